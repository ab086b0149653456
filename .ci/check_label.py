"""Labelling in a real browser: items settled by keys, an edge dragged, many accepted, a bare recording labelled.

What the page did is what the journal tells: it is read by the command line.
"""

import json
import subprocess
import sys
import tempfile
from collections import Counter
from contextlib import suppress
from pathlib import Path

from bare_recording import write_recording
from browser import Server, Tab, Timed, chromium, new_tab
from playwright.sync_api import Browser

CLAIM = "document.querySelector('#review-item .claim')?.textContent"
SETTLED = "+(document.querySelector('#pace b')?.textContent ?? '').replace(/,/g, '')"
QUESTION = "mug left of the laptop"
FRAMES = 10


def events(labels: Path, *options: object) -> list[dict]:
    """What the journal of labels holds."""
    command = [sys.executable, "-m", "spatialviz", "journal", str(labels), "--json", *map(str, options)]
    told = subprocess.run(command, capture_output=True, text=True, check=False).stdout
    return [json.loads(line) for line in told.splitlines()]


def boxes(found: list[dict]) -> list[dict]:
    return [e for e in found if e["field"] == "box"]


def settle_by_keys(tab: Tab, journal: Path, labels: Path) -> None:
    """Five items, each by one key; each settled one opens the next."""
    tab.poll("document.querySelector('#review-list .queue .q')", seconds=120)
    tab.click("queue-kind:relation")
    tab.press("j")
    seen = []
    for n in range(5):
        seen.append(tab.poll(CLAIM))
        assert tab.see("#review-item .because").inner_text().strip(), "no reason is told"
        tab.page.keyboard.press("y")
        tab.poll(f"claim => {CLAIM} !== claim", seen[-1])
        tab.poll(f"n => {SETTLED} > n", n)
    assert len(set(seen)) == 5, seen
    assert len({e["group"] for e in events(labels, "--journal", journal)}) == 5
    tab.see("#pace", "an hour")
    assert tab.page.locator("#review-item .upcoming button").count() == 5


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


def drag_an_edge(tab: Tab, journal: Path, labels: Path) -> None:
    """An edge of a side view is drawn outwards: the box of the labels grows by as much; one undo takes it back."""
    object_shown(tab)
    size = "[...document.querySelectorAll('#sides .side-view figcaption span')].map(e => e.textContent)[0]"
    before = tab.poll(size)
    x, y = drawn_edge(tab)
    mouse = tab.page.mouse
    mouse.move(x, y)
    mouse.down()
    mouse.move(x + 18, y, steps=4)
    assert tab.poll(f"was => {size} !== was && {size}", before), "the box does not follow the hand"
    mouse.up()
    tab.see("#side .note", "3D box")
    (made,) = boxes(events(labels, "--journal", journal))
    grown = [round(a - b, 4) for a, b in zip(made["after"]["size"], made["before"]["size"], strict=True)]
    assert sum(g > 0.005 for g in grown) == 1, grown
    assert sum(abs(g) < 1e-6 for g in grown) == 2, grown
    tab.press("Control+z")
    tab.see("#side .note", "taken back")
    tab.poll(f"was => {size} === was", before)
    # Tab walks the objects while the views have the focus, and Escape leaves them.
    tab.page.locator("#sides").focus()
    name = "document.querySelector('#crop figcaption b').textContent"
    was = tab.poll(name)
    tab.page.keyboard.press("Tab")
    tab.poll(f"was => {name} !== was", was)
    tab.page.keyboard.press("Shift+Tab")
    tab.poll(f"was => {name} === was", was)
    tab.page.keyboard.press("Escape")
    tab.poll("document.activeElement.closest('#review-item')")


def accept_many(tab: Tab, journal: Path, labels: Path) -> None:
    """All that a filter finds is accepted as one step, which one undo takes back."""
    tab.click("queue-kind:relation")
    before = tab.poll(SETTLED)
    tab.page.locator("#queue-find").fill("left 000002")
    accept = tab.see('[data-do="accept-found"]:not([disabled])')
    found = int(accept.inner_text().split()[-1].replace(",", ""))
    assert found > 3, found
    accept.click()
    tab.poll(f"wanted => {SETTLED} >= wanted", before + found)
    groups = [e["group"] for e in events(labels, "--journal", journal)]
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


def from_nothing(tab: Tab, labels: Path) -> None:
    """Two things are outlined and named in a recording that nobody labelled; their relation follows by geometry."""
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
    assert "laptop" in tab.see("#review-pair h2").inner_text()
    tab.click("task:explain")


def judge_ten_frames(tab: Tab) -> dict[str, str]:
    """*This pair is right* under an answer gives its verdict at once, frame by frame."""
    found: dict[str, str] = {}
    for n in range(FRAMES):
        frame = f"{n:04d}"
        tab.page.locator("#where .frame-id").fill(frame)
        tab.page.locator("#where .frame-id").press("Enter")
        tab.poll("frame => document.title.includes(` ${frame} `)", frame)
        tab.poll("!document.getElementById('working').textContent")
        things = tab.page.evaluate("[...document.querySelectorAll('#objects b')].map(e => e.textContent)")
        # The most frequent name may mean several things, the next one fewer.
        names = [name for name, _ in Counter(t.partition("·")[0] for t in things if "·" in t).most_common()]
        tab.ask(f"{names[0]} left of the {names[1]}")
        offered = tab.page.locator('[data-do="right-pair"]')
        tab.poll("document.querySelector('[data-do=\"right-pair\"]') || document.querySelector('#ask-problem .note')")
        if not offered.count():
            found[frame] = "no pair"
            continue
        # Of every third frame it is the first pair with another target that is right: the answer fails then.
        targets = tab.page.locator("tr[id^=pair-] .w>div:first-child").all_inner_texts() if n % 3 == 2 else []
        other = next((k for k, target in enumerate(targets) if target != targets[0]), 0)
        for _ in range(other):
            tab.press("j")
        tab.poll("k => document.querySelector(`#pair-${k}[aria-current]`)", str(other))
        offered.click()
        tab.see("#right-pair", "kept as true")
        found[frame] = tab.see("#answer .verdict").inner_text().split()[0]
        assert (found[frame] == "CORRECT") == (not other), (frame, targets, found[frame])
    return found


def check_demo(browser: Browser, home: Path) -> None:
    labels, journal = Path("assets/demo_run/labels").resolve(), home / "journal.sqlite"
    with Server("demo", "--journal", journal) as server:
        tab = new_tab(browser).open(server.address).drawn()
        tab.click("task:label")
        settle_by_keys(tab, journal, labels)
        drag_an_edge(tab, journal, labels)
        accept_many(tab, journal, labels)
        assert not tab.problems, tab.problems
        tab.page.close()


def check_bare(browser: Browser, home: Path) -> dict[str, str]:
    recording, labels = home / "rec", home / "rec-labels"
    detections = write_recording(recording, FRAMES)
    with Server(recording, "--detector", "recorded", "--model", detections) as server:
        tab = new_tab(browser).open(server.address).drawn()
        from_nothing(tab, labels)
        verdicts = judge_ten_frames(tab)
        assert sum(v != "no pair" for v in verdicts.values()) >= FRAMES - 2, verdicts
        assert len({*verdicts.values()} - {"no pair"}) > 1, f"nothing failed: {verdicts}"
        assert not tab.problems, tab.problems
    true = [e for e in events(labels) if e["field"] == "exists" and e["kind"] == "expression"]
    assert len(true) == sum(v != "no pair" for v in verdicts.values())
    return verdicts


def main() -> None:
    timed = Timed()
    with tempfile.TemporaryDirectory() as folder, chromium() as browser:
        for check in (check_demo, check_bare):
            if not sys.argv[1:] or check.__name__ in sys.argv:
                print(timed(check, browser, Path(folder)), flush=True)
    print(timed)


if __name__ == "__main__":
    main()
