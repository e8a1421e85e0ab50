"""Meshes in each format."""

import struct

import numpy as np
from hypothesis import strategies as st

from taichi_sim.common.errors import SceneError
from taichi_sim.geometry.mesh import read_surface
from tests.support import mesh_zoo

from .documents import changed, damaged, mostly

VERTICES = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype="<f4")
FACES = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]], dtype="<i4")
PLY = "ply\nformat {} 1.0\ncomment é\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\nelement face 4\n"
PLY += "property list uchar int vertex_indices\nend_header\n"


def _stl():
    records = b"".join(bytes(12) + VERTICES[face].tobytes() + bytes(2) for face in FACES)
    return b"solid \xe9".ljust(80) + struct.pack("<I", len(FACES)) + records


def _stl_text():
    facet = "facet normal 0 0 0\nouter loop\n{}endloop\nendfacet\n"
    return "solid s\n" + "".join(
        facet.format("".join("vertex {} {} {}\n".format(*VERTICES[k]) for k in f)) for f in FACES
    )


def _ply():
    return (
        PLY.format("binary_little_endian").encode()
        + VERTICES.tobytes()
        + b"".join(b"\3" + face.tobytes() for face in FACES)
    )


def _ply_text():
    rows = [" ".join(map(str, v)) for v in VERTICES] + [f"3 {a} {b} {c}" for a, b, c in FACES]
    return PLY.format("ascii") + "\n".join(rows) + "\n"


GLTF = {
    "asset": {"version": "2.0"},
    "scene": 0,
    "scenes": [{"nodes": [0]}],
    "nodes": [{"mesh": 0, "children": [1]}, {"mesh": 0, "translation": [2.0, 0.0, 0.0]}],
    "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
    "accessors": [
        {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3"},
        {"bufferView": 1, "componentType": 5125, "count": 12, "type": "SCALAR"},
    ],
    "bufferViews": [{"buffer": 0, "byteLength": 48}, {"buffer": 0, "byteOffset": 48, "byteLength": 48}],
    "buffers": [{"byteLength": 96}],
}


def glb(header):
    """A binary glTF."""
    return mesh_zoo.glb(header, VERTICES.tobytes() + FACES.tobytes())


OBJ = "".join(f"v {x} {y} {z}\n" for x, y, z in VERTICES) + "".join(f"f {a + 1} {b + 1} {c + 1}\n" for a, b, c in FACES)
WHOLE = {
    "a.obj": ("# \xe9\nmtllib ../x.mtl\n" + OBJ).encode("latin-1"),
    "a.ply": _ply_text().encode("latin-1"),
    "b.ply": _ply(),
    "a.stl": _stl_text().encode(),
    "b.stl": _stl(),
    "a.glb": glb(GLTF),
}
WHOLE |= {case.name: case.data for case in mesh_zoo.cases()[::9] if not case.beside}
cases = st.sampled_from(sorted(WHOLE)).flatmap(lambda name: st.tuples(st.just(name), damaged(WHOLE[name])))
cases = mostly(cases, st.tuples(st.just("a.glb"), changed([GLTF]).map(glb)), 3)


def judge(folder, case):
    """Read it: a surface that is whole, or a sentence that says what is wrong."""
    name, data = case
    (folder / name).write_bytes(data)
    try:
        surface = read_surface(folder / name)
    except SceneError as error:
        if "it is damaged" in error.says:  # which no reader foresaw
            raise AssertionError(error.says) from error
        raise
    assert np.isfinite(surface.vertices).all()
    assert 0 <= surface.triangles.min() <= surface.triangles.max() < len(surface.vertices)
    assert surface.uv is None or (surface.uv.shape == (*surface.triangles.shape, 2) and np.isfinite(surface.uv).all())
    return surface
