"""Player: what can be done with a simulation that is watched, in a window or in a browser. It draws nothing."""

import math
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from taichi_sim.analysis.frame import Frame
from taichi_sim.forces.pointer import MOST_RATE_STEP, POINTER_RATE, Pointer
from taichi_sim.viewer.pace import Pace

__all__ = ["COMMANDS", "Command", "Player", "Rows"]

MESSAGE_TIME = 3.0  # s that a message stays

Rows = tuple[tuple[str, str], ...]  # names and what they are


class Player:
    """Lets the time of a simulation pass, stand or go step by step, returns it to its start, and drags its balls.

    The thread of the simulation calls its functions. pointer: one of the forces of the simulation; of one that is not, no ball
    can be dragged. fps [1/s]: pictures that are wanted; until [s]: simulated time that ends it, or None.
    """

    def __init__(self, simulation: Any, pointer: Pointer, fps: float, until: float | None) -> None:
        self.simulation, self.fps, self.until = simulation, fps, until
        self.pointer = pointer if pointer.ready else None
        self.pace = Pace()
        self.paused = False
        self.frame: Frame = simulation.frame()
        self._start = simulation.snapshot()
        self._single = 0  # steps asked for one by one
        self._hold: Any = 0.0  # m, from where the hand holds a ball to its centre
        self._message, self._message_until = "", 0.0

    # Time ----------------------------------------------------------------------------------------------------------

    def advance(self, wall: float) -> float:
        """Simulate what is due after `wall` seconds; the seconds that were simulated. Then `frame` is another one."""
        sim = self.simulation
        due, self._single = self._single, 0
        if not due and not self.paused:
            due = self.pace.steps(wall, sim.dt)
        due = int(min(due, self._left()))
        simulated = self._advance(due) if due else 0.0
        self.pace.note(wall, simulated)
        return simulated

    def _advance(self, steps: int) -> float:
        sim = self.simulation
        before, begin = sim.time, time.perf_counter()
        sim.step(steps)
        self.pace.made(steps, time.perf_counter() - begin)
        self.frame = sim.frame()
        return float(sim.time - before)

    def _left(self) -> float:
        """Steps until the time that ends it."""
        sim = self.simulation
        return math.inf if self.until is None else max(0, round((self.until - sim.time) / sim.dt))

    @property
    def ended(self) -> bool:
        """True if time has come to its end."""
        return self._left() == 0

    @property
    def stands(self) -> bool:
        """True if no time passes by itself."""
        return self.paused or self.ended

    # Commands ------------------------------------------------------------------------------------------------------

    def pause(self) -> None:
        """Stop the time, or let it pass again."""
        self.paused = not self.paused

    def step(self) -> None:
        """Pause, and make one time step."""
        self.paused, self._single = True, self._single + 1

    def step_picture(self) -> None:
        """Pause, and make the time steps between two pictures."""
        self.paused, self._single = True, self._single + max(1, round(1 / self.fps / self.simulation.dt))

    def reset(self) -> None:
        """Return to the start. No ball is dragged any longer."""
        self.let_go()
        self.simulation.resume(self._start)
        self.frame = self.simulation.frame()

    def slow_down(self) -> None:
        """Halve the speed."""
        self.pace.scale(0.5)

    def speed_up(self) -> None:
        """Double the speed."""
        self.pace.scale(2.0)

    # A hand --------------------------------------------------------------------------------------------------------

    def grab(self, ball: int, at: NDArray[np.float64]) -> bool:
        """Hold a ball at a point (dim,) [m] of it, and no other; False where it cannot be dragged."""
        self.let_go()
        pinned = self.frame.pinned
        if self.pointer is None or (len(pinned) and pinned[ball]):
            return False
        sim, centre = self.simulation, self.frame.position[ball]
        self._hold = centre - at
        self.pointer.rate = min(POINTER_RATE, MOST_RATE_STEP * sim.substeps / sim.dt)
        self.pointer.grab(ball, centre)
        return True

    def pull(self, to: NDArray[np.float64]) -> None:
        """Draw the point that is held to another one (dim,) [m]; does nothing where none is."""
        if self.pointer is not None:
            self.pointer.move(to + self._hold)

    def let_go(self) -> None:
        """Release the ball that is held."""
        if self.pointer is not None:
            self.pointer.release()

    @property
    def held(self) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
        """Places (dim,) [m] of the ball that is held and of what it is drawn to, or None."""
        pointer = self.pointer
        if pointer is None or pointer.ball is None or pointer.target is None:
            return None
        return self.frame.position[pointer.ball], pointer.target

    # Words ---------------------------------------------------------------------------------------------------------

    def tell(self, message: str) -> None:
        """Show a message for some seconds."""
        self._message, self._message_until = message, time.perf_counter() + MESSAGE_TIME

    @property
    def message(self) -> Rows:
        """The message that is to be shown, or nothing."""
        return (("", self._message),) if time.perf_counter() < self._message_until else ()

    def figures(self) -> Rows:
        """The time, the speed, the energy and the number of balls, in words."""
        frame, pace = self.frame, self.pace
        asked = "" if pace.speed == 1 else f" ({pace.speed:g} x asked for)"
        speed = "paused" if self.paused else "at its end" if self.ended else f"{pace.reached:.2g} x real time"
        rate = () if self.stands or not pace.rate else (("pictures", f"{pace.rate:.0f} per second"),)
        energy = () if frame.energy is None else (("energy", f"{frame.energy[3]:.4g} J"),)
        balls = ("balls", f"{len(frame.position):,}".replace(",", " "))
        return (("time", f"{frame.time:.3f} s"), ("speed", speed + asked), *rate, *energy, balls)


class Command(NamedTuple):
    """Something that a key or a button does with a player. key: its name in lists of keys; paused: its label while the player
    is paused, where that is another one."""

    label: str
    key: str
    words: str
    act: Callable[[Player], None]
    paused: str = ""


COMMANDS = (
    Command("Pause", "space", "pause, go on", Player.pause, "Resume"),
    Command("Step", "s", "one time step", Player.step),
    Command("Picture", "right arrow", "one picture further", Player.step_picture),
    Command("Reset", "r", "back to the start", Player.reset),
    Command("Slower", "[", "half the speed", Player.slow_down),
    Command("Faster", "]", "twice the speed", Player.speed_up),
)
