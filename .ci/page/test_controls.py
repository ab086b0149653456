"""How much there is to press at the first look, and how it is reached by keys."""

from browser import OpenTab
from controls import controls
from servers import Server

MOST, MOST_STOPS = 30, 24
"""In view at first load; and stops of Tab: of a group one, whose other members are reached by the arrows."""
FOCUS = "document.activeElement.textContent.trim()"


def test_the_first_look_has_few_controls(demo: Server, open_tab: OpenTab) -> None:
    tab = open_tab(demo.address).drawn()
    tab.see("#timeline button")
    found = [c for c in controls(tab) if c["control"]]
    stops = [c["name"] for c in found if c["stop"]]
    print(f"{len(found)} controls in view, {len(stops)} stops of Tab")
    assert len(found) <= MOST, [c["name"] for c in found]
    assert len(stops) <= MOST_STOPS, stops
    groups = {c["group"] for c in found if c["group"]}
    assert len(groups) >= 3, groups
    for group in groups:
        assert sum(c["stop"] for c in found if c["group"] == group) == 1, group


def test_a_group_is_one_stop_and_arrows_choose(demo: Server, open_tab: OpenTab) -> None:
    tab = open_tab(demo.address)
    tab.page.evaluate("document.activeElement.blur()")
    tab.page.keyboard.press("Tab")
    assert tab.page.evaluate(FOCUS).startswith("Skip to the")
    tab.page.keyboard.press("Enter")
    assert tab.page.evaluate("!!document.activeElement.closest('#scene-tools')")
    tab.page.locator(".steps [tabindex='0']").focus()
    before = tab.page.evaluate(FOCUS)
    tab.page.keyboard.press("ArrowRight")
    after = tab.page.evaluate(FOCUS)
    assert before != after
    tab.poll("document.activeElement.getAttribute('aria-expanded') === 'true'")
    tab.page.keyboard.press("Shift+Tab")
    tab.page.keyboard.press("Tab")
    assert tab.page.evaluate(FOCUS) == after, "Tab comes back to where the arrows went"
    tab.page.locator("#tasks [tabindex='0']").focus()
    tab.page.keyboard.press("ArrowRight")
    tab.poll("document.body.dataset.mode === 'evaluate'")
