"""Probes: quantities that have a name, in SI units: what a scene file, Python, the summary, arrays and reports can ask for.

A kind is a class with the numbers it gives, `read`, and for totals that grow the means over the time since the last reading.
Everything is worked out in NumPy, in float64, from the state at the time of the reading; only the impulses on walls and
colliders are summed while steps are made, and only where a probe asks for them.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from taichi_sim.common import validation
from taichi_sim.common.errors import SceneError
from taichi_sim.scene.columns import Names
from taichi_sim.scene.strains import STRAINED, element_strains

__all__ = ["KINDS", "Probe", "ProbeSample", "Probed", "add", "bodies_of"]

Floats = NDArray[np.float64]
NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_-]*")


@dataclass(frozen=True, slots=True)
class ProbeSample:
    """The moment that probes read. torn: (m,) springs, or None. impulses: (b, dim) N s since the start, on `bodies_of`."""

    scene: Any
    x: Floats  # (n, dim) m
    v: Floats  # (n, dim) m/s
    torn: NDArray[np.bool_] | None
    energy: Callable[[], tuple[float, ...]]
    impulses: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Probe:
    """One probe of a scene. given: the arguments that it keeps, arrays or plain values."""

    name: str
    given: Mapping[str, Any]

    kind: ClassVar[str]
    takes: ClassVar[tuple[str, ...]] = ()
    units: ClassVar[Mapping[str, str]]  # of each number by its name
    vector: ClassVar[bool] = False  # its numbers are x, y, z and the magnitude of them
    start: ClassVar[bool] = False  # they have no zero of their own: what counts is how far they are from the start

    @classmethod
    def make(cls, scene: Any, name: str, asked: Mapping[str, Any]) -> Probe:
        """Judge the arguments, those that were given. Raises SceneError."""
        return cls(name, dict(asked))

    def numbers(self, dim: int) -> tuple[str, ...]:
        """Names of its numbers."""
        return (*"xyz"[:dim], "magnitude") if self.vector else tuple(self.units)

    def unit(self, number: str) -> str:
        """Unit of a number; empty where it is a plain one."""
        return next(iter(self.units.values())) if self.vector else self.units[number]

    def read(self, sample: ProbeSample) -> dict[str, float]:
        """The numbers that belong to the moment."""
        raise NotImplementedError

    def held_by(self, scene: Any) -> str:
        """Words on why it never changes in a scene; empty where it may."""
        return ""

    def total(self, sample: ProbeSample) -> Floats | None:
        """Total that has grown since the start, of which the probe gives means; None where it gives none."""
        return None

    def mean(self, growth: Floats, interval: float) -> dict[str, float]:
        """The numbers that are means: from the growth of `total` per second, over an interval [s]."""
        return {}


def _vector(values: Floats) -> dict[str, float]:
    """x, y, z and the magnitude."""
    return {**dict(zip("xyz", values.tolist())), "magnitude": float(np.linalg.norm(values))}


class Position(Probe):
    """Mean position of balls."""

    kind, takes, vector, units = "position", ("balls", "at"), True, {"": "m"}
    start = True

    @classmethod
    def make(cls, scene: Any, name: str, asked: Mapping[str, Any]) -> Probe:
        one = _only_one(cls.kind, asked)
        if one == "at":
            away = scene.position - validation.vector("probes.at", asked["at"], scene.dim)
            if not scene.n_balls:
                raise SceneError("probes.at", says="the scene has no ball yet; add the probe after the balls")
            return cls(name, {"balls": np.array([np.argmin(np.sum(away**2, axis=1))], dtype=np.int32)})
        return cls(name, {"balls": _balls(scene, asked["balls"])})

    def read(self, sample: ProbeSample) -> dict[str, float]:
        return _vector(sample.x[self.given["balls"]].mean(axis=0))

    def held_by(self, scene: Any) -> str:
        return "all its balls are pinned" if _at_rest(scene, self.given["balls"]) else ""


class Length(Probe):
    """Length of a spring, torn or not."""

    kind, takes, units, start = "length", ("spring", "at"), {"length": "m"}, True

    @classmethod
    def make(cls, scene: Any, name: str, asked: Mapping[str, Any]) -> Probe:
        one = _only_one(cls.kind, asked)
        if not scene.n_springs:
            parts = {"triangles": scene.membranes, "bricks": scene.bricks, "solids": scene.solids}
            made = [what for what, some in parts.items() if len(some)]
            says = "the scene has no spring yet; add the probe after the springs"
            if made:
                says = (
                    f"the scene is made of {' and '.join(made)}, which are no springs; a {cls.kind} is that of a spring"
                )
            raise SceneError(f"probes.{one}", says=says)
        if one == "at":
            away = scene.position[scene.pairs].mean(axis=1) - validation.vector("probes.at", asked["at"], scene.dim)
            return cls(name, {"spring": int(np.argmin(np.sum(away**2, axis=1)))})
        return cls(name, {"spring": validation.whole("probes.spring", asked["spring"], 0, scene.n_springs - 1)})

    def read(self, sample: ProbeSample) -> dict[str, float]:
        i, j = sample.scene.pairs[self.given["spring"]]
        return {"length": float(np.linalg.norm(sample.x[j] - sample.x[i]))}

    def held_by(self, scene: Any) -> str:
        spring = self.given["spring"]
        if any(spring in motor.springs for motor in scene.motors) or not _at_rest(scene, scene.pairs[spring]):
            return ""
        return f"both ends of spring {spring} are pinned"


class Tension(Length):
    """The force that a spring carries, k (L - L0) + c dL/dt, positive where it pulls; 0 once it has torn."""

    kind, units, start = "tension", {"tension": "N"}, False

    def read(self, sample: ProbeSample) -> dict[str, float]:
        scene, k = sample.scene, self.given["spring"]
        i, j = scene.pairs[k]
        r = sample.x[j] - sample.x[i]
        length = float(np.linalg.norm(r))
        if sample.torn is not None and sample.torn[k]:
            return {"tension": 0.0}
        rate = float((sample.v[j] - sample.v[i]) @ r) / length if length > 0 else 0.0
        return {"tension": float(scene.stiffness[k] * (length - scene.rest_length[k]) + scene.damping[k] * rate)}


class Strain(Probe):
    """Strains of what is whole: (length - rest) / rest of springs that have a rest length, and of triangles, bricks and solids
    the principal strain that is largest in amount. The largest, the least, the mean."""

    kind, takes, units = "strain", ("springs", "balls"), {"max": "", "min": "", "mean": ""}

    @classmethod
    def make(cls, scene: Any, name: str, asked: Mapping[str, Any]) -> Probe:
        if not asked:
            return cls(name, {})
        if _only_one(cls.kind, asked) == "springs":
            return cls(name, {"springs": _several("spring", asked["springs"], scene.n_springs)})
        balls = _balls(scene, asked["balls"])
        strained = (scene.pairs, *(element.corners(scene) for element in STRAINED))
        if not any(np.isin(k, balls).all(axis=1).any() for k in strained):
            says = "no spring, triangle, brick or solid lies between them; there is no strain to measure"
            raise SceneError("probes.balls", says=says)
        return cls(name, {"balls": balls})

    def read(self, sample: ProbeSample) -> dict[str, float]:
        scene, balls = sample.scene, self.given.get("balls")
        counts = scene.rest_length > 0
        if sample.torn is not None:
            counts &= ~sample.torn
        chosen = self.given.get("springs", np.arange(scene.n_springs))
        chosen = chosen[counts[chosen]]
        i, j = scene.pairs[chosen].T
        stretch = np.linalg.norm(sample.x[j] - sample.x[i], axis=1) / scene.rest_length[chosen] - 1.0
        parts = [(scene.pairs[chosen], stretch)]
        if "springs" not in self.given:
            parts += element_strains(scene, sample.x, sample.torn)
        strain = np.concatenate([one if balls is None else one[np.isin(k, balls).all(axis=1)] for k, one in parts])
        if not len(strain):
            return dict.fromkeys(self.units, np.nan)
        return {"max": float(strain.max()), "min": float(strain.min()), "mean": float(strain.mean())}


class Energy(Probe):
    """Energy of the whole scene, as `Simulation.energy`."""

    kind, units = "energy", dict.fromkeys(("kinetic", "spring", "gravity", "total"), "J")

    def read(self, sample: ProbeSample) -> dict[str, float]:
        return dict(zip(self.units, map(float, sample.energy())))


class Impulse(Probe):
    """All that balls have given a wall or a collider since the start by pressing, hitting and rubbing."""

    kind, takes, vector, units = "impulse", ("wall", "collider"), True, {"": "N s"}

    @classmethod
    def make(cls, scene: Any, name: str, asked: Mapping[str, Any]) -> Probe:
        one = _only_one(cls.kind, asked)
        many = {"wall": scene.walls, "collider": scene.colliders}[one]
        if not many:
            raise SceneError(f"probes.{one}", says=f"the scene has no {one} yet; add the probe after it")
        return cls(name, {one: validation.whole(f"probes.{one}", asked[one], 0, len(many) - 1)})

    @property
    def body(self) -> tuple[str, int]:
        """wall or collider, and its number."""
        return next(iter(self.given.items()))

    def read(self, sample: ProbeSample) -> dict[str, float]:
        return _vector(sample.impulses[bodies_of(sample.scene).index(self.body)])


class Force(Impulse):
    """The mean force of that since the last reading, and the interval of that mean: their product is the impulse. Frames are an
    interval of whole steps apart, so that 1 / fps is not it."""

    kind, units = "force", {"": "N"}

    def numbers(self, dim: int) -> tuple[str, ...]:
        return (*Impulse.numbers(self, dim), "interval")

    def unit(self, number: str) -> str:
        return "s" if number == "interval" else "N"

    def read(self, sample: ProbeSample) -> dict[str, float]:
        return {}

    def total(self, sample: ProbeSample) -> Floats:
        return sample.impulses[bodies_of(sample.scene).index(self.body)]

    def mean(self, growth: Floats, interval: float) -> dict[str, float]:
        return {**_vector(growth), "interval": interval}


class Flux(Probe):
    """Balls, and their mass, that have gone through a plane along its normal since the start, those that came back taken off;
    and both per second, since the last reading."""

    kind, takes = "flux", ("normal", "offset", "balls")
    units: ClassVar = {"count": "", "mass": "kg", "count_rate": "1/s", "mass_rate": "kg/s"}

    @classmethod
    def make(cls, scene: Any, name: str, asked: Mapping[str, Any]) -> Probe:
        if "normal" not in asked:
            raise SceneError("probes.normal", says="is missing; a flux needs the direction in which it counts")
        normal = validation.direction("probes.normal", asked["normal"], scene.dim)
        length = float(np.linalg.norm(normal))
        given: dict[str, Any] = {
            "normal": normal.tolist() if abs(length - 1.0) < 4e-16 else (normal / length).tolist(),
            "offset": validation.number("probes.offset", asked.get("offset", 0.0)),
        }
        if "balls" in asked:
            given["balls"] = _balls(scene, asked["balls"])
            numbers, times = np.unique(given["balls"], return_counts=True)
            if times.max() > 1:  # it would be counted so often
                says = f"ball {numbers[times.argmax()]} is named {times.max()} times; name each once"
                raise SceneError("probes.balls", says=says)
        return cls(name, given)

    def total(self, sample: ProbeSample) -> Floats:
        chosen = self.given.get("balls", slice(None))
        normal, mass = np.array(self.given["normal"]), sample.scene.mass[chosen]
        before, now = (x[chosen] @ normal > self.given["offset"] for x in (sample.scene.position, sample.x))
        through = now.astype(float) - before
        return np.array([through.sum(), through @ mass])

    def read(self, sample: ProbeSample) -> dict[str, float]:
        return dict(zip(("count", "mass"), self.total(sample).tolist()))

    def mean(self, growth: Floats, interval: float) -> dict[str, float]:
        return dict(zip(("count_rate", "mass_rate"), growth.tolist()))


KINDS: dict[str, type[Probe]] = {
    kind.kind: kind for kind in (Position, Length, Tension, Strain, Energy, Force, Impulse, Flux)
}


def add(scene: Any, name: str, kind: str, asked: Mapping[str, Any]) -> Probe:
    """A probe with the arguments that were given. Raises SceneError that names the argument and what is allowed."""
    if not isinstance(name, str) or not NAME.fullmatch(name):
        raise SceneError("probes.name", name, "a word of letters, digits, _ and -")
    if scene.probe_names.number(scene.probes, name) is not None:
        raise SceneError("probes.name", name, says="exists already; every probe needs its own name")
    validation.one_of("probes.kind", kind, KINDS)
    made = KINDS[kind]
    for key in asked:
        if key not in made.takes:
            allowed = f"it takes {' or '.join(made.takes)}" if made.takes else "it takes nothing more"
            raise SceneError(f"probes.{key}", says=f"is not for the kind {kind!r}; {allowed}")
    return made.make(scene, name, asked)


def _only_one(kind: str, asked: Mapping[str, Any]) -> str:
    """The one argument of those that stand for each other."""
    takes = KINDS[kind].takes
    if not asked:
        raise SceneError("probes.kind", says=f"the kind {kind!r} needs {' or '.join(takes)}")
    if len(asked) > 1:
        raise SceneError(f"probes.{list(asked)[1]}", says=f"{' and '.join(asked)} are given; give one of them")
    return next(iter(asked))


def _at_rest(scene: Any, balls: NDArray[np.int32]) -> bool:
    """True if balls (k,) are all pinned where they are."""
    driven = [pins.balls for pins in scene.moving_pins]
    return bool(scene.pinned[balls].all()) and not any(np.isin(balls, one).any() for one in driven)


def _balls(scene: Any, value: ArrayLike) -> NDArray[np.int32]:
    return _several("ball", value, scene.n_balls)


def _several(what: str, value: ArrayLike, n: int) -> NDArray[np.int32]:
    """Numbers of balls or springs; one by itself needs no list."""
    where = f"probes.{what}s"
    found = validation.indices(where, [value] if isinstance(value, (int, np.integer)) else value, n, what=what)  # type: ignore
    if not len(found):
        raise SceneError(where, says=f"is empty; name at least one {what}")
    return found


def bodies_of(scene: Any) -> list[tuple[str, int]]:
    """The walls and colliders whose impulses are asked for."""
    return list(dict.fromkeys(probe.body for probe in scene.probes if isinstance(probe, Impulse)))


class Probed:
    """The part of a Scene that holds its probes."""

    probes: list[Probe]

    def _begin_probes(self) -> None:
        self.probe_names = Names()

    def add_probe(
        self: Any,
        name: str,
        kind: str,
        *,
        balls: ArrayLike | None = None,
        spring: int | None = None,
        springs: ArrayLike | None = None,
        at: ArrayLike | None = None,
        wall: int | None = None,
        collider: int | None = None,
        normal: ArrayLike | None = None,
        offset: float | None = None,
    ) -> str:
        """Name a quantity, for `Simulation.probe`, arrays, the summary and reports, and return its name. It costs what reading it
        takes; force and impulse a sum in each step besides. What it is of is counted when it is added.

        Args:
            name: a word of letters, digits, _ and -.
            kind: what is measured:
                "position" of `balls`, their mean, or of the ball nearest to the point `at` [m] now: x, y, z, magnitude [m].
                "length" [m] and "tension" [N] of `spring`, or of that whose middle is nearest to `at`. The tension is the force
                that it carries, k (L - L0) + c dL/dt: elastic and damping force, positive where it pulls; 0 once torn.
                "strain" of `springs`, or of all springs, triangles, bricks and solids between `balls` or in the scene: max, min,
                mean. That of a spring is (L - L0) / L0, of the others the largest principal strain in amount, of a brick at its
                centre.
                "energy" of the whole scene: kinetic, spring, gravity, total [J].
                "force" [N] on `wall` or `collider`, the mean since the probe was last read, and "impulse" [N s], since the start:
                x, y, z, magnitude of what balls gave it by pressing, hitting and friction.
                "flux" through the plane normal . x = offset, of `balls` or of all: count and mass [kg] that have gone along
                the normal since the start, less what came back; count_rate [1/s], mass_rate [kg/s] since the last reading.
            balls: (k,) that are meant; spring: number of one; springs: (k,) numbers.
            at: (dim,) a point near what is meant [m].
            wall: number of one; collider: number of one.
            normal: (dim,) of a plane [1]; offset: of the plane along it [m].
        """
        asked = {
            "balls": balls,
            "spring": spring,
            "springs": springs,
            "at": at,
            "wall": wall,
            "collider": collider,
            "normal": normal,
            "offset": offset,
        }
        given = {key: value for key, value in asked.items() if value is not None}
        self.probes.append(add(self, name, kind, given))
        return name
