"""What hard cases share: the verdict, and the simulation that they run in."""

import warnings
from collections.abc import Callable
from typing import Any, NamedTuple

from taichi_sim.scene import Scene
from taichi_sim.simulation import Simulation

__all__ = ["Case", "Verdict", "double", "rounding", "simulation"]

H = 1e-3  # s


class Verdict(NamedTuple):
    """What became of a case. figure: the number that its bound is about."""

    passed: bool
    figure: float
    words: str


class Case(NamedTuple):
    """A hard case; `bound` says what it must do to pass."""

    name: str
    bound: str
    run: Callable[[str, bool], Verdict]


def simulation(scene: Scene, contacts: str, **settings: Any) -> Simulation:
    """On the CPU, with what the process runs or double precision; warnings are the business of the case that is about them."""
    from taichi_sim import backend

    if backend.running() is None:
        backend.start("cpu", "f64")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return Simulation(scene, **{"dt": H, "contacts": contacts, "arch": "cpu", **settings})


def double(sim: Simulation) -> bool:
    return sim.backend.precision == "f64"


def rounding(sim: Simulation) -> float:
    """1e-9 in double precision, what rounding leaves in single."""
    return 1e-9 if double(sim) else 1e-5
