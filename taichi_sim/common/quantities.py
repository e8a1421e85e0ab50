"""Numbers in words, in one form everywhere: value +- uncertainty, unit, and the source of the uncertainty."""

import math
from collections.abc import Sequence

__all__ = ["EXACT", "ROUNDED", "at_most", "counted", "measured", "measures", "percent", "plain_number"]

EXACT = 1e-12  # of a value: an uncertainty below that is rounding
ROUNDED = "exact to rounding"
PREFIXES = {-9: "n", -6: "µ", -3: "m", 0: "", 3: "k", 6: "M", 9: "G"}
PREFIXED = ("m", "m/s", "N", "N s", "N/m", "J", "Pa", "s", "W")  # units that take a prefix


def measured(value: float, uncertainty: float | None = None, unit: str = "", source: str = "") -> str:
    """A value with its uncertainty: `15.60 +- 0.09 kN (step)`; without one (None) three digits: `15.6 kN`."""
    words = measures([value], [uncertainty], unit)[0]
    return f"{words} ({source})" if source and not words.endswith(ROUNDED) else words


def measures(values: Sequence[float], uncertainties: Sequence[float | None], unit: str = "") -> list[str]:
    """Several values of one quantity with the same prefix, that of the largest."""
    known = [abs(value) for value in values if math.isfinite(value)]
    largest = max(known, default=math.inf) or max([one for one in uncertainties if one], default=0.0)
    power = _power(largest, unit)
    return [
        _one(value / 10.0**power, _scaled(u, power), f"{PREFIXES[power]}{unit}")
        for value, u in zip(values, uncertainties)
    ]


def counted(number: int, one: str, many: str) -> str:
    """A number and the words that follow it: those for one, or those for several or none."""
    return f"{number} {one if number == 1 else many}"


def at_most(value: float) -> str:
    """A positive number of two digits, rounded down, for advice that must hold as it is printed."""
    if not 0.0 < value < math.inf:
        return f"{value:g}"
    unit = 10.0 ** (math.floor(math.log10(value) + 1e-12) - 1)
    return f"{math.floor(value / unit * (1.0 + 1e-9)) * unit:.2g}"


def percent(part: float) -> str:
    """A part as a percentage of two digits."""
    return f"{plain_number(100.0 * part, 2)} %"


def plain_number(value: float, digits: int = 3) -> str:
    """A number of so many significant digits, without an exponent from 1e-4 to 1e5."""
    if not math.isfinite(value) or value == 0.0:
        return f"{value:g}"
    places = digits - 1 - math.floor(math.log10(abs(value)) + 1e-12)
    if not 1e-4 <= abs(value) < 1e5:
        return f"{value:.{digits - 1}e}"
    return f"{round(value, places):.{max(0, places)}f}"


def _scaled(uncertainty: float | None, power: int) -> float | None:
    return None if uncertainty is None else uncertainty / 10.0**power


def _power(value: float, unit: str) -> int:
    """Power of ten of the prefix that brings a value between 1 and 1000."""
    if unit not in PREFIXED or not 0.0 < value < math.inf:
        return 0
    return min(max(3 * math.floor(math.log10(value) / 3.0 + 1e-12), min(PREFIXES)), max(PREFIXES))


def _one(value: float, uncertainty: float | None, unit: str) -> str:
    shown = f" {unit}".rstrip()
    if uncertainty is None or math.isnan(uncertainty) or not math.isfinite(value):
        return f"{plain_number(value)}{shown}"
    if uncertainty <= EXACT * abs(value):
        return f"{value:.6g}{shown}, {ROUNDED}"
    if not math.isfinite(uncertainty):
        return f"{plain_number(value)}{shown}, uncertainty without bound"
    digits = 2 if f"{uncertainty:.0e}"[0] == "1" else 1
    places = digits - 1 - math.floor(math.log10(uncertainty) + 1e-12)
    if abs(value) >= 1e6 or max(abs(value), uncertainty) < 1e-4:  # in powers of ten
        exponent = math.floor(math.log10(max(abs(value), uncertainty)))
        scale, places = 10.0**exponent, max(0, places + exponent)
        return f"({value / scale:.{places}f} +- {uncertainty / scale:.{places}f})e{exponent:+03d}{shown}"
    return f"{round(value, places) + 0.0:.{max(0, places)}f} +- {round(uncertainty, places):.{max(0, places)}f}{shown}"
