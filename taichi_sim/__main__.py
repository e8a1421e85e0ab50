"""`python -m taichi_sim`, and where the taichi-sim command starts."""

import os
import sys

from taichi_sim.common.printable import settle_streams

__all__ = ["main"]


def main() -> None:
    """Run the command; whoever interrupts what it loads gets no traceback."""
    settle_streams()
    # processes that this one starts take no modules from the working folder, which may be that of a scene from elsewhere
    os.environ.setdefault("PYTHONSAFEPATH", "1")
    try:
        from taichi_sim.cli.main import main as run
    except KeyboardInterrupt:
        print("taichi-sim: interrupted", file=sys.stderr)
        sys.exit(130)
    run()


if __name__ == "__main__":
    main()
