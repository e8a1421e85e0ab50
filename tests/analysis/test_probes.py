"""Probes: quantities with a name, against what mechanics says they are."""

import numpy as np
import pytest
from physics_support import PRECISION

import taichi_sim as ts
from taichi_sim.analysis.lazy_frame import MomentsOf
from taichi_sim.analysis.probe_readings import quantity_of
from taichi_sim.common.errors import SceneError
from taichi_sim.common.quantities import measured, plain_number
from taichi_sim.outputs import export, open_output
from taichi_sim.render.colouring import Colouring
from taichi_sim.scene.probes import KINDS, ProbeSample

pytestmark = pytest.mark.long_in("f32")

G = 10.0  # m/s^2
MASS, STIFFNESS, DAMPING, SPEED = 2.0, 1e3, 40.0, 0.5
DIGITS = 1e-9 if PRECISION == "f64" else 1e-4


def hanging():
    """A weight on a damped spring that moves down at first, and three balls that fall through planes."""
    scene = ts.Scene(dim=2, gravity=(0, -G))
    scene.add_balls([[0, 0], [0, -1]], radius=0.05, mass=MASS, pinned=[0], velocity=[[0, 0], [0, -SPEED]])
    scene.add_springs([[0, 1]], stiffness=STIFFNESS, damping=DAMPING, rest_length=0.9)
    drops = scene.add_balls([[1, 0], [2, -1], [3, -9]], radius=0.05, mass=[1, 2, 4])
    scene.add_probe("load", "tension", at=(0.1, -0.5))
    scene.add_probe("rope", "length", spring=0)
    scene.add_probe("stretch", "strain", balls=[0, 1])
    scene.add_probe("tip", "position", at=(0, -1.1))
    scene.add_probe("middle", "position", balls=[0, 1])
    scene.add_probe("heat", "energy")
    scene.add_probe("down", "flux", normal=(0, -2), offset=3.0, balls=drops)  # through y = -3
    scene.add_probe("up", "flux", normal=(0, 1), offset=-3.0)
    return scene


@pytest.fixture(scope="module")
def sim():
    with ts.Simulation(hanging(), dt=1e-3, contacts="off") as made:
        yield made


def test_the_start(sim):
    """Elastic and damping force; nothing has gone through a plane, and no time has passed for rates."""
    sim.resume(ts.Snapshot(sim.scene.position, sim.scene.velocity))
    assert sim.probe("load") == pytest.approx(STIFFNESS * 0.1 + DAMPING * SPEED, rel=DIGITS)
    assert sim.probe("load.tension") == sim.probe("load")
    assert sim.probe("rope") == pytest.approx(1.0)
    for name in ("max", "min", "mean"):
        assert sim.probe(f"stretch.{name}") == pytest.approx(1.0 / 0.9 - 1.0, rel=1e-6)
    assert sim.probe("tip") == pytest.approx([0.0, -1.0])
    assert sim.probe("middle.magnitude") == pytest.approx(0.5)
    assert sim.probe("heat.kinetic") == pytest.approx(0.5 * MASS * SPEED**2)
    assert sim.probe("heat.total") == pytest.approx(sim.energy().total)
    found = sim.probes()
    assert found["down.count"] == found["up.mass"] == 0.0
    assert np.isnan(found["down.count_rate"])


def test_a_weight_at_rest_pulls_with_its_weight_and_what_falls_is_counted(sim, tmp_path):
    """After t the second ball has fallen from -1 to -1 - g t^2 / 2; the planes lie at -3, and the third began below them."""
    sim.resume(ts.Snapshot(sim.scene.position, sim.scene.velocity))
    sim.run(0.7)
    found = sim.probes()
    assert (found["down.count"], found["down.mass"]) == (1.0, 2.0)
    assert (found["up.count"], found["up.mass"]) == (-1.0, -2.0)
    assert found["down.mass_rate"] == pytest.approx(2.0 / 0.7)
    sim.run(0.2)
    assert sim.probe("down.mass") == 3.0
    assert sim.probe("down.mass_rate") == pytest.approx(1.0 / 0.2)
    assert sim.probe("down.mass_rate") == pytest.approx(1.0 / 0.2)  # read again at the same time
    sim.run(1.1)
    assert sim.probe("load") == pytest.approx(MASS * G, rel=max(DIGITS, 1e-6))
    assert sim.probe("down.mass_rate") == 0.0
    sim.save(tmp_path / "state.npz")
    with ts.Simulation.restore(tmp_path / "state.npz") as again:
        assert again.probes().keys() == found.keys()
        assert again.probe("load") == sim.probe("load")
        assert again.probe("down.mass") == 3.0


def test_arrays_and_the_summary_hold_them(sim, tmp_path):
    sim.resume(ts.Snapshot(sim.scene.position, sim.scene.velocity))
    summary = export(sim, open_output(tmp_path / "x.npz"), fps=20, duration=0.5)
    kept = np.load(tmp_path / "x.npz")
    x, v = kept["position"][:, 1, 1], kept["velocity"][:, 1, 1]
    assert kept["load.tension"] == pytest.approx(STIFFNESS * (-x - 0.9) - DAMPING * v, abs=200 * DIGITS)
    assert kept["tip.y"] == pytest.approx(x, abs=DIGITS)
    last, least, most = (f(kept["load.tension"]) for f in (lambda a: a[-1], np.min, np.max))
    assert summary.probes["load.tension"] == (last, least, most)
    said = [measured(one, None, "N") for one in (last, least, most)]
    line = "load.tension {} in the last frame; least {}, peak {} of all frames"
    assert line.format(*said) in [" ".join(one.split()) for one in summary.lines()]
    assert any(line.startswith("uncertainty  not estimated; --error") for line in summary.lines())


@pytest.mark.parametrize("dt", [4e-3, 1e-3])
def test_a_second_run_at_half_the_step_tells_the_error_of_the_step(dt):
    """The weight's way is known: s = s_e + exp(-d t) (A cos w t + B sin w t)."""
    scene = hanging()
    rest, d = 0.9 + MASS * G / STIFFNESS, DAMPING / (2.0 * MASS)
    w = np.sqrt(STIFFNESS / MASS - d**2)
    a = 1.0 - rest
    b = (SPEED + d * a) / w
    with ts.Simulation(scene, dt=dt, contacts="off") as sim:
        summary = export(sim, None, fps=50, duration=0.2, error=True)
        t = sim.time
        exact = rest + np.exp(-d * t) * (a * np.cos(w * t) + b * np.sin(w * t))
        off = abs(summary.probes["rope.length"][0] - exact)
    estimate = summary.step_error.probes["rope.length"][0]
    assert 0.7 * off < estimate + DIGITS
    assert estimate < 1.5 * off + DIGITS
    assert summary.step_error.largest >= summary.step_error.rms >= 0.0
    text = "\n".join(summary.lines())
    assert " +- " in next(line for line in summary.lines() if line.startswith("rope.length"))
    assert f"a second run at a step of {plain_number(dt / 2)} s" in text


def test_the_error_is_not_estimated_twice():
    with ts.Simulation(hanging(), tolerance=1e-2, contacts="off") as sim, pytest.raises(SceneError, match="already"):
        export(sim, None, duration=0.1, error=True)


def test_a_torn_spring_carries_nothing():
    scene = hanging()
    torn = np.array([True])
    sample = ProbeSample(scene, scene.position, scene.velocity, torn, lambda: (0.0,) * 4, np.zeros((0, 2)))
    assert scene.probes[0].read(sample) == {"tension": 0.0}
    assert np.isnan(scene.probes[2].read(sample)["max"])


FILE = """format = 1
[[balls]]
name = "pair"
position = [[0.0, 0.0], [1.0, 0.0]]
radius = 0.1
[[springs]]
pairs = [[0, 1]]
stiffness = 1.0
[[probes]]
name = "a"
kind = "position"
balls = "pair"
members = [1]
"""
BAD = [
    (
        'kind = "position"',
        'kind = "positon"',
        11,
        "probes[0].kind: 'positon' is not allowed; it must be one of 'position'",
    ),
    (
        'kind = "position"',
        'kind = "energy"',
        12,
        "probes[0].balls: is not for the kind 'energy'; it takes nothing more",
    ),
    (
        'kind = "position"',
        'kind = "tension"',
        12,
        "probes[0].balls: is not for the kind 'tension'; it takes spring or at",
    ),
    ('kind = "position"', "", 9, "probes[0].kind: is missing"),
    ('name = "a"', 'name = "a b"', 10, "probes[0].name: 'a b' is not allowed; it must be a word of"),
    ("members = [1]", "member = [1]", 13, "probes[0].member: is not a known key; did you mean 'members'?"),
    ("members = [1]", "members = [2]", 13, "probes[0].members[0]: 2 is not allowed; it must name a ball, from 0 to 1"),
    ("members = [1]", "at = [0.0, 0.0]", 13, "probes[0].at: balls and at are given; give one of them"),
    ('balls = "pair"\nmembers = [1]', "at = [0.0]", 12, "probes[0].at: shape (1,) does not fit; it must be (2,)"),
    ('balls = "pair"\nmembers = [1]', "", 11, "probes[0].kind: the kind 'position' needs balls or at"),
    ('"pair"\nmembers = [1]', '"pear"', 12, "probes[0].balls: 'pear' is not a name in this file; did you mean 'pair'?"),
    (
        '"position"\nballs = "pair"\nmembers = [1]',
        '"tension"\nspring = 1',
        12,
        "probes[0].spring: 1 is not allowed; it must",
    ),
    ('"position"\nballs = "pair"\nmembers = [1]', '"force"\nwall = 0', 12, "probes[0].wall: the scene has no wall yet"),
    (
        '"position"\nballs = "pair"\nmembers = [1]',
        '"flux"',
        9,
        "probes[0].normal: is missing; a flux needs the direction",
    ),
    (
        "members = [1]",
        'members = [1]\n[[probes]]\nname = "a"\nkind = "energy"',
        15,
        "probes[1].name: 'a' exists already",
    ),
]


@pytest.mark.parametrize(("old", "new", "line", "message"), BAD, ids=[b[1][:30] for b in BAD])
def test_a_mistake_is_one_sentence(tmp_path, old, new, line, message):
    assert old in FILE.split("[[springs]]")[1]
    start, end = FILE.split("[[probes]]")
    (tmp_path / "s.toml").write_text(f"{start}[[probes]]{end.replace(old, new, 1)}")
    with pytest.raises(SceneError) as caught:
        ts.load_scene(tmp_path / "s.toml")
    assert str(caught.value).startswith(f"{tmp_path / 's.toml'}, line {line}: {message}")


def test_names_of_quantities():
    scene = hanging()
    assert quantity_of(scene, "load").numbers == ("load.tension",)
    assert quantity_of(scene, "tip").numbers == ("tip.x", "tip.y")
    assert quantity_of(scene, "tip.y").unit == "m"
    for name, message in (
        ("lod.tension", "'lod.tension' is not a probe of this scene; did you mean 'load'?"),
        ("heat", "'heat' has several numbers; name one of heat.kinetic, heat.spring, heat.gravity, heat.total"),
        ("tip.z", "the position 'tip' has no number 'z'; name one of tip.x, tip.y, tip.magnitude"),
    ):
        with pytest.raises(SceneError, match=message.replace("?", r"\?")):
            quantity_of(scene, name)
    assert set(KINDS) == {"position", "length", "tension", "strain", "energy", "force", "impulse", "flux"}


# Walls and colliders ------------------------------------------------------------------------------------------------


def boxed(restitution, friction=0.0):
    """Five balls of different masses in a box of three walls, over a sphere."""
    scene = ts.Scene(dim=2, gravity=(0, -G))
    scene.add_material("m", restitution=restitution, friction=friction)
    places = [[0.5, 1.0], [0.75, 1.0], [1.0, 1.0], [0.6, 1.4], [0.9, 1.4]]
    mass, speed = [1.0, 4.0, 0.5, 1.5, 1.0], [[1, 0], [0, -2], [3, 1], [0, 0], [-1, -4]]
    scene.add_balls(places, radius=0.1, mass=mass, velocity=speed, material="m")
    for normal, offset in (((0, 1), 0.0), ((1, 0), 0.0), ((-1, 0), -1.5)):
        scene.add_wall(normal, offset, material="m")
    scene.add_collider(ts.Sphere([0.8, 0.0], 0.3, material="m"))
    for k in range(3):
        scene.add_probe(f"wall{k}", "impulse", wall=k)
    scene.add_probe("weight", "force", wall=0)
    scene.add_probe("sphere", "impulse", collider=0)
    return scene


BODIES = ("wall0", "wall1", "wall2", "sphere")


def lost(sim, start):
    """What balls have lost since then to walls and colliders: the impulse of gravity less the change of momentum [N s]."""
    return start + sim.scene.mass.sum() * np.array([0.0, -G]) * sim.time - sim.momentum()


def crowd():
    """Sixteen balls that nearly touch, which split masses and restitution would give energy (kernels.energy_limiter)."""
    scene, rng = boxed(1.0, 0.5), np.random.default_rng(1)
    crowd = ts.Scene(dim=2, gravity=(0, -G))
    crowd.materials[:], crowd.walls[:] = scene.materials, scene.walls
    crowd.add_collider(ts.Sphere([0.7, -0.2], 0.3, material="m"))
    places = 0.3 + 0.2025 * np.stack(np.meshgrid(np.arange(4), np.arange(4), indexing="ij"), -1).reshape(-1, 2)
    speed, mass = rng.normal(size=places.shape), rng.uniform(0.5, 2.0, len(places))
    crowd.add_balls(places, radius=0.1, mass=mass, velocity=speed, material="m")
    crowd.probes.extend(scene.probes)
    return crowd


@pytest.mark.slow
@pytest.mark.parametrize(
    ("make", "settings"),
    [
        (crowd, {"dt": 5e-3, "contacts": "jacobi", "contact_iterations": 1}),
        pytest.param(
            lambda: boxed(0.3, 0.3), {"dt": 1e-3, "integrator": "xpbd", "driver": "parallel"}, marks=pytest.mark.long
        ),
    ],
    ids=["tamed", "parallel"],
)
def test_walls_and_colliders_receive_all_that_balls_lose(make, settings):
    """However balls meet, press and rub, the sum over bodies is exact."""
    with ts.Simulation(make(), **settings) as sim:
        start = sim.momentum()
        sim.run(0.5)
        impulses = [sim.probe(name) for name in BODIES]
        assert np.sum(impulses, axis=0) == pytest.approx(lost(sim, start), abs=100 * DIGITS)
        assert sum(np.linalg.norm(one) > 0.1 for one in impulses) >= 2


@pytest.mark.long
def test_what_lies_still_presses_with_its_weight(tmp_path):
    """Floor, sides and sphere carry it together; what is restored holds the sums, and means go on."""
    scene = boxed(0.5, 0.4)
    with ts.Simulation(scene, dt=1e-3) as sim:
        start = sim.momentum()
        sim.run(3.0)
        before = np.sum([sim.probe(name) for name in BODIES], axis=0)
        assert before == pytest.approx(lost(sim, start), abs=300 * DIGITS)
        floor, landing = sim.probe("wall0"), sim.probe("weight")
        sim.save(tmp_path / "state.npz")
        sim.run(0.5)
        assert np.abs(sim.velocity).max() < 1e-2
        pressed = np.sum([sim.probe(name) for name in BODIES], axis=0) - before
        assert pressed / 0.5 == pytest.approx([0.0, -scene.mass.sum() * G], abs=1e-2)
        assert sim.probe("weight") == pytest.approx((sim.probe("wall0") - floor) / 0.5, abs=1e-2)
        with ts.Simulation.restore(tmp_path / "state.npz") as again:
            assert again.probe("wall0") == pytest.approx(floor)
            assert again.probe("weight") == pytest.approx(landing)
            again.run(0.5)
            assert again.probe("weight") == pytest.approx(sim.probe("weight"))


def test_an_elastic_bounce_gives_twice_the_momentum():
    """2 m v to a wall, at an angle too; nothing to a wall that it does not reach."""
    scene = ts.Scene(dim=2)
    scene.add_material("m", restitution=1.0)
    scene.add_balls([[0, 1]], radius=0.1, mass=3.0, velocity=(2, -5), material="m")
    scene.add_wall((0, 1), material="m")
    scene.add_wall((1, 0), -9.0, material="m")
    scene.add_probe("floor", "impulse", wall=0)
    scene.add_probe("push", "force", wall=0)
    scene.add_probe("far", "impulse", wall=1)
    with ts.Simulation(scene, dt=1e-2) as sim:
        assert np.isnan(sim.probe("push.y"))
        sim.run(0.4)
        assert sim.probe("floor") == pytest.approx([0.0, -2 * 3.0 * 5.0])
        assert sim.probe("push") == pytest.approx([0.0, -2 * 3.0 * 5.0 / 0.4])
        assert sim.probe("far.magnitude") == 0.0
        with pytest.raises(ValueError, match="tolerance: cannot be kept together with probes of force or impulse"):
            ts.Simulation(scene, tolerance=1e-3)


def test_nothing_is_compiled_where_no_probe_asks():
    scene = boxed(0.5)
    scene.probes.clear()
    with ts.Simulation(scene, dt=1e-3) as sim:
        assert not sim.parts.contacts.walls.probed
        assert sim.probes() == {}


def test_a_probe_that_comes_late_is_told():
    """A simulation knows the probes that there were when it was made."""
    scene = ts.Scene(dim=2, gravity=(0, -10))
    scene.add_balls([[0, 0.3]], radius=0.1)
    scene.add_wall((0, 1), 0.0)
    with ts.Simulation(scene, arch="cpu", precision=PRECISION, dt=1e-3) as sim:
        sim.run(0.05)
        scene.add_probe("late", "force", wall=0)
        assert sim.probes() == {}
        with pytest.raises(SceneError, match="got more probes after this simulation was made"):
            sim.run(0.05)
        with pytest.raises(SceneError, match="'late' is not a probe of this scene"):
            sim.probe("late")
        with pytest.raises(SceneError, match="stays as it is"):
            sim.scene.add_probe("late", "force", wall=0)


def test_numbers_are_named_once():
    scene = ts.Scene(dim=2)
    scene.add_balls([[0, 0], [1, 0], [2, 0]], radius=0.1)
    scene.add_springs([[0, 1], [1, 2]], stiffness=1.0)
    for kind, given, words in (
        ("flux", {"normal": (1, 0), "balls": [0, 0]}, "ball 0 is named 2 times"),
        ("position", {"balls": [[0], [1, 2]]}, "is not a list of integers"),
        ("strain", {"springs": []}, "springs: is empty; name at least one spring"),
        ("strain", {"springs": [5]}, "must name a spring, from 0 to 1"),
        (["position"], {"balls": [0]}, "probes.kind"),
    ):
        with pytest.raises(SceneError, match=words):
            scene.add_probe("p", kind, **given)


def stretched():
    """A sheet of triangles, a block of bricks and a spring, each far apart, and where a known stretch puts their balls."""
    scene = ts.Scene(dim=3)
    sheet = ts.shapes.cloth(scene, (1.0, 0.7), (3, 4), warp=50.0, weft=20.0)
    block = ts.shapes.jelly(scene, (0.6, 0.8, 1.0), (3, 2, 3), young_modulus=1e4, position=(5, 0, 0))
    pair = scene.add_balls([[9, 0, 0], [9, 0, 2]], radius=0.1)
    scene.add_springs([pair], stiffness=1.0)
    x = scene.position.copy()
    x[sheet.balls] *= [1.05, 1.0, 0.98]
    x[block.balls] *= [1.01, 0.9, 1.03]
    x[pair] *= [1.0, 1.0, 1.2]
    turn, _ = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))
    turn *= np.sign(np.linalg.det(turn))  # whatever is turned is not strained
    return scene, (sheet.balls, block.balls, pair), x @ turn.T


def test_strains_of_triangles_and_bricks():
    scene, bodies, x = stretched()
    for k, balls in enumerate(bodies):
        scene.add_probe(f"s{k}", "strain", balls=balls)
    scene.add_probe("all", "strain")
    scene.add_probe("spring", "strain", springs=[0])
    sample = ProbeSample(scene, x, np.zeros_like(x), None, lambda: (0.0,) * 4, np.zeros((0, 3)))
    read = [list(probe.read(sample).values()) for probe in scene.probes]
    for found, strain in zip(read[:3], (0.05, -0.1, 0.2), strict=True):
        assert found == pytest.approx([strain] * 3)
    assert read[3][:2] == pytest.approx([0.2, -0.1])
    assert read[4] == pytest.approx([0.2] * 3)
    frame = MomentsOf(scene).at(0.0, x, np.zeros_like(x), np.zeros((len(x), 3)), None)
    shown = Colouring.of(frame, "strain", (0.0, 1.0)).values(frame)
    for balls, strain in zip(bodies, (0.05, 0.1, 0.2), strict=True):
        assert shown[balls] == pytest.approx(strain)
    with pytest.raises(SceneError, match="no spring, triangle, brick or solid lies between them"):
        scene.add_probe("none", "strain", balls=[0, len(x) - 1])


def test_what_is_turned_inside_out_is_shorter_than_nothing():
    """A block that is mirrored: its side that is a tenth too short is as long below nothing."""
    scene, (_, block, _), x = stretched()
    scene.add_probe("block", "strain", balls=block)
    x[block] *= [1.0, -1.0, 1.0]
    sample = ProbeSample(scene, x, np.zeros_like(x), None, lambda: (0.0,) * 4, np.zeros((0, 3)))
    assert list(scene.probes[-1].read(sample).values()) == pytest.approx([-1.9] * 3)


def test_what_has_torn_has_no_strain():
    scene = ts.Scene(dim=3)
    ts.shapes.cloth(scene, (1.0, 1.0), (2, 2), warp=50.0, break_strain=0.5)
    scene.add_probe("all", "strain")
    x = 1.1 * scene.position
    sample = ProbeSample(scene, x, x, np.ones(scene.n_springs, dtype=bool), lambda: (0.0,) * 4, np.zeros((0, 3)))
    assert np.isnan(scene.probes[0].read(sample)["max"])


def test_a_tension_of_a_body_without_springs_is_refused():
    for what, add in (
        ("bricks", lambda s: ts.shapes.jelly(s, (1, 1, 1), (2, 2, 2), young_modulus=1e4)),
        ("triangles", lambda s: ts.shapes.cloth(s, (1, 1), (2, 2), warp=50.0)),
    ):
        scene = ts.Scene(dim=3)
        add(scene)
        with pytest.raises(SceneError, match=rf"probes\.at: the scene is made of {what}, which are no springs"):
            scene.add_probe("load", "tension", at=(0, 0, 0))


def test_a_mean_force_comes_with_the_interval_of_its_mean():
    """Frames are whole steps apart, 8 or 9 ms at 120 a second: the impulse is force times that, not over fps."""
    scene = ts.Scene(dim=2, gravity=(0, -G))
    scene.add_balls([[0, 0.04], [0.5, 0.06]], radius=0.05, mass=MASS, body=1)
    scene.add_wall((0, 1))
    scene.add_probe("floor", "force", wall=0)
    scene.add_probe("given", "impulse", wall=0)
    with ts.Simulation(scene, dt=1e-3) as sim:
        for fps, interval in ((120, 0.008), (70, 0.014)):
            sim.reset(scene)
            seen = [sim.probes() for _ in sim.frames(fps=fps, duration=0.1)]
            assert seen[1]["floor.interval"] == pytest.approx(interval)
            impulse = sum(one["floor.y"] * one["floor.interval"] for one in seen[1:])
            assert impulse == pytest.approx(seen[-1]["given.y"] - seen[0]["given.y"], rel=1e-6)
            assert sim.probe("floor") == pytest.approx([seen[-1]["floor.x"], seen[-1]["floor.y"]])
