"""The states of items as people go on saving: of frames in which something was saved, as a queue made now has them."""

from __future__ import annotations

from collections.abc import Sequence

from pipeline.journal.effective import Corrector
from pipeline.journal.effective_frame import EffectiveFrame
from pipeline.journal.events import Event
from pipeline.journal.journal import Journal
from pipeline.relations import PAIRWISE, letter
from pipeline.review.items import ItemKey, State
from pipeline.review.states import item_of, judgements_of


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


def states_since(corrector: Corrector, journal: Journal, after: int) -> tuple[dict[ItemKey, State], int]:
    """What became of items since an event, whoever saved it.

    Parameters
    ----------
    after : int
        `id` of the newest event that is known already.

    Returns
    -------
    states : dict of ItemKey to str
        Of every item that people ever did something to, in the frames with newer events.
    newest : int
        `id` of the newest event.

    Raises
    ------
    InputError
        The journal or a frame cannot be read.
    """
    fresh = journal.events(after=after)
    found: dict[ItemKey, State] = {}
    for name in dict.fromkeys(e.cell.frame for e in fresh):
        if name not in corrector.index.of_frame:
            continue
        events = journal.events(frame=name)
        states = frame_states(corrector.frame(name, events), events)
        keys = (item_of(e.cell) for e in events)
        found |= {key: states.get(key, "unreviewed") for key in keys if key is not None}
    return found, fresh[-1].id if fresh else after
