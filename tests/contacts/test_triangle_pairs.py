"""Triangles that collide: found as by brute force, solved as by hand, and never gone through."""

import numpy as np
import pytest
import reference_facets as ref
from physics_support import F64, simulate
from taichi_sim.kernels.contacts.triangle_pairs import SHORTEST_LEVER

import taichi_sim as ts

pytestmark = pytest.mark.long_in("f32")

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
    t = np.array([[i, i + 1, i + 2] for i in range(TRIANGLES)] + [[k, k + 1, k + 2] for k in (17, 20, 23)])
    scene.add_triangles(balls[t], collides=True)
    scene.add_springs([[0, 5], [3, 18], [4, 9]], stiffness=0.0)
    return scene


def listed_pairs(sim):
    """The listed pairs as (balls, weights, normal, distance, thickness with a minus where it does not push)."""
    triangles = sim.parts.contacts.triangles
    used, table = int(triangles.used[0]), triangles.contact
    member, weight = (f.to_numpy()[: 4 * used].reshape(-1, 4) for f in (triangles.member, triangles.weight))
    columns = (table.normal.to_numpy(), table.distance.to_numpy(), table.thickness.to_numpy())
    return list(zip(map(tuple, member.tolist()), weight, *columns))


def key(edge, balls):
    """A name for a pair that does not depend on the order of its sides, nor within them."""
    cut = 2 if edge else 1
    sides = tuple(sorted(balls[:cut])), tuple(sorted(balls[cut:]))
    return tuple(sorted(sides)) if edge else sides


@pytest.fixture(scope="module", params=["fused", pytest.param("parallel", marks=pytest.mark.long)])
def soup_run(request):
    scene = soup()
    settings = {"dt": H, "integrator": "symplectic_euler", "contacts": "jacobi", "contact_iterations": 1}
    with simulate(scene, ("ordered", request.param), **settings) as sim:
        yield sim


def draw(rng, scene):
    """Positions in a random box, flat in some of them, and velocities of some metres a second."""
    n = scene.n_balls
    x = rng.uniform(0.0, 1.0, (n, 3)) * rng.choice([0.1, 0.4, 1.0], 3) + rng.uniform(-2, 2, 3)
    v = rng.normal(size=(n, 3)) * rng.choice([0.0, 1.0, 30.0])
    v[scene.pinned] = 0.0
    return (a.astype(np.float64 if F64 else np.float32).astype(np.float64) for a in (x, v))


def test_pairs_and_one_iteration_as_by_brute_force(soup_run):
    sim, scene = soup_run, soup_run.scene
    rng = np.random.default_rng(1)
    w = np.where(scene.pinned, 0.0, 1.0 / scene.mass)
    slack = 1e-9 if F64 else 3e-5
    contacts = iterations = 0
    for _ in range(24):
        x, v = draw(rng, scene)
        sim.resume(ts.Snapshot(x, v))
        sim.contacts()  # finds them
        listed = ref.pairs(x, v, scene.radius, scene.triangles, scene.pairs, H, scene.position)
        listed = {key(p.edge, p.balls): p for p in listed if w[list(p.balls)].any()}
        kinds = sim.parts.contacts.triangles.contact.kind.to_numpy()
        found = {}
        for c, (balls, *row) in enumerate(listed_pairs(sim)):
            assert key(kinds[c] > 0, balls) not in found, "a pair is listed twice"
            found[key(kinds[c] > 0, balls)] = row
        for name in listed.keys() ^ found.keys():
            assert name in listed, f"{name} is listed, and not near"
            assert listed[name].margin < slack, f"{name} is missing: {listed[name]}"
        for name, (_, n, d, thickness) in found.items():
            p = listed[name]
            assert abs(d - p.distance) < slack
            free, part = w[list(p.balls)] > 0, np.abs(p.g)
            if p.margin > slack and np.all(np.abs(part - SHORTEST_LEVER) > slack):
                held = p.contact and bool(np.any(free & (part > SHORTEST_LEVER)))  # else what moves is next to a pin
                assert (thickness >= 0) == held
                if held:
                    assert abs(thickness - p.thickness) < slack
                    assert np.abs(n @ p.normal) > 1 - 1e-3 or d < 1e-3
                    contacts += 1
        met = [listed[name] for name, row in found.items() if row[-1] >= 0]  # single precision decides some otherwise
        if min((p.distance for p in met), default=0.0) > 1e-6:
            after = ref.one_pass(met, v, w, 0.0, H, 0.01)
            sim.step()
            off = np.abs(sim.velocity - after).max(axis=1) / (1e-3 + np.abs(v).max())
            assert (
                off.max() < 1e-8 if F64 else np.median(off) < 1e-3
            )  # edges that cross have no normal in single precision
            iterations += np.any(after != v)
    assert contacts > 300
    assert iterations > 4


def test_corners_of_one_body_meet_as_balls_do():
    """Triangles of one body fly at each other tip to tip, off centre by a part of a radius, and come no nearer than their balls
    are thick."""
    scene, tips, thick = ts.Scene(dim=3), [], []
    for k, (off, radius, other) in enumerate(((0.0, 0.02, 0.02), (0.4, 0.03, 0.01), (0.7, 0.02, 0.05))):
        across = off * (radius + other)
        place = np.array(
            [[-0.1, 0, 0], [-0.6, 0.3, 0], [-0.6, -0.3, 0.1], [0.1, across, 0], [0.6, 0.2, 0], [0.6, -0.3, 0]]
        )
        place[:, 2] += 3.0 * k
        velocity = np.repeat([[4.0, 0, 0], [-3.0, 0, 0]], 3, axis=0)
        balls = scene.add_balls(place, radius=np.repeat([radius, other], 3), velocity=velocity, body=k + 1)
        scene.add_triangles(balls[[[0, 1, 2], [3, 4, 5]]], collides=True)
        tips.append(balls[[0, 3]])
        thick.append(radius + other)
    nearest = np.full(len(tips), np.inf)
    with simulate(scene, dt=H) as sim:
        for _ in range(60):
            sim.step()
            apart = [np.linalg.norm(np.subtract(*sim.position[two])) for two in tips]
            nearest = np.minimum(nearest, apart)
    assert np.all(nearest < 1.05 * np.array(thick))
    assert np.all(nearest > 0.98 * np.array(thick))


def test_how_near_one_body_comes_to_itself_does_not_jump():
    """Two triangles share a side; a ball that a spring joins to the corner of one of them moves across that side, and the
    distance at touch with it, from what a spring allows to what balls do."""
    scene = ts.Scene(dim=3)
    corners = scene.add_balls([[-0.5, 0, 0], [0.5, 0, 0], [0, 0, 1], [0, 0, -1]], radius=0.1, mass=1.0)
    scene.add_triangles(corners[[[0, 1, 2], [1, 0, 3]]], collides=True)
    ball = scene.add_balls([[0, 3.0, 0.9]], radius=0.6)[0]
    scene.add_springs([[ball, corners[2]]], stiffness=0.0)
    x, found = scene.position.copy(), []
    with simulate(scene, dt=H) as sim:
        for z in np.linspace(0.95, -0.4, 28):
            x[ball] = [0.1, 0.3, z]
            sim.resume(ts.Snapshot(x, np.zeros_like(x)))
            sim.contacts()  # finds them
            found.append([row[-1] for row in listed_pairs(sim) if row[0][0] == ball and row[-1] >= 0.0])
    assert all(len(each) == 1 for each in found)
    touch = np.ravel(found)
    assert touch[0] < 0.5
    assert np.allclose(touch[-1], 0.7)
    assert np.abs(np.diff(touch)).max() < 0.02


# Momentum and energy ----------------------------------------------------------------------------------------------------

PLACES, EACH = 150, 8


def clusters(friction):
    """Clusters far apart: two triangles that share an edge, one by itself, a loose ball; overlapping, of any masses."""
    rng = np.random.default_rng(5)
    scene = ts.Scene(dim=3)
    for k in range(6):
        rough = {"friction": rng.choice([0.3, 1.5]), "viscous_friction": rng.choice([0.0, 300.0])} if friction else {}
        scene.add_material(f"m{k}", restitution=(0.0, 0.3, 1.0)[k % 3] if friction else 0.0, **rough)
    at = np.stack(np.unravel_index(np.arange(PLACES), (6, 5, 5)), axis=1) * 1.0
    for k in range(PLACES):
        mass = 10 ** rng.uniform(-3, 3, EACH) if k % 3 else 1.0
        balls = scene.add_balls(
            np.repeat(at[k : k + 1], EACH, axis=0),
            radius=rng.uniform(0.01, 0.05, EACH),
            mass=mass,
            pinned=[k % EACH] if k % 2 else False,
            material=f"m{k % 6}",
        )
        scene.add_triangles(balls[[[0, 1, 2], [2, 1, 3], [4, 5, 6]]], collides=True)
    return scene, np.repeat(at, EACH, axis=0)


@pytest.fixture(scope="module", params=["rough-jacobi", "smooth-jacobi", "smooth-gauss_seidel"])
def cluster_run(request):
    surface, contacts = request.param.split("-")
    scene, at = clusters(surface == "rough")
    settings = {"dt": H, "integrator": "symplectic_euler", "contacts": contacts, "contact_iterations": 1}
    with simulate(scene, **settings) as sim:
        yield sim, at, contacts


@pytest.mark.long
def test_a_pass_keeps_momentum_and_never_adds_energy(cluster_run):
    """Any masses, pins, restitutions, frictions and spins, of triangles, edges and balls on top of each other, or further apart.

    Without friction all acts along the normals, between the closest points. Impulses p before the move act at places x, those q
    after it at y = x + h (v + p / m) + d, where d undoes overlap. So sum x p = sum y q = 0 for the moments, and
    sum m y w - sum m x v = sum m d (v + p / m) for the final velocities w. This is 0 where nothing was moved out of an overlap.
    One iteration of Jacobi has no q: its levers are those at x, whatever d is.
    """
    sim, at, contacts = cluster_run
    scene, rng = sim.scene, np.random.default_rng(2)
    free = np.where(scene.pinned, 0.0, scene.mass)
    spins = bool(sim.parts.model.spins)
    loose = ~np.any(scene.pinned.reshape(PLACES, EACH), axis=1)

    def total(values):
        return values.reshape(PLACES, EACH, *values.shape[1:]).sum(axis=1)

    def energy():
        return total(
            0.5 * free * (np.sum(sim.velocity**2, axis=1) + 0.4 * np.sum(sim.snapshot().surface_speed ** 2, axis=1))
        )

    met = unmoved = 0
    for k in range(60):
        wide = k >= 40
        size = 0.6 if wide else 0.15
        x = at + rng.uniform(0.0, size, at.shape)
        v = (rng.normal(size=at.shape) - 20.0 * (x - at - 0.5 * size)) * ~scene.pinned[:, None]
        turn = rng.normal(size=at.shape) * ~scene.pinned[:, None] if spins else None
        sim.resume(ts.Snapshot(x, v, surface_speed=turn))
        before, x, v = energy(), sim.position - at, sim.velocity
        p = total(free[:, None] * v)
        sim.step()
        assert np.max((energy() - before) / before) < (1e-13 if F64 else 1e-5)
        scale = total(free * np.linalg.norm(v, axis=1))[:, None]
        assert np.max((np.abs(total(free[:, None] * sim.velocity) - p) / scale)[loose]) < (1e-14 if F64 else 1e-6)
        changed = total(np.abs(sim.velocity - v).sum(axis=1)) > 0.0
        met += 0 if wide else np.count_nonzero(changed)
        if not spins:
            still = total(np.abs(sim.parts.contacts.position_correction.to_numpy()).sum(axis=1)) == 0.0
            still &= loose & changed
            unmoved += np.count_nonzero(still)
            gained = total(free[:, None] * (np.cross(sim.position - at, sim.velocity) - np.cross(x, v)))
            assert np.max((np.abs(gained) / (size * scale))[still], initial=0.0) < (1e-13 if F64 else 1e-5)
        if not spins and contacts == "jacobi":
            arm = total(free[:, None] * np.cross(x, sim.velocity - v))
            assert np.max((np.abs(arm) / (size * scale))[loose]) < (1e-13 if F64 else 1e-5)
    assert met > 0.9 * 40 * PLACES
    assert spins or unmoved > 10


@pytest.mark.long
def test_what_pins_hold_throws_nothing():
    """A pin beside the edge between two others, or led onto it: the third corner can do nothing about it."""
    scene, free = ts.Scene(dim=3), []
    for k, (z, led) in enumerate(((0.0, False), (0.0, True), (5e-4, False), (5e-4, True))):
        place = np.array([[0, 0, 0], [1, 0, 0], [0.5, 0, 1], [0.5, 0.15, z]])
        place[:, 0] += 10.0 * k
        a, b, c, pin = scene.add_balls(place, radius=0.1, pinned=[0, 1, 3])
        scene.add_triangles([[a, c, b]], collides=True)
        scene.add_springs([[a, c], [b, c]], stiffness=10.0, damping=0.1)
        if led:
            scene.add_moving_pins([pin], velocity=(0.0, -1.0, 0.0))
        free.append(c)
    held = np.setdiff1d(np.arange(16), [*free, 7, 15])
    with simulate(scene, dt=H) as sim:
        start = sim.position[held]
        for _ in range(20):
            sim.step(5)
            assert np.abs(sim.velocity[free]).max() < 2.0
        assert np.array_equal(sim.position[held], start)


# Nothing goes through ---------------------------------------------------------------------------------------------------

N, STEPS = 14, 300


def rim(n):
    """The balls on the four sides of a sheet of n x n."""
    i, j = np.divmod(np.arange(n * n), n)
    return np.flatnonzero((i % (n - 1) == 0) | (j % (n - 1) == 0))


def folded(x, layers, gap, rng):
    """A flat sheet of 1 m in x, z folded like an accordion along x: so many layers, a gap [m] apart."""
    r = gap / 2
    straight = (1.0 - (layers - 1) * np.pi * r) / layers
    s, out = x[:, 0], np.zeros_like(x)
    k, rest = np.divmod(s, straight + np.pi * r)
    turn = np.maximum(0.0, rest - straight) / r
    side = np.where(k % 2 == 0, 1.0, -1.0)
    flat = np.where(k % 2 == 0, np.minimum(rest, straight), straight - np.minimum(rest, straight))
    out[:, 0] = flat + side * r * np.sin(turn)
    out[:, 1] = 2 * r * k + r * (1 - np.cos(turn))
    out[:, 2] = x[:, 2]
    return out + rng.normal(0.0, 1e-4, x.shape)


def hall():
    """Far from each other: balls as small as a quarter of the spacing thrown at a sheet whose rim is pinned, a folded sheet that
    falls on the floor, and two sheets that fly through each other's places."""
    rng = np.random.default_rng(9)
    scene = ts.Scene(dim=3, gravity=(0.0, -10.0, 0.0))
    scene.add_material("cotton", friction=0.3)
    scene.add_material("rubber", restitution=0.6, friction=0.2)
    sheet = {"size": (1.0, 1.0), "resolution": (N, N), "surface_collision": True}
    net = ts.shapes.cloth(scene, **sheet, pinned=rim(N), stiffness=200.0, mass=0.2)
    number = 40
    x = rng.uniform(0.15, 0.85, (number, 3)) * [1, 0, 1] + [0, 0.06, 0] + rng.uniform(0, 0.3, (number, 1)) * [0, 1, 0]
    v = rng.normal(size=(number, 3)) - [0.0, 10.0, 0.0]
    v[::4] *= 4.0
    shot = scene.add_balls(x, radius=0.25 / (N - 1), velocity=v, mass=1e-3, material="rubber")
    fold = ts.shapes.cloth(scene, **sheet, material="cotton")
    shift = np.array([5.0, -0.8, 0.0])
    scene.set_balls(fold.balls, position=shift + folded(scene.position[fold.balls], 3, 0.08, rng))
    scene.add_wall((0, 1, 0), offset=-1.0, material="cotton")
    one = ts.shapes.cloth(scene, **sheet, position=(10.0, 0.3, 0.0))
    two = ts.shapes.cloth(scene, **sheet, position=(10.06, 0.5, 0.03), rotation=(4.0, 20.0, 3.0))
    scene.set_balls(one.balls, velocity=[0.0, 3.5, 0.0])
    scene.set_balls(two.balls, velocity=[0.0, -1.5, 0.0])
    return scene, net, shot


def beneath(x, corners):
    """Whether points x (k, 3) lie outside of the room between a sheet (t, 3, 3) and the plane of its flat rim, y = 0, below which
    they are: the solid angle that both together fill is 0."""
    lid = corners * [1.0, 0.0, 1.0]
    turns = np.zeros(len(x))
    for part, sign in ((corners, 1.0), (lid, -1.0)):
        a, b, c = np.moveaxis(part[None] - x[:, None, None], 2, 0)
        la, lb, lc = (np.linalg.norm(r, axis=2) for r in (a, b, c))
        dot = [np.sum(p * q, axis=2) for p, q in ((a, b), (b, c), (c, a))]
        volume = np.sum(a * np.cross(b, c), axis=2)
        angle = 2 * np.arctan2(volume, la * lb * lc + dot[0] * lc + dot[1] * la + dot[2] * lb)
        turns += sign * angle.sum(axis=1) / (4 * np.pi)
    over = np.all((x[:, ::2] > 0.0) & (x[:, ::2] < 1.0), axis=1)  # others have left the sheet by its side
    return over & (x[:, 1] < 0.0) & (np.abs(turns) < 0.5)


@pytest.fixture(scope="module")
def flight():
    """The hall with a look at it every 20 steps: names of the parts; crossings, balls that got through, and the lowest ball at
    each look; and the last state."""
    scene, net, shot = hall()
    looks = []
    with simulate(scene, dt=H) as sim:
        for _ in range(STEPS // 20):
            sim.step(20)
            x = sim.position
            through = int(beneath(x[shot], x[net.triangles]).sum())
            looks.append((sim.crossings(), through, x[shot, 1].min()))
        pinned = scene.pinned
        assert np.abs(sim.position[pinned] - scene.position[pinned]).max() < ROUNDING
        return sim.kernels(), np.array(looks), sim.position, sim.velocity


@pytest.mark.slow
def test_nothing_goes_through(flight):
    names, looks, _, v = flight
    assert "triangles" in names
    assert np.all(looks[:, 0] == 0), "edges pierce triangles"
    assert np.all(looks[:, 1] == 0), "balls went through"
    assert looks[:, 2].min() < -0.02  # and the sheet was hit
    assert np.linalg.norm(v, axis=1).max() < 45.0


def test_the_look_from_beneath_sees_what_it_looks_for():
    _, net, _ = hall()
    x = np.stack([*np.meshgrid(np.linspace(0, 1, N), [0.0], np.linspace(0, 1, N), indexing="ij")], axis=-1).reshape(
        -1, 3
    )
    x[:, 1] -= 2.0 * x[:, 0] * (1 - x[:, 0]) * x[:, 2] * (1 - x[:, 2])
    at = np.array([[0.4, -0.05, 0.6], [0.4, -0.3, 0.6], [0.4, 0.1, 0.6], [1.4, -0.3, 0.6]])
    assert beneath(at, x[net.triangles]).tolist() == [False, True, False, False]
