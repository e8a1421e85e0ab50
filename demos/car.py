"""A car of soft wheels and springs drives over sticks."""

import numpy as np

import taichi_sim as ts

WHEEL, SPOKES = 0.3, 20


def scene(speed=2.0, friction=0.9, stiffness=9000.0):
    scene = ts.Scene(dim=2, gravity=(0, -10))
    scene.output = {"fps": 60, "duration": 6, "size": (1280, 720)}
    scene.settings = {"spin": False}  # the balls of a tyre do not turn on their own
    scene.add_material("rubber", friction=friction)
    along = np.arange(-1.0, 34.0, 0.2)
    height = -0.22 * along + 0.07 * np.sin(2.6 * along) * np.clip(along / 4 - 0.5, 0, 1) - 0.06
    road = scene.add_balls(np.stack([along, height], axis=1), radius=0.02, pinned=True, material="rubber")
    scene.add_springs(np.stack([road[:-1], road[1:]], axis=1), stiffness=1.0, collides=True)
    hubs = []
    for x in (0.0, 1.3):
        wheel = ts.shapes.wheel(
            scene, centre=(x, WHEEL + 0.1 - 0.22 * x), radius=WHEEL, spokes=SPOKES, mass=3.0, stiffness=stiffness, damping=1.0,
            material="rubber", colour=(0.2, 0.2, 0.22), ball_radius=0.05,
        )  # fmt: skip
        hubs.append(wheel.balls[0])
    body = scene.add_balls(
        [[-0.25, 0.68], [0.65, 0.5], [1.55, 0.3], [-0.2, 0.95], [0.3, 1.15], [1.0, 1.0], [1.5, 0.6]],
        radius=0.06, mass=1.5, body=scene.new_body(), collides_with=[], colour=(0.85, 0.25, 0.2),
    )  # fmt: skip
    pairs = [(i, j) for i in range(7) for j in range(i)]
    scene.add_springs(body[np.array(pairs)], stiffness=8000, damping=20)
    for hub, struts in zip(hubs, ((0, 1, 3), (1, 2, 6))):
        scene.attach([hub] * 3, body[list(struts)], stiffness=2500, damping=30)
    scene.output["camera"] = {"follow": body.tolist(), "width": 8.0}
    scene.set_balls(~scene.pinned, velocity=(speed, -0.22 * speed))
    return scene


def check(sim):
    car = ~sim.scene.pinned
    assert sim.position[car, 0].mean() > 8.0
    assert np.ptp(sim.position[car, 0]) < 2.6  # in one piece
