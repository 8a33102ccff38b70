"""Milliseconds a picture of the batched renderers on Lift, against `mujoco.Renderer`.

    python benchmarks/render.py [--size 84] [--views 64] [--json]

    python benchmarks/render.py --no-opengl        # the two ray tracers alone

All draw the same visual model from the same camera poses with one sample a pixel, with shadows and
without, and the mean difference of their pictures is printed to show it. The ray tracers are ours
for the CPU, on one core here, and MJX's, which draws on CUDA and drew on CPUs up to version 0.1.0;
what they take is processor time, of `mujoco.Renderer` too. `mujoco.Renderer` makes
its shadows from a map of 4096 x 4096 texels, MuJoCo's default, whatever the picture's size. It
needs OpenGL without a display: EGL (Debian: libegl1 and libegl-mesa0), or OSMesa (libosmesa6) with
MUJOCO_GL=osmesa. Everything is measured in turn, round by round; the medians over the rounds
count, and ratios are taken within a round.
"""

import argparse
import copy
import json
import os
import time
from collections.abc import Callable
from typing import Any

os.environ.setdefault("MUJOCO_GL", "egl")  # mujoco reads it when it is imported

import mujoco
import numpy as np

from jaxcam.rays import sample_poses, to_mujoco
from jaxcam.rays.intrinsics import intrinsics
from jaxcam.sim import make_task
from jaxcam.sim.mujoco.render import Renderer
from jaxcam.sim.mujoco.scene import Scene, build_scene
from jaxcam.sim.mujoco.tracer.painter import CpuRenderer
from jaxcam.sim.task import Task, starts
from jaxcam.sim.types import View

GL_HELP = """mujoco.Renderer could not start ({error}).
On Debian or Ubuntu: apt install libegl1 libegl-mesa0; or: apt install libosmesa6, and
MUJOCO_GL=osmesa before the command."""


def make_view(task: Task, scene: Scene, size: int, count: int) -> View:
    """As many starts as cameras, the test cameras."""
    start = starts(task, scene, range(count))
    return View(
        qpos=start.qpos,
        geom_size=start.geom_size,
        fixtures=start.fixtures,
        K=np.tile(intrinsics(task.fovy_deg, size), (count, 1, 1)),
        world_from_camera=sample_poses(task.cameras, count, 23),
    )


class OpenGL:
    """`mujoco.Renderer` on the same views, one at a time."""

    def __init__(self, scene: Scene, varied: tuple[str, ...], size: int) -> None:
        model = copy.copy(scene.visual)
        model.cam_sensorsize[:] = model.cam_resolution[:] = size  # K is in pixels
        model.vis.quality.offsamples = 0
        self._model, self._data = model, mujoco.MjData(model)
        self._fixtures = scene.fixtures
        self._varied = [model.geom(f"{name}_vis").id for name in varied]
        self._renderer = mujoco.Renderer(model, size, size)

    def rgb(self, view: View, *, shadows: bool) -> np.ndarray:
        """Pictures, uint8 [B, H, W, 3]."""
        model, data, pictures = self._model, self._data, []
        eye, axes = (np.asarray(x) for x in to_mujoco(view.world_from_camera))
        for i in range(len(view.qpos)):
            data.qpos[:] = view.qpos[i]
            data.mocap_pos[self._fixtures] = view.fixtures[i, :, :3]
            data.mocap_quat[self._fixtures] = view.fixtures[i, :, 3:]
            model.geom_size[self._varied] = view.geom_size[i]
            model.cam_intrinsic[0, :2] = view.K[i, 0, 0], view.K[i, 1, 1]
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            mujoco.mj_camlight(model, data)
            data.cam_xpos[0], data.cam_xmat[0] = eye[i], axes[i].reshape(9)
            self._renderer.update_scene(data, camera=0)
            self._renderer.scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = shadows
            pictures.append(self._renderer.render())
        return np.stack(pictures)


def main() -> None:
    parser = argparse.ArgumentParser(description="Speed of the batched renderer on Lift.")
    parser.add_argument("--scene", default="randomized", choices=("fixed", "randomized"))
    parser.add_argument("--size", type=int, default=84, help="image side (pixels)")
    parser.add_argument("--views", type=int, default=64, help="pictures a round")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--no-opengl", action="store_true", help="leave mujoco.Renderer out")
    parser.add_argument("--json", action="store_true", help="print one JSON object as well")
    args = parser.parse_args()

    task = make_task("lift")
    scene = build_scene(task.objects(), args.scene)
    view = make_view(task, scene, args.size, args.views)
    programs: dict[str, Callable[[], np.ndarray]] = {}
    for shadows, suffix in ((True, ""), (False, ", no shadows")):
        for name, kind in (("jaxcam", CpuRenderer), ("MJX's ray tracer", Renderer)):
            ours = kind(scene, args.size, varied=task.varied, shadows=shadows)
            programs[f"{name}{suffix}"] = lambda ours=ours: ours.rgb(view)
    if not args.no_opengl:
        add_opengl(programs, scene, task, view, args.size)
    measure(programs, args)


def add_opengl(
    programs: dict[str, Callable[[], np.ndarray]], scene: Scene, task: Task, view: View, size: int
) -> None:
    """Adds `mujoco.Renderer`, where it starts."""
    try:
        opengl = OpenGL(scene, task.varied, size)
    except Exception as error:  # whichever library is missing, each says so in its own way
        print(GL_HELP.format(error=error))
    else:
        programs["mujoco.Renderer"] = lambda: opengl.rgb(view, shadows=True)
        programs["mujoco.Renderer, no shadows"] = lambda: opengl.rgb(view, shadows=False)


def measure(programs: dict[str, Callable[[], np.ndarray]], args: argparse.Namespace) -> None:
    """Times all programs in turn and prints the table and, if asked, the JSON."""
    pictures = {name: run() for name, run in programs.items()}  # compiles too
    times: dict[str, list[float]] = {name: [] for name in programs}
    for _ in range(args.rounds):
        for name, run in programs.items():
            began = time.process_time()
            run()
            times[name].append(1e3 * (time.process_time() - began) / args.views)
    one = np.array(next(iter(times.values())))
    ratios = {name: float(np.median(np.array(t) / one)) for name, t in times.items()}
    cores, load = os.cpu_count(), os.getloadavg()[0]
    print(f"Lift, {args.scene} scene, {args.size} x {args.size}, {cores} cores, load {load:.1f}:")
    print(f"  {'':28} {'ms a picture':>12} {'of the first':>14}")
    for name, values in times.items():
        print(f"  {name:28} {np.median(values):12.2f} {ratios[name]:14.2f}")
    measured: dict[str, Any] = {
        "what": f"processor's milliseconds a picture of Lift at {args.size} px, medians",
        "scene": args.scene,
        "ms": {name: float(np.median(t)) for name, t in times.items()},
        "times_of_the_first": ratios,
    }
    first = pictures["jaxcam"].astype(float)
    measured["mean_difference_of_255"] = {
        name: float(abs(first - pictures[name]).mean())
        for name in ("MJX's ray tracer", "mujoco.Renderer")
        if name in pictures
    }
    for name, difference in measured["mean_difference_of_255"].items():
        print(f"  pictures of {name} differ by {difference:.4f} of 255 on average")
    if args.json:
        print(json.dumps(measured))


if __name__ == "__main__":
    main()
