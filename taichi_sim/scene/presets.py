"""Materials that are known by name: how they touch, and what cloth and jelly of them is like, with where the numbers come from.

    ts.shapes.cloth(scene, material="cotton", pinned="corners")

A name that a scene has given to a material of its own means that one. KES is Kawabata's evaluation system for fabrics.
"""

import math
from dataclasses import dataclass

from taichi_sim.scene.materials import Material

__all__ = ["PRESETS", "SLAB", "UNITS", "Preset"]

SLAB = 0.1  # m, the thickness that bodies in 2D stand for
SHEET = 1e-3  # m, a sheet of rubber
GRAM = 9.80665e-3  # N, weight of a gram
KES_BENDING = GRAM * 1e-2  # N m in gf cm^2/cm
KES_SHEAR = GRAM / (1e-2 * math.radians(1.0))  # N/m in gf/(cm degree)
KES_WEIGHT = 1e-2  # kg/m^2 in mg/cm^2

UNITS = {  # others are plain numbers
    "mass_per_area": "kg/m^2",
    "stretch_stiffness": "N/m",
    "shear_stiffness": "N/m",
    "bending_rigidity": "N m",
    "bending_weft": "N m",
    "warp": "N/m",
    "weft": "N/m",
    "shear": "N/m",
    "coupling": "N/m",
    "density": "kg/m^3",
    "young_modulus": "Pa",
}


@dataclass(frozen=True, slots=True)
class Preset:
    """A material of that name. Cloth of it has a mass per area, stretch and shear stiffness of springs, bending rigidity along
    warp and weft, and the threads of triangles; bodies have a density, and as jelly a Young's modulus and Poisson's ratio, in
    UNITS. None: not known.
    """

    source: str
    restitution: float
    friction: float
    mass_per_area: float | None = None
    stretch_stiffness: float | None = None
    shear_stiffness: float | None = None
    bending_rigidity: float | None = None
    bending_weft: float | None = None
    warp: float | None = None
    weft: float | None = None
    shear: float | None = None
    coupling: float | None = None
    density: float | None = None
    young_modulus: float | None = None
    poisson_ratio: float | None = None

    def material(self, name: str) -> Material:
        """Surface material, named `name`, of balls and walls made of it."""
        return Material(name, self.restitution, self.friction)


def _sheet(modulus: float, ratio: float, density: float, thickness: float) -> dict[str, float]:
    """A plate of an elastic solid, as cloth."""
    plane = modulus * thickness / (1 - ratio**2)
    return {
        "mass_per_area": density * thickness,
        "stretch_stiffness": plane,
        "shear_stiffness": modulus * thickness / (2 * (1 + ratio)),
        "bending_rigidity": plane * thickness**2 / 12,
    }


_WANG = "Wang, O'Brien, Ramamoorthi 2011, Data-driven elastic models for cloth"
# Beside these, what Kawabata's tests give of shirts to denim: about 0.05 to 0.5 gf cm^2/cm in bending (1 is 9.8e-5 N m), and 3 to
# 10 % of stretch at 500 gf/cm (490 N/m)
_UNSURE = (
    "unstretched, the stiffer direction taken as the warp; springs have the mean; stiffness uncertain by up to a factor of ten:"
    " tests at larger strains (Kawabata 1980) give more stretch stiffness and less bending rigidity"
)
_MATSUDAIRA = "Matsudaira, Masuda, Wada, Yokura 2015, J. Textile Eng. 61, 69-73"
_THREADS = {"warp": 2000.0, "weft": 2000.0}  # N/m
_ESTIMATED = (
    "threads estimated: below the secant of what Kawabata's tests give shirts and suits, 3 to 10 % at 490 N/m, as fabrics are"
    " softer unstretched; springs are softer still, for longer steps; shear estimated"
)
_TOUCH = "friction within the 0.2 to 0.6 of Gupta 2008, Friction in textile materials; restitution assumed"
_ASHBY = "density and moduli: Ashby 2011, Materials selection in mechanical design"
RUBBER = {"modulus": 2e6, "ratio": 0.49, "density": 925.0}  # Pa, 1, kg/m^3

PRESETS: dict[str, Preset] = {
    "cotton": Preset(
        f"{_MATSUDAIRA}, a broadcloth: weight and mean bending rigidity (KES), without the friction of its threads, with which it"
        f" drapes as if that rigidity were 2.4 times as large; {_ESTIMATED}; {_TOUCH}",
        *(0.0, 0.4, 12.38 * KES_WEIGHT, 200.0, 30.0, 0.118 * KES_BENDING),
        **_THREADS,
        shear=KES_SHEAR,
    ),
    "denim": Preset(
        f"{_WANG}, a denim of 11 oz with 1 % of spandex, {_UNSURE}; {_TOUCH}",
        *(0.0, 0.5, 0.324, 610.0, 53.0, 9.70e-5, 6.42e-5),
        *(1013.9, 205.4, 53.4, 10.2),
    ),
    "polyester": Preset(
        f"{_WANG}, a fabric of polyester for jackets, {_UNSURE}; {_TOUCH}",
        *(0.0, 0.3, 0.113, 107.0, 14.0, 2.03e-5, 1.43e-5),
        *(171.4, 43.1, 14.3, 54.4),
    ),
    "knit": Preset(
        f"{_WANG}, a double knit (ponte) of polyester and rayon, {_UNSURE}; its measured coupling, below 0, is taken as 0,"
        f" and its springs have less shear, so that oblong squares can have it; {_TOUCH}",
        *(0.0, 0.4, 0.284, 38.0, 19.0, 3.72e-5, 3.63e-5),
        *(44.0, 31.1, 31.9, 0.0),
    ),
    "wool": Preset(
        f"{_MATSUDAIRA}, a tropical of wool: weight and mean bending rigidity (KES); {_ESTIMATED}; {_TOUCH}",
        *(0.0, 0.4, 16.29 * KES_WEIGHT, 200.0, 30.0, 0.067 * KES_BENDING),
        **_THREADS,
        shear=KES_SHEAR,
    ),
    "silk": Preset(
        "a habotai of 16 momme of 4.34 g/m^2; bending rigidity in the order of the charts for thin dress fabrics in Kawabata"
        f" 1980, The standardization and analysis of hand evaluation; {_ESTIMATED}; {_TOUCH}",
        *(0.0, 0.25, 0.069, 100.0, 17.0, 4e-6),
        **_THREADS,
        shear=0.3 * KES_SHEAR,
    ),
    "rubber": Preset(
        f"{_ASHBY}, natural rubber; cloth of it is a sheet of 1 mm; friction and restitution assumed, as of a ball on concrete",
        *(0.7, 0.9),
        **_sheet(**RUBBER, thickness=SHEET),
        density=RUBBER["density"],
        young_modulus=RUBBER["modulus"],
        poisson_ratio=RUBBER["ratio"],
    ),
    "gelatine": Preset(
        "modulus: Bonavia 2025, arXiv:2512.20502, its power law at 10 parts of water; density and ratio nearly those of water;"
        " friction and restitution assumed",
        *(0.1, 0.2),
        density=1020.0,
        young_modulus=15e3,
        poisson_ratio=0.49,
    ),
    "foam": Preset(
        f"{_ASHBY}, flexible polymer foam of very low density; friction and restitution assumed",
        *(0.2, 0.6),
        density=25.0,
        young_modulus=5e5,
        poisson_ratio=0.3,
    ),
    "wood": Preset(
        f"{_ASHBY}, pine along the grain; friction: dry wood on wood in common tables; restitution assumed",
        *(0.4, 0.4),
        density=520.0,
        young_modulus=9.4e9,
        poisson_ratio=0.3,
    ),
    "steel": Preset(
        f"{_ASHBY}, carbon steel; friction and restitution of small balls: Lorenz, Tuozzolo, Louge 1997, Measurements of impact"
        " properties of small, nearly spherical particles",
        *(0.95, 0.1),
        density=7850.0,
        young_modulus=2.1e11,
        poisson_ratio=0.29,
    ),
    "glass": Preset(
        "friction and restitution of beads of 3 mm: Foerster, Louge, Chang, Allia 1994, Measurements of the collision properties"
        f" of small spheres; {_ASHBY}, soda-lime glass",
        *(0.97, 0.092),
        density=2500.0,
        young_modulus=7e10,
        poisson_ratio=0.22,
    ),
    "sand": Preset(
        "density of quartz; friction between grains of 26 degrees: Rowe 1962, The stress-dilatancy relation; restitution"
        " assumed, low for grains that are no balls",
        *(0.1, 0.49),
        density=2650.0,
    ),
}
