"""PARTS: the kinds of thing that a scene holds. The schema, the reader and the writer of scene files, state files, digests,
copies of scenes and what is said of them are loops over these."""

from collections.abc import Callable, Mapping
from typing import Any

from taichi_sim.scene.colliders import shape_of
from taichi_sim.scene.elements import ELEMENTS
from taichi_sim.scene.part import Columns, Listed, Part, Row, group_keys

__all__ = ["LISTS", "PARTS"]


class _Balls(Columns):
    def restorer(self, scene: Any) -> Callable[..., Any]:
        return scene._add_ball_columns  # type: ignore[no-any-return]


class _Walls(Listed):
    def row(self, scene: Any, one: Any) -> Row:
        own = {"normal": one.normal, "offset": one.offset, "material": scene.materials[one.material].name}
        return own | group_keys(scene, one.group, one.mask)


class _Colliders(Listed):
    """Colliders; those of the user's own as they are drawn, which no shape that can be added is: see `Collider.saved`."""

    def row(self, scene: Any, one: Any) -> Row:
        return one.given | ({"vertices": one.vertices, "triangles": one.triangles} if one.is_meshed else {})

    def add(self, scene: Any, row: Mapping[str, Any]) -> Any:
        return scene.add_collider(shape_of(row))

    def restorer(self, scene: Any) -> Callable[..., Any]:
        return lambda **row: self.add(scene, row)


MATERIAL = ("name", "restitution", "friction", "viscous_friction", "colour")
SURFACE = ("corners", "weights", "triangles", "covers", "colour", "uv")
MEMBERS = {"balls": "members"}
# in the order in which a file's tables are added; shapes come after the balls. Attachments become springs
PARTS: tuple[Part, ...] = (
    Listed(name="materials", method="add_material", keys=MATERIAL, has_file=False, is_simulated=False),
    _Balls(name="balls", method="add_balls"),
    Columns(name="springs", method="add_springs", counted=("pairs",), assumed={"break_strain": float("inf")}),
    Part(name="attachments", method="attach", has_file=False, chosen={"one": "one_members", "other": "other_members"}),
    *ELEMENTS,
    Listed(name="moving_pins", method="add_moving_pins", keys=("balls",), chosen=MEMBERS),
    Listed(name="motors", method="add_motor", keys=("springs", "phase"), assumed={"phase": 0.0}, chosen=MEMBERS),
    _Walls(name="walls", method="add_wall", has_file=False),
    _Colliders(name="colliders", method="add_collider"),
    Columns(name="triangles", method="add_triangles", counted=("triangles",)),
    Listed(name="objects", method="set_name", keys=("name", "balls", "uv"), is_simulated=False),
    Listed(
        name="embedded_surfaces",
        method="add_embedded_surface",
        keys=SURFACE,
        assumed={"covers": -1},
        counted=("corners", "covers"),
        is_simulated=False,
    ),
    Listed(name="probes", method="add_probe", keys=("name", "kind"), chosen=MEMBERS),
)
LISTS = tuple(part.name for part in PARTS if isinstance(part, Listed))
