"""Contacts between balls, and of balls with sticks, against closed forms and the reference's contact law."""

import functools
from types import SimpleNamespace

import numpy as np
import pytest
import reference as ref
from physics_sticks import CROWD_STEPS, STICK_CASES, stick_run
from physics_support import (
    CONTACT_CASES,
    EPS,
    F64,
    record,
    simulate,
    vector,
)

import taichi_sim as ts

pytestmark = pytest.mark.long_in("f32")

H, G, R = 1e-3, 10.0, 0.05
STILL = EPS * G * H  # m/s: one kick of gravity, to its rounding

# Balls against balls --------------------------------------------------------------------------------------------------

MASSES = (1e-4, 1e-2, 1.0, 1e2, 1e4)
RESTITUTIONS = (0.0, 0.3, 1.0)


@functools.cache
def collision_scene(dim):
    """Overlapping pairs, far from each other, around the origin; the first step is the collision."""
    rng = np.random.default_rng(5)
    scene = ts.Scene(dim=dim)
    for e in RESTITUTIONS:
        scene.add_material(f"e{e}", restitution=e)
    at, places = SimpleNamespace(hits=[]), iter(np.ndindex(*([40] * 2)))

    def pair(n, v, mass, material=("default", "default"), depth=1e-3, **more):
        i, j = next(places)
        middle = vector(dim, (i - 5) * 0.7, (j - 20) * 0.7, 0.3 * (i + j) - 4.0)
        b = []
        for k in (0, 1):
            x = middle + (k - 0.5) * (2 * R - depth) * n
            b.append(int(scene.add_balls([x], radius=R, velocity=v[k], mass=mass[k], material=material[k], **more)[0]))
        return b

    for m in MASSES:
        for e in RESTITUTIONS:
            for glancing in (False, True):
                n = rng.normal(size=dim)
                n /= np.linalg.norm(n)
                v = np.array([1.0 * n, -0.5 * n]) + (rng.normal(size=(2, dim)) if glancing else 0.0)
                if (v[1] - v[0]) @ n > -0.05:
                    v[0] += 3.0 * n
                # the pair takes the larger restitution: the other ball has none
                at.hits.append((pair(n, v, (1.0, m), (f"e{e}", "e0.0")), n, e))
    n = vector(dim, 0.6, 0.8)
    closing = (n, -n)
    at.apart = pair(n, (-n, n), (1.0, 1.0), ("e1.0", "e1.0"))
    at.spring = pair(n, closing, (1.0, 1.0))
    scene.add_springs([at.spring], stiffness=0.0)
    at.body = pair(n, closing, (1.0, 1.0), body=scene.new_body())
    at.pinned = pair(n, closing, (1.0, 1.0), ("e1.0", "e1.0"))
    scene.set_balls(at.pinned[0], pinned=True)
    at.both_pinned = pair(n, closing, (1.0, 1.0), pinned=True)
    at.same_place = pair(n, closing, (1.0, 3.0), depth=2 * R)  # coincident
    at.same_place_at_rest = pair(n, (0 * n, 0 * n), (1.0, 3.0), depth=2 * R)
    at.zero_spring = pair(n, (0 * n, 0 * n), (1.0, 3.0), depth=2 * R)
    scene.add_springs([at.zero_spring], stiffness=100.0, damping=1.0, rest_length=0.3)
    at.zero_rest = pair(n, (0 * n, 0 * n), (1.0, 3.0), depth=2 * R)
    scene.add_springs([at.zero_rest], stiffness=100.0, damping=1.0, rest_length=0.0)
    at.slow = pair(n, (0.001 * n, -0.001 * n), (1.0, 1.0), ("e1.0", "e1.0"))
    return scene, at


@pytest.fixture(scope="module", params=CONTACT_CASES)
def hit(request):
    dim, method, variant = request.param
    scene, at = collision_scene(dim)
    with simulate(
        scene, variant, integrator=method, dt=H, contact_iterations=2
    ) as sim:  # lone pairs need no more to be exact
        x, v = record(sim, 20, 1)
    return SimpleNamespace(dim=dim, method=method, scene=scene, at=at, x=x, v=v)


def touch_normal(r, u, reach):
    """Line of centres when the distance of two balls, r apart [m] with the velocity u [m/s], was `reach`; at most a step ago."""
    b, w = r @ u, u @ u
    t = max(-H, -(b + np.sqrt(max(0.0, b * b - w * (r @ r - reach * reach)))) / w)
    return (r + t * u) / np.linalg.norm(r + t * u)


@pytest.mark.slow
def test_collisions_of_masses_from_1e_4_to_1e4(hit):
    m = hit.scene.mass
    for (i, j), n, e in hit.at.hits:
        if hit.method == "explicit_euler":  # it moves first and solves contacts where the balls are then
            n, _ = ref.direction(hit.x[1], i, j)
        v1, v2 = hit.v[0, i], hit.v[0, j]
        speed = np.linalg.norm(v2 - v1)
        got = hit.v[1, [i, j]]
        # rules that solve impacts in turn take the normal of the moment of touch, others that of where the balls are found
        normals = n, touch_normal(hit.x[0, j] - hit.x[0, i], v2 - v1, hit.scene.radius[[i, j]].sum())
        n = min(normals, key=lambda n: np.abs(got - np.array(ref.two_body_collision(m[i], m[j], v1, v2, n, e))).max())
        want = ref.two_body_collision(m[i], m[j], v1, v2, n, e)
        # the normal is known to the rounding of the positions, some metres from the origin
        slack = (1e-12 if F64 else 2e-4) * speed
        assert np.max(np.abs(got - np.array(want))) < slack, f"masses 1 and {m[j]}, e = {e}"
        p0, p1 = m[i] * v1 + m[j] * v2, m[i] * got[0] + m[j] * got[1]
        assert np.max(np.abs(p1 - p0)) < 8 * EPS * (m[i] + m[j]) * max(1.0, np.abs(got).max())
        u, W = float(n @ (v2 - v1)), 1 / m[i] + 1 / m[j]
        lost = 0.5 * (m[i] * (got[0] @ got[0] - v1 @ v1) + m[j] * (got[1] @ got[1] - v2 @ v2))
        scale = 0.5 * (m[i] * v1 @ v1 + m[j] * v2 @ v2)
        assert abs(lost + (1 - e * e) * u * u / (2 * W)) < (1e-12 if F64 else 2e-4) * scale
        assert np.max(np.abs(hit.v[-1, [i, j]] - got)) < slack  # and nothing after it


def test_separating_balls_are_left_alone(hit):
    assert np.array_equal(hit.v[-1, hit.at.apart], hit.v[0, hit.at.apart])


def test_a_slow_approach_bounces_as_a_fast_one(hit):
    """Nothing pushes these 2 mm/s: without gravity there is no speed below which balls rest."""
    i, j = hit.at.slow
    want = hit.v[0, [j, i]]  # equal masses, e = 1
    assert np.max(np.abs(hit.v[-1, [i, j]] - want)) < (1e-12 if F64 else 1e-3) * 0.002


@pytest.mark.parametrize("who", ["spring", "body", "both_pinned"])
def test_these_do_not_collide(hit, who):
    pair = getattr(hit.at, who)
    assert np.max(np.abs(hit.v[-1, pair] - hit.v[0, pair])) < 4 * EPS
    moved = hit.x[0, pair] + 20 * H * hit.v[0, pair]
    assert np.max(np.abs(hit.x[-1, pair] - moved)) < 100 * EPS * np.abs(moved).max()


def test_pinned_ball_gives_all_to_the_other(hit):
    i, j = hit.at.pinned
    assert np.all(hit.v[:, i] == 0.0)
    assert np.all(hit.x[:, i] == hit.x[0, i])
    assert np.max(np.abs(hit.v[1, j] + hit.v[0, j])) < (1e-12 if F64 else 1e-5)


@pytest.mark.parametrize("who", ["same_place", "same_place_at_rest", "zero_spring", "zero_rest"])
def test_coincident_balls_stay_finite_and_keep_their_centre(hit, who):
    pair, m = getattr(hit.at, who), hit.scene.mass
    assert np.all(np.isfinite(hit.x[:, pair]))
    assert np.all(np.isfinite(hit.v[:, pair]))
    assert np.max(np.abs(hit.v[:, pair])) < 10.0
    share = m[pair] / m[pair].sum()
    p = share @ hit.v[0, pair]
    assert np.max(np.abs(np.einsum("i,kid->kd", share, hit.v[:, pair]) - p)) < 32 * EPS
    centre = share @ hit.x[0, pair] + np.outer(np.arange(21) * H, p)
    assert np.max(np.abs(np.einsum("i,kid->kd", share, hit.x[:, pair]) - centre)) < 50 * EPS * np.abs(centre).max()
    if who in ("same_place_at_rest", "zero_spring"):
        assert np.linalg.norm(hit.x[-1, pair[1]] - hit.x[-1, pair[0]]) > 1e-3  # they do separate
    if who == "zero_rest":
        assert np.array_equal(hit.v[-1, pair], hit.v[0, pair])  # F = -k r is 0 there


# Sticks ---------------------------------------------------------------------------------------------------------------

WORKED = {0.5: (1 / 3, -2 / 3, -2 / 3), 0.25: (3 / 13, -12 / 13, -4 / 13), 0.0: (0.0, -1.0, 0.0)}


@pytest.fixture(scope="module", params=STICK_CASES)
def sticks(request):
    return stick_run(*request.param)


@pytest.mark.slow
def test_worked_stick_numbers(sticks):
    """Section 4: unit masses, e = 1, the ball at -1 along the normal; velocities after of ball, end 2 and end 3."""
    for b, n, t in sticks.at.worked:
        want = np.outer(WORKED[t], n)
        assert np.max(np.abs(sticks.one.v[b] - want)) < (1e-12 if F64 else 2e-5), f"t = {t}: {sticks.one.v[b] @ n}"


@pytest.mark.slow
def test_stick_hits_of_any_masses(sticks):
    for b, n, t, e in sticks.at.random:
        w = 1 / sticks.scene.mass[b]
        want, _ = ref.contact_impulse([1.0, t - 1.0, -t], w, sticks.before[b], n, e)
        found = np.max(np.abs(sticks.one.v[b] - want)) / np.max(np.abs(sticks.before[b]))
        # without a bounce the stick of 1 m turns under the ball, and the same step's second solve holds them together again
        turn = 2 * H * np.max(np.abs(sticks.before[b])) if e == 0.0 else 0.0
        tolerance = turn + (1e-12 if F64 else 2e-4)
        assert found < tolerance, f"t = {t:.3f}, e = {e}: {found:.2e}"


@pytest.mark.slow
def test_pinned_stick_reflects(sticks):
    b, n = sticks.at.pinned
    far = (
        EPS * np.max(np.abs(sticks.scene.position[b])) / 0.09
    )  # the angle that rounded coordinates leave, 0.09 m apart
    assert np.max(np.abs(sticks.one.v[b] - np.outer([1.0, 0.0, 0.0], n))) < (1e-12 if F64 else 4 * far)


@pytest.mark.slow
def test_beyond_the_end_there_is_no_stick(sticks):
    b, _ = sticks.at.beyond
    assert np.array_equal(sticks.one.v[b], sticks.before[b])


@pytest.mark.slow
def test_hit_at_a_joint_counts_once(sticks):
    b, n = sticks.at.joint
    assert np.max(np.abs(sticks.one.v[b] - np.outer([0.0, -1.0, 0.0, 0.0], n))) < (1e-12 if F64 else 2e-5)


@pytest.mark.slow
def test_momentum_of_a_crowd_with_sticks(sticks):
    """1000 balls, springs and sticks, with friction: f64 1e-13 sum m|v| sqrt(steps)."""
    b = sticks.at.crowd
    m = sticks.scene.mass[b]
    change = m @ sticks.last.v[b] - m @ sticks.before[b]
    size = float(m @ np.linalg.norm(sticks.before[b], axis=1))
    tolerance = (1e-13 if F64 else 1e-13 * 2.0**29) * size * np.sqrt(CROWD_STEPS)
    assert np.max(np.abs(change)) < tolerance
    assert np.all(np.isfinite(sticks.last.x))


@pytest.mark.slow
def test_crowd_with_sticks_gains_no_energy(sticks):
    scene = sticks.scene
    start = ref.energy(
        ref.network(1 / scene.mass, scene.pairs, scene.stiffness, scene.damping, scene.rest_length, scene.gravity),
        scene.position,
        scene.velocity,
    )
    assert sticks.last.energy.total < sum(start) * (1 + 1e-9)
