"""View of an answer: shown objects with names, the chosen pair, the selection, effects of edits."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import field, replace
from functools import cached_property
from typing import TypeVar

import numpy as np

from pipeline.answering.ask import Trace
from pipeline.answering.frame_store import LoadedFrame
from pipeline.answering.objects import PreparedFrame, SceneObject
from pipeline.answering.pair_table import ScoredPair
from pipeline.diagnosis.answer import Answer, Judged
from pipeline.diagnosis.story_words import UNTOLD, Story
from pipeline.diagnosis.verdict import Diagnosis
from pipeline.diagnosis.whatif.edits import Edits
from pipeline.diagnosis.whatif.rerun import Outcome
from pipeline.geometry.boxes import Box3D, iou_2d
from pipeline.geometry.palette import Role
from pipeline.system.errors import require
from pipeline.system.frozen import dataclass


@dataclass(frozen=True)
class ShownObjects:
    """Objects of a view: all of the frame, and those found by the question alone."""

    objects: tuple[SceneObject, ...]
    # "mug·3": the class and the place in the list (the dataset's own where the objects are the dataset's).
    names: tuple[str, ...]
    place: Mapping[int, int]  # place in the trace's objects -> place in `objects`

    def in_roles(self, trace: Trace, pair: ScoredPair) -> ShownObjects:
        """Objects with each of a pair under the name and the score of its role.

        A detector may take the same object for a mug and, less surely, for a laptop; its number stays.
        """
        objects = list(self.objects)
        for i, name in trace.names_in(pair).items():
            objects[self.place[i]] = trace.under(name, i)
        return replace(self, objects=tuple(objects), names=_named(objects, trace.exact))


NOTHING = ShownObjects((), (), {})
"""Of a broken frame."""


def shown_objects(loaded: LoadedFrame, trace: Trace | None, exact: bool, before: Trace | None = None) -> ShownObjects:
    """Objects of a frame, then those found by the question's own detector runs alone.

    An object found under several names has its surest name, until looked at as a part of a pair
    (`ShownObjects.in_roles`). An object taken out by an edit keeps its name of the answer `before`.
    """
    objects = list(loaded.objects)
    by_id = {o.id: i for i, o in enumerate(objects) if o.id >= 0}
    for _, entry in () if before is None else _most_surely(before):
        if entry.id in by_id:
            objects[by_id[entry.id]] = entry
    place: dict[int, int] = {}
    for i, entry in () if trace is None else _most_surely(trace):
        at = place[i] = by_id.get(entry.id, len(objects))
        objects[at : at + 1] = [entry]
    return ShownObjects(tuple(objects), _named(objects, exact), place)


def _most_surely(trace: Trace) -> Iterator[tuple[int, SceneObject]]:
    """Places of a trace's objects, each with its object under its surest name."""
    best: dict[int, tuple[float, SceneObject]] = {}
    for name, found in trace.candidates.items():
        for i, score in zip(found.index.tolist(), found.scores.tolist(), strict=True):
            number = trace.objects[i].id
            key = number if number >= 0 else -1 - i
            if key not in best or score > best[key][0]:
                best[key] = score, trace.under(name, i)
    for i, entry in enumerate(trace.objects):
        yield i, best.get(entry.id if entry.id >= 0 else -1 - i, (0.0, entry))[1]


def _named(objects: list[SceneObject], exact: bool) -> tuple[str, ...]:
    return tuple(o.name(i, exact) for i, o in enumerate(objects))


View = TypeVar("View", bound="AnswerView")


@dataclass(frozen=True)
class OtherAnswer(Answer):
    """Answer of another run to the same question about the same frame."""

    name: str = field(kw_only=True)  # Of its system


@dataclass(frozen=True)
class ExtraBox:
    """Extra box in a view: of the label, of another run's answer, or to blame."""

    key: str
    text: str
    box: Box3D  # Camera frame
    role: Role  # "truth" for the label's, "edited" for the other run's, "other" for a blamed one as found
    of: int | None = None  # The same thing as found, in `shown.objects`: in another box


def same_thing(trace: Trace | None, place: int | None, other: SceneObject) -> bool:
    """True where two answers mean the same object, as in the comparison of two runs."""
    if trace is None or place is None:
        return False
    return float(iou_2d(trace.objects[place].bbox, other.bbox)[0, 0]) >= 0.5


@dataclass(frozen=True)
class BothAnswers:
    """Answer without and with edits."""

    before: Outcome
    after: Outcome
    judged: Judged  # The verdict on the one before
    seconds: float  # What answering again took the core

    @property
    def story(self) -> Story:
        """What is said of the answer before."""
        return self.judged.story if isinstance(self.judged, Diagnosis) else UNTOLD

    @property
    def changed(self) -> bool:
        """True where the edits have made another pair win."""
        return self.before.winner != self.after.winner

    def pair_before(self, pair: ScoredPair) -> tuple[int | None, ScoredPair | None]:
        """Pair of the unedited answer, after its former rank from 1; None for no candidate."""
        return self.before.ranked.get(self.after.pair_keys(pair), (None, None))

    def relation_before(self, a: int, b: int, relation: str) -> float | None:
        """P("a RELATION b") before the edits, for places in the objects of the answer."""
        keys, scores = (self.after.keys[a], self.after.keys[b]), self.before.trace.scores
        if relation not in scores.relations or not set(keys) <= set(self.before.keys):
            return None
        return float(scores.of(relation)[tuple(map(self.before.keys.index, keys))])


@dataclass(frozen=True, kw_only=True)
class AnswerView:
    """View of a frame and an answer."""

    loaded: LoadedFrame | None = None  # None where the frame is broken
    trace: Trace | None = None
    found: ShownObjects = NOTHING  # What `shown` is made of
    # The chosen pair (with "between", all three), as places in `shown.objects`; kept by objects, not by rank
    pair: tuple[int, ...] | None = None
    selected: int | None = None  # Place in `shown.objects`
    # The verdict on the answer, why there is none, or None where nothing is known of the truth
    judged: Judged = None
    other: OtherAnswer | None = None  # The answer of a run to compare with
    edits: Edits = field(default_factory=Edits)  # Of the question that is asked; they stay when it is asked again
    # `trace` is the answer under the edits, and this has the one without them; None where nothing is edited
    edited: BothAnswers | None = None

    @cached_property
    def shown(self) -> ShownObjects:
        """Shown objects, each of the chosen pair under the name and with the score of its role."""
        chosen = self.chosen
        return self.found if self.trace is None or chosen is None else self.found.in_roles(self.trace, chosen)

    def name_of(self, i: int) -> str:
        """Name of an object of the trace, by its detection."""
        assert self.trace is not None
        number = self.found.names[self.found.place[i]].rpartition("·")[2]
        return f"{self.trace.objects[i].label}·{number}"

    def key_at(self, place: int, keys: tuple[str, ...]) -> str | None:
        """Key of the object at a place, with `keys` those of the trace's objects; None for an object without key.

        Keys are those of `pipeline.diagnosis.whatif.pair_tables`.
        """
        entry = self.shown.objects[place]
        found = next((keys[t] for t, at in self.shown.place.items() if at == place and keys), None)
        return f"#{entry.id}" if entry.id >= 0 else found

    def named(self, key: str) -> str:
        """Name of an object by key; the key itself for a hidden object."""
        if self.edited is not None and key in self.edited.after.keys:
            return self.name_of(self.edited.after.keys.index(key))
        ids = {f"#{o.id}": name for o, name in zip(self.shown.objects, self.shown.names, strict=True) if o.id >= 0}
        return ids.get(key, key)

    @property
    def ranked(self) -> Sequence[ScoredPair]:
        """Ranked pairs; without a relation, single objects."""
        if self.trace is None or self.trace.ranking is None or self.trace.ranking.degenerate:
            return ()
        return self.trace.ranking.pairs

    def at(self, pair: ScoredPair) -> tuple[int, ...]:
        """Ranked pair as places in `shown.objects`: target, reference and, with "between", the other end.

        A single object stands twice.
        """
        ends = (pair.target, pair.target if pair.reference is None else pair.reference, pair.second_reference)
        return tuple(self.found.place[i] for i in ends if i is not None)

    @cached_property
    def chosen(self) -> ScoredPair | None:
        """Chosen ranked pair."""
        return next((p for p in self.ranked if self.at(p) == self.pair), None)

    @cached_property
    def roles(self) -> dict[int, Role]:
        """Roles of the chosen pair's objects, as places in `shown.objects`."""
        if self.pair is None:
            return {}
        roles: dict[int, Role] = {self.pair[1]: "reference"}
        links = () if self.chosen is None else self.chosen.links
        ends = [end for link in links for end in (link.a, link.b, link.c) if end is not None]
        roles |= dict.fromkeys((self.shown.place[end] for end in ends), "reference")
        roles[self.pair[0]] = "target"
        return roles

    @property
    def pair_lines(self) -> list[tuple[int, int]]:
        """The chosen pair, then the next best few, as places in `shown.objects`."""
        if self.pair is None:
            return []
        chosen = (self.pair[0], self.pair[1])
        others = dict.fromkeys((self.at(p)[0], self.at(p)[1]) for p in self.ranked[:6])
        return [ends for ends in (chosen, *(o for o in others if o != chosen)) if ends[0] != ends[1]]

    @cached_property
    def _matched(self) -> dict[str, int]:
        """Labelled objects in the roles of the chosen pair, -1 for none; empty where nothing judges this answer."""
        judged, chosen = self.judged, self.chosen
        if not isinstance(judged, Diagnosis) or self.trace is None or chosen is None:
            return {}
        if judged.evidence.answers.objects is not self.trace.objects:
            return {}
        ends = {"target": chosen.target, "reference": chosen.reference}
        return {role: int(judged.evidence.match[end]) for role, end in ends.items() if end is not None}

    @property
    def label_blamed(self) -> bool:
        """True where nothing failed but the label."""
        return isinstance(self.judged, Diagnosis) and self.judged.verdict == "LABEL"

    @cached_property
    def right_roles(self) -> frozenset[str]:
        """Roles of the chosen pair that a right object fills, in a box that is not to blame."""
        judged, matched = self.judged, self._matched
        if not isinstance(judged, Diagnosis) or not matched or "LIFT" in judged.repair:
            return frozenset()
        # Beside a label that names another the answer is right, too, but not by it.
        targets = [judged.case.target_object] if judged.verdict == "LABEL" else judged.case.acceptable
        right = {"target": targets, "reference": [judged.case.reference_object]}
        return frozenset(role for role, found in matched.items() if found in right[role])

    @cached_property
    def lit(self) -> list[np.ndarray]:
        """(H, W) bool each: masks of the chosen pair's objects, and of the labelled ones."""
        masks = [self.shown.objects[i].mask for i in self.roles]
        if isinstance(self.judged, Diagnosis):
            masks += map(self.judged.evidence.objects.mask, self.judged.labelled.values())
        return masks

    @property
    def ghosts(self) -> list[ExtraBox]:
        """Labelled target and reference in 3D where the pair's are others, and the other run's where different."""
        found: list[ExtraBox] = []
        if isinstance(self.judged, Diagnosis):
            # Another answer may be right beside the labelled one.
            before = "label:" if self.judged.verdict == "LABEL" else "should be"
            names = {role: self.judged.truth.labels[k] for role, k in self.judged.labelled.items()}
            ends: dict[str, int] = dict(zip(("target", "reference"), self.pair or (), strict=False))
            same = {role: ends[role] for role, k in self.judged.labelled.items() if self._matched.get(role) == k}
            found = [
                ExtraBox(role, f"{before} {names[role]}", box, "truth", same.get(role))
                for role, box in self.judged.labelled_boxes().items()
                if role not in self.right_roles
            ]
            if (blamed := self._blamed(self.judged)) is not None:
                found.append(blamed)
        other, mine = self.other, self.ranked[0] if self.ranked else None
        if other is None or not other.pairs:
            return found
        best = other.pairs[0]
        others = (
            ("target", best.target, None if mine is None else mine.target),
            ("reference", best.reference, None if mine is None else mine.reference),
        )
        for name, place, own in others:
            entry = None if place is None else other.objects[place]
            if entry is not None and entry.lifted.box is not None and not same_thing(self.trace, own, entry):
                found.append(ExtraBox(f"other-{name}", f"{other.name}: {entry.label}", entry.lifted.box, "edited"))
        return found

    def _blamed(self, judged: Diagnosis) -> ExtraBox | None:
        """Box that LIFT blames, as found, where it is of neither object of the chosen pair."""
        objects, needed = judged.evidence.answers.objects, judged.needed_box
        if needed is None or not self._matched or judged.right is None:
            return None
        place, box = needed[0], objects[needed[0]].lifted.box
        if box is None or self.found.place[place] in (self.pair or ()):
            return None
        role = "target" if place == judged.right.target else "reference"
        return ExtraBox(f"found-{role}", f"{self.name_of(place).replace('·', ' ')} as found", box, "other")

    @property
    def other_pair(self) -> str:
        """Difference of the other run's answer from the pair; empty where either is missing."""
        mine, other = self.ranked[0] if self.ranked else None, self.other
        if mine is None or other is None or not other.pairs:
            return ""
        ends = ((mine.target, other.pairs[0].target), (mine.reference, other.pairs[0].reference))
        same = [a is not None and b is not None and same_thing(self.trace, a, other.objects[b]) for a, b in ends]
        found = {(True, True): "the same pair", (True, False): "the same target, another reference"}
        return found.get((same[0], same[1]), "another target")

    def under(self: View, edits: Edits, edited: BothAnswers, judged: Judged, keys: tuple[str, ...]) -> View:
        """View with an answer under edits; `keys` are those of the objects of the trace until now.

        The selection stays. The chosen pair stays, too, unless it was the answer: then it is the new one.
        """
        assert self.loaded is not None
        outcome, trace = edited.after, edited.after.trace
        chosen, named = self.chosen, None
        # The answer itself is followed by the new one.
        if chosen is not None and chosen is not self.ranked[0]:
            named = [keys[i] for i in (chosen.target, chosen.reference, chosen.second_reference) if i is not None]
        selected = None if self.selected is None else self.key_at(self.selected, keys)
        changed = replace(
            self,
            trace=trace,
            edits=edits,
            edited=edited if edits else None,
            judged=judged,
            found=shown_objects(self.loaded, trace, trace.exact, edited.before.trace),
            pair=None,
            selected=None,
        )
        at = {key: changed.shown.place[i] for i, key in enumerate(outcome.keys)}
        at |= {f"#{o.id}": i for i, o in enumerate(changed.shown.objects) if o.id >= 0 and f"#{o.id}" not in at}
        pairs = [changed.at(p) for p in changed.ranked]
        kept = None if named is None else tuple(at.get(key) for key in named)
        pair = next((pair for pair in pairs if pair == kept), pairs[0] if pairs else None)
        return replace(changed, pair=pair, selected=None if selected is None else at.get(selected))

    def key_of(self, place: int) -> str | None:
        """Key of the object at a place; None for one without a key: of no candidate, by a detector without ids."""
        return self.key_at(place, () if self.edited is None else self.edited.after.keys)

    def place_of(self, key: str) -> int | None:
        """Place of the object of a key; None for an unknown key."""
        if self.edited is not None and key in self.edited.after.keys:
            return self.shown.place.get(self.edited.after.keys.index(key))
        return next((i for i, o in enumerate(self.shown.objects) if key == f"#{o.id}"), None)


def answer_view(context: PreparedFrame, outcome: Outcome, edits: Edits, key: str | None = None) -> AnswerView:
    """Initial view of an answer under edits: the best pair, with the target or the object of a key selected."""
    loaded, trace = LoadedFrame(context, ()), outcome.trace
    view = AnswerView(loaded=loaded, trace=trace, found=shown_objects(loaded, trace, trace.exact), edits=edits)
    pair = next(map(view.at, view.ranked), None)
    known = key is None or key in outcome.keys
    require(known, "the answer has no such object", got=key, expected=", ".join(outcome.keys[:30]))
    selected = pair[0] if key is None and pair is not None else None
    return replace(view, pair=pair, selected=selected if key is None else view.shown.place[outcome.keys.index(key)])
