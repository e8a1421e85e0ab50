"""`Simulation.reset`: another scene, of the same structure without compiling, to the same bits as a new simulation."""

import gc
import warnings
from itertools import pairwise

import numpy as np
import pytest
from physics_support import PRECISION

import taichi_sim as ts
from taichi_sim.device.engine import ENGINE, ti
from taichi_sim.device.fields import Fields
from taichi_sim.simulation.contact_capacity import ContactCapacity

pytestmark = pytest.mark.skipif(ENGINE != "taichi", reason="it shares no kernels")
CPU = {"precision": PRECISION, "arch": "cpu"}


def pile(e=0.4, mu=0.3, viscous=0.0, g=-10.0, r=0.05, m=1.0, seed=0, wall=0.0, normal=(0.0, 1.0, 0.0), dim=2, v=0.0, dt=1e-3,
         pinned=(0,), sphere=None, path=None, probe=False, radii=0.0, masses=0.0, n=5, balls=None):  # fmt: skip
    scene = ts.Scene(dim=dim, gravity=(0, g, 0)[:dim])
    scene.settings["dt"] = dt
    scene.add_material("rubber", restitution=e, friction=mu, viscous_friction=viscous)
    rng = np.random.default_rng(seed)
    rows = [np.arange(n) * 0.12 + 0.06] * 2 + [np.array([0.0, 0.12])] * (dim - 2)
    x = np.stack(np.meshgrid(*rows), -1).reshape(-1, dim)
    x = (x + rng.uniform(-0.004, 0.004, x.shape))[:balls]
    few = len(x)
    radius, mass = r * (1 + radii * rng.uniform(-1, 1, few)), m * (1 + masses * rng.uniform(0, 1, few))
    scene.add_balls(
        x, radius=radius, mass=mass, velocity=np.full((few, dim), v), material="rubber", pinned=list(pinned)
    )
    scene.add_wall(normal[:dim], wall, "rubber")
    if sphere is not None:
        scene.add_collider(ts.Sphere(center=(0.3, -0.15, 0.0)[:dim], radius=sphere))
    if path is not None:
        keys = [{"time": 0.0, "position": (0.0,) * dim}, {"time": 1.0, "position": (0.0, path, 0.0)[:dim]}]
        scene.add_collider(ts.Box(center=(0.3, -0.3, 0.0)[:dim], size=(0.2,) * dim, path=keys))
    if probe:
        scene.add_probe("floor", "force", wall=0)
    return scene


def sheet(k=100.0, m=1.0, size=1.0, bend=1e-2, tear=None, damping=0.1, wind=None, ball=None, solid=False, method="verlet",
          dt=1e-3, path=None, wall=None, mu=0.0):  # fmt: skip
    scene = ts.Scene(dim=3, gravity=(0, -10, 0))
    scene.settings.update(integrator=method, dt=dt)
    scene.add_material("cotton", friction=mu)
    more = {} if tear is None else {"break_strain": tear}
    more |= {"bending_stiffness": bend, "damping": damping, "pinned": False if path else [0, 6]}
    cloth = ts.shapes.cloth(
        scene,
        size=(size, 1),
        resolution=(7, 7),
        stiffness=k,
        mass=m,
        material="cotton",
        surface_collision=solid,
        **more,
    )
    if wind is not None:
        scene.add_wind(velocity=(wind, 0, 0.3), gust=0.3)
    if ball is not None:
        scene.add_collider(ts.Sphere(center=(0.5, -0.3, 0.5), radius=ball))
    if path is not None:
        keys = [{"time": 0.0, "position": (0, 0, 0)}, {"time": 1.0, "position": (path, 0, 0)}]
        scene.add_moving_pins(cloth.balls[[0, 6]], path=keys)
    if wall is not None:
        scene.add_wall((0, 1, 0), wall, "cotton")
    return scene


def jelly(young=5e3, poisson=0.3, density=50.0, height=0.1):
    scene = ts.Scene(dim=3, gravity=(0, -10, 0))
    ts.shapes.jelly(scene, size=(0.3,) * 3, resolution=(4, 4, 4), position=(0, height, 0), density=density,
                    young_modulus=young, poisson_ratio=poisson)  # fmt: skip
    scene.add_wall((0, 1, 0), 0.0)
    return scene


def balloon(radius=0.3):
    scene = ts.Scene(dim=3, gravity=(0, -10, 0))
    ts.shapes.balloon(scene, centre=(0, 0, 0), radius=radius, subdivisions=1)
    return scene


def sticks(k=1e3, length=1.0):
    scene = ts.Scene(dim=2, gravity=(0, -10))
    scene.add_balls([[0, 0], [length, 0]], radius=0.02, pinned=True)
    scene.add_balls([[0.5, 0.1], [0.55, 0.3], [0.4, 0.5]], radius=0.05, mass=0.3)
    scene.add_springs([[0, 1]], stiffness=k, collides=True)
    return scene


OFTEN = {  # what the first scene is made with, and each change of it
    pile: ({}, [{"e": 0.7}, {"e": 1.0}, {"mu": 0.6}, {"g": -4.0}, {"r": 0.045}, {"m": 3.0}, {"seed": 4}, {"wall": -0.1},
                {"normal": (0.1, 1.0, 0.0)}, {"v": 1.0}, {"dt": 5e-4}, {"radii": 0.1}, {"masses": 1.0}, {"pinned": (3,)}]),
    sheet: ({}, [{"k": 200.0}, {"m": 2.0}, {"size": 1.3}, {"bend": 3e-2}, {"damping": 0.2}, {"dt": 5e-4}]),
}  # fmt: skip
SELDOM = [
    (pile, {"viscous": 0.1}, {"viscous": 0.3}), (pile, {"dim": 3}, {"seed": 3, "r": 0.048}),
    (pile, {"sphere": 0.1}, {"sphere": 0.12}), (pile, {"path": 0.2}, {"path": 0.25}), (pile, {"probe": True}, {"e": 0.6}),
    (sheet, {"tear": 0.02}, {"tear": 0.2}), (sheet, {"wind": 3.0}, {"wind": 6.0}), (sheet, {"ball": 0.2}, {"ball": 0.25}),
    (sheet, {"solid": True, "wall": -0.05}, {"k": 150.0}), (sheet, {"path": 0.1}, {"path": 0.3}),
    (sheet, {"wall": -0.05, "mu": 0.2}, {"mu": 0.5}), (sheet, {"method": "rk4"}, {"k": 200.0}),
    (sheet, {"method": "xpbd"}, {"k": 200.0}), (sheet, {"method": "implicit_euler", "dt": 5e-3}, {"k": 200.0}),
    (sheet, {"method": "tr_bdf2", "dt": 5e-3}, {"k": 200.0, "m": 2.0}), (jelly, {}, {"young": 8e3}),
    (jelly, {}, {"poisson": 0.4, "density": 80.0, "height": 0.05}), (balloon, {}, {"radius": 0.25}),
    (sticks, {}, {"k": 2e3, "length": 1.2}),
]  # fmt: skip


def ended(simulation):
    """All that is seen of a run of .15 s."""
    simulation.run(0.15)
    snapshot = simulation.snapshot()
    arrays = (snapshot.position, snapshot.velocity, snapshot.low_position, snapshot.surface_speed, snapshot.torn)
    return simulation.dt, simulation.substeps, simulation.energy(), str(simulation.probes()), *arrays


def same(one, other):
    return all(np.array_equal(a, b) for a, b in zip(one, other))


def check(make, given, changes):
    with warnings.catch_warnings(), ts.Simulation(make(**given), **CPU) as used:
        warnings.simplefilter("ignore")
        used.run(0.1)
        before = ended(used)
        for change in changes:
            used.reset(make(**given | change))
            assert used.time == 0.0
            found = ended(used)
            with ts.Simulation(make(**given | change), **CPU) as fresh:
                assert same(found, ended(fresh)), change
            assert not same(found, before), change


@pytest.mark.long_in("f64")
@pytest.mark.slow_where(make=pile)
@pytest.mark.parametrize("make", OFTEN, ids=lambda make: make.__name__)
def test_a_reset_run_has_the_bits_of_a_new_one(make):
    check(make, *OFTEN[make])


@pytest.mark.long
@pytest.mark.parametrize(("make", "given", "change"), SELDOM, ids=lambda part: getattr(part, "__name__", str(part)))
def test_so_it_is_with_all_parts(make, given, change):
    check(make, given, [change])


def objects():
    """How many the interpreter keeps. Each pass leaves out one more level of tuples in tuples, which can refer to nothing."""
    count = -1
    while count != (count := len(gc.get_objects())):
        gc.collect()
    return count


@pytest.mark.slow
@pytest.mark.once
def test_nothing_is_compiled_and_nothing_left():
    with ts.Simulation(pile(), **CPU) as used:

        def resets(count):
            for k in range(count):
                used.reset(pile(seed=k, e=0.01 + 0.01 * k, mu=0.1 + 0.01 * k, m=1 + k))
                used.step(3)
                used.contacts(), used.energy()

        resets(30)  # what is kept of the last few is there
        compiled = ti.lang.impl.get_runtime().get_num_compiled_functions
        before, fields, kept = compiled(), used.parts.fields.bytes, objects()
        resets(30)
        assert compiled() == before
        assert used.parts.fields.bytes == fields
        assert objects() - kept < 15


@pytest.mark.slow
@pytest.mark.once
def test_a_scene_that_is_wrong_changes_nothing():
    """One fails before anything is declared, one midway, where a number does not fit into the fields."""
    with ts.Simulation(pile(), **CPU) as used:
        used.step(5)
        x = used.position
        for wrong, error, why in (
            ("pile", ts.SceneError, "is no Scene"),
            (pile(dt=-1.0), ValueError, "dt"),
            *[(pile(wall=-1e39), ts.SceneError, "does not fit into single precision")] * (PRECISION == "f32"),
        ):
            with pytest.raises(error, match=why):
                used.reset(wrong)
        assert np.array_equal(used.position, x)
        assert used.time == pytest.approx(5e-3)
        used.step(5)
        with ts.Simulation(pile(), **CPU) as whole:
            whole.step(10)
            assert np.array_equal(whole.position, used.position)


def run_to_end(simulation):
    simulation.step(20)
    return simulation.position


def same_as_new(make, *changes, **more):
    """Reset a simulation to each of some scenes, which then runs as a new one; and whether it took the kernels of before."""
    ends = []
    for change in changes:
        with ts.Simulation(make(**change), **more, **CPU) as new:
            ends.append(run_to_end(new))
    with ts.Simulation(make(), **more, **CPU) as used:
        kernels = [used.parts.kernels]
        for change, end in zip(changes, ends):
            used.reset(make(**change))
            kernels.append(used.parts.kernels)
            assert np.array_equal(run_to_end(used), end), change
    return [before == now != "" for before, now in pairwise(kernels)]


@pytest.mark.slow
@pytest.mark.once
def test_a_scene_of_another_structure_gets_kernels_of_its_own():
    """Other lengths of fields, and other constants of kernels."""
    assert same_as_new(pile, {"e": 0.6}, {"balls": 24}, {"masses": 9.0}) == [True, False, False]


def row(k=200.0, amplitude=0.2):
    scene = ts.Scene(dim=2, gravity=(0, -10))
    scene.settings["dt"] = 5e-4
    balls = scene.add_balls(np.arange(6)[:, None] * [0.2, 0.0], radius=0.03, mass=0.1, pinned=[0])
    springs = scene.add_springs(np.stack([balls[:-1], balls[1:]], axis=1), stiffness=k, damping=0.5)
    scene.add_motor(springs[:2], amplitude=amplitude, frequency=10.0 * abs(amplitude))
    return scene


@pytest.mark.once
def test_room_for_contacts_that_was_needed_is_that_of_as_many_balls():
    with ts.Simulation(pile(), **CPU) as used:
        used.parts.capacity = ContactCapacity(pairs=50_000)
        used.reset(pile(e=0.6))
        assert used.parts.room.pairs == 50_000
        used.reset(pile(balls=24))
        assert used.parts.room.pairs < 10_000


@pytest.mark.once
def test_a_reset_that_fails_leaves_the_users_forces_where_they_were(monkeypatch):
    def full(fields):
        raise MemoryError

    ends = []
    for fails in (True, False):
        pointer = ts.Pointer()
        with ts.Simulation(row(), forces=[pointer], contacts="off", **CPU) as used:
            pointer.grab(5, target=(1.0, 0.2))
            if fails:
                with monkeypatch.context() as patch:
                    patch.setattr(Fields, "build", full)
                    with pytest.raises(MemoryError):
                        used.reset(row(k=300.0))
            assert pointer.ball == 5
            pointer.move((0.9, 0.1))
            ends.append(run_to_end(used))
    assert np.array_equal(*ends)


@pytest.mark.slow
@pytest.mark.once
def test_so_does_one_with_another_scheme_of_damping():
    assert same_as_new(row, {"amplitude": -0.3}, {"k": 1e5}, contacts="off") == [True, False]


@pytest.mark.slow
@pytest.mark.once
def test_user_defined_parts_are_compiled_each_time():
    class Push:
        @ti.func
        def accumulate(self, model: ti.template(), ball: ti.template(), impulse: ti.template(), h, time):
            for i in range(model.n):
                impulse[i] = impulse[i] + h

    assert same_as_new(row, {"amplitude": -0.3}, forces=[ti.data_oriented(Push)()], contacts="off") == [False]


@pytest.mark.once
def test_an_engine_whose_kernels_are_not_shared_compiles_them(monkeypatch):
    monkeypatch.setattr("taichi_sim.device.shared_kernels.IS_KNOWN", False)
    assert same_as_new(row, {"amplitude": -0.3}, contacts="off") == [False]


def flock(n: int) -> ts.Scene:
    scene = ts.Scene(dim=2, gravity=(0.0, -3.0))
    scene.add_balls([[0.4 * k, 0.0] for k in range(n)], radius=0.1)
    return scene


@pytest.mark.parametrize("at", [1, 4])
def test_frames_end_where_a_reset_begins_another_run(at):
    """Also after the last one, and for the very scene that it has."""
    with ts.Simulation(flock(2), contacts="off", dt=0.05, **CPU) as sim:
        seen = []

        def look_and_reset() -> None:
            for frame in sim.frames(fps=4.0, duration=1.0):
                seen.append(frame.time)
                if len(seen) == at + 1:
                    sim.reset(sim.scene)

        with pytest.raises(ts.SceneError, match=r"^frames: end here, where reset\(scene\) began another run"):
            look_and_reset()
        assert seen == pytest.approx([0.25 * k for k in range(at + 1)])
        assert [frame.time for frame in sim.frames(fps=2.0, duration=0.5)] == [0.0, 0.5]


def test_a_reset_is_refused_in_an_export(tmp_path):
    with ts.Simulation(flock(2), contacts="off", dt=0.05, **CPU) as sim:
        output = ts.open_output(tmp_path / "a.csv")
        with pytest.raises(ts.SceneError, match=r"^reset: cannot be called in an export"):
            ts.export(sim, output, fps=4, duration=1, checkpoint=1e-9, watch=lambda _: sim.reset(flock(2)))
        assert not list(tmp_path.iterdir())
        sim.reset(flock(2))
        assert ts.export(sim, None, fps=4, duration=1).frames == 5


@pytest.mark.once
@pytest.mark.parametrize(
    ("name", "moves"),
    [
        ("step", lambda sim: sim.step(3)),
        ("step", lambda sim: sim.run(0.2)),
        ("step", lambda sim: list(sim.frames(fps=8.0, duration=0.25))),
        ("export", lambda sim: ts.export(sim, None, fps=8, duration=0.25)),
    ],
    ids=["step", "run", "frames", "export"],
)
def test_nobody_else_moves_a_simulation_in_an_export(name, moves):
    """The frames that followed came at other times than those of the export, without a word."""

    class Mover(ts.Output):
        needs_image = False

        def write(self, index, frame, image):
            if index == 2:
                moves(sim)

        def finish(self):
            pass

        def discard(self):
            pass

    says = (
        rf"^{name}: cannot be called in an export, which moves the simulation itself; call it when the export has ended"
    )
    with ts.Simulation(flock(2), contacts="off", dt=0.05, **CPU) as sim:
        for given in ({"output": Mover()}, {"output": None, "watch": lambda frame: frame.time > 0.3 and moves(sim)}):
            sim.reset(flock(2))
            with pytest.raises(ts.SceneError, match=says):
                ts.export(sim, **given, fps=4, duration=1)
            assert sim.time == pytest.approx(0.5)
        moves(sim)
