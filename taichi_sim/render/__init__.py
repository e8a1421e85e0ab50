"""Offscreen pictures of frames."""

from taichi_sim.camera_path import CameraPath
from taichi_sim.render.camera import Camera, Flat
from taichi_sim.render.renderer import Renderer

__all__ = ["Camera", "CameraPath", "Flat", "Renderer"]
