"""Review queue of a client, worked through with single keys; made in another process, for all clients."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import field
from functools import cached_property

from pipeline.answering.frame_store import LoadedFrame
from pipeline.answering.pipeline import Pipeline
from pipeline.corrections.journal.edits import Edits
from pipeline.corrections.journal.effective_frame import EffectiveFrame
from pipeline.corrections.journal.events import Event
from pipeline.corrections.journal.field_refs import FieldRef
from pipeline.corrections.label_editor import Target
from pipeline.corrections.review.decisions import (
    OF_LETTER,
    SAYS,
    Answer,
    ReviewQuestion,
    edits_of_answer,
    question_of,
    state_edits,
    words_of,
)
from pipeline.corrections.review.items import ItemKey, item_of
from pipeline.corrections.review.label_jobs import CANCELLED, QueueJob, QueueProgress
from pipeline.corrections.review.worklist import (
    BLOCK,
    MOST,
    NOTHING,
    Mark,
    Worklist,
    accept_all,
    refreshed_worklist,
    say_of_item,
)
from pipeline.corrections.scene import ASKED_BEYOND_M, labelled_objects, pair_card
from pipeline.corrections.unsaved import JournalLocation
from pipeline.language.counted import counted
from pipeline.relations.relations import letter
from pipeline.system.errors import InputError, needed
from pipeline.system.frozen import dataclass
from spatialviz.app.channel import Command
from spatialviz.app.context import Context, command, there
from spatialviz.app.label_part import NO_LABELS, LabelPart
from spatialviz.app.markup import Element, h, panel
from spatialviz.app.review_html import (
    DECISIONS,
    begin_card,
    bulk_html,
    decision_bar,
    doubt_html,
    idle_card,
    item_card,
    pace_html,
    queue_html,
    said,
)

OF_KEYS: dict[str, Answer] = {"T": "right", "F": "wrong", "U": "unsure"}
DOUBT_TITLE = "Against geometry"


@dataclass
class SourceQueue:
    """Queue of a pipeline, as known to a client."""

    source: Pipeline
    location: JournalLocation
    work: Worklist | None = None
    newest: Mark = NOTHING  # Newest event known to the list
    seen: QueueProgress = field(default_factory=QueueProgress)  # Progress as last taken
    behind: bool = False  # Finished since the last drawing
    networks: bool = False  # The next queue is made of networks too

    @cached_property
    def names(self) -> dict[tuple[str, int], str]:
        """Class names of the labelled objects by frame and number: initial labels, updated on sight."""
        columns = (self.location.labels.objects.column(c).to_pylist() for c in ("frame", "object", "label"))
        return {(frame, number): label for frame, number, label in zip(*columns, strict=True)}


class ReviewQueue(LabelPart):
    """Walks through the queue of a client's current pipeline."""

    def __init__(self, ctx: Context) -> None:
        super().__init__(ctx)
        self._queues = {
            name: SourceQueue(ctx.shared.store.sources[name], location)
            for name, location in ctx.shared.journals.items()
        }
        self._kind, self._find = "all", ""
        self._ahead: tuple[str, str] | None = None
        self._doubted: tuple[ItemKey, int] | None = None
        ctx.editors.on_saved.append(self._saved)
        ctx.leave += [
            queue.location.jobs.queue.listen(lambda queue=queue: ctx.post(lambda: self._made(queue)))
            for queue in self._queues.values()
        ]

    @property
    def _queue(self) -> SourceQueue:
        return needed(self._queues.get(self.state.source), NO_LABELS)

    @property
    def _item(self) -> ItemKey | None:
        return None if self.state.labels is None else self.state.labels.item

    # ---- the queue --------------------------------------------------------------------

    @command("make-queue")
    def make(self) -> None:
        """Make the queue of the current pipeline, from the chosen sources."""
        queue, place = self._queue, self.location
        if place.jobs.queue.running:
            return
        place.jobs.make(
            QueueJob(
                place.labels.root,
                None if place.where is None else str(place.where),
                place.project,
                str(queue.source.dataset.root),
                networks=queue.networks,
            )
        )

    @command("stop-queue")
    def stop(self) -> None:
        """Stop making the queue, begun by any client; the present queue stays."""
        self.location.jobs.queue.stop()

    @command("queue-networks")
    def switch(self) -> None:
        """Switch networks on or off as a source of the next queue."""
        queue = self._queue
        queue.networks = not queue.networks
        self.follow()

    def _made(self, queue: SourceQueue) -> None:
        """Take over a finished queue, begun by any client."""
        self._take(queue)
        self.follow()

    def _take(self, queue: SourceQueue) -> None:
        was, now = queue.seen, queue.location.jobs.queue.seen
        queue.seen = now
        if now.work is not None and now.work is not was.work:
            queue.work, queue.newest, queue.behind = now.work, now.last, True
            self.ctx.note(f"review queue: {counted(len(now.work), 'item')}")
        if now.problem and now.problem != was.problem:
            stopped = now.problem == CANCELLED
            self.ctx.note("the review queue is not made" if stopped else f"no review queue: {now.problem}")

    def _saved(self, events: Sequence[Event]) -> bool:
        """Update the list; an item whose answer was taken back is shown again: True then."""
        work, items = self._caught_up(), [item_of(e.ref) for e in events if e.action == "undo" and _answers(e.ref)]
        found = [i for i in items if work is not None and i is not None and i.plain in work.indices]
        # The same said the other way round is taken back with it; many answers at once are no item.
        one = len({(i.frame, frozenset((i.a, i.b))) for i in found}) == 1
        if not one or work is None or self.state.labels is None:
            return False
        self.open(work.keys[work.indices[found[0].plain]])
        return True

    def _caught_up(self) -> Worklist | None:
        """List of the current pipeline, updated with everybody's saved edits."""
        queue = self._queues.get(self.state.source)
        if queue is None or queue.work is None:
            return None
        queue.behind = False
        # Unsaved edits already show an unreadable journal.
        with suppress(InputError):
            journal, corrector = self.location.to_read(), self.editor.corrector
            if journal is not None:
                queue.work, queue.newest = refreshed_worklist(queue.work, corrector, journal, queue.newest)
        return queue.work

    # ---- walking ----------------------------------------------------------------------

    @command("next-item")
    def step(self, step: int) -> None:
        """Show the next open item, or the previous."""
        work, found = there(self._caught_up()), self._item
        kind = None if self._kind == "all" else self._kind
        self.open(there(work.previous(found, kind) if step < 0 else self._next(work, found)))

    def _next(self, work: Worklist, after: ItemKey | None) -> ItemKey | None:
        if not self._find:
            return work.next_item(after, kind=None if self._kind == "all" else self._kind)
        places, at = self._found(work), -1 if after is None else work.indices.get(after.plain, -1)
        return None if not places else work.keys[next((k for k in places if k > at), places[0])]

    def _found(self, work: Worklist) -> list[int]:
        """Positions of open items matching the filter."""
        names, kind = self._queue.names, None if self._kind == "all" else self._kind
        return sorted(work.found(lambda row: said(row, names), self._find, kind))

    @command("queue-find")
    def narrow(self, text: str) -> None:
        """Filter the items by the words of a text."""
        self._find = text.strip()
        self.follow()

    @command("accept-found")
    def accept_found(self) -> None:
        """Accept all results of the filter, as a single step."""
        work = there(self._caught_up())
        items = [work.keys[k] for k in self._found(work)[:MOST] if self._find]
        if items:
            self.save(lambda _: accept_all(items, self.editor.frame, self.editor.author))

    @command("item")
    def open_row(self, place: int) -> None:
        """Show the item of a row."""
        work = there(self._queue.work)
        if 0 <= place < len(work):
            self.open(work.keys[place])

    def open(self, key: ItemKey) -> None:
        """Show an item: pair, object, or ends of a sentence."""
        work = self._queue.work
        if self.state.labels is not None:
            # A frame without readable labels is not opened.
            self.editor.events(key.frame)
        ends = (key.a, key.b)
        if work is not None and key.kind == "expression" and key.plain in work.indices:
            row = work.row(key)
            ends = (row["a"], row["b"])
        numbers = tuple(n for n in ends if n is not None and n >= 0)
        self.look_at(Target(key.frame, numbers, key.what if key.kind == "relation" else None, key))
        self._prefetch(key)

    def _prefetch(self, key: ItemKey | None) -> None:
        """Load the next frame of the queue in the background."""
        name, work, editor = self.state.source, self._queue.work, self.editor
        after = None if work is None else self._next(work, key)
        for _ in range(BLOCK):
            if work is None or after is None or key is None or after.frame != key.frame:
                break
            after = self._next(work, after)
        if after is None or (name, after.frame) == self._ahead:
            return
        frame = after.frame
        self._ahead = name, frame

        def draw(loaded: LoadedFrame) -> None:
            for entry in labelled_objects(editor.saved(frame)):
                loaded.thumb(entry.bbox)

        self.ctx.shared.store.prepare(name, [frame], draw)

    @command("queue-kind")
    def choose_kind(self, kind: str) -> None:
        """Filter the items by kind."""
        self._kind = kind
        self._prefetch(self._item)
        self.follow()

    # ---- answering --------------------------------------------------------------------

    @property
    def _question(self) -> ReviewQuestion | None:
        """Question of the open item, else of the chosen pair's relation, else of the selected object."""
        view, item, queue = self.state.labels, self._item, self._queues.get(self.state.source)
        if view is None or queue is None:
            return None
        frame = view.frame
        if item is None and view.card is not None and view.relation is not None:
            item = ItemKey(frame.frame, "relation", view.card.a, view.card.b, view.relation)
        elif item is None and self.number is not None:
            item = ItemKey(frame.frame, "object", self.number, None, "")
        if item is None:
            return None
        work, missing, words = queue.work, "object", ()
        if work is not None and item.plain in work.indices:
            missing = work.row(item)["label"] or missing if item.a < 0 else missing
            words = words_of(frame, self.editor.events(frame.frame), item) if work.state(item) == "unsure" else ()
        return question_of(frame, item, missing, words)

    @command("decide")
    def decide(self, answer: Answer) -> None:
        """Answer the question: right, wrong, or unsure."""
        self.check_asked()
        question, author = there(self._question), self.editor.author
        state = question.choices[answer].state
        if state is None or self._sure(question, state, DECISIONS[answer][1]):
            self._save(question, lambda frame: edits_of_answer(frame, question, answer, author))

    @command("settle")
    def settle_relation(self, said: str) -> None:
        """Set a relation's state: "left:T" of the shown pair, "T" of what is asked; of others, T is right, F wrong."""
        self.check_asked()
        view, question = self.view, self._question
        *named, key = said.split(":")
        if key not in OF_LETTER:
            return
        if named:
            card = there(view.card)
            self.ctx.handle(Command("relation-row", (named[0],)))
            item = ItemKey(view.frame.frame, "relation", card.a, card.b, named[0])
            asked = question is not None and question.item == item
            question = question if asked else question_of(view.frame, item)
        question = there(question)
        if question.item.kind != "relation":
            self.decide(OF_KEYS[key])
        elif self._sure(question, OF_LETTER[key], key):
            author, differ = self.editor.author, bool(question.words)
            self._save(question, lambda frame: state_edits(frame, question.item, OF_LETTER[key], author, differ))

    def _sure(self, question: ReviewQuestion, state: int, key: str) -> bool:
        """False where another state contradicts geometry by decimetres: the same key confirms it."""
        view, item = self.view, question.item
        if state == view.frame.pairs.state(*item[2:]):
            return True
        card = pair_card(view.frame, item.a, needed(item.b, "no relation"))
        line = next((x for x in card.lines if x.relation == item.what), None)
        line = needed(line, card.why_none or "the pair has no such relation")
        doubted, self._doubted = self._doubted, (item, state)
        if line.against(state) <= ASKED_BEYOND_M or (doubted == (item, state) and self.ctx.dialog.title == DOUBT_TITLE):
            self.ctx.dialog.close()
            return True
        named = "" if item == self._item else f"{item.what}:"
        do = f"settle:{named}{letter(state)}"
        save = h.button(f"Save {SAYS[state]} all the same ({key})", do=do, aria_keyshortcuts=key)
        self.ctx.dialog.show(DOUBT_TITLE, doubt_html(card, line, state), save)
        return False

    @command("unsure-item")
    def leave_open(self) -> None:
        """Leave the question to somebody else."""
        question, author = there(self._question), self.editor.author
        self._save(question, lambda frame: say_of_item(frame, question.item, "unsure", author))

    def _save(self, question: ReviewQuestion, made: Callable[[EffectiveFrame], Edits]) -> None:
        self.save(made, draw=False)
        item = self._item
        if item is None or question.item.plain != item.plain or not self._go_on(item):
            self.ctx.draw()

    def _go_on(self, item: ItemKey) -> bool:
        work = self._queue.work
        after = None if work is None or self.editor.waiting else self._next(work, item)
        if after is None or after.plain == item.plain:
            return False
        self.open(after)
        return True

    # ---- drawing ----------------------------------------------------------------------

    def follow(self) -> None:
        """Draw the list and the item for the state; the first time, make the queue."""
        queue, view, page, item = self._queues.get(self.state.source), self.state.labels, self.ctx.page, self._item
        if queue is None:
            return
        self._take(queue)
        if view is not None:
            if queue.behind:
                self._caught_up()
                self._prefetch(item)
            # Labels just begun by hand have nothing to queue.
            labelled = self.location.labels.manifest.tables.get("relations")
            if queue.seen == QueueProgress() and labelled is not None and labelled.rows:
                self.make()
                self._take(queue)
            queue.names.update({(view.frame.frame, n): row["label"] for n, row in view.frame.objects.items()})
        work = queue.work
        if work is not None and self.ctx.reviewed is not work.frame_counts:
            self.ctx.reviewed = work.frame_counts
            self.ctx.post(lambda: self.ctx.handle(Command("timeline")))
        found = [] if work is None else self._found(work)
        bulk = None if work is None else bulk_html(self._find, len(found))
        listed = found if self._find else None
        question = self._question
        page.fill(
            {
                "review-item": None if view is None else self._card(queue, item, question),
                "review-list": queue_html(
                    work, queue.seen, queue.networks, self._kind, item, queue.names, bulk, listed
                ),
                "pace": None if work is None or view is None else pace_html(work.counts),
                "decide": None if view is None else decision_bar(question),
            }
        )

    def _card(self, queue: SourceQueue, item: ItemKey | None, question: ReviewQuestion | None) -> Element:
        """Question with its reasons."""
        work, view = queue.work, self.view
        place = None if work is None or item is None else work.indices.get(item.plain)
        known = work is not None and place is not None and not work.gone[place]
        reasons = work.rows([place])[0]["reasons"] if known and work is not None and place is not None else ()
        if question is not None:
            card = item_card(question, reasons)
        else:
            card = begin_card(self.editor) if not view.frame.objects else idle_card(work is not None)
        # A new id for each card, so that the page scrolls to the card.
        return panel(card.with_(id=f"card-{place}-{self.number}", data_shown=True, data_asked=self.asked))


def _answers(ref: FieldRef) -> bool:
    """True for a cell that an answer to an item sets, not an edit of its object or sentence."""
    return ref.kind in ("relation", "review") or ref.field.endswith("status")
