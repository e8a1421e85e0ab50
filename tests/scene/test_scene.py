"""Scene: what it holds after each call, and every refusal with the place, the value and what is allowed."""

import subprocess
import sys

import numpy as np
import pytest

from taichi_sim import Scene, SceneError

pytestmark = pytest.mark.once

NAN, INF = float("nan"), float("inf")
CLOSED = [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]


def pair(**changes) -> Scene:
    scene = Scene(dim=2)
    scene.add_balls(**({"position": [[0, 0], [1, 0]], "radius": 0.1} | changes))
    return scene


def three() -> Scene:
    scene = Scene(dim=3)
    scene.add_balls([[0, 0, 0], [1, 0, 0], [0, 1, 0]], radius=0.1)
    return scene


def tetrahedron() -> Scene:
    scene = three()
    scene.add_balls([[0, 0, 1]], radius=0.1)
    return scene


def flat(**cells) -> Scene:
    scene = pair(position=[[0, 0], [1, 0], [2, 0], [0, 1]])
    scene.add_cells(**({"bulk_modulus": 1.0} | cells))
    return scene


def springs(**changes) -> Scene:
    scene = pair()
    scene.add_springs(**({"pairs": [[0, 1]], "stiffness": 1.0} | changes))
    return scene


def bending(weights) -> None:
    tetrahedron().add_bending([[0, 1, 2, 3]] * 2, weights=[[-1, -1, 1, 1], weights], stiffness=1, hinge=True)


def test_defaults():
    scene = springs()
    assert scene.mass.tolist() == [1, 1]
    assert scene.velocity.tolist() == [[0, 0], [0, 0]]
    assert scene.pinned.tolist() == [False, False]
    assert scene.damping.tolist() == [0]
    assert scene.rest_length.tolist() == [1]
    assert scene.collides.tolist() == [False]
    assert scene.gravity.tolist() == [0, 0]
    material = scene.materials[0]
    assert (material.restitution, material.friction, material.viscous_friction) == (0, 0, 0)


def test_indices_go_on_from_call_to_call():
    scene = pair()
    assert scene.add_balls([[2, 0], [3, 0]], radius=0.1).tolist() == [2, 3]
    assert scene.add_springs([[0, 3]], stiffness=1).tolist() == [0]
    assert scene.add_springs([1, 2], stiffness=1).tolist() == [1]
    assert scene.position.shape == (4, 2)


def test_one_or_one_per_item():
    scene = pair(mass=[1, 2], radius=0.5, velocity=(3, 4), pinned=[1])
    assert scene.mass.tolist() == [1, 2]
    assert scene.radius.tolist() == [0.5, 0.5]
    assert scene.pinned.tolist() == [False, True]
    assert scene.velocity.tolist() == [[3, 4], [0, 0]]  # a pinned ball has velocity 0
    assert pair(pinned=True).pinned.tolist() == [True, True]
    assert pair(pinned=[True, False]).pinned.tolist() == [True, False]


def test_walls_are_normalised():
    scene = Scene(dim=2)
    scene.add_wall((0, 2), 0.5)
    assert scene.walls[0].normal == (0.0, 1.0)
    assert scene.walls[0].offset == 0.5


REFUSED = [
    (lambda: Scene(dim=4), "dim: 4 .*2 or 3"),
    (lambda: Scene(dim=2, gravity=(0, NAN)), "gravity.*nan .*finite"),
    (lambda: Scene(dim=2, gravity=(0, 1, 2)), "gravity.*does not fit"),
    (lambda: pair(position=[[0, 0], [1, NAN]]), r"balls\.position\[1\]\[1\]: nan"),
    (lambda: pair(position=[[0, 0], [INF, 0]]), r"balls\.position\[1\]\[0\]: inf"),
    (lambda: pair(position=[[0, 0, 0]]), r"balls\.position: shape \(1, 3\)"),
    (lambda: pair(position="here"), r"balls\.position: 'here'"),
    (lambda: pair(mass=0), r"balls\.mass: 0.* greater than 0"),
    (lambda: pair(mass=[1, -1]), r"balls\.mass\[1\]: -1.0 .*greater than 0"),
    (lambda: pair(mass=[1, 2, 3]), r"balls\.mass: shape \(3,\).* 2 of them"),
    (lambda: pair(mass=INF), r"balls\.mass: inf"),
    (lambda: pair(mass=True), r"balls\.mass: True"),
    (lambda: pair(radius=0), r"balls\.radius: 0.* greater than 0"),
    (lambda: pair(radius=[0.1, NAN]), r"balls\.radius\[1\]: nan"),
    (lambda: pair(velocity=[[0, 0], [NAN, 0]]), r"balls\.velocity\[1\]\[0\]: nan"),
    (lambda: pair(pinned=[2]), r"balls\.pinned\[0\]: 2 .*from 0 to 1"),
    (lambda: pair(pinned=[-1]), r"balls\.pinned\[0\]: -1"),
    (lambda: pair(pinned=[0.5]), r"balls\.pinned: .*integers"),
    (lambda: pair(pinned=[[0], [1, 2]]), r"balls\.pinned: "),
    (lambda: pair(material="jam"), r"balls\.material: 'jam' .*'default'"),
    (lambda: pair(colour=(0, 0, 1.5)), r"balls\.colour\[2\]: 1.5 .*from 0 to 1"),
    (lambda: springs(pairs=[[0, 2]]), r"springs\.pairs\[0\]: \[0, 2\] .*from 0 to 1"),
    (lambda: springs(pairs=[[0, 1], [1, 1]]), r"springs\.pairs\[1\]: \[1, 1\] joins a ball to itself"),
    (lambda: springs(pairs=[[0, 1, 1]]), r"springs\.pairs: shape"),
    (lambda: springs(stiffness=-1), r"springs\.stiffness: -1"),
    (lambda: springs(damping=NAN), r"springs\.damping: nan"),
    (lambda: springs(rest_length=[-0.5]), r"springs\.rest_length\[0\]: -0.5"),
    (lambda: springs(collides=1), r"springs\.collides: 1"),
    (lambda: springs().set_springs([4], damping=0.1), r"springs\[0\]: 4 .*must name a spring, from 0 to 0"),
    (
        lambda: springs().add_motor([5], amplitude=0.1, frequency=1),
        r"motors\[0\]\.springs\[0\]: 5 .*a spring, from 0 to 0",
    ),
    (lambda: springs().set_balls([7], mass=1), r"balls\[0\]: 7 .*must name a ball, from 0 to 1"),
    (lambda: springs(collides=[[True], [True, False]]), r"springs\.collides: "),
    (lambda: Scene(dim=2).add_wall((0, 0)), r"walls\.normal: .*direction"),
    (lambda: Scene(dim=2).add_wall((0, 1), INF), r"walls\.offset: inf"),
    (lambda: Scene(dim=2).add_material("a", restitution=2), "restitution: 2.* from 0 to 1"),
    (lambda: Scene(dim=2).add_material("a", friction=-1), "friction: -1"),
    (lambda: Scene(dim=2).add_material(""), "materials.name: ''"),
    (lambda: pair().add_triangles([[0, 1, 2]]), r"triangles\[0\]: \[0, 1, 2\]"),
    (lambda: pair().add_triangles([[0, 1, 1]], collides=True), r"triangles\.collides: .*dim = 3"),
    (lambda: three().add_triangles([[0, 1, 2], [0, 1, 1]], collides=True), r"triangles\[1\]: \[0, 1, 1\] .*different"),
    (lambda: three().add_triangles([[0, 1, 2]], collides=[True, False]), r"triangles\.collides: .*list of 1"),
    (lambda: springs(collides=True, break_strain=0.1), r"break_strain\[0\]: a stick, which collides, cannot tear"),
    (lambda: springs(rest_length=0.0, break_strain=0.1), r"break_strain\[0\]: this spring has rest length 0"),
    (lambda: pair().set_balls(body=[0, 0.5]), r"balls\.body\[1\]: 0\.5 .*whole number"),
    (lambda: flat(corners=[[0, 1, 3], [0, 1, 2]]), r"cells\.corners\[1\]: \[0, 1, 2\] is flat now; give a rest_volume"),
    (lambda: flat(corners=[[0, 1, 3], [0, 1, 1]]), r"cells\.corners\[1\]: \[0, 1, 1\] names a ball twice; give 3"),
    (lambda: flat(corners=[0, 1, 3], bulk_modulus=-1), r"cells\.bulk_modulus: -1"),
    (lambda: flat(corners=[[0, 1, 3], [1, 2, 3]], together=[0, 0.5]), r"cells\.together\[1\]: 0\.5 .*whole number"),
    (
        lambda: three().add_membranes([[0, 1, 2], [0, 1, 1]], warp=1),
        r"membranes\.corners\[1\]: \[0, 1, 1\] has no area",
    ),
    (
        lambda: three().add_membranes([[0, 1, 2]], warp=3, coupling=-4),
        r"membranes\.coupling\[0\]: -4\.0 .*at most 3, the",
    ),
    (lambda: bending([-1, -1, 1, 2]), r"bending\.weights\[1\]: \[-1\.0, -1\.0, 1\.0, 2\.0\] .*sum is 0"),
    (
        lambda: bending([-1, -1, -1, 3]),
        r"bending\.weights\[1\]: \[-1\.0, -1\.0, -1\.0, 3\.0\] .*of a hinge: .* one sign",
    ),
    (lambda: tetrahedron().add_gas(CLOSED, pressure=1.0, volume=-1.0), r"gases\.volume: -1\.0 is not allowed"),
]


@pytest.mark.parametrize(("call", "message"), REFUSED, ids=[message for _, message in REFUSED])
def test_refused(call, message):
    with pytest.raises(SceneError, match=message):
        call()


def test_a_refused_call_changes_nothing():
    scene = pair()
    with pytest.raises(SceneError):
        scene.add_balls([[0, 0]], radius=-1)
    with pytest.raises(SceneError):
        scene.add_springs([[0, 1]], stiffness=NAN)
    assert scene.n_balls == 2
    assert scene.n_springs == 0
    assert np.isfinite(scene.position).all()


def test_scene_and_shapes_import_no_taichi():
    code = "import sys, taichi_sim.shapes, taichi_sim.files.toml_reader; print('taichi' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout == "False\n"


def test_simulations_without_meshes_import_no_scipy():
    code = "import sys, taichi_sim.simulation.simulation; print('scipy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout == "False\n"


def test_a_scene_says_what_it_holds():
    scene = Scene(dim=2, gravity=(0, -9.81))
    assert repr(Scene()) == "<Scene in 2D: empty>"
    scene.add_balls([[0, 0], [1, 0], [2, 0]], radius=0.1, pinned=[0])
    scene.add_springs([(0, 1)], stiffness=10.0)
    assert repr(scene) == "<Scene in 2D: 3 balls, 1 pinned, 1 spring; gravity (0, -9.81) m/s^2>"
    assert "<th>balls</th><td>3</td>" in scene._repr_html_()


def test_what_an_object_holds_cannot_be_written_to():
    scene = Scene(dim=2)
    scene.set_name(scene.add_balls([[0, 0]], radius=0.1), "ball", uv=[[0.5, 0.5]])
    for array in (scene.objects[0].balls, scene.objects[0].uv):
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0


def test_a_frozen_scene_refuses_a_name_given_by_name():
    with pytest.raises(SceneError, match="belongs to a simulation"):
        Scene(dim=2).frozen().add_material(name="ice")
