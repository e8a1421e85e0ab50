"""Rows of a report, made from trials."""

import numpy as np

from taichi_sim.analysis.methods import Method, named
from taichi_sim.reports.speed_error.compared import worst
from taichi_sim.reports.speed_error.plan import PARTS, Step, bound
from taichi_sim.reports.speed_error.reference import Reference
from taichi_sim.reports.speed_error.rows import LEFT_OUT, STABLE, UNSTABLE, Row
from taichi_sim.reports.speed_error.trial_process import Outcome
from taichi_sim.reports.speed_error.trials import Trials

HELD = 10.0  # of the same: more in all than springs hold that act softer than they are
GAIN = 1.0  # of the largest kinetic and spring energy: more motion than that is not the scene's


def measure(
    trials: Trials, reference: Reference, precision: str, method: str, step: Step, most: float | None = None
) -> Row:
    """Run one method with one step for at most so many seconds, and say what it cost and how far it was off."""
    outcome = trials.run(precision, method, step, most=most or trials.plan.most, keep=False, timed=True)
    return row_of(trials, reference, outcome, precision, method, step)


def row_of(trials: Trials, reference: Reference, outcome: Outcome, precision: str, method: str, step: Step) -> Row:
    """Row of an outcome compared with the reference. A run that ended early has no error, and for its cost what its first
    step promised."""
    scene, duration = trials.scene, trials.plan.duration
    safe = bound(scene, method)
    verdict, reason = _verdict(reference, outcome, named(method))
    known = verdict != LEFT_OUT and len(outcome.position) == PARTS
    errors = trials.compared.errors(outcome, reference)[: reference.parts] if known else []
    off = worst(errors) if errors else None
    seconds = None if verdict == LEFT_OUT or outcome.seconds is None else outcome.seconds / duration
    ball_steps = step.number * PARTS * max(1, scene.n_balls)
    return Row(
        scene=trials.plan.name,
        balls=scene.n_balls,
        springs=scene.n_springs,
        precision=precision,
        device=outcome.device,
        method=method,
        step=step.seconds,
        part_of_safe_step=step.seconds / safe if 0.0 < safe < np.inf else None,
        passes=None if not known or outcome.passes is None else outcome.passes / duration,
        seconds=seconds,
        noise=None if seconds is None or outcome.noise is None else outcome.noise / duration,
        ns_per_ball_step=None if seconds is None else 1e9 * seconds * duration / ball_steps,
        rms_error=off,
        max_error=float(np.max(errors, initial=0.0)) if errors else None,
        relative_error=None if off is None or not reference.motion else off / reference.motion,
        order=None,
        energy_drift=(outcome.energy[-1][3] - reference.energy[-1, 3]) / reference.scale
        if known and len(reference.energy)
        else None,
        verdict=verdict,
        reason=reason,
    )


def _verdict(reference: Reference, outcome: Outcome, method: Method) -> tuple[str, str]:
    if outcome.left_out:
        return LEFT_OUT, outcome.left_out
    if outcome.unstable:
        return UNSTABLE, outcome.unstable
    if len(reference.energy):
        # kinetic alone: springs that act softer than they are hold much of what is no motion
        gained = np.max(np.array(outcome.energy) - reference.energy, axis=0) / reference.scale
        if not gained[0] <= GAIN:
            return UNSTABLE, f"moves with {gained[0]:.3g} times the largest energy of the reference more than that"
        by_springs = method.limit is not None and method.limit.by_springs
        if by_springs and not method.symplectic and not gained[3] <= GAIN:  # those swing, by more near their bound
            return UNSTABLE, f"has {gained[3]:.3g} times the largest energy of the reference more, out of nothing"
        if method.single_pass and not gained[3] <= HELD:
            return (
                UNSTABLE,
                f"has {gained[3]:.3g} times the largest energy of the reference more, in springs left too long",
            )
    return STABLE, outcome.warning
