"""The loops of docs/gallery.md are there, small, three seconds long, each with its command."""

from pathlib import Path

import pytest
from PIL import Image

from taichi_sim.files.source import demos
from tests.support.gallery import FOLDER, LOOPS, MOST_BYTES, MOST_IN_ALL, command

pytestmark = pytest.mark.once


@pytest.mark.parametrize("name", LOOPS)
def test_a_loop_lasts_three_seconds_and_is_small(name):
    file = FOLDER / f"{name}.webp"
    assert name in demos()
    assert file.stat().st_size < MOST_BYTES
    with Image.open(file) as loop:
        assert loop.info["loop"] == 0
        shown = 0
        for k in range(loop.n_frames):
            loop.seek(k)
            loop.load()
            shown += loop.info["duration"]
    assert shown == 3000


def test_the_page_shows_them_with_their_commands():
    page = (Path(__file__).parent.parent / "docs" / "gallery.md").read_text()
    for name in LOOPS:
        assert f"(gallery/{name}.webp)" in page
    assert f"taichi-sim {' '.join(command('NAME'))}" in page
    assert sorted(file.stem for file in FOLDER.glob("*.webp")) == sorted(LOOPS)
    assert sum(file.stat().st_size for file in FOLDER.glob("*.webp")) < MOST_IN_ALL
