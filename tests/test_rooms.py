"""The shape of the program: which room imports which, the public names, and the length of files."""

import ast
import inspect
from pathlib import Path

import pytest

import taichi_sim as ts

ROOT = Path(__file__).resolve().parent.parent
PACKAGE, KERNELS = ROOT / "taichi_sim", ROOT / "kernels"
FILES = sorted([*PACKAGE.rglob("*.py"), *KERNELS.rglob("*.py")])

# from the outermost room to the innermost; a file imports from its own level or from further in
LEVELS = (
    ("cli", "demos"),
    ("reports",),
    ("outputs",),
    ("simulation", "state_file", "render"),
    ("controlled",),
    ("stepper",),
    ("collider_checks", "cautions"),
    ("assembly", "settings"),
    ("drivers",),
    ("companion",),
    ("integrators",),
    ("gauge",),
    ("contacts", "forces", "pins"),
    ("moment",),
    ("accuracy", "contact_needs", "outcome", "slow_modes"),
    ("damping", "diagnostics", "stability", "order", "watch", "crossings"),
    ("element_rates",),
    ("state",),
    ("model",),
    ("fields", "backend"),
    ("front_end",),
    ("scene_file", "scene_save", "scene_source", "scene_lines", "scene_schema"),
    ("shapes", "rates"),
    ("shape_parts",),
    ("fabric", "solids"),
    ("scene", "frame"),
    ("scene_elements", "materials"),
    ("colliders",),
    ("level_set",),
    ("mesh", "motion", "skins", "tables", "camera_path", "readings"),
    ("probes",),
    ("checks", "files", "interrupts", "memory", "groups", "options"),
    ("errors",),
    ("kernels",),
)
LEVEL = {name: k for k, names in enumerate(LEVELS) for name in names}
# settings names integrators, base knows the solver and the forces; no Taichi in the scene's rooms
NO_TAICHI = (
    "scene",
    "scene_elements",
    "materials",
    "shapes",
    "shape_parts",
    "fabric",
    "solids",
    "rates",
    "mesh",
    "motion",
    "colliders",
    "collider_checks",
    "cautions",
    "errors",
    "checks",
    "frame",
    "files",
    "stability",
    "damping",
    "accuracy",
    "contact_needs",
    "outcome",
    "slow_modes",
    "element_rates",
    "watch",
    "diagnostics",
    "crossings",
    "order",
    "interrupts",
    "memory",
    "groups",
    "skins",
    "tables",
    "camera_path",
    "probes",
    "readings",
)


def room(path):
    if KERNELS in path.parents:
        return "kernels"
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


def imports(path):
    """(module, deferred) of every import; deferred: inside a function or under TYPE_CHECKING."""
    tree = ast.parse(path.read_text())
    top = {id(node) for node in tree.body} | {
        id(inner) for node in tree.body if isinstance(node, ast.Try) for inner in node.body
    }
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield alias.name, id(node) not in top
        elif isinstance(node, ast.ImportFrom):
            if node.level:
                here = (
                    "taichi_sim.kernels"
                    if room(path) == "kernels"
                    else ".".join(("taichi_sim", *path.relative_to(PACKAGE).parts[:-1]))
                )
                yield f"{here}.{node.module}" if node.module else here, id(node) not in top
            elif node.module == "taichi_sim":
                for alias in node.names:
                    yield f"taichi_sim.{alias.name}", id(node) not in top
            else:
                yield str(node.module), id(node) not in top


def target(module):
    """The room a module of the package lies in, or None for one that is not ours."""
    parts = module.split(".")
    return parts[1] if parts[0] == "taichi_sim" and len(parts) > 1 else None


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(ROOT)))
def test_imports_run_one_way(path):
    here = room(path)
    if here in ("__init__", "__main__"):
        return
    assert here in LEVEL, f"{here}: a new room; give it a level in {Path(__file__).name}"
    for module, deferred in imports(path):
        there = target(module)
        if there is None or there not in LEVEL or deferred:
            continue
        assert LEVEL[there] >= LEVEL[here], f"{here} imports {module}, which lies further out"


@pytest.mark.parametrize("path", sorted(KERNELS.rglob("*.py")), ids=lambda p: p.name)
def test_kernels_import_only_taichi_and_each_other(path):
    for module, _ in imports(path):
        assert (
            module.split(".")[0] == "taichi" or module.startswith("taichi_sim.kernels") or module in ("math", "typing")
        ), module


@pytest.mark.parametrize(
    "path", [p for p in FILES if room(p) in NO_TAICHI or room(p).startswith("scene")], ids=lambda p: p.name
)
def test_scene_rooms_know_no_taichi(path):
    for module, _ in imports(path):
        assert module.split(".")[0] != "taichi", module
        assert target(module) not in ("kernels", "backend", "model", "state", "fields", "simulation", "drivers"), module


def test_only_the_backend_starts_taichi():
    for path in FILES:
        calls = [n for n in ast.walk(ast.parse(path.read_text())) if isinstance(n, ast.Call)]
        starts = [
            c
            for c in calls
            if isinstance(c.func, ast.Attribute) and c.func.attr == "init" and getattr(c.func.value, "id", "") == "ti"
        ]
        assert not starts or room(path) == "backend", path.name


@pytest.mark.parametrize(
    "path", [*FILES, *sorted((ROOT / "tests").rglob("*.py"))], ids=lambda p: str(p.relative_to(ROOT))
)
def test_no_file_over_400_lines(path):
    assert len(path.read_text().splitlines()) <= 400


def test_files_with_kernels_do_not_postpone_annotations():
    """`from __future__ import annotations` breaks Taichi kernels."""
    for path in FILES:
        if any(m.split(".")[0] == "taichi" for m, _ in imports(path)):
            assert not any(m == "__future__" for m, _ in imports(path)), path.name


# Public names ---------------------------------------------------------------------------------------------------------


def test_public_names():
    for name in (
        "Scene",
        "Simulation",
        "SceneError",
        "UnstableError",
        "BackendError",
        "shapes",
        "load_scene",
        "__version__",
    ):
        assert hasattr(ts, name), name
    assert set(dir(ts)) >= {"Scene", "shapes"}
    assert issubclass(ts.SceneError, ValueError)
    with pytest.raises(AttributeError, match="nonsense"):
        _ = ts.nonsense


SIMULATION = """step run time position velocity energy momentum angular_momentum frames stability save restore dt substeps
kernels close apply_impulse set_dt set_position set_velocity __enter__ __exit__"""


@pytest.mark.parametrize("name", SIMULATION.split())
def test_simulation_has(name):
    with ts.Simulation(ts.Scene(dim=2)) as sim:
        assert hasattr(sim, name)


@pytest.mark.parametrize(
    "name", ["add_material", "add_balls", "add_springs", "add_wall", "add_collider", "add_skin", "add_probe", "save"]
)
def test_scene_has(name):
    assert callable(getattr(ts.Scene, name))


def test_arguments_of_simulation():
    from taichi_sim.settings import DEFAULTS

    wanted = "integrator dt precision arch contacts contact_passes accumulate driver spin threads substeps"
    assert set(DEFAULTS) >= set(wanted.split())
    assert "forces" in inspect.signature(ts.Simulation).parameters


def test_shapes():
    for name in ("cloth", "jelly", "rope", "wheel", "pile", "truss", "net", "balloon", "tower"):
        assert callable(getattr(ts.shapes, name)), name


def test_names_and_types_of_results():
    scene = ts.Scene(dim=2)
    b = scene.add_balls([[0, 0], [1, 0]], radius=0.1)
    assert b.shape == (2,)
    assert scene.add_springs([b], stiffness=1.0).shape == (1,)
    with ts.Simulation(scene) as sim:
        assert sim.energy()._fields == ("kinetic", "spring", "gravity", "total")
        assert sim.stability()._fields == ("dt_any_shape", "dt_present", "spring", "ball", "reason")
        frame = sim.frame()
        for name in ("time", "position", "velocity", "radius", "springs", "triangles", "colour", "strain"):
            assert hasattr(frame, name), name
    assert (PACKAGE / "py.typed").exists()
