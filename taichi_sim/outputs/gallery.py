"""A video of each of many scenes, one after another, each in a process of its own."""

import subprocess
from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import Any

from taichi_sim.common.own_modules import own_command
from taichi_sim.outputs.base import require_folder_place


def render_all(names: Sequence[str], folder: str | PathLike[str], *, quiet: bool = False, **options: Any) -> int:
    """Run `taichi-sim run NAME -o folder/NAME.mp4` for every name whose video is not there yet.

    The folder is made; its parent is not. options: of `run`, by name; None is left out. Ends at the first scene that fails, with
    its exit status, else with 0. What was interrupted is resumed.
    """
    root = Path(folder)
    require_folder_place(root)
    root.mkdir(exist_ok=True)
    given = [word for key, value in options.items() if value is not None for word in (f"--{key}", str(value))]
    for number, name in enumerate(names, start=1):
        target = root / f"{name.replace('/', '_')}.mp4"
        if target.exists():
            continue
        if not quiet:
            print(f"{number} of {len(names)}: {name}", flush=True)
        command = own_command("run", name, "-o", str(target), "--resume", *given)
        status = subprocess.run([*command, *(["--quiet"] if quiet else [])], check=False).returncode
        if status:
            return status
    return 0
