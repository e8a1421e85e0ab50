"""The three errors that a user of taichi_sim can meet, and the words that they share."""

import difflib
import os
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import islice
from typing import Any

from taichi_sim.common.printable import told

__all__ = [
    "BackendError",
    "KeyPath",
    "SceneError",
    "UnstableError",
    "about",
    "did_you_mean",
    "following",
    "key_name",
    "path_of",
    "short",
    "unknown_key",
    "words_of",
]

KeyPath = tuple[str | int, ...]
LONGEST = 60  # of a value or a key in a message
LONGEST_PATH = 300  # of keys
LISTED = 50  # names, before the others are only counted
DIGITS = 18  # of an index; longer ones are no numbers
RENAMED = {
    "contact_passes": "contact_iterations",
    "skins": "embedded_surfaces",
    "add_skin": "add_embedded_surface",
    "angular_velocity": "rotation_rate",
}
MEANT = {  # words of other programs, and what they may be called here
    **dict.fromkeys(("framerate", "frame_rate", "frames_per_second", "rate"), ("fps",)),
    **dict.fromkeys(("resolution", "shape", "width", "height"), ("meshes", "size")),
    **dict.fromkeys(("length", "seconds", "time", "t_end", "end_time"), ("duration",)),
    **dict.fromkeys(("timestep", "time_step", "step", "h", "delta_t"), ("dt",)),
    **dict.fromkeys(("method", "solver", "scheme"), ("integrator",)),
    **dict.fromkeys(("filename", "file", "output"), ("path",)),
}
IN_UNITS = {"angular_velocity": ", in degrees per second"}  # of what was renamed, where these are others


class SceneError(ValueError):
    """Something in the scene is wrong. The message is made of data, which stay attributes.

    path: keys and indices of the place, ("springs", 3, "pairs", 12), given so or as text; () where a sentence stands alone.
    value: what stands there; `...` where no value is at fault. allowed: what it must be. says: in place of that, what is
    wrong, in words that follow the value. file, line: of the scene file or state file, or None.

        SceneError("balls.mass", -1.0, "greater than 0")        balls.mass: -1.0 is not allowed; it must be greater than 0
        SceneError("balls.mass", "x", says="is not a number")   balls.mass: 'x' is not a number
        SceneError("wind", says="there is one already")         wind: there is one already
        SceneError("nothing moves")                             nothing moves
    """

    def __init__(
        self,
        path: str | Sequence[str | int],
        value: Any = ...,
        allowed: str = "",
        *,
        says: str = "",
        file: Any = None,
        line: int | None = None,
    ) -> None:
        if value is ... and not says:
            path, says = (), str(path)
        super().__init__(path, value, allowed)
        self.path, self.value, self.allowed = path_of(path), value, allowed
        self.says = says or f"is not allowed; it must be {allowed}"
        self.file, self.line = file, line

    def __str__(self) -> str:
        at = None if self.file is None else f"{self.file}" + (f", line {self.line}" if self.line else "")
        value = self.value if self.file is None else _as_in_file(self.value)
        sentence = self.says if value is ... else f"{short(value)} {self.says}"
        return told(": ".join(part for part in (at, key_name(self.path), sentence) if part))


class BackendError(RuntimeError):
    """Taichi cannot be started as asked: no such device, or another precision or arch is already running."""


class UnstableError(RuntimeError):
    """A ball became non-finite or left the world.

    Attributes: `time` [s] of the first bad state, `ball` (index), `spring` (index of the stiffest spring at that ball,
    or None), `safe_dt` [s] (largest step that is safe for every shape, or None where the scene has no springs).
    The simulation is left in its last good state.
    """

    def __init__(self, message: str, time: float, ball: int, spring: int | None, safe_dt: float | None) -> None:
        super().__init__(message, time, ball, spring, safe_dt)  # all of them, or it could not be sent between processes
        self.time = time
        self.ball = ball
        self.spring = spring
        self.safe_dt = safe_dt

    def __str__(self) -> str:
        return str(self.args[0])

    @property
    def reason(self) -> str:
        """Words on what happened, without those on the state that is kept."""
        return str(self).split("; the last good")[0]


@contextmanager
def about(place: str) -> Iterator[None]:
    """Let errors speak of `place` instead of the first name in their paths: cloth.pinned[3] in place of balls.pinned[3]; also
    instead of its number, where that name is the one of the place: walls[2].offset in place of walls[0].offset."""
    try:
        yield
    except SceneError as error:
        here, path = path_of(place), error.path
        numbered = path[:1] == here[:1] and len(path) > 1 and isinstance(path[1], int) and len(here) > 1
        error.path = here + path[1 + numbered :]
        raise


@contextmanager
def following(arguments: Mapping[str, Sequence[str]]) -> Iterator[None]:
    """Let errors about what was worked out, columns of tables such as `balls.mass`, speak of the arguments that it follows from:
    cloth.bending_rigidity: makes a stiffness of 2e+50, which is not allowed; ..."""
    try:
        yield
    except SceneError as error:
        if given := arguments.get(".".join(map(str, error.path[:2]))):
            more = f", with {' and '.join(given[1:])}," if len(given) > 1 else ""
            error.says = f"makes{more} a {error.path[1]} of {short(error.value)}, which {error.says}"
            error.path, error.value = (error.path[0], given[0]), ...
        raise


def path_of(place: str | Sequence[str | int]) -> KeyPath:
    """("springs", 3, "pairs", 12) for `springs[3].pairs[12]`."""
    if not isinstance(place, str):
        return tuple(place)
    parts = place.replace("[", ".").replace("]", "").split(".")
    return tuple(int(part) if part.isascii() and part.isdigit() and len(part) <= DIGITS else part for part in parts)


def key_name(path: Sequence[str | int]) -> str:
    """Name of a path as `path_of` takes it: ("springs", 3, "pairs", 12) as `springs[3].pairs[12]`. A key that holds lines or
    control sequences is written as Python writes it; long ones, and long paths, are cut off."""
    names = (
        part if isinstance(part, int) or (part.isprintable() and len(part) <= LONGEST) else short(part) for part in path
    )
    text = "".join(f"[{name}]" if isinstance(name, int) else f".{name}" for name in names).lstrip(".")
    return text if len(text) <= LONGEST_PATH else text[: LONGEST_PATH - 3].rstrip(".") + "..."


def _as_in_file(value: Any) -> Any:
    """Tuples as lists, which files have in their place."""
    return [_as_in_file(one) for one in value] if isinstance(value, (list, tuple)) else value


def short(value: object) -> str:
    """A value as text, cut off where that is long and no path."""
    if isinstance(value, os.PathLike):
        return repr(os.fspath(value))
    text = " ".join(_text(_listed(value)).splitlines())
    return text if len(text) <= LONGEST else text[: LONGEST - 3] + "..."


def _listed(value: Any) -> Any:
    """NumPy's arrays and numbers, also in lists and tuples, as Python's."""
    if type(value) in (list, tuple):
        return type(value)(map(_listed, value))
    return value.tolist() if hasattr(value, "tolist") else value


def _text(value: object) -> str:
    """A value as Python writes it; integers of too many digits for that, which files give in hexadecimal ones, in these."""
    try:
        return repr(value)
    except ValueError:
        if isinstance(value, int):
            return hex(value)
        if isinstance(value, (list, tuple)):
            return f"[{', '.join(map(_text, value))}]"
        if isinstance(value, dict):
            return f"{{{', '.join(f'{_text(key)}: {_text(item)}' for key, item in value.items())}}}"
        raise


def unknown_key(path: str | Sequence[str | int], known: Collection[str], what: str = "a known key") -> SceneError:
    """The error about a key that is none of those known: what it is called now, or may have meant."""
    key = str(path_of(path)[-1])
    if RENAMED.get(key) in known:
        return SceneError(path, says=f"is now called {RENAMED[key]!r}{IN_UNITS.get(key, '')}")
    meant = next((word for word in MEANT.get(key.lower(), ()) if word in known), key)
    return SceneError(path, says=f"is not {what}; {did_you_mean(meant, known)}")


def did_you_mean(word: str, known: Collection[str], otherwise: str = "") -> str:
    """`did you mean 'mass'?`, or all that there is, or what is to be said otherwise."""
    close = difflib.get_close_matches(word, known, n=1)
    if close or otherwise:
        return f"did you mean {close[0]!r}?" if close else otherwise
    more = f" and {len(known) - LISTED} more" if len(known) > LISTED else ""
    return f"there are {', '.join(islice(known, LISTED))}{more}" if known else "there are none"


def words_of(error: BaseException) -> str:
    """`ValueError: what it says`, of an exception that may be of a user's class, whose message cannot be made."""
    try:
        says = str(error)
    except Exception as inner:  # of the user's class
        says = f"(its message raises {type(inner).__name__})"
    return f"{type(error).__name__}: {says}"
