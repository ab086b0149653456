"""A pipeline that is not ours, with faults planted in one module of it at a time; its level 3 predictions are judged.

It is made like SpatialRGPT's: depth points of each mask are cleaned by statistics (what lies far from the median is
dropped), a box along the camera's axes is put around the rest, and relations compare centres. It ranks by no product:
the score of a pair is six tenths of the relation's probability and four tenths of the weaker detection.

OPM    the right targets, or the right references, are not proposed
LIFT   the boxes of the right targets are put .6 to 1.5 m to the other side, and a little elsewhere
SRM    the relation of right pairs is turned round, its probability is one minus itself
CONF   right targets score .05 to .15, and three things that are none of the class are proposed for it with .97
PRM    the score of a wrong pair, and nothing else, is raised above all others

What follows in the pipeline follows from the fault. A fault counts where the pipeline answers right without it and
wrong with it.

    python -m benchmarks.other_pipeline        (from tests/; with --rooms N on rooms that are rendered for it)
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from pipeline.answering.imported import ImportedPipeline, open_imported
from pipeline.answering.objects import prepare_frame
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

FAULTS = {"OPM": ("OPM-TARGET", "OPM-REF"), "LIFT": ("LIFT",), "SRM": ("SRM",), "CONF": ("OPM-CONF",), "PRM": ("PRM",)}
"""Planted in -> the verdicts that name it."""
PLANTED_SHARE = 0.35
HEADER = Header(system="centre comparison", ranking="pair_scores")
AXES = {"left": (0, -1), "right": (0, 1), "above": (1, 1), "below": (1, -1), "behind": (2, 1), "front": (2, -1)}
"""Relation -> axis among (right, up, forward), and the side."""


@dataclass(frozen=True)
class Thing:
    """What the pipeline has of an object: identity, class name, 2D box, center and size in the camera frame."""

    id: int
    name: str
    box: tuple[float, ...]
    center: np.ndarray
    size: np.ndarray


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


@dataclass(frozen=True)
class Asked:
    """One expression as the pipeline meets it: candidates with scores by name, and what is wrong in it."""

    case: Case
    targets: dict[int, float]
    references: dict[int, float]
    moved: dict[int, np.ndarray]
    turned: frozenset[int] = frozenset()
    raised: tuple[int, int] | None = None


def answered(asked: Asked, known: dict[int, Thing], viewer: ViewerAxes, frame: Frame) -> Prediction:
    """Its line."""
    case = asked.case
    there = {i: replace(t, center=asked.moved.get(i, t.center)) for i, t in known.items()}
    rows, pairs = [], []
    for a, p_target in asked.targets.items():
        for b, p_reference in asked.references.items():
            if a == b:
                continue
            p = probability(case.relation, there[a], there[b], viewer)
            p = 1 - p if a in asked.turned else p
            rows.append((a, b, p))
            pairs.append((a, b, 2.0 if asked.raised == (a, b) else pair_score(p_target, p_reference, p)))
    best = max(pairs, key=lambda row: row[2], default=None)
    used = {**asked.targets, **asked.references}
    proposals = {
        name: tuple(Proposal(i, s, known[i].box) for i, s in scores.items())  # type: ignore[arg-type]
        for name, scores in ((case.target, asked.targets), (case.reference, asked.references))
    }
    boxes: dict[int, GivenBox | None] = {
        i: GivenBox(tuple(there[i].center.tolist()), tuple(there[i].size.tolist()))  # type: ignore[arg-type]
        for i in used
    }
    return Prediction(
        frame.id, case.text, None if best is None else GivenAnswer(best[0], best[1]),
        None if best is not None else "no pair", proposals=proposals, boxes_3d=boxes,
        relations={case.relation: tuple(rows)}, pairs=tuple(pairs),
    )  # fmt: skip


@dataclass(frozen=True)
class Line:
    """A line with the fault that is planted in it; None for a clean one."""

    line: Prediction
    fault: str | None


def lines(dataset: Dataset, labels: Labels, seed: int, every: int = 1, share: float = PLANTED_SHARE) -> Iterator[Line]:
    """The pipeline on the expressions of labels, some of them with a fault."""
    rng = np.random.default_rng(seed)
    for truth in read_cases(labels, 0, 2**31 - 1):
        frame = dataset.load(truth.frame)
        context = prepare_frame(dataset, frame)
        known = {t.id: t for t in things(frame)}
        if not len(known):
            continue
        for case in truth.cases[::every]:
            if case.target == case.reference:
                continue
            asked = clean(case, truth, known, rng)
            line = answered(asked, known, context.viewer, frame)
            fault = str(rng.choice(list(FAULTS))) if rng.random() < share and right(line, case, truth) else None
            # What is moved has another identity: an id is one object in all lines of a frame.
            broken = None if fault is None else planted(fault, asked, case, truth, known, context.viewer, rng)
            if broken is None:
                yield Line(line, None)
                continue
            wrong = answered(*broken, context.viewer, frame)
            yield Line(line, None) if right(wrong, case, truth) else Line(wrong, fault)


def clean(case: Case, truth: FrameCases, known: dict[int, Thing], rng: np.random.Generator) -> Asked:
    """What its detector gives: the things of the two names, and two others that it takes for them, less surely."""

    def scored(example: int) -> dict[int, float]:
        ids = truth.numbers[np.flatnonzero(truth.alike[example])].tolist()
        others = [i for i in known if i not in ids]
        false = rng.permutation(others)[:2].tolist()
        found = {i: float(rng.uniform(0.55, 0.95)) for i in ids if i in known}
        return found | {int(i): float(rng.uniform(0.3, 0.6)) for i in false}

    return Asked(case, scored(case.target_object), scored(case.reference_object), {})


def right(line: Prediction, case: Case, truth: FrameCases) -> bool:
    if line.answer is None or line.answer.object is None:
        return False
    box = np.array([line.objects[line.answer.object].box])
    return bool(iou_2d(box, truth.boxes[case.acceptable]).max(initial=0.0) >= HIT)


Broken = tuple[Asked, dict[int, Thing]]


def planted(
    fault: str,
    asked: Asked,
    case: Case,
    truth: FrameCases,
    known: dict[int, Thing],
    viewer: ViewerAxes,
    rng: np.random.Generator,
) -> Broken | None:
    """The same with one fault; None where there is nothing to break."""
    good = [i for i in truth.numbers[case.acceptable].tolist() if i in asked.targets]
    others = [i for i in asked.targets if i not in good]
    fresh = 10_000 + int(rng.integers(10**9))
    if fault == "OPM" and rng.random() < 0.5:
        pairs = truth.acceptable_pairs(case)
        ends = set(truth.numbers[np.flatnonzero(pairs.any(axis=0))].tolist())
        kept = {i: s for i, s in asked.references.items() if i not in ends}
        return replace(asked, references=kept), known
    if fault == "OPM":
        return replace(asked, targets={i: asked.targets[i] for i in others}), known
    if fault == "LIFT":
        new = {i: fresh + k for k, i in enumerate(good)}
        axis, sign = AXES[case.relation]
        back = -sign * viewer.matrix[axis]
        shift = {n: known[i].center + back * rng.uniform(0.6, 1.5) + _jitter(rng) for i, n in new.items()}
        targets = {new.get(i, i): s for i, s in asked.targets.items()}
        references = {new.get(i, i): s for i, s in asked.references.items()}
        return replace(asked, targets=targets, references=references, moved=shift), {
            **known, **{n: replace(known[i], id=n) for i, n in new.items()}
        }  # fmt: skip
    if fault == "SRM":
        return replace(asked, turned=frozenset(good)), known
    if fault == "CONF":
        away = [i for i, t in known.items() if i not in asked.targets and i not in asked.references]
        false = rng.permutation(away)[:3].tolist()
        low = {i: float(rng.uniform(0.05, 0.15)) for i in good}
        return replace(asked, targets={**asked.targets, **low, **dict.fromkeys(map(int, false), 0.97)}), known
    wrong = [(a, b) for a in others for b in asked.references if a != b]
    return (replace(asked, raised=wrong[int(rng.integers(len(wrong)))]), known) if wrong else None


def _jitter(rng: np.random.Generator) -> np.ndarray:
    return rng.normal(scale=0.1, size=3)


def verdicts(dataset: str | Path, labels: Labels, found: Sequence[Line]) -> list[tuple[str | None, str, str | None]]:
    """(fault, verdict, detail) of every line, judged as `import-run` judges."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "predictions.jsonl"
        write_predictions(path, HEADER, [f.line for f in found])
        source = open_imported(path, dataset)
        return list(_judged(source, labels, found))


def _judged(
    source: ImportedPipeline, labels: Labels, found: Sequence[Line]
) -> Iterator[tuple[str | None, str, str | None]]:
    faults = {(f.line.frame, f.line.text): f.fault for f in found}
    names = class_names_of(labels)
    for truth in read_cases(labels, 0, 2**31 - 1):
        kept = tuple(c for c in truth.cases if (truth.frame, c.text) in faults)
        if kept:
            context = prepare_frame(source.dataset, source.dataset.load(truth.frame), source.config.lift)
            for row in imported_rows(source, replace(truth, cases=kept), context, names):
                yield faults[truth.frame, row["text"]], row["verdict"], row["detail"]


def tally(rows: Sequence[tuple[str | None, str, str | None]]) -> dict[str, Counter[str]]:
    """By what was planted, how often each verdict."""
    found: dict[str, Counter[str]] = {}
    for fault, verdict, detail in rows:
        words = f"{verdict} {detail}" if verdict in ("UNEXPLAINED", "COMPOUND") else verdict
        found.setdefault(fault or "clean", Counter())[words] += 1
    return found


if __name__ == "__main__":
    import argparse

    from pipeline.answering.opening import open_pipeline

    parser = argparse.ArgumentParser()
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--every", type=int, default=1)
    parser.add_argument("--dataset", default="demo")
    parser.add_argument("--labels", type=Path, default=None)
    given = parser.parse_args()
    opened = open_labels(given.labels or demo_labels())
    data = open_pipeline(given.dataset, srm="rule").dataset
    every_row = [
        row
        for seed in range(given.seeds)
        for row in verdicts(given.dataset, opened, list(lines(data, opened, seed, given.every)))
    ]
    named = total = 0
    for fault, counts in sorted(tally(every_row).items()):
        hits = sum(counts[v] for v in FAULTS.get(fault, ()))
        print(f"{fault:6} {hits}/{counts.total()} {dict(counts.most_common())}")
        if fault in FAULTS:
            named, total = named + hits, total + counts.total()
    print(f"named {named} of {total}: {named / max(total, 1):.1%}")
