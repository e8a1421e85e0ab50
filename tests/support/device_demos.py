"""The built-in demos on a device and on the CPU, in single precision: held to move and look alike.

    python tests/support/device_demos.py ARCH [NAME ...] [--at PART] [--full] [--folder FOLDER]

Each demo goes 40 steps of 0.5 ms, or of its own step where that is shorter, with its own settings, but by the contact rule of
devices on both sides and with the parallel driver. Where nothing touches at the start of a demo, --at says more: 0.5 begins with
what the CPU makes of it, by the demo's own rule, in half of its time. A row says what came out, and which limit is broken; the
exit status is then 1. Each run has a process of its own, for Taichi holds one device for each, and a driver may crash.

Two pictures are compared with the CPU's: the device's drawing of the CPU's last state, and that of its own. The first is the fair
one, which has the limit: it judges the renderer alone, and motion has limits of its own.

Where motion differs too much, the CPU goes again from a start that is nudged by as little as single precision can hold. If it
ends as far off, the scene and not the device makes much of rounding: that is told, and the limit counts as broken all the same.
"""

import argparse
import sys
import tempfile
import time
import warnings
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from taichi_sim.demos import million, pudding

import taichi_sim as ts
from taichi_sim.files.source import checked_output, demos, open_scene
from taichi_sim.render.renderer import Renderer

STEPS, STEP = 40, 5e-4  # s
WIDTH = 480  # px
NUDGE = 1e-7  # m, or the last digit of a coordinate where that is more
VISIBLE = 24  # of 255
LIMITS = {"motion": 2e-4, "energy": 1e-3, "pixels": 2e-3}  # m, parts, part of the picture
COLUMNS = (
    f"{'demo':26} {'balls':>7} {'moved m':>8} {'apart m':>8} {'energy':>8} {'contacts':>13} {'pixels':>8} {'own':>8}"
    f" {'cpu s':>6} {'device s':>8}"
)


def small_million():
    """The million as 16 000 balls: as deep, an eighth as wide and long."""
    part = 20 / million.LAYER[0]
    million.LAYER, million.SHEET = (20, million.LAYER[1], 20), 13
    million.LONG = million.WIDE = 20 * million.SPACING
    scene = million.scene()
    scene.output["camera"]["distance"] *= part
    return scene


def small_pudding():
    """The pudding of 12 000 tetrahedra."""
    pudding.SPACING = 0.04
    return pudding.scene()


SMALLER = {"million": small_million, "pudding": small_pudding}


def opened(name, full):
    """A demo's scene, its length [s], the size of its picture [px] and its look."""
    scene = SMALLER[name]() if name in SMALLER and not full else open_scene(demos()[name])
    assert scene is not None
    output: dict[str, Any] = {"duration": 5.0, "size": (1280, 720)} | checked_output(scene)
    duration, (width, height) = output.pop("duration"), output.pop("size")
    output.pop("fps", None)
    return scene, duration, (WIDTH, round(WIDTH * height / width)), output


def begin_later(name, full, part, file):
    """Write where the CPU is after a part of the demo."""
    warnings.simplefilter("ignore")
    scene, duration, _, _ = opened(name, full)
    with ts.Simulation(scene, arch="cpu", precision="f32") as simulation:
        simulation.run(part * duration)
        snapshot = simulation.snapshot()
    arrays: dict[str, Any] = {"began": snapshot.time} | snapshot.arrays()
    np.savez(file, **arrays)


def ready(scene, arch, start):
    """A simulation that has yet to go; start: what begin_later wrote, or None."""
    rule = scene.settings.get("contacts", "auto")
    rule = "jacobi" if rule in ("auto", "gauss_seidel") else rule
    simulation = ts.Simulation(scene, arch=arch, precision="f32", driver="parallel", contacts=rule)
    if start is not None:
        with np.load(start) as arrays:
            simulation.resume(ts.Snapshot.of_file(arrays, float(arrays["began"]), {}))
    simulation.set_dt(min(STEP, simulation.dt))
    return simulation


def nudge(simulation):
    """Move every ball by almost nothing in each direction."""
    x = simulation.position
    little = np.maximum(NUDGE, np.spacing(np.abs(x).astype(np.float32)))
    way = np.random.default_rng(0).choice([-1.0, 1.0], x.shape) * ~simulation.scene.pinned[:, None]
    simulation.set_position(x + way * little)


def run(name, full, arch, file, start, drawn=None, nudged=False):
    """Write what a demo comes to; drawn: the file of another run, whose last state is drawn, too."""
    warnings.simplefilter("ignore")
    begin = time.perf_counter()
    scene, _, size, look = opened(name, full)
    with ready(scene, arch, start) as simulation:
        if nudged:
            nudge(simulation)
        first = simulation.frame()
        simulation.step(STEPS)
        last, torn = simulation.frame(), simulation.torn
        found = {
            "first": first.position,
            "position": last.position,
            "velocity": last.velocity,
            "energy": np.array(last.energy),
            "contacts": np.array(simulation.contacts().number),
            "torn": np.zeros(0, dtype=bool) if torn is None else torn,
        }
        with Renderer(first, size, **look) as renderer:
            found["picture"] = renderer.render(last)
        if drawn is not None:
            same = simulation.frame()
            with np.load(drawn) as there:
                same.position, same.velocity = there["position"], there["velocity"]
            with Renderer(first, size, **look) as renderer:
                found["picture_of_same"] = renderer.render(same)
    np.savez(file, seconds=time.perf_counter() - begin, **found)


def alone(function, *given):
    """Call it in a process of its own."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        pool.submit(function, *given).result()


def loaded(file):
    with np.load(file) as arrays:
        return dict(arrays)


def differing(one, other):
    """Part of the pixels that differ visibly."""
    return float((np.abs(one.astype(int) - other.astype(int)).max(axis=2) > VISIBLE).mean())


def motion(one, other):
    """How far apart two runs end [m], and their energies, as a part of what moves, stretches or is there in all."""
    kinetic, spring, _, total = np.abs(one["energy"])
    energy = abs(one["energy"][3] - other["energy"][3]) / max(total, kinetic + spring, 1e-300)
    return float(np.abs(one["position"] - other["position"]).max(initial=0.0)), float(energy)


def broken(cpu, device):
    """Names of the limits that two runs do not keep."""
    apart, energy = motion(cpu, device)
    kept = {
        "motion": apart < LIMITS["motion"],  # false for nan
        "energy": energy < LIMITS["energy"],
        "contacts": cpu["contacts"] == device["contacts"],
        "torn springs": np.array_equal(cpu["torn"], device["torn"]),
        "pixels": differing(cpu["picture"], device["picture_of_same"]) < LIMITS["pixels"],
    }
    return [name for name, holds in kept.items() if not holds]


def row(name, cpu, device):
    """A line of the table."""
    moved = np.abs(cpu["position"] - cpu["first"]).max(initial=0.0)
    apart, energy = motion(cpu, device)
    same, own = (differing(cpu["picture"], device[picture]) for picture in ("picture_of_same", "picture"))
    contacts = f"{cpu['contacts']}, {device['contacts']}"
    return (
        f"{name:26} {len(cpu['position']):7} {moved:8.1e} {apart:8.1e} {energy:8.1e} {contacts:>13} {same:8.3%} {own:8.3%}"
        f" {cpu['seconds']:6.0f} {device['seconds']:8.0f}"
    )


def compare(name, arch, part, full, folder):
    """Run a demo on both, print its row, and return whether it keeps all limits."""
    start = folder / "start.npz" if part else None
    if start is not None:
        alone(begin_later, name, full, part, start)
    files = {which: folder / f"{which}.npz" for which in ("on_cpu", "on_device", "nudged")}
    alone(run, name, full, "cpu", files["on_cpu"], start)
    alone(run, name, full, arch, files["on_device"], start, files["on_cpu"])
    cpu, device = loaded(files["on_cpu"]), loaded(files["on_device"])
    print(row(name, cpu, device), flush=True)
    wrong = broken(cpu, device)
    if wrong:
        said = f"    broken: {', '.join(wrong)}"
        if wrong != ["pixels"]:
            alone(run, name, full, "cpu", files["nudged"], start, None, True)
            nudged = loaded(files["nudged"])
            apart, energy = motion(cpu, nudged)
            said += f"; a nudge on the CPU: {apart:.1e} m, energy {energy:.1e}, {nudged['contacts']} contacts"
        print(said, flush=True)
    return not wrong


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("arch", choices=("cuda", "vulkan", "metal"))
    parser.add_argument("names", nargs="*", metavar="NAME", help="demos; all otherwise")
    parser.add_argument("--at", type=float, default=0.0, help="part of the demo's time that is over, 0 to 1")
    parser.add_argument("--full", action="store_true", help="the million and the pudding in their full numbers")
    parser.add_argument("--folder", type=Path, help="keep states and pictures there")
    given = parser.parse_args()
    print(COLUMNS, flush=True)
    kept = True
    with tempfile.TemporaryDirectory() as nowhere:
        for name in given.names or demos():
            folder = (given.folder or Path(nowhere)) / name
            folder.mkdir(parents=True, exist_ok=True)
            try:
                kept &= compare(name, given.arch, given.at, given.full, folder)
            except Exception as error:  # the others are worth knowing
                kept = False
                print(f"{name:26} failed: {type(error).__name__}: {error}", flush=True)
    return 0 if kept else 1


if __name__ == "__main__":
    sys.exit(main())
