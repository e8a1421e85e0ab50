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

HERE = Path(__file__).parent / "course"
COLOURS = ("#d1495b", "#2e6f95", "#edae49")
SIZE, DPI, FRAMES = (7.2, 3.2), 100, 40  # inches, pixels an inch, of a clip
LABELS = {"explicit_euler": "explicit Euler", "symplectic_euler": "symplectic Euler", "verlet": "Verlet"}


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
    figure.savefig(file, dpi=DPI)
    return Image.open(file).convert("RGB")


def clip(chapter, times, curves, exact, centres, view, value, limits=None, radius=0.1, springs=()):
    """Write a clip: left the balls with clock and value, right each curve so far over the exact one, which is grey.

    curves: label to numbers at the times; exact: label to the same; centres: of the balls (times, n, 2); view: (x0, x1, y0, y1)
    of the left side; value: name and unit of the curves; limits: of them, theirs by default; springs: pairs of balls.
    """
    shown = np.unique(np.linspace(0, len(times) - 1, FRAMES).round().astype(int))
    images = []
    for k in shown:
        figure, (left, right) = plt.subplots(1, 2, figsize=SIZE, layout="constrained")
        for a, b in springs:
            left.plot(*np.transpose(centres[k][[a, b]]), color="#777777", zorder=0)
        for n, centre in enumerate(centres[k]):
            left.add_patch(plt.Circle(centre, radius, color=COLOURS[n * len(curves) // len(centres[k])]))
        left.set(xlim=view[:2], ylim=view[2:], aspect="equal", xlabel="x [m]", ylabel="y [m]")
        left.set_title(f"t = {times[k]:.2f} s", loc="left", family="monospace", fontsize=11)
        for (label, numbers), colour in zip(curves.items(), COLOURS):
            right.plot(times, exact[label], color="#bbbbbb", linewidth=3.5, zorder=0)
            right.plot(times[: k + 1], numbers[: k + 1], color=colour, label=f"{label}: {numbers[k]:.2f}")
        right.set(xlabel="t [s]", ylabel=value, xlim=(times[0], times[-1]), ylim=limits)
        right.legend(loc="upper right", fontsize=8, framealpha=0.85)
        images.append(picture(figure))
        plt.close(figure)
    duration = [round(1000 * (times[-1] - times[0]) / len(shown))] * (len(shown) - 1) + [1500]
    images[0].save(
        HERE / f"{chapter}.webp",
        save_all=True,
        append_images=images[1:],
        duration=duration,
        loop=0,
        quality=60,
        method=4,
    )


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
    clip(chapter, times, curves, exact, centres, (-0.6, 1.6, 0, 1.6), "height [m]", (0, 1.9))
    wrong = {f"steps of {1000 * h:.0f} ms": by_the_simple_rule(h, 1.0, 10) for h in (0.01, 0.05)}
    curves_wrong(chapter, wrong, "height [m]")


def restitution(chapter):
    names = names_of(chapter)
    upto = 201  # 4 s
    times, heights = np.array(names["times"])[:upto], np.array(names["heights"])[:upto]
    curves = {f"e = {e}": heights[:, k] for k, e in enumerate((0.5, 0.7, 0.9))}
    exact = {f"e = {e}": bounces(times, 1.25, e) for e in (0.5, 0.7, 0.9)}
    centres = np.stack([np.broadcast_to([0, 0.5, 1], heights.shape), heights + 0.1], axis=2)
    clip(chapter, times, curves, exact, centres, (-0.6, 1.6, 0, 1.6), "height [m]", (0, 1.9))
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
    clip(chapter, times, curves, exact, centres, (-0.5, 8.5, -1.5, 3.5), "way [m]", (0, 11), radius=0.25)
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
}

if __name__ == "__main__":
    plt.switch_backend("agg")
    for chapter in sys.argv[1:] or CHAPTERS:
        CHAPTERS[chapter](chapter)
