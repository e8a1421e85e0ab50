"""Frames and pictures as records, from which the same ones are made again."""

import io
import json
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import replace
from fractions import Fraction
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.analysis.diagnostics import Energy
from taichi_sim.analysis.frame import Contacts, Frame, Placed
from taichi_sim.analysis.lazy_frame import Moment, MomentsOf

__all__ = ["FrameRecords", "PicturePacker", "picture_of", "png_of", "unpacked_pictures"]

LENGTH = 4  # bytes that say how long the text is with which a record begins
KINDS = ("<f4", "<f8", "<i4", "|b1")  # of arrays
# what may differ from frame to frame in frames that are not a simulation's
FREE = ("springs", "sticks", "strain", "triangles", "torn_springs", "torn_triangles", "colour")
LOSSLESS = {"preset": "ultrafast", "qp": "0", "tune": "zerolatency", "threads": "1"}  # a packet a picture, at once


class FrameRecords:
    """Packs what changes between the frames of one run. first: a frame that has what does not; arrays: pack these, too; without
    them frames have time, energy, contacts and probes alone."""

    def __init__(self, first: Frame, arrays: bool) -> None:
        self._first, self._arrays = first, arrays
        self._moments = MomentsOf(first.scene) if isinstance(first, Moment) else None

    def pack(self, frame: Frame) -> bytes:
        """A record: the length of a text, the text, which lists the arrays, and these. The energy is in it where it is known."""
        arrays = {name: _packed_array(array) for name, array in self._changing(frame)} if self._arrays else {}
        energy = frame.known_energy if isinstance(frame, Moment) else frame.energy
        about = {
            "time": frame.time,
            "energy": energy,
            "contacts": frame.contacts,
            "probes": dict(frame.probes),
            "arrays": [(name, array.dtype.str, array.shape) for name, array in arrays.items()],
        }
        text = json.dumps(about, default=np.generic.item).encode()
        return b"".join([len(text).to_bytes(LENGTH, "little"), text, *(array.tobytes() for array in arrays.values())])

    def _changing(self, frame: Frame) -> Iterator[tuple[str, NDArray]]:
        yield "position", frame.position
        yield "velocity", frame.velocity
        if isinstance(frame, Moment):
            if frame.spin.any():
                yield "spin", frame.spin
            if frame.torn is not None:
                yield "torn", frame.torn
            return
        for name in FREE:
            if getattr(frame, name) is not getattr(self._first, name):
                yield name, getattr(frame, name)
        if frame.colliders is not self._first.colliders:
            yield "centres", np.array([one.centre for one in frame.colliders])
            yield "rotations", np.array([one.rotation for one in frame.colliders])

    def unpack(self, data: bytes) -> Frame:
        """The frame of a record. Raises ValueError, or what taking apart of something else may raise."""
        begin = LENGTH + int.from_bytes(data[:LENGTH], "little")
        about = json.loads(data[LENGTH:begin])
        arrays = dict(_unpacked(about["arrays"], data, begin))
        first, time = self._first, float(about["time"])
        if not arrays:
            none = np.zeros((0, first.dim))
            frame = Frame(time, none, none, none[:, 0])
        else:
            self._check(arrays)
            frame = self._moment(time, arrays) if self._moments is not None else self._free(time, arrays)
        if about["energy"] is not None:
            energy = tuple(map(float, about["energy"]))
            frame.energy = energy if self._moments is None else Energy(*energy)  # type: ignore[assignment]
        elif not isinstance(frame, Moment):
            frame.energy = None
        frame.contacts = None if about["contacts"] is None else Contacts(*about["contacts"])
        frame.probes = {name: float(value) for name, value in about["probes"].items()}
        return frame

    def _moment(self, time: float, arrays: dict[str, NDArray]) -> Frame:
        assert self._moments is not None
        return self._moments.at(time, arrays["position"], arrays["velocity"], arrays.get("spin"), arrays.get("torn"))

    def _free(self, time: float, arrays: dict[str, NDArray]) -> Frame:
        centres, rotations = arrays.pop("centres", None), arrays.pop("rotations", None)
        given: dict[str, Any] = dict(arrays)
        if centres is not None and rotations is not None:
            placed = zip(self._first.colliders, centres, rotations, strict=True)
            given["colliders"] = tuple(Placed(one.collider, *where) for one, *where in placed)
        return replace(self._first, time=time, **given)

    def _check(self, arrays: dict[str, NDArray]) -> None:
        """Raise ValueError where these cannot be of a frame of the run."""
        shapes = dict.fromkeys(("position", "velocity"), self._first.position.shape)
        if isinstance(self._first, Moment):
            shapes |= {"spin": self._first.spin.shape, "torn": (self._first.scene.n_springs,)}
        for name, array in arrays.items():
            if self._moments is not None and name not in shapes:
                raise ValueError(f"it has {name}")
            if array.shape != shapes.get(name, array.shape) or (array.dtype == bool) != (name in ("torn", "sticks")):
                raise ValueError(f"{name} is {array.dtype} {array.shape}, not {shapes.get(name)}")


def _packed_array(array: NDArray) -> NDArray:
    """The array as one of KINDS: in single precision where that loses nothing, as in a run in single precision."""
    if array.dtype.kind != "f":
        return array.astype("|b1" if array.dtype == bool else "<i4")
    short = array.astype("<f4")
    return short if (short == array).all() else array.astype("<f8")


def _unpacked(listed: Any, data: bytes, begin: int) -> Iterator[tuple[str, NDArray]]:
    for name, kind, shape in listed:
        if kind not in KINDS or not all(isinstance(length, int) and length >= 0 for length in shape):
            raise ValueError(f"{name} is {kind} {shape}")
        array = np.frombuffer(data, kind, prod(shape), begin).reshape(shape)
        begin += array.nbytes
        yield name, array.astype("<f8" if kind == "<f4" else kind)
    if begin != len(data):
        raise ValueError("its length does not fit")


def png_of(image: NDArray[np.uint8]) -> bytes:
    """A picture (height, width, 3 or 4) as a PNG, packed quickly."""
    from PIL import Image

    file = io.BytesIO()
    Image.fromarray(image).save(file, "PNG", compress_level=1)
    return file.getvalue()


def picture_of(png: bytes) -> NDArray[np.uint8]:
    """The picture (height, width, 3 or 4) of a PNG."""
    from PIL import Image

    return np.asarray(Image.open(io.BytesIO(png), formats=("PNG",)))


class PicturePacker:
    """Packs pictures without loss, each as its difference from the one before, those with alpha as PNG."""

    def __init__(self) -> None:
        self._encoder: Any = None

    def pack(self, image: NDArray[np.uint8]) -> bytes:
        """The record of a picture (height, width, 3 or 4)."""
        import av

        if image.shape[2] == 4:
            return png_of(image)
        picture = av.VideoFrame.from_ndarray(image, format="rgb24")
        if self._encoder is None:
            self._encoder = encoder = av.CodecContext.create("libx264rgb", "w")
            encoder.width, encoder.height, encoder.pix_fmt = picture.width, picture.height, "rgb24"
            encoder.time_base, encoder.options = Fraction(1, 60), LOSSLESS
        return b"".join(bytes(packet) for packet in self._encoder.encode(picture))


def unpacked_pictures(records: Iterable[bytes]) -> Iterator[tuple[int, Any]]:
    """Pictures (height, width, 3 or 4) by the numbers of their records, in order; empty records have none."""
    import av

    decoder = av.CodecContext.create("h264", "r")
    decoder.thread_count = 1
    waiting: deque[int] = deque()
    for number, data in enumerate(records):
        if data.startswith(b"\x89PNG"):
            yield number, picture_of(data)
        elif data:
            waiting.append(number)
            for picture in decoder.decode(av.Packet(data)):
                yield waiting.popleft(), picture.to_ndarray(format="rgb24")
    for picture in decoder.decode(None) if waiting else ():
        yield waiting.popleft(), picture.to_ndarray(format="rgb24")
    if waiting:
        raise ValueError(f"picture {waiting[0]} cannot be decoded")
