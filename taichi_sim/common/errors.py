"""The three errors that a user of taichi_sim can meet, and nothing else."""

__all__ = ["BackendError", "SceneError", "UnstableError"]


class SceneError(ValueError):
    """Something in the scene is wrong; the message names the field, the index, the value and what is allowed."""


class BackendError(RuntimeError):
    """Taichi cannot be started as asked: no such device, or another precision or arch is already running."""


class UnstableError(RuntimeError):
    """A ball became non-finite or left the world.

    Attributes: `time` [s] of the first bad state, `ball` (index), `spring` (index of the stiffest spring at that ball,
    or None), `safe_dt` [s] (largest step that is safe for every shape, or None where the scene has no springs).
    The simulation is left in its last good state.
    """

    def __init__(self, message: str, time: float, ball: int, spring: int | None, safe_dt: float | None) -> None:
        super().__init__(message)
        self.time = time
        self.ball = ball
        self.spring = spring
        self.safe_dt = safe_dt
