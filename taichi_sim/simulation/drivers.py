"""Two ways to run the parts of a substep: `parallel`, with a few launches a substep of parallel loops, and `fused`, one launch
for many substeps whose loops run one after another on one thread. A launch costs 1 us and a parallel loop 50 us, 6 us on one
thread, so small scenes run up to a hundred times faster fused; both give the same bits where sums have a fixed order."""

from typing import Any

from taichi_sim.device.engine import ti
from taichi_sim.device.parts import PRIME, STEP, Chain, Launches, Part
from taichi_sim.scene.motion import counted

__all__ = ["Drivers"]

# substeps that kernels count on from one time: whole numbers of single precision, and of 32 bits with what is added
COUNTED = 1 << 24
FUSED_WORK = 1 << 20  # balls and springs gone through in one launch: between launches the host hears of Ctrl-C


@ti.data_oriented
class Drivers:
    """The kernels of one simulation. `integrator` is any bound Integrator; `pins`: moving ones, `motors`, `tearing`: of springs,
    or None; `size`: balls and springs."""

    def __init__(
        self, integrator: Any, pins: Any = None, motors: Any = None, tearing: Any = None, size: int = 0
    ) -> None:
        self.integrator, self.pins, self.motors, self.tearing = integrator, pins, motors, tearing
        self.leads, self.flexes = pins is not None, motors is not None
        tears = tearing is not None and not tearing.before_contacts
        lead = (Part(self, "_stay", PRIME), Part(self, "_lead", STEP)) if self.leads or self.flexes else ()
        tear = (Part(self, "_tear", STEP),) if tears else ()
        self.chain = Chain((*lead, *integrator.recipe, *tear))
        self.hosted = integrator.runs_from_host
        self.before, self.after = Launches(lead), Launches(tear)  # where a method runs the rest
        self.launches = integrator.launches if self.hosted else Launches(self.chain.parts)
        self._longest = max(1, FUSED_WORK // max(1, size))

    @ti.func
    def _lead(self, role: ti.template(), h, time):
        self._drive(True)

    @ti.func
    def _stay(self, role: ti.template(), h, time):
        self._drive(False)

    @ti.func
    def _drive(self, forth: ti.template()):
        if ti.static(self.leads):
            self.pins.drive(forth)
        if ti.static(self.flexes):
            self.motors.drive(forth)

    @ti.func
    def _tear(self, role: ti.template(), h, time):
        self.tearing.cut_overstretched(self.integrator.ball)

    @ti.kernel
    def fused(self, role: int, first: int, steps: int, h: float, time: float):
        """Run `steps` substeps from number `first` on; or, in the role PRIME, what makes the state before them."""
        ti.loop_config(serialize=True)
        for k in range(first, first + steps):
            self.chain.run(role, h, time + k * h)

    def prime(self, h: float, time: float, fused: bool) -> None:
        """Forces and contacts at the present positions."""
        if fused:
            self.fused(PRIME, 0, 1, h, time)
            return
        if self.hosted:
            self.before.run(PRIME, 0, h, time)
        self.launches.run(PRIME, 0, h, time)

    def run(self, first: int, steps: int, h: float, time: float, fused: bool) -> None:
        """`steps` substeps of h seconds by the chosen driver, from number `first` of those from `time` on. If `time` is a whole
        number of them, they are counted from 0, so that times are the same to the last bit however a run is divided."""
        begin, before = counted(time, h)
        number, end = before + first, before + first + steps
        while True:
            base = number // COUNTED * COUNTED
            now = min(end, base + COUNTED)
            self._run(number - base, now - number, h, begin + base * h, fused)
            number = now
            if number == end:
                return

    def _run(self, first: int, steps: int, h: float, time: float, fused: bool) -> None:
        end = first + steps
        if fused:
            for number in range(first, end, self._longest):
                self.fused(STEP, number, min(self._longest, end - number), h, time)
        elif self.hosted:
            for number in range(first, end):
                self.before.run(STEP, number, h, time)
                self.integrator.advance(number, h, time)
                self.after.run(STEP, number, h, time)
        else:
            self.launches.run(STEP, first, h, time, steps)
