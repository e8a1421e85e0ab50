"""One precision per process: TAICHI_SIM_PRECISION is f32 or f64 (left out: f64). Everything in a process shares its Taichi."""

import os

import pytest

PRECISION = os.environ.get("TAICHI_SIM_PRECISION", "f64")
if PRECISION not in ("f32", "f64"):
    raise pytest.UsageError(f"TAICHI_SIM_PRECISION: {PRECISION!r} is not allowed; it must be f32 or f64")


@pytest.fixture(scope="session", autouse=True)
def _taichi():
    """Taichi on the CPU in this process's precision."""
    from taichi_sim import backend

    backend.start(arch="cpu", precision=PRECISION)


@pytest.fixture(scope="session")
def precision():
    """f32 or f64: what this process runs."""
    return PRECISION
