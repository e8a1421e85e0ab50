"""Taichi serves the thread that started it; nothing of the process is changed for others."""

import os
import subprocess
import sys
import threading
import time

import pytest
from physics_support import simulate

import taichi_sim as ts
from taichi_sim.device import backend
from taichi_sim.device.engine import ENGINE, ti
from taichi_sim.device.fields import Fields
from taichi_sim.device.kernel_cache import cache_folder
from taichi_sim.render.renderer import Renderer

pytestmark = pytest.mark.once


def elsewhere(work):
    """What work raises in another thread."""
    raised = []

    def run():
        try:
            work()
        except BaseException as error:
            raised.append(error)

    thread = threading.Thread(target=run, name="worker")
    thread.start()
    thread.join()
    return raised[0] if raised else None


def two_balls():
    scene = ts.Scene(dim=2, gravity=(0, -8))
    scene.add_balls([[0, 2], [0.5, 3]], radius=0.1)
    return scene


def test_another_thread_is_told_where_simulations_belong():
    with simulate(two_balls(), dt=1e-3, contacts="off") as sim:
        renderer = Renderer(sim.frame(), size=(8, 8))
        frame = sim.frame()
        for work in (
            backend.check_thread,
            lambda: ts.Simulation(two_balls()),
            lambda: Renderer(frame, size=(8, 8)),
            lambda: renderer.render(frame),
            renderer.close,
            lambda: Fields(None),
        ):
            error = elsewhere(work)
            assert isinstance(error, ts.BackendError)
            assert "'MainThread'" in str(error)
            assert "'worker'" in str(error)
            assert "process of its own" in str(error)
        sim.step(1)  # and all is well here
        assert renderer.render(frame).shape[:2] == (8, 8)
        renderer.close()


def test_a_forked_process_is_told_to_be_spawned(monkeypatch):
    pid, *rest = backend._owner
    monkeypatch.setattr(backend, "_owner", (pid - 1, *rest))
    with pytest.raises(ts.BackendError, match="spawn"):
        backend.check_thread()


STARTS = """
import sys, threading, time
from taichi_sim.device import backend
lines, stop = 0, False
def talk():
    while not stop:
        print("line")
        globals()["lines"] += 1
thread = threading.Thread(target=talk)
thread.start()
backend.start("cpu")
stop = True
thread.join()
sys.stderr.write(str(lines))
"""


def test_a_start_says_nothing_and_loses_nothing_of_other_threads():
    done = subprocess.run([sys.executable, "-c", STARTS], capture_output=True, text=True, timeout=120, check=True)
    assert set(done.stdout.splitlines()) == {"line"}
    assert len(done.stdout.splitlines()) == int(done.stderr.split()[-1])


@pytest.mark.skipif(ENGINE != "taichi", reason="the lock of Taichi")
def test_a_stale_lock_of_the_cache_is_removed_and_said(tmp_path, monkeypatch):
    lock = tmp_path / "ticache.lock"
    assert cache_folder(tmp_path) == tmp_path  # none: nothing is said
    lock.touch()
    assert cache_folder(tmp_path) == tmp_path
    assert lock.exists()  # somebody may hold it
    long_ago = time.time() - 3600.0
    os.utime(lock, (long_ago, long_ago))
    with pytest.warns(UserWarning, match=r"ticache\.lock: a killed process .* removed"):
        assert cache_folder(tmp_path) == tmp_path
    assert not lock.exists()


RESTARTS = """
import numpy as np
import taichi_sim as ts
from taichi_sim.device import backend
from taichi_sim.device.engine import ti  # the engine that is used

def is_closed(sim):
    try:
        sim.step(1)
    except RuntimeError as error:
        return "closed" in str(error)
    return False

scene = ts.Scene(dim=2, gravity=(0, -8))
scene.add_balls([[0, 2], [0.5, 3]], radius=0.1)
ends = []
for precision in ("f32", "f32", "f64"):
    sim = ts.Simulation(scene, precision=precision, arch="cpu", contacts="off")
    sim.run(0.1)
    ends.append(sim.position)
    backend.stop()
    assert backend.running() is None
    assert is_closed(sim)
    sim.close()
backend.stop()
assert np.array_equal(ends[0], ends[1])
assert np.allclose(ends[0], ends[2], atol=1e-5)
assert not np.array_equal(ends[0], ends[2])
for own in (ti.reset, lambda: ti.init(arch=ti.cpu, default_fp=ti.f32)):
    old = ts.Simulation(scene, precision="f64", arch="cpu", contacts="off", dt=1e-3)
    own()
    assert backend.running() is None
    new = ts.Simulation(scene, precision="f64", arch="cpu", contacts="off", dt=1e-3)
    new.step(100)
    assert abs(new.position[0, 1] - (2 - 4 * 0.1**2)) < 1e-12, new.position
    assert is_closed(old)
"""


def test_simulations_start_the_engine_again_after_a_stop_in_any_precision_and_somebodys_own_reset():
    done = subprocess.run([sys.executable, "-c", RESTARTS], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr


def test_threads_of_a_gpu_are_refused():
    with pytest.raises(ValueError, match="threads: 2 is not allowed; they are those of arch 'cpu', and 'vulkan'"):
        backend.start(arch="vulkan", threads=2)


@pytest.mark.parametrize("threads", [0, -1, True, 2.0, backend.MOST_THREADS + 1, 4096 * 4096])
def test_the_number_of_threads_is_bounded(threads):
    """Where memory is limited the engine would wait for those that it cannot start."""
    with pytest.raises(ValueError, match=f"threads: {threads} is not allowed; it must be a whole number from 1 to"):
        backend.start("cpu", threads=threads)


def test_a_caller_may_be_deep_within_other_calls():
    """The engine compiles within some hundred calls of its own, to which those of the caller add up."""
    backend.start("cpu")
    n = ti.field(int, ())

    @ti.kernel
    def count():
        n[None] += 1

    def within(calls):
        return within(calls - 1) if calls else count()

    within(1500)
    assert n[None] == 1
