"""Pace: how many steps to make between two pictures of a live view, and how often to make one. Plain numbers; no clock."""

BUDGET = 0.05  # s of work between two pictures, so that a heavy scene still answers the mouse
STALL = 0.25  # s: longer waits are not caught up with
SPEEDS = (1 / 1024, 1024.0)
OVER = 0.5  # s that figures are averaged over


class Pace:
    """Real time, or `speed` times that, as long as steps are fast enough; where they are not, what fits into BUDGET."""

    def __init__(self) -> None:
        self.speed = 1.0  # asked for: simulated over real seconds
        self._wall, self._simulated = 0.0, 0.0  # averages, s per picture, of as much as is known
        self._known = 0.0  # how much that is, from 0 to 1
        self._owed = 0.0  # s to be simulated
        self._cost = 0.0  # s per step; 0: not known yet

    def scale(self, factor: float) -> None:
        """Another speed."""
        self.speed = min(max(self.speed * factor, SPEEDS[0]), SPEEDS[1])

    def steps(self, wall: float, dt: float) -> int:
        """Steps of dt [s] to make, `wall` seconds after the last call."""
        self._owed += min(wall, STALL) * self.speed
        most = max(1, int(BUDGET / self._cost)) if self._cost > 0 else 1
        due = int(self._owed / dt * (1 + 1e-12))
        if due > most:
            self._owed = most * dt  # the rest is given up
            due = most
        self._owed = max(0.0, self._owed - due * dt)
        return due

    def made(self, steps: int, seconds: float) -> None:
        """Note that so many steps took so many seconds."""
        if steps:
            now = seconds / steps
            self._cost = now if self._cost == 0 else (self._cost + now) / 2

    def note(self, wall: float, simulated: float) -> None:
        """A picture came `wall` seconds after the last one and shows `simulated` seconds more."""
        share = min(1.0, wall / OVER)
        self._known += share * (1.0 - self._known)
        self._wall += share * (wall - self._wall)
        self._simulated += share * (simulated - self._simulated)

    @property
    def reached(self) -> float:
        """The speed that it came to, over about half a second."""
        return self._simulated / self._wall if self._wall > 0 else 0.0

    @property
    def rate(self) -> float:
        """Pictures per second; 0 before the second one."""
        return self._known / self._wall if self._wall > 0 else 0.0


class Share:
    """Tells when pictures for others are due, so that making them takes no more than a part of the time.

    fps: most pictures per second; part: of the time, in 0..1.
    """

    def __init__(self, fps: float, part: float) -> None:
        self._least, self._rest = 1.0 / fps, 1.0 / part
        self._next = 0.0

    def due(self, now: float) -> bool:
        """True if another picture may be made at `now` [s]."""
        return now >= self._next

    def spent(self, begin: float, end: float) -> None:
        """Note that one took from `begin` to `end` [s]."""
        self._next = begin + max(self._least, (end - begin) * self._rest)
