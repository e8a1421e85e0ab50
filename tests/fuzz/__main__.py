"""Thousands of scene files, state files and meshes, each read or refused in one sentence.

`python -m tests.fuzz --cases 10000` prints a line for each place in the program that broke, with the shortest file that breaks
it. It exits with 1 if there are any.
"""

import argparse
import resource
import sys
import tempfile
import time
import traceback
from collections import Counter
from pathlib import Path

from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st

from taichi_sim.common.errors import SceneError

from . import mesh_files, scene_files, state_files

MOST_SECONDS, MOST_BYTES = 10.0, 4 << 30


class Found:
    """What became of the cases, and the shortest of those that broke something, by where that was."""

    def __init__(self, folder):
        self.folder, self.counts, self.faults, self.slowest = folder, Counter(), {}, 0.0

    def take(self, kind, judge, case):
        """Judge one case."""
        start = time.perf_counter()
        try:
            judge(self.folder, case)
            outcome = "read"
        except SceneError as error:
            outcome = "refused"
            if not (error.file or error.path) or "\n" in str(error) or not error.says:
                self.fault(kind, f"without a place: {error}", case)
        except MemoryError as error:
            outcome = "memory"
            self.fault(kind, f"more than {MOST_BYTES >> 30} GB: {_where(error)}", case)
        except Exception as error:
            outcome = "broke"
            self.fault(kind, f"{type(error).__name__} {_where(error)}: {str(error)[:200]}", case)
        took = time.perf_counter() - start
        self.slowest = max(self.slowest, took)
        if took > MOST_SECONDS:
            self.fault(kind, f"{took:.0f} s", case)
        self.counts[kind, outcome] += 1

    def fault(self, kind, what, case):
        """Keep the shortest case of each."""
        key = f"{kind}: {what.splitlines()[0]}"
        if key not in self.faults or len(repr(case)) < len(repr(self.faults[key])):
            self.faults[key] = case


def _where(error):
    entries = traceback.extract_tb(error.__traceback__)
    last = ([entry for entry in entries if "taichi_sim" in entry.filename] or entries)[-1]
    return f"{Path(last.filename).name}:{last.lineno} {last.name}"


def main():
    """The command line; 1 where something broke."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("--cases", type=int, default=10_000, help="of all kinds together (10000)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--kind", choices=["scenes", "states", "meshes"], action="append")
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        scene_files.prepare(folder)
        kinds = {"scenes": (scene_files, 0.5), "states": (state_files, 0.25), "meshes": (mesh_files, 0.25)}
        kinds = {key: value for key, value in kinds.items() if not chosen.kind or key in chosen.kind}
        whole = state_files.whole(folder) if "states" in kinds else None
        used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (used + MOST_BYTES, resource.RLIM_INFINITY))
        found = Found(folder)
        for kind, (module, share) in kinds.items():
            strategy = module.cases(*whole) if kind == "states" else module.cases
            run(
                found,
                kind,
                strategy,
                module.judge,
                round(chosen.cases * share / sum(s for _, s in kinds.values())),
                chosen.seed,
            )
            print(kind, {outcome: n for (k, outcome), n in found.counts.items() if k == kind}, flush=True)
        for what, case in sorted(found.faults.items()):
            print(f"\n{what}\n{_shown(case)}")
        print(f"\n{found.counts.total()} cases, {len(found.faults)} faults, the slowest took {found.slowest:.1f} s")
        return 1 if found.faults else 0


def run(found, kind, strategy, judge, cases, number):
    """So many cases of one kind."""

    @seed(number)
    @settings(
        max_examples=cases,
        deadline=None,
        database=None,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    @given(strategy | st.nothing())
    def each(case):
        found.take(kind, judge, case)

    each()


def _shown(case):
    text = case.decode(errors="replace") if isinstance(case, bytes) else repr(case)
    return text if len(text) < 3000 else text[:3000] + " ..."


if __name__ == "__main__":
    sys.exit(main())
