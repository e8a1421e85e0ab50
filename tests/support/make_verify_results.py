"""Writes what `taichi-sim verify` compares with, by `python tests/support/make_verify_results.py`."""

import json
from pathlib import Path

import taichi_sim
from taichi_sim.reports import verify


def rounded(number):
    return float(f"{number:.9g}")


if __name__ == "__main__":
    stored = {}
    for case in verify.CASES:
        x, energy, exchanged = verify.computed(case, precision="f64", arch="cpu")
        position = [[rounded(number) for number in row] for row in x.tolist()]
        stored[case.name] = {"position": position, "energy": rounded(energy), "exchanged": rounded(exchanged)}
    path = Path(taichi_sim.__file__).parent / "reports" / verify.STORED
    path.write_text(json.dumps(stored, indent=0) + "\n", encoding="utf-8")
