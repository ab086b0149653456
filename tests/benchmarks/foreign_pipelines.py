"""Foreign pipelines: objects of a frame, candidates of an expression, and the line of predictions that follows.

A pipeline gives level 3 predictions of the expressions of labels. Each subclass of `ForeignPipeline` holds its own ways
to lift, judge, score and rank, and the faults that can be planted in them.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar

import cv2
import numpy as np
from benchmarks.planted_parts import share

from pipeline.answering.coordinate_conventions import box_2d
from pipeline.answering.objects import prepare_frame
from pipeline.answering.predictions import Header, PredictedAnswer, PredictedBox, Prediction, Proposal
from pipeline.datasets.base import Dataset
from pipeline.geometry.boxes import iou_2d
from pipeline.geometry.camera import backproject
from pipeline.geometry.frame import Frame
from pipeline.geometry.masks import RunLength
from pipeline.geometry.viewer import ViewerAxes
from pipeline.labels.cases import HIT, Case, FrameCases, read_cases
from pipeline.labels.reading import Labels

AXES = {"left": (0, -1), "right": (0, 1), "above": (1, 1), "below": (1, -1), "behind": (2, 1), "front": (2, -1)}
"""Relation -> axis among (right, up, forward), and the side."""
TURNED = {"left": "right", "right": "left", "above": "below", "below": "above", "front": "behind", "behind": "front"}
"""Relation -> its opposite."""
UNIT_LENGTHS = {"m": 1, "cm": 100, "mm": 1000}
FEWEST_POINTS = 25
"""Of an object that is lifted."""
Placed = tuple[np.ndarray, np.ndarray, np.ndarray | None]
"""Center, size and R of a `Thing`."""
Pair = tuple[int, int]
"""Ids of a target and a reference."""
Detected = tuple[dict[int, float], dict[int, float]]
"""Scores by id, of the target's candidates and of the reference's."""
Rng = np.random.Generator


@dataclass(frozen=True)
class Thing:
    """An object as a pipeline has it.

    Attributes
    ----------
    id : int
    name : str
        Of its class.
    box : tuple of float
        2D, as the pipeline writes it.
    center, size : (3,) float64
        3D box in the camera frame, metres.
    R : (3, 3) float64 or None
        Columns are the axes of the 3D box; None along those of the camera.
    mask : RunLength or None
    """

    id: int
    name: str
    box: tuple[float, ...]
    center: np.ndarray
    size: np.ndarray
    R: np.ndarray | None = None
    mask: RunLength | None = None

    def reach(self, axis: np.ndarray) -> float:
        """Half of the box's extent along an axis, metres."""
        along = axis if self.R is None else self.R.T @ axis
        return float(np.abs(along) @ self.size / 2)


@dataclass(frozen=True)
class Question:
    """An expression as a pipeline meets it, with all that is known of its frame and all that is broken in it.

    Attributes
    ----------
    case : Case
    truth : FrameCases
    frame : Frame
    viewer : ViewerAxes
    known : dict of int to Thing
        By id: all things of the frame.
    targets, references : dict of int to float
        Scores of the candidates, by id.
    relations, scores : dict of (int, int) to float
        P and pair scores that replace those of the pipeline.
    dropped : dict of str to list
        Proposals that did not go on: id, score and reason, by name.
    answer : (int, int) or None
        The answer, where the first pair of the ranking is not.
    """

    case: Case
    truth: FrameCases
    frame: Frame
    viewer: ViewerAxes
    known: dict[int, Thing]
    targets: dict[int, float]
    references: dict[int, float]
    relations: dict[Pair, float] = field(default_factory=dict)
    scores: dict[Pair, float] = field(default_factory=dict)
    dropped: dict[str, list[tuple[int, float, str]]] = field(default_factory=dict)
    answer: Pair | None = None

    @property
    def pairs(self) -> list[Pair]:
        """Pairs of every target with every reference."""
        return [(a, b) for a in self.targets for b in self.references if a != b]


@dataclass(frozen=True)
class ForeignPipeline(ABC):
    """A pipeline by its header; 3D boxes are written with so many decimals."""

    header: Header
    decimals: ClassVar[int | None] = None

    @abstractmethod
    def things(self, frame: Frame, viewer: ViewerAxes) -> list[Thing]:
        """Objects of a frame, from its annotations."""

    @abstractmethod
    def detected(self, case: Case, truth: FrameCases, known: Mapping[int, Thing], rng: Rng) -> Detected:
        """Scores by id of the target's candidates and of the reference's."""

    @abstractmethod
    def probability(self, relation: str, a: Thing, b: Thing, viewer: ViewerAxes) -> float:
        """P(a RELATION b)."""

    @abstractmethod
    def ranks(self, factors: np.ndarray, pairs: Sequence[Pair]) -> np.ndarray:
        """Scores (P,) of pairs by the factors (P, 3) of target, reference and relation."""

    @abstractmethod
    def planted(self, fault: str, q: Question, rng: Rng, whole: bool) -> Question | None:
        """Question with a fault; None where it changes nothing. `whole`: every line of the file has it."""

    @abstractmethod
    def counts(self, module: str, q: Question, broken: Question) -> bool:
        """Check whether the fault counts: the answer is wrong by it, and by nothing else."""

    def pixels(self, t: Thing, frame: Frame) -> np.ndarray:
        """(4,): x0, y0, x1, y1."""
        return box_2d(t.box, self.header, frame.width, frame.height)


def points_of(frame: Frame, index: int) -> np.ndarray:
    """(N, 3): depth points of an annotation's mask without its border, in the camera frame, metres."""
    mask = mask_of(frame, index)
    if mask is None:
        return np.zeros((0, 3))
    inner = cv2.erode(mask.astype(np.uint8), np.ones((5, 5), np.uint8)).astype(bool) & (frame.depth > 0)
    return points_at(frame, inner if inner.sum() >= 40 else mask)


def mask_of(frame: Frame, index: int) -> np.ndarray | None:
    """(H, W) bool of an annotation."""
    return next((a.mask for a in frame.annotations if a.index == index), None)


def points_at(frame: Frame, mask: np.ndarray) -> np.ndarray:
    """(N, 3): depth points of a mask (H, W), in the camera frame, metres."""
    v, u = np.nonzero(mask & (frame.depth > 0))
    return backproject(frame.depth, frame.camera, v, u).astype(np.float64)


def annotated(
    header: Header, frame: Frame, masked: bool, box_of: Callable[[int, np.ndarray], Placed | None]
) -> list[Thing]:
    """The annotated objects of a frame, but the narrow ones.

    Parameters
    ----------
    masked : bool
        The pipeline gives masks.
    box_of : callable
        3D box by the annotation's index and its 2D box (4,) float64, pixels; None for an object that is not found.
    """
    found: list[Thing] = []
    for a in frame.annotations:
        pixels = a.bbox.astype(np.float64)
        if (pixels[2:] - pixels[:2]).min() >= 4 and (box := box_of(a.index, pixels)) is not None:
            mask = RunLength.of(a.mask) if masked and a.mask is not None else None
            found.append(Thing(a.index, a.label, as_written(header, frame, pixels), *box, mask))
    return found


def noise(relation: str, a: Thing, b: Thing) -> float:
    """Logistic, of scale 1; only the boxes in the picture decide it."""
    q = share(relation, *a.box, *b.box)
    return float(np.log(q / (1 - q)))


def as_written(header: Header, frame: Frame, pixels: np.ndarray) -> tuple[float, ...]:
    """A 2D box (4,), x0 y0 x1 y1, in the form of the header."""
    x0, y0, x1, y1 = pixels.tolist()
    w, h = x1 - x0, y1 - y0
    box = {"xyxy": (x0, y0, x1, y1), "xywh": (x0, y0, w, h), "cxcywh": ((x0 + x1) / 2, (y0 + y1) / 2, w, h)}
    of_frame = np.array(box[header.boxes]) / np.tile([frame.width, frame.height], 2)
    if header.box_unit == "shares":
        return tuple(round(x, 5) for x in of_frame.tolist())
    return tuple(np.round(of_frame * 1000, 1).tolist()) if header.box_unit == "thousandths" else box[header.boxes]


def given_box(own: ForeignPipeline, t: Thing) -> PredictedBox:
    """A thing's 3D box in the form of the header."""
    axes = np.array([1, -1, -1] if own.header.coordinates == "camera_opengl" else [1, 1, 1])
    center, size = (x * UNIT_LENGTHS[own.header.length] for x in (t.center * axes, t.size))
    if own.decimals is not None:
        center, size = np.round(center, own.decimals), np.round(size, own.decimals)
    box = PredictedBox(tuple(center.tolist()), tuple(size.tolist()))  # type: ignore[arg-type]
    if t.R is None:
        return box
    R = np.diag(axes) @ t.R
    # A rotation, not a reflection.
    R = R * [1, 1, np.sign(np.linalg.det(R))]
    return replace(box, rotation=tuple(R.ravel().tolist()))  # type: ignore[arg-type]


def detections(
    case: Case,
    truth: FrameCases,
    known: Mapping[int, Thing],
    rng: Rng,
    sure: Callable[[str, float], float],
    *,
    missed: float,
    others: tuple[int, int],
    right: tuple[float, float],
    false: tuple[float, float],
) -> Detected:
    """Scores by id of the things of each name, and of others that are taken for them; by their numbers.

    Parameters
    ----------
    sure : callable
        Score by a class name and a certainty, 0 to 1.
    missed : float
        Share of the right things that are not found.
    others : tuple of int
        Least number of other things, and one more than the greatest.
    right, false : tuple of float
        Least and greatest certainty, of right things and of others.
    """

    def scored(name: str, example: int) -> dict[int, float]:
        ids = set(truth.numbers[truth.alike[example]].tolist())
        found = {i: sure(name, rng.uniform(*right)) for i in known if i in ids and rng.random() > missed}
        wrong = rng.permutation([i for i in known if i not in ids])[: rng.integers(*others)].tolist()
        return dict(sorted((found | {int(i): sure(name, rng.uniform(*false)) for i in wrong}).items()))

    return scored(case.target, case.target_object), scored(case.reference, case.reference_object)


def probabilities(own: ForeignPipeline, q: Question, relation: str) -> dict[Pair, float]:
    """P of every pair without a fault."""
    return {(a, b): own.probability(relation, q.known[a], q.known[b], q.viewer) for a, b in q.pairs}


def judged(own: ForeignPipeline, q: Question) -> dict[Pair, float]:
    """P of every pair, as the line has it."""
    p = probabilities(own, q, q.case.relation)
    return {pair: q.relations.get(pair, x) for pair, x in p.items()}


def factors_of(q: Question, p: Mapping[Pair, float]) -> np.ndarray:
    """(P, 3): target's score, reference's score and probability of pairs."""
    rows = [(q.targets[a], q.references[b], x) for (a, b), x in p.items()]
    return np.array(rows).reshape(-1, 3)


def pair_scores(own: ForeignPipeline, q: Question, p: Mapping[Pair, float]) -> dict[Pair, float]:
    """Score of every pair by its probability, without a fault of the ranking."""
    return dict(zip(p, own.ranks(factors_of(q, p), list(p)).tolist(), strict=True)) if p else {}


def ranked(own: ForeignPipeline, q: Question) -> dict[Pair, float]:
    """Score of every pair, as the line has it."""
    if all(pair in q.scores for pair in q.pairs):
        return {pair: q.scores[pair] for pair in q.pairs}
    return pair_scores(own, q, judged(own, q)) | q.scores


def predicted(own: ForeignPipeline, q: Question) -> Prediction:
    """The line of predictions."""
    p, scores = judged(own, q), ranked(own, q)
    best = q.answer or max(scores, key=scores.__getitem__, default=None)

    def proposals(name: str, scored: Mapping[int, float]) -> tuple[Proposal, ...]:
        every = [*((i, s, None) for i, s in scored.items()), *q.dropped.get(name, ())]
        found = ((q.known[i], s, why) for i, s, why in every)
        return tuple(Proposal(t.id, s, t.box, mask=t.mask, dropped=why) for t, s, why in found)  # type: ignore[arg-type]

    return Prediction(
        q.frame.id,
        q.case.text,
        None if best is None else PredictedAnswer(*best),
        "no pair" if best is None else None,
        proposals={n: proposals(n, s) for n, s in ((q.case.target, q.targets), (q.case.reference, q.references))},
        boxes_3d={i: given_box(own, q.known[i]) for i in {**q.targets, **q.references}},
        relations={q.case.relation: tuple((*pair, x) for pair, x in p.items())},
        pairs=tuple((*pair, x) for pair, x in scores.items()),
    )


def is_right(own: ForeignPipeline, line: Prediction, q: Question) -> bool:
    """Check whether the 2D box of the answer lies on a right target."""
    if line.answer is None or line.answer.object is None:
        return False
    box = line.objects[line.answer.object].box
    assert box is not None
    there = box_2d(box, own.header, q.frame.width, q.frame.height)
    return bool(iou_2d(there[None], q.truth.boxes[q.case.acceptable]).max(initial=0.0) >= HIT)


def right_ids(q: Question) -> tuple[list[int], list[int]]:
    """Ids of the right targets that are proposed, and of the references that they are right by."""
    targets = q.truth.numbers[q.case.acceptable].tolist()
    ends = q.truth.numbers[np.flatnonzero(q.truth.acceptable_pairs(q.case).any(axis=0))].tolist()
    return [i for i in targets if i in q.targets], [i for i in ends if i in q.references]


def side_of(q: Question, of_target: bool) -> tuple[str, str, dict[int, float], set[int]]:
    """Field and name of a role, its scores, and all things of the name."""
    side, name, scores, example = (
        ("targets", q.case.target, q.targets, q.case.target_object)
        if of_target
        else ("references", q.case.reference, q.references, q.case.reference_object)
    )
    return side, name, scores, set(q.truth.numbers[q.truth.alike[example]].tolist())


def with_things(q: Question, new: Mapping[int, Thing]) -> Question:
    """Exchange things of a question for others.

    Each new one has an id of its own: an id is one object in all lines of a frame.
    """
    ids = {i: t.id for i, t in new.items()}
    targets, references = ({ids.get(i, i): s for i, s in scores.items()} for scores in (q.targets, q.references))
    return replace(q, targets=targets, references=references, known={**q.known, **{t.id: t for t in new.values()}})


def new_id(rng: Rng) -> int:
    """Id that no thing has, the first of a hundred."""
    return 10_000 + 100 * int(rng.integers(10**9))


def numbered_anew(new: Mapping[int, Thing], rng: Rng) -> dict[int, Thing]:
    """Things with new ids."""
    return {i: replace(t, id=new_id(rng) + k) for k, (i, t) in enumerate(new.items())}


Scene = tuple[FrameCases, Frame, ViewerAxes, dict[int, Thing]]


def scenes(own: ForeignPipeline, dataset: Dataset, labels: Labels) -> Iterator[Scene]:
    """Expressions of each frame, the frame, its viewer and the things that a pipeline has of it."""
    for truth in read_cases(labels, 0, 2**31 - 1):
        frame = dataset.load(truth.frame)
        viewer = prepare_frame(dataset, frame).viewer
        yield truth, frame, viewer, {t.id: t for t in own.things(frame, viewer)}


def questions(own: ForeignPipeline, frames: Iterable[Scene], rng: Rng, part: int, every: int) -> Iterator[Question]:
    """Questions of each frame: every so manieth expression from the given one on."""
    for truth, frame, viewer, known in frames:
        for case in truth.cases[part % every :: every] if known else ():
            if case.target != case.reference:
                targets, references = own.detected(case, truth, known, rng)
                yield Question(case, truth, frame, viewer, known, targets, references)
