"""Figures of studies: their style, which no file of the user's changes, and how they get into pages and files."""

import functools
import io
import re
from collections.abc import Callable
from typing import Any

__all__ = ["INK", "dress", "literal", "png", "styled", "svg"]

INK = "#010203"  # of words and axes; becomes the page's own colour


def styled(function: Callable[..., Any]) -> Callable[..., Any]:
    """Let a function draw in matplotlib's own style: a file `matplotlibrc` in the working folder, which may be anybody's, could
    have it start LaTeX."""

    @functools.wraps(function)
    def call(*args: Any) -> Any:
        import matplotlib

        usual = {name: value for name, value in matplotlib.rcParamsDefault.items() if not name.startswith("backend")}
        with matplotlib.rc_context(usual):
            return function(*args)

    return call


def literal(text: str) -> str:
    """Escape a name for a figure: a $ in it begins no formula."""
    return text.replace("$", r"\$")


def dress(axis: Any, grid: bool = True) -> None:
    """Give an axis the colour of a page's words, and no frame."""
    axis.patch.set_alpha(0.0)
    axis.tick_params(which="both", colors=INK, labelcolor=INK)
    if grid:
        axis.grid(True, which="major", color=INK, alpha=0.13, lw=0.6)
    for side, spine in axis.spines.items():
        spine.set_color(INK)
        spine.set_visible(side in ("left", "bottom"))


@styled
def svg(figure: Any) -> str:
    """Figure as SVG for a page: words and axes in the colour of its text, no background, no header."""
    import matplotlib

    text = io.StringIO()
    with matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": "taichi_sim", "font.family": "sans-serif"}):
        figure.savefig(text, format="svg", transparent=True, metadata={"Date": None})
    body = text.getvalue()
    return re.sub(INK, "currentColor", body[body.index("<svg") :], flags=re.IGNORECASE)


@styled
def png(figure: Any) -> bytes:
    """Figure as PNG for Markdown, on white."""
    data = io.BytesIO()
    figure.savefig(data, format="png", dpi=130, facecolor="white")
    return data.getvalue()
