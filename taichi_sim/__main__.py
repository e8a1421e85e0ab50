"""`python -m taichi_sim`, and where the taichi-sim command starts."""

import sys

from taichi_sim.common.printable import settle_streams

__all__ = ["main"]


def main() -> None:
    """Run the command; whoever interrupts what it loads gets no traceback."""
    settle_streams()
    try:
        from taichi_sim.cli.main import main as run
    except KeyboardInterrupt:
        print("taichi-sim: interrupted", file=sys.stderr)
        sys.exit(130)
    run()


if __name__ == "__main__":
    main()
