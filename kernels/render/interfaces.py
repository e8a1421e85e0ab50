"""What the kernels of the renderer read of the objects handed to them, with shape and unit.

Pictures have `pixels` pixels, from the top left, and in 3D `samples` samples in each. Vertices are balls and, after them, what
follows balls, in 3D in units of the scene's size about its centre. Colours are linear, from 0 to 1.
"""

from typing import Any, Protocol

Field = Any  # of Taichi: read and written by index


class Vertex(Protocol):
    """(vertices) vector of four numbers, the last one a radius, 0 where none is drawn."""

    xyz: Any  # place


class Visibility(Protocol):
    """(slots) what lies nearest at each sample of a picture, or texel of a shadow map."""

    wide: bool  # whether the device has 64-bit integers; else the two columns below, by two stages
    depth_only: bool  # no identity, hence one stage: a shadow map
    marked: Field  # (tiles) whether anything may be seen there
    thin: Field  # (tiles) of a shadow map: whether anything there is too thin for the distance of taps
    key: Field  # (slots) 64-bit (closeness << 32) | identity
    bits: Field  # (slots) of the closeness
    identity: Field  # (slots) kind << 28 | index, 0 for nothing
    stage: Field  # (1) 0: the closeness is looked for; 1: the identity


class Surfaces(Protocol):
    """What there is in a 3D scene to be shaded, and what light it gets."""

    has_spheres: bool  # whether any vertex has a radius
    has_rods: bool  # whether there are rods
    has_triangles: bool  # whether there are triangles
    has_shadow: bool  # whether the lamp casts shadows
    has_occlusion: bool  # whether pixels see only a share of the sky
    transparent: bool  # whether background and ground stay clear
    samples: int  # in a pixel
    stage: Any  # lights and ground, see render/stages.py: constants of the kernels
    ball: Vertex  # (vertices)
    colour: Field  # (vertices) vector
    normal: Field  # (normals) unit vector
    corner: Field  # (triangles) vector of three vertices
    normal_of: Field  # (triangles) vector of the normals at them
    part: Field  # (triangles) number of the smooth part of a surface that each is of
    style_of: Field  # (triangles) number of its style
    style: Field  # (styles) vector of 8 numbers, see render/styles.py
    is_patterned: bool  # whether any of them has a pattern
    place: Field  # (3 triangles) vector: where each corner lies in its pattern, of which 0 to 1 is a period
    texel: Field  # (texels) vector, colours of textures, row after row from the top, each followed by its smaller sizes
    rod: Field  # (rods) vector of two vertices
    rod_radius: Field  # (rods)
    rod_strain: Field  # (rods)
    plane: (
        Field  # (pixels) number of the plane that lies behind, from 1 on; negative where samples differ, 0 for the sky
    )
    backdrop: Field  # (pixels) vector, colour of sky and ground in all light
    backdrop_packed: Field  # (pixels) its bytes
    backdrop_cell: Field  # (pixels) coarse cell of the shadow map that the plane lies in, -1 for none
    backdrop_level: Field  # (pixels) closeness to the lamp of what casts a shadow there
    shadow: Visibility  # (shadow_size^2) the shadow map
    shadow_size: int  # texels along its side
    coarse: Field  # (cells of the shadow map) largest closeness to the lamp near each
    open_raw: Field  # (pixels / 4) share of the sky that is seen, not smoothed yet
    open_depth: Field  # (pixels / 4) closeness there
    openness: Field  # (pixels) the share, smoothed
    thin: Field  # (cells of the shadow map) whether anything near each is too thin for the distance of taps
    lattice_share: (
        Field  # (corners) share of the lamp at every fourth pixel of every fourth row, negative where not known
    )
    lattice_identity: Field  # (corners) what is seen there
    lattice_depth: Field  # (corners) its closeness
    image: Field  # (pixels) vector, colour, where a pixel has one sample
    packed: Field  # (pixels) bytes of the picture


class Shapes(Protocol):
    """What a 2D picture is made of, in px from its top left; at least one of each."""

    shape: Field  # (shapes) vector of 8 numbers, see paint2d
    kind: Field  # (shapes) DISC, ROD or TRIANGLE
    colour: Field  # (shapes) vector
    wall: Field  # (walls) vector (a, b, c): a x + b y + c px above it
    body: Field  # (colliders) vector of 8 numbers, see paint2d
    tint: Field  # (colliders) vector, negative for that of walls
    packed: Field  # (pixels) bytes of the picture
    transparent: bool  # whether background and walls stay clear


class ColourScale(Protocol):
    """(entries, 3) colours for values from 0 to 1."""

    shape: Any  # (entries, 3)


READS = {"ball": Vertex, "seen": Visibility, "shadow": Visibility, "scene": Surfaces, "table": ColourScale}
