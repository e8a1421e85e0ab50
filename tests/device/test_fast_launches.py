"""Kernels launched without the engine's overhead do what the engine would have done."""

from unittest.mock import patch

import numpy as np
import pytest

from taichi_sim.device import backend, fast_launches, trees
from taichi_sim.device.engine import ENGINE, ti
from taichi_sim.device.fast_launches import BoundKernel, by_engine, copy_in
from taichi_sim.device.fields import Fields
from taichi_sim.device.shared_kernels import share_kernels

pytestmark = [pytest.mark.once, pytest.mark.skipif(ENGINE != "taichi", reason="other engines launch as they do")]


@pytest.fixture(autouse=True)
def _started():
    backend.start("cpu")


@ti.data_oriented
class Adding:
    """Adds to 3 numbers."""

    def __init__(self, fields, factor=1.0):
        self.x, self.factor = fields.reals(3), factor

    @property
    def twice(self):
        return 2.0 * self.factor

    @ti.kernel
    def add(self, real: ti.f32, whole: ti.i32):
        for i in range(3):
            self.x[i] += self.factor * real + whole

    @ti.kernel
    def add_field(self, other: ti.template(), subtract: ti.template()):
        for i in range(3):
            self.x[i] += -other[i] if ti.static(subtract) else other[i]

    @ti.kernel
    def largest(self) -> ti.f32:
        most = 0.0
        for i in range(3):
            ti.atomic_max(most, self.x[i])
        return most


Adding.__module__ = "taichi_sim.part"


def made(factor=1.0):
    fields = Fields(ti.f32)
    part = Adding(fields, factor)
    fields.build()
    assert share_kernels({"part": part})
    return fields, part


@pytest.fixture
def fast(monkeypatch):
    """Names of the kernels whose launches were fast so far."""
    launches = []
    launch = fast_launches._FastKernel._launch
    monkeypatch.setattr(
        fast_launches._FastKernel,
        "_launch",
        lambda kernel, *known: bool(launch(kernel, *known) and (launches.append(kernel._kernel.func.__name__) or True)),
    )
    return launches


def test_the_second_launch_is_fast_and_adds_what_it_is_given(fast):
    fields, part = made(3.0)
    assert isinstance(part.add, BoundKernel)
    for real, whole in ((1.0, 0), (np.float32(0.5), np.int32(2)), (2, True)):
        part.add(real, whole)
    assert fast.count("add") in (2, 3)  # an earlier test may have compiled it
    assert part.x.to_numpy().tolist() == [3.0 * 3.5 + 3.0] * 3
    assert part.largest() == 13.5
    assert part.twice == 6.0
    part.add(real=1.0, whole=0)
    assert part.x[0] == 16.5
    fields.free()


def test_what_a_kernel_may_not_take_is_refused_as_before():
    fields, part = made()
    part.add(1.0, 1)
    with pytest.raises(ti.TaichiRuntimeTypeError, match="Argument"):
        part.add(1.0, 0.5)
    with pytest.raises(ti.TaichiRuntimeTypeError, match="Argument"):
        part.add("1", 1)
    with pytest.raises(Exception, match="`whole : i32` missing"):
        part.add(1.0)
    assert part.x[0] == 2.0
    fields.free()


def test_fields_and_flags_are_told_apart(fast):
    fields, part = made()
    others = Fields(ti.f32)
    one, ten = others.reals(np.ones(3)), others.reals(np.full(3, 10.0))
    others.build()
    for _ in range(2):
        for other in (one, ten):
            for subtract in (False, False, True):
                part.add_field(other, subtract)
    assert part.x[0] == 2 * (1 + 10)
    assert fast.count("add_field") >= 12 - 4
    fields.free()
    others.free()


def test_after_memory_is_given_back_or_the_engine_stops_kernels_are_compiled_again(fast):
    fields, part = made()
    part.add(1.0, 0)
    fast.clear()
    part.add(1.0, 0)
    other = Fields(ti.f32)
    other.reals(7)
    other.build()
    other.free()
    trees._kept.pop().destroy()
    assert fast == ["add"]
    part.add(1.0, 0)
    assert fast == ["add"]
    part.add(1.0, 0)
    assert part.x[0] == 4.0
    assert fast == ["add", "add"]
    backend.stop()
    backend.start("cpu")
    fields, part = made()
    part.add(1.0, 0)
    assert fast == ["add", "add"]
    part.add(1.0, 0)
    assert part.x[0] == 2.0
    assert fast == ["add"] * 3
    fields.free()


def test_who_watches_launches_sees_them():
    fields, part = made()
    part.add(1.0, 0)
    seen, kind = [], ti.lang.kernel_impl.Kernel
    launch = kind.launch_kernel
    with by_engine(), patch.object(kind, "launch_kernel", lambda *args: seen.append(1) or launch(*args)):
        part.add(1.0, 0)
        part.add(1.0, 0)
    assert len(seen) == 2
    part.add(1.0, 0)
    assert part.x[0] == 4.0
    fields.free()


def test_numbers_are_copied_into_fields_of_every_kind():
    fields = Fields(ti.f32)
    real, vector, matrix = fields.reals(4), fields.vectors(4, 3), fields.matrices(4, 2)
    rows = fields.table({"a": ti.i32, "v": ti.types.vector(2, ti.f32)}, 4)
    fields.build()
    for seed in range(2):
        rng = np.random.default_rng(seed)
        for field, shape in ((real, (4,)), (vector, (3, 4)), (matrix, (4, 2, 2))):
            data = rng.normal(size=shape).astype(np.float32)
            data = data.T if field is vector else data  # not contiguous
            copy_in(field, data)
            assert np.array_equal(field.to_numpy(), data)
        data = {"a": rng.integers(9, size=4, dtype=np.int32), "v": rng.normal(size=(4, 2)).astype(np.float32)}
        copy_in(rows, data)
        assert np.array_equal(rows.a.to_numpy(), data["a"])
        assert np.array_equal(rows.v.to_numpy(), data["v"])
    for field, shape in ((real, (5,)), (real, (4, 1)), (vector, (4,)), (matrix, (4, 2))):
        with pytest.raises(ValueError, match="do not fit"):
            copy_in(field, np.zeros(shape, np.float32))
    fields.free()
