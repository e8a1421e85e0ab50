"""Collision groups: who collides with whom."""

from taichi_sim.device.engine import ti


@ti.func
def meets(group_a, mask_a, group_b, mask_b):
    """True if two things collide: each must be in a group that the other collides with."""
    return (group_a & mask_b) != 0 and (group_b & mask_a) != 0


@ti.func
def balls_meet(model: ti.template(), i, j):
    """True if the groups of two balls let them collide; only where the scene has groups."""
    return meets(model.group[i], model.mask[i], model.group[j], model.mask[j])
