"""What a script can see of how the page looks: what is cut or overlaps (looks.js), and what axe-core finds."""

from collections.abc import Iterator
from importlib import resources
from pathlib import Path
from typing import Any

from browser import Tab, new_tab
from playwright.sync_api import Browser

LOOKS = (Path(__file__).parent / "looks.js").read_text("utf-8")
SIZES = ((1440, 900), (1920, 1080), (1024, 768))
STAGES = ("PARSE", "OPM", "LIFT", "SRM", "PRM", "LABEL")


def axe(tab: Tab, source: str) -> list[str]:
    """What axe-core finds against WCAG A and AA and good practice; the document of the scene's frame is viser's."""
    tab.page.evaluate(f"() => {{ if (!window.axe) {{ {source} }} }}")
    found: Any = tab.page.evaluate(
        "async () => (await axe.run({exclude: [['#view']]}, {iframes: false, resultTypes: ['violations']})).violations"
    )
    return [f"{v['id']}: {v['help']}: {node['html'][:160]}" for v in found for node in v["nodes"][:4]]


def states(tab: Tab) -> Iterator[str]:
    """Brings the page into one state after the other, and names it."""
    yield "answer with verdict"
    for name in STAGES:
        opened = f"#head-{name.lower()}[aria-expanded=true]"
        if not tab.page.locator(opened).count():
            tab.click(f"stage:{name}")
            tab.see(opened)
        yield f"stage {name}"
    tab.drawer("Edit")
    yield "what if"
    tab.drawer("Objects")
    tab.ask("unicorn left of the mug")
    tab.see("#side", "unicorn")
    yield "error"
    tab.press("x")
    tab.poll("document.getElementById('ask-text').value === ''")
    yield "empty"
    tab.press("h")
    tab.see("#dialog-window")
    yield "keys"
    tab.page.keyboard.press("Escape")
    tab.poll("!document.getElementById('dialog-window')")
    tab.click("task:evaluate")
    tab.see("#listing tr")
    yield "evaluate"
    tab.click("task:label")
    tab.see("#review-list .queue .q")
    tab.press("j")
    tab.see("#review-item .item")
    yield "label"
    tab.click("task:explain")
    tab.see("#stages .stage")


def check_looks(browser: Browser, address: str) -> None:
    """Nothing is cut or overlaps at three sizes; axe finds nothing, in both themes."""
    source = (resources.files("axe_playwright_python") / "axe.min.js").read_text("utf-8")
    found = []
    for width, height in SIZES:
        tab = new_tab(browser, viewport={"width": width, "height": height}).open(address).drawn()
        themes = ("dark", "light") if width == SIZES[0][0] else ("dark",)
        for theme in themes:
            if tab.page.evaluate("document.documentElement.dataset.theme") != theme:
                tab.press("m")
                tab.poll("theme => document.documentElement.dataset.theme === theme", theme)
            for state in states(tab):
                tab.page.wait_for_timeout(150)
                seen = tab.page.evaluate(f"[...({LOOKS}).cut(), ...({LOOKS}).overlap()]")
                seen += axe(tab, source) if len(themes) == 2 else []
                found += [f"{width} {theme} {state}: {one}" for one in seen]
        found += tab.problems
        tab.page.close()
    assert not found, "\n".join(found)
