"""On the CPU the numbers of fields are read and written where they lie, with no kernels of the engine's own."""

import numpy as np
import pytest

from taichi_sim.common.errors import BackendError
from taichi_sim.device import backend
from taichi_sim.device.engine import IS_KNOWN, ti
from taichi_sim.device.fields import Fields, fill
from taichi_sim.device.host_memory import seen

pytestmark = [pytest.mark.once, pytest.mark.skipif(not IS_KNOWN, reason="the layout is not known")]


@ti.data_oriented
class Kinds:
    """One field of each kind, and kernels that write and sum their entries."""

    def __init__(self, n):
        backend.start("cpu")
        self.n, self.fields = n, Fields(ti.f32)
        columns = {"number": ti.i32, "vector": ti.types.vector(3, ti.f32), "last": ti.f32}
        self.row = self.fields.table(columns, n)
        self.by_column = self.fields.table(columns, n, by_column=True)
        self.real = self.fields.reals(np.arange(n, dtype=float))
        self.integer = self.fields.integers(n)
        self.double = self.fields.doubles(n)
        self.key = self.fields.keys(n)
        self.vector = self.fields.vectors(n, 2)
        self.matrix = self.fields.matrices(n, 3)
        self.fields.build()

    @ti.kernel
    def write(self):
        for i in range(self.n):
            for row in ti.static((self.row, self.by_column)):
                row[i].number, row[i].last = 2 * i, 0.5 * i
                row[i].vector = ti.Vector([1.0 * i, 2.0 * i, 3.0 * i])
            self.integer[i], self.double[i], self.key[i] = i + 1, 0.1, ti.cast(i, ti.i64) << 40
            self.vector[i] = ti.Vector([1.0 * i, -1.0 * i])
            self.matrix[i] = ti.Matrix([[1.0 * i, 2.0, 3.0], [4.0, 5.0, 6.0], [7.0, 8.0, 9.0 * i]])

    @ti.kernel
    def mirrored(self) -> ti.f32:
        """Sum, by a kernel, of numbers that the host has written."""
        total = 0.0
        for i in range(self.n):
            total += self.vector[i][1] + self.matrix[i][2, 1] + self.row[i].vector[2] + self.real[i]
        return total


def _compiled():
    return ti.lang.impl.get_runtime().get_num_compiled_functions()


def test_the_host_sees_what_kernels_write():
    kinds, i = Kinds(7), np.arange(7)
    kinds.write()
    for table in (kinds.row.to_numpy(), kinds.by_column.to_numpy()):
        assert table["number"].tolist() == (2 * i).tolist()
        assert np.array_equal(table["vector"], np.outer(i, [1.0, 2.0, 3.0]))
        assert np.array_equal(table["last"], 0.5 * i)
    assert np.array_equal(kinds.real.to_numpy(), i)
    assert np.array_equal(kinds.integer.to_numpy(), i + 1)
    assert kinds.double.to_numpy().dtype == np.float64
    assert np.all(kinds.double.to_numpy() == np.float32(0.1))
    assert np.array_equal(kinds.key.to_numpy(), i << 40)
    assert np.array_equal(kinds.vector.to_numpy(), np.outer(i, [1.0, -1.0]))
    assert kinds.matrix.to_numpy()[3].tolist() == [[3.0, 2.0, 3.0], [4.0, 5.0, 6.0], [7.0, 8.0, 27.0]]
    assert kinds.row[2].vector[1] == 4.0
    assert kinds.vector[6].to_numpy().tolist() == [6.0, -6.0]
    assert kinds.key[3] == 3 << 40


def test_kernels_see_what_the_host_writes_and_no_kernel_copies():
    kinds = Kinds(5)
    kinds.write(), kinds.mirrored()
    before = _compiled()
    kinds.vector.from_numpy(np.full((5, 2), 2.0, dtype=np.float32))
    kinds.matrix.fill(10.0)
    kinds.row.vector.from_numpy(np.full((5, 3), 100.0)[:, ::-1])
    fill(kinds.real, np.full(5, 1000.0))
    kinds.real[1] = 2000.0
    kinds.row[0].vector = [0.0, 0.0, 50.0]
    assert kinds.mirrored() == 5 * 1112.0 + 1000.0 - 50.0
    assert _compiled() == before


def test_a_copy_is_no_view():
    kinds = Kinds(3)
    copy = kinds.real.to_numpy()
    copy[:] = 9.0
    assert kinds.real.to_numpy().tolist() == [0.0, 1.0, 2.0]


def test_nothing_is_seen_once_memory_is_gone():
    kinds = Kinds(4)
    tree = kinds.fields._tree
    assert seen(kinds.real) is not None
    tree._memory.free()  # as `destroy` does
    assert seen(kinds.real) is None


def test_freed_memory_is_zero_for_the_next_fields():
    kinds = Kinds(6)
    kinds.write()
    kinds.fields.free()
    again = Kinds(6)
    assert not again.matrix.to_numpy().any()
    assert not again.row.to_numpy()["vector"].any()
    assert again.real.to_numpy().tolist() == [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]


def test_one_number_of_freed_memory_is_refused():
    kept = Kinds(3).vector
    kept[1] = [4.0, 5.0]
    assert kept[1][1] == 5.0
    backend.stop()
    with pytest.raises(BackendError, match="memory was freed"):
        print(kept[1][1])
    with pytest.raises(BackendError, match="memory was freed"):
        kept[1] = [0.0, 0.0]
