"""Numbers in words, in one form everywhere: value +- uncertainty, unit, and the source of the uncertainty."""

import math

__all__ = ["EXACT", "ROUNDED", "at_most", "counted", "measured", "percent", "plain_number"]

EXACT = 1e-12  # of a value: an uncertainty below that is rounding
ROUNDED = "exact to rounding"
PREFIXES = {-9: "n", -6: "µ", -3: "m", 0: "", 3: "k", 6: "M", 9: "G"}
PREFIXED = ("m", "m/s", "N", "N s", "N/m", "J", "Pa", "s", "W")  # units that take a prefix


def measured(value: float, uncertainty: float | None = None, unit: str = "", source: str = "") -> str:
    """A value with its uncertainty: `15.60 +- 0.09 kN (step)`; without one (None) three digits: `15.6 kN`. The prefix of the
    unit brings the larger of the two to 1 to 999."""
    known = uncertainty is not None and math.isfinite(uncertainty)
    largest = max(abs(value), uncertainty or 0.0) if known else float(f"{abs(value):.3g}")
    power = _power(largest, unit)
    scaled = None if uncertainty is None else uncertainty / 10.0**power
    words = _one(value / 10.0**power, scaled, f"{PREFIXES[power]}{unit}")
    return f"{words} ({source})" if source and not words.endswith(ROUNDED) else words


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
    rounded = float(short := f"{value:.{digits - 1}e}")  # 0.9997 to three digits is 1.00
    if not 1e-4 <= abs(rounded) < 1e5:
        return short
    return f"{rounded:.{max(0, digits - 1 - math.floor(math.log10(abs(rounded)) + 1e-12))}f}"


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
