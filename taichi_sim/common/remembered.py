"""Findings of one process that later ones use: small tables in the user's folder of caches."""

import json
from typing import Any

from platformdirs import user_cache_path

from taichi_sim.common.atomic_file import replacing

__all__ = ["recall", "remember"]


def recall(name: str) -> dict[str, Any]:
    """The table of that name; empty where there is none yet, or what lies there is not one."""
    try:
        known = json.loads((user_cache_path("taichi_sim") / f"{name}.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return known if isinstance(known, dict) else {}


def remember(name: str, table: dict[str, Any]) -> None:
    """Write it. A folder that cannot be written costs what could have been known, and nothing else."""
    path = user_cache_path("taichi_sim") / f"{name}.json"
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path) as file:
            file.write(json.dumps(table, indent=1).encode())
    except OSError:
        pass
