"""The page of published tests names every test, and every test can be measured."""

import pytest

from tests.published.page import PAGE, modules, title_and_text

pytestmark = pytest.mark.once


def test_the_page_names_every_test():
    page = PAGE.read_text()
    for name, module in modules().items():
        title, text = title_and_text(module)
        assert f"## {title}\n" in page, f"{name}: run `make published`"
        assert text in page, f"{name}: run `make published`"
        assert callable(module.measure)
