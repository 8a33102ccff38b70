"""The arm's model: what moves, and where it is."""

import numpy as np
import pytest
from boxed_arm import JOINTS, XML, boxed_arm, links

from jaxcam.errors import ConfigError
from jaxcam.robot.calibration.arm.model import ArmModel, load_arm

URDF = """<robot name="small">
  <link name="base"/>
  <link name="link"><visual><origin xyz="0 0 0.2"/>
    <geometry><cylinder radius="0.05" length="0.4"/></geometry></visual>
    <inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>
  </link>
  <joint name="turns" type="revolute"><parent link="base"/><child link="link"/>
    <origin xyz="0 0 0.1"/><axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="1" velocity="1"/>
  </joint>
</robot>"""


def test_links_are_where_they_are_by_hand():
    arm = boxed_arm()
    assert arm.joints == 3
    assert len(arm.parts) == 3  # the base does not move
    angles = np.array([[0.0, 0, 0], [0.4, -0.3, 0.8]])
    np.testing.assert_allclose(arm.poses(angles), [links(a) for a in angles], atol=1e-9)


def test_boxes_have_their_corners_and_faces_that_look_outwards():
    part = boxed_arm().parts[1]
    np.testing.assert_allclose(part.vertices.max(0), [0.32, 0.045, 0.05], atol=1e-9)
    a, b, c = (part.vertices[part.faces[:, i]] for i in range(3))
    across = np.cross(b - a, c - a)
    assert ((a - part.vertices.mean(0)) * across).sum(-1).min() > 0
    assert np.linalg.norm(across, axis=-1).sum() / 2 == pytest.approx(
        8 * (0.16 * 0.045 + 0.16 * 0.05 + 0.045 * 0.05)
    )


def test_an_mjcf_file_and_a_urdf_file_are_read(tmp_path):
    (tmp_path / "arm.xml").write_text(XML)
    assert load_arm(str(tmp_path / "arm.xml")).joints == len(JOINTS)
    (tmp_path / "arm.urdf").write_text(URDF)
    arm = load_arm(str(tmp_path / "arm.urdf"))
    pose = arm.poses(np.array([[np.pi / 2]]))[0, 0]
    top = pose @ [0, 0, 0.4, 1]
    np.testing.assert_allclose(top[:3], [0.4, 0, 0.1], atol=1e-9)
    assert np.ptp(arm.parts[0].vertices[:, 2]) == pytest.approx(0.4)


def test_what_is_no_robot_is_said(tmp_path):
    with pytest.raises(ConfigError, match="no such file"):
        load_arm(str(tmp_path / "none.xml"))
    (tmp_path / "broken.xml").write_text("<mujoco><nothing/></mujoco>")
    with pytest.raises(ConfigError, match="MuJoCo cannot read it"):
        load_arm(str(tmp_path / "broken.xml"))
    (tmp_path / "still.xml").write_text("<mujoco><worldbody/></mujoco>")
    with pytest.raises(ConfigError, match="no joint that turns"):
        load_arm(str(tmp_path / "still.xml"))


def test_a_joint_that_there_is_not():
    import mujoco

    with pytest.raises(ConfigError, match="no joint 'j4'"):
        ArmModel(mujoco.MjModel.from_xml_string(XML), "base", ("j1", "j4"))
