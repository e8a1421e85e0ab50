"""Differences between two descriptions of runs, in words."""

import json
from collections.abc import Collection, Iterator, Mapping
from typing import Any

from taichi_sim.common.errors import short

__all__ = ["differences", "named"]

NAMED = 4  # before the others are only counted
READABLE = 40  # characters of a value that a message shows


def differences(then: Mapping[str, Any], now: Mapping[str, Any], why: Mapping[str, str] | None = None) -> Iterator[str]:
    """Each name whose plain values are not the same, with both where they are short; of tables, each of their keys.

    why: by name, what a reader cannot guess of it.
    """
    for name in dict.fromkeys([*then, *now]):
        yield from _differs(name, then.get(name), now.get(name), why or {})


def named(found: Collection[str]) -> str:
    """The first of them, and how many more there are."""
    more = f" and {len(found) - NAMED} more" if len(found) > NAMED else ""
    return ", ".join(list(found)[:NAMED]) + more


def _differs(name: str, old: Any, new: Any, why: Mapping[str, str]) -> Iterator[str]:
    if json.dumps(old, sort_keys=True) == json.dumps(new, sort_keys=True):  # nan is nan here
        return
    if isinstance(old, Mapping) and isinstance(new, Mapping):
        for key in dict.fromkeys([*old, *new]):
            yield from _differs(f"{name}.{key}", old.get(key), new.get(key), why)
        return
    said = all(len(short(value)) <= READABLE for value in (old, new))
    reason = why.get(name, "")
    yield f"{name} ({_word(old)} then, {_word(new)} now{reason})" if said else f"{name}{reason}"


def _word(value: Any) -> str:
    return "none" if value is None else short(value)
