"""Finer meshes of a scene file: every block, sheet and rope of a material with half and a quarter of the spacing.

A grid of n balls along an axis gets 2 n - 1, so that each ball of the coarse mesh is one of the finer ones, where it can be
compared. Balls that the file names go with it; between two that are pinned or led, new ones are pinned or led as well.
"""

import copy
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.analysis.coarse_meshes import ropes
from taichi_sim.analysis.touching import further_overlap
from taichi_sim.common.errors import SceneError
from taichi_sim.files.parameters import put
from taichi_sim.files.toml_document import parsed
from taichi_sim.files.toml_reader import Reader
from taichi_sim.files.toml_schema import SHAPES
from taichi_sim.reports.speed_error.command import settled_scene
from taichi_sim.scene.pins import is_described
from taichi_sim.scene.scene import Scene

LEVELS = 2  # halvings of the spacing
# what makes a shape the same at every resolution
MATERIAL = {
    "cloth": (
        *("mass_per_area", "stretch_stiffness", "shear_stiffness", "bending_rigidity", "bending_weft"),
        *("warp", "young_modulus"),  # of triangles
    ),
    "jelly": ("young_modulus", "density", "poisson_ratio"),
    "rope": (),  # is of a material anyhow, unless it is a CHAIN
}
CHAIN = ("stiffness", "bending_stiffness")  # of each spring or piece: with them it is no material
BY_HAND = (
    "cells",
    "bricks",
    "solids",
    "bending",
    "gases",
    "triangles",
    "embedded_surfaces",
)  # of balls that a finer mesh does not have
Ints = NDArray[np.int64]


@dataclass(frozen=True)
class Finer:
    """A scene with a finer mesh; balls: (n,) where each of the coarse one's balls is in it; overlap: words on what touches in
    it at the start, but not in the coarse one, so that it is another scene, else empty."""

    scene: Scene
    balls: Ints
    overlap: str = ""


def finer(file: Path, levels: int = LEVELS, parameters: Mapping[str, Any] | None = None) -> list[Finer]:
    """The scene of a file, with other values by their paths, with 1/2, 1/4, ... of its spacing. Raises SceneError where nothing,
    or not all, can be refined."""
    document = _document(file, parameters)
    given = _read(file, document)[0]
    found: list[Finer] = []
    balls: Ints | None = None
    for _ in range(levels):
        level = _Level(file, document)
        document = level.refined()
        scene = _read(file, document)[0]
        balls = level.everywhere if balls is None else level.everywhere[balls]
        overlap = further_overlap(given, scene)
        found.append(Finer(settled_scene(scene)[0] if scene.settings.get("settle") else scene, balls, overlap))
    return found


def advice(file: Path, parameters: Mapping[str, Any] | None = None) -> Iterator[str]:
    """A line on the command that estimates the error of a scene's mesh; none where it would refuse."""
    try:
        _Level(file, _document(file, parameters)).refined()
    except SceneError:
        return
    yield f"{'':12} `taichi-sim report {file} --resolutions` estimates the error of the mesh"


def _document(file: Path, parameters: Mapping[str, Any] | None) -> dict[str, Any]:
    if file.suffix != ".toml":
        raise SceneError(
            f"--resolutions: {file} is Python, whose shapes have one resolution; a scene file's can be refined"
        )
    _, document = parsed(file)
    for path, value in (parameters or {}).items():
        put(document, path, value)
    for name in BY_HAND:
        if name in document:
            raise SceneError(f"--resolutions: {file}: [[{name}]] names balls by hand, which a finer mesh does not have")
    return document


def _read(file: Path, document: dict[str, Any]) -> tuple[Scene, dict[str, NDArray[np.int32]]]:
    reader = Reader(
        file, "", document, allow_outside=True
    )  # which files it may name was judged as the coarse one was read
    return reader.scene(), reader.groups


class _Level:
    """One halving. here: for each table of balls or shape, its balls in the finer one by those of the coarse."""

    def __init__(self, file: Path, document: dict[str, Any]) -> None:
        self.file, self.document = file, copy.deepcopy(document)
        self.document.get("output", {}).pop("camera", None)
        self.named: dict[str, tuple[Ints, tuple[int, ...] | None]] = {}  # map of each group, and its grid where refined
        named = copy.deepcopy(self.document)
        tables = [(kind, k) for kind in ("balls", *SHAPES) for k in range(len(named.get(kind, [])))]
        for kind, k in tables:
            named[kind][k].setdefault("name", f"{kind}[{k}]")
        self.coarse, groups = _read(file, named)
        parts, first, refined = [], 0, 0
        for kind, k in tables:
            table = self.document[kind][k]
            number = len(groups[named[kind][k]["name"]])
            grid = self._grid(kind, k, table) if kind in MATERIAL and "mesh" not in table else None
            refined += grid is not None
            inside = np.arange(number) if grid is None else _nested(grid)
            self.named[named[kind][k]["name"]] = (inside, grid)
            if grid is not None:
                if kind == "rope":
                    table["n"] = 2 * grid[0] - 1
                else:
                    table["resolution"] = [2 * n - 1 for n in grid]
                if isinstance(table.get("pinned"), list) and all(type(ball) is int for ball in table["pinned"]):
                    table["pinned"] = _filled(grid, table["pinned"])
                if kind == "jelly" and "damping" in table and self.coarse.dim == 3:
                    table["damping"] /= 2.0  # of springs that are half as stiff
            parts.append(first + inside)
            first += number if grid is None else int(np.prod([2 * n - 1 for n in grid]))
        if not refined:
            raise SceneError(
                f"--resolutions: {file}: has nothing to refine: a rope, or a cloth or jelly of a material with a resolution"
            )
        self.everywhere = np.concatenate(parts)

    def _grid(self, kind: str, k: int, table: dict[str, Any]) -> tuple[int, ...]:
        """Balls along each axis. Raises SceneError for springs that are no material, which another mesh makes another body."""
        chain = next((key for key in CHAIN if key in table), None) if kind == "rope" else None
        if chain is not None:
            raise SceneError(
                f"--resolutions: {self.file}: rope[{k}].{chain}: is of each piece, and more pieces make another rope;"
                " give EA or EI"
            )
        if MATERIAL[kind] and not any(key in table for key in MATERIAL[kind]) and not self._is_preset(kind, table):
            raise SceneError(
                f"--resolutions: {self.file}: {kind}[{k}]: is another body at another resolution; give it"
                f" {' or '.join(MATERIAL[kind])}, which make it of a material"
            )
        if isinstance(table.get("pinned"), list) and any(type(ball) is bool for ball in table["pinned"]):
            raise SceneError(f"--resolutions: {self.file}: {kind}[{k}].pinned: name the pinned balls by their numbers")
        if kind == "rope":
            return (table.get("n", 32),)
        default = {"cloth": (32, 32), "jelly": (8,) * self.coarse.dim}[kind]
        return tuple(table.get("resolution", default))

    def _is_preset(self, kind: str, table: dict[str, Any]) -> bool:
        """True if the material by its name makes the shape of a material."""
        preset = self.coarse.preset(table.get("material", ""))
        known = any(getattr(preset, key, None) is not None for key in MATERIAL[kind])
        return known and not any(key in table for key in CHAIN)

    def refined(self) -> dict[str, Any]:
        """The document of the finer scene."""
        document = self.document
        for table in document.get("attachments", []):
            for side in ("one", "other"):
                self._move(table, side, f"{side}_members", fill=False)
        for table in document.get("moving_pins", []):
            self._move(table, "balls", "members", fill=True)
        for k, table in enumerate(document.get("motors", [])):
            if "balls" not in table:
                raise SceneError(
                    f"--resolutions: {self.file}: motors[{k}]: say by `balls` which springs it drives; numbers are others"
                )
            self._move(table, "balls", "members", fill=True)
        for k, table in enumerate(document.get("springs", [])):
            if "file" in table:
                raise SceneError(
                    f"--resolutions: {self.file}: springs[{k}].file: name the balls in the scene file itself"
                )
            inside = self.named[table["balls"]][0] if "balls" in table else self.everywhere
            table["pairs"] = inside[np.array(table["pairs"])].tolist()
        probes = document.pop("probes", [])
        if probes:
            self.fine_pairs = _read(self.file, document)[0].pairs
            more = len(self.fine_pairs) - self.coarse.n_springs
            own = sum(len(np.atleast_2d(t["pairs"])) for t in document.get("springs", [])) + sum(
                len(t["one_members"] if "one_members" in t else t["one"]) for t in document.get("attachments", [])
            )
            for k, table in enumerate(probes):
                self._probe(k, table, self.coarse.n_springs - own, more)
            document["probes"] = probes
        return document

    def _move(self, table: dict[str, Any], key: str, members: str, *, fill: bool) -> None:
        """The balls that a table names, where they are now."""
        if not isinstance(table.get(key), str):
            if key in table:
                table[key] = self.everywhere[table[key]].tolist()
            return
        inside, grid = self.named[table[key]]
        if members in table and is_described(table[members]):  # the same words in any mesh
            return
        if members in table:
            chosen = table[members]
            table[members] = _filled(grid, chosen) if fill and grid is not None else inside[chosen].tolist()
        elif grid is not None and not fill:
            table[members] = inside.tolist()

    def _probe(self, k: int, table: dict[str, Any], of_shapes: int, more: int) -> None:
        kind = table["kind"]
        one = kind in ("length", "tension")
        springs = [self.coarse.probes[k].given["spring"]] if one else table.get("springs", [])
        moved = [self._pieces(spring) if spring < of_shapes else [spring + more] for spring in springs]
        if not all(moved) or (kind == "length" and springs[0] < of_shapes):
            raise SceneError(
                f"--resolutions: {self.file}: probes[{k}]: the springs of a shape are others in a finer mesh; measure a position,"
                " the tension of a rope, or the strain between balls"
            )
        if one:
            table.pop("at", None)
            table["spring"] = self._outer(springs[0], moved[0])
        if "springs" in table:
            table["springs"] = [spring for some in moved for spring in some]
        if kind == "position" and "at" in table:
            table.pop("at")
            table["balls"] = self.coarse.probes[k].given["balls"].tolist()
        self._move(table, "balls", "members", fill=kind != "position")

    def _pieces(self, spring: int) -> list[int]:
        """The two pieces of a rope that a piece of the coarse one is in the finer one; none where it is of no rope."""
        if not any(self.coarse.pairs[spring, 0] in one.balls for one in ropes(self.coarse)):
            return []
        first, last = self.everywhere[self.coarse.pairs[spring]]
        return [
            int(np.flatnonzero((self.fine_pairs == (ball, ball + 1)).all(axis=1))[0]) for ball in range(first, last)
        ]

    def _outer(self, spring: int, pieces: list[int]) -> int:
        """That of the pieces which is at the end of its rope where the coarse one is, else the first."""
        last = self.coarse.pairs[spring, 1]
        return pieces[-1 if any(one.balls[-1] == last for one in ropes(self.coarse)) else 0]


def _nested(grid: tuple[int, ...]) -> Ints:
    """Each ball of a grid in the finer one."""
    places = np.unravel_index(np.arange(int(np.prod(grid))), grid)
    return np.ravel_multi_index([2 * place for place in places], [2 * n - 1 for n in grid])


def _filled(grid: tuple[int, ...], balls: list[int]) -> list[int]:
    """Balls of a grid in the finer one, and the new balls between those of them that are neighbours."""
    chosen = np.zeros(grid, dtype=bool)
    chosen.ravel()[balls] = True
    for axis in range(len(grid)):
        n = chosen.shape[axis]
        here = np.moveaxis(chosen, axis, 0)
        there = np.zeros((2 * n - 1, *here.shape[1:]), dtype=bool)
        there[::2] = here
        there[1::2] = here[1:] & here[:-1]
        chosen = np.moveaxis(there, 0, axis)
    return np.flatnonzero(chosen.ravel()).tolist()
