"""What a scene can have besides balls, springs and walls: cells that keep their volume, bending, gas, wind, moving pins,
motors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from taichi_sim.common import validation
from taichi_sim.common.errors import SceneError
from taichi_sim.common.errors import about as place_of
from taichi_sim.geometry.mesh import sides
from taichi_sim.scene.columns import Table, sealed
from taichi_sim.scene.keyframes import Keyframe, Motion, plain_keyframe
from taichi_sim.scene.motors import Motorised
from taichi_sim.scene.objects import Objects
from taichi_sim.scene.probes import Probed

__all__ = ["Elements", "Gas", "MovingPins", "Wind", "cell_volumes"]

AIR = 1.2  # kg/m^3
PLATE = 1.28  # drag of a flat plate across the flow
SKIN_FRICTION = 0.05  # the same along it
CRUSHED = 0.5  # of its rest volume: a cell that has less resists with its crush modulus, too
FLAT_CELL = 1e-9  # of the cube of its longest edge: a cell of less volume is flat


@dataclass(frozen=True, slots=True)
class Wind:
    """Air that moves, or stands still and drags, see `Elements.add_wind`."""

    velocity: tuple[float, ...]  # m/s
    density: float  # kg/m^3
    drag: float
    skin_friction: float
    gust: float  # part of the speed
    gust_length: float  # m


@dataclass(frozen=True, slots=True, eq=False)
class Gas:
    """Gas in a closed surface: (pressure + outside) V = const against `outside`."""

    triangles: NDArray[np.int32]  # (t, 3) balls, counter-clockwise from outside
    pressure: float  # Pa, over that outside, at the volume of the start
    outside: float  # Pa
    volume: float  # m^3, at the start


@dataclass(frozen=True, slots=True, eq=False)
class MovingPins:
    """Pinned balls that are led along a path as one rigid body."""

    balls: NDArray[np.int32]  # (k,)
    motion: Motion  # of their centre
    given: Mapping[str, Any]  # the arguments, for saving


class Elements(Probed, Objects, Motorised):
    """The part of a Scene that holds them; every `add_` raises SceneError and then changes nothing."""

    def _begin_elements(self, dim: int) -> None:
        whole = np.int32
        self._cells = Table(
            corners=np.zeros((0, dim + 1), dtype=whole),
            bulk_modulus=np.zeros(0),
            crush_modulus=np.zeros(0),
            rest_volume=np.zeros(0),
            together=np.zeros(0, dtype=whole),
        )
        self._bends = Table(
            corners=np.zeros((0, 4), dtype=whole),
            weights=np.zeros((0, 4)),
            stiffness=np.zeros(0),
            damping=np.zeros(0),
            hinge=np.zeros(0, dtype=bool),
        )
        self.wind: Wind | None = None
        self.gases: list[Gas] = []
        self.moving_pins: list[MovingPins] = []
        self._driven_of = 0, np.zeros(0, dtype=bool)  # the first so many of them drive these balls
        self._begin_motors()
        self._begin_probes()
        self._begin_objects()

    cells = property(lambda self: self._cells["corners"], doc="(c, dim + 1) balls of each cell")
    bulk_modulus = property(lambda self: self._cells["bulk_modulus"], doc="(c,) Pa, in 2D N/m")
    crush_modulus = property(
        lambda self: self._cells["crush_modulus"],
        doc="(c,) Pa, in 2D N/m, of cells of less than half of their rest volume",
    )
    rest_volume = property(lambda self: self._cells["rest_volume"], doc="(c,) m^3, in 2D m^2; positive")
    cells_together = property(lambda self: self._cells["together"], doc="(c,) a number that cells in one have, or -1")
    bends = property(lambda self: self._bends["corners"], doc="(b, 4) balls of each bending element")
    bend_weights = property(lambda self: self._bends["weights"], doc="(b, 4) sum 0 for each")
    bend_stiffness = property(lambda self: self._bends["stiffness"], doc="(b,) N/m")
    bend_damping = property(lambda self: self._bends["damping"], doc="(b,) N s/m")
    bend_hinge = property(
        lambda self: self._bends["hinge"], doc="(b,) bool; True: of two sides, one of which may be held"
    )

    def has_elements(self) -> bool:
        """Whether forces besides gravity, springs and contacts act."""
        return bool(self.cells_act() or self._bends.rows or self.wind is not None or self.gases)

    def cells_act(self) -> bool:
        """Whether any cell exerts a force; others are only watched, see `Simulation.inverted`."""
        return bool(self.bulk_modulus.any() or self.crush_modulus.any())

    def joined(self: Any) -> NDArray[np.bool_]:
        """Which balls (n,) belong to a spring, a cell, a bending element or the skin of a gas."""
        joined = np.zeros(self.n_balls, dtype=bool)
        for balls in (self.pairs, self.cells, self.bends, *(gas.triangles for gas in self.gases)):
            joined[balls] = True
        return joined

    def add_cells(
        self: Any,
        corners: ArrayLike,
        *,
        bulk_modulus: ArrayLike,
        crush_modulus: ArrayLike = 0.0,
        rest_volume: ArrayLike | None = None,
        together: ArrayLike | None = None,
    ) -> NDArray[np.int32]:
        """Add c cells that resist a change of volume and return their indices, shape (c,).

        A cell, a tetrahedron in 3D and a triangle in 2D, stores bulk_modulus V0 (V / V0 - 1)^2 / 2, V with its sign: one that
        is turned inside out is driven back through flatness. Below half of its rest volume it stores besides crush_modulus V0
        (V / V0 - 1/2)^2 / 2.

        Args:
            corners: (c, dim + 1) balls, or one cell, in any order.
            bulk_modulus: one or one per cell, >= 0 [Pa, in 2D N/m].
            crush_modulus: one or one per cell, >= 0 [Pa, in 2D N/m]: keeps cells from being crushed, and does not change how they
                respond to small strains.
            rest_volume: V0, one or one per cell, > 0 [m^3, in 2D m^2]; None: the present volume, whose orientation then counts as
                positive.
            together: (c,) whole numbers: cells with the same one, from 0 on, resist a change of their volumes' sum alone, as one
                of their mean modulus; -1 or None: each its own.
        """
        ij = validation.indices("cells.corners", validation.many(corners, 1), self.n_balls, width=self.dim + 1)
        c = len(ij)
        ordered = np.sort(ij, axis=1)
        twice = (ordered[:, 1:] == ordered[:, :-1]).any(axis=1)
        if twice.any():
            k = int(np.argmax(twice))
            raise SceneError(f"cells.corners[{k}]", ij[k], says=f"names a ball twice; give {self.dim + 1} different")
        modulus = validation.per_item("cells.bulk_modulus", bulk_modulus, c, low=0)
        crush = validation.per_item("cells.crush_modulus", crush_modulus, c, low=0)
        present = cell_volumes(self.position, ij)
        if rest_volume is None:
            edge = np.abs(self.position[ij] - self.position[ij[:, :1]]).max(axis=(1, 2), initial=0.0)
            flat = np.abs(present) <= FLAT_CELL * edge**self.dim
            if flat.any():
                k = int(np.argmax(flat))
                says = "is flat now; give a rest_volume, or corners that span a volume"
                raise SceneError(f"cells.corners[{k}]", ij[k], says=says)
            ij[present < 0] = ij[present < 0][:, [1, 0, *range(2, self.dim + 1)]]
            rest = np.abs(present)
        else:
            rest = validation.per_item("cells.rest_volume", rest_volume, c, positive=True)
        shared = validation.per_item("cells.together", -1 if together is None else together, c, low=-1)
        broken = shared != np.round(shared)
        if broken.any():
            k = int(np.argmax(broken))
            raise SceneError(f"cells.together[{k}]", shared[k], "a whole number")
        before = int(self.cells_together.max(initial=-1)) + 1
        shared = np.where(shared < 0, -1, shared + before).astype(np.int32)
        first = self._cells.rows
        columns = {"bulk_modulus": modulus, "crush_modulus": crush, "rest_volume": rest, "together": shared}
        self._cells.append(c, corners=ij, **columns)
        return np.arange(first, first + c, dtype=np.int32)

    def add_bending(
        self: Any,
        corners: ArrayLike,
        *,
        weights: ArrayLike,
        stiffness: ArrayLike,
        damping: ArrayLike = 0.0,
        hinge: bool | Sequence[bool] | NDArray = False,
    ) -> None:
        """Add b bending elements: forces -w_i sum_j w_j (stiffness x_j + damping v_j) on four balls each.

        The energy is stiffness |sum w_j x_j|^2 / 2, 0 where the element is flat; quadratic, so its force is linear (Bergou et
        al. 2006, "A quadratic bending model for inextensible surfaces"). An element of a rod through balls a, b, c has the
        corners (b, b, a, c) and the weights (-1, -1, 1, 1).

        Args:
            corners: (b, 4) balls; weights: (b, 4) of them [1], the sum of each row 0.
            stiffness: one or one per element, >= 0 [N/m]; damping: one or one per element, >= 0 [N s/m].
            hinge: one or one per element: corners 0 and 1 are the hinge between two sides of a rod or sheet, corners 2 and 3
                their far ends. A side whose balls are all pinned cannot bend. The other one then bears the whole change of
                angle over its own length, so stiffness and damping rise to those of that side: twice, for equal sides. A rod
                or sheet is thus clamped exactly at its last pinned balls.
        """
        ij = validation.indices("bending.corners", validation.many(corners, 1), self.n_balls, width=4)
        w = validation.vectors("bending.weights", validation.many(weights, 1), None, 4)
        if w.shape != ij.shape:
            says = f"shape {w.shape} does not fit; it must be {ij.shape}, as corners"
            raise SceneError("bending.weights", says=says)
        off = np.abs(w.sum(axis=1)) > 1e-9 * np.abs(w).max(axis=1, initial=1e-300)
        if off.any():
            k = int(np.argmax(off))
            raise SceneError(f"bending.weights[{k}]", w[k], "four numbers whose sum is 0")
        strength = validation.per_item("bending.stiffness", stiffness, len(ij), low=0)
        loss = validation.per_item("bending.damping", damping, len(ij), low=0)
        sides = validation.flags("bending.hinge", hinge, len(ij))
        ends = w[:, 2:][sides]
        if np.any(ends[:, 0] * ends[:, 1] <= 0.0):
            k = int(np.flatnonzero(sides)[np.argmax(ends[:, 0] * ends[:, 1] <= 0.0)])
            raise SceneError(f"bending.weights[{k}]", w[k], "of a hinge: the last two of one sign, and not 0")
        self._bends.append(len(ij), corners=ij, weights=w, stiffness=strength, damping=loss, hinge=sides)

    def held_bending(self: Any) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Stiffness (b,) [N/m] and damping (b,) [N s/m] of the bending elements as they act with the present pins, see
        `add_bending`. The two sides of a hinge are as long as the inverse weights of their far ends."""
        held = self.pinned[self.bends]
        held[:, 2:] &= held[:, :1] & held[:, 1:2] & self.bend_hinge[:, None]
        size = np.abs(self.bend_weights[:, [3, 2]])  # of side 2 and 3, as 1 / w2 : 1 / w3
        free = np.where(held[:, 2:], 0.0, size).sum(axis=1)
        rise = np.divide(size.sum(axis=1), free, out=np.ones(len(free)), where=free > 0.0)
        return self.bend_stiffness * rise, self.bend_damping * rise

    def set_bending(self: Any, *, stiffness: ArrayLike | None = None, damping: ArrayLike | None = None) -> None:
        """Change all b bending elements: stiffness [N/m], damping [N s/m], one or one per element; what is left None stays."""
        new = {}
        for name, given in (("stiffness", stiffness), ("damping", damping)):
            if given is not None:
                new[name] = validation.per_item(f"bending.{name}", given, self._bends.rows, low=0)
        self._bends.replace(slice(None), **new)

    def add_wind(
        self: Any,
        velocity: ArrayLike,
        *,
        density: float = AIR,
        drag: float = PLATE,
        skin_friction: float = SKIN_FRICTION,
        gust: float = 0.0,
        gust_length: float = 1.0,
    ) -> None:
        """Let air act on all triangles of a 3D scene: density / 2 times area times the square of the relative speed.

        Args:
            velocity: of the air [m/s]; zeros for still air that only drags.
            density: of the air [kg/m^3]; drag: coefficient for flow across a triangle [1]; skin_friction: coefficient for flow
                along it [1].
            gust: 0 to 1 [1], part of the speed by which it varies in waves that travel with the wind.
            gust_length: of the longest of them [m].
        """
        if self.dim != 3:
            raise SceneError("wind", says="acts on triangles, which a scene with dim = 3 has; this one has dim = 2")
        if self.wind is not None:
            raise SceneError("wind", says="there is one already; a scene has one at most")
        self.wind = Wind(
            tuple(validation.vector("wind.velocity", velocity, 3).tolist()),
            validation.number("wind.density", density, low=0),
            validation.number("wind.drag", drag, low=0),
            validation.number("wind.skin_friction", skin_friction, low=0),
            validation.number("wind.gust", gust, low=0, high=1),
            validation.number("wind.gust_length", gust_length, positive=True),
        )

    def add_gas(self: Any, triangles: ArrayLike, *, pressure: float, outside: float = 0.0) -> None:
        """Fill a closed surface with gas: (pressure + outside) times the volume stays what it is now.

        Args:
            triangles: (t, 3) balls, counter-clockwise seen from outside, that enclose a volume without a hole.
            pressure: over that outside, now [Pa]; negative where the gas is thinner, at least -outside, which is a vacuum.
            outside: pressure around it [Pa]. With 0 outside the gas is as soft as it can
                be; air at 101325 Pa hardly lets the volume change, and wants short steps.
        """
        if self.dim != 3:
            says = "fills closed surfaces of triangles, in a scene with dim = 3; this one has dim = 2"
            raise SceneError("gases", says=says)
        t = validation.indices("gases.triangles", triangles, self.n_balls, width=3)
        edges = sides(t).astype(np.int64)
        forth, back = edges @ [self.n_balls, 1], edges @ [1, self.n_balls]
        open_ = ~np.isin(forth, back)
        if not len(t) or open_.any():
            where = f": the edge from ball {edges[open_][0, 0]} to {edges[open_][0, 1]} has one" if len(t) else ""
            says = f"must close a volume, with two triangles, turned alike, at every edge{where}"
            raise SceneError("gases.triangles", says=says)
        a, b, c = (self.position[t[:, k]] - self.position[t[0, 0]] for k in range(3))
        volume = float(np.einsum("ti,ti->", a, np.cross(b, c))) / 6.0
        if volume <= 0.0:
            says = f"enclose {volume:.4g} m^3; give them counter-clockwise seen from outside"
            raise SceneError("gases.triangles", says=says)
        around = validation.number("gases.outside", outside, low=0)
        p = validation.number("gases.pressure", pressure, low=0.0 - around)
        self.gases.append(sealed(Gas(t, p, around, volume)))

    def add_moving_pins(
        self: Any,
        balls: ArrayLike,
        *,
        velocity: ArrayLike | None = None,
        rotation_rate: ArrayLike | None = None,
        pivot: ArrayLike | None = None,
        path: Sequence[Keyframe | Sequence[Any]] | None = None,
        repeat: bool = False,
    ) -> None:
        """Pin balls (k,) and lead them as one rigid body; they push what they meet and take nothing.

        Args:
            balls: (k,) of the scene.
            velocity: (dim,) for ever [m/s].
            rotation_rate: about `pivot`, for ever [degrees per second], counter-clockwise in 2D, (3,) in 3D.
            pivot: (dim,) that they turn about, which moves along [m]; their mean if left out.
            path: in place of these, keyframes {time, position, rotation} or (time, position[, rotation]): by how far they have
                moved from where they start, and turned about their mean. The first is 0. Between keyframes they move with
                constant velocities, and they stay where the last one leaves them, unless the path repeats.
            repeat: whether the path starts again at its end, for ever.
        """
        where = f"moving_pins[{len(self.moving_pins)}]"
        index = validation.indices(f"{where}.balls", np.atleast_1d(validation.as_array(balls)), self.n_balls)
        if not len(index):
            raise SceneError(f"{where}.balls", says="is empty; name at least one ball")
        both = index[self._driven()[index]]
        if len(both) or len(np.unique(index)) < len(index):
            k = int(both[0]) if len(both) else int(np.sort(index)[:-1][np.diff(np.sort(index)) == 0][0])
            says = f"ball {k} is named twice; a ball can be led along one path only"
            raise SceneError(f"{where}.balls", says=says)
        given = {
            "velocity": None
            if velocity is None
            else validation.vector(f"{where}.velocity", velocity, self.dim).tolist(),
            "rotation_rate": None if rotation_rate is None else validation.as_array(rotation_rate).tolist(),
            "pivot": None if pivot is None else validation.vector(f"{where}.pivot", pivot, self.dim).tolist(),
            "path": path,
            "repeat": repeat,
        }
        centre = self.position[index].mean(axis=0)
        motion = Motion.of(where, self.dim, centre, {**given, "rotation": None}, named=False)
        if path is not None:
            given["path"] = [plain_keyframe(key) for key in path]
        if not motion.moves:
            says = "does not move; give a velocity, a rotation_rate or a path, or use `pinned`"
            raise SceneError(where, says=says)
        self._balls.replace(index, pinned=True, velocity=0.0)
        self.moving_pins.append(
            MovingPins(sealed(index), sealed(motion), {k: v for k, v in given.items() if v is not None})
        )

    def _driven(self: Any) -> NDArray[np.bool_]:
        """Which balls (n,) moving pins drive. It grows with them, so that many are added in as many steps."""
        of, driven = self._driven_of
        if of > len(self.moving_pins):  # some were taken back
            of, driven = 0, driven[:0]
        if len(driven) < self.n_balls:
            driven = np.concatenate([driven, np.zeros(self.n_balls - len(driven), dtype=bool)])
        for pins in self.moving_pins[of:]:
            driven[pins.balls] = True
        self._driven_of = len(self.moving_pins), driven
        return driven

    def attach(
        self: Any,
        one: ArrayLike,
        other: ArrayLike,
        *,
        stiffness: ArrayLike,
        damping: ArrayLike = 0.0,
        rest_length: ArrayLike | None = None,
        break_strain: ArrayLike | None = None,
    ) -> NDArray[np.int32]:
        """Join balls of two objects, the k-th of `one` to the k-th of `other`, and return the springs, shape (k,).

        Args:
            one, other: (k,) balls. Those that a spring joins do not collide.
            stiffness: one or one per spring, >= 0 [N/m]; damping: along the spring, one or one per spring, >= 0 [N s/m].
            rest_length: one or one per spring, >= 0 [m]; None: the present distance.
            break_strain: strain at which it tears for good, > 0 [1]; None: never.
        """
        a = validation.indices("attachments.one", np.atleast_1d(validation.as_array(one)), self.n_balls)
        b = validation.indices("attachments.other", np.atleast_1d(validation.as_array(other)), self.n_balls)
        if len(a) != len(b):
            says = f"names {len(b)} balls and attachments.one {len(a)}; each needs its partner"
            raise SceneError("attachments.other", says=says)
        return self.add_springs(
            np.stack([a, b], axis=1),
            stiffness=stiffness,
            damping=damping,
            rest_length=rest_length,
            break_strain=break_strain,
        )

    def elements(self) -> dict[str, Any]:
        """Wind, gases, moving pins, motors, probes and objects as plain values, arrays apart, for files and digests."""
        return {
            "wind": None if self.wind is None else asdict(self.wind),
            "gases": [{"pressure": g.pressure, "outside": g.outside, "volume": g.volume} for g in self.gases],
            "moving_pins": [dict(pins.given) for pins in self.moving_pins],
            "motors": [dict(motor.given) for motor in self.motors],
            "probes": [{"name": one.name, "kind": one.kind, **one.plain()} for one in self.probes],
            "objects": [one.name for one in self.objects],
        }

    def element_arrays(self) -> dict[str, NDArray]:
        """The arrays that go with `elements`."""
        arrays: dict[str, Any] = {f"gases.{k}.triangles": gas.triangles for k, gas in enumerate(self.gases)}
        arrays |= {f"moving_pins.{k}.balls": pins.balls for k, pins in enumerate(self.moving_pins)}
        arrays |= {f"motors.{k}.springs": motor.springs for k, motor in enumerate(self.motors)}
        arrays |= {f"motors.{k}.phase": one.phase for k, one in enumerate(self.motors) if one.phase.any()}
        arrays |= {f"objects.{k}.balls": one.balls for k, one in enumerate(self.objects)}
        arrays |= {f"objects.{k}.uv": one.uv for k, one in enumerate(self.objects) if one.uv is not None}
        return arrays | {
            f"probes.{one.name}.{key}": array for one in self.probes for key, array in one.arrays().items()
        }

    def set_elements(self: Any, about: Mapping[str, Any], arrays: Mapping[str, NDArray]) -> None:
        """Add what `elements` and `element_arrays` gave, judged as what is added by hand is. Raises SceneError that names what is
        wrong, an array by its name among the arrays."""
        gases, pins = (validation.tables(about, name) for name in ("gases", "moving_pins"))
        # older versions had none
        motors, probes = (validation.tables(about, name) if name in about else [] for name in ("motors", "probes"))
        with self.all_or_nothing():
            if about.get("wind") is not None:
                (wind,) = validation.tables({"wind": [about["wind"]]}, "wind")
                validation.call("wind", self.add_wind, wind)
            for k, table in enumerate(gases):
                gas = dict(table)
                volume = validation.number(f"gases[{k}].volume", gas.pop("volume", None), positive=True)
                gas["triangles"] = _array(arrays, "gases", k, "triangles")
                with place_of(f"gases[{k}]"):
                    validation.call("gases", self.add_gas, gas)
                self.gases[-1] = replace(self.gases[-1], volume=volume)
            for k, table in enumerate(pins):
                balls = {"balls": _array(arrays, "moving_pins", k, "balls")}
                validation.call(f"moving_pins[{k}]", self.add_moving_pins, table | balls)
            for k, table in enumerate(motors):
                springs = {"springs": _array(arrays, "motors", k, "springs")}
                phase = {"phase": arrays[f"motors.{k}.phase"]} if f"motors.{k}.phase" in arrays else {}
                validation.call(f"motors[{k}]", self.add_motor, table | springs | phase)
            for k, table in enumerate(probes):
                start = f"probes.{table.get('name')}."
                own = {key.removeprefix(start): array for key, array in arrays.items() if key.startswith(start)}
                with place_of(f"probes[{k}]"):
                    validation.call("probes", self.add_probe, {**table, **own})
            names = about.get("objects", [])
            if not isinstance(names, (list, tuple)):
                raise SceneError("objects", names, "a list of names")
            for k, name in enumerate(names):
                with place_of(f"objects[{k}]"):
                    self.set_name(_array(arrays, "objects", k, "balls"), name, arrays.get(f"objects.{k}.uv"))


def _array(arrays: Mapping[str, NDArray], *path: str | int) -> NDArray:
    name = ".".join(map(str, path))
    if name not in arrays:
        raise SceneError(path, says=f"is missing; there is no array {name!r}")
    return arrays[name]


def cell_volumes(x: NDArray, corners: NDArray) -> NDArray[np.float64]:
    """Signed volumes (c,) [m^3, in 2D m^2] of tetrahedra (triangles) with `corners` (c, dim + 1) at x (n, dim) [m]."""
    sides = x[corners[:, 1:]] - x[corners[:, :1]]
    if x.shape[1] == 2:
        return 0.5 * (sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0])
    return np.einsum("ci,ci->c", sides[:, 0], np.cross(sides[:, 1], sides[:, 2])) / 6.0
