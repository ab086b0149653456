"""Edits as short words between colons, such as "size:1:0.2" or "k:5", for the Edit tab and `whatif --do`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from pipeline.answering.frame_store import LoadedFrame
from pipeline.answering.objects import SceneObject
from pipeline.answering.pipeline import Pipeline
from pipeline.diagnosis.verdict import Diagnosis
from pipeline.diagnosis.whatif.answer_view import AnswerView, answer_view
from pipeline.diagnosis.whatif.edits import Edits
from pipeline.diagnosis.whatif.placement import box_numbers, grown, labelled_mask, rectangle, with_numbers
from pipeline.diagnosis.whatif.rerun import Baseline, rerun
from pipeline.geometry.boxes import Box3D
from pipeline.geometry.viewer import ViewerAxes
from pipeline.relations.model import is_named
from pipeline.system.errors import InputError, as_input_error, needed, require

PROFILE_SETTINGS = ("cone", "doubtful_cone", "dead_zone", "dead_zone_depth")
WEIGHTS = ("target_weight", "reference_weight", "relation_weight")


def edit_from_words(said: str, view: AnswerView, pipeline: Pipeline, keys: tuple[str, ...]) -> Edits:
    """Add an edit in words to the edits of a view.

    Parameters
    ----------
    said : str
        Of the selected object "center:AXIS:METRES" (0 right, 1 forward, 2 up), "size:AXIS:METRES" (0 width, 1 height, 2
        depth), "yaw:DEGREES", "hide", "confidence:NAME:P" (NAME counted from 0), "mask:grow:PIXELS", "mask:label",
        "mask:rectangle:X0,Y0,X1,Y1" (shares of the picture); of the chosen pair "relation:P"; of the
        settings "set:NAME:VALUE".
    keys : tuple of str
        Of the objects of the answer that is shown.

    Raises
    ------
    InputError
        For what cannot be done, and why.
    """
    edits, (what, *rest) = view.edits, said.split(":")
    match what, rest:
        case "center" | "size" | "yaw", _:
            key, entry = _selected(view, keys)
            box = needed(entry.lifted.box, "the selected object has no 3D box: there is no depth in its pixels")
            return edits.with_box(key, box_with(box, _loaded(view).context.viewer, what, rest))
        case "hide", _:
            entry = None if view.selected is None else view.shown.objects[view.selected]
            if entry is not None and entry.id >= 0 and f"#{entry.id}" in edits.hidden:
                return edits.with_shown(f"#{entry.id}")
            return edits.with_hidden(_selected(view, keys)[0])
        case "confidence", [number, p]:
            names = dict(enumerate(needed(view.trace, "nothing is asked").candidates))
            name = needed(names.get(int(number_of([number]))), "the question has no such name, counted from 0")
            return edits.with_confidence(name, _selected(view, keys)[0], number_of([p]))
        case "relation", [*ends, p]:
            return _relation(view, keys, ends, number_of([p]))
        case "mask", [way, *more]:
            # A new mask is lifted anew: a box that was placed by hand would hide what it does.
            key, mask = _mask(view, keys, way, more)
            boxes = {k: box for k, box in edits.boxes.items() if k != key}
            return replace(edits, boxes=boxes).with_mask(key, mask)
        case "set", [name, value]:
            return _setting(edits, pipeline, name, value)
    raise InputError("there is no such edit", got=said)


def edits_from_words(baseline: Baseline, edits: Edits, said: Sequence[str], key: str | None = None) -> Edits:
    """Add edits in words to the edits of a question, in order.

    Parameters
    ----------
    said : sequence of str
        As for `edit_from_words`; the pair that they are of is the answer.
    key : str, optional
        Of the object that they are of. Default: the target of the answer.
    """
    for words in said:
        outcome = rerun(baseline, edits)
        edits = edit_from_words(
            words, answer_view(baseline.context, outcome, edits, key), baseline.source, outcome.keys
        )
    return edits


def number_of(words: Sequence[str]) -> float:
    """Number in a single word; InputError for none."""
    with as_input_error("this must be a number", ValueError, got=repr(":".join(words))):
        (value,) = map(float, words)
    require(np.isfinite(value), "this must be a number", got=repr(words[0]))
    return value


def box_with(box: Box3D, viewer: ViewerAxes, what: str, numbers: Sequence[str]) -> Box3D:
    """Box after "center" AXIS METRES, "size" AXIS METRES or "yaw" DEGREES; InputError for anything else."""
    value: Any = number_of(numbers[-1:])
    if what != "yaw":
        known = what in ("center", "size") and len(numbers) == 2 and numbers[0] in ("0", "1", "2")
        require(known, "a box has no such number", got=":".join((what, *numbers)))
        now = getattr(box_numbers(box, viewer), what)
        value = tuple(value if axis == int(numbers[0]) else x for axis, x in enumerate(now))
    changed: dict[str, Any] = {what: value}
    return with_numbers(box, viewer, **changed)


def _loaded(view: AnswerView) -> LoadedFrame:
    return needed(view.loaded, "the frame is broken")


def _selected(view: AnswerView, keys: tuple[str, ...]) -> tuple[str, SceneObject]:
    """Selected object, necessarily a candidate."""
    for trace_place, shown_place in view.shown.place.items():
        if shown_place == view.selected:
            return keys[trace_place], view.shown.objects[shown_place]
    raise InputError("no candidate of the question is selected")


def _relation(view: AnswerView, keys: tuple[str, ...], ends: list[str], p: float) -> Edits:
    """Set the probability of the asked relation for two objects by their places; without any for the chosen pair.

    A slider names its own pair: what is chosen moves on where the answer does, while the hand still holds the slider.
    """
    trace, pair = needed(view.trace, "nothing is asked"), view.chosen
    if ends:
        at = {str(shown): keys[t] for t, shown in view.shown.place.items()}
        require(len(ends) == 2 and set(ends) <= set(at), "the pair is no longer among the candidates")
        a, b = (at[end] for end in ends)
    else:
        # In the order in which the relation is judged.
        if pair is None or pair.reference is None or pair.second_reference is not None:
            raise InputError("no pair of two objects is chosen")
        a, b = (keys[i] for i in (pair.target, pair.reference)[:: -1 if trace.inverse else 1])
    return view.edits.with_relation(trace.relation, a, b, p)


def _mask(view: AnswerView, keys: tuple[str, ...], way: str, more: list[str]) -> tuple[str, np.ndarray]:
    """Mask of the selected object, after its key: "grow" PIXELS, the "label"'s, or "rectangle" x0,y0,x1,y1."""
    (key, entry), frame = _selected(view, keys), _loaded(view).context.frame
    match way:
        case "grow":
            return key, grown(entry.mask, int(number_of(more)))
        case "rectangle":
            corners = [number_of([part]) for part in ":".join(more).split(",")]
            require(len(corners) == 4, "a rectangle has four numbers", got=":".join(more))
            return key, rectangle(frame.height, frame.width, (corners[0], corners[1], corners[2], corners[3]))
        case "label":
            truth = view.judged.truth if isinstance(view.judged, Diagnosis) else None
            found = None if truth is None else labelled_mask(truth, entry.bbox, frame.height, frame.width)
            return key, needed(found, "no labelled object with a mask is where the selected one is")
    raise InputError("there is no such mask", got=way, expected="grow, rectangle or label")


def _setting(edits: Edits, pipeline: Pipeline, name: str, value: str) -> Edits:
    """Set a value; the pipeline's own value is no edit."""
    match name:
        case "scorer":
            expected = "rule, trained, or an installed one"
            require(value == "own" or is_named(value), "there is no such relation scorer", got=value, expected=expected)
            return edits.with_scorer(None if value == "own" else value)
        case "k":
            k = int(number_of([value]))
            return edits.with_k(None if k == pipeline.config.k else k)
        case "min_score":
            return edits.with_min_score(number_of([value]) or None)
    require(name in WEIGHTS or name in PROFILE_SETTINGS, "there is no such setting", got=name)
    return edits.with_settings("rank" if name in WEIGHTS else "profile", **{name: number_of([value])})
