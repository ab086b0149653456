"""What checks of labelling read on the page and in a journal."""

from contextlib import suppress

from browser import Tab

CLAIM = "document.querySelector('#review-item .claim')?.textContent"
SETTLED = "+(document.querySelector('#pace b')?.textContent ?? '').replace(/,/g, '')"


def boxes(found: list[dict]) -> list[dict]:
    return [e for e in found if e["field"] == "box"]


def object_shown(tab: Tab) -> None:
    """Open an item about an object, and wait until its three views have its points."""
    tab.click("queue-kind:object")
    # A detector may meanwhile put many items about what is not labelled before those about objects.
    find = tab.page.locator("#queue-find")
    find.fill("cut by the image border")
    shown = f"document.querySelector('#crop figcaption b')?.textContent === {CLAIM}"
    for _ in range(60):
        tab.press("j")
        with suppress(AssertionError):
            tab.poll(shown, seconds=2)
            break
    tab.poll(shown)
    find.fill("")
    tab.press("Escape")
    tab.see("#sides .side-view canvas")
    # The points may come after the words.
    tab.poll("document.getElementById('sides').dataset.of === document.querySelector('#crop figcaption b').textContent")
    tab.page.wait_for_timeout(1000)


def drawn_edge(tab: Tab) -> tuple[float, float]:
    """Where an edge of the box is drawn in the view from above."""
    edge = tab.page.evaluate("import('/app/sides.mjs').then(m => m.sideEdge('top', 0, 1))")
    return edge["x"], edge["y"]
