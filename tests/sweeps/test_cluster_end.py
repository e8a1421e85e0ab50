"""How workers end: what they have compiled is kept for the next run."""

from types import SimpleNamespace

import pytest

from taichi_sim.sweeps import cluster

pytestmark = pytest.mark.once


def test_each_worker_ends_its_engine_which_keeps_what_it_compiled():
    asked, waited = [], []

    def submit(work, workers, pure):
        asked.append((work, workers, pure))
        return workers[0]

    client = SimpleNamespace(ncores=lambda: {"one": 1, "two": 1}, submit=submit)
    cluster._keep_kernels(client, lambda ends, timeout: waited.append((ends, timeout)))
    assert asked == [(cluster._end_engine, ["one"], False), (cluster._end_engine, ["two"], False)]
    assert waited == [(["one", "two"], cluster.PATIENCE)]

    def late(ends, timeout):
        raise TimeoutError

    cluster._keep_kernels(client, late)  # costs nothing else
