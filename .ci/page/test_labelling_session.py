"""Labelling: items settled by keys, an edge dragged, many accepted, a bare recording labelled.

What the page did is what the journal tells: it is read by the command line.
"""

import re
from collections import Counter
from pathlib import Path

import pytest
from browser import OpenTab, Tab
from labelling import CLAIM, SETTLED, boxes, drawn_edge, object_shown
from recordings import LABELS, events
from servers import Server


@pytest.fixture
def review(reviewed: Server, open_tab: OpenTab) -> Tab:
    """A tab that reviews the demo's labels, with its queue."""
    tab = open_tab(reviewed.address).drawn()
    tab.click("task:label")
    tab.poll("document.querySelector('#review-list .queue .q')", seconds=120)
    return tab


def test_items_are_settled_by_one_key_each(review: Tab, reviewed: Server) -> None:
    """Five of them; each settled one opens the next."""
    tab, before = review, len(events(LABELS, "--journal", reviewed.journal))
    settled = tab.page.evaluate(SETTLED)
    tab.click("queue-kind:relation")
    tab.press("j")
    seen = []
    for n in range(5):
        seen.append(tab.poll(CLAIM))
        assert tab.see("#review-item .because").inner_text().strip(), "no reason is told"
        tab.page.keyboard.press("y")
        tab.poll(f"claim => {CLAIM} !== claim", seen[-1])
        tab.poll(f"n => {SETTLED} > n", settled + n)
    assert len(set(seen)) == 5, seen
    assert len({e["group"] for e in events(LABELS, "--journal", reviewed.journal)[before:]}) == 5


THRICE = """() => {
  for (const repeat of [false, true, false]) dispatchEvent(new KeyboardEvent('keydown', {key: 'y', repeat}));
}"""


def test_an_answer_is_to_what_is_shown(review: Tab, reviewed: Server) -> None:
    """A key that is pressed again before the next item is shown answers nothing, nor does one that is held down."""
    tab, before = review, len(events(LABELS, "--journal", reviewed.journal))
    tab.click("queue-kind:relation")
    tab.press("j")
    item = tab.still("document.querySelector('#review-item [data-asked]')?.dataset.asked")
    tab.page.evaluate(THRICE)
    tab.see(".toast.bad", "had not been shown yet").locator(".close").click()
    made = events(LABELS, "--journal", reviewed.journal)[before:]
    assert made, "the first press is an answer"
    assert len({e["group"] for e in made}) == 1, made
    assert {e["frame"] for e in made} == {item.split(" ")[0]}, (item, made)
    tab.press("Control+z")
    tab.see(".toast", "taken back")


GONE = """core => {
  const field = document.querySelector("#edit label.field[title^='width'] input");
  field.focus();
  field.value = (Number(field.value) + 0.01).toFixed(3);
  core.patch([['edit', '<div id="edit"></div>']]);
  const ask = document.getElementById('ask-text'), heard = [];
  for (const field of [ask, document.body]) {
    field.focus();
    if (field !== ask) ask.blur();
    heard.push(dispatchEvent(new KeyboardEvent('keydown', {key: '5', cancelable: true})));
  }
  dispatchEvent(new KeyboardEvent('keydown', {key: 'y'}));
  return heard;
}"""


def test_a_letter_is_a_key_where_a_field_went(review: Tab, reviewed: Server) -> None:
    """What may still be typed into a number is no key of the page; an answer that follows it is one."""
    tab, before = review, len(events(LABELS, "--journal", reviewed.journal))
    tab.click("queue-kind:relation")
    tab.press("j")
    first = tab.still(CLAIM)
    tab.drawer("Edit")
    tab.see("#edit label.field[title^='width'] input")
    heard = tab.page.evaluate(f"import('/app/core.mjs').then({GONE})")
    assert heard == [True, False], "a digit goes into another field that has the focus, and nowhere else"
    tab.poll(f"claim => {CLAIM} !== claim", first)
    made = events(LABELS, "--journal", reviewed.journal)[before:]
    assert any(e["field"] != "box" for e in made), made
    assert not any(e["field"] == "class" for e in made), made


def test_undo_brings_the_item_back(review: Tab) -> None:
    """The one that was answered, open as before."""
    tab = review
    tab.click("queue-kind:relation")
    tab.press("j")
    tab.see("#review-item .task-item")
    first = tab.still(CLAIM)
    tab.page.keyboard.press("y")
    tab.poll(f"claim => {CLAIM} !== claim", first)
    tab.press("Control+z")
    tab.poll(f"claim => {CLAIM} === claim", first)
    tab.see(".toast", "taken back")


def test_an_edge_is_dragged(review: Tab, reviewed: Server) -> None:
    """An edge of a side view is drawn outwards: the box of the labels grows by as much; one undo takes it back."""
    tab, before = review, len(events(LABELS, "--journal", reviewed.journal))
    object_shown(tab)
    size = "[...document.querySelectorAll('#sides .side-view figcaption span')].map(e => e.textContent)[0]"
    was = tab.poll(size)
    x, y = drawn_edge(tab)
    mouse = tab.page.mouse
    mouse.move(x, y)
    mouse.down()
    mouse.move(x + 18, y, steps=4)
    assert tab.poll(f"was => {size} !== was && {size}", was), "the box does not follow the hand"
    mouse.up()
    tab.see(".toast", "3D box")
    (made,) = boxes(events(LABELS, "--journal", reviewed.journal)[before:])
    grown = [round(a - b, 4) for a, b in zip(made["after"]["size"], made["before"]["size"], strict=True)]
    assert sum(g > 0.005 for g in grown) == 1, grown
    assert sum(abs(g) < 1e-6 for g in grown) == 2, grown
    tab.press("Control+z")
    tab.see(".toast", "taken back")
    tab.poll(f"was => {size} === was", was)
    # Tab walks the objects while the views have the focus, and Escape leaves them.
    tab.page.locator("#sides").focus()
    name = "document.querySelector('#crop figcaption b').textContent"
    was = tab.poll(name)
    tab.page.keyboard.press("Tab")
    tab.poll(f"was => {name} !== was", was)
    tab.page.keyboard.press("Shift+Tab")
    tab.poll(f"was => {name} === was", was)
    tab.page.keyboard.press("Escape")
    tab.poll("document.activeElement.closest('#decide')")


def test_many_are_accepted_as_one_step(review: Tab, reviewed: Server) -> None:
    """All that a filter finds; one undo takes it back."""
    tab = review
    tab.click("queue-kind:relation")
    before = tab.still(SETTLED)
    tab.page.locator("#queue-find").fill("left 000002")
    accept = tab.see('[data-do="accept-found"]:not([disabled])')
    found = int(accept.inner_text().split()[1].replace(",", ""))
    assert found > 3, found
    listed = tab.page.locator("#queue-rows .q").all_inner_texts()
    assert listed
    assert all("000002" in row for row in listed), listed
    accept.click()
    tab.poll(f"wanted => {SETTLED} >= wanted", before + found)
    groups = [e["group"] for e in events(LABELS, "--journal", reviewed.journal)]
    assert len(set(groups[-found:])) == 1, "not one step"
    tab.press("Control+z")
    tab.poll(f"wanted => {SETTLED} === wanted", before)
    tab.page.locator("#queue-find").fill("")
    tab.press("Escape")


def outline(tab: Tab, name: str, corners: tuple[float, float, float, float]) -> None:
    """Outline a thing by a rectangle of the picture, and type its name."""
    tab.send(f"px-new:{','.join(map(str, corners))}")
    field = tab.see(".pixels input.cls")
    tab.see(".pixels .info", "points")
    field.fill(name)
    field.press("Enter")
    tab.poll("!document.querySelector('.pixels')")


def test_a_recording_that_nobody_labelled(bare: Server, open_tab: OpenTab) -> None:
    """Two things are outlined and named; their relation follows by geometry."""
    labels = bare.folder / "rec-labels"
    tab = open_tab(bare.address).drawn()
    tab.click("task:label")
    tab.see("#review-item", "Nothing is labelled")
    assert not labels.exists(), "looking writes nothing"
    outline(tab, "mug", (0.34, 0.44, 0.42, 0.54))
    assert labels.exists(), "not saved from the first stroke"
    outline(tab, "laptop", (0.43, 0.38, 0.60, 0.56))
    names = [e["after"] for e in events(labels) if e["field"] == "label"]
    assert names == ["mug", "laptop"], names
    # The two that were outlined are a pair, whose relations follow from their geometry.
    tab.see("#review-pair .tuf")
    assert "laptop" in tab.see("#review-pair summary").inner_text()


def test_evaluate_says_what_it_needs(bare: Server, open_tab: OpenTab) -> None:
    """Of a recording without a run: the commands that make one."""
    tab = open_tab(bare.address, "absent")
    tab.click("task:evaluate")
    told = tab.see("#evaluate .norun").inner_text()
    assert f"spatialviz eval {bare.folder / 'rec'} --labels" in told, told
    assert "spatialviz view --run RUN" in told, told
    assert not tab.page.locator("#facets:visible, #rows:visible").count()


def judge(tab: Tab, frame: str, fails: bool) -> str:
    """*This pair is correct* under an answer gives its verdict at once; where it `fails`, another pair is right."""
    tab.page.locator("#timeline .frame-id").fill(frame)
    tab.page.locator("#timeline .frame-id").press("Enter")
    tab.poll("frame => document.title.includes(` ${frame} `)", frame)
    tab.poll("!document.getElementById('working').textContent")
    # Names of the shown answer count twice.
    if not tab.page.locator("#objects b:visible").count():
        tab.drawer("Objects")
        tab.see("#objects b")
    of = "[...document.querySelectorAll('#objects b, #answer .thing b')].map(e => e.textContent)"
    things = [re.sub(r"[· ][0-9]+$", "", thing) for thing in tab.still(of)]
    # The most frequent name may mean several things, the next one fewer.
    names = [name for name, _ in Counter(things).most_common()]
    text = f"{names[0]} left of the {names[1]}"
    tab.ask(text)
    offer = f"[data-do^='right-pair:{frame} '][data-do$=' {text}']"
    offered = tab.page.locator(offer)
    refused = "document.getElementById('verdict')?.textContent.startsWith('Could not')"
    tab.poll(f'document.querySelector("{offer}") || {refused}')
    if not offered.count():
        return "no pair"
    if fails and not tab.page.locator("tr[id^=pair-]").count():
        tab.send("stage:PRM")
        tab.see("tr[id^=pair-]")
    targets = tab.page.locator("tr[id^=pair-] .w>div:first-child").all_inner_texts() if fails else []
    # The first pair with another target.
    other = next((k for k, target in enumerate(targets) if target != targets[0]), 0)
    for _ in range(other):
        tab.press("j")
    if fails:
        tab.poll("k => document.querySelector(`#pair-${k}[aria-current]`)", str(other))
    # Where a truth is known it is one of two ways in a menu.
    offered.evaluate("e => e.click()")
    tab.see("#right-pair", "kept as correct")
    told = tab.see("#answer .sub").inner_text()
    verdict = "CORRECT" if "CORRECT" in told else told
    assert (verdict == "CORRECT") == (not other), (frame, targets, verdict)
    return verdict


@pytest.mark.parametrize(
    "frames", [range(4), pytest.param(range(4, 10), marks=pytest.mark.slow)], ids=["first", "others"]
)
def test_answers_are_judged(bare: Server, open_tab: OpenTab, frames: range) -> None:
    """Frame by frame; of every third one it is another pair that is right: the answer fails then."""
    labels = bare.folder / "rec-labels"
    before = len(judged(labels))
    tab = open_tab(f"{bare.address}/?mode=explain").drawn()
    verdicts = {n: judge(tab, f"{n:04d}", fails=n % 3 == 2) for n in frames}
    made = [verdict for verdict in verdicts.values() if verdict != "no pair"]
    assert len(made) >= len(frames) - 1, verdicts
    assert len(set(made)) > 1, f"nothing failed: {verdicts}"
    assert len(judged(labels)) - before == len(made)


def judged(labels: Path) -> list[dict]:
    """The sentences that were judged to be true, by the journal."""
    return [e for e in events(labels) if e["field"] == "exists" and e["kind"] == "expression"]


def test_an_object_is_followed_through_its_frames(mapped: Server, open_tab: OpenTab) -> None:
    """Its crops stand beside its numbers; a click and a key show it there, and its own crop is marked."""
    tab = open_tab(f"{mapped.address}/?frame=000001/000000&mode=label", scene="absent")
    tab.see("[data-mode=label] #review-head input")
    tab.drawer("Edit")
    tab.send("object-at:2:000001/000000")
    crops = tab.page.locator("#edit .sighting")
    tab.see("#edit .sighting.shown")
    assert crops.count() == 3
    assert crops.nth(2).get_attribute("title") == "laptop 1 in 000001/000002"
    crops.nth(2).click()
    assert tab.other_frame("000001/000000") == "000001/000002"
    tab.see("#edit h2", "laptop 1")
    tab.press("Shift+Z")
    assert tab.other_frame("000001/000002") == "000001/000001"
    tab.see("#edit .sighting.shown[title='laptop 2 in 000001/000001']")
    sides = tab.page.evaluate(
        "[...document.querySelectorAll('#edit .sighting')].map(e => e.getBoundingClientRect().top)"
    )
    assert len(set(sides)) == 1, "in one row"
    widths = "[...document.querySelectorAll('#edit .sighting img')].map(e => e.naturalWidth)"
    tab.poll(f"{widths}.every(w => w > 0)")


def test_an_object_is_carried_to_other_frames(mapped: Server, open_tab: OpenTab) -> None:
    """A class is proposed in the other frames; one is accepted, then the rest, and that is taken back as one step."""
    tab = open_tab(f"{mapped.address}/?frame=000001/000000&mode=label", scene="absent")
    labels = mapped.folder / "labels"
    tab.see("[data-mode=label] #review-head input")
    tab.drawer("Edit")
    tab.send("object-at:2:000001/000000")
    tab.see("#edit h2", "laptop 2")
    tab.send("class:book")
    tab.see("#edit h2", "book 2")
    saved = len(events(labels, "--journal", mapped.journal))
    tab.click("carry")
    tab.see("#carry .go", "accept 2")
    assert tab.page.locator("#carry .carried path").count() == 2, "each with its outline"
    assert len(events(labels, "--journal", mapped.journal)) == saved, "proposed, not saved"
    tab.page.locator("#carry .carried .try").first.click()
    tab.see("#carry", "1 accepted")
    tab.click("carry-all")
    tab.see("#carry", "2 accepted")
    made = events(labels, "--journal", mapped.journal)[saved:]
    assert [e["frame"] for e in made if e["field"] == "label"] == ["000001/000001", "000001/000002"], made
    assert all(e["reason"].startswith("carried from 000001/000000") for e in made), made
    tab.press("Control+z")
    tab.see(".toast", "taken back")
    undone = events(labels, "--journal", mapped.journal)[saved + len(made) :]
    assert {e["frame"] for e in undone} == {"000001/000002"}, undone
    assert {e["action"] for e in undone} == {"undo"}
    # As the others found them.
    for left in (1, 0):
        tab.press("Control+z")
        tab.poll(f"document.querySelectorAll('#from-label [data-do]').length === {left}")
