"""A gas in two processes: each steps the balls of its half and a halo of the other's, and after each step sends its balls near
the cut. docs/scaling.md has what comes out.

    python -m tests.support.halo_exchange                    # how the difference from one process grows
    python -m tests.support.halo_exchange --again 100        # what is kept throughout: compared anew every 100 steps

Elastic balls in a box, by the package itself in each process. A message holds all balls of the sender near the cut, also
those that have crossed it: which side a ball is on says whose it is, so balls change hands without messages of their own.
"""

import argparse
import multiprocessing
from collections.abc import Iterator, Sequence
from contextlib import suppress
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

BALLS, CELLS = 10_000, (34, 17, 18)  # of a lattice in the box, on which the balls begin
BOX, CUT = np.array([2.0, 1.0, 1.0]), 1.0  # m; the cut is the plane x = CUT
RADIUS, MASS, DT = 0.0168, 1.0, 1e-3  # m, kg, s: a tenth of the box is filled, and a ball meets another every 25 steps
# The rule takes all contacts at once: in turn, the halves would take those of balls that touch several in another order than the
# whole. So many iterations keep the energy of three that meet in a step.
LAW: dict[str, Any] = {
    "integrator": "verlet", "dt": DT, "substeps": 1, "contacts": "jacobi", "contact_iterations": 32,
    "precision": "f64", "arch": "cpu",
}  # fmt: skip
# What changes a ball in a step is the cluster of touching balls that it is in: a halo holds those that reach over the cut whole
# where it is as many diameters wide as they are long.
LAYERS = 3
RECORD = np.dtype([("number", "i4"), ("x", "f8", 3), ("v", "f8", 3)])  # 52 bytes
SPARE = 1.5  # times half of the balls are places in a process
GROWTH = (1, 10, 20, 50, 100, 150, 200, 300, 400, 500)


def gas(seed: int) -> NDArray[Any]:
    """All balls (BALLS,) of RECORD, in a lattice shaken by as much as there is room."""
    rng = np.random.default_rng(seed)
    cell = BOX / CELLS
    lattice = np.stack(np.meshgrid(*map(np.arange, CELLS), indexing="ij"), -1).reshape(-1, 3)
    place = lattice[np.sort(rng.choice(len(lattice), BALLS, replace=False))]
    balls = np.zeros(BALLS, RECORD)
    balls["number"] = np.arange(BALLS)
    free = 0.5 * cell - 1.001 * RADIUS
    balls["x"] = (place + 0.5) * cell + free * rng.uniform(-1.0, 1.0, (BALLS, 3))
    balls["v"] = rng.normal(size=(BALLS, 3))
    return balls


def simulation(x: NDArray[np.float64], open_sides: tuple[int, ...] = (), threads: int | None = None) -> Any:
    """Balls at x in the box, without its wall at x = 0 (0) or at the other end (1) where that is open."""
    import taichi_sim as ts

    scene = ts.Scene(dim=3, gravity=(0.0, 0.0, 0.0))
    scene.add_material("elastic", restitution=1.0)
    scene.add_balls(x, radius=RADIUS, mass=MASS, material="elastic")
    for axis in range(3):
        for side, normal in enumerate((np.eye(3)[axis], -np.eye(3)[axis])):
            if axis or side not in open_sides:
                scene.add_wall(normal, -side * BOX[axis], "elastic")
                scene.add_probe(f"wall{axis}{side}", "impulse", wall=len(scene.walls) - 1)
    return ts.Simulation(scene, threads=threads, **LAW)


class Half:
    """The balls on one side of the cut: side 0 has x < CUT. halo: width [m] of what it knows of the other side."""

    def __init__(self, side: int, balls: NDArray[Any], halo: float, other: Any) -> None:
        self.side, self.halo_width, self.other = side, halo, other
        self.places = int(SPARE * BALLS / 2)
        # places without a ball wait in a row beyond the cut, where this half has no wall
        away = CUT + (2.0 + 4.0 * RADIUS * np.arange(self.places)) * (1 - 2 * side)
        self.waiting = np.stack([away, *np.full((2, self.places), 0.5)], axis=1)
        self.sim = simulation(self.waiting, (1 - side,), threads=1)
        self.own = balls[self._is_mine(balls)]
        self.halo = balls[~self._is_mine(balls) & self._is_near(balls)]
        self.sent = self.moved = 0  # bytes, and balls that came over

    def _is_mine(self, balls: NDArray[Any]) -> NDArray[np.bool_]:
        return (balls["x"][:, 0] < CUT) != bool(self.side)

    def _is_near(self, balls: NDArray[Any]) -> NDArray[np.bool_]:
        return np.abs(balls["x"][:, 0] - CUT) < self.halo_width

    def step(self) -> None:
        """One step of all that is known; what becomes of the halo is the other's to say."""
        known = np.concatenate([self.own, self.halo])
        if len(known) > self.places:
            raise RuntimeError(f"side {self.side}: {len(known)} balls, and places for {self.places}")
        x, v = self.waiting.copy(), np.zeros_like(self.waiting)
        x[: len(known)], v[: len(known)] = known["x"], known["v"]
        self.sim.set_position(x)
        self.sim.set_velocity(v)
        self.sim.step()
        self.own["x"], self.own["v"] = self.sim.position[: len(self.own)], self.sim.velocity[: len(self.own)]
        self.exchange()

    def exchange(self) -> None:
        """Balls near the cut go to the other half; who is on which side of it now says whose they are."""
        crossed = ~self._is_mine(self.own)
        message = self.own[crossed | self._is_near(self.own)].tobytes()
        if self.side == 0:  # one sends while the other one receives: a full pipe would stop two that send
            self.other.send_bytes(message)
        found = np.frombuffer(self.other.recv_bytes(), RECORD)
        if self.side == 1:
            self.other.send_bytes(message)
        come = self._is_mine(found)
        self.halo = np.concatenate([found[~come], self.own[crossed]])
        self.own = np.concatenate([self.own[~crossed], found[come]])
        self.sent += len(message)
        self.moved += int(come.sum())


def work(side: int, seed: int, halo: float, other: Any, parent: Any) -> None:
    """A process: steps as often as it is told, and says what it has; 0 steps end it."""
    half = Half(side, gas(seed), halo, other)
    while steps := parent.recv():
        half.sent = half.moved = 0
        for _ in range(steps):
            half.step()
        parent.send((half.own, len(half.halo), half.sent, half.moved))


class Comparison(NamedTuple):
    """After `step` steps, `since` of them since the whole was set to what the halves had."""

    step: int
    since: int
    x: float  # m, largest difference of a ball's place from the whole
    v: float  # m/s
    balls: int  # different numbers
    energy: float  # relative change of the halves' since the start
    momentum: float  # kg m/s, largest component of what they have less what they began with and walls gave
    halo: float  # balls, mean of the two, at this moment
    sent: float  # bytes a step and half, since the last comparison
    moved: float  # balls a step, in both directions


def compared(at: Sequence[int], again: bool = False, layers: int = LAYERS, seed: int = 1) -> Iterator[Comparison]:
    """Run the two, and the whole beside them in this process; compare after each of these numbers of steps. again: set the whole
    to what the halves have each time."""
    spawn = multiprocessing.get_context("spawn")
    between, said = spawn.Pipe(), [spawn.Pipe() for _ in range(2)]
    halo = 2.0 * RADIUS * layers
    halves = [
        spawn.Process(target=work, args=(side, seed, halo, between[side], said[side][1]), daemon=True)
        for side in range(2)
    ]
    for half in halves:
        half.start()
    for end in (*between, *(theirs for _, theirs in said)):
        end.close()  # so that a half that fails is an EOFError here, and for the other one
    start, done, begun = gas(seed), 0, 0
    try:
        with simulation(start["x"]) as whole:
            whole.set_velocity(start["v"])
            for step in at:
                for ours, _ in said:
                    ours.send(step - done)
                whole.step(step - done)
                found = [ours.recv() for ours, _ in said]
                balls = np.sort(np.concatenate([own for own, *_ in found]), order="number")
                halos, sent, moved = np.sum([more for _, *more in found], axis=0)
                each = len(balls) == BALLS and bool(np.all(balls["number"] == start["number"]))
                given = np.sum([whole.probe(probe.name) for probe in whole.scene.probes], axis=0)
                change = MASS * (balls["v"].sum(axis=0) - start["v"].sum(axis=0)) + given
                yield Comparison(
                    step,
                    step - begun,
                    float(np.abs(balls["x"] - whole.position).max()) if each else np.nan,
                    float(np.abs(balls["v"] - whole.velocity).max()) if each else np.nan,
                    len(np.unique(balls["number"])),
                    float(np.sum(balls["v"] ** 2) / np.sum(start["v"] ** 2) - 1.0),
                    float(np.abs(change).max()),
                    halos / 2,
                    sent / (2 * (step - done)),
                    moved / (step - done),
                )
                done = step
                if again:
                    begun = step
                    whole.set_position(balls["x"])
                    whole.set_velocity(balls["v"])
    finally:
        for (ours, _), half in zip(said, halves):
            with suppress(BrokenPipeError):  # it has failed, and said why
                ours.send(0)
            half.join()


def main() -> None:
    """Print the comparisons."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--again", type=int, metavar="STEPS", help="set the whole to what the halves have so often")
    parser.add_argument("--steps", type=int, default=1000, help="with --again, of the run")
    parser.add_argument("--layers", type=int, default=LAYERS, help="of contacts that a halo is wide")
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    at = GROWTH if given.again is None else range(given.again, given.steps + 1, given.again)
    print(" step  since   place m   speed m/s   balls    energy  momentum   halo  bytes/step  moved/step")
    for one in compared(at, given.again is not None, given.layers, given.seed):
        print(
            f"{one.step:5d}  {one.since:5d}  {one.x:8.1e}    {one.v:8.1e}  {one.balls:6d}  {one.energy:8.1e}  {one.momentum:8.1e}"
            f"  {one.halo:5.0f}  {one.sent:10.0f}  {one.moved:10.2f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
