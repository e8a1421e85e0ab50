"""Methods: what can be said of each way of stepping before anything runs, declared once. No Taichi.

An integrator carries its declaration as `method`; whatever judges steps, energies or damping takes that object and asks it.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from taichi_sim.analysis.damping import decay, lone, predicts_damping, softened, stages
from taichi_sim.analysis.limits import (
    DampedKickLimit,
    ExplicitEulerLimit,
    ImplicitLimit,
    RungeKuttaLimit,
    SmallMotionLimit,
    StabilityLimit,
)
from taichi_sim.scene.elements import ELEMENTS
from taichi_sim.scene.gases import GASES
from taichi_sim.scene.part import Element
from taichi_sim.scene.scene import Scene

__all__ = [
    "BUILT_IN_METHODS",
    "BUILT_IN_RULES",
    "EXPLICIT_EULER",
    "GAMMA",
    "IMPLICIT_EULER",
    "MOST_TURNED_BACK",
    "RK4",
    "SYMPLECTIC_EULER",
    "TR_BDF2",
    "VERLET",
    "XPBD",
    "Method",
    "named",
]

GAMMA = 2.0 - float(
    np.sqrt(2.0)
)  # first part of a step of TR-BDF2; then both stages have like matrices (Bank et al. 1985)
# rad by which the turn that TR-BDF2 gives back to a free body leads it on in a step: by more, what turned by 3 gained energy
MOST_TURNED_BACK = 0.1

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Method:
    """Declared properties of a method. Only the name is required; a property that is not declared is not claimed.

    `order`: of convergence of the phase-space error for smooth scenes. `limit`: of its step, None where that is not known: then
    a simulation needs a number as dt. `symplectic`: small motion keeps an energy near the true one, but large motion of
    undamped springs resonates with the step, so that automatic steps are shorter there. `conserves`: it damps nothing of its
    own. `contact_solves`: in a step, each for its part of the load. `solves_gas`: together with springs. `solves_elements`: the
    same for elements that give their derivatives. `single_pass`: each spring gives once in a step, or by halves in two
    passes, what it would if it were alone. `contacts_follow`: springs are solved before it knows of contacts.
    `holds_at_surfaces`: but not before those with walls and colliders. `swing_power`: of the elastic part of the energy, with
    which `swing` grows. `stage`: length of an implicit one, in steps.

    A method that can say more overrides the functions below:

        class MyMethod(Method):
            def amplification(self, scene, omega, d, h):
                return np.array([[1.0, h], [-h * omega**2, 1.0 - h * d]])
    """

    name: str
    order: int = 0
    limit: StabilityLimit | None = None
    symplectic: bool = False
    conserves: bool = False
    contact_solves: int = 1
    solves_gas: bool = False
    solves_elements: bool = False
    single_pass: bool = False
    contacts_follow: bool = False
    holds_at_surfaces: bool = False
    swing_power: float = 1.0
    stage: float = 1.0

    def __str__(self) -> str:
        return self.name

    @property
    def iterates(self) -> bool:
        """True if it solves equations in each step, to a residual that depends on the precision."""
        return self.solves_elements and not self.single_pass

    def solved(self, scene: Scene) -> tuple[Element, ...]:
        """The scene's elements that do not limit the step, as the method solves for them together with springs."""
        elements = [one for one in ELEMENTS if self.solves_elements and one.is_implicit and one.acts(scene)]
        with_gas = self.solves_gas and (scene.n_springs > 0 or len(elements) > 0)
        return (*elements, *((GASES,) if with_gas else ()))

    def amplification(self, scene: Scene, omega: float, d: float, h: float) -> Floats | None:
        """The matrix by which a step of h seconds takes on place and velocity, and what else the method remembers, of
        q'' + d q' + omega^2 q = 0; None where it is not known."""
        return None

    def turning_loss(self, speed: float, h: float) -> float:
        """Part of its angular momentum [1/s] that a body loses which turns at a speed [rad/s]."""
        return 0.0

    def keeps_free_turns(self, speed: float | Floats, h: float) -> NDArray[np.bool_]:
        """True where bodies that nothing holds lose nothing all the same; they turn at these speeds [rad/s]."""
        return np.zeros(np.shape(speed), dtype=np.bool_)

    def precedes_contacts(self, scene: Scene, h: float) -> bool:
        """True if springs, or their damping, are solved before it knows of contacts of balls in steps of h seconds."""
        return self.contacts_follow

    def spring_damping(self, scene: Scene, h: float) -> Floats:
        """(m,) N s/m of springs as steps of h seconds take it."""
        return scene.damping

    def swing(self, part: float) -> float:
        """Largest over least kinetic plus elastic energy of one oscillation, at a part of the bound."""
        return 1.0

    def why_energy_grows(self) -> str:
        """The reason in words why it may give energy to springs where nothing acts; empty where there is none."""
        return f"{self} goes through the springs twice in a step and leaves them stretched" if self.single_pass else ""

    def passes(self, scene: Scene, h: float) -> int:
        """Number of times that a step of h seconds goes through the springs; of methods that iterate, the least."""
        return 1

    def damping_cure(self, omega: float, allowed: float) -> str:
        """Advice where the decay of a motion of omega [1/s] is off by more than `allowed` [1/s]."""
        return f"take shorter steps, {VERLET} or {TR_BDF2}"


def _linear(omega: float, d: float) -> Floats:
    """A of d(q, v)/dt = A (q, v)."""
    return np.array([[0.0, 1.0], [-(omega**2), -d]])


class _ExplicitEuler(Method):
    def amplification(self, scene: Scene, omega: float, d: float, h: float) -> Floats:
        return np.asarray(np.eye(2) + h * _linear(omega, d), dtype=np.float64)

    def why_energy_grows(self) -> str:
        """Gain of the method in a step of h seconds, m a^2 h^2 / 2 for a ball of acceleration a."""
        return f"{self} adds m a^2 dt^2 / 2 to a ball of acceleration a in each step, also in free fall"


class _SymplecticEuler(Method):
    def amplification(self, scene: Scene, omega: float, d: float, h: float) -> Floats:
        k = omega**2
        return np.array([[1.0 - h * h * k, h * (1.0 - h * d)], [-h * k, 1.0 - h * d]])

    def swing(self, part: float) -> float:
        """Swing of the energy where a step keeps v^2 + w^2 x^2 - h w^2 x v."""
        return (1.0 + part) / (1.0 - part)


class _Verlet(Method):
    def amplification(self, scene: Scene, omega: float, d: float, h: float) -> Floats:
        """Matrix of a step. Damping at predicted velocities adds the acceleration of the step before; else it is the kick
        between two drifts, and a drift."""
        k = omega**2
        if predicts_damping(scene):
            drift = np.array([[1.0, h, 0.5 * h * h], [0.0, 1.0, 0.5 * h]])  # the place, the velocity in the middle
            pull = -k * drift[0] - d * np.array([0.0, 1.0, h])
            return np.array([drift[0], drift[1] + 0.5 * h * pull, pull])
        left, gone = 1.0, h  # the part that both halves leave, and (1 - R) / d
        if d != 0.0:
            z = np.array([0.5 * h * d])
            alone = not np.any((scene.damping > 0) & ~lone(scene))
            left = float(np.exp(-2.0 * z[0]) if alone else decay(stages(scene, 0.5 * h), z)[0])
            gone = (1.0 - left) / d
        return np.array([[1.0 - h * k * gone, h * left], [-k * gone, left]])

    def spring_damping(self, scene: Scene, h: float) -> Floats:
        """Damping (m,) [N s/m] as steps take it; of networks that are strongly damped, as far as the stages reach."""
        if predicts_damping(scene):
            return scene.damping
        return np.where(lone(scene), scene.damping, softened(scene, 0.5 * h))

    def precedes_contacts(self, scene: Scene, h: float) -> bool:
        """True for damping so strong that it takes several stages in half a step of h seconds."""
        return self.passes(scene, h) > 2

    def swing(self, part: float) -> float:
        """Swing of the energy where a step keeps v^2 + w^2 x^2 (1 - s^2), s = w h / 2."""
        return 1.0 / (1.0 - part**2)

    def passes(self, scene: Scene, h: float) -> int:
        """One for each stage of strong damping."""
        if np.any((scene.damping > 0) & ~lone(scene)) and not predicts_damping(scene):
            return sum(len(half) for half in stages(scene, 0.5 * h))
        return 1

    def damping_cure(self, omega: float, allowed: float) -> str:
        """Advice for strong damping, the only one that can be off."""
        return f"stages for damping this strong have an end; take {TR_BDF2}, or less damping"


class _RungeKutta(Method):
    def amplification(self, scene: Scene, omega: float, d: float, h: float) -> Floats:
        one, A = np.eye(2), _linear(omega, d)
        whole = one + h * A @ (one + h * A @ (one + h * A @ (one + h * A / 4.0) / 3.0) / 2.0)
        return np.asarray(whole, dtype=np.float64)

    def passes(self, scene: Scene, h: float) -> int:
        return 4


@dataclass(frozen=True)
class _BackwardEuler(Method):
    """iterations: that a step takes, over springs, at the least."""

    iterations: int = 1

    def amplification(self, scene: Scene, omega: float, d: float, h: float) -> Floats:
        """xpbd: where springs are soft enough for a single pass."""
        return np.asarray(np.linalg.inv(np.eye(2) - h * _linear(omega, d)), dtype=np.float64)

    def turning_loss(self, speed: float, h: float) -> float:
        """h W^2, see analysis.turning; for long steps as an oscillation of the frequency W loses it."""
        return float(np.log1p((speed * h) ** 2)) / h

    def passes(self, scene: Scene, h: float) -> int:
        return self.iterations if scene.n_springs else 1

    def damping_cure(self, omega: float, allowed: float) -> str:
        short = 2.0 * allowed / omega**2
        return f"{self} damps by omega^2 h / 2 of its own; take {TR_BDF2}, or steps of {short:.2g} s"


class _TRBDF2(Method):
    def amplification(self, scene: Scene, omega: float, d: float, h: float) -> Floats:
        one, A = np.eye(2), _linear(omega, d)
        part = 0.5 * GAMMA * h
        middle = np.linalg.solve(one - part * A, one + part * A)
        weight = float(1.0 / (GAMMA * (2.0 - GAMMA)))
        end = np.linalg.solve(one - part * A, weight * middle + (1.0 - weight) * one)
        return np.asarray(end, dtype=np.float64)

    def turning_loss(self, speed: float, h: float) -> float:
        """h^3 W^4 / 40, see analysis.turning."""
        return float((speed * h) ** 4) / (40.0 * h)

    def keeps_free_turns(self, speed: float | Floats, h: float) -> NDArray[np.bool_]:
        """True where a step loses no more than it may give back."""
        return np.asarray((np.asarray(speed) * h) ** 5 <= 40.0 * MOST_TURNED_BACK)

    def passes(self, scene: Scene, h: float) -> int:
        """Two stages."""
        return 10 if scene.n_springs else 1


EXPLICIT_EULER = _ExplicitEuler("explicit_euler", 1, ExplicitEulerLimit(undamped=1.0, damped=2.0))
SYMPLECTIC_EULER = _SymplecticEuler(
    "symplectic_euler",
    1,
    StabilityLimit(undamped=2.0, damped=2.0),
    symplectic=True,
    conserves=True,
    swing_power=0.5,  # the root of elastic times kinetic energy
)
VERLET = _Verlet(
    "verlet", 2, DampedKickLimit(undamped=2.0, damped=1.0), symplectic=True, conserves=True, contact_solves=2
)
RK4 = _RungeKutta("rk4", 4, RungeKuttaLimit(undamped=2.61, damped=2.61), conserves=True, contact_solves=2)
XPBD = _BackwardEuler(
    "xpbd",
    1,
    ImplicitLimit(undamped=2.0, damped=1.0),
    solves_gas=True,
    solves_elements=True,
    single_pass=True,
    contacts_follow=True,
    iterations=2,
)
IMPLICIT_EULER = _BackwardEuler(
    "implicit_euler",
    1,
    ImplicitLimit(undamped=2.0, damped=1.0),
    solves_gas=True,
    solves_elements=True,
    contacts_follow=True,
    holds_at_surfaces=True,
    iterations=5,
)
# its two stages take explicit forces from old places
TR_BDF2 = _TRBDF2(
    "tr_bdf2",
    2,
    SmallMotionLimit(undamped=1.0, damped=0.5),
    contact_solves=2,
    solves_gas=True,
    solves_elements=True,
    contacts_follow=True,
    holds_at_surfaces=True,
    stage=0.5 * GAMMA,
)

BUILT_IN_METHODS = {
    method.name: method for method in (EXPLICIT_EULER, SYMPLECTIC_EULER, VERLET, RK4, XPBD, IMPLICIT_EULER, TR_BDF2)
}
BUILT_IN_RULES = ("gauss_seidel", "jacobi", "sum", "off")  # of contacts


def named(name: str) -> Method:
    """A built-in method by its name. Raises ValueError for another."""
    if name not in BUILT_IN_METHODS:
        raise ValueError(f"integrator: {name!r} is not allowed; it must be one of {', '.join(BUILT_IN_METHODS)}")
    return BUILT_IN_METHODS[name]
