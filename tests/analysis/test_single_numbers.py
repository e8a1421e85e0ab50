"""Numbers that single precision would take for others are refused before anything is compiled, by their places."""

import pytest
from physics_support import F64

import taichi_sim as ts
from taichi_sim.analysis.single_numbers import require_single


def cloth(**given):
    scene = ts.Scene(dim=3, gravity=(0.0, -9.81, 0.0))
    ts.shapes.cloth(scene, (1.0, 1.0), (3, 4), **{"warp": 500.0, "mass_per_area": 0.3} | given)
    return scene


def springs(**given):
    scene = ts.Scene(dim=3)
    ts.shapes.cloth(scene, (1.0, 1.0), (3, 4), **given)
    return scene


def jelly(dim=3, **given):
    scene = ts.Scene(dim=dim)
    ts.shapes.jelly(scene, (0.3,) * dim, (3,) * dim, **{"young_modulus": 2e4, "density": 800.0} | given)
    return scene


def balls(**given):
    scene = ts.Scene(dim=2, gravity=given.pop("gravity", (0.0, -9.81)))
    scene.add_balls([[0.0, 1.0], [0.0, 3.0]], **{"radius": 0.1, "mass": 0.2} | given)
    scene.add_springs([0, 1], stiffness=10.0)
    return scene


REFUSED = [
    (
        lambda: cloth(mass_per_area=3e49),
        r"^balls\.mass\[0\]: \S+e\+48 does not fit .*at most 1e\+34; use precision \"f64\", or",
    ),
    (lambda: cloth(mass_per_area=7e-26), r"^balls\.mass\[0\]: \S+e-27 does not fit .*at least 1e-25 kg"),
    (lambda: cloth(warp=2e47), r"^membranes\.warp\[0\]: 2e\+47 does not fit into single precision"),
    (
        lambda: cloth(warp=2e29, mass_per_area=2e-6),
        r"^membranes: their stiffness of \S+e\+\d\d N/m at ball 0 \(number 0 of cloth_0\) of \S+ kg does not fit",
    ),
    (lambda: cloth(damping=4e36, warp=1.0), r"^membranes\.damping\[0\]: 4e\+36 "),
    (
        lambda: cloth(bending_rigidity=1e32),
        r"^bending: their stiffness of \S+ N/m at ball \d+ \(number \d+ of cloth_0\)",
    ),
    (lambda: cloth(bending_rigidity=1e39), r"^bending\.stiffness\[0\]: "),
    (lambda: springs(damping=2e34), r"^springs\.damping\[0\]: 2e\+34 "),
    (lambda: springs(damping=1e33), r"^springs: their damping of \S+ N s/m at ball 0 \(number 0 of cloth_0\) of"),
    (lambda: springs(stretch_stiffness=1e36), r"^springs\.stiffness\[0\]: "),
    (lambda: jelly(young_modulus=3e42), r"^bricks\.young_modulus\[0\]: 3e\+42 "),
    (
        lambda: jelly(young_modulus=1e33, poisson_ratio=0.4999),
        r"^bricks: their stiffness over mass of \S+e\+3\d 1/s\^2 does not",
    ),
    (lambda: jelly(dim=2, damping=1e33, density=1e-4), r"^bricks: their damping over mass of \S+ 1/s does not fit"),
    (lambda: balls(gravity=(0.0, -3e40)), r"^gravity\[1\]: -3e\+40 does not fit"),
    (lambda: balls(radius=[0.1, 2e39]), r"^balls\.radius\[1\]: 2e\+39 does not fit"),
    (lambda: balls(velocity=(0.0, 2e39)), r"^balls\.velocity\[0\]\[1\]: 2e\+39 does not fit"),
]


@pytest.mark.parametrize(("make", "says"), REFUSED, ids=[says for _, says in REFUSED])
def test_what_single_precision_does_not_hold(make, says):
    with pytest.raises(ts.SceneError, match=says):
        require_single(make())


@pytest.mark.parametrize(
    "make",
    [
        lambda: cloth(mass_per_area=1e30), lambda: cloth(mass_per_area=1e-12), lambda: cloth(warp=1e30),
        lambda: cloth(break_strain=1e50), lambda: jelly(young_modulus=1e30), lambda: jelly(density=1e-12),
        lambda: springs(damping=1e30), lambda: balls(colour=(1, 0, 0)),
    ],
)  # fmt: skip
def test_what_it_holds(make):
    require_single(make())


def test_a_simulation_in_double_precision_takes_more():
    heavy = cloth(mass_per_area=1e40)
    if F64:
        with ts.Simulation(heavy, integrator="verlet", contacts="off") as sim:
            sim.step()
            assert sim.velocity[0, 1] == pytest.approx(-9.81 * sim.dt)
        return
    with pytest.raises(ts.SceneError, match=r"^balls\.mass\[0\]: "):
        ts.Simulation(heavy, contacts="off")
