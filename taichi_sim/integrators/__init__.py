"""Integrators: one time-stepping method per file, each a small class that carries its declaration, see analysis.methods.

A method of your own subclasses Integrator and needs a `method` and a `substep`. This one is symplectic Euler, contacts and all:

    @ti.data_oriented
    class KickDrift(Integrator):
        method = Method("kick_drift", order=1, symplectic=True, limit=StabilityLimit(undamped=2.0, damped=2.0))

        @ti.func
        def substep(self, h, time):
            self.forces.total(self.ball, h, time)
            for i in range(self.model.n):
                self.state.kick(i, self.forces.change(i, h))
            self.contacts.solve(self.ball, h, self.contacts.iterations, True)
            self.contacts.separate(self.ball, h)
            for i in range(self.model.n):
                v = self.ball[i].v
                shift, drift = self.contacts.move(self.ball, i, v, 0.0 * v, h, self.forces.change(i, h))
                self.state.shift(i, shift)
                self.ball[i].v = drift
            self.contacts.refresh(self.ball)

    Simulation(scene, integrator=KickDrift())

Without a declared limit it runs only with a number as dt; without the lines on contacts balls pass through everything.
"""

from taichi_sim.integrators.base import Integrator
from taichi_sim.integrators.explicit_euler import ExplicitEuler
from taichi_sim.integrators.implicit_euler import ImplicitEuler
from taichi_sim.integrators.rk4 import RK4
from taichi_sim.integrators.symplectic_euler import SymplecticEuler
from taichi_sim.integrators.tr_bdf2 import TRBDF2
from taichi_sim.integrators.verlet import Verlet
from taichi_sim.integrators.xpbd import XPBD

__all__ = [
    "BUILT_IN",
    "RK4",
    "TRBDF2",
    "XPBD",
    "ExplicitEuler",
    "ImplicitEuler",
    "Integrator",
    "SymplecticEuler",
    "Verlet",
]

BUILT_IN = (ExplicitEuler, SymplecticEuler, Verlet, RK4, XPBD, ImplicitEuler, TRBDF2)
