"""`python -m taichi_sim`: the taichi-sim command."""

from taichi_sim.cli.main import main

main()
