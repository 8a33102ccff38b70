"""`python -m jaxcam.check DATASET|RUN|--env`: the doctor of datasets, runs and machines.

It looks and changes nothing. What it finds is told in a table and on a page beside what was
checked; the exit code is 1 if something must be mended.
"""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import h5py
from rich.console import Console

from jaxcam.checks.dataset import check_content, check_physics, read
from jaxcam.checks.findings import Finding, show, worst
from jaxcam.checks.machine import check_env
from jaxcam.checks.numbers import statistics
from jaxcam.checks.page import Report, draw_figures, write_page
from jaxcam.checks.pictures import check_caches, draw_overlays
from jaxcam.checks.run import check_run
from jaxcam.config.commands import CheckConfig
from jaxcam.config.datasets import ManiskillConfig, RobomimicConfig
from jaxcam.data.demos import Demos
from jaxcam.errors import ConfigError, DatasetError, SimError
from jaxcam.interop.maniskill_files import is_trajectories


def check_dataset(path: Path, count: int, console: Console | None = None) -> Report:
    """Examines a dataset of ours.

    Args:
        path: of the file.
        count: demonstrations that are replayed, drawn and compared with cached pictures.
        console: for progress; silent when None.
    """
    demos, findings = read(path)
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
            findings.append(Finding("replay and pictures", "note", "not looked at", fix=str(error)))
    return Report(
        title=f"{task.name}, {scene.name}",
        subtitle=path.name,
        findings=findings,
        numbers=statistics(demos),
        figures=draw_figures(demos, task),
        overlays=overlays,
    )


def check_foreign(
    path: Path, count: int, console: Console | None, importer: Callable[[Path], Demos]
) -> Report:
    """Examines what becomes of somebody else's file when it is imported; nothing of that is kept.

    Args:
        path: of the file.
        count: see `check_dataset`.
        console: for progress; silent when None.
        importer: writes the file's demonstrations as a dataset of ours to a path.
    """
    with TemporaryDirectory() as folder:
        try:
            demos = importer(Path(folder) / "imported.hdf5")
        except DatasetError as error:
            finding = Finding("file", "bad", str(error))
            return Report(path.name, "It cannot be imported.", [finding])
        report = check_dataset(demos.path, count, console)
    about = demos.header.versions["imported"]
    return replace(report, subtitle=f"{about}, as jaxcam imports it")


def examine(path: Path, count: int, console: Console | None = None) -> Report:
    """Examines what a path leads to; see `check_dataset`, `check_foreign`, `check_run`."""
    if path.is_dir():
        if not (path / "config.json").is_file():
            raise ConfigError(
                f"{path}: not a run folder, since it has no config.json, and datasets are files."
            )
        return Report(path.name, "Run folder.", list(check_run(path, console)))
    if is_trajectories(path):
        from jaxcam.interop.maniskill import import_trajectories

        def trajectories(out: Path) -> Demos:
            return import_trajectories(ManiskillConfig(str(path), out=str(out)), console).demos

        return check_foreign(path, count, console, trajectories)
    if task := _robomimic_task(path):
        from jaxcam.interop.robomimic import import_demos

        def robomimic(out: Path) -> Demos:
            return import_demos(RobomimicConfig(str(path), task=task, out=str(out)), console)

        return check_foreign(path, count, console, robomimic)
    return check_dataset(path, count, console)


def _robomimic_task(path: Path) -> str:
    """Our task of a file in robomimic's layout; empty if it is another's."""
    from jaxcam.interop.robomimic import ENVIRONMENTS

    try:
        with h5py.File(path, "r") as file:
            attributes: Any = file["data"].attrs
            if "jaxcam" in attributes or "env_args" not in attributes:
                return ""
            name = json.loads(attributes["env_args"])["env_name"]
    except (OSError, RuntimeError, LookupError, TypeError, ValueError):
        return ""
    return ENVIRONMENTS.get(str(name), "lift")  # others are refused with the reason


def _page(config: CheckConfig) -> Path:
    target = Path(config.target)
    if config.out:
        return Path(config.out)
    return target / "check.html" if target.is_dir() else target.with_suffix(".check.html")


def main(config: CheckConfig, console: Console) -> int:
    """Runs the command; its exit code."""
    if config.env:
        with console.status("looking"):
            findings = list(check_env())
        show(findings, console)
        console.print("The first four are all that the MuJoCo tasks need.")
    else:
        report = examine(Path(config.target), config.episodes, console)
        findings = report.findings
        show(findings, console)
        try:
            console.print(f"Page: {write_page(report, _page(config))}", soft_wrap=True)
        except OSError as error:
            console.print(f"The page cannot be written ({error}): choose another --out.")
    return int(worst(findings) == "bad")
