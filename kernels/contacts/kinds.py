"""Numbers that say what something is, shared by the kernels and by what fills their tables."""

# The part that a wall or collider plays for a ball: LEAVING, it is no constraint of the solve; RESTING on it; NEAR, the ball may
# be pushed there by others; SUNK, inside of it already and turned back by the solve; ARRIVING fast, left to the move with its
# exact time.
LEAVING, RESTING, NEAR, SUNK, ARRIVING = range(5)
ALONE, CROWDED, FAST = range(3)  # a ball that touches no others; one that does; one that arrives fast at a wall besides
ROUND, BOX, MESH, CUSTOM = range(4)  # shapes of colliders
BALL_TRIANGLE, EDGE_EDGE, STICK_EDGE, EDGE_STICK = (
    0,
    4,
    5,
    6,
)  # pairs of surfaces; a stick is the first edge, or the second
