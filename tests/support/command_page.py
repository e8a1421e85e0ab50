"""Page docs/command.md, made from the command itself: `make docs` writes it, a test holds the page against it."""

from pathlib import Path

from typer.core import TyperGroup
from typer.main import get_command

from taichi_sim.cli.main import main

PAGE = Path(__file__).parents[2] / "docs" / "command.md"


def commands():
    """Name to command, in the order of `taichi-sim --help`."""
    group = get_command(main)
    assert isinstance(group, TyperGroup)
    return group.commands


def options(command):
    """Rows (names, default, help) of a command, its arguments first."""
    found = sorted(command.params, key=lambda one: one.param_type_name != "argument")
    for one in found:
        argument = one.param_type_name == "argument"
        value = one.metavar or one.name.upper()
        names = value if argument else ", ".join(one.opts) + ("" if getattr(one, "is_flag", False) else f" {value}")
        default = (
            ""
            if getattr(one, "is_flag", False) or one.default in (None, ()) or callable(one.default)
            else f"{one.default}"
        )
        yield names, default, one.help or ""


def table(rows):
    yield from ("| argument or option | default | means |", "|---|---|---|")
    for names, default, text in rows:
        cells = (f"`{names}`", default and f"`{default}`", " ".join(text.split()))
        yield "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def markdown():
    """The whole page."""
    group = get_command(main)
    lines = ["# Commands", "", "<!-- `make docs` writes this page from the command -->", ""]
    lines += [f"`taichi-sim COMMAND -h` prints the same. {group.help}", "", str(group.epilog)]
    for name, command in commands().items():
        lines += ["", f"## taichi-sim {name}", "", " ".join(command.help.split()), "", *table(options(command))]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    PAGE.write_text(markdown())
