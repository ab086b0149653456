"""The states of items as people go on saving: of frames in which something was saved, as a queue made now has them."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence

from pipeline.corrections.journal.effective import Corrector
from pipeline.corrections.journal.effective_frame import EffectiveFrame
from pipeline.corrections.journal.events import Event
from pipeline.corrections.journal.journal import Journal
from pipeline.corrections.review.items import SETTLED, ItemKey, State
from pipeline.corrections.review.states import item_of, judgements_of
from pipeline.corrections.review.worklist import Worklist
from pipeline.language.relation_names import PAIRWISE
from pipeline.relations.relations import letter

Mark = tuple[int, str]
"""An event of a journal: `id` and `ulid`. The second tells a journal from one that was put in its place."""
NOTHING: Mark = (0, "")
"""Stands before the first event."""


def frame_states(frame: EffectiveFrame, events: Sequence[Event]) -> dict[ItemKey, State]:
    """The states of a frame's items over all people, as `reviewed.states_on_labels` has those of all frames.

    Parameters
    ----------
    frame : EffectiveFrame
    events : sequence of Event
        All of it, in the order of their saving.
    """

    def automatic(key: ItemKey) -> int | None:
        return frame.auto.pairs.state(key.a, -1 if key.b is None else key.b, key.what)

    ignored = {u.event.ulid for u in frame.unapplied if u.kind != "agreed"}
    judgements = judgements_of(events, automatic=automatic, ignored=ignored)
    states = judgements.states()
    for key in states:
        if key.kind != "relation" or key.b is None or key.what not in PAIRWISE:
            continue
        now, said = frame.pairs.state(key.a, key.b, key.what), judgements.said(key)
        if now is not None and said in ("T", "U", "F") and said != letter(now):
            states[key] = "unsure"
    return states


def refreshed_worklist(work: Worklist, corrector: Corrector, journal: Journal, after: Mark) -> tuple[Worklist, Mark]:
    """A list with what became of its items since an event, whoever saved it: their states, and which of them have gone.

    Parameters
    ----------
    after : Mark
        The newest event that is known already. Where the journal lacks it, that is another one now, such as a copy that
        was put back: then nothing of what was known holds.

    Returns
    -------
    work : Worklist
    newest : Mark
        The newest event.

    Raises
    ------
    InputError
        The journal or a frame cannot be read.
    """
    fresh, standing = _since(journal, after)
    names = [e.cell.frame for e in fresh]
    if not standing:
        names += work.touched
        work = work.untouched()
    for frame, states in _changed(corrector, journal, names):
        keys = [work.keys[place] for place in work.frames.get(frame.frame, ())]
        work = work.with_states(states).with_gone(frame.frame, gone_items(frame, keys, states))
    return work, mark_of(fresh) if fresh or not standing else after


def mark_of(events: Sequence[Event]) -> Mark:
    """The newest of events in the order of their saving."""
    return (events[-1].id, events[-1].ulid) if events else NOTHING


def _since(journal: Journal, after: Mark) -> tuple[Sequence[Event], bool]:
    """The events after one, and whether that one is still there; all events where it is not."""
    if after == NOTHING:
        return journal.events(), True
    # Nothing is ever taken out of a journal: with that event it has all that came before.
    found = journal.events(after=after[0] - 1)
    if found and found[0].ulid == after[1]:
        return found[1:], True
    return journal.events(), False


def gone_items(
    frame: EffectiveFrame, keys: Collection[ItemKey], states: Mapping[ItemKey, State]
) -> frozenset[ItemKey]:
    """The items of a frame that a queue made now would not have: nothing is left that could be right or wrong.

    A relation goes with its pair, an expression with its objects, everything with its frame. An object or expression
    that somebody has settled, by leaving it out for one, stays.
    """

    def stands(key: ItemKey) -> bool:
        if key.kind != "relation" and states.get(key.plain) in SETTLED:
            return True
        if not frame.stands:
            return False
        if key.kind == "relation":
            return frame.pairs.state(key.a, -1 if key.b is None else key.b, key.what) is not None
        if key.kind == "expression":
            return key.what in frame.expressions
        return key.a < 0 or key.a in frame.objects

    return frozenset(key for key in keys if not stands(key))


def _changed(
    corrector: Corrector, journal: Journal, names: Iterable[str]
) -> Iterator[tuple[EffectiveFrame, dict[ItemKey, State]]]:
    """Frames, each with the states of the items that its events are about."""
    for name in dict.fromkeys(names):
        if name not in corrector.index.of_frame:
            continue
        events = journal.events(frame=name)
        frame = corrector.frame(name, events)
        states = frame_states(frame, events)
        keys = (item_of(e.cell) for e in events)
        yield frame, {key: states.get(key, "unreviewed") for key in keys if key is not None}
