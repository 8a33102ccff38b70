"""The code's own rules: names, sizes, and a file of tests for each module."""

import ast
import re
from collections import defaultdict
from pathlib import Path
from statistics import median

from places import REPO

TREES = {
    path.relative_to(REPO): ast.parse(path.read_text("utf-8"))
    for folder in ("jaxcam", "tests", "benchmarks", "examples")
    for path in sorted((REPO / folder).rglob("*.py"))
}
PACKAGE = {path: tree for path, tree in TREES.items() if path.parts[0] == "jaxcam"}
TESTS = {path: tree for path, tree in TREES.items() if path.parts[0] == "tests"}
FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef)

ELSEWHERE = {
    # Nothing but tables, records and promises.
    "config/presets": "config/test_names",
    "sim/observing": "sim/test_rollout",
    "sim/painter": "sim/test_simulators",
    "sim/types": "sim/test_engine",
    "sim/mujoco/table": "sim/test_tasks",
    "sim/maniskill/scene": "sim/maniskill/test_tasks",
    "sim/maniskill/task": "sim/maniskill/test_tasks",
    # What is one program, or one process, is tested as such.
    "sim/mujoco/mjx_physics": "sim/mujoco/test_mjx",
    "sim/mujoco/render_inputs": "sim/mujoco/test_render",
    "sim/mujoco/render_program": "sim/mujoco/test_render",
    "sim/mujoco/tracer/kernel": "sim/mujoco/tracer/test_painter",
    "sim/mujoco/tracer/seeing": "sim/mujoco/tracer/test_painter",
    "sim/mujoco/tracer/shading": "sim/mujoco/tracer/test_painter",
    "sim/maniskill/envs": "sim/maniskill/test_tasks",
    "sim/maniskill/memory": "sim/maniskill/test_worlds",
    "sim/maniskill/studio": "sim/maniskill/test_worlds",
    "sim/maniskill/worker": "sim/maniskill/test_worlds",
    "training/records": "training/test_loop",
    "training/side": "training/test_checkpoint",
    "training/side_by_side": "training/test_loop",
    # Each test is of all three tasks.
    "sim/tasks/lift_upright": "sim/maniskill/test_tasks",
    "sim/tasks/push": "sim/maniskill/test_tasks",
    "sim/tasks/roll_ball": "sim/maniskill/test_tasks",
    # One recording, one export and back, serve all tests of these.
    "interop/maniskill": "interop/test_maniskill_files",
    "interop/maniskill_actions": "interop/test_maniskill_files",
    "interop/lerobot/arrow": "interop/lerobot/test_dataset",
    "interop/lerobot/format": "interop/lerobot/test_dataset",
    "interop/lerobot/layout": "interop/lerobot/test_policy",
    "interop/lerobot/counterparts": "interop/lerobot/test_records",
    "interop/weights": "interop/lerobot/test_policy",
    "interop/cameras/optics": "interop/cameras/test_files",
    "interop/droid/annotations": "interop/droid/test_reading",
    "interop/droid/cameras": "interop/droid/test_reading",
    "interop/droid/videos": "interop/droid/test_reading",
    "interop/robosuite_witness": "interop/test_robosuite_commands",
    # One film, one good copy and its faults, serve all tests of these.
    "checks/recorded/bases": "checks/recorded/test_places",
    "checks/recorded/judged": "checks/recorded/test_places",
    "checks/recorded/looks": "checks/recorded/test_report",
    "checks/recorded/motion": "checks/recorded/test_places",
    "checks/recorded/overlays": "checks/recorded/test_report",
    "checks/page": "checks/test_examine",
    "robot/calibration/command": "robot/calibration/lens/test_form",
    "robot/calibration/figures": "robot/calibration/test_page",
    "robot/calibration/known": "robot/calibration/tags/test_form",
    "robot/calibration/pose_page": "robot/calibration/tags/test_form",
    "files/json": "interop/cameras/test_files",
    "data/recorded/recording": "data/recorded/test_parts",
    "pipeline/simulated": "pipeline/test_train",
    "pipeline/sources": "pipeline/test_recorded",
}
"""Modules without a file of tests of their own name, and where they are tested."""

SHARED = {
    "has_accelerator": "a simulator's answer, which `jaxcam.sim.simulators` asks for, and JAX's",
    "main": "runs a command",
    "scene_of": "makes a simulator's worlds, which `jaxcam.sim.simulators` asks for",
}
"""Public functions that several modules have, for one meaning."""


ENTRY = re.compile(r"""[*]{0,2}\w+: ([A-Z\d"`']|\W[A-Z]).*[.]""")
EMPTY_WORDS = {"every", "found", "frames", "seen", "told"}


def functions(trees):
    for path, tree in trees.items():
        for node in ast.walk(tree):
            if isinstance(node, FUNCTIONS):
                yield f"{path}:{node.lineno} {node.name}", node


def arguments(function):
    a = function.args
    return [x.arg for x in (*a.posonlyargs, *a.args, *a.kwonlyargs) if x.arg not in ("self", "cls")]


def test_each_module_has_tests_of_its_name():
    """`jaxcam/a/b.py` is tested by `tests/a/test_b.py`; a command's file is a line (test_main)."""
    commands = {path for path in PACKAGE if len(path.parts) == 2 and "COMMAND" in names_in(path)}
    missing = set()
    for path in PACKAGE.keys() - commands:
        module = Path(*path.parts[1:]).with_suffix("")
        if module.name != "__init__":
            own = module.with_name(f"test_{module.name.strip('_')}")
            if Path("tests", f"{own}.py") not in TESTS:
                missing.add(str(module))
    assert missing == set(ELSEWHERE)
    assert {Path("tests", f"{place}.py") for place in ELSEWHERE.values()} <= set(TESTS)


def names_in(path):
    targets = (node.targets for node in TREES[path].body if isinstance(node, ast.Assign))
    return {t.id for some in targets for t in some if isinstance(t, ast.Name)}


def test_each_test_asserts_something():
    """Itself, or by a function of the tests that does."""
    asserting = {"raises", "warns", "fail"}

    def asserts(node):
        for part in ast.walk(node):
            if isinstance(part, ast.Assert):
                return True
            if isinstance(part, ast.Call):
                name = ast.unparse(part.func).rpartition(".")[2]
                if name in asserting or name.startswith("assert_"):
                    return True
        return False

    helpers = [node for _, node in functions(TESTS) if not node.name.startswith("test_")]
    for _ in range(2):  # a helper may leave it to another one
        asserting |= {node.name for node in helpers if asserts(node)}
    silent = [
        where for where, node in functions(TESTS)
        if node.name.startswith("test_") and not asserts(node)
    ]  # fmt: skip
    assert silent == []


def test_files_and_functions_are_short():
    lines = {
        path: len((REPO / path).read_text("utf-8").splitlines())
        for path in TREES
    }  # fmt: skip
    assert {path: n for path, n in lines.items() if n > 400} == {}
    assert median(n for path, n in lines.items() if path in PACKAGE) <= 150
    long = [where for where, node in functions(TREES) if length(node) > 80]
    assert long == []
    wide = [where for where, node in functions(TREES) if len(arguments(node)) > 8]
    assert wide == []


def length(node):
    return node.end_lineno - node.lineno + 1


def test_a_folder_holds_fourteen_modules_at_most():
    folders = defaultdict(list)
    for path in PACKAGE:
        if path.name != "__init__.py" and len(path.parts) > 2:
            folders[path.parent].append(path.name)
    assert {folder: len(names) for folder, names in folders.items() if len(names) > 14} == {}


def test_variables_say_what_they_hold():
    """Not that it was found, told or seen; and a picture is no frame."""
    bound = []
    for path, tree in TREES.items():
        if path.parts[0] == "tests" and len(path.parts) == 2:
            continue  # of whole commands, in whose terms their rows and films are
        for node in ast.walk(tree):
            is_bound = isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)
            names = [node.id] if is_bound else [node.arg] if isinstance(node, ast.arg) else []
            bound += [f"{path}:{node.lineno} {name}" for name in names if name in EMPTY_WORDS]
    assert bound == []


def test_a_public_name_has_one_meaning():
    places = defaultdict(list)
    for path, tree in PACKAGE.items():
        for node in tree.body:
            is_alias = isinstance(node, ast.Assign) and re.fullmatch(
                "[A-Z][a-z]+[A-Za-z]*", getattr(node.targets[0], "id", "")
            )
            if isinstance(node, (*FUNCTIONS, ast.ClassDef)) or is_alias:
                name = node.targets[0].id if is_alias else node.name
                places[name].append(str(path))
    several = {name for name, some in places.items() if len(some) > 1 and name[0] != "_"}
    assert several == set(SHARED)


def test_arguments_are_described_in_one_form():
    """`name: What it is.`, and either all of them or none."""
    wrong = []
    for where, node in functions(PACKAGE):
        entries = args_of(ast.get_docstring(node) or "")
        named = {entry.partition(":")[0].lstrip("*") for entry in entries}
        given = {*arguments(node), *(x.arg for x in (node.args.vararg, node.args.kwarg) if x)}
        if entries and named != given:
            wrong.append(where)
        wrong += [f"{where}: {e}" for e in entries if not ENTRY.fullmatch(e)]
    assert wrong == []


def args_of(docstring):
    """The entries of `Args:`, each in one line."""
    section = re.search(r"^Args:\n((?:    .*\n?|\n)+)", docstring, re.MULTILINE)
    entries = []
    for line in section[1].splitlines() if section else ():
        if line.startswith("     ") and entries:
            entries[-1] += f" {line.strip()}"
        elif line.strip():
            entries.append(line.strip())
    return entries
