"""The course as HTML pages that load nothing from elsewhere, made from the Markdown in the package."""

import io
import os
import re
import sys
import webbrowser
from html import escape
from importlib import resources
from pathlib import Path

from platformdirs import user_cache_path

from taichi_sim.common.atomic_file import replacing
from taichi_sim.common.own_folder import require_own
from taichi_sim.outputs.base import require_folder_place
from taichi_sim.studies.page_parts import STYLE

__all__ = ["formula", "show", "write"]

START, RECORD = "index.html", "course.txt"
SAYS = b"The course of taichi_sim, which is written here again each time.\n"  # the record
OWN = """
body { max-width: 48rem } img { max-width: 100%; background: #fff; border-radius: 6px }
pre { padding: .8rem; background: var(--soft); border-radius: 6px; font-size: .8rem;
  white-space: pre-wrap; overflow-wrap: anywhere }
th, td { white-space: normal; text-align: left }
svg.formula { width: auto; height: auto } svg.formula path, svg.formula use, svg.formula rect { fill: currentColor; stroke: none }
"""


def write(out: str | None = None) -> Path:
    """Write the pages and pictures into a folder, by default one of the user's caches, and return the first page. Raises OSError
    where the folder is not one that this function made, which its record tells."""
    source = Path(str(resources.files("taichi_sim.course")))
    folder = user_cache_path("taichi_sim", ensure_exists=True) / "course" if out is None else Path(out)
    require_folder_place(folder)
    require_own(folder, lambda there: (there / RECORD).is_file() and (there / RECORD).read_bytes() == SAYS)
    folder.mkdir(exist_ok=True)
    with replacing(folder / RECORD) as record:
        record.write(SAYS)
    files = sorted(source.iterdir())
    texts = {file.stem: file.read_text(encoding="utf-8") for file in files if file.suffix == ".md"}
    for name, text in texts.items():
        with replacing(folder / f"{name}.html") as page:
            page.write(_page(text, _ways(name, texts)).encode())
    for file in files:
        if file.suffix in (".webp", ".png"):
            with replacing(folder / file.name) as picture:
                picture.write(file.read_bytes())
    return folder / START


def show(page: Path) -> None:
    """Open a page in a browser; nothing where there is no display."""
    if sys.platform in ("darwin", "win32") or os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"):
        webbrowser.open(page.resolve().as_uri())


def formula(source: str) -> str:
    """A formula in TeX as paths of an SVG, in the colour of the text around it: no script, no font and no network."""
    from matplotlib.font_manager import FontProperties
    from matplotlib.mathtext import math_to_image

    source, file = " ".join(source.split()).replace(r"\frac", r"\dfrac"), io.BytesIO()
    math_to_image(f"${source}$", file, prop=FontProperties(size=14, math_fontfamily="stix"), format="svg")
    paths = file.getvalue().decode()
    paths = re.sub(r'^.*?(?=<svg)|<metadata>.*?</metadata>|<g id="patch_1">.*?</g>', "", paths, flags=re.DOTALL)
    return paths.replace("<svg ", f'<svg role="img" aria-label="{escape(source)}" class="formula" ', 1).strip()


def _title(text: str) -> str:
    return text.split("\n", 1)[0].lstrip("# ")


def _ways(name: str, texts: dict[str, str]) -> str:
    """Links from a page, of texts by name, to the chapter before, to the contents and to the next chapter."""
    if name == "index":
        return ""
    chapters = sorted(set(texts) - {"index"})
    at = chapters.index(name)
    ways = [
        f'<a href="{one}.html" rel="prev">{escape(_title(texts[one]))}</a>' for one in chapters[max(0, at - 1) : at]
    ]
    ways.append(f'<a href="{START}">Course</a>')
    ways += [f'<a href="{one}.html" rel="next">{escape(_title(texts[one]))}</a>' for one in chapters[at + 1 : at + 2]]
    return f"<p>{' | '.join(ways)}</p>\n"


def _page(text: str, ways: str) -> str:
    """The HTML of a chapter in Markdown; ways: links above and below it."""
    from markdown_it import MarkdownIt

    text = re.sub(r"```\{.*?```\n", "", text, flags=re.DOTALL)  # directives of the site
    text = re.sub(r"(?<!!)\[([^\]]*)\]\(\.\./([\w.]+)[^)]*\)", r"\1 (docs/\2)", text)  # pages that the package has not
    text = re.sub(r"\((\w+)\.md\)", r"(\1.html)", text)
    text = re.sub(r"\$\$(.*?)\$\$", lambda found: "".join(formula(found[1]).splitlines()), text, flags=re.DOTALL)
    title = _title(text)
    body = MarkdownIt("commonmark", {"html": True}).enable("table").render(text)
    return (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>{escape(title)}</title>\n'
        f'<meta name="viewport" content="width=device-width"><style>{STYLE}{OWN}</style></head><body>\n'
        f"{ways}{body}{ways}</body></html>\n"
    )
