"""Warp, started quietly, for the peers that use it."""

from taichi_sim.reports.peers import PeerMissingError

try:
    import warp as wp
except ImportError:
    raise PeerMissingError("Warp is not installed (pip install warp-lang)") from None

__all__ = ["version", "wp"]

if hasattr(wp, "LOG_ERROR"):
    wp.config.log_level = wp.LOG_ERROR
else:
    setattr(wp.config, "quiet", True)  # noqa: B010  (older versions)
wp.init()


def version() -> str:
    """Warp's version."""
    return str(wp.config.version)
