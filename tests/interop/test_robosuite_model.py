"""Models in demonstration files: MuJoCo reads no file for them, and none grows without bounds."""

import os
import time

import numpy as np
import pytest
from robomimic_files import recorded

from jaxcam.errors import DatasetError
from jaxcam.interop.robosuite_model import read_origin

ROBOT = "<mujoco><worldbody>{}</worldbody></mujoco>"


@pytest.fixture(scope="module")
def parts():
    return recorded("1.5")


def origin_of(xml, parts, lift):
    return read_origin(xml, parts["states_0"][0], lift.scene("randomized"), lift.varied)


@pytest.mark.timeout(60)
@pytest.mark.parametrize(
    ("xml", "message"),
    [
        ('<mujoco><include file="{}"/></mujoco>', "element 'include'"),
        (ROBOT.format('<include file="{}"/>'), "element 'include'"),
        (ROBOT.format('<body><include file="{}"/></body>'), "element 'include'"),
        ('<mujoco><default><include file="{}"/></default></mujoco>', "element 'include'"),
        ('<mujoco><extension><plugin plugin="{}"/></extension></mujoco>', "element 'extension'"),
        (ROBOT.format('<body><plugin plugin="{}"/></body>'), "element 'plugin'"),
        (ROBOT.format('<replicate count="1000000000"><geom size="1"/></replicate>'), "'replicate'"),
        (ROBOT.format('<composite type="grid" count="100000 100000 1"/>'), "element 'composite'"),
        (ROBOT.format('<flexcomp name="a" file="{}"/>'), "element 'flexcomp'"),
        (ROBOT.format('<attach model="a"/>'), "element 'attach'"),
        (ROBOT.format('<body><flexcomp count="9999 9999 9"/></body>'), "element 'flexcomp'"),
        (ROBOT.format("<body/>" * 20_001), "over 20000 elements"),
        (ROBOT.format("<body>" * 300 + "</body>" * 300), "200 inside each other"),
        ('<!DOCTYPE a [<!ENTITY b SYSTEM "{}">]><mujoco>&b;</mujoco>', "document type"),
        ('<!DOCTYPE a [<!ENTITY b "bbbb">]><mujoco>&b;</mujoco>', "document type"),
        ("", "no MJCF"),
        ("<mujoco>", "no MJCF"),
        ("\0", "no MJCF"),
        (ROBOT.format('<body pos="a b c"/>'), "no MJCF"),
        (ROBOT.format('<body><geom size="-1"/></body>'), "no MJCF"),
        ("<urdf/>", "no MJCF"),
    ],
)
def test_models_that_reach_out_or_grow_are_refused(tmp_path, parts, lift, xml, message):
    pipe = tmp_path / "pipe.xml"
    os.mkfifo(pipe)
    began = time.perf_counter()
    with pytest.raises(DatasetError, match=message):
        origin_of(xml.replace("{}", str(pipe)), parts, lift)
    assert time.perf_counter() - began < 20


@pytest.mark.timeout(60)
def test_files_that_a_model_names_are_not_opened(tmp_path, parts, lift):
    """Meshes, textures and height fields that are pipes: opening one would wait for ever."""
    wanted = origin_of(str(parts["model_0"]), parts, lift)
    pipe = tmp_path / "pipe.obj"
    os.mkfifo(pipe)
    assets = (
        f'<mesh name="m" file="{pipe}"/><hfield name="h" file="{pipe}"/>'
        f'<texture name="t" type="2d" file="{pipe}"/><model name="x" file="{pipe}"/>'
        f'<skin file="{pipe}"/>'
    )
    geoms = '<geom type="mesh" mesh="m"/><geom type="hfield" hfield="h"/>'
    xml = str(parts["model_0"]).replace("<asset>", "<asset>" + assets)
    xml = xml.replace("<worldbody>", "<worldbody>" + geoms)
    assert geoms in xml
    assert assets in xml
    origin = origin_of(xml, parts, lift)
    np.testing.assert_array_equal(origin.world_from_theirs, wanted.world_from_theirs)
    np.testing.assert_array_equal(origin.geom_size, wanted.geom_size)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('pos="0 0 0.775"', 'pos="0 0 nan"', "no MJCF|table's top"),
        ('pos="0 0 0.775"', 'pos="0 0 1e300"', "no MJCF|table's top"),
    ],
)
def test_numbers_that_are_none_match_nothing(parts, lift, old, new, message):
    xml = str(parts["model_0"])
    assert old in xml
    with pytest.raises(DatasetError, match=message):
        origin_of(xml.replace(old, new), parts, lift)
