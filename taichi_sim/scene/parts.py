"""Parts: the kinds of thing that a scene holds, each declared once.

A part is a table of scene files, whose keys are the arguments of the method of Scene that adds it. The schema, the reader and the
writer of scene files, state files, digests and copies of scenes are loops over PARTS."""

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from taichi_sim.scene.colliders import shape_of
from taichi_sim.scene.collision_groups import EVERY, ONLY

__all__ = ["LISTS", "PARTS", "Part", "group_keys"]

Row = dict[str, Any]  # arguments of a method of Scene, arrays or plain values


def _none(_: Any) -> list[Row]:
    return []


@dataclass(frozen=True, slots=True)
class Part:
    """One kind of thing that a scene holds."""

    name: str  # of its table in a file
    method: str  # of Scene, which adds it; its signature and docstring are the schema of the table
    rows: Callable[[Any], list[Row]] = _none  # of a scene: what adds the same again
    add: Callable[..., Any] | None = None  # takes a table of a file, where the method takes something else
    restore: Callable[..., Any] | None = None  # takes a row, where the method takes something else
    needed: tuple[
        str, ...
    ] = ()  # arguments without a default, which may lie in the .npz that a table names as its `file`
    has_file: bool = True  # whether it may name one
    counted: tuple[str, ...] = ()  # arguments that number balls within those that a table names as `balls`
    chosen: Mapping[str, str] = field(
        default_factory=dict
    )  # arguments that are balls: the name of a group, and the key of
    # those of its members that are meant
    is_table: bool = (
        False  # whether its rows are columns of a table of the scene, so that there is one row of arrays at most
    )
    is_single: bool = False  # whether a scene has one at most
    in_list: bool = False  # whether the scene has a list of that name
    is_simulated: bool = True  # whether a simulation depends on it by itself
    title: str = ""  # in words, in the plural

    def adder(self, scene: Any) -> Callable[..., Any]:
        """Adds what the keys of a table of a file say."""
        if self.add is None:
            return getattr(scene, self.method)  # type: ignore[no-any-return]
        return lambda **row: self.add(scene, **row)  # type: ignore[misc]

    def restorer(self, scene: Any) -> Callable[..., Any]:
        """Adds what a row says."""
        return self.adder(scene) if self.restore is None else self.restore(scene)  # type: ignore[no-any-return]

    def count(self, scene: Any) -> int:
        """How many of them a scene has."""
        if self.is_table:
            return int(scene.tables[self.name].rows)
        return len(getattr(scene, self.name)) if self.in_list else len(self.rows(scene))

    @property
    def is_one(self) -> bool:
        """Whether a scene has one row of it at most."""
        return self.is_table or self.is_single


def _columns(name: str, **assumed: float) -> Callable[[Any], list[Row]]:
    """Rows of what is in a table of the scene: one, of all columns but those that have everywhere what a method assumes."""

    def rows(scene: Any) -> list[Row]:
        table = scene.tables[name]
        columns = {key: table[key] for key in table.names}
        row = {key: column for key, column in columns.items() if np.any(column != assumed.get(key, np.nan))}
        return [row] if table.rows else []

    return rows


def group_keys(scene: Any, group: int, mask: int) -> Row:
    """The arguments for collision groups, where they are not the default."""
    keys: Row = {} if group == ONLY else {"group": scene.groups.listed(group)}
    return keys if mask == EVERY else keys | {"collides_with": scene.groups.listed(mask)}


def _walls(scene: Any) -> list[Row]:
    return [
        {"normal": wall.normal, "offset": wall.offset, "material": scene.materials[wall.material].name}
        | group_keys(scene, wall.group, wall.mask)
        for wall in scene.walls
    ]


def _colliders(scene: Any) -> list[Row]:
    """Those of the user's own as they are drawn, which no shape that can be added is: see `Collider.saved`."""
    rows = []
    for collider in scene.colliders:
        plain = {key: value for key, value in collider.given.items() if key != "mesh"}
        mesh = {"vertices": collider.vertices, "triangles": collider.triangles} if collider.is_meshed else {}
        rows.append(plain | mesh)
    return rows


def _surfaces(scene: Any) -> list[Row]:
    rows = []
    for one in scene.embedded_surfaces:
        row = {"corners": one.corners, "weights": one.weights, "triangles": one.triangles}
        row |= {"covers": one.covers} if len(one.covers) else {}
        rows.append(row if one.colour is None else row | {"colour": one.colour})
    return rows


def _gases(scene: Any) -> list[Row]:
    return [{key: getattr(gas, key) for key in ("triangles", "pressure", "outside", "volume")} for gas in scene.gases]


def _motors(scene: Any) -> list[Row]:
    return [
        {"springs": motor.springs, **({"phase": motor.phase} if motor.phase.any() else {}), **motor.given}
        for motor in scene.motors
    ]


def _objects(scene: Any) -> list[Row]:
    return [{"name": o.name, "balls": o.balls} | ({} if o.uv is None else {"uv": o.uv}) for o in scene.objects]


# in the order in which a file's tables are added; shapes come after the balls
PARTS: tuple[Part, ...] = (
    Part(
        "materials",
        "add_material",
        lambda scene: [{k: v for k, v in asdict(one).items() if v is not None} for one in scene.materials],
        has_file=False,
        in_list=True,
        is_simulated=False,
    ),
    Part(
        "balls",
        "add_balls",
        _columns("balls"),
        restore=lambda scene: scene._add_ball_columns,
        needed=("position", "radius"),
        is_table=True,
    ),
    Part(
        "springs",
        "add_springs",
        _columns("springs", break_strain=np.inf),
        needed=("pairs", "stiffness"),
        counted=("pairs",),
        is_table=True,
    ),
    Part(
        "attachments",
        "attach",
        has_file=False,
        chosen={"one": "one_members", "other": "other_members"},
    ),
    Part(
        "cells",
        "add_cells",
        _columns("cells", together=-1),
        needed=("corners", "bulk_modulus"),
        counted=("corners",),
        is_table=True,
    ),
    Part(
        "bending",
        "add_bending",
        _columns("bending"),
        needed=("corners", "weights", "stiffness"),
        counted=("corners",),
        is_table=True,
        title="bends",
    ),
    Part(
        "gases",
        "add_gas",
        _gases,
        needed=("triangles",),
        counted=("triangles",),
        in_list=True,
    ),
    Part(
        "moving_pins",
        "add_moving_pins",
        lambda scene: [{"balls": pins.balls, **pins.given} for pins in scene.moving_pins],
        needed=("balls",),
        chosen={"balls": "members"},
        in_list=True,
    ),
    Part("motors", "add_motor", _motors, chosen={"balls": "members"}, in_list=True),
    Part(
        "wind",
        "add_wind",
        lambda scene: [] if scene.wind is None else [asdict(scene.wind)],
        has_file=False,
        is_single=True,
    ),
    Part("walls", "add_wall", _walls, has_file=False, in_list=True),
    Part(
        "colliders",
        "add_collider",
        _colliders,
        add=lambda scene, **given: scene.add_collider(shape_of(given)),
        in_list=True,
    ),
    Part(
        "triangles",
        "add_triangles",
        _columns("triangles"),
        needed=("triangles",),
        counted=("triangles",),
        is_table=True,
    ),
    Part("objects", "set_name", _objects, needed=("balls",), in_list=True, is_simulated=False),
    Part(
        "embedded_surfaces",
        "add_embedded_surface",
        _surfaces,
        needed=("corners", "weights", "triangles"),
        counted=("corners", "covers"),
        in_list=True,
        is_simulated=False,
    ),
    Part(
        "probes",
        "add_probe",
        lambda scene: [{"name": one.name, "kind": one.kind, **one.given} for one in scene.probes],
        chosen={"balls": "members"},
        in_list=True,
    ),
)
LISTS = tuple(part.name for part in PARTS if part.in_list)
