"""How Warp is started."""

import errno

import pytest
import warp

from jaxcam.errors import MachineError
from jaxcam.sim.mujoco.machine import start_warp


def test_a_cache_of_kernels_that_cannot_be_written_is_told(monkeypatch):
    def refuse():
        raise PermissionError(errno.EACCES, "Permission denied", "/x/warp")

    monkeypatch.setattr(warp, "init", refuse)
    start_warp.cache_clear()
    with pytest.raises(MachineError, match=r"/x/warp: Permission denied.*set WARP_CACHE_PATH"):
        start_warp()
