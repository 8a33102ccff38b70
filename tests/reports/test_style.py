"""Figures leave matplotlib as they found it."""

import subprocess
import sys


def test_figures_need_no_pyplot_and_change_no_settings():
    code = (
        "import sys, matplotlib as mpl; before = mpl.rcParams.copy()\n"
        "from jaxcam.reports import run_figures as plots\n"
        "plots.loss_curves([{'step': 1, 'loss': 1.0}])\n"
        "assert 'matplotlib.pyplot' not in sys.modules\n"
        "assert mpl.rcParams.copy() == before\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, check=False)
    assert (done.returncode, done.stderr) == (0, b"")
