"""Samples that triangles cover: what rows of a triangle leave out holds none."""

import numpy as np
import pytest
from taichi_sim.kernels.render import triangles
from taichi_sim.kernels.render.raster import SAMPLE_OFFSETS, TRIANGLE

from taichi_sim.device import backend
from taichi_sim.device.engine import ti
from taichi_sim.device.fields import Fields
from taichi_sim.render.canvas import Visibility, matrix_of

WIDTH, HEIGHT, FOCAL, NUMBER, SAMPLES = 160, 90, 100.0, 400, 4


@pytest.fixture(scope="module")
def draw():
    """A function from corners (NUMBER, 3, 3) in the axes of the eye to what is seen at all samples, one above its index, or 0."""
    backend.start()
    fields = Fields(ti.f32, backend.has_wide_numbers())
    seen = Visibility(fields, (WIDTH, HEIGHT), SAMPLES)
    ball, corner = fields.vectors(3 * NUMBER, 4), fields.cells(NUMBER, 3)
    style_of, style = fields.integers(NUMBER), fields.vectors(1, 9)
    fields.build()
    corner.from_numpy(np.arange(3 * NUMBER, dtype=np.int32).reshape(-1, 3))
    view = np.eye(4)
    view[3] = FOCAL, WIDTH / 2, HEIGHT / 2, 0.0

    def drawn(place):
        ball.from_numpy(np.insert(place.reshape(-1, 3), 3, 0.0, axis=1).astype(np.float32))
        seen.clear(WIDTH, HEIGHT)
        given = (seen, SAMPLES, matrix_of(view), WIDTH, HEIGHT, NUMBER)
        triangles.draw_triangles(ball, corner, style_of, style, False, *given)
        identity = seen.key.to_numpy() & 0xFFFFFFFF
        return np.where(identity > 0, identity - (TRIANGLE << 28) + 1, 0)

    yield drawn
    fields.free()


def expected(place):
    """Triangle that `draw` should find at each sample, counted from 1, or 0: in double precision, by all samples."""
    place = place.astype(np.float32).astype(float)
    x, y = WIDTH / 2 + FOCAL * place[..., 0] / place[..., 2], HEIGHT / 2 - FOCAL * place[..., 1] / place[..., 2]
    offset = np.array(SAMPLE_OFFSETS[SAMPLES])
    row, column = np.mgrid[0:HEIGHT, 0:WIDTH]
    px, py = column[..., None] + 0.5 + offset[:, 0], row[..., None] + 0.5 + offset[:, 1]
    nearest, which = np.zeros(px.shape), np.zeros(px.shape, dtype=int)
    for k, (a, b, w) in enumerate(zip(x, y, 1 / place[..., 2])):
        area = (a[1] - a[0]) * (b[2] - b[0]) - (b[1] - b[0]) * (a[2] - a[0])
        u = ((px - a[0]) * (b[2] - b[0]) - (py - b[0]) * (a[2] - a[0])) / area
        v = ((a[1] - a[0]) * (py - b[0]) - (b[1] - b[0]) * (px - a[0])) / area
        near = np.where(np.minimum(np.minimum(u, v), 1 - u - v) >= 0, w[0] + u * (w[1] - w[0]) + v * (w[2] - w[0]), 0.0)
        which[near > nearest] = k + 1
        nearest = np.maximum(nearest, near)
    return which.ravel()


@pytest.mark.once
@pytest.mark.parametrize(("size", "thin"), [(0.03, 1.0), (0.3, 1.0), (1.5, 0.01)])
def test_rows_leave_out_no_sample(draw, size, thin):
    rng = np.random.default_rng(8)
    middle = rng.uniform((-1.2, -0.8, 2.0), (1.2, 0.8, 3.0), (NUMBER, 1, 3))
    way = rng.normal(size=(NUMBER, 1, 3))
    place = (
        middle
        + way * rng.normal(size=(NUMBER, 3, 1)) * size * (thin < 1)
        + rng.normal(size=(NUMBER, 3, 3)) * size * thin
    )
    place[..., 2] = np.maximum(place[..., 2], 0.5)
    place[: NUMBER // 8, 1, 1] = place[: NUMBER // 8, 0, 1]  # with level edges, and upright ones
    place[: NUMBER // 8, :, 2] = middle[: NUMBER // 8, :, 2]
    place[: NUMBER // 8, 2, 0] = place[: NUMBER // 8, 0, 0]
    found, right = draw(place), expected(place)
    assert np.count_nonzero(right) > 1000
    assert np.mean((found != right)[right > 0]) < 1e-3  # on an edge, to rounding
