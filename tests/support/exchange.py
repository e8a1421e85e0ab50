"""A scene with what files for other programs hold: sheets with images, one of them with a seam, marbles of two colours, a rope, a
body, colliders, a floor; and frames of it, without a simulation."""

import numpy as np
from PIL import Image

import taichi_sim as ts
from taichi_sim.analysis.lazy_frame import MomentsOf
from taichi_sim.outputs import open_output

FPS, FRAMES = 30.0, 7
RED, BLUE, GREEN = (0.9, 0.2, 0.1), (0.2, 0.4, 0.9), (0.0, 1.0, 0.0)
# two squares whose common side has other places on the image on either side of it
SAIL = """v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0
v 2 0 0
v 2 1 0
vt 0 0
vt 0.4 0
vt 0.4 1
vt 0 1
vt 0.6 0
vt 1 0
vt 1 1
vt 0.6 1
f 1/1 2/2 3/3 4/4
f 2/5 5/6 6/7 3/8
"""


def scene(folder):
    """The scene; the images that it names, and the mesh, are made in a folder."""
    for name, colour in (("flag.png", (10, 200, 30)), ("sail.png", (200, 30, 10))):
        Image.new("RGB", (4, 2), colour).save(folder / name)
    (folder / "sail.obj").write_text(SAIL)
    made = ts.Scene(dim=3, gravity=(0, -10, 0))
    flag = ts.shapes.cloth(made, (1, 2), (3, 4), position=(0, 1, 0), colour=BLUE)
    made.set_name(flag.balls, "left flag")
    sail = ts.shapes.cloth(made, mesh=folder / "sail.obj", position=(-3, 0, 0), colour=GREEN)
    made.set_name(sail.balls, "sail")
    jelly = ts.shapes.jelly(made, (0.4, 0.3, 0.3), (3, 3, 3), position=(2, 0.5, 0), colour=RED)
    made.set_name(jelly.balls, "pudding")
    ts.shapes.rope(made, (0, 2, 3), (1, 2, 3), 4)
    marbles = [
        made.add_balls([(0, 3, k), (0.5, 3, k)], radius=[0.1, 0.15], colour=c) for k, c in ((0, GREEN), (1, RED))
    ]
    made.set_name(np.concatenate(marbles), "marbles")
    made.add_collider(ts.Sphere((5, 0, 0), 0.3, velocity=(0, 0.6, 0), colour=RED, name="moon"))
    made.add_collider(ts.Box((7, 0, 0), (1, 2, 3), rotation_rate=(0, 0, 60.0)))
    made.add_wall((0, 1, 0), -1)
    made.output = {
        "looks": [
            {"of": "left flag", "texture": folder / "flag.png", "repeat": 2.0},
            {"of": "sail", "texture": folder / "sail.png"},
        ]
    }
    return made


def frames(of):
    """Frames of it, in which it falls, and turns a little."""
    moments, start = MomentsOf(of), of.position
    for k in range(FRAMES):
        x = start + np.array([0.0, -0.1 * k, 0.02 * k * k]) + 0.05 * k * start[:, [1, 2, 0]]
        yield moments.at(k / FPS, x, 0 * x, np.zeros((len(x), 3)), None)


def write(of, folder, names):
    """Files of the frames, and the frames."""
    made = list(frames(of))
    for name in names:
        with open_output(folder / name, fps=FPS) as output:
            output.prepare(made[0], (640, 360), {"looks": of.output["looks"]})
            for index, frame in enumerate(made):
                output.write(index, frame, None)
                output.frames += 1
    return made
