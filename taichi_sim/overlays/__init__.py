"""Text, curves and marks over pictures, drawn with Pillow. `open_renderer` gives a renderer whose pictures have them."""

from taichi_sim.overlays.overlaid import Overlaid, open_renderer

__all__ = ["Overlaid", "open_renderer"]
