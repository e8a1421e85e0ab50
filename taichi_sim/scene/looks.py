"""Look: how the surface of one thing looks in pictures in 3D, as [[output.looks]] of a scene file says it. Imports no Taichi."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, fields
from os import PathLike
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from taichi_sim.common import validation
from taichi_sim.common.atomic_file import require_file
from taichi_sim.common.errors import SceneError, unknown_key

__all__ = ["PATTERNS", "Look"]

MOST_PIXELS, KEPT_PIXELS = 8192, 1024  # along a side of a texture: of a file, and of what is drawn
FORMATS = ("PNG", "JPEG", "WEBP", "GIF", "BMP", "TIFF")  # none of them starts a program, as PostScript does
PATTERNS = ("plain", "stripes", "checks")


@dataclass(frozen=True, slots=True)
class Look:
    """Appearance of the surface of a shape or of a collider.

    Args:
        of: name of the shape or of the collider.
        pattern: plain, stripes or checks, which stay with the surface: as they lie on a rectangular cloth, and in a body.
        pattern_colour: sRGB in 0..1 of every other stripe or field [1].
        texture: an image file (PNG, JPEG, WebP, GIF, BMP or TIFF), in place of a pattern; it lies on a cloth as its texture
            coordinates say, upright on a body without any, as if shone through it from the front.
        repeat: how often the pattern repeats, along each side of a cloth, or along the longest side of a body [1]; 8 by default,
            once for a texture.
        gloss: of highlights, from 0, matt, to 1 [1].
        opacity: of a collider: share of what is behind that it hides, to about a quarter [1]. Below 1 it casts no shadow.
    """

    of: str
    pattern: Literal["plain", "stripes", "checks"] = "plain"
    pattern_colour: tuple[float, float, float] = (0.96, 0.95, 0.92)
    texture: str | PathLike[str] | None = None
    repeat: float | None = None
    gloss: float = 0.15
    opacity: float = 1.0

    @classmethod
    def of_table(
        cls,
        where: str,
        given: Mapping[str, Any],
        shapes: Collection[str],
        colliders: Collection[str],
        before: Sequence[Look] = (),
    ) -> Look:
        """Make a look from a table of [[output.looks]], the names of shapes and colliders, and the looks of the tables
        before. Raises SceneError that names `where`, the key and the value."""
        known = [f.name for f in fields(cls)]
        if not isinstance(given, Mapping):
            raise SceneError(where, given, "a table")
        for key in given:
            if key not in known:
                raise unknown_key((where, key), known, "a key of a look")
        if "of" not in given:
            raise SceneError(f"{where}.of", says="is missing; give the name of a shape or of a collider")
        look = cls(**given)
        names = sorted({*shapes, *colliders})
        if look.of not in names:
            raise SceneError(
                f"{where}.of", look.of, f"the name of a shape or of a collider: {', '.join(names) or 'none has one'}"
            )
        for k, other in enumerate(before):
            if other.of == look.of:
                says = f"has a look already, that of looks[{k}]; give it one"
                raise SceneError(f"{where}.of", look.of, says=says)
        validation.one_of(f"{where}.pattern", look.pattern, PATTERNS)
        colour = validation.per_item(f"{where}.pattern_colour", look.pattern_colour, 3, low=0, high=1)
        usual = 8.0 if look.texture is None else 1.0
        repeat = validation.number(f"{where}.repeat", usual if look.repeat is None else look.repeat, positive=True)
        if look.texture is not None and not isinstance(look.texture, (str, PathLike)):
            raise SceneError(f"{where}.texture", look.texture, "the name of an image file")
        if look.texture is not None and look.pattern != "plain":
            raise SceneError(
                f"{where}.texture", str(look.texture), says="takes the place of a pattern; give one or the other"
            )
        shares = {
            key: validation.number(f"{where}.{key}", getattr(look, key), low=0, high=1) for key in ("gloss", "opacity")
        }
        if shares["opacity"] < 1 and look.of not in colliders:
            raise SceneError(f"{where}.opacity", look.opacity, says="is for colliders; a shape hides what is behind it")
        red, green, blue = colour.tolist()
        checked = cls(look.of, look.pattern, (red, green, blue), look.texture, repeat, **shares)
        checked.sizes(where)
        return checked

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
