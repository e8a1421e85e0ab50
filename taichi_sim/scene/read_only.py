"""Tables and lists that stay as they are: the settings and the output of a scene that belongs to a simulation."""

from collections.abc import Mapping
from copy import deepcopy
from typing import Any, NoReturn

from taichi_sim.common.errors import SceneError

__all__ = ["read_only", "refuse"]


def refuse(name: str, /, *_: object, **__: object) -> NoReturn:
    """Raise SceneError: the scene of a simulation is not changed."""
    says = "this scene belongs to a simulation and stays as it is; change your own, and make another simulation"
    raise SceneError(name, says=says)


def read_only(name: str, value: Any) -> Any:
    """A copy whose tables and lists cannot be changed, all the way down; its own copies can. name: of it, for messages."""
    if isinstance(value, Mapping):
        return _Table(name, {key: read_only(f"{name}.{key}", one) for key, one in value.items()})
    if isinstance(value, list):
        return _List(name, [read_only(name, one) for one in value])
    return deepcopy(value)


class _Table(dict[str, Any]):
    def __init__(self, name: str, given: Mapping[str, Any]) -> None:
        super().__init__(given)
        self._name = name

    def _refuse(self, *_: object, **__: object) -> NoReturn:
        refuse(self._name)

    def __reduce__(self) -> Any:
        return _Table, (self._name, dict(self))

    def __deepcopy__(self, memory: Any) -> dict[str, Any]:
        return {key: deepcopy(value, memory) for key, value in self.items()}

    __setitem__ = __delitem__ = __ior__ = _refuse  # type: ignore[assignment]
    clear = pop = popitem = setdefault = update = _refuse  # type: ignore[assignment]


class _List(list[Any]):
    def __init__(self, name: str, given: list[Any]) -> None:
        super().__init__(given)
        self._name = name

    def _refuse(self, *_: object, **__: object) -> NoReturn:
        refuse(self._name)

    def __reduce_ex__(self, _: Any) -> Any:
        return _List, (self._name, list(self))

    def __deepcopy__(self, memory: Any) -> list[Any]:
        return [deepcopy(value, memory) for value in self]

    __setitem__ = __delitem__ = __iadd__ = __imul__ = _refuse  # type: ignore[assignment]
    append = clear = extend = insert = pop = remove = reverse = sort = _refuse  # type: ignore[assignment]
