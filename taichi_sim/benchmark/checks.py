"""Checks of a device before it is timed: the self-test, and in a source folder the tests against the CPU."""

import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import taichi_sim
from taichi_sim.device.devices import examine

ROOT = Path(taichi_sim.__file__).parents[1]  # of the source, where there is one
QUICK = ("-k", "computes_right")  # the tests that a quick run makes


class Tests(NamedTuple):
    """Numbers of the tests of devices, and of those that failed the names."""

    tests: int
    failed: int
    skipped: int
    seconds: float
    exit_status: int
    failures: list[str]


class Checks(NamedTuple):
    """self_test: what is wrong, "" where it passed; tests: None without a source folder."""

    self_test: str
    tests: dict[str, Any] | None
    passed: bool

    def lines(self) -> list[str]:
        """Lines for a person."""
        said = "tests of devices: none here; they come with the source"
        if self.tests is not None:
            said = "tests of devices: {tests}, of which {failed} failed and {skipped} skipped".format(**self.tests)
            if self.tests["exit_status"] and not self.tests["failed"]:
                said = f"tests of devices could not run: pytest ended with status {self.tests['exit_status']}"
        failures = [] if self.tests is None else [f"  {name}" for name in self.tests["failures"]]
        return [f"self-test: {self.self_test or 'passed'}", said, *failures]


def check_device(arch: str, quick: bool) -> Checks:
    """Both. Raises nothing where they fail."""
    wrong = examine(arch)
    found = run_tests(arch, QUICK if quick else ()) if (ROOT / "tests" / "gpu").is_dir() else None
    passed = not wrong and (found is None or found.exit_status == 0)
    return Checks(wrong, None if found is None else found._asdict(), passed)


def run_tests(arch: str, options: tuple[str, ...] = ()) -> Tests:
    """The tests marked `gpu`, by pytest in a process of its own."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "tests.xml")
        command = [sys.executable, "-m", "pytest", "-m", "gpu", "--arch", arch, f"--junitxml={file}", *options]
        environment = os.environ | {"TAICHI_SIM_PRECISION": "f32"}
        done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
        if not file.is_file():  # pytest is not installed, or could not begin
            last = (done.stderr.strip().splitlines() or ["no message"])[-1]
            return Tests(0, 0, 0, 0.0, done.returncode, [last])
        suite = next(ElementTree.parse(file).iter("testsuite"))
    number = {key: int(suite.get(key, 0)) for key in ("tests", "failures", "errors", "skipped")}
    failures = [
        f"{case.get('classname')}::{case.get('name')}"
        for case in suite.iter("testcase")
        if case.find("failure") is not None or case.find("error") is not None
    ]
    return Tests(
        number["tests"],
        number["failures"] + number["errors"],
        number["skipped"],
        float(suite.get("time", 0.0)),
        done.returncode,
        failures,
    )
