"""`jaxcam.rays` stands alone."""

import subprocess
import sys

HEAVY = "flax optax orbax mujoco warp cv2 robosuite torch sapien h5py scipy matplotlib rich"


def run(code):
    return subprocess.run(
        [sys.executable, "-W", "error", "-c", code], capture_output=True, text=True, check=False
    )


def test_rays_load_only_jax_and_numpy():
    done = run(
        "import sys, jaxcam.rays as r\n"
        "r.plucker([[9, 0, 4], [0, 9, 4], [0, 0, 1]], __import__('numpy').eye(4), 8, 8)\n"
        f"print(sorted(set('{HEAVY}'.split()) & set(sys.modules)))"
    )
    assert done.stdout.strip() == "[]", done.stdout + done.stderr


def test_the_package_itself_loads_nothing():
    done = run("import sys, jaxcam; print(jaxcam.__version__, 'jax' in sys.modules)")
    assert done.stdout.split()[1] == "False", done.stderr
