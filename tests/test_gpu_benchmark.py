"""The GPU's benchmark at a toy's size on a CPU: all of it runs, and what fails stops nothing."""

import json
import os
import subprocess
import sys

import pytest
from places import REPO

SCRIPT = REPO / "benchmarks" / "gpu.py"


def benchmark(out, *flags, **env):
    done = subprocess.run(
        [sys.executable, str(SCRIPT), "--sizes", "toy", "--out", str(out), *flags],
        capture_output=True, text=True, check=False,
        env=os.environ | {"JAX_PLATFORMS": "cpu"} | env,
    )  # fmt: skip
    assert out.exists(), done.stderr
    return done, json.loads(out.read_text())


@pytest.mark.slow  # it compiles all there is: rollouts in one program, updates of three policies
@pytest.mark.timeout(2400)
def test_every_section_measures_at_toy_sizes(tmp_path):
    done, result = benchmark(tmp_path / "gpu.json", "--peak", "0.5")
    sections = {section["name"]: section for section in result["sections"]}
    assert {name: s["problem"] for name, s in sections.items()} == dict.fromkeys(sections, "")
    assert done.returncode == 0
    assert list(sections) == ["rays", "physics", "pictures", "rollouts", "act", "diffusion",
                              "smolvla", "parity"]  # fmt: skip
    values = {row["what"]: row["value"] for s in sections.values() for row in s["rows"]}
    assert all(value >= 0 for value in values.values())
    assert len(sections["physics"]["rows"]) == 3
    # On one device both sides of a comparison are the same program.
    assert all(values[row] == 0 for row in values if row.startswith(("rays, ", "loss of ")))
    share, rate = (next(row for row in sections["act"]["rows"] if row["what"] == what)
                   for what in ("share of peak", "rate"))  # fmt: skip
    assert share["value"] == pytest.approx(100 * rate["value"] / 0.5)
    assert {"jax", "mujoco", "warp-lang"} <= result["machine"]["versions"].keys()
    assert all(what in done.stdout for what in values)


def test_a_section_that_fails_is_told_of_and_the_next_goes_on(tmp_path):
    """The first has an engine's cache where it may not write; the second needs none."""
    code = (
        "import sys; sys.argv = ['gpu.py', '--sizes', 'toy', '--sections', 'act', 'rays', "
        f"'--out', {str(tmp_path / 'gpu.json')!r}]; sys.path.insert(0, {str(SCRIPT.parent)!r}); "
        "import gpu; run = gpu.run_section; "
        "gpu.run_section = lambda name, words, s: "
        "run(name, [*words, '--no-such'] if name == 'act' else words, s); "
        "sys.exit(gpu.main())"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False,
        env=os.environ | {"JAX_PLATFORMS": "cpu"},
    )  # fmt: skip
    assert done.returncode == 1, done.stderr
    broken, whole = json.loads((tmp_path / "gpu.json").read_text())["sections"]
    assert "--no-such" in broken["problem"]
    assert (whole["name"], whole["problem"]) == ("rays", "")
    assert whole["rows"]


def test_a_section_that_hangs_is_ended_with_what_it_had(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(SCRIPT.parent))
    import gpu

    sleeper = tmp_path / "gpu_sections.py"
    sleeper.write_text(
        'import time\nprint(\'{"what": "a", "value": 1.5, "unit": "s"}\', flush=True)\n'
        "print('{\"what', end='', flush=True)\ntime.sleep(600)\n"
    )
    monkeypatch.setattr(gpu, "__file__", str(tmp_path / "gpu.py"))
    section = gpu.run_section("rays", [], 5)
    assert section.problem == "stopped after its 5 s"
    assert [row["value"] for row in section.rows] == [1.5]
    assert section.seconds < 60
    assert "stopped after its 5 s" in gpu.table([section])


def test_cards_are_known_by_their_names(monkeypatch):
    monkeypatch.syspath_prepend(str(SCRIPT.parent))
    import gpu

    peaks = {name: gpu.peak_of(name) for name in
             ("NVIDIA H200", "NVIDIA H100 PCIe", "NVIDIA H100 80GB HBM3", "NVIDIA L40S",
              "NVIDIA A100-SXM4-80GB", "NVIDIA A10G", "Tesla V100", "cpu")}  # fmt: skip
    assert [*peaks.values()] == [989, 756, 989, 362, 312, 70, None, None]
