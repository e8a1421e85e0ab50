"""Packages of the wheel, found: those of taichi_sim, and what lies beside it and is imported from it: kernels, demos, course."""

from setuptools import find_packages, setup

beside = find_packages(include=["kernels*", "demos*"])
setup(
    packages=[*find_packages(include=["taichi_sim*"]), *(f"taichi_sim.{name}" for name in beside), "taichi_sim.course"]
)
