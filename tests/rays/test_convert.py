"""Conversions, each against the project it converts from or the numbers that project defines."""

import json
import os
import warnings
from pathlib import Path
from types import SimpleNamespace

import cv2
import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from rays_oracle import random_poses, seeds

from jaxcam import rays
from jaxcam.errors import CameraError

some = settings(max_examples=25, deadline=None, derandomize=True)
MJCF = """
<mujoco>
  <worldbody>
    <body pos="0.1 0.2 0.3" quat="0.5 0.5 -0.5 0.5">
      <camera name="side" pos="0.4 -0.2 0.9" quat="0.8 0.1 -0.3 0.2" fovy="50"/>
    </body>
    <geom name="ball" type="sphere" size="0.05" pos="0.3 -0.2 0.6"/>
  </worldbody>
</mujoco>
"""


@pytest.fixture(scope="module")
def scene():
    model = mujoco.MjModel.from_xml_string(MJCF)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


@some
@given(seeds)
def test_there_and_back_again(seed):
    pose = random_poses(np.random.default_rng(seed), (2,))
    same = {
        "gl": rays.opengl_from_opencv(rays.opencv_from_opengl(pose)),
        "gl twice": rays.opencv_from_opengl(rays.opencv_from_opengl(pose)),
        "inverse": rays.invert(rays.invert(pose)),
        "sapien": rays.opencv_from_sapien(rays.sapien_from_opencv(pose)),
        "mujoco": rays.from_mujoco(*rays.to_mujoco(pose)),
        "quaternion": rays.from_mujoco_quat(*rays.to_mujoco_quat(pose)),
        "maniskill": rays.from_maniskill(rays.to_maniskill(pose)[0]),
        "maniskill gl": rays.from_maniskill_gl(rays.to_maniskill(pose)[1]),
    }
    for name, got in same.items():
        np.testing.assert_allclose(got, pose, atol=1e-12, err_msg=name)
    np.testing.assert_allclose(
        rays.invert(pose) @ pose, np.eye(4) + np.zeros_like(pose), atol=1e-12
    )


def test_axes_of_one_camera_written_out():
    """A camera at (1, 2, 3) that looks along world +x, with world +z up in its image."""
    cv = np.array([[0, 0, 1, 1], [-1, 0, 0, 2], [0, -1, 0, 3], [0, 0, 0, 1.0]])
    gl = np.array([[0, 0, -1, 1], [-1, 0, 0, 2], [0, 1, 0, 3], [0, 0, 0, 1.0]])
    sapien = np.array([[1, 0, 0, 1], [0, 1, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1.0]])
    world_to_camera = np.array([[0, -1, 0, 2], [0, 0, -1, 3], [1, 0, 0, -1.0]])
    np.testing.assert_allclose(rays.opencv_from_opengl(gl), cv)
    np.testing.assert_allclose(rays.opencv_from_sapien(sapien), cv)
    np.testing.assert_allclose(rays.sapien_from_opencv(cv), sapien)
    np.testing.assert_allclose(rays.from_maniskill(world_to_camera), cv)
    np.testing.assert_allclose(rays.from_maniskill_gl(gl), cv)
    np.testing.assert_allclose(rays.to_maniskill(cv)[0], world_to_camera)
    np.testing.assert_allclose(rays.look_at(np.array([1.0, 2, 3]), np.array([5.0, 2, 3])), cv)


def test_mujoco_camera(scene):
    model, data = scene
    pose = rays.from_mujoco(data.cam_xpos[0], data.cam_xmat[0])
    np.testing.assert_array_equal(
        rays.from_mujoco(data.cam_xpos, data.cam_xmat.reshape(-1, 3, 3))[0], pose
    )
    world_from_body = np.eye(4)
    world_from_body[:3, :3] = data.xmat[1].reshape(3, 3)
    world_from_body[:3, 3] = data.xpos[1]
    body_from_camera = rays.from_mujoco_quat(model.cam_pos[0], 3 * model.cam_quat[0])
    np.testing.assert_allclose(world_from_body @ body_from_camera, pose, atol=1e-12)
    position, quaternion = rays.to_mujoco_quat(body_from_camera)
    np.testing.assert_allclose(position, model.cam_pos[0], atol=1e-12)
    np.testing.assert_allclose(quaternion, model.cam_quat[0], atol=1e-12)


def test_rays_hit_what_mujoco_says_is_there(scene):
    """The ray of the ball's pixel, cast by MuJoCo, hits the ball; those of mirrored pixels miss."""
    model, data = scene
    pose = rays.look_at(np.array([1.1, 0.4, 1.2]), np.array([0.2, 0.1, 0.5]))
    camera = rays.Camera.from_fovy(np.deg2rad(model.cam_fovy[0]), 64, 64, pose)
    (u, v), depth = camera.project(data.geom_xpos[0])
    ray_map = np.asarray(camera.plucker(), np.float64)

    def cast(row, column):
        hit = np.zeros(1, np.int32)
        distance = mujoco.mj_ray(
            *(model, data, pose[:3, 3], ray_map[row, column, :3], None, 1, -1, hit)
        )
        return distance, hit[0]

    distance, geom = cast(int(v), int(u))
    assert geom == 0
    z = distance * ray_map[int(v), int(u), :3] @ pose[:3, 2]
    np.testing.assert_allclose(z, depth - 0.05, atol=0.01)
    assert cast(int(v), 63 - int(u))[1] == -1
    assert cast(63 - int(v), int(u))[1] == -1


def test_robosuite_matrices(scene):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from robosuite.utils import camera_utils  # here, since it warns of what it lacks
    model, data = scene
    names = SimpleNamespace(camera_name2id=lambda _: 0, cam_fovy=model.cam_fovy)
    sim = SimpleNamespace(model=names, data=data)
    extrinsic = camera_utils.get_camera_extrinsic_matrix(sim, "side")
    np.testing.assert_allclose(
        rays.from_robosuite(extrinsic), rays.from_mujoco(data.cam_xpos[0], data.cam_xmat[0])
    )
    np.testing.assert_allclose(
        camera_utils.get_camera_intrinsic_matrix(sim, "side", 48, 64),
        rays.Camera.from_fovy(np.deg2rad(50), 48, 64).K,
    )


def test_maniskill_shapes():
    pose = random_poses(np.random.default_rng(0), (4,))
    extrinsic, gl = rays.to_maniskill(pose)
    assert extrinsic.shape == (4, 3, 4)
    full = np.concatenate([extrinsic, np.tile([[0, 0, 0, 1.0]], (4, 1, 1))], axis=-2)
    np.testing.assert_allclose(rays.from_maniskill(full), rays.from_maniskill_gl(gl), atol=1e-12)
    with pytest.raises(CameraError, match=r"\[\.\.\., 3, 4\] or \[\.\.\., 4, 4\], got \[3, 3\]"):
        rays.from_maniskill(np.eye(3))


@some
@given(seeds)
def test_quaternions_near_half_turns(seed):
    """Where w vanishes; the naive formula through the trace loses all digits there."""
    rng = np.random.default_rng(seed)
    axis = rng.normal(size=3) * rng.integers(0, 2, 3) + [1e-9, 0, 0]
    axis /= np.linalg.norm(axis)
    turn = np.eye(4)
    turn[:3, :3] = 2 * np.outer(axis, axis) - np.eye(3)
    pose = rays.opencv_from_opengl(turn)
    np.testing.assert_allclose(rays.from_mujoco_quat(*rays.to_mujoco_quat(pose)), pose, atol=1e-12)


def test_jax_in_jax_out():
    pose = jnp.asarray(random_poses(np.random.default_rng(0), (3,)), jnp.float32)
    for convert in (rays.invert, rays.opencv_from_opengl, rays.sapien_from_opencv):
        got = jax.jit(convert)(pose)
        assert isinstance(convert(pose), jax.Array)
        np.testing.assert_allclose(got, convert(np.asarray(pose)), atol=1e-6)
    position, quaternion = jax.jit(rays.to_mujoco_quat)(pose)
    np.testing.assert_allclose(rays.from_mujoco_quat(position, quaternion), pose, atol=1e-6)


def test_pose_file_round_trip(tmp_path):
    path = tmp_path / "poses.json"
    poses = rays.sample_poses(rays.POSE_RANGES["robosuite"], 5, seed=3)
    rays.write_pose_file(path, poses, {"seed": 3})
    content = json.loads(path.read_text())
    assert list(content) == ["config", "poses"]
    # In the file: OpenGL axes, so the third column points away from the scene.
    np.testing.assert_allclose(np.array(content["poses"])[:, :3, 2], -poses[:, :3, 2])
    read, config = rays.read_pose_file(path)
    np.testing.assert_array_equal(read, poses)
    assert config == {"seed": 3}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('{"poses": [[1, 2', "not JSON.*cut download"),
        ("[]", "'poses', found list"),
        ('{"config": {}}', r"found \['config'\]"),
        ('{"poses": {"agentview": []}}', "list 'poses'"),
        ('{"poses": [[1, 2], [3]]}', "4x4 matrices of numbers"),
        ('{"poses": [[[1, 2], [3, 4]]]}', "wrong shape"),
        ('{"poses": [[[1e999]]], "config": 3}', "'config' must be an object, found int"),
        ("[" * 100_000, "not JSON"),
        ('{"poses": [[[1' + "0" * 400 + "]]]}", "4x4 matrices of numbers"),
        ('{"poses": [1, 2]}', r"\[count, 4, 4\]"),
        ('{"poses": [[[1,0,0,0],[0,1,0,0],[0,0,-1,0],[0,0,0,1]]]}', r"pose\[0\]: determinant"),
    ],
)
def test_damaged_pose_files_are_refused_by_name(tmp_path, text, message):
    path = tmp_path / "poses.json"
    path.write_text(text)
    with pytest.raises(CameraError, match=f"poses.json.*{message}"):
        rays.read_pose_file(path)


@pytest.mark.parametrize("kind", ["missing", "folder", "pipe", "device"])
def test_what_may_never_end_is_no_pose_file(tmp_path, kind):
    path = tmp_path / "poses.json"
    if kind == "folder":
        path.mkdir()
    elif kind == "pipe":
        os.mkfifo(path)
    elif kind == "device":
        path = Path("/dev/zero")
    with pytest.raises(CameraError, match=f"{path.name} (is no file|cannot be read)"):
        rays.read_pose_file(path)


def test_impossible_poses_are_not_written(tmp_path):
    with pytest.raises(CameraError, match=r"pose\[1\]"):
        rays.write_pose_file(tmp_path / "p.json", np.stack([np.eye(4), np.zeros((4, 4))]))
    with pytest.raises(CameraError, match=r"\[count, 4, 4\]"):
        rays.write_pose_file(tmp_path / "p.json", np.eye(4))
    assert not (tmp_path / "p.json").exists()


CALIBRATED = """
<mujoco>
  <worldbody>
    <camera name="c" pos="0.3 -0.4 1.2" xyaxes="1 0.2 0 0 1 0.3" resolution="64 48"
      sensorsize="0.0064 0.0048" focal="0.005 0.006" principal="{}"/>
    <site name="s" pos="0.35 -0.3 0.1"/>
  </worldbody>
  <sensor><camprojection site="s" camera="c"/></sensor>
</mujoco>
"""


def _calibrated(principal):
    """MuJoCo's model and data, and the camera that docs/conventions.md makes of them."""
    model = mujoco.MjModel.from_xml_string(CALIBRATED.format(principal))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    width, height = model.cam_resolution[0]
    fx, fy, px, py = model.cam_intrinsic[0] * np.tile(
        model.cam_resolution[0] / model.cam_sensorsize[0], 2
    )
    K = np.array([[fx, 0, width / 2 - px], [0, fy, height / 2 - py], [0, 0, 1]])
    pose = rays.from_mujoco(data.cam_xpos[0], data.cam_xmat[0])
    return model, data, rays.Camera(K, pose, int(height), int(width))


def test_mjcf_focal_and_principal_are_mujocos_frustum():
    model, data, camera = _calibrated("0.0004 -0.0003")
    scene, eye = mujoco.MjvScene(model, 10), mujoco.MjvCamera()
    eye.type, eye.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, 0
    mujoco.mjv_updateScene(
        model, data, mujoco.MjvOption(), None, eye, mujoco.mjtCatBit.mjCAT_ALL, scene
    )
    # Two eyes, a little apart, of which both look through the same window.
    window = scene.camera[0]
    left = window.frustum_center - window.frustum_width
    right = window.frustum_center + window.frustum_width
    near = window.frustum_near
    K = camera.K
    for u, v, x, y in (
        (0, 0, left, window.frustum_top),
        (64, 48, right, window.frustum_bottom),
    ):
        tangents = np.array([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1]])
        np.testing.assert_allclose(tangents, [x / near, -y / near], atol=1e-6)
    np.testing.assert_allclose(K[:2, 2], [28, 27], atol=1e-5)


def test_mjcf_focal_is_mujocos_projection():
    """MuJoCo's `camprojection` sensor, which leaves `principal` out."""
    _, data, camera = _calibrated("0 0")
    uv, _ = camera.project(data.site_xpos[0])
    np.testing.assert_allclose(uv, data.sensordata, atol=1e-5)


def test_opencv_calibrations_have_pixel_centres_at_whole_numbers():
    """OpenCV's rays of whole pixels are ours, with 0.5 added to the principal point."""
    theirs = np.array([[50.0, 0, 31.5], [0, 52, 23.5], [0, 0, 1]])
    ours = theirs + np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
    d = np.asarray(rays.plucker(ours, np.eye(4), 48, 64))[..., :3]
    indices = np.stack(np.meshgrid(np.arange(64.0), np.arange(48.0)), -1).reshape(-1, 1, 2)
    want = cv2.undistortPoints(indices, theirs, None).reshape(48, 64, 2)
    np.testing.assert_allclose(d[..., :2] / d[..., 2:], want, atol=1e-6)
