"""Packages of the wheel, found: those of taichi_sim, and what lies beside it and is imported from it: kernels, demos, course.
The demos of the thread are files that are run, in a folder that is no module."""

from setuptools import find_packages, setup

beside = find_packages(include=["kernels*", "demos*"])
packages = [*find_packages(include=["taichi_sim*"]), *(f"taichi_sim.{name}" for name in beside)]
setup(packages=[*packages, "taichi_sim.demos.thread", "taichi_sim.course"])
