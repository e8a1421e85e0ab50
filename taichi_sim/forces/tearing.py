"""Tearing: springs that break for good where they are stretched too far."""

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from taichi_sim.device.engine import ti
from taichi_sim.device.fields import Fields, fill
from taichi_sim.device.model import Model
from taichi_sim.forces.springs import Springs
from taichi_sim.kernels.springs import law
from taichi_sim.scene.scene import Scene

__all__ = ["Severable", "Severed", "Tearing"]


class Severable(Protocol):
    """Part whose rows no longer act once a spring between two of their balls has torn."""

    members: NDArray  # (r, k) balls of each row, negative: of none
    gone: Any  # field (r), 1: acts no more


@ti.data_oriented
class Severed:
    """Mask of the rows of balls (r, k), negative for none, that are gone."""

    def __init__(self, members: NDArray, fields: Fields) -> None:
        self.members, self.gone = members, fields.integers(len(members))


@ti.data_oriented
class Tearing:
    """Looks at all springs in each substep; those longer than `limit` [m] lose their stiffness and damping.

    `torn` (as the springs are stored) marks them; `kept`: the same in the last state known to be good. An element, a triangle in
    the wind among them, two of whose balls a torn spring joined, acts no more, and a triangle that collides is no more.
    before_contacts: springs are looked at once balls have moved, before contacts are found, and not at the end of the substep.
    """

    def __init__(
        self, model: Model, springs: Springs, parts: Sequence[Severable], fields: Fields, before_contacts: bool
    ) -> None:
        scene = model.scene
        self.springs, self.n, self.m = springs, model.n, scene.n_springs
        springs.tearing = self
        number = springs.number
        tears = np.isfinite(scene.break_strain)
        limit = np.full(self.m, np.inf)  # also of what has no length at rest
        limit[tears] = scene.rest_length[tears] * (1.0 + scene.break_strain[tears])
        # a number that is larger than any length, but not infinite, which single precision would refuse
        stored = np.where(number < 0, np.inf, limit[number])
        self.limit = fields.reals(np.minimum(stored, 1e30))
        self.torn, self.kept = fields.integers(springs.entries), fields.integers(springs.entries)
        self.stiffness = np.where(number < 0, 0.0, scene.stiffness[number])
        self.ties = [_Ties(scene, springs, part, fields) for part in parts]
        self.before_contacts = before_contacts

    @ti.func
    def cut_overstretched(self, ball: ti.template()):
        """Mark and cut what is too long. Where both balls list a spring, both come to the same."""
        for i in range(self.n):
            for t in range(self.springs.start[i + 1] - self.springs.start[i]):
                place = law.spring_entry(self.springs, i, t)
                r = ball[self.springs.spring[place].other].x - ball[i].x
                if r.dot(r) > self.limit[place] * self.limit[place]:
                    self._cut(place)

    @ti.func
    def _cut(self, place):
        self.torn[place] = 1
        self.springs.spring[place].stiffness = 0.0
        if ti.static(self.springs.damped):
            self.springs.spring[place].damping = 0.0
        for tie in ti.static(self.ties):
            tie.sever(place)

    def keep(self) -> None:
        """Remember the present state as good."""
        self.kept.copy_from(self.torn)

    def restore(self) -> None:
        """Return to the state last kept."""
        if not np.array_equal(self.torn.to_numpy(), self.kept.to_numpy()):
            self._set(self.kept.to_numpy())

    def live(self) -> list[Any]:
        """Fields that a substep changes."""
        return [self.torn]

    def renew(self) -> None:
        """Take note that the values of `live` were put back."""
        self._set(self.torn.to_numpy())

    def _set(self, torn: NDArray[Any]) -> None:
        self.torn.from_numpy(torn)
        fill(self.springs.spring.stiffness, np.where(torn > 0, 0.0, self.stiffness))
        self.springs.set_damping(self.springs.given)
        for tie in self.ties:
            tie.set(torn > 0)

    def whole(self) -> NDArray[np.bool_]:
        """Mask of the springs, as they are stored, that are not torn."""
        return self.torn.to_numpy() == 0

    @property
    def springs_torn(self) -> NDArray[np.bool_]:
        """(m,) in the scene's order."""
        torn = np.zeros(self.m, dtype=bool)
        number = self.springs.number
        torn[number[number >= 0]] = self.torn.to_numpy()[number >= 0] > 0
        return torn

    def tear(self, torn: NDArray[np.bool_] | None) -> None:
        """Take over which springs (m,) are torn, from a file or from before lists grew; None: none."""
        number = self.springs.number
        self.put_back({"torn": np.where(number < 0, False, False if torn is None else torn[number])})

    def stored(self) -> dict[str, NDArray]:
        """Arrays of the state last kept, by name."""
        return {"torn": self.kept.to_numpy()}

    def put_back(self, stored: Mapping[str, NDArray]) -> None:
        """Take over what `stored` gave."""
        self._set((stored["torn"] > 0).astype(np.int32))
        self.keep()


@ti.data_oriented
class _Ties:
    """Rows of a part that have both balls of a spring: for spring `place` those from first[key] to first[key + 1]."""

    def __init__(self, scene: Scene, springs: Springs, part: Severable, fields: Fields) -> None:
        self.part = part
        n, pairs = scene.n_balls, np.sort(scene.pairs.astype(np.int64), axis=1)
        joined, key = np.unique(pairs[:, 0] * n + pairs[:, 1], return_inverse=True)
        members = np.sort(part.members.astype(np.int64), axis=1)
        sides = [(a, b) for b in range(members.shape[1]) for a in range(b)]
        codes = np.concatenate([members[:, a] * n + members[:, b] for a, b in sides])
        found = np.minimum(np.searchsorted(joined, codes), len(joined) - 1)
        same = np.flatnonzero(joined[found] == codes)
        order = same[np.argsort(found[same], kind="stable")]
        first = np.zeros(len(joined) + 1, dtype=np.int32)
        np.cumsum(np.bincount(found[same], minlength=len(joined)), out=first[1:])
        self._first, self._row = first, (order % len(members)).astype(np.int32)
        self._key = np.where(springs.number < 0, 0, key.ravel()[springs.number])
        self.key, self.first, self.row = fields.integers(self._key), fields.integers(first), fields.integers(self._row)

    @ti.func
    def sever(self, place):
        """Spring `place` has torn."""
        key = self.key[place]
        for k in range(self.first[key], self.first[key + 1]):
            self.part.gone[self.row[k]] = 1

    def set(self, torn: NDArray[np.bool_]) -> None:
        """Springs (as they are stored) that are torn, and no others."""
        gone = np.zeros(len(self.part.members), dtype=np.int32)
        for key in np.unique(self._key[torn]):
            gone[self._row[self._first[key] : self._first[key + 1]]] = 1
        self.part.gone.from_numpy(gone)
