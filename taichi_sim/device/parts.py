"""Parts of which a substep is made, and the kernels' way to run them.

Taichi inlines all that a kernel calls into one function, and LLVM takes more than twice as long for one of twice the length. So
in a kernel that runs on one thread each part is compiled by itself, as a function that calls the next one at its end. It calls no
other: the engine lists what a function calls in the order of addresses, so that one which calls two would be known to the cache
on disk by another name in each process.

Private names are touched, so this holds for one version of Taichi only; in any other parts are inlined.
"""

from collections.abc import Sequence
from itertools import groupby
from typing import Any, NamedTuple

from taichi_sim.device.engine import IS_KNOWN, on_device, program, ti
from taichi_sim.device.fast_launches import repeated

__all__ = ["BOTH", "PRIME", "STEP", "Chain", "Launches", "Part", "run_parts"]

STEP, PRIME = 1, 2  # roles: what a substep does, and what makes the state that it starts from
BOTH = STEP | PRIME

real_function = ti.real_func if IS_KNOWN else ti.func  # one that is not inlined


class Part(NamedTuple):
    """A function `name(role, h, time)` of an object, `owner`, the roles in which it runs, and how many times in a row."""

    owner: Any
    name: str
    roles: int
    times: int = 1


@ti.func
def run_parts(parts: ti.template(), role: ti.template(), h, time):
    """All parts of a role, fixed when this is compiled, in turn."""
    for part in ti.static(parts):
        if ti.static(part.roles & role):
            for _ in ti.static(range(part.times)):  # unrolled: inside another loop none would be parallel
                ti.static(getattr(part.owner, part.name))(role, h, time)


@ti.data_oriented
class Chain:
    """Parts, run in turn on one thread, whose role may be chosen when they run."""

    _program: Any = None  # of the engine, which the functions were compiled for

    def __init__(self, parts: Sequence[Part]) -> None:
        self.parts = tuple(parts)
        self.linked = IS_KNOWN
        if IS_KNOWN:
            _install()
            Chain._forget()

    @classmethod
    def _forget(cls) -> None:
        """Drop what belonged to an engine that was stopped."""
        if cls._program is not program():
            cls._program = program()
            _drop(cls.link.func)

    @ti.func
    def run(self, role, h, time):
        """All parts of a role."""
        if ti.static(self.linked):
            self.link(0, role, h, time)
        else:
            for part in ti.static(self.parts):
                if role & part.roles != 0:
                    for _ in range(part.times):
                        ti.static(getattr(part.owner, part.name))(role, h, time)

    @real_function
    def link(self, number: ti.template(), role: int, h: float, time: float):
        """Part `number`, and all after it."""
        if role & self.parts[number].roles != 0:
            for _ in range(self.parts[number].times):
                ti.static(getattr(self.parts[number].owner, self.parts[number].name))(role, h, time)
        if ti.static(number + 1 < len(self.parts)):
            if role == STEP:  # a function that is called in one place only would be inlined there, whatever its length
                self.link(number + 1, STEP, h, time)
            else:
                self.link(number + 1, role, h, time)


@ti.data_oriented
class Launches:
    """Parts, run in turn on many threads: those in a row that have the same roles are one kernel, which serves all of them; so is
    one that runs several times. On a device, where a launch takes as long as a loop, all that a role needs is one kernel."""

    def __init__(self, parts: Sequence[Part]) -> None:
        groups = [(kind, tuple(group)) for kind, group in groupby(parts, lambda part: (part.roles, part.times))]
        if on_device():
            all_of = [part for part in parts for _ in range(part.times)]
            groups = [((role, 1), tuple(part for part in all_of if part.roles & role)) for role in (STEP, PRIME)]
        self.kinds = tuple(kind for kind, _ in groups)
        self.groups = tuple(group for _, group in groups)

    def run(self, role: int, first: int, h: float, time: float, steps: int = 1) -> None:
        """All parts of a role, for so many substeps from number `first` on of those of h seconds from `time` on."""
        turn = [which for which, (roles, times) in enumerate(self.kinds) for _ in range(times if roles & role else 0)]
        for which in turn if steps else ():
            self._launch(which, role, first, h, time)
        if steps < 2:
            return
        again = [repeated(self._launch, 2, which, role, first, h, time) for which in turn]
        for number in range(first + 1, first + steps):
            for launch in again:
                launch(number)

    @ti.kernel
    def _launch(self, which: ti.template(), role: int, number: int, h: float, time: float):
        for part in ti.static(self.groups[which]):
            ti.static(getattr(part.owner, part.name))(role, h, time + number * h)


def _drop(link: Any) -> None:
    """Compile a real function anew when it is called next."""
    link.compiled, link.taichi_functions = None, {}
    link.mapper.mapping.clear()


def _install() -> None:
    """Make the engine write what is inlined into a function there, and not into the kernel; and drop a function whose
    compilation ended early (an interrupt, an error in a force), which the engine would take for an empty one from then on."""
    from taichi.lang import impl, kernel_impl

    tree_and_context = kernel_impl._get_tree_and_ctx
    if tree_and_context.__module__ == __name__:
        return
    link = Chain.link.func
    compile_link = link.do_compile

    def compile_whole(**given: Any) -> None:
        around = impl.get_runtime().compiling_callable
        try:
            compile_link(**given)
        except BaseException:
            impl.get_runtime().compiling_callable = around
            _drop(link)
            link.func_id = kernel_impl.Func.function_counter  # the program keeps a function of the old name
            kernel_impl.Func.function_counter += 1
            raise

    link.do_compile = compile_whole

    def in_place(*args: Any, **named: Any) -> Any:
        tree, context = tree_and_context(*args, **named)
        if not context.is_kernel and not context.is_real_function:
            context.ast_builder = impl.get_runtime().compiling_callable.ast_builder()
        return tree, context

    kernel_impl._get_tree_and_ctx = in_place
