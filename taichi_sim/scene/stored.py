"""The part of a scene that goes to files and comes back, judged as what is added by hand is."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.common import validation
from taichi_sim.common.errors import SceneError, about
from taichi_sim.scene.collision_groups import Groups
from taichi_sim.scene.embedded_surfaces import surfaces_from, surfaces_to
from taichi_sim.scene.materials import Wall

__all__ = ["MOST_BODY", "Stored"]

INT32 = -(2**31), 2**31 - 1
MOST_BODY = INT32[1]
UNIT = 1e-12  # how far a normal may be from length 1
NEWER = {
    "break_strain": np.inf,
    "collides": False,
    "together": np.int32(-1),
    "hinge": False,
    "crush_modulus": 0.0,
}  # columns that files of older versions may lack


class Stored:
    """The part of a Scene that gives its arrays and plain values, and takes them."""

    def to_arrays(self: Any) -> dict[str, NDArray]:
        """All columns of balls, springs, triangles, cells, bends and embedded surfaces under "balls.mass" and the like: what a
        state file keeps."""
        columns = {f"{name}.{key}": table[key] for name, table in self._tables().items() for key in table.names}
        return columns | surfaces_to(self.embedded_surfaces)

    def from_arrays(self: Any, arrays: Mapping[str, NDArray]) -> None:
        """Add what `to_arrays` gave, judged as what is added by hand is; other names among the arrays do not matter.

        Materials and groups are there already. Raises SceneError that names the array and what is allowed.
        """
        add: dict[str, Any] = {"balls": self._add_columns, "springs": self.add_springs, "triangles": self.add_triangles}
        add.update(cells=self.add_cells, bends=self.add_bending)
        with self.all_or_nothing():
            for name, table in self._tables().items():
                columns = self._columns(name, table.names, arrays)
                if columns is not None:
                    with about(name):
                        add[name](**columns)
            for surface in surfaces_from(arrays):
                self.add_embedded_surface(**surface)

    @staticmethod
    def _columns(name: str, keys: Sequence[str], arrays: Mapping[str, NDArray]) -> dict[str, NDArray] | None:
        """The columns of a table among arrays, all of one length; None where there is none: an older version had fewer."""
        given = {key: arrays[f"{name}.{key}"] for key in keys if f"{name}.{key}" in arrays}
        if not given:
            return None
        first, rows = next(iter(given)), np.shape(next(iter(given.values())))[:1]
        for key in keys:
            if key in given and np.shape(given[key])[:1] != rows:
                says = f"shape {np.shape(given[key])} does not fit; it must have as many rows as {name}.{first}, {rows}"
                raise SceneError(f"{name}.{key}", says=says)
            if key not in given and key not in NEWER:
                raise SceneError(f"{name}.{key}", says=f"is missing; {name}.{first} is there")
        return {key: np.full(rows, new) for key, new in NEWER.items() if key in keys} | given

    def _add_columns(self: Any, **given: NDArray) -> None:
        """Add balls from all their columns."""
        n = len(given["position"])
        columns: dict[str, NDArray] = {
            "position": validation.vectors("balls.position", given["position"], None, self.dim),
            "velocity": validation.vectors("balls.velocity", given["velocity"], n, self.dim),
            "mass": validation.per_item("balls.mass", given["mass"], n, positive=True),
            "radius": validation.per_item("balls.radius", given["radius"], n, positive=True),
            "pinned": validation.flags("balls.pinned", given["pinned"], n),
            "material": validation.indices("balls.material", given["material"], len(self.materials), what="material"),
            "body": validation.indices("balls.body", given["body"], MOST_BODY + 1, what="body"),
            "group": validation.bits("balls.group", given["group"]),
            "mask": validation.bits("balls.mask", given["mask"]),
            "colour": validation.colours("balls.colour", given["colour"]),
        }
        validation.require(
            "balls.velocity",
            columns["velocity"],
            ~columns["pinned"][:, None] | (columns["velocity"] == 0),
            "0, it is pinned",
        )
        self.groups.check_bits("balls", columns["group"], columns["mask"])
        self._balls.append(n, **columns)
        self._bodies = max(self._bodies, int(columns["body"].max(initial=0)))

    def plain(self: Any) -> dict[str, Any]:
        """Materials, groups and walls as plain values, for files."""
        return {
            "materials": [asdict(material) for material in self.materials],
            "groups": list(self.groups.names),
            "walls": [asdict(wall) for wall in self.walls],
        }

    def set_plain(self: Any, given: Mapping[str, Any]) -> None:
        """Take materials, groups and walls as `plain` gave them in place of those there are. Raises SceneError that names what
        is wrong, and what is allowed."""
        materials, walls = (validation.tables(given, name) for name in ("materials", "walls"))
        names = given.get("groups")
        if not isinstance(names, (list, tuple)) or not names or len(set(map(str, names))) < len(names):
            raise SceneError("groups", names, "a list of different names")
        self.groups = Groups(())
        self.groups.bits("groups", names)
        self.materials[:] = self.materials[:1]
        self.walls.clear()
        for k, table in enumerate(materials):
            with about(f"materials[{k}]"):
                validation.call("materials", self.add_material, table)
        if [material.name for material in self.materials] != [table["name"] for table in materials]:
            raise SceneError("materials", says="must begin with the one called 'default'")
        for k, table in enumerate(walls):
            with about(f"walls[{k}]"):
                validation.call("walls", self._add_bits, table)

    def _add_bits(self: Any, normal: Any, offset: Any, material: Any, group: Any, mask: Any) -> None:
        """Add a wall as `Wall` says it."""
        n = validation.direction("walls.normal", normal, self.dim)
        if abs(float(np.linalg.norm(n)) - 1.0) > UNIT:
            raise SceneError("walls.normal", normal, "a vector of length 1")
        number = validation.whole("walls.material", material, 0, len(self.materials) - 1)
        bits = [validation.whole(f"walls.{key}", one, *INT32) for key, one in (("group", group), ("mask", mask))]
        self.groups.check_bits("walls", *bits)
        self.walls.append(Wall(tuple(n.tolist()), validation.number("walls.offset", offset), number, *bits))
