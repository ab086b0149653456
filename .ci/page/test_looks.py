"""What a script can see of how the page looks: nothing is cut, and no two things lie on each other."""

from pathlib import Path

import pytest
from browser import OpenTab
from servers import Server
from states import explained, others

LOOKS = (Path(__file__).parent / "looks.js").read_text("utf-8")
SIZES = [(1440, 900), *(pytest.param(size, marks=pytest.mark.slow) for size in ((1920, 1080), (1024, 768)))]


@pytest.mark.parametrize("size", SIZES, ids=lambda size: f"{size[0]}x{size[1]}")
def test_nothing_is_cut_or_overlaps(demo: Server, open_tab: OpenTab, size: tuple[int, int]) -> None:
    found, looked = [], 0
    tab = open_tab(demo.address, viewport={"width": size[0], "height": size[1]}).drawn()
    tab.poll("getComputedStyle(document.querySelector('#tags .tag') ?? document.body).visibility === 'visible'")
    for states in (explained, others):
        for state in states(tab):
            tab.page.wait_for_timeout(200)  # until names stand where they stay
            found += [f"{state}: {one}" for one in tab.page.evaluate(LOOKS)]
            looked += 1
    assert looked >= 15
    assert not found, "\n".join(found)
