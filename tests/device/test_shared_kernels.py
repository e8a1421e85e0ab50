"""Freed fields serve later ones of the same layout, and equal parts run the same compiled kernels."""

import numpy as np
import pytest

from taichi_sim.device import backend, trees
from taichi_sim.device.engine import ENGINE, ti
from taichi_sim.device.fields import Fields
from taichi_sim.device.shared_kernels import share_kernels

pytestmark = pytest.mark.once


@pytest.fixture(autouse=True)
def _started():
    backend.start("cpu")


@ti.data_oriented
class Part:
    """Weights of n vectors; the factor is compiled in."""

    def __init__(self, fields, weights, factor, extra=None):
        self.n, self.factor, self.extra = len(weights), factor, extra
        self.weight = fields.reals(weights)
        self.vector = fields.vectors(self.n, 3)
        self.row = fields.table({"a": fields.real, "v": ti.types.vector(2, fields.real)}, self.n, by_column=True)

    @ti.kernel
    def work(self):
        for i in range(self.n):
            self.vector[i] += self.factor * self.weight[i]
            self.row[i].v[1] = 2.0 * self.weight[i]


Part.__module__ = "taichi_sim.part"


def made(weights, factor=3.0, extra=None):
    fields = Fields(ti.f32)
    part = Part(fields, np.asarray(weights, dtype=float), factor, extra)
    fields.build()
    return fields, part


def compiled():
    return ti.lang.impl.get_runtime().get_num_compiled_functions()


def test_a_freed_tree_serves_the_next_fields_of_its_layout_zeroed():
    fields, part = made([1.0, 2.0])
    part.work()
    tree = fields._tree
    fields.free()
    assert not fields.built
    again, same = made([5.0, 7.0])
    assert again._tree is tree
    assert same.weight.to_numpy().tolist() == [5.0, 7.0]
    assert not same.vector.to_numpy().any()
    assert not same.row.v.to_numpy().any()
    assert same.vector.shape == (2,)
    other, third = made([5.0, 7.0])  # while the tree is in use
    assert other._tree is not tree
    same.work()
    assert not third.vector.to_numpy().any()
    longer, _ = made([1.0, 2.0, 3.0])
    assert longer._tree not in (tree, other._tree)
    for one in (again, other, longer):
        one.free()
        one.free()


def test_rows_and_columns_are_different_layouts():
    trees_of = []
    for by_column in (False, True):
        fields = Fields(ti.f32)
        fields.table({"a": ti.f32}, 5, by_column=by_column)
        fields.build()
        trees_of.append(fields._tree)
        fields.free()
    assert trees_of[0] is not trees_of[1]


@pytest.mark.skipif(ENGINE != "taichi", reason="it shares none")
def test_equal_parts_compile_once_and_unequal_ones_anew():
    counts, results = [], []
    for weights, factor, extra in (
        ([1.0, 2.0], 3.0, None),
        ([4.0, 5.0], 3.0, None),
        ([6.0, 7.0], 4.0, None),  # another constant
        ([6.0, 7.0], 4.0, np.arange(3)),
        ([6.0, 7.0], 4.0, np.arange(3) + 1),  # no kernel reads the numbers of an array
        ([6.0, 7.0], 4.0, np.arange(4)),
    ):
        fields, part = made(weights, factor, extra)
        known_by = share_kernels({"part": part})
        before = compiled()
        part.work()
        counts.append(compiled() - before)
        results.append(part.vector.to_numpy()[:, 2].tolist())
        fields.free()
        assert known_by
    assert counts == [1, 0, 1, 1, 0, 1]
    assert results == [[3.0, 6.0], [12.0, 15.0], [24.0, 28.0], [24.0, 28.0], [24.0, 28.0], [24.0, 28.0]]


@ti.data_oriented
class Reads(Part):
    @ti.kernel
    def work(self):
        for i in range(self.n):
            self.vector[i] += ti.static(self.extra[0])


Reads.__module__ = Reads.__dict__["work"]._primal.func.__module__ = "taichi_sim.part"


@pytest.mark.skipif(ENGINE != "taichi", reason="it shares none")
def test_a_kernel_that_reads_an_array_is_refused():
    fields = Fields(ti.f32)
    part = Reads(fields, np.ones(2), 3.0, np.arange(3.0))
    fields.build()
    share_kernels({"part": part})
    with pytest.raises(Exception, match=r"kernels read no NumPy array, but .*work reads 'extra'"):
        part.work()
    fields.free()


def test_fields_take_over_the_memory_of_others_that_are_in_use():
    fields, part = made([1.0, 2.0])
    part.work()
    other = Fields(ti.f32, on=fields)
    same = Part(other, np.array([5.0, 7.0]), 3.0)
    assert part.vector.to_numpy().any()
    other.build()
    assert not fields.built
    assert same.weight.to_numpy().tolist() == [5.0, 7.0]
    assert not same.vector.to_numpy().any()
    tree = other._tree
    longer = Fields(ti.f32, on=other)
    unlike = Part(longer, np.ones(3), 3.0)
    assert other.built
    longer.build()
    assert not other.built
    assert longer._tree is not tree
    assert unlike.weight.to_numpy().tolist() == [1.0, 1.0, 1.0]
    assert trees._kept[-1] is tree  # freed, for others
    fewer = Fields(ti.f32, on=longer)
    fewer.reals(np.ones(3))  # begins like the others
    fewer.abandon()
    assert longer.built
    longer.free()


def test_fields_that_only_begin_like_freed_ones_are_their_own():
    fields, _ = made([1.0, 2.0])
    fields.free()
    other = Fields(ti.f32)
    weight = other.reals(np.array([3.0, 4.0]))
    vector = other.vectors(2, 3)
    pair = other.table({"a": ti.f32, "v": ti.types.vector(2, ti.f32)}, 2)  # not by column
    kept = pair.v
    other.build()
    again, same = made([5.0, 6.0])
    same.work()
    kept[1] = [8.0, 9.0]
    assert weight.to_numpy().tolist() == [3.0, 4.0]
    assert not vector.to_numpy().any()
    assert pair.v.to_numpy().tolist() == [[0.0, 0.0], [8.0, 9.0]]
    other.free(), again.free()


def test_parts_from_elsewhere_share_nothing():
    class Own(Part):
        pass

    Own.__module__ = "a_user"
    fields = Fields(ti.f32)
    part = ti.data_oriented(Own)(fields, np.ones(2), 3.0)
    fields.build()
    assert share_kernels({"part": part}) == ""
    plain = made([1.0], extra=lambda x: x)
    assert share_kernels({"part": plain[1]}) == ""
    fields.free(), plain[0].free()


def test_no_more_trees_are_kept_than_allowed(monkeypatch):
    monkeypatch.setattr(trees, "MOST_KEPT", 2)
    for n in (11, 12, 13):
        made(np.ones(n))[0].free()
    assert [tree.layout[0][1] for tree in trees._kept] == [12, 13]
    monkeypatch.setattr(trees, "MOST_KEPT_BYTES", 0)
    made(np.ones(14))[0].free()
    assert not trees._kept


def test_fields_that_are_given_up_leave_nothing_behind():
    fields = Fields(ti.f32)
    fields.reals(3)
    fields.abandon()
    open_ = ti.lang.impl.get_runtime().unfinalized_fields_builder
    assert len(open_) == 1  # the engine's own
    fields, part = made([1.0])
    part.work()
    fields.free()


def test_more_fields_than_a_tree_of_the_engine_has_room_for():
    """450 fields of vectors are 1800 nodes, of 1024; what is freed is taken over as a whole."""

    def fill_all(first):
        fields = Fields(ti.f32)
        held = [fields.reals(np.full((2, 3), first + k)) for k in range(450)]
        fields.build()
        return fields, held

    fields, held = fill_all(1.0)
    assert [one.to_numpy()[1, 2] for one in held] == [1.0 + k for k in range(450)]
    fields.free()
    given = trees._kept[-1]
    fields, held = fill_all(3.0)
    assert fields._tree is given
    assert [one.to_numpy()[1, 2] for one in held] == [3.0 + k for k in range(450)]
    given_up = Fields(ti.f32)
    for _ in range(450):
        given_up.vectors(4, 3)
    given_up.abandon()
    assert len(ti.lang.impl.get_runtime().unfinalized_fields_builder) == 1  # the engine's own
    fields.free()


def test_kernels_run_when_all_were_dropped_with_a_destroyed_tree():
    """What is compiled anew often gets the address of what was dropped, by which Quadrants 1.4.0 keeps what to launch."""
    fields, part = made([1.0, 2.0], factor=4.0)
    for n in range(3, 33):
        part.work()
        made(np.arange(n))[0].free()
        trees._kept.pop().destroy()
    assert part.vector.to_numpy()[1, 0] == 240.0
    fields.free()
