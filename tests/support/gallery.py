"""The loops of docs/gallery.md. `make gallery` makes those that are not there; delete what is to be made anew."""

import subprocess
import sys
from pathlib import Path

FOLDER = Path(__file__).parents[2] / "docs" / "gallery"
LOOPS = ("eel", "jelly", "drum", "car", "stairs", "squeeze", "wrecking", "tower", "cloth", "pudding", "silk", "octopus")
OPTIONS = ("--fps", "20", "--duration", "2.95", "--size", "480x270")
MOST_BYTES, MOST_IN_ALL = 700_000, 6_000_000  # so that the repository stays small


def command(name: str) -> list[str]:
    """What makes a loop, behind `taichi-sim`."""
    return ["run", name, "-o", f"{name}.webp", *OPTIONS]


if __name__ == "__main__":
    for name in LOOPS:
        if not (FOLDER / f"{name}.webp").exists():
            subprocess.run([sys.executable, "-m", "taichi_sim", *command(name)], cwd=FOLDER, check=True)
