"""Collision groups: who collides with whom, against brute force; names and their errors; scene and state files."""

import numpy as np
import pytest
from physics_support import simulate
from scene_files import assert_refused

import taichi_sim as ts

pytestmark = pytest.mark.long_in("f64")

NAMES = ("default", "net", "fish", "water", "rock")


def choose(rng, masks):
    """Random arguments of a thing."""
    group = [str(name) for name in rng.choice(NAMES, rng.integers(1, 3), replace=False)]
    mask = (
        [str(name) for name in rng.choice(NAMES, rng.integers(0, 4), replace=False)] if rng.random() < masks else None
    )
    return {"group": group, "collides_with": mask}


def meet(a, b):
    """The rule in words."""

    def minds(one, other):
        return one["collides_with"] is None or bool(set(one["collides_with"]) & set(other["group"]))

    return minds(a, b) and minds(b, a)


@pytest.mark.slow
def test_balls_walls_and_sticks_meet_only_what_they_collide_with():
    rng = np.random.default_rng(0)
    scene = ts.Scene(dim=2)
    crowd = [choose(rng, 0.5) for _ in range(60)]
    for kind in crowd:
        scene.add_balls(rng.uniform(0.0, 1.0, (1, 2)), radius=0.2, pinned=False, **kind)
    far = [choose(rng, 0.5) for _ in range(40)]  # each 0.1 m in front of the walls
    for k, kind in enumerate(far):
        scene.add_balls([[-9.7, 10.0 + k]], radius=0.2, velocity=(-10.0, 0.0), **kind)
    walls = [choose(rng, 1.0) for _ in range(3)]
    for kind in walls:
        scene.add_wall((1, 0), -10.0, **kind)
    sticks = [choose(rng, 0.5) for _ in range(8)]
    for k, kind in enumerate(sticks):
        one = scene.add_balls([[20.0, 3.0 * k]], radius=0.01, pinned=True, **kind)
        two = scene.add_balls([[24.0, 3.0 * k]], radius=0.01, pinned=True)
        scene.add_springs([[one[0], two[0]]], stiffness=0.0, collides=True)
    near = [choose(rng, 0.5) for _ in range(48)]
    for k, kind in enumerate(near):
        scene.add_balls([[20.5 + 0.5 * (k % 6), 3.0 * (k // 6) + 0.05]], radius=0.1, **kind)
    first_near = scene.n_balls - len(near)
    with simulate(scene, dt=1e-3, contacts="jacobi", contact_iterations=1, integrator="symplectic_euler") as sim:
        sim.penetration()
        parts, x = sim.parts.contacts, sim.position
        lists = parts.pairs
        first, number, other = (f.to_numpy() for f in (lists.first, lists.touching, lists.link.other))
        found = {(min(i, int(j)), max(i, int(j))) for i in range(60) for j in other[first[i] : first[i] + number[i]]}
        touch = {(i, j) for i in range(60) for j in range(i) if np.linalg.norm(x[i] - x[j]) < 0.4}
        expected = {(j, i) for i, j in touch if meet(crowd[i], crowd[j])}
        assert found == expected
        assert 0.2 * len(touch) < len(found) < 0.8 * len(touch)
        used = int(parts.sticks.used[0])
        rows = set(
            zip(
                parts.sticks.contact.ball.to_numpy()[:used].tolist(),
                parts.sticks.contact.stick.to_numpy()[:used].tolist(),
            )
        )
        expected = {(first_near + k, k // 6) for k, kind in enumerate(near) if meet(kind, sticks[k // 6])}
        assert rows == expected
        assert 8 < used < 40
        sim.step(100)
        stopped = sim.position[60:100, 0] > -10.0
        assert stopped.tolist() == [any(meet(kind, wall) for wall in walls) for kind in far]
        assert 8 < np.count_nonzero(stopped) < 32
        assert sim.penetration() < 0.4  # a ball behind a wall that it does not mind is not inside it


def test_names_are_checked():
    scene = ts.Scene()
    scene.add_balls([[0.0, 0.0]], radius=0.1, group="net", collides_with=["fsh"])
    with pytest.raises(
        ts.SceneError, match=r"collides_with: 'fsh' is no group of this scene; there are 'default', 'net'"
    ):
        simulate(scene)
    scene.set_group([0], "net", ["net", "default"])
    assert scene.has_groups()
    scene.set_group([0], "net")
    assert not scene.has_groups()
    for wrong in ("", 3, ["a", ""], []):
        with pytest.raises(
            ts.SceneError, match=r"balls.group: .* is not allowed; it must be a name, or a list of names"
        ):
            scene.add_balls([[0.0, 0.0]], radius=0.1, group=wrong)
    with pytest.raises(ts.SceneError, match=r"walls.collides_with: 3 is not allowed"):
        scene.add_wall((0, 1), collides_with=3)
    scene = ts.Scene()
    for k in range(31):
        scene.add_balls([[0.0, 0.0]], radius=0.1, group=f"g{k}", collides_with=[f"g{k}"])
    assert scene.has_groups()
    with pytest.raises(ts.SceneError, match=r"balls.group: 'g31' is one group too many; there can be 32"):
        scene.add_balls([[0.0, 0.0]], radius=0.1, group="g31")
    assert scene.n_balls == 31


def test_a_wrong_name_in_a_file_is_named(tmp_path):
    text = "format = 1\n[[balls]]\nposition = [[0.0, 0.0], [1.0, 0.0]]\nradius = 0.1\ngroup = ['net', 'rope']\n"
    assert_refused(tmp_path, text, "'rope'", "7", r"balls\[0\].group")


@pytest.mark.slow
def test_colliders_meet_their_groups_only():
    """Three balls fall: one minds the box below it, one does not, one starts inside another box that it does not mind."""
    scene = ts.Scene(gravity=(0.0, -10.0))
    scene.add_balls([[0.0, 1.0]], radius=0.1, group="fish", collides_with="net")
    scene.add_balls([[1.0, 1.0]], radius=0.1, group="fish", collides_with="rope")
    scene.add_balls([[5.0, 0.0]], radius=0.1, group="fish", collides_with="net")
    scene.add_collider(ts.Box((0.0, -0.5), (4.0, 1.0), group="net"))
    scene.add_collider(ts.Box((5.0, 0.0), (1.0, 1.0), group="rope"))
    with simulate(scene, dt=1e-3) as sim:
        sim.step(800)
        y = sim.position[:, 1]
    assert abs(y[0] - 0.1) < 1e-3
    assert np.all(y[1:] < -1.0)
