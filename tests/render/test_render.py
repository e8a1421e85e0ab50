"""Pictures: what is seen where, and that the same frame gives the same picture. Small sizes: compile time dominates."""

import json
import math

import numpy as np
import pytest

import taichi_sim as ts
from taichi_sim import Box, Scene, Sphere
from taichi_sim.analysis.frame import Frame, Placed
from taichi_sim.device import backend
from taichi_sim.geometry.graph import components
from taichi_sim.render import Camera, Renderer
from taichi_sim.render.tiles import tile_lists

pytestmark = pytest.mark.once

SIZE = (160, 90)
RED, GREEN = (0.9, 0.05, 0.05), (0.05, 0.8, 0.05)
FRONT = Camera(eye=(0.0, 0.0, 10.0), target=(0.0, 0.0, 0.0), fov=30.0)


def balls(position, radius, colour=(), **more):
    position = np.asarray(position, dtype=float)
    return Frame(
        time=0.0,
        position=position,
        velocity=np.zeros_like(position),
        radius=np.broadcast_to(np.asarray(radius, dtype=float), len(position)).copy(),
        colour=np.asarray(colour, dtype=float).reshape(-1, 3),
        **more,
    )


def sheet(n, height):
    """Vertices and triangles of a square of n x n points, from -1 to 1 in x and z, at heights of (x, z)."""
    u, v = np.meshgrid(np.linspace(-1, 1, n), np.linspace(-1, 1, n), indexing="ij")
    i = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    triangles = np.concatenate([np.stack([i, i + 1, i + n], 1), np.stack([i + 1, i + n + 1, i + n], 1)])
    return np.stack([u, height(u, v), v], axis=-1).reshape(-1, 3), triangles.astype(np.int32)


def picture(frame, **options):
    with Renderer(frame, size=SIZE, **options) as renderer:
        return renderer.render(frame)


def reddish(pixel):
    r, g, b = (int(a) for a in pixel)
    return r > 1.5 * g and r > 1.5 * b


def greenish(pixel):
    r, g, b = (int(a) for a in pixel)
    return g > 1.5 * r and g > 1.5 * b


def project(point, camera=FRONT):
    """Pixel (row, column) of a point, by hand for a camera on the z axis that looks along -z."""
    focal = SIZE[1] / 2 / math.tan(math.radians(camera.fov) / 2)
    depth = camera.eye[2] - point[2]
    return SIZE[1] / 2 - focal * point[1] / depth, SIZE[0] / 2 + focal * point[0] / depth


def test_spheres_where_they_belong_and_the_nearer_hides_the_farther():
    near, far, high = (0.0, 0.0, 1.0), (0.0, 0.0, -3.0), (-1.6, 1.2, 0.0)
    frame = balls([far, near, high], [0.9, 0.5, 0.4], [GREEN, RED, GREEN])
    with Renderer(frame, size=SIZE, camera=FRONT) as renderer:
        image = renderer.render(frame)
        again = renderer.render(frame)
    assert image.shape == (SIZE[1], SIZE[0], 3)
    assert image.dtype == np.uint8
    assert np.array_equal(image, again)
    row, column = (int(a) for a in project(near))
    assert reddish(image[row, column])
    row, column = (int(a) for a in project(high))
    assert row < SIZE[1] / 2  # up is up
    assert column < SIZE[0] / 2  # right is right
    assert greenish(image[row, column])
    row, column = (int(a) for a in project((0.0, 0.75, -3.0)))  # the rim of the far one looks out behind the near one
    assert greenish(image[row, column])
    for corner in (image[0, 0], image[0, -1], image[-1, 0], image[-1, -1]):
        assert not reddish(corner)
        assert not greenish(corner)


def test_the_outline_of_a_sphere_has_the_right_size():
    frame = balls([(0.0, 0.0, 0.0)], 1.0, [RED])
    image = picture(frame, camera=FRONT).astype(float)
    covered = np.count_nonzero(image[:, :, 0] > 1.4 * image[:, :, 2])
    focal = SIZE[1] / 2 / math.tan(math.radians(FRONT.fov) / 2)
    radius = focal / math.sqrt(10.0**2 - 1.0)  # of the cone that touches the sphere
    assert covered == pytest.approx(math.pi * radius**2, rel=0.04)


def test_a_triangle_is_drawn_whichever_way_it_is_wound():
    corners = [(-1.0, -1.0, 0.0), (1.0, -1.0, 0.0), (0.0, 1.2, 0.0)]
    seen = []
    for order in ((0, 1, 2), (0, 2, 1)):
        frame = balls(corners, 0.3, [RED] * 3, triangles=np.array([order], dtype=np.int32))
        image = picture(frame, camera=FRONT, shadow=False)
        assert reddish(image[SIZE[1] // 2, SIZE[0] // 2])
        low, high = ([int(a) for a in project((-0.7, y, 0.0))] for y in (-0.8, 0.8))
        assert reddish(image[low[0], low[1]])
        assert not reddish(image[high[0], high[1]])
        seen.append(image)
    corner = [int(a) for a in project((-1.0, -1.2, 0.0))]
    assert not reddish(seen[0][corner[0], corner[1]])  # corners of triangles are not drawn as balls


def test_a_shadow_darkens_the_ground_under_a_ball():
    frame = balls([(0.0, 1.0, 0.0)], 0.5, [RED], walls=np.array([[0.0, 1.0, 0.0, 0.0]]))
    camera = Camera(eye=(0.0, 5.0, 7.0), target=(0.0, 0.5, 0.0))
    lit = picture(frame, camera=camera, shadow=False).astype(int)
    dark = picture(frame, camera=camera).astype(int)
    change = lit.sum(axis=2) - dark.sum(axis=2)
    ground = np.ptp(lit, axis=2) < 20
    shaded = ground & (change > 60)
    assert 100 < np.count_nonzero(shaded) < 0.1 * change.size
    assert np.count_nonzero(ground & (np.abs(change) <= 6)) > 0.7 * change.size  # no dirt on what is lit
    ball = lit[:, :, 0] > 2 * lit[:, :, 2]
    assert np.count_nonzero(ball) > 100
    assert np.count_nonzero(ball & (np.abs(change) > 12)) < 0.05 * np.count_nonzero(ball)  # nor on the ball itself
    columns = np.nonzero(shaded)[1]
    assert columns.mean() > SIZE[0] / 2  # the lamp is on the left


def test_the_camera_finds_the_scene_and_ignores_one_ball_far_away():
    rng = np.random.default_rng(0)
    near = rng.normal(size=(200, 3))
    camera = Camera.fit(balls(near, 0.1), aspect=16 / 9)
    stray = Camera.fit(balls(np.vstack([near, [(1e5, 0.0, 0.0)]]), 0.1), aspect=16 / 9)
    distance = np.linalg.norm(np.subtract(camera.eye, camera.target))
    assert np.linalg.norm(np.subtract(stray.eye, stray.target)) == pytest.approx(distance, rel=0.2)
    local = (near - camera.eye) @ camera.axes().T
    tall = math.tan(math.radians(camera.fov) / 2)
    screen = np.abs(local[:, :2] / local[:, 2:]) / (tall * 16 / 9, tall)
    assert np.all(screen < 1.0)
    assert screen.max() > 0.8


def with_colliders(position, radius, *shapes):
    scene = Scene(dim=3)
    for shape in shapes:
        scene.add_collider(shape)
    placed = tuple(Placed(one, one.motion.at(0.0)[0][0], one.motion.at(0.0)[1][0]) for one in scene.colliders)
    return balls(position, radius, colliders=placed)


@pytest.mark.slow
def test_a_surface_that_reaches_behind_the_eye_is_drawn_up_to_the_picture_edge():
    """Floors whose triangles have one and two corners behind the eye, at three turns: all below the horizon is theirs."""
    for turn in (0.0, 30.0, 77.0):
        floor = Box(center=(0.0, -0.5, 0.0), size=(60.0, 1.0, 60.0), rotation=(0.0, turn, 0.0), colour=RED)
        camera = Camera(eye=(0.0, 1.0, 3.0), target=(0.0, 0.5, 0.0), fov=50.0)
        rgb = picture(with_colliders([(0.0, 30.0, 0.0)], 0.1, floor), camera=camera)
        below = [[reddish(pixel) for pixel in row] for row in rgb[SIZE[1] // 2 :]]
        assert np.all(below), turn


def test_the_camera_shows_all_of_a_collider_near_the_balls_and_of_a_large_one_the_part_beside_them():
    cube = np.stack(np.meshgrid([-0.2, 0.2], [0.4, 0.8], [-0.2, 0.2]), axis=-1).reshape(-1, 3)

    def fit(size):
        return Camera.fit(with_colliders(cube, 0.1, Box((0.0, -0.05, 0.0), (size, 0.1, size))), aspect=16 / 9)

    def seen(camera, points):
        local = (points - camera.eye) @ camera.axes().T
        tall = math.tan(math.radians(camera.fov) / 2)
        return np.all(np.abs(local[:, :2] / local[:, 2:]) < (tall * 16 / 9, tall))

    for size in (0.3, 1.0, 2.0):
        camera = fit(size)
        corners = np.stack(np.meshgrid([-1, 1], [-1, 0], [-1, 1]), axis=-1).reshape(-1, 3) * (size / 2, 0.1, size / 2)
        assert seen(camera, corners)
        assert seen(camera, cube)
    near, far = fit(8.0), fit(800.0)
    assert near.eye == pytest.approx(far.eye)
    assert seen(far, cube)
    assert np.linalg.norm(np.subtract(far.eye, far.target)) < np.linalg.norm(np.subtract(camera.eye, camera.target))


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.slow_where(dim=3)
def test_odd_frames_are_drawn(dim):
    ground = np.eye(dim + 1)[1:2] * 1.0
    rods = np.array([[0, 1], [2, 2], [1, 2]], dtype=np.int32)
    frame = balls(np.full((3, dim), 1e9), 0.2, [(np.nan,) * 3] * 3, springs=rods, sticks=rods[:, 0] > 0, walls=ground)
    with Renderer(frame, size=SIZE) as renderer:
        assert np.ptp(renderer.render(frame)) > 20
        more = balls(np.zeros((7, dim)), 1e-3, walls=ground, triangles=np.zeros((1, 3), dtype=np.int32))
        assert renderer.render(more).shape == (SIZE[1], SIZE[0], 3)  # allocates again
    empty = picture(balls(np.zeros((0, dim)), 0.0))
    assert empty.shape == (SIZE[1], SIZE[0], 3)


def test_a_sphere_around_the_eye_is_left_out():
    frame = balls([(0.0, 0.0, 10.0), (0.0, 0.0, 9.5), (0.0, 0.0, 0.0)], [1.0, 1.0, 0.5], [GREEN, GREEN, RED])
    image = picture(frame, camera=FRONT)
    assert reddish(image[SIZE[1] // 2, SIZE[0] // 2])
    assert not greenish(image[0, 0])


def disc_picture(radius, colour=RED, **more):
    frame = balls([(0.0, 0.0), (3.0, 0.0)], [radius, radius], [colour] * 2, **more)
    return frame, picture(frame, background=(1.0, 1.0, 1.0))


def test_the_area_of_a_disc():
    from taichi_sim.render.renderer2d import Renderer2D

    frame, image = disc_picture(0.7, colour=(0.0, 0.0, 0.0))
    assert tuple(image[0, 0]) == (255, 255, 255)
    left = image[:, : SIZE[0] // 2, 0].astype(float) / 255
    linear = np.where(left <= 0.04045, left / 12.92, ((left + 0.055) / 1.055) ** 2.4)
    painter = Renderer2D(frame, SIZE)
    scale = painter.camera.scale
    painter.close()
    body = np.pi * (0.7 * scale) ** 2
    dark = np.clip(1.0 - linear, 0, 1)
    dark[dark > 0.9] = 1.0  # a black disc still has a faint light on it
    assert dark.sum() == pytest.approx(body, rel=0.01)


def test_walls_and_strain_in_a_flat_picture():
    points = [(-2.0, 0.5), (0.0, 0.5), (2.0, 0.5)]
    springs = np.array([[0, 1], [1, 2]], dtype=np.int32)
    frame = balls(
        points,
        0.3,
        springs=springs,
        sticks=np.zeros(2, dtype=bool),
        strain=np.array([0.3, -0.3]),
        walls=np.array([[0.0, 1.0, 0.0]]),
    )
    image = picture(frame).astype(int)
    row = image[:, :, 0].shape[0]
    assert image[0].sum() > image[row - 3].sum() * 1.1  # the ground is darker, and below
    stretched = image[:, : SIZE[0] // 2].reshape(-1, 3)
    pressed = image[:, SIZE[0] // 2 :].reshape(-1, 3)
    assert np.any((stretched[:, 0] > 150) & (stretched[:, 2] < 70) & (stretched[:, 1] < 70))
    assert np.any((pressed[:, 2] > 140) & (pressed[:, 0] < 70) & (pressed[:, 1] < 120))


def test_bodies_are_connected_sets_of_balls():
    label = components(7, np.array([[5, 6], [1, 2], [2, 5], [0, 4]]))
    assert label.tolist() == [0, 1, 1, 3, 0, 1, 1]


def placed(shape, dim):
    """One collider of a scene where it stands at the start."""
    scene = Scene(dim=dim)
    scene.add_collider(shape)
    centre, rotation = scene.colliders[0].motion.at(0.0)
    return Placed(scene.colliders[0], centre[0], rotation[0])


def test_colliders_in_a_flat_picture():
    """A red box turned by 45 degrees and a green ring, each in its place; the balls fix the view."""
    shapes = [Box((0, 0), (1, 1), rotation=45, colour=RED), Sphere((2, 0), 0.4, hollow=0.2, colour=GREEN)]
    frame = balls([(-1.0, -1.0), (3.0, 1.0)], 0.1, [RED, RED], colliders=tuple(placed(s, 2) for s in shapes))
    image = picture(frame)
    scale = (SIZE[0] - 2 * 0.06 * SIZE[0]) / 4.2  # px per m; the picture is as wide as the scene

    def at(x, y):
        return image[int(SIZE[1] / 2 - y * scale), int(SIZE[0] / 2 + (x - 1) * scale)]

    for spot in ((0, 0), (0.55, 0), (0, 0.55)):
        assert reddish(at(*spot))
    for spot in ((0.45, 0.45), (2, 0), (2.75, 0)):
        assert not reddish(at(*spot))
        assert not greenish(at(*spot))
    for spot in ((2.5, 0), (2, -0.5)):
        assert greenish(at(*spot))


def test_colliders_in_a_picture_in_space():
    """A red box hides the ball behind it; one looks into a green hollow sphere and sees the ball within."""
    shapes = [Box((-1.5, 0, 0), (1, 1, 1), colour=RED), Sphere((1.0, 0, 0), 0.9, hollow=0.1, colour=GREEN)]
    places = [(-1.5, 0.0, -2.0), (1.0, 0.0, 0.0)]
    frame = balls(places, 0.3, [GREEN, RED], colliders=tuple(placed(s, 3) for s in shapes))
    image = picture(frame, camera=FRONT)
    for point, right in (((-1.5, 0.0, 0.5), reddish), ((1.0, 0.0, 0.0), reddish), ((1.0, 0.6, 0.0), greenish)):
        row, column = (int(a) for a in project(point))
        assert right(image[row, column])


def test_tiles_list_every_box_once_in_drawing_order():
    rng = np.random.default_rng(1)
    low = rng.uniform(-20, 100, size=(60, 2))
    high = low + rng.uniform(0, 50, size=(60, 2))
    high[::5] = 16.0 * np.ceil(high[::5] / 16.0)  # at the border of a tile, which they touch
    entry, start = tile_lists(low, high, (100, 70), 16)
    for ty in range(5):
        for tx in range(7):
            tile = ty * 7 + tx
            first, end = np.array([tx, ty]) * 16.0, np.array([tx + 1, ty + 1]) * 16.0
            touching = np.flatnonzero(np.all((high >= first) & (low < end), axis=1))
            assert entry[start[tile] : start[tile + 1]].tolist() == touching.tolist()


def test_bad_arguments_are_refused():
    frame = balls(np.zeros((1, 3)), 1.0)
    with pytest.raises(ValueError, match="size"):
        Renderer(frame, size=(0, 10))
    with pytest.raises(ValueError, match="background"):
        Renderer(frame, size=SIZE, background=(1.0, 0.0))
    with pytest.raises(ValueError, match="camera"):
        Renderer(frame, size=SIZE, camera=Camera((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)))


def linear(image):
    c = image.astype(float) / 255
    return np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.slow_where(dim=3)
def test_a_transparent_picture_laid_over_a_background_is_the_opaque_one(dim):
    """Straight alpha, also where a pixel is covered in part; the ground is holdout, colliders are drawn."""
    grey = (0.3, 0.3, 0.3)
    points = np.array([(0.0, 0.3, 0.0), (1.5, 0.9, -1.0), (-1.5, -1.0, 0.0)])[:, :dim]
    triangles = np.array([[0, 1, 2]], dtype=np.int32)
    wall = np.eye(dim + 1)[1:2] - np.eye(dim + 1)[-1:]  # the ground at y = -1
    box = (placed(Box((-2.0, 1.0, 0.0)[:dim], (0.5,) * dim, colour=RED), dim),)
    options = {"background": grey} | ({"camera": FRONT, "shadow": False} if dim == 3 else {})
    frame = balls(
        [*points, np.zeros(dim) - 0.6], [0.4] * 4, [RED, GREEN, RED, GREEN], triangles=triangles, colliders=box
    )
    opaque, clear = picture(frame, **options), picture(frame, transparent=True, **options)
    assert clear.shape == (SIZE[1], SIZE[0], 4)
    alpha = clear[:, :, 3:] / 255
    laid = linear(clear[:, :, :3]) * alpha + linear(np.full(3, round(0.3 * 255))) * (1 - alpha)
    assert np.abs(laid - linear(opaque)).max() < 0.025
    assert np.count_nonzero((alpha > 0.1) & (alpha < 0.9)) > 50
    assert np.all(clear[alpha[:, :, 0] == 0] == 0)
    frame.walls = wall
    above = picture(frame, transparent=True, **options)
    assert above[-1, :, 3].max() == 0
    assert above[0, 0, 3] == 0


@pytest.mark.slow
def test_a_caught_shadow_darkens_what_is_under_the_picture():
    """Laid over the picture of a ground in all light, it is as bright as that with shadows, of the lamp and of the sky."""
    frame = balls([(0.0, 0.5, 0.0), (1.2, 0.3, 0.4)], [0.5, 0.3], [RED, GREEN], walls=np.array([[0.0, 1.0, 0.0, 0.0]]))
    camera = Camera(eye=(0.0, 2.0, 6.0), target=(0.3, 0.4, 0.0), fov=35.0)
    lit, shaded = (picture(frame, camera=camera, shadow=dark, ambient_occlusion=dark) for dark in (False, True))
    plain, caught = (picture(frame, camera=camera, transparent=True, shadow_catcher=on) for on in (False, True))
    alpha = caught[:, :, 3:] / 255
    laid = linear(caught[:, :, :3]) * alpha + linear(lit) * (1 - alpha)
    ground = plain[:, :, 3] == 0
    assert np.abs((laid - linear(shaded)).mean(axis=2))[ground].max() < 0.02  # black has not the blue of the sky
    assert np.count_nonzero(alpha[ground] > 0.2) > 80
    assert np.all(caught[ground][:, :3] == 0)
    assert np.array_equal(caught[plain[:, :, 3] == 255], plain[plain[:, :, 3] == 255])


@pytest.mark.slow
def test_a_picture_alone_is_the_one_of_a_run():
    """Whatever was drawn before, from elsewhere or coarser: sky and ground are kept, and only what was drawn on is cleared."""
    random = np.random.default_rng(4)
    walls = np.array([[0.0, 1.0, 0.0, -1.5], [0.6, 0.8, 0.0, -1.4]])
    frames = [balls(random.uniform(-0.8, 0.8, (40, 3)), 0.15, walls=walls) for _ in range(3)]
    for frame in frames:
        frame.position[:2] = (-1, -1, -1), (1, 1, 1)
        frame.triangles = np.arange(9, dtype=np.int32).reshape(3, 3)
    options = {"size": SIZE, "ambient_occlusion": True}
    aside = Camera(eye=(4.0, 1.0, 4.0), target=(0.0, 0.0, 0.0))
    with Renderer(frames[0], camera=FRONT, **options) as renderer:
        renderer.render(frames[1], coarse=2)
        renderer.render(frames[2])
        renderer.camera = aside
        there = renderer.render(frames[1])
        renderer.camera = FRONT
        here = renderer.render(frames[1])
    for camera, picture_of_run in ((aside, there), (FRONT, here)):
        with Renderer(frames[0], camera=FRONT, **options) as renderer:
            renderer.camera = camera
            assert np.array_equal(renderer.render(frames[1]), picture_of_run)


def test_shadows_of_what_rests_do_not_flicker_while_something_moves():
    """The shadow map stays put while the scene keeps within its bounds."""
    ground = np.array([[0.0, 1.0, 0.0, 0.0]])
    frames = [balls([(-1.5, 0.5, 0.0), (1.5, 0.5 + 0.01 * k, 0.0)], 0.4, [RED, GREEN], walls=ground) for k in (0, 1, 2)]
    frames[0].position[0, 1] = 0.9  # so that the picture has room
    seen = []
    with Renderer(frames[0], size=SIZE) as renderer:
        for frame in frames[1:]:
            seen.append(renderer.render(frame).astype(int))
    changed = np.abs(seen[1] - seen[0]).sum(axis=2) > 0
    assert changed.any()
    assert not changed[:, : SIZE[0] // 2 - 8].any()


def test_a_ball_that_is_flung_away_takes_no_detail_from_shadows():
    """Beyond the camera's distance from its target the map of shadows does not grow with it."""
    ground, above = np.array([[0.0, 1.0, 0.0, 0.0]]), Camera(eye=(0.0, 3.0, 8.0), target=(0.0, 0.5, 0.0))

    def frame(x: float) -> Frame:
        return balls([(0.0, 0.5, 0.0), (x, 0.5, 0.0)], 0.4, [RED, GREEN], walls=ground)

    with Renderer(frame(1.0), SIZE, camera=above) as renderer:
        seen = [renderer.render(frame(x)) for x in (60.0, 70.0, 300.0)]
    with Renderer(frame(1.0), SIZE, camera=above, shadow=False) as renderer:
        assert (renderer.render(frame(60.0)) != seen[0]).any()
    np.testing.assert_array_equal(seen[0], seen[1])
    np.testing.assert_array_equal(seen[0], seen[2])


@pytest.mark.slow
def test_a_collider_in_sight_has_a_shadow_where_balls_are_few():
    scene = Scene(dim=3)
    scene.add_balls([[0.6, 0.1, 0.3]], radius=0.05)
    scene.add_wall((0, 1, 0))
    scene.add_collider(Box((0.0, 0.6, 0.0), (0.8, 0.05, 0.5)))
    scene.output = {"camera": {"eye": [0.8, 1.2, 3.2], "target": [0.0, 0.5, 0.0]}}
    dark, plain = (np.asarray(ts.picture(scene, size=SIZE, shadow=shadow)).astype(int) for shadow in (True, False))
    assert (np.abs(dark - plain).max(axis=2) > 30).mean() > 0.01
    other = np.asarray(ts.picture(scene, size=SIZE, shadow=False, camera={"azimuth": 0.0})).astype(int)
    assert (np.abs(other - plain).max(axis=2) > 30).mean() > 0.01  # the camera was that of scene.output


@pytest.mark.slow
@pytest.mark.parametrize("dim", [2, 3])
def test_what_tears_is_drawn_without_new_fields(dim):
    """Fewer springs and triangles fit where more were; new fields would compile all kernels again."""
    x = np.random.default_rng(0).uniform(-1, 1, (12, dim))
    springs = np.array([[0, 1], [1, 2], [2, 3], [3, 4]], dtype=np.int32)
    triangles = np.array([[5, 6, 7], [6, 7, 8], [9, 10, 11]], dtype=np.int32)

    def frame(m: int, t: int) -> Frame:
        rods = {"springs": springs[:m], "sticks": np.zeros(m, dtype=bool), "strain": np.zeros(m)}
        return Frame(0.0, x, 0 * x, np.full(12, 0.1), triangles=triangles[:t], **rods)

    with Renderer(frame(4, 3), size=SIZE) as renderer:
        whole = renderer.render(frame(4, 3))
        buffers = renderer.buffers
        torn = renderer.render(frame(2, 1))
        assert renderer.buffers is buffers
        assert not np.array_equal(torn, whole)
        assert np.array_equal(renderer.render(frame(4, 3)), whole)
    with Renderer(frame(2, 1), size=SIZE) as renderer:
        assert np.array_equal(renderer.render(frame(2, 1)), torn)


@pytest.mark.slow_where(dim=3)
@pytest.mark.parametrize("dim", [2, 3])
def test_a_renderer_goes_on_from_what_another_remembers(dim):
    """The camera follows, the light's box has grown, and a spring has torn."""
    random = np.random.default_rng(3)
    start, drift = random.uniform(-1, 1, (9, dim)), random.uniform(-1, 1, (9, dim))
    springs = np.array([[0, 1], [1, 2], [2, 3]], dtype=np.int32)

    def frame(k: int) -> Frame:
        kept = springs[: 3 if k < 4 else 2]
        rods = {"springs": kept, "sticks": np.zeros(len(kept), dtype=bool), "strain": np.zeros(len(kept))}
        return Frame(0.1 * k, start + 0.1 * k * k * drift, drift, np.full(9, 0.3), **rods)

    options = {"size": SIZE, "camera": {"follow": [4, 5]}}
    with Renderer(frame(0), **options) as renderer:
        drawn = [renderer.render(frame(k)) for k in range(4)]
        memory = json.loads(json.dumps(renderer.memory()))
        drawn += [renderer.render(frame(k)) for k in range(4, 7)]
    with Renderer(frame(0), **options) as renderer:
        renderer.recall(memory)
        renderer.skip(frame(4))
        assert np.array_equal(renderer.render(frame(5)), drawn[5])
        assert np.array_equal(renderer.render(frame(6)), drawn[6])


def test_pixels_of_many_small_triangles_keep_their_light():
    """Samples that may share their shading are weighed whole: of three, the outer ones may be alike to the middle one only."""
    flat, triangles = sheet(33, lambda u, v: 0.0 * u)
    x = np.outer(flat[:, 0], (1.6, 0, 0)) + np.outer(flat[:, 2], (0, 1, -3))  # steep: depths of neighbours differ
    frame = balls(x, 0.0, triangles=triangles[:, ::-1])
    inside = linear(picture(frame, camera=FRONT, shadow=False))[36:64, 64:96]
    assert np.ptp(inside.mean(axis=2)) < 0.02


@pytest.mark.slow
def test_a_small_picture_has_the_light_of_a_large_one():
    """A wavy sheet does not lie in its own shadow where pixels are larger than its folds are deep."""
    folded, triangles = sheet(81, lambda u, v: 0.08 * np.sin(7 * u + 2 * v) - 3.0 * v)
    x = folded[:, [0, 2, 1]] * (1.6, 1.0, 1.0)
    frame = Frame(0.0, x, 0 * x, np.zeros(len(x)), triangles=triangles[:, ::-1])
    seen = []
    for factor in (1, 4):
        with Renderer(frame, size=(SIZE[0] * factor, SIZE[1] * factor), camera=FRONT) as renderer:
            large = linear(renderer.render(frame)).reshape(SIZE[1], factor, SIZE[0], factor, 3)
            seen.append(large.mean(axis=(1, 3)))
    inside = np.abs(seen[0] - seen[1]).max(axis=2)[30:60, 50:110]
    assert seen[1][30:60, 50:110].std() > 0.02  # it is wavy
    assert np.mean(inside > 0.05) < 0.1  # where a pixel holds a fold; 0.8 with such shadows


@pytest.mark.slow
def test_without_64_bit_numbers_the_picture_is_the_same(monkeypatch):
    """Two stages of 32 bits, as on most GPUs, in a scene of all that is drawn, with shadows and occlusion."""
    rng = np.random.default_rng(5)
    frame = balls(rng.uniform(-0.5, 0.5, (60, 3)), 0.12, walls=np.array([[0.0, 1.0, 0.0, -0.6]]))
    frame.triangles = np.arange(60).reshape(20, 3)
    frame.springs = np.stack([np.arange(0, 60, 2), np.arange(1, 60, 2)], axis=1)
    wide = picture(frame)
    monkeypatch.setattr(backend, "has_wide_numbers", lambda: False)
    narrow = picture(frame)
    np.testing.assert_array_equal(narrow, wide)
