"""Stages: the light on a scene, what lies behind it and the ground that it stands on."""

from dataclasses import dataclass

__all__ = ["DAY", "STAGES", "Stage"]

Triple = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Stage:
    """Light is linear, 1 lights white to white. Lamp and fill stand where the first camera is, so many degrees to its right, and
    above the ground."""

    zenith: Triple  # sRGB, above
    horizon: Triple  # sRGB, to which the ground fades
    flat_top: Triple  # sRGB, the same of pictures in 2D
    flat_bottom: Triple
    key: Triple  # light from the lamp
    fill: Triple  # light from the fill, which has no shadow
    sky: Triple  # light from above
    bounce: Triple  # light from below
    lamp_angle: tuple[float, float]  # degrees to the right, and of height
    fill_angle: tuple[float, float]
    glow: Triple  # light above the horizon, below the lamp
    floor: Triple  # colour of the ground, as a part of the horizon's
    checker: float  # difference between its squares, as a part of it
    line: float  # how much its lines differ from it, as a part; above 0 towards white
    pool: float  # how soon its light falls off with the square of the distance from the scene, in its sizes
    fog: float  # how soon it fades, per size of the scene
    gloss: float  # of all surfaces, as a part of their own
    wash: float  # share of the horizon's colour, a little lighter, in that of surfaces
    outline: float  # share of white at outlines and sharp edges


DAY = Stage(
    zenith=(0.56, 0.65, 0.76),
    horizon=(0.905, 0.915, 0.925),
    flat_top=(0.975, 0.975, 0.970),
    flat_bottom=(0.925, 0.935, 0.945),
    key=(2.35, 2.18, 1.92),
    fill=(0.26, 0.30, 0.38),
    sky=(0.50, 0.60, 0.76),
    bounce=(0.34, 0.31, 0.29),
    lamp_angle=(-58.0, 52.0),
    fill_angle=(65.0, 12.0),
    glow=(0.0, 0.0, 0.0),
    floor=(0.775, 0.765, 0.755),
    checker=0.05,
    line=-0.30,
    pool=0.0,
    fog=0.16,
    gloss=1.0,
    wash=0.0,
    outline=0.0,
)
STUDIO = Stage(
    zenith=(0.055, 0.06, 0.07),
    horizon=(0.15, 0.155, 0.17),
    flat_top=(0.13, 0.135, 0.15),
    flat_bottom=(0.10, 0.105, 0.115),
    key=(2.7, 2.5, 2.2),
    fill=(1.3, 1.65, 2.2),
    sky=(0.16, 0.18, 0.22),
    bounce=(0.08, 0.075, 0.07),
    lamp_angle=(-48.0, 50.0),
    fill_angle=(142.0, 28.0),
    glow=(0.0, 0.0, 0.0),
    floor=(2.4, 2.35, 2.3),
    checker=0.0,
    line=0.0,
    pool=0.9,
    fog=0.10,
    gloss=1.6,
    wash=0.0,
    outline=0.0,
)
BLUEPRINT = Stage(
    zenith=(0.06, 0.23, 0.46),
    horizon=(0.08, 0.28, 0.53),
    flat_top=(0.07, 0.25, 0.49),
    flat_bottom=(0.08, 0.28, 0.53),
    key=(0.55, 0.55, 0.55),
    fill=(0.10, 0.10, 0.10),
    sky=(0.72, 0.72, 0.72),
    bounce=(0.50, 0.50, 0.50),
    lamp_angle=(-58.0, 52.0),
    fill_angle=(65.0, 12.0),
    glow=(0.0, 0.0, 0.0),
    floor=(0.85, 0.85, 0.85),
    checker=0.0,
    line=0.45,
    pool=0.0,
    fog=0.16,
    gloss=0.0,
    wash=0.4,
    outline=0.8,
)
PAPER = Stage(
    zenith=(0.66, 0.665, 0.675),
    horizon=(0.86, 0.855, 0.845),
    flat_top=(0.90, 0.895, 0.89),
    flat_bottom=(0.84, 0.835, 0.83),
    key=(2.2, 2.1, 1.95),
    fill=(0.55, 0.58, 0.62),
    sky=(0.50, 0.51, 0.53),
    bounce=(0.42, 0.41, 0.40),
    lamp_angle=(-40.0, 56.0),
    fill_angle=(75.0, 25.0),
    glow=(0.0, 0.0, 0.0),
    floor=(0.84, 0.84, 0.84),
    checker=0.0,
    line=0.0,
    pool=0.05,
    fog=0.30,
    gloss=1.2,
    wash=0.0,
    outline=0.0,
)
DUSK = Stage(
    zenith=(0.30, 0.38, 0.56),
    horizon=(0.80, 0.67, 0.62),
    flat_top=(0.42, 0.42, 0.55),
    flat_bottom=(0.80, 0.64, 0.56),
    key=(3.1, 1.95, 1.10),
    fill=(0.42, 0.46, 0.62),
    sky=(0.40, 0.46, 0.64),
    bounce=(0.30, 0.23, 0.21),
    lamp_angle=(-118.0, 24.0),
    fill_angle=(40.0, 35.0),
    glow=(0.60, 0.28, 0.08),
    floor=(0.36, 0.51, 0.60),
    checker=0.0,
    line=0.0,
    pool=0.03,
    fog=0.18,
    gloss=1.2,
    wash=0.0,
    outline=0.0,
)
STAGES = {"day": DAY, "paper": PAPER, "dusk": DUSK, "studio": STUDIO, "blueprint": BLUEPRINT}
