"""devices, warm, verify, bench: what this machine computes on, whether it computes right, and how fast."""

from typing import Annotated, Any

import typer

from taichi_sim.cli.command import BAD_INPUT, FAILED, echo, fail, flag, subcommand


@subcommand()
def devices() -> None:
    """List what this machine can compute on, and test whether it computes right."""
    from time import perf_counter

    from rich.console import Console
    from rich.table import Table

    from taichi_sim.device import backend, devices
    from taichi_sim.device.engine import ENGINE, VERSION

    table = Table("arch", "device", "memory", "precision", "self-test")
    for arch in reversed(backend.AUTOMATIC):
        device = devices.find(arch)
        if device is None:
            table.add_row(arch, "none found")
            continue
        start = perf_counter()
        wrong = devices.verdict(device, f"{ENGINE} {VERSION}", again=True)
        said = wrong or f"passed in {perf_counter() - start:.1f} s"
        if device.software:
            said += "; in software, so never taken without being asked for"
        memory = f"{device.memory / 2**30:.1f} GiB" if device.memory else "?"
        table.add_row(arch, device.words, memory, "f32, f64" if arch in backend.WIDE_ARCHES else "f32", said)
    Console().print(table)


@subcommand("arch", "precision", "integrator")
def warm(
    scenes: Annotated[list[str] | None, typer.Argument(metavar="[SCENE ...]")] = None,
    **options: Any,
) -> None:
    """Compile what SCENEs need, all demos otherwise, so that later runs on this machine need not."""
    from time import perf_counter

    from taichi_sim.files.source import demos
    from taichi_sim.reports import warm as warming

    start, failed = perf_counter(), 0
    for scene in warming.warm(scenes or list(demos()), {key: value for key, value in options.items() if value}):
        said = f"compiled {scene.kernels} kernels" if scene.kernels else "compiled nothing"
        echo(f"{scene.name}: {scene.failure or f'{said}, took {scene.seconds:.1f} s'}")
        failed += bool(scene.failure)
    cache = warming.kept()
    where = f"in {cache.folder}" if cache.folder else "nowhere"
    echo(
        f"took {perf_counter() - start:.0f} s; {cache.kernels} kernels, {cache.bytes / 2**20:.0f} MiB, are kept {where}"
    )
    if failed:
        fail(f"{failed} of the scenes failed", BAD_INPUT)


@subcommand("arch")
def verify(**options: Any) -> None:
    """Test an installation: small scenes against stored results. To be sent with a bug report.

    What a scene is off by: its positions as a part of its size, or its energy as a part of that exchanged, whichever is more.
    """
    from taichi_sim.reports import verify as verification

    off, ran = [], 0
    for result in verification.results(options["arch"]):
        if result.failed:
            said = result.failed
        elif result.deviation is None:
            said = "runs on a CPU alone"
        else:
            said = f"off by {result.deviation:.1e} of its size or energy, allowed {verification.TOLERANCE:.0e}"
        echo(f"{'passed' if result.passed else 'WRONG':7} {result.name}: {said}")
        off += [] if result.passed else [result.name]
        ran += result.failed != "" or result.deviation is not None
    echo(verification.installation())
    if off:
        fail(f"{len(off)} of {ran} failed: {'; '.join(off)}", FAILED)
    echo(f"all {ran} passed")


@subcommand("arch")
def bench(
    names: Annotated[list[str] | None, typer.Argument(metavar="[CASE ...]")] = None,
    quick: Annotated[bool, flag("quick", "Tiny sizes, to try it out.")] = False,
    json: Annotated[str | None, typer.Option(metavar="FILE", help="Where all numbers go.")] = None,
    checks: Annotated[
        bool,
        flag(
            "checks", "First the device's self-test, and in a source folder its tests; exit status 1 where one fails."
        ),
    ] = False,
    **options: Any,
) -> None:
    """Run the benchmark, beside its reference implementations: on the CPU, or the device that --arch names."""
    from taichi_sim.benchmark import main as benchmark

    arch = options["arch"] or "cpu"
    if not benchmark.main(names or [], quick=quick, arch=arch, file=json, checks=checks):
        raise typer.Exit(FAILED)
