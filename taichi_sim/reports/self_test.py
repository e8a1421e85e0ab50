"""Self-test of a device: small loops with known results, for what the simulation relies on.

    python -m taichi_sim.reports.self_test vulkan

takes a few seconds and prints nothing where all is right, else what went wrong: the driver is broken then.
"""

import sys
from collections.abc import Iterator

import numpy as np

from taichi_sim.device import backend
from taichi_sim.device.devices import WRONG
from taichi_sim.device.engine import ti
from taichi_sim.kernels import self_test

__all__ = ["faults"]

ATOMICS = 128  # lanes of unlike lengths
MANY = 100_000
NOTE = "this driver is broken (Mesa's lavapipe 22.3 is such a one); update it, or take another device"


def faults() -> Iterator[str]:
    """Faults of the device that runs in this process, in words."""
    drawn = ATOMICS * (ATOMICS - 1) // 2
    count, slots = ti.field(ti.i32, 1), ti.field(ti.i32, drawn)
    self_test.ragged(count, slots, ATOMICS)
    if count[0] != drawn or (slots.to_numpy() != 1).any():
        yield f"loops of unlike lengths stored {int((slots.to_numpy() == 1).sum())} of {drawn} numbers by atomic additions"
    a, b = ti.field(ti.i32, MANY), ti.field(ti.i32, MANY)
    self_test.in_order(a, b, MANY)
    if wrong := int((b.to_numpy() != 3 * np.arange(MANY)).sum()):
        yield f"{wrong} of {MANY} numbers were read before the loop that writes them had ended"
    whole, real = ti.field(ti.i32, 3), ti.field(ti.f32, MANY + 1)
    n = 60_000
    self_test.reduced(whole, real, n)
    found, wanted = [*whole.to_numpy().tolist(), float(real[0])], [n * (n - 1) // 2, 0, n - 1, 0.5 * n]
    if found != wanted:
        yield f"sum, least, largest and sum of floats are {found}, not {wanted}"
    self_test.hashed(a, MANY)
    i = np.arange(MANY)
    key = i.astype(np.uint32) * np.uint32(2654435761)
    key ^= key >> np.uint32(15)
    expected = (key & np.uint32(0x7FFFFFFF)).astype(np.int32) ^ i.astype(np.float32).view(np.int32)
    if wrong := int((a.to_numpy() != expected).sum()):
        yield f"{wrong} of {MANY} unsigned products or bits of floats are wrong"
    real.fill(0.0)
    self_test.rounded(real, MANY)
    if wrong := int((real.to_numpy()[:MANY] != np.floor(-0.25 * i)).sum()):
        yield f"{wrong} of {MANY} numbers were rounded or compared wrongly"


if __name__ == "__main__":
    backend.start(sys.argv[1], "f32")
    if found := list(faults()):
        print(f"{WRONG}{'; '.join(found)}: {NOTE}")
