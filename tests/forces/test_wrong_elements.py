"""Elements of a user's own that are wrong: what they do to a run is told, and is no silent wrong result."""

import numpy as np
import pytest
import taichi as ti
from physics_support import PRECISION

import taichi_sim as ts


@ti.data_oriented
class Band(ts.Element):
    """Pulls two balls together: the energy is k / 2 |x_b - x_a|^2. `broken` [m]: no number beyond this length."""

    def __init__(self, balls, k, broken=1e6):
        self.balls, self.columns = np.asarray(balls), {"k": k, "broken": broken}

    @ti.func
    def force(self, ball: ti.template(), row, time):
        way = ball[row.b].x - ball[row.a].x
        pull = ti.select(row.corner == 0, row.k, -row.k)
        if way.norm() > row.broken:
            pull = pull / (0.0 * way.norm())
        return pull * way

    @ti.func
    def product(self, ball: ti.template(), row, s):
        return s * s * row.k * ti.select(row.corner == 0, -1.0, 1.0) * (ball[row.b].p - ball[row.a].p)

    @ti.func
    def block(self, ball: ti.template(), row, s):
        return s * s * row.k * ti.Matrix.identity(float, 2)

    @ti.func
    def potential(self, ball: ti.template(), row, s):
        return 0.25 * row.k * (ball[row.b].x - ball[row.a].x).norm_sqr()

    def energies(self, position):
        return 0.5 * self.columns["k"] * np.sum((position[self.balls[:, 1]] - position[self.balls[:, 0]]) ** 2, axis=1)

    def stiffness_rate(self, scene):
        return ts.largest_rate(scene, self.balls, [1.0, -1.0], self.columns["k"])


def two_pairs():
    """The second pair flies apart; a pin holds another ball."""
    scene = ts.Scene(dim=2)
    x = [[0.0, 0.0], [0.8, 0.3], [3.0, 0.0], [3.9, 0.1], [3.0, 1.0]]
    v = [[0.0, 0.5], [0.0, -0.2], [-1.0, 0.0], [2.0, 0.0], [0.0, 0.0]]
    scene.add_balls(x, radius=0.05, mass=[1.0, 2.0, 0.7, 1.3, 1.0], velocity=v, pinned=[4])
    return scene


def simulate(element, **settings):
    return ts.Simulation(
        two_pairs(), forces=[element], contacts="off", arch="cpu", precision=PRECISION, **{"dt": 0.01, **settings}
    )


PAIRS = [[0, 1], [2, 3], [2, 4]]


@pytest.mark.parametrize("method", ["verlet", "implicit_euler", "tr_bdf2"])
def test_a_force_that_is_no_number_ends_the_run_by_every_method(method):
    """Implicit methods went on without it, as though there was no force, and asked for shorter steps."""
    with simulate(Band(PAIRS, 3.0, broken=1.05), integrator=method) as sim:
        with pytest.raises(ts.UnstableError, match=r"ball [23] is not finite or left the world") as told:
            sim.run(1.0)
        assert 0.03 < told.value.time < 0.1
        assert np.abs(np.stack([sim.position, sim.velocity])).max() < 10.0


@pytest.mark.parametrize(
    ("energies", "says"),
    [
        *((energies, r"it must be \(3,\)") for energies in (3.0, np.ones(2), np.ones((3, 2)))),
        *(
            pytest.param(energies, "is not a list of numbers", marks=pytest.mark.once)
            for energies in (np.full(3, 2.0 + 1j), np.array(["a", "b", "c"]), np.array([None] * 3))
        ),
    ],
    ids=str,
)
def test_energies_of_another_shape_or_kind_are_named(energies, says):
    band = Band(PAIRS, 3.0)
    band.energies = lambda position: energies
    with simulate(band) as sim, pytest.raises(ts.SceneError, match=r"Band\.energies: .*" + says):
        sim.energy()


@pytest.mark.once
def test_an_energy_of_a_force_that_is_no_number_is_named():
    @ti.data_oriented
    class Rest:
        @ti.func
        def accumulate(self, model: ti.template(), ball: ti.template(), impulse: ti.template(), h, time):
            pass

        def energy(self, position, velocity):
            return 1j

    with simulate(Rest()) as sim, pytest.raises(ts.SceneError, match=r"Rest\.energy: 1j is not a number"):
        sim.energy()
