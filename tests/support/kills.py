"""Exports that are killed (-9) at random moments and resumed: what comes out is what an export that nobody disturbed writes.

    python -m tests.support.kills --kills 200 --seed 1

Each run is killed at a moment between its start and its end, then resumed, where one time in three it may finish and otherwise is
killed again. Judged: nothing lies under the final name before the end (files of frames are whole when they appear, and what grows
during the run is whole after each frame);
the finished output has the same bytes; nothing else is left; the last checkpoint is no older than the interval and a little more.
"""

import argparse
import random
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path

NET = """# A net with a weight swings.
format = 1
dim = 3
gravity = [0.0, -10.0, 0.0]
[simulation]
dt = 0.0005
contacts = "off"
arch = "cpu"
precision = "f64"
[[cloth]]
size = [1.0, 1.0]
resolution = [30, 30]
position = [0.0, 1.0, 0.0]
pinned = [0, 29]
[[balls]]
position = [[0.5, 1.5, 0.5]]
radius = 0.1
[output]
camera = {follow = [900]}
"""
HEAP = """# Balls with friction fall into a heap on a floor and a turning bar.
format = 1
dim = 3
gravity = [0.0, -10.0, 0.0]
[simulation]
dt = 0.0001
arch = "cpu"
[[materials]]
name = "rubber"
friction = 0.5
restitution = 0.2
[[walls]]
normal = [0.0, 1.0, 0.0]
offset = 0.0
material = "rubber"
[[colliders]]
shape = "box"
center = [0.3, 0.1, 0.3]
size = [0.8, 0.05, 0.1]
rotation_rate = [0.0, 90.0, 0.0]
[[pile]]
name = "heap"
resolution = [6, 8, 6]
radius = 0.04
position = [0.0, 0.3, 0.0]
material = "rubber"
[output]
camera = {follow = [100]}
"""
LOOKED_AT = """fps = 40
duration = 1.5
size = [96, 64]
[[probes]]
name = "all"
kind = "energy"
"""
SCENES = {"net": NET + LOOKED_AT, "heap": HEAP + LOOKED_AT}
FORMATS = (
    "x.mp4",
    "x.webm",
    "x.gif",
    "x.webp",
    "frames",
    "x.npz",
    "x.obj",
    "x.ply",
    "x.usdc",
    "x.glb",
    "x.pvd",
    "x.gsd",
    "x.csv",
)
INTERVAL = 0.2  # s, between checkpoints, however long they take
LATE = 0.8  # of the kills come when there is a checkpoint of the same run
SLACK = 1.0  # s that a frame, a checkpoint and a busy machine may add
COMMAND = """
import sys
from taichi_sim.outputs import checkpoints
checkpoints.SHARE = 1e9
from taichi_sim.cli.main import main
main(sys.argv[1:])
"""


@dataclass
class Tally:
    """Of one format. lost: the oldest last checkpoint at a kill [s]. wrong: what was not as it should be."""

    kills: int = 0
    finished: int = 0
    resumed: int = 0  # of the finished ones, from a checkpoint
    lost: float = 0.0
    wrong: list[str] = field(default_factory=list)


def start(folder: Path, name: str, *options: str) -> subprocess.Popen[str]:
    """An export of the scene into a folder."""
    words = ("run", str(folder.parent / "scene.toml"), "-o", name, "--checkpoint", str(INTERVAL), *options)
    pipe = subprocess.PIPE
    return subprocess.Popen([sys.executable, "-c", COMMAND, *words], cwd=folder, text=True, stdout=pipe, stderr=pipe)


def files(folder: Path) -> dict[str, bytes]:
    """All that lies in a folder, by its path there."""
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def kept(folder: Path, name: str) -> list[Path]:
    """The files of that name in the log of an unfinished output."""
    return [*folder.glob(f".*.resume/{name}"), *folder.glob(f"*/.resume/{name}")]


def since(folder: Path, begin: float) -> float:
    """When the last checkpoint was made by a run that began then, 0 where it has made none."""
    return max(
        (file.stat().st_mtime for file in kept(folder, "checkpoint.json") if file.stat().st_mtime > begin), default=0.0
    )


def campaign(
    root: Path, formats: tuple[str, ...], kills: int, seed: int, until: float = float("inf"), scene: str = "net"
) -> dict[str, Tally]:
    """Kill so many exports in all, of the formats in turn, or until a time [s] of time.time()."""
    chance = random.Random(seed)
    (root / "scene.toml").write_text(SCENES[scene])
    whole, times = {}, {}
    for name in formats:
        (folder := root / f"whole_{name}").mkdir()
        for _ in range(2):  # the first one compiles
            process, begin, first = (
                start(folder, name, *(["--overwrite"] if name == "frames" else [])),
                time.time(),
                0.0,
            )
            while process.poll() is None:
                first = first or bool(kept(folder, "run.json")) * (time.time() - begin)
                time.sleep(0.005)
            if process.returncode:
                raise RuntimeError(f"{name}: {process.communicate()[1]}")
        whole[name], times[name] = files(folder), (first, time.time() - begin)
    tallies = {name: Tally() for name in formats}
    while (made := sum(tally.kills for tally in tallies.values())) < kills and time.time() < until:
        name = formats[sum(tally.finished for tally in tallies.values()) % len(formats)]
        chain(root, name, whole[name], times[name], chance, tallies[name], kills - made)
    return tallies


def chain(
    root: Path,
    name: str,
    whole: dict[str, bytes],
    times: tuple[float, float],
    chance: random.Random,
    tally: Tally,
    left: int,
) -> None:
    """Kill an export and its resumed runs, at most `left` times, until one of them finishes, and judge it. whole: the right
    files; times: when the first frame was there, and the end [s]."""
    (folder := root / "killed").mkdir()
    options: tuple[str, ...] = ()
    while True:
        process, begin = start(folder, name, *options), time.time()
        if left == 0 or (options and chance.random() < 1 / 3):
            break
        wait = chance.uniform(0.0, times[0])
        if chance.random() < LATE:  # once it makes checkpoints
            while process.poll() is None and not since(folder, begin):
                time.sleep(0.002)
            wait = chance.uniform(0.0, times[1] - times[0])
        try:
            process.wait(wait)
            break  # done before
        except subprocess.TimeoutExpired:
            process.kill()
        now = time.time()
        process.communicate()
        tally.kills, left = tally.kills + 1, left - 1
        if files(folder) == whole:  # it was done, and the process about to end: there is nothing to resume
            tally.finished += 1
            shutil.rmtree(folder)
            return
        if last := since(folder, begin):
            tally.lost = max(tally.lost, now - last)
        partly = {key: data for key, data in files(folder).items() if not key.rpartition("/")[2].startswith(".")}
        partly = {key: data for key, data in partly.items() if ".resume/" not in key}
        if any(not so_far(folder / key, data, whole.get(key, b"")) for key, data in partly.items()):
            tally.wrong.append(f"{name}: something lay under the final name that was not whole")
        options = ("--resume",)
    said, complaint = process.communicate()
    tally.finished += 1
    tally.resumed += "resumed " in said
    if process.returncode:
        tally.wrong.append(f"{name}: status {process.returncode}: {complaint.strip()}")
    found = files(folder)
    if set(found) != set(whole):
        tally.wrong.append(f"{name}: other files: {sorted(set(found) ^ set(whole))[:5]}")
    elif found != whole:
        tally.wrong.append(f"{name}: other bytes in {[key for key in whole if whole[key] != found[key]][:5]}")
    shutil.rmtree(folder)


def so_far(path: Path, data: bytes, whole: bytes) -> bool:
    """Whether a file that a killed run left is whole, or, of one that grows, the beginning of the whole one."""
    if path.suffix == ".csv":
        return data.endswith(b"\n") and whole.startswith(data)
    if path.suffix == ".pvd":
        entries, end, rest = data.partition(b"</Collection>")
        return bool(end) and rest == b"\n</VTKFile>\n" and whole.startswith(entries)
    if path.suffix == ".gsd":
        import gsd.hoomd

        with gsd.hoomd.open(str(path)) as file:
            return [one.configuration.step for one in file] == list(range(len(file))) and len(file) > 0
    return data == whole


def main() -> int:
    """Status 1 where something was wrong."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--formats", nargs="+", default=FORMATS, help="those to try")
    parser.add_argument("--minutes", type=float, default=float("inf"), help="wall time after which no more is begun")
    parser.add_argument("--scene", choices=sorted(SCENES), default="net", help="a net, or a heap with contacts")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        tallies = campaign(
            Path(folder),
            tuple(given.formats),
            given.kills,
            given.seed,
            time.time() + 60 * given.minutes,
            given.scene,
        )
    for name, one in tallies.items():
        print(
            f"{name:8} {one.kills:4} kills, {one.finished:3} finished, {one.resumed:3} of them from a checkpoint,"
            f" {len(one.wrong)} wrong; the oldest last checkpoint {one.lost:.2f} s"
        )
    wrong = [line for one in tallies.values() for line in one.wrong]
    wrong += [f"{name}: {one.lost:.2f} s lost" for name, one in tallies.items() if one.lost > INTERVAL + SLACK]
    print("\n".join(wrong))
    return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main())
