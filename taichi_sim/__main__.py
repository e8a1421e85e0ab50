"""`python -m taichi_sim`, and where the taichi-sim command starts."""

import os
import signal
import sys
from typing import Any

__all__ = ["main"]

if __name__ == "__main__" and not getattr(sys.flags, "safe_path", False):  # Python 3.10 has none
    del sys.path[0]  # the working folder, which may be that of a scene from elsewhere


def end_at_once(number: int, _: Any) -> None:
    """Answer a signal that comes before there is anything to be left in order."""
    os.write(2, b"taichi-sim: interrupted\n")
    os._exit(128 + number)


def main() -> None:
    """Run the command; whoever interrupts what it loads gets no traceback."""
    for name in ("SIGINT", "SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)
        if number is not None and signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, end_at_once)
    from taichi_sim.common.own_modules import settle_children
    from taichi_sim.common.printable import settle_streams

    settle_streams()
    settle_children()
    try:
        from taichi_sim.cli.main import main as run
    except KeyboardInterrupt:
        print("taichi-sim: interrupted", file=sys.stderr)
        sys.exit(130)
    run()


if __name__ == "__main__":
    main()
