"""Ten tasks, each counted in keys, clicks, drags and letters typed; docs/tasks.md has the table.

pytest -s .ci/page/test_counted_tasks.py

Each task begins where the one before has left off, or where its text says, and is done when the page shows its result.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest
from browser import OpenTab, Tab
from labelling import CLAIM, boxes, drawn_edge, object_shown
from recordings import LABELS, events
from servers import Server

DOCUMENT = Path(__file__).parents[2] / "docs" / "tasks.md"
QUESTION = "mug left of the laptop"
WHOLE = """() => {
  const e = document.querySelector('#answer .why'), s = e && getComputedStyle(e);
  return e && e.textContent.trim().length > 20 && s.textOverflow !== 'ellipsis'
    && e.scrollWidth <= e.clientWidth + 1 && e.scrollHeight <= e.clientHeight + 1
    && e.getBoundingClientRect().bottom <= innerHeight && e.textContent;
}"""


@dataclass
class Counted:
    """A tab whose keys, clicks, drags and letters are counted."""

    tab: Tab
    open_tab: OpenTab
    keys: int = 0
    clicks: int = 0
    drags: int = 0
    letters: int = 0

    def press(self, key: str) -> None:
        self.keys += 1
        self.tab.page.keyboard.press(key)

    def click(self, selector: str, words: str = "") -> None:
        self.clicks += 1
        self.tab.see(selector, words).click()

    def type(self, text: str) -> None:
        self.letters += len(text)
        self.tab.page.keyboard.type(text)

    def drag(self, x: float, y: float, dx: float, dy: float) -> None:
        self.drags += 1
        mouse = self.tab.page.mouse
        mouse.move(x, y)
        mouse.down()
        mouse.move(x + dx, y + dy, steps=4)
        mouse.up()

    @property
    def told(self) -> str:
        counts = {"key": self.keys, "click": self.clicks, "drag": self.drags, "letter": self.letters}
        return ", ".join(f"{n} {what}{'s' if n > 1 else ''}" for what, n in counts.items() if n) or "nothing"


def next_failure(c: Counted) -> None:
    was = c.tab.question
    c.press(".")
    c.tab.poll("was => document.getElementById('ask-text').value !== was", was)
    c.tab.see("#answer .why:is(.bad, .doubt)")


def read_why(c: Counted) -> None:
    c.tab.poll(WHOLE)
    c.tab.see("#stages [aria-expanded=true]")


def next_pair(c: Counted) -> None:
    c.press("j")
    c.tab.poll("new URLSearchParams(location.search).get('pair') === '2'")


def ask(c: Counted) -> None:
    c.press("/")
    c.type(QUESTION)
    c.press("Enter")
    c.tab.answers(*QUESTION.split(" left of the "))


def share(c: Counted) -> None:
    c.tab.poll("asked => new URLSearchParams(location.search).get('ask') === asked", QUESTION)
    c.press("Control+c")
    c.tab.see("#toasts", "the address of this view")
    address = c.tab.page.evaluate("navigator.clipboard.readText()")
    other = c.open_tab(address, "absent")
    other.poll("asked => document.getElementById('ask-text').value === asked", QUESTION)
    assert other.frame == c.tab.frame


def narrow(c: Counted) -> None:
    c.click("#tasks [data-do='task:evaluate']")
    value = c.tab.see("#facet-verdict .value", "OPM-REF")
    count = value.locator(".n").inner_text()
    c.click("#facet-verdict .value", "OPM-REF")
    c.tab.poll("n => document.querySelector('#found-bar .count b')?.textContent === n", count)
    c.tab.see("#rows .expr:not(.wait)")


def second_broke(c: Counted) -> None:
    c.click("#filters .try", "what the second run broke")
    c.tab.poll("location.search.includes('change:broken') || location.search.includes('change%3Abroken')")
    c.tab.see("#rows .expr:not(.wait)")


def settle(c: Counted) -> None:
    was = c.tab.poll(CLAIM)
    c.press("y")
    c.tab.poll(f"was => {CLAIM} && {CLAIM} !== was", was)


def edit_box(c: Counted) -> None:
    c.drag(*drawn_edge(c.tab), 18, 0)
    c.tab.see(".toast", "3D box")


def fix_mask(c: Counted) -> None:
    c.press("Shift+I")
    canvas = c.tab.see(".pixels canvas")
    b = canvas.bounding_box()
    assert b is not None
    c.tab.page.wait_for_timeout(500)
    c.drag(b["x"] + b["width"] * 0.5, b["y"] + b["height"] * 0.5, 30, 12)
    c.tab.see(".pixels .info", "points")
    c.press("Enter")
    c.tab.poll("!document.querySelector('.pixels')")


TASKS: dict[str, Callable[[Counted], None]] = {
    "next failure": next_failure,
    "read why": read_why,
    "next pair": next_pair,
    "ask": ask,
    "share a view": share,
    "filter (from Explain)": narrow,
    "find what a second run broke": second_broke,
    "settle a label": settle,
    "edit a box": edit_box,
    "fix a mask": fix_mask,
}


def prepare(tab: Tab, name: str) -> None:
    """What a task begins with, where that is not what the one before has left."""
    if name == "find what a second run broke":
        tab.click("find:")
    if name == "settle a label":
        tab.click("task:label")
        tab.poll("document.querySelector('#review-list .queue .q')", seconds=120)
        tab.click("queue-kind:relation")
        tab.press("j")
    if name == "edit a box":
        object_shown(tab)


@pytest.mark.slow
def test_each_task_takes_what_the_table_says(compared: Server, open_tab: OpenTab) -> None:
    before = len(events(LABELS, "--journal", compared.journal))
    tab = open_tab(compared.address, permissions=["clipboard-read", "clipboard-write"]).drawn()
    told = []
    for name, task in TASKS.items():
        prepare(tab, name)
        counted = Counted(tab, open_tab)
        task(counted)
        told.append(f"| {name} | {counted.told} |")
    print("", *told, sep="\n")
    made = events(LABELS, "--journal", compared.journal)[before:]
    assert len(boxes(made)) == 1, boxes(made)
    assert any(e["field"] == "mask" for e in made), "the mask is not saved"
    table = DOCUMENT.read_text("utf-8")
    assert not [row for row in told if row not in table], "docs/tasks.md says otherwise"
