"""Light and looks: sharp edges where they are, both sides of a sheet, edges without steps."""

from typing import get_args

import numpy as np
import pytest
from PIL import Image
from taichi_sim.kernels.render import shading_pass
from test_embedded_surfaces import frame_of
from test_render import FRONT, GREEN, RED, SIZE, balls, greenish, linear, picture, placed, reddish, sheet

from taichi_sim import Box, Capsule, Mesh, Scene, SceneError, load_scene, shapes
from taichi_sim.analysis.lazy_frame import MomentsOf
from taichi_sim.files.toml_settings import Output
from taichi_sim.render import Camera, Renderer
from taichi_sim.render.content import Content
from taichi_sim.render.smoothing import Smoothing
from taichi_sim.render.stages import STAGES
from taichi_sim.scene.looks import Look

pytestmark = pytest.mark.once


# Sharp edges --------------------------------------------------------------------------------------------------------


def test_a_cube_has_six_smooth_parts():
    scene = Scene(dim=3)
    cube = shapes.jelly(scene, size=(1, 1, 1), resolution=(4, 4, 4))
    for crease, parts, normals in ((40.0, 6, 6 * 16), (100.0, 1, 56)):
        found = Smoothing.of(scene.position, cube.triangles, crease)
        assert len(np.unique(found.part)) == parts
        assert found.normals == normals
        assert found.part.shape == (len(cube.triangles),)
        assert not found.sheet.any()
    for t, normals in zip(cube.triangles, Smoothing.of(scene.position, cube.triangles, 40.0).normal_of):
        same = np.flatnonzero((cube.triangles == t[0]).any(axis=1))
        assert len(same) >= 2
        assert len(set(normals.tolist())) == 3


def test_where_an_edge_is_sharp():
    """Two triangles at an angle, wound alike or not; a third one at their edge; a border makes a sheet."""
    angle = np.radians(50.0)
    points = np.array([[0, 0, 0], [0, 0, 1], [1, 0, 0], [-np.cos(angle), np.sin(angle), 0], [0, -1, 0]])
    pair = np.array([[0, 1, 2], [1, 0, 3]])
    for triangles, crease, normals in (
        (pair, 49.0, 6),
        (pair, 51.0, 4),
        (np.array([[0, 1, 2], [0, 1, 3]]), 180.0, 6),
        (np.vstack([pair, [[0, 1, 4]]]), 180.0, 9),
    ):
        found = Smoothing.of(points, triangles, crease)
        assert found.normals == normals
        assert found.sheet.all()
    assert Smoothing.of(points, pair, 49.0, np.array([True, True])).normals == 4


def test_a_folded_cloth_and_a_finer_surface_are_smooth():
    """Sharp is what is sharp at rest: a rectangular cloth never, whatever the first frame shows."""
    scene = Scene(dim=3)
    shapes.cloth(scene, size=(1, 1), resolution=(5, 5))
    x = scene.position + np.where(np.arange(25) // 5 % 2 == 0, 0.0, 1.0)[:, None] * (0, 1, 0)
    frame = frame_of(scene, x)
    assert Content.of(frame, 1.0).smoothing.normals == 4 * 10  # four strips
    frame.objects = tuple(scene.objects)
    assert Content.of(frame, 1.0).smoothing.normals == 25
    scene = Scene(dim=3)
    shapes.jelly(scene, size=(1, 1, 1), resolution=(3, 3, 3))
    assert Content.of(frame_of(scene), 1.0).smoothing.normals == 6 * 9
    assert len(np.unique(Content.of(frame_of(scene), 1.0, 1).smoothing.part)) == 1


@pytest.mark.slow
def test_folds_along_a_diagonal_of_cloth_have_no_teeth():
    """Waves along a diagonal of the squares, which are cut across it in every other row: light is even along each wave. It
    varied by 0.012 with normals of each vertex's own triangles."""
    scene = Scene(dim=3)
    shapes.cloth(scene, size=(2, 2), resolution=(31, 31), position=(-1, 0, -1), rotation=(0, 45, 0), material="silk")
    frame = frame_of(scene)
    frame.objects = tuple(scene.objects)
    x = frame.position - frame.position.mean(axis=0)
    x[:, 1] = 0.03 * np.cos(2 * np.pi * x[:, 2] / 0.28)
    frame.position = x
    camera = Camera(eye=(0.0, 4.0, 3.0), target=(0.0, 0.0, 0.0), fov=8.0)
    seen = linear(picture(frame, camera=camera, shadow=False, ambient_occlusion=False)).mean(axis=2)[10:80, 30:130]
    assert seen.std(axis=1).max() < 0.008


def test_faces_of_a_block_are_evenly_lit():
    """The block is turned; seen from the front, two faces, each of one brightness, with nothing between them."""
    scene = Scene(dim=3)
    shapes.jelly(scene, size=(2, 2, 2), resolution=(3, 3, 3), rotation=(0, 45, 0), colour=RED)
    frame = frame_of(scene)
    middle = frame.position.mean(axis=0)
    camera = Camera(eye=(middle[0], middle[1], middle[2] + 1000.0), target=tuple(middle), fov=0.25)
    seen = {}
    for crease in (40.0, 180.0):
        image = linear(picture(frame, camera=camera, shadow=False, crease=crease))[30:60]
        left, right = image[:, 55:76, 0], image[:, 84:105, 0]
        seen[crease] = left.std(), right.std(), abs(left.mean() - right.mean())
    assert max(seen[40.0][:2]) < 0.01
    assert seen[40.0][2] > 0.05
    assert min(seen[180.0][:2]) > 0.02


def test_edges_between_faces_have_no_steps():
    """The upper edge of a box's front, a little slanted on the screen, is mixed from both faces."""
    box = placed(Box((0, -1, 0), (4, 1.4, 2), rotation=(0, 8, 0)), 3)
    frame = balls(np.array([[-2.0, -2, 0], [2, 1, 0]]), 0.01, [GREEN] * 2, colliders=(box,))
    camera = Camera(eye=(0, 4, 10), target=(0, -1, 0), fov=30.0)
    columns = linear(picture(frame, camera=camera, shadow=False))[:, 55:100, 1]
    front, top = columns[50], columns[34]
    assert np.all(top > front + 0.1)
    covered = (columns[34:50] - front) / (top - front)  # by the top
    between = np.any((covered > 0.15) & (covered < 0.85), axis=0)
    assert between.mean() > 0.5  # with steps, no column


# Sheets -------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_underside_of_a_sheet_is_neither_black_nor_flat():
    """Seen from below, the lamp above it: light comes through, and shows folds; not so through a closed block."""
    x, triangles = sheet(33, lambda u, v: 0.06 * np.sin(9 * u + 2 * v))
    frame = balls(x, 0.0, np.tile((0.2, 0.45, 0.7), (len(x), 1)), triangles=triangles)
    seen = []
    for height in (5.0, -5.0):
        camera = Camera(eye=(0.0, height, 3.0), target=(0.0, 0.0, 0.0), fov=20.0)
        seen.append(linear(picture(frame, camera=camera))[30:60, 60:100].mean(axis=2))
    above, below = seen
    assert below.mean() > 0.35 * above.mean()
    assert below.std() > 0.08 * below.mean()


# Shadows ------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_edge_of_a_shadow_has_no_notches():
    """A capsule over the ground, seen from low: the straight edges of its shadow are straight in a small picture."""
    capsule = placed(Capsule((-1.5, 0.2, 0.6), (1.5, 0.9, -0.6), 0.2), 3)
    ground = np.array([[0.0, 1.0, 0.0, 0.0]])
    frame = balls(np.array([[-2.0, 0.1, -0.5], [2, 0.1, 0.5]]), 0.01, [GREEN] * 2, colliders=(capsule,), walls=ground)
    seen, size = [], (640, 360)
    for shadow in (False, True):
        camera = Camera(eye=(0.5, 1.7, 5.0), target=(0.5, 0.2, 0.0), fov=22.0)
        with Renderer(frame, size=size, camera=camera, shadow=shadow) as renderer:
            seen.append(linear(renderer.render(frame)).mean(axis=2))
    share = np.clip(seen[1] / seen[0], 0.0, 1.0)[:, 220:460]
    share = (share - share.min()) / (1 - share.min())
    column = np.arange(share.shape[1])
    for level in (0.2, 0.5, 0.85):
        row = len(share) - 1 - np.argmax(share[::-1] < level, axis=0)  # the near edge, below the capsule
        low, high = share[row + 1, column], share[row, column]
        place = row + (level - high) / (low - high)
        fit = np.polyval(np.polyfit(column, place, 2), column)
        assert np.abs(place - fit).max() < 0.6  # px; notches were more than one deep


def post(sections, around=40):
    """A post in slim triangles, so many of them one above the other."""
    turn = 2 * np.pi * np.arange(around) / around
    ring = np.stack([0.15 * np.cos(turn), np.zeros(around), 0.15 * np.sin(turn)], axis=1)
    vertices = np.concatenate(
        [ring + np.array([0, y, 0]) for y in np.linspace(0.0, 1.2, sections + 1)] + [[[0, 0, 0], [0, 1.2, 0]]]
    )
    here = np.arange((sections + 1) * around).reshape(sections + 1, around)
    after = np.roll(here, -1, axis=1)
    parts = [(here[:-1], here[1:], after[:-1]), (after[:-1], here[1:], after[1:])]
    parts += [(here[0], after[0], np.full(around, here.size)), (after[-1], here[-1], np.full(around, here.size + 1))]
    return vertices, np.concatenate([np.stack([corner.ravel() for corner in part], axis=1) for part in parts])


@pytest.mark.long
def test_slim_triangles_are_shaded_as_those_they_are_cut_into():
    """The shadow of a slab on a post: the point that a pixel shows does not slide along a triangle whose side it lies beside."""
    slab = placed(Box((-0.95, 1.35, 0.6), (1.4, 0.2, 1.4), rotation=(0, 30, 0), colour=RED), 3)
    camera, seen = Camera(eye=(0.3, 1.1, 4.0), target=(0.0, 0.6, 0.0), fov=22.0), []
    for sections in (1, 24):
        colliders = (slab, placed(Mesh(post(sections), colour=(0.9, 0.7, 0.3)), 3))
        frame = balls(np.array([[-1.5, 0.1, -1.0], [1.5, 0.1, 1.0]]), 0.01, [GREEN] * 2, colliders=colliders)
        with Renderer(frame, size=(320, 180), camera=camera) as renderer:
            seen.append(renderer.render(frame).astype(int))
    off = np.abs(seen[0] - seen[1]).max(axis=2)
    lit = seen[1][30:150, 145:175].sum(axis=2)
    assert np.ptp(lit) > 100  # part of the post lies in shadow
    assert off.max() < 12


# The sky -------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_less_of_the_sky_is_seen_where_a_wall_meets_the_ground():
    """It is darker there, evenly along the wall and ever less away from it; far away nothing changes."""
    box = placed(Box((0, 0.6, -1.0), (6, 1.2, 1.0)), 3)
    ground = np.array([[0.0, 1.0, 0.0, 0.0]])
    frame = balls(np.array([[-2.0, 0.1, 2.0], [2, 0.1, 2.0]]), 0.01, [GREEN] * 2, colliders=(box,), walls=ground)
    camera, seen = Camera(eye=(0.0, 2.0, 5.0), target=(0.0, 0.3, 0.0), fov=40.0), []
    for on in (False, True):
        with Renderer(frame, size=(320, 180), camera=camera, shadow=False, ambient_occlusion=on) as renderer:
            seen.append(linear(renderer.render(frame)).mean(axis=2))
    share = (seen[1] / seen[0])[:, 120:200]
    foot = 90 + np.argmin(share[90:130].mean(axis=1))
    along, away = share[foot:].mean(axis=1), share[foot + 40 :]
    assert along[0] < 0.92
    assert np.all(np.diff(along[:30:3]) > -0.005)
    assert share[foot : foot + 30].std(axis=1).max() < 0.02
    assert np.abs(away - 1).max() < 0.01


@pytest.mark.slow
def test_tiles_of_plain_ground_are_as_if_they_were_shaded(monkeypatch):
    """Those with neither anything drawn on them nor less of the lamp or of the sky are copied."""
    frame = balls([(0.0, 0.5, 0.0), (1.2, 0.3, 0.4)], [0.5, 0.3], [RED, GREEN], walls=np.array([[0.0, 1.0, 0.0, 0.0]]))
    camera, find_busy = Camera(eye=(0.0, 2.0, 8.0), target=(0.3, 0.4, 0.0), fov=60.0), shading_pass.find_busy
    copied, busy = picture(frame, camera=camera), []

    def all_busy(scene, *given):
        find_busy(scene, *given)
        busy.append(scene.busy.to_numpy().mean())
        scene.busy.fill(1)

    monkeypatch.setattr(shading_pass, "find_busy", all_busy)
    assert np.array_equal(picture(frame, camera=camera), copied)
    assert 0.05 < busy[0] < 0.8


# Stages -------------------------------------------------------------------------------------------------------------


@pytest.mark.slow_where(dim=3)
@pytest.mark.parametrize("dim", [2, 3])
def test_stages_and_a_background_over_each(dim):
    """Bright, dark and blue; what is in front of a background of one's own keeps the stage's light."""
    frame = balls(np.eye(3)[:, :dim], 0.5, [RED] * 3)
    options = {"camera": FRONT} if dim == 3 else {}
    corner, middle = {}, {}
    for stage in STAGES:
        for background in (None, (0.1, 0.5, 0.1)):
            image = picture(frame, stage=stage, background=background, **options)
            corner[stage, background is None], middle[stage, background is None] = image[0, 0], image[45, 80]
        assert np.all(np.abs(corner[stage, False].astype(int) - (26, 128, 26)) <= 2)
    assert corner["day", True].min() > 130
    assert corner["paper", True].min() > 130
    assert corner["dusk", True][0] > corner["dusk", True][2] or dim == 2
    assert corner["studio", True].max() < 60
    assert corner["blueprint", True][2] > 2 * corner["blueprint", True][0]
    if dim == 3:
        assert np.array_equal(middle["studio", True], middle["studio", False])
        assert not np.array_equal(middle["studio", True], middle["day", True])


def test_scene_files_know_all_stages():
    assert get_args(Output.model_fields["stage"].annotation) == tuple(STAGES)


def test_a_blueprint_has_lines_at_outlines_and_sharp_edges():
    box = placed(Box((0, 0, 0), (3, 2, 2), rotation=(0, 30, 0)), 3)
    frame = balls(np.array([[-2.0, -2, 0], [2, 2, 0]]), 0.01, [GREEN] * 2, colliders=(box,))
    row = linear(picture(frame, camera=FRONT, stage="blueprint"))[45].mean(axis=1)
    bright = np.flatnonzero(row > 1.5 * np.median(row[70:76]))
    groups = np.split(bright, np.flatnonzero(np.diff(bright) > 1) + 1)
    assert len(groups) == 3  # two outlines and the edge between the faces
    assert max(len(group) for group in groups) <= 2


# Looks --------------------------------------------------------------------------------------------------------------


def upright(**more):
    """A cloth of 2 x 2 m, white, that stands upright and faces the camera, called flag."""
    scene = Scene(dim=3)
    sheet = shapes.cloth(
        scene, size=(2, 2), resolution=(9, 9), rotation=(90, 0, 0), position=(-1, 1, 0), colour=(1, 1, 1), **more
    )
    scene.set_name(sheet.balls, "flag")
    frame = frame_of(scene)
    frame.objects = tuple(scene.objects)
    return frame


@pytest.mark.slow
def test_stripes_and_checks_on_a_cloth():
    frame, dark = upright(), (0.0, 0.0, 0.0)
    seen = {}
    for pattern in ("plain", "stripes", "checks"):
        look = {"of": "flag", "pattern": pattern, "pattern_colour": dark}
        look |= {} if pattern == "plain" else {"repeat": 2}
        image = linear(picture(frame, camera=FRONT, shadow=False, looks=[look])).mean(axis=2)
        seen[pattern] = image[30:60, 66:94] > 0.3
    assert seen["plain"].all()
    for pattern in ("stripes", "checks"):
        assert 0.35 < seen[pattern].mean() < 0.65
    assert np.all(seen["stripes"] == seen["stripes"][0])  # along the columns
    assert np.count_nonzero(np.diff(seen["checks"][7])) >= 2
    assert np.count_nonzero(np.diff(seen["checks"][:, 5])) >= 2


@pytest.mark.slow
def test_a_weave_has_threads_near_by_and_their_mean_far_away():
    frame, seen = upright(), {}
    for pattern in ("plain", "weave"):
        look = {"of": "flag", "pattern": pattern} | ({} if pattern == "plain" else {"repeat": 20})
        for distance in (4.0, 80.0):
            camera = Camera(eye=(0.0, 0.0, distance), target=(0.0, 0.0, 0.0), fov=120.0 / distance)
            image = linear(picture(frame, camera=camera, shadow=False, looks=[look | {"hem": 0.0}]))
            seen[pattern, distance] = image[30:60, 60:100].mean(axis=2)
        for repeat in (23, 1000):  # 0.7 and 30 threads in a pixel
            look |= {} if pattern == "plain" else {"repeat": repeat}
            image = linear(picture(frame, camera=FRONT, shadow=False, looks=[look]))
            seen[pattern, repeat] = image[30:60, 66:94]
    near, plain = seen["weave", 4.0], seen["plain", 4.0]
    assert near.std() > 0.08
    assert near.mean() == pytest.approx(plain.mean(), rel=0.15)
    for repeat, most in ((23, 0.03), (1000, 0.01)):
        assert np.abs(seen["weave", repeat] - seen["plain", repeat]).max() < most


@pytest.mark.slow
def test_a_hem_is_darker_and_lets_less_light_through():
    """Seen in front of the lamp: along the borders, as wide as it is said to be."""
    frame = upright()
    behind = Camera(eye=(2.0, -3.0, -9.0), target=(0.0, 0.0, 0.0), fov=20.0)
    plain, hemmed = (
        linear(picture(frame, camera=behind, looks=[{"of": "flag", "hem": wide}])).mean(axis=2) for wide in (0.0, 0.2)
    )
    changed = hemmed < 0.95 * plain
    middle = np.argwhere(plain != hemmed).mean(axis=0).astype(int)
    assert np.count_nonzero(changed) > 300
    assert not changed[middle[0] - 3 : middle[0] + 4, middle[1] - 3 : middle[1] + 4].any()


@pytest.mark.slow
def test_light_comes_through_a_body_the_more_the_thinner_it_is():
    """A wall of jelly before the lamp: nothing without translucency, and more where its way is shorter."""
    seen = {}
    for depth in (0.2, 0.8):
        scene = Scene(dim=3)
        wall = shapes.jelly(
            scene, size=(2, 2, depth), resolution=(5, 5, 3), position=(-1, -1, 0), colour=(0.8, 0.6, 0.2)
        )
        scene.set_name(wall.balls, "wall")
        frame = frame_of(scene)
        frame.objects = tuple(scene.objects)
        first = Camera(eye=(0.0, 0.0, 10.0), target=(0.0, 0.0, 0.0), fov=20.0)
        for share in (0.0, 0.5):
            options = {"size": SIZE, "looks": [{"of": "wall", "translucency": share}], "camera": first}
            with Renderer(frame, **options) as renderer:
                renderer.camera = Camera(eye=(6.0, -3.0, -8.0), target=(0.0, 0.0, depth / 2), fov=20.0)
                seen[depth, share] = linear(renderer.render(frame))[40:50, 75:85].mean(axis=(0, 1))
    for depth in (0.2, 0.8):
        assert np.all(seen[depth, 0.5] >= seen[depth, 0.0])
    gain = [(seen[depth, 0.5] - seen[depth, 0.0]).max() for depth in (0.2, 0.8)]
    assert gain[0] > 1.5 * gain[1] > 0


@pytest.mark.slow
def test_light_inside_shows_no_texels_of_the_shadow_map():
    """On a side that the lamp grazes: the curvature of its brightness from left to right, in rows of which six are one."""
    scene = Scene(dim=3)
    cube = shapes.jelly(scene, size=(1.5, 1.5, 1.5), resolution=(4, 4, 4), rotation=(0, 41, 0), colour=(0.9, 0.5, 0.2))
    scene.set_name(cube.balls, "cube")
    frame = frame_of(scene)
    frame.objects = tuple(scene.objects)
    sides = []
    for share in (0.0, 0.5):
        look = {"of": "cube", "translucency": share}
        with Renderer(frame, size=(640, 480), looks=[look], camera={"azimuth": 10.0, "elevation": 18.0}) as renderer:
            drawn = renderer.render(frame)[180:396, 280:400]
        sides.append(drawn.astype(float).mean(axis=2).reshape(36, 6, 120).mean(axis=1))
    solid, lit = sides
    assert lit.mean() > solid.mean() + 10
    assert np.abs(np.diff(lit[:, ::2], n=2, axis=1)).mean() < 0.48


def test_fabrics_shine_and_let_light_through_as_they_do():
    """A preset's gloss and translucency are those of a surface, unless a look gives them, or a material has its name."""
    rows = {}
    for material in ("silk", "denim", "default", "own"):
        scene = Scene(dim=3)
        if material == "own":
            scene.add_material("silk", friction=0.1)
        name = "silk" if material == "own" else material
        more = {} if material in ("silk", "denim") else {"stiffness": 100.0}
        sheet = shapes.cloth(scene, size=(1, 1), resolution=(3, 3), material=name, **more)
        for translucency in (None, 0.9):
            looks = [] if translucency is None else [Look("cloth_0", translucency=translucency)]
            styles = Content.of(
                MomentsOf(scene).at(0.0, scene.position, scene.velocity, scene.velocity, None), 1.0, looks=looks
            ).styles
            rows[material, translucency] = tuple(styles.rows[styles.of_triangle[0], :2].tolist())
        assert len(sheet.triangles) > 0
    assert rows["default", None] == pytest.approx((0.15, 0.4))
    assert rows["own", None] == rows["default", None]
    assert rows["silk", None][0] > rows["default", None][0] > rows["denim", None][0]
    assert rows["silk", None][1] > rows["default", None][1] > rows["denim", None][1]
    assert rows["denim", 0.9] == pytest.approx((rows["denim", None][0], 0.9))


RED_OVER_BLUE = (((255, 0, 0),), ((0, 0, 255),))


def image_of(folder, colours):
    """Path of an image of 60 x 60 px with fields of these colours, row by row."""
    fields = np.array(colours, dtype=np.uint8)
    Image.fromarray(fields.repeat(60 // fields.shape[0], axis=0).repeat(60 // fields.shape[1], axis=1)).save(
        folder / "a.png"
    )
    return folder / "a.png"


@pytest.mark.parametrize("repeat", [1, 3])
def test_no_border_of_a_texture_shows_its_opposite_one(tmp_path, repeat):
    """Not in pixels that see the cloth beside their centre, either."""
    look = {"of": "flag", "texture": image_of(tmp_path, RED_OVER_BLUE), "repeat": repeat}
    frame, turn = upright(), np.deg2rad(6)
    frame.position = frame.position @ np.array(
        [[np.cos(turn), np.sin(turn), 0], [-np.sin(turn), np.cos(turn), 0], [0, 0, 1]]
    )
    drawn = picture(frame, camera=FRONT, shadow=False, background=(0, 0, 0), looks=[look]).astype(int)
    for column in drawn.transpose(1, 0, 2)[68:92]:
        seen = np.flatnonzero(column.max(axis=1) > 20)
        upper, lower = column[seen[0]], column[seen[-1]]
        assert upper[0] > upper[2]
        assert lower[2] > lower[0]


def test_a_texture_covers_all_of_a_surface_that_reaches_beyond_its_balls(tmp_path):
    """A square of 1.6 m in front of a cube of balls of 1 m, as the mesh of a jelly may be: no border shows the opposite one."""
    scene = Scene(dim=3)
    cube = shapes.jelly(scene, size=(1, 1, 1), resolution=(2, 2, 2), position=(-0.5, -0.5, -0.5))
    scene.set_name(cube.balls, "flag")
    balls = scene.position[cube.balls]
    square = 0.8 * np.array([[-1, -1, 0.6], [1, -1, 0.6], [1, 1, 0.6], [-1, 1, 0.6]])
    weights = np.prod(0.5 + 2 * square[:, None] * balls[None], axis=2)  # trilinear
    scene.add_embedded_surface(np.tile(cube.balls, (4, 1)), weights, [[0, 1, 2], [0, 2, 3]], colour=(1, 1, 1))
    frame = frame_of(scene)
    frame.objects, frame.embedded_surfaces = tuple(scene.objects), tuple(scene.embedded_surfaces)
    look = {"of": "flag", "texture": image_of(tmp_path, RED_OVER_BLUE)}
    drawn = picture(frame, camera=FRONT, shadow=False, background=(0, 0, 0), looks=[look]).astype(int)
    for column in drawn.transpose(1, 0, 2)[72:88]:
        seen = np.flatnonzero(column.max(axis=1) > 20)
        upper, lower = np.array_split(column[seen], 2)
        assert len(seen) > 20
        assert np.mean(upper[:, 0] > upper[:, 2]) > 0.9
        assert np.mean(lower[:, 2] > lower[:, 0]) > 0.9


def assert_quarters(frame, folder, colours):
    """A texture of red and green over blue and white shows these, the upper two first, on what is called flag."""
    texture = image_of(folder, (((255, 0, 0), (0, 255, 0)), ((0, 0, 255), (255, 255, 255))))
    drawn = picture(frame, camera=FRONT, shadow=False, looks=[{"of": "flag", "texture": texture}]).astype(int)
    seen = dict(zip(colours, (drawn[row, column] for row in (35, 55) for column in (70, 90))))
    assert reddish(seen["red"])
    assert greenish(seen["green"])
    assert seen["blue"][2] > 1.5 * max(seen["blue"][:2])
    assert seen["white"].min() > 100


def test_a_texture_lies_upright_and_is_not_mirrored(tmp_path):
    assert_quarters(upright(), tmp_path, ("red", "green", "blue", "white"))
    for name, text in (
        ("none.png", "is not there"),
        ("test.txt", "is not an image that can be read: .*none of PNG, JPEG"),
    ):
        (tmp_path / "test.txt").write_text("no image")
        with pytest.raises(SceneError, match=rf"looks\[0\].texture: .* {text}"):
            picture(upright(), looks=[{"of": "flag", "texture": tmp_path / name}])
    for texture in (3, ["a.png"], True):
        with pytest.raises(
            SceneError, match=r"looks\[0\].texture: .* is not allowed; it must be the name of an image file"
        ):
            picture(upright(), looks=[{"of": "flag", "texture": texture}])
    says = r"looks\[1\].of: 'flag' has a look already, that of looks\[0\]; give it one"
    with pytest.raises(SceneError, match=says):
        picture(upright(), looks=[{"of": "flag", "gloss": 0.5}, {"of": "flag"}])


def test_a_texture_lies_as_the_corners_of_a_mesh_say(tmp_path):
    """Turned by a quarter, beyond 0..1, and with a seam along the middle."""
    scene = Scene(dim=3)
    sheet = shapes.cloth(scene, size=(2, 2), resolution=(9, 9), rotation=(90, 0, 0), position=(-1, 1, 0))
    x = scene.position[sheet.triangles]
    right, up = 0.5 * (x[..., 0] + 1), 0.5 * (x[..., 1] - x[..., 1].min())
    uv = np.stack([1 - up, right], axis=2) + np.where(x[..., 0].mean(axis=1) < 0, 3.0, -2.0)[:, None, None]
    scene.set_name(sheet.balls, "flag", uv)
    frame = frame_of(scene)
    frame.objects = tuple(scene.objects)
    assert_quarters(frame, tmp_path, ("blue", "red", "white", "green"))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["stripes", "checks", "texture"])
def test_patterns_far_away_are_means_over_pixels(tmp_path, kind):
    """A long carpet seen at a slant, as the mean of a picture four times as wide and high shows it; its triangles, all of one
    mapping, are not seen. A filter as wide in all directions is off by 0.1 to 0.11."""
    scene = Scene(dim=3)
    carpet = shapes.cloth(scene, size=(8, 24), resolution=(9, 13), position=(-4, 0, -20), colour=(0.1, 0.2, 0.8))
    scene.set_name(carpet.balls, "carpet")
    squares = (np.indices((64, 64)) // 8).sum(axis=0) % 2 == 0
    Image.fromarray(np.where(squares[..., None], (20, 40, 200), (245, 245, 235)).astype(np.uint8)).save(
        tmp_path / "a.png"
    )
    look = {"of": "carpet", "pattern": kind, "pattern_colour": (0.96, 0.95, 0.92), "repeat": 16}
    if kind == "texture":
        look = {"of": "carpet", "texture": tmp_path / "a.png", "repeat": 4}
    frame = frame_of(scene)
    frame.objects = tuple(scene.objects)
    seen = []
    for times in (1, 4):
        size = (SIZE[0] * times, SIZE[1] * times)
        camera = Camera(eye=(0.3, 1.5, 5.0), target=(0, 0, -4))
        with Renderer(frame, size=size, camera=camera, shadow=False, looks=[look]) as renderer:
            seen.append(linear(renderer.render(frame)))
    small, large = seen
    mean = large.reshape(SIZE[1], 4, SIZE[0], 4, 3).mean(axis=(1, 3))
    assert np.sqrt(np.mean((small - mean)[30:] ** 2)) < 0.065


@pytest.mark.long
def test_a_see_through_collider_shows_what_is_behind_it():
    """Half of a green ball through a red box; in a picture with alpha half of nothing. It casts no shadow, and gloss shines."""
    box = placed(Box((0, 0, 0), (2, 2, 2), colour=RED, name="glass"), 3)
    frame = balls([(0.0, 0.0, -2.5)], 0.5, [GREEN], colliders=(box,))
    look = {"of": "glass", "opacity": 0.5}
    options = {"camera": FRONT, "shadow": False, "transparent": True}
    solid, glass = (picture(frame, looks=looks, **options) for looks in ([], [look]))
    behind = picture(balls([(0.0, 0.0, -2.5)], 0.5, [GREEN]), **options)
    assert solid[45, 80, 3] == 255
    assert glass[45, 80, 3] == 255
    mixed = linear(glass[45, 80, :3])
    assert mixed == pytest.approx((linear(solid[45, 80, :3]) + linear(behind[45, 80, :3])) / 2, abs=0.02)
    assert glass[30, 66, 3] == 128
    assert solid[30, 66, 3] == 255
    ground = np.array([[0.0, 1.0, 0.0, -1.0]])
    frame = balls([(-1.5, -0.9, 0.0), (1.5, 1.0, 0.0)], 0.01, colliders=(box,), walls=ground)
    above = Camera(eye=(0.0, 5.0, 7.0), target=(0.0, 0.0, 0.0))
    dark = [
        np.count_nonzero(
            picture(frame, camera=above, looks=looks, shadow=False).astype(int).sum(axis=2)
            > picture(frame, camera=above, looks=looks).astype(int).sum(axis=2) + 60
        )
        for looks in ([], [look])
    ]
    assert dark[0] > 100
    assert dark[1] < 10


def test_looks_that_are_refused(tmp_path):
    frame = upright()
    for look, message in (
        (
            {"of": "flga"},
            r"looks\[0\].of: 'flga' is not allowed; it must be the name of a shape or of a collider: flag",
        ),
        ({"pattern": "checks"}, r"looks\[0\].of: is missing"),
        ({"of": "flag", "glos": 1}, "did you mean 'gloss'"),
        ({"of": "flag", "gloss": 2}, r"looks\[0\].gloss: 2"),
        ({"of": "flag", "pattern": "dots"}, "'plain', 'stripes', 'checks'"),
        ({"of": "flag", "opacity": 0.5}, "is for colliders"),
        ({"of": "flag", "translucency": 1.5}, r"looks\[0\].translucency: 1.5"),
        ({"of": "flag", "hem": 0.6}, r"looks\[0\].hem: 0.6"),
        ({"of": "flag", "repeat": 3}, r"looks\[0\].repeat: 3 is of a pattern or a texture"),
    ):
        with pytest.raises(SceneError, match=message):
            Renderer(frame, size=SIZE, looks=[look])
    file = tmp_path / "scene.toml"
    text = 'format = 1\ndim = 3\n[[cloth]]\nname = "flag"\n[[output.looks]]\nof = "flag"\n'
    for more, message in (
        ('texture = "none.png"', r"line 7: output\.looks\[0\]\.texture: .* is not there"),
        ("gloss = -1", r"line 7: output\.looks\[0\]\.gloss: -1"),
    ):
        file.write_text(text + more)
        with pytest.raises(SceneError, match=message):
            load_scene(file)
    file.write_text(text.replace("cloth", "jelly") + "hem = 0.07")
    with pytest.raises(
        SceneError, match=r"line 7: output\.looks\[0\]\.hem: 0.07 is for rectangular cloth; 'flag' is none"
    ):
        load_scene(file)
    rope = "[[rope]]\nname = 'rope'\nstart = [0, 0, 0]\nend = [1, 0, 0]\nn = 4\nradius = 0.1\n"
    file.write_text(text.replace("[[output", rope + "[[output") + 'gloss = 1\n[[output.looks]]\nof = "rope"')
    with pytest.raises(
        SceneError, match=r"line 15: output\.looks\[1\]\.of: 'rope' has no surface; a look is for cloth"
    ):
        load_scene(file)
    for stage in (None, ["day"]):
        with pytest.raises(SceneError, match=r"stage: .* is not allowed; it must be one of 'day', "):
            Renderer(frame, size=SIZE, stage=stage)
    file.write_text(text + 'pattern = "checks"')
    assert load_scene(file).output["looks"] == ({"of": "flag", "pattern": "checks"},)
