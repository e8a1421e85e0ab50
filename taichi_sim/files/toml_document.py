"""The document of a scene file: its text, what that says in TOML, and errors that name the line and the key's path."""

import re
import sys
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from taichi_sim.common.errors import KeyPath, SceneError, unknown_key
from taichi_sim.files.toml_lines import deepest_line, line_of

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

if TYPE_CHECKING:
    from pydantic import BaseModel

__all__ = ["MOST_NESTED", "Parsed", "located", "nested", "parsed"]

MOST_NESTED = 16  # lists and tables within each other
LONG_KEY = re.compile(
    r"""(?<![\w"'.-])(?:(?:[\w-]+|"[^"\n]*"|'[^'\n]*')[ \t]*\.[ \t]*){1000}"""
)  # which takes seconds to parse


def parsed(file: Path) -> tuple[str, dict[str, Any]]:
    """The text of a file and what it says in TOML. Raises SceneError."""
    try:
        text = file.read_text(encoding="utf-8-sig")  # some editors begin a file with a byte order mark
        if LONG_KEY.search(text):
            raise RecursionError
        document = tomllib.loads(text)
    except UnicodeDecodeError as error:
        raise SceneError((), says=f"is not a text in UTF-8: {error.reason} at byte {error.start}", file=file) from None
    except RecursionError:
        raise _too_deep(file, text, ()) from None
    except ValueError as error:  # TOMLDecodeError, or one of a number or a date that Python does not make
        raise SceneError((), says=f"is not valid TOML: {error}", file=file) from None
    path = nested(document)
    if path is not None:
        raise _too_deep(file, text, path)
    return text, document


def nested(document: Any) -> KeyPath | None:
    """Path, cut to MOST_NESTED keys, of lists and tables that lie within each other more than MOST_NESTED deep; None where
    there are none."""
    deep: list[tuple[KeyPath, Any]] = [((), document)]
    while deep:
        path, value = deep.pop()
        if isinstance(value, (dict, list)):
            if len(path) > MOST_NESTED:
                return path[:MOST_NESTED]
            items = value.items() if isinstance(value, dict) else enumerate(value)
            deep += [((*path, key), item) for key, item in items if isinstance(item, (dict, list))]
    return None


def _too_deep(file: Path, text: str, path: KeyPath) -> SceneError:
    says = f"has lists or tables within each other, more than {MOST_NESTED} deep"
    error = located(file, text, SceneError(path[:2], says=says))
    error.line = error.line or deepest_line(text)
    return error


class Parsed:
    """One parsed document; every error leaves it with the file, the line and the key's path. own: names of tables that the
    caller invents."""

    def __init__(self, file: Path, text: str, document: dict[str, Any], own: Collection[str] = ()) -> None:
        self.file, self.text, self.document, self._own = file, text, document, own
        self.spelled: dict[KeyPath, str] = {}  # how the file spells keys for which there are two spellings

    @contextmanager
    def _at(self, *place: str | int) -> Iterator[None]:
        """Give an error from within the block its file, line and path: that of the key in the table at `place`."""
        try:
            yield
        except SceneError as error:
            raise self._located(error, _fitting(self.document, place + _within_table(error.path, place))) from None

    def _located(self, error: SceneError, path: KeyPath) -> SceneError:
        known = next((depth for depth in range(len(path), 0, -1) if path[:depth] in self.spelled), 0)
        error.path = (*path[: known - 1], self.spelled[path[:known]], *path[known:]) if known else path
        return located(self.file, self.text, error)

    def _spell(self) -> None:
        """Give keys that have two spellings the one that the models know. Raises SceneError where both are given."""
        from taichi_sim.files.toml_schema import ALIASES, Document

        for name, tables in self.document.items():
            if name not in Document.model_fields:
                continue
            places: list[tuple[KeyPath, Any]] = [((name,), tables)]
            if isinstance(tables, list):
                places = [((name, index), table) for index, table in enumerate(tables)]
            for place, table in places:
                for other in ALIASES.keys() & set(table) if isinstance(table, dict) else ():
                    if ALIASES[other] in table:
                        error = SceneError((), says=f"is another spelling of {ALIASES[other]!r}, which is given, too")
                        raise self._located(error, (*place, other))
                    key = (*place, ALIASES[other])
                    table[key[-1]] = table.pop(other)
                    self.spelled[key] = other

    def _validated(self) -> "BaseModel":
        from pydantic import ValidationError

        from taichi_sim.files.toml_schema import Document, keys_at, what_is_allowed

        try:
            return Document.model_validate(
                _frozen({name: table for name, table in self.document.items() if name not in self._own})
            )
        except ValidationError as error:
            problems: list[Any] = error.errors(include_url=False)
        unknown = next((p["loc"] for p in problems if p["type"] == "extra_forbidden"), None)
        if unknown is not None:
            raise self._located(unknown_key(unknown, keys_at(unknown)), unknown)
        first = problems[0]
        path, value = _known(self.document, first["loc"])
        if first["type"] == "missing":
            missing = (*path, *first["loc"][len(path) : len(path) + 1])
            wanted = (
                "the first line of a scene file is `format = 1`" if missing == ("format",) else "this table needs it"
            )
            raise self._located(SceneError(missing, says=f"is missing; {wanted}"), missing)
        if len(path) == 1 and isinstance(value, dict):
            says = f"is written as one table; there may be several of them: write [[{path[0]}]]"
            raise self._located(SceneError(path, says=says), path)
        allowed = []
        for problem in problems:
            if _known(self.document, problem["loc"])[0] == path:  # one for each type that the key may have
                of_items = any(isinstance(part, int) for part in problem["loc"][len(path) :])
                allowed.append(("a list, each " if of_items else "") + what_is_allowed(problem))
        raise self._located(SceneError(path, value, " or ".join(dict.fromkeys(allowed))), path)


def located(file: Path, text: str, error: SceneError) -> SceneError:
    """The error, with the file and the line of its path there."""
    error.file, error.line = file, line_of(text, error.path)
    return error


def _frozen(value: Any) -> Any:
    """Lists as tuples, all the way down: what the strict models take for a sequence of any kind."""
    if isinstance(value, dict):
        return {key: _frozen(item) for key, item in value.items()}
    return tuple(_frozen(item) for item in value) if isinstance(value, list) else value


def _known(document: Any, path: Sequence[str | int]) -> tuple[KeyPath, Any]:
    """The leading part of a path that exists in the document, and what is there: pydantic's own path goes on into the members
    of a union."""
    for depth, part in enumerate(path):
        fits = isinstance(document, dict) and part in document
        fits = fits or (isinstance(document, list) and isinstance(part, int) and part < len(document))
        if not fits:
            return tuple(path[:depth]), document
        document = document[part]
    return tuple(path), document


def _within_table(path: KeyPath, place: KeyPath) -> KeyPath:
    """Path of an error without the name that a function gives to what it checks, and without its number there: `size` of
    `colliders[2].size`, (2,) of no table."""
    if not place or (len(path) == 1 and path[0] != place[0]):
        return path
    return path[2:] if len(path) > 1 and isinstance(path[1], int) else path[1:]


def _fitting(document: Any, path: KeyPath) -> KeyPath:
    """The path without an index 0 that the document does not have: one vector was checked as a list of one."""
    for depth, part in enumerate(path):
        shorter = path[:depth] + path[depth + 1 :]
        if part == 0 and _known(document, path)[0] != path and _known(document, shorter)[0] == shorter:
            return shorter
    return path
