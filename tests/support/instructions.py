"""LLVM instructions of the kernels that a scene compiles, exact on any machine: time grows faster than their number.

    TAICHI_SIM_PRECISION=f32 python -m tests.support.instructions [SCENE ...]

Each scene is compiled in a process of its own, with an empty cache, whose files are then read.
"""

import os
import re
import subprocess
import sys
import tempfile
import warnings
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

SPACES = re.compile(rb"^  [^ ;]")  # an instruction, and no case of a switch
NAME = re.compile(rb"^define [^@]*@\"?(\w+?)_c\d+_\d+_kernel_\d+")
STEPS = ("fused", "prime")  # kernels that move balls on one thread


def count(folder: Path) -> Counter[str]:
    """Instructions by the name of the kernel, of all that were stored in a cache."""
    found: Counter[str] = Counter()
    for file in folder.rglob("*.tic"):
        name, instructions, inside = "?", 0, False
        for line in file.read_bytes().split(b"\n"):
            if line.startswith(b"define "):
                inside = True
                named = NAME.match(line)
                name = named[1].decode() if named else name
            elif line.startswith(b"}"):
                inside = False
            elif inside and SPACES.match(line):
                instructions += 1
        found[name] += instructions
    return found


def _cloth(**more):
    import taichi_sim as ts

    scene = ts.Scene(dim=3, gravity=(0.0, -10.0, 0.0))
    ts.shapes.cloth(
        scene, size=(1.0, 1.0), resolution=(16, 16), mass=0.2, stiffness=300.0, bending_stiffness=1.0, damping=0.03,
        pinned="left", position=(0, 1, 0), **more,
    )  # fmt: skip
    scene.add_wall((0, 1, 0), offset=-0.3)
    return scene


def _demo(name):
    from importlib import import_module

    return import_module(f"taichi_sim.demos.{name}").scene()


def _box():
    import taichi_sim as ts

    return ts.load_scene("demos/box.toml")


def _discs():
    from taichi_sim.benchmark.runs import discs

    return discs(0)


def _bricks():
    import taichi_sim as ts

    scene = ts.Scene(dim=3, gravity=(0.0, -10.0, 0.0))
    ts.shapes.jelly(
        scene, (0.8, 0.2, 0.2), (9, 3, 3), young_modulus=1e5, poisson_ratio=0.4, density=1000.0, pinned="left"
    )
    return scene


SCENES: dict[str, Callable[[], tuple[Any, dict[str, Any]]]] = {
    "jelly": lambda: (_demo("jelly"), {"driver": "fused"}),
    "surfaces": lambda: (_cloth(surface_collision=True), {}),
    "box": lambda: (_box(), {}),
    "discs": lambda: (_discs(), {}),
    "cloth": lambda: (_cloth(), {"driver": "fused"}),
    "implicit": lambda: (_cloth(), {"integrator": "implicit_euler", "dt": 4e-3}),
    "bricks": lambda: (_bricks(), {"integrator": "implicit_euler", "dt": 4e-3, "driver": "fused"}),
    "rk4": lambda: (_discs(), {"integrator": "rk4"}),
}


def run(name: str, steps: int = 20) -> None:
    """Compile the kernels of a scene in this process, by some steps and a look at the positions."""
    import taichi_sim as ts

    scene, settings = SCENES[name]()
    warnings.simplefilter("ignore")
    precision = os.environ.get("TAICHI_SIM_PRECISION", "f32")
    with ts.Simulation(scene, arch="cpu", precision=precision, **settings) as sim:
        sim.step(steps)
        assert len(sim.position) == scene.n_balls


def counted(name: str) -> Counter[str]:
    """Instructions of a scene's kernels, from a process with an empty cache."""
    with tempfile.TemporaryDirectory() as folder:
        own = {**os.environ, "TI_OFFLINE_CACHE_FILE_PATH": folder}
        subprocess.run([sys.executable, "-m", __spec__.name, "--run", name], check=True, env=own)
        return count(Path(folder))


if __name__ == "__main__":
    if sys.argv[1:2] == ["--run"]:
        run(sys.argv[2])
    else:
        for scene in sys.argv[1:] or SCENES:
            found = counted(scene)
            steps = ", ".join(f"{name} {found[name]}" for name in STEPS)
            print(f"{scene}: {steps}; all {found.total()} in {len(found)} kinds of kernel", flush=True)
