"""Memory that this process may still take, and that it takes."""

import os
import sys
from pathlib import Path

__all__ = ["available", "used"]

UNKNOWN = 4 << 30  # bytes, where the system does not say
GROUPS = (  # a container's limit and what it uses, in the two ways that Linux has
    ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory.current"),
    ("/sys/fs/cgroup/memory/memory.limit_in_bytes", "/sys/fs/cgroup/memory/memory.usage_in_bytes"),
)


def available() -> int:
    """Bytes that can be taken before the machine swaps, or the container's limit or that of the process is met."""
    free = [_machine(), _process()]
    for limit, used in GROUPS:
        try:
            free.append(int(Path(limit).read_text()) - int(Path(used).read_text()))
        except (OSError, ValueError):  # no such group, or no limit ("max")
            continue
    return max(0, min(free))


def used() -> int:
    """Bytes of memory that this process has; 0 where the system does not say."""
    try:
        return _pages(1)
    except (AttributeError, OSError, ValueError):
        return 0


def _pages(column: int) -> int:
    """Bytes of address space (column 0) or memory (1)."""
    return int(Path("/proc/self/statm").read_text().split()[column]) * os.sysconf("SC_PAGE_SIZE")


def _process() -> int:
    """Bytes of address space that `ulimit -v` leaves."""
    try:
        import resource

        limit = resource.getrlimit(resource.RLIMIT_AS)[0]
        taken = _pages(0)
    except (ImportError, AttributeError, OSError, ValueError):
        return sys.maxsize
    return sys.maxsize if limit == resource.RLIM_INFINITY else limit - taken


def _machine() -> int:
    try:
        for line in Path("/proc/meminfo").read_text().splitlines():
            if line.startswith("MemAvailable:"):
                return int(line.split()[1]) << 10
    except OSError:
        pass
    try:
        return os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, OSError, ValueError):
        return UNKNOWN
