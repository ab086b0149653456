"""A correction session: what is done to the labels is what their journal tells, a reload included."""

import pytest
from browser import OpenTab, Tab
from playwright.sync_api import Locator
from recordings import LABELS, events
from servers import Server

FRAME, MUG, LAPTOP = "000001/000000", 3, 2
FIELD = "document.activeElement.tagName"
ITEM = "document.querySelector('#review-item .claim')?.textContent"


def state(tab: Tab, relation: str) -> str:
    """How a relation of the chosen pair is labelled."""
    return tab.see(f"#label-{relation} .tuf [aria-pressed=true]").inner_text()


def until_state(tab: Tab, relation: str, wanted: str) -> None:
    tab.see(f'#label-{relation} .tuf [aria-pressed=true]:text-is("{wanted}")')


def show_pair(tab: Tab) -> None:
    tab.send(f"labels-at:{MUG},{LAPTOP},left,{FRAME}")
    tab.see("#label-left")


def saved(tab: Tab, words: str) -> None:
    tab.see(".toast", words)


def labels_shown(tab: Tab) -> None:
    tab.see("[data-mode=label] #review-head input")


def handles(tab: Tab, name: str) -> Locator:
    """Wait until handles are of this kind; their switch."""
    return tab.see(f'#edit [aria-label*="andles"] [aria-checked=true]:text-is("{name}")')


@pytest.fixture
def labelled(corrected: Server, open_tab: OpenTab) -> Tab:
    """A tab that shows the demo's labels, for ann to correct."""
    tab = open_tab(corrected.address)
    labels_shown(tab)
    return tab


def test_a_review_by_keys(labelled: Tab) -> None:
    """Named labels are shown, their queue comes, keys act on the open item alone, and a doubt asks before it saves."""
    tab = labelled
    tab.see("#review-list .queue .q")
    tab.click("queue-kind:relation")
    tab.press("j")
    first = tab.see("#review-item .claim", " is ").inner_text()
    tops = [e["y"] for e in map(Locator.bounding_box, tab.page.locator("#decide button").all()) if e]
    show_pair(tab)
    tab.poll(f"text => {ITEM} !== text", first)
    tab.press("k")
    tab.press("j")
    tab.poll(f"text => {ITEM} === text", first)
    tab.drawer("Objects")
    tab.click(f"object:{LAPTOP}")
    tab.see("#review-pair", "Only looked at")
    tab.press("u")
    saved(tab, first.partition(" is ")[0])
    assert [e["y"] for e in map(Locator.bounding_box, tab.page.locator("#decide button").all()) if e] == tops
    tab.see(".toast .undo").click()
    saved(tab, "taken back")
    # The left of the laptop is its left by decimetres: the opposite is asked about, and Escape saves nothing.
    show_pair(tab)
    tab.click("settle:right:T")
    tab.see("#dialog-window", "Against geometry")
    tab.page.keyboard.press("Escape")
    tab.closed()
    assert state(tab, "right") == "F"


def test_fields_and_handles_are_left(labelled: Tab) -> None:
    """A field that was sent or left gives the keys back to the page; no handles stand in the labels' scene."""
    tab = labelled
    show_pair(tab)
    tab.press("Shift+E")
    tab.click("task:explain")
    tab.see('#stages [data-do^="stage:"]')
    tab.drawer("Edit")
    handles(tab, "Off")
    for key in ("Enter", "Escape"):
        tab.press("/")
        tab.poll(f"{FIELD} === 'INPUT'")
        if key == "Enter":
            tab.page.keyboard.type("mug left of the laptop")
        tab.page.keyboard.press(key)
        tab.poll(f"{FIELD} === 'BODY'")
    tab.page.keyboard.press("j")
    assert tab.question == "mug left of the laptop", tab.question
    tab.click("task:label")
    labels_shown(tab)


def test_the_journal_tells_what_was_done(labelled: Tab, corrected: Server) -> None:
    """A class, a box and a relation are corrected, taken back and done again; all of it outlasts a reload."""
    tab = labelled
    tab.see("#review-list .queue .q")
    show_pair(tab)
    tab.drawer("Edit")
    name = tab.see("input[data-field=class]")
    name.fill("bottle")
    name.press("Enter")
    saved(tab, "mug → bottle")
    width = tab.see("#edit label.field[title^='width'] input")
    width.fill("0.20")
    width.press("Enter")
    saved(tab, "3D box of bottle")
    before = state(tab, "left")
    flipped = {"T": "F", "F": "T", "U": "T"}[before]
    # A key goes to the page only where no field is being typed into.
    tab.press(flipped.lower())
    until_state(tab, "left", flipped)
    tab.press("Control+z")
    until_state(tab, "left", before)
    tab.press("Control+y")
    until_state(tab, "left", flipped)
    tab.page.reload()
    labels_shown(tab)
    show_pair(tab)
    assert state(tab, "left") == flipped
    assert tab.page.locator("#label-left").get_by_text("by hand").count() == 1
    assert tab.page.locator("#review-pair summary", has_text=f"bottle {MUG}").count()

    number = {"T": 1, "U": 0, "F": -1}
    pair, mirror = f"{MUG},{LAPTOP}", f"{LAPTOP},{MUG}"
    told = events(LABELS, "--journal", corrected.journal)
    of_pair = [e for e in told if e["key"] in (str(MUG), pair, mirror)]
    story = [(e["action"], e["key"], e["field"], e["after"]) for e in of_pair if e["field"] != "box"]
    wanted = [("edit", str(MUG), "label", "bottle")]
    for action, after in (("edit", flipped), ("undo", before), ("redo", flipped)):
        wanted += [(action, pair, "left", number[after]), (action, mirror, "right", number[after])]
    assert story == wanted, (story, wanted)
    (box,) = (e for e in of_pair if e["field"] == "box")
    assert (box["action"], box["key"], box["id"]) == ("edit", str(MUG), of_pair[0]["id"] + 1), box
    assert abs(box["after"]["size"][0] - 0.20) < 1e-6, box["after"]
    assert {e["author"] for e in told} == {"ann"}
