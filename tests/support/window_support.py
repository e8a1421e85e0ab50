"""A display of one's own, and the hand at its mouse and keys."""

import ctypes
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

MISSING = [tool for tool in ("Xvfb", "xdotool") if shutil.which(tool) is None]
WAIT = 120.0  # s; compiling on a busy machine

# a simulation in a child process that prints the time and places of each frame
LOGGED = """
import json, sys
import numpy as np
import taichi_sim as ts

class Logged(ts.Simulation):
    def frame(self):
        frame = super().frame()
        print(json.dumps([frame.time, frame.position.tolist()]), flush=True)
        return frame

"""

CHILD = (
    LOGGED
    + """
from taichi_sim.viewer import window

def two():
    scene = ts.Scene(dim=2)
    scene.add_balls([[0, 0], [1, 0.5], [0.5, 1]], radius=0.1, mass=[1.0, 1e-3, 1.0], pinned=[2])
    return scene

def three():
    scene = ts.Scene(dim=3)
    ts.shapes.cloth(scene, size=(1, 1), resolution=(6, 6), rotation=(60, 0, 0))
    return scene

def simulate(forces):
    return Logged(globals()[sys.argv[1]](), forces=forces, contacts="off", arch="cpu", precision="f32", dt=1e-3)

window.show(simulate, fps=30, size=(320, 240), say=lambda line: print(json.dumps(line), flush=True))
"""
)


def _heed_interrupts() -> None:
    """A shell's background job, which the tests may be, ignores SIGINT, and what it starts would too."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


class Display:
    """An Xvfb on a free display number; `close` ends it."""

    def __init__(self) -> None:
        read, write = os.pipe()
        # -noreset: else it starts anew, deaf for a moment, when its last client goes
        command = ["Xvfb", "-displayfd", str(write), "-screen", "0", "800x600x24", "-noreset", "-nolisten", "tcp"]
        self.server = subprocess.Popen(command, pass_fds=[write], stderr=subprocess.DEVNULL)
        os.close(write)
        with os.fdopen(read) as number:
            self.name = f":{number.readline().strip()}"
        self.environment = os.environ | {"DISPLAY": self.name}

    def do(self, *words: object) -> str:
        """One xdotool command line; what it prints."""
        line = ["xdotool", *map(str, words)]
        done = subprocess.run(line, env=self.environment, capture_output=True, text=True, timeout=30)
        return done.stdout

    def close(self) -> None:
        self.server.terminate()
        self.server.wait(timeout=30)


class Window:
    """A window in a process of its own, in a folder, on a display: its process, its mouse and its keys."""

    def __init__(self, display: Display, folder: Path, *command: str) -> None:
        self.display, self.folder = display, folder
        self.log = folder / "log"
        with open(self.log, "w") as out, open(folder / "errors", "w") as errors:
            self.process = subprocess.Popen(
                [sys.executable, *command],
                cwd=folder,
                env=display.environment,
                stdout=out,
                stderr=errors,
                preexec_fn=_heed_interrupts,
            )
        self.until(
            lambda: (
                display.do("search", "--onlyvisible", "--name", "taichi_sim").strip() or self.process.poll() is not None
            )
        )
        assert self.process.poll() is None, self.errors
        self.id = int(display.do("search", "--onlyvisible", "--name", "taichi_sim").split()[0])
        self.point(160, 120)

    @classmethod
    def of(cls, display: Display, folder: Path, scene: str) -> "Window":
        """One of the scenes of CHILD, whose frames it logs."""
        (folder / "child.py").write_text(CHILD)
        window = cls(display, folder, "child.py", scene)
        window.until(lambda: len(window.frames()) >= 2 or window.process.poll() is not None)  # all is compiled
        assert window.process.poll() is None, window.errors
        return window

    @property
    def errors(self) -> str:
        return (self.folder / "errors").read_text()

    @staticmethod
    def until(happened, wait: float = WAIT) -> None:
        """Wait for it."""
        end = time.monotonic() + wait
        while not happened():
            assert time.monotonic() < end, "waited in vain"
            time.sleep(0.05)

    def frames(self) -> list[tuple[float, np.ndarray]]:
        """Time and positions of every frame so far."""
        lines = self.log.read_text().rsplit("\n", 1)[0].splitlines()
        return [(line[0], np.array(line[1])) for line in map(json.loads, lines) if isinstance(line, list)]

    @property
    def time(self) -> float:
        return self.frames()[-1][0]

    def moves_on(self) -> None:
        """Wait until some time has been simulated."""
        begin = self.time
        self.until(lambda: self.time > begin + 0.05)

    def key(self, *names: str) -> None:
        self.display.do("key", "--delay", 40, *names)

    def point(self, x: float, y: float) -> None:
        self.display.do("mousemove", "--window", self.id, round(x), round(y))

    def drag(self, *places: tuple[float, float], button: int = 1, hold: float = 0.3) -> None:
        """Press at the first place, go through the others, and let go `hold` seconds later."""
        self.point(*places[0])
        time.sleep(0.1)
        self.display.do("mousedown", button)
        for place in places[1:]:
            time.sleep(0.2)
            self.point(*place)
        time.sleep(hold)
        self.display.do("mouseup", button)
        time.sleep(0.1)

    def close(self) -> None:
        """As the close button of a window manager does: a message that asks the window to go."""
        x11 = ctypes.CDLL("libX11.so.6")
        x11.XOpenDisplay.restype = ctypes.c_void_p
        x11.XInternAtom.restype = ctypes.c_ulong
        x11.XInternAtom.argtypes = [ctypes.c_void_p, ctypes.c_char_p, ctypes.c_int]
        x11.XSendEvent.argtypes = [ctypes.c_void_p, ctypes.c_ulong, ctypes.c_int, ctypes.c_long, ctypes.c_void_p]
        x11.XCloseDisplay.argtypes = [ctypes.c_void_p]
        display = x11.XOpenDisplay(self.display.name.encode())
        protocols, delete = (x11.XInternAtom(display, name, 0) for name in (b"WM_PROTOCOLS", b"WM_DELETE_WINDOW"))
        event = (ctypes.c_long * 24)(33, 0, 1, 0, self.id, protocols, 32, delete)  # a ClientMessage, on 64 bits
        x11.XSendEvent(display, self.id, 0, 0, ctypes.addressof(event))
        x11.XCloseDisplay(display)

    def ended(self) -> int:
        """Its exit status, once it has ended."""
        return self.process.wait(timeout=WAIT)

    def kill(self) -> None:
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait()
