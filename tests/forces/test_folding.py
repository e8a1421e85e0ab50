"""Membranes that give way to compression: their energy, what a strip bears, coarse cloth on a sphere."""

import numpy as np
import pytest
from physics_support import F64, simulate
from scene_files import assert_unchanged

import taichi_sim as ts
from taichi_sim.device.engine import ti
from taichi_sim.forces.folding import folded
from taichi_sim.scene.membranes import folded_energy


def laws(n, seed):
    """Laws (n, 3, 3), limits (n,) and strains (n, 3) at random, of all that folds, by turns without a limit, without shear and
    with a coupling that is the root of warp times weft, or minus that."""
    rng = np.random.default_rng(seed)
    one, unlike, shear = 10.0 ** rng.uniform((0, -6, -3), (3, 6, 2), (n, 3)).T
    kind, unlike = np.arange(n), np.where(rng.random(n) < 0.5, unlike, unlike**0.1)
    root = one * np.sqrt(unlike)
    law = np.zeros((n, 3, 3))
    law[:, 0, 0], law[:, 1, 1], law[:, 2, 2] = one, one * unlike, np.where(kind % 7, shear * root, 0.0)
    most = 1.0 - np.where(kind % 11, 10.0 ** rng.uniform(-4, 0, n), 0.0)
    law[:, 0, 1] = law[:, 1, 0] = np.where((rng.random(n) < 0.5) | (kind % 77 == 0), most, -most) * root
    limit = np.where(kind % 2, 0.0, np.minimum(one, one * unlike) * 10.0 ** rng.uniform(-4, 0, n))
    return law, limit, 10.0 ** rng.uniform(-4, 0, (n, 1)) * rng.normal(size=(n, 3))


def least_energy(strain, law, limit):
    """Energy (n,) of the best of folds in any direction, by search, or of a state in which the stress is -limit."""
    flat = 0.5 * np.einsum("ti,tij,tj->t", strain, law, strain)

    def off(angle):
        fold = np.stack([np.cos(angle) ** 2, np.sin(angle) ** 2, np.sin(2.0 * angle)], axis=-1)
        along = np.einsum("tij,t...j->t...i", law, fold)
        q = np.einsum("ti,t...i->t...", strain, along) + (limit if angle.ndim == 1 else limit[:, None])
        return 0.5 * np.minimum(0.0, q) ** 2 / np.maximum(np.sum(fold * along, axis=-1), 1e-300)

    # of axes drawn by warp and weft alike; closer beside them and halfway between, where folds may take off much more than around
    fine = np.concatenate([[0.0], np.geomspace(1e-8, 0.25 * np.pi, 300)])
    drawn = np.unique(np.concatenate([0.25 * np.pi * k + side * fine for k in range(-1, 3) for side in (-1, 1)]))
    draw = (law[:, 0, 0] / law[:, 1, 1])[:, None] ** 0.25
    angles = np.unwrap(np.arctan2(draw * np.sin(drawn), np.cos(drawn)), axis=1)
    each, at = np.arange(len(law)), np.argmax(off(angles), axis=1)
    low, high = angles[each, np.maximum(at - 1, 0)], angles[each, np.minimum(at + 1, len(drawn) - 1)]
    for _ in range(80):
        one, other = high - 0.618034 * (high - low), low + 0.618034 * (high - low)
        better = off(one) > off(other)
        low, high = np.where(better, low, one), np.where(better, other, high)
    least = flat - np.maximum(off(0.5 * (low + high)), off(angles[each, at]))
    for t in np.flatnonzero(np.linalg.eigvalsh(law)[:, 0] > 1e-12 * np.einsum("tii->t", law)):
        u, v, uv = -limit[t] * np.linalg.solve(law[t], [1.0, 1.0, 0.0]) - strain[t]
        if u > 0.0 and v > 0.0 and u * v > 0.25 * uv**2:
            pressed = strain[t] + (u, v, uv)
            least[t] = 0.5 * pressed @ law[t] @ pressed + limit[t] * (u + v)
    return least


def low(stress):
    """Least principal stress (n,)."""
    return 0.5 * (stress[:, 0] + stress[:, 1]) - np.hypot(0.5 * (stress[:, 0] - stress[:, 1]), stress[:, 2])


@pytest.mark.once
def test_folds_take_off_as_much_energy_as_they_can():
    """By as much as in the best direction, and no sum of three folds takes off more. So much holds of all sheets that fold."""
    law, limit, strain = laws(2000, 3)
    found, flat = folded_energy(strain, law, limit), 0.5 * np.einsum("ti,tij,tj->t", strain, law, strain)
    assert 0.3 < np.mean(found < flat - 1e-9) < 0.95  # else nothing folds
    assert (np.abs(found - least_energy(strain, law, limit)) < 1e-9 * flat).all()
    rng = np.random.default_rng(4)
    size = np.abs(strain).max(axis=1)
    for _ in range(100):
        angle, part = rng.uniform(0, np.pi, (3, len(law))), 3.0 * size * rng.uniform(0, 1, (3, len(law))) ** 3
        fold = np.stack([np.cos(angle) ** 2, np.sin(angle) ** 2, np.sin(2 * angle)], axis=-1)
        fold = np.sum(part[..., None] * fold, axis=0)
        whole = strain + fold
        other = 0.5 * np.einsum("ti,tij,tj->t", whole, law, whole) + limit * (fold[:, 0] + fold[:, 1])
        assert (other > found - 1e-9 * flat).all()


@ti.kernel
def fold_all(membranes: ti.template(), strain: ti.types.ndarray(), found: ti.types.ndarray()):
    for t in range(membranes.count):
        row = membranes.triangle[t]
        given = ti.Vector([strain[t, 0], strain[t, 1], strain[t, 2]])
        stress, energy, share, across, turn = folded(given, row)
        for k in ti.static(range(3)):
            found[t, k], found[t, 5 + k], found[t, 8 + k] = stress[k], across[k], turn[k]
        found[t, 3], found[t, 4] = energy, share


def fold(membranes, strain):
    """Stress (n, 3), energy (n,) and derivative of the stress (n, 3, 3), all times the area, by kernel."""
    found = np.zeros((len(strain), 11), strain.dtype)
    fold_all(membranes, strain, found)
    row = {name: membranes.triangle.to_numpy()[name].astype(float) for name in ("warp", "weft", "shear", "coupling")}
    law = np.zeros((len(strain), 3, 3))
    law[:, 0, 0], law[:, 1, 1], law[:, 2, 2] = row["warp"], row["weft"], row["shear"]
    law[:, 0, 1] = law[:, 1, 0] = row["coupling"]
    stress, energy, share, across, turn = np.split(found.astype(float), [3, 4, 5, 8], axis=1)
    off = across[:, :, None] * across[:, None] + turn[:, :, None] * turn[:, None]
    return stress, energy[:, 0], share[:, :, None] * law - off


@pytest.mark.parametrize("size", [1.0, 3e-6])
def test_kernels_fold_as_numpy_does(size):
    """Triangles of 1 m and of 3 um: no stress is below the limit, and what implicit methods take for its derivative is that."""
    law, limit, strain = laws(2000, 8)
    law, limit, strain = size * law, size * limit, strain.astype(np.float64 if F64 else np.float32)
    scene, n = ts.Scene(dim=3), len(law)
    x = np.zeros((n, 3, 3))
    x[:, 1, 0] = x[:, 2, 1] = size
    scene.add_balls(x.reshape(-1, 3), radius=0.1 * size)
    moduli = {"warp": law[:, 0, 0], "weft": law[:, 1, 1], "shear": law[:, 2, 2], "coupling": law[:, 0, 1]}
    scene.add_membranes(np.arange(3 * n).reshape(n, 3), compression_limit=limit, **moduli)
    with simulate(scene, integrator="symplectic_euler", dt=1e-6, contacts="off") as sim:
        (membranes,) = sim.parts.forces.elements
        stress, energy, rate = fold(membranes, strain)
        if F64:
            step = 1e-7 * np.abs(strain).max(axis=1)[:, None]
            sides = [[fold(membranes, strain + side * step * d)[0] for side in (1, -1)] for d in np.eye(3)]
    area, near = (
        0.5 * size**2,
        1e-9 if F64 else 1e-5,
    )  # of what softest directions of folds are taken for, and of rounding
    stiff = np.einsum("tii->ti", law).copy()
    off = np.abs(energy / area - folded_energy(strain.astype(float), law, limit))
    assert (off < near * np.sum(stiff * strain**2, axis=1)).all()
    assert (low(stress / area) > -limit - near * np.abs(np.einsum("tij,tj->ti", law, strain)).max(axis=1)).all()
    stiff[:, 2] = np.maximum(stiff[:, 2], 1e-3 * np.sqrt(stiff[:, 0] * stiff[:, 1]))  # or no shear would divide by 0
    assert np.linalg.eigvalsh(rate / area / np.sqrt(stiff[:, :, None] * stiff[:, None])).min() > -near
    if F64:
        change = np.stack([(one - other) / (2.0 * step) for one, other in sides], axis=2)
        wrong = np.abs(change - rate).max(axis=(1, 2)) / (area * stiff.max(axis=1))
        assert np.quantile(wrong, 0.99) < 1e-6  # in the others such a step may lead into another state


@pytest.mark.parametrize(
    "fabric", [{"weft": 80.0, "shear": 0.0, "coupling": -25.0}, {"weft": 80.0, "coupling": 80.0}, {"weft": 8e-4}]
)
def test_a_sheet_that_folds_keeps_its_energy(fabric):
    """Of fabrics without shear, that keep their area, and with threads a hundred thousand times as soft along the weft."""
    scene = ts.Scene(dim=3, gravity=(0.0, 0.0, 0.0))
    made = {"warp": 80.0, "shear": 20.0, "bending_rigidity": 0.0, "mass_per_area": 0.2, "damping": 0.0} | fabric
    ts.shapes.cloth(scene, (0.3, 0.3), (6, 6), folds=True, **made)
    speed = np.random.default_rng(1).normal(size=(scene.n_balls, 3)) * (0.4, 0.1, 0.4)
    scene.set_balls(velocity=speed)
    with simulate(scene, integrator="verlet", dt=4e-5, substeps=1, contacts="off") as sim:
        start = sim.energy().total
        for _ in range(5):
            sim.run(0.04)
            assert sim.energy().total == pytest.approx(start, rel=1e-3)


@pytest.mark.parametrize("angle", [0.0, 90.0])
def test_a_sheet_that_is_pressed_bears_euler_s_load_of_a_triangle(angle):
    """Between two rows of balls that are held nearer than at rest, whose springs would bear four times as much."""
    wide, long, rigidity = 0.5, 0.8, 2e-3
    scene = ts.Scene(dim=3, gravity=(0.0, 0.0, 0.0))
    fabric = {"warp": 90.0, "weft": 60.0, "shear": 20.0, "warp_angle": angle, "bending_rigidity": rigidity}
    ts.shapes.cloth(scene, (long, wide), (9, 6), folds=True, mass_per_area=0.2, **fabric)
    x = scene.position.copy()
    x[:, 0] *= 0.9
    scene.set_balls(position=x)
    with simulate(scene, integrator="symplectic_euler", dt=1e-6, substeps=1, contacts="off") as sim:
        sim.step(1)
        force = sim.velocity * scene.mass[:, None] / 1e-6
    edge = np.isclose(x[:, 0], 0.0)
    limit = np.pi**2 * rigidity / 0.01  # squares of 10 cm
    shortened = 0.9  # by which the force of a stress per length at rest is smaller
    assert force[edge, 0].sum() == pytest.approx(-limit * wide * shortened, rel=1e-6 if F64 else 1e-3)


def sides(n):
    """Mean height [m] of the middles of the sides of a sheet on a sphere 0.5 m wide, its middle held, after 0.75 s."""
    scene = ts.Scene(dim=3, gravity=(0.0, -9.81, 0.0))
    ts.shapes.cloth(
        scene,
        (1, 1),
        (n, n),
        warp=600.0,
        shear=200.0,
        mass_per_area=0.2,
        position=(-0.5, 0.26, -0.5),
        radius=0.005,
        folds=True,
    )
    x = scene.position.copy()
    angle, r = np.arctan2(x[:, 2], x[:, 0]), np.hypot(x[:, 0], x[:, 2])
    x[:, 1] += 0.12 * r**2 * (1.0 + np.cos(4.0 * angle))
    scene.set_balls(position=x)
    scene.set_balls([n * n // 2], pinned=True)
    scene.add_collider(ts.Sphere((0, 0, 0), 0.25))
    with simulate(scene, integrator="implicit_euler", dt=1 / 120, substeps=1) as sim:
        sim.run(0.75)
        y = sim.position[:, 1].reshape(n, n)
    return np.mean([y[0, n // 2], y[-1, n // 2], y[n // 2, 0], y[n // 2, -1]])


@pytest.mark.slow
def test_a_coarse_cloth_drapes_as_a_fine_one():
    """Without folds the sides of 17 and 33 balls are 50 mm apart: flat triangles resist curved folds."""
    coarse, fine = sides(17), sides(33)
    assert coarse < -0.08
    assert abs(coarse - fine) < 0.01


@pytest.mark.once
@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"folds": True, "stretch_stiffness": 50.0}, r"cloth.folds: is for a cloth of triangles; give warp"),
        ({"warp": 50.0, "folds": "yes"}, r"cloth.folds"),
        ({"warp": 50.0, "folds": 2}, r"cloth.folds"),
        (
            {"warp": 50.0, "weft": 0.0, "folds": True},
            r"cloth.weft: 0.0 is not allowed; it must be from 1e-06 to 1e\+06",
        ),
        ({"warp": 0.0, "weft": 5.0, "folds": True}, r"cloth.weft: 5.0 is not allowed"),
        ({"warp": 1.0, "weft": 1.1e6, "folds": True}, r"cloth.weft: 1100000.0 is not allowed"),
    ],
)
def test_refusals(given, message):
    assert_unchanged(ts.Scene(dim=3), lambda scene: ts.shapes.cloth(scene, **given), message)


@pytest.mark.once
def test_a_limit_below_0_is_refused():
    scene = ts.Scene(dim=3)
    scene.add_balls(np.eye(3), radius=0.01)
    given = {"warp": 1.0, "compression_limit": -0.1}
    assert_unchanged(
        scene, lambda scene: scene.add_membranes([[0, 1, 2]], **given), r"membranes.compression_limit.*-0.1"
    )


@pytest.mark.once
def test_only_what_folds_needs_threads_along_both_axes():
    scene = ts.Scene(dim=3)
    scene.add_balls(np.repeat(np.eye(3), 2, axis=0), radius=0.01)
    given = {"warp": 1.0, "weft": [0.0, 0.0], "shear": 1.0, "compression_limit": [np.inf, 0.1]}
    two = [[0, 2, 4], [1, 3, 5]]
    assert_unchanged(scene, lambda scene: scene.add_membranes(two, **given), r"membranes.weft\[1\]: 0.0 is not allowed")
    scene.add_membranes(two, **given | {"compression_limit": None})
