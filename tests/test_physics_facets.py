"""Triangles that collide: found as by brute force, solved as by hand, and never gone through."""

import numpy as np
import pytest
import reference_facets as ref
from physics_support import F64, simulate

import taichi_sim as ts

H = 1e-3
ROUNDING = 1e-12 if F64 else 2e-5


# Against brute force ----------------------------------------------------------------------------------------------------

BALLS, LOOSE, TRIANGLES = 26, 6, 14


def soup():
    """Random triangles that share balls, and loose balls among them, all of one body so that only surfaces count."""
    rng = np.random.default_rng(3)
    scene = ts.Scene(dim=3)
    n = BALLS + LOOSE
    x = rng.uniform(0.0, 1.0, (n, 3))
    radius = rng.uniform(0.03, 0.1, n)
    balls = scene.add_balls(
        x, radius=radius, mass=10 ** rng.uniform(-2, 2, n), pinned=rng.uniform(size=n) < 0.1, body=1
    )
    t = np.array([[i, i + 1, i + 2] for i in range(0, TRIANGLES)] + [[k, k + 1, k + 2] for k in (17, 20, 23)])
    scene.add_triangles(balls[t], collides=True)
    scene.add_springs([[0, 5], [3, 18], [4, 9]], stiffness=0.0)
    return scene


def rows(sim):
    """The listed pairs as (balls, weights, normal, distance, thickness or -1)."""
    facets = sim._parts.contacts.facets
    used = int(facets.used[0])
    row = facets.row
    member, weight = (f.to_numpy()[: 4 * used].reshape(-1, 4) for f in (facets.member, facets.weight))
    columns = (row.normal.to_numpy(), row.distance.to_numpy(), row.thickness.to_numpy())
    return list(zip(map(tuple, member.tolist()), weight, *columns))


def key(edge, balls):
    """A name for a pair that does not depend on the order of its sides, nor within them."""
    cut = 2 if edge else 1
    sides = tuple(sorted(balls[:cut])), tuple(sorted(balls[cut:]))
    return tuple(sorted(sides)) if edge else sides


@pytest.fixture(scope="module", params=["fused", "parallel"])
def soup_run(request):
    scene = soup()
    settings = {"dt": H, "integrator": "symplectic_euler", "contacts": "jacobi", "contact_passes": 1}
    with simulate(scene, ("ordered", request.param), **settings) as sim:
        yield sim


def draw(rng, scene):
    """Positions in a random box, flat in some of them, and velocities of some metres a second."""
    n = scene.n_balls
    x = rng.uniform(0.0, 1.0, (n, 3)) * rng.choice([0.1, 0.4, 1.0], 3) + rng.uniform(-2, 2, 3)
    v = rng.normal(size=(n, 3)) * rng.choice([0.0, 1.0, 30.0])
    v[scene.pinned] = 0.0
    return (a.astype(np.float64 if F64 else np.float32).astype(np.float64) for a in (x, v))


def test_pairs_and_one_pass_as_by_brute_force(soup_run):
    sim, scene = soup_run, soup_run.scene
    rng = np.random.default_rng(1)
    w = np.where(scene.pinned, 0.0, 1.0 / scene.mass)
    slack = 1e-9 if F64 else 3e-5
    contacts = passes = 0
    for _ in range(24):
        x, v = draw(rng, scene)
        sim.resume(x, v, 0.0)
        sim.contacts()  # finds them
        listed = ref.pairs(x, v, scene.radius, scene.triangles, scene.pairs, H, scene.position)
        listed = {key(p.edge, p.balls): p for p in listed if w[list(p.balls)].any()}
        kinds = sim._parts.contacts.facets.row.kind.to_numpy()
        found = {}
        for c, (balls, *row) in enumerate(rows(sim)):
            assert key(kinds[c] > 0, balls) not in found, "a pair is listed twice"
            found[key(kinds[c] > 0, balls)] = row
        for name in listed.keys() ^ found.keys():
            assert name in listed, f"{name} is listed, and not near"
            assert listed[name].margin < slack, f"{name} is missing: {listed[name]}"
        for name, (_, n, d, thickness) in found.items():
            p = listed[name]
            assert abs(d - p.distance) < slack
            if p.margin > slack:
                assert (thickness >= 0) == p.contact
                if p.contact:
                    assert abs(thickness - p.thickness) < slack
                    assert np.abs(n @ p.normal) > 1 - 1e-3
                    contacts += 1
        if all(p.margin > slack for p in listed.values()) and len(listed):
            after = ref.one_pass([p for p in listed.values() if p.contact], v, w, 0.0, H, 0.01)
            sim.step()
            np.testing.assert_allclose(sim.velocity, after, atol=(1e-9 if F64 else 1e-3) * (1e-3 + np.abs(v).max()))
            passes += np.any(after != v)
    assert contacts > 300
    assert passes > 4
