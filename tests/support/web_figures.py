"""The figures of docs/web.md: what pages of four scenes get, and what they cost. `python -m tests.support.web_figures` prints
the table. It takes Chromium."""

import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from chromium import Chromium, Window, chromium
from web_page import Page

import taichi_sim as ts
from taichi_sim.analysis.frame import Frame
from taichi_sim.viewer.web import MOST_FPS
from taichi_sim.viewer.web_server import WebServer
from taichi_sim.viewer.web_stage import WebStage

MOVING = ("/balls", "/points0", "/surface0")  # parts of which one is in each scene
MOMENTS, SECONDS = 8, 10.0  # pictures that take turns, and how long each page is watched
WARM = 150.0  # s that it may take to show its first pictures
SHOWN = """() => {
    // a picture is shown at an animation frame before which positions were handed to the graphics card
    window.pictures = 0;
    let sent = false;
    const upload = WebGL2RenderingContext.prototype;
    for (const name of ['bufferData', 'bufferSubData', 'texSubImage2D']) {
        const plain = upload[name];
        upload[name] = function (...all) { sent = true; return plain.apply(this, all); };
    }
    const tick = () => { window.pictures += sent; sent = false; requestAnimationFrame(tick); };
    requestAnimationFrame(tick);
}"""


def balls(number: int) -> list[Frame]:
    """Moments of so many loose balls in a box."""
    start = np.random.default_rng(1).uniform(-1, 1, (number, 3))
    radius = np.full(number, 0.3 * number ** (-1 / 3))
    turns = 2 * np.pi * np.arange(MOMENTS) / MOMENTS
    return [Frame(turn, x := start + 0.1 * np.sin(turn + 3 * start[:, ::-1]), 0 * x, radius) for turn in turns]


def cloth(side: int) -> list[Frame]:
    """Moments of a cloth of side x side balls."""
    scene = ts.Scene(dim=3)
    ts.shapes.cloth(scene, size=(1, 1), resolution=(side, side))
    frames = []
    with ts.Simulation(scene, arch="cpu", contacts="off") as sim:
        start = sim.position
        for turn in 2 * np.pi * np.arange(MOMENTS) / MOMENTS:
            sim.set_position(start + 0.1 * np.sin(turn + 5 * start[:, [1, 0, 1]]) * (0, 1, 0))
            frames.append(sim.frame())
    return frames


def feed(stage: WebStage, frames: list[Frame], until: Callable[[int], bool]) -> tuple[int, float]:
    """Show them in turn, at most MOST_FPS a second, until a number of them is enough; this number, and the processor time of
    one [s]."""
    number, cost, due = 0, 0.0, time.perf_counter()
    while not until(number):
        begin = time.thread_time()
        stage.show(frames[number % len(frames)])
        cost += time.thread_time() - begin
        number += 1
        due = max(due + 1 / MOST_FPS, time.perf_counter())
        time.sleep(max(0.0, due - time.perf_counter()))
    return number, cost / number


def told(window: Window) -> tuple[float, float, float]:
    """Pictures that it has shown, processor time of its scripts so far [s], and the present time [s]."""
    found = {one["name"]: one["value"] for one in window.call("Performance.getMetrics")["metrics"]}
    return window.run("window.pictures"), found["ScriptDuration"], time.perf_counter()


def for_a_while() -> Callable[[int], bool]:
    """True once SECONDS are over."""
    end = time.perf_counter() + SECONDS
    return lambda number: time.perf_counter() > end


def row(name: str, frames: list[Frame], browser: Chromium) -> str:
    """A line of the table."""
    with WebServer(port=0) as server:
        stage = WebStage(server, frames[0], {})
        stage.show(frames[0])
        with Page(server.url) as page:
            time.sleep(3.0)
            before, part = page.bytes, next(part for name, part in page.parts.items() if name.startswith(MOVING))
            most = part.get("updates", 0) + 30
            feed(stage, frames, lambda number: part["updates"] >= most)
            time.sleep(3.0)
            size = (page.bytes - before) / (part["updates"] - most + 30)
        window = browser.window()
        window.call("Performance.enable", timeDomain="threadTicks")
        window.call("Page.addScriptToEvaluateOnNewDocument", source=f"({SHOWN})()")
        window.open(server.url)
        end = time.perf_counter() + WARM
        while window.run("window.pictures") < 3 and time.perf_counter() < end:  # it compiles its shaders first
            feed(stage, frames, for_a_while())
        start = np.array(told(window))
        sent, cost = feed(stage, frames, for_a_while())
        shown, scripts, spent = told(window) - start
        window.close()
    return (
        f"| {name} | {size / 1000:.0f} kB | {1000 * cost:.1f} ms | {1000 * scripts / max(shown, 1):.0f} ms"
        f" | {sent / spent:.0f} | {shown / spent:.1f}"
        f" | {len(window.errors)} |"
    )


if __name__ == "__main__":
    print(
        "| scene | bytes of a picture | processor time | of the page | sent a second | shown a second | errors in the console |"
    )
    print("|---|---|---|---|---|---|---|")
    with chromium() as browser:
        for number in (1_000, 10_000, 100_000, 1_000_000):
            print(row(f"{number} balls", balls(number), browser), flush=True)
        print(row("cloth of 128 x 128 balls", cloth(128), browser), flush=True)
