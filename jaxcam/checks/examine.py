"""`python -m jaxcam.check DATASET|RUN|--env`: the doctor of datasets, runs and machines.

It looks and changes nothing. Its findings are shown in a table and on a page beside what was
checked; the exit code is 1 if something must be mended.
"""

import os
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

from rich.console import Console

from jaxcam.checks.dataset import check_content, check_file, check_physics
from jaxcam.checks.findings import bad, note, show, worst
from jaxcam.checks.machine import check_env
from jaxcam.checks.numbers import statistics
from jaxcam.checks.page import Report, draw_figures, write_page
from jaxcam.checks.pictures import check_caches, draw_overlays
from jaxcam.checks.recorded.report import check_recorded
from jaxcam.checks.run import check_run
from jaxcam.config.commands import CheckConfig
from jaxcam.errors import CameraError, ConfigError, DatasetError, SimError
from jaxcam.files.paths import absolute
from jaxcam.files.whole import check_free
from jaxcam.interop.formats import read as read_any
from jaxcam.interop.formats import recognise
from jaxcam.interop.recordings import is_recording, read_recording


def check_dataset(path: Path, count: int, console: Console | None = None) -> Report:
    """Examines a dataset of ours.

    Args:
        path: Of the file.
        count: Demonstrations that are replayed, drawn and compared with cached pictures.
        console: For progress; silent when None.
    """
    demos, findings = check_file(path)
    if demos is None:
        return Report(path.name, "It cannot be used.", findings)
    task, scene = demos.task, demos.world
    findings += check_content(demos, scene)
    wrong = {finding.what for finding in findings if finding.mark == "bad"}
    overlays = None
    if count and "states" not in wrong:
        try:
            task.require()
            findings += check_physics(demos, task, scene, count, console)
            if "camera poses" not in wrong:
                findings += check_caches(demos, task, scene, count)
                overlays = draw_overlays(demos, task, scene, count)
        except SimError as error:
            findings.append(note("replay and pictures", got="not looked at", fix=str(error)))
    return Report(
        title=f"{task.name}, {scene.name}",
        subtitle=path.name,
        findings=findings,
        numbers=statistics(demos),
        figures=draw_figures(demos, task),
        overlays=overlays,
    )


def check_foreign(path: Path, count: int, console: Console | None = None) -> Report:
    """Examines a file of another project as it would be imported; the import is not kept.

    Args:
        path: Of the file.
        count: See `check_dataset`.
        console: For progress; silent when None.
    """
    with TemporaryDirectory() as folder:
        try:
            demos = read_any(path, Path(folder) / "imported.hdf5", console)
        except DatasetError as error:
            finding = bad("file", got=str(error))
            return Report(path.name, "It cannot be imported.", [finding])
        report = check_dataset(demos.path, count, console)
    about = demos.header.versions["imported"]
    return replace(report, subtitle=f"{about}, as jaxcam imports it")


def check_folder(
    path: Path,
    count: int,
    console: Console | None,
    cameras: Path | None,
    grip: str,
    robot: str = "",
) -> Report:
    """Examines a folder, of a run or of a recorded dataset; see `examine`.

    Raises:
        ConfigError: It is neither, or the settings do not go with it.
    """
    if (path / "config.json").is_file():
        return Report(path.name, "Run folder.", list(check_run(path, console)))
    if not is_recording(path):
        raise ConfigError(
            f"{path}: not a run folder, since it has no config.json, and no recorded dataset: it "
            "has neither meta/info.json (LeRobot) nor trajectory.h5 (DROID). Datasets of "
            "demonstrations that were simulated are files."
        )
    try:
        recording = read_recording(path, cameras)
    except (DatasetError, CameraError) as error:
        finding = bad("dataset", got=str(error), fix="See docs/recorded.md.")
        return Report(path.name, "It cannot be used.", [finding])
    return check_recorded(recording, grip, count, console, robot)


def examine(
    path: Path,
    count: int,
    console: Console | None = None,
    *,
    cameras: Path | None = None,
    grip: str = "",
    robot: str = "",
) -> Report:
    """Examines what a path leads to.

    Args:
        path: Of a dataset or of a run's folder.
        count: See `check_dataset`.
        console: For progress; silent when None.
        cameras: JSON file of a recorded dataset's calibrations.
        grip: Where a recorded dataset's state has the grip's position.
        robot: Arm of a recorded dataset, see `check_recorded`.

    Raises:
        ConfigError: It leads to a folder that is neither a run's nor a recorded dataset's.
        DatasetError: It leads to nothing.
    """
    if not os.path.lexists(path):
        raise DatasetError(f"{path}: there is neither a dataset nor a run.")
    if path.is_dir():
        return check_folder(path, count, console, cameras, grip, robot)
    if recognise(path) in ("robomimic", "maniskill"):
        return check_foreign(path, count, console)
    return check_dataset(path, count, console)


def _page(config: CheckConfig) -> Path:
    target = absolute(config.target)
    if config.out:
        return absolute(config.out)
    if not target.is_dir():
        return target.with_suffix(".check.html")
    if (target / "config.json").is_file():
        return target / "check.html"
    return target.with_name(f"{target.name}.check.html")  # nothing is written into a recording


def main(config: CheckConfig, console: Console) -> int:
    """Runs the command; its exit code."""
    if config.env:
        with console.status("looking"):
            findings = list(check_env())
        show(findings, console)
        console.print("The first four are all that the MuJoCo tasks need.")
    else:
        page = _page(config)
        if page.suffix == ".png":
            raise ConfigError(f"{page}: a page is no picture. Choose an --out that ends in .html.")
        check_free(page, (absolute(config.target),), writable=False)
        if not page.exists() and (overlays := page.with_suffix(".png")).exists():
            raise ConfigError(
                f"{overlays} is there, where the page's pictures go. Choose another --out."
            )
        report = examine(
            absolute(config.target),
            config.episodes,
            console,
            cameras=absolute(config.cameras) if config.cameras else None,
            grip=config.grip,
            robot=config.robot,
        )
        findings = report.findings
        show(findings, console)
        try:
            console.print(f"Page: {write_page(report, page)}", soft_wrap=True)
        except OSError as error:
            console.print(f"The page cannot be written ({error}): choose another --out.")
    return int(worst(findings) == "bad")
