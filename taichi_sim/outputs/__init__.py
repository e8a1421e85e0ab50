"""Where frames go: one output per file. `open_output` picks one by the ending of a name."""

from os import PathLike, fspath
from pathlib import Path

from taichi_sim.outputs.base import Output
from taichi_sim.outputs.export import Summary, export

__all__ = ["Output", "Summary", "export", "open_output"]


ENDINGS = {".mp4": ("h264", "h265"), ".webm": ("vp9",)}  # of videos, and their codecs, the usual one first
FILES = (*ENDINGS, ".gif", ".npz", ".ply", ".obj")
USE = "use x.mp4, x.webm, x.gif, x.npz, x.ply, x.obj or folder/ for PNG frames"


def open_output(
    path: str | PathLike[str],
    *,
    fps: float = 60.0,
    overwrite: bool = False,
    resume: bool = False,
    codec: str | None = None,
) -> Output:
    """The output for a name: x.mp4 or x.webm a video, x.gif an animation, x.npz arrays, x.ply or x.obj surfaces, a file for each
    frame, a name without an ending PNG frames.

    It is opened at once: ValueError for another ending, OSError where it cannot be written. overwrite is for a folder of frames
    that is not empty; a file is replaced when the new one is complete. resume goes on with a run into the same name that was cut
    off: from its last checkpoint, see `export`, with the frames that are finished. codec: "h264" or "h265" for x.mp4, "vp9" for
    x.webm.
    """
    name = fspath(path)
    suffix = Path(name).suffix.lower()
    if name.endswith(("/", "\\")) or (suffix not in FILES and Path(name).is_dir()):
        suffix = ""
    if resume and overwrite:
        raise ValueError("overwrite and resume exclude each other; give one of them")
    codecs = ENDINGS.get(suffix, ())
    if codec is not None and codec not in codecs:
        allowed = ", ".join(f"{', '.join(known)} for x{ending}" for ending, known in ENDINGS.items())
        raise ValueError(f"codec: {codec!r} is not allowed for {name}; there are {allowed}")
    if codecs:
        from taichi_sim.outputs.video import Video

        return Video(name, fps, codec=codec or codecs[0], resume=resume)
    if suffix == ".gif":
        from taichi_sim.outputs.gif import Gif

        return Gif(name, fps, resume=resume)
    if suffix == ".npz":
        from taichi_sim.outputs.arrays import Arrays

        return Arrays(name, resume=resume)
    if suffix in (".ply", ".obj"):
        from taichi_sim.outputs.geometry import Geometry

        return Geometry(name, resume=resume)
    if suffix == "":
        from taichi_sim.outputs.png import PngFolder

        return PngFolder(name, overwrite=overwrite, resume=resume)
    raise ValueError(f"{name}: {suffix!r} is not allowed; {USE}")
