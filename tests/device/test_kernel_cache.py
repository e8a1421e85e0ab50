"""Where compiled kernels are kept: wherever the process runs, and as whom, it ends with what it was asked for."""

import os
import shutil
import stat
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from taichi_sim.device import kernel_cache
from taichi_sim.device.engine import ENGINE
from taichi_sim.device.kernel_cache import cache_folder

pytestmark = [
    pytest.mark.once,
    pytest.mark.skipif(os.name != "posix" or ENGINE != "taichi", reason="homes, rights and Taichi's cache"),
]

SCRIPT = """
import warnings
warnings.showwarning = lambda message, *_: print(f"warning: {message}")
from taichi_sim.device import backend
from taichi_sim.device.engine import ti

print(backend.start("cpu", "f32"))

@ti.kernel
def double(x: int) -> int:
    return 2 * x

print(double(21))
"""
SITE = [place for place in sys.path if place]
OTHER = 54321  # a user whom nobody knows


@pytest.fixture
def place(monkeypatch):
    """A folder that any user may write to; temporary files lie in it, too."""
    folder = Path(tempfile.mkdtemp())
    folder.chmod(0o777)
    (folder / "tmp").mkdir()
    (folder / "tmp").chmod(0o1777)
    (folder / "double.py").write_text(SCRIPT)
    yield folder
    shutil.rmtree(folder)


def started(place, user=None, **environment):
    """What the script says, which ends well, in these environment variables alone."""
    given = {
        "PATH": os.environ["PATH"],
        "TMPDIR": str(place / "tmp"),
        "PYTHONPATH": os.pathsep.join(SITE),
        **environment,
    }
    as_user = ["setpriv", f"--reuid={user}", f"--regid={user}", "--clear-groups"] if user else []
    if user:  # it may read the packages, wherever they are
        as_user += ["--inh-caps=+dac_read_search", "--ambient-caps=+dac_read_search"]
    done = subprocess.run(
        [*as_user, sys.executable, place / "double.py"],
        env=given,
        cwd=place,
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    first, *lines = done.stdout.splitlines()
    assert lines[-1] == "42"
    assert {p.name for p in place.iterdir()} <= {"tmp", "double.py", "home"}  # nothing in the working folder
    return [line for line in (first, *lines) if line.startswith("warning")]


def own(place, user=None):
    return place / "tmp" / f"taichi_sim_{user or os.getuid()}"


def test_without_a_home(place):
    """The user's own is taken, from the list of users."""
    for home in ({}, {"HOME": ""}, {"HOME": "here"}):
        started(place, **home)


@pytest.mark.slow_where(file=["home/.cache", "home/.cache/taichi"])
@pytest.mark.parametrize("file", ["home", "home/.cache", "home/.cache/taichi", "home/.cache/taichi/ticache"])
def test_a_file_in_place_of_the_cache(place, file):
    (place / file).parent.mkdir(parents=True, exist_ok=True)
    (place / file).touch()
    (said,) = started(place, HOME=str(place / "home"))
    assert "home/.cache/taichi/ticache: compiled kernels cannot be kept there (" in said
    assert f"they are kept in {own(place)}. Set XDG_CACHE_HOME to a folder that you can write" in said
    assert list(own(place).glob("*.tic"))


def test_a_folder_in_place_of_the_list_of_kernels(place):
    (place / "home/.cache/taichi/ticache/ticache.tcb").mkdir(parents=True)
    assert "cannot be kept there (Is a directory)" in started(place, HOME=str(place / "home"))[0]


as_root = pytest.mark.skipif(
    not hasattr(os, "getuid") or os.getuid() != 0 or shutil.which("setpriv") is None, reason="becomes another user"
)


@as_root
@pytest.mark.slow_where(home=["", "/"])
@pytest.mark.parametrize("home", [None, "", "/", "/nonexistent"])
def test_a_user_whom_nobody_knows(place, home):
    environment = {} if home is None else {"HOME": home}
    said = started(place, OTHER, **environment)
    assert len(said) <= 1
    assert own(place, OTHER).stat().st_uid == OTHER
    assert list(own(place, OTHER).rglob("*.tic"))


@as_root
def test_a_home_that_can_be_read_alone(place):
    started(place, HOME=str(place / "home"))
    before = {p: p.read_bytes() for p in (place / "home").rglob("*") if p.is_file()}
    assert "(Permission denied); they are kept in" in started(place, OTHER, HOME=str(place / "home"))[0]
    assert {p: p.read_bytes() for p in (place / "home").rglob("*") if p.is_file()} == before
    # a folder that is open, but holds kernels of somebody else
    (place / "home/.cache/taichi/ticache").chmod(0o777)
    assert "(Permission denied); they are kept in" in started(place, OTHER, HOME=str(place / "home"))[0]


@as_root
def test_nothing_can_be_written_anywhere(place):
    (place / "tmp").chmod(0o555)
    (said,) = started(place, OTHER, HOME="/nonexistent", TMPDIR="/nonexistent", XDG_CACHE_HOME="/nonexistent")
    assert "kept in /tmp/" in said or "kept in /var/tmp/" in said or "each process compiles all of them" in said
    shutil.rmtree(Path("/tmp") / f"taichi_sim_{OTHER}", ignore_errors=True)


def test_a_temporary_folder_of_somebody_else_is_not_taken(tmp_path, monkeypatch):
    """Kernels are programs: what lies there could be anybody's."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    usual = tmp_path / "file" / "ticache"
    (tmp_path / "file").touch()
    place = own(Path())
    place = tmp_path / place.name

    def chosen():
        with pytest.warns(UserWarning, match=r"cannot be kept there \(Not a directory\)"):
            return cache_folder(usual)

    assert chosen() == place
    assert stat.S_IMODE(place.stat().st_mode) == 0o700
    place.chmod(0o777)
    assert chosen() is None
    place.rmdir()
    place.symlink_to(tmp_path)
    assert chosen() is None
    place.unlink()
    place.mkdir(mode=0o700)
    monkeypatch.setattr(kernel_cache.os, "getuid", lambda: OTHER)
    place.rename(tmp_path / f"taichi_sim_{OTHER}")
    assert chosen() is None


def test_environment_variables_of_the_engine_end_nothing(place):
    given = {"TI_ARCH": "nonsense", "TI_DEFAULT_FP": "64", "TI_LOG_LEVEL": "loud", "TI_CPU_MAX_NUM_THREADS": "many"}
    assert started(place, HOME=str(place / "home"), **given) == []


def test_the_working_folder_was_deleted(place, tmp_path):
    (tmp_path / "gone").mkdir()
    code = f"import os; os.chdir({str(tmp_path / 'gone')!r}); os.rmdir(os.getcwd())"
    (place / "double.py").write_text(f"{code}{SCRIPT}")
    with pytest.raises(AssertionError, match="BackendError: the working folder was deleted; change to another one"):
        started(place, HOME=str(place / "home"))


def test_a_wrong_environment_variable_is_named(place):
    with pytest.raises(AssertionError, match="environment variables TI_OPT_LEVEL: invalid literal"):
        started(place, HOME=str(place / "home"), TI_OPT_LEVEL="high")
