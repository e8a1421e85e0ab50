"""Collision groups: names that users type, bits of 32 that contacts compare."""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.common import validation
from taichi_sim.common.errors import SceneError

__all__ = ["EVERY", "ONLY", "Groups", "bits_of", "meet"]

MOST_GROUPS = 32
ONLY = 1  # bits of what is in the first group, "default", alone
EVERY = -1  # mask of what collides with all groups


class Groups:
    """The names of a scene, each a bit, in the order in which they were first used."""

    def __init__(self, names: Iterable[str] = ("default",)) -> None:
        self.names = list(names)

    def bits(self, where: str, names: str | Sequence[str] | None) -> int:
        """Bits of one name or several, as a signed 32-bit integer; None: all, also those that come later."""
        if names is None:
            return EVERY
        listed = [names] if isinstance(names, str) else names
        if not isinstance(listed, (list, tuple)) or not all(isinstance(name, str) and name for name in listed):
            raise SceneError(where, names, "a name, or a list of names")
        new = [name for name in dict.fromkeys(listed) if name not in self.names]
        if len(self.names) + len(new) > MOST_GROUPS:
            raise SceneError(where, new[0], says=f"is one group too many; there can be {MOST_GROUPS}")
        self.names += new
        return int(np.uint32(sum(1 << self.names.index(name) for name in dict.fromkeys(listed))).astype(np.int32))

    def listed(self, bits: int) -> list[str]:
        """The names of bits."""
        return [name for k, name in enumerate(self.names) if bits >> k & 1]

    def check_bits(self, owner: str, group: Any, mask: Any) -> None:
        """Raise SceneError where bits of group or mask, integers or arrays (k,) of them, are of no group there is."""
        there_are = f"bits of the {len(self.names)} groups there are"
        others = ~self.bits("", self.names)
        validation.require(f"{owner}.group", group, (group != 0) & (group & others == 0), f"{there_are}, one or more")
        validation.require(
            f"{owner}.mask", mask, (mask == EVERY) | (mask & others == 0), f"{there_are}, or {EVERY} for all"
        )

    def check(self, groups: Iterable[int], masks: Iterable[tuple[str, int]]) -> None:
        """Raise SceneError where a mask, given with the name of its owner, names a group that nothing is in."""
        used = 1
        for bits in groups:
            used |= bits
        for owner, bits in masks:
            unknown = [] if bits == EVERY else self.listed(bits & ~used)
            if unknown:
                known = ", ".join(repr(name) for name in self.listed(used))
                says = f"is no group of this scene; there are {known}"
                raise SceneError(f"{owner}.collides_with", unknown[0], says=says)


def bits_of(column: NDArray[np.int32]) -> list[int]:
    """The different values of a column, as Python integers."""
    alike = len(column) and np.all(column == column[0])  # a million balls need no sorting then
    return [int(bits) for bits in (column[:1] if alike else np.unique(column))]


def meet(group: NDArray[np.int32], mask: NDArray[np.int32], other_group: int, other_mask: int) -> NDArray[np.bool_]:
    """Mask of the items that collide with another one: each must be in a group that the other collides with."""
    return ((group & np.int32(other_mask)) != 0) & ((mask & np.int32(other_group)) != 0)
