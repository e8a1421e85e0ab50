"""Subject: what scenes are made of, a scene file, a Python file or a function, and a scene from parameters and a seed."""

import ast
import hashlib
import inspect
import json
import os
import shutil
import tempfile
import weakref
from collections.abc import Callable, Mapping
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np

from taichi_sim.common.errors import SceneError, did_you_mean
from taichi_sim.files.parameters import changing
from taichi_sim.files.source import python_scene, resolve
from taichi_sim.files.toml_document import parsed
from taichi_sim.files.toml_reader import Reader
from taichi_sim.scene.contents import contents_of
from taichi_sim.scene.scene import Scene

__all__ = ["FileSubject", "FunctionSubject", "Subject", "described", "lasting", "subject_of"]

JITTER = 1e-3  # of its radius: how far at most a loose ball is from its place, where nothing else makes use of a seed


class Subject:
    """Makes scenes. It is sent to other processes, which read files anew."""

    name = ""
    seeded = False  # whether a seed means something by itself

    def scene(self, parameters: Mapping[str, Any], seed: int | None = None) -> Scene:
        """The scene of a point. Raises SceneError for what is not allowed. seed: what chance is drawn from; None: what the scene
        says by itself. Where the scene has no chance of its own, 0 is as it is, and any other displaces each loose ball by up to
        a thousandth of its radius."""
        made = self._made(parameters, seed)
        if seed and not self.seeded:
            _jitter(made, seed)
        return made

    def _made(self, parameters: Mapping[str, Any], seed: int | None) -> Scene:
        raise NotImplementedError

    def identity(self) -> str:
        """Changes with all that decides what its scenes are, as far as can be told."""
        raise NotImplementedError


class FileSubject(Subject):
    """A scene file. Parameters are paths in its own words: `materials.rubber.restitution`, `cloth[0].stiffness`, `gravity[1]`,
    `simulation.dt`; a table in a list is meant by its number or its name."""

    def __init__(self, file: Path, allow_outside: bool = False) -> None:
        self.file, self.allow_outside, self.name = file, allow_outside, file.stem
        self.text, self.document = parsed(file)
        piles = self.document.get("pile")
        self.seeded = isinstance(piles, list) and bool(piles)

    def _made(self, parameters: Mapping[str, Any], seed: int | None) -> Scene:
        document = deepcopy(self.document)
        with changing(self.file, document, parameters):
            if seed is not None and self.seeded:
                piles = document["pile"] if isinstance(document["pile"], list) else []
                for pile in piles:
                    if isinstance(pile, dict) and isinstance(pile.get("seed", 0), int):  # else it is refused as it is
                        pile["seed"] = pile.get("seed", 0) + seed
            return Reader(self.file, self.text, document, None, self.allow_outside).scene()

    def identity(self) -> str:
        """Identity by what the file says, comments apart, and by all that it reads: arrays, meshes."""
        try:
            made = contents_of(self._made({}, None))
        except (SceneError, ValueError):  # it lacks what the parameters are
            made = {}
        said = json.dumps([self.document, made], sort_keys=True, default=str)
        return hashlib.sha256(said.encode()).hexdigest()


class FunctionSubject(Subject):
    """A function, or scene() of a Python file. Parameters are its arguments; `seed` among them takes the seed."""

    def __init__(self, function: Callable[..., Scene] | None = None, file: Path | None = None) -> None:
        self.file, self._function = file, function
        self._sources = "" if file is None else sources_of(file)
        made = self.function
        self.name = getattr(made, "__name__", "scene") if file is None else file.stem
        takes = inspect.signature(made).parameters
        self.takes = {key for key, one in takes.items() if one.kind is not one.VAR_KEYWORD}
        self.anything = any(one.kind is one.VAR_KEYWORD for one in takes.values())
        self.seeded = "seed" in takes

    def __getstate__(self) -> dict[str, Any]:
        return vars(self) | ({} if self.file is None else {"_function": None})  # read anew elsewhere

    @property
    def function(self) -> Callable[..., Scene]:
        """Function that makes scenes. Raises SceneError where its file was changed meanwhile."""
        if self._function is None:
            assert self.file is not None
            if sources_of(self.file) != self._sources:
                raise SceneError((), says="was changed while its points ran; run them again", file=self.file)
            self._function = python_scene(self.file)
        return self._function

    def _made(self, parameters: Mapping[str, Any], seed: int | None) -> Scene:
        for name in parameters:
            if name not in self.takes and not self.anything:
                known = sorted(self.takes - {"seed"})
                says = f"is no argument of {self.function.__name__}(); {did_you_mean(name, known)}"
                raise SceneError((name,), says=says, file=self.file)
        given = dict(parameters)
        if self.seeded and seed is not None:
            given["seed"] = seed
        made = self.function(**given)
        if not isinstance(made, Scene):
            raise SceneError(
                (), says=f"{self.function.__name__}() returned {type(made).__name__}; it must return a Scene"
            )
        return made

    def identity(self) -> str:
        if self.file is not None:
            return self._sources
        return f"{described(self.function, 'scene')} {source_of(self.function)}"


def subject_of(what: Any, folder: Path, allow_outside: bool = False) -> Subject:
    """Subject of what a user gives: a name as the commands take it, a function that returns a Scene, or a Scene, whose file
    is written to the folder. Raises SceneError or OSError."""
    if isinstance(what, Scene):
        folder.mkdir(exist_ok=True)
        what.save(folder / "scene.toml")
        return FileSubject(folder / "scene.toml")
    if isinstance(what, (str, os.PathLike)):
        file = resolve(os.fspath(what)).resolve()
        if file.suffix == ".toml":
            return FileSubject(file, allow_outside)
        return FunctionSubject(file=file)
    if callable(what):
        described(what, "scene")
        return FunctionSubject(what)
    raise SceneError("scene", what, "a Scene, a function that returns one, or the name of a file or a demo")


def lasting(scene: Scene) -> Subject:
    """A Scene whose file, and the arrays beside it, which are read with each scene that is made of it, lie in a folder of their
    own for as long as there is the subject."""
    folder = Path(tempfile.mkdtemp(prefix="taichi_sim_scene_"))
    try:
        subject = subject_of(scene, folder)
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    weakref.finalize(subject, shutil.rmtree, folder, ignore_errors=True)
    return subject


def described(function: Callable[..., Any], what: str) -> str:
    """`module:name` of a function that other processes can import. Raises SceneError for one that has no name in a module."""
    name, module = getattr(function, "__qualname__", ""), getattr(function, "__module__", "")
    if not name or "<" in name:
        kind = "a lambda" if "<lambda>" in name else f"{name or function!r}"
        says = f"{kind} has no name in a module, by which other processes could find it; define it at the top of a file"
        raise SceneError(what, says=says)
    return f"{module}:{name}"


def source_of(function: Callable[..., Any]) -> str:
    """A hash of a function's source; "" where there is none."""
    try:
        return hashlib.sha256(inspect.getsource(function).encode()).hexdigest()[:16]
    except (OSError, TypeError):
        return ""


def sources_of(file: Path) -> str:
    """A hash of a Python file and of the modules beside it that it imports, and these import."""
    waiting, met = [file.resolve()], set[Path]()
    while waiting:
        one = waiting.pop()
        if one in met or not one.is_file():
            continue
        met.add(one)
        try:
            tree = ast.parse(one.read_bytes())
        except (SyntaxError, ValueError):  # which is told where it is run
            continue
        for node in ast.walk(tree):
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                names = [node.module] if node.module else [alias.name for alias in node.names]
            else:
                continue
            for name in names:
                place = file.resolve().parent.joinpath(*name.split("."))
                waiting += [place.with_name(f"{place.name}.py"), place / "__init__.py"]
    digest = hashlib.sha256()
    for one in sorted(met):
        digest.update(hashlib.sha256(one.read_bytes()).digest())
    return digest.hexdigest()


def _jitter(scene: Scene, seed: int) -> None:
    """Displace each loose ball a little."""
    loose = scene.loose()
    if not loose.any():
        says = (
            "would all give one result: scene() takes no argument `seed`, and there is neither a pile nor a loose ball"
        )
        raise SceneError("seeds", says=says)
    chance = np.random.default_rng(seed).uniform(-1.0, 1.0, (scene.n_balls, scene.dim))
    scene.set_balls(loose, position=scene.position[loose] + JITTER * scene.radius[loose, None] * chance[loose])
