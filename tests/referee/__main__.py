"""Random scenes, judged by relations that hold without a reference.

python -m tests.referee --scenes 2000 --seed 1 --shrink --family sled --json found.json

With --json the file is written after every batch; started again with the same file, seed and program the run goes on where
it was ended.
"""

import argparse
import hashlib
import json
import sys
from pathlib import Path

from taichi_sim.common.atomic_file import replacing

from .families import FAMILIES
from .run import Tally, redrawn, referee, table
from .shrink import shrink, toml


def main() -> int:
    """The command line; 1 where a relation fails."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.referee", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--scenes", type=int, default=200, help="about how many (200)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--family", action="append", choices=list(FAMILIES), help="these alone; all by default")
    parser.add_argument(
        "--shrink", action="store_true", help="shrink the worst scene of each failing relation, as TOML"
    )
    parser.add_argument("--seconds", type=float, default=300.0, help="the most for shrinking one (300)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="keep the table there, and go on with it")
    parser.add_argument("--list", action="store_true", help="families and their relations")
    chosen = parser.parse_args()
    names = chosen.family or list(FAMILIES)
    if chosen.list:
        for name in names:
            print(f"{name:20s} {', '.join(FAMILIES[name].relations)}")
        return 0
    about = {"seed": chosen.seed, "families": names, "code": _code()}
    tallies, batch, done = _begin(chosen.json, about)

    def keep(tallies: dict[tuple[str, str], Tally], batch: int, done: int) -> None:
        if chosen.json:
            rows = [tally.plain() for tally in tallies.values()]
            text = json.dumps({**about, "batch": batch, "scenes": done, "rows": rows}, indent=1)
            with replacing(chosen.json) as file:
                file.write(text.encode())

    found = referee([FAMILIES[name] for name in names], chosen.scenes, chosen.seed, tallies, batch, done, _say, keep)
    print(table(found))
    if chosen.shrink:
        for tally in found:
            if tally.worst_at is not None and tally.failures:
                if tally.worst_case is None:  # of an earlier run: drawn again
                    tally.worst_case = redrawn(FAMILIES[tally.family], chosen.seed, *tally.worst_at)
                _say(f"\n{tally.family}: {tally.relation}")
                case, figure = shrink(tally.worst_case, tally.relation, chosen.seconds, _say)
                if figure == 0.0:
                    _say("fails only beside other scenes; the scene as it was drawn:")
                else:
                    _say(f"{figure:.3g}, where {tally.tolerance:g} is allowed:")
                print(toml(case))
    return int(any(t.failures for t in found))


def _say(line: str) -> None:
    print(line, flush=True)


def _code() -> str:
    """A number for all that is judged and judges."""
    root, found = Path(__file__).parents[2], hashlib.sha256()
    for folder in ("kernels", "taichi_sim", "tests/referee"):
        for path in sorted((root / folder).rglob("*.py")):
            found.update(path.read_bytes())
    return found.hexdigest()[:16]


def _begin(file: Path | None, about: dict) -> tuple[dict[tuple[str, str], Tally], int, int]:
    """What an earlier run with the same seed, families and program left; nothing where the program is another one by now."""
    if file is None or not file.exists():
        return {}, 0, 0
    try:
        kept = json.loads(file.read_text())
        code, same = kept["code"] == about["code"], all(kept[key] == about[key] for key in ("seed", "families"))
    except (ValueError, KeyError, TypeError):
        raise SystemExit(f"{file}: is no table of the referee; give another file, or delete it") from None
    if not same:
        raise SystemExit(f"{file}: is of another seed or other families; give another file")
    if not code:
        _say(f"{file}: is of another state of the program; begun anew")
        return {}, 0, 0
    rows = [Tally(**row) for row in kept["rows"]]
    return {(row.family, row.relation): row for row in rows}, kept["batch"], kept["scenes"]


if __name__ == "__main__":
    sys.exit(main())
