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

__all__ = ["MEMBRANES", "MembraneMethods", "flattened", "require_coupling", "shape_gradients"]

Floats = NDArray[np.float64]
ROOM = 1.5  # times the stiffness at rest: what a sheet has that is stretched by a seventh
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
                see `physics.md`; at least 0, None or inf: never [N/m].
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
        return self.tables["membranes"].append(t, corners=ij, rest=flat, coupling=both, **columns)  # type: ignore[no-any-return]


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
    stress = np.einsum("tij,tj->ti", law, strain)
    energy = 0.5 * np.sum(strain * stress, axis=1)
    mean, half = 0.5 * (stress[:, 0] + stress[:, 1]), 0.5 * (stress[:, 0] - stress[:, 1])
    (gives,) = np.nonzero(mean - np.hypot(half, stress[:, 2]) < -limit)
    if not len(gives):
        return energy
    strain, law, limit, stress = strain[gives], law[gives], limit[gives], stress[gives]
    starts = [
        np.full(len(gives), a) for a in np.linspace(0.0, 2.0 * np.pi, 32, endpoint=False)
    ]  # twice the angles of directions
    starts.append(np.arctan2(-stress[:, 2], -half[gives]))  # of the least principal stress
    gain = [_fold_terms(angle, stress, law, limit)[0] for angle in starts]
    best = np.array(starts)[np.argmax(gain, axis=0), np.arange(len(gives))]
    for _ in range(6):  # of Newton's method
        _, slope, rise = _fold_terms(best, stress, law, limit)
        best -= np.clip(slope / np.maximum(np.abs(rise), 1e-300), -0.2, 0.2)
    less = energy[gives] - 0.5 * _fold_terms(best, stress, law, limit)[0]
    det = law[:, 0, 0] * law[:, 1, 1] - law[:, 0, 1] ** 2
    one, other = limit * (law[:, 1, 1] - law[:, 0, 1]), limit * (law[:, 0, 0] - law[:, 0, 1])
    u, v, uv = -(one + det * strain[:, 0]), -(other + det * strain[:, 1]), -0.5 * det * strain[:, 2]
    crushed = (u > 0) & (v > 0) & (u * v > uv * uv)
    flat = -limit * (strain[:, 0] + strain[:, 1] + 0.5 * (one + other) / np.where(crushed, det, 1.0))
    energy[gives] = np.where(crushed, flat, less)
    return energy


def _fold_terms(angle: Floats, stress: Floats, law: Floats, limit: Floats) -> tuple[Floats, Floats, Floats]:
    """Twice the energy that folds take off along directions by twice their angles; what is 0 where that is greatest, and its
    derivative."""
    c, s = np.cos(angle), np.sin(angle)
    along, beside = np.stack([0.5 + 0.5 * c, 0.5 - 0.5 * c, s], axis=1), np.stack([-0.5 * s, 0.5 * s, c], axis=1)
    bent = np.stack([-0.5 * c, 0.5 * c, -s], axis=1)
    stiff, turned = (np.einsum("tij,tj->ti", law, w) for w in (along, beside))
    p, q, dq = (np.sum(a * b, axis=1) for a, b in ((along, stiff), (along, stress), (beside, stress)))
    q = q + limit
    kappa = np.sum(beside * stiff, axis=1)
    rise = np.sum(bent * stress, axis=1) * p + dq * kappa - q * np.sum(beside * turned + bent * stiff, axis=1)
    return np.where(q < 0, q * q / np.maximum(p, 1e-300), 0.0), dq * p - q * kappa, rise


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
