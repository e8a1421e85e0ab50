"""Parts of a substep: run in turn by their roles, compiled apart on one thread, and found in the cache by a second process."""

import os
import subprocess
import sys
from contextlib import nullcontext
from functools import partial
from pathlib import Path

import numpy as np
import pytest

import taichi_sim as ts
from taichi_sim.device import backend, parts
from taichi_sim.device.engine import IS_KNOWN, ti
from taichi_sim.device.fast_launches import by_engine
from taichi_sim.device.parts import BOTH, PRIME, STEP, Chain, Launches, Part
from taichi_sim.integrators.symplectic_euler import SymplecticEuler
from taichi_sim.integrators.verlet import Verlet
from taichi_sim.simulation import choices, drivers

pytestmark = pytest.mark.once


@ti.data_oriented
class Numbers:
    """Some numbers, and parts that each change them in a loop; `last` is compiled in."""

    def __init__(self, last=3.0):
        self.last = last
        self.x = ti.field(float, 5)
        names = {"_add": STEP, "_double": BOTH, "_subtract": PRIME, "_multiply": BOTH}
        self.parts = tuple(Part(self, name, roles) for name, roles in names.items())
        self.chain = Chain(self.parts)
        self.launches = Launches(self.parts)

    @ti.func
    def _add(self, role: ti.template(), h, time):
        for i in range(5):
            self.x[i] = self.x[i] + h + time

    @ti.func
    def _double(self, role: ti.template(), h, time):
        for i in range(5):
            self.x[i] = 2.0 * self.x[i]

    @ti.func
    def _subtract(self, role: ti.template(), h, time):
        for i in range(5):
            self.x[i] = self.x[i] - h

    @ti.func
    def _multiply(self, role: ti.template(), h, time):
        for i in range(5):
            if role == STEP:
                self.x[i] = self.last * self.x[i]

    @ti.kernel
    def fused(self, role: int, steps: int, h: float):
        ti.loop_config(serialize=True)
        for k in range(steps):
            self.chain.run(role, h, 1.0 * k)


def _chained(last=3.0):
    """Numbers that two steps and a start make of 1, on one thread."""
    numbers = Numbers(last)
    numbers.x.fill(1.0)
    numbers.fused(STEP, 2, 0.5)
    numbers.fused(PRIME, 1, 0.25)
    return numbers.x.to_numpy()


def test_parts_run_in_turn_by_their_roles():
    backend.start("cpu")
    numbers = Numbers()
    numbers.x.fill(1.0)
    for number in range(2):
        numbers.launches.run(STEP, number, 0.5, 0.5 * number)
    numbers.launches.run(PRIME, 0, 0.25, 0.0)
    expected = 2.0 * (6.0 * (6.0 * 1.5 + 1.5)) - 0.25
    assert np.all(numbers.x.to_numpy() == expected)
    assert np.all(_chained() == expected)


def test_substeps_launched_in_one_call_differ_in_their_number_alone():
    """Whatever launches them; the first one of a call is launched by itself, and compiled."""
    backend.start("cpu")
    ends = []
    for calls, watch in (
        (((0, 1), (1, 1), (2, 1)), nullcontext),
        (((0, 3), (3, 0)), nullcontext),
        (((0, 3),), by_engine),
    ):
        numbers = Numbers()
        numbers.x.fill(1.0)
        with watch():
            for first, steps in calls:
                numbers.launches.run(STEP, first, 0.5, 0.25, steps)
        ends.append(numbers.x.to_numpy()[0])
    x = 1.0
    for number in range(3):
        x = 6.0 * (x + 0.5 + 0.25 + 0.5 * number)
    assert ends == [x, x, x]


@pytest.mark.skipif(not IS_KNOWN, reason="the engine launches")
def test_a_launch_is_prepared_once_for_many_substeps(monkeypatch):
    """Of a scene of the program's own parts, and with a force of the user's."""
    scene = ts.Scene(dim=2, gravity=(0.0, -8.0))
    scene.add_balls([[0.0, 0.15], [0.05, 0.45]], radius=0.02)
    scene.add_springs([(0, 1)], stiffness=40.0)
    wind, prepared, repeated = Wind(), [], parts.repeated
    wind.vector = ti.Vector([1.0, 0.0])

    def prepare(*given):
        prepared.append(repeated(*given))
        return prepared[-1]

    monkeypatch.setattr(parts, "repeated", prepare)
    for forces in ([], [wind]):
        with ts.Simulation(scene, dt=2e-3, driver="parallel", arch="cpu", forces=forces) as sim:
            sim.step(1)
            for steps in (1, 2, 20):
                prepared.clear()
                sim.step(steps)
                assert (len(prepared) > 0) == (steps > 1)
                assert len(prepared) <= len(sim.parts.drivers.launches.groups)
                assert all(launch.__qualname__.startswith("_FastKernel") for launch in prepared)


@pytest.mark.slow
def test_one_thread_runs_large_scenes_fused_too(monkeypatch):
    """Between launches of at most so much work the host hears of Ctrl-C; the bits are those of the other driver."""
    scene = ts.Scene(dim=2, gravity=(0.0, -8.0))
    scene.add_balls([[0.0, 0.15], [0.05, 0.45], [1.0, 0.2]], radius=0.02)
    scene.add_springs([(1, 2)], stiffness=40.0)
    monkeypatch.setattr(choices, "FUSED_UP_TO", 0)
    monkeypatch.setattr(choices, "FUSED_WITH_SEARCH", 0)
    monkeypatch.setattr(drivers, "FUSED_WORK", 12)  # three substeps of four
    start, ends = backend.start, []
    for threads in (1, 2):
        monkeypatch.setattr(backend, "start", lambda *given, n=threads: start(*given)._replace(threads=n))
        with ts.Simulation(scene, dt=2e-3, arch="cpu") as sim:
            assert sim.kernels()[0] == ("driver.fused" if threads == 1 else "driver.parallel")
            launched, kernels = [], sim.parts.drivers
            vars(kernels)["fused"] = partial(
                lambda fused, heard, *given: heard.append(given[2]) or fused(*given), kernels.fused, launched
            )
            sim.step(11)
            assert launched == ([1, 3, 3, 3, 2] if threads == 1 else [])
            ends.append(sim.position)
    assert np.array_equal(*ends)


def test_a_scene_that_looks_for_contacts_is_fused_up_to_a_larger_size(monkeypatch):
    """Its substeps have more loops, which threads take long to begin."""
    start = backend.start
    monkeypatch.setattr(backend, "start", lambda *given: start(*given)._replace(threads=2))
    monkeypatch.setattr(choices, "FUSED_UP_TO", 4)

    def driver(chain, limit, **settings):
        scene = ts.Scene(dim=2)
        scene.add_balls([[0.3 * k, 0.0] for k in range(4)], radius=0.1)
        scene.add_springs([(0, 1), (1, 2), (2, 3), (0, 2), (1, 3), (0, 3)][: 6 if chain else 3], stiffness=40.0)
        monkeypatch.setattr(choices, "FUSED_WITH_SEARCH", limit)
        with ts.Simulation(scene, dt=1e-3, arch="cpu", **settings) as sim:
            return sim.kernels()[0]

    fewest = 4 + 3 + 4 * choices.SEARCHED
    assert driver(False, fewest) == "driver.fused"
    assert driver(False, fewest - 1) == "driver.parallel"
    assert driver(False, fewest, contacts="off") == "driver.parallel"
    assert driver(True, fewest + 3) == "driver.parallel"  # all joined by springs: none may touch


@pytest.mark.skipif(not IS_KNOWN, reason="parts are inlined")
def test_a_second_process_finds_parts_and_a_changed_one_is_compiled_anew(tmp_path):
    """Also where other functions were made before. A part that is called once would be inlined by LLVM: all are functions."""
    kept = [_kept_by(tmp_path, *arguments) for arguments in (("3.0", "0"), ("3.0", "17"), ("7.0", "0"))]
    assert kept[0] == kept[1] > 0
    assert kept[2] == kept[0] + 1  # the kernel of Numbers alone, though only the end of the chain differs


def _kept_by(folder, last, others):
    """Kernels in a cache after a process that has run the chain, having made so many other functions before."""
    code = (
        "import sys; sys.path.insert(0, 'tests/device')\n"
        "from taichi_sim.device.engine import ti\n"
        "from taichi_sim.device import backend\n"
        "from test_parts import _chained\n"
        f"made = [ti.func(lambda x: x) for _ in range({others})]\n"
        "backend.start('cpu', 'f32')\n"
        f"print(_chained({last}))"
    )
    environment = {**os.environ, "TI_OFFLINE_CACHE_FILE_PATH": str(folder)}
    subprocess.run([sys.executable, "-c", code], check=True, env=environment, cwd=Path(__file__).parents[2])
    return len(list(folder.glob("*.tic")))


@ti.data_oriented
class Floating(SymplecticEuler):
    """A method whose substep replaces the parts that it inherits: nothing acts on balls."""

    @ti.func
    def substep(self, h, time):
        for i in range(self.model.n):
            self.state.shift(i, h * self.ball[i].v)


@ti.data_oriented
class Halved(SymplecticEuler):
    """A method that calls the substep that it inherits, twice."""

    @ti.func
    def substep(self, h, time):
        SymplecticEuler.substep(self, 0.5 * h, time)
        SymplecticEuler.substep(self, 0.5 * h, time)


def _moved(method, dt, steps):
    scene = ts.Scene(dim=2, gravity=(0.0, -8.0))
    scene.add_balls([[0.0, 0.0]], velocity=[[1.0, 0.0]], radius=0.1)
    with ts.Simulation(scene, integrator=method, dt=dt) as sim:
        sim.step(steps)
        return sim.position


def test_a_substep_of_its_own_replaces_inherited_parts():
    assert np.array_equal(_moved(Floating(), 0.25, 4), [[1.0, 0.0]])
    assert np.array_equal(_moved(Halved(), 0.25, 2), _moved("symplectic_euler", 0.125, 4))


@ti.data_oriented
class Still(Verlet):
    """A method of a built-in that may run from the host, whose own substep does nothing."""

    @ti.func
    def substep(self, h, time):
        pass


@pytest.mark.parametrize("driver", ["fused", "parallel"])
def test_a_substep_of_its_own_replaces_what_runs_from_the_host(driver):
    scene = ts.Scene(dim=2, gravity=(0.0, -8.0))
    ts.shapes.rope(scene, start=(0, 0), end=(1, 0), n=4, stiffness=50.0, damping=40.0)
    with ts.Simulation(scene, integrator=Still(), dt=0.01, driver=driver, arch="cpu") as sim:
        sim.step(3)
        np.testing.assert_allclose(sim.position, scene.position, atol=1e-6)


def test_a_method_without_a_substep_is_refused():
    class Nothing(ts.Integrator):
        @ti.func
        def substeps(self, h, time):
            pass

    scene = ts.Scene(dim=2)
    scene.add_balls([[0.0, 0.0]], radius=0.1)
    with pytest.raises(ts.SceneError, match="Nothing has no substep"):
        ts.Simulation(scene, integrator=Nothing(), dt=0.01)


@ti.data_oriented
class Wind:
    """A force that cannot be compiled before its `vector` [N] is given."""

    def stiffness_rate(self, scene):
        return 0.0

    damping_rate = stiffness_rate

    @ti.func
    def accumulate(self, model: ti.template(), ball: ti.template(), impulse: ti.template(), h, time):
        for i in range(model.n):
            impulse[i] += h * self.vector


@pytest.mark.parametrize("goes_on", [True, False])
def test_a_run_whose_compilation_failed_is_right_once_it_is_mended(goes_on):
    scene = ts.Scene(dim=2, gravity=(0, -12))
    scene.add_balls([[0, 2.0]], radius=0.1, mass=1.0)
    wind = Wind()
    first = ts.Simulation(scene, forces=[wind], dt=2e-3, driver="fused", arch="cpu")
    with pytest.raises(Exception, match="vector"):
        first.run(0.3)
    wind.vector = ti.Vector([1.0, 0.0])
    if not goes_on:
        first.close()
    with first if goes_on else ts.Simulation(scene, forces=[wind], dt=2e-3, driver="fused", arch="cpu") as sim:
        sim.run(0.3)
        np.testing.assert_allclose(sim.position[0], [0.5 * 0.3**2, 2 - 6 * 0.3**2], rtol=1e-5)


@pytest.mark.slow
def test_a_step_on_many_threads_compiles_the_search_for_contacts_once():
    """One kernel finds contacts and sums forces, in a step and before the first one."""
    scene = ts.Scene(dim=2, gravity=(0.0, -8.0))
    scene.add_balls([[0.0, 0.15], [0.05, 0.45], [1.0, 0.2]], radius=0.12)
    scene.add_springs([(1, 2)], stiffness=40.0)
    scene.add_wall((0, 1))
    known = Launches._launch._primal.compiled_kernels
    before = len(known)
    with ts.Simulation(scene, dt=2e-3, driver="parallel", arch="cpu") as sim:
        sim.step(4)
        now = len(Launches._launch._primal.compiled_kernels) - before
        assert 0 < now <= len(sim.parts.drivers.launches.groups)


@pytest.mark.slow
@pytest.mark.parametrize("contacts", ["gauss_seidel", "jacobi"])
def test_further_iterations_are_one_part_that_runs_often(contacts):
    """Thirteen iterations on many threads compile no more kernels than six, and give the same bits as on one thread."""
    scene = ts.Scene(dim=2, gravity=(0.0, -8.0))
    scene.add_material("felt", friction=0.3)
    scene.add_balls([[0.0, 0.11], [0.05, 0.33], [0.0, 0.56]], radius=0.12, material="felt")
    scene.add_wall((0, 1), material="felt")
    ends, kernels = {}, []
    for driver, iterations in (("fused", 6), ("parallel", 6), ("parallel", 13)):
        settings = {"contacts": contacts, "contact_iterations": iterations, "accumulate": "ordered"}
        with ts.Simulation(scene, dt=2e-3, driver=driver, arch="cpu", **settings) as sim:
            sim.step(40)
            ends[driver, iterations] = sim.position
            kernels.append(len(sim.parts.drivers.launches.groups))
    assert np.array_equal(ends["fused", 6], ends["parallel", 6])
    assert not np.array_equal(ends["parallel", 6], ends["parallel", 13])
    assert kernels[1] == kernels[2]
