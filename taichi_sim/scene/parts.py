"""PARTS: the kinds of thing that a scene holds. The schema, the reader and the writer of scene files, state files, digests,
copies of scenes and what is said of them are loops over these."""

from collections.abc import Callable, Mapping
from dataclasses import asdict
from typing import Any, ClassVar

from taichi_sim.scene.colliders import shape_of
from taichi_sim.scene.elements import ELEMENTS
from taichi_sim.scene.part import Columns, Listed, Part, Row, group_keys

__all__ = ["LISTS", "PARTS"]


class _Materials(Listed):
    name, method, has_file, is_simulated = "materials", "add_material", False, False

    def row(self, scene: Any, one: Any) -> Row:
        return {key: value for key, value in asdict(one).items() if value is not None}


class _Balls(Columns):
    name, method = "balls", "add_balls"

    def restorer(self, scene: Any) -> Callable[..., Any]:
        return scene._add_ball_columns  # type: ignore[no-any-return]


class _Springs(Columns):
    name, method, counted = "springs", "add_springs", ("pairs",)
    assumed: ClassVar = {"break_strain": float("inf")}


class _Attachments(Part):
    """Springs, which the scene holds as such."""

    name, method, has_file = "attachments", "attach", False
    chosen: ClassVar = {"one": "one_members", "other": "other_members"}


class _MovingPins(Listed):
    name, method, chosen = "moving_pins", "add_moving_pins", {"balls": "members"}

    def row(self, scene: Any, one: Any) -> Row:
        return {"balls": one.balls, **one.given}


class _Motors(Listed):
    name, method, chosen = "motors", "add_motor", {"balls": "members"}

    def row(self, scene: Any, one: Any) -> Row:
        return {"springs": one.springs, **({"phase": one.phase} if one.phase.any() else {}), **one.given}


class _Walls(Listed):
    name, method, has_file = "walls", "add_wall", False

    def row(self, scene: Any, one: Any) -> Row:
        own = {"normal": one.normal, "offset": one.offset, "material": scene.materials[one.material].name}
        return own | group_keys(scene, one.group, one.mask)


class _Colliders(Listed):
    """Those of the user's own as they are drawn, which no shape that can be added is: see `Collider.saved`."""

    name, method = "colliders", "add_collider"

    def row(self, scene: Any, one: Any) -> Row:
        return one.given | ({"vertices": one.vertices, "triangles": one.triangles} if one.is_meshed else {})

    def add(self, scene: Any, row: Mapping[str, Any]) -> Any:
        return scene.add_collider(shape_of(row))

    def restorer(self, scene: Any) -> Callable[..., Any]:
        return lambda **row: self.add(scene, row)


class _Triangles(Columns):
    name, method, counted = "triangles", "add_triangles", ("triangles",)


class _Objects(Listed):
    name, method, is_simulated = "objects", "set_name", False

    def row(self, scene: Any, one: Any) -> Row:
        return {"name": one.name, "balls": one.balls} | ({} if one.uv is None else {"uv": one.uv})


class _EmbeddedSurfaces(Listed):
    name, method, counted = "embedded_surfaces", "add_embedded_surface", ("corners", "covers")
    is_simulated = False

    def row(self, scene: Any, one: Any) -> Row:
        own = {key: getattr(one, key) for key in ("corners", "weights", "triangles", "colour")}
        own |= {"covers": one.covers} if len(one.covers) else {}
        return {key: value for key, value in own.items() if value is not None}


class _Probes(Listed):
    name, method, chosen = "probes", "add_probe", {"balls": "members"}

    def row(self, scene: Any, one: Any) -> Row:
        return {"name": one.name, "kind": one.kind, **one.given}


# in the order in which a file's tables are added; shapes come after the balls
PARTS: tuple[Part, ...] = (
    _Materials(),
    _Balls(),
    _Springs(),
    _Attachments(),
    *ELEMENTS,
    _MovingPins(),
    _Motors(),
    _Walls(),
    _Colliders(),
    _Triangles(),
    _Objects(),
    _EmbeddedSurfaces(),
    _Probes(),
)
LISTS = tuple(part.name for part in PARTS if isinstance(part, Listed))
