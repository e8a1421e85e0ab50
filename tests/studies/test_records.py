"""Records of a study are read back as they were, and no damage passes for one."""

from dataclasses import dataclass

import numpy as np
import pytest

from taichi_sim.studies.records import arrays_of, lines_of, packed, rows_of, table_of

pytestmark = pytest.mark.once


@dataclass(frozen=True)
class Reading:
    name: str
    value: float
    seed: int | None = None


READINGS = [Reading("tension", 12.5), Reading("Länge", 1e-300, 7), Reading('"a"\n', float("inf"), 0)]


def test_rows_are_read_as_they_were_kept():
    assert rows_of(lines_of(READINGS), Reading) == READINGS


def test_no_changed_character_of_a_row_passes():
    """A row with one character changed is refused, or says the same: a letter of an escape in the other case."""
    data = lines_of(READINGS[:2])
    refused = 0
    for place in range(len(data)):
        for other in b"7 x":
            changed = data[:place] + bytes([other]) + data[place + 1 :]
            try:
                assert rows_of(changed, Reading) == READINGS[:2]
            except (ValueError, TypeError):
                refused += 1
    assert refused > 2 * len(data)


@pytest.mark.parametrize("data", [b"", b"{}", b"{}\n", b"[1]\n", b'{"name": "a"}\n', lines_of(READINGS)[:-1]])
def test_what_is_no_row_is_refused(data):
    with pytest.raises(ValueError, match=r"checksum|no table|not complete"):
        rows_of(data, Reading)


def test_arrays_numbers_and_texts_are_read_as_they_were_kept(tmp_path):
    given = {"x": np.arange(6.0).reshape(3, 2), "none": None, "empty": [], "name": "rk4", "n": 3, "h": 0.1, "on": True}
    (tmp_path / "a.npz").write_bytes(packed(given))
    found = arrays_of(tmp_path / "a.npz")
    np.testing.assert_array_equal(found.pop("x"), given["x"])
    assert len(found.pop("empty")) == 0
    assert found == {"name": "rk4", "n": 3, "h": 0.1, "on": True}


def test_a_table_holds_no_formula():
    assert table_of({"name": ["=1+1", "b"], "value": [None, 0.1]}) == b"name,value\n'=1+1,\nb,0.1\n"
