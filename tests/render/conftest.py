"""Pictures need an engine, which other tests of a process may have stopped."""

import pytest

from taichi_sim.device import backend


@pytest.fixture(scope="module", autouse=True)
def _backend():
    if backend.running() is None:
        backend.start(arch="cpu")
