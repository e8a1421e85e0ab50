"""Outlines of text and of drawings as polygons with holes. Imports no Taichi.

Text comes from matplotlib's fonts, drawings from svgelements, and shapely makes areas of them (`pip install "taichi-sim[text]"`).
"""

import math
import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from taichi_sim.common.atomic_file import require_file
from taichi_sim.common.errors import SceneError, did_you_mean
from taichi_sim.geometry.svg_values import require_values

__all__ = ["FONT_FILES", "Outline", "drawing_outlines", "text_outlines"]

FINE = 2000.0  # units of the em square: curves are divided as finely as pictures of that size need
DEFAULT_FONT = "DejaVu Sans:bold"  # comes with matplotlib, so that a scene looks the same everywhere
LINE = 1.3  # from line to line, in heights of an E and its descender
MOST_LETTERS = 1_000  # each takes some hundredths of a second
MOST_COORDINATE = 1e50  # of a drawing, so that squares are finite
MOST_BYTES = 2_000_000  # of a drawing, each `use` replaced by what it names
MOST_PATHS, MOST_CORNERS = 2_000, 100_000  # of its filled areas
MOST_CROSSINGS = 5_000  # of an outline with itself, and four times as many with others: areas are cut there
MOST_NEAR = 3_000_000  # pairs of edges whose boxes overlap
CURVE_STEP = 0.002  # of a drawing's height: pieces of its curves
FONT_FILES = (".ttf", ".otf")


class Outline(NamedTuple):
    """An area without islands."""

    polygon: Any  # a shapely Polygon [m]
    colour: tuple[float, float, float] | None = None  # sRGB


def _shapely(where: str) -> Any:
    try:
        import shapely
    except ImportError:
        says = 'needs one more package: pip install "taichi-sim[text]"'
        raise SceneError(where, says=says) from None
    return shapely


def text_outlines(where: str, text: str, height: float, font: str | None = None) -> list[Outline]:
    """The letters of a text, parts that do not touch apart, from left to right and line by line.

    height: of a capital letter [m]. font: the name of a family that is installed, with `:bold` or `:italic` behind it, or a file
    .ttf or .otf. The origin is in the middle of the first base line. Raises SceneError that names what the font has no glyph for.
    """
    if not isinstance(text, str) or not text.strip():
        raise SceneError(f"{where}.text", text, "a text with something to see")
    if len(text) > MOST_LETTERS:
        raise SceneError(f"{where}.text", text, f"at most {MOST_LETTERS} letters")
    shapely = _shapely(where)
    from matplotlib.font_manager import FontProperties, get_font
    from matplotlib.textpath import TextPath

    file = _font_file(f"{where}.font", font)
    try:
        face: Any = get_font(file)
    except (RuntimeError, OSError, ValueError) as error:  # of a damaged file
        reason = str(error).partition("\n")[0]
        raise SceneError(f"{where}.font", file, says=f"cannot be read as a font: {reason}") from None
    for letter in text:
        if not letter.isspace() and face.get_char_index(ord(letter)) == 0:
            missing = f"{letter!r} (U+{ord(letter):04X}), which the font {face.family_name} does not have"
            raise SceneError(f"{where}.text", text, says=f"has {missing}; take another letter, or another `font`")
    properties = FontProperties(fname=file)

    def rings(line: str, usetex: bool = False) -> list[NDArray]:
        path = TextPath((0.0, 0.0), line.replace("$", r"\$"), size=FINE, prop=properties, usetex=usetex)
        return [np.asarray(ring) for ring in path.to_polygons(closed_only=True)]

    capital = float(np.ptp(np.concatenate(rings("H"))[:, 1]))
    scale = height / capital
    found = []
    for number, line in enumerate(text.splitlines()):
        if not line.strip():
            continue
        drawn = rings(line)
        x = np.concatenate(drawn)[:, 0]
        shift = np.array([-0.5 * (x.min() + x.max()), -number * LINE * capital])
        area = _filled(shapely, [(ring + shift) * scale for ring in drawn])
        parts = sorted(shapely.get_parts(area), key=lambda part: part.bounds[0])
        found += [Outline(part) for part in parts]
    return found


def _font_file(where: str, font: Any) -> str:
    from matplotlib.font_manager import FontProperties, findfont, fontManager

    if font is not None and (not isinstance(font, (str, os.PathLike)) or not str(font)):
        raise SceneError(where, font, "the name of a font, or a file .ttf or .otf")
    if font is not None and str(font).lower().endswith(FONT_FILES):
        if not Path(font).is_file():
            raise SceneError(
                where, font, says="is not there; it must be the name of an installed font, or a file .ttf or .otf"
            )
        return os.fspath(font)
    family, *styles = str(font or DEFAULT_FONT).split(":")
    for style in styles:
        if style not in ("bold", "italic"):
            raise SceneError(where, font, f"a family with :bold or :italic behind it, not :{style}")
    asked = FontProperties(
        family=family,
        weight="bold" if "bold" in styles else "normal",
        style="italic" if "italic" in styles else "normal",
    )
    known = sorted({entry.name for entry in fontManager.ttflist})
    if family not in known:
        raise SceneError(where, font, says=f"is not installed; {did_you_mean(family, known)}")
    return findfont(asked)


def drawing_outlines(where: str, file: str | os.PathLike[str], height: float) -> list[Outline]:
    """The filled areas of an SVG file, parts that do not touch apart, each with its colour.

    height: of all of it [m]; the origin is in the middle of its lower side. What is drawn as a line alone (`fill="none"`) is no
        area;
    raises SceneError for a path that is filled, but not closed, for a file without any area, and for one that cannot be read.
    """
    shapely = _shapely(where)
    try:
        from svgelements import SVG, Close, Shape
        from svgelements import Path as SvgPath
    except ImportError:
        raise SceneError(where, says='needs one more package: pip install "taichi-sim[text]"') from None
    where = f"{where}.file"
    try:
        require_file(file)
        size = max(os.stat(file).st_size, _weight(file))
        if size > MOST_BYTES:
            says = f"has {size / 1e6:.3g} MB, uses of its parts included; a drawing may have {MOST_BYTES / 1e6:g} MB at most"
            raise SceneError(where, file, says=says)
        drawing = SVG.parse(os.fspath(file), reify=True)
    except (FileNotFoundError, IsADirectoryError):
        raise SceneError(where, file, says="is not there; it must be an existing .svg file") from None
    except SceneError:
        raise
    except Exception as error:  # a parser for foreign files may raise anything
        reason = "its groups are too deep" if isinstance(error, RecursionError) else error
        if isinstance(error, (LookupError, TypeError, AttributeError)):  # whose messages are of the parser alone
            reason = "it holds something else than SVG has there"
        if isinstance(error, ArithmeticError):
            reason = "it has numbers that are too small or too large"
        raise SceneError(where, file, says=f"cannot be read as SVG: {reason}") from None
    found_rings: list[tuple[list[NDArray], bool, tuple[float, float, float]]] = []
    corners = 0
    box = drawing.bbox()
    if box is None or box[3] <= box[1]:
        sides = [f"{key} = {drawing.values[key]!r}" for key in ("width", "height") if key in drawing.values]
        says = "shows nothing that has an area" + (f"; it is drawn with {' and '.join(sides)}" if sides else "")
        raise SceneError(where, file, says=says)
    if not all(abs(side) <= MOST_COORDINATE for side in box):
        raise SceneError(where, file, says=f"has coordinates beyond {MOST_COORDINATE:g}")
    step = CURVE_STEP * (box[3] - box[1])
    for number, element in enumerate(one for one in drawing.elements() if isinstance(one, Shape)):
        fill = element.fill
        if fill is None or fill.value is None or fill.alpha == 0:
            continue
        rings = []
        for part in SvgPath(element).as_subpaths():
            path = SvgPath(part)
            ends = path.first_point, path.current_point
            closed = any(isinstance(segment, Close) for segment in path)
            if not closed and (None in ends or abs(ends[0] - ends[1]) > step):
                called = f"the path {element.id!r}" if element.id else f"path {number} (from 0)"
                places = [] if None in ends else [f"({end.x:g}, {end.y:g})" for end in ends]
                at = f", which goes from {' to '.join(places)}" if places else ""
                says = f'has an open outline, {called}{at}; close it, or give it fill="none" if it is a line'
                raise SceneError(where, file, says=says)
            try:
                rings.append(_flat(path, step, MOST_CORNERS - corners))
            except (ValueError, ArithmeticError) as error:  # of numbers that are none
                called = f"the path {element.id!r}" if element.id else f"path {number} (from 0)"
                raise SceneError(where, file, says=f"has numbers in {called} that make no outline: {error}") from None
            corners += len(rings[-1])
        rings = [ring for ring in rings if len(ring) >= 3]
        if rings:
            rule = element.values.get("fill-rule") == "evenodd"
            found_rings.append((rings, rule, (fill.red / 255, fill.green / 255, fill.blue / 255)))
        if len(found_rings) > MOST_PATHS:
            raise SceneError(where, file, says=f"has more than {MOST_PATHS} filled paths")
    _require_simple(shapely, where, file, [ring for rings, _, _ in found_rings for ring in rings])
    filled = ((_filled(shapely, rings, even_odd=rule), colour) for rings, rule, colour in found_rings)
    areas = [(area, colour) for area, colour in filled if not area.is_empty]
    if not areas:
        raise SceneError(where, file, says='shows no filled area; lines alone (fill="none") have none')
    left, top, right, bottom = shapely.total_bounds([area for area, _ in areas])
    scale = height / (bottom - top)
    found = []
    covered: Any = None
    for area, colour in reversed(areas):  # what is drawn later hides what is below
        seen = area if covered is None else area.difference(covered)
        covered = area if covered is None else covered.union(area)
        placed = shapely.transform(seen, lambda x: (x - [0.5 * (left + right), bottom]) * [scale, -scale])
        found += [Outline(part, colour) for part in _polygons(shapely, placed)]
    if not found:
        raise SceneError(where, file, says="shows nothing that has an area")
    return found[::-1]


def _weight(file: str | os.PathLike[str]) -> int:
    """Bytes of the texts in a drawing once each `use` is replaced by what it names. Raises ValueError where one names itself, and
    what `require_values` raises it for."""
    root = ElementTree.parse(file).getroot()
    require_values(root)
    named = {element.get("id"): element for element in root.iter()}
    known: dict[Any, int | None] = {}

    def weigh(element: Any) -> int:
        if element not in known:
            known[element] = None
            total = sum(len(key) + len(value) for key, value in element.attrib.items()) + len(element.text or "") + 1
            total += sum(map(weigh, element))
            if str(element.tag).rpartition("}")[2] == "use":
                links = (value for key, value in element.attrib.items() if key.rpartition("}")[2] == "href")
                total += sum(weigh(named[link[1:]]) for link in links if link[1:] in named)
            known[element] = total
        weight = known[element]
        if weight is None:
            raise ValueError(f"the element {element.get('id')!r} uses itself")
        return weight

    return weigh(root)


def _require_simple(shapely: Any, where: str, file: Any, rings: Sequence[NDArray]) -> None:
    """Raise SceneError where edges cross each other so often that areas would take minutes."""
    if not rings:
        return
    ends = np.concatenate([np.stack([ring, np.roll(ring, -1, axis=0)], axis=1).reshape(-1, 4) for ring in rings])
    ends, first = np.unique(ends, axis=0, return_index=True)
    ring_of = np.repeat(np.arange(len(rings)), [len(ring) for ring in rings])[first]
    edges = shapely.linestrings(ends.reshape(-1, 2, 2))
    tree = shapely.STRtree(edges)
    near = own = others = 0  # each from either edge
    for begin in range(0, len(edges), 64):
        some = edges[begin : begin + 64]
        near += tree.query(some).shape[1]
        if near <= MOST_NEAR:
            one, other = tree.query(some, predicate="crosses")
            same = int(np.count_nonzero(ring_of[begin + one] == ring_of[other]))
            own, others = own + same, others + len(one) - same
        if near > MOST_NEAR or own > 2 * MOST_CROSSINGS or others > 8 * MOST_CROSSINGS:
            raise SceneError(where, file, says="has edges that cross each other too often; unite or simplify its paths")


def _flat(path: Any, step: float, most: int) -> NDArray:
    """The corners (k, 2) of a path whose curves are divided into pieces about `step` long. Raises ValueError where there would be
    more than `most`."""
    from svgelements import Arc, Close, CubicBezier, Line, Move, QuadraticBezier

    points: list[tuple[float, float]] = []
    for segment in path:
        if isinstance(segment, Move):
            points.append((segment.end.x, segment.end.y))
        elif isinstance(segment, (Line, Close)):
            if segment.end is not None:
                points.append((segment.end.x, segment.end.y))
        elif isinstance(segment, (CubicBezier, QuadraticBezier, Arc)):
            coarse = segment.npoint(np.linspace(0.0, 1.0, 17))
            length = float(np.linalg.norm(np.diff(coarse, axis=0), axis=1).sum())  # a few thousandths less than it is
            if not math.isfinite(length):
                raise ValueError("a curve is not finite")
            pieces = int(min(1000, max(4, math.ceil(length / step))))
            points += map(tuple, segment.npoint(np.arange(1, pieces + 1) / pieces).tolist())
        if len(points) > most:
            raise ValueError(f"the drawing has more than {MOST_CORNERS} corners")
    return np.array(points).reshape(-1, 2)


def _filled(shapely: Any, rings: Sequence[NDArray], even_odd: bool = False) -> Any:
    """The area that closed rings (k, 2) enclose, by the winding rule of fonts and SVG, or by the even-odd rule."""
    if even_odd:
        area = shapely.Polygon()
        for ring in rings:
            area = area.symmetric_difference(_area(shapely, ring))
        return area
    solid = max(rings, key=lambda ring: abs(_signed(ring)))
    turn = np.sign(_signed(solid))
    same, other = (
        [_area(shapely, r) for r in rings if (np.sign(_signed(r)) == turn) == side] for side in (True, False)
    )
    inner = shapely.union_all(other)
    outer = shapely.union_all(same)
    if not other or outer.contains(inner):
        return outer.difference(inner)
    return outer.symmetric_difference(inner)  # rings beside each other that turn differently are filled, too


def _signed(ring: NDArray) -> float:
    x, y = ring.T
    return 0.5 * float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))


def _area(shapely: Any, ring: NDArray) -> Any:
    polygon = shapely.Polygon(ring)
    return polygon if polygon.is_valid else shapely.make_valid(polygon)


def _polygons(shapely: Any, area: Any) -> Iterable[Any]:
    """The polygons of an area, without points and lines where parts touch."""
    return [part for part in shapely.get_parts(area) if part.geom_type == "Polygon" and part.area > 0]
