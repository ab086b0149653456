"""Four more pipelines that are not ours (`fourth_parts`), scene graphs unlike the first three in parts and faults.

OPM-TARGET, OPM-REF  right targets, or references, are not seen, suppressed, or cut off by K; all of the name are
          missed, and other things found for it (a wrong synonym); or one box holds them together with a neighbour
LIFT      boxes of right targets, or of the references that they are right by: by the focal length of another size of
          picture, in the coordinates of a crop, of a mask that bleeds on a neighbour, with holes of the depth read as
          zero or as far away, of another instance, or with axes of another convention
SRM       all edges of the line with swapped arguments, of another relation, all likely, or by chance; the right edges
          denied; a false one claimed
OPM-CONF  for the targets' name or the references': sure of things of another class, unsure of the right ones, turned
          round, all the same, or each score the next candidate's
PRM       the ranking leaves a factor out, or takes one for its opposite; pairs have the next one's score, or that of
          another relation; a wrong pair comes first

What follows in the pipeline follows from the fault. It counts where the pipeline answers right without it, by a right
reference, and wrong with it, and where no other module is wrong in what decides (`alone`). Rates are told by module and
by kind.

    python -m benchmarks.fourth_pipeline --also FOLDER        (from tests/; FOLDER: another dataset with annotations)
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, cast

import numpy as np

from pipeline.answering.opening import open_pipeline
from pipeline.datasets.base import Dataset
from pipeline.datasets.synthetic import render_dataset
from pipeline.geometry.boxes import iou_2d
from pipeline.labels.job import label
from pipeline.labels.reading import Labels

from .fourth_parts import (
    COARSE,
    GRAPHS,
    Graph,
    Oriented,
    alone,
    edges,
    false_pairs,
    graph_pipeline,
    least_box,
    points_of,
    right_pair,
    scored,
    true_pairs,
    truly_wrong,
)
from .other_pipeline import (
    AXES,
    FAULTS,
    PLANTED_SHARE,
    Line,
    Met,
    OtherPipeline,
    Pair,
    Row,
    Thing,
    lines,
    right,
    right_ids,
    verdicts,
)
from .third_parts import Seen
from .third_pipeline import TRIES, put, told_rows

KINDS = {
    "OPM-TARGET": ("unseen", "nms", "topk", "synonym", "grouped"),
    "OPM-REF": ("unseen", "nms", "topk", "synonym", "grouped"),
    "LIFT": ("focal", "crop", "bleeding", "holes", "instance", "axes"),
    "SRM": ("swapped", "another", "yes", "chance", "denied", "claimed"),
    "OPM-CONF": ("oversure", "unsure", "turned", "flat", "shifted"),
    "PRM": ("deaf", "sign", "shifted", "stale", "first"),
}
"""A fault is "MODULE kind"."""
CONVENTIONS = ([-1, 1, 1], [1, -1, 1], [1, -1, -1])
"""Signs of x, y and z in other camera frames."""


def planted(graph: Graph, own: OtherPipeline, fault: str, met: Met, rng: np.random.Generator) -> Met | None:
    """With the fault, where the answer was right by a right reference, and the fault makes it wrong."""
    if own.told is None or not right_pair(own.told(own, met), met):
        return None
    module, kind = fault.split()
    for _ in range(TRIES):
        broken = planted_once(graph, own, module, kind, met, rng)
        if broken is None or right(own, own.told(own, broken), met):
            continue
        if truly_wrong(own, module, met, broken) and alone(own, module, met, broken):
            return broken
    return None


def planted_once(
    graph: Graph, own: OtherPipeline, module: str, kind: str, met: Met, rng: np.random.Generator
) -> Met | None:
    good, ends = right_ids(met)
    if module in ("SRM", "PRM"):
        judge = judged_wrong if module == "SRM" else ranked_wrong
        return judge(own, kind, met, rng)
    of_target = module == "OPM-TARGET" or (module != "OPM-REF" and rng.random() < 0.5)
    ids = good if of_target else ends
    if module == "LIFT":
        new = {i: box for i in ids if (box := lifted_wrong(kind, i, met, rng)) is not None}
        return put(met, new, rng) if len(new) == len(ids) else None
    change = scored_wrong if module == "OPM-CONF" else partial(proposed_wrong, own)
    return change(graph, kind, met, of_target, ids, rng)


def lifted_wrong(kind: str, i: int, met: Met, rng: np.random.Generator) -> Thing | None:
    """A thing with a wrong 3D box; None where there is nothing to be wrong by."""
    t, frame = cast(Oriented, met.known[i]), met.frame
    others = [cast(Oriented, o) for o in met.known.values() if o.id != i]
    if kind == "focal":
        factor = float(rng.choice([0.375, 0.5, 2.0, 2.5]))
        return replace(t, center=t.center * [factor, factor, 1], size=t.size * [factor, factor, 1])
    if kind == "crop":
        y0, x0 = np.array(t.box[:2]) / 1000 * [frame.height, frame.width]
        return replace(t, center=t.center - t.center[2] * np.array([x0 / frame.camera.fx, y0 / frame.camera.fy, 0]))
    if kind == "axes":
        signs = np.array(CONVENTIONS[int(rng.integers(len(CONVENTIONS)))])
        return replace(t, center=t.center * signs, R=signs[:, None] * t.R)
    if kind == "instance" and others:
        other = others[int(rng.integers(len(others)))]
        return replace(t, center=other.center, size=other.size, R=other.R)
    points = points_of(frame, i)
    if kind == "bleeding" and others:
        middle = np.array([*t.box[:2], *t.box[2:]]).reshape(2, 2).mean(axis=0)
        away = [float(np.linalg.norm(np.array(o.box).reshape(2, 2).mean(axis=0) - middle)) for o in others]
        near = points_of(frame, others[int(np.argsort(away)[int(rng.integers(min(2, len(others))))])].id)
        points = np.concatenate([points, near])
    elif kind == "holes":
        hollow = rng.random(len(points)) < rng.uniform(0.1, 0.5)
        read = float(rng.choice([0.0, 8.0 / max(1.0, float(np.median(points[:, 2])))]))
        points = np.where(hollow[:, None], points * read, points)
    else:
        return None
    center, size, R = least_box(points, met.viewer)
    return replace(t, center=center, size=size, R=R)


def judged_wrong(own: OtherPipeline, kind: str, met: Met, rng: np.random.Generator) -> Met | None:
    """With wrong probabilities of edges."""
    case, known = met.asked.case, met.known
    p = edges(own, met, case.relation)
    true, false = ([pair for pair in p if pair in of] for of in (true_pairs(met), false_pairs(met)))
    another = str(rng.choice([r for r in AXES if AXES[r][0] != AXES[case.relation][0]]))
    if kind == "claimed" and not false:
        return None
    said: dict[Pair, float] = {
        "swapped": lambda: {(a, b): own.probability(case.relation, known[b], known[a], met.viewer) for a, b in p},
        "another": lambda: edges(own, met, another),
        "yes": lambda: dict.fromkeys(p, 0.9),
        "chance": lambda: {pair: float(rng.choice(COARSE)) for pair in p},
        "denied": lambda: dict.fromkeys(true, 0.1),
        "claimed": lambda: {false[int(rng.integers(len(false)))]: 0.97},
    }[kind]()
    return replace(met, asked=replace(met.asked, relations=said))


def ranked_wrong(own: OtherPipeline, kind: str, met: Met, rng: np.random.Generator) -> Met | None:
    """With wrong scores of pairs."""
    case, targets, references = met.asked.case, met.asked.targets, met.asked.references
    p = edges(own, met, case.relation)
    factors = {(a, b): (targets[a], references[b], q) for (a, b), q in p.items()}
    scores = {pair: own.pair_score(*f) for pair, f in factors.items()}
    wrong = [pair for pair in p if pair not in true_pairs(met)]
    if kind == "shifted":
        said = dict(zip(p, np.roll(list(scores.values()), int(rng.choice([-1, 1]))).tolist(), strict=True))
    elif kind == "stale":
        other = edges(own, met, str(rng.choice([r for r in AXES if r != case.relation])))
        said = {pair: own.pair_score(f[0], f[1], other[pair]) for pair, f in factors.items()}
    elif kind == "first":
        if not wrong:
            return None
        said = {wrong[int(rng.integers(len(wrong)))]: max(scores.values()) + float(rng.uniform(0.01, 0.2))}
    else:
        k = int(rng.integers(3))
        said = {}
        for pair, f in factors.items():
            t, r, q = (x if j != k else 0.5 if kind == "deaf" else 1 - x for j, x in enumerate(f))
            said[pair] = own.pair_score(t, r, q)
    return replace(met, asked=replace(met.asked, scores=said))


def _side(met: Met, of_target: bool) -> tuple[str, str, dict[int, float], list[int]]:
    """The field and the name of a role, its scores, and what is neither of the name nor asked for."""
    seen, case = met.asked, met.asked.case
    side, name, scores, example = (
        ("targets", case.target, seen.targets, case.target_object)
        if of_target
        else ("references", case.reference, seen.references, case.reference_object)
    )
    named = set(met.truth.numbers[met.truth.alike[example]].tolist())
    return side, name, scores, [i for i in met.known if i not in named and i not in scores]


def scored_wrong(
    graph: Graph, kind: str, met: Met, of_target: bool, ids: Sequence[int], rng: np.random.Generator
) -> Met | None:
    """With wrong scores of one name's candidates."""
    side, _, scores, others = _side(met, of_target)
    logits = graph.logits(scores)
    if kind == "oversure":
        classes = sorted({met.known[i].name for i in others})
        if not classes:
            return None
        one = str(rng.choice(classes))
        logits |= {i: float(rng.uniform(3.5, 4.5)) for i in others if met.known[i].name == one}
        if graph.softmax:
            # Theirs stand to the sum of the others, which is 1.
            logits = {i: x if i in scores else x - 1 for i, x in logits.items()}
    elif kind == "unsure":
        logits |= {i: logits[i] - float(rng.uniform(2.5, 4.5)) for i in ids}
    elif kind == "turned":
        middle = float(np.median(list(logits.values()))) if graph.softmax else 0.0
        logits = {i: 2 * middle - x for i, x in logits.items()}
    elif kind == "flat":
        logits = dict.fromkeys(logits, 0.0)
    else:
        logits = dict(zip(logits, np.roll(list(logits.values()), 1).tolist(), strict=True))
    return replace(met, asked=replace(met.asked, **{side: graph.scores(dict(sorted(logits.items())))}))


def proposed_wrong(
    own: OtherPipeline, graph: Graph, kind: str, met: Met, of_target: bool, ids: Sequence[int],
    rng: np.random.Generator,
) -> Met | None:  # fmt: skip
    """Without the right candidates of one name."""
    side, name, scores, others = _side(met, of_target)
    logits = {i: x for i, x in graph.logits(scores).items() if i not in ids}
    gone: list[tuple[int, float, str]] = []
    if kind == "grouped":
        return _grouped(met, ids, rng)
    if kind in ("nms", "topk"):
        gone = [(i, scores[i], "overlap" if kind == "nms" else "rank") for i in ids]
    if kind == "synonym":
        named = set(met.known) - set(others) - set(scores)
        logits = {i: x for i, x in logits.items() if i not in named and met.known[i].name != name}
        found = rng.permutation(others)[: 1 + int(rng.integers(2))].tolist()
        logits |= {int(i): float(rng.uniform(0.6, 3.0)) - (2 if graph.softmax else 0) for i in found}
    kept = graph.scores(dict(sorted(logits.items())))
    return replace(met, asked=replace(cast(Seen, met.asked), **{side: kept}, dropped={name: gone}))


def _grouped(met: Met, ids: Sequence[int], rng: np.random.Generator) -> Met | None:
    """Each of these with a neighbour in one box, in which none of the frame's things is found; None without one."""
    new: dict[int, Thing] = {}
    every = np.array([t.box for t in met.known.values()])
    for i in ids:
        t = cast(Oriented, met.known[i])
        unions = np.concatenate([np.minimum(every[:, :2], t.box[:2]), np.maximum(every[:, 2:], t.box[2:])], axis=1)
        free = [k for k, u in enumerate(unions) if iou_2d(u[None], every).max() < 0.45]
        if not free:
            return None
        area = np.prod(unions[:, 2:] - unions[:, :2], axis=1)
        k = min(free, key=lambda k: float(area[k]))
        other = list(met.known)[k]
        both = np.concatenate([points_of(met.frame, j) for j in (i, other)])
        center, size, R = least_box(both, met.viewer)
        new[i] = replace(t, box=tuple(unions[k].tolist()), center=center, size=size, R=R)
    return put(met, new, rng)


@dataclass
class Kept:
    """What was planted, by frame and text: before and after."""

    planted: Callable[..., Met | None]
    mets: dict[tuple[str, str], tuple[Met, Met]] = field(default_factory=dict)

    def __call__(self, *given: Any) -> Met | None:
        """As `planted`, whose last arguments are the expression and the generator."""
        met, broken = given[-2], self.planted(*given)
        if broken is not None:
            self.mets[met.frame.id, met.asked.case.text] = met, broken
        return broken


def numbered(own: OtherPipeline, root: Path, labels: Labels, found: Sequence[Line]) -> tuple[list[Row], list[Line]]:
    """`verdicts`, with the line that each row is of."""
    marked = [replace(f, fault=f"{f.fault}#{k}") for k, f in enumerate(found)]
    rows, of = [], []
    for fault, verdict, detail in verdicts(own, root, labels, marked):
        words, _, k = str(fault).partition("#")
        rows.append((None if words == "None" else words, verdict, detail))
        of.append(found[int(k)])
    return rows, of


def as_told(own: OtherPipeline, met: Met) -> dict[str, Any]:
    """A line for people: answer, scores by id, centres and sizes (metres), and pairs with P and score."""
    assert own.told is not None
    line, seen = own.told(own, met), met.asked
    used = {**seen.targets, **seen.references}
    return {
        "answer": line.answer and (line.answer.object, line.answer.reference),
        "targets": {i: round(s, 3) for i, s in seen.targets.items()},
        "references": {i: round(s, 3) for i, s in seen.references.items()},
        "things": {t.id: [t.name, *np.round([*t.center, *t.size], 2).tolist()] for t in map(met.known.get, used) if t},
        "pairs": [[*pair, round(p, 3), round(score, 4)] for pair, (p, score) in scored(own, met).items()],
    }


@dataclass(frozen=True)
class Study:
    """Pipelines by name, how one is made over a dataset with what breaks it, and the kinds of faults by module."""

    names: Sequence[str]
    make: Callable[[str, Dataset, Kept], OtherPipeline]
    planted: Callable[..., Met | None]
    kinds: Mapping[str, Sequence[str]]


def measured(study: Study, root: Path, labels: Path, given: argparse.Namespace, every: int, apart: int) -> None:
    opened, data = label(root, labels), open_pipeline(root, srm="rule").dataset
    kinds = {m: [f"{m} {k}" for k in study.kinds[m]] for m in FAULTS}
    # Each module as often as any other.
    even = [fault for m in FAULTS for fault in kinds[m] for _ in range(60 // len(kinds[m]))]
    mixed = [(seed, every, PLANTED_SHARE, even) for seed in range(given.first, given.first + given.seeds)]
    alone = [(given.first + given.seeds, apart, 1.0, kinds[m]) for m in FAULTS]
    for name in given.only or study.names:
        for words, files in (("mixed", mixed), ("one module", alone)):
            rows: list[Row] = []
            for file in files:
                kept = Kept(study.planted)
                own = study.make(name, data, kept)
                found, of = numbered(own, root, opened, list(lines(own, data, opened, *file)))
                rows += found
                if given.misses is not None:
                    write_misses(given.misses, (root.name, name, words, file[0]), own, kept.mets, found, of)
            told_rows(f"{name}, {root.name}, {words}", rows, study.kinds)


def write_misses(
    path: Path, where: tuple[object, ...], own: OtherPipeline, mets: Mapping[tuple[str, str], tuple[Met, Met]],
    rows: Sequence[Row], of: Sequence[Line],
) -> None:  # fmt: skip
    """Append a JSON line for each fault that was not named."""
    with path.open("a") as file:
        for (fault, verdict, detail), line in zip(rows, of, strict=True):
            if fault is None or fault.split()[0] == verdict:
                continue
            met, broken = mets[line.line.frame, line.line.text]
            told = {"in": where, "frame": line.line.frame, "text": line.line.text, "fault": fault, "verdict": verdict,
                    "detail": detail, "true": sorted(true_pairs(met)),
                    "before": as_told(own, met), "after": as_told(own, broken)}  # fmt: skip
            file.write(json.dumps(told) + "\n")


def main(study: Study, rooms_seed: int, every: int, apart: int, also: tuple[int, int]) -> None:
    """Rates on rendered rooms and on another dataset; of expressions each so manieth, mixed and with one module."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--also", type=Path)
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--first", type=int, default=0, help="the first seed of what is planted, and of rooms")
    parser.add_argument("--every", type=int, default=every)
    parser.add_argument("--apart", type=int, default=apart)
    parser.add_argument("--only", choices=study.names, action="append")
    parser.add_argument("--misses", type=Path, help="JSON lines of what was not named are appended to it")
    given = parser.parse_args()
    with TemporaryDirectory() as folder:
        rooms = Path(folder, "rooms")
        render_dataset(rooms, rooms=8, views=3, seed=rooms_seed + given.first, width=480, height=360)
        measured(study, rooms, Path(folder, "labels"), given, given.every, given.apart)
        if given.also is not None:
            measured(study, given.also, Path(folder, "also"), given, *also)


if __name__ == "__main__":
    main(Study(list(GRAPHS), graph_pipeline, planted, KINDS), 2718, 6, 16, (1, 2))
