"""Observer: what a run notes of its frames, and of the simulation at its end."""

from typing import Any

import numpy as np

from taichi_sim.analysis import contact_loads, late_impacts, turning
from taichi_sim.analysis.coarse_meshes import beyond_bricks
from taichi_sim.analysis.diagnostics import inverted
from taichi_sim.analysis.frame import Contacts, Frame
from taichi_sim.analysis.probe_readings import units_of
from taichi_sim.outputs.summary import Summary
from taichi_sim.scene.objects import ball_in_words

__all__ = ["Observer"]

WATCHED_CELLS = 200_000  # in each frame; more are counted at the end alone
WATCHED_TRIANGLES = 10_000  # half a second, at the end


class Observer:
    """Notes in a summary what a simulation and its frames say."""

    def __init__(self, simulation: Any, summary: Summary) -> None:
        self.simulation, self.summary = simulation, summary
        # of a run that is resumed, up to the checkpoint: the simulation was made anew
        self._searches = 0 if summary.contacts is None else summary.contacts.searches

    def note(self, frame: Frame) -> None:
        """Give the present frame what the simulation says of contacts and probes, and note it."""
        sim, scene, summary = self.simulation, self.simulation.scene, self.summary
        frame.contacts, frame.probes = contacts, probes = sim.contacts(), sim.probes()
        contacts = contacts._replace(searches=self._searches + contacts.searches)
        summary.frames += 1
        if scene.n_volumes() <= WATCHED_CELLS:
            self._count_inverted(inverted(scene, frame.position, frame.torn_springs))
        if contacts.iterations:
            self._note_contacts(frame, contacts)
        if contacts.number:
            h = sim.dt / contacts.substeps
            summary.late = max(summary.late, (late_impacts.late_share(scene, frame.velocity, h, sim.setup.at_touch), h))
        for name, value in probes.items():
            _, least, most = summary.probes.get(name, (value, value, value))
            # a mean has none at first
            summary.probes[name] = (value, float(np.fmin(least, value)), float(np.fmax(most, value)))
        if summary.frames == 1 and frame.energy is not None:  # of the first and the last: it takes long
            summary.energy_start = tuple(frame.energy)

    def _note_contacts(self, frame: Frame, now: Contacts) -> None:
        summary = self.summary
        summary.contacts = now
        summary.most_contacts = max(summary.most_contacts, now.number)
        if now.number:
            summary.unsolved.append(now.unsolved)
        if now.largest_speed > summary.largest_speed:
            ball = int(np.argmax(np.linalg.norm(frame.velocity, axis=1)))
            summary.fastest = f"{ball_in_words(frame.objects, ball)} at {frame.time:.4g} s"
        for name in ("penetration", "relative_penetration", "residual", "largest_speed"):
            setattr(summary, name, max(getattr(summary, name), getattr(now, name)))

    def _count_inverted(self, now: int) -> None:
        self.summary.inverted = now, max(self.summary.inverted[1], now)
        self.summary.cells = self.simulation.scene.n_volumes()

    def conclude(self, last: Frame | None) -> None:
        """Note the end of the simulation. last: the frame there."""
        sim, scene, summary = self.simulation, self.simulation.scene, self.summary
        summary.units = units_of(scene)
        summary.settled = str(getattr(sim, "settled", None) or summary.settled)
        summary.device, summary.decisions = str(sim.backend), sim.decisions()
        if sim.torn is not None:
            summary.torn = int(np.count_nonzero(sim.torn)), int(np.isfinite(scene.break_strain).sum())
        summary.beyond = ["; ".join(one) for one in beyond_bricks(scene)]
        if scene.n_volumes():
            self._count_inverted(sim.inverted())
        if scene.dim == 3 and not scene.solid.all():
            summary.crossings = sim.crossings() if len(scene.triangles) <= WATCHED_TRIANGLES else None
        if last is not None and last.energy is not None:
            summary.energy_end = tuple(last.energy)
        summary.error, summary.solver, summary.scales = sim.error(), sim.solver(), sim.scales()
        summary.rotation = self._rotation(last)
        summary.contact_load = self._contact_load() if summary.unsolved else ""
        summary.momentum = tuple(np.atleast_1d(sim.momentum()).tolist())

    def _rotation(self, last: Frame | None) -> str:
        """Loss of angular momentum by the method, at the start or at the end, whichever is more; empty where it does not show."""
        sim, scene = self.simulation, self.simulation.scene
        method, h = sim.settings.integrator.method, sim.dt / sim.substeps
        if method.turning_loss(1.0, h) == 0.0:
            return ""
        states = [(scene.position, scene.velocity)] + ([] if last is None else [(last.position, last.velocity)])
        turns = [turn for state in states if (turn := turning.fastest_turn(scene, *state, method, h)) is not None]
        turn = max(turns, key=lambda one: one.speed, default=None)
        if turn is None or not turn.shows(method, h):
            return ""
        return f"{turning.sentence(turn, method, h, sim.time or 1.0)}; {turning.cure(turn, method, h)}"

    def _contact_load(self) -> str:
        """Load that elements at contacts bear too much by the method; empty where it does not show."""
        sim = self.simulation
        method, h = sim.settings.integrator.method, sim.dt / sim.substeps
        excess = contact_loads.at_contacts(sim.scene, method, h)
        if excess is None or not excess.shows(method, h):
            return ""
        return f"{contact_loads.sentence(excess, method, h)}; {contact_loads.cure(excess, method, h)}"
