"""Membranes: triangles of woven fabric or of a sheet that resist stretch and shear in their plane."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from taichi_sim.common import validation
from taichi_sim.common.errors import SceneError
from taichi_sim.scene.columns import Column
from taichi_sim.scene.part import Columns, Element, Quadratic
from taichi_sim.scene.solids import shape_gradients

__all__ = [
    "MEMBRANES",
    "MembraneMethods",
    "aspect",
    "flattened",
    "folded_energy",
    "require_coupling",
    "require_folding",
    "shape_gradients",
]

Floats = NDArray[np.float64]
ROOM = 1.5  # times the stiffness at rest: what a sheet has that is stretched by a seventh
MOST_UNLIKE = 1e6  # times the weaker thread the stronger one of a sheet that folds: beyond that it is none
SOFTEST = 1e-12  # as in forces/folding.py, and ROUNDS
ROUNDS = 16
FLAT = 1e-9  # of the square of the longest edge: a triangle of less area has none


class MembraneMethods:
    """The part of a Scene that holds membranes."""

    membranes = Column("membranes", "corners", "(t, 3) balls of each membrane", (3,), np.int32)
    membrane_rest = Column("membranes", "rest", "(t, 3, 2) m, its corners in the plane of the fabric at rest", (3, 2))
    membrane_warp = Column("membranes", "warp", "(t,) N/m")
    membrane_weft = Column("membranes", "weft", "(t,) N/m")
    membrane_shear = Column("membranes", "shear", "(t,) N/m")
    membrane_coupling = Column("membranes", "coupling", "(t,) N/m")
    membrane_damping = Column("membranes", "damping", "(t,) s")
    membrane_compression_limit = Column("membranes", "compression_limit", "(t,) N/m; inf: none")

    def add_membranes(
        self: Any,
        corners: ArrayLike,
        *,
        warp: ArrayLike,
        weft: ArrayLike | None = None,
        shear: ArrayLike | None = None,
        coupling: ArrayLike = 0.0,
        damping: ArrayLike = 0.0,
        compression_limit: ArrayLike | None = None,
        rest: ArrayLike | None = None,
    ) -> NDArray[np.int32]:
        """Add t triangles of an orthotropic St. Venant-Kirchhoff membrane in 3D and return their indices, shape (t,).

        With the Green strains E_uu along the warp, E_vv along the weft and E_uv between them a triangle stores per area at rest
        (warp E_uu^2 + weft E_vv^2) / 2 + coupling E_uu E_vv + 2 shear E_uv^2. It has no resistance to bending.

        Args:
            corners: (t, 3) balls, or one triangle.
            warp: force per width and strain along the warp, with the strain across kept at 0, one or one per triangle, >= 0
                [N/m].
            weft: the same along the weft [N/m]; the warp's by default.
            shear: force per width and angle of shear [N/m]; by default (warp - coupling) / 2, that of an isotropic sheet.
            coupling: force per width along the weft, and strain along the warp [N/m]; its square is at most warp times weft.
            compression_limit: force per width of compression at which a triangle gives way, as a sheet that folds below its size,
                see `physics.md`; at least 0, None or inf: never [N/m]. Its weft is then from 1e-6 to 1e6 times its warp.
            damping: time by which stresses of the rate of strain are those of strain, one or one per triangle, >= 0 [s].
            rest: (t, 3, 2) corners at rest in the plane of the fabric, u along the warp [m]; None: the present shape, its warp
                along the first two corners.
        """
        if self.dim != 3:
            raise SceneError("membranes", says="a membrane needs a scene with dim = 3")
        ij = validation.indices("membranes.corners", validation.many(corners, 1), self.n_balls, width=3)
        t = len(ij)
        given = None if rest is None else validation.rows_of_vectors("membranes.rest", rest, t, 3, 2)
        flat = flattened(self.position[ij]) if given is None else given
        edges = flat[:, 1:] - flat[:, :1]
        has_area = np.linalg.det(edges) > FLAT * np.sum(edges**2, axis=(1, 2))
        says = "has no area at rest, or its corners at rest are not in counter-clockwise order"
        validation.require("membranes.corners", ij, has_area, says=says)
        optional = validation.given(weft=weft, shear=shear)
        columns = validation.amounts("membranes", t, warp=warp, damping=damping, **optional)
        one, both = columns["warp"], validation.per_item("membranes.coupling", coupling, t)
        other = columns.setdefault("weft", one)
        require_coupling("membranes.coupling", both, one, other)
        if shear is None and np.any(one != other):
            raise SceneError("membranes.shear", says="is missing; only where warp and weft are alike it has a default")
        columns.setdefault("shear", 0.5 * (one - both))
        columns["compression_limit"] = validation.limits("membranes.compression_limit", compression_limit, t, low=0)
        require_folding("membranes.weft", one, other, columns["compression_limit"])
        return self.tables["membranes"].append(t, corners=ij, rest=flat, coupling=both, **columns)  # type: ignore[no-any-return]


def require_folding(where: str, warp: ArrayLike, weft: ArrayLike, limit: ArrayLike) -> None:
    """Raise SceneError for the first weft [N/m] of a sheet that folds at a limit [N/m], inf: never, and that has next to no
    stiffness along one of its axes. Without it folds would be without bounds."""
    one, other = np.broadcast_arrays(np.asarray(warp, dtype=float), weft)
    good = (one > 0) & (one <= MOST_UNLIKE * other) & (other <= MOST_UNLIKE * one)
    allowed = f"from {1 / MOST_UNLIKE:g} to {MOST_UNLIKE:g} times the warp, both above 0, where it folds"
    validation.require(where, other, good | np.isposinf(np.asarray(limit, dtype=float)), allowed)


def require_coupling(where: str, coupling: ArrayLike, warp: ArrayLike, weft: ArrayLike) -> None:
    """Raise SceneError for the first coupling [N/m] with which a strain of a sheet would give energy."""
    one, both = np.multiply(warp, weft), np.asarray(coupling)
    good = both**2 <= one * (1.0 + 1e-9)
    most = np.sqrt(one.flat[int(np.argmin(good))]) if good.size else 0.0
    validation.require(where, both, good, f"at most {most:.4g}, the root of warp times weft, and at least minus that")


def flattened(x: Floats, direction: Floats | None = None) -> Floats:
    """Corners (t, 3, 2) [m] of triangles x (t, 3, 3) in their own planes, u along `direction` (t, 3) or, without it, along the
    first edge."""
    one, two = x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]
    normal = np.cross(one, two)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    along = one if direction is None else direction - np.einsum("ti,ti->t", direction, normal)[:, None] * normal
    u = along / np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-300)
    axes = np.stack([u, np.cross(normal, u)], axis=2)
    return np.einsum("tki,tia->tka", x - x[:, :1], axes)


def folded_energy(strain: Floats, law: Floats, limit: Floats) -> Floats:
    """Energy per area at rest (t,) [N/m] of strains (t, 3), E_uu, E_vv and 2 E_uv, by the laws C (t, 3, 3) [N/m] of sheets that
    fold where their compression is above a limit (t,) [N/m]; see forces/folding.py, which says why."""
    (folds,) = np.nonzero(np.isfinite(limit))
    whole, work = strain.copy(), np.zeros(len(strain))
    if len(folds):
        fold = _folds(strain[folds], law[folds], limit[folds])
        whole[folds] += fold
        work[folds] = limit[folds] * (fold[:, 0] + fold[:, 1])
    return np.asarray(0.5 * np.einsum("ti,tij,tj->t", whole, law, whole) + work)


def _folds(strain: Floats, law: Floats, limit: Floats) -> Floats:
    """Second strain W (t, 3) of sheets that fold; see `folded_energy`."""
    r, root = aspect(law[:, 0, 0], law[:, 1, 1]), np.sqrt(law[:, 0, 0] * law[:, 1, 1])
    both, limit = law[:, 0, 1] / root, limit / root
    stiff = np.maximum(SOFTEST, [1.0 + both, 1.0 - both, 2.0 * law[:, 2, 2] / root])
    u, v = r * strain[:, 0], strain[:, 1] / r
    b = stiff * [u + v, u - v, strain[:, 2]] + limit * [1.0 / r + r, 1.0 / r - r, 0.0 * r]
    w = -0.5 * b / stiff
    folded = (b[0] < np.hypot(b[1], b[2])) & (w[0] < np.hypot(w[1], w[2]))
    w[:, folded] = _folds_along(b[:, folded], stiff[:, folded])
    w[:, b[0] >= np.hypot(b[1], b[2])] = 0.0
    return np.stack([(w[0] + w[1]) / r, (w[0] - w[1]) * r, 2.0 * w[2]], axis=1)


def _folds_along(b: Floats, stiff: Floats) -> Floats:
    """s, d and t (3, t) of folds in one direction, of b (3, t) and of A, B and D (3, t)."""
    size = np.hypot(b[1], b[2])
    ratio, gap, share = b[0] / size, (size - b[0]) / size, (b[1:] / size) ** 2
    z = np.maximum(0.0, (stiff[0] + ratio * np.sum(share * stiff[1:], axis=0)) / gap)
    for _ in range(ROUNDS):
        part = share / (stiff[1:] + z) ** 2
        reach = np.sum(part, axis=0) ** -0.5
        slope = np.sum(part / (stiff[1:] + z), axis=0) * reach**3
        z = np.maximum(0.0, z - (z - stiff[0] - ratio * reach) / np.maximum(1.0 - ratio * slope, 1e-3 * gap))
    turned = -b[1:] / (stiff[1:] + z)
    along = np.stack([np.ones(len(z)), *(turned / np.hypot(*turned))])
    least = -0.5 * np.sum(b * along, axis=0) / np.sum(stiff * along**2, axis=0)
    return np.asarray(np.maximum(0.0, least) * along)


def aspect(warp: Floats, weft: Floats) -> Floats:
    """Factor r (t,) by which fabrics of a warp and a weft [N/m] are drawn where their folds are looked for; see
    forces/folding.py."""
    return np.asarray((warp / weft) ** 0.25)


class _Membranes(Columns, Element):
    name, method, counted = "membranes", "add_membranes", ("corners",)
    assumed: ClassVar = {"damping": 0.0, "compression_limit": np.inf}
    is_implicit = excludes_contact = True
    work = 2
    features: ClassVar = {"damping of membranes": lambda scene: np.any(scene.membrane_damping > 0)}

    def gradients(self, scene: Any, x: Floats) -> Floats:
        """Deformation gradients (t, 3, 2) [1] at x (n, 3) [m]."""
        return np.einsum("tki,tka->tia", x[scene.membranes], shape_gradients(scene.membrane_rest)[0])

    def energies(self, scene: Any, x: Floats, whole: NDArray[np.bool_]) -> list[float]:
        f, area = self.gradients(scene, x), shape_gradients(scene.membrane_rest)[1]
        e = 0.5 * (np.einsum("tia,tib->tab", f, f) - np.eye(2))
        law = np.zeros((len(e), 3, 3))
        law[:, 0, 0], law[:, 1, 1], law[:, 2, 2] = scene.membrane_warp, scene.membrane_weft, scene.membrane_shear
        law[:, 0, 1] = law[:, 1, 0] = scene.membrane_coupling
        strain = np.stack([e[:, 0, 0], e[:, 1, 1], 2.0 * e[:, 0, 1]], axis=1)
        stored = folded_energy(strain, law, scene.membrane_compression_limit)
        return [float(np.sum((area * stored)[whole]))]

    def stiffness(self, scene: Any) -> list[Quadratic]:
        """Quadratic forms of the present shape, with room for stretching."""
        return self._forms(scene, np.full(len(scene.membranes), ROOM))

    def damping(self, scene: Any) -> list[Quadratic]:
        return self._forms(scene, ROOM * scene.membrane_damping)

    def _forms(self, scene: Any, factor: Floats) -> list[Quadratic]:
        """Forms of the strains along both axes that a stress goes with alone, and of the angle of shear."""
        gradient, area = shape_gradients(scene.membrane_rest)
        f = np.einsum("tki,tka->tia", scene.position[scene.membranes], gradient)
        along = np.einsum("tka,tia->tkia", gradient, f)  # what a strain E_aa is of each corner's place
        law = np.empty((len(area), 2, 2))
        law[:, 0, 0], law[:, 1, 1] = scene.membrane_warp, scene.membrane_weft
        law[:, 0, 1] = law[:, 1, 0] = scene.membrane_coupling
        strength, axis = np.linalg.eigh(law)
        forms = [
            Quadratic(
                scene.membranes,
                np.einsum("tkia,ta->tki", along, axis[:, :, k]),
                factor * area * np.maximum(strength[:, k], 0.0),
            )
            for k in range(2)
        ]
        angle = np.einsum("tka,tib->tkiab", gradient, f)
        angle = angle[..., 0, 1] + angle[..., 1, 0]
        return [*forms, Quadratic(scene.membranes, angle, factor * area * scene.membrane_shear)]


MEMBRANES = _Membranes()
