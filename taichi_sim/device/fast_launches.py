"""Kernels that were compiled for the same arguments are launched with a fourth of the engine's overhead.

Each time that a kernel is launched, the engine looks at the type of every argument, asks its compiler for the kernel, and wraps
the object that the kernel belongs to; and it intercepts every access to an attribute of such an object. That takes some 20 us a
launch, as long as a device needs for a loop over a hundred thousand balls, and most of the time in which a small simulation is
reset. Here what was compiled for the same arguments is launched at once.

Private names are touched, so it is used for one version of Taichi only; in any other the engine launches.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.device.engine import IS_KNOWN, ti
from taichi_sim.device.host_memory import seen

__all__ = ["KEY", "BoundKernel", "by_engine", "copy_in", "quicken", "repeated"]

KEY = "_kernels_known_by"  # attribute of an object or a field: what kernels can read of it, see `shared_kernels`
_engine_launches = False  # all kernels, for those who watch it
WHOLE, REAL = (int, np.integer), (int, float, np.integer, np.floating)


class _Compiled(dict):
    """Compiled forms of a kernel in the engine, by its own keys. fast: the kernel and its machine code, by ours.

    The engine forgets all of it when it gives memory back, and takes another dictionary when it stops: nothing that was
    compiled before may be touched then.
    """

    def __init__(self, known: dict) -> None:
        super().__init__(known)
        self.fast: dict[Any, tuple[Any, Any]] = {}

    def clear(self) -> None:
        super().clear()
        self.fast.clear()


class _FastKernel:
    """A kernel, launched by positional arguments. Kernels that return something, and arguments that have no key, are left to the
    engine."""

    def __init__(self, kernel: Any) -> None:
        self._kernel = kernel
        self._keys: list[Callable[[Any], Any]] = []  # of each argument, what the compiled kernel depends on, or None
        self._hand_over: list[tuple[int, Callable[[Any, Any], bool]]] = []
        self._simple = kernel.return_type is None
        for number, argument in enumerate(kernel.arguments):
            self._argument(number, argument.annotation)

    def _argument(self, number: int, kind: Any) -> None:
        engine = ti.lang.kernel_impl
        types, place = engine.primitive_types, (len(self._hand_over),)
        if isinstance(kind, ti.template):
            self._keys.append(_template_key)
            return
        if isinstance(kind, ti.types.ndarray) and kind.dtype is None:
            self._keys.append(_array_key)
            hand_over = _array(place)
        elif id(kind) in types.real_type_ids:
            self._keys.append(_no_key)
            hand_over = _number(place, "set_arg_float", float, REAL)
        elif id(kind) in types.integer_type_ids:
            self._keys.append(_no_key)
            signed = engine.is_signed(engine.cook_dtype(kind))
            hand_over = _number(place, "set_arg_int" if signed else "set_arg_uint", int, WHOLE)
        else:
            self._simple = False
            return
        self._hand_over.append((number, hand_over))

    def __call__(self, *args: Any, **named: Any) -> Any:
        key = self._key(args) if self._simple and not named and not _engine_launches else None
        if key is None:
            return self._kernel(*args, **named)
        kernel = self._kernel
        if type(kernel.compiled_kernels) is _Compiled:
            known = kernel.compiled_kernels.fast.get(key)
            if known is not None and self._launch(*known, args):
                return None
        kernel(*args)
        found, program = kernel.ensure_compiled(*args), kernel.runtime.prog
        if type(kernel.compiled_kernels) is not _Compiled:
            kernel.compiled_kernels = _Compiled(kernel.compiled_kernels)
        compiled = kernel.compiled_kernels[found]
        data = program.compile_kernel(program.config(), program.get_device_caps(), compiled)
        kernel.compiled_kernels.fast[key] = compiled, data
        return None

    def repeated(self, place: int, args: tuple[Any, ...]) -> Callable[[int], None]:
        """Launch with these arguments, except that at `place`, which is given each time."""
        kernel, found = self._kernel, self._kernel.ensure_compiled(*args)
        compiled, program = kernel.compiled_kernels[found], kernel.runtime.prog
        data = program.compile_kernel(program.config(), program.get_device_caps(), compiled)
        context = compiled.make_launch_context()
        for number, hand_over in self._hand_over:
            hand_over(context, args[number])
        change = dict(self._hand_over)[place]

        def launch(value: int) -> None:
            if kernel.compiled_kernels.get(found) is not compiled:  # the engine has forgotten it
                kernel(*args[:place], value, *args[place + 1 :])
                return
            change(context, value)
            try:
                program.launch_kernel(data, context)
            except Exception as error:
                raise ti.lang.kernel_impl.handle_exception_from_cpp(error) from None

        return launch

    def _key(self, args: tuple[Any, ...]) -> Any:
        """Key of the arguments that the compiled kernel depends on; None where the engine has to find out."""
        if len(args) != len(self._keys):
            return None
        keys = tuple([key(argument) for key, argument in zip(self._keys, args)])
        return None if None in keys else keys

    def _launch(self, compiled: Any, data: Any, args: tuple[Any, ...]) -> bool:
        """Launch it; whether that was done: not where an argument is none that it takes."""
        context = compiled.make_launch_context()
        for number, hand_over in self._hand_over:
            if not hand_over(context, args[number]):
                return False
        try:
            self._kernel.runtime.prog.launch_kernel(data, context)
        except Exception as error:
            raise ti.lang.kernel_impl.handle_exception_from_cpp(error) from None
        return True


def _no_key(argument: Any) -> Any:
    return 0


def _template_key(argument: Any) -> Any:
    if isinstance(argument, (bool, int, str)):
        return type(argument).__name__, argument
    return getattr(argument, "__dict__", {}).get(KEY)


def _array_key(argument: Any) -> Any:
    return (argument.dtype.str, argument.ndim) if isinstance(argument, np.ndarray) else None


def _number(place: tuple[int], name: str, cast: Callable, kinds: tuple[type, ...]) -> Callable[[Any, Any], bool]:
    def hand_over(context: Any, value: Any) -> bool:
        fits = isinstance(value, kinds)
        if fits:
            getattr(context, name)(place, cast(value))
        return fits

    return hand_over


def _array(place: tuple[int]) -> Callable[[Any, Any], bool]:
    def hand_over(context: Any, value: Any) -> bool:
        fits = value.flags.c_contiguous and value.size < 1 << 31
        if fits:
            context.set_arg_external_array_with_shape(place, value.ctypes.data, value.nbytes, value.shape, 0)
        return fits

    return hand_over


class _Method:
    """A kernel of a class, in its place."""

    def __init__(self, wrapped: Any) -> None:
        self._wrapped = wrapped
        self.kernel = wrapped._primal
        self.fast = _FastKernel(self.kernel)

    def __get__(self, owner: Any, kind: type) -> Any:
        return self._wrapped if owner is None else BoundKernel(self, owner)


class BoundKernel:
    """A kernel of an object, to be called."""

    __slots__ = ("_kernel_owner", "_method")

    def __init__(self, method: _Method, owner: Any) -> None:
        self._method, self._kernel_owner = method, owner

    @property
    def _primal(self) -> Any:
        return self._method.kernel

    def __call__(self, *args: Any, **named: Any) -> Any:
        try:
            return self._method.fast(self._kernel_owner, *args, **named)
        except (ti.TaichiCompilationError, ti.TaichiRuntimeError) as error:
            if ti.lang.impl.get_runtime().print_full_traceback:
                raise
            raise type(error)("\n" + str(error)) from None


@contextmanager
def by_engine() -> Iterator[None]:
    """Meanwhile the engine launches all kernels."""
    global _engine_launches
    before, _engine_launches = _engine_launches, True
    try:
        yield
    finally:
        _engine_launches = before


def repeated(kernel: Any, place: int, *args: Any) -> Callable[[int], None]:
    """Launch of a kernel of an object, which was launched with these arguments before, except that at `place`, a whole number
    that is given each time. It takes a microsecond; objects of the user's have it, too."""
    if _engine_launches or not IS_KNOWN:
        return lambda value: kernel(*args[:place], value, *args[place + 1 :])
    fast = kernel._method.fast if isinstance(kernel, BoundKernel) else _FastKernel(kernel._primal)
    return fast.repeated(1 + place, (kernel._kernel_owner, *args))


def quicken(kind: type) -> None:
    """Make objects of this class, one of this package, launch their kernels fast, and their attributes plain ones."""
    for base in kind.__mro__:
        if "_data_oriented" not in vars(base) or "__getattribute__" not in vars(base):
            continue
        for name, value in list(vars(base).items()):
            if hasattr(value, "_is_wrapped_kernel") and value._is_classkernel:
                setattr(base, name, _Method(value))
        del base.__getattribute__  # type: ignore[attr-defined]


if IS_KNOWN:
    from taichi import _kernels

    _to_scalars, _to_vectors = (
        _FastKernel(one._primal) for one in (_kernels.ext_arr_to_tensor, _kernels.ext_arr_to_matrix)
    )


def copy_in(field: Any, data: NDArray | dict[str, NDArray]) -> None:
    """Copy numbers of its shape and type into a field; of a table, by the name of the column."""
    if not IS_KNOWN:
        field.from_numpy(data)
    elif isinstance(field, ti.StructField):
        for name, column in field._items:
            copy_in(column, data[name])
    else:
        numbers = np.ascontiguousarray(data)
        vectors = isinstance(field, ti.MatrixField)
        if numbers.shape[0] != field.shape[0] or numbers.ndim != 1 + (vectors and (1 if field.m == 1 else 2)):
            raise ValueError(f"numbers of shape {numbers.shape} do not fit into a field of {field.shape[0]}")
        there = seen(field)
        if there is not None:
            there[...] = numbers.reshape(there.shape)
            return
        if vectors:
            _to_vectors(numbers, field, field.m == 1)
        else:
            _to_scalars(numbers, field)
        ti.sync()
