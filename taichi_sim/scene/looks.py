"""Look: how the surface of one thing looks in pictures in 3D, as [[output.looks]] of a scene file says it. Imports no Taichi."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from os import PathLike
from pathlib import Path
from types import NoneType
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from taichi_sim.common import validation
from taichi_sim.common.atomic_file import require_file
from taichi_sim.common.errors import SceneError, path_of, unknown_key
from taichi_sim.scene.embedded_surfaces import EmbeddedSurface
from taichi_sim.scene.objects import SceneObject

__all__ = ["FINISHES", "PATTERNS", "Finish", "Look", "Subjects"]

OFF_WHITE = (0.96, 0.95, 0.92)  # sRGB
MOST_PIXELS, KEPT_PIXELS = 8192, 1024  # along a side of a texture: of a file, and of what is drawn
FORMATS = ("PNG", "JPEG", "WEBP", "GIF", "BMP", "TIFF")  # none of them starts a program, as PostScript does
PATTERNS = ("plain", "stripes", "checks", "weave")
REPEATS = {"weave": 120.0, "texture": 1.0}  # of other patterns eight


@dataclass(frozen=True, slots=True)
class Finish:
    """Gloss and translucency of a surface, where no look gives them: in a sheet the share of the light that comes through, in a
    body that left after a quarter of its longest side."""

    gloss: float = 0.15
    sheet: float = 0.4
    body: float = 0.0


FINISHES = {  # of presets of these names
    "cotton": Finish(0.06, 0.4),
    "denim": Finish(0.04, 0.15),
    "polyester": Finish(0.25, 0.4),
    "knit": Finish(0.04, 0.3),
    "wool": Finish(0.03, 0.25),
    "silk": Finish(0.4, 0.5),
    "rubber": Finish(0.3, 0.05),
    "gelatine": Finish(0.6, 0.5, 0.4),
}


class Subjects(NamedTuple):
    """Names that a look may be `of`: shapes with a surface, those among them that are rectangular sheets, and colliders. bare:
    names of shapes without a surface. dim: of the scene."""

    dim: int
    shapes: Collection[str]
    sheets: Collection[str]
    bare: Collection[str]
    colliders: Collection[str]

    @classmethod
    def of(
        cls,
        dim: int,
        objects: Iterable[SceneObject],
        triangles: NDArray,
        embedded: Iterable[EmbeddedSurface],
        colliders: Iterable[str],
    ) -> Subjects:
        """Subjects of a scene: its objects, triangles (t, 3) of balls, embedded surfaces and the labels of its colliders."""
        objects = tuple(objects)
        surfaced = np.unique(np.concatenate([np.ravel(triangles), *(np.ravel(one.corners) for one in embedded)]))
        shapes = [one.name for one in objects if np.isin(one.balls, surfaced).any()]
        sheets = [one.name for one in objects if one.is_sheet]
        bare = [one.name for one in objects if one.name not in shapes]
        return cls(dim, shapes, sheets, bare, [label for label in colliders if label])

    @classmethod
    def of_scene(cls, scene: Any) -> Subjects:
        """Subjects of a Scene."""
        labels = (one.label for one in scene.colliders)
        return cls.of(scene.dim, scene.objects, scene.triangles, scene.embedded_surfaces, labels)


@dataclass(frozen=True, slots=True)
class Look:
    """Appearance of the surface of a shape or of a collider.

    Args:
        of: name of the shape or of the collider.
        pattern: plain, stripes, checks or weave, which stay with the surface: as they lie on a rectangular cloth, and in a body.
        pattern_colour: sRGB in 0..1 of every other stripe or field, or of the threads across in a weave, whose own colour is that
            of the surface [1].
        texture: an image file (PNG, JPEG, WebP, GIF, BMP or TIFF), in place of a pattern; it lies on a cloth as its texture
            coordinates say, upright on a body without any, as if shone through it from the front.
        repeat: how often the pattern repeats, along each side of a cloth, or along the longest side of a body [1]; 8 by default,
            120 threads of a weave, once for a texture.
        gloss: of highlights, from 0, matt, to 1 [1]; that of the material's preset, else 0.15.
        translucency: share of the light that comes through a sheet, or that is left inside a body after a quarter of its longest
            side [1]; that of the material's preset, else 0.4 of a sheet, 0 of a body.
        hem: width of a stitched hem along the borders of a rectangular cloth, as a part of its sides [1].
        opacity: of a collider: share of what is behind that it hides, to about a quarter [1]. Below 1 it casts no shadow.
    """

    of: str
    pattern: Literal["plain", "stripes", "checks", "weave"] = "plain"
    pattern_colour: tuple[float, float, float] | None = None
    texture: str | PathLike[str] | None = None
    repeat: float | None = None
    gloss: float | None = None
    translucency: float | None = None
    hem: float = 0.0
    opacity: float = 1.0

    @classmethod
    def listed(cls, given: Any, subjects: Subjects, read: bool = True) -> list[Look]:
        """Make the looks of the tables of [[output.looks]], none of None. read: True if their images are read, too. Raises
        SceneError that names `looks`, the number of the table, the key and the value."""
        if not isinstance(given, (list, tuple, NoneType)):
            raise SceneError("looks", given, "a list of tables")
        looks: list[Look] = []
        for k, table in enumerate(given or ()):
            looks.append(cls.of_table(f"looks[{k}]", table, subjects, looks))
            if read:
                looks[k].sizes(f"looks[{k}]")
        return looks

    @classmethod
    def of_table(
        cls,
        where: str,
        given: Mapping[str, Any],
        subjects: Subjects,
        before: Sequence[Look] = (),
    ) -> Look:
        """Make a look from a table of [[output.looks]], of one of the subjects, after the looks of the tables before. Raises
        SceneError that names `where`, the key and the value."""
        if subjects.dim != 3:
            raise SceneError(where, says="is for 3D; in 2D give `colour`, or a `stage`")
        known = [f.name for f in fields(cls)]
        if not isinstance(given, Mapping):
            raise SceneError(where, given, "a table")
        for key in given:
            if key not in known:
                raise unknown_key((*path_of(where), key), known, "a key of a look")
        given = {key: value for key, value in given.items() if value is not None}
        if "of" not in given:
            raise SceneError(f"{where}.of", says="is missing; give the name of a shape or of a collider")
        look = cls(**given)
        colliders = subjects.colliders
        names = sorted({*subjects.shapes, *colliders})
        if not isinstance(look.of, str) or look.of not in names:
            if isinstance(look.of, str) and look.of in subjects.bare:
                says = "has no surface; a look is for cloth, jelly, meshes and colliders, not for balls and springs"
                raise SceneError(f"{where}.of", look.of, says=says)
            raise SceneError(
                f"{where}.of", look.of, f"the name of a shape or of a collider: {', '.join(names) or 'none has one'}"
            )
        for k, other in enumerate(before):
            if other.of == look.of:
                says = f"has a look already, that of looks[{k}]; give it one"
                raise SceneError(f"{where}.of", look.of, says=says)
        validation.one_of(f"{where}.pattern", look.pattern, PATTERNS)
        colour = look.pattern_colour
        if colour is not None or look.pattern != "weave":
            given_colour = OFF_WHITE if colour is None else colour
            red, green, blue = validation.per_item(f"{where}.pattern_colour", given_colour, 3, low=0, high=1).tolist()
            colour = red, green, blue
        usual = REPEATS.get(look.pattern if look.texture is None else "texture", 8.0)
        repeat = validation.number(f"{where}.repeat", usual if look.repeat is None else look.repeat, positive=True)
        if look.texture is not None and not isinstance(look.texture, (str, PathLike)):
            raise SceneError(f"{where}.texture", look.texture, "the name of an image file")
        if look.texture is not None and look.pattern != "plain":
            raise SceneError(
                f"{where}.texture", str(look.texture), says="takes the place of a pattern; give one or the other"
            )
        shares = {
            key: validation.number(f"{where}.{key}", value, low=0, high=0.5 if key == "hem" else 1)
            for key in ("gloss", "translucency", "hem", "opacity")
            if (value := getattr(look, key)) is not None
        }
        if shares["opacity"] < 1 and look.of not in colliders:
            raise SceneError(f"{where}.opacity", look.opacity, says="is for colliders; a shape hides what is behind it")
        if look.hem and look.of not in subjects.sheets:
            what = "a collider has no borders" if look.of in colliders else f"{look.of!r} is none"
            raise SceneError(f"{where}.hem", look.hem, says=f"is for rectangular cloth; {what}")
        if look.repeat is not None and look.pattern == "plain" and look.texture is None:
            raise SceneError(
                f"{where}.repeat", look.repeat, says="is of a pattern or a texture; give one, or leave it out"
            )
        return cls(look.of, look.pattern, colour, look.texture, repeat, **shares)

    def sizes(self, where: str = "looks") -> list[NDArray[np.uint8]]:
        """The image (height, width, 3) of the texture, at most 1024 pixels wide and high, and smaller ones, each half as large as
        the one before; none without one. Raises SceneError where it cannot be read."""
        if self.texture is None:
            return []
        from PIL import Image, UnidentifiedImageError

        try:
            require_file(self.texture)
            with Image.open(self.texture, formats=FORMATS) as file:
                if max(file.size) > MOST_PIXELS:
                    raise ValueError(
                        f"it has {file.size[0]} x {file.size[1]} pixels, more than {MOST_PIXELS} along a side"
                    )
                image = file.convert("RGB")
        except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
            reason = getattr(error, "strerror", None) or error
            if isinstance(error, UnidentifiedImageError):
                reason = f"it is none of {', '.join(FORMATS)}"
            says = f"is not an image that can be read: {reason}"
            if isinstance(error, FileNotFoundError):
                says = "is not there; give an image file that exists"
            raise SceneError(f"{where}.texture", Path(self.texture), says=says) from None
        image.thumbnail((KEPT_PIXELS, KEPT_PIXELS))
        sizes = [np.asarray(image)]
        while max(image.size) > 1:
            image = image.resize(((image.width + 1) // 2, (image.height + 1) // 2), Image.Resampling.BOX)
            sizes.append(np.asarray(image))
        return sizes
