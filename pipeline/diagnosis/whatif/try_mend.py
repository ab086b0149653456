"""Mend of a story tried: its change as edits of a what-if."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from pipeline.diagnosis.answer import Answer
from pipeline.diagnosis.asking import judged
from pipeline.diagnosis.story import change_words
from pipeline.diagnosis.story_words import Change
from pipeline.diagnosis.whatif.changes import became
from pipeline.diagnosis.whatif.edits import Edits, edits_record
from pipeline.diagnosis.whatif.rerun import Baseline, rerun
from pipeline.geometry.boxes import Box3D
from pipeline.geometry.masks import RunLength
from pipeline.labels.cases import FrameCases
from pipeline.proposals.annotations import box_mask
from pipeline.system.errors import InputError, require
from pipeline.system.frozen import dataclass


@dataclass(frozen=True)
class Tried:
    """Answer under the change that its story names."""

    edits: Edits
    answer: Answer
    said: str  # Whether it is right now

    def record(self) -> dict[str, Any]:
        """Convert to JSON."""
        return {"edits": edits_record(self.edits), "said": self.said, "head": self.answer.story.head}


def try_mend(answered: Answer) -> Tried | None:
    """Answer once more under the change that the story names; None where it names none."""
    d, change = answered.diagnosis, answered.story.change
    if d is None or change is None:
        return None
    source, context = d.evidence.answers.source, d.evidence.answers.context
    known: Any = {"case": d.case, "confidence": d.evidence.confidence}
    if change.field == "question":
        after = judged(source.ask(context, change.name), source, context, d.truth, **known)
        return Tried(Edits(), after, change_words(True, answered.story, after.story))
    baseline = Baseline(source, context, answered.text)
    edits = mend_edits(baseline, change, d.truth)
    outcome = rerun(baseline, edits)
    after = judged(outcome.trace, source, context, d.truth, **known)
    return Tried(edits, after, became(baseline.outcome, outcome, answered.story, after.story))


def mend_edits(baseline: Baseline, change: Change, truth: FrameCases, value: float | None = None) -> Edits:
    """Edits by which an answer would be right.

    Parameters
    ----------
    change : Change
        Of the story of the answer without edits.
    value : float, optional
        In place of the number that is enough.

    Raises
    ------
    InputError
        The change names what this answer does not have.
    """
    outcome, p = baseline.outcome, change.after if value is None else value
    known = all(0 <= k < len(outcome.keys) for k in change.objects)
    require(known, "the change is of another answer", got=str(change.objects))
    edits, keys = Edits(), [outcome.keys[k] for k in change.objects]
    match change.field:
        case "relations":
            # In the order in which the relation is judged.
            a, b = keys[::-1] if outcome.trace.inverse else keys
            return edits.with_relation(change.name, a, b, p or 0.0)
        case "confidences":
            return _with_scores(edits, change.names or (change.name,), keys, p)
        case "boxes":
            box = _labelled_box(truth, _at(truth, change.labelled[0][1]))
            return edits if box is None else edits.with_box(keys[0], box)
        case "masks":
            k = _at(truth, change.labelled[0][1])
            edits = _shaped(replace(edits, masks={keys[0]: _mask(baseline, truth, k)}), keys[0], truth, k)
            edits = edits if p == change.before else _with_scores(edits, change.names, keys, p)
            return _with_added(baseline, edits, truth, change.labelled[1:], p)
        case "added":
            edits = _with_scores(edits, change.names, keys, p)
            return _with_added(baseline, edits, truth, change.labelled, p)
    raise InputError("there is no such change", got=change.field)


def _with_scores(edits: Edits, names: Sequence[str], keys: Sequence[str], p: float | None) -> Edits:
    for name, key in zip(names, keys, strict=True):
        edits = edits.with_confidence(name, key, p or 0.0)
    return edits


def _with_added(
    baseline: Baseline, edits: Edits, truth: FrameCases, labelled: Sequence[tuple[str, int]], p: float | None
) -> Edits:
    """Edits with labelled objects found, each by its name."""
    for name, number in labelled:
        k = _at(truth, number)
        edits = edits.with_added(name, _mask(baseline, truth, k), p or 0.0)
        edits = _shaped(edits, tuple(edits.added)[-1], truth, k)
    return edits


def _at(truth: FrameCases, number: int) -> int:
    at = np.flatnonzero(truth.numbers == number)
    require(len(at), "the labels have no such object", got=number)
    return int(at[0])


def _mask(baseline: Baseline, truth: FrameCases, k: int) -> RunLength:
    """Labelled pixels of an object; without any its whole 2D box."""
    frame, code = baseline.context.frame, truth.masks[k]
    shape = frame.height, frame.width
    return RunLength.of(box_mask(truth.boxes[k], *shape)) if code is None else RunLength(shape, code)


def _shaped(edits: Edits, key: str, truth: FrameCases, k: int) -> Edits:
    """Edits with the labelled 3D box where there are no labelled pixels to make one of."""
    box = _labelled_box(truth, k) if truth.masks[k] is None else None
    return edits if box is None else edits.with_box(key, box)


def _labelled_box(truth: FrameCases, k: int) -> Box3D | None:
    """Labelled 3D box of an object; None where there is none."""
    center, R, size = (truth.geometry[name][k] for name in ("center", "R", "size"))
    return Box3D(center, R.reshape(3, 3), size) if all(np.isfinite(part).all() for part in (center, R, size)) else None
