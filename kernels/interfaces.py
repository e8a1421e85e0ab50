"""What kernels of all folders read of the objects handed to them, with shape and unit: n balls in `dim` dimensions."""

from typing import Any, Protocol

Field = Any  # of Taichi: read and written by index


class Law(Protocol):
    """What two materials do to each other."""

    restitution: float  # 1
    friction: float  # 1, Coulomb
    viscous_friction: float  # 1/s


class Model(Protocol):
    """What stays constant while a scene runs; all but the first three only where there are contacts."""

    n: int  # number of balls
    dim: int  # 2 or 3
    inverse_mass: Field  # (n) 1/kg, 0 where pinned
    has_gravity: bool  # whether it is not 0
    gravity: Field  # (1) vector, m/s^2
    radius: Field  # (n) m
    surface: Field  # (n) material
    surfaces: int  # number of materials
    laws: "Law"  # (surfaces^2) of each pair of materials
    has_friction: bool  # of either kind, whether any material in use has it
    has_viscous: bool  # the same of viscous friction
    has_restitution: bool  # the same of restitution
    has_groups: bool  # whether any ball, wall or collider is in a collision group of its own
    group: Field  # (n) bits: the collision groups of a ball, where the scene has some
    mask: Field  # (n) bits: those that it collides with
    spins: bool  # whether any ball spins
    some_spin: bool  # whether others that are not pinned do not
    spin_inertia_ratio: float  # m r^2 / I of balls that spin

    def spin_response(self, i: int) -> float:
        """m r^2 / I of ball i: change of spin per change of velocity by a sideways impulse, 0 where it does not spin."""

    def sideways(self, i: int) -> float:
        """Mass that ball i opposes to a sideways impulse at its surface, as a part of its own."""


class Ball(Protocol):
    """(n) place and velocity side by side."""

    x: Field  # vector, m
    v: Field  # vector, m/s


class State(Protocol):
    """What changes while a scene runs."""

    spin: Field  # (n) m/s, radius times angular velocity: a scalar in 2D, a vector in 3D

    def shift(self, i: int, dx: Any) -> None:
        """x += dx [m] for ball i."""

    def kick(self, i: int, dv: Any) -> None:
        """v += dv [m/s] for ball i."""


class Lists(Protocol):
    """Lists of entries, one for each ball: list i has start[i + 1] - start[i] of them, see loops.list_entry."""

    start: Field  # (n + 1) entries
    sliced: bool  # whether lists lie in slices, as on devices
    slice_start: Field  # (slices) the first entry of each, where that is so


READS = {"model": Model, "ball": Ball, "state": State, "law": Law, "lists": Lists}
