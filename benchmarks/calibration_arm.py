"""How exact `jaxcam.calibrate arm` and `drift` are, on films of Lift whose truth is known.

Called by `benchmarks/calibration.py`. Lift demonstrations in randomised scenes, where table and
floor lie elsewhere in each episode, are drawn at 256x256 from one of the authors' test cameras,
blurred over half the time between pictures, with noise, and with all seven joint angles off by
up to half a degree, the same in all episodes. Films are kept in a folder: drawing takes longer
than finding the camera.
"""

import time
from pathlib import Path

import numpy as np
from rich.console import Console
from scipy.spatial.transform import Rotation

from jaxcam.config.calibrate_arm import ArmConfig, DriftConfig
from jaxcam.config.datasets import CollectConfig
from jaxcam.data.collection import collect
from jaxcam.data.demos import Demo
from jaxcam.errors import DatasetError
from jaxcam.rays import invert, sample_poses
from jaxcam.rays.intrinsics import intrinsics
from jaxcam.robot.calibration.arm.film import Film
from jaxcam.robot.calibration.arm.fit import fit_arm
from jaxcam.robot.calibration.arm.model import load_arm
from jaxcam.robot.calibration.drift.change import ask, judged_changes, with_common_joints
from jaxcam.robot.calibration.projection import apart, moved
from jaxcam.sim import make_painter, make_task
from jaxcam.sim.controllers import CONTROL_HZ
from jaxcam.sim.types import View

SIDE, EPISODES, BLUR = 256, 8, 3
ARM_PICTURES, DRIFT_PICTURES = ArmConfig.most, DriftConfig.most
"""Of each episode, as the commands take them."""
DEMOS, SEED = 40, 7
OFF = np.deg2rad(0.5)
NOISE = 2.0
OPEN = 0.08


def film_of(camera: int, pictures: int, folder: Path) -> tuple[Film, np.ndarray, np.ndarray]:
    """Eight episodes from one of the authors' test cameras, where it stands, and joints' faults."""
    path = folder / f"cam{camera}-{pictures}.npz"
    if not path.exists():
        draw_film(camera, pictures, path)
    with np.load(path) as file:
        values = dict(file)
    angles, speeds = values["q"], np.zeros_like(values["q"])
    for episode in np.unique(values["episode"]):
        rows = np.flatnonzero(values["episode"] == episode)
        times = values["steps"][rows] / CONTROL_HZ
        speeds[rows] = np.gradient(angles[rows], times, axis=0)
    opening = abs(values["grip"]).sum(1) / OPEN
    film = Film(values["K"], values["rgb"], angles, speeds, opening, values["episode"],
                values["steps"])  # fmt: skip
    return film, values["pose"], values["off"]


def draw_film(camera: int, pictures: int, path: Path) -> None:
    """Draws and keeps a film of so many pictures an episode."""
    task = make_task("lift")
    scene = task.scene("randomized")
    config = CollectConfig(demos=DEMOS, validation=0, n=1, m=0, seed=SEED,
                           data_dir=str(path.parent / "data"))  # fmt: skip
    demos = collect(config, Console())
    world_from_camera = sample_poses(task.cameras, 100, 23)[camera]
    painter = make_painter(scene, SIDE, SIDE, varied=task.varied)
    K, rng = intrinsics(task.fovy_deg, SIDE, SIDE), np.random.default_rng(camera)
    off = rng.uniform(-1, 1, 7) * OFF
    kept: dict[str, list[np.ndarray]] = {name: [] for name in ("rgb", "q", "grip", "steps")}
    for number in rng.choice(DEMOS, EPISODES, replace=False):
        demo = demos.episodes[number]
        steps = np.unique(np.linspace(0, demo.length - 1, pictures).round().astype(int))
        qpos = np.concatenate([blurred(demo, step) for step in steps])
        count = len(qpos)
        rgb = painter.rgb(View(
            qpos,
            np.broadcast_to(demo.geom_size, (count, *demo.geom_size.shape)),
            np.broadcast_to(demo.fixtures, (count, *demo.fixtures.shape)),
            np.broadcast_to(K, (count, 3, 3)),
            np.broadcast_to(world_from_camera, (count, 4, 4)),
        ))  # fmt: skip
        rgb = rgb.reshape(len(steps), BLUR, SIDE, SIDE, 3).astype(float).mean(1)
        rgb = np.clip(rgb + rng.normal(0, NOISE, rgb.shape), 0, 255).round().astype(np.uint8)
        kept["rgb"].append(rgb)
        kept["q"].append(demo.qpos[steps][:, scene.arm] + off)
        kept["grip"].append(demo.qpos[steps][:, scene.fingers])
        kept["steps"].append(steps)
    episode = np.repeat(np.arange(EPISODES), [len(steps) for steps in kept["steps"]])
    arrays = {name: np.concatenate(parts) for name, parts in kept.items()}
    pose = invert(scene.world_from_base) @ world_from_camera
    np.savez(path, rgb=arrays["rgb"], q=arrays["q"], grip=arrays["grip"], steps=arrays["steps"],
             episode=episode, pose=pose, K=K, off=off)  # fmt: skip


def blurred(demo: Demo, step: int) -> np.ndarray:
    """Positions through half a step's time around a step, [BLUR, nq]."""
    rows = []
    for share in np.linspace(-0.25, 0.25, BLUR):
        other = np.clip(step + (1 if share > 0 else -1), 0, demo.length)
        rows.append((1 - abs(share)) * demo.qpos[step] + abs(share) * demo.qpos[other])
    return np.stack(rows)


def arm(cameras: range, folder: Path) -> tuple[tuple[str, ...], np.ndarray]:
    """Errors of `calibrate arm` for some cameras: names of the columns, and a row for each."""
    robot, rows, errors = load_arm("panda"), [], []
    for camera in cameras:
        film, pose, off = film_of(camera, ARM_PICTURES, folder)
        began = time.process_time()
        try:
            fit = fit_arm(robot, film)
        except DatasetError as error:
            print(f"camera {camera}: {error}", flush=True)
            rows.append([*[np.inf] * 4, *[np.nan] * 4])
            continue
        took = time.process_time() - began
        place, turn = apart(pose, fit.base_from_camera)
        # Where the camera stands for a robot that believes its first joint.
        believed = np.eye(4)
        believed[:3, :3] = Rotation.from_rotvec([0, 0, off[0]]).as_matrix()
        place2, turn2 = apart(believed @ pose, fit.base_from_camera)
        said = fit.refined.spread
        row = [1000 * float(place), np.rad2deg(float(turn)), 1000 * float(place2),
               np.rad2deg(float(turn2)), 1000 * said[0], np.rad2deg(said[1]), fit.support,
               took]  # fmt: skip
        rows.append(row)
        errors.append(np.linalg.inv(pose) @ fit.base_from_camera)
        print(f"camera {camera}: {row[0]:.1f} mm {row[1]:.2f} degrees; but for joint 1 "
              f"{row[2]:.1f} mm {row[3]:.2f} degrees; as said {row[4]:.1f} mm {row[5]:.2f} "
              f"degrees; {took:.0f} s", flush=True)  # fmt: skip
    np.save(folder / f"errors-{cameras.start}.npy", np.array(errors))
    result = np.array(rows)
    for mm, degrees in ((10, 0.5), (20, 1.0)):
        for words, part in (("", result[:, :2]), (" but for joint 1", result[:, 2:4])):
            share = ((part[:, 0] <= mm) & (part[:, 1] <= degrees)).mean()
            print(f"within {mm} mm and {degrees} degrees{words}: {share:.0%} of {len(result)}")
    names = ("position (mm)", "rotation (degrees)", "position but for joint 1 (mm)",
             "rotation but for joint 1 (degrees)", "deviation as said (mm)",
             "deviation as said (degrees)", "share of contour on edges", "CPU seconds")  # fmt: skip
    return names, result


def drift(cameras: range, folder: Path) -> None:
    """False alarms of episodes in which nothing moved, and moves of 1 degree or 1 cm that are seen.

    In each trial the camera is said to be elsewhere than it was in the last three of eight
    episodes, by a turn or a shift in a direction drawn at random.
    """
    robot = load_arm("panda")
    alarms, quiet, hits_of, silent = 0, 0, {"turn": [], "shift": []}, 0
    for camera in cameras:
        film, pose, _ = film_of(camera, DRIFT_PICTURES, folder)
        films = [film.some(film.episodes == e) for e in np.unique(film.episodes)]
        rng = np.random.default_rng(camera)
        first = [ask(robot, one, pose) for one in films]
        answers = judged_changes(with_common_joints(robot, films, first))
        silent += len(films) - len(answers)
        alarms, quiet = alarms + sum(t.moved for t in answers), quiet + len(answers)
        for kind in hits_of:
            way = rng.normal(size=3)
            way /= np.linalg.norm(way)
            change = np.r_[0.01 * way, np.zeros(3)] if kind == "shift" else np.r_[
                np.zeros(3), np.deg2rad(1) * way]  # fmt: skip
            given = [pose] * 5 + [moved(pose, change)] * (len(films) - 5)
            asked = [*first[:5], *(ask(robot, one, g) for one, g in
                                   zip(films[5:], given[5:], strict=True))]  # fmt: skip
            late = [
                t
                for t in judged_changes(with_common_joints(robot, films, asked))
                if t.asked.episode >= 5
            ]
            hits_of[kind] += [t.moved for t in late] + [False] * (len(films) - 5 - len(late))
        said = {kind: f"{sum(hits)} of {len(hits)}" for kind, hits in hits_of.items()}
        print(f"to camera {camera}: alarms {alarms} of {quiet} episodes, silent {silent}; found "
              f"{said}", flush=True)  # fmt: skip
    for kind, hits in hits_of.items():
        print(f"{kind} found in {np.mean(hits):.0%} of {len(hits)} episodes")
    print(f"false alarms in {alarms / max(quiet, 1):.1%} of {quiet} episodes")
