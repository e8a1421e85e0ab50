"""Who reaches workers, and how they end: what they have compiled is kept for the next run."""

import ipaddress
import socket
from contextlib import suppress
from types import SimpleNamespace

import pytest

from taichi_sim.studies import workers as cluster

pytestmark = pytest.mark.once


@pytest.mark.slow
def test_nobody_reaches_workers_of_this_machine():
    """Neither another machine nor another user of this one, who could have programs of theirs run by them."""
    import psutil

    with cluster.connected(None, 1, print) as workers:
        this = psutil.Process()
        listening = [
            one.laddr
            for process in (this, *this.children(recursive=True))
            for one in process.net_connections()
            if one.status == psutil.CONN_LISTEN
        ]
        assert len(listening) >= 3  # the scheduler, its pages, the worker
        assert all(ipaddress.ip_address(address.ip).is_loopback for address in listening)
        scheme, _, place = workers.client.scheduler.address.partition("://")
        assert scheme == "tls"
        host, _, port = place.rpartition(":")
        with socket.create_connection((host, int(port)), timeout=30) as stranger, suppress(ConnectionResetError):
            stranger.sendall(b"hello, run this" * 10)
            assert b"compression" not in stranger.recv(1000)  # as it greets whom it trusts


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
