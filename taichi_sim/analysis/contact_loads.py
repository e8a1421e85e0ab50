"""Load that elements bear too much at a contact, with methods that solve them before contacts. No Taichi.

Xpbd solves springs as if there were no contact. Implicit Euler and TR-BDF2 solve springs and elements, and xpbd elements, as if
there were none of balls with balls: what rests on walls and colliders they hold. So what rests moves into the contact, which
stops it afterwards. At rest a layer of the mass m that bears the weight W ends each solve with the speed u = h W / m. Elements of
the stiffness k and the damping c that join it to the rest answer with (h k + c) u: too much by (h^2 k + h c) / m of the weight.
So does the highest layer of a body that bears another one: it ends each solve with a speed upwards, which the contact stops.
Of TR-BDF2, which has two stages, the steady state of a column shows 0.41 of the first part and 0.85 of the second. Verlet solves
damping likewise where that takes several stages in half a step, and columns show 0.4 of the second part.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from taichi_sim.analysis.methods import TR_BDF2, VERLET, Method
from taichi_sim.geometry.graph import components
from taichi_sim.scene.bricks import BRICKS
from taichi_sim.scene.neo_hookean import lame
from taichi_sim.scene.part import Quadratic
from taichi_sim.scene.scene import Scene
from taichi_sim.scene.solids import SOLIDS, shape_gradients

__all__ = ["Excess", "at_contacts", "cure", "sentence"]

TOUCHES = 0.5  # of a radius: balls lower than that are those that a body may rest on, or its lowest layer
SHOWS = 0.05  # of the weight: an excess that is worth a word
PARTS = {
    TR_BDF2.name: (0.41, 0.85),
    VERLET.name: (0.0, 0.4),
}  # of the excess by stiffness and by damping; 1 by methods of one solve

Floats = NDArray[np.float64]


class Excess(NamedTuple):
    """Excess of load on the elements at the lowest layer of a body, as a part of the weight that the layer bears: `elastic`
    [1/s^2], times h^2, and `damping` [1/s], times h. ball: one of the layer. on_balls: it rests on other balls. below: that at
    the highest layer of a body below, as a part of the weight that it bears there; None where nothing below has elements."""

    ball: int
    elastic: float
    damping: float
    on_balls: bool = False
    below: "Excess | None" = None

    def share(self, method: Method, h: float) -> float:
        """Part of the weight that is borne too much with steps of h seconds."""
        elastic, damping = PARTS.get(method.name, (1.0, 1.0))
        return elastic * h * h * self.elastic + damping * h * self.damping

    def most(self, method: Method, h: float) -> float:
        """The larger share, of this body and of that below."""
        return max(self.share(method, h), self.below.share(method, h) if self.below is not None else 0.0)

    def shows(self, method: Method, h: float) -> bool:
        """True if the excess is worth a word."""
        return self.most(method, h) > SHOWS

    def step(self, method: Method) -> float:
        """The longest step [s] in which it is not."""
        elastic, damping = PARTS.get(method.name, (1.0, 1.0))
        a, b = elastic * self.elastic, damping * self.damping
        own = 2.0 * SHOWS / (b + float(np.sqrt(b * b + 4.0 * a * SHOWS)))
        return min(own, self.below.step(method)) if self.below is not None else own


def at_contacts(scene: Scene, method: Method, h: float) -> Excess | None:
    """The body whose elements bear most too much where it rests on its lowest layer, as it lies at the start. None where the
    method knows of contacts, nothing falls, or no body without pins can rest on anything."""
    g = float(np.linalg.norm(scene.gravity))
    if not method.precedes_contacts(scene, h) or g == 0.0 or not scene.n_balls:
        return None
    springs_alone = not method.holds_at_surfaces and scene.n_springs > 0 and bool(scene.walls or scene.colliders)
    solved, up = () if springs_alone else method.solved(scene), -scene.gravity / g
    elastic, damping = _springs(scene, scene.stiffness), _springs(scene, scene.damping)
    for one in solved:
        elastic += one.stiffness(scene)
        damping += one.damping(scene)
    solids: list[tuple[NDArray[np.int32], tuple[Floats, Floats, Floats, Floats]]] = []
    if BRICKS in solved:
        volume = scene.brick_size.prod(axis=1)
        laws = volume, scene.brick_modulus, scene.brick_ratio, scene.brick_viscosity
        solids.append((scene.bricks, laws))
    if SOLIDS in solved:
        volume = shape_gradients(scene.solid_rest)[1]
        laws = volume, scene.solid_modulus, scene.solid_ratio, scene.solid_viscosity
        solids.append((scene.solids, laws))
    for stiff, lossy in (_strained(scene, *each, up) for each in solids):
        elastic.append(stiff)
        damping.append(lossy)
    edges = [kind.corners[:, [k, k + 1]] for kind in elastic for k in range(kind.corners.shape[1] - 1)]
    if not edges:
        return None
    body = components(scene.n_balls, np.concatenate(edges))
    held = np.bincount(body[scene.pinned], minlength=scene.n_balls) > 0
    found = _of_bodies(scene, body, (elastic, damping), up, held, method, h)
    if springs_alone:
        return found[0] if found else None
    extents = _Extents(scene, body, up)
    for excess in found:
        under = extents.under(body[excess.ball])
        if under.any():
            reached = np.zeros(scene.n_balls, dtype=bool)
            reached[: len(under)] = under
            borne = _of_bodies(scene, body, (elastic, damping), -up, ~reached, method, h)
            return excess._replace(on_balls=True, below=borne[0] if borne else None)
    return None


def _of_bodies(
    scene: Scene,
    body: NDArray[np.int64],
    rates: tuple[list[Quadratic], list[Quadratic]],
    up: Floats,
    out: NDArray[np.bool_],
    method: Method,
    h: float,
) -> list[Excess]:
    """Excesses at the layers of bodies that lie lowest by `up`, the largest first. rates: elements by stiffness and by damping.
    out: mask (n,) of bodies that do not count; those whose layer has a pinned ball do not either."""
    layer = _lowest(scene, body, up)
    mass = np.bincount(body[layer], scene.mass[layer], scene.n_balls)
    stands = np.bincount(body[layer & scene.pinned], minlength=scene.n_balls) > 0
    moves = (mass > 0.0) & ~out & ~stands & (np.bincount(body, minlength=scene.n_balls) > 1)
    if not moves.any():
        return []
    elastic, damping = (
        np.where(moves, _of_layers(kinds, body, layer, up), 0.0) / np.maximum(mass, 1e-300) for kinds in rates
    )
    number = np.flatnonzero(moves)
    ball = np.zeros(scene.n_balls, dtype=np.int64)
    chosen = np.flatnonzero(layer)[::-1]
    ball[body[chosen]] = chosen
    found = [Excess(int(ball[b]), float(elastic[b]), float(damping[b])) for b in number]
    return sorted((one for one in found if one.share(method, h) > 0.0), key=lambda one: -one.share(method, h))


def _springs(scene: Scene, strength: Floats) -> list[Quadratic]:
    """Springs of a scene, along their directions at the start."""
    if not scene.n_springs:
        return []
    i, j = scene.pairs.T
    along = scene.position[j] - scene.position[i]
    along = along / np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-300)
    return [Quadratic(scene.pairs, np.stack([-along, along], axis=1), strength)]


def _strained(
    scene: Scene, corners: NDArray[np.int32], laws: tuple[Floats, Floats, Floats, Floats], up: Floats
) -> tuple[Quadratic, Quadratic]:
    """Stiffness and damping of bricks or solids with these corners, strained along `up` alone. laws: volumes, moduli, ratios and
    viscosities."""
    volume, modulus, ratio, viscosity = laws
    mu, lam = lame(scene.dim, modulus, ratio)
    x = scene.position[corners]
    apart = np.linalg.pinv(x - x.mean(axis=1, keepdims=True))  # (e, dim, k): the gradient of a field from its corners
    gradient = np.einsum("eak,a->ek", apart, up)[:, :, None] * up
    elastic = Quadratic(corners, gradient, volume * (lam + 2.0 * mu))
    return elastic, Quadratic(corners, gradient, 2.0 * volume * viscosity)


def _lowest(scene: Scene, body: NDArray[np.int64], up: Floats) -> NDArray[np.bool_]:
    """Balls (n,) whose lowest point is within half a radius of the lowest one of their body."""
    bottom = scene.position @ up - scene.radius
    lowest = np.full(scene.n_balls, np.inf)
    np.minimum.at(lowest, body, bottom)
    return np.asarray(bottom <= lowest[body] + TOUCHES * scene.radius, dtype=np.bool_)


class _Extents:
    """Boxes about bodies, along and across `up`."""

    def __init__(self, scene: Scene, body: NDArray[np.int64], up: Floats) -> None:
        height, radius = scene.position @ up, scene.radius
        level = scene.position - height[:, None] * up
        number = int(body.max()) + 1
        self.bottom, self.slack = np.full(number, np.inf), np.zeros(number)
        self.low, self.high = np.full((number, scene.dim), np.inf), np.full((number, scene.dim), -np.inf)
        np.minimum.at(self.bottom, body, height - radius)
        np.maximum.at(self.slack, body, TOUCHES * radius)
        np.minimum.at(self.low, body, level - radius[:, None])
        np.maximum.at(self.high, body, level + radius[:, None])

    def under(self, b: int) -> NDArray[np.bool_]:
        """Mask of the bodies that reach below body b, and are not beside it."""
        over = np.all((self.low < self.high[b]) & (self.high > self.low[b]), axis=1)
        return np.asarray(over & (self.bottom < self.bottom[b] - self.slack[b]), dtype=np.bool_)


def _of_layers(kinds: list[Quadratic], body: NDArray[np.int64], layer: NDArray[np.bool_], up: Floats) -> Floats:
    """Second derivative (n,) [N/m], or of damping [N s/m], of elements where the layer of each body moves along `up`; stored at
    its first ball."""
    total = np.zeros(len(body))
    for kind in kinds:
        moved = kind.gradient * layer[kind.corners][:, :, None]
        whole = kind.gradient.shape[2] == 1
        square = moved.sum(axis=1)[:, 0] ** 2 if whole else (moved @ up).sum(axis=1) ** 2
        total += np.bincount(body[kind.corners[:, 0]], kind.strength * square, len(body))
    return total


def sentence(excess: Excess, method: Method, h: float) -> str:
    """The excess in words."""
    solved = "strong damping" if method is VERLET else "springs and elements"
    which, ground = (" of balls", "other balls") if excess.on_balls else ("", "its lowest balls")
    borne = ""
    if excess.below is not None:
        share = excess.below.share(method, h)
        borne = f", and what is next to the highest balls of the body of ball {excess.below.ball} {share:.2g} of what it bears"
    return (
        f"{method} solves {solved} before contacts{which}: where the body of ball {excess.ball} rests on {ground}, what is next"
        f" to its lowest balls bears {excess.share(method, h):.2g} of its weight too much{borne}"
    )


def cure(excess: Excess, method: Method, h: float) -> str:
    """The remedy, empty where the excess is small."""
    if not excess.shows(method, h):
        return ""
    verlet = "" if method is VERLET else f"{VERLET}, which knows of contacts, or "
    return f"take {verlet}substeps of {excess.step(method):.2g} s"
