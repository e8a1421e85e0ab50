"""Integrators: one time-stepping method per file, each a small class with its declared order.

A method of your own subclasses Integrator and needs a name, an order, and `substep`:

    @ti.data_oriented
    class Drift(Integrator):
        name, order = "drift", 1

        @ti.func
        def substep(self, h, time):
            for i in range(self.model.n):
                self.ball[i].x += h * self.ball[i].v

    Simulation(scene, integrator=Drift())
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
