"""The command: what it prints, its exit status, and that bad input writes nothing. Each run is a process of its own."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

pytestmark = pytest.mark.once

BALL = """# One ball falls.
format = 1
gravity = [0.0, -10.0]
[simulation]
dt = 0.01
precision = "f64"
arch = "cpu"
[[balls]]
position = [[0.0, 1.0]]
radius = 0.1
[output]
fps = 20
duration = 0.5
size = [160, 120]
"""

STIFF = BALL.replace("dt = 0.01", "dt = 0.05").replace(
    "[output]",
    """[[balls]]
position = [[1.0, 1.0], [2.0, 1.1]]
radius = 0.1
[[springs]]
pairs = [[0, 1], [1, 2]]
stiffness = 10000.0
rest_length = 0.7
[output]""",
)


def command(folder: Path, *arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """taichi-sim with these arguments, run in the folder."""
    return subprocess.run(
        [sys.executable, "-m", "taichi_sim", *arguments],
        cwd=folder,
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        timeout=300,
    )


def in_one_process(folder: Path, calls: list[tuple[str, ...]], **environment: str) -> list[tuple[int, str, str]]:
    """Status, output and error text of several commands, run one after the other in one process, for speed."""
    code = """import contextlib, io, json, sys
from taichi_sim.cli.main import main
results = []
for arguments in json.loads(sys.argv[1]):
    sys.argv[1:] = arguments
    out, err, status = io.StringIO(), io.StringIO(), 0
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            main()
        except SystemExit as end:
            status = end.code or 0
    results.append((status, out.getvalue(), err.getvalue()))
print(json.dumps(results))
"""
    done = subprocess.run(
        [sys.executable, "-c", code, json.dumps(calls)],
        cwd=folder,
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    return [tuple(result) for result in json.loads(done.stdout)]


def names(folder: Path) -> list[str]:
    return sorted(p.name for p in folder.iterdir())


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "ball.toml").write_text(BALL)
    (tmp_path / "stiff.toml").write_text(STIFF)
    return tmp_path


WORKS = {
    "arrays": ("run", "ball.toml", "-o", "ball.npz", "-o", "ball.csv"),
    "options": ("run", "ball.toml", "-o", "fast.npz", "--fps", "10", "--duration", "1", "--quiet", "--dt", "auto"),
    "python": ("run", "s.py", "-o", "python.npz", "--duration", "0.1"),
    "check": ("check", "stiff.toml"),
    "first": ("run", "ball.toml", "-o", "x.npz", "--resume", "--quiet"),
    "again": ("run", "ball.toml", "-o", "x.npz", "--resume", "--quiet"),
    "more": ("run", "ball.toml", "-o", "x.npz", "-o", "y.csv", "--resume"),
}


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """A folder in which one process ran the commands of WORKS, with status, output and errors of each."""
    folder = tmp_path_factory.mktemp("works")
    (folder / "ball.toml").write_text(BALL)
    (folder / "stiff.toml").write_text(STIFF)
    (folder / "parts.py").write_text("HEIGHT = 2.0\n")
    (folder / "s.py").write_text(
        "import taichi_sim as ts\nfrom parts import HEIGHT\n\ndef scene():\n    scene = ts.Scene(dim=2)\n"
        "    scene.add_balls([[0, HEIGHT]], radius=0.1)\n    return scene\n"
    )
    return folder, dict(zip(WORKS, in_one_process(folder, list(WORKS.values()))))


# What works --------------------------------------------------------------------------------------------------------


def test_help_is_light(tmp_path):
    code = (
        "import sys\nsys.argv = ['taichi-sim', '--help']\nfrom taichi_sim.cli.main import main\n"
        "try:\n    main()\nexcept SystemExit:\n    pass\n"
        "names = ('taichi', 'av', 'trimesh', 'matplotlib', 'pydantic', 'rich', 'PIL', 'viser')\n"
        "print([m for m in names if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path)
    assert done.stdout.endswith("[]\n")
    for word in ("run", "view", "check", "report", "tune", "bench", "demos", "--version"):
        assert word in done.stdout


def test_version(tmp_path):
    from taichi_sim import __version__

    done = command(tmp_path, "--version")
    assert (done.returncode, done.stdout) == (0, f"taichi-sim {__version__}\n")


def test_demos_are_listed_with_one_line_each(tmp_path):
    from taichi_sim.files.source import built_in, demos

    done = command(tmp_path, "demos")
    assert done.returncode == 0
    lines = done.stdout.splitlines()
    assert [line.split()[0] for line in lines] == list(demos())
    for file in demos().values():
        assert built_in(file), f"{file} says nothing about itself in its first line"


@pytest.mark.slow_where(arguments=("check", "cloth"))
@pytest.mark.parametrize("arguments", [("demos",), ("check", "cloth")])
def test_who_stops_reading_gets_no_error(tmp_path, arguments):
    """As `taichi-sim demos | head -1`: the work is done, and its status says so."""
    read, write = os.pipe()
    os.close(read)
    try:
        done = subprocess.run(
            [sys.executable, "-m", "taichi_sim", *arguments], stdout=write, stderr=subprocess.PIPE, cwd=tmp_path
        )
    finally:
        os.close(write)
    assert done.stderr == b""
    assert done.returncode == 0


def test_run_writes_arrays_and_a_summary(done):
    folder, (status, out, err) = done[0], done[1]["arrays"]
    assert (status, err) == (0, "")
    for word in ("frames       11", "energy", "momentum", "per simulated second", "ball.npz", "ball.csv"):
        assert word in out
    assert "penetration" not in out  # one ball alone has no contacts
    with np.load(folder / "ball.npz") as data:
        t = data["time"]
        assert t == pytest.approx(np.arange(11) / 20)
        assert data["position"][:, 0, 1] == pytest.approx(1 - 5 * t**2, abs=1e-9)
        assert data["energy"][:, 3] == pytest.approx(np.full(11, 10.0))
        table = np.genfromtxt(folder / "ball.csv", delimiter=",", names=True)
        assert np.array_equal(table["total"], data["energy"][:, 3])
    given = ["ball.toml", "parts.py", "s.py", "stiff.toml"]
    written = ["ball.csv", "ball.npz", "fast.npz", "python.npz", "x.npz", "y.csv"]
    assert [name for name in names(folder) if name != "__pycache__"] == sorted(given + written)


def test_help_names_every_format(tmp_path):
    from taichi_sim.outputs import CODECS, OTHERS

    done = command(tmp_path, "run", "--help")
    for ending in (*CODECS, *OTHERS, "folder/"):
        assert ending in done.stdout, ending


def test_options_go_over_the_file_and_quiet_is_quiet(done):
    assert done[1]["options"] == (0, "", "")
    assert np.load(done[0] / "fast.npz")["time"] == pytest.approx(np.arange(11) / 10)


def test_run_draws_a_video_without_a_display(folder):
    import av

    done = command(folder, "run", "ball.toml", "-o", "ball.mp4", DISPLAY="")
    assert done.returncode == 0, done.stderr
    with av.open(str(folder / "ball.mp4")) as container:
        frames = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
    assert len(frames) == 11
    assert frames[0].shape == (120, 160, 3)
    assert np.abs(frames[0].astype(int) - frames[-1]).max() > 50


def test_a_python_scene(done):
    assert done[1]["python"][0] == 0
    assert np.load(done[0] / "python.npz")["position"][0, 0, 1] == 2.0


SIMULATION = """import taichi_sim as ts

def simulation():
    scene = ts.Scene(dim=2)
    scene.add_balls([[0, 0]], radius=0.1, velocity=(1, 0))
    scene.output = {'fps': 5, 'duration': 0.6}
    return ts.Simulation(scene, dt=0.01)
"""
DRAG = """import taichi as ti
import taichi_sim as ts

@ti.data_oriented
class Drag:
    @ti.func
    def accumulate(self, model: ti.template(), ball: ti.template(), impulse: ti.template(), h, time):
        for i in range(model.n):
            impulse[i] -= h * 0.3 * ball[i].v

    def damping_rate(self, scene):
        return 0.3 / scene.mass.min()

def simulation():
    scene = ts.Scene(dim=2)
    scene.add_balls([[0, 0], [0, 1]], radius=0.1)
    scene.add_springs([[0, 1]], stiffness=30.0)
    return ts.Simulation(scene, dt=4e-3, forces=[Drag()])
"""
DEEP = "format = 1\ndim = 2\n[[balls]]\nposition = [[0.0, 3.0], [0.0, 3.05]]\nradius = 0.1\n"
SLOW = {
    "own": ("run", "s.py", "-o", "own.npz", "--precision", "f64"),
    "faster": ("run", "s.py", "-o", "faster.npz", "--fps", "10"),
    "step": ("run", "s.py", "--dt", "0.1"),
    "force": ("check", "drag.py"),
    "settle": ("check", "drag.py", "--settle"),
    "deep": ("check", "deep.toml"),
    "tolerance": ("check", "stiff.toml", "--tolerance", "1e-3"),
    "unstable": ("run", "stiff.toml", "-o", "x.npz", "--duration", "20"),
}


@pytest.fixture(scope="module")
def slowly(tmp_path_factory):
    """A folder in which one process ran the commands of SLOW, with status, output and errors of each."""
    folder = tmp_path_factory.mktemp("slow")
    for name, text in {"s.py": SIMULATION, "drag.py": DRAG, "deep.toml": DEEP, "stiff.toml": STIFF}.items():
        (folder / name).write_text(text)
    return folder, dict(zip(SLOW, in_one_process(folder, list(SLOW.values()))))


@pytest.mark.slow
def test_a_python_simulation_is_run_as_its_scene_says(slowly):
    folder, said = slowly
    for name, fps in (("own", 5), ("faster", 10)):
        assert said[name][0] == 0
        with np.load(folder / f"{name}.npz") as arrays:
            time = np.arange(0.6 * fps + 1) / fps
            assert arrays["time"] == pytest.approx(time)
            assert arrays["position"][:, 0, 0] == pytest.approx(time)
    status, _, errors = said["step"]
    assert status == 2
    assert "--dt: s.py makes its own simulation()" in errors


@pytest.mark.slow
def test_check_takes_a_python_simulation_that_has_a_force(slowly):
    status, said, errors = slowly[1]["force"]
    assert (status, errors) == (0, "")
    assert "spring 0" in said
    assert "--settle: drag.py makes its own simulation()" in slowly[1]["settle"][2]


def test_check_says_what_is_safe(done):
    status, out, _ = done[1]["check"]
    assert status == 0
    assert "however the scene deforms" in out
    assert "spring 0" in out


@pytest.mark.slow
def test_check_names_balls_that_overlap_at_the_start(slowly):
    status, _, errors = slowly[1]["deep"]
    assert status == 0
    assert "at the start ball 0 and ball 1 overlap by 1.5 of the smaller radius: move apart" in errors


@pytest.mark.slow
def test_check_says_that_a_tolerance_chooses_the_step(slowly):
    status, said, _ = slowly[1]["tolerance"]
    assert status == 0
    assert "at first; the tolerance of 0.001 chooses it" in said


# What goes wrong ---------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_unstable_keeps_the_frames_and_warns_before(slowly):
    folder, said = slowly
    status, _, errors = said["unstable"]
    assert status == 3
    warning, grew, kept, reason = errors.splitlines()
    assert warning.startswith("warning: dt = 0.05 s is above the safe bound of 0.0115")
    assert grew.startswith("warning: energy grew from ")
    frames = len(np.load(folder / "x.npz")["time"])
    assert kept == f"x.npz: holds the {frames} frames until then"
    assert 0 < frames < 400
    for word in ("ball ", "spring ", "t = ", "safe step is 0.0115"):
        assert word in reason


REFUSED = [
    (("run",), "Missing argument 'SCENE'"),
    (("run", "ball.toml", "--fast"), "No such option: --fast"),
    (("run", "none.toml"), "none.toml: there is no such file"),
    (("check", "shapes.toml"), "shapes.toml: is a folder, and no file"),
    (("run", "no_such_demo"), "no_such_demo: is neither a file nor a built-in demo"),
    (("run", "words.txt"), "'.txt' is not allowed; a scene is a .toml or a .py file"),
    (("run", "bad.toml"), "bad.toml, line 9: balls[0].mass: -1.0 is not allowed; it must be greater than 0"),
    (("run", "empty.toml"), "empty.toml: holds no ball"),
    (("run", "empty.py"), "empty.py: has neither scene() nor simulation()"),
    (("run", "wrong.py"), "wrong.py, line 4: balls.radius: -1"),
    (("run", "broken.py"), "broken.py, line 2: SyntaxError"),
    (("run", "style.py"), "scene.output.fps: 'fast' is not allowed; it must be a number"),
    (
        ("run", "ball.toml", "-o", "x.mp4", "--fps", "0.1", "--duration", "1"),
        "fps times duration is less than one frame",
    ),
    (("run", "ball.toml", "--fps", "3", "--duration", "0.3"), "fps times duration is less than one frame"),
    (("run", "ball.toml", "--dt", "0"), "--dt: '0' is not allowed; it must be a number greater than 0 or auto"),
    (("run", "ball.toml", "--dt", "nan"), "--dt: 'nan' is not allowed"),
    (("run", "ball.toml", "--fps", "-1"), "--fps: -1 is not allowed; it must be a number greater than 0"),
    (("run", "ball.toml", "--duration", "inf"), "--duration: inf is not allowed"),
    (("run", "ball.toml", "--size", "big"), "--size: 'big' is not allowed; it must be like 1280x720"),
    (("run", "ball.toml", "--size", "0x10"), "--size: '0x10' is not allowed; each side must be from 16 to 8192"),
    (("run", "ball.toml", "--resume"), "--overwrite, --resume, --checkpoint, --codec and --transparent need --out"),
    (
        ("run", "ball.toml", "--checkpoint", "off"),
        "--overwrite, --resume, --checkpoint, --codec and --transparent need --out",
    ),
    (
        ("run", "ball.toml", "-o", "x.mp4", "--transparent"),
        "transparent: x.mp4 holds no transparency; write PNG frames",
    ),
    (
        ("run", "ball.toml", "-o", "x.npz", "--transparent"),
        "--transparent: x.npz holds no pictures; write PNG frames, to a folder/",
    ),
    (("run", "ball.toml", "-o", ".glb"), ".glb: is an ending without a name; give x.glb"),
    (
        ("run", "ball.toml", "-o", "x.gif", "--checkpoint", "5x"),
        "--checkpoint: '5x' is not allowed; it must be like 90,",
    ),
    (
        ("run", "ball.toml", "-o", "x.gif", "--checkpoint", "0s"),
        "--checkpoint: '0s' is not allowed; it must be like 90,",
    ),
    (
        ("run", "ball.toml", "-o", "x.avi"),
        "x.avi: '.avi' is not allowed; use x.mp4, x.webm, x.gif, x.webp, x.npz, x.usdc, x.usda, x.glb, x.pvd, x.gsd, x.csv,",
    ),
    (
        ("run", "ball.toml", "-o", "x.npz", "-o", "full/../x.npz"),
        "full/../x.npz: is given twice; give every output a name of its own",
    ),
    (
        ("run", "ball.toml", "-o", "x.npz", "-o", "x.usdc"),
        'x.usdc: .usdc needs one more package: pip install "taichi-sim[usd]"',
    ),
    (("run", "ball.toml", "-o", "x.csv", "-o", "x.avi"), "x.avi: '.avi' is not allowed"),
    (("run", "ball.toml", "-o", "none/x.mp4"), "none/x.mp4: there is no folder 'none'; make it first"),
    (("run", "ball.toml", "-o", "full"), "full: the folder is not empty; use --overwrite, --resume or another name"),
    (("view", "ball.toml"), "there is no display for a window; use `taichi-sim view SCENE --web` or"),
    (("report",), "report: give a SCENE, or --hard-cases"),
    (("report", "ball.toml", "--hard-cases"), "--hard-cases takes no scene"),
    (("report", "--hard-cases", "--methods", "verlet"), "--hard-cases takes no other option, but --methods was given"),
    (("report", "--hard-cases", "-o", "r"), "--hard-cases takes no other option, but --out was given"),
    (("demos", "--size", "640x360"), "demos: options are for --all, but --size was given"),
    (("report", "ball.toml", "--methods", "verlet,magic"), "--methods: 'magic' is not allowed; it must be of verlet,"),
    (("report", "ball.toml", "--dts", "1e-3,"), "--dts: '1e-3,' is not allowed"),
    (("report", "ball.toml", "--dts", "1,2", "--duration", "1"), "--dts: 2 is not allowed; the longest is 0.125"),
    (("report", "ball.toml", "--duration", "1e300"), "--duration: 1e+300 is not allowed; the longest is "),
    (("report", "ball.toml", "--dts", "0.1"), "the longest is 0.0625, an eighth of the 0.5 s"),
    (("report", "ball.toml", "--precision", "f16"), "--precision: 'f16' is not allowed; it must be of f64, f32"),
    (("report", "ball.toml", "--tolerance", "2"), "--tolerance: 2 is not allowed; it is a part of the motion"),
    (("report", "ball.toml", "-o", "full"), "full: the folder is not empty and holds no report"),
    (("report", "ball.toml", "-o", "none/r"), "none/r: there is no folder 'none'; make it first"),
    (("tune", "box", "--write"), "--write: box is a demo; copy "),
    (("tune", "none.toml"), "none.toml: there is no such file"),
    (
        ("fit", "ball.toml", "--vary", "a=0:1", "--target", "a=1", "--target", "a=2"),
        "target: 'a=2' gives a another value than before; give it once",
    ),
    (
        ("render", "x.npz", "-o", "x.gif", "--style", "camera=1", "--style", "camera.fov=2"),
        "--style: 'camera.fov=2' is w",
    ),
    (("tune", "ball.toml", "--limit", "0"), "--limit: 0.0 is not allowed; it must be a number greater than 0"),
]
FROM_TAICHI = [
    (
        ("run", "ball.toml", "-o", "x.mp4", "--arch", "gpu"),
        "arch: 'gpu' is not allowed; it must be one of 'auto', 'cpu'",
    ),
    (("run", "ball.toml", "-o", "x.mp4", "--integrator", "magic"), "integrator: 'magic' is not allowed"),
    (("run", "ball.toml", "-o", "x.mp4", "--contacts", "magic"), "contacts: 'magic' is not allowed"),
    (("run", "ball.toml", "-o", "y/", "--precision", "f16"), "precision: 'f16' is not allowed"),
    (("run", "ball.toml", "-o", "x.npz", "--threads", "0"), "threads: 0 is not allowed"),
    (("run", "ball.toml", "-o", "x.npz", "--threads", "99999999999"), "threads: 99999999999 is not allowed"),
    (("report", "ball.toml", "--threads", "0"), "threads: 0 is not allowed"),
    (("tune", "ball.toml", "--arch", "gpu"), "arch: 'gpu' is not allowed; it must be one of 'auto', 'cpu'"),
]


def write_bad_files(folder: Path) -> None:
    (folder / "bad.toml").write_text(BALL.replace("position", "mass = -1.0\nposition"))
    (folder / "empty.toml").write_text("format = 1\n")
    (folder / "words.txt").write_text("format = 1\n")
    (folder / "empty.py").write_text("")
    (folder / "broken.py").write_text("x = 1\ndef scene(:\n")
    (folder / "wrong.py").write_text(
        "import taichi_sim as ts\ndef scene():\n    scene = ts.Scene()\n    scene.add_balls([[0, 0]], radius=-1)\n"
    )
    (folder / "style.py").write_text(
        "import taichi_sim as ts\ndef scene():\n    scene = ts.Scene()\n    scene.add_balls([[0, 0]], radius=1)\n"
        "    scene.output = {'fps': 'fast'}\n    return scene\n"
    )
    (folder / "pxr.py").write_text("raise ImportError")  # as if it were not installed
    (folder / "full").mkdir()
    (folder / "shapes.toml").mkdir()
    (folder / "full" / "notes.txt").write_text("mine")


def test_bad_input_ends_with_one_message_and_writes_nothing(folder):
    write_bad_files(folder)
    before = names(folder)
    cases = REFUSED + FROM_TAICHI
    results = in_one_process(folder, [arguments for arguments, _ in cases], DISPLAY="", WAYLAND_DISPLAY="")
    for (arguments, message), (status, out, err) in zip(cases, results):
        assert status == 2, (arguments, out, err)
        assert message in err, (arguments, err)
        assert not re.sub(r"(?m)^\d+:\d\d:\d\d  .*\n", "", out), arguments  # but for what a slow machine waits for
        assert "Traceback" not in err
        if not err.startswith("Usage"):
            assert err.startswith("taichi-sim: ")
            assert err.count("\n") == 1, err
    assert [name for name in names(folder) if name != "__pycache__"] == before
    assert names(folder / "full") == ["notes.txt"]


def test_resume_says_where_nothing_is_kept(done):
    first, again, more = (done[1][name] for name in ("first", "again", "more"))
    assert first == (0, "", "x.npz: nothing is kept of it; it begins at the first frame\n")
    assert again == (0, "", "x.npz: is complete, and is left as it is; without --resume it is made anew\n")
    assert more[2].count("x.npz: is complete") == 1
    assert "written      y.csv" in more[1]
    assert "written      x.npz" not in more[1]


def test_cuda_without_a_gpu(folder):
    done = command(folder, "run", "ball.toml", "-o", "x.mp4", "--arch", "cuda", CUDA_VISIBLE_DEVICES="")
    if done.returncode == 0:
        pytest.skip("there is a GPU")
    assert done.returncode == 2
    assert done.stderr == (
        "taichi-sim: arch: 'cuda' was asked for, but no such device works here: `taichi-sim devices` says what does; use 'cpu' or"
        " 'auto'\n"
    )
    assert names(folder) == ["ball.toml", "stiff.toml"]


INTERRUPTS = [  # module while which is imported, what happens then, and the exit status
    *((module, "raise KeyboardInterrupt", 130) for module in ("taichi_sim.cli.command", "taichi_sim.common.errors", "typer")),
    *((module, f"os.kill(os.getpid(), {int(number)})", 128 + number) for module in ("taichi_sim.common.printable", "typer.main")
      for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)),
]  # fmt: skip


@pytest.mark.parametrize(("module", "happens", "status"), INTERRUPTS)
def test_an_interrupt_while_the_command_loads_is_no_traceback(tmp_path, module, happens, status):
    loading = f"""
import os, runpy, signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)

class Signals:
    def find_spec(self, name, path=None, target=None):
        if name == "{module}":
            {happens}

sys.meta_path.insert(0, Signals())
runpy.run_module("taichi_sim", run_name="__main__")
"""
    done = subprocess.run([sys.executable, "-c", loading], cwd=tmp_path, capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (status, "", "taichi-sim: interrupted\n")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="pipes")
def test_nothing_is_kept_of_a_pipe_whose_reader_goes(folder):
    os.mkfifo(folder / "x.csv")
    reader = subprocess.Popen([sys.executable, "-c", "open('x.csv').readline()"], cwd=folder)
    done = command(folder, "run", "ball.toml", "-o", "x.csv", "--duration", "1e3", "--quiet")
    reader.wait(60)
    last = done.stderr.splitlines()[-1]  # a process that was killed elsewhere may have left a lock, which is said
    assert (done.returncode, last) == (2, "taichi-sim: x.csv: whoever read it has gone")
    assert names(folder) == ["ball.toml", "stiff.toml", "x.csv"]


@pytest.mark.parametrize(
    ("number", "status", "words"),
    [(signal.SIGINT, 130, "taichi-sim: interrupted"), (signal.SIGTERM, 143, "taichi-sim: interrupted")],
)
def test_an_interrupt_leaves_no_half_file(folder, number, status, words):
    running = subprocess.Popen(
        [sys.executable, "-m", "taichi_sim", "run", "ball.toml", "-o", "x.mp4", "--duration", "1e5"],
        cwd=folder,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # a background job of a shell ignores it
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    deadline = time.monotonic() + 60
    while not any(name.endswith(".part") for name in names(folder)) and time.monotonic() < deadline:
        time.sleep(0.05)
    time.sleep(0.3)  # while Taichi starts, which swallows an exception here and there
    running.send_signal(number)
    try:
        _, err = running.communicate(timeout=60)
    finally:
        running.kill()  # does nothing to one that has ended
    assert running.returncode == status
    said = [line for line in err.splitlines() if "--resume goes on with" not in line]  # where one was drawn by then
    assert "\n".join(said).strip() == words
    shutil.rmtree(folder / ".x.mp4.resume", ignore_errors=True)
    assert names(folder) == ["ball.toml", "stiff.toml"]


@pytest.mark.parametrize(
    ("body", "said"),
    [
        ("impulse[i] += speeed * ball[i].v", 'Name "speeed" is not defined'),
        pytest.param("impulse[i] += ball[i].w", "'w'", marks=pytest.mark.slow),
        pytest.param("impulse[i] += ti.Vector([1.0, 2.0, 3.0])", "3", marks=pytest.mark.slow),
    ],
)
def test_a_mistake_in_a_kernel_of_the_user_is_one_line(tmp_path, body, said):
    """With the place in the file, for which the compiler's own words have sixty lines."""
    (tmp_path / "pull.py").write_text(
        "import taichi as ti, taichi_sim as ts\n"
        "@ti.data_oriented\n"
        "class Pull:\n"
        "    @ti.func\n"
        "    def accumulate(self, model: ti.template(), ball: ti.template(), impulse: ti.template(), h, time):\n"
        "        for i in range(model.n):\n"
        f"            {body}\n"
        "    def stiffness_rate(self, scene): return 0.0\n"
        "    def damping_rate(self, scene): return 0.0\n"
        "def simulation():\n"
        "    scene = ts.Scene(dim=2)\n"
        "    scene.add_balls([[0.0, 1.0]], radius=0.1)\n"
        "    return ts.Simulation(scene, forces=[Pull()])\n"
    )
    done = command(tmp_path, "run", "pull.py", "--quiet", "-o", "x.csv")
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert "pull.py, line 7, in accumulate: " in line
    assert said in line
    assert body in line
    assert sorted(path.name for path in tmp_path.iterdir() if path.is_file()) == ["pull.py"]
