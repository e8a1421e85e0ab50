"""Warp, started quietly, for the peers that use it."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.benchmark.peers import PeerMissingError

try:
    import warp as wp
except ImportError:
    raise PeerMissingError("Warp is not installed (pip install warp-lang)") from None

if hasattr(wp, "LOG_ERROR"):
    wp.config.log_level = wp.LOG_ERROR
else:
    setattr(wp.config, "quiet", True)  # noqa: B010  (older versions)
wp.init()


def on_cpu(vectors: NDArray) -> Any:
    """An array (n, 3) of Warp's."""
    return wp.array(vectors.astype(np.float32), dtype=wp.vec3, device="cpu")
