"""The command, run in this process."""

import re

import pytest


def status(*words) -> int:
    """Exit status of taichi-sim with these words."""
    from taichi_sim.cli.main import main

    with pytest.raises(SystemExit) as ended:
        main([str(word) for word in words])
    code = ended.value.code
    assert isinstance(code, int)
    return code


def run_shown(text: str, pattern: str, *more: str) -> None:
    """Run the one command of a page's text that matches, with further words."""
    (command,) = re.findall(rf"^taichi-sim {pattern}$", text, re.MULTILINE)
    assert status(*command.split(), *more) == 0
