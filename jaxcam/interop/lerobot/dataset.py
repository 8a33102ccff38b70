"""`python -m jaxcam.lerobot DATASET OUT`: a dataset in LeRobot's v3.0 format, cameras included.

Written with pyarrow and PyAV, so LeRobot and its PyTorch need not be installed; LeRobot's own
loader reads the folder (`tests/golden/check_lerobot.py`). Beside what every LeRobot dataset has
(`observation.state`, `action`, a video a view) each row carries, for each view,
`camera.<view>.base_from_camera` (OpenCV axes) and `camera.<view>.intrinsics` (pixels), and
`meta/jaxcam.json` tells the conventions. They are no `observation.*`, since LeRobot would take
those for robot states and normalise every number of a pose by itself.
"""

from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from jaxcam.config.datasets import LerobotConfig
from jaxcam.console.progress import progress
from jaxcam.data.batches import Dataset, make_dataset
from jaxcam.data.demos import Demos, read_demos
from jaxcam.data.header import Header
from jaxcam.data.pictures import load_pictures
from jaxcam.errors import DatasetError
from jaxcam.files.locks import exclusive
from jaxcam.files.paths import home
from jaxcam.files.whole import whole
from jaxcam.interop.lerobot.format import VERSION, Writer, feature, video_feature, write_meta
from jaxcam.sim.actions import action_names, is_absolute, is_joint
from jaxcam.sim.controllers import CONTROL_HZ
from jaxcam.sim.world import STATE_NAMES, World


def export_dataset(config: LerobotConfig, console: Console | None = None) -> Path:
    """Writes a dataset's training (or validation) demonstrations as a LeRobot dataset.

    Args:
        config: What to export, and where to.
        console: For progress; silent when None.

    Returns:
        The folder.

    Raises:
        DatasetError: If the dataset cannot be read, has no such demonstrations, or the folder
            exists.
    """
    demos, out = read_demos(home(config.dataset)), home(config.out)
    chosen = range(len(demos.train), len(demos.train) + len(demos.valid))
    if not config.validation:
        chosen = range(len(demos.train))
    if not chosen:
        raise DatasetError(f"{demos.path}: no validation demonstrations to export.")
    _refuse_existing(out)
    with exclusive(out, console):  # before anything is drawn: it needs a place to go to
        _refuse_existing(out)
        scene = demos.world
        pictures = load_pictures(demos, config.resolution, console)
        data = make_dataset(demos, pictures, config.action_space, scene)
        try:
            with whole(out, folder=True) as part:
                _write(part, config, demos, data, chosen, scene, console)
        except OSError as error:
            raise DatasetError(
                f"{out}: cannot be written: {error.strerror or error}. Make room and repeat."
            ) from error
    return out


def _refuse_existing(out: Path) -> None:
    if out.exists():
        raise DatasetError(f"{out} exists. Choose another folder, or delete it first.")


def _write(
    root: Path,
    config: LerobotConfig,
    demos: Demos,
    data: Dataset,
    chosen: range,
    scene: World,
    console: Console | None,
) -> None:
    views = [f"view_{v}" for v in range(len(data.windows[chosen[0]]))]
    features = _features(config, data, views)
    instruction = config.instruction or demos.task.prompt
    total = int(data.lengths[list(chosen)].sum())
    with (
        Writer(root, features, CONTROL_HZ, instruction) as writer,
        progress(console, "exporting", total) as advance,
    ):
        for demo in chosen:
            writer.add(_rows(data, demo, views), _pictures(data, demo))
            advance(int(data.lengths[demo]))
        writer.finish("panda")
    write_meta(root / "meta/jaxcam.json", _about(config, demos, data, scene))


def _about(config: LerobotConfig, demos: Demos, data: Dataset, scene: World) -> dict[str, Any]:
    """What LeRobot's own metadata has no place for."""
    header = demos.header
    return {
        "task": header.task,
        "scene": header.scene,
        "action_space": config.action_space,
        **_optics(header, data),
        "image_size": list(data.pictures.rgb.shape[1:3]),
        "world_from_base": scene.world_from_base.tolist(),
        "nominal_grip": scene.nominal_grip.tolist(),
        "conventions": {
            "camera": "OpenCV axes: x right, y down, z forward; pixel (i, j) has its centre at "
            "(j + 0.5, i + 0.5)",
            **_whose_optics(header, data),
            "base_from_camera": "p_base = base_from_camera @ p_camera; metres, robot's base",
            "actions": _meaning(config.action_space),
            "gripper": "positive closes",
        },
        "source": {"fingerprint": demos.fingerprint, "versions": header.versions},
        "jaxcam": version("jaxcam"),
    }


def _optics(header: Header, data: Dataset) -> dict[str, Any]:
    """The intrinsics and the field of view of all cameras; None where they differ."""
    if np.ptp(data.K, 0).any():
        return {"intrinsics": None, "fovy_deg": None}
    fovy = header.fovy_deg if header.K is None else float(np.rad2deg(header.camera(0, 1).fovy))
    return {"intrinsics": data.K[0].tolist(), "fovy_deg": fovy}


def _whose_optics(header: Header, data: Dataset) -> dict[str, str]:
    """Where each camera's intrinsics and lens are, if they have their own."""
    if header.K is None and header.distortion is None:
        return {}
    drawn = ", ".join(f"{name} {text}" for name, text in header.ranges.items())
    said = "each camera's own: camera.<view>.intrinsics"
    if data.distortion is not None:
        said += ", and camera.<view>.distortion as jaxcam.rays.lens.pack has it"
    return {"intrinsics": said + (f"; drawn from {drawn}" if drawn else "")}


def _meaning(space: str) -> str:
    """What the numbers of an action are, in words."""
    if is_joint(space):
        return "joint angles (rad)" if is_absolute(space) else "what joint angles move by (rad)"
    if is_absolute(space):
        return (
            "grip site in the world (m) and rotation vector r (rad) about the world's axes, "
            "R_world = exp(r) @ nominal_grip"
        )
    return (
        "what the commanded grip pose moves by: the site in the world (m) and rotation vector r "
        "(rad) about the world's axes, R_next = exp(r) @ R"
    )


def _features(config: LerobotConfig, data: Dataset, views: list[str]) -> dict[str, Any]:
    """LeRobot's description of every column and video that is ours."""
    action, state = list(action_names(config.action_space)), list(STATE_NAMES)
    features = {
        "observation.state": feature("float32", data.proprio.shape[-1:], state),
        "action": feature("float32", data.actions.shape[-1:], action),
    }
    height, width = data.pictures.rgb.shape[1:3]
    for view in views:
        features[f"observation.images.{view}"] = video_feature(height, width, CONTROL_HZ)
        features[f"camera.{view}.base_from_camera"] = feature("float32", (4, 4))
        features[f"camera.{view}.intrinsics"] = feature("float32", (3, 3))
        if data.distortion is not None:
            features[f"camera.{view}.distortion"] = feature("float32", data.distortion.shape[-1:])
    if data.errors is not None:
        features["errors"] = feature("bool", (1,))
    return features


def _rows(data: Dataset, demo: int, views: list[str]) -> dict[str, np.ndarray]:
    """One demonstration's columns that are its own."""
    length = int(data.lengths[demo])
    rows = {"observation.state": data.proprio[demo, :length], "action": data.actions[demo, :length]}
    for view, camera in zip(views, data.windows[demo], strict=True):
        pose, K = data.base_from_camera[camera], data.K[camera]
        rows[f"camera.{view}.base_from_camera"] = np.broadcast_to(pose, (length, 4, 4))
        rows[f"camera.{view}.intrinsics"] = np.broadcast_to(K, (length, 3, 3))
        if data.distortion is not None:
            lens = data.distortion[camera]
            rows[f"camera.{view}.distortion"] = np.broadcast_to(lens, (length, len(lens)))
    if data.errors is not None:
        rows["errors"] = data.errors[demo, :length]
    return rows


def _pictures(data: Dataset, demo: int) -> dict[str, np.ndarray]:
    """One demonstration's pictures, uint8 [T, H, W, 3] by video."""
    t = np.arange(data.lengths[demo])
    views, at = range(len(data.windows[demo])), data.pictures.layout.at
    rows = [at(np.array(demo), t, np.array(v)) for v in views]
    return {f"observation.images.view_{v}": data.pictures.rgb[r] for v, r in enumerate(rows)}


def main(config: LerobotConfig, console: Console) -> None:
    """Runs the command."""
    out = export_dataset(config, console)
    console.print(f"{out}: a LeRobot {VERSION} dataset. Read it with:")
    read = f"LeRobotDataset({out.name!r}, root={str(out)!r})"
    console.print(f"  {read}", soft_wrap=True, highlight=False)
