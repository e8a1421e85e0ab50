"""The rows of each published test hold."""

import pytest

from tests.published.common import hold
from tests.published.page import modules

QUICK = ("billiard", "elastic_pendulum", "falling_slinky")


def cases():
    """Each module without tests of its own; what is quick, or a mean of random starts, is measured in one precision."""
    for name, module in modules().items():
        if not any(other.startswith("test_") for other in vars(module)):
            marks = [] if name in QUICK else [pytest.mark.long]
            marks += [pytest.mark.once] if name in QUICK or hasattr(module, "CHAOTIC") else []
            marks += [pytest.mark.xfail(strict=True, reason=module.CAUSE)] if hasattr(module, "CAUSE") else []
            yield pytest.param(module, id=name, marks=marks)


@pytest.mark.parametrize("module", list(cases()))
def test_published(module):
    hold(list(module.measure()))
