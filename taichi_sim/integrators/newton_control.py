"""Rounds: the order in which an implicit stage is solved."""

__all__ = ["control"]


def control(self, s, stage):
    """A stage, from base. The one text of two programs: compiled for one thread, where every loop runs inside a kernel, and in
    Python, where each line launches a kernel whose loops run in parallel."""
    self.begin(stage)
    self.linearise(s, 1.0)
    if self.doubtful():
        self.compare(s, 1.0)
        if self.raised():
            self.linearise(s, -1.0)
    self.set_target()
    while self.unsolved():
        self.aim()
        while self.searching():
            self.turn()
        self.evaluate(s, 1.0)
        part = 1.0
        while self.larger():
            self.compare(s, part)
            if self.raised():
                part = 0.5 * part
                self.evaluate(s, -part)
    self.end(stage)
