"""What commands' processes ask the system for."""

import os
import platform
import subprocess
import sys

import pytest

FAULTS = """
import resource
from jaxcam.console.memory import keep_memory
keep_memory()
def work(rounds):
    for _ in range(rounds):
        b'x' * (2**25 + rounds)  # 8192 pages
work(2)
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
work(20)
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="glibc's allocator alone is told")
@pytest.mark.parametrize(("own", "faults"), [({}, (0, 8192)), ({"MALLOC_ARENA_MAX": "2"}, None)])
def test_memory_is_taken_once_unless_the_user_has_settings_of_his_own(own, faults):
    clean = {k: v for k, v in os.environ.items() if not k.startswith(("MALLOC_", "GLIBC_"))}
    done = subprocess.run(
        [sys.executable, "-c", FAULTS], env=clean | own, capture_output=True, text=True, check=True
    )
    low, high = faults or (20 * 8192, 10**9)
    assert low <= int(done.stdout) < high
