"""Trees of fields: allocated memory that outlives its owner, for the next one that wants the same.

Taichi gives memory back only by whole trees, drops the kernels of all others with one, and compiles the same kernel again for
another tree. So a freed tree is kept for a while, and fields of the same layout take it over, zeroed.
"""

from typing import Any

from taichi_sim.device.engine import forget_launches, program, ti
from taichi_sim.device.fast_launches import KEY, quicken
from taichi_sim.device.host_memory import HostMemory

__all__ = ["Tree", "drop", "forget", "kept", "lead", "take", "take_back", "twin"]

MOST_KEPT, MOST_KEPT_BYTES = 16, 64 << 20  # freed trees
SHORT = 4096  # entries of a field that one thread sets to zero
MOST_UNROLLED = 32  # fields a kernel; Taichi warns of more
_kept: list["Tree"] = []  # the last one freed at the end
_dropped: list["Tree"] = []  # by owners that were collected; maybe on another thread, where Taichi must not be called


class Tree:
    """Allocated fields. `fields` mean the memory of those declared, which are handed out: the owner's may be changed, and these
    stay, known to Taichi's own kernels that copy into them."""

    def __init__(self, layout: tuple[Any, ...], declared: list[Any], builders: list[Any], size: int) -> None:
        self.layout, self.bytes = layout, size
        self._trees = [builder.finalize() for builder in builders]
        ti.lang.impl.get_runtime().materialize()  # fields learn where their entries lie
        self._program = program()
        self.fields = [twin(field) for field in declared]
        self._memory = HostMemory(self.fields)
        self._zeros: list[_Zeros] | None = None
        self.lend(declared)

    @property
    def alive(self) -> bool:
        """True if the engine that holds it still runs."""
        return self._program is program()

    def lend(self, declared: list[Any]) -> None:
        """Make declared fields of this layout aliases of this memory."""
        for field, own in zip(declared, self.fields):
            if vars(field).get(KEY) != vars(own)[KEY]:  # else it is one already
                lead(field, own)

    def clear(self) -> None:
        """Set all fields to zero, as a new tree's are."""
        if self._memory.alive:
            self._memory.clear()
            return
        if self._zeros is None:
            alike: dict[int, list[Any]] = {}
            for field in self.fields:
                for one in _numbers(field):
                    alike.setdefault(one.shape[0], []).append(one)
            self._zeros = [
                _Zeros(some[k : k + MOST_UNROLLED])
                for some in alike.values()
                for k in range(0, len(some), MOST_UNROLLED)
            ]
            quicken(_Zeros)
        for zeros in self._zeros:
            zeros.write()

    def destroy(self) -> None:
        """Give the memory back; all kernels of the process are compiled again when they run next."""
        self._memory.free()
        for tree in self._trees:
            tree.destroy()
        forget_launches()


def kept() -> list[Tree]:
    """The freed trees, the last one freed at the end."""
    while _dropped:
        take_back(_dropped.pop())
    _kept[:] = [tree for tree in _kept if tree.alive]
    return list(_kept)


def take(
    layout: tuple[Any, ...], declared: list[Any], builders: list[Any], released: Tree | None = None
) -> Tree | None:
    """A tree of this layout, `released` or one that was freed, zero, lent to the declared fields in place of what their builders
    would make; None where there is none."""
    free = [*kept(), *[released] * (released is not None)]
    tree = next((tree for tree in reversed(free) if tree.layout == layout), None)
    if tree is not None:
        if tree is not released:
            _kept.remove(tree)
        forget(builders)
        tree.lend(declared)
        tree.clear()
    return tree


def take_back(tree: Tree) -> None:
    """Keep what its owner has freed, or, where too much is kept, give back what was freed first."""
    _kept[:] = [*kept(), tree]
    while len(_kept) > MOST_KEPT or sum(tree.bytes for tree in _kept) > MOST_KEPT_BYTES:
        _kept.pop(0).destroy()


def drop(tree: Tree) -> None:
    """Give back a tree on any thread: it is kept when the next one is looked for."""
    _dropped.append(tree)


def forget(builders: list[Any]) -> None:
    """Remove builders whose fields nobody will use from what the engine waits for."""
    if not builders:
        return
    runtime = ti.lang.impl.get_runtime()
    for builder in builders:
        runtime.unfinalized_fields_builder.pop(builder, None)
    for waiting in (runtime.global_vars, runtime.grad_vars, runtime.dual_vars, runtime.matrix_fields):
        waiting.clear()


@ti.data_oriented
class _Zeros:
    """Sets fields of numbers of the same length to zero, in one loop: a loop for each takes a third of a second to compile."""

    def __init__(self, fields: list[Any]) -> None:
        self.fields, self.length = tuple(fields), fields[0].shape[0]
        self.short = self.length <= SHORT
        vars(self)[KEY] = (KEY, tuple(field.snode.ptr.id for field in fields))

    def write(self) -> None:
        """All of them."""
        self._write(self.length)

    @ti.kernel
    def _write(self, length: int):
        ti.loop_config(serialize=ti.static(self.short))
        for i in range(length):
            for field in ti.static(self.fields):
                field[i] = ti.cast(0, field.dtype)


def _numbers(field: Any) -> list[Any]:
    """The fields of numbers of which a field is made."""
    if isinstance(field, ti.StructField):
        return [number for _, member in field._items for number in _numbers(member)]
    if isinstance(field, ti.MatrixField):
        return [field.get_scalar_field(row, column) for row in range(field.n) for column in range(field.m)]
    return [field]


def twin(field: Any) -> Any:
    """Copy of a field that means the same memory."""
    if isinstance(field, ti.StructField):
        other = ti.StructField({name: twin(one) for name, one in field._items}, field.struct_methods, field.name)
    else:
        other = object.__new__(type(field))  # `copy.copy` takes three times as long
        vars(other).update(vars(field))
    members = field._get_field_members()
    vars(other)[KEY] = (KEY, members[0].ptr.snode().id, len(members), isinstance(field, ti.StructField))
    return other


def lead(field: Any, own: Any) -> None:
    """Make `field`, and the members that may have been taken from it, aliases of `own`, another field of the same layout."""
    if isinstance(field, ti.StructField):
        vars(field)[KEY] = vars(own).get(KEY)
        for name, member in field._items:
            lead(member, own.get_member_field(name))
    else:
        vars(field).update(vars(own))
