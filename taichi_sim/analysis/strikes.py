"""Strikes: contacts of balls on springs or elements with other balls, by methods that solve springs before they know of such
contacts. No Taichi.

A stage solves stiff springs for all of a step h, and then a contact gives a ball of mass m a velocity v that no spring has
answered. It moves by v h until the next stage, which stores k (v h)^2 / 2 in its springs: (omega h)^2 times the energy of the
impact, omega^2 = k / m. A heavy striker pushes on all the while.
"""

import numpy as np
from numpy.typing import NDArray

from taichi_sim.analysis.element_rates import element_rates
from taichi_sim.analysis.methods import VERLET, Method
from taichi_sim.analysis.spring_bounds import largest_eigenvalue
from taichi_sim.analysis.stability import REBOUNDS
from taichi_sim.common.quantities import at_most
from taichi_sim.geometry.graph import components
from taichi_sim.scene.collision_groups import meet
from taichi_sim.scene.elements import ELEMENTS
from taichi_sim.scene.materials import max_restitution
from taichi_sim.scene.part import Quadratic
from taichi_sim.scene.scene import Scene

__all__ = [
    "ANSWERED",
    "ANSWERED_BY_PASSES",
    "bounce_step",
    "fastest_swing",
    "may_strike",
    "resolved_bounce_step",
    "safe_step",
    "strike_step",
    "unanswered",
]

# Longest step times the largest frequency of balls on their springs, omega h, at which nets, cloth and jelly struck by balls of
# 5 to 450 times the mass of theirs gained less than a tenth of the kinetic energy before it: by stages, and by two passes
ANSWERED, ANSWERED_BY_PASSES = 2.0, 1.0
OWN_PART = 0.5  # of the bound of omega^2 of bricks and solids: what they give a ball where the balls around it stay


def strike_step(scene: Scene, method: Method) -> float:
    """The longest step [s] in which a method answers the impacts of other balls on bodies of springs or elements; infinite
    where there are none, and for methods whose steps springs limit."""
    if method.limit is None or method.limit.by_springs or not may_strike(scene):
        return np.inf
    omega = fastest_swing(scene)
    return (ANSWERED_BY_PASSES if method.single_pass else ANSWERED) / omega if omega > 0.0 else np.inf


def fastest_swing(scene: Scene) -> float:
    """A bound [1/s] of the frequencies of balls on their springs and elements, undamped."""
    springs = float(largest_eigenvalue(scene, scene.stiffness)[0]) if scene.n_springs else 0.0
    return float(np.sqrt(springs + element_rates(scene).elastic))


def bounce_step(scene: Scene, method: Method) -> float:
    """The longest step [s] in which bodies of springs or elements that bounce at the restitution of the scene gain no energy;
    infinite where that is low, and for methods that go through each spring once, which say so themselves."""
    bounce = max_restitution(scene)
    longest = next((part for least, part in REBOUNDS if bounce > least), np.inf)
    if method.limit is None or method.single_pass or np.isinf(longest):
        return np.inf
    damped = method.limit.by_springs  # explicit: what is damped gains nothing
    k = np.where(scene.damping > 0.0, 0.0, scene.stiffness) if damped else scene.stiffness
    rate = float(largest_eigenvalue(scene, k)[0]) if scene.n_springs else 0.0
    if not damped:
        rate += element_rates(scene).elastic
    return float(longest / np.sqrt(rate)) if rate > 0.0 else np.inf


def resolved_bounce_step(scene: Scene, method: Method) -> float:
    """The longest step [s] in which balls of springs or elements keep a restitution of their own: h^2 n . K n / m of what stages
    solve for is at most 1, see kernels.contacts.contact_law.swing; infinite where nothing bounces, and for methods that always
    do. n: the normals of walls, where these are all that bodies meet, and as they lie at the start; else any."""
    solved = method.solved(scene)
    if method.single_pass and not any(one.is_implicit for one in solved):  # which has no stages then
        return np.inf
    if method.limit is None or method.limit.by_springs or max_restitution(scene) == 0.0:
        return np.inf
    springs = not method.single_pass  # which stages solve for
    stiff = _holding(scene, scene.stiffness * springs, [form for one in solved for form in one.stiffness(scene)])
    damped = _holding(scene, scene.damping * springs, [form for one in solved for form in one.damping(scene)])
    if scene.colliders or scene.pinned.any() or np.ptp(scene.velocity, axis=0).any() or may_strike(scene):
        elastic, drag = (np.linalg.eigvalsh(one)[:, -1] for one in (stiff, damped))
    else:
        n = np.array([wall.normal for wall in scene.walls]).reshape(-1, scene.dim)
        elastic, drag = (np.einsum("wa,iab,wb->iw", n, one, n) for one in (stiff, damped))
    # along any direction
    further = np.sum([(0.0, 0.0), *(one.further_rates(scene) for one in solved if one.is_implicit)], axis=0)
    elastic, drag = elastic + OWN_PART * further[0], drag + OWN_PART * further[1]
    root = drag / method.stage + np.sqrt((drag / method.stage) ** 2 + 4.0 * elastic)  # of h^2 K + h D / stage = 1
    most = float(np.max(root, initial=0.0))
    return 2.0 / most if most > 0.0 else np.inf


def _holding(scene: Scene, k: NDArray[np.float64], forms: list[Quadratic]) -> NDArray[np.float64]:
    """w K (n, dim, dim) of each ball at rest, where the balls around it stay, of springs of k (m,) and of elements."""
    blocks = np.zeros((scene.n_balls, scene.dim, scene.dim))
    r = scene.position[scene.pairs[:, 1]] - scene.position[scene.pairs[:, 0]]
    d = np.linalg.norm(r, axis=1)
    across = np.where(d > scene.rest_length, 1.0 - scene.rest_length / np.where(d > 0.0, d, 1.0), 0.0)
    n = r / np.where(d > 0.0, d, 1.0)[:, None]
    along = (1.0 - across)[:, None, None] * n[:, :, None] * n[:, None, :] + across[:, None, None] * np.eye(scene.dim)
    for end in scene.pairs.T:
        np.add.at(blocks, end, k[:, None, None] * along)
    for form in forms:
        g = form.gradient
        each = g[..., :, None] * g[..., None, :] if g.shape[2] > 1 else g[..., None] ** 2 * np.eye(scene.dim)
        np.add.at(blocks, form.corners, form.strength[:, None, None, None] * each)
    return np.where(scene.pinned, 0.0, 1.0 / scene.mass)[:, None, None] * blocks


def safe_step(scene: Scene, method: Method) -> float:
    """The longest step [s] in which impacts on bodies that balls may strike give no energy, from the strikes or from the bodies'
    own bounces; infinite where nothing strikes."""
    struck = strike_step(scene, method)
    return min(struck, bounce_step(scene, method)) if np.isfinite(struck) else np.inf


def may_strike(scene: Scene) -> bool:
    """True if a free ball of a spring or an element may meet a ball that nothing joins it to. Contacts of a body with itself
    do not count."""
    part = _parts(scene)
    elastic = scene.joined() & ~scene.pinned
    kinds, which = np.unique(
        np.stack([scene.body, scene.group, scene.mask, elastic], axis=1), axis=0, return_inverse=True
    )
    which = which.reshape(-1)
    first, last = np.full(len(kinds), scene.n_balls), np.full(len(kinds), -1)  # part of each kind, by its number
    np.minimum.at(first, which, part)
    np.maximum.at(last, which, part)
    body, group, mask = kinds[:, 0], kinds[:, 1], kinds[:, 2]
    for k in np.flatnonzero(kinds[:, 3]):
        others = meet(group, mask, group[k], mask[k]) & ((body != body[k]) | (body[k] == 0))
        if np.any(others & ((first != first[k]) | (last != last[k]) | (first[k] != last[k]))):
            return True
    return False


def _parts(scene: Scene) -> NDArray[np.int64]:
    """Lowest number (n,) of the balls that springs and elements join to each ball."""
    edges = [scene.pairs]
    for corners in (one.corners(scene) for one in ELEMENTS):
        edges += [corners[:, [0, k]] for k in range(1, corners.shape[1])]
    return components(scene.n_balls, np.concatenate(edges).astype(np.int64))


def unanswered(scene: Scene, method: Method, h: float) -> tuple[str, str]:
    """Words on why impacts of balls give energy in steps of h seconds, and the cure; both empty where they do not."""
    if h <= strike_step(scene, method) * (1.0 + 1e-9):
        return "", ""
    step = min(safe_step(scene, method), resolved_bounce_step(scene, method))
    swings = ""
    if step < strike_step(scene, method):
        bounce = max_restitution(scene)
        swings = f"; these do not resolve either how fast what bounces at a restitution of {bounce:g} swings"
    return (
        f"{method} solves springs and elements before it knows of contacts between balls, so impacts of balls on them may give"
        f" energy in steps of {h:.3g} s{swings}",
        f"take steps of {at_most(step)} s, or {VERLET}",
    )
