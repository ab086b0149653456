"""A pipeline that is not ours, with faults planted in one module of it at a time; its level 3 predictions are judged.

It is made like SpatialRGPT's: depth points of each mask are cleaned by statistics (what lies far from the median is
dropped), a box along the camera's axes is put around the rest, and relations compare centres. It ranks by no product:
the score of a pair is six tenths of the relation's probability and four tenths of the weaker detection.

OPM-TARGET, OPM-REF  the right targets, or the right references, are not proposed
LIFT      the boxes of the right targets are put .6 to 1.5 m to the other side, and a little elsewhere
SRM       the relation of right pairs is turned round, its probability is one minus itself
OPM-CONF  right targets score .05 to .15, and three things that are none of the class are proposed for it with .97
PRM       the score of a wrong pair, and nothing else, is raised above all others

What follows in the pipeline follows from the fault. A fault counts where the pipeline answers right without it and
wrong with it. `second_pipeline` is one that is made otherwise.

    python -m benchmarks.other_pipeline        (from tests/)
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from pipeline.answering.imported import ImportedPipeline, open_imported
from pipeline.answering.objects import prepare_frame
from pipeline.answering.opening import open_pipeline
from pipeline.answering.placing import box_2d
from pipeline.answering.predictions import (
    GivenAnswer,
    GivenBox,
    Header,
    Prediction,
    Proposal,
    write_predictions,
)
from pipeline.datasets.base import Dataset
from pipeline.datasets.demo import demo_labels
from pipeline.evaluation.imported_rows import imported_rows
from pipeline.evaluation.run import class_names_of
from pipeline.geometry.boxes import iou_2d
from pipeline.geometry.camera import backproject
from pipeline.geometry.frame import Frame
from pipeline.geometry.viewer import ViewerAxes
from pipeline.labels.cases import HIT, Case, FrameCases, read_cases
from pipeline.labels.reading import Labels, open_labels

FAULTS = ("OPM-TARGET", "OPM-REF", "LIFT", "SRM", "OPM-CONF", "PRM")
"""What is planted; each is the verdict that names it."""
PLANTED_SHARE = 0.35
AXES = {"left": (0, -1), "right": (0, 1), "above": (1, 1), "below": (1, -1), "behind": (2, 1), "front": (2, -1)}
"""Relation -> axis among (right, up, forward), and the side."""
Pair = tuple[int, int]


@dataclass(frozen=True)
class Thing:
    """What a pipeline has of an object: identity, class name, 2D box, center and size in the camera frame."""

    id: int
    name: str
    box: tuple[float, ...]
    center: np.ndarray
    size: np.ndarray


@dataclass(frozen=True)
class Asked:
    """One expression as a pipeline meets it: candidates with scores by name, and what is wrong in it.

    Attributes
    ----------
    case : Case
    targets, references : dict of int to float
        Their scores by id.
    relations, scores : dict of (int, int) to float
        P and pair scores of some pairs that are not what the pipeline would give.
    """

    case: Case
    targets: dict[int, float]
    references: dict[int, float]
    relations: dict[Pair, float] = field(default_factory=dict)
    scores: dict[Pair, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Met:
    """An expression with what is known of its frame."""

    asked: Asked
    truth: FrameCases
    known: dict[int, Thing]
    viewer: ViewerAxes
    frame: Frame


@dataclass(frozen=True)
class OtherPipeline:
    """Its parts: how it lifts, judges a pair and scores it, writes its boxes, and what can be broken in it.

    `asked` gives what its detector gives, `told` its line; by default `clean` and `answered`. `planted` gives the same
    with one fault, None where there is nothing to break; its `known` holds what it moved, by new ids, for an id is one
    object in all lines of a frame.
    """

    header: Header
    things: Callable[[Frame], list[Thing]]
    probability: Callable[[str, Thing, Thing, ViewerAxes], float]
    pair_score: Callable[[float, float, float], float]
    written: Callable[[Thing], tuple[tuple[float, ...], GivenBox]]
    planted: Callable[[OtherPipeline, str, Met, np.random.Generator], Met | None]
    asked: Callable[[Case, FrameCases, dict[int, Thing], np.random.Generator], Asked] | None = None
    told: Callable[[OtherPipeline, Met], Prediction] | None = None


def things(frame: Frame) -> list[Thing]:
    """The annotated objects, boxed by statistics of their depth."""
    found = []
    for a in frame.annotations:
        if a.mask is None:
            continue
        v, u = np.nonzero(a.mask & (frame.depth > 0))
        if len(v) < 40:
            continue
        points = backproject(frame.depth, frame.camera, v, u).astype(np.float64)
        away = np.linalg.norm(points - np.median(points, axis=0), axis=1)
        kept = points[away <= away.mean() + 2 * away.std()]
        lo, hi = kept.min(axis=0), kept.max(axis=0)
        found.append(Thing(a.index, a.label, tuple(map(float, a.bbox)), (lo + hi) / 2, hi - lo))
    return found


def probability(relation: str, a: Thing, b: Thing, viewer: ViewerAxes) -> float:
    """P(a RELATION b), by their centres alone."""
    axis, sign = AXES[relation]
    along = float(sign * (viewer.matrix @ (a.center - b.center))[axis])
    return float(1 / (1 + np.exp(-np.clip(along / 0.08, -30, 30))))


def pair_score(p_target: float, p_reference: float, p_relation: float) -> float:
    return 0.6 * p_relation + 0.4 * min(p_target, p_reference)


def written(thing: Thing) -> tuple[tuple[float, ...], GivenBox]:
    return thing.box, GivenBox(tuple(thing.center.tolist()), tuple(thing.size.tolist()))  # type: ignore[arg-type]


def answered(own: OtherPipeline, met: Met) -> Prediction:
    """Its line."""
    asked, known, case = met.asked, met.known, met.asked.case
    rows, pairs = [], []
    for a, p_target in asked.targets.items():
        for b, p_reference in asked.references.items():
            if a != b:
                p = asked.relations.get((a, b), own.probability(case.relation, known[a], known[b], met.viewer))
                rows.append((a, b, p))
                pairs.append((a, b, asked.scores.get((a, b), own.pair_score(p_target, p_reference, p))))
    best = max(pairs, key=lambda row: row[2], default=None)
    boxes = {i: own.written(known[i]) for i in {**asked.targets, **asked.references}}
    proposals = {
        name: tuple(Proposal(i, s, boxes[i][0]) for i, s in scores.items())  # type: ignore[arg-type]
        for name, scores in ((case.target, asked.targets), (case.reference, asked.references))
    }
    return Prediction(
        met.frame.id, case.text, None if best is None else GivenAnswer(best[0], best[1]),
        None if best is not None else "no pair", proposals=proposals, boxes_3d={i: b for i, (_, b) in boxes.items()},
        relations={case.relation: tuple(rows)}, pairs=tuple(pairs),
    )  # fmt: skip


@dataclass(frozen=True)
class Line:
    """A line with the fault that is planted in it; None for a clean one."""

    line: Prediction
    fault: str | None


def lines(
    own: OtherPipeline,
    dataset: Dataset,
    labels: Labels,
    seed: int,
    every: int = 1,
    share: float = PLANTED_SHARE,
    faults: Sequence[str] = FAULTS,
) -> Iterator[Line]:
    """The pipeline on the expressions of labels, some of them with a fault."""
    rng = np.random.default_rng(seed)
    asked, told = own.asked or clean, own.told or answered
    for truth in read_cases(labels, 0, 2**31 - 1):
        frame = dataset.load(truth.frame)
        context = prepare_frame(dataset, frame)
        known = {t.id: t for t in own.things(frame)}
        for case in truth.cases[seed % every :: every] if known else ():
            if case.target == case.reference:
                continue
            met = Met(asked(case, truth, known, rng), truth, known, context.viewer, frame)
            line = told(own, met)
            fault = str(rng.choice(faults)) if rng.random() < share and right(own, line, met) else None
            broken = None if fault is None else own.planted(own, fault, met, rng)
            wrong = line if broken is None else told(own, broken)
            yield Line(line, None) if right(own, wrong, met) or fault is None else Line(wrong, fault)


def clean(case: Case, truth: FrameCases, known: dict[int, Thing], rng: np.random.Generator) -> Asked:
    """What its detector gives: the things of the two names, and two others that it takes for them, less surely."""

    def scored(example: int) -> dict[int, float]:
        ids = truth.numbers[np.flatnonzero(truth.alike[example])].tolist()
        others = [i for i in known if i not in ids]
        false = rng.permutation(others)[:2].tolist()
        found = {i: float(rng.uniform(0.55, 0.95)) for i in ids if i in known}
        return found | {int(i): float(rng.uniform(0.3, 0.6)) for i in false}

    return Asked(case, scored(case.target_object), scored(case.reference_object))


def right(own: OtherPipeline, line: Prediction, met: Met) -> bool:
    if line.answer is None or line.answer.object is None:
        return False
    box = line.objects[line.answer.object].box
    assert box is not None
    there = box_2d(box, own.header, met.frame.width, met.frame.height)
    return bool(iou_2d(there[None], met.truth.boxes[met.asked.case.acceptable]).max(initial=0.0) >= HIT)


def right_ids(met: Met) -> tuple[list[int], list[int]]:
    """Ids of the right targets that are proposed, and of the references that they are right by."""
    truth, case = met.truth, met.asked.case
    targets = [i for i in truth.numbers[case.acceptable].tolist() if i in met.asked.targets]
    ends = truth.numbers[np.flatnonzero(truth.acceptable_pairs(case).any(axis=0))].tolist()
    return targets, [i for i in ends if i in met.asked.references]


def moved(met: Met, centers: dict[int, np.ndarray], rng: np.random.Generator) -> Met:
    """The same with things elsewhere, under new ids."""
    fresh = 10_000 + int(rng.integers(10**9))
    new = {i: fresh + k for k, i in enumerate(centers)}
    targets, references = (
        {new.get(i, i): s for i, s in scores.items()} for scores in (met.asked.targets, met.asked.references)
    )
    things = {n: replace(met.known[i], id=n, center=centers[i]) for i, n in new.items()}
    return replace(met, asked=replace(met.asked, targets=targets, references=references), known={**met.known, **things})


def not_proposed(fault: str, met: Met) -> Met:
    targets, ends = right_ids(met)
    if fault == "OPM-TARGET":
        kept = {i: s for i, s in met.asked.targets.items() if i not in targets}
        return replace(met, asked=replace(met.asked, targets=kept))
    kept = {i: s for i, s in met.asked.references.items() if i not in ends}
    return replace(met, asked=replace(met.asked, references=kept))


def planted(own: OtherPipeline, fault: str, met: Met, rng: np.random.Generator) -> Met | None:
    asked, known, matrix = met.asked, met.known, met.viewer.matrix
    good = right_ids(met)[0]
    if fault in ("OPM-TARGET", "OPM-REF"):
        return not_proposed(fault, met)
    if fault == "LIFT":
        axis, sign = AXES[asked.case.relation]
        back = -sign * matrix[axis]
        places = {i: known[i].center + back * rng.uniform(0.6, 1.5) + rng.normal(scale=0.1, size=3) for i in good}
        return moved(met, places, rng)
    if fault == "SRM":
        turned = {
            (a, b): 1 - own.probability(asked.case.relation, known[a], known[b], met.viewer)
            for a in good
            for b in asked.references
        }
        return replace(met, asked=replace(asked, relations=turned))
    if fault == "OPM-CONF":
        away = [i for i in known if i not in asked.targets and i not in asked.references]
        false = rng.permutation(away)[:3].tolist()
        low = {i: float(rng.uniform(0.05, 0.15)) for i in good}
        return replace(
            met, asked=replace(asked, targets={**asked.targets, **low, **dict.fromkeys(map(int, false), 0.97)})
        )
    wrong = [(a, b) for a in asked.targets if a not in good for b in asked.references if a != b]
    return replace(met, asked=replace(asked, scores={wrong[int(rng.integers(len(wrong)))]: 2.0})) if wrong else None


CENTRES = OtherPipeline(
    Header(system="centre comparison", ranking="pair_scores"), things, probability, pair_score, written, planted
)
Row = tuple[str | None, str, str | None]
"""What was planted, the verdict, its detail."""


def verdicts(own: OtherPipeline, dataset: str | Path, labels: Labels, found: Sequence[Line]) -> list[Row]:
    """Every line, judged as `import-run` judges."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "predictions.jsonl"
        write_predictions(path, own.header, [f.line for f in found])
        return list(_judged(open_imported(path, dataset), labels, found))


def _judged(source: ImportedPipeline, labels: Labels, found: Sequence[Line]) -> Iterator[Row]:
    faults = {(f.line.frame, f.line.text): f.fault for f in found}
    names = class_names_of(labels)
    for truth in read_cases(labels, 0, 2**31 - 1):
        kept = tuple(c for c in truth.cases if (truth.frame, c.text) in faults)
        if kept:
            context = prepare_frame(source.dataset, source.dataset.load(truth.frame), source.config.lift)
            for row in imported_rows(source, replace(truth, cases=kept), context, names):
                yield faults[truth.frame, row["text"]], row["verdict"], row["detail"]


def tally(rows: Sequence[Row]) -> dict[str, Counter[str]]:
    """By what was planted, how often each verdict."""
    found: dict[str, Counter[str]] = {}
    for fault, verdict, detail in rows:
        words = f"{verdict} {detail}" if verdict in ("UNEXPLAINED", "COMPOUND") else verdict
        found.setdefault(fault or "clean", Counter())[words] += 1
    return found


def main(own: OtherPipeline, dataset: str | Path, labels: Path, seeds: int, every: int) -> None:
    """Print figures of three kinds of files: some lines broken, all of them, and all of them in one module."""
    opened, data = open_labels(labels), open_pipeline(dataset, srm="rule").dataset
    for words, share, kinds in (
        ("some lines", PLANTED_SHARE, (FAULTS,)),
        ("all lines", 1.0, (FAULTS,)),
        ("all lines in one module", 1.0, tuple((f,) for f in FAULTS)),
    ):
        rows = [
            row
            for seed in range(seeds)
            for faults in kinds
            for row in verdicts(own, dataset, opened, list(lines(own, data, opened, seed, every, share, faults)))
        ]
        counts = tally(rows)
        named, total = (
            sum(counts[f][f] for f in FAULTS if f in counts),
            sum(counts[f].total() for f in FAULTS if f in counts),
        )
        print(f"{own.header.system}, {words}: named {named} of {total}, {named / max(total, 1):.1%}")
        for fault, found in sorted(counts.items()):
            print(f"  {fault:10} {found[fault]}/{found.total()} {dict(found.most_common())}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--every", type=int, default=10)
    given = parser.parse_args()
    main(CENTRES, "demo", demo_labels(), given.seeds, given.every)
