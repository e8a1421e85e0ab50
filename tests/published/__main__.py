"""Measure the published tests and write docs/published.md.

python -m tests.published            all, in single and in double precision
python -m tests.published pendulum   these alone, in single precision; prints the rows and writes nothing
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict
from pathlib import Path

from taichi_sim.device import backend

from .page import PAGE, modules, page


def measured(names: list[str], precision: str) -> dict[str, list[dict]]:
    """Rows of the tests in this process, as dictionaries with their error; each is printed as it comes."""
    backend.start(arch="cpu", precision=precision)
    found = {}
    for name, module in modules(names).items():
        if precision == "f64" and hasattr(module, "CHAOTIC"):
            continue  # another draw, which says nothing of precision
        began = time.process_time()
        found[name] = [asdict(row) | {"error": row.error} for row in module.measure()]
        print(f"{name} ({precision}, {time.process_time() - began:.1f} s of processor time)", flush=True)
        for row in found[name]:
            print(
                f"  {row['quantity']} [{row['unit']}] {row['settings']}: {row['found']:.6g}, reference {row['reference']:.6g}, "
                f"error {100 * row['error']:+.3g} %, allowed {100 * row['allowed']:.2g} %",
                flush=True,
            )
    return found


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(prog="python -m tests.published", description=__doc__)
    parser.add_argument("names", nargs="*", help="of tests; all by default")
    parser.add_argument("--precision", choices=("f32", "f64"), default="f32")
    parser.add_argument("--json", type=Path, help="write the rows there and leave the page alone")
    chosen = parser.parse_args()
    if chosen.names or chosen.json:
        rows = measured(chosen.names, chosen.precision)
        if chosen.json:
            chosen.json.write_text(json.dumps(rows, default=float))
        return
    both = {}
    with tempfile.TemporaryDirectory() as folder:
        for precision in ("f32", "f64"):  # Taichi has one precision per process
            file = Path(folder) / precision
            subprocess.run([sys.executable, "-m", __package__, "--precision", precision, "--json", file], check=True)
            both[precision] = json.loads(file.read_text())
    PAGE.write_text(page(both))


if __name__ == "__main__":
    main()
