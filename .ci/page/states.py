"""The states of the page, one after the other."""

from collections.abc import Iterator

from browser import Tab

MENUS = {"Share": "#tools .menu:first-child", "More": "#tools .menu:last-child", "Show": "#show"}


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
    tab.see("#answer", "unicorn")
    yield "refusal"
    tab.press("x")
    tab.poll("document.getElementById('ask-text').value === ''")
    tab.poll("!document.querySelector('#answer .heads')")
    yield "no question"
    tab.press("Escape")
    tab.poll("document.getElementById('drawer').classList.contains('closed')")
    for name, menu in MENUS.items():
        tab.see(f"{menu}>summary").click()
        yield f"menu {name}"
        tab.page.keyboard.press("Escape")
    tab.press("h")
    tab.see("#dialog-window")
    yield "keys"
    tab.page.keyboard.press("Escape")
    tab.closed()
    tab.press("Shift+W")
    tab.see("#frame-grid .shot")
    tab.poll("!!document.querySelector('#frame-grid .camera')")
    yield "all frames"
    tab.see("[data-local='framesOf:with failures']").click()
    yield "frames with failures"
    tab.page.keyboard.press("Escape")
    tab.see("#frame-bar").focus()
    tab.page.keyboard.press("ArrowRight")
    tab.see(".passing figcaption", "wrong")
    yield "a frame in passing"
    tab.page.keyboard.press("Escape")


def others(tab: Tab) -> Iterator[str]:
    """The same of the other tasks."""
    tab.click("task:evaluate")
    tab.see("#figures .falls")
    tab.poll("document.querySelectorAll('#rows .tile').length > 3")
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
