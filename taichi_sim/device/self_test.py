"""Whether a device computes right. It takes a few seconds, in a process of its own, which a broken driver may end.

    python -m taichi_sim.device.self_test vulkan

prints one line: nothing where all is right, else what went wrong.
"""

import subprocess
import sys
from collections.abc import Iterator

import numpy as np

__all__ = ["examine", "faults"]

ATOMICS = 128  # lanes of unlike lengths
MANY = 100_000
PATIENCE = 120.0  # s
NOTE = "this driver is broken (Mesa's lavapipe 22.3 is such a one); update it, or take another device"


def faults() -> Iterator[str]:
    """What the device that runs in this process does wrong, in words."""
    from taichi_sim.device.engine import ti
    from taichi_sim.kernels import self_test

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


def examine(arch: str) -> str:
    """What is wrong with a device, in one sentence; "" where it passed. It runs in a new process."""
    command = [sys.executable, "-m", __spec__.name, arch]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE)
    except subprocess.TimeoutExpired:
        return f"the self-test did not end within {PATIENCE:g} s"
    if done.returncode:
        last = (done.stderr.strip().splitlines() or ["no message"])[-1]
        return f"the self-test ended with status {done.returncode}: {last}"
    return done.stdout.strip()


if __name__ == "__main__":
    from taichi_sim.device import backend

    backend.start(sys.argv[1], "f32")
    found = list(faults())
    if found:
        print(f"{'; '.join(found)}: {NOTE}")
