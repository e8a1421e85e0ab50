"""Into how many parts a ball splits its mass where contacts are summed from old velocities."""

from taichi_sim.device.engine import ti


@ti.func
def shares(solver: ti.template(), ball: ti.template(), i):
    """What decides into how many parts ball i splits its mass: the sums of n n^T and of 1 over all that is accumulated, with
    "gauss_seidel" only sticks and surfaces, whose weights count."""
    count = 0.0 * solver.model.inverse_mass[i]
    T = ti.Matrix.zero(float, solver.model.dim, solver.model.dim)
    if ti.static(solver.plan.pairs and solver.split):
        count = solver.pair_count[i]
        if ti.static(solver.splits_by_direction):
            T = solver.normal_tensor[i]
    if ti.static(solver.plan.walls and solver.split):
        t, c = solver.walls.shares(ball, i)
        T += t
        count += c
    if ti.static(not solver.sums_plainly):
        for part in ti.static(solver.sticks_and_triangles):
            t, c = part.shares(i)
            T += t
            count += c
    return T, count
