"""A few hundred of the cases that `make fuzz` makes thousands of."""

import pytest

from tests.fuzz import mesh_files, scene_files, state_files
from tests.fuzz.__main__ import Found, run

pytestmark = pytest.mark.once


@pytest.mark.parametrize(("module", "cases"), [(scene_files, 150), (state_files, 100), (mesh_files, 100)])
def test_what_is_read_or_refused_in_one_sentence(tmp_path, module, cases):
    scene_files.prepare(tmp_path)
    strategy = module.cases(*state_files.whole(tmp_path)) if module is state_files else module.cases
    found = Found(tmp_path)
    run(found, "fuzz", strategy, module.judge, cases, 0)
    assert not found.faults
    assert found.counts["fuzz", "read"] > 0
    assert found.counts["fuzz", "refused"] > cases / 4
