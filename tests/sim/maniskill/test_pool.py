"""Child processes that die or hang."""

import logging
import os
import signal

import pytest

from jaxcam.errors import SimError
from jaxcam.sim.maniskill import pool as pool_module
from jaxcam.sim.maniskill.pool import Child


def test_a_child_that_dies_is_replaced_once_and_its_last_words_are_told(world, caplog, monkeypatch):
    child = Child(world)
    child.ask("hello")
    about = child.answer()
    child.ask("juggle")
    with pytest.raises(SimError, match="no attribute 'juggle'"):
        child.answer()
    os.kill(child.pid, signal.SIGABRT)
    with caplog.at_level(logging.WARNING):
        child.ask("hello")
        assert child.answer() == about
    assert "started anew" in caplog.text
    assert "Fatal Python error: Aborted" in caplog.text
    os.kill(child.pid, signal.SIGSTOP)
    monkeypatch.setattr(pool_module, "STALL", 1.0)
    child.ask("load", [0])
    with pytest.raises(SimError, match=r"(?s)has hung: no sign of work for 1 s.*last words"):
        child.answer()
    child.close()
