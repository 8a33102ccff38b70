"""The scene that viser's client draws."""

import numpy as np
from exhibits import an_exhibit

from jaxcam.rays import Camera
from jaxcam.viewer.scene import frustum, node_name, page_of


def test_a_frustum_ends_where_the_corners_of_the_picture_are_seen():
    K = np.array([[110.0, 0, 40], [0, 90.0, 40], [0, 0, 1]])
    camera = Camera(K, np.eye(4), 72, 96)
    corners = frustum(camera, 0.2)
    np.testing.assert_allclose(corners[:, 2], 0.2)
    pixels, _ = camera.project(corners)
    np.testing.assert_allclose(pixels, [[0, 0], [96, 0], [96, 72], [0, 72]], atol=1e-4)


def test_a_name_with_a_slash_is_one_node():
    assert node_name("cameras", 3, "a/b").count("/") == 2


def test_the_page_has_the_scene_inside():
    page = page_of(an_exhibit())
    assert "__VISER_EMBED_DATA__" in page
    assert "<title>Viser</title>" in page  # which `jaxcam.viewer.page` replaces
    assert page.count("</head>") == page.count("</body>") == 1
