"""The saved page in a browser: it draws, says nothing, asks for nothing, and answers."""

import json
import re
from dataclasses import replace

import cv2
import numpy as np
import pytest
from chromium import chromium
from exhibits import SLAB, an_exhibit

from jaxcam.errors import DatasetError
from jaxcam.files.whole import FOOTER, MARK
from jaxcam.viewer import page as pages
from jaxcam.viewer.exhibit import Exhibit
from jaxcam.viewer.page import render_page


@pytest.fixture(scope="module")
def exhibit():
    return an_exhibit()


@pytest.fixture(scope="module")
def file(exhibit, tmp_path_factory):
    path = tmp_path_factory.mktemp("pages") / "page.html"
    path.write_text(render_page(exhibit, {0: "the first", 4: "the fourth"}), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def tab(file, tmp_path_factory):
    """The page, opened."""
    with chromium(tmp_path_factory.mktemp("profile")) as tab:
        tab.open(file.as_uri())
        close = "document.querySelector('.mantine-Notification-closeButton')"
        tab.wait(f"Boolean({close})")  # that WebGL runs without a GPU, which lies over the scene
        tab.value(f"{close}.click()")
        yield tab


def content(page):
    return json.loads(re.search(r'id="exhibit">(.*?)</script>', page, re.DOTALL)[1])


def test_names_of_others_are_no_code(exhibit):
    evil = "</script><script>alert(1)</script>"
    view = replace(exhibit.viewpoints[0], name=evil)
    page = render_page(Exhibit(evil, evil, viewpoints=(view,), notes=(evil,)))
    assert "<script>alert" not in page
    assert content(page)["notes"] == [evil]


def test_a_page_is_known_as_ours(file):
    assert MARK in file.read_text("utf-8")[-FOOTER:]


def test_a_page_too_large_has_fewer_pictures(exhibit, monkeypatch):
    whole = render_page(exhibit)
    steps = content(whole)["views"][0]["steps"]
    monkeypatch.setattr(pages, "LARGEST", len(whole) - 1)
    assert content(render_page(exhibit))["views"][0]["steps"] == steps[::2]
    monkeypatch.setattr(pages, "LARGEST", 1000)
    with pytest.raises(DatasetError, match="shorter episode"):
        render_page(exhibit)


def test_it_says_nothing_and_asks_for_nothing(tab):
    assert tab.said == []
    assert [url for url in tab.asked if not url.startswith(("file:", "blob:", "data:"))] == []


def test_the_canvas_is_not_blank(tab):
    picture = cv2.imdecode(np.frombuffer(tab.screenshot(), np.uint8), cv2.IMREAD_COLOR)
    scene = picture[:, : picture.shape[1] - 380]
    assert len(np.unique(scene.reshape(-1, 3), axis=0)) > 50
    slab = (abs(scene.astype(int) - (160, 120, 90)).max(-1) < 60).sum()
    assert slab > 500


def drawn(tab, t):
    """A view's picture as the panel shows it at a moment, [height, width, 3]."""
    tab.value(f"document.getElementById('time').value = {t}")
    tab.value("document.getElementById('time').oninput()")
    tab.wait(f"document.getElementById('now').textContent.startsWith('{t} of')")
    tab.value("new Promise(done => setTimeout(done, 300))")
    size, levels = tab.value(
        "(() => { const c = document.querySelector('canvas[data-camera]');"
        "const all = c.getContext('2d').getImageData(0, 0, c.width, c.height);"
        "return [[c.height, c.width], [...all.data]] })()"
    )
    return np.array(levels, np.uint8).reshape(*size, 4)[..., :3]


def test_the_slider_shows_the_pictures_of_that_moment(tab, exhibit):
    for t in (4, 0):
        expected = exhibit.viewpoints[0].pictures[t].astype(int)
        assert abs(drawn(tab, t) - expected).mean() < 4  # JPEG


def test_the_slider_moves_the_bodies(tab):
    where = "__viserMutable.nodeRefFromName['/bodies/001 block'].position.x"
    drawn(tab, 5)
    tab.wait(f"Math.abs({where} - 0.6) < 1e-4")
    drawn(tab, 0)
    tab.wait(f"Math.abs({where} - 0.2) < 1e-4")


def click_pixel(tab, view, u, v):
    """Clicks at a pixel of a view's picture in the panel; what the panel then says."""
    box = tab.value(
        f"(() => {{ const c = document.querySelector('canvas[data-camera=\"{view}\"]');"
        "c.scrollIntoView({block: 'center'}); const b = c.getBoundingClientRect();"
        "return [b.left, b.top, b.width / c.width, (b.height - 3) / c.height] })()"
    )
    x, y = box[0] + u * box[2], box[1] + v * box[3]
    tab.click(x, y)
    tab.wait("!document.querySelector('#ray label').hidden")
    return tab.value("document.querySelector('#ray p').textContent")


def numbers(text):
    return [float(x) for x in re.findall(r"-?\d+\.\d+", text)]


def test_a_click_on_a_pixel_gives_its_ray_and_where_the_others_see_its_end(tab, exhibit):
    drawn(tab, 0)
    view = exhibit.viewpoints[0]
    u, v, *rest = numbers(click_pixel(tab, 0, 30.0, 50.0))
    assert (u, v) == pytest.approx((30, 50), abs=1.5)
    origin, direction, point = np.array(rest[:9]).reshape(3, 3)
    np.testing.assert_allclose(origin, view.camera.world_from_camera[:3, 3], atol=2e-3)
    far = np.asarray(view.camera.unproject(np.array([1.0]), np.array([[u, v]])))[0]
    truth = (far - origin) / np.linalg.norm(far - origin)
    np.testing.assert_allclose(direction, truth, atol=3e-3)
    # It ends on the slab, or on the block above it.
    assert point[2] == pytest.approx(SLAB, abs=2e-3) or 0.3 <= point[2] <= 0.351
    for i, other in enumerate(exhibit.viewpoints[1:3], start=1):
        pixel, depth = other.camera.project(point[None])
        said = tab.value(f"document.querySelector('canvas[data-camera=\"{i}\"]').dataset.pixel")
        assert depth[0] > 0
        np.testing.assert_allclose(np.array(said.split(","), float), pixel[0], atol=0.3)


def test_the_ray_is_drawn_in_space(tab):
    click_pixel(tab, 1, 48.0, 36.0)
    tab.wait("__viserMutable.nodeRefFromName['/pointer/ray'].visible")
    picture = cv2.imdecode(np.frombuffer(tab.screenshot(), np.uint8), cv2.IMREAD_COLOR)
    scene = picture[:, : picture.shape[1] - 380].astype(int)
    red, green = scene[..., 2], scene[..., 1]
    assert ((red - green > 100) & (scene[..., 0] - green > 60)).sum() > 40


def test_rays_of_a_lens_are_those_of_the_library(tab, exhibit):
    """To a tenth of a pixel and less, all over the picture, and back."""
    camera = exhibit.viewpoints[1].camera
    places = np.random.default_rng(0).uniform((0, 0), (camera.width, camera.height), (40, 2))
    said = tab.value(
        "(() => { const c = jaxcam.cameras[1]; return "
        f"{places.tolist()}.map(([u, v]) => {{ const r = c.ray(u, v, 0);"
        "return [r.direction, c.pixel(jaxcam.add(r.origin, r.direction, 0.7), 0)] }) })()"
    )
    ends = np.asarray(camera.unproject(np.ones(len(places)), places), float)
    truth = ends - camera.world_from_camera[:3, 3]
    focal = camera.K[0, 0]
    assert np.abs(np.array([d for d, _ in said]) - truth).max() * focal < 0.1
    np.testing.assert_allclose(np.array([pixel for _, pixel in said]), places, atol=0.01)


def test_a_click_in_space_gives_the_pixels_of_a_point(tab, exhibit):
    target = np.array([0.7, 0.3, SLAB])
    x, y = tab.value(f"jaxcam.onScreen({target.tolist()})")
    tab.click(x, y)
    tab.wait("document.querySelector('#ray p').textContent.startsWith('Point')")
    point = np.array(numbers(tab.value("document.querySelector('#ray p').textContent")))
    np.testing.assert_allclose(point, target, atol=0.02)
    for i, view in enumerate(exhibit.viewpoints[:3]):
        (pixel,), (depth,) = view.camera.project(point[None])
        said = tab.value(f"document.querySelector('canvas[data-camera=\"{i}\"]').dataset.pixel")
        size = view.camera.width, view.camera.height
        inside = depth > 0 and (pixel >= 0).all() and (pixel <= size).all()
        assert bool(said) == bool(inside)
        if said:
            np.testing.assert_allclose(np.array(said.split(","), float), pixel, atol=0.3)


def test_a_click_on_a_picture_in_space_is_its_pixel(tab, exhibit):
    view = exhibit.viewpoints[2]
    pose = view.camera.world_from_camera
    K = view.camera.K
    u, v = 60.0, 30.0
    at = 0.16 * np.array([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], 1])
    x, y = tab.value(f"jaxcam.onScreen({(pose[:3, :3] @ at + pose[:3, 3]).tolist()})")
    tab.click(x, y)
    tab.wait("document.querySelector('#ray p').textContent.startsWith('right, pixel')")
    assert numbers(tab.value("document.querySelector('#ray p').textContent"))[:2] == pytest.approx(
        (u, v), abs=2
    )


def test_a_ball_of_the_sphere_tells_what_came_of_its_rollouts(tab, exhibit):
    outcomes = exhibit.outcomes[0]
    x, y = tab.value(f"jaxcam.onScreen({outcomes.places[1].tolist()})")
    tab.mouse("mouseMoved", x, y)
    tab.wait("__viserMutable.canvas.title === 'pair 1'")
    assert tab.value("document.querySelectorAll('.legend .rate').length") == 1


def test_another_episode_is_asked_of_the_server(tab):
    labels = tab.value("[...document.querySelectorAll('#episode option')].map(o => o.textContent)")
    assert labels == ["0: the first", "4: the fourth"]
