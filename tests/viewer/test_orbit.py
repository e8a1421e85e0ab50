"""The parts of the live window that need no display: views, picking, pace, overlay."""

import numpy as np
import pytest

from taichi_sim.analysis.frame import Frame
from taichi_sim.render import Camera, Flat, Renderer
from taichi_sim.viewer import overlay
from taichi_sim.viewer.orbit import NOTCH, Orbit, Slide, pick, view_of
from taichi_sim.viewer.pace import BUDGET, STALL, Pace

pytestmark = pytest.mark.once

SIZE = (200, 100)
EYE = Camera(eye=(1.0, 2.0, 8.0), target=(1.0, 2.0, 3.0))


def orbit() -> Orbit:
    return Orbit(EYE, SIZE)


def slide() -> Slide:
    return Slide(Flat((-1.0, 2.0), 50.0), SIZE)


@pytest.mark.parametrize("view", [orbit(), slide()], ids=["3d", "2d"])
def test_a_point_is_seen_where_it_came_from(view):
    depth = 3.0 if isinstance(view, Orbit) else 0.0
    at = (37.0, 81.5)
    seen = view.camera.see(view.point(at, depth)[None], view.size)
    assert seen.at[0] == pytest.approx(at)
    assert seen.depth[0] == pytest.approx(depth)


def test_the_target_is_in_the_middle_and_what_lies_behind_is_nowhere():
    seen = EYE.see(np.array([EYE.target, (1.0, 2.0, 9.0), (2.0, 3.0, 3.0)]), orbit().size)
    assert seen.at[0] == pytest.approx([100, 50])
    assert np.isnan(seen.at[1]).all()
    assert seen.at[2, 0] > 100  # right
    assert seen.at[2, 1] < 50  # up
    assert seen.at[2, 0] - 100 == pytest.approx(seen.scale[2])  # a metre


def test_turning_keeps_the_distance_and_never_goes_over_a_pole():
    view = orbit()
    for dx, dy in ((10, 0), (0, 5), (-30, 7), (0, 500), (3, 900), (0, -2000), (40, 3)):
        view.turn(dx, dy)
        back = np.subtract(view.camera.eye, view.camera.target)
        assert np.linalg.norm(back) == pytest.approx(5.0)
        assert view.camera.target == pytest.approx(EYE.target)
        assert abs(back[1]) < 5.0 * np.cos(np.radians(1.9))
    view = orbit()
    view.turn(10, 0)  # to the right: what is in front goes right, so the eye goes left
    assert view.camera.eye[0] < 1.0
    assert view.camera.eye[1] == pytest.approx(2.0)
    view.turn(0, 10)  # down: one looks from higher up
    assert view.camera.eye[1] > 2.0
    view.turn(0, -10)
    view.turn(-10, 0)
    assert view.camera.eye == pytest.approx(EYE.eye)


@pytest.mark.parametrize("make", [orbit, slide], ids=["3d", "2d"])
def test_panning_takes_the_scene_along(make):
    view = make()
    point = view.point((60.0, 40.0), 5.0)[None]  # as deep as the target
    view.pan(13.0, -8.0)
    assert view.camera.see(point, view.size).at[0] == pytest.approx([73.0, 32.0])


def test_zoom():
    view = orbit()
    view.zoom(2, (0, 0))
    assert np.linalg.norm(np.subtract(view.camera.eye, view.camera.target)) == pytest.approx(5.0 / NOTCH**2)
    view.zoom(-100, (0, 0))
    assert np.all(np.isfinite(view.camera.eye))
    flat, at = slide(), (150.0, 20.0)
    fixed = flat.point(at, 0.0)
    flat.zoom(3, at)
    assert flat.camera.scale == pytest.approx(50 * NOTCH**3)
    assert flat.camera.see(fixed[None], flat.size).at[0] == pytest.approx(at)  # what is under the pointer stays there
    flat.zoom(100, at)
    assert np.isfinite(flat.camera.scale)
    assert isinstance(view_of(EYE, SIZE), Orbit)
    assert isinstance(view_of(flat.camera, SIZE), Slide)


def frame(position, radius=0.5, **more: object) -> Frame:
    x = np.array(position, dtype=float)
    return Frame(time=0.0, position=x, velocity=0 * x, radius=np.full(len(x), radius), **more)


@pytest.mark.parametrize("dim", [2, 3])
def test_the_views_agree_with_the_renderer(dim):
    """A red ball is red where the view says that it is, also after the view has moved."""
    balls = frame([[0.0] * dim, [1.0, 2.0, 0.5][:dim]], 0.2, colour=np.array([[1.0, 0, 0], [0, 0, 1.0]]))
    with Renderer(balls, size=SIZE) as renderer:
        view = view_of(renderer.camera, SIZE)
        for move in ((0.0, 0.0), (15.0, -4.0)):
            view.turn(*move)
            view.zoom(-move[0] / 5, (100.0, 50.0))
            renderer.camera = view.camera
            picture = renderer.render(balls).astype(int)
            red = np.argwhere(picture[:, :, 0] - picture[:, :, 2] > 50)[:, ::-1] + 0.5
            assert red.mean(axis=0) == pytest.approx(view.camera.see(balls.position, view.size).at[0], abs=1.5)
        half = renderer.render(balls, coarse=2)
        assert half.shape == ((50, 100, 3) if dim == 3 else (100, 200, 3))
        if dim == 3:  # the same picture, smaller
            assert np.abs(picture[::2, ::2] - half).mean() < 12
            assert np.array_equal(renderer.render(balls), picture)


def test_picking_discs():
    view = slide()  # 50 px per metre, from (-1, 2) on
    seen = frame([[0, 3], [0.3, 3], [2, 3], [2.6, 3]], 0.2, pinned=np.array([0, 0, 1, 0], dtype=bool))
    assert pick(view, seen, (50, 50)) == 0
    assert pick(view, seen, (58, 50)) == 1  # drawn over 0
    assert pick(view, seen, (150, 50)) is None  # pinned
    assert pick(view, seen, (100, 90)) is None
    assert pick(view, seen, (75 + 5, 50)) == 1  # a few px beside it
    assert pick(view, seen, (75 + 10, 50)) is None
    assert pick(view, frame(np.zeros((0, 2))), (50, 50)) is None


def test_picking_in_depth():
    view = orbit()
    seen = frame([[1, 2, 0], [1, 2, 2], [1, 2, 9]], 0.3)  # one behind the other, and one behind the eye
    assert pick(view, seen, (100, 50)) == 1
    seen.pinned = np.array([False, True, False])
    assert pick(view, seen, (100, 50)) is None  # a pinned ball hides what lies behind it


def test_picking_surfaces():
    view = orbit()
    corners = [[0, 1, 3], [2, 1, 3], [1, 4, 3], [0, 1, 1], [2, 1, 1], [1, 4, 1], [1, 2, 0]]
    seen = frame(corners, 0.05, triangles=np.array([[3, 4, 5], [0, 1, 2]], dtype=np.int32))
    at = view.camera.see(np.array([[0.3, 1.2, 3.0], [0.9, 3.2, 3.0], [-0.02, 0.98, 3.0], [-2, 1, 3]]), view.size).at
    assert pick(view, seen, tuple(at[0])) == 0  # the triangle in front, its nearest corner
    assert pick(view, seen, tuple(at[1])) == 2
    assert pick(view, seen, tuple(at[2])) == 0  # just outside
    assert pick(view, seen, tuple(at[3])) is None
    seen.pinned = np.arange(7) == 0
    assert pick(view, seen, tuple(at[0])) is None


def run(pace: Pace, *, wall: float, dt: float, cost: float, pictures: int) -> float:
    """Simulated over real seconds, for pictures that each take `wall` besides the steps."""
    real = simulated = 0.0
    took = wall
    for k in range(pictures):
        steps = pace.steps(took, dt)
        pace.made(steps, steps * cost)
        if k >= pictures // 2:
            real, simulated = real + took, simulated + steps * dt
        pace.note(took, steps * dt)
        took = wall + steps * cost
    return simulated / real


def test_pace_keeps_to_real_time():
    pace = Pace()
    assert run(pace, wall=1 / 60, dt=1e-3, cost=1e-5, pictures=200) == pytest.approx(1.0, rel=0.01)
    assert pace.reached == pytest.approx(1.0, rel=0.05)
    assert pace.rate == pytest.approx(60.0, rel=0.1)
    pace.scale(0.5)
    assert run(pace, wall=1 / 60, dt=1e-3, cost=1e-5, pictures=200) == pytest.approx(0.5, rel=0.01)
    assert run(Pace(), wall=1 / 60, dt=0.1, cost=1e-5, pictures=600) == pytest.approx(1.0, rel=0.03)  # long steps


def test_pace_of_a_heavy_scene_leaves_time_for_the_mouse():
    pace = Pace()
    assert run(pace, wall=0.01, dt=1e-3, cost=5e-3, pictures=100) == pytest.approx(0.01 / 0.06, rel=0.02)
    assert pace.steps(10.0, 1e-3) == round(BUDGET / 5e-3)
    pace.made(10, 100.0)
    assert pace.steps(10.0, 1e-3) == 1  # a step that is longer than the budget is made alone
    pace = Pace()
    pace.made(1, 1e-9)
    assert pace.steps(60.0, 1e-3) == pytest.approx(STALL / 1e-3)  # what was missed in a long wait is not caught up with


def test_the_first_pictures_have_the_rate_of_later_ones():
    pace = Pace()
    pace.note(0.0, 0.0)  # nothing has passed before the first
    assert (pace.rate, pace.reached) == (0.0, 0.0)
    for _ in range(50):
        pace.note(0.05, 0.02)
        assert pace.rate == pytest.approx(20.0)
        assert pace.reached == pytest.approx(0.4)


def test_speeds_have_bounds():
    pace = Pace()
    for _ in range(100):
        pace.scale(0.5)
    assert pace.speed == 1 / 1024
    assert pace.steps(0.1, 1e-3) == 0


@pytest.mark.parametrize("level", [0, 255], ids=["dark", "light"])
@pytest.mark.parametrize("size", [(180, 320), (40, 20), (4, 4)])
def test_the_overlay_is_legible_and_fits(level, size):
    image = np.full((*size, 3), level, dtype=np.uint8)
    overlay.draw_table(image, (("time", "1.25 s"), ("speed", "0.2 x real time")))
    overlay.draw_table(image, (("", "saved picture_000.png"),), bottom=True)
    overlay.draw_recording(image)
    overlay.draw_line(image, (10.0, 10.0), (-50.0, 1e9))
    overlay.draw_line(image, (-10.0, -10.0), (-50.0, -20.0))
    if size[0] == 180:
        panel = image[20:40, 10:200].max(axis=2)
        assert panel.max() > 220
        assert panel.min() < 80
        assert (image[5:20, -20:] == overlay.RED).all(axis=2).any()
        assert (image[100:] == level).mean() > 0.7  # the rest is left alone


def test_nothing_to_say_paints_nothing():
    image = np.zeros((40, 40, 3), dtype=np.uint8)
    overlay.draw_table(image, ())
    assert not image.any()
