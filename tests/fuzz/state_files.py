"""State files that were edited."""

import contextlib
import io
import json
import warnings

import numpy as np
from hypothesis import strategies as st

import taichi_sim as ts
from taichi_sim.common.errors import SceneError
from taichi_sim.common.npz import read_npz
from taichi_sim.simulation.settings import Settings

from .documents import changed, damaged, mostly
from .scene_files import CORNERS, TETRAHEDRON


class Judged(ts.Simulation):
    """One that takes a state as others do, but is never compiled."""

    def __init__(self, scene, **given):
        self.scene = scene
        self.settings = Settings.resolve(scene, given)

    def resume(self, snapshot):
        snapshot.checked(self.scene)


def everything():
    """A tetrahedron of balls with a part of most kinds."""
    scene = ts.Scene(dim=3)
    scene.add_material("rubber", restitution=0.5, colour=(0.1, 0.2, 0.3))
    scene.add_balls(
        CORNERS,
        radius=0.1,
        material="rubber",
        group="a",
        collides_with="a",
        pinned=[0],
    )
    scene.add_springs([[0, 1], [1, 2]], stiffness=10.0, break_strain=0.5)
    scene.add_triangles(TETRAHEDRON, collides=True)
    scene.add_cells([[0, 1, 2, 3]], bulk_modulus=5.0)
    scene.add_bending([[0, 1, 2, 3]], weights=[[1, -1, 1, -1]], stiffness=1.0)
    scene.add_embedded_surface([[0, 1], [1, 2], [2, 3]], np.full((3, 2), 0.5), [[0, 1, 2]], colour=(1, 0, 0))
    scene.add_gas(TETRAHEDRON, pressure=1.0)
    scene.add_wind((1, 0, 0))
    scene.add_wall((0, 1, 0), -3.0, material="rubber", collides_with="a")
    scene.add_moving_pins([3], velocity=(1, 0, 0))
    scene.add_motor([0], amplitude=0.1, frequency=2.0, phase=90.0)
    scene.add_collider(ts.Box((9, 0, 0), (1, 1, 1), path=[(0, (0, 0, 0)), (1, (1, 0, 0))]))
    scene.set_name([0, 1], "ends", uv=[[0, 0], [1, 1]])
    scene.add_probe("load", "strain", springs=[0, 1])
    return scene


def whole(folder):
    """The arrays of a state file, and what it says in plain values."""
    scene = everything()
    scene.gravity = np.array([0.0, -10.0, 0.0])
    scene.gases.clear()  # what may tear holds none
    ts.shapes.rope(scene, (5, 0, 0), (6, 0, 0), n=4)
    scene.add_collider(ts.Mesh((CORNERS, TETRAHEDRON), position=(50, 0, 0)))
    scene.add_collider(ts.Sphere((60, 0, 0), 1.0))
    brick = scene.add_balls(np.argwhere(np.ones((2, 2, 2))) + 20.0, radius=0.1)
    scene.add_bricks([brick], young_modulus=9.0, poisson_ratio=0.3)
    scene.add_solids([brick[[0, 1, 2, 4]]], young_modulus=9.0, poisson_ratio=0.3)
    with ts.Simulation(scene, dt=1e-3, contacts="off") as simulation:
        simulation.save(folder / "whole.npz")
    with np.load(folder / "whole.npz") as file:
        arrays = dict(file)
    return arrays, json.loads(str(arrays.pop("about")))


FILLS = [0, -1, 1, 5, 2**31 - 1, 1e-300, -1e300, np.nan, np.inf]
DTYPES = ["f4", "f8", "i1", "i4", "i8", "u8", "?", "U3", "S2", "c16", "f2", "M8[s]"]


@st.composite
def edited(draw, arrays, about):
    """The file with up to three arrays changed, or what it says."""
    arrays, about = dict(arrays), about
    for _ in range(draw(st.integers(1, 3))):
        name = draw(st.sampled_from(sorted(arrays)))
        array = arrays[name]
        what = draw(
            st.sampled_from(
                ["item", "item", "item", "type", "fill", "cut", "more", "drop", "turn", "flat", "other", "about"]
            )
        )
        with np.errstate(all="ignore"):
            if what == "item" and array.size:
                array = array.copy()
                array.flat[draw(st.integers(0, array.size - 1))] = _as(draw(st.sampled_from(FILLS)), array.dtype)
            elif what == "type":
                array = _as(array, np.dtype(draw(st.sampled_from(DTYPES))))
            elif what == "fill":
                array = np.full_like(array, _as(draw(st.sampled_from(FILLS)), array.dtype))
            elif what == "cut" and array.ndim:
                array = array[:-1]
            elif what == "more" and array.ndim:
                array = np.concatenate([array, array])
            elif what == "turn":
                array = array.T
            elif what == "flat":
                array = draw(
                    st.sampled_from([array.ravel(), array[..., None], array[None], np.zeros(()), np.zeros((0, 3))])
                )
            elif what == "other":
                array = arrays[draw(st.sampled_from(sorted(arrays)))]
        if what == "drop":
            del arrays[name]
        else:
            arrays[name] = array
        if what == "about":
            about = draw(changed([about]))
    data = io.BytesIO()
    np.savez(data, about=np.array(json.dumps(about, default=str)), **arrays)
    return data.getvalue()


def _as(value, dtype):
    try:
        return np.asarray(value).astype(dtype)
    except (TypeError, ValueError, OverflowError):
        return np.zeros(np.shape(value), dtype)


def cases(arrays, about):
    """Edited files, and some with damaged bytes."""
    files = edited(arrays, about)
    return mostly(files, files.flatmap(damaged))


def judge(folder, data):
    """Read it."""
    (folder / "state.npz").write_bytes(data)
    with contextlib.suppress(SceneError):
        read_npz(folder / "state.npz")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that it was edited
        return Judged.restore(folder / "state.npz")
