"""Capacity of the lists of contacts: how many entries they need, and how many there is memory for."""

from typing import NamedTuple

from taichi_sim.common import memory
from taichi_sim.common.errors import SceneError
from taichi_sim.contacts import ContactRule
from taichi_sim.contacts.pairs import Pairs
from taichi_sim.device.backend import Backend
from taichi_sim.device.devices import find
from taichi_sim.device.fields import Fields
from taichi_sim.kernels.contacts.pairs import ENDLESS

__all__ = ["NO_CAPACITY_KNOWN", "PAIR_BYTES", "ContactCapacity", "enough_for", "lacking", "room_of", "spare_bytes"]

MEMORY_SHARE = 0.5  # of what the machine has free, or a GPU has in all: the most that lists of contacts may grow to
GPU_MEMORY = 1 << 30  # bytes, the same where a GPU does not say what it has
PAIR_BYTES = 64  # about what a listed pair takes
# made, in units of what was found too much: once, and if that happens again
SPARE_CAPACITY, LARGE_SPARE_CAPACITY = 1.5, 4.0


class ContactCapacity(NamedTuple):
    """Entries that contacts are known to need: links of pairs, rows of sticks and of triangles."""

    pairs: int = 0
    sticks: int = 0
    triangles: int = 0


NO_CAPACITY_KNOWN = ContactCapacity()


def lacking(contacts: ContactRule, known: ContactCapacity) -> ContactCapacity | None:
    """Capacity that contact lists need, `known` with larger numbers for the lists that overflowed since the last call; None where
    all fitted."""
    found = {}
    for name in ContactCapacity._fields:
        part = getattr(contacts, name)
        if part is not None and (entries := int(part.overflow[0])) > part.capacity:
            part.overflow[0] = 0
            found[name] = entries
    return known._replace(**found) if found else None


def enough_for(needed: ContactCapacity, contacts: ContactRule, again: bool, spare: int) -> ContactCapacity:
    """Capacity for what is needed and half as much again, or, where it was too little `again`, four times that. spare: bytes
    that lists may take. Raises SceneError where they are too few, or the entries more than numbers of 32 bits count."""
    enough = {}
    for name in ContactCapacity._fields:
        part, entries = getattr(contacts, name), getattr(needed, name)
        if part is not None and entries > part.capacity:
            if entries == ENDLESS:
                raise SceneError(_endless(contacts.pairs))
            limit = max(part.capacity, int(min(part.most, spare // part.bytes_each)))
            if entries > limit:
                raise SceneError(
                    f"contacts: {part.what} need {entries} entries, but there is memory for {limit}"
                    f" ({limit * part.bytes_each / 2**30:.3g} GiB): too many balls lie in each other"
                )
            entries = min(limit, int((LARGE_SPARE_CAPACITY if again else SPARE_CAPACITY) * entries))
        enough[name] = entries
    return ContactCapacity(**enough)


def room_of(contacts: ContactRule) -> ContactCapacity:
    """Entries that there is room for; 0 of what is missing."""
    parts = (getattr(contacts, name) for name in ContactCapacity._fields)
    return ContactCapacity(*(0 if part is None else part.capacity for part in parts))


def spare_bytes(backend: Backend, fields: Fields) -> int:
    """Bytes that lists of contacts may take, with `fields` freed."""
    if backend.arch != "cpu":
        device = find(backend.arch)
        return int(MEMORY_SHARE * device.memory) if device is not None and device.memory else GPU_MEMORY
    return int(MEMORY_SHARE * (memory.available() + fields.bytes))


def _endless(pairs: Pairs | None) -> str:
    """Message for a scene where counting itself would take too long."""
    assert pairs is not None
    width = pairs.grid.widest
    return (
        f"contacts: {float(pairs.grid.most_crowded_pairs[0]):.2g} pairs of balls lie in the same cells, up to {width:.3g} m"
        f" wide, but there is memory for {float(pairs.grid.pair_limit[0]):.2g}: too many balls lie in each other"
    )
