"""The interval in which a mean lies."""

import numpy as np
from numpy.typing import NDArray

__all__ = ["CONFIDENCE", "half_width"]

CONFIDENCE = 0.95


def half_width(values: NDArray[np.float64]) -> float:
    """Half of the interval in which the mean lies, by Student's distribution; nan for fewer than two values."""
    from scipy.stats import t

    n = len(values)
    if n < 2:
        return float("nan")
    return float(t.ppf(0.5 + CONFIDENCE / 2.0, n - 1) * values.std(ddof=1) / np.sqrt(n))
