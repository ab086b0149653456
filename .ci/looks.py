"""The states of the page one after the other, and what a script can see of how they look: what is cut or overlaps."""

import time
from collections.abc import Iterator
from pathlib import Path

from browser import Tab, new_tab
from playwright.sync_api import Browser

LOOKS = (Path(__file__).parent / "looks.js").read_text("utf-8")
SIZES = ((1440, 900), (1920, 1080), (1024, 768))


def explained(tab: Tab) -> Iterator[str]:
    """Brings the page into one state of Explain after the other, and names it."""
    yield "answer with verdict"
    for name in ("PARSE", "OPM", "LIFT", "SRM", "PRM", "LABEL"):
        opened = f"#head-{name.lower()}[aria-expanded=true]"
        if not tab.page.locator(opened).count():
            tab.click(f"stage:{name}")
            tab.see(opened)
        yield f"stage {name}"
    tab.drawer("Edit")
    yield "what if"
    tab.drawer("Objects")
    tab.ask("unicorn left of the mug")
    tab.see("#ask-problem", "unicorn")
    yield "refusal"
    tab.press("x")
    tab.poll("document.getElementById('ask-text').value === ''")
    tab.poll("!document.querySelector('#answer .heads')")
    yield "no question"
    tab.see(".menu>summary").click()
    yield "menu"
    tab.page.keyboard.press("Escape")
    tab.press("h")
    tab.see("#dialog-window")
    yield "keys"
    tab.page.keyboard.press("Escape")
    tab.poll("!document.getElementById('dialog-window')")
    tab.press("Shift+W")
    tab.see("#frame-grid .shot")
    yield "all frames"
    tab.page.keyboard.press("Escape")
    tab.click("frames-of:failed")
    yield "frames with failures"


def others(tab: Tab) -> Iterator[str]:
    """The same of the other tasks."""
    tab.click("task:evaluate")
    tab.see("#figures .falls")
    tab.poll("document.querySelectorAll('#rows .card').length > 3")
    yield "evaluate"
    tab.click("rows-view:table")
    tab.see("#rows [role=columnheader]", "verdict")
    yield "evaluate, table"
    tab.click("task:label")
    tab.see("#review-list .queue .q")
    yield "label"
    tab.press("j")
    tab.see("#review-item .task-item")
    yield "label, an item"


def check_looks(browser: Browser, address: str) -> None:
    """Nothing is cut or overlaps at three sizes."""
    found = []
    for width, height in SIZES:
        started = time.monotonic()
        tab = new_tab(browser, viewport={"width": width, "height": height}).open(address).drawn()
        tab.poll("getComputedStyle(document.querySelector('#tags .tag') ?? document.body).visibility === 'visible'")
        looked = 0
        for states in (explained, others):
            for state in states(tab):
                tab.page.wait_for_timeout(200)
                seen = tab.page.evaluate(LOOKS)
                found += [f"{width} {state}: {one}" for one in seen]
                looked += 1
        found += tab.problems
        tab.page.close()
        print(f"  {width}x{height}: {looked} states in {time.monotonic() - started:.0f} s", flush=True)
    assert not found, "\n".join(found)
