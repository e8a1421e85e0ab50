"""ContactStatistics: all contacts, when someone asks. Its kernel is compiled at the first call; steps know nothing of it."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.contacts.base import ContactRule
from taichi_sim.device.engine import ti
from taichi_sim.device.fields import Fields
from taichi_sim.kernels.contacts import statistics
from taichi_sim.kernels.reductions import each_part, member, members, parts_of

__all__ = ["ContactStatistics"]


@ti.data_oriented
class ContactStatistics:
    """Asks each kind of contact in `contacts.parts` for those of ball i: a function `statistics(ball, solver, i)`,
    see kernels.contacts.statistics. A contact of two balls belongs to one of them."""

    def __init__(self, fields: Fields, contacts: ContactRule) -> None:
        self.contacts, self.n = contacts, contacts.n
        self.chunks = parts_of(self.n)
        self.sums = fields.vectors(self.chunks, statistics.SIZE)

    @ti.kernel
    def _look(self, ball: ti.template()):
        each_part(self.chunks, self._sum_chunk, (ball,))

    @ti.func
    def _sum_chunk(self, c, ball: ti.template()):
        total = statistics.nothing()
        for k in range(members(c, self.chunks, self.n)):
            i = member(c, k, self.chunks)
            for part in ti.static(self.contacts.parts):
                total = statistics.join(total, part.statistics(ball, self.contacts, i))
        self.sums[c] = total

    def look(self, ball: Any) -> NDArray[np.float64]:
        """(statistics.SIZE,) of all contacts at the present positions and velocities, which the last refresh has
        seen."""
        self._look(ball)
        parts = self.sums.to_numpy().astype(np.float64)
        whole = np.concatenate([parts[:, : statistics.SUMS].sum(axis=0), parts[:, statistics.SUMS :].max(axis=0)])
        whole[statistics.BALL] = parts[parts[:, statistics.LARGEST_PART].argmax(), statistics.BALL]
        return whole
