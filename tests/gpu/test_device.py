"""A device against the CPU, in the precision of TAICHI_SIM_PRECISION: the same scenes, a few steps, and what comes out of each.

The CPU's results are made by another process, since Taichi holds one device for each. Tolerances: positions within 2e-4 m after
balls have begun in each other; where nothing collides, 1e-5 m.
"""

import os
import subprocess
import sys
from pathlib import Path

import device_scenes
import numpy as np
import pytest

import taichi_sim as ts
from taichi_sim.device import backend
from taichi_sim.reports import verify
from taichi_sim.reports.self_test import faults

pytestmark = pytest.mark.gpu

OTHER_STARTS = 1.5  # times what the furthest of a few other starts comes to
FREE = {"many_springs", "with_a_tolerance", "implicit_euler", "tr_bdf2"}  # nothing touches


@pytest.fixture(scope="module")
def arch(request):
    return request.config.getoption("--arch")


def by_scene(names):
    """Parameters whose tests share a worker under `-n 6 --dist loadgroup`, so that each scene is run once."""
    return [pytest.param(name, marks=pytest.mark.xdist_group(name)) for name in names]


@pytest.fixture(scope="module")
def on_cpu(tmp_path_factory):
    """What the CPU finds: begun with the first test, waited for by the first that compares; by workers, scene by scene."""
    folder = tmp_path_factory.mktemp("cpu")
    command = [sys.executable, str(Path(device_scenes.__file__)), "cpu"]
    running, loaded = {}, {}

    def begin(*names):
        file = folder / f"{len(running)}.npz"
        running[file] = subprocess.Popen(
            [*command, file, *names], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        )
        return file

    def load(file):
        said, _ = running[file].communicate()
        assert running[file].returncode == 0, said
        with np.load(file) as arrays:
            for key, array in arrays.items():
                name, _, what = key.partition(".")
                loaded.setdefault(name, {})[what] = array

    alone = "PYTEST_XDIST_WORKER" not in os.environ
    whole = begin() if alone else None

    def found(name):
        if name not in loaded:
            load(whole if alone else begin(name))
        return loaded[name]

    yield found
    for process in running.values():
        process.kill()
        process.wait()


@pytest.fixture(scope="module")
def in_double(tmp_path_factory):
    """Results of the CPU for the stiff scenes in double precision, by default settings and with stages solved to rounding."""
    file = tmp_path_factory.mktemp("double") / "found.npz"
    command = [sys.executable, str(Path(device_scenes.__file__)), "cpu", str(file), *device_scenes.STIFF]
    subprocess.run(command, env={**os.environ, "TAICHI_SIM_PRECISION": "f64"}, check=True)
    with np.load(file) as arrays:
        return dict(arrays)


def test_the_device_computes_right(on_cpu):
    assert list(faults()) == []


@pytest.mark.once  # in single precision only
def test_it_computes_what_is_stored(arch):
    """`taichi-sim verify`: each case that a device can run."""
    results = list(verify.results(arch))
    assert sum(result.deviation is not None for result in results) == 5
    assert [result for result in results if not result.passed] == []


@pytest.fixture(scope="module")
def on_device(arch):
    """What the device finds: each scene is run by the first test that asks for it."""
    ran = {}

    def found(name):
        if name not in ran:
            ran[name] = device_scenes.run(name, arch)
        return ran[name]

    return found


@pytest.mark.parametrize("name", by_scene(device_scenes.BY_NAME))
def test_runs(name, on_cpu, on_device):
    assert np.isfinite(on_device(name)["position"]).all()


@pytest.mark.parametrize("name", by_scene(["pile_ordered", "pile_2d", "pile_3d", "surfaces", "implicit_euler"]))
def test_the_same_bits_in_every_run(name, arch, on_device):
    once, again = on_device(name), device_scenes.run(name, arch)
    for what in ("position", "velocity", "spin"):
        np.testing.assert_array_equal(once[what], again[what])


def test_sums_over_many_balls_are_right(arch):
    """Energies, summed by few at a time, against NumPy's."""
    rng = np.random.default_rng(4)
    n = 20_000
    scene = ts.Scene(dim=3, gravity=(0, -10, 0))
    scene.add_balls(
        rng.uniform(0, 100, (n, 3)), velocity=rng.normal(size=(n, 3)), mass=rng.uniform(1, 5, n), radius=0.1
    )
    with ts.Simulation(scene, arch=arch, contacts="off", driver="parallel", dt=1e-3) as sim:
        energy = sim.energy()
    kinetic = 0.5 * np.sum(scene.mass[:, None] * scene.velocity**2)
    assert energy.kinetic == pytest.approx(kinetic, rel=1e-6)
    assert energy.gravity == pytest.approx(10.0 * np.sum(scene.mass * scene.position[:, 1]), rel=1e-6)


@pytest.mark.parametrize("name", by_scene(["many_springs", "pile_2d"]))
def test_a_restored_run_goes_on(name, arch, tmp_path):
    scene, settings = device_scenes.BY_NAME[name]()
    with ts.Simulation(scene, arch=arch, **settings) as whole:
        whole.step(10)
        whole.save(tmp_path / "a.npz")
        whole.step(10)
        with ts.Simulation.restore(tmp_path / "a.npz") as rest:
            rest.step(10)
            np.testing.assert_array_equal(rest.position, whole.position)


def test_double_precision_is_refused_where_there_may_be_none(arch):
    if backend.running().has_wide_numbers:
        pytest.skip(f"{arch} has double precision")
    with pytest.raises(ts.BackendError, match=f"precision: 'f64' was asked for, which {arch} devices may lack"):
        backend.start(arch=arch, precision="f64")


# Comparisons, last: what the CPU finds takes it minutes beside the device


def differences(one, other, tolerance):
    """By how much two results differ: the furthest coordinate [m], the share of those beyond the tolerance, energy, number of
    contacts, depth and residual in parts of what they may, and the median of velocities, of the fastest."""
    moved = np.abs(one["position"] - other["position"])
    depth = np.abs(one["depth"] - other["depth"]) / np.maximum(1e-2 * np.abs(other["depth"]), 1e-5)
    energy = abs(one["energy"][3] / other["energy"][3] - 1.0)
    contacts = abs(one["contacts"][0] - other["contacts"][0])
    turned = np.abs(one["velocity"] - other["velocity"]).max(axis=1)
    velocity = np.median(turned) / np.linalg.norm(other["velocity"], axis=1).max()
    return np.array([moved.max(), np.mean(moved > tolerance), energy, contacts, depth.max(), velocity])


@pytest.mark.parametrize("name", by_scene(device_scenes.BY_NAME))
def test_as_the_cpu(name, on_cpu, on_device):
    """Or, where a scene is sensitive, as near to the CPU as that comes to itself from starts that are off by a rounding error."""
    here, there = on_device(name), on_cpu(name)
    tolerance = 1e-5 * np.abs(there["position"]).max() if name in FREE else 2e-4
    limit = np.array([tolerance, 0.0, 1e-3, 0, 1.0, 1e-3])
    for other in device_scenes.from_other_starts(there):
        limit = np.maximum(limit, OTHER_STARTS * differences(other, there, tolerance))
    found = differences(here, there, tolerance)
    assert (found <= limit).all(), (
        f"{found}, allowed {limit}: furthest, share beyond, energy, contacts, depth, velocity"
    )
    np.testing.assert_array_equal(here["torn"], there["torn"])


def test_scenes_have_what_is_to_be_compared(on_cpu):
    """Contacts, springs that tear, balls that turn: a comparison of nothing would pass."""
    for name in ("pile_2d", "pile_3d", "sizes_differ", "mesh_collider", "sticks_and_colliders", "surfaces", "jelly"):
        assert on_cpu(name)["contacts"][0] > 0, name
    assert on_cpu("tearing_in_wind")["torn"].any()
    assert np.abs(on_cpu("pile_3d")["spin"]).max() > 0.1


@pytest.mark.parametrize("name", by_scene(device_scenes.SWINGING))
def test_springs_by_colours_are_as_accurate_as_in_turn(name, arch, on_cpu):
    here, there = device_scenes.swung(name, arch), on_cpu(name)
    assert "springs.colours" in here["kernels"]
    mine, theirs = (np.sqrt(np.mean((found["position"] - there["exact"]) ** 2)) for found in (here, there))
    assert mine < 1.3 * theirs
    if name == "swinging_cloth" and mine >= 1.1 * theirs:
        pytest.xfail(f"there and back by colours is {mine / theirs:.2f} as far off as in turn, 1.1 is the goal")
    assert mine < 1.1 * theirs


@pytest.mark.parametrize("name", by_scene(device_scenes.STIFF))
def test_implicit_methods_are_solved_as_well_as_on_the_cpu(name, arch, on_cpu, in_double):
    """By default settings, against the same steps in double precision, solved to rounding: without aggregates a tolerance hides
    slow modes. The CPU shows what the tolerance allows in double precision, and what rounding adds in the present one."""
    exact = in_double[f"{name}.exact"]
    found = (device_scenes.stiff(name, arch), on_cpu(name), {"position": in_double[f"{name}.position"]})
    mine, rounded, theirs = (np.sqrt(np.mean((one["position"] - exact) ** 2)) for one in found)
    assert mine < 2.0 * max(rounded, theirs)


@pytest.mark.parametrize("name", by_scene(device_scenes.PICTURES))
def test_pictures_as_the_cpu_draws_them(name, arch, on_cpu):
    here, there = device_scenes.picture(name, arch).astype(int), on_cpu(name)["picture"].astype(int)
    assert there.std() > 10  # something is seen
    assert (np.abs(here - there).max(axis=2) > 24).mean() < 2e-3
