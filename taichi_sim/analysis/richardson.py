"""Richardson's extrapolation: the error of a result, from how far it lies from that with half the step or spacing."""

from math import log2, nan

import numpy as np
from numpy.typing import NDArray

__all__ = ["LEAST_RATIO", "error_from", "error_of_events", "error_of_three", "rms"]

SAFETY = 1.25  # of an error told by three results (Roache, Verification and Validation in Computational Science, 1998)
EVENTS = 3.0  # times the largest error that differences show: the factor of safety where no order is seen (Roache 1998)
LEAST_RATIO = 1.25  # of differences at successive halvings, below which no order is seen


def rms(values: NDArray[np.float64]) -> float:
    """Root of the mean square; 0 of nothing."""
    return float(np.sqrt(np.mean(values**2))) if values.size else 0.0


def error_from(difference: float, order: float) -> float:
    """Error of the coarser of two results that differ by `difference`, in its unit.

    Where the error is C h^p, the results at h and h/2 differ by (1 - 2^-p) of it. order: p, above 0.
    """
    return difference * 2.0**order / (2.0**order - 1.0)


def error_of_three(first: float, second: float, order: float, ratio: float) -> float:
    """Error of the coarsest of three results that differ by `first`, then by `second`, in their unit; nan where no order shows.

    ratio: of such differences over the whole run, 2^p where they fall with the power p. The lower p of the run's, the result's
    own and `order` is taken for the order. The larger of the two differences counts, each as p tells it, for one may vanish by
    luck. Roache's factor of safety is included.
    """
    if not ratio >= LEAST_RATIO:
        return nan
    if 0.0 < LEAST_RATIO * second <= first <= ratio * second:
        ratio = first / second
    seen = min(order, log2(ratio))
    return SAFETY * error_from(max(first, second * 2.0**seen), seen)


def error_of_events(first: float, second: float) -> float:
    """Error of the coarsest of three results that differ by `first`, then by `second`, in their unit, where events fall somewhere
    within a step: each result is off by some part of its own step, so that the differences show no order.

    The second difference counts twice, as it is of steps half as long.
    """
    return EVENTS * max(first, 2.0 * second)
