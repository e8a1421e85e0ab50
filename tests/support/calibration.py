"""Calibration of `tolerance`: random scenes of every kind, the error that was promised, and the true one.

    python tests/support/calibration.py --builds 5 --starts 11 --seed 1 --log rows.jsonl [--kinds cloth,pile] [--integrator rk4]

A structure is compiled once and started many times: each build draws what is compiled in (dimension, numbers of balls, masses,
materials), each start positions, velocities and the tolerance. The truth is the same scene with 6 times as many substeps in every
step as the run took in any; 3 times as many tell how true that is.
"""

import argparse
import json
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

import taichi_sim as ts
from taichi_sim.simulation.settings import Settings
from taichi_sim.simulation.stepper import Stepper

DURATION = 0.5  # s
TRUTH = (3, 6)  # times the substeps


class Row(NamedTuple):
    """One run. Errors in units of what was asked, tolerance x size x duration: `error` true, `known`: how well that is known;
    `lost`: when it was said that the tolerance is not kept [s], or None; `unsure`: when that it is no promise; `said`: whether
    warnings said the same; `most` substeps in a step; `repeated`: from the start;
    `wall` [s], compiling included in the first of a build; `steps`: wall of one plain run with as many substeps [s], about."""

    kind: str
    build: int
    start: int
    tolerance: float
    error: float
    known: float
    estimate: float
    lost: float | None
    unsure: float | None
    said: bool
    most: int
    repeated: int
    wall: float
    plain: float


class Kind(NamedTuple):
    """`build` a structure, `start` it: positions and velocities (n, dim); the power of ten that the tolerance is at least."""

    build: Callable[[Generator], ts.Scene]
    start: Callable[[Generator, ts.Scene], tuple[NDArray, NDArray]]
    least: float


def _material(scene: ts.Scene, rng: Generator, restitution: float | None = None) -> None:
    e = rng.uniform(0, 1) if restitution is None else restitution
    scene.add_material("m", restitution=e, friction=rng.choice([0.0, rng.uniform(0.1, 0.8)]))


def _box(scene: ts.Scene, width: float, height: float) -> None:
    rest = [0] * (scene.dim - 2)
    for normal, offset in (((1, 0), 0.0), ((-1, 0), -width), ((0, 1), 0.0), ((0, -1), -height)):
        scene.add_wall([*normal, *rest], offset, material="m")


def _down(dim: int) -> list[float]:
    return [0.0, -10.0, 0.0][:dim]


def glancing(rng: Generator) -> ts.Scene:
    """Two balls of any mass, restitution and friction, nothing else."""
    scene = ts.Scene(dim=int(rng.integers(2, 4)))
    _material(scene, rng)
    at = np.zeros((2, scene.dim))
    at[1, 0] = 0.7
    scene.add_balls(at, radius=rng.uniform(0.05, 0.2, 2), material="m", mass=rng.uniform(0.1, 10, 2))
    return scene


def start_glancing(rng: Generator, scene: ts.Scene) -> tuple[NDArray, NDArray]:
    """From central to within a hundredth of a miss."""
    x, v, both = scene.position.copy(), np.zeros_like(scene.position), scene.radius.sum()
    x[1, 0], x[1, 1] = rng.uniform(both + 0.05, 0.9), both * rng.uniform(0, 0.99)
    v[0, 0] = rng.uniform(1, 8)
    return x, v


def bounces(rng: Generator) -> ts.Scene:
    """A ball in a box, with a block in it half of the times."""
    dim = int(rng.integers(2, 4))
    scene = ts.Scene(dim=dim, gravity=_down(dim))
    _material(scene, rng)
    scene.add_balls([[0.5, 0.8, 0.5][: scene.dim]], radius=0.05, material="m")
    _box(scene, 1, 1)
    if rng.random() < 0.5:
        scene.add_collider(ts.Box((0.5, 0.1, 0.5)[: scene.dim], size=(0.3, 0.2, 1.0)[: scene.dim], material="m"))
    return scene


def start_bounces(rng: Generator, scene: ts.Scene) -> tuple[NDArray, NDArray]:
    """Above the block."""
    x = scene.position.copy()
    x[:, 0], x[:, 1] = rng.uniform(0.1, 0.9), rng.uniform(0.3, 0.9)
    return x, rng.normal(0, 2, x.shape)


def boxed(rng: Generator) -> ts.Scene:
    """Two balls in a box, under gravity."""
    scene = ts.Scene(dim=2, gravity=_down(2))
    _material(scene, rng)
    scene.add_balls([[0.3, 0.8], [0.7, 0.8]], radius=rng.uniform(0.04, 0.1, 2), material="m")
    _box(scene, 1, 1)
    return scene


def start_boxed(rng: Generator, scene: ts.Scene) -> tuple[NDArray, NDArray]:
    """Each in its half."""
    x = np.stack([rng.uniform([0.12, 0.3], [0.39, 0.85]), rng.uniform([0.61, 0.3], [0.88, 0.85])])
    return x, rng.normal(0, 1.5, x.shape)


def _hanging(rng: Generator, links: int, length: float, load: float, stiffness: float, damping: float) -> ts.Scene:
    scene = ts.Scene(dim=2, gravity=_down(2))
    at = [[length * i, 0] for i in range(links + 1)]
    mass = np.full(links + 1, 0.01) if links > 3 else rng.uniform(0.1, 2, links + 1)
    mass[-1] *= load
    scene.add_balls(at, radius=length / 10, mass=mass, pinned=[True] + [False] * links)
    pairs = [[i, i + 1] for i in range(links)]
    scene.add_springs(pairs, stiffness=stiffness, damping=damping, rest_length=length)
    scene.settings = {"contacts": "off"}
    return scene


def pendulums(rng: Generator) -> ts.Scene:
    """Single, double, triple, on springs."""
    stiffness, damping = 10 ** rng.uniform(3, 5), rng.choice([0.0, 1.0])
    return _hanging(rng, int(rng.integers(1, 4)), 0.3, 1.0, stiffness, damping)


def chain(rng: Generator) -> ts.Scene:
    """With a load at its end."""
    stiffness, damping = 10 ** rng.uniform(2, 4), rng.choice([0.0, 0.05, 1.0])
    return _hanging(rng, int(rng.integers(8, 20)), 0.05, rng.uniform(1, 50), stiffness, damping)


def start_hanging(rng: Generator, scene: ts.Scene) -> tuple[NDArray, NDArray]:
    """Straight, in any direction below the pin."""
    angle = rng.uniform(-np.pi, 0)
    x = scene.position[:, :1] * np.array([[np.cos(angle), np.sin(angle)]])
    v = rng.normal(0, 1, x.shape)
    v[0] = 0
    return x, v


def cloth(rng: Generator) -> ts.Scene:
    """Pinned at one edge."""
    scene, n = ts.Scene(dim=3, gravity=_down(3)), int(rng.integers(4, 11))
    stiffness, damping = 10 ** rng.uniform(2, 3.3), rng.choice([0.0, 0.01, 0.1])
    sheet = ts.shapes.cloth(scene, size=(1, 1), resolution=(n, n), stiffness=stiffness, damping=damping)
    scene.set_balls(sheet.balls[:n], pinned=True)
    return scene


def start_pushed(rng: Generator, scene: ts.Scene) -> tuple[NDArray, NDArray]:
    """With one velocity for all."""
    v = np.zeros_like(scene.position)
    v[~scene.pinned] = rng.normal(0, 1, scene.dim)
    return scene.position.copy(), v


def jelly(rng: Generator) -> ts.Scene:
    """Thrown in a box."""
    scene, n = ts.Scene(dim=2, gravity=_down(2)), int(rng.integers(3, 6))
    _material(scene, rng)
    ts.shapes.jelly(scene, size=(0.4, 0.4), resolution=(n, n), position=(0.3, 0.3), material="m")
    _box(scene, 1, 2)
    return scene


def balloon(rng: Generator) -> ts.Scene:
    """Above a floor."""
    scene = ts.Scene(dim=3, gravity=_down(3))
    _material(scene, rng)
    damping = (None, 1.0)[rng.integers(2)]
    ts.shapes.balloon(scene, (0, 0.5, 0), 0.3, int(rng.integers(1, 3)), damping=damping, material="m")
    scene.add_wall((0, 1, 0), 0.0, material="m")
    return scene


def pile(rng: Generator) -> ts.Scene:
    """A few discs above each other in a box."""
    scene, n = ts.Scene(dim=2, gravity=_down(2)), int(rng.integers(3, 7))
    _material(scene, rng, rng.choice([0.0, 0.3]))
    scene.add_balls([[0.5, 0.05 + 0.1 * i] for i in range(n)], radius=0.05, material="m")
    _box(scene, 1, 2)
    return scene


def start_pile(rng: Generator, scene: ts.Scene) -> tuple[NDArray, NDArray]:
    """Touching or apart, upright or not quite."""
    n = scene.n_balls
    x = np.stack([np.full(n, 0.5), 0.05 + 0.1 * np.arange(n) * (1 + rng.uniform(0, 0.3))], axis=1)
    x[:, 0] += rng.choice([0.0, 1e-3, 0.03]) * rng.normal(size=n)
    return x, np.zeros_like(x)


KINDS = {
    "glancing": Kind(glancing, start_glancing, -3.5),
    "bounces": Kind(bounces, start_bounces, -4.5),
    "boxed": Kind(boxed, start_boxed, -3.0),
    "pendulums": Kind(pendulums, start_hanging, -4.5),
    "chain": Kind(chain, start_hanging, -4.5),
    "cloth": Kind(cloth, start_pushed, -4.0),
    "jelly": Kind(jelly, start_pushed, -3.0),
    "balloon": Kind(balloon, start_pushed, -3.0),
    "pile": Kind(pile, start_pile, -3.0),
}


def _run(sim: ts.Simulation, x: NDArray, v: NDArray, settings: Settings, substeps: int) -> NDArray:
    """Positions at the end; the parts that are compiled go on being used."""
    parts = sim._stepper.parts
    parts.set_step(sim.dt / substeps, anew=True)
    sim._stepper = Stepper(sim.scene, settings, parts, sim.dt, substeps, sim._stability, False)
    sim.resume(ts.Snapshot(x, v))
    sim.run(DURATION)
    return sim.position


def rows(name: str, builds: int, starts: int, seed: int, integrator: str | None = None) -> Iterator[Row]:
    """Runs of one kind."""
    kind = KINDS[name]
    for build in range(builds):
        rng = np.random.default_rng([seed, list(KINDS).index(name), build])
        scene = kind.build(rng)
        given = scene.settings | ({} if integrator is None else {"integrator": integrator})
        scene.settings = {}
        with ts.Simulation(scene, arch="cpu", tolerance=1e-2, **given) as sim:
            method, built = sim.settings.integrator, scene.position.copy()
            for start in range(starts):
                tolerance = float(10 ** rng.uniform(kind.least, -2))
                scene.set_balls(position=built)
                x, v = kind.start(rng, scene)
                scene.set_balls(position=x)
                settings = replace(Settings.resolve(scene, given | {"tolerance": tolerance}), integrator=method)
                begin = time.perf_counter()
                with warnings.catch_warnings(record=True) as warned:
                    warnings.simplefilter("always")
                    end = _run(sim, x, v, settings, settings.time_step(scene, sim._stability)[1])
                wall = time.perf_counter() - begin
                found = sim._stepper.policy.report()
                assert found is not None
                unit = tolerance * found.size * DURATION
                plain, finer, begin = replace(settings, tolerance=None, dt=sim.dt), [], time.perf_counter()
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")
                    for times in TRUTH:
                        finer.append(_run(sim, x, v, plain, times * found.most))
                once = (time.perf_counter() - begin) / sum(TRUTH)
                yield Row(
                    name,
                    build,
                    start,
                    tolerance,
                    float(np.linalg.norm(end - finer[1], axis=1).max()) / unit,
                    float(np.linalg.norm(finer[0] - finer[1], axis=1).max()) / unit,
                    found.estimate / (tolerance * DURATION),
                    found.lost,
                    found.unsure,
                    all(
                        any(words in str(warning.message) for warning in warned) == (since is not None)
                        for words, since in (("cannot be kept", found.lost), ("no promise", found.unsure))
                    ),
                    found.most,
                    found.repeated,
                    wall,
                    once,
                )


def table(found: list[Row]) -> Iterator[str]:
    """Lines of a table by kind: how many runs said that the tolerance is lost or no promise; of those that promised it, and of
    the others that did not lose it, how many kept it, and the largest error."""
    yield "| kind | runs | lost, and said so | promised | kept | largest | no promise, and said so | kept | largest | time |"
    yield "|---|---|---|---|---|---|---|---|---|---|"
    for name in [*dict.fromkeys(row.kind for row in found), "all"]:
        own = [row for row in found if name in (row.kind, "all")]
        left = [row for row in own if row.lost is None]
        cells = ""
        for part in ([row for row in left if row.unsure is None], [row for row in left if row.unsure is not None]):
            kept = sum(row.error <= 1.0 for row in part)
            cells += f" {len(part)} | {kept} | {max((row.error for row in part), default=0.0):.2g} |"
        cost = np.median([row.wall / row.plain for row in left if row.start > 0] or [np.nan])
        yield f"| {name} | {len(own)} | {len(own) - len(left)} |{cells} {cost:.1f} |"


def main() -> None:
    """See above."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--kinds", default=",".join(KINDS))
    options.add_argument("--builds", type=int, default=5)
    options.add_argument("--starts", type=int, default=11)
    options.add_argument("--seed", type=int, default=1)
    options.add_argument("--integrator")
    options.add_argument("--precision", default="f64")
    options.add_argument("--log")
    given = options.parse_args()
    from taichi_sim.device import backend

    backend.start("cpu", given.precision, None)
    found = []
    for name in given.kinds.split(","):
        for row in rows(name, given.builds, given.starts, given.seed, given.integrator):
            found.append(row)
            if given.log:
                with open(given.log, "a") as file:
                    file.write(json.dumps(row._asdict()) + "\n")
    print(*table(found), sep="\n")


if __name__ == "__main__":
    main()
