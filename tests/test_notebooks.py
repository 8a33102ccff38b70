"""The notebooks of examples/, each from its first cell to its last at a toy's size."""

import os
import sys

import nbformat
import pytest
from nbclient import NotebookClient
from places import REPO

FOLDER = REPO / "examples"
TOYS = {
    "rays": "SIDE = 24",
    "train": """
MORE = {{"dataset": {demos!r}, "resolution": 24, "m": 1, "n": 3}}
DEMOS, VALIDATION, STEPS, BATCH, PAIRS = 4, 2, 4, 4, 1
DATA, RUN = {data!r}, "run"
""",
    "recorded": """
MAKE = ["--quick"]
SCRIPT = {script!r}
STEPS, BATCH, RESOLUTION = 4, 2, "24"
""",
    "foreign": "PAIRS, WIDTH, VIDEOS = 1, 1, 1",
}
"""Settings in the place of those of a notebook's cell `parameters`."""


def test_these_are_the_notebooks():
    assert {path.stem for path in FOLDER.glob("*.ipynb")} == set(TOYS)


@pytest.mark.parametrize("name", TOYS)
def test_a_notebook_runs(name, tmp_path, request):
    book = nbformat.read(FOLDER / f"{name}.ipynb", as_version=4)
    assert not [cell for cell in book.cells if cell.get("outputs") or cell.get("execution_count")]
    demos = request.getfixturevalue("demos").path if name == "train" else ""
    toy = TOYS[name].format(
        demos=str(demos), data=str(demos and demos.parent),
        script=str(FOLDER / "recorded/make_dataset.py"),
    )  # fmt: skip
    (at,) = (i for i, c in enumerate(book.cells) if "parameters" in c.metadata.get("tags", ()))
    book.cells.insert(at + 1, nbformat.v4.new_code_cell(toy))
    paths = os.pathsep.join([str(REPO), *sys.path])
    client = NotebookClient(
        book,
        timeout=600,
        kernel_name="python3",
        resources={"metadata": {"path": str(tmp_path)}},
    )
    client.execute(env={**os.environ, "PYTHONPATH": paths, "MPLBACKEND": ""})
    shown = [o for cell in book.cells for o in cell.get("outputs", ())]
    assert [o for o in shown if "image/png" in o.get("data", {})]
    assert not [o for o in shown if o.output_type == "error"]
