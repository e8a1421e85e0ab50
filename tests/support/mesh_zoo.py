"""Mesh files as many programs write them: each with the body that it describes, or a part of the sentence that refuses it."""

import base64
import json
import struct
from typing import NamedTuple

import numpy as np


class Body(NamedTuple):
    """A closed surface of polygons, counter-clockwise from outside, and its area [m^2], volume [m^3] and corners [m]."""

    vertices: np.ndarray
    polygons: list[tuple[int, ...]]
    area: float
    volume: float

    @property
    def bounds(self):
        return self.vertices.min(axis=0), self.vertices.max(axis=0)


class Case(NamedTuple):
    name: str
    data: bytes
    body: Body | None  # None: it is refused
    says: str = ""
    beside: tuple[tuple[str, bytes], ...] = ()  # other files of its folder


def prism(outline, height):
    """A prism over a polygon in x and y, counter-clockwise, whose two caps are one polygon each."""
    p = np.array(outline, dtype=float)
    n, q = len(p), np.roll(p, -1, axis=0)
    flat = 0.5 * float(np.sum(p[:, 0] * q[:, 1] - q[:, 0] * p[:, 1]))
    vertices = np.concatenate([np.column_stack([p, np.full(n, z)]) for z in (0.0, height)])
    sides = [(k, (k + 1) % n, n + (k + 1) % n, n + k) for k in range(n)]
    polygons = [tuple(range(n))[::-1], tuple(range(n, 2 * n)), *sides]
    around = float(np.linalg.norm(q - p, axis=1).sum())
    return Body(vertices, polygons, 2 * flat + around * height, flat * height)


BOX = prism([(0, 0), (2, 0), (2, 1), (0, 1)], 1.5)
CUBE = prism([(0, 0), (3, 0), (3, 3), (0, 3)], 3.0)
STEP = prism([(2, 1), (1, 1), (1, 3), (0, 3), (0, 0), (2, 0)], 0.5)  # the first corner does not see all others
COMB = prism(
    [(0, 0), (5, 0), (5, 3), (4, 3), (4, 1), (3, 1), (3, 3), (2, 3), (2, 1), (1, 1), (1, 3), (0.5, 3), (0, 3)], 1.0
)  # three teeth, and a corner along an edge that is straight
ARROW = prism([(0, 0), (3, 1), (0, 2), (1, 1)], 2.0)  # its caps are quadrilaterals that are not convex
FRAME = prism(
    [(0, 0), (3, 0), (3, 3), (0, 3), (0, 0), (1, 1), (1, 2), (2, 2), (2, 1), (1, 1)], 1.0
)  # a hole, and a bridge to it, as editors cut a face with a hole: the two sides of the bridge cancel
FRAME = FRAME._replace(
    polygons=[p for p in FRAME.polygons if p not in ((4, 5, 15, 14), (9, 0, 10, 19))],
    area=2 * 8 + 12 + 4.0,
)
BODIES = {"box": BOX, "step": STEP, "comb": COMB, "arrow": ARROW, "frame": FRAME}


def fans(body):
    """Triangles of a body whose polygons are convex."""
    return [(p[0], p[k], p[k + 1]) for p in body.polygons for k in range(1, len(p) - 1)]


def moved(body, by):
    return body._replace(vertices=body.vertices + by)


def twice(body, by=(9.0, 0.0, 0.0)):
    """A body and another one beside it."""
    n = len(body.vertices)
    return Body(
        np.concatenate([body.vertices, body.vertices + by]),
        body.polygons + [tuple(k + n for k in p) for p in body.polygons],
        2 * body.area,
        2 * body.volume,
    )


# OBJ -------------------------------------------------------------------------------------------------------------------


def v_lines(body, more="", first=0):
    return "".join(f"v {x!r} {y!r} {z!r}{more}\n" for x, y, z in body.vertices[first:].tolist())


def f_lines(body, corner="{0}", shift=1, polygons=None):
    return "".join(
        "f " + " ".join(corner.format(k + shift) for k in p) + "\n"
        for p in (body.polygons if polygons is None else polygons)
    )


def obj_texts(body):
    v, f, n = v_lines(body), f_lines(body), len(body.vertices)
    yield "plain", v + f
    yield "negative", v + f_lines(body, shift=-n)
    own = "".join(
        v_lines(body._replace(vertices=body.vertices[list(p)]))
        + f"f {' '.join(str(k - len(p)) for k in range(len(p)))}\n"
        for p in body.polygons
    )
    yield "negative between vertices", own
    yield "negative with normals and places", v + "vn 0 0 1\nvt 0 0\n" + f_lines(body, "{0}/-1/-1", shift=-n)
    yield "normals alone", v + "vn 0 0 1\n" + f_lines(body, "{0}//1")
    yield "places alone", v + "vt 0.5 0.5 0\n" + f_lines(body, "{0}/1")
    yield (
        "seam",
        v + v + f_lines(body, polygons=body.polygons[:2]) + f_lines(body, polygons=body.polygons[2:], shift=n + 1),
    )
    yield "continued lines", v + f.replace(" ", " \\\n  ")
    yield "a weight", v_lines(body, " 1.0") + f
    yield "colours", v_lines(body, " 0.1 0.2 0.3") + f
    yield "tabs and leading spaces", " \t" + (v + f).replace(" ", "\t  ").replace("\n", " \n\t ")
    yield "exponents", "".join("v {:+.9E} {:+.9E} {:+.9E}\n".format(*tuple(x)) for x in body.vertices) + f
    yield "comments", "# a mesh\n" + v.replace("\n", " # here\n") + "#\n" + f.replace("\n", "# there\n")
    yield "no last line end", (v + f).rstrip()
    yield (
        "materials for each side",
        "mtllib none.mtl\n"
        + v
        + "".join(f"usemtl m{k}\ns {k}\n" + f_lines(body, polygons=[p]) for k, p in enumerate(body.polygons)),
    )
    yield "points and lines as well", v + f + "l 1 2\np 1\nl 1 2 3\n"
    yield "faces first", f + v
    yield "unknown words", "cstype bezier\ndeg 3\n" + v + "g one two\ns off\nvp 0 1\n" + f + "call x.obj\n"
    yield "vertices of no face", "v 99 99 99\n" + v + f_lines(body, shift=2)
    yield "a corner twice", v + "".join("f " + " ".join(str(k + 1) for k in (*p, p[-1])) + "\n" for p in body.polygons)


def obj_cases():
    for name, body in BODIES.items():
        for how, text in obj_texts(body):
            yield Case(f"{name}, {how}.obj", text.encode(), body)
    text = v_lines(STEP) + f_lines(STEP)
    for how, data in (
        ("line ends of DOS", text.replace("\n", "\r\n").encode()),
        ("line ends of old Macs", text.replace("\n", "\r").encode()),
        ("byte order mark", b"\xef\xbb\xbf" + text.encode()),
        ("UTF-16", b"\xff\xfe" + text.encode("utf-16-le")),
        ("UTF-16 of the other end", b"\xfe\xff" + text.encode("utf-16-be")),
        ("comments in Latin-1", b"# caf\xe9\no Gr\xfc\xdfe\n" + text.encode()),
    ):
        yield Case(f"{how}.OBJ", data, STEP)
    yield Case(
        "two objects.obj",
        ("o a\n" + text + "o b\n" + v_lines(moved(STEP, (9, 0, 0))) + f_lines(STEP, shift=13)).encode(),
        twice(STEP),
    )
    far = moved(STEP, (1e4, -2e4, 3e4))
    yield Case("far away.obj", (v_lines(far) + f_lines(far)).encode(), far)
    v = v_lines(BOX)
    for how, data, says in (
        ("decimal commas", v.replace(".", ",") + f_lines(BOX), "line 1: '0,0' is not a number"),
        ("two numbers", v + "v 1 2\n" + f_lines(BOX), "line 9: a vertex needs three numbers"),
        ("vertex 0", v + "f 0 1 2\n", "line 9: vertex 0 does not exist"),
        ("too far back", v + "f -9 -1 -2\n", "line 9: vertex -9 does not exist"),
        ("beyond the end", v + "f 1 2 9\n", "line 9: vertex 9 does not exist"),
        ("words", v + "f one two three\n", "line 9: 'one' is not"),
        ("half an index", v + "f 1.5 2 3\n", "line 9: '1.5' is not"),
        ("points alone", v + "p 1\n", "has no faces"),
        ("not a number", v.replace("v 0.0", "v nan", 1) + f_lines(BOX), "vertex 0 .* not finite"),
        ("too far", v.replace("v 0.0", "v 1e200", 1) + f_lines(BOX), "vertex 0 .* too far"),
        ("no area", v + "f 1 1 2\n", "no face with an area"),
        ("pairs", v + "f 1 2\n", "has no faces"),
        ("underscores", v.replace("2.0", "2_0.0", 1) + f_lines(BOX), "line 2: '2_0.0' is not a number"),
        ("underscores in a face", v + "f 1 2 0_3\n", "line 9: '0_3' is not the number of a vertex"),
        ("a place beyond the end", v + "vt 0 0\nf 1/1 2/1 3/5\n", "line 10: place on a texture 5 does not exist"),
        ("a face of very many corners", v + "f" + " 1 2 3" * 10_000 + "\n", "a face of 30000 corners is not convex"),
        ("a fortran exponent", v.replace("1.5", "1.5D+00") + f_lines(BOX), "line 5: '1.5D[+]00' is not a number"),
        ("a page of a web server", "<!DOCTYPE html><html><body>404</body></html>", "has no faces"),
    ):
        yield Case(f"{how}.obj", data.encode(), None, says)


# STL -------------------------------------------------------------------------------------------------------------------


def stl_text(body, name="a"):
    facets = "".join(
        "facet normal 0 0 0\n outer loop\n"
        + "".join("  vertex {:.6e} {:.6e} {:.6e}\n".format(*tuple(body.vertices[k])) for k in t)
        + " endloop\nendfacet\n"
        for t in fans(body)
    )
    return f"solid {name}\n{facets}endsolid {name}\n"


def stl_binary(body, head=b"", number=None, tail=b"", attribute=0):
    t = fans(body)
    rows = b"".join(struct.pack("<12fH", 0, 0, 0, *body.vertices[list(k)].ravel(), attribute) for k in t)
    return head.ljust(80)[:80] + struct.pack("<I", len(t) if number is None else number) + rows + tail


def stl_cases():
    text = stl_text(BOX)
    for how, data in (
        ("text", text),
        ("capitals", text.upper()),
        ("a strange name", stl_text(BOX, "endsolid facet vertex 1 2 3")),
        ("no name", stl_text(BOX, "").replace("solid \n", "solid\n")),
        ("indented, DOS", "  " + text.replace("\n", "\r\n   ")),
        (
            "one line",
            text.replace("\n", "\r").replace("\r", "\n", 1).replace("\r", " ").replace("endsolid", "\nendsolid"),
        ),
        ("byte order mark", "\ufeff" + text),
        ("a comment before", "solid a ; made by hand\n" + text.partition("\n")[2]),
        ("no end", text.rpartition("endsolid")[0]),
    ):
        yield Case(f"{how}.stl", data.encode(), BOX)
    yield Case("name in Latin-1.stl", b"solid caf\xe9\n" + text.partition("\n")[2].encode(), BOX)
    yield Case("two solids.stl", (text + stl_text(moved(BOX, (9, 0, 0)), "b")).encode(), twice(BOX))
    for how, data in (
        ("binary", stl_binary(BOX)),
        ("binary that begins with solid", stl_binary(BOX, b"solid exported by a CAD program")),
        ("binary with colours", stl_binary(BOX, b"COLOR=\x01\x02\x03\xffMATERIAL=", attribute=0x8000)),
        ("bytes behind", stl_binary(BOX, tail=bytes(10))),
        ("bytes behind, solid", stl_binary(BOX, b"solid x", tail=bytes(2))),
        ("a line end behind", stl_binary(BOX, tail=b"\r\n")),
        ("bytes of Latin-1 in the header", stl_binary(BOX, b"Gr\xfc\xdfe")),
        ("no normals", text.replace("normal 0 0 0", "normal nan -nan inf").encode()),
        ("no ends of facets", text.replace("endfacet\n", "").encode()),
        ("a facet without area", stl_binary(BOX, number=13, tail=bytes(50))),
    ):
        yield Case(f"{how}.stl", data, BOX)
    for how, data, says in (
        ("cut off", stl_binary(BOX)[:-7], "of 12 triangles that would have 684 bytes, and it has 677"),
        ("counts none", stl_binary(BOX, number=0), "of 0 triangles that would have 84 bytes, and it has 684"),
        ("nothing", b"", "STL"),
        ("a text", b"solid nothing\nendsolid nothing\n", "has no faces"),
        ("two corners", text.replace("vertex", "#", 1).encode(), "12 facets.* 35 corners|is not"),
        ("words", text.replace("0.000000e+00", "zero", 1).encode(), "'zero' is not a number"),
        ("underscores", text.replace("2.000000e+00", "2_0", 1).encode(), "'2_0' is not a number"),
        ("UTF-16", ("\ufeff" + text).encode("utf-16-le"), "is no text, which begins with solid"),
        ("a pointer in place of a large file", b"version https://git-lfs.github.com/spec/v1\n" * 3, "is no text"),
        ("an OBJ", (v_lines(BOX) + f_lines(BOX)).encode(), "is no text"),
    ):
        yield Case(f"{how}.stl", data, None, says)


# PLY -------------------------------------------------------------------------------------------------------------------

ENDS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
CODES = {
    "uchar": "B",
    "ushort": "H",
    "int": "i",
    "uint": "I",
    "uint8": "B",
    "int32": "i",
    "float": "f",
    "double": "d",
    "short": "h",
}


def ply(
    body,
    form,
    polygons=None,
    real="float",
    count="uchar",
    index="int",
    word="vertex_indices",
    normals=False,
    edges=0,
    face_first=False,
    face_more=False,
):
    """A PLY file; face_more: a number before and another list after the corners of a face."""
    polygons = body.polygons if polygons is None else polygons
    head = [f"comment gr\u00fc\u00dfe\nelement vertex {len(body.vertices)}"]
    head[0] += "".join(f"\nproperty {real} {name}" for name in ("x", "y", "z"))
    head[0] += "\nproperty float nx\nproperty uchar red" if normals else ""
    more = ("property uchar flags\n", "property list uchar float texcoord\n") if face_more else ("", "")
    head.append(f"element face {len(polygons)}\n{more[0]}property list {count} {index} {word}\n{more[1]}".rstrip())
    end = ENDS[form]

    def row(codes, *values):
        if not end:
            return (" ".join(f"{v:g}" if c in "fd" else str(v) for c, v in zip(codes, values)) + "\n").encode()
        return struct.pack(end + codes, *values)

    r, c, i = CODES[real], CODES[count], CODES[index]
    extra = (0.5, 200) if normals else ()
    vertices = b"".join(row(r * 3 + ("fB" if normals else ""), *x, *extra) for x in body.vertices.tolist())
    faces = b"".join(
        row(
            ("B" if face_more else "") + c + i * len(p) + ("B2f" if face_more and end else "Bff" if face_more else ""),
            *((7,) if face_more else ()),
            len(p),
            *p,
            *((2, 0.5, 0.25) if face_more else ()),
        )
        for p in polygons
    )
    parts = [(head[0], vertices), (head[1], faces)]
    if face_first:
        parts.reverse()
    if edges:
        parts.insert(1, (f"element edge {edges}\nproperty int vertex1\nproperty int vertex2", row("ii", 0, 1) * edges))
    text = "\n".join(["ply", f"format {form} 1.0", "obj_info num_cols 3", *(a for a, _ in parts), "end_header\n"])
    return text.encode() + b"".join(b for _, b in parts)


def _with_real_index(index):
    """A file whose lists of corners are of numbers with a decimal point, one of which is this."""
    data = ply(BOX, "binary_little_endian", index="float")
    return data.replace(struct.pack("<f", 3.0), struct.pack("<f", index), 1)


def ply_cases():
    for form in ENDS:
        for name, body in BODIES.items():
            yield Case(f"{name}, {form}.ply", ply(body, form), body)
        mixed = [*BOX.polygons[:4], *((p[0], p[k], p[k + 1]) for p in BOX.polygons[4:] for k in (1, 2))]
        for how, options in (
            ("triangles", {"polygons": fans(BOX)}),
            ("mixed", {"polygons": mixed}),
            ("double and uint", {"real": "double", "index": "uint"}),
            ("old names", {"word": "vertex_index", "count": "uint8", "index": "int32"}),
            ("wide counts", {"count": "int", "index": "ushort"}),
            ("more columns", {"normals": True}),
            ("edges between", {"edges": 3}),
            ("faces first", {"face_first": True}),
            ("lists of faces", {"face_more": True}),
            ("lists of faces, mixed", {"face_more": True, "polygons": mixed}),
        ):
            yield Case(f"{how}, {form}.ply", ply(BOX, form, **options), BOX)
    data = ply(BOX, "ascii")
    yield Case("line ends of DOS.ply", data.replace(b"\n", b"\r\n"), BOX)
    yield Case("byte order mark.ply", b"\xef\xbb\xbf" + data, BOX)
    yield Case("line ends of old Macs.ply", data.replace(b"\n", b"\r"), BOX)
    yield Case("blank lines.ply", data.replace(b"end_header\n", b"end_header\n\n").replace(b"ply\n", b"ply\n\n"), BOX)
    head, _, body = ply(BOX, "binary_little_endian").partition(b"end_header\n")
    yield Case("DOS head, binary.ply", head.replace(b"\n", b"\r\n") + b"end_header\r\n" + body, BOX)
    strip = "ply\nformat ascii 1.0\nelement vertex 8\nproperty float x\nproperty float y\nproperty float z\n"
    strip += "element tristrips 1\nproperty list int int vertex_indices\nend_header\n"
    strip += "".join("{:g} {:g} {:g}\n".format(*tuple(x)) for x in BOX.vertices)
    runs = [(p[0], p[1], p[3], p[2]) for p in BOX.polygons]
    flat = [k for run in runs for k in (*run, -1)]
    yield Case("strips.ply", (strip + f"{len(flat)} {' '.join(map(str, flat))}\n").encode(), BOX)
    for how, wrong, says in (
        ("cut off", ply(BOX, "binary_little_endian")[:-3], "PLY"),
        ("cut off, text", data[:-12], "PLY"),
        ("beyond", data.replace(b"4 3 2 1 0", b"4 3 2 1 8"), r"has face 0 \(from 0\) of vertices"),
        (
            "a splat",
            data[: data.index(b"element face")].replace(b"float x", b"float f_dc_0") + b"end_header\n" + b"0 0 0\n" * 8,
            "has no",
        ),
        ("a negative count", data.replace(b"vertex 8", b"vertex -8"), "'-8' is not the number of rows"),
        ("no format", data.replace(b"format ascii 1.0\n", b""), "PLY"),
        ("points", data[: data.index(b"element face")] + b"end_header\n" + b"0 0 0\n" * 8, "has no faces"),
        ("huge", data.replace(b"vertex 8", b"vertex 800000000000"), "PLY"),
        ("no end of the head", data.replace(b"end_header", b"end"), "PLY"),
        ("another type", data.replace(b"float x", b"quad x"), "'quad'"),
        ("half an index", data.replace(b"4 3 2 1 0", b"4 3 1.5 1 0"), "1.5 stands where a whole number must"),
        ("half an index, binary", _with_real_index(1.5), "1.5 stands where a whole number must"),
        ("no index", _with_real_index(float("nan")), "nan stands where a whole number must"),
        ("half a corner", data.replace(b"4 3 2 1 0", b"4.5 3 2 1 0"), "4.5 stands where a whole number must"),
        ("underscores", data.replace(b"0 0 0\n", b"0 0_1 0\n", 1), "element vertex: '0_1' is not a number"),
        ("x twice", data.replace(b"float y", b"float x"), "two properties x"),
        ("vertices twice", data.replace(b"element face", b"element vertex"), "two elements of one name"),
        (
            "lists for x",
            data.replace(b"property float x", b"property list uchar float x"),
            "x is a list",
        ),
    ):
        yield Case(f"{how}.ply", wrong, None, says)


# glTF ------------------------------------------------------------------------------------------------------------------

INDEX = {5121: "u1", 5123: "<u2", 5125: "<u4"}


def document(body, nodes=({"mesh": 0},), kind=5123, indexed=True, mode=4, meshes=1):
    """The JSON and the buffer of a glTF."""
    t = np.array(fans(body))
    x = body.vertices.astype("<f4") if indexed else body.vertices[t].reshape(-1, 3).astype("<f4")
    a, b = x.tobytes(), t.astype(INDEX[kind]).tobytes()
    b += bytes(-len(b) % 4)
    inner = {child for node in nodes for child in node.get("children", ())}
    part = {"attributes": {"POSITION": 0}, "mode": mode} | ({"indices": 1} if indexed else {})
    return {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [k for k in range(len(nodes)) if k not in inner]}],
        "nodes": [dict(node) for node in nodes],
        "meshes": [{"primitives": [dict(part)]} for _ in range(meshes)],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": len(x), "type": "VEC3"},
            {"bufferView": 1, "componentType": kind, "count": t.size, "type": "SCALAR"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteLength": len(a)},
            {"buffer": 0, "byteOffset": len(a), "byteLength": len(b)},
        ],
        "buffers": [{"byteLength": len(a + b)}],
    }, a + b


def glb(header, body):
    text = json.dumps(header, default=str).encode()
    text += b" " * (-len(text) % 4)
    size = 12 + 8 + len(text) + 8 + len(body)
    return (
        struct.pack("<4sIIII", b"glTF", 2, size, len(text), 0x4E4F534A)
        + text
        + struct.pack("<II", len(body), 0x004E4942)
        + body
    )


def quantised(body, kind, code, normalised):
    """Positions as whole numbers, of which the largest is the side of a cube around the body."""
    top, side = np.iinfo(kind).max, float(body.vertices.max())
    header, data = document(body)
    old = header["bufferViews"][0]["byteLength"]
    x = np.zeros((len(body.vertices), 4), dtype=kind)
    x[:, :3] = np.rint(body.vertices / side * top)
    header["accessors"][0] |= {"componentType": code, "normalized": normalised}
    header["bufferViews"][0] |= {"byteLength": x.nbytes, "byteStride": x.strides[0]}
    header["bufferViews"][1]["byteOffset"] = x.nbytes
    header["buffers"][0]["byteLength"] = x.nbytes + len(data) - old
    header["nodes"][0]["scale"] = [side if normalised else side / top] * 3
    header["extensionsUsed"] = header["extensionsRequired"] = ["KHR_mesh_quantization"]
    return glb(header, x.tobytes() + data[old:])


def changed(change, *arguments, **options):
    header, body = document(BOX, *arguments, **options)
    change(header)
    return glb(header, body)


def scaled(body, factor, by=(0.0, 0.0, 0.0)):
    return Body(body.vertices * factor + by, body.polygons, body.area * factor**2, body.volume * factor**3)


def interleaved():
    """Positions of which each is followed by a normal."""
    header, body = document(BOX)
    old, x = header["bufferViews"][0]["byteLength"], np.full((len(BOX.vertices), 6), 9.0, dtype="<f4")
    x[:, :3] = BOX.vertices
    header["bufferViews"][0] |= {"byteLength": x.nbytes, "byteStride": 24}
    header["bufferViews"][1]["byteOffset"] = x.nbytes
    header["buffers"][0]["byteLength"] = x.nbytes + len(body) - old
    return glb(header, x.tobytes() + body[old:])


def with_chunk(data):
    """A binary file with a chunk of a kind that nobody knows behind its buffer."""
    return data[:8] + struct.pack("<I", len(data) + 12) + data[12:] + struct.pack("<II4s", 4, 0x58585858, b"abcd")


def gltf_cases():
    def one(*nodes, **options):
        return glb(*document(BOX, nodes or ({"mesh": 0},), **options))

    turned = BOX._replace(vertices=BOX.vertices[:, [1, 0, 2]] * [-1, 1, 1])
    half = 2**-0.5
    for how, data, body in (
        ("plain", one(), BOX),
        ("interleaved", interleaved(), BOX),
        ("a chunk of another kind", with_chunk(one()), BOX),
        ("shape keys out of use", changed(lambda d: d["meshes"][0].update(weights=[0.0, 0])), BOX),
        ("8 bit", one(kind=5121), BOX),
        ("32 bit", one(kind=5125), BOX),
        ("no indices", one(indexed=False), BOX),
        ("moved and scaled", one({"mesh": 0, "translation": [1, 2, 3], "scale": [2, 2, 2]}), scaled(BOX, 2, (1, 2, 3))),
        ("turned", one({"mesh": 0, "rotation": [0, 0, half, half]}), turned),
        ("mirrored", one({"mesh": 0, "scale": [-1, 1, 1]}), BOX._replace(vertices=BOX.vertices * [-1, 1, 1])),
        (
            "two nodes of a name",
            one({"mesh": 0, "name": "x"}, {"mesh": 0, "name": "x", "translation": [9, 0, 0]}),
            twice(BOX),
        ),
        ("two meshes", one({"mesh": 0}, {"mesh": 1, "translation": [9, 0, 0]}, meshes=2), twice(BOX)),
        (
            "a child",
            one({"translation": [5, 0, 0], "scale": [2, 2, 2], "children": [1]}, {"mesh": 0, "translation": [1, 0, 0]}),
            scaled(BOX, 2, (7, 0, 0)),
        ),
        (
            "a matrix",
            one({"mesh": 0, "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 4, 5, 6, 1]}),
            moved(BOX, (4, 5, 6)),
        ),
        ("nodes without a mesh", one({"mesh": 0}, {"name": "empty"}, {"camera": 0}), BOX),
        (
            "a node in no scene",
            changed(lambda d: d.update(scenes=[{"nodes": [0]}]), ({"mesh": 0}, {"mesh": 0, "translation": [9, 9, 9]})),
            BOX,
        ),
        (
            "the second scene",
            changed(
                lambda d: d.update(scene=1, scenes=[{"nodes": [0]}, {"nodes": [1]}]),
                ({"mesh": 0}, {"mesh": 0, "translation": [9, 0, 0]}),
            ),
            moved(BOX, (9, 0, 0)),
        ),
        ("no scene named", changed(lambda d: d.pop("scene")), BOX),
        ("no scene", changed(lambda d: (d.pop("scene"), d.pop("scenes"))), BOX),
        ("no mode", changed(lambda d: d["meshes"][0]["primitives"][0].pop("mode")), BOX),
        (
            "a compression that is not needed",
            changed(lambda d: d.update(extensionsUsed=["KHR_draco_mesh_compression"])),
            BOX,
        ),
        ("a material that is needed", changed(lambda d: d.update(extensionsRequired=["KHR_materials_unlit"])), BOX),
        ("16 bit, scaled", quantised(CUBE, "<u2", 5123, False), CUBE),
        ("16 bit, normalised", quantised(CUBE, "<u2", 5123, True), CUBE),
        ("8 bit, normalised", quantised(CUBE, "u1", 5121, True), CUBE),
        ("8 bit with a sign, normalised", quantised(CUBE, "i1", 5120, True), CUBE),
        ("16 bit with a sign, normalised", quantised(CUBE, "<i2", 5122, True), CUBE),
    ):
        yield Case(f"{how}.glb", data, body)
    fan = [(p[0], p[1], p[3], p[2]) for p in BOX.polygons]
    header, body = document(BOX)
    first = np.array(fan, dtype="<u2")
    header["meshes"][0]["primitives"] = [{"attributes": {"POSITION": 0}, "indices": 1 + k, "mode": 5} for k in range(6)]
    header["accessors"][1:] = [
        {"bufferView": 1, "byteOffset": 8 * k, "componentType": 5123, "count": 4, "type": "SCALAR"} for k in range(6)
    ]
    x = BOX.vertices.astype("<f4").tobytes()
    yield Case("strips.glb", glb(header, x + first.tobytes().ljust(len(body) - len(x), b"\0")), BOX)
    for part in header["meshes"][0]["primitives"]:
        part["mode"] = 6
    first = np.array(BOX.polygons, dtype="<u2")
    yield Case("fans.glb", glb(header, x + first.tobytes().ljust(len(body) - len(x), b"\0")), BOX)
    header, body = document(BOX)
    header["accessors"][0]["sparse"] = {
        "count": 1,
        "indices": {"bufferView": 2, "componentType": 5123},
        "values": {"bufferView": 3},
    }
    where = len(body)
    wrong = np.frombuffer(body, "<f4").copy()
    wrong[:3] = 77.0
    extra = struct.pack("<H2x", 0) + BOX.vertices[0].astype("<f4").tobytes()
    header["bufferViews"] += [
        {"buffer": 0, "byteOffset": where, "byteLength": 2},
        {"buffer": 0, "byteOffset": where + 4, "byteLength": 12},
    ]
    header["buffers"][0]["byteLength"] += len(extra)
    yield Case("sparse.glb", glb(header, wrong.tobytes()[: len(x)] + body[len(x) :] + extra), BOX)
    header, body = document(BOX)
    for how, name, uri in (
        ("plain", "buffer.bin", "buffer.bin"),
        ("a space", "a buffer.bin", "a buffer.bin"),
        ("percent", "a buffer \u00fc.bin", "a%20buffer%20%C3%BC.bin"),
        ("a percent sign", "100%.bin", "100%25.bin"),
        ("a folder", "part.bin", "./part.bin"),
    ):
        header["buffers"][0]["uri"] = uri
        yield Case(f"{how}.gltf", json.dumps(header).encode(), BOX, beside=((name, body),))
    header["buffers"][0]["uri"] = "data:application/octet-stream;base64," + base64.b64encode(body).decode()
    yield Case("data in the text.gltf", json.dumps(header).encode(), BOX)
    yield Case("byte order mark.gltf", b"\xef\xbb\xbf" + json.dumps(header).encode(), BOX)

    def draco(d):
        d["extensionsUsed"] = d["extensionsRequired"] = ["KHR_draco_mesh_compression"]
        for one in d["accessors"]:
            one.pop("bufferView")
        d["meshes"][0]["primitives"][0]["extensions"] = {"KHR_draco_mesh_compression": {"bufferView": 0}}

    def meshopt(d):
        d["extensionsUsed"] = d["extensionsRequired"] = ["EXT_meshopt_compression"]
        d["bufferViews"][0] |= {"buffer": 1, "extensions": {"EXT_meshopt_compression": {"buffer": 0, "byteLength": 96}}}
        d["buffers"].append({"byteLength": 96})

    def beyond(d):
        d["accessors"][0]["count"] = 9

    def circle(d):
        d["nodes"] = [{"children": [1], "mesh": 0}, {"children": [0]}]

    def lines(d):
        d["meshes"][0]["primitives"][0]["mode"] = 1

    def instances(d):
        d["extensionsUsed"] = ["EXT_mesh_gpu_instancing"]
        d["nodes"][0]["extensions"] = {"EXT_mesh_gpu_instancing": {"attributes": {}}}

    for how, change, says in (
        ("draco", draco, "is compressed with Draco .*export it without"),
        ("meshopt", meshopt, "is compressed with meshopt .*export it without"),
        ("beyond its buffer", beyond, r"accessors\[0\] reaches beyond"),
        ("nodes in a circle", circle, "node 0 .*more than once"),
        ("lines", lines, "has no faces"),
        ("instances", instances, "EXT_mesh_gpu_instancing"),
        ("no mesh", lambda d: d.pop("meshes"), "GLB"),
        ("the first version", lambda d: d.update(asset={"version": "1.0"}), "version 1.0"),
        ("no such mesh", lambda d: d["nodes"][0].update(mesh=4), r"nodes\[0\].mesh is 4; .* one of the 1 meshes"),
        ("no such child", lambda d: d["nodes"][0].update(children=[0, 7]), r"children\[1\] is 7"),
        ("no such view", lambda d: d["accessors"][1].update(bufferView=2), r"accessors\[1\].bufferView is 2"),
        ("a mesh before the first", lambda d: d["nodes"][0].update(mesh=-1), "mesh is -1"),
        ("half a count", lambda d: d["accessors"][0].update(count=2.5), r"count is 2.5; it must be a whole number"),
        ("no count", lambda d: d["accessors"][0].pop("count"), r"accessors\[0\].count is missing"),
        ("no such type", lambda d: d["accessors"][0].update(type="VEC5"), "'VEC5'; it must be one of SCALAR, "),
        ("places of two numbers", lambda d: d["accessors"][0].update(type="VEC2"), "'VEC2'; it must be 'VEC3' there"),
        ("real indices", lambda d: d["accessors"][1].update(componentType=5126, count=9), "must be whole"),
        ("a turn of three numbers", lambda d: d["nodes"][0].update(rotation=[0, 0, 1]), "must be 4 numbers"),
        ("a word as a place", lambda d: d["nodes"][0].update(translation=["x", 0, 0]), "must be 3 numbers"),
        ("a list as a head", lambda d: d.update(asset=[2]), r"asset is \[2\]; it must be a table"),
        ("a number as a name", lambda d: d["buffers"][0].update(uri=7), r"uri is 7; it must be a text"),
        ("no primitives", lambda d: d["meshes"][0].pop("primitives"), r"meshes\[0\].primitives is missing"),
        ("a skin", lambda d: d["nodes"][0].update(skin=0, translation=[5, 0, 0]), "has a skin, .* apply the armature"),
        ("shape keys", lambda d: d["meshes"][0].update(weights=[0.0, 0.5]), "has shape keys in use"),
        ("shape keys of a node", lambda d: d["nodes"][0].update(weights=[1]), "has shape keys in use"),
        ("an unknown extension", lambda d: d.update(extensionsRequired=["FOO_hull"]), "needs the extension 'FOO_hull'"),
        ("corners left over", lambda d: d["accessors"][1].update(count=35), "a list of triangles has 35 corners"),
    ):
        yield Case(f"{how}.glb", changed(change), None, says)
    header["buffers"][0]["uri"] = "none.bin"
    yield Case("a buffer that is not there.gltf", json.dumps(header).encode(), None, "none.bin")
    yield Case("cut off.glb", one()[:-20], None, "GLB")
    for how, data in (("damaged", b'{"asset": }'), ("nested", b"[" * 50_000), ("in Latin-1", b'{"a": "\xe9"}')):
        yield Case(f"{how}.gltf", data, None, "its JSON is damaged")


def cases():
    """All of them."""
    return [*obj_cases(), *stl_cases(), *ply_cases(), *gltf_cases()]
