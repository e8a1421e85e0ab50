"""Gases: closed surfaces of triangles that press outward, the more the smaller they are."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from taichi_sim.common import validation
from taichi_sim.common.errors import SceneError
from taichi_sim.geometry.mesh import sides
from taichi_sim.scene.columns import sealed
from taichi_sim.scene.part import Element, Listed, Quadratic

__all__ = ["GASES", "Gas", "GasMethods", "enclosed"]

Floats = NDArray[np.float64]
ROOM = 2.0  # times the stiffness at the present volume


@dataclass(frozen=True, slots=True, eq=False)
class Gas:
    """Gas in a closed surface: (pressure + outside) V = const against `outside`."""

    triangles: NDArray[np.int32]  # (t, 3) balls, counter-clockwise from outside
    pressure: float  # Pa, over that outside, at the volume of the start
    outside: float  # Pa
    volume: float  # m^3, at the start


class GasMethods:
    """The part of a Scene that holds gases."""

    gases: list[Gas]

    def add_gas(
        self: Any, triangles: ArrayLike, *, pressure: float, outside: float = 0.0, volume: float | None = None
    ) -> None:
        """Fill a closed surface with gas: (pressure + outside) times the volume stays what it is at the start.

        Args:
            triangles: (t, 3) balls, counter-clockwise seen from outside, that enclose a volume without a hole.
            pressure: over that outside, at `volume` [Pa]; negative where the gas is thinner, at least -outside, a vacuum.
            outside: pressure around it [Pa]. With 0 outside the gas is as soft as it can be; air at 101325 Pa hardly lets the
                volume change, and wants short steps.
            volume: at which it has this pressure [m^3]; None: the present one.
        """
        if self.dim != 3:
            says = "fills closed surfaces of triangles, in a scene with dim = 3; this one has dim = 2"
            raise SceneError("gases", says=says)
        t = validation.indices("gases.triangles", triangles, self.n_balls, width=3)
        edges = sides(t).astype(np.int64)
        forth, back = edges @ [self.n_balls, 1], edges @ [1, self.n_balls]
        _, places, times = np.unique(forth, return_index=True, return_counts=True)
        wrong = np.union1d(np.flatnonzero(~np.isin(forth, back)), places[times > 1])
        if not len(t) or len(wrong):
            start, end = edges[wrong[0]] if len(t) else (0, 0)
            many = np.count_nonzero((forth == forth[wrong[0]]) | (back == forth[wrong[0]])) if len(t) else 0
            where = f": the edge from ball {start} to {end} has {'one' if many == 1 else many}" if len(t) else ""
            says = f"must close a volume, with two triangles, turned alike, at every edge{where}"
            raise SceneError("gases.triangles", says=says)
        present = enclosed(self.position, t)
        if present <= 0.0:
            says = f"enclose {present:.4g} m^3; give them counter-clockwise seen from outside"
            raise SceneError("gases.triangles", says=says)
        around = validation.number("gases.outside", outside, low=0)
        p = validation.number("gases.pressure", pressure)
        if p < -around:
            allowed = f"at least {-around:g}, a vacuum"
            cure = "; give the pressure around it as outside, over which this one is" if around == 0.0 else ""
            raise SceneError("gases.pressure", p, allowed + cure)
        first = present if volume is None else validation.number("gases.volume", volume, positive=True)
        self.gases.append(sealed(Gas(t, p, around, first)))


class _Gases(Listed, Element):
    name, method, counted = "gases", "add_gas", ("triangles",)
    gives_energy = True  # as far as the energy monitor knows, which does not count it: it may be negative
    keys = ("triangles", "pressure", "outside", "volume")

    def corners(self, scene: Any) -> NDArray[np.int32]:
        return np.concatenate([np.zeros((0, 3), dtype=np.int32), *(gas.triangles for gas in scene.gases)])

    def energies(self, scene: Any, x: Floats, whole: NDArray[np.bool_]) -> list[float]:
        """0 at the first volume. Its surface does not tear, see `check_tearing`."""
        terms = []
        for gas in scene.gases:
            now = enclosed(x, gas.triangles) / gas.volume
            inside = (gas.pressure + gas.outside) * gas.volume
            terms.append(gas.outside * gas.volume * (now - 1.0))
            if inside:
                terms.append(-inside * float(np.log(now)) if now > 0 else np.inf)
        return terms

    def stiffness(self, scene: Any) -> list[Quadratic]:
        """Quadratic forms by the gradient of the present volume."""
        found = []
        for gas in scene.gases:
            balls = np.unique(gas.triangles)
            strength = ROOM * (gas.pressure + gas.outside) / gas.volume
            gradient = volume_gradient(scene.position, gas.triangles)[balls][None]
            found.append(Quadratic(balls[None], gradient, np.array([strength])))
        return found

    def further_rates(self, scene: Any) -> tuple[float, float]:
        """Rates of the pressure, which turns with the surface: p times the edges at a ball over six."""
        root, press = np.where(scene.pinned, 0.0, 1.0 / np.sqrt(scene.mass)), 0.0
        for gas in scene.gases:
            x, t = scene.position, gas.triangles
            edge = np.linalg.norm(x[np.roll(t, -1, axis=1)] - x[t], axis=2)  # from corner k to the next
            length = np.bincount(t.ravel(), (edge + np.roll(edge, 1, axis=1)).ravel(), scene.n_balls)
            press += float((abs(gas.pressure) * length / 6.0 * root).max()) * float(root.max())
        return press, 0.0


GASES = _Gases()


def enclosed(x: Floats, triangles: NDArray) -> float:
    """Volume [m^3] in a closed surface of triangles (t, 3) of the balls at x (n, 3)."""
    a, b, c = (x[triangles[:, k]] - x[triangles[0, 0]] for k in range(3))
    return float(np.einsum("ti,ti->", a, np.cross(b, c))) / 6.0


def volume_gradient(x: Floats, triangles: NDArray) -> Floats:
    """dV/dx (n, 3) [m^2] of the volume in a closed surface of triangles (t, 3) of the balls at x (n, 3)."""
    t = triangles
    area = np.cross(x[t[:, 1]] - x[t[:, 0]], x[t[:, 2]] - x[t[:, 0]]) / 6.0
    sums = [np.bincount(t.ravel(), np.repeat(area[:, a], 3), len(x)) for a in range(3)]
    return np.stack(sums, axis=1).astype(np.float64)
