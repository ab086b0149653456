"""From what the Edit tab sends to edits: every message is a few words between colons, and the core checks them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from pipeline.answering.objects import SceneObject
from pipeline.answering.opening import Pipeline
from pipeline.diagnosis.verdict import Diagnosis
from pipeline.diagnosis.whatif import Edits
from pipeline.diagnosis.whatif.placement import box_numbers, grown, labelled_mask, rectangle, with_numbers
from pipeline.geometry.boxes import Box3D
from pipeline.relations.installed import installed_network
from pipeline.system.errors import InputError
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
    what, *rest = said.split(":")
    if what not in _EDITS:
        raise InputError("there is no such edit", got=said)
    return _EDITS[what](state, source, keys, rest)


def _number(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not np.isfinite(value):
        raise InputError("this must be a number", got=repr(text))
    return value


def _selected(state: State, keys: tuple[str, ...]) -> tuple[str, SceneObject]:
    """The selected object, which must be a candidate."""
    for trace_place, shown_place in state.shown.place.items():
        if shown_place == state.selected:
            return keys[trace_place], state.shown.objects[shown_place]
    raise InputError("no candidate of the question is selected")


def _chosen(state: State, keys: tuple[str, ...]) -> tuple[str, str]:
    """The keys of the chosen pair, in the order in which the relation is judged."""
    pair = state.chosen
    if state.trace is None or pair is None or pair.reference is None or pair.second_reference is not None:
        raise InputError("no pair of two objects is chosen")
    ends = keys[pair.target], keys[pair.reference]
    return (ends[1], ends[0]) if state.trace.inverse else ends


def _box_of(state: State, keys: tuple[str, ...]) -> tuple[str, Box3D]:
    key, entry = _selected(state, keys)
    if entry.lifted.box is None:
        raise InputError("the selected object has no 3D box: there is no depth in its pixels")
    return key, entry.lifted.box


def _place(state: State, source: Pipeline, keys: tuple[str, ...], rest: list[str]) -> Edits:
    """center:AXIS:METRES, size:AXIS:METRES, yaw:DEGREES."""
    what, *numbers = rest
    key, box = _box_of(state, keys)
    assert state.loaded is not None
    viewer = state.loaded.context.viewer
    now = box_numbers(box, viewer)
    if what == "yaw":
        return state.edits.with_box(key, with_numbers(box, viewer, yaw=_number(numbers[0])))
    axis, value = int(numbers[0]), _number(numbers[1])
    three = list(getattr(now, what))
    three[axis] = value
    found = (three[0], three[1], three[2])
    changed = with_numbers(box, viewer, center=found) if what == "center" else with_numbers(box, viewer, size=found)
    return state.edits.with_box(key, changed)


def _hide(state: State, source: Pipeline, keys: tuple[str, ...], rest: list[str]) -> Edits:
    entry = None if state.selected is None else state.shown.objects[state.selected]
    if entry is not None and entry.id >= 0 and f"#{entry.id}" in state.edits.hidden:
        return state.edits.with_shown(f"#{entry.id}")
    return state.edits.with_hidden(_selected(state, keys)[0])


def _confidence(state: State, source: Pipeline, keys: tuple[str, ...], rest: list[str]) -> Edits:
    """confidence:NUMBER OF THE NAME:P."""
    assert state.trace is not None
    name = list(state.trace.candidates)[int(rest[0])]
    return state.edits.with_confidence(name, _selected(state, keys)[0], _number(rest[1]))


def _relation(state: State, source: Pipeline, keys: tuple[str, ...], rest: list[str]) -> Edits:
    """relation:A:B:P, of the asked relation of two objects that are shown; without A and B of the chosen pair.

    A slider names its own pair: what is chosen moves on where the answer does, while the hand still holds the slider.
    """
    assert state.trace is not None
    *ends, value = rest
    if not ends:
        return state.edits.with_relation(state.trace.relation, *_chosen(state, keys), _number(value))
    at = {shown: keys[t] for t, shown in state.shown.place.items()}
    places = [int(_number(end)) for end in ends]
    if len(places) != 2 or not all(place in at for place in places):
        raise InputError("the pair is no longer among the candidates")
    return state.edits.with_relation(state.trace.relation, at[places[0]], at[places[1]], _number(value))


def _mask(state: State, source: Pipeline, keys: tuple[str, ...], rest: list[str]) -> Edits:
    """mask:grow:PIXELS, mask:label, mask:swap, mask:rectangle:x0,y0,x1,y1."""
    key, entry = _selected(state, keys)
    assert state.loaded is not None
    frame = state.loaded.context.frame
    if rest[0] == "grow":
        mask = grown(entry.mask, int(_number(rest[1])))
    elif rest[0] == "rectangle":
        corners = [_number(part) for part in rest[1].split(",")]
        if len(corners) != 4:
            raise InputError("a rectangle has four numbers", got=rest[1])
        mask = rectangle(frame.height, frame.width, (corners[0], corners[1], corners[2], corners[3]))
    elif rest[0] == "label":
        truth = state.judged.truth if isinstance(state.judged, Diagnosis) else None
        found = None if truth is None else labelled_mask(truth, entry.bbox, frame.height, frame.width)
        if found is None:
            raise InputError("no labelled object with a mask is where the selected one is")
        mask = found
    else:
        a, b = partners(state)
        trace_place = {shown: t for t, shown in state.shown.place.items()}
        one, other = keys[trace_place[a]], keys[trace_place[b]]
        masks = [state.shown.objects[i].mask for i in (a, b)]
        return _without_boxes(state.edits, one, other).with_mask(one, masks[1]).with_mask(other, masks[0])
    return _without_boxes(state.edits, key).with_mask(key, mask)


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
    if other == state.selected:
        raise InputError("an object cannot swap with itself")
    return state.selected, other


def _without_boxes(edits: Edits, *keys: str) -> Edits:
    """A new mask is lifted anew: a box that was placed by hand would hide what it does."""
    return replace(edits, boxes={k: box for k, box in edits.boxes.items() if k not in keys})


def _setting(state: State, source: Pipeline, keys: tuple[str, ...], rest: list[str]) -> Edits:
    """set:NAME:VALUE; a value that is that of the source is no edit."""
    name, value = rest
    edits = state.edits
    if name == "k":
        wanted = int(_number(value))
        return edits.with_k(None if wanted == source.config.k else wanted)
    if name == "min_score":
        least = _number(value)
        return edits.with_min_score(least or None)
    if name == "scorer":
        return edits.with_scorer(None if value == "own" else _known_scorer(value))
    if name == "aggregate":
        return edits.with_settings("rank", aggregate=value)
    if name in WEIGHTS:
        return edits.with_settings("rank", **{name: _number(value)})
    if name in PROFILE_SETTINGS:
        return edits.with_settings("profile", **{name: _number(value)})
    raise InputError("there is no such setting", got=name)


def _known_scorer(name: str) -> str:
    if name not in ("rule", "trained") and installed_network(name) is None:
        raise InputError("there is no such relation scorer", got=name, expected="rule, trained, or an installed one")
    return name


_Edit = Callable[[State, Pipeline, tuple[str, ...], list[str]], Edits]


_EDITS: Mapping[str, _Edit] = {
    "center": lambda s, o, k, r: _place(s, o, k, ["center", *r]),
    "size": lambda s, o, k, r: _place(s, o, k, ["size", *r]),
    "yaw": lambda s, o, k, r: _place(s, o, k, ["yaw", *r]),
    "hide": _hide,
    "confidence": _confidence,
    "relation": _relation,
    "mask": _mask,
    "set": _setting,
}
