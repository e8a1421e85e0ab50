"""Running cases: many in one simulation, side by side and far apart, for compiling takes longer than running."""

import pickle
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

import taichi_sim as ts
from taichi_sim.analysis import diagnostics
from taichi_sim.analysis.stability import stability
from taichi_sim.common.errors import UnstableError
from taichi_sim.simulation.settings import Settings

from .scenes import Change, changed, merged, walls

__all__ = ["Case", "Record", "auto_dt", "observe"]

TOGETHER = 100  # scenes in one simulation
GROUPS = 28  # of those whose walls differ; 32 groups are the most there can be
WIDE = 64.0  # m, of those in single precision: it rounds places by 1e-7 of that
MOST_BALLS = 1000  # together: more would get fewer passes by default
PLAIN = "plain"


@dataclass(eq=False)
class Case:
    """A scene, what it is run with, for how long [s], and at how many moments it is looked at.

    how: "plain"; "restored": saved and restored half way; "grouped": steps asked for in uneven groups; "single",
    "threads1", "threads2": in a process of its own, in single precision or with so many threads. alone: in no simulation
    with others. weighed: what its colliders receive is summed.
    """

    scene: ts.Scene
    settings: dict[str, Any]
    duration: float
    samples: int = 8
    how: str = PLAIN
    alone: bool = False
    weighed: bool = False

    def key(self) -> tuple:
        """What cases must share to run in one simulation."""
        own = id(self) if self.alone else 0
        said = tuple(sorted((k, str(v)) for k, v in self.settings.items()))
        s = self.scene
        wind = None if s.wind is None else repr(s.wind)
        return (own, s.dim, tuple(s.gravity), wind, said, self.duration, self.samples, self.how, self.weighed)

    def but(self, **settings: Any) -> "Case":
        """The same with other settings."""
        return replace(self, settings={**self.settings, **settings})

    def of(self, scene: ts.Scene) -> "Case":
        """Another scene, run alike."""
        return replace(self, scene=scene)


@dataclass
class Record:
    """What was seen: times (s,) [s], positions and velocities (s, n, dim), angular velocities (s, n, 1 or 3) [1/s]."""

    time: np.ndarray
    x: np.ndarray
    v: np.ndarray
    spin: np.ndarray
    dt: float
    substeps: int
    warnings: list[str] = field(default_factory=list)
    failed: str = ""
    size: float = 0.0  # m, what a tolerance is a part of
    impulse: Any = None  # (s, c, dim) N s that the c colliders have received, where they are weighed

    def energy(self, scene: ts.Scene) -> np.ndarray:
        """Total energy (s,) [J]."""
        return np.array([diagnostics.energy(scene, *now).total for now in zip(self.x, self.v, self.spin)])


def auto_dt(case: Case) -> float:
    """Seconds per step that `dt = "auto"` takes."""
    settings = {k: v for k, v in case.settings.items() if k not in ("dt", "substeps", "tolerance")}
    resolved = Settings.resolve(case.scene, settings)
    dt, parts = resolved.time_step(case.scene, stability(case.scene, resolved.integrator.method))
    return dt / parts


def _reach(case: Case) -> float:
    """Within so many metres of x = 0 all of it stays."""
    scene, T = case.scene, case.duration
    fastest = float(np.linalg.norm(scene.velocity, axis=1).max(initial=0.0))
    g = float(np.linalg.norm(scene.gravity))
    far = float(np.abs(scene.position).max(initial=0.0)) + 3.0 * fastest * T + g * T**2
    for collider in scene.colliders:
        centre = np.abs(collider.motion.positions).max() + np.abs(collider.motion.velocity).max() * T
        far = max(far, float(centre) + collider.extent)
    return far + 4.0 * float(scene.radius.max(initial=0.0))


def observe(cases: Iterable[Case]) -> dict[int, Record]:
    """Records of all cases, by their identity."""
    out: dict[int, Record] = {}
    groups: dict[tuple, list[Case]] = {}
    for case in cases:
        groups.setdefault(case.key(), []).append(case)
    for group in groups.values():
        first, most = 0, TOGETHER if len({walls(case.scene, 1.0) for case in group}) == 1 else GROUPS
        if any(wall.normal[0] for wall in group[0].scene.walls):
            most = GROUPS
        if group[0].how == "single":
            most = min(most, max(1, int(WIDE / _pitch(group))))
        while first < len(group):
            last, balls = first, 0
            while last < len(group) and last - first < most and (last == first or balls < MOST_BALLS):
                balls += group[last].scene.n_balls
                last += 1
            chunk = group[first:last]
            out.update({id(case): record for case, record in zip(chunk, _together(chunk))})
            first = last
    return out


def _pitch(cases: list[Case]) -> float:
    """Metres from scene to scene."""
    return float(2.0 ** np.ceil(np.log2(2.5 * max(_reach(case) for case in cases) + 1e-9)))


def _together(cases: list[Case]) -> list[Record]:
    one = cases[0]
    shifts = [_pitch(cases) * k for k in range(len(cases))]
    everything = one.scene if len(cases) == 1 else merged([case.scene for case in cases], shifts)
    if one.weighed:
        everything = changed(everything, Change())
        for k in range(len(everything.colliders)):
            everything.add_probe(f"c{k}", "impulse", collider=k)
    job = (everything, one.settings, one.duration, one.samples, one.how)
    whole = _elsewhere(*job) if one.how in ("single", "threads1", "threads2") else _run(*job)
    records, start, first = [], 0, 0
    for case, shift in zip(cases, shifts):
        balls = slice(start, start + case.scene.n_balls)
        x = whole.x[:, balls].copy()
        x[..., 0] -= shift
        mine = slice(first, first + len(case.scene.colliders))
        impulse = whole.impulse[:, mine]
        records.append(replace(whole, x=x, v=whole.v[:, balls], spin=whole.spin[:, balls], impulse=impulse))
        start, first = balls.stop, mine.stop
    return records


def _run(scene: ts.Scene, settings: dict[str, Any], duration: float, samples: int, how: str) -> Record:
    """One simulation. What ends as unstable is recorded up to there."""
    given = {"arch": "cpu", "precision": "f64", **settings}
    seen: list[tuple] = []
    failed = ""
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        try:
            sim = ts.Simulation(scene, **given)
        except ValueError as refused:  # "finds no safe step", "cannot be met": it says so, which is right
            n, dim = scene.n_balls, scene.dim
            none = np.zeros((0, n, dim))
            said_so = f"refused: {refused}"
            return Record(np.zeros(0), none, none, np.zeros((0, n, 1)), 0.0, 1, [], said_so, impulse=none)
        dt, substeps = sim.dt, sim.substeps
        n = max(1, round(duration / dt))
        marks = np.unique(np.round(np.linspace(0, n, samples + 1)).astype(int))
        rng = np.random.default_rng(n)
        try:
            done = 0
            for mark in marks:
                if how == "restored" and mark > n // 2 and done <= n // 2:
                    sim = _restored(sim)
                while done < mark:
                    k = mark - done if how != "grouped" else int(rng.integers(1, min(7, mark - done) + 1))
                    sim.step(int(k))
                    done += k
                now = sim.snapshot()
                spin = np.asarray(now.surface_speed) / scene.radius[:, None]
                seen.append((now.time, now.position, now.velocity, spin, now.impulses))
        except UnstableError as error:
            failed = str(error)
        found = sim.error()
        sim.close()
    time, x, v, spin, impulse = (np.array(column) for column in zip(*seen))
    texts = [str(w.message) for w in said]
    return Record(time, x, v, spin, dt, substeps, texts, failed, 0.0 if found is None else found.size, impulse)


def _restored(sim: ts.Simulation) -> ts.Simulation:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "state.npz"
        sim.save(file)
        sim.close()
        return ts.Simulation.restore(file, arch="cpu")


def _elsewhere(scene: ts.Scene, settings: dict[str, Any], duration: float, samples: int, how: str) -> Record:
    """In a process of its own: Taichi holds one precision and one number of threads per process."""
    other = {"single": {"precision": "f32"}, "threads1": {"threads": 1}, "threads2": {"threads": 2}}[how]
    with tempfile.TemporaryDirectory() as folder:
        job, result = Path(folder) / "scene.toml", Path(folder) / "record.pickle"
        scene.save(job)
        about = {"settings": {**settings, **other}, "duration": duration, "samples": samples}
        (Path(folder) / "about.pickle").write_bytes(pickle.dumps(about))
        code = f"from {__package__}.observe import child; child({str(folder)!r})"
        path = [str(Path(__file__).parents[2]), str(Path(__file__).parents[1])]
        lines = f"import sys; sys.path[:0] = {path!r}; {code}"
        subprocess.run([sys.executable, "-c", lines], check=True, cwd=path[0])
        return pickle.loads(result.read_bytes())


def child(folder: str) -> None:
    """What such a process does."""
    about = pickle.loads((Path(folder) / "about.pickle").read_bytes())
    scene = ts.load_scene(Path(folder) / "scene.toml")
    record = _run(scene, about["settings"], about["duration"], about["samples"], PLAIN)
    (Path(folder) / "record.pickle").write_bytes(pickle.dumps(record))
