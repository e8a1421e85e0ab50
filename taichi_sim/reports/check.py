"""The report before a run: which step is safe with each method, what limits it, what it costs, and what it will get wrong."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from taichi_sim.analysis.accuracy import findings
from taichi_sim.analysis.choice import SECOND_ORDER, passes_of_stage
from taichi_sim.analysis.element_rates import Declared, element_rates
from taichi_sim.analysis.methods import (
    BUILT_IN_METHODS,
    EXPLICIT_EULER,
    IMPLICIT_EULER,
    RK4,
    SYMPLECTIC_EULER,
    TR_BDF2,
    VERLET,
    XPBD,
    Method,
)
from taichi_sim.analysis.preflight import cautions
from taichi_sim.analysis.slow_modes import Decay, not_worked_out, slow_decays
from taichi_sim.analysis.stability import (
    Stability,
    explicit_parts,
    sinking_spring,
    soft_step,
    softened_spring,
    stability,
    where_safe,
    without,
)
from taichi_sim.analysis.strikes import safe_step
from taichi_sim.analysis.touching import may_touch
from taichi_sim.common.quantities import at_most, measured
from taichi_sim.scene.scene import Scene
from taichi_sim.simulation.settings import SAFETY, Settings, part_of_bound
from taichi_sim.simulation.simulation import Simulation

EXPLICIT = (VERLET, SYMPLECTIC_EULER, RK4, EXPLICIT_EULER)
STIFF = tuple(method for method in BUILT_IN_METHODS.values() if method not in EXPLICIT)
MANY_PASSES = 20_000  # over the springs in a simulated second, from which a stiff method is worth a try
MUCH_LONGER = 2.0  # times longer step without the limiting spring, from which that one alone is to blame
LONGER = 1.01  # times longer, from which that is said
NO_DECAY = 1e-9  # of a frequency: a rate of decay below it is rounding
WRONG_DECAY = 0.05  # of a decay rate, from which its error is reported
TOUCHES = 0.01  # of the radius: a gap that counts as none
WRONG_IN_A_CYCLE = 0.01  # of a cycle's motion, likewise, where springs damp less


def damping(scene: Scene, method: Method, h: float, position: NDArray[np.float64]) -> Iterator[str]:
    """Lines on the decay of the slowest motions with steps of h [s], and the cure where it is wrong."""
    if method.single_pass and (sinking := sinking_spring(scene, h)) is not None:
        yield f"damping               not known: ball {sinking.ball} is too heavy for its springs at this step of {method}"
        return
    if method.amplification(scene, 0.0, 0.0, h) is None:
        yield f"damping               not known: {method} declares no amplification"
        return
    decays = slow_decays(scene, method, h, position)
    if not decays:
        if why := not_worked_out(scene):
            yield f"damping               not worked out: {why}"
        return
    worst = max(decays, key=lambda mode: abs(mode.found - mode.exact) / _allowed(mode))
    free = ", as if nothing held what touches walls or colliders" * _rests(scene, position)
    if decays[0].hangs:
        yield f"damping               the slowest motion that springs resist{free}, {_decay(decays[0])}"
        yield f"{'':22}slower ones, such as a swing, are resisted by gravity alone, and are not worked out"
        return
    yield f"damping               the slowest motion{free}, {_decay(decays[0])}"
    if abs(worst.found - worst.exact) <= _allowed(worst):
        return
    if worst is not decays[0]:
        yield f"                      that of {_decay(worst)}"
    yield f"                      {method.damping_cure(2.0 * np.pi * worst.frequency, _allowed(worst))}"


def _rests(scene: Scene, position: NDArray[np.float64]) -> bool:
    """True if a wall or a collider may hold a ball of a spring, which the modes know nothing of."""
    balls = np.unique(scene.pairs)
    balls = balls[~scene.pinned[balls]]
    x, near = position[balls], (1.0 + TOUCHES) * scene.radius[balls]
    above = [x @ np.asarray(wall.normal) - wall.offset for wall in scene.walls]
    above += [collider.distance(x, 0.0) for collider in scene.colliders]
    return any(bool(np.any(distance <= near)) for distance in above)


def _allowed(mode: Decay) -> float:
    """Error of a rate of decay [1/s] that is good."""
    return max(WRONG_DECAY * mode.exact, WRONG_IN_A_CYCLE * mode.frequency)


def _decay(mode: Decay) -> str:
    """Words on the decay of a motion."""
    good = abs(mode.found - mode.exact) <= _allowed(mode)
    exact, found = (rate if abs(rate) > NO_DECAY * mode.frequency else 0.0 for rate in (mode.exact, mode.found))
    if exact == found == 0.0:
        return f"{mode.frequency:.3g} Hz, is undamped, and this step adds no damping: good"
    swings = (
        f"{mode.frequency:.3g} Hz" if mode.swings else f"{mode.frequency:.3g} Hz without damping, does not swing and"
    )
    return f"{swings}{',' * mode.swings} {_falls(exact)}; with this step {_falls(found)}{': good' * good}"


def _falls(rate: float) -> str:
    """Words on a rate of decay [1/s]."""
    if rate == 0.0:
        return "is undamped"
    return f"{'falls to 1/e' if rate > 0.0 else 'grows e-fold'} in {measured(1.0 / abs(rate), unit='s')}"


def lines(sim: Simulation) -> Iterator[str]:
    """The report on a simulation, line by line; positions are its present ones."""
    scene, used, custom = sim.scene, sim.settings.integrator.method, sim.force_rates
    h = sim.dt / sim.substeps
    limits = sim.stability()
    yield f"method                {sim.settings.chosen or used}"
    tolerance, many = sim.settings.tolerance, sim.substeps
    yield (
        f"step used             {h:.4g} s{'' if many == 1 else f' ({many} substeps of {sim.dt:.4g} s)'}"
        f"{'' if tolerance is None else f' at first; the tolerance of {tolerance:g} chooses it'}"
    )
    if used.limit is not None:
        share = _share(h, limits.dt_any_shape, part_of_bound(scene, used))
        soft = soft_step(scene, used)
        too_long = f"; above {at_most(soft)} s springs come out too long" if soft < limits.dt_any_shape else ""
        yield f"safe step             {_seconds(limits.dt_any_shape)}, {where_safe(scene, used, custom)}{share}{too_long}"
        yield f"safe at present       {_seconds(limits.dt_present)}, at the present positions alone"
    limiting = [f"{name} {one}" for name, one in (("spring", limits.spring), ("ball", limits.ball)) if one is not None]
    if limiting:
        yield f"limited by            {', '.join(limiting)}"
    yield f"why                   {limits.reason}"
    if used.single_pass and (softened := softened_spring(scene, h)):
        spring, left = softened
        k = scene.stiffness[spring]
        yield f"softened              in this step spring {spring} bears others with about {left:.2g} of its {k:.3g} N/m"
        yield f"{'':22}springs in the middle of a net act with less; where that shows, take {VERLET} or {TR_BDF2}"
    yield from damping(scene, used, h, sim.position)
    for finding in findings(scene, sim.setup):
        yield f"{finding.subject:22}{finding.what}"
        if finding.cure:
            yield f"{'':22}{finding.cure}"
    if not np.isfinite(min(limits.dt_any_shape, stability(scene, VERLET, None, custom).dt_any_shape)):
        yield f"advice                {_advice(sim, limits, np.inf)}"
        return
    longer = np.inf
    if limits.spring is not None:
        longer = without(scene, used, limits.spring, custom)
    if longer > LONGER * limits.dt_any_shape and limits.spring is not None:
        yield f"{f'without spring {limits.spring}':22}{_seconds(longer)} would be the safe step"
    yield ""
    yield from methods(sim, limits)
    stiff = ", ".join(map(str, STIFF))
    if any(not np.isinf(stability(scene, method, None, custom).dt_any_shape) for method in STIFF):
        yield from _limited(scene, custom)
    else:
        soft = soft_step(scene, XPBD)
        above = f", and {XPBD} makes them too soft in steps above {at_most(soft)} s" if np.isfinite(soft) else ""
        springs = f": springs are damped{above}" if scene.n_springs else ""
        yield f"{stiff}: any step is stable, but the error grows with it{springs}"
    answered = [_strike_step(sim, method) for method in STIFF]
    if np.isfinite(answered).any():
        steps = ", ".join(at_most(step) for step in answered)
        yield f"{stiff}, struck by balls: steps of at most {steps} s; impacts may give energy in longer ones"
    yield from _other_by_auto(sim)
    if sim.undeclared_forces:
        names = ", ".join(sim.undeclared_forces)
        yield f"The step that {names} needs is unknown; declare stiffness_rate"
    yield ""
    yield f"advice                {_advice(sim, limits, longer)}"


def methods(sim: Simulation, limits: Stability) -> Iterator[str]:
    """Table of methods: the step that each takes, and its work. limits: of the one in use."""
    scene, used, custom = sim.scene, sim.settings.integrator.method, sim.force_rates
    bound = stability(scene, VERLET, None, custom).dt_any_shape
    touching = sim.setup.rule != "off" and may_touch(scene)
    head = f"{'method':18} {'safe step':>11} {'at present':>11} {'step taken':>11}"
    yield f"{head} {'passes over the forces per simulated second':>44}"
    for method in dict.fromkeys((*EXPLICIT, *STIFF, used)):
        found = limits if method is used else stability(scene, method, sim.position, custom)
        taken = sim.dt / sim.substeps if method is used else sim.settings.automatic_step(scene, method, found)
        row = f"{method.name:18} {_seconds(found.dt_any_shape):>11} {_seconds(found.dt_present):>11} {_seconds(taken):>11}"
        yield f"{row} {_passes(scene, method, taken, bound, touching):>44}"


def _passes(scene: Scene, method: Method, h: float, bound: float, touching: bool) -> str:
    """Passes over the forces in a simulated second by steps of h [s]; those of solved stages are an estimate. bound [s]: of
    Verlet."""
    if h == 0.0:
        return "-"
    if method not in STIFF:
        return f"{method.passes(scene, h) / h:.3g}"
    stage = passes_of_stage(scene, h, bound, touching)
    each = stage if method is IMPLICIT_EULER else SECOND_ORDER * stage if method is TR_BDF2 else 2.0
    if method is XPBD and method.solved(scene):
        each += stage
    return f"about {each / h:.2g}"


def _other_by_auto(sim: Simulation) -> Iterator[str]:
    """Line on the method that "auto" would take in place of the one used, with its estimate; none where it is the same."""
    if (
        sim.settings.chosen
        or sim.undeclared_forces
        or any(map(any, sim.force_rates))
        or sim.settings.tolerance is not None
    ):
        return
    auto = Settings.resolve(sim.scene, {"integrator": "auto", "dt": sim.settings.dt, "contacts": sim.settings.contacts})
    if auto.integrator.method is not sim.settings.integrator.method:
        yield f'integrator = "auto" would take {auto.integrator.method}: {auto.chosen.partition(" by auto: ")[2]}'


def _strike_step(sim: Simulation, method: Method) -> float:
    """The longest step [s] in which impacts of balls on springs and elements give no energy; infinite without contacts."""
    return safe_step(sim.scene, method) if sim.setup.rule != "off" else np.inf


def _limited(scene: Scene, custom: Declared) -> Iterator[str]:
    """Sentences on what limits the steps of stiff methods, some of which have a limit."""
    for method in STIFF:
        longest = stability(scene, method, None, custom).dt_any_shape
        if not np.isinf(longest):
            parts = explicit_parts(scene, method, custom)
            yield f"{method} takes {parts} explicitly, which allows it steps of {longest:.4g} s; springs limit none"


def _seconds(value: float) -> str:
    return "no limit" if np.isinf(value) else "none" if value == 0 else f"{value:.4g} s"


def _share(h: float, safe: float, part: float) -> str:
    """Words on the part of the safe step that is used, and why where that is the automatic part."""
    if not 0 < safe < np.inf:
        return ""
    why = ", since a longer one lets large motion of undamped springs gain energy" if part < SAFETY else ""
    return f"; the step used is {h / safe:.2g} of that{why * (abs(h / safe - part) < 0.01)}"


def _free_choice(sim: Simulation) -> str:
    """Advice where nothing makes long steps unstable."""
    used = sim.settings.integrator.method
    if any(cautions(sim.scene, sim.setup)):
        return "no spring limits the step; follow the warnings above, then choose it by the accuracy you need"
    if used.single_pass and softened_spring(sim.scene, sim.dt / sim.substeps):
        return (
            f"springs act too softly, see above: take {VERLET} or {TR_BDF2}, or halve the step until the result stays"
        )
    if sim.settings.chosen and used is not VERLET and sim.settings.tolerance is None:
        return "this step is for pictures; for a number with a known error run `taichi-sim tune`"
    return "no spring limits the step; choose it by the accuracy you need"


def _advice(sim: Simulation, limits: Stability, longer: float) -> str:
    scene, used, h = sim.scene, sim.settings.integrator.method, sim.dt / sim.substeps
    safe = limits.dt_any_shape
    if used.limit is None:
        return f"{used} declares no stability limit: halve the step until the result stays the same"
    if (struck := _strike_step(sim, used)) < min(soft_step(scene, used), safe):
        return (
            f"take steps of {at_most(struck)} s at most, or {VERLET}: in longer ones impacts of balls may give energy"
        )
    if (soft := soft_step(scene, used)) < min(safe, h):
        return (
            f"take steps of {at_most(soft)} s at most: in longer ones {used} leaves springs too long by what they carry"
        )
    if np.isinf(safe):
        return _free_choice(sim)
    if safe == 0.0:
        return f"take {SYMPLECTIC_EULER} or {VERLET}: {used} gains energy on an undamped spring whatever the step"
    if limits.spring is not None and longer > MUCH_LONGER * safe and scene.n_springs > 1:
        times = f"{longer / safe:.3g} times shorter"
        return f"spring {limits.spring} alone makes the step {times}; is its stiffness, or its ball's mass, meant?"
    if stability(scene, VERLET, None, sim.force_rates).dt_any_shape > MUCH_LONGER * safe:
        return f"{VERLET} takes a longer step here: strong damping does not limit it"
    part = part_of_bound(scene, used)
    good = part * safe
    if h > safe:
        return f'dt above the bound of {safe:.4g} s may blow up; take {good:.4g} s, or dt = "auto"'
    if h > good * (1.0 + 1e-9) and part < SAFETY:
        why = "an undamped spring: large motion can resonate"
        return f'{why} above {good:.4g} s, and gain energy; take that, or dt = "auto"'
    if h > good * (1.0 + 1e-9):
        return f'dt is close to the bound of {safe:.4g} s; take {good:.4g} s, or dt = "auto"'
    if used.passes(scene, safe) / safe > MANY_PASSES and not any(element_rates(scene)):
        return f"if an error of a hundredth of the size will do, {XPBD} or {IMPLICIT_EULER} may need fewer passes"
    return f"{used} at {h:.4g} s is safe, {where_safe(scene, used, sim.force_rates)}"
