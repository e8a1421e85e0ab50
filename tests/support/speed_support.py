"""What the tests of `report` and `tune` share: a scene with a closed solution, and made-up runs that need no process."""

import numpy as np

import taichi_sim as ts
from taichi_sim.analysis.methods import named
from taichi_sim.reports.speed_error.plan import PARTS, Plan
from taichi_sim.reports.speed_error.trial_process import Outcome

STIFFNESS, STRETCH = 100.0, 0.1
RATE = np.sqrt(2 * STIFFNESS)  # 1/s, of two balls of 1 kg
ORDER = {
    "verlet": 2,
    "symplectic_euler": 1,
    "rk4": 4,
    "explicit_euler": 1,
    "xpbd": 1,
    "implicit_euler": 1,
    "tr_bdf2": 2,
}


def pair():
    """Two balls on a stretched spring: its length is 1 + STRETCH cos(RATE t)."""
    scene = ts.Scene(dim=2)
    balls = scene.add_balls([(0, 0), (1 + STRETCH, 0)], radius=0.05)
    scene.add_springs([balls], stiffness=STIFFNESS, rest_length=1.0)
    return scene


def length(times):
    return 1 + STRETCH * np.cos(RATE * times)


def plan(**other):
    given = {"name": "pair", "duration": 0.4, "methods": ("verlet", "symplectic_euler"), "precisions": ("f64",)}
    return Plan(**{**given, **other})


class MadeUp:
    """Stands for TrialProcesses: the pair's solution with an error of (h RATE)^order, and a cost of 1 ms a step (RK4 4 ms).

    grows: how many times a difference at the start is larger at each part. fail: after so many runs comes a Ctrl-C. moves [m]:
    amplitude of its motion, which its error is a part of. path: (PARTS,) how far it has gone at each part, of that.
    """

    def __init__(self, scene, *, grows=1.0, fail=None, cost=None, moves=0.1, path=None):
        self.scene, self.grows, self.fail, self.trials = scene, grows, fail, []
        self.moves, self.path = moves, np.sin(np.arange(1, PARTS + 1)) if path is None else path
        self.cost = cost or {}

    def __enter__(self):
        return self

    def __exit__(self, *error):
        pass

    def run(self, precision, trial):
        if self.fail is not None and len(self.trials) == self.fail:
            raise KeyboardInterrupt
        self.trials.append((precision, trial))
        start = self.scene.position if trial.start is None else trial.start
        position, energy, quantity = [], [], []
        probe = self.scene.probes[0].given if self.scene.probes else {}
        spring, place = probe.get("spring") == 0, probe.get("balls")
        for k in range(1, PARTS + 1):
            x = start + self.grows**k * (start - self.scene.position)
            off = (trial.step.seconds * RATE) ** ORDER[trial.method]
            x[:, 0] += self.moves * (self.path[k - 1] + off / 0.1)
            position.append(x)
            energy.append((0.5, 0.5, 0.0, 1.0))
            if spring:  # its tension, of the place of ball 0: what MadeUp says of lengths does not change
                quantity.append(np.array([STIFFNESS * (x[0, 0] - start[0, 0])]))
            elif place is not None:  # along the first axis
                quantity.append(x[place].mean(axis=0)[:1])
        cost = self.cost.get((precision, trial.method), 4e-3 if trial.method == "rk4" else 1e-3)
        seconds = cost * trial.step.number * PARTS
        if seconds > trial.most:
            return Outcome("made up", [], [], [], left_out="too long")
        contacts = [(0, 0.0)] * PARTS
        begin = None if place is None else start[place].mean(axis=0)[:1]
        passes = float(named(trial.method).passes(self.scene, trial.step.seconds) * trial.step.number * PARTS)
        return Outcome("made up", position, energy, contacts, seconds, passes=passes, quantity=quantity, begin=begin)
