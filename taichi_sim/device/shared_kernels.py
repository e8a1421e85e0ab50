"""Kernels of one simulation, used again by the next one of the same structure.

Taichi compiles a kernel anew for each object that is handed to it, and keeps what it made of the earlier ones until the process
ends. Here an object is known by what kernels can read of it: its place among all parts of a simulation, the constants of all of
them, and the memory of their fields; the numbers of NumPy arrays are no constants, kernels do not read them. Fields of the same
layout take over the memory of freed ones (`fields`), so the parts of a second simulation of the same structure find the kernels
of the first. What merely differs in value is copied into the fields.

Private names are touched, so this holds for one version of Taichi only; in any other every object has kernels of its own.
"""

import functools
import hashlib
import types
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.device.engine import IS_KNOWN, ti
from taichi_sim.device.fast_launches import KEY, BoundKernel, quicken

__all__ = ["share_kernels"]

OURS = "taichi_sim"  # the package; what lies elsewhere may read what is not seen here
PLAIN = (bool, int, float, complex, str, bytes, type(None), np.generic)


def share_kernels(parts: dict[str, Any], apart: tuple[type, ...] = ()) -> str:
    """Make these parts, and all that they hold, use the kernels compiled for equal ones. Returns the key of these kernels; ""
    where nothing is shared: with user-defined parts, which may read what is not seen here, and in another engine.

    To be called once all fields have memory, before any kernel has run. apart: types of what no kernel reads, a scene for
    instance.
    """
    if not IS_KNOWN:
        return ""
    walk = _Walk(apart)
    walk.value(parts)
    if walk.foreign:
        for part in walk.kernel_holders:
            vars(part).pop(KEY, None)
        return ""
    _install()
    known_by = hashlib.sha256(repr(walk.told).encode()).hexdigest()
    for number, part in enumerate(walk.kernel_holders):
        vars(part)[KEY] = (KEY, known_by, number)
        quicken(type(part))
    return known_by


class _Walk:
    """Reads all that is reachable, each object once, in the order in which it is met."""

    def __init__(self, apart: tuple[type, ...]) -> None:
        self.apart = apart
        self.told: list[tuple[object, ...]] = []
        self.kernel_holders: list[Any] = []
        self.foreign = False  # whether a function or a part is not of this package
        self._met: dict[int, int] = {}
        self._alive: list[Any] = []  # so that no identity is given twice

    def _say(self, *words: object) -> None:
        self.told.append(words)

    def value(self, value: Any) -> None:
        kind: Any = type(value)
        if kind in PLAIN or isinstance(value, PLAIN):
            self._say(kind.__name__, value)
        elif isinstance(value, self.apart):
            self._say(kind.__name__)
        elif id(value) in self._met:
            self._say("again", self._met[id(value)])
        else:
            self._met[id(value)] = len(self._met)
            self._alive.append(value)
            _reader(kind)(self, value, kind)

    def field(self, value: Any, kind: type) -> None:
        self._say(kind.__name__, vars(value).get(KEY) or [one.ptr.snode().id for one in value._get_field_members()])

    def array(self, value: NDArray, kind: type) -> None:
        self._say("array", value.shape, value.dtype.str)  # not its numbers: `_install` sees to it that none is read

    def sequence(self, value: Any, kind: type) -> None:
        self._say(kind.__qualname__, len(value))
        for one in value:
            self.value(one)

    def unordered(self, value: Any, kind: type) -> None:
        self._say(kind.__qualname__, len(value))
        for one in sorted(value, key=repr):
            self.value(one)

    def mapping(self, value: Any, kind: type) -> None:
        self._say("dict", len(value))
        for key, one in value.items():
            self.value(key)
            self.value(one)

    def partial(self, value: Any, kind: type) -> None:
        self.value((value.func, value.args, value.keywords))

    def method(self, value: Any, kind: type) -> None:
        self.value((value.__func__, value.__self__))

    def kernel(self, value: Any, kind: type) -> None:
        self._say("kernel", value._primal.func.__qualname__)
        self.value(value._kernel_owner)

    def function(self, value: Any, kind: type) -> None:
        self._say("function", value.__module__, value.__qualname__, value.__code__.co_firstlineno)
        self.foreign = self.foreign or not _is_ours(value)
        self.value((value.__defaults__, *(cell.cell_contents for cell in value.__closure__ or ())))

    def class_(self, value: Any, kind: type) -> None:
        self._say("type", value.__module__, value.__qualname__, id(value))

    def parts(self, value: Any, kind: type) -> None:
        self._say("object", kind.__module__, kind.__qualname__, id(kind))
        if hasattr(kind, "_data_oriented"):
            self.kernel_holders.append(value)
            self.foreign = self.foreign or not _is_ours(kind)
        held = dict(vars(value)) if hasattr(value, "__dict__") else {}
        held.update((name, getattr(value, name)) for name in _slots(kind) if hasattr(value, name))
        held.pop(KEY, None)
        self.value(held)

    def engine_type(self, value: Any, kind: type) -> None:
        self._say(kind.__qualname__, str(value))


@functools.cache
def _reader(kind: type) -> Callable[[_Walk, Any, type], None]:
    """Method of `_Walk` that reads an object of a kind."""
    for read, kinds in (
        (_Walk.field, ti.Field),
        (_Walk.array, np.ndarray),
        (_Walk.sequence, (list, tuple)),
        (_Walk.unordered, (set, frozenset)),
        (_Walk.mapping, (dict, types.MappingProxyType)),
        (_Walk.partial, functools.partial),
        (_Walk.method, types.MethodType),
        (_Walk.kernel, (BoundKernel, ti.lang.kernel_impl._BoundedDifferentiableMethod)),
        (_Walk.function, types.FunctionType),
        (_Walk.class_, type),
    ):
        if issubclass(kind, kinds):
            return read
    return _Walk.parts if hasattr(kind, "__dict__") or hasattr(kind, "__slots__") else _Walk.engine_type


@functools.cache
def _slots(kind: type) -> tuple[str, ...]:
    return tuple(name for base in kind.__mro__ for name in getattr(base, "__slots__", ()))


def _is_ours(value: Any) -> bool:
    return str(value.__module__).split(".")[0] in (OURS, "taichi")


@functools.cache
def _install() -> None:
    """Make the engine look for the key of an object, or of a field, before it takes it by its identity; and refuse kernels of
    this package that read a NumPy array, whose numbers the key does not hold."""
    from taichi.lang.ast.ast_transformer import ASTTransformer
    from taichi.lang.kernel_impl import TaichiCallableTemplateMapper as Mapper

    by_identity, template = Mapper.extract_arg, ti.template

    def extract_arg(argument: Any, annotation: Any, name: str) -> Any:
        if isinstance(annotation, template):
            known_by = getattr(argument, "__dict__", {}).get(KEY)
            if known_by is not None:
                return known_by
        return by_identity(argument, annotation, name)

    Mapper.extract_arg = staticmethod(extract_arg)
    build_attribute = ASTTransformer.build_Attribute

    def attribute(context: Any, node: Any) -> Any:
        found = build_attribute(context, node)
        if isinstance(getattr(node, "ptr", None), np.ndarray) and _is_ours(context.func.func):
            raise TypeError(f"kernels read no NumPy array, but {context.func.func.__qualname__} reads {node.attr!r}")
        return found

    ASTTransformer.build_Attribute = staticmethod(attribute)
