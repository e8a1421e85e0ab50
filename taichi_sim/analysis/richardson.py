"""Richardson's extrapolation: the error of a result, from how far it lies from that with half the step or spacing."""

__all__ = ["error_from"]


def error_from(difference: float, order: float) -> float:
    """Error of the coarser of two results that differ by `difference`, in its unit.

    Where the error is C h^p, the results at h and h/2 differ by (1 - 2^-p) of it. order: p, above 0.
    """
    return difference * 2.0**order / (2.0**order - 1.0)
