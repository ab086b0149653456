"""*This pair is right*: the answer to a question becomes what is true, by which it is judged from then on."""

from __future__ import annotations

from datetime import datetime, timezone

import numpy as np

from pipeline.answering.ask import Trace
from pipeline.answering.objects import SceneObject
from pipeline.answering.pair_table import ScoredPair
from pipeline.corrections.journal.edits import Edits, add_object, add_sentence, new_numbers
from pipeline.corrections.journal.effective_frame import EffectiveFrame
from pipeline.corrections.journal.events import new_ulid
from pipeline.corrections.label_editor import NOT_IN_THE_JOURNAL, LabelEditor
from pipeline.corrections.scene import labelled_objects
from pipeline.corrections.unsaved import Waiting
from pipeline.labels.cases import HIT
from pipeline.language.naming import same_class
from pipeline.language.tree import Query
from pipeline.system.errors import needed, require


def right_pair(editor: LabelEditor, trace: Trace, pair: ScoredPair) -> Edits:
    """The edits by which a pair of an answer is right: its objects, where the labels lack them, and the sentence.

    Parameters
    ----------
    editor : LabelEditor
        Its labels hold the frame: see `take_in`.
    trace : Trace
        Of the question.
    pair : ScoredPair
        One that was ranked.

    Raises
    ------
    InputError
        The question says more than a relation between two names, or the labels say so already.
    """
    words = words_of(trace.query)
    reference = needed(pair.reference, "the answer is no pair")
    frame = editor.frame(trace.frame.id)
    ends = (words[0], trace.objects[pair.target]), (words[2], trace.objects[reference])
    numbers: list[int] = []
    new: Edits = ()
    for (name, entry), free in zip(ends, new_numbers(frame, 2), strict=True):
        number = _labelled(name, entry, frame)
        if number is None:
            made = add_object(frame, name, mask=entry.mask, number=free)
            number, new = free, (*new, *made)
        numbers.append(number)
    if new:
        # The relation and the sentence are made on the frame with these objects in it.
        waiting = Waiting(new, editor.author, new_ulid(), datetime.now(timezone.utc), "")
        events = [*editor.events(frame.frame), *waiting.events(NOT_IN_THE_JOURNAL, "")]
        frame = editor.corrector.frame(frame.frame, events)
    return (*new, *add_sentence(frame, trace.query.text, words, numbers[0], numbers[1], "this pair is right"))


def right_objects(frame: EffectiveFrame, query: Query, a: int, b: int) -> Edits:
    """The edits by which a question means two labelled objects, whatever was answered; raises as `right_pair`."""
    return add_sentence(frame, query.text, words_of(query), a, b, "this pair is right")


def words_of(query: Query) -> tuple[str, str, str]:
    """Target, relation and reference of a question.

    Raises
    ------
    InputError
        It says more, or less, than one relation between two names.
    """
    e, top = query.expression, query.default.root.triple
    plain = e is not None and top is not None and len(query.readings) == 1 and not e.inverse
    if not plain or e is None or e.second_reference is not None:
        require(False, "only a relation between two names can be kept as true", got=query.text)
        raise AssertionError
    return e.target, e.relation, e.reference


def _labelled(name: str, entry: SceneObject, frame: EffectiveFrame) -> int | None:
    """The labelled object that an object of an answer is: of its class, and the one whose pixels are most its own."""
    best: tuple[float, int | None] = (HIT, None)
    for other in labelled_objects(frame):
        if other.label == name or same_class(other.label, name):
            both = np.count_nonzero(other.mask & entry.mask)
            overlap = both / max(np.count_nonzero(other.mask | entry.mask), 1)
            best = max(best, (overlap, other.id), key=lambda found: found[0])
    return best[1]
