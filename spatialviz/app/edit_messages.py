"""From what the Edit tab sends to edits: every message is a few words between colons, and the core checks them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from pipeline.answering.objects import SceneObject
from pipeline.answering.opening import Pipeline
from pipeline.diagnosis.verdict import Diagnosis
from pipeline.diagnosis.whatif import Edits
from pipeline.diagnosis.whatif.placement import box_numbers, grown, labelled_mask, rectangle, with_numbers
from pipeline.geometry.boxes import Box3D
from pipeline.geometry.viewer import ViewerAxes
from pipeline.relations.installed import installed_network
from pipeline.system.errors import InputError, as_input_error, needed, require
from spatialviz.app.frames import LoadedFrame
from spatialviz.app.state import State

PROFILE_SETTINGS = ("cone", "doubtful_cone", "dead_zone", "dead_zone_depth")
WEIGHTS = ("target_weight", "reference_weight", "relation_weight")


def edited_by(said: str, state: State, source: Pipeline, keys: tuple[str, ...]) -> Edits:
    """The edits of a state after one more.

    Parameters
    ----------
    said : str
        "size:1:0.2" for the height of the selected object, "k:5", "mask:grow:-2".
    keys : tuple of str
        Of the objects of the answer that is shown.

    Raises
    ------
    InputError
        For what cannot be done, and why.
    """
    edits, (what, *rest) = state.edits, said.split(":")
    match what, rest:
        case "center" | "size" | "yaw", _:
            key, entry = _selected(state, keys)
            box = needed(entry.lifted.box, "the selected object has no 3D box: there is no depth in its pixels")
            return edits.with_box(key, box_with(box, _loaded(state).context.viewer, what, rest))
        case "hide", _:
            entry = None if state.selected is None else state.shown.objects[state.selected]
            if entry is not None and entry.id >= 0 and f"#{entry.id}" in edits.hidden:
                return edits.with_shown(f"#{entry.id}")
            return edits.with_hidden(_selected(state, keys)[0])
        case "confidence", [number, p]:
            name = list(needed(state.trace, "nothing is asked").candidates)[int(number)]
            return edits.with_confidence(name, _selected(state, keys)[0], number_of([p]))
        case "relation", [*ends, p]:
            return _relation(state, keys, ends, number_of([p]))
        case "mask", [way, *more]:
            # A new mask is lifted anew: a box that was placed by hand would hide what it does.
            for key, mask in _masks(state, keys, way, more).items():
                boxes = {k: box for k, box in edits.boxes.items() if k != key}
                edits = replace(edits, boxes=boxes).with_mask(key, mask)
            return edits
        case "set", [name, value]:
            return _setting(edits, source, name, value)
    raise InputError("there is no such edit", got=said)


def number_of(words: Sequence[str]) -> float:
    """The number that one word says; InputError where it says none."""
    with as_input_error("this must be a number", ValueError, got=repr(":".join(words))):
        (value,) = map(float, words)
    require(np.isfinite(value), "this must be a number", got=repr(words[0]))
    return value


def box_with(box: Box3D, viewer: ViewerAxes, what: str, numbers: Sequence[str]) -> Box3D:
    """A box after "center" AXIS METRES, "size" AXIS METRES or "yaw" DEGREES; InputError where it is none of these."""
    value: Any = number_of(numbers[-1:])
    if what != "yaw":
        known = what in ("center", "size") and numbers[0] in ("0", "1", "2")
        require(known, "a box has no such number", got=":".join((what, *numbers)))
        now = getattr(box_numbers(box, viewer), what)
        value = tuple(value if axis == int(numbers[0]) else x for axis, x in enumerate(now))
    changed: dict[str, Any] = {what: value}
    return with_numbers(box, viewer, **changed)


def _loaded(state: State) -> LoadedFrame:
    return needed(state.loaded, "the frame is broken")


def _selected(state: State, keys: tuple[str, ...]) -> tuple[str, SceneObject]:
    """The selected object, which must be a candidate."""
    for trace_place, shown_place in state.shown.place.items():
        if shown_place == state.selected:
            return keys[trace_place], state.shown.objects[shown_place]
    raise InputError("no candidate of the question is selected")


def _relation(state: State, keys: tuple[str, ...], ends: list[str], p: float) -> Edits:
    """The probability of the asked relation for two objects by their places; without any for the chosen pair.

    A slider names its own pair: what is chosen moves on where the answer does, while the hand still holds the slider.
    """
    trace, pair = needed(state.trace, "nothing is asked"), state.chosen
    if ends:
        at = {str(shown): keys[t] for t, shown in state.shown.place.items()}
        require(len(ends) == 2 and set(ends) <= set(at), "the pair is no longer among the candidates")
        a, b = (at[end] for end in ends)
    else:
        # In the order in which the relation is judged.
        if pair is None or pair.reference is None or pair.second_reference is not None:
            raise InputError("no pair of two objects is chosen")
        a, b = (keys[i] for i in (pair.target, pair.reference)[:: -1 if trace.inverse else 1])
    return state.edits.with_relation(trace.relation, a, b, p)


def _masks(state: State, keys: tuple[str, ...], way: str, more: list[str]) -> dict[str, np.ndarray]:
    """By key: "grow" PIXELS, the "label"'s, the other's by "swap", or "rectangle" x0,y0,x1,y1."""
    (key, entry), frame = _selected(state, keys), _loaded(state).context.frame
    match way:
        case "grow":
            return {key: grown(entry.mask, int(number_of(more)))}
        case "rectangle":
            corners = [number_of([part]) for part in more[0].split(",")]
            require(len(corners) == 4, "a rectangle has four numbers", got=more[0])
            return {key: rectangle(frame.height, frame.width, (corners[0], corners[1], corners[2], corners[3]))}
        case "label":
            truth = state.judged.truth if isinstance(state.judged, Diagnosis) else None
            found = None if truth is None else labelled_mask(truth, entry.bbox, frame.height, frame.width)
            return {key: needed(found, "no labelled object with a mask is where the selected one is")}
    a, b = partners(state)
    key_of = {shown: keys[t] for t, shown in state.shown.place.items()}
    return {key_of[a]: state.shown.objects[b].mask, key_of[b]: state.shown.objects[a].mask}


def partners(state: State) -> tuple[int, int]:
    """The two whose masks are swapped: the selected object, and the other end of the chosen pair.

    Raises
    ------
    InputError
        No pair is chosen, or no candidate selected.
    """
    if state.pair is None or state.selected is None or state.selected not in state.shown.place.values():
        raise InputError("swapping takes a selected candidate and a chosen pair")
    other = state.pair[0] if state.selected != state.pair[0] else state.pair[1]
    require(other != state.selected, "an object cannot swap with itself")
    return state.selected, other


def _setting(edits: Edits, source: Pipeline, name: str, value: str) -> Edits:
    """One setting; a value that is that of the source is no edit."""
    match name:
        case "scorer":
            known = value in ("own", "rule", "trained") or installed_network(value) is not None
            expected = "rule, trained, or an installed one"
            require(known, "there is no such relation scorer", got=value, expected=expected)
            return edits.with_scorer(None if value == "own" else value)
        case "aggregate":
            return edits.with_settings("rank", aggregate=value)
        case "k":
            k = int(number_of([value]))
            return edits.with_k(None if k == source.config.k else k)
        case "min_score":
            return edits.with_min_score(number_of([value]) or None)
    require(name in WEIGHTS or name in PROFILE_SETTINGS, "there is no such setting", got=name)
    return edits.with_settings("rank" if name in WEIGHTS else "profile", **{name: number_of([value])})
