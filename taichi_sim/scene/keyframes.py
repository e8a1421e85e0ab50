"""Keyframes: what a path of a body, a motor or the camera says at times that rise. The one place that reads them."""

from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any

from taichi_sim.common.errors import SceneError, path_of, unknown_key

__all__ = ["Checks", "check_repeat", "keyframe", "keyframes"]

Checks = Mapping[str, Callable[[str, Any], Any]]


def keyframes(where: str, path: Any, checks: Checks, needed: Collection[str] = ("time",)) -> list[dict[str, Any]]:
    """Keyframes as tables of judged values. Raises SceneError that names the keyframe and the key.

    checks: keys of a keyframe, `time` the first, and what returns a value from its place and what stands there; needed: keys
    that each must have. A keyframe is a table, or a list of values in the order of the keys.
    """
    if not isinstance(path, (list, tuple)):
        raise SceneError(where, path, "a list of two keyframes or more")
    if len(path) < 2:
        raise SceneError(where, says=f"has {'one' if path else 'no'} keyframe; it needs two keyframes or more")
    found: list[dict[str, Any]] = []
    for k, given in enumerate(path):
        place = f"{where}[{k}]"
        table = keyframe(place, given, list(checks), needed)
        key = {
            name: check(f"{place}.{name}", table[name]) for name, check in checks.items() if table.get(name) is not None
        }
        if found and key["time"] <= found[-1]["time"]:
            allowed = f"later than {found[-1]['time']:g} s, the one before; times must rise"
            raise SceneError(f"{place}.time", key["time"], allowed)
        found.append(key)
    return found


def keyframe(place: str, given: Any, keys: Sequence[str], needed: Collection[str] = ()) -> Mapping[str, Any]:
    """A keyframe as a table."""
    if not isinstance(given, Mapping):
        if not isinstance(given, (list, tuple)) or not 2 <= len(given) <= len(keys):
            says = f"is not a keyframe; it must be a table of {', '.join(keys)}, or a list of these values"
            raise SceneError(place, given, says=says)
        given = dict(zip(keys, given))
    for key in given:
        if key not in keys:
            raise unknown_key((*path_of(place), key), keys)
    for key in needed:
        if given.get(key) is None:
            raise SceneError(f"{place}.{key}", says="is missing; each keyframe needs it")
    return given


def check_repeat(where: str, path: Any, repeat: Any) -> None:
    """Raise SceneError unless `repeat` is a bool, and false where there is no path."""
    if not isinstance(repeat, bool):
        raise SceneError(f"{where}.repeat", repeat, "true or false")
    if repeat and (path is None or (isinstance(path, (list, tuple)) and not path)):
        raise SceneError(f"{where}.repeat", says="there is no path to repeat; give `path`, or leave `repeat` out")
