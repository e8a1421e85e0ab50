"""What `help` shows of a public name can be read."""

import inspect

import pytest

import taichi_sim as ts

pytestmark = pytest.mark.once


def public():
    for name in ts.__all__:
        found = getattr(ts, name)
        if inspect.ismodule(found):
            found = type(name, (), {one: getattr(found, one) for one in found.__all__})
        if inspect.isfunction(found):
            yield name, found
        elif inspect.isclass(found):
            for method, function in inspect.getmembers(found, inspect.isfunction):
                if method == "__init__" or not method.startswith("_"):
                    yield f"{name}.{method}", function


def test_signatures_name_what_numpy_spells_out():
    walls = [name for name, function in public() if "numpy._typing" in str(inspect.signature(function))]
    assert not walls
    assert len(list(public())) > 50
