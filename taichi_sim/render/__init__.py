"""Offscreen pictures of frames."""

from taichi_sim.render.camera import Camera, Flat
from taichi_sim.render.renderer import Renderer
from taichi_sim.scene.camera_path import CameraPath

__all__ = ["Camera", "CameraPath", "Flat", "Renderer"]
