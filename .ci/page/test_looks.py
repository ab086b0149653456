"""What a script can see of how the page looks: nothing is cut, no two things lie on each other, five sizes of type."""

from pathlib import Path

import pytest
from browser import OpenTab
from servers import Server
from states import explained, others

LOOKS, TYPES = ((Path(__file__).parent / f"{name}.js").read_text("utf-8") for name in ("looks", "type"))
SIZES_OF_TYPE = {"24 650", "16 400", "14 600", "13 400", "12 400"}
"""Pixels and weight, as --t1 to --t5 of theme.css; names drawn in the picture are of its own units."""
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
            types = tab.page.evaluate(TYPES)
            found += [f"{state}: type {kind}: {who[:3]}" for kind, who in types if kind not in SIZES_OF_TYPE]
            looked += 1
    assert looked >= 15
    assert not found, "\n".join(found)
