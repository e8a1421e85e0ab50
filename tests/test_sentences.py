"""Sentences of the docs: none is longer than a reader can hold, and none uses words that only this project's authors use."""

import re
from pathlib import Path

import pytest

pytestmark = pytest.mark.once

DOCS = Path(__file__).parent.parent / "docs"
PAGES = sorted(DOCS.rglob("*.md"))
MOST_WORDS = 40
PRIVATE = {  # words that readers stumble over: what to write in their place
    r"(?:is|are|was|were) (?:told|said)(?! to)": "reports, prints, names",
    "but for": "except",
    "none more than": "no ... more than",
    "what is left out": "what it is, by name",
    "what moves": "what it is, by name",
    "reckoned": "counted",
    "wherefrom": "where ... from",
    "anew": "again",
    "besides": "also",
    "goes first": "overrides",
    "takes its place altogether": "replaces it",
}
TAG = re.compile(r"</?[a-z]+[^>]*>|<!--.*?-->", re.DOTALL)


def plain(text):
    """Words of a page without programs, formulas, tags and addresses; `x` counts as one word."""
    text = re.sub(r"^(\s*)(```|~~~).*?^\s*\2\s*$", "\n\n", text, flags=re.DOTALL | re.MULTILINE)
    text = re.sub(r"\$\$.*?\$\$", " ", text, flags=re.DOTALL)
    text = re.sub(r"`[^`]*`", "code", text)
    text = TAG.sub(" ", text)
    return re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", text)


def sentences(text):
    """Sentences of a page; paragraphs, points of a list, headings and cells of a table end one."""
    for block in re.split(r"\n\s*\n|\n(?=\s*(?:[-*]|\d+\.) )|\n(?=\|)|\n(?=#)|(?<=\|)\n", plain(text)):
        for cell in block.split("|") if block.lstrip().startswith("|") else [block]:
            yield from re.split(r"(?<=[.!?])[)*\"]*\s+", " ".join(cell.split()))


def test_sentences_are_told_apart():
    text = "One two. Three (four.) Five\n- six: seven\n\n| a | b c |\n\n```\nno sentence\n```\n`x y z` is, see [a page](x.md).\n"
    assert [one for one in sentences(text) if one] == [
        "One two.",
        "Three (four.",
        "Five",
        "- six: seven",
        "a",
        "b c",
        "code is, see a page.",
    ]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(DOCS).as_posix())
def test_no_sentence_is_too_long(page):
    found = [
        (len(one.split()), one) for one in sentences(page.read_text(encoding="utf-8")) if len(one.split()) > MOST_WORDS
    ]
    assert not found


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(DOCS).as_posix())
def test_no_word_is_private(page):
    text = " ".join(plain(page.read_text(encoding="utf-8")).split())
    for word, instead in PRIVATE.items():
        found = re.search(rf"\b{word}\b", text, re.IGNORECASE)
        assert not found, f"{text[max(0, found.start() - 60) : found.end() + 30]!r}: write {instead}"
