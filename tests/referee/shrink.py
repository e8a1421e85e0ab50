"""The smallest scene that still fails: what can go, goes, as long as the relation fails; and the scene as TOML."""

import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import taichi_sim as ts

from .observe import Case
from .run import judge
from .scenes import Change, changed, components, part

__all__ = ["shrink", "toml"]

MOST = 24  # ways tried at once; they run side by side in one simulation
ROUNDED = ("position", "velocity", "mass", "radius", "stiffness", "damping", "rest_length", "bulk_modulus")


def toml(case: Case) -> str:
    """The scene file of a case: its settings, and for how long it runs."""
    scene = changed(case.scene, Change())
    scene.settings, scene.output = dict(case.settings), {"duration": case.duration}
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "scene.toml"
        scene.save(file)
        return file.read_text()


def shrink(
    case: Case, relation: str, seconds: float = 300.0, show: Callable[[str], None] = lambda _: None
) -> tuple[Case, float]:
    """The shortest case found within so many seconds that still fails, and its figure; the figure of the case itself first,
    alone: what fails only beside others is said to by a figure of 0."""
    start = time.perf_counter()
    finding = judge([case], [relation])[0][0]
    figure = finding.figure or 0.0
    if not finding.fails:
        return case, 0.0
    size = len(toml(case))
    while time.perf_counter() - start < seconds:
        tries = [one for one in _smaller(case) if len(toml(one)) < size][: 6 if case.alone else MOST]
        if not tries:
            break
        found = [finding[0] for finding in judge(tries, [relation])]
        failing = [(len(toml(one)), k) for k, (one, f) in enumerate(zip(tries, found)) if f.fails]
        if not failing:
            break
        size, best = min(failing)
        case, figure = tries[best], float(found[best].figure or 0.0)
        show(f"  {case.scene.n_balls} balls, {size} characters, {figure:.2g}")
    return case, figure


def _smaller(case: Case) -> Iterator[Case]:
    """Cases that lack something, the largest pieces first."""
    scene = case.scene
    things = components(scene)
    everything = np.arange(scene.n_balls)
    if len(things) > 1:
        for k in (2, 4):
            for piece in np.array_split(np.arange(len(things)), k):
                kept = np.concatenate(
                    [things[i] for i in np.setdiff1d(np.arange(len(things)), piece)] or [everything[:0]]
                )
                if 0 < len(kept) < len(everything):
                    yield case.of(part(scene, np.sort(kept)))
        if len(things) <= MOST:
            for thing in things:
                yield case.of(part(scene, np.setdiff1d(everything, thing)))
    yield from _plainer(case)
    if scene.n_balls <= 12 and scene.n_springs and not scene.gases:
        for ball in everything:
            yield case.of(part(scene, np.setdiff1d(everything, [ball])))


def _plainer(case: Case) -> Iterator[Case]:
    def edited(change: Callable[[ts.Scene], None]) -> Case:
        copy = changed(case.scene, Change())
        change(copy)
        return case.of(copy)

    scene = case.scene
    for name, things in (("walls", scene.walls), ("colliders", scene.colliders)):
        for k in range(len(things)):
            yield edited(lambda s, name=name, k=k: getattr(s, name).pop(k))
    if scene.wind is not None:
        yield edited(lambda s: setattr(s, "wind", None))
    if scene.gravity.any():
        yield edited(lambda s: setattr(s, "gravity", np.zeros(s.dim)))
    for law in ("friction", "restitution", "viscous_friction"):
        if any(getattr(m, law) for m in scene.materials):
            yield edited(
                lambda s, law=law: s.materials.__setitem__(slice(None), [replace(m, **{law: 0.0}) for m in s.materials])
            )
    for digits in (1, 2, 3):
        yield edited(lambda s, digits=digits: _round(s, digits))
        for name in ROUNDED:
            yield edited(lambda s, digits=digits, name=name: _round(s, digits, (name,)))
    for name in ("mass", "radius", "stiffness", "damping"):
        column = getattr(scene, name)
        if len(column) and np.ptp(column):
            yield edited(
                lambda s, name=name: _set(s, name, np.full(len(getattr(s, name)), np.median(getattr(s, name))))
            )


def _round(scene: ts.Scene, digits: int, names: tuple[str, ...] = ROUNDED) -> None:
    for name in names:
        column = getattr(scene, name)
        size = np.where(column == 0, 1.0, np.abs(column))
        unit = 10.0 ** (np.floor(np.log10(size)) - digits + 1)
        if name in ("position", "velocity"):  # one unit for all, or what touches comes apart the more
            unit = 10.0 ** (np.floor(np.log10(max(float(np.abs(column).max(initial=0.0)), 1e-12))) - digits)
        rounded = np.round(column / unit) * unit
        flat = column.ndim == 1
        _set(scene, name, [float(f"{value:.10g}") for value in rounded.ravel()] if flat else np.round(rounded, 12))


def _set(scene: ts.Scene, name: str, values: Any) -> None:
    """Give a column of balls, springs or cells other values."""
    if name == "bulk_modulus":
        scene.tables["cells"].replace(slice(None), bulk_modulus=values)
        return
    change = scene.set_springs if name in ("stiffness", "damping", "rest_length", "break_strain") else scene.set_balls
    change(**{name: values})
