"""Files for ParaView: x.pvd, and the polygons of each frame as x_00000.vtp, in VTK's XML format.

They are written here: meshio, small and kept, has no polygons (.vtp), and VTK itself weighs 140 MB. The format is text around
arrays as they lie in memory ("raw appended" data), which is quick, too.
"""

from collections.abc import Mapping
from os import PathLike
from typing import IO, Any
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import NDArray

from taichi_sim.analysis.frame import Frame
from taichi_sim.common.atomic_file import naming, replacing
from taichi_sim.outputs.base import Image
from taichi_sim.outputs.geometry import Geometry
from taichi_sim.outputs.parts import Together

HEAD = '<?xml version="1.0"?>\n<VTKFile type="{}" version="1.0" byte_order="LittleEndian" header_type="UInt64">\n'
BEGIN, END = HEAD.format("Collection") + "<Collection>\n", "</Collection>\n</VTKFile>\n"
TYPES = {"f4": "Float32", "f8": "Float64", "i4": "Int32", "u1": "UInt8"}


class ParaView(Geometry):
    """x.pvd names the files of all frames with their times [s]; it is complete after each frame.

    x_00000.vtp holds all parts, see `Together`: points with velocity [m/s], radius [m], colour, object (number), ball (number, or
    -1), Normals and TCoords; loose balls as vertices, springs between them as lines, triangles. The field data `names` are those
    of the objects, `TimeValue` is the time. What was written before an error or Ctrl-C stays.
    """

    suffix = ".vtp"
    keeps_frames = False  # the .pvd has all of them

    def __init__(self, path: str | PathLike[str], resume: bool = False) -> None:
        super().__init__(path, resume)
        self.pattern = f"{self.path}, {self.pattern}"
        self._end = 0  # byte behind the last entry of the .pvd

    def holds(self, count: int) -> bool:
        if not (super().holds(count) and self.path.is_file()):
            return False
        return self.path.read_text(encoding="utf-8").count("\n<DataSet ") == count

    def write(self, index: int, frame: Frame, image: Image | None) -> None:
        self._time = frame.time
        super().write(index, frame, image)
        entry = f'<DataSet timestep="{float(frame.time)!r}" part="0" file={quoteattr(self._file(index).name)}/>\n'
        if not self._end:
            with replacing(self.path) as file:
                file.write((BEGIN + entry + END).encode())
            self._end = len(BEGIN.encode())
        else:
            with naming(self.path), open(self.path, "r+b") as file:
                file.seek(self._end)
                file.write((entry + END).encode())
        self._end += len(entry.encode())

    def fill(self, file: IO[bytes], parts: Together) -> None:
        columns = {"velocity": parts.velocity, "Normals": parts.normals, "radius": parts.radius}
        point_data = {name: column.astype("<f4") for name, column in columns.items()}
        point_data |= {"object": parts.number, "ball": parts.ball, "colour": np.rint(255.0 * parts.colour).astype("u1")}
        if np.isfinite(parts.uv).any():
            point_data["TCoords"] = np.nan_to_num(parts.uv).astype("<f4")
        names = np.frombuffer(b"".join(name.encode() + b"\0" for name in parts.names), dtype="u1")
        file.write(_polygons(self._time, names, len(parts.names), parts, point_data))


def _polygons(time: float, names: NDArray, count: int, parts: Together, point_data: Mapping[str, NDArray]) -> bytes:
    """A whole .vtp file."""
    blocks: list[bytes] = []
    place = 0

    def array(name: str, values: NDArray, **more: Any) -> str:
        nonlocal place
        values = np.ascontiguousarray(values)
        kind = TYPES[values.dtype.str[1:]]
        more = {"NumberOfComponents": values.shape[1] if values.ndim == 2 else 1, **more}
        words = " ".join(f'{key}="{value}"' for key, value in more.items())
        data = values.tobytes()
        blocks.append(len(data).to_bytes(8, "little") + data)
        text = f'<DataArray Name="{name}" type="{kind}" {words} format="appended" offset="{place}"/>\n'
        place += len(blocks[-1])
        return text.replace('type="UInt8" NumberOfComponents="1"', 'type="String"') if name == "names" else text

    def cells(kind: str, corners: NDArray) -> str:
        n, width = corners.shape
        ends = width * np.arange(1, n + 1, dtype="<i4")
        return f"<{kind}>\n{array('connectivity', corners.astype('<i4').ravel())}{array('offsets', ends)}</{kind}>\n"

    sizes: dict[str, NDArray] = {
        "Points": parts.points,
        "Verts": parts.loose,
        "Lines": parts.springs,
        "Polys": parts.triangles,
    }
    text = HEAD.format("PolyData") + "<PolyData>\n<FieldData>\n"
    text += array("TimeValue", np.array([time], dtype="<f8"), NumberOfTuples=1)
    text += array("names", names, NumberOfTuples=count) + "</FieldData>\n<Piece "
    text += " ".join(f'NumberOf{name}="{len(values)}"' for name, values in sizes.items()) + ">\n"
    mapped = ' TCoords="TCoords"' if "TCoords" in point_data else ""
    text += f'<PointData Scalars="object" Vectors="velocity" Normals="Normals"{mapped}>\n'
    text += "".join(array(name, values) for name, values in point_data.items()) + "</PointData>\n"
    text += f"<Points>\n{array('Points', parts.points.astype('<f4'))}</Points>\n"
    text += cells("Verts", parts.loose[:, None]) + cells("Lines", parts.springs) + cells("Polys", parts.triangles)
    text += '</Piece>\n</PolyData>\n<AppendedData encoding="raw">\n_'
    return b"".join([text.encode(), *blocks, b"\n</AppendedData>\n</VTKFile>\n"])
