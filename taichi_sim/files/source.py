"""Sources that a user may name as a SCENE: a TOML file, a Python file with scene() or simulation(), or a built-in demo."""

import ast
import functools
import importlib.util
import shutil
import sys
import traceback
from collections.abc import Callable, Iterator, Mapping
from importlib import resources
from pathlib import Path
from types import ModuleType
from typing import Any

from taichi_sim.analysis.probe_readings import units_of
from taichi_sim.common.atomic_file import not_there
from taichi_sim.common.errors import BackendError, SceneError, UnstableError, about, did_you_mean, unknown_key, words_of
from taichi_sim.common.plain import plain
from taichi_sim.scene.camera_path import CameraPath, require_depth
from taichi_sim.scene.looks import Look, Subjects
from taichi_sim.scene.overlay import Overlay
from taichi_sim.scene.scene import Scene

__all__ = [
    "built_in",
    "checked_output",
    "copy_demo",
    "demos",
    "open_scene",
    "open_simulation",
    "python_scene",
    "resolve",
    "run_as_module",
]


def demos() -> dict[str, Path]:
    """The built-in scenes by name, sorted: `jelly`, `thread/springs`, ..."""
    root = Path(str(resources.files("taichi_sim.demos")))
    files = [f for f in root.rglob("*") if f.suffix in (".toml", ".py") and not f.name.startswith(("_", "."))]
    return {f.relative_to(root).with_suffix("").as_posix(): f for f in sorted(files)}


def _demos_by_any_name() -> dict[str, Path]:
    """The demos by their names, and by the last parts of these."""
    return {key.rsplit("/", 1)[-1]: file for key, file in reversed(demos().items())} | demos()


def built_in(file: Path) -> str:
    """Description of a demo, from its own file: its leading comment, or the first line of its docstring."""
    text = file.read_text(encoding="utf-8")
    if file.suffix == ".py":
        return ((ast.get_docstring(ast.parse(text)) or "").splitlines() or [""])[0]
    first = text.lstrip().split("\n", 1)[0]
    return first.lstrip("# ") if first.startswith("#") else ""


def resolve(name: str) -> Path:
    """The file that a SCENE argument means. Raises FileNotFoundError with the closest demo's name."""
    if Path(name).is_file():
        return Path(name)
    known = _demos_by_any_name()
    if name in known:
        return known[name]
    if Path(name).suffix in (".toml", ".py"):
        raise not_there(name)
    hint = did_you_mean(name, known, "`taichi-sim demos` lists the demos")
    raise FileNotFoundError(f"{name}: is neither a file nor a built-in demo; {hint}")


def copy_demo(name: str) -> list[Path]:
    """Copy the file of a demo, and arrays beside it, into the present folder; the paths written. Raises OSError for a name that
    is no demo or a file that is there already."""
    known = _demos_by_any_name()
    if name not in known:
        raise FileNotFoundError(f"{name}: is no demo; {did_you_mean(name, known, '`taichi-sim demos` lists them')}")
    file = known[name]
    sources = [file, *sorted(file.parent.glob(f"{file.stem}_*.npz"))]
    targets = [Path(one.name) for one in sources]
    for target in targets:
        if target.exists() or target.is_symlink():
            raise FileExistsError(f"{target}: exists already; remove it or go to another folder")
    for one, target in zip(sources, targets):
        shutil.copyfile(one, target)
    return targets


def open_scene(file: Path, *, allow_outside: bool = False, parameters: Mapping[str, Any] | None = None) -> Scene | None:
    """The scene in a file; None for a Python file that makes its own simulation(). allow_outside: see `load_scene`. parameters:
    values by their paths, over those in the file; for scene() of a Python file its arguments, or paths in what it returns."""
    parameters = parameters or {}
    if file.suffix == ".toml":
        from taichi_sim.files.parameters import changed_scene
        from taichi_sim.files.toml_reader import load_scene

        return (
            changed_scene(file, parameters, allow_outside)
            if parameters
            else load_scene(file, allow_outside=allow_outside)
        )
    if file.suffix != ".py":
        raise ValueError(f"{file}: {file.suffix!r} is not allowed; a scene is a .toml or a .py file")
    module = _module(file)
    if hasattr(module, "scene"):
        from taichi_sim.files.parameters import python_scene_with

        return python_scene_with(file, python_scene(file), parameters)
    if hasattr(module, "simulation"):
        return None
    raise SceneError((), says="has neither scene() nor simulation(); define one of them", file=file)


def checked_output(scene: Scene) -> dict[str, Any]:
    """`Scene.output` as a scene in Python set it, its keys and values judged as those of [output] in a scene file are.
    NumPy's numbers and arrays, and paths, are plain values here: what is returned can be written to any file."""
    if not scene.output:
        return {}
    try:
        output = plain(scene.output)
    except RecursionError:
        raise SceneError("scene.output", says="has lists or tables within each other, too deep") from None
    from pydantic import ValidationError

    from taichi_sim.files.toml_schema import what_is_allowed
    from taichi_sim.files.toml_settings import Output

    listed: dict[str, Any] = {key: tuple(value) if isinstance(value, list) else value for key, value in output.items()}
    try:
        Output.model_validate(listed)
    except ValidationError as error:
        first = error.errors()[0]
        path = ("scene", "output", *first["loc"])
        if first["type"] == "extra_forbidden":
            raise unknown_key(path, Output.model_fields) from None
        if first["type"] == "missing":  # of a list that is too short
            missing = [one["loc"][-1] for one in error.errors() if one["loc"][:-1] == first["loc"][:-1]]
            raise SceneError(path[:-1], list(first["input"]), f"a list of {int(missing[-1]) + 1}") from None
        raise SceneError(path, first["input"], what_is_allowed(first)) from None
    if listed.get("camera") is not None:
        with about("scene.output.camera"):
            CameraPath.of(listed["camera"], scene.dim, scene.n_balls)
    if listed.get("looks") is not None:
        with about("scene.output.looks"):
            Look.listed(listed["looks"], Subjects.of_scene(scene), read=False)
    with about("scene.output.aperture"):
        require_depth(listed.get("aperture", 0.0), scene.dim)
    if listed.get("overlay") is not None:
        with about("scene.output.overlay"):
            Overlay.of(listed["overlay"], scene.dim, units_of(scene))
    return listed


def open_simulation(file: Path, parameters: Mapping[str, Any] | None = None) -> Any:
    """Simulation that simulation() of a Python file returns. parameters: its arguments."""
    return _call(file, _module(file), "simulation", **(parameters or {}))


def _module(file: Path) -> ModuleType:
    """The file, run as a module of its own name, once; its folder can be imported from, as with `python file.py`."""
    if str(file.resolve().parent) != sys.path[0]:
        sys.path.insert(0, str(file.resolve().parent))
    try:
        return run_as_module(file, f"taichi_sim_scene_{file.stem}")
    except Exception as error:
        raise _located(file, error) from error


def run_as_module(file: Path, name: str) -> ModuleType:
    """A Python file, run as the module of that name where it is not yet. Raises SceneError for another kind of file, and what
    the file raises."""
    place = str(file.resolve())
    if name in sys.modules and getattr(sys.modules[name], "__file__", None) == place:
        return sys.modules[name]
    specification = importlib.util.spec_from_file_location(name, place)
    if specification is None or specification.loader is None:
        raise SceneError((), says="cannot be read as Python", file=file)
    module = importlib.util.module_from_spec(specification)
    sys.modules[name] = module  # Taichi looks up the source of kernels through it
    try:
        specification.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
    return module


def python_scene(file: Path) -> Callable[..., Scene]:
    """scene() of a Python file, with its arguments; its errors name their place. Raises SceneError where there is none."""
    module = _module(file)
    if not callable(getattr(module, "scene", None)):
        raise SceneError((), says="has no function scene(); define one", file=file)

    @functools.wraps(module.scene)
    def scene(**arguments: Any) -> Scene:
        made = _call(file, module, "scene", **arguments)
        if not isinstance(made, Scene):
            raise SceneError((), says=f"scene() returned {type(made).__name__}; it must return a Scene", file=file)
        return made

    return scene


def _call(file: Path, module: ModuleType, function: str, **arguments: Any) -> Any:
    try:
        return getattr(module, function)(**arguments)
    except Exception as error:
        raise _located(file, error) from error


def _located(file: Path, error: Exception) -> Exception:
    """An error from a user's Python file as one line with the place in that file; its kind decides the exit status."""
    if isinstance(error, (BackendError, UnstableError)):
        return error
    lines = list(_lines(error, file.resolve()))
    if isinstance(error, SyntaxError) and error.lineno:
        lines.append(error.lineno)
    says = str(error) if isinstance(error, SceneError) else words_of(error)
    return SceneError((), says=says, file=file, line=lines[-1] if lines else None)


def _lines(error: Exception, file: Path) -> Iterator[int]:
    for entry in traceback.extract_tb(error.__traceback__):
        if Path(entry.filename) == file and entry.lineno:
            yield entry.lineno
