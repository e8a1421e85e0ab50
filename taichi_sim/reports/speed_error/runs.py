"""Progress of a report or of tune: which run is in progress, how many are done and about how many there will be."""

import time

from taichi_sim.common.progress import Work


class Runs(Work):
    """Runs that are done, and about how many there will be. Called with each run in words as it begins."""

    def __init__(self) -> None:
        super().__init__(0, "runs", about=True)
        self.to_come, self._begun = 0, 0
        self.words = lambda: "starting"

    def expect(self, number: int) -> None:
        """Expect so many more runs, or fewer where the number is negative."""
        self.to_come = max(0, self.to_come + number)
        self.total = self._begun + self.to_come

    def __call__(self, what: str) -> None:
        self.done, self._begun = self._begun, self._begun + 1
        self.expect(-1)
        start = time.monotonic()
        self.words = lambda: f"{what}, begun {time.monotonic() - start:.0f} s ago"
