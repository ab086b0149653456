"""What one client looks at. Frozen: every change makes a new state, and the page is drawn from it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal

import numpy as np

from pipeline.answering.agreement.frames import SecondDetections
from pipeline.answering.ask import Trace
from pipeline.answering.objects import SceneObject
from pipeline.answering.pair_table import ScoredPair
from pipeline.diagnosis.verdict import Diagnosis
from pipeline.diagnosis.whatif import Edits, Outcome
from pipeline.diagnosis.whatif.changes import PairKeys, pair_keys, ranked_pairs
from pipeline.geometry.boxes import Box3D, iou_2d
from pipeline.geometry.measure import Measurement, measure
from pipeline.geometry.palette import Role
from spatialviz.app.frames import LoadedFrame
from spatialviz.app.label_view import LabelView
from spatialviz.app.place import CameraMode, Place, Task
from spatialviz.app.run_figures import Listing

ColorMode = Literal["rgb", "objects", "depth", "evidence"]
EditMode = Literal["off", "move", "turn", "resize"]
Layers = Literal["both", "a", "b"]
Tool = Literal["", "level", "measure"]


@dataclass(frozen=True)
class Shown:
    """The objects on the page: all of the frame, and those only the question found.

    Attributes
    ----------
    objects : tuple of SceneObject
    names : tuple of str
        "mug·3": the class and the place in the list (the dataset's own where the objects are the dataset's).
    place : dict of int to int
        Place in the trace's objects -> place in `objects`.
    """

    objects: tuple[SceneObject, ...]
    names: tuple[str, ...]
    place: Mapping[int, int]


NOTHING = Shown((), (), {})
"""What a broken frame shows."""


@dataclass(frozen=True)
class OtherAnswer:
    """What another run answers to the same question about the same frame.

    Attributes
    ----------
    name : str
        Of its system.
    trace : Trace or None
    judged : Diagnosis or str or None
    error : str
        Why it cannot be asked.
    """

    name: str
    trace: Trace | None
    judged: Diagnosis | str | None = None
    error: str = ""

    @property
    def best(self) -> ScoredPair | None:
        """Its best pair."""
        if self.trace is None or self.trace.ranking is None or self.trace.ranking.degenerate:
            return None
        return self.trace.ranking.pairs[0]


@dataclass(frozen=True)
class Ghost:
    """A box beside the answer's: of the label, or of another run's answer.

    Attributes
    ----------
    key, text : str
    box : Box3D
        Camera frame.
    role : str
        "truth" for the label's, "edited" for the other run's.
    """

    key: str
    text: str
    box: Box3D
    role: Role


@dataclass(frozen=True)
class SceneFlags:
    """What is shown."""

    cloud: bool = True
    boxes: bool = False
    labels: bool = False
    pairs: bool = True
    truth: bool = False
    axes: bool = False
    context: bool = False
    camera: bool = False
    ghosts: bool = True
    region: bool = False
    grid: bool = False


@dataclass(frozen=True)
class State:
    """One client's view.

    Attributes
    ----------
    source, frame_id : str
    loaded : LoadedFrame or None
        None where the frame is broken.
    problem : str
        Why it is.
    text : str
        The expression as typed.
    trace : Trace or None
    error : str
        Why the expression could not be asked.
    unread : str
        Of which kind that is, as the detail of the verdict PARSE says it.
    shown : Shown
    pair : tuple of int or None
        The chosen pair (with "between", all three), as places in `shown.objects`; kept by objects, not by rank.
    selected : int or None
        Place in `shown.objects`.
    judged : Diagnosis or str or None
        The verdict on the answer, why there is none, or None where nothing is known of the truth.
    listing : Listing or None
        What is searched of the source's run.
    other : OtherAnswer or None
        The answer of a run to compare with.
    edits : Edits
        Of the question that is asked; they stay when it is asked again.
    edited : Edited or None
        `trace` is the answer under the edits, and this has the one without them; None where nothing is edited.
    mode : str
        What the handles in the scene do with the selected object's box.
    labels : LabelView or None
        The labels that are shown, and may be corrected, in place of an answer.
    correctable : bool
        Labels are open that may be corrected.
    layers : str
        Whose boxes are shown where there is a second detector.
    second : int or None
        The selected object of the second detector, where it is not the one that stands for `selected`.
    picking : str
        What the next click on a surface is for, "level" or "measure"; "" selects.
    marks : tuple of (int, int)
        The pixels, none to two, between which is measured.
    point_size : float
        Of the cloud, as a factor.
    hovered : int or None
        The object whose row the mouse is over, as a place in `shown.objects`.
    evaluating : bool
        The run is looked at, rather than one answer.
    stage : str
        The module whose evidence is open; "" leaves it to the answer, "-" is none.
    """

    source: str
    frame_id: str
    loaded: LoadedFrame | None = None
    problem: str = ""
    text: str = ""
    trace: Trace | None = None
    error: str = ""
    unread: str = ""
    shown: Shown = NOTHING
    pair: tuple[int, ...] | None = None
    selected: int | None = None
    colors: ColorMode = "rgb"
    camera: CameraMode = "pair"
    flags: SceneFlags = field(default_factory=SceneFlags)
    dark: bool = True
    judged: Diagnosis | str | None = None
    listing: Listing | None = None
    other: OtherAnswer | None = None
    edits: Edits = field(default_factory=Edits)
    edited: Edited | None = None
    mode: EditMode = "off"
    labels: LabelView | None = None
    correctable: bool = False
    layers: Layers = "both"
    second: int | None = None
    picking: Tool = ""
    marks: tuple[tuple[int, int], ...] = ()
    point_size: float = 1.0
    evaluating: bool = False
    hovered: int | None = None
    stage: str = ""

    @property
    def task(self) -> Task:
        """What the page is for now."""
        return "label" if self.labels is not None else "evaluate" if self.evaluating else "explain"

    def expression_id(self, text: str) -> str | None:
        """The id of the run's expression that is open, where it is the one that is asked."""
        at = None if self.listing is None else self.listing.at
        return at[1] if at is not None and (at[0], at[2]) == (self.frame_id, text) else None

    @property
    def unasked(self) -> State:
        """The same without any answer."""
        return replace(
            self, trace=None, pair=None, selected=None, hovered=None, error="", unread="", judged=None, other=None,
            edited=None, labels=None, second=None, stage="",
        )  # fmt: skip

    @property
    def beside(self) -> SecondDetections | None:
        """What a second detector finds, where that is looked at."""
        return None if self.loaded is None or self.labels is not None else self.loaded.beside

    @property
    def boxes_shown(self) -> bool:
        """Whether all boxes are shown: where they are wanted, and where there is no pair, not even a labelled one."""
        return self.flags.boxes or not (self.roles or self.ghosts)

    @property
    def own_layer(self) -> bool:
        """The objects of the detector that answers are shown."""
        return self.beside is None or self.layers != "b"

    @property
    def second_layer(self) -> tuple[SceneObject, ...]:
        """The objects of the second detector that are shown."""
        return () if self.beside is None or self.layers == "a" else self.beside.objects

    @property
    def second_selected(self) -> int | None:
        """The selected object of the second detector: the one that was selected, else what it has of the own one."""
        if self.beside is None:
            return None
        return self.beside.partner(self.selected) if self.second is None else self.second

    def name_of(self, i: int) -> str:
        """The name of an object of the trace."""
        return self.shown.names[self.shown.place[i]]

    def key_at(self, place: int, keys: tuple[str, ...]) -> str | None:
        """The key of a shown object, with `keys` those of the trace's objects; None where they do not have it."""
        entry = self.shown.objects[place]
        found = next((keys[t] for t, at in self.shown.place.items() if at == place and keys), None)
        return f"#{entry.id}" if entry.id >= 0 else found

    def named(self, key: str) -> str:
        """The name of an object by its key (`pipeline.diagnosis.whatif.pair_tables`)."""
        if self.edited is not None and key in self.edited.after.keys:
            return self.name_of(self.edited.after.keys.index(key))
        ids = {f"#{o.id}": name for o, name in zip(self.shown.objects, self.shown.names, strict=True) if o.id >= 0}
        return ids.get(key, key)

    @property
    def ranked(self) -> tuple[ScoredPair, ...]:
        """The ranked pairs; without a relation, things alone."""
        if self.trace is None or self.trace.ranking is None or self.trace.ranking.degenerate:
            return ()
        return self.trace.ranking.pairs

    def at(self, pair: ScoredPair) -> tuple[int, ...]:
        """A ranked pair as places in `shown.objects`: target, reference and, with "between", the other end.

        A thing alone stands twice.
        """
        ends = (pair.target, pair.target if pair.reference is None else pair.reference, pair.second_reference)
        return tuple(self.shown.place[i] for i in ends if i is not None)

    @property
    def chosen(self) -> ScoredPair | None:
        """The ranked pair that is chosen."""
        return next((p for p in self.ranked if self.at(p) == self.pair), None)

    @property
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

    @property
    def ghosts(self) -> list[Ghost]:
        """The labelled target and reference in 3D, and those of the other run where it answers otherwise."""
        boxes = self.judged.labelled_boxes() if isinstance(self.judged, Diagnosis) else {}
        found = [Ghost(name, f"labelled {name}", box, "truth") for name, box in boxes.items()]
        other, mine = self.other, self.ranked[0] if self.ranked else None
        if other is None or other.trace is None or other.best is None:
            return found
        ends = (
            ("target", other.best.target, None if mine is None else mine.target),
            ("reference", other.best.reference, None if mine is None else mine.reference),
        )
        for name, place, own in ends:
            entry = None if place is None else other.trace.objects[place]
            if entry is not None and entry.lifted.box is not None and not same_thing(self.trace, own, entry):
                found.append(Ghost(f"other-{name}", f"{other.name}: {entry.label}", entry.lifted.box, "edited"))
        return found

    @property
    def about(self) -> np.ndarray | None:
        """(N, 3) corners of the chosen pair's boxes, and of those of the labels in their place, or of the object whose
        label is asked about; shown frame."""
        if self.loaded is None:
            return None
        seen = list(self.roles)
        if not seen and self.selected is not None and self.labels is not None and self.labels.item is not None:
            seen = [self.selected]
        boxes = [self.shown.objects[i].lifted.box for i in seen] + [ghost.box for ghost in self.ghosts]
        viewer = self.loaded.context.viewer
        to_show = np.stack([viewer.right, viewer.forward, viewer.up])
        corners = [box.corners @ to_show.T for box in boxes if box is not None]
        return np.concatenate(corners) if corners else None

    @property
    def measured(self) -> Measurement | None:
        """What lies between the two marked pixels."""
        if self.loaded is None or len(self.marks) < 2:
            return None
        context = self.loaded.context
        return measure(context.frame.depth, context.frame.camera, context.viewer, *self.marks[:2])

    @property
    def paint_key(self) -> tuple[object, ...]:
        """What the colours of the cloud depend on."""
        roles = tuple(sorted(self.roles.items())) if self.colors == "objects" else ()
        return (self.source, self.frame_id, self.colors, self.dark, roles)

    @property
    def at_place(self) -> Place:
        """What a reload brings back; while labels are shown no question is."""
        look = None if self.camera == "pair" else self.camera
        pair = next((n for n, p in enumerate(self.ranked, 1) if self.at(p) == self.pair), 1)
        place = Place(
            self.source, self.frame_id, self.text, self.task, self.stage, pair=None if pair == 1 else pair, look=look
        )
        if self.labels is None:
            return place
        card = self.labels.card
        return replace(place, text=None, item=None if card is None else (card.a, card.b))


def same_thing(trace: Trace | None, place: int | None, other: SceneObject) -> bool:
    """Whether two answers mean one thing, as the comparison of two runs has it."""
    if trace is None or place is None:
        return False
    return float(iou_2d(trace.objects[place].bbox, other.bbox)[0, 0]) >= 0.5


def shown_objects(loaded: LoadedFrame, trace: Trace | None, exact: bool, before: Trace | None = None) -> Shown:
    """All objects of a frame, then those that only the question's own detector runs found.

    What an edit took out of the question keeps the name that the answer `before` gave it.
    """
    objects = list(loaded.objects)
    by_id = {o.id: i for i, o in enumerate(objects) if o.id >= 0}
    for entry in () if before is None else before.objects:
        if entry.id in by_id:
            objects[by_id[entry.id]] = entry
    place: dict[int, int] = {}
    for i, entry in enumerate(() if trace is None else trace.objects):
        at = place[i] = by_id.get(entry.id, len(objects))
        # The question's name and score are those the answer was made with.
        objects[at : at + 1] = [entry]
    return Shown(tuple(objects), tuple(o.name(i, exact) for i, o in enumerate(objects)), place)


@dataclass(frozen=True)
class Edited:
    """Both answers.

    Attributes
    ----------
    before, after : Outcome
    judged : Diagnosis or str or None
        The verdict on the one before.
    seconds : float
        What answering again took the core.
    """

    before: Outcome
    after: Outcome
    judged: Diagnosis | str | None
    seconds: float

    def pair_before(self, pair: ScoredPair) -> tuple[int | None, ScoredPair | None]:
        """A pair of the answer as it was, after the place that it had, from 1; None where it was no candidate."""
        return self._ranked.get(pair_keys(self.after, pair), (None, None))

    def relation_before(self, a: int, b: int, relation: str) -> float | None:
        """P("a RELATION b") as it was, for places in the objects of the answer."""
        keys, scores = (self.after.keys[a], self.after.keys[b]), self.before.trace.scores
        if relation not in scores.relations or not set(keys) <= set(self.before.keys):
            return None
        return float(scores.of(relation)[tuple(map(self.before.keys.index, keys))])

    @cached_property
    def _ranked(self) -> dict[PairKeys, tuple[int, ScoredPair]]:
        return ranked_pairs(self.before)
