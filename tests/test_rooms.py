"""The house: which room imports which, and what stays public."""

import ast
from functools import cache
from pathlib import Path

import pytest

import taichi_sim as ts

pytestmark = pytest.mark.once

ROOT = Path(__file__).resolve().parent.parent
# From the outermost room to the innermost: a file imports from its own room and from those after it, at its top or inside a
# function. The second part knows nothing of Taichi.
WITH_TAICHI = (
    "cli", "benchmark", "sweeps", "reports", "studies", "viewer", "outputs", "overlays", "render", "simulation", "integrators",
    "contacts", "forces", "kernels", "device",
)  # fmt: skip
WITHOUT_TAICHI = ("files", "analysis", "shapes", "scene", "geometry", "common")
ROOMS = WITH_TAICHI + WITHOUT_TAICHI
FLOOR = {room: floor for floor, room in enumerate(ROOMS)}
LOOSE = {"__init__", "__main__"}  # of taichi_sim; they may import from every room
ENGINE = "taichi_sim.device.engine"  # the one place that imports Taichi


def modules():
    """Dotted name and path of every module of the package."""
    for folder in ("taichi_sim", "kernels"):
        for path in sorted((ROOT / folder).rglob("*.py")):
            parts = path.relative_to(ROOT).with_suffix("").parts
            parts = parts if parts[0] == "taichi_sim" else ("taichi_sim", *parts)
            yield ".".join(parts[:-1] if parts[-1] == "__init__" else parts), path


MODULES = dict(modules())


def room(module):
    """The room of a module, or of a file that lies loose its name."""
    parts = module.split(".")
    return parts[1] if len(parts) > 1 else "__init__"


@cache
def imports(module):
    """All modules that one imports, whether at its top or inside a function; names from a package count as its modules."""
    found = set()
    for node in ast.walk(ast.parse(MODULES[module].read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert not node.level, f"{module}: a relative import"
            names = [f"{node.module}.{alias.name}" for alias in node.names]
            found |= {name if name in MODULES else node.module for name in names}
    return found


def test_every_module_has_a_room():
    assert {room(module) for module in MODULES} == {*ROOMS, *LOOSE}


def test_imports_run_one_way():
    for module in MODULES:
        for other in imports(module) if room(module) in ROOMS else ():
            if other.split(".")[0] == "taichi_sim" and other != "taichi_sim":
                assert FLOOR[room(other)] >= FLOOR[room(module)], f"{module} imports {other}, which lies further out"


def test_no_circles():
    unseen, path = {m: {i for i in imports(m) if i in MODULES and i != m} for m in MODULES}, []

    def visit(module):
        assert module not in path, " -> ".join([*path[path.index(module) :], module])
        if module in unseen:
            path.append(module)
            for other in sorted(unseen[module]):
                visit(other)
            del unseen[path.pop()]

    for module in MODULES:
        visit(module)


def test_taichi_comes_through_the_engine():
    for module in MODULES:
        own = {name.split(".")[0] for name in imports(module)}
        assert "taichi" not in own or room(module) == "device", module
        if room(module) in WITHOUT_TAICHI:
            assert ENGINE not in imports(module), module


STANDARD = {"collections", "dataclasses", "math", "typing"}  # what kernels may use of Python's library


def test_kernels_know_only_the_engine():
    for module in MODULES:
        if room(module) == "kernels":
            for other in imports(module):
                top = other.split(".")[0]
                assert other == ENGINE or other.startswith("taichi_sim.kernels") or top in STANDARD, module


def test_files_with_kernels_do_not_postpone_annotations():
    """`from __future__ import annotations` breaks Taichi kernels."""
    for module in MODULES:
        if ENGINE in imports(module):
            assert "__future__" not in imports(module), module


def test_what_is_public():
    assert issubclass(ts.SceneError, ValueError)
    assert all(hasattr(ts, name) for name in ts.__all__)
    with pytest.raises(AttributeError, match="nonsense"):
        _ = ts.nonsense
    assert (ROOT / "taichi_sim" / "py.typed").exists()
