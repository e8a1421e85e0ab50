"""Contact rules of a user's own: what the machinery around them does beside them."""

import pytest
import taichi as ti
from physics_support import simulate

import taichi_sim as ts


@ti.data_oriented
class Penalty(ts.ContactRule):
    """A spring of `stiffness` [N/m] pushes balls apart by what they overlap."""

    name = "penalty"
    pushes_out = False

    def __init__(self, stiffness):
        self.stiffness = stiffness

    @ti.func
    def solve(self, ball: ti.template(), time, iterations: ti.template(), impacts: ti.template()):
        self.each_pair(ball, self.push)

    @ti.func
    def push(self, ball: ti.template(), i, j, c):
        pair = self.pairs.contact[c]
        if pair.depth > 0.0:
            self.exchange(i, j, -self.stiffness * pair.depth / self.rate[0] * pair.normal)


@pytest.mark.parametrize("gravity", [(0, 0), (0, -10)])
def test_a_penalty_throws_balls_apart_without_loss(gravity):
    """Balls of 1 and 3 kg fall alike; their relative velocity of 2 m/s is reversed."""
    scene = ts.Scene(dim=2, gravity=gravity)
    scene.add_balls([[0, 0], [0.5, 0]], radius=0.2, mass=[1.0, 3.0], velocity=[[2.0, 0], [0, 0]])
    with simulate(scene, dt=1e-4, integrator="symplectic_euler", contacts=Penalty(800.0)) as sim:
        sim.run(0.5)
        assert sim.velocity[:, 0] == pytest.approx([-1.0, 1.0], rel=2e-3)
