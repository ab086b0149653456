"""Two people in two browsers correct one label set at the same time: no edit is lost, and none doubled.

Both accept items, type sizes of boxes (often of the same object), and take things back, each without waiting for the
other. What each of them did is written down here, and the journal must hold exactly that.
"""

import json
import random
import re
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import pytest
from browser import OpenTab, Tab
from recordings import LABELS, events, spatialviz
from servers import Server

from pipeline.corrections.journal.events import Event
from pipeline.corrections.unsaved import JournalLocation
from pipeline.labels.reading import open_labels

WIDTH = "#edit label.field[title^='width'] input"
ITEM = "document.querySelector('#review-item [data-asked]')?.dataset.asked"
PRESSED = f"addEventListener('keydown', e => {{ if (e.key === 'y') window.answeredItem = {ITEM}; }}, true)"
"""Keeps what the page asked when it was answered: the next item may come up just then."""
EDITED = "document.querySelector('#edit h2 b, #edit .name b')?.textContent"
Done = tuple[str, str, float]
"""What is done, to what, and with a box its width in metres."""


class Refused(Exception):
    """What was typed or answered is shown no longer, and the page says so; or the other was faster."""


REFUSED = re.compile("another object is selected|had not been shown yet|was faster")


@dataclass
class Person:
    """One of them: a browser, and what it has saved and taken back."""

    name: str
    tab: Tab
    chance: random.Random
    location: JournalLocation
    done: list[Done] = field(default_factory=list)
    """That stands, in order: the last one is what an undo takes back."""
    saved: Counter[Done] = field(default_factory=Counter)
    back: Counter[Done] = field(default_factory=Counter)
    told: Counter[str] = field(default_factory=Counter)
    last: int = 0
    """Of the journal's events, how far they have been looked at."""
    blocked: int = 0
    """So many of `done` the other has changed since: they are not taken back."""

    def saves(self, what: str, wanted: Callable[[Event], bool], still: Callable[[], bool] = lambda: True) -> bool:
        """Wait until the journal has something from this person; False where the page asks whose value it is to be.

        What was typed where the next item was coming up was typed nowhere: it is `still` so where it was not.
        """
        started = time.monotonic()
        while (waited := time.monotonic() - started) < 60:
            if waited > 5 and not still():
                raise Refused
            journal = self.location.to_read()
            new = () if journal is None else journal.events(author=self.name, after=self.last)
            for event in new:
                self.last = event.id
                if wanted(event):
                    # The other events of one action are no second one.
                    self.last = max(e.id for e in new if e.group == event.group)
                    return True
            if self.tab.page.locator("#dialog-window").count():
                return False
            # What is told of a 3D box that somebody else was faster with is of a size that was typed before.
            refused = self.tab.page.locator(".toast.bad", has_text=REFUSED).filter(has_not_text="3D box of")
            if refused.count():
                refused.locator(".close").first.evaluate("close => close.click()")
                raise Refused
            self.tab.page.wait_for_timeout(100)
        raise AssertionError(f"{self.name}: lost: {what}; {self.tab.page.locator('.toast').all_inner_texts()}")

    def keep(self, done: Done) -> None:
        self.done.append(done)
        self.saved[done] += 1

    def settled(self) -> None:
        """A dispute is settled by chance: one's own instead, or the other's kept."""
        # Neither what was saved nor a dispute comes later than this.
        self.tab.page.wait_for_timeout(200)
        self.tab.poll("!document.getElementById('working').textContent")

    def accept(self) -> Iterator[None]:
        self.tab.poll(ITEM)
        self.tab.press("y")
        yield
        frame, _, *ends, _ = self.tab.page.evaluate("window.answeredItem").split(" ")
        try:
            # What the other has answered, or taken back, since the page showed it is asked about.
            while not self.saves("an answer", lambda e: e.action != "undo" and e.ref.field != "box"):
                if not self.takes_own():
                    return
        except Refused:
            self.told["refused"] += 1
            return
        self.keep(("accept", f"{frame} {sorted(map(int, ends))}", 0.0))

    def takes_own(self) -> bool:
        """Settle what is disputed by chance; False for the other's value."""
        mine = self.chance.random() < 0.5
        self.told["mine" if mine else "theirs"] += 1
        self.tab.page.keyboard.press("m" if mine else "t")
        self.tab.closed()
        return mine

    def number(self, row: int) -> int:
        """Number of a labelled object of the frame that is shown."""
        rows = self.location.labels.objects.select(["frame", "object"]).to_pylist()
        frame = self.tab.frame
        return sorted(r["object"] for r in rows if r["frame"] == frame)[row]

    def resize(self, row: int) -> Iterator[None]:
        page = self.tab.page
        entry = page.locator(WIDTH)
        while not (page.evaluate(EDITED) or "").endswith(end := f" {self.number(row)}") or not entry.count():
            # What the next item chooses at this moment takes its place again.
            self.tab.send(f"number:{end.strip()}")
            for _ in range(100):
                page.wait_for_timeout(100)
                if (page.evaluate(EDITED) or "").endswith(end) and entry.count():
                    break
        now = float(entry.input_value())
        # The number that stands there already is no edit.
        width = round(self.chance.uniform(0.2, 0.6), 3)
        width = width if abs(width - now) > 1e-3 else width + 0.01
        entry.fill(f"{width:.3f}")
        # The next item may have come up since: whose number this is, the page says.
        name = page.evaluate(EDITED)
        # Or the field went before a digit was in it.
        typed = entry.count() and entry.input_value() == f"{width:.3f}"
        entry.press("Enter")
        yield
        done = ("box", f"{self.tab.frame} {name.rpartition(' ')[2]}", width)

        def wanted(e: Event) -> bool:
            return e.ref.field == "box" and bool(e.after) and abs(e.after["size"][0] - width) < 1e-6

        try:
            # Whoever takes their own is asked again where the other has saved once more meanwhile.
            while not self.saves(str(done), wanted, lambda: typed and page.evaluate(EDITED) == name):
                if not self.takes_own():
                    return
        except Refused:
            # The page was still on its way to the next item when the width was typed.
            self.told["refused"] += 1
            return
        self.keep(done)

    def undo(self) -> Iterator[None]:
        self.tab.press("Control+z")
        yield
        if self.saves("an undo", lambda e: e.action == "undo"):
            self.back[self.done.pop()] += 1
        else:
            self.told["not taken back"] += 1
            self.tab.page.keyboard.press("t")
            self.tab.closed()
            self.blocked = len(self.done)

    def act(self, row: int) -> Iterator[None]:
        which = self.chance.random()
        if which < 0.2 and len(self.done) > self.blocked:
            return self.undo()
        return self.resize(row) if which < 0.6 else self.accept()


def enter(open_tab: OpenTab, address: str, journal: Path, name: str, seed: int) -> Person:
    tab = open_tab(scene="absent")
    tab.page.add_init_script(f"localStorage.setItem('author', {name!r}); {PRESSED}")
    tab.open(address)
    tab.poll("document.querySelector('#review-list .queue .q')", seconds=120)
    tab.send("queue-kind:relation")
    tab.press("j")
    tab.poll("document.querySelector('#review-item .claim')")
    tab.page.evaluate("import('/app/core.mjs').then(m => m.locals.tab(null, 'Edit'))")
    return Person(name, tab, random.Random(seed), JournalLocation(open_labels(LABELS), journal))


def journal_says(journal: Path, name: str) -> tuple[Counter[Done], Counter[Done], int]:
    """What a person saved and took back, by the journal; how many of its events have one cell and group twice."""
    groups: dict[str, list[dict]] = {}
    for e in events(LABELS, "--journal", journal):
        if e["author"] == name:
            groups.setdefault(e["group"], []).append(e)
    saved, back, twice = Counter[Done](), Counter[Done](), 0
    for made in groups.values():
        first = made[0]
        twice += len(made) - len({(e["frame"], e["kind"], e["key"], e["field"]) for e in made})
        value = first["before"] if first["action"] == "undo" else first["after"]
        if first["field"] == "box":
            done = ("box", f"{first['frame']} {first['key']}", round(value["size"][0], 3) if value else -1.0)
        else:
            # An undecided relation gets a state, where others are accepted as they are.
            ends = json.loads(first["key"])[2:4] if first["kind"] == "review" else map(int, first["key"].split(","))
            done = ("accept", f"{first['frame']} {sorted(ends)}", 0.0)
        (back if first["action"] == "undo" else saved)[done] += 1
    return saved, back, twice


def work(people: list[Person], seconds: float) -> int:
    until, chance, rounds = time.monotonic() + seconds, random.Random(7), 0
    while time.monotonic() < until:
        row = chance.randrange(6)
        # The same object, for both, half of the time.
        acts = [p.act(row if chance.random() < 0.7 else p.chance.randrange(6)) for p in people]
        for act in acts:
            next(act)
        for act in acts:
            for _ in act:
                pass
        rounds += 1
    return rounds


@pytest.mark.parametrize("seconds", [4, pytest.param(60, marks=pytest.mark.slow)], ids=["brief", "long"])
def test_no_edit_is_lost_or_doubled(shared: Server, open_tab: OpenTab, seconds: float) -> None:
    journal = shared.journal
    # Each time by other people, so that the journal tells what they did.
    names = [f"{name}{seconds}" for name in ("ann", "bob")]
    people = [enter(open_tab, shared.address, journal, name, seed) for seed, name in enumerate(names)]
    rounds = work(people, seconds)
    for person in people:
        person.settled()
    for person in people:
        saved, back, twice = journal_says(journal, person.name)
        assert saved, f"{person.name} did nothing"
        assert not twice, f"{person.name}: {twice} events doubled"
        assert saved == person.saved, (person.name, "lost", person.saved - saved, "more", saved - person.saved)
        assert back == person.back, (person.name, "lost", person.back - back, "more", back - person.back)
        print(person.name, {"rounds": rounds, "saved": saved.total(), "taken back": back.total(), **person.told})
    spatialviz("journal", LABELS, "--journal", journal, "--check")
