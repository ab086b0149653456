"""Where each item of a review stands, by what people did: read from the journal, and nowhere else.

What a person did to an item is a word on it. Correcting a value says
"corrected", or "accepted" where it is what the labeller had said; leaving out
an object or expression, or marking the latter as wrong, says "rejected"; a
status says itself; a judgement (`pipeline.corrections.journal.replay`) says it for one
person. Of each person the newest word counts, and what was taken back was never
said.

Over all, the newest word counts as well, unless people say different things:
then the item is "unsure", and so open, until `edits.settle` says the last word.
Who is unsure contradicts nobody. A word after the settlement that says
something else opens the item again.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from pipeline.corrections.journal.events import Event
from pipeline.corrections.journal.field_refs import FieldRef, judged_item, same_value
from pipeline.corrections.journal.journal import Journal
from pipeline.corrections.journal.replay import by_ref, standing_at
from pipeline.corrections.review.items import NOBODY, SETTLED, ItemKey, State
from pipeline.relations.relations import letter

_RANK = {"unreviewed": 0, "unsure": 1, "accepted": 2, "corrected": 3, "rejected": 4}
"""Of what one action says of an item, by several fields, the strongest counts."""
Labelled = Callable[[ItemKey], "int | None"]
"""The state (T, U, F) that automatic labels give a relation; None where it is not known."""


@dataclass(frozen=True)
class Judgement:
    """What one person says of an item.

    Attributes
    ----------
    author : str
    status : str
        "accepted", "corrected", "rejected" or "unsure"; "unreviewed" where an earlier word was withdrawn.
    verdict : str
        What is compared between people. Of relations T, U or F: who accepts a T says T. Of others the status; who
        accepts what another has corrected says "corrected", as that one did.
    at : int
        `id` of the event that made it so: later words have greater ones.
    time : datetime
    """

    author: str
    status: State
    verdict: str
    at: int
    time: datetime


@dataclass(frozen=True)
class Judgements:
    """All words that stand.

    Attributes
    ----------
    words : dict of ItemKey to dict of str to Word
        The newest of each author.
    settled : dict of ItemKey to Word
        What was settled where people differed.
    """

    words: dict[ItemKey, dict[str, Judgement]]
    settled: dict[ItemKey, Judgement]

    @property
    def authors(self) -> tuple[str, ...]:
        """Who said anything, sorted."""
        return tuple(sorted({author for of_item in self.words.values() for author in of_item}))

    def of(self, author: str) -> dict[ItemKey, Judgement]:
        """What one person says."""
        return {key: words[author] for key, words in self.words.items() if author in words}

    def differ(self, key: ItemKey) -> bool:
        """Whether people say different things of an item, and nobody has settled it."""
        return len({w.verdict for w in self._open_words(key)}) > 1

    def state(self, key: ItemKey) -> State:
        """The state of an item over all people."""
        words = [w for w in self.words.get(key, {}).values() if w.status != "unreviewed"]
        last = self.settled.get(key)
        if self.differ(key):
            return "unsure"
        if last is not None:
            return last.status
        return max(words, key=lambda w: w.at).status if words else "unreviewed"

    def verdict(self, key: ItemKey) -> str | None:
        """What stands of a settled item, as of `Judgement.verdict`; None where it is open."""
        if self.state(key) not in SETTLED:
            return None
        return max(self._open_words(key), key=lambda w: w.at).verdict

    def states(self, author: str | None = None) -> dict[ItemKey, State]:
        """The state of every item that anyone, or this person, has said something of."""
        if author is not None:
            return {k: w.status for k, w in self.of(author).items() if w.status != "unreviewed"}
        found: dict[ItemKey, State] = {key: self.state(key) for key in {**self.words, **self.settled}}
        return {key: state for key, state in found.items() if state != "unreviewed"}

    def _open_words(self, key: ItemKey) -> list[Judgement]:
        """Words that count now: a settlement and those after it, or all; of those who are sure."""
        words = [w for w in self.words.get(key, {}).values() if w.status in SETTLED]
        last = self.settled.get(key)
        return words if last is None else [last, *(w for w in words if w.at > last.at)]


def states_of(journal: Journal | Iterable[Event], author: str | None = None) -> dict[ItemKey, State]:
    """The state of every reviewed item, over all or by one person; what is lacking is unreviewed.

    Parameters
    ----------
    journal : Journal or iterable of Event
        All events, in the order of their saving.
    author : str, optional
    """
    return judgements_of(journal).states(author)


def judgements_of(
    journal: Journal | Iterable[Event],
    *,
    automatic: Labelled | None = None,
    ignored: Collection[str] = (),
) -> Judgements:
    """Everyone's words.

    Parameters
    ----------
    journal : Journal or iterable of Event
        All events, in the order of their saving.
    automatic : callable, optional
        What the labeller says of a relation, for those who accepted it by its status alone. Without it, their word
        is "accepted" where nobody ever changed the relation.
    ignored : collection of str
        ULIDs of events that say nothing of the labels as they are now (`EffectiveLabels.unapplied`).
    """
    events = journal.events() if isinstance(journal, Journal) else tuple(journal)
    refs = by_ref(events)
    standing = {ref: [x for x in standing_at(members) if x[0].ulid not in ignored] for ref, members in refs.items()}
    settling = {e.group for ref, found in standing.items() if ref.field == "settled" for e, _ in found}
    of_entity: dict[ItemKey, list[FieldRef]] = {}
    for ref in refs:
        key = item_of(ref)
        if key is not None and _is_value(ref):
            of_entity.setdefault(key, []).append(ref)
    groups: dict[tuple[ItemKey, str, str], Judgement] = {}
    settled: dict[ItemKey, Judgement] = {}
    for ref, found in standing.items():
        key = item_of(ref)
        if key is None:
            continue
        for event, at in found:
            word = _word(event, at, key, refs, of_entity.get(key, ()), automatic)
            if ref.field == "settled":
                if word.status != "unreviewed" and (key not in settled or at > settled[key].at):
                    settled[key] = word
            elif event.group not in settling:
                spoken = key, event.author, event.group
                other = groups.get(spoken)
                if other is None or _RANK[word.status] >= _RANK[other.status]:
                    groups[spoken] = word
    words: dict[ItemKey, dict[str, Judgement]] = {}
    for (key, author, _), word in groups.items():
        of_item = words.setdefault(key, {})
        if author not in of_item or word.at > of_item[author].at:
            of_item[author] = word
    return Judgements(words, settled)


def item_of(ref: FieldRef) -> ItemKey | None:
    """The item that a cell is about; None of a frame's."""
    if ref.kind == "review":
        _, kind, a, b, what = judged_item(ref.key)
        return ItemKey(ref.frame, kind, a, b, what)
    if ref.kind == "relation":
        a, b = ref.numbers
        return ItemKey(ref.frame, "relation", a, b, ref.field.removesuffix(".status"))
    if ref.kind == "object":
        return ItemKey(ref.frame, "object", ref.numbers[0], None, "")
    return ItemKey(ref.frame, "expression", NOBODY, None, ref.key) if ref.kind == "expression" else None


def _is_value(ref: FieldRef) -> bool:
    return ref.kind != "review" and not ref.field.endswith("status") and ref.field != "mark"


def _word(
    event: Event,
    at: int,
    key: ItemKey,
    refs: Mapping[FieldRef, Sequence[Event]],
    of_entity: Sequence[FieldRef],
    automatic: Labelled | None,
) -> Judgement:
    ref, after = event.ref, event.after
    status, state = _said_by(event, refs[ref][0].before)
    if ref.kind == "review" and isinstance(after, dict):
        state = after["value"]
    elif key.kind == "relation" and status == "accepted" and not _is_value(ref):
        state = _value_at(event, key, refs.get(_value_cell(key), ()), automatic)
    if key.kind == "relation" and state is not None and status != "unsure":
        verdict = letter(state)
    elif key.kind != "relation" and status == "accepted" and _changed_before(event, of_entity, refs):
        verdict = "corrected"
    else:
        verdict = status
    return Judgement(event.author, status, verdict, at, event.time)


def _said_by(event: Event, automatic: Any) -> tuple[State, int | None]:
    """The status of an event, and of a relation's value the value."""
    ref, after = event.ref, event.after
    if ref.kind == "review":
        return ("unreviewed" if after is None else after["status"]), None
    if not _is_value(ref):
        if after is None:
            return "unreviewed", None
        return ("rejected" if ref.field == "mark" else after), None
    changed = ref.field == "exists" or not same_value(after, automatic)
    return ("corrected" if changed else "accepted"), (after if ref.kind == "relation" else None)


def _value_cell(key: ItemKey) -> FieldRef:
    return FieldRef("relation", key.frame, f"{key.a},{key.b}", key.what)


def _value_at(event: Event, key: ItemKey, values: Sequence[Event], automatic: Labelled | None) -> int | None:
    """The relation's state when the event was saved."""
    before = [e.after for e in values if e.id < event.id]
    if before:
        return before[-1]
    if values:
        return values[0].before
    return None if automatic is None else automatic(key)


def _changed_before(event: Event, of_entity: Sequence[FieldRef], refs: Mapping[FieldRef, Sequence[Event]]) -> bool:
    """Whether people had changed an object or expression when the event was saved."""
    for ref in of_entity:
        earlier = [e for e in refs[ref] if e.id <= event.id]
        if earlier and (ref.field == "exists" or not same_value(earlier[-1].after, earlier[0].before)):
            return True
    return False
