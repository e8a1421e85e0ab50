"""Outputs of frames: one output per file. `open_output` picks one by the ending of a name."""

import os
from collections.abc import Sequence
from importlib import import_module
from os import PathLike, fspath
from pathlib import Path
from typing import Any

from taichi_sim.common.atomic_file import kind_of
from taichi_sim.outputs.base import Output, film_rate
from taichi_sim.outputs.export import export
from taichi_sim.outputs.summary import Summary

__all__ = ["Output", "Summary", "export", "open_output", "open_outputs"]


CODECS = {".mp4": ("h264", "h265"), ".webm": ("vp9",)}  # of videos, the usual one first
OTHERS = {  # the module and the class of each ending
    ".gif": ("gif", "Gif"),
    ".webp": ("gif", "Webp"),
    ".npz": ("arrays", "Arrays"),
    ".usdc": ("usd", "Usd"),
    ".usda": ("usd", "Usd"),
    ".glb": ("gltf", "Gltf"),
    ".pvd": ("paraview", "ParaView"),
    ".gsd": ("trajectory", "Trajectory"),
    ".csv": ("table", "Table"),
    ".ply": ("geometry", "Geometry"),
    ".obj": ("geometry", "Geometry"),
}
USE = f"use {', '.join(f'x{ending}' for ending in (*CODECS, *OTHERS))} or folder/ for PNG frames"


def open_output(
    path: str | PathLike[str],
    *,
    fps: float | None = None,
    overwrite: bool = False,
    resume: bool = False,
    codec: str | None = None,
) -> Output:
    """The output for a name: x.mp4 or x.webm a video, x.gif or x.webp an animation, x.npz arrays, x.usdc or x.usda a USD scene,
    x.glb a glTF scene, x.pvd files for ParaView, x.gsd a trajectory, x.csv a table of energies and probes, x.ply or x.obj a mesh
    for each frame, a name without an ending PNG frames. Where x.csv is a pipe (a FIFO) its rows are written into it. fps [1/s]:
    at which a film, x.npz and a scene are shown; that of `export` by default.

    It is opened at once: ValueError for another ending or where a package that it needs is missing, OSError where it cannot be
    written. overwrite is for a folder of frames that is not empty; a file is replaced when the new one is complete, x.gsd and
    x.csv, which grow during the run, at the first frame. resume goes on with a run into the same name that was cut off: from its
    last checkpoint, see `export`, with the frames that are finished. codec: "h264" or "h265" for x.mp4, "vp9" for x.webm.
    """
    name = fspath(path)
    suffix = Path(name).suffix.lower()
    if name.endswith(("/", "\\")) or (suffix not in (*CODECS, *OTHERS) and Path(name).is_dir()):
        suffix = ""
    if (
        suffix == ""
        and Path(name).name.lower() in (*CODECS, *OTHERS)
        and not (name.endswith("/") or Path(name).is_dir())
    ):
        raise ValueError(f"{name}: is an ending without a name; give x{Path(name).name}")
    if not name:
        raise ValueError("the name of the output is empty; give a file, x.mp4 for instance, or a folder of frames")
    if resume and overwrite:
        raise ValueError("overwrite and resume exclude each other; give one of them")
    codecs = CODECS.get(suffix, ())
    if codec is not None and codec not in codecs:
        allowed = ", ".join(f"{', '.join(known)} for x{ending}" for ending, known in CODECS.items())
        raise ValueError(f"codec: {codec!r} is not allowed for {name}; there are {allowed}")
    films = *CODECS, ".gif", ".webp", ".usdc", ".usda", ".glb"
    rate = film_rate(fps) if fps is not None and suffix in films else fps
    if codecs:
        from taichi_sim.outputs.video import Video

        return Video(name, rate, codec=codec or codecs[0], resume=resume)
    if suffix == "":
        from taichi_sim.outputs.png import PngFolder

        return PngFolder(name, overwrite=overwrite, resume=resume)
    if suffix not in OTHERS:
        raise ValueError(f"{name}: {suffix!r} is not allowed; {USE}")
    if suffix == ".csv" and kind_of(path) == "pipe":
        from taichi_sim.outputs.table import PipedTable

        if resume:
            raise ValueError(f"{name}: is a pipe, which cannot be resumed")
        return PipedTable(path)
    module, kind = OTHERS[suffix]
    timed: dict[str, Any] = {"fps": rate} if suffix in (*films, ".npz") else {}
    made: Output = getattr(import_module(f"taichi_sim.outputs.{module}"), kind)(name, resume=resume, **timed)
    return made


def open_outputs(paths: Sequence[str | PathLike[str]], *, codec: str | None = None, **options: Any) -> list[Output]:
    """Outputs for several names, all or, where one is refused, none; options: of `open_output`. codec is for the videos among
    them. Raises ValueError where two have one name."""
    places = [os.path.realpath(fspath(path)) for path in paths]
    for k, place in enumerate(places):
        if place in places[:k]:
            raise ValueError(f"{fspath(paths[k])}: is given twice; give every output a name of its own")
    videos = [Path(fspath(path)).suffix.lower() in CODECS for path in paths]
    opened: list[Output] = []
    try:
        for path, video in zip(paths, videos):
            opened.append(open_output(path, codec=codec if video or not any(videos) else None, **options))
    except BaseException:
        for output in opened:
            output.discard()
        raise
    return opened
