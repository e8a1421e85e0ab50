"""Parts that hard cases share: the verdict, the table of them, and the simulation that they run in."""

import warnings
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from taichi_sim.analysis.methods import named
from taichi_sim.analysis.stability import stability
from taichi_sim.device import backend
from taichi_sim.scene.scene import Scene
from taichi_sim.simulation.simulation import Simulation

G = 10.0  # m/s^2
H = 1e-3  # s


class Verdict(NamedTuple):
    """Verdict on a case. figure: the number that its bound is about; refused: a warning or an error came before step 1."""

    passed: bool
    figure: float
    words: str
    refused: bool = False


class Case(NamedTuple):
    """A hard case; `bound` says what it must do to pass. run: of a column's name, and whether in its short form."""

    name: str
    bound: str
    run: Callable[[str, bool], Verdict]


class RefusedError(Exception):
    """Refusal of a simulation before its first step, in words, and the safe step [s]."""

    def __init__(self, words: str, safe: float) -> None:
        super().__init__(words)
        self.safe = safe


def judge(case: Case, column: str, short: bool = False) -> Verdict:
    """The verdict on a case; one that ends with an error, or without a finite figure, has failed."""
    try:
        verdict = case.run(column, short)
    except RefusedError as refusal:
        safe = np.isfinite(refusal.safe)
        return Verdict(False, refusal.safe, "s is the safe step" if safe else str(refusal), refused=True)
    except Exception as error:
        return Verdict(False, float("nan"), f"{type(error).__name__}: {error}")
    return verdict._replace(passed=verdict.passed and bool(np.isfinite(verdict.figure)))


def show(title: str, cases: Sequence[Case], columns: Sequence[str]) -> bool:
    """Judge all cases in all columns, and print each verdict as it is known. False when a case passed in none."""
    from rich.console import Console

    console = Console(soft_wrap=True, highlight=False)
    console.print(f"[bold]{title}[/]")
    good = True
    for case in cases:
        console.print(f"\n{case.name}: {case.bound}")
        passed = False
        for column in columns:
            verdict = judge(case, column)
            mark = "[yellow]refuses[/]" if verdict.refused else "[red]FAIL[/]   "
            console.print(
                f"  {column:16} {'[green]pass[/]   ' if verdict.passed else mark} {verdict.figure:.3g} ", end=""
            )
            console.print(verdict.words, markup=False)
            passed = passed or verdict.passed
        good = good and passed
    return good


def simulation(scene: Scene, contacts: str, **settings: Any) -> Simulation:
    """Simulation on the CPU, with what the process runs or double precision; warnings are the business of the case that is
    about them."""
    _start()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return Simulation(scene, **{"dt": H, "contacts": contacts, "arch": "cpu", **settings})


def heeding(scene: Scene, integrator: str, **settings: Any) -> Simulation:
    """Simulation on the CPU by a method, dt "auto" if none is given. Raises RefusedError for a warning, or where a
    simulation finds no step."""
    _start()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", UserWarning)
            # these cases are about methods; what single precision rounds off is said of each
            warnings.filterwarnings("ignore", message="precision: ", category=UserWarning)
            return Simulation(scene, integrator=integrator, arch="cpu", **settings)
    except (UserWarning, ValueError) as words:
        raise RefusedError(str(words), stability(scene, named(integrator)).dt_any_shape) from words


def _start() -> None:
    if backend.running() is None:
        backend.start("cpu", "f64")


def largest(sim: Simulation, seconds: float, times: int, *figures: Callable[[], Any]) -> list[Any]:
    """The largest value of each figure, or of each of its entries, at so many moments in the next `seconds`."""
    seen = []
    for _ in range(times):
        sim.run(seconds / times)
        seen.append([figure() for figure in figures])
    return [np.max(values, axis=0) for values in zip(*seen)]


def energy_part(sim: Simulation) -> Callable[[], float]:
    """A figure: the total energy as a part of what it is now."""
    start = sim.energy().total
    return lambda: sim.energy().total / start


def on_floor(dim: int = 2, offset: float = 0.0, **material: Any) -> Scene:
    """Gravity, and a wall under all; "it" is the material that it is of."""
    scene = Scene(dim=dim, gravity=(0.0, -G, 0.0)[:dim])
    scene.add_material("it", **material)
    scene.add_wall((0.0, 1.0, 0.0)[:dim], offset, "it")
    return scene


def double(sim: Simulation) -> bool:
    return sim.backend.precision == "f64"


def rounding(sim: Simulation) -> float:
    """1e-9 in double precision, what rounding leaves in single."""
    return 1e-9 if double(sim) else 1e-5
