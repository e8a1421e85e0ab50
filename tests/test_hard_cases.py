"""Hard cases: the quick ones in every run, all of them in their long form when there is time."""

import pytest
from conftest import PRECISION

from taichi_sim.reports import hard_cases

QUICK = (("everything pinned", 2), ("empty scene", 2), ("corner of three walls", 2), ("negative coordinates", 1))
CASES = {case.name: case for case in hard_cases.CASES}
# what is known to fail, by the words that say why; a row leaves this table when it passes
NO_SWEPT_TEST = ("bullet, 10 radii a step, at a ball", "bullet, 10 radii a step, at a stick")


def test_quick_hard_cases():
    """Each of the quick ones, in its short form."""
    for name, rules in QUICK:
        for contacts in hard_cases.RULES[:rules]:
            verdict = hard_cases.judge(CASES[name], contacts, short=True)
            assert verdict.passed, f"{name}, {contacts}: {verdict.figure:.3g} {verdict.words}"


def test_a_case_that_raises_has_failed():
    def broken(contacts, short):
        raise ZeroDivisionError("of zero")

    verdict = hard_cases.judge(hard_cases.Case("broken", "nothing", broken), "jacobi")
    assert not verdict.passed
    assert verdict.words == "ZeroDivisionError: of zero"


def test_the_table_fails_when_a_case_fails_with_every_rule(capsys):
    one = hard_cases.Case(
        "one", "pass once", lambda contacts, short: hard_cases.Verdict(contacts == "jacobi", 1.0, "a")
    )
    none = hard_cases.Case("none", "pass", lambda contacts, short: hard_cases.Verdict(False, 2.0, "b"))
    endless = hard_cases.Case("endless", "end", lambda contacts, short: hard_cases.Verdict(True, float("nan"), "c"))
    assert hard_cases.main([one])
    assert not hard_cases.main([one, none])
    assert not hard_cases.main([endless])
    shown = capsys.readouterr().out
    assert "pass once" in shown
    assert "FAIL" in shown


@pytest.mark.slow
@pytest.mark.parametrize("contacts", hard_cases.RULES)
@pytest.mark.parametrize("name", [name for name in CASES if name not in (*NO_SWEPT_TEST, "1e6 balls in one cell")])
def test_hard_case(name, contacts):
    if PRECISION == "f32" and name in ("radius 1e-4 m in a 1e4 m world",):
        pytest.skip("single precision tells such places 1e-3 m apart, and says so")
    verdict = hard_cases.judge(CASES[name], contacts)
    assert verdict.passed, f"{verdict.figure:.3g} {verdict.words}"
