"""The largest safe time step of a scene by a method, for every shape that it can take and for the one it has."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from taichi_sim.analysis.element_rates import Declared, Rates, element_rates, pushing_gas
from taichi_sim.analysis.limits import StabilityLimit
from taichi_sim.analysis.methods import Method
from taichi_sim.analysis.spring_bounds import Network, largest_eigenvalue, present_eigenvalue
from taichi_sim.common.quantities import at_most
from taichi_sim.geometry.graph import components
from taichi_sim.scene.elements import ELEMENTS
from taichi_sim.scene.gases import GASES
from taichi_sim.scene.objects import pair_in_words
from taichi_sim.scene.scene import Scene, max_restitution

__all__ = [
    "Overload",
    "Sinking",
    "Stability",
    "coarsest_spring",
    "explicit_parts",
    "overload_step",
    "overloaded_spring",
    "present_limit",
    "sinking_spring",
    "sinking_step",
    "soft_step",
    "softened_spring",
    "stability",
    "where_safe",
    "without",
]

# Restitution, and the longest step times the largest frequency of balls on their springs, omega h, at which bodies of a higher
# restitution gain less than a tenth of their energy. Measured; up to the last restitution none gains
REBOUNDS = ((0.85, 0.4), (0.5, 1.0))
MOST_BOUNCE = 0.85  # restitution at which springs solved one by one are known to gain nothing from a wall
SINKING = 0.05  # of a rest length: what xpbd may leave a spring too long by
SOFTENED = 0.9  # of its stiffness: what xpbd should leave a spring
LONG = 1.0 / 30.0  # s, a step as long as any that is used
OVERLOAD = 0.05  # of a load: what xpbd may leave a spring to an element with too much
HEAVY = 10.0  # times the mass of the other end: such a ball may not
NOTHING = Declared()
VISIBLE = 1.0  # unit of rounding: a spring whose load stretches it by less is rigid or slack by chance

Floats = NDArray[np.float64]


class Stability(NamedTuple):
    """`dt_any_shape` [s]: safe for every shape the scene can take; `dt_present` [s]: for the present shape; `spring`, `ball`:
    what limits the first, or None; `reason`: one sentence. Infinite where nothing limits the step, or the method declares no
    limit."""

    dt_any_shape: float
    dt_present: float
    spring: int | None
    ball: int | None
    reason: str


def stability(
    scene: Scene,
    method: Method,
    position: Floats | None = None,
    custom: Declared = NOTHING,
    torn: NDArray[np.bool_] | None = None,
) -> Stability:
    """Largest safe step of a scene by a method. position (n, dim) [m]: the present shape; without it that bound, which takes
    seconds for a million balls, is not asked for, and dt_present is dt_any_shape. custom: what user-defined forces declare.
    torn: (m,) springs that are no more."""
    limit = method.limit
    if limit is None:
        return _unlimited(f"{method} declares no stability limit, so the step that is safe is not known")
    rates = _explicit(scene, method, custom)
    idle = (
        scene.n_springs == 0 and not any(rates) and (limit.by_springs or not any(one.acts(scene) for one in ELEMENTS))
    )
    if idle or scene.pinned.all():
        return _unlimited("no spring moves a ball: every step is stable")
    pushed = _pushed(scene, method)
    if pushed < limit.of_elements(rates):
        return Stability(
            pushed, pushed, None, None, "gas: each step leaves the springs of its surface a part of what it pushes"
        )
    if not limit.by_springs and not any(rates):
        bounce = max_restitution(scene)
        gains = bounce > (MOST_BOUNCE if method.single_pass else REBOUNDS[-1][0])
        once = (
            f"; bodies that bounce at a restitution above {MOST_BOUNCE:g} may gain energy" * method.single_pass * gains
        )
        if np.isfinite(soft := soft_step(scene, method)):
            return _unlimited(
                f"{method} stays bounded at any step, but in steps above {at_most(soft)} s its two passes leave springs too long"
                f" by the weights that they carry, and these hold energy that nothing gave{once}"
            )
        return _unlimited(f"{method} is stable at any step{limit.bouncing + once if gains else limit.caution}")
    k, c = _whole(scene, torn)
    if not limit.by_springs or not np.any(k + c > 0):
        return _of_elements(method, limit, rates, explicit_parts(scene, method, custom))
    h, spring = limit.of_springs(_any_shape(scene, k, c, rates))
    if np.isinf(h):
        return _unlimited("no spring has stiffness or damping: every step is stable")
    now = h if position is None else max(h, present_limit(scene, method, position, custom, torn)[0])
    i, j = (int(b) for b in scene.pairs[spring])
    load = np.bincount(scene.pairs.ravel(), np.repeat(k + c, 2), scene.n_balls) / scene.mass * ~scene.pinned
    ball = i if load[i] >= load[j] else j
    what = explicit_parts(scene, method, custom) if any(rates) else ""
    ends = pair_in_words(scene.objects, i, j)
    if h == 0.0:
        of = f"{what} are" if rates.elastic > 0.0 else f"spring {spring} ({ends}) is"
        return Stability(h, now, spring, ball, f"{of} undamped: {method} gains energy whatever the step")
    reason = (
        f"spring {spring} ({ends}, k = {k[spring]:.4g} N/m, c = {c[spring]:.4g} N s/m) limits {method};"
        f" ball {ball} (m = {scene.mass[ball]:.4g} kg) carries most of it"
    )
    if rates.elastic > 0.0:
        part = 1.0 - largest_eigenvalue(scene, k)[0] / (largest_eigenvalue(scene, k)[0] + rates.elastic)
        share = f"{part:.0%}" if part >= 0.01 else "less than 1%"
        reason += f"; {share} of the stiffness comes from {what}"
    return Stability(h, now, spring, ball, reason + limit.caution)


def present_limit(
    scene: Scene, method: Method, position: Floats, custom: Declared = NOTHING, torn: NDArray[np.bool_] | None = None
) -> tuple[float, int]:
    """The largest safe step [s] at `position` (n, dim) [m], and the spring that sets it, or -1 where springs do not. torn: as
    above."""
    k, c = _whole(scene, torn)
    limit = method.limit
    if limit is None or not limit.by_springs or not np.any(k + c > 0):
        return stability(scene, method, None, custom, torn).dt_any_shape, -1
    rates = _explicit(scene, method, custom)
    return limit.of_springs(Network(scene, k, c, rates, lambda k, c: present_eigenvalue(scene, k, c, position)))


def without(scene: Scene, method: Method, spring: int, custom: Declared = NOTHING) -> float:
    """The bound for any shape if one spring were not there [s]."""
    k, c = scene.stiffness.copy(), scene.damping.copy()
    k[spring] = c[spring] = 0.0
    rates, limit = _explicit(scene, method, custom), method.limit
    if limit is None:
        return np.inf
    return limit.of_springs(_any_shape(scene, k, c, rates))[0] if np.any(k + c > 0) else limit.of_elements(rates)


def _whole(scene: Scene, torn: NDArray[np.bool_] | None) -> tuple[Floats, Floats]:
    """Stiffness and damping (m,) of the springs, 0 of those that have torn."""
    if torn is None or not torn.any():
        return scene.stiffness, scene.damping
    return np.where(torn, 0.0, scene.stiffness), np.where(torn, 0.0, scene.damping)


def _any_shape(scene: Scene, k: Floats, c: Floats, rates: Rates) -> Network:
    return Network(scene, k, c, rates, lambda k, c: largest_eigenvalue(scene, k + c))


def _explicit(scene: Scene, method: Method, custom: Declared) -> Rates:
    """Rates of what a method takes explicitly besides springs."""
    return element_rates(scene, method.solved(scene)).plus(custom.left(method.solves_elements))


def _pushed(scene: Scene, method: Method) -> float:
    """The longest step [s] that the push of gases allows a method, whose springs answer it once in a step; else infinite."""
    answers = method.single_pass and scene.n_springs > 0
    return pushing_gas(scene) if answers and GASES in method.solved(scene) else np.inf


def explicit_parts(scene: Scene, method: Method, custom: Declared) -> str:
    """Names of what a method takes explicitly besides springs, or of the gas whose push allows it the shortest steps."""
    pushed, limit = _pushed(scene, method), method.limit
    if limit is not None and pushed < np.inf and pushed < limit.of_elements(_explicit(scene, method, custom)):
        return f"the push of the {GASES.name}"
    solved = method.solved(scene)
    names = [one.name for one in ELEMENTS if one.acts(scene) and one not in solved]
    names += ["user-defined forces"] * any(custom.left(method.solves_elements))
    return " and ".join(filter(None, (", ".join(names[:-1]), *names[-1:])))


def where_safe(scene: Scene, method: Method, custom: Declared) -> str:
    """Words on where `Stability.dt_any_shape` holds: in any shape for springs and what is linear; the stiffness of other elements
    that a method takes explicitly is that about the present shape."""
    solved = method.solved(scene)
    names = [one.words for one in ELEMENTS if one.acts(scene) and not one.is_linear and one not in solved]
    names += ["user-defined forces"] * any(custom.left(method.solves_elements))
    if not names:
        return "however the scene deforms"
    springs = "however springs deform, " if scene.n_springs else ""
    return f"{springs}with {' and '.join(names)} about as now"


def _unlimited(reason: str) -> Stability:
    return Stability(np.inf, np.inf, None, None, reason)


def _of_elements(method: Method, limit: StabilityLimit, rates: Rates, parts: str) -> Stability:
    """Stability where only `parts` that a method takes explicitly limit the step."""
    h = limit.of_elements(rates)
    if np.isinf(h):
        return _unlimited("nothing has stiffness or damping: every step is stable")
    what = "and gains energy whatever the step" if h == 0.0 else "which limits its step"
    return Stability(h, h, None, None, f"{method} takes {parts} explicitly, {what}")


class Sinking(NamedTuple):
    """A spring that xpbd leaves too long: its number, its heavier free ball, its load [N], and by how much [m]."""

    spring: int
    ball: int
    load: float
    depth: float


def sinking_spring(scene: Scene, h: float) -> Sinking | None:
    """The spring that steps of xpbd leave too long by most; None where that is no more than the load stretches it anyway, or
    less than SINKING of the rest length and no ball is HEAVY times the other end.

    A pass gives at most what moves both ends to their place, so two passes hold a load F as a spring of the compliance 1 / k +
    (h^2 + h c / k) W / 2, W the inverse masses of both ends, however still its lighter end is held by others. At the end of a
    chain of light balls it is tens of times as much.
    """
    load, lag = _lags(scene)
    depth = lag * (h**2 + h * _answer_time(scene))
    mass = np.where(scene.pinned, 0.0, scene.mass)[scene.pairs]
    shows = (depth >= _own_stretch(scene, load)) & (_heavy(scene) | (depth >= SINKING * scene.rest_length))
    if not np.any(shows & (depth > 0.0)):
        return None
    spring = int(np.argmax(np.where(shows, depth, 0.0)))
    ball = int(scene.pairs[spring, np.argmax(mass[spring])])
    return Sinking(spring, ball, float(load[spring]), float(depth[spring]))


def soft_step(scene: Scene, method: Method) -> float:
    """The longest step [s] of a method of two passes that leaves no spring too long, see `sinking_spring`; infinite for others,
    and where no step is that long."""
    return sinking_step(scene) if method.single_pass and sinking_spring(scene, LONG) is not None else np.inf


def sinking_step(scene: Scene) -> float:
    """The longest step [s] of xpbd that leaves no spring too long by more than its load stretches it, or, where no end is HEAVY,
    SINKING of its rest length, whichever is more."""
    load, lag = _lags(scene)
    own = _own_stretch(scene, load)
    allowed = np.where(_heavy(scene), own, np.maximum(own, SINKING * scene.rest_length))
    return _shortest(allowed[lag > 0] / lag[lag > 0], _answer_time(scene)[lag > 0])


def softened_spring(scene: Scene, h: float) -> tuple[int, float] | None:
    """The spring that two passes in a step of h [s] leave the least of its stiffness, and the stiffness [N/m] against loads that
    others hand on; None where each keeps SOFTENED of its own. See `sinking_spring`; it is less in the middle of a net."""
    w = np.where(scene.pinned, 0.0, 1.0 / scene.mass)[scene.pairs].sum(axis=1)
    part = 1.0 / (1.0 + 0.5 * w * (h**2 * scene.stiffness + h * scene.damping))
    if not np.any(part < SOFTENED):
        return None
    spring = int(np.argmin(np.where(scene.stiffness > 0.0, part, 1.0)))
    return spring, float(part[spring] * scene.stiffness[spring])


class Overload(NamedTuple):
    """A spring between a pin and a body of elements: its number, its free ball, its load [N], and the part that xpbd adds."""

    spring: int
    ball: int
    load: float
    part: float


def overloaded_spring(scene: Scene, h: float) -> Overload | None:
    """The spring from a pin to a body of elements that steps of xpbd leave with the most too much; None below OVERLOAD.

    Elements keep such a ball of mass m at its place between the passes. With a = (h^2 k + h c) / (2 m) the spring shows
    2 ((1 + a) F - a m g) / (2 + a) where it should carry F.
    """
    spring, ball, load, own = _hung_by_pins(scene)
    a = (h**2 * scene.stiffness[spring] + h * scene.damping[spring]) / (2.0 * scene.mass[ball])
    part = own * a / (2.0 + a)
    if not np.any(part >= OVERLOAD):
        return None
    k = int(np.argmax(part))
    return Overload(int(spring[k]), int(ball[k]), float(load[k]), float(part[k]))


def overload_step(scene: Scene) -> float:
    """The longest step [s] of xpbd that leaves no spring to a body of elements with more than OVERLOAD too much."""
    spring, ball, _, own = _hung_by_pins(scene)
    k, c, m = scene.stiffness[spring], scene.damping[spring], scene.mass[ball]
    acts = (own > OVERLOAD) & (k > 0.0)
    a = 2.0 * OVERLOAD / (own[acts] - OVERLOAD)
    return _shortest(2.0 * m[acts] * a / k[acts], c[acts] / k[acts])


def _hung_by_pins(scene: Scene) -> tuple[NDArray[np.intp], NDArray[np.int32], Floats, Floats]:
    """Springs from pins to balls that elements join, their free balls, their loads [N], and 1 - 2 m g / F of each: the springs at
    pins of a body share its weight. Bodies with pins of their own are left out."""
    n, g = scene.n_balls, float(np.linalg.norm(scene.gravity))
    rows = [one.corners(scene) for one in ELEMENTS if one.is_implicit and one.acts(scene)]
    elements = [row[:, [k, k + 1]] for row in rows for k in range(row.shape[1] - 1)]
    if not elements or not scene.n_springs or g == 0.0:
        nothing = np.zeros(0)
        return np.zeros(0, dtype=np.intp), np.zeros(0, dtype=np.int32), nothing, nothing
    joined = np.zeros(n, dtype=bool)
    joined[np.concatenate(elements)] = True
    held = scene.pinned[scene.pairs].sum(axis=1) == 1
    body = components(n, np.concatenate([scene.pairs[~scene.pinned[scene.pairs].any(axis=1)], *elements]))
    free = np.where(scene.pinned[scene.pairs[:, 0]], scene.pairs[:, 1], scene.pairs[:, 0])
    pins = np.bincount(body[scene.pinned], minlength=n) > 0
    spring = np.flatnonzero(held & joined[free] & ~pins[body[free]] & (scene.stiffness > 0.0))
    ball = free[spring]
    load = (
        g * (np.bincount(body, scene.mass, n) / np.maximum(np.bincount(body[free[held]], minlength=n), 1))[body[ball]]
    )
    return spring, ball, load, 1.0 - 2.0 * g * scene.mass[ball] / load


def _shortest(area: Floats, time: Floats) -> float:
    """The least h with h^2 + h time = area [s^2]; infinite where there is none."""
    return float(np.min(0.5 * (np.sqrt(time**2 + 4.0 * area) - time), initial=np.inf))


def _answer_time(scene: Scene) -> Floats:
    """c / k (m,) [s] of springs; 0 of those without stiffness."""
    k, c = scene.stiffness, scene.damping
    return np.divide(c, k, out=np.zeros_like(k), where=k > 0)


def _heavy(scene: Scene) -> NDArray[np.bool_]:
    """Springs (m,) one of whose ends, both free, is HEAVY."""
    mass = np.where(scene.pinned, 0.0, scene.mass)[scene.pairs]
    return (mass.min(axis=1) > 0.0) & (mass.max(axis=1) >= HEAVY * mass.min(axis=1))


def _lags(scene: Scene) -> tuple[Floats, Floats]:
    """Load (m,) [N] of springs, and the length [m/s^2] that xpbd leaves too much, over h^2 + h c / k.

    Between free balls the load is the weight of the heavier one. The springs at the pinned balls of a body share its weight,
    without that of the balls that hang on these pins themselves.
    """
    g = float(np.linalg.norm(scene.gravity))
    mass, w = np.where(scene.pinned, 0.0, scene.mass), np.where(scene.pinned, 0.0, 1.0 / scene.mass)
    i, j = scene.pairs.T
    held = scene.pinned[i] != scene.pinned[j]
    load = np.where(held, 0.0, np.maximum(mass[i], mass[j]))
    load[scene.pinned[i] & scene.pinned[j]] = 0.0
    if held.any():
        body, n = components(scene.n_balls, scene.pairs), scene.n_balls
        hanging = np.ones(n, dtype=bool)
        hanging[scene.pairs[held]] = False
        weight = np.bincount(body, mass * hanging, n) / np.maximum(np.bincount(body[i[held]], minlength=n), 1)
        load[held] = weight[body[i[held]]]
    return g * load, 0.5 * g * load * (w[i] + w[j])


def _own_stretch(scene: Scene, load: Floats) -> Floats:
    """Stretch (m,) [m] of springs by their loads."""
    return np.divide(load, scene.stiffness, out=np.full_like(load, np.inf), where=scene.stiffness > 0)


def coarsest_spring(scene: Scene) -> tuple[int, float, float] | None:
    """The spring whose load shows least in single precision, the stretch [m] by its heavier ball's weight, and the distance [m]
    between neighbouring numbers there; None where each stretch is at least VISIBLE of those."""
    g = float(np.linalg.norm(scene.gravity))
    if g == 0.0 or not scene.n_springs:
        return None
    load = np.where(scene.pinned, 0.0, scene.mass)[scene.pairs].max(axis=1) * g
    rounding = np.abs(scene.position).max(axis=1)[scene.pairs].max(axis=1) * float(np.finfo(np.float32).eps)
    stretch = np.divide(load, scene.stiffness, out=np.full_like(load, np.inf), where=(scene.stiffness > 0) & (load > 0))
    ratio = np.divide(stretch, rounding, out=np.full_like(load, np.inf), where=rounding > 0)
    spring = int(np.argmin(ratio))
    return (spring, float(stretch[spring]), float(rounding[spring])) if ratio[spring] < VISIBLE else None
