"""Random scenes of springs: sleds and jelly on the ground, chains, balloons, pendulums, sheets, led ends."""

from collections.abc import Iterator
from typing import Any

import numpy as np

import taichi_sim as ts

from .agreement import PROCESSES, VIEWS, slowest
from .bounces import blank, log, up
from .likeness import block
from .observe import Case
from .scenes import components

__all__ = ["BODIES", "METHODS"]

Rng = np.random.Generator
METHODS = ("verlet", "rk4", "symplectic_euler", "implicit_euler", "tr_bdf2", "xpbd", "explicit_euler")


def ground(scene: ts.Scene, kind: str, material: str) -> None:
    """Solid below y = 0."""
    dim = scene.dim
    centre, size = np.array([0.0, -1.0, 0.0])[:dim], np.array([16.0, 2.0, 4.0])[:dim]
    if kind == "wall":
        scene.add_wall(np.eye(dim)[1], 0.0, material)
    elif kind == "box":
        scene.add_collider(ts.Box(centre, size, material=material))
    else:
        scene.add_collider(ts.Mesh(block(size), position=centre, material=material, resolution=16))


def chain(scene: ts.Scene, at: np.ndarray, stiffness: float, damping: float = 0.0, **balls: Any) -> None:
    """Balls at so many metres along x, each joined to the next."""
    x = np.zeros((len(at), scene.dim))
    x[:, 0] = at
    made = scene.add_balls(x, body=scene.new_body(), **balls)
    scene.add_springs(np.stack([made[:-1], made[1:]], axis=1), stiffness=stiffness, damping=damping)


def _sleds(rng: Rng, n: int, method: str | None = None) -> Iterator[Case]:
    """Feet that carry a load on springs and slide."""
    dim = int(rng.integers(2, 4))
    kind = str(rng.choice(["wall", "box"] if dim == 2 else ["wall", "box", "mesh"]))
    method = method or str(rng.choice(METHODS))
    stray = rng.random() < 0.5  # a loose ball above, which turns by friction where feet do not
    for _ in range(n if kind != "mesh" else 4):
        mu = float(rng.uniform(0.1, 0.8))
        scene = blank(dim, 10.0, friction=mu)
        load, r, foot = float(log(rng, 0.5, 50.0)), 0.05, float(log(rng, 0.1, 3.0))
        feet = 2 if dim == 2 else 3
        x = np.zeros((feet + 1, dim))
        angle = 2 * np.pi * np.arange(feet) / feet
        x[:feet, 0] = 0.4 * np.cos(angle)
        if dim == 3:
            x[:feet, 2] = 0.4 * np.sin(angle)
        x[:feet, 1], x[feet, 1] = r, 0.16
        mass = np.full(feet + 1, foot)
        mass[feet] = load * foot * feet
        v = np.zeros(dim)
        v[0] = 1.4 * mu * 10.0 * 0.3 + 0.5
        balls = scene.add_balls(x, radius=r, mass=mass, velocity=v, material="m", body=scene.new_body())
        pairs = [[i, j] for i in balls for j in balls if i < j]
        # flat struts: so stiff that the load sinks in by a fiftieth of its height
        k = 50.0 * 10.0 * mass.sum() / 0.11
        scene.add_springs(pairs, stiffness=k, damping=0.4 * np.sqrt(k * foot))
        if stray:
            scene.add_balls([np.eye(dim)[1]], radius=r, mass=foot, material="m")
        ground(scene, kind, "m")
        yield Case(scene, {"integrator": method}, 0.3, 6)


def _jelly_slides(rng: Rng, n: int) -> Iterator[Case]:
    """Jelly that lands along the ground."""
    dim = 2 if rng.random() < 0.7 else 3
    kind, fabric = str(rng.choice(["wall", "box"])), rng.random() < 0.5
    method = str(rng.choice(["verlet", "verlet", "rk4", "symplectic_euler"]))
    for _ in range(n if dim == 2 else 3):
        scene = blank(dim, 10.0, friction=float(rng.uniform(0.1, 0.4)))
        size = (0.4, 0.2, 0.2)[:dim]
        made = {"young_modulus": 2e4, "poisson_ratio": 0.35, "damping": 2.0} if fabric else {}
        # by its centre of mass, a touch above the ground
        body = ts.shapes.jelly(scene, size, (5, 3, 3)[:dim], material="m", position=(0.0, 0.06, 0.0)[:dim], **made)
        v = [rng.uniform(8.0, 20.0), -rng.uniform(0.5, 3.0), 0.0][:dim]
        scene.set_balls(body.balls, velocity=v)
        ground(scene, kind, "m")
        yield Case(scene, {"integrator": method}, 0.15, 4)


def _jelly_stays(rng: Rng, n: int) -> Iterator[Case]:
    """Jelly at rest on ground that is less steep than its friction holds."""
    dim = 2
    slope = float(rng.uniform(0.1, 0.4))
    kind, method = str(rng.choice(["wall", "box"])), str(rng.choice(["verlet", "rk4", "implicit_euler"]))
    for _ in range(n):
        scene = ts.Scene(dim, (10.0 * np.sin(slope), -10.0 * np.cos(slope)))
        scene.add_material("m", friction=float(np.tan(slope) * rng.uniform(1.3, 2.5)))
        made = {"young_modulus": float(log(rng, 5e3, 5e4)), "damping": 2.0} if rng.random() < 0.5 else {}
        size, number = (0.4, float(rng.uniform(0.15, 0.25))), (5, 3)
        radius = 0.45 * min(size[0] / 4, size[1] / 2)
        ts.shapes.jelly(scene, size, number, material="m", radius=radius, position=(0.0, radius), **made)
        ground(scene, kind, "m")
        yield Case(scene, {"integrator": method}, 1.0, 2)


def _chains(rng: Rng, n: int) -> list[Case]:
    """Chains of damped springs, a load at their ends, in their slowest mode."""
    dim, method = int(rng.integers(2, 4)), str(rng.choice(["verlet", "verlet", "rk4", "tr_bdf2"]))
    stiffness = float(log(rng, 1e3, 1e5))
    drawn = []
    for _ in range(n):
        scene = ts.Scene(dim)
        links = int(rng.integers(4, 20))
        mass = np.ones(links + 1)
        mass[-1] = log(rng, 1.0, 300.0)
        critical = 2 * np.sqrt(stiffness * mass.sum() * links)  # about, of the whole
        damping = min(float(log(rng, 3e-3, 0.5)) * critical, 0.3 * np.sqrt(stiffness) * (mass.sum() * links) ** 0.5)
        chain(scene, 0.1 * np.arange(links + 1), stiffness, damping, radius=0.01, mass=mass, pinned=[0])
        value, _, right = slowest(scene, components(scene)[0])
        speed = right[scene.n_balls * dim :]
        speed = np.real(speed / speed[np.argmax(np.abs(speed))])
        scene.set_balls(velocity=0.01 * abs(value) * speed.reshape(-1, dim))  # it moves by a tenth of a link
        drawn.append((scene, -value.real))
    longest = min(8.0, float(np.median([2.0 / decay for _, decay in drawn])))
    return [Case(scene, {"integrator": method}, longest, 60) for scene, _ in drawn]


def _balloons(rng: Rng, n: int) -> Iterator[Case]:
    """Balloons that turn freely."""
    method = str(rng.choice(["implicit_euler", "xpbd", "verlet", "tr_bdf2"]))
    for _ in range(n):
        scene = ts.Scene(3)
        radius = float(rng.uniform(0.15, 0.4))
        body = ts.shapes.balloon(
            scene,
            (0.0, 0.0, 0.0),
            radius,
            1,
            stretch_stiffness=float(log(rng, 50, 300)),
            damping=0.05,
            ball_radius=0.02,
        )
        axis = rng.normal(size=3)
        scene.set_balls(body.balls, velocity=np.cross(0.5 * axis / np.linalg.norm(axis), scene.position[body.balls]))
        yield Case(scene, {"integrator": method}, 0.5, 4)


def _hung_balloons(rng: Rng, n: int) -> Iterator[Case]:
    """Balloons pinned at the top that sag."""
    method = str(rng.choice(["implicit_euler", "xpbd", "tr_bdf2"]))
    for _ in range(n):
        scene = ts.Scene(3, (0.0, -10.0, 0.0))
        body = ts.shapes.balloon(
            scene,
            (0.0, 0.0, 0.0),
            float(rng.uniform(0.2, 0.4)),
            1,
            mass=float(log(rng, 3e-3, 0.1)),
            damping=0.05,
            ball_radius=0.02,
        )
        top = body.balls[np.argmax(scene.position[body.balls, 1])]
        scene.set_balls(top, pinned=True)
        yield Case(scene, {"integrator": method}, 0.2, 4)


def _pendulums(rng: Rng, n: int) -> Iterator[Case]:
    """Very stiff pendulums and ropes, by an implicit method at long steps."""
    dim = int(rng.integers(2, 4))
    settings = {"integrator": "implicit_euler", "dt": 1.0 / float(rng.choice([60, 120, 240]))}
    for _ in range(n):
        scene = ts.Scene(dim, up(dim, 10.0))
        k, length = int(rng.choice([1, 1, 2, 5, 10])), float(rng.uniform(0.05, 0.5))
        mass, stiffness = float(log(rng, 0.1, 10)), float(log(rng, 1e5, 1e8))
        chain(scene, length * np.arange(k + 1) / k, stiffness, radius=0.01 * length, mass=mass, pinned=[0])
        yield Case(scene, settings, 2.0, 120)


def _sheets(rng: Rng, n: int) -> Iterator[Case]:
    """Folded sheets with damping of bending that turn freely."""
    for _ in range(n):
        scene = ts.Scene(3)
        body = ts.shapes.cloth(
            scene, (0.3, 0.3), (3, 3), mass_per_area=0.3, bending_rigidity=float(log(rng, 1e-5, 1e-3)), radius=0.005
        )
        x = scene.position[body.balls] - scene.position[body.balls].mean(axis=0)
        fold = float(rng.uniform(0.5, 1.5))
        x[:, 1] += np.sin(fold) * np.abs(x[:, 0])
        x[:, 0] *= np.cos(fold)
        x -= x.mean(axis=0)
        scene.set_balls(body.balls, position=x)
        scene.set_bending(damping=10.0 ** rng.uniform(-3, -1))
        axis = rng.normal(size=3)
        scene.set_balls(body.balls, velocity=np.cross(2.0 * axis / np.linalg.norm(axis), x))
        yield Case(scene, {"integrator": "verlet"}, 0.5, 4)


def _nets(rng: Rng, n: int) -> Iterator[Case]:
    """Cloth and ropes, damped by little or much, that hang, swing and feel wind; no contacts."""
    method = str(rng.choice(["verlet", "tr_bdf2", "implicit_euler"]))
    windy = rng.random() < 0.5
    for _ in range(n):
        scene = ts.Scene(3, (0.0, -10.0, 0.0))
        body = ts.shapes.cloth(
            scene,
            (0.6, 0.5),
            (4, 4),
            mass_per_area=float(log(rng, 0.1, 1.0)),
            bending_rigidity=1e-4,
            damping=0.0,
            radius=0.01,
        )
        scene.set_springs(damping=float(log(rng, 1e-3, 1e2)))
        scene.set_bending(damping=1e-3)
        scene.set_balls(body.balls[: int(rng.integers(1, 5))], pinned=True)
        if windy:
            scene.add_wind((1.0, 0.5, 2.0))
        yield Case(scene, {"integrator": method, "contacts": "off", "dt": 2.0**-11, "substeps": 1}, 0.25, 4)


def _led(rng: Rng, n: int) -> Iterator[Case]:
    """Chains of damped springs, one end led along a path with kinks at whole steps."""
    dim, method = int(rng.integers(2, 4)), str(rng.choice(["verlet", "tr_bdf2"]))
    dt = 2.0**-9
    for _ in range(n):
        scene = ts.Scene(dim)
        links = int(rng.integers(2, 6))
        k = float(log(rng, 1e2, 2e3))
        damping = float(rng.uniform(0.05, 0.2)) * np.sqrt(k)
        chain(scene, 0.2 * np.arange(links + 1), k, damping, radius=0.01)
        path = [(0.0, np.zeros(dim))]
        for step in (16, 40, 96):
            path.append((step * dt, rng.uniform(-0.05, 0.05, dim)))
        scene.add_moving_pins([0], path=[{"time": t, "position": p.tolist()} for t, p in path])
        yield Case(scene, {"integrator": method, "dt": dt, "substeps": 1, "contacts": "off"}, 128 * dt, 1)


def _hanging(rng: Rng, n: int) -> list[Case]:
    """A cloth that falls into the hands that hold it; a tolerance is asked for."""
    scene = ts.Scene(3, (0.0, -10.0, 0.0))
    k = int(rng.integers(6, 11))
    sheet = ts.shapes.cloth(
        scene, (1.0, 1.0), (k, k), stiffness=float(log(rng, 100, 1000)), damping=float(log(rng, 3e-3, 0.1))
    )
    scene.set_balls([sheet.balls[0], sheet.balls[k - 1]], pinned=True)
    tolerance = float(rng.choice([1e-3, 1e-4]))
    return [Case(scene, {"integrator": "verlet", "tolerance": tolerance}, 0.5, 1, alone=True)]


BODIES = {
    "sled": (_sleds, ("friction_is_mu_while_sliding",), 30),
    "jelly_slides": (_jelly_slides, ("friction_is_mu_while_sliding",), 24),
    "jelly_stays": (_jelly_stays, ("stays_below_the_friction_angle", "friction_is_mu_while_sliding"), 24),
    "chain": (_chains, ("decays_as_the_linear_network",), 30),
    "balloon": (_balloons, ("angular_momentum_is_kept", "momentum_is_kept"), 12),
    "hung_balloon": (_hung_balloons, ("methods_agree",), 10),
    "pendulum": (_pendulums, ("energy_never_grows",), 40),
    "folded_sheet": (_sheets, ("angular_momentum_is_kept", "momentum_is_kept"), 40),
    "net": (_nets, (*VIEWS, "restored_goes_on", "methods_agree", "default_step_is_near_a_small_one", *PROCESSES), 16),
    "led_chain": (_led, ("order_is_kept", "methods_agree"), 40),
    "hanging_cloth": (_hanging, ("tolerance_is_kept",), 1),
}
