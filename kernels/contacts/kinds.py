"""Numbers that say what something is, shared by the kernels and by what fills their tables."""

# The role of a wall or collider for a ball: LEAVING, it is no constraint of the solve; RESTING on it; REACHABLE, the ball may be
# pushed there by others; SUNK, inside of it already and turned back by the solve; ARRIVING fast, left to the move with its exact
# time; FORESEEN, an implicit stage took it as reached at the end of the step.
LEAVING, RESTING, REACHABLE, SUNK, ARRIVING, FORESEEN = range(6)
BALL_ALONE, BALL_CROWDED, BALL_ARRIVING = range(
    3
)  # a ball that touches no others; one that does; one that arrives fast at a wall besides
# Pairs in contacts of triangles: two edges are EDGE_EDGE, + STICK_FIRST or STICK_SECOND where one of them is a bare stick.
BALL_TRIANGLE, EDGE_EDGE = 0, 4
STICK_FIRST, STICK_SECOND = 1, 2
