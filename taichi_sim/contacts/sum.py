"""The article's sum: all contacts from old velocities, each with the whole masses of its balls."""

from taichi_sim.contacts.jacobi import Jacobi
from taichi_sim.device.engine import ti

__all__ = ["Sum"]


@ti.data_oriented
class Sum(Jacobi):
    """Jacobi's iteration without its split masses: exact for balls that have one contact, but it over-corrects wherever a ball
    has several, so that packs gain energy. Contacts are rigid, and nothing limits the energy. Here for study."""

    name = "sum"
    sums_plainly = True
    split = softens = energy_limiter = False
