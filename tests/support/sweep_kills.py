"""Sweeps whose workers, or whose command, are killed (-9) at random moments: the table is the one of an undisturbed sweep.

    python -m tests.support.sweep_kills --kills 20 --seed 1

First workers: in each of several sweeps one is killed at a random moment after each five rows or more, so that points come
further than their killers.
Then the command: it is killed at random moments, and the same one run again, until it ends. Judged: every point once, the same
measures to the last bit, no error, the report there, and no file of a batch left over.
"""

import argparse
import csv
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from tests.support.sweep_scenes import heap_file

POINTS = ("--vary", "materials.rubber.restitution=0.1:0.7:25", "--seeds", "4", "--measure", "energy.kinetic.max")
BETWEEN = 5  # rows, from one killed worker to the next
CHANGING = ("wall", "version")  # columns that differ from run to run


def start(folder: Path, name: str, workers: int) -> subprocess.Popen[str]:
    """A sweep of 100 points."""
    command = [sys.executable, "-m", "taichi_sim", "sweep", "heap.toml", *POINTS, "-o", name, "--workers", str(workers)]
    pipe = subprocess.PIPE
    return subprocess.Popen(command, cwd=folder, text=True, stdout=pipe, stderr=pipe)


def workers_of(process: subprocess.Popen[str]) -> list[int]:
    """The processes that it started to run points."""
    found = []
    for task in Path(f"/proc/{process.pid}/task").glob("*/children"):
        found += [int(child) for child in task.read_text().split()]
    return [pid for pid in found if b"spawn_main" in Path(f"/proc/{pid}/cmdline").read_bytes()]


def table(folder: Path) -> list[dict[str, str]]:
    """Rows without what differs from run to run."""
    with open(folder / "table.csv", newline="") as file:
        return [{key: value for key, value in row.items() if key not in CHANGING} for row in csv.DictReader(file)]


def rows_so_far(folder: Path) -> int:
    """Points that are done; 0 where files were joined at this moment."""
    try:
        return sum(
            len(file.read_text().splitlines()) for file in (*folder.glob("batches/*.jsonl"), *folder.glob("rows.jsonl"))
        )
    except FileNotFoundError:
        return 0


def faults(folder: Path, process: subprocess.Popen[str], right: list[dict[str, str]]) -> list[str]:
    """What is not as it should be after the end."""
    _, complaint = process.communicate()
    if process.returncode:
        return [f"status {process.returncode}: {complaint.strip()[-500:]}"]
    found = table(folder)
    left = [file.name for file in (folder / "batches").iterdir()]
    said = (
        [] if found == right else [f"another table: {sum(a != b for a, b in zip(found, right))} of {len(found)} rows"]
    )
    said += [f"left over: {left[:5]}"] if left else []
    return said + ([] if (folder / "report.html").is_file() else ["no report"])


def kill_workers(root: Path, kills: int, chance: random.Random, right: list[dict[str, str]]) -> list[str]:
    """So many workers, one in each of several sweeps or more."""
    wrong, done = [], 0
    while done < kills:
        process, folder = start(root, "swept", 2), root / "swept"
        rows = 0
        while process.poll() is None and done < kills:
            while process.poll() is None and rows_so_far(folder) < rows + BETWEEN:
                time.sleep(0.05)
            time.sleep(chance.uniform(0.0, 3.0))
            if process.poll() is None and (found := workers_of(process)):
                try:
                    signal.pidfd_send_signal(pidfd(chance.choice(found)), signal.SIGKILL)
                except ProcessLookupError:
                    continue
                done += 1
                rows = rows_so_far(folder)
        wrong += faults(folder, process, right)
        print(f"workers: {done} killed, {len(wrong)} wrong", flush=True)
        shutil.rmtree(folder)
    return wrong


def pidfd(pid: int) -> int:
    """Stands for that process, and for no later one of its number."""
    import os

    return os.pidfd_open(pid)


def kill_command(root: Path, kills: int, chance: random.Random, right: list[dict[str, str]]) -> list[str]:
    """So often the command, which is run again until it ends."""
    wrong, done = [], 0
    while done < kills:
        for workers in (0, 2):
            folder = root / "swept"
            while True:
                process = start(root, "swept", workers)
                try:
                    process.wait(chance.uniform(1.0, 12.0) if done < kills else None)
                    break
                except subprocess.TimeoutExpired:
                    process.kill()
                    process.communicate()
                    done += 1
            wrong += faults(folder, process, right)
            print(f"command: {done} killed, {len(wrong)} wrong", flush=True)
            shutil.rmtree(folder)
    return wrong


def main() -> int:
    """Status 1 where something was wrong."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=20, help="of workers, and as many of the command")
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    chance = random.Random(given.seed)
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        (root / "heap.toml").write_text(heap_file(6, 2.0))
        if start(root, "whole", 2).wait():
            raise RuntimeError("the undisturbed sweep failed")
        right = table(root / "whole")
        assert len(right) == 100
        assert not any(row["error"] for row in right)
        wrong = kill_workers(root, given.kills, chance, right) + kill_command(root, given.kills, chance, right)
    for one in wrong:
        print(one)
    return bool(wrong)


if __name__ == "__main__":
    raise SystemExit(main())
