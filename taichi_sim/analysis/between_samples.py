"""Extremes between samples: how far a quantity may go beyond the largest or least value that was sampled."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

__all__ = ["beyond"]

PART = 0.25  # of the change from an extreme to a neighbour: 1/8 of a parabola, 0.21 of a wave of four samples


def beyond(values: Sequence[float] | NDArray[np.float64], at: int) -> float:
    """Bound of how far a quantity goes beyond its extreme sample number `at`, in its unit. values: (n,) at even times, those that
    are nan left out.

    A curve with at least four samples in its fastest period keeps to it; jumps need not. At the first and the last sample the
    parabola through it and its two neighbours tells: a motion that starts there from rest goes no further.
    """
    known = np.flatnonzero(~np.isnan(values))
    found, at = np.asarray(values, dtype=np.float64)[known], int(np.searchsorted(known, at))
    changes = np.abs(np.diff(found))
    if 0 < at < len(changes):
        return PART * float(changes[at - 1 : at + 1].max())
    if len(changes) < 2:
        return 0.0
    first, second = (changes if at == 0 else changes[::-1])[:2]
    return PART * float((second - 3.0 * first) ** 2 / (second - first)) if second > 3.0 * first else 0.0
