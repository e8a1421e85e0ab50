"""Pictures of the course, drawn from the programs of its chapters as they stand: python docs/draw_course.py [CHAPTER ...]."""

import contextlib
import io
import math
import re
import sys
import warnings
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from PIL import Image

import taichi_sim as ts
from taichi_sim.overlays import open_renderer

HERE = Path(__file__).parent / "course"
COLOURS = ((0.82, 0.29, 0.36), (0.18, 0.44, 0.58), (0.93, 0.68, 0.29), (0.36, 0.60, 0.42))  # sRGB
SIZE, PLOT, FRAMES, PAUSE = (
    (720, 320),
    (0.58, 1.0),
    40,
    1.5,
)  # of a clip: pixels, share of the plot, number, s at the end
FLOOR = [(0, 1, 0)]
LABELS = {"explicit_euler": "explicit Euler", "symplectic_euler": "symplectic Euler", "verlet": "Verlet"}
LABELS |= {"implicit_euler": "implicit Euler", "tr_bdf2": "TR-BDF2"}


def names_of(chapter):
    """Names that the programs of a chapter leave."""
    text = (HERE / f"{chapter}.md").read_text(encoding="utf-8")
    names: dict = {}
    with contextlib.redirect_stdout(io.StringIO()), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for program in re.findall(r"```python\n(.*?)```", text, re.DOTALL):
            exec(compile(program, chapter, "exec"), names)
    return names


def picture(figure):
    """Pixels of a figure."""
    file = io.BytesIO()
    figure.savefig(file, dpi=100)
    return Image.open(file).convert("RGB")


def clip(chapter, times, curves, exact, centres, view, value, limits=None, radius=0.1, springs=(), walls=(), of=None):
    """Write a clip: left the balls with a clock, right each curve so far over the exact one, which is grey.

    curves: label to numbers at the times; exact: label to the same; centres: of the balls (times, n, 2); view: (x0, x1, y0, y1)
    of the left side; value: name and unit of the curves; limits: of them, theirs by default; springs: pairs of balls; walls:
    rows of a normal and an offset; of: the number of the curve that a ball has the colour of, in equal parts by default.
    """
    times, centres = np.asarray(times, dtype=float), np.asarray(centres, dtype=float)
    balls, colours = centres.shape[1], dict(zip(curves, COLOURS))
    of = [n * len(curves) // balls for n in range(balls)] if of is None else of
    share = 1 - PLOT[0]
    scale = min(share * SIZE[0] / (view[1] - view[0]), SIZE[1] / (view[3] - view[2]))  # px per metre
    middle = (view[0] + view[1]) / 2 + PLOT[0] * SIZE[0] / 2 / scale, (view[2] + view[3]) / 2
    probes = [
        {"of": label, "expected": np.column_stack([times, exact[label]]), "colour": colours[label]} for label in curves
    ]
    overlay = {"clock": True, "probes": probes, "plot_size": PLOT, "plot_label": value, "text_size": 11}
    overlay |= {} if limits is None else {"plot_range": limits}
    style = {"camera": {"centre": middle, "width": SIZE[0] / scale}, "overlay": overlay}
    shown = np.unique(np.linspace(0, len(times) - 1, FRAMES).round().astype(int))
    frames = [
        ts.Frame(
            time=times[k],
            position=centres[k],
            velocity=np.zeros_like(centres[k]),
            radius=np.full(balls, radius),
            springs=np.array(springs, dtype=np.int32).reshape(-1, 2),
            colour=np.array(COLOURS)[of],
            walls=np.array(walls, dtype=float).reshape(-1, 3),
            probes={label: float(numbers[k]) for label, numbers in curves.items()},
        )
        for k in range(len(times))
    ]
    fps = len(shown) / (times[-1] - times[0])
    with open_renderer(frames[0], SIZE, style) as renderer, ts.open_output(HERE / f"{chapter}.webp", fps=fps) as output:
        renderer.fit(frames)
        drawn = 0
        for k, frame in enumerate(frames):
            if k not in shown:
                renderer.skip(frame)
                continue
            image = renderer.render(frame)
            for _ in range(round(PAUSE * fps) if k == shown[-1] else 1):
                output.write(drawn, frame, image)
                drawn += 1


def curves_wrong(chapter, curves, ylabel, **more):
    """Write the picture of what goes wrong: label to (times, numbers)."""
    figure, axes = plt.subplots(figsize=(6.4, 2.8), layout="constrained")
    for (label, (times, numbers)), colour in zip(curves.items(), COLOURS):
        axes.plot(times, numbers, color=colour, label=label)
    axes.axhline(0, color="#999999", linewidth=0.8, zorder=0)
    axes.set(xlabel="t [s]", ylabel=ylabel, **more)
    axes.legend(fontsize=8)
    picture(figure).quantize(64).save(HERE / f"{chapter}_wrong.png", optimize=True)
    plt.close(figure)


def bounces(times, first, e, g=10.0):
    """Exact heights of a ball that is dropped from the height `first`, with restitution e."""
    found, height, start = [], first, -math.sqrt(2 * first / g)  # as if it had been thrown up before
    for t in times:
        while height > 1e-7 and t > start + 2 * math.sqrt(2 * height / g):
            start += 2 * math.sqrt(2 * height / g)
            height *= e**2
        since = t - start
        found.append(max(0.0, math.sqrt(2 * g * height) * since - g * since**2 / 2))
    return found


def by_the_simple_rule(h, e, duration, radius=0.1):
    """Times and heights of the loop of chapters 3 and 4."""
    x, v, heights = 1.35, 0.0, [1.25]
    for _ in range(round(duration / h)):
        v -= 10 * h
        x += v * h
        if x < radius and v < 0:
            v = -e * v
        heights.append(x - radius)
    return np.arange(len(heights)) * h, heights


def motion(chapter):
    names = names_of(chapter)
    times, x = np.array(names["times"]), np.array(names["positions"])
    curves = {f"{v} m/s": x[:, v - 1] for v in (1, 2, 3)}
    exact = {f"{v} m/s": v * times for v in (1, 2, 3)}
    centres = np.stack([x, np.broadcast_to([0, 1, 2], x.shape)], axis=2)
    clip(chapter, times, curves, exact, centres, (-0.5, 6.5, -1, 3), "x [m]", radius=0.15)


def gravity(chapter):
    heights = {LABELS[method]: numbers for method, numbers in names_of(chapter)["heights"].items()}
    times = np.linspace(0, 2, 11)
    exact = dict.fromkeys(heights, 10 * times - 5 * times**2)
    centres = np.stack([np.stack([3 * times, one], axis=1) for one in heights.values()], axis=1)
    clip(chapter, times, heights, exact, centres, (-0.5, 8, -2.5, 6.5), "height [m]", (-2.5, 9), radius=0.2)


def walls(chapter):
    names = names_of(chapter)
    upto = 151  # 3 s
    times, heights = np.array(names["times"])[:upto], np.array(names["heights"])[:upto]
    curves = {"from 1.25 m": heights[:, 0], "from 0.625 m": heights[:, 1]}
    exact = {"from 1.25 m": bounces(times, 1.25, 1.0), "from 0.625 m": bounces(times, 0.625, 1.0)}
    centres = np.stack([np.broadcast_to([0, 1], heights.shape), heights + 0.1], axis=2)
    clip(chapter, times, curves, exact, centres, (-0.6, 1.6, -0.1, 1.6), "height [m]", (0, 1.9), walls=FLOOR)
    wrong = {f"steps of {1000 * h:.0f} ms": by_the_simple_rule(h, 1.0, 10) for h in (0.01, 0.05)}
    curves_wrong(chapter, wrong, "height [m]")


def restitution(chapter):
    names = names_of(chapter)
    upto = 201  # 4 s
    times, heights = np.array(names["times"])[:upto], np.array(names["heights"])[:upto]
    curves = {f"e = {e}": heights[:, k] for k, e in enumerate((0.5, 0.7, 0.9))}
    exact = {f"e = {e}": bounces(times, 1.25, e) for e in (0.5, 0.7, 0.9)}
    centres = np.stack([np.broadcast_to([0, 0.5, 1], heights.shape), heights + 0.1], axis=2)
    clip(chapter, times, curves, exact, centres, (-0.6, 1.6, -0.1, 1.6), "height [m]", (0, 1.9), walls=FLOOR)
    wrong = {f"steps of {1000 * h:.0f} ms": by_the_simple_rule(h, 0.5, 6) for h in (0.01, 0.05)}
    curves_wrong(chapter, wrong, "height [m]")


def rows_of(lengths):
    """Centres of the balls of one spring a row, about their common middle, and the pairs."""
    ends = [
        np.stack([side * np.array(one) / 2, np.full(len(one), -0.5 * row)], axis=1)
        for row, one in enumerate(lengths)
        for side in (-1, 1)
    ]
    return {"centres": np.stack(ends, axis=1), "springs": [(2 * row, 2 * row + 1) for row in range(len(ends) // 2)]}


def springs(chapter):
    names = names_of(chapter)
    lengths = {LABELS[method]: numbers for method, numbers in names["lengths"].items()}
    exact = dict.fromkeys(lengths, names["exact"])
    rows = rows_of(lengths.values())
    clip(
        chapter,
        np.array(names["times"]),
        lengths,
        exact,
        view=(-1.3, 1.3, -1.5, 0.5),
        value="length [m]",
        limits=(0, 3),
        **rows,
    )


def damped(times, c, k=50.0, m=0.5):
    """Exact lengths of the spring of chapter 6."""
    decay, rate = c / (2 * m), k / m
    root = np.sqrt(complex(rate - decay**2))
    part = times if root == 0 else np.sin(root * times) / root
    return 1 + 0.5 * np.real(np.exp(-decay * times) * (np.cos(root * times) + decay * part))


def damping(chapter):
    names = names_of(chapter)
    upto = 76  # 1.5 s
    times = np.array(names["times"])[:upto]
    lengths = {f"c = {c:.0f} N s/m": np.array(numbers)[:upto] for c, numbers in names["lengths"].items()}
    exact = {f"c = {c:.0f} N s/m": damped(times, c) for c in names["lengths"]}
    rows = rows_of(lengths.values())
    clip(chapter, times, lengths, exact, view=(-1.3, 1.3, -1.5, 0.5), value="length [m]", limits=(0.5, 1.9), **rows)
    wrong = {f"h = {h} s": ((1 + np.arange(16)) * h, stretch) for h, stretch in names["stretches"].items()}
    curves_wrong(chapter, wrong, "stretch [m]", ylim=(-8, 8))


def friction(chapter):
    names = names_of(chapter)
    times, ways = np.array(names["times"]), np.array(names["ways"])
    curves, exact = {}, {}
    for k, mu in enumerate((0.1, 0.2, 0.4)):
        until = np.minimum(times, 4 / (10 * mu))
        curves[f"mu = {mu}"], exact[f"mu = {mu}"] = ways[:, k], 4 * until - 5 * mu * until**2
    centres = np.stack([ways, np.broadcast_to([2.0, 1.0, 0.0], ways.shape)], axis=2)
    clip(chapter, times, curves, exact, centres, (-0.5, 8.5, -1.5, 3.5), "way [m]", (0, 8.5), radius=0.25)
    wrong = {f"f h = {f / 100}": (np.arange(6) * 0.01, [4.0, *names["speeds"](f)]) for f in (50, 150, 250)}
    curves_wrong(chapter, wrong, "speed [m/s]", ylim=(-15, 25))


def collisions(chapter):
    names = names_of(chapter)
    places = {name: np.array(one) for name, one in names["places"].items()}
    times = np.linspace(0, 1.2, 61)
    curves = {name: one[:, 1] for name, one in places.items()}
    after = np.maximum(times - 0.5, 0)  # the balls meet after 1 m at 2 m/s
    exact = {name: speed * after for name, speed in zip(places, (2, 3, 1))}
    centres = [
        np.stack([one[:, k], np.full(len(times), -0.6 * row)], axis=1)
        for row, one in enumerate(places.values())
        for k in (0, 1)
    ]
    clip(
        chapter,
        times,
        curves,
        exact,
        np.stack(centres, axis=1),
        (-1.5, 2.3, -2, 0.8),
        "place of the second ball [m]",
        (-0.1, 3.2),
    )


def sticks(chapter):
    names = names_of(chapter)
    times, heights = np.array(names["times"]), np.array(names["heights"])
    labels = ("in the middle", "at a quarter", "at the end")
    curves = {label: heights[:, k] for k, label in enumerate(labels)}
    exact = {}
    for label, speed, low in zip(labels, (1 / 3, 3 / 13, 0.0), (0.1, 0.1, 0.16)):  # m/s afterwards, m of the hit
        hit = 1 - low
        exact[label] = np.where(times < hit, 1 - times, low + speed * (times - hit))
    places = np.stack([frame.position for frame in names["frames"]])
    pairs = [(3 * row, 3 * row + 1) for row in range(3)]
    clip(chapter, times, curves, exact, places, (-0.3, 4.5, -1.4, 1.3), "height [m]", (0, 1.5), springs=pairs)


def stacks(chapter):
    names = names_of(chapter)
    times, places = names["times"], np.array(names["places"])
    curve = {"impulse on the floor": np.array(names["taken"])}
    exact = {"impulse on the floor": names["exact"]}
    clip(chapter, times, curve, exact, places, (-0.9, 0.9, -0.15, 1.6), "impulse [N s]", walls=FLOOR)
    seconds = np.arange(1, 61) / 60
    wrong = {
        f"{rounds} round{'s' * (rounds > 1)}, {'with' if remembers else 'no'} memory": names["sinking"](
            rounds, remembers
        )
        for rounds, remembers in ((1, False), (10, False), (10, True))
    }
    curves_wrong(chapter, {label: (seconds, depths) for label, depths in wrong.items()}, "the top has sunk by [m]")


def cloth_and_jelly(chapter):
    names = names_of(chapter)
    times, stretches = np.array(names["times"]), np.array(names["stretches"])
    late = 1 / math.sqrt(names["E"] / names["density"])  # s: the wave arrives at the lower end
    exact = [
        5 * t**2 + sum((-1) ** (k // 2 + 1) * 10 * max(0.0, t - k * late) ** 2 for k in range(1, 30, 2)) for t in times
    ]
    labels = ("jelly", "cloth")
    curves = {label: stretches[:, k] for k, label in enumerate(labels)}
    places = np.array(names["places"])
    sides, springs, of = [], [], []
    for k, one in enumerate(
        names["shapes"]
    ):  # the balls of the side that faces us, joined along their rows and columns
        x = names["scene"].position[one.balls]
        side = one.balls[x[:, 2] > x[:, 2].max() - 1e-6]
        first, x = len(of), places[0, side, :2]
        gaps = np.abs(x[:, None] - x)
        near = (gaps.min(axis=2) < 1e-6) & (gaps.max(axis=2) < (0.21, 0.13)[k])
        springs += (first + np.argwhere(np.triu(near, 1))).tolist()
        sides, of = [*sides, side], of + [k] * len(side)
    order = np.concatenate(sides)
    seen = places[0, order, :2] + 20 * (places[:, order, :2] - places[0, order, :2])
    clip(
        chapter, times, curves, dict.fromkeys(labels, 1000 * np.array(exact)), seen, (-0.3, 1.0, -0.4, 1.2),
        "stretch [mm]", radius=0.02, springs=springs, of=of,
    )  # fmt: skip


def implicit(chapter):
    names = names_of(chapter)
    angles = {LABELS[method]: np.array(one) for method, one in names["angles"].items()}
    times = np.array(names["times"])
    parts = [np.stack([2.6 * k + np.sin(one), -np.cos(one)], axis=1) for k, one in enumerate(angles.values())]
    hooks = [np.broadcast_to([2.6 * k, 0.0], (len(times), 2)) for k in range(2)]
    centres = np.stack([hooks[0], parts[0], hooks[1], parts[1]], axis=1)
    exact = dict.fromkeys(angles, names["exact"])
    clip(
        chapter, times, angles, exact, centres, (-1.2, 3.8, -1.4, 0.6), "angle [rad]", (-1.2, 1.2), springs=[(0, 1), (2, 3)]
    )  # fmt: skip


def error(chapter):
    names = names_of(chapter)
    steps = (0.2, 0.1, 0.05)
    times = np.linspace(0, 5, 101)
    places = {}
    for h in steps:
        one = np.array(names["places"][h])
        at = np.arange(len(one)) * h
        places[f"h = {h} s"] = np.stack([np.interp(times, at, one[:, k]) for k in (0, 1)], axis=1)
    exact = dict.fromkeys(places, np.cos(names["w"] * times))
    curves = {label: one[:, 0] for label, one in places.items()}
    clip(
        chapter, times, curves, exact, np.stack(list(places.values()), axis=1), (-1.2, 1.2, -0.9, 0.9), "x [m]", (-1.1, 1.1),
        radius=0.06,
    )  # fmt: skip
    apart = np.array(names["apart"])
    curve = {"distance of the second ball": (np.arange(len(apart)) / 2, np.maximum(apart, 1e-6))}
    curves_wrong(chapter, curve, "apart [m]", yscale="log", ylim=(1e-6, 10))


CHAPTERS = {
    "01_motion": motion,
    "02_gravity": gravity,
    "03_walls": walls,
    "04_restitution": restitution,
    "05_springs": springs,
    "06_damping": damping,
    "07_friction": friction,
    "08_collisions": collisions,
    "09_sticks": sticks,
    "10_stacks": stacks,
    "11_cloth_and_jelly": cloth_and_jelly,
    "12_implicit": implicit,
    "13_error": error,
}

if __name__ == "__main__":
    plt.switch_backend("agg")
    for chapter in sys.argv[1:] or CHAPTERS:
        CHAPTERS[chapter](chapter)
