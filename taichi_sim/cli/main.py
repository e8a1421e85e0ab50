"""The taichi-sim command. It imports nothing heavy before it knows what to do."""

# isort: off
# --help lists commands in this order
from taichi_sim.cli import running
from taichi_sim.cli import judging
from taichi_sim.cli import studies
from taichi_sim.cli import installation
from taichi_sim.cli import listing
from taichi_sim.cli.command import main

__all__ = ["installation", "judging", "listing", "main", "running", "studies"]

if __name__ == "__main__":
    main()
