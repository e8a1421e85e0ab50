"""Taichi's start in a process's one precision, and the rule for markers (pyproject.toml says what each means)."""

import os

import pytest
from physics_support import PRECISION


def _is_slow(item):
    params = getattr(item, "callspec", None)
    for mark in item.iter_markers("slow_where"):
        found = {name: params.params[name] for name in mark.kwargs}  # a name that the test does not take is a mistake
        if all(
            found[name] == one or (isinstance(one, tuple) and found[name] in one) for name, one in mark.kwargs.items()
        ):
            return True
    return any(PRECISION in mark.args for mark in item.iter_markers("slow_in"))


@pytest.hookimpl(tryfirst=True)  # before -m selects
def pytest_collection_modifyitems(config, items):
    for item in items:
        if _is_slow(item):
            item.add_marker(pytest.mark.slow)
    if os.environ.get("TAICHI_SIM_PRECISION") == "f64":  # asked for: single precision has its own run
        again = [item for item in items if item.get_closest_marker("once")]
        config.hook.pytest_deselected(items=again)
        items[:] = [item for item in items if item not in again]


@pytest.fixture(scope="session", autouse=True)
def _taichi():
    """Taichi on the CPU in this process's precision."""
    from taichi_sim.device import backend

    backend.start(arch="cpu", precision=PRECISION)


@pytest.fixture(scope="session")
def precision():
    """f32 or f64: what this process runs."""
    return PRECISION
