"""Pages on which a simulation is watched: who is admitted, what is shown, what can be done, and what it costs a run."""

import importlib
import re
import signal
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest
from window_support import LOGGED

import taichi_sim as ts
from taichi_sim.analysis.frame import Frame
from taichi_sim.render.camera import Camera
from taichi_sim.render.styles import unmirrored
from taichi_sim.viewer.web_panel import WebPanel
from taichi_sim.viewer.web_server import WebServer
from taichi_sim.viewer.web_stage import MOST_BALLS, WebStage

pytestmark = pytest.mark.once

viser = pytest.importorskip("viser", reason="viser is not installed (the extra web)")
web_page = importlib.import_module("web_page")  # which takes viser
Page, CAMERA = web_page.Page, web_page.CAMERA
browsers = importlib.import_module("chromium")

needs_browser = pytest.mark.skipif(browsers.BROWSER is None, reason="Chromium is not installed")

CHILD = (
    LOGGED
    + """
from taichi_sim.viewer import web

def simulate(forces):
    scene = ts.Scene(dim=2)
    scene.add_balls([[0, 0], [1, 0.5], [0.5, 1]], radius=0.1, mass=[1.0, 1e-3, 1.0], pinned=[2])
    scene.add_probe("second", kind="position", balls=[1])
    return Logged(scene, forces=forces, contacts="off", arch="cpu", precision="f32", dt=1e-3)

web.show(simulate, fps=30, port=0, title="three balls", say=lambda line: print(json.dumps(line), flush=True))
"""
)


# Who is admitted ---------------------------------------------------------------------------------------------------


def answer(url: str) -> int:
    """Status of the answer to a request."""
    try:
        found = urllib.request.urlopen(url, timeout=30)
    except urllib.error.HTTPError as refused:
        found = refused
    with found:
        assert (b"<html" in found.read()) == (found.status == 200)
        return found.status


def test_only_those_who_know_the_token_are_admitted():
    from websockets.exceptions import InvalidStatus

    with WebServer(port=0) as server:
        bare = server.url.removesuffix(f"{server.token}/")
        wrong = server.token[:-1] + ("A" if server.token[-1] != "A" else "B")
        assert answer(server.url) == answer(server.url.rstrip("/")) == 200
        for path in (
            "",
            "index.html",
            f"{wrong}/",
            f"{server.token}x/",
            f"{server.token[:-1]}/",
            f"?{server.token}",
            "%2e%2e/",
        ):
            assert answer(bare + path) == 403, path
            with pytest.raises(InvalidStatus, match="403"):
                Page(bare + path)
        assert not server.watched
        with Page(server.url) as page:
            page.until(lambda: server.watched)
        other = WebServer(port=0)
        other.close()
        assert other.token != server.token
        assert len(server.token) > 20


def raw(port: int, request: bytes) -> bytes:
    """First line of what a server answers to these bytes; nothing comes after those of a request that has no end."""
    with socket.create_connection(("127.0.0.1", port), timeout=30) as line:
        line.sendall(request)
        if not request.endswith(b"\r\n\r\n"):
            line.shutdown(socket.SHUT_WR)
        return line.makefile("rb").readline()


def test_what_strangers_send_is_refused_without_a_word(capfd):
    """Also a page that knows the token, and talks nonsense, fills no terminal."""
    with WebServer(port=0) as server:
        for path in (b"/\xe9/", b"/\xff\xfe", b"/" + b"\xc3\xa9" * 9):
            assert b" 403 " in raw(server.port, b"GET " + path + b" HTTP/1.1\r\nHost: x\r\n\r\n"), path
        for request in (
            b"\x16\x03\x01\x00\xee",
            b"GET /" + server.token.encode(),
            b"\r\n\r\n",
            b"POST / HTTP/1.1\r\n\r\n",
        ):
            raw(server.port, request)
        with Page(server.url) as page:
            page.until(lambda: server.watched)
            page.socket.send(b"\xc1 no msgpack")
            page.until(lambda: not server.watched and page.closed)
        assert answer(server.url) == 200
    assert capfd.readouterr() == ("", "")


@pytest.mark.slow
def test_a_request_is_answered_after_a_kernel_that_takes_the_compiler_long():
    """It takes all threads' time meanwhile, for longer than a request may take as a rule: 10 s."""
    with WebServer(port=0) as server, socket.create_connection(("127.0.0.1", server.port), timeout=30) as line:
        assert answer(server.url) == 200  # so the connection above was accepted
        server.viser.get_event_loop().call_soon_threadsafe(time.sleep, 10.5)
        line.sendall(f"GET /{server.token}/ HTTP/1.1\r\nHost: x\r\n\r\n".encode())
        assert b" 200 " in line.makefile("rb").readline()


def test_servers_that_start_at_one_time_have_a_token_each(monkeypatch):
    plain = viser.ViserServer

    def slow(*arguments, **options):
        time.sleep(0.2)  # until the other one has begun, too
        return plain(*arguments, **options)

    monkeypatch.setattr(viser, "ViserServer", slow)
    with ThreadPoolExecutor(2) as threads:
        servers = [one.result() for one in [threads.submit(WebServer, port=0) for _ in range(2)]]
    assert [answer(one.url) for one in servers] == [200, 200]
    for one in servers:
        one.close()


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc")
def test_nothing_but_the_loopback_listens():
    with WebServer(port=0) as server:
        listening = []
        for name in ("tcp", "tcp6"):
            for row in Path("/proc/net", name).read_text().splitlines()[1:]:
                _, local, _, state = row.split()[:4]
                address, port = local.split(":")
                if state == "0A" and int(port, 16) == server.port:
                    listening.append(address)
        assert listening == ["0100007F"]
    with socket.socket() as free:  # the port is given back
        free.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        free.bind(("127.0.0.1", server.port))


def test_an_address_that_cannot_be_had_is_one_sentence():
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(OSError, match=rf"^port {port} is in use; choose another one with --port") as caught:
            WebServer(port=port)
    assert caught.value.errno is None  # the command prints the sentence alone
    with pytest.raises(OSError, match="is no address of this machine"):
        WebServer(host="203.0.113.7", port=0)
    for host in ("", None, "0", "0x0", "::0", "::ffff:0.0.0.0"):
        with pytest.raises(
            ValueError, match=rf"^host: {host!r} is not allowed; .*0.0.0.0 or :: for all of its addresses$"
        ):
            WebServer(host=host, port=0)
    with pytest.raises(ValueError, match="port: 65536 is not allowed; it must be from 0 to 65535"):
        WebServer(port=65536)


def test_without_viser_one_sentence_names_the_command(monkeypatch):
    monkeypatch.setitem(sys.modules, "viser", None)
    with pytest.raises(ts.BackendError, match=r'pip install "taichi-sim\[web\]"'):
        ts.LiveView(port=0)


@pytest.mark.parametrize(("words", "says"), [
    (["view", "box", "--port", "0"], "--port needs --web"),
    (["run", "box", "--host", "0.0.0.0"], "--host needs --watch"),
])  # fmt: skip
def test_options_of_pages_need_pages(words, says):
    from typer.testing import CliRunner

    from taichi_sim.cli.main import main

    done = CliRunner().invoke(main, words)
    assert done.exit_code == 2
    assert done.stderr == f"taichi-sim: {says}\n"


# What is shown -----------------------------------------------------------------------------------------------------


def sheet(many: int, tilt: float = 0.0) -> Frame:
    """A square sheet of many balls a side, a loose pair that a spring joins, a drum and a floor."""
    u = np.linspace(0.0, 1.0, many)
    x = np.stack([*np.meshgrid(u, u, indexing="ij"), np.full((many, many), 0.3)], axis=-1).reshape(-1, 3)[:, [0, 2, 1]]
    x[:, 1] += tilt * x[:, 0]
    k = np.arange(many * many).reshape(many, many)
    corners = [(k[:-1, :-1], k[:-1, 1:], k[1:, :-1]), (k[1:, 1:], k[1:, :-1], k[:-1, 1:])]
    faces = np.concatenate([np.stack(three, axis=-1).reshape(-1, 3) for three in corners]).astype(np.int32)
    x = np.concatenate([x, [[0.2, 0.8, 0.2], [0.6, 0.8, 0.2]]])
    n = len(x)
    ts_scene = ts.Scene(dim=3)
    ts_scene.add_collider(ts.Sphere((0.5, 0.0, 0.5), 0.2, name="stone"))
    with ts.Simulation(ts_scene, arch="cpu", contacts="off") as sim:
        colliders = sim.frame().colliders
    return Frame(
        tilt, x, np.stack([0 * x[:, 0], 3 * x[:, 0], 0 * x[:, 0]], axis=1), np.full(n, 0.05), triangles=faces,
        springs=np.array([[n - 2, n - 1]], dtype=np.int32), walls=np.array([[0.0, 1.0, 0.0, -0.1]]), colliders=colliders,
    )  # fmt: skip


def floats(part, name):
    """Shape of an array that came as a reference to bytes."""
    return part[name]["__binary_shape"] if "__binary_shape" in part[name] else part[name]


def test_all_that_a_scene_holds_is_shown_and_moves():
    first = sheet(9)
    with WebServer(port=0) as server, Page(server.url) as page:
        stage = WebStage(server, first, {})
        stage.show(first)
        page.until(lambda: "/hand" not in page.parts and "/springs" in page.parts and "/collider0" in page.parts)
        kinds = {name: part["type"] for name, part in page.parts.items() if name.startswith("/")}
        assert kinds["/balls"] == "BatchedMeshesMessage"
        assert kinds["/springs"] == "LineSegmentsMessage"
        assert {kinds[name] for name in ("/surface0_own0", "/collider0", "/wall0")} == {"MeshMessage"}
        assert stage.legend("object") == ()
        assert stage.legend("strain") == (("strain", "dark 0 to light 0.1"),)
        assert stage.legend("speed")[0][1].endswith(" m/s")
        stage.show(sheet(9, 0.5), "speed")
        page.until(lambda: sum(name.startswith("/surface0_band") for name in page.parts) > 6)  # 0 to 3 m/s along it
        stage.show(sheet(9, 0.7), "object", (np.zeros(3), np.ones(3)))
        page.until(lambda: "/hand" in page.parts)
        before = page.parts["/surface0_own0"]["updates"]
        stage.show(sheet(9, 0.9))
        page.until(lambda: page.parts["/surface0_own0"]["updates"] > before)


def test_the_first_answer_says_that_it_compiles_and_fetches_the_page():
    with WebServer(port=0) as server:
        first = urllib.request.urlopen(server.url, timeout=30)
        words = first.read().decode()
        page = urllib.request.urlopen(server.url + "?page", timeout=30).read()
    assert "taichi_sim is compiling its kernels" in words
    assert len(page) > 10 * len(words)
    assert len(words.encode()) < 2 * 1400  # two packets of a network
    assert first.headers["Content-Type"] == "text/html; charset=utf-8"
    assert first.headers["Referrer-Policy"] == "no-referrer"


def test_a_texture_lies_on_a_cloth_as_in_pictures(tmp_path):
    """Its lower left corner at the ball whose places on it are 0, turned over where it would be mirrored in front."""
    from PIL import Image

    image = np.zeros((40, 40, 3), dtype=np.uint8)
    image[:20, :20], image[20:, :20], image[:20, 20:] = (255, 0, 0), (0, 255, 0), (0, 0, 255)
    Image.fromarray(image).save(tmp_path / "a.png")
    scene = ts.Scene(dim=3)
    flag = ts.shapes.cloth(scene, size=(2, 1), resolution=(9, 7), rotation=(-20, 0, 0))
    scene.set_name(flag.balls, "flag")
    with ts.Simulation(scene, arch="cpu", contacts="off") as sim, WebServer(port=0) as server:
        frame = sim.frame()
        stage = WebStage(server, frame, {"looks": [{"of": "flag", "texture": str(tmp_path / "a.png")}]})
        painted = stage._surfaces[0].surface
        front = unmirrored(painted.uv, stage._parts.triangles(frame)[0])
    for corner, colour in (((0, 1), (1, 0, 0)), ((0, 0), (0, 1, 0)), ((1, 1), (0, 0, 1)), ((1, 0), (0, 0, 0))):
        k = int(np.abs(front - corner).sum(axis=1).argmin())
        assert painted.colour[k].tolist() == list(colour)


@pytest.mark.parametrize("dim", [2, 3])
def test_the_panel_covers_nothing_of_the_scene(dim):
    """Seen through the camera of the page, in a window of 1280 x 880."""
    rng = np.random.default_rng(8)
    x = rng.uniform(-3, 2, (30, dim))
    with WebServer(port=0) as server:
        stage = WebStage(server, Frame(0.0, x, 0 * x, np.full(30, 0.02)), {})
        start = server.viser.initial_camera
        eye, target = np.array(start.position), np.array(start.look_at)
        camera = Camera(tuple(eye), tuple(target), tuple(start.up), float(np.degrees(start.fov)))
        right, _, forward = ((stage._to_page(x) - eye) @ camera.axes().T).T
    px = 440 / np.tan(start.fov / 2) * right / forward + 640
    assert px.min() > 0
    assert px.max() < 1280 - 330


def test_each_page_sees_the_scene_as_large_as_its_own_shape_allows():
    """A flat disc of balls, seen from the camera's own direction, in wide pages, in a tall one, and on a phone, whose panel lies
    below; once for each page."""
    turn = np.linspace(0, 2 * np.pi, 40)
    right, up, _ = Camera((0.0, 0.0, 1.0), (0.0, 0.0, 0.0)).axes()
    x = np.cos(turn)[:, None] * right + np.sin(turn)[:, None] * up
    frame = Frame(0.0, x, 0 * x, np.full(40, 0.02))
    with WebServer(port=0) as server:
        stage = WebStage(server, frame, {"camera": None})
        WebStage(server, frame, {})
        start = server.viser.initial_camera
        for width, height in ((1900, 700), (700, 1000), (390, 844), (0, -5)):
            with Page(server.url, image_width=width, image_height=height) as page:
                page.until(lambda page=page: len(page.camera) > 1)
                eye, target = page.camera["SetCameraPositionMessage"], page.camera["SetCameraLookAtMessage"]
            if width == 0:
                assert np.all(np.isfinite([eye, target]))
                continue
            camera = Camera(tuple(eye), tuple(target), tuple(start.up), float(np.degrees(start.fov)))
            right, up, forward = ((stage._to_page(x) - eye) @ camera.axes().T).T
            scale = height / 2 / np.tan(start.fov / 2)
            across, high = scale * right / forward + width / 2, scale * up / forward
            free = width - (min(330, width / 2) if width > 576 else 0)
            assert across.min() > 0
            assert across.max() < free
            assert max(np.ptp(across) / free, np.ptp(high) / height) > 0.75


def test_a_second_stage_does_not_undo_what_fits_an_open_page():
    """`view` has one stage while it waits and one that can be played with: told again where to look from, a page forgot its own
    shape."""
    frame = sheet(3)
    with WebServer(port=0) as server, Page(server.url, image_width=390, image_height=844) as page:
        page.until(lambda: server.watched)
        WebStage(server, frame, {})
        page.until(lambda: len(page.camera) == 2 and page.starts)
        starts = page.starts
        WebStage(server, frame, {}).show(frame)
        page.until(lambda: "/balls" in page.parts)
        assert page.starts == starts
        # a page that heard of the start last says so
        fits, start = dict(page.camera), server.viser.initial_camera
        page.camera.clear()
        page.say("ViewerCameraMessage", **CAMERA | {"position": tuple(start.position), "look_at": tuple(start.look_at)})
        page.until(lambda: page.camera == fits, 10.0)


def seen_by(page: Page, server: WebServer, points: np.ndarray) -> np.ndarray:
    """Points (n, 3) of pages in the picture of one, in halves of it from its middle."""
    start = server.viser.initial_camera
    eye, target = page.camera["SetCameraPositionMessage"], page.camera["SetCameraLookAtMessage"]
    axes = Camera(tuple(eye), tuple(target), tuple(start.up), float(np.degrees(start.fov))).axes()
    right, up, forward = ((points - eye) @ axes.T).T
    tall = forward * np.tan(start.fov / 2)
    return np.stack([right / tall * page.size[1] / page.size[0], up / tall], axis=1)


@pytest.mark.parametrize("dim", [2, 3])
def test_what_leaves_the_picture_stays_in_it_on_each_page_that_was_not_turned(dim):
    """A pillar that topples and slides on, before a wide page, a phone, one whose user turned it and one that comes later."""
    x = np.random.default_rng(4).uniform(-1, 1, (200, 3)) * (0.2, 1.0, 0.2)
    frames = [
        Frame(t, y := (x[:, [1, 0, 2]] + (t, -0.8, t))[:, :dim], 0 * y, np.full(200, 0.03)) for t in (1.0, 1.7, 2.0)
    ]
    first = Frame(0.0, x[:, :dim], 0 * x[:, :dim], np.full(200, 0.03))
    with WebServer(port=0) as server, ExitStack() as stack:
        stage = WebStage(server, first, {})
        sizes = ((1280, 800), (390, 844), (640, 480))
        pages = [stack.enter_context(Page(server.url, image_width=w, image_height=h)) for w, h in sizes]
        for page in pages:
            page.until(lambda page=page: len(page.camera) == 2)
        own = CAMERA | {"position": (0.0, 3.0, 0.1)}
        pages[2].say("ViewerCameraMessage", **own)
        clients = server.viser.get_clients().values
        pages[2].until(lambda: any(np.allclose(one.camera.position, own["position"]) for one in clients()))
        before = dict(pages[2].camera)
        for frame in (first, *frames):
            stage.show(frame)
        pages.append(stack.enter_context(Page(server.url, image_width=844, image_height=390)))
        for page in pages:
            page.until(lambda page=page: "/balls" in page.parts and len(page.camera) == 2)
        for page in (*pages[:2], pages[3]):
            free = 1 - 2 * (min(330, page.size[0] / 2) if page.size[0] > 576 else 0) / page.size[0]

            def shown(page=page, free=free) -> bool:
                inside = [seen_by(page, server, stage._to_page(one.position)) for one in (first, *frames)]
                return all((np.abs(one) < 1).all() and (one[:, 0] < free).all() for one in inside)

            page.until(shown, 5.0)
        assert pages[2].camera == before


def test_what_falls_for_ever_leaves_the_picture():
    """Else all the rest would become a dot."""
    x = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    with WebServer(port=0) as server, Page(server.url) as page:
        stage = WebStage(server, Frame(0.0, x, 0 * x, np.full(2, 0.1)), {})
        page.until(lambda: len(page.camera) == 2)
        before = dict(page.camera)
        for fallen in (100.0, np.nan, 3.0):
            stage.show(Frame(1.0, x - (0.0, fallen, 0.0), 0 * x, np.full(2, 0.1)))
            page.until(lambda: "/balls" in page.parts)
        assert page.camera == before


def test_a_scene_of_any_size_and_anywhere_is_as_large_and_in_the_middle():
    for unit, far in ((1e-4, 0.0), (1.0, 5e3), (2e6, -1e7)):
        rng = np.random.default_rng(3)
        x = far + unit * rng.uniform(-1, 1, (40, 2))
        with WebServer(port=0) as server:
            stage = WebStage(server, Frame(0.0, x, 0 * x, np.full(40, 0.01 * unit)), {})
            page = stage._to_page(x)
            assert 0.2 < np.abs(page).max() < 0.8
            assert stage._to_scene(page[7]) == pytest.approx(x[7], abs=1e-6 * unit + 1e-7 * abs(far))


def test_a_million_balls_are_thinned_and_it_is_said():
    n = 1_000_000
    x = np.random.default_rng(1).uniform(size=(n, 3)).astype(np.float64)
    frame = Frame(0.0, x, 0 * x, np.where(np.arange(n) % 2, 0.002, 0.004), colour=np.full((n, 3), 0.5))
    with WebServer(port=0) as server, Page(server.url) as page:
        stage = WebStage(server, frame, {}, grip=lambda *_: None)
        stage.show(frame)
        page.until(lambda: "/points0" in page.parts)
        assert stage.notes[0] == "1 of 5 balls is drawn: 1000000 are too many"
        assert "cannot be dragged" in stage.notes[1]
        assert page.bytes < 20 * MOST_BALLS


# What can be done --------------------------------------------------------------------------------------------------


class Played:
    """The simulation of CHILD in a process of its own, and what it says."""

    def __init__(self, folder: Path) -> None:
        import json
        import threading

        (folder / "child.py").write_text(CHILD)
        self.errors = folder / "errors"
        with open(self.errors, "w") as errors:
            self.process = subprocess.Popen(
                [sys.executable, "child.py"], cwd=folder, stdout=subprocess.PIPE, stderr=errors, text=True,
                preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
            )  # fmt: skip
        self.url = json.loads(self.process.stdout.readline()).split()[-1]
        self.time, self.position = 0.0, np.zeros((3, 2))

        def listen() -> None:
            for line in self.process.stdout:
                self.time, position = json.loads(line)
                self.position = np.array(position)

        threading.Thread(target=listen, daemon=True).start()

    def until(self, happened, wait: float = 60.0) -> None:
        end = time.monotonic() + wait
        while not happened():
            assert time.monotonic() < end, self.errors.read_text()
            assert self.process.poll() is None, self.errors.read_text()
            time.sleep(0.02)


@pytest.fixture(scope="module")
def played(tmp_path_factory):
    one = Played(tmp_path_factory.mktemp("played"))
    yield one
    one.process.kill()
    one.process.wait()


@pytest.fixture
def page(played):
    with Page(played.url) as one:
        one.until(lambda: "/balls" in one.parts and "three" not in one.figures and one.figures)
        yield one


def places(played: Played) -> list:
    """Places of balls on a page, in units of the box of all balls, from its middle."""
    centre, size = np.array([0.5, 0.5]), np.hypot(1.2, 1.2)
    return [[*((x - centre) / size), 0.0] for x in played.position]


def test_no_time_passes_until_a_page_is_open(played):
    time.sleep(1.0)
    assert played.time == 0.0
    with Page(played.url) as page:
        page.until(lambda: played.time > 0.1)
        page.until(lambda: page.parts["/balls"]["updates"] >= 1)
    played.until(lambda: True)
    time.sleep(0.5)
    stopped = played.time
    time.sleep(0.5)
    assert played.time == stopped


def test_two_pages_show_and_do_the_same(played, page):
    with Page(played.url) as other:
        other.until(lambda: other.figures and "/balls" in other.parts)
        played.until(lambda: played.time > 0.1)
        page.press("Pause")
        for one in (page, other):
            one.until(lambda one=one: "paused" in one.figures)
        stopped = played.time
        other.press("Step")
        other.press("Step")
        played.until(lambda: played.time == pytest.approx(stopped + 2e-3, abs=1e-9))
        page.press("Picture")
        played.until(lambda: played.time == pytest.approx(stopped + 2e-3 + 33e-3, abs=1e-9))
        other.press("Reset")
        played.until(lambda: played.time == 0.0)
        page.until(lambda: "0.000 s" in page.figures)
        for one in (page, other):  # the button says what it does
            one.until(lambda one=one: "Resume" in one.labels)
        page.press("Resume")
        page.until(lambda: "Pause" in page.labels)
        played.until(lambda: played.time > 0.1)


def test_a_ball_is_dragged_by_one_page_at_a_time(played, page):
    page.press("Reset")
    played.until(lambda: played.time < 0.2)
    start, goal = places(played)[0], [0.3, 0.2, 0.0]
    with Page(played.url) as other:
        other.until(lambda: "/balls" in other.parts)
        page.drag("/balls", "start", start, 0)
        page.drag("/balls", "update", goal, 0)
        played.until(lambda: played.position[0][0] > 0.1)
        other.drag("/balls", "start", places(played)[1], 1)  # while another page drags
        other.drag("/balls", "update", [-0.4, -0.4, 0.0], 1)
        played.until(lambda: np.linalg.norm(np.subtract(places(played)[0], goal)) < 0.02)
        page.drag("/balls", "end", goal, 0)
        assert played.position[1] == pytest.approx([1.0, 0.5], abs=1e-3)
        other.drag("/balls", "end", goal, 1)
        other.drag("/balls", "start", places(played)[2], 2)  # a pinned one
        other.drag("/balls", "update", goal, 2)
        other.drag("/balls", "end", goal, 2)
        # a page that vanishes lets go
        other.drag("/balls", "start", places(played)[1], 1)
        other.drag("/balls", "update", goal, 1)
        played.until(lambda: played.position[1][1] > 0.55)
        page.until(lambda: page.parts["/hand"].get("visible") is True)
        other.vanish()
    page.until(lambda: page.parts["/hand"].get("visible") is False)
    page.drag("/balls", "start", places(played)[0], 0)
    page.drag("/balls", "update", [-0.2, 0.1, 0.0], 0)
    played.until(lambda: np.linalg.norm(np.subtract(places(played)[0], [-0.2, 0.1, 0.0])) < 0.05)
    page.drag("/balls", "end", [-0.2, 0.1, 0.0], 0)
    assert played.position[2] == pytest.approx([0.5, 1.0], abs=1e-6)


def test_nothing_that_a_page_says_ends_the_simulation(played, page):
    for instance, to in (
        (10**9, [0, 0, 0]),
        (-3, [0, 0, 0]),
        (0, [float("nan"), 0, 0]),
        (0, [1e308, 0, 0]),
        (None, [0, 0, 0]),
    ):
        for phase in ("update", "start", "update", "end", "end"):
            page.drag("/balls", phase, to, instance)
    uuid = next(name for name, one in page.parts.items() if "Pause" in one.get("options", ()))
    choice = next(name for name, one in page.parts.items() if "speed" in one.get("options", ()))
    for name, value in ((uuid, "rm"), (choice, "../../etc"), ("none", 1)):
        page.say("GuiUpdateMessage", uuid=name, updates={"value": value})
    page.say("ShareUrlRequest")
    now = played.time
    played.until(lambda: played.time > now + 0.2)


def test_a_page_whose_camera_is_none_is_left_as_it_is_without_a_word(capfd):
    """viser printed a traceback."""
    frame = Frame(0.0, np.array([[0.0, 1.0], [0.5, 1.2]]), np.zeros((2, 2)), np.full(2, 0.1))
    nan, up = float("nan"), (0.0, 1.0, 0.0)
    with WebServer(port=0) as server:
        WebStage(server, frame, {})
        for own in (
            {"look_at": (0.0, nan, 0.0)},
            {"position": (float("inf"), 0.0, 0.0)},
            {"up_direction": (nan, nan, nan)},
            {"up_direction": (0.0, 0.0, 0.0)},
            {"position": (1e308, 0.0, 0.0), "look_at": (-1e308, 0.0, 0.0)},
            {"position": up, "look_at": up},
            {"position": (0.0, 3.0, 0.0), "up_direction": up},
            {"position": (0.0, 3.0), "look_at": "here"},
        ):
            with Page(server.url, **own):
                while not server.viser.get_clients():
                    time.sleep(0.01)
                time.sleep(0.2)  # for the thread that looks at the page
        with Page(server.url) as page:
            page.until(lambda: len(page.camera) > 1)
    said = capfd.readouterr()
    assert said.out + said.err == ""


def test_control_c_ends_it(played):
    """The last of those that share the simulation."""
    with Page(played.url) as page:
        page.until(lambda: page.figures)
        played.process.send_signal(signal.SIGINT)
        assert played.process.wait(timeout=30) == 0
    lines = [line for line in played.errors.read_text().splitlines() if "Traceback" in line]
    assert lines == []


# What a run is charged ---------------------------------------------------------------------------------------------


def pile():
    scene = ts.Scene(dim=2, gravity=(0.0, -10.0))
    places = np.stack(np.meshgrid(0.15 * np.arange(10), 0.1 + 0.15 * np.arange(6)), axis=-1).reshape(-1, 2)
    scene.add_balls(places + np.random.default_rng(5).uniform(0, 0.04, places.shape), radius=0.05)
    scene.add_wall((0, 1))
    scene.add_probe("ball", kind="position", balls=[3])
    return scene


class Kept(ts.Output):
    """An output that keeps positions."""

    needs_image = False

    def __init__(self):
        self.kept = []

    def write(self, index, frame, image):
        self.kept.append(frame.position.copy())


def look_on(view: ts.LiveView, sim: ts.Simulation) -> np.ndarray:
    """Positions of all frames of a run at which a slow page looks on, and one that vanishes."""
    slow, gone, kept = Page(view.url, slow=0.5), Page(view.url), Kept()
    slow.until(lambda: view._server.watched)

    def show(frame: Frame) -> None:
        view.show(frame)
        if len(kept.kept) == 50:
            gone.vanish()

    ts.export(sim, kept, fps=100, duration=1.0, watch=show)
    slow.until(lambda: "GuiUplotMessage" in [one.get("type") for one in slow.parts.values()])
    slow.close()
    return np.array(kept.kept)


@pytest.mark.slow
def test_a_run_is_the_same_whoever_looks_on():
    with ts.Simulation(pile(), arch="cpu", dt=2e-3) as sim:
        start, alone, unseen = sim.snapshot(), Kept(), Kept()
        ts.export(sim, alone, fps=100, duration=1.0)
        sim.resume(start)
        with ts.LiveView(port=0) as view:  # which nobody opens
            ts.export(sim, unseen, fps=100, duration=1.0, watch=view.show)
        sim.resume(start)
        with ts.LiveView(port=0, style={"colour": "speed"}) as view:
            watched = look_on(view, sim)
    assert len(watched) == 101
    assert np.array_equal(watched, alone.kept)
    assert np.array_equal(unseen.kept, alone.kept)


def test_a_page_hears_why_nothing_moves_any_more():
    with ts.LiveView(port=0) as view:
        view.show(sheet(3))
        page = Page(view.url)
        page.until(lambda: view._server.watched)
        error = ts.UnstableError("ball 3 left the world", 1.0, 3, None, None)
        view.__exit__(type(error), error, None)
    page.until(lambda: page.said)
    assert page.said[0]["body"] == "ball 3 left the world"


def test_a_page_shows_the_scene_and_how_long_to_wait_before_any_kernel_is_there(monkeypatch):
    """Both are there before the first kernel; the words go with the first frame of a later time."""
    from taichi_sim.device import compiling

    monkeypatch.setattr("taichi_sim.viewer.web.TOLD", 0.05)
    monkeypatch.setattr(compiling, "_met", set())

    def words(page: Page) -> list[str]:
        return [text for one in page.parts.values() if "Please wait" in (text := str(one.get("_markdown", "")))]

    with ts.LiveView(port=0) as view, Page(view.url) as page, ts.Simulation(pile(), arch="cpu", dt=2e-3) as sim:
        page.until(lambda: words(page) == ["Please wait: the program is reading the scene."])
        before = compiling.seconds()
        view.wait(sim)
        page.until(lambda: "/balls" in page.parts and re.search(r"(kernels|starting).* \d+ s have", *words(page)))
        page.until(lambda: re.search(r" [1-9]\d* s have passed", *words(page)))
        assert compiling.seconds() == before
        sim.step(0)
        view.show(sim.frame())  # pictures of it are still to be compiled
        drawn = page.parts["/balls"]["updates"]
        sim.step(1)
        view.show(sim.frame())
        page.until(lambda: page.parts["/balls"]["updates"] > drawn)
        page.until(lambda: [one["visible"] for one in page.parts.values() if "_markdown" in one] == [False])
        assert "GuiRemoveMessage" not in page.kinds  # viser's page puts it before changes of the same moment: an error


def test_a_view_waits_again_and_shows_every_frame_until_another_time():
    scene = ts.Scene(dim=2)
    scene.add_balls([[0.0, 0.0], [0.7, 0.2]], radius=0.1)

    with ts.LiveView(port=0) as view, Page(view.url) as page, ts.Simulation(scene, contacts="off", arch="cpu") as sim:
        page.until(lambda: view._server.watched)
        for _ in range(2):
            view.wait(sim)
            view.wait(sim)  # a second time before any frame
            page.until(lambda: any("have passed" in str(one.get("_markdown", "")) for one in page.parts.values()))
            drawn = page.parts["/balls"]["updates"]
            sim.set_position(sim.position + 0.1)  # at the time at which it waits
            view.show(sim.frame())
            page.until(lambda drawn=drawn: page.parts["/balls"]["updates"] > drawn)
            assert view._begin == 0.0
            sim.step(1)
            view.show(sim.frame())
            assert view._begin > 0.0


def test_a_page_shows_the_last_frame_while_pictures_are_drawn_and_how_far_that_is(monkeypatch):
    """However little time pages may take: here a picture in an hour."""
    monkeypatch.setattr("taichi_sim.viewer.web.TOLD", 0.05)
    monkeypatch.setattr("taichi_sim.viewer.web.MOST_FPS", 1 / 3600)

    class Drawn(ts.Output):
        def write(self, index, frame, image):
            if index == 2:
                page.until(lambda: "0.350 s" in page.figures, 10.0)
                page.until(lambda: "Drawing pictures: 2 of 8" in words(), 10.0)

    def words() -> str:
        return next((str(one["_markdown"]) for one in page.parts.values() if "_markdown" in one), "")

    with ts.LiveView(port=0) as view, Page(view.url) as page, ts.Simulation(pile(), arch="cpu", dt=2e-3) as sim:
        page.until(lambda: view._server.watched)
        ts.export(sim, Drawn(), fps=20, duration=0.35, size=(64, 64), watch=view.show)
        view.__exit__(None, None, None)
        page.until(lambda: page.said)
        assert [one["visible"] for one in page.parts.values() if "_markdown" in one] == [False]


@pytest.mark.parametrize("error", [None, ts.UnstableError("ball 3 left the world", 1.0, 3, None, None)])
def test_a_page_shows_the_last_frame_before_it_hears_of_the_end(error, monkeypatch):
    monkeypatch.setattr("taichi_sim.viewer.web.MOST_FPS", 1 / 3600)
    with ts.LiveView(port=0) as view, Page(view.url) as page:
        page.until(lambda: view._server.watched)
        for tilt in (0.0, 0.25, 0.75):
            view.show(sheet(3, tilt))
        view.__exit__(None if error is None else type(error), error, None)
        page.until(lambda: page.said)
        assert "0.750 s" in page.figures


@pytest.mark.parametrize(("error", "says"), [
    (None, "The run has ended."),
    (KeyboardInterrupt(), "It was stopped by Ctrl-C."),
    (ValueError("balls"), "An error, which the program printed, ended it."),
])  # fmt: skip
def test_a_page_says_what_it_waits_for_and_that_a_run_has_ended(error, says):
    with ts.LiveView(port=0) as view, Page(view.url) as page:
        page.until(lambda: any("reading" in str(one.get("_markdown", one)) for one in page.parts.values()))
        view.show(sheet(3))
        page.until(lambda: "/surface0_own0" in page.parts and view._server.watched)
        view.__exit__(None if error is None else type(error), error, None)
        page.until(lambda: page.said)
    assert page.said[0]["body"] == says


@pytest.mark.slow
def test_a_run_that_is_watched_ends_by_itself(tmp_path):
    """By the command, with a page that stays open; the address is printed with --quiet, too."""
    (tmp_path / "ball.toml").write_text("format = 1\ndim = 2\n[[balls]]\nposition = [[0.0, 1.0]]\nradius = 0.1\n")
    words = ["run", "ball.toml", "--watch", "--port", "0", "--quiet", "-o", "x.npz", "--fps", "100", "--duration", "30"]
    run = subprocess.Popen(
        [sys.executable, "-m", "taichi_sim", *words],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    with Page(run.stdout.readline().split()[-1]) as page:
        page.until(lambda: "/balls" in page.parts)
        out, errors = run.communicate(timeout=120)
    assert (run.returncode, out, errors) == (0, "", "")
    assert (tmp_path / "x.npz").is_file()


@pytest.mark.slow
def test_the_program_of_the_page_runs(tmp_path, monkeypatch):
    page = Path(__file__).parents[2] / "docs" / "web.md"
    (program,) = re.findall(r"```python\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)
    monkeypatch.chdir(tmp_path)
    exec(compile(program, "web.md", "exec"), {})
    assert (tmp_path / "balls.npz").is_file()


def test_a_notebook_shows_the_page_in_a_cell():
    with ts.LiveView(port=0) as view:
        assert f'<iframe src="{view.url}"' in view._repr_html_()


# In a browser ------------------------------------------------------------------------------------------------------


@needs_browser
@pytest.mark.slow
def test_a_browser_draws_it_without_an_error():
    """Balls, a surface in about its own colour and the panel, in two windows; the one that stays goes on when the other is
    closed."""
    with WebServer(port=0) as server, browsers.chromium() as browser:
        first = sheet(4)
        stage = WebStage(server, first, {})
        stage.show(first)
        panel = WebPanel(server, "sheet <b>", {"a.x": "m", "a.y": "m"}, "object")
        panel.show(0.0, {"a.x": 1.0, "a.y": 2.0}, lambda: (("time", "0.000 s"), ("", "1 of 5 <balls> is drawn")))
        windows = [browser.window(), browser.window()]
        for window in windows:
            window.open(server.url)
        for window in windows:
            window.until_it_says("1 of 5 <balls> is drawn")
            window.until_it_says("a.x [m]")
        windows[0].close()
        coloured, end, own = np.empty((0, 3)), time.monotonic() + 60, stage._own[0].astype(int)
        while (len(coloured) < 500 or np.abs(np.median(coloured, axis=0) - own).max() >= 60) and time.monotonic() < end:
            picture = windows[1].picture()  # which fades in from white
            coloured = picture[80:, :300][(np.ptp(picture, axis=2) > 60)[80:, :300]]  # beside the panel
        errors = windows[0].errors + windows[1].errors
    assert len(coloured) >= 500
    assert np.abs(np.median(coloured, axis=0) - own).max() < 60
    assert errors == []


@needs_browser
@pytest.mark.slow
def test_on_a_phone_the_panel_begins_folded_and_a_dark_one_is_dark():
    unfolded = "document.querySelector('.figures').getClientRects().length > 0"
    with ts.LiveView(port=0, title="a sheet") as view, browsers.chromium() as browser:
        window = browser.window(390, 300, dark=True)
        window.open(view.url)
        window.until_it_says("Please wait:")  # in the panel, which nothing folds so long
        view.show(Frame(0.0, x := np.eye(2), 0 * x, np.full(2, 0.1)))
        window.until(f"document.querySelector('.figures') && !({unfolded})")
        picture = window.picture()
        window.run("document.elementFromPoint(250, 280).click()")
        window.until(unfolded)
        window.close()
        wide = browser.window(700, 200)
        wide.open(view.url)
        wide.until(f"document.querySelector('.figures') && {unfolded}")
    assert np.median(picture[:30, 320:]) < 60  # beside what viser says without a graphics card


@needs_browser
@pytest.mark.slow
def test_a_page_that_comes_while_the_compiler_works_shows_the_scene_later(monkeypatch):
    """In a window without the focus. The first request for viser's page is lost, and the first connection stalls for longer
    than viser waits: 5 s."""
    from websockets.asyncio import server

    plain, seen = server.serve, set()

    def serve(*arguments, process_request, **options):
        def stall(connection, request):
            kind = "Upgrade" if "Upgrade" in request.headers else request.path.partition("?")[2]
            if kind and kind not in seen:
                seen.add(kind)
                if kind != "Upgrade":
                    return connection.respond(503, "later")
                time.sleep(5.5)
            return process_request(connection, request)

        return plain(*arguments, process_request=stall, **options)

    monkeypatch.setattr(server, "serve", serve)
    with ts.LiveView(port=0) as view, browsers.chromium() as browser:
        window = browser.window()
        window.open(view.url)
        window.until("!document.hidden")
        window.until_it_says("reading the scene.\nThe scene will appear here")
        window.until_it_says("Please wait:", 30)
    assert seen == {"page", "Upgrade"}
