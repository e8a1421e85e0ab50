"""One precision per process: TAICHI_SIM_PRECISION is f32 or f64 (left out: f64). Everything in a process shares its Taichi."""

import os

import pytest

PRECISION = os.environ.get("TAICHI_SIM_PRECISION", "f64")
if PRECISION not in ("f32", "f64"):
    raise pytest.UsageError(f"TAICHI_SIM_PRECISION: {PRECISION!r} is not allowed; it must be f32 or f64")


# What knows nothing of precision: where both are run one after the other, once is enough, in single precision.
ONCE = (
    "bench",
    "cli",
    "demos",
    "files",
    "mesh",
    "outputs",
    "readme",
    "render",
    "report",
    "rooms",
    "scene",
    "scene_file",
    "shapes",
    "tune",
    "waves",
)
ONCE_FILES = {f"test_{name}.py" for name in ONCE}
# Long ones that tell most in double precision, or the same in both: in single precision `make test-slow` runs them.
LONG = (
    "contact_energy",
    "hard_cases",
    "order",
    "physics_article",
    "physics_brute_force",
    "physics_colliders",
    "physics_contacts",
    "physics_drivers",
    "physics_neighbours",
    "physics_swept",
    "tolerance",
    "validation_contacts",
)
LONG_FILES = {f"test_{name}.py" for name in LONG}
# And long ones for which single precision is enough: in double precision `make test-slow` runs them.
LONG_ONCE = (
    "contact_report",
    "groups",
    "physics_arguments",
    "physics_piles",
    "physics_simulation",
    "state_file",
    "watch",
)
LONG_ONCE_FILES = {f"test_{name}.py" for name in LONG_ONCE}


@pytest.hookimpl(tryfirst=True)  # before -m selects
def pytest_collection_modifyitems(config, items):
    for item in items:
        if item.path.name in (LONG_FILES if PRECISION == "f32" else LONG_ONCE_FILES):
            item.add_marker(pytest.mark.slow)
    if os.environ.get("TAICHI_SIM_PRECISION") == "f64":
        again = [item for item in items if item.path.name in ONCE_FILES]
        config.hook.pytest_deselected(items=again)
        items[:] = [item for item in items if item.path.name not in ONCE_FILES]


@pytest.fixture(scope="session", autouse=True)
def _taichi():
    """Taichi on the CPU in this process's precision."""
    from taichi_sim import backend

    backend.start(arch="cpu", precision=PRECISION)


@pytest.fixture(scope="session")
def precision():
    """f32 or f64: what this process runs."""
    return PRECISION
