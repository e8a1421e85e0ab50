"""Motion blur and depth of field: means of pictures over a shutter and a lens."""

import numpy as np
import pytest
from test_render import FRONT, GREEN, RED, balls, linear, picture, placed, project

from taichi_sim import SceneError, Sphere
from taichi_sim.render.exposure import Exposure, Mean

pytestmark = pytest.mark.once

CORNERS = [[-4, -2], [4, 2]]  # of what the picture shows


def redness(image):
    """Excess of red over the background of (h, w) pixels."""
    light = linear(image)
    return np.maximum(light[..., 0] - light[..., 1], 0.0)


def test_what_moves_is_spread_along_its_way():
    """A disc that goes two radii to the right while the shutter is open: as much of it is seen as of one that stands still."""
    frame = balls([[0.0, 0.0], *CORNERS], 0.5, [RED, GREEN, GREEN])
    frame.velocity[0] = (4.0, 0.0)
    one, other = (redness(picture(frame, shutter=shutter, exposures=32)) for shutter in (0.0, 0.25))
    columns = [np.flatnonzero(part.max(axis=0) > 0.02 * one.max()) for part in (one, other)]
    assert len(columns[1]) == pytest.approx(1.97 * len(columns[0]), abs=3)
    assert columns[1].mean() == pytest.approx(columns[0].mean(), abs=1.5)
    assert other.sum() == pytest.approx(one.sum(), rel=0.05)
    rows = [np.flatnonzero(part.max(axis=1) > 0.02 * one.max()) for part in (one, other)]
    assert abs(len(rows[1]) - len(rows[0])) <= 2


@pytest.mark.parametrize("n", [1, 2, 3, 5, 11, 12, 16, 100, 256])
def test_moments_lie_evenly_about_the_time_of_the_frame(n):
    """Each is in the middle of its own n-th of the time that the shutter is open."""
    frame = balls([[1.0, 0.0]], 0.5, [RED])
    frame.velocity[0] = (2.0, 0.0)
    exposure = Exposure(shutter=0.5, aperture=0.1, exposures=n)
    places = sorted(float(moment.position[0, 0]) for moment, _ in exposure.moments(frame))
    assert places == pytest.approx((1.0 + (np.arange(n) + 0.5) / n - 0.5).tolist(), abs=1e-12)


def test_a_lens_is_sharp_at_its_target_alone():
    """Balls at the target and far before it; the camera looks at the first."""
    frame = balls([[-1.0, 0.0, 0.0], [0.6, 0.0, 5.0]], 0.4, [RED, RED])
    soft = []
    for aperture in (0.0, 0.5):
        red = redness(picture(frame, camera=FRONT, shadow=False, aperture=aperture))
        between = (red > 0.1 * red.max()) & (red < 0.6 * red.max())
        edges = []
        for place in frame.position:
            row, column = (round(part) for part in project(place))
            edges.append(np.count_nonzero(between[row, max(0, column - 30) : column + 30]))
        soft.append(edges)
    assert soft[1][0] <= soft[0][0] + 3
    assert soft[1][1] >= soft[0][1] + 4


def test_colliders_move_while_the_shutter_is_open():
    moving = placed(Sphere((0, 0, 0), 0.5, velocity=(4.0, 0, 0), colour=RED), 3)
    frame = balls([[-3.0, 0, 0]], 0.2, [GREEN], colliders=(moving,))
    one, other = (
        redness(picture(frame, camera=FRONT, shadow=False, shutter=shutter, exposures=8)) for shutter in (0.0, 0.4)
    )
    assert np.count_nonzero(other.max(axis=0) > 0.05) > 1.5 * np.count_nonzero(one.max(axis=0) > 0.05)


def test_the_mean_of_pictures_is_that_of_their_light():
    mean = Mean()
    for value in (0, 255):
        mean.add(np.full((1, 1, 3), value, dtype=np.uint8))
    assert mean.picture().tolist() == [[[188, 188, 188]]]  # half of the light of white
    clear = Mean()
    for pixel in ((255, 0, 0, 255), (0, 255, 0, 0)):
        clear.add(np.array([[pixel]], dtype=np.uint8))
    assert clear.picture().tolist() == [[[255, 0, 0, 128]]]  # what is not there has no colour
    same = Mean()
    every = np.arange(256, dtype=np.uint8).reshape(16, 16, 1).repeat(3, axis=2)
    for _ in range(3):
        same.add(every)
    assert np.array_equal(same.picture(), every)


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"shutter": -1.0}, "shutter"),
        ({"shutter": 1e5}, "shutter"),
        ({"aperture": 1e4}, "aperture"),
        ({"aperture": 0.1}, "aperture: 0.1 is for scenes in 3D; in 2D all is as far away"),
        ({"aperture": float("nan")}, "aperture"),
        ({"exposures": 0}, "exposures"),
    ],
)
def test_refused(given, says):
    with pytest.raises(SceneError, match=says):
        picture(balls([[0.0, 0.0]], 0.5), **given)
