"""Energy and momentum of a scene in a given state, in float64 NumPy: slow, plain, and independent of the kernels; and what
its contacts say."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from taichi_sim.analysis.frame import Contacts
from taichi_sim.common import validation
from taichi_sim.common.errors import SceneError
from taichi_sim.scene.bricks import corner_volumes
from taichi_sim.scene.cells import cell_volumes
from taichi_sim.scene.colliders import Collider
from taichi_sim.scene.elements import ELEMENTS
from taichi_sim.scene.scene import Scene
from taichi_sim.scene.strains import cut

__all__ = [
    "Energy",
    "angular_momentum",
    "check_tearing",
    "collider_depth",
    "contacts",
    "cut",
    "energy",
    "inertia",
    "inverted",
    "largest_speed",
    "momentum",
    "strain",
    "torn_open",
]

Floats = NDArray[np.float64]
GAPING = 2.0  # rest lengths between the ends of a torn spring


class Energy(NamedTuple):
    """Joule. Gravity's is 0 at the origin."""

    kinetic: float
    spring: float
    gravity: float
    total: float


def _moving(scene: Scene) -> Floats:
    """Masses (n,) [kg], 0 for pinned balls: they count in no momentum or energy."""
    return np.where(scene.pinned, 0.0, scene.mass)


def energy(
    scene: Scene,
    x: Floats,
    v: Floats,
    spin: Floats | None = None,
    torn: NDArray[np.bool_] | None = None,
    forces: Sequence[Any] = (),
) -> Energy:
    """Energy of positions x and velocities v, both (n, dim), and of angular velocities (n, 1 or 3) [1/s]. torn: (m,) springs.
    `spring` holds that of cells, bending and gas too, and of user-defined forces that tell theirs."""
    m = _moving(scene)
    kinetic = 0.5 * float(np.sum(m * np.sum(v * v, axis=1)))
    if spin is not None:
        kinetic += 0.5 * float(np.sum(inertia(scene) * np.sum(spin * spin, axis=1)))
    r = x[scene.pairs[:, 1]] - x[scene.pairs[:, 0]]
    stretch = np.linalg.norm(r, axis=1) - scene.rest_length
    strength = scene.stiffness if torn is None else np.where(torn, 0.0, scene.stiffness)
    pairs = scene.pairs[:0] if torn is None else scene.pairs[torn]
    spring = 0.5 * float(np.sum(strength * stretch**2)) + _elements(scene, x, pairs)
    spring += sum(_custom(scene, force, x, v, pairs) for force in forces)
    gravity = 0.0 - float(np.sum(m * (x @ scene.gravity)))
    return Energy(kinetic, spring, gravity, kinetic + spring + gravity)


def _elements(scene: Scene, x: Floats, torn: NDArray) -> float:
    """Energy of all elements [J]. torn: (k, 2) balls of torn springs."""
    total = 0.0
    for element in ELEMENTS:
        if element.count(scene):
            for term in element.energies(scene, x, ~cut(element.corners(scene), torn, scene.n_balls)):
                total += term
    return total


def _custom(scene: Scene, force: Any, x: Floats, v: Floats, torn: NDArray) -> float:
    """Energy [J] of a user-defined force: the sum over its elements that are whole, or of the force as it is."""
    if hasattr(force, "energies"):
        whole = ~cut(np.asarray(force.balls), torn, scene.n_balls)
        found = np.asarray(force.energies(x))
        if found.shape != whole.shape:
            says = f"returns an array of shape {found.shape}; it must be {whole.shape}, one energy for each element"
            raise SceneError(f"{type(force).__name__}.energies", says=says)
        return float(np.sum(_real(f"{type(force).__name__}.energies", found, "a list of numbers")[whole]))
    if not hasattr(force, "energy"):
        return 0.0
    return float(_real(f"{type(force).__name__}.energy", np.asarray(force.energy(x, v)), "a number"))


def _real(where: str, found: NDArray[Any], what: str) -> NDArray[Any]:
    """The values that a user's function returned. Raises SceneError unless it is of real numbers, which may be nan."""
    if found.dtype.kind not in "iuf":
        raise SceneError(where, found, says=f"is not {what}")
    return found


def torn_open(scene: Scene, position: NDArray, torn: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Mask (t,) of the triangles removed by torn springs (m,): those with two torn sides, or one torn side longer than
    GAPING times its rest length; a thread that tears alone leaves no hole in cloth that holds. A triangle that collides is
    removed with its first torn side. position: (n, dim) [m]."""
    n, pairs = scene.n_balls, np.sort(scene.pairs[torn].astype(np.int64), axis=1)
    length = np.linalg.norm(position[pairs[:, 1]] - position[pairs[:, 0]], axis=1)
    gapes = length > GAPING * scene.rest_length[torn]
    sides = np.sort(scene.triangles[:, [[0, 1], [1, 2], [2, 0]]].astype(np.int64), axis=2)
    side, spring = sides[..., 0] * n + sides[..., 1], pairs[:, 0] * n + pairs[:, 1]
    lost = np.isin(side, spring).sum(axis=1)
    return np.asarray((lost > np.where(scene.solid, 0, 1)) | np.isin(side, spring[gapes]).any(axis=1))


def check_tearing(scene: Scene) -> None:
    """Raise SceneError where a side of a triangle that holds a gas could tear: what is left would still do so."""
    validation.limits(
        "springs.break_strain", scene.break_strain, scene.n_springs, positive=True
    )  # which may have been set by hand
    validation.strained(scene.break_strain, scene.rest_length)
    tears = np.isfinite(scene.break_strain)
    for number, gas in enumerate(scene.gases):
        if cut(gas.triangles, scene.pairs[tears], scene.n_balls).any():
            says = f"the surface of gas {number} could tear, and a gas does not flow out"
            raise SceneError("springs.break_strain", says=says)


def inverted(scene: Scene, x: Floats, torn: NDArray | None = None) -> int:
    """Number of cells, bricks and solids that are flat or turned inside out, bricks at any corner. x: (n, dim) [m]; torn: (k, 2)
    balls of torn springs, whose elements are no more."""
    cells, solids, bricks = (
        corners if torn is None else corners[~cut(corners, torn, scene.n_balls)]
        for corners in (scene.cells, scene.solids, scene.bricks)
    )
    simplices = sum(np.count_nonzero(cell_volumes(x, corners) <= 0.0) for corners in (cells, solids))
    return int(simplices + np.count_nonzero((corner_volumes(x, bricks) <= 0.0).any(axis=1)))


def momentum(scene: Scene, v: Floats) -> Floats:
    """Sum of m v, (dim,) kg m/s."""
    return _moving(scene) @ v


def inertia(scene: Scene) -> Floats:
    """Moments of inertia (n,) [kg m^2]: discs in 2D, solid spheres in 3D; 0 for pinned balls."""
    return _moving(scene) * scene.radius**2 * (0.5 if scene.dim == 2 else 0.4)


def angular_momentum(scene: Scene, x: Floats, v: Floats, spin: Floats | None = None) -> Any:
    """Sum of m x cross v + I spin about the origin [kg m^2/s]: a float in 2D, (3,) in 3D."""
    m = _moving(scene)
    own = inertia(scene) @ (np.zeros((len(m), 1 if scene.dim == 2 else 3)) if spin is None else spin)
    if scene.dim == 2:
        return float(np.sum(m * (x[:, 0] * v[:, 1] - x[:, 1] * v[:, 0])) + own[0])
    return np.sum(m[:, None] * np.cross(x, v), axis=0) + own


def strain(scene: Scene, x: Floats) -> Floats:
    """Relative stretch (m,) of each spring: (length - rest) / rest, 0 where the rest length is 0."""
    length = np.linalg.norm(x[scene.pairs[:, 1]] - x[scene.pairs[:, 0]], axis=1)
    rest = scene.rest_length
    return np.divide(length - rest, rest, out=np.zeros_like(rest), where=rest > 0)


def largest_speed(v: Floats) -> float:
    """Speed of the fastest ball [m/s]; 0 with none."""
    return float(np.sqrt(np.max(np.sum(v * v, axis=1), initial=0.0)))


def contacts(tally: Floats | None, iterations: int, substeps: int, fastest: float, searches: int) -> Contacts:
    """Contacts from statistics (9,), see kernels.contacts.statistics, or None for no contact at all."""
    number, depths, parts, squares, deepest, part, left, unsolved, ball = np.zeros(9) if tally is None else tally
    many = max(number, 1.0)
    return Contacts(
        number=int(number),
        penetration=float(deepest),
        mean_penetration=float(depths / many),
        relative_penetration=float(part),
        mean_relative_penetration=float(parts / many),
        residual=float(left),
        rms_residual=float(np.sqrt(squares / many)),
        iterations=iterations,
        substeps=substeps,
        largest_speed=fastest,
        searches=searches,
        unsolved=float(unsolved),
        ball=int(ball) if part > 0.0 else -1,
    )


def collider_depth(scene: Scene, collider: Collider, x: Floats, time: float) -> Floats:
    """Depth [m] (n,) of each ball in a collider, 0 where the ball does not touch it or is pinned. x: (n, dim) [m] at time
    [s]."""
    depth = np.zeros(scene.n_balls)
    centre = collider.motion.at(time)[0][0]
    reach = collider.extent + scene.radius
    near = np.flatnonzero(~scene.pinned & (np.linalg.norm(x - centre, axis=1) < reach))
    depth[near] = np.maximum(0.0, scene.radius[near] - collider.distance(x[near], time))
    return depth
