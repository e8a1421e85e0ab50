"""Ambient occlusion: the share of the sky that pixels see, from the depths about them, on the lattice of `shadow_lattice`.

M. McGuire, M. Mara, D. Luebke, Scalable ambient obscurance, 2012; here every occluder counts by its cosine alone.
"""

from taichi_sim.kernels.render.raster import PLANE, View, vec2, vec3
from taichi_sim.kernels.render.shadow import rotated
from taichi_sim.kernels.render.shadow_lattice import STEP, lattice_width
from taichi_sim.kernels.render.visibility import TILE, tiles_across

from taichi_sim.device.engine import ti

SIDE = TILE // STEP  # points along the side of a tile
REACH = 0.11  # sizes of the scene: what is farther away hides no sky
WIDEST = 22.0  # lattice steps: no disc of taps has a larger radius
TAPS = 9
GAIN = 3.0  # of the mean cosine of what hides the sky, to the share that it hides
LEAST = 0.1  # cosine that hides anything: neighbours on the same curved surface hide nothing
DARKEST = 0.1  # share
OPEN = 0.995  # share of the sky from which all of it is seen
ALIKE = 60.0  # how soon points count less by the difference of their depths, as a part of them


@ti.func
def view_place(view, x, y, w):
    """Place in the axes of the view of what is seen at a lattice point, and whose closeness is w."""
    px, py = ti.cast(x * STEP, ti.f32) + ti.f32(0.5), ti.cast(y * STEP, ti.f32) + ti.f32(0.5)
    z = 1 / ti.max(w, ti.f32(1e-9))
    return vec3((px - view[3, 1]) * z / view[3, 0], (view[3, 2] - py) * z / view[3, 0], z)


@ti.func
def seen_share(scene: ti.template(), view, x, y, across, down):
    """Share of the sky that a lattice point sees among the others about it."""
    k = y * across + x
    w, n = scene.lattice_depth[k], scene.lattice_normal[k]
    p, blocked = view_place(view, x, y, w), ti.f32(0.0)
    radius = ti.min(ti.f32(REACH) * view[3, 0] * w / STEP, ti.f32(WIDEST))
    turn = ti.cast((x % 3) * 3 + y % 3, ti.f32) * ti.f32(0.6981317)  # nine turns in each square of 3 x 3 points
    direction = vec2(ti.cos(turn), ti.sin(turn))
    for tap in range(TAPS):
        r = radius * (ti.cast(tap, ti.f32) + ti.f32(0.7)) / TAPS
        i, j = x + ti.cast(ti.round(r * direction[0]), ti.i32), y + ti.cast(ti.round(r * direction[1]), ti.i32)
        direction = rotated(direction)
        if i >= 0 and j >= 0 and i < across and j < down:
            other = scene.lattice_depth[j * across + i]
            if other > 0:
                v = view_place(view, i, j, other) - p
                squared = ti.max(v.dot(v), ti.f32(1e-12))
                near = ti.max(1 - squared / ti.f32(REACH * REACH), ti.f32(0.0))
                blocked += ti.max(v.dot(n) / ti.sqrt(squared) - ti.f32(LEAST), ti.f32(0.0)) * near
    return ti.max(1 - blocked * ti.f32(GAIN / TAPS), ti.f32(DARKEST))


@ti.func
def any_near(scene: ti.template(), seen: ti.template(), view, tile, width, height):
    """True if anything but planes may be within reach of a tile's points."""
    tiles, rows = tiles_across(width), tiles_across(height)
    across, x, y = lattice_width(width), tile % tiles, tile // tiles
    closest = ti.f32(0.0)
    for k in range(SIDE * SIDE):
        closest = ti.max(closest, scene.lattice_depth[(y * SIDE + k // SIDE) * across + x * SIDE + k % SIDE])
    px = ti.min(ti.f32(REACH) * view[3, 0] * closest, ti.f32(WIDEST * STEP))
    reach, found = ti.cast(px / TILE, ti.i32) + 1, 0
    for j in range(ti.max(y - reach, 0), ti.min(y + reach + 1, rows)):
        for i in range(ti.max(x - reach, 0), ti.min(x + reach + 1, tiles)):
            found |= seen.marked[j * tiles + i]
    return found > 0 and closest > 0


@ti.func
def occluded_near(scene: ti.template(), tile, width, height):
    """True if any point of a tile or of those about it sees less than all of the sky."""
    tiles, rows, found = tiles_across(width), tiles_across(height), 0
    for j in range(ti.max(tile // tiles - 1, 0), ti.min(tile // tiles + 2, rows)):
        for i in range(ti.max(tile % tiles - 1, 0), ti.min(tile % tiles + 2, tiles)):
            found |= scene.occluded[j * tiles + i]
    return found > 0


@ti.kernel
def occlude(scene: ti.template(), seen: ti.template(), view: View, planes: ti.i32, width: ti.i32, height: ti.i32):
    """Find the share of the sky that each lattice point sees; then smooth it over 3 x 3 of them, in which all turns occur."""
    across, down = lattice_width(width), lattice_width(height)
    tiles = tiles_across(width)
    for tile in range(tiles * tiles_across(height)):
        occluded = 0
        if planes > 1 or any_near(scene, seen, view, tile, width, height):
            for k in range(SIDE * SIDE):
                x, y = tile % tiles * SIDE + k % SIDE, tile // tiles * SIDE + k // SIDE
                if scene.lattice_depth[y * across + x] > 0:
                    share = seen_share(scene, view, x, y, across, down)
                    scene.open_raw[y * across + x] = share
                    if share < ti.f32(OPEN):
                        occluded = 1
        scene.occluded[tile] = occluded
    for tile in range(tiles * tiles_across(height)):
        scene.dim[tile] = ti.cast(occluded_near(scene, tile, width, height), ti.i32)
        if scene.dim[tile] > 0:
            for k in range(SIDE * SIDE):
                x, y = tile % tiles * SIDE + k % SIDE, tile // tiles * SIDE + k // SIDE
                w, total, weights = scene.lattice_depth[y * across + x], ti.f32(0.0), ti.f32(0.0)
                sharp = ti.f32(ALIKE) / ti.max(w, ti.f32(1e-9))
                for j in range(ti.max(y - 1, 0), ti.min(y + 2, down)):
                    for i in range(ti.max(x - 1, 0), ti.min(x + 2, across)):
                        at = j * across + i
                        weight = 1 / (1 + ti.abs(scene.lattice_depth[at] - w) * sharp)
                        total += weight * scene.open_raw[at]
                        weights += weight
                scene.open[y * across + x] = total / weights


@ti.func
def open_share(scene: ti.template(), identity, w, x, y, width):
    """Share of the sky that a pixel sees, from the lattice points about it that show the like; w: its closeness."""
    k, across = y // STEP * lattice_width(width) + x // STEP, lattice_width(width)
    u, v = ti.cast(x % STEP, ti.f32) / STEP, ti.cast(y % STEP, ti.f32) / STEP
    total, weights = ti.f32(0.0), ti.f32(0.0)
    for j in ti.static(range(2)):
        for i in ti.static(range(2)):
            corner = k + j * across + i
            weight = (u if ti.static(i == 1) else 1 - u) * (v if ti.static(j == 1) else 1 - v) + ti.f32(1e-3)
            other = scene.lattice_identity[corner]
            if other != identity:
                if other == 0 or (identity >> 28) == PLANE or (other >> 28) == PLANE:
                    weight *= ti.f32(1e-3)
                else:
                    weight /= 1 + ti.abs(scene.lattice_depth[corner] - w) * ti.f32(ALIKE) / w
            total += weight * scene.open[corner]
            weights += weight
    return total / weights
