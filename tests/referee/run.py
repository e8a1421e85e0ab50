"""The run: families of random scenes, each batch judged by its relations; a table, failing scenes shrunk and printed."""

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from .agreement import AGREEMENTS
from .likeness import LIKENESSES
from .observe import Case, Record, observe
from .relations import LEDGERS, Finding, Relation, judged

__all__ = ["RELATIONS", "Family", "Tally", "judge", "referee", "table"]

EXACT = 1e-8  # what is allowed: less is hardly more than rounding

RELATIONS: dict[str, Relation] = {**LEDGERS, **AGREEMENTS, **LIKENESSES}


@dataclass(frozen=True)
class Family:
    """Random scenes of one kind. draw(rng, n): n of them that may run together; relations: names of what they must obey."""

    name: str
    draw: Callable[[np.random.Generator, int], Iterable[Case]]
    relations: tuple[str, ...]
    batch: int = 12  # scenes drawn at once


@dataclass
class Tally:
    """What one relation said about the scenes of one family."""

    family: str
    relation: str
    tolerance: float
    scenes: int = 0
    failures: int = 0
    worst: float = 0.0
    seconds: float = 0.0
    worst_at: tuple[int, int] | None = None  # batch and number in it
    worst_case: Case | None = None

    def plain(self) -> dict[str, Any]:
        """For a file: all but the case."""
        kept = {f.name: getattr(self, f.name) for f in fields(self) if f.name != "worst_case"}
        return {**kept, "worst": min(self.worst, 1e300)}


def judge(cases: list[Case], names: Iterable[str]) -> list[list[Finding]]:
    """Findings of each case. All runs that they need are made together where they can be; but those of a relation that allows
    hardly more than rounding by themselves, with the same scenes side by side in each: others change the last bits."""
    relations = [RELATIONS[name] for name in names]
    plans = [[relation.runs(case) for relation in relations] for case in cases]
    apart = [k for k, relation in enumerate(relations) if relation.tolerance < EXACT]
    rest = [k for k in range(len(relations)) if k not in apart]
    records: dict[tuple[int, int], Record] = {}
    for together in [rest, *([k] for k in apart)]:
        needed = {id(run): run for plan in plans for k in together for run in plan[k] or ()}
        seen = observe(needed.values())
        records |= {(k, i): seen[i] for k in together for i in needed}
    out = []
    for case, plan in zip(cases, plans):
        findings = []
        for k, (relation, runs) in enumerate(zip(relations, plan)):
            if runs is None:
                findings.append(Finding(relation.name, None, relation.tolerance))
            else:
                findings.append(judged(relation, case, [records[k, id(run)] for run in runs]))
        out.append(findings)
    return out


Tallies = dict[tuple[str, str], Tally]


def redrawn(family: Family, seed: int, batch: int, number: int) -> Case:
    """The scene of that number in a batch of `referee`."""
    return list(family.draw(np.random.default_rng([seed, batch]), family.batch))[number]


def referee(
    families: Iterable[Family],
    scenes: int,
    seed: int,
    tallies: Tallies | None = None,
    batch: int = 0,
    done: int = 0,
    show: Callable[[str], None] = lambda _: None,
    keep: Callable[[Tallies, int, int], None] = lambda *_: None,
) -> list[Tally]:
    """About `scenes` scenes, shared out over the families, batch after batch: the k-th batch has the seed (seed, k).

    tallies, batch, done: what an earlier run left, to go on from there; keep: is called with these after every batch.
    """
    tallies = {} if tallies is None else tallies
    chosen = list(families)
    while done < scenes:
        family = chosen[batch % len(chosen)]
        start = time.perf_counter()
        cases = list(family.draw(np.random.default_rng([seed, batch]), family.batch))
        found = judge(cases, family.relations)
        took = time.perf_counter() - start
        for k, (case, findings) in enumerate(zip(cases, found)):
            for f in findings:
                tally = tallies.setdefault((family.name, f.relation), Tally(family.name, f.relation, f.tolerance))
                tally.seconds += took / (len(cases) * len(findings))
                if f.figure is None:
                    continue
                tally.scenes += 1
                tally.failures += f.fails
                if f.figure > tally.worst:
                    tally.worst, tally.worst_at, tally.worst_case = f.figure, (batch, k), case
        failures = sum(f.fails for findings in found for f in findings)
        show(f"{batch:4d} {family.name:20s} {len(cases):3d} scenes, {failures:3d} findings, {took:6.1f} s")
        done += len(cases)
        batch += 1
        keep(tallies, batch, done)
    return list(tallies.values())


def table(tallies: list[Tally]) -> str:
    """Family, relation, scenes, failures, worst figure, tolerance, seconds."""
    rows = [f"{'family':22s} {'relation':34s} {'scenes':>6s} {'fail':>5s} {'worst':>9s} {'allowed':>8s} {'s':>6s}"]
    for t in sorted(tallies, key=lambda t: (t.family, t.relation)):
        if t.scenes:
            rows.append(
                f"{t.family:22s} {t.relation:34s} {t.scenes:6d} {t.failures:5d} {t.worst:9.2g} {t.tolerance:8.1g}"
                f" {t.seconds:6.1f}"
            )
    return "\n".join(rows)
