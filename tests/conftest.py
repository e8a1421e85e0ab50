"""Taichi's start in a process's one precision, and the rule for markers (pyproject.toml says what each means)."""

import os
import sys

import pytest
from physics_support import PRECISION
from software_gpu import offer_software

from taichi_sim.device.engine import ENGINE, ti

if ENGINE != "taichi":  # tests import Taichi, as users do
    sys.modules["taichi"] = ti


def pytest_addoption(parser):
    parser.addoption(
        "--arch", default="cpu", choices=("cpu", "cuda", "vulkan", "metal"), help="the device of `gpu` tests"
    )


def pytest_configure(config):
    os.environ.pop("CI", None)  # with it pytest explains, for hours, how two files of megabytes differ
    if config.getoption("--arch") == "vulkan":
        offer_software(config)


def _is_where(item, name):
    """Whether its parameters are among those of a marker `slow_where` or `long_where`."""
    params = item.callspec.params if hasattr(item, "callspec") else {}
    for node, mark in item.iter_markers_with_node(name):
        unknown = [argument for argument in mark.kwargs if argument not in params]
        if unknown and node is item:
            raise pytest.UsageError(f"{item.nodeid}: {name} names {unknown[0]}, which the test does not take")
        if not unknown and all(
            params[argument] in value if isinstance(value, list) else params[argument] == value
            for argument, value in mark.kwargs.items()
        ):
            return True
    return False


@pytest.hookimpl(tryfirst=True)  # before -m selects
def pytest_collection_modifyitems(config, items):
    of_device = config.getoption("--arch") != "cpu"
    left_out = [item for item in items if bool(item.get_closest_marker("gpu")) != of_device]
    config.hook.pytest_deselected(items=left_out)
    items[:] = [item for item in items if item not in set(left_out)]
    for item in items:
        of_precision = not item.get_closest_marker("once")  # which single precision alone runs, whatever its file says
        long_here = of_precision and any(PRECISION in mark.args for mark in item.iter_markers("long_in"))
        if long_here or _is_where(item, "long_where"):
            item.add_marker(pytest.mark.long)
        if item.get_closest_marker("long") or _is_where(item, "slow_where"):
            item.add_marker(pytest.mark.slow)
        if item.get_closest_marker("long"):
            item.add_marker(pytest.mark.timeout(0))
        if PRECISION == "f64" and item.get_closest_marker("slow") and not item.get_closest_marker("long_in"):
            item.add_marker(pytest.mark.long)  # what takes so long is run in one precision but by `make test-long`
    if os.environ.get("TAICHI_SIM_PRECISION") == "f64" or (of_device and PRECISION == "f64"):  # f32 has its own run
        again = [item for item in items if item.get_closest_marker("once")]
        config.hook.pytest_deselected(items=again)
        items[:] = [item for item in items if item not in again]


@pytest.fixture(scope="session", autouse=True)
def _taichi(request):
    """Taichi in this process's precision, on the CPU or the device that gpu tests name."""
    from taichi_sim.device import backend

    backend.start(arch=request.config.getoption("--arch"), precision=PRECISION)


@pytest.fixture(scope="session")
def precision():
    """f32 or f64: what this process runs."""
    return PRECISION
