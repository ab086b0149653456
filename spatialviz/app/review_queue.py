"""The review queue as one client works through it, with single keys; it is made in another process, for all clients."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

from pipeline.corrections.journal.edits import Edits, judge_both_ways, judge_missing, set_status
from pipeline.corrections.journal.effective_frame import EffectiveFrame
from pipeline.corrections.journal.field_refs import FieldRef, object_ref
from pipeline.corrections.review.detector_evidence import second_setup
from pipeline.corrections.review.items import BLOCK, ItemKey
from pipeline.corrections.review.label_jobs import CANCELLED, QueueJob, QueueProgress
from pipeline.corrections.review.worklist import NOTHING, Mark, Worklist, refreshed_worklist
from pipeline.corrections.scene import PairCard, RelationLine, labelled_objects
from pipeline.language.counted import counted
from pipeline.relations.relations import F, T, U, letter
from pipeline.system.errors import InputError
from spatialviz.app.context import Context, Part, command
from spatialviz.app.correct import Correct
from spatialviz.app.frames import LoadedFrame
from spatialviz.app.keys import KEYS_OF_ONE
from spatialviz.app.label_view import Target
from spatialviz.app.markup import h, panel
from spatialviz.app.review_html import KINDS, Asked, doubt_html, item_html, queue_html

LETTERS = {"T": T, "U": U, "F": F}
DOUBT_TITLE = "Against geometry"


class ReviewQueue(Part):
    """Walks through the queue of the source that a client looks at."""

    def __init__(self, ctx: Context, correct: Correct) -> None:
        super().__init__(ctx)
        self._correct = correct
        self._works: dict[str, Worklist] = {}
        self._newest: dict[str, Mark] = {}
        self._makings: dict[str, QueueProgress] = {}
        self._behind: set[str] = set()
        self._asked: dict[str, Asked] = {}
        self._names: dict[str, dict[tuple[str, int], str]] = {}
        self._kind = "all"
        self._ahead: tuple[str, str] | None = None
        self._doubted: tuple[str, str] | None = None
        correct.on_saved(lambda _: self._caught_up())
        correct.on_doubt = self._doubt
        ctx.leave += [
            place.jobs.queue.listen(lambda name=name: ctx.post(lambda: self._made(name)))
            for name, place in ctx.shared.journals.items()
        ]

    @property
    def _work(self) -> Worklist | None:
        return self._works.get(self.state.source)

    @property
    def _item(self) -> ItemKey | None:
        view = self.state.labels
        return None if view is None else view.item

    # ---- the queue --------------------------------------------------------------------

    @command("make-queue")
    def make(self) -> None:
        """Make the queue of the source that is looked at, of what is switched on."""
        name = self.state.source
        place, asked = self.ctx.shared.journals.get(name), self._asks(name)
        if place is None or place.jobs.queue.running:
            return
        source = self.ctx.shared.store.sources[name]
        second = second_setup(source, place.labels) if asked.detector else None
        place.jobs.make(
            lambda out: QueueJob(
                place.labels.root,
                out,
                None if place.where is None else str(place.where),
                place.project,
                str(source.dataset.root),
                networks=asked.networks,
                detector=None if second is None else second[1],
                called=None if second is None else second[0],
            )
        )

    @command("stop-queue")
    def stop(self) -> None:
        """End what makes the queue, whoever began it; the one that there is stays."""
        place = self.ctx.shared.journals.get(self.state.source)
        if place is not None:
            place.jobs.queue.stop()

    @command("queue-from")
    def switch(self, what: str) -> None:
        """Put networks or the detector into the next queue, or leave them out."""
        name = self.state.source
        asked = self._asks(name)
        if what in ("networks", "detector"):
            self._asked[name] = replace(asked, **{what: not getattr(asked, what)})
            self.follow()

    def _asks(self, name: str) -> Asked:
        if name not in self._asked:
            second = second_setup(self.ctx.shared.store.sources[name], self.ctx.shared.journals[name].labels)
            self._asked[name] = Asked(named="" if second is None else second[0])
        return self._asked[name]

    def _made(self, name: str) -> None:
        """Take what is made by now, whoever began it."""
        self._taken(name)
        self.follow()

    def _taken(self, name: str) -> QueueProgress:
        was, now = self._makings.get(name, QueueProgress()), self.ctx.shared.journals[name].jobs.queue.seen
        self._makings[name] = now
        if now.work is not None and now.work is not was.work:
            self._works[name], self._newest[name] = now.work, (now.made or {}).get("last", NOTHING)
            self._behind.add(name)
            self.ctx.note(f"review queue: {counted(len(now.work), 'item')}")
            self._note_skipped(now)
        if now.problem and now.problem != was.problem:
            stopped = now.problem == CANCELLED
            self.ctx.note("the review queue is not made" if stopped else f"no review queue: {now.problem}")
        return now

    def _note_skipped(self, making: QueueProgress) -> None:
        asked = (making.made or {}).get("detector")
        if asked is not None and (skipped := asked["skipped"]):
            frame, why = next(iter(skipped.items()))
            number = counted(len(skipped), "frame")
            self.ctx.note(f"the detector {asked['name']} could not look at {number}, as {frame}: {why}")

    def _caught_up(self) -> Worklist | None:
        """The list of the source that is looked at, with what anybody has saved by now."""
        name, work, desk = self.state.source, self._work, self._correct.desk
        if work is None or desk is None:
            return work
        self._behind.discard(name)
        # Where the journal cannot be read now, what waits says so already.
        with suppress(InputError):
            journal = desk.location.to_read()
            if journal is not None:
                work, self._newest[name] = refreshed_worklist(
                    work, desk.corrector, journal, self._newest.get(name, NOTHING)
                )
                self._works[name] = work
        return work

    # ---- walking ----------------------------------------------------------------------

    @command("next-item")
    def step(self, step: int) -> None:
        """Look at the next item that is open, or at the one above."""
        work = self._caught_up()
        if work is None:
            return
        if step < 0:
            found = self._item
            while (found := work.previous(found)) is not None and self._kind not in ("all", found.kind):
                pass
        else:
            found = self._next(work, self._item)
        if found is not None:
            self.look_at(found)

    def _next(self, work: Worklist, after: ItemKey | None) -> ItemKey | None:
        return work.next_item(after, kind=None if self._kind == "all" else self._kind)

    @command("item")
    def open(self, place: int) -> None:
        """Look at the item of a row."""
        work = self._work
        if work is not None and 0 <= place < len(work):
            self.look_at(work.keys[place])

    def look_at(self, key: ItemKey) -> None:
        """Show an item: its pair, its object, or the ends of its sentence."""
        work, desk = self._work, self._correct.open_desk
        try:
            if desk is not None and self.state.labels is not None:
                desk.events(key.frame)
        except InputError as error:
            # Better stay where labels are seen than go where they are not.
            self._correct.refuse(str(error))
            return
        ends = (key.a, key.b)
        if work is not None and key.kind == "expression" and key.plain in work.indices:
            row = work.row(key)
            ends = (row["a"], row["b"])
        numbers = tuple(n for n in ends if n is not None and n >= 0)
        relation = key.what if key.kind == "relation" else None
        self._correct.look_at(Target(key.frame, numbers, relation, key))
        self._prefetch(key)

    def _prefetch(self, key: ItemKey | None) -> None:
        """Make the next frame of the queue ready, while this item is looked at."""
        name, work, desk = self.state.source, self._work, self._correct.desk
        if work is None or desk is None:
            return
        after = self._next(work, key)
        for _ in range(BLOCK):
            if after is None or key is None or after.frame != key.frame:
                break
            after = self._next(work, after)
        if after is None or (name, after.frame) == self._ahead:
            return
        frame = after.frame
        self._ahead = name, frame

        def draw(loaded: LoadedFrame) -> None:
            for entry in labelled_objects(desk.saved(frame)):
                loaded.thumb(entry.bbox)

        self.ctx.shared.store.prepare(name, [frame], draw)

    @command("queue-kind")
    def choose_kind(self, kind: str) -> None:
        """Walk through items of one kind only."""
        if kind in KINDS:
            self._kind = kind
            self._prefetch(self._item)
            self.follow()

    # ---- settling ---------------------------------------------------------------------

    @command("settle")
    def settle(self, said: str, sure: bool = False) -> None:
        """Settle a relation: "left:T" of the pair that is shown, "T" of the open item, or without one of that pair.

        A key belongs to the open item, whatever is looked at beside it. From
        there it goes on to the next one.
        """
        view, item = self.state.labels, self._item
        *named, letter = said.split(":")
        if view is None or letter not in LETTERS:
            return
        if item is not None and item.b is not None and not named and item.kind == "relation":
            relation, ends = item.what, (item.a, item.b)
        elif view.card is not None and (item is None or named):
            relation, ends = named[0] if named else view.relation, (view.card.a, view.card.b)
        else:
            self._correct.refuse(f"T, U and F are for the relation of two objects. {KEYS_OF_ONE}.")
            return
        if named:
            self._correct.focus_relation(named[0])
        work = self._work
        last_word = work is not None and item is not None and work.is_disputed(item)
        # The key that was answered by a question answers it when it is pressed again.
        sure = sure or (self._doubted == (view.frame.frame, said) and self.ctx.dialog.title == DOUBT_TITLE)
        self._doubted = view.frame.frame, said
        if not self._correct.settle(ends, relation, LETTERS[letter], last_word=last_word, sure=sure):
            return
        if sure:
            self.ctx.dialog.close()
        own = item is not None and (item.what, item.a, item.b) == (relation, *ends)
        if not (own and item is not None and self._go_on(item)):
            self.ctx.draw()

    def _doubt(self, card: PairCard, line: RelationLine, state: int) -> None:
        """Ask before a judgement is saved that geometry contradicts."""
        self.ctx.dialog.show(
            DOUBT_TITLE, doubt_html(card, line, state), h.button(f"Save {letter(state)} all the same", do="settle-sure")
        )

    @command("settle-sure")
    def _sure(self) -> None:
        """Save what was asked about."""
        view, doubted = self.state.labels, self._doubted
        self.ctx.dialog.close()
        if view is not None and doubted is not None and doubted[0] == view.frame.frame:
            self.settle(doubted[1], sure=True)

    @command("leave-item")
    def leave(self) -> None:
        """Look at the item no longer; the keys act on what is selected again."""
        view = self.state.labels
        if view is not None and view.item is not None:
            self.ctx.show(labels=replace(view, item=None))

    @command("accept-item=accepted", "reject-item=rejected", "unsure-item=unsure")
    def say(self, status: str) -> None:
        """Say of the item that is looked at, else of the selected object, that it is right, wrong, or unclear."""
        view, desk, item = self.state.labels, self._correct.desk, self._item
        if view is None or desk is None:
            return
        selected = self.state.selected
        if item is None and selected is None:
            return
        number = None if selected is None else view.numbers[selected]

        def made(frame: EffectiveFrame) -> Edits:
            if item is not None and item.kind == "object" and item.a < 0:
                return judge_missing(frame, item.what, status, desk.author)
            cell = object_ref(frame.frame, int(number or 0), "status") if item is None else status_cell(item)
            if cell.kind == "relation" and status == "rejected":
                raise InputError("a relation is not rejected", expected="T, U or F")
            if cell.kind == "relation":
                return judge_both_ways(frame, cell, status, desk.author)
            return set_status(frame, cell, status, author=desk.author)

        if self._correct.save(made, draw=False) and (item is None or not self._go_on(item)):
            self.ctx.draw()

    def _go_on(self, item: ItemKey) -> bool:
        work, desk = self._work, self._correct.desk
        after = None if work is None or desk is None or desk.waiting else self._next(work, item)
        if after is None or after.plain == item.plain:
            return False
        self.look_at(after)
        return True

    # ---- drawing ----------------------------------------------------------------------

    def follow(self) -> None:
        """Bring the list and the item up to the state; the first time, make the queue."""
        name, page = self.state.source, self.ctx.page
        if name not in self.ctx.shared.journals:
            return
        making = self._taken(name)
        if self.state.labels is not None:
            if name in self._behind:
                self._caught_up()
                self._prefetch(self._item)
            if making == QueueProgress():
                self.make()
                making = self._taken(name)
        work, names, item = self._work, self._known_names(name), self._item
        if work is not None and self.ctx.reviewed is not work.frame_counts:
            self.ctx.reviewed = work.frame_counts
            self.ctx.post(lambda: self.ctx.handle("strip"))
        shown = None
        if work is not None and item is not None and item.plain in work.indices and not work.is_gone(item):
            shown = panel(item_html(work, names, item))
        page.show("review-item", shown)
        page.show("review-list", queue_html(work, making, self._asks(name), self._kind, item, names))

    def _known_names(self, name: str) -> dict[tuple[str, int], str]:
        """Class names of the labelled objects, as the labels were made."""
        if name not in self._names:
            objects = self.ctx.shared.journals[name].labels.objects
            columns = (objects.column(c).to_pylist() for c in ("frame", "object", "label"))
            self._names[name] = {(f, n): label for f, n, label in zip(*columns, strict=True)}
        view = self.state.labels
        if view is not None:
            frame = view.frame
            self._names[name].update({(frame.frame, n): r["label"] for n, r in frame.objects.items()})
        return self._names[name]


def status_cell(item: ItemKey) -> FieldRef:
    """The status of an item."""
    if item.kind == "relation":
        return FieldRef("relation", item.frame, f"{item.a},{item.b}", f"{item.what}.status")
    if item.kind == "object":
        return object_ref(item.frame, item.a, "status")
    return FieldRef("expression", item.frame, item.what, "status")
