"""Forces and stiffness of springs, bending elements, cells and bricks of a scene in NumPy, and where it hangs at rest."""

import numpy as np

from taichi_sim.scene.bricks import BRICKS


def forces(scene, x):
    """Forces (n dim,) [N] at x (n, dim) and their dense stiffness matrix; that of springs without what compression softens."""
    n, dim = x.shape
    i, j = scene.pairs[:, 0], scene.pairs[:, 1]
    apart = x[j] - x[i]
    length = np.linalg.norm(apart, axis=1)
    along = apart / length[:, None]
    pull = scene.stiffness * (length - scene.rest_length)
    force = scene.mass[:, None] * scene.gravity
    np.add.at(force, i, pull[:, None] * along)
    np.add.at(force, j, -pull[:, None] * along)
    across = np.maximum(pull / length, 0.0)
    block = np.einsum("m,mi,mj->mij", scene.stiffness - across, along, along) + across[:, None, None] * np.eye(dim)
    matrix = np.zeros((n, dim, n, dim))
    for a, b, sign in ((i, i, 1), (j, j, 1), (i, j, -1), (j, i, -1)):
        np.add.at(matrix.swapaxes(1, 2), (a, b), sign * block)
    for corners, weights, k in zip(scene.bends, scene.bend_weights, scene.held_bending()[0]):
        np.add.at(force, corners, -k * np.outer(weights, weights @ x[corners]))
        for a, wa in zip(corners, weights):
            for b, wb in zip(corners, weights):
                matrix[a, :, b] += k * wa * wb * np.eye(dim)
    if len(scene.bricks):
        at = (dim * scene.bricks[:, :, None] + np.arange(dim)).reshape(len(scene.bricks), -1)
        push, stiff = brick_forces(scene, x)
        np.add.at(force.reshape(-1), at, push)
        np.add.at(matrix.reshape(n * dim, n * dim), (at[:, :, None], at[:, None]), stiff)
    if len(scene.cells):
        volume, gradient = cell_gradients(x, scene.cells)
        alone = scene.cells_together < 0
        one = np.where(alone, np.arange(len(alone)), len(alone) + scene.cells_together)
        for group in np.unique(one):
            own = np.flatnonzero(one == group)
            rest = scene.rest_volume[own].sum()
            modulus = scene.bulk_modulus[own] @ scene.rest_volume[own] / rest
            whole = np.zeros((n, dim))
            np.add.at(whole, scene.cells[own], gradient[own])
            at = np.unique(scene.cells[own])
            force -= modulus * (volume[own].sum() / rest - 1) * whole
            stiff = np.einsum("ki,lj->kilj", whole[at], whole[at]) * modulus / rest
            matrix[at[:, None], :, at[None]] += stiff.transpose(0, 2, 1, 3)
    return force.ravel(), matrix.reshape(n * dim, n * dim)


def brick_forces(scene, x):
    """Forces (b, 2^dim dim) [N] of bricks on their corners, exact, and what they lose by places there, by differences."""
    corners = x[scene.bricks].reshape(len(scene.bricks), -1)
    width, tiny = corners.shape[1], 1e-7 * np.ptp(x)

    def push(at):
        change = at[None] + 1e-30j * np.eye(width)[:, None]
        stored = [BRICKS.stored(scene, one.reshape(-1, 2**scene.dim, scene.dim)).imag for one in change]
        return -np.stack(stored, axis=1) / 1e-30

    ahead = [push(corners + tiny * one) - push(corners - tiny * one) for one in np.eye(width)]
    stiff = -np.stack(ahead, axis=2) / (2 * tiny)
    return push(corners), 0.5 * (stiff + stiff.transpose(0, 2, 1))


def cell_gradients(x, cells):
    """Volumes (c,) and their derivatives (c, dim + 1, dim) by the corners."""
    sides = x[cells[:, 1:]] - x[cells[:, :1]]
    if x.shape[1] == 2:
        u, v = sides[:, 0], sides[:, 1]
        volume = 0.5 * (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])
        of = 0.5 * np.stack([np.stack([v[:, 1], -v[:, 0]], 1), np.stack([-u[:, 1], u[:, 0]], 1)], axis=1)
    else:
        a, b, c = sides[:, 0], sides[:, 1], sides[:, 2]
        of = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=1) / 6
        volume = np.einsum("ci,ci->c", a, of[:, 0])
    return volume, np.concatenate([-of.sum(axis=1, keepdims=True), of], axis=1)


def at_rest(scene, x=None, rounds=100, most=1e-11):
    """Positions (n, dim) where the forces on all free balls vanish, by Newton's method with shortened steps; and K there."""
    x = np.array(scene.position if x is None else x)
    free = np.repeat(~scene.pinned, x.shape[1])
    weight = np.abs(scene.mass[:, None] * scene.gravity).sum()
    for _ in range(rounds):
        force, matrix = forces(scene, x)
        left = np.linalg.norm(force[free]) / weight
        if left < most:
            return x, matrix[np.ix_(free, free)]
        step = np.linalg.solve(matrix[np.ix_(free, free)], force[free])
        x.reshape(-1)[free] += step * min(1.0, 0.1 * np.ptp(scene.position) / np.abs(step).max())
    raise AssertionError(f"no rest: {left:.1e} of the weight is left")
