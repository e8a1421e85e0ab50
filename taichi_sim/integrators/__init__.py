"""Integrators: one time-stepping method per file, each a small class that carries its declaration, see analysis.methods.

A user-defined one subclasses Integrator and needs a `method` and a `substep`. This one is symplectic Euler, contacts and all:

    @ti.data_oriented
    class KickDrift(ts.Integrator):
        method = ts.Method("kick_drift", order=1, symplectic=True, limit=ts.StabilityLimit(undamped=2.0, damped=2.0))
        relaxes = True  # the substep ends with `relax`, so that contacts may be soft

        @ti.func
        def substep(self, h, time):
            self.forces.total(self.ball, h, time)
            self.contacts.advance(self.ball, self, h, h)
            self.contacts.relax(self.ball, 0.0)

        @ti.func
        def before_move(self, i, h):
            self.state.kick(i, self.forces.change(i, h))

        @ti.func
        def load(self, i, h):
            return self.forces.change(i, h)

    ts.Simulation(scene, integrator=KickDrift())

Without a declared limit it runs only with a number as dt. A substep that moves balls otherwise than by `contacts.advance` has no
contacts: balls pass through everything.
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
