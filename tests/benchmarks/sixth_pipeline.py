"""Two more pipelines that are not ours (`sixth_parts`), with faults that stand in code: each is a rule; held out.

OPM-TARGET, OPM-REF  things of a name are taken for another class, suppressed by what overlaps them whatever its class,
          cut off after the two surest, missed by a synonym, dropped at the picture's border, or for being small
LIFT      boxes of all candidates: by intrinsics of another resolution, of depth in another unit in half of the picture,
          with what flies between a thing and its background, by a transposed rotation, joined with what they stand on,
          or at the near surface
SRM       arguments swapped; sides of the reference's own front; one relation's head dead; above for below; a margin in
          another unit; one relation far too sure
OPM-CONF  a class that is sure of whatever name; scores turned round; larger boxes surer; shared among a name's things;
          less with distance
PRM       a factor ignored; a sum; the next pair of the list; the least; the scores of target and reference exchanged; a
          winner by the place of another line's

Two ways: some lines of a file broken, each by some kind; and a file for each kind, in which the rule is applied to
every line, also where the answer stays as it was. A fault counts where the pipeline answers right without it, by a
right reference, and wrong with it, where the module is wrong in truth and no other is wrong in what decides.

    python -m benchmarks.sixth_pipeline --also FOLDER        (from tests/; FOLDER: another dataset with annotations)
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import cast

import cv2
import numpy as np

from pipeline.answering.objects import prepare_frame
from pipeline.answering.opening import open_pipeline
from pipeline.answering.placing import box_3d
from pipeline.datasets.base import Dataset
from pipeline.datasets.synthetic import render_dataset
from pipeline.geometry.boxes import iou_2d, iou_3d
from pipeline.geometry.camera import backproject
from pipeline.geometry.frame import Frame
from pipeline.geometry.viewer import ViewerAxes
from pipeline.labels.cases import FrameCases, read_cases
from pipeline.labels.job import label
from pipeline.labels.reading import Labels

from .fifth_parts import Variant, factors_of, judged
from .fifth_pipeline import side_of
from .fifth_pipeline import truly as truly_said
from .fourth_parts import Oriented, alone, edges, points_of, right_pair, true_pairs, truly_wrong
from .fourth_pipeline import numbered, write_misses
from .other_pipeline import AXES, FAULTS, Line, Met, OtherPipeline, Row, Thing, right
from .planted_parts import share
from .sixth_parts import NAMES, Made, Told, in_hundredths, made, odds_of, sixth
from .third_pipeline import put, told_rows

KINDS = {
    "OPM-TARGET": ("class", "nms", "cap", "synonym", "border", "small"),
    "OPM-REF": ("class", "nms", "cap", "synonym", "border", "small"),
    "LIFT": ("resolution", "region", "flying", "transposed", "support", "near"),
    "SRM": ("swapped", "allocentric", "dead", "vertical", "margin", "temperature"),
    "OPM-CONF": ("class", "negated", "larger", "split", "far"),
    "PRM": ("ignores", "sum", "next", "least", "exchanged", "stale"),
}
"""A fault is "MODULE kind"."""
SHARE = 0.65
"""Of the lines in which a fault is tried; many of them keep their answer, so that some fifth is broken."""
HALF = ("left", "above", "behind")
"""The relations whose heads are broken in a whole file, where that is of some relations only."""
OFTEN = np.array([1, 1, 3, 2, 1, 1]) / 9
"""How often each of FAULTS is tried."""


def planted(
    parts: Made, own: OtherPipeline, fault: str, met: Met, rng: np.random.Generator, whole: bool
) -> tuple[Met | None, bool]:
    """The expression with the fault, None where the rule changes nothing; and whether it counts."""
    assert own.told is not None
    module, kind = fault.split()
    if module == "LIFT":
        new = lifted_wrong(parts, kind, met)
        # In a whole file a thing has the same wrong box in every line.
        known = {**met.known, **new}
        broken = replace(met, known=known) if whole else put(met, cast("dict[int, Thing]", new), rng)
    elif module == "SRM":
        broken = judged_wrong(parts, own, kind, met, whole)
    elif module == "PRM":
        broken = ranked_wrong(own, kind, met, rng, whole)
    elif module == "OPM-CONF":
        broken = scored_wrong(parts, kind, met)
    else:
        broken = proposed_wrong(parts, kind, met, module == "OPM-TARGET")
    if broken is None:
        return None, False
    counts = (
        right_pair(own.told(own, met), met)
        and not right(own, own.told(own, broken), met)
        and truly(parts, own, module, met, broken)
        and alone(own, module, met, broken)
    )
    return broken, counts


def truly(parts: Made, own: OtherPipeline, module: str, met: Met, broken: Met) -> bool:
    """Whether the module is wrong in truth: a box of the answer's pair or of a right one is far off; edges, proposals
    and confidences as for the earlier pipelines."""
    if module == "LIFT":
        assert own.told is not None
        answer = own.told(own, broken).answer
        assert answer is not None
        place = {t.box: t.id for t in broken.known.values()}
        was = {place[t.box]: t for t in met.known.values()}
        used = {cast(int, answer.object), cast(int, answer.reference)}
        used |= {place[met.known[i].box] for pair in true_pairs(met) for i in pair if i in met.known}
        pairs = [[box_3d(own.written(t)[1], own.header, None) for t in (was[i], broken.known[i])] for i in used]
        return any(iou_3d(a, b) < 0.5 for a, b in pairs)
    if module == "OPM-CONF" and not right_with_honest_scores(parts, own, met, broken):
        return False
    if module.startswith("OPM"):
        # Of the variant only the pixels of a box are asked.
        return truly_said(cast(Variant, parts), own, module, met, broken)
    return truly_wrong(own, module, met, broken)


def right_with_honest_scores(parts: Made, own: OtherPipeline, met: Met, broken: Met) -> bool:
    """Whether the same candidates with the scores from before, the new ones with the least, are answered right: else
    it is not their confidence that makes them win."""
    assert own.told is not None
    least = parts.band[1][0]
    targets = {i: met.asked.targets.get(i, least) for i in broken.asked.targets}
    references = {i: met.asked.references.get(i, least) for i in broken.asked.references}
    honest = replace(broken, asked=replace(broken.asked, targets=targets, references=references))
    return right(own, own.told(own, honest), met)


def lifted_wrong(parts: Made, kind: str, met: Met) -> dict[int, Oriented]:
    """All candidates as they are lifted with the fault."""
    new: dict[int, Oriented] = {}
    frame, viewer = met.frame, met.viewer
    for i in {**met.asked.targets, **met.asked.references}:
        t = cast(Oriented, met.known[i])
        if kind == "transposed":
            G = viewer.R_level_camera
            moved = replace(t, center=G.T @ G.T @ t.center, R=G.T @ G.T @ t.R)
        elif kind == "near":
            way = t.center / np.linalg.norm(t.center)
            moved = replace(t, center=t.center - way * t.reach(way))
        else:
            moved = parts.lifted(t, wrong_points(parts, kind, frame, t), viewer)
        if moved is not None:
            new[i] = moved
    return new


def wrong_points(parts: Made, kind: str, frame: Frame, t: Thing) -> np.ndarray:
    """(N, 3): the depth points that a thing is lifted from with the fault."""
    points, camera = points_of(frame, t.id), frame.camera
    z = points[:, 2:]
    focal, middle = np.array([camera.fx, camera.fy]), np.array([camera.cx, camera.cy])
    uv = points[:, :2] / z * focal + middle
    if kind == "resolution":
        # The camera is that of a smaller or larger picture.
        size = (0.5, 0.75, 2.0)[int(3 * share(frame.id.split("/")[0], kind))]
        return np.concatenate([(uv - size * middle) / (size * focal) * z, z], axis=1)
    if kind == "region":
        side = int(4 * share(frame.id, kind))
        half = uv[:, side // 2] > (frame.width, frame.height)[side // 2] / 2
        unit = (0.5, 0.7, 1.5)[int(3 * share(frame.id, "unit"))]
        return np.where((half == bool(side % 2))[:, None], unit * points, points)
    x0, y0, x1, y1 = parts.pixels(t, frame)
    if kind == "support":
        w, h = x1 - x0, y1 - y0
        below = points_between(frame, (x0 - 0.2 * w, y1, x1 + 0.2 * w, y1 + 0.7 * h))
        return np.concatenate([points, below])
    near = next(a.mask for a in frame.annotations if a.index == t.id)
    assert near is not None
    wide = max(3, round(0.03 * frame.width))
    around = cv2.dilate(near.astype(np.uint8), np.ones((2 * wide + 1,) * 2, np.uint8)).astype(bool)
    v, u = np.nonzero(around & (frame.depth > 0))
    return np.concatenate([points, backproject(frame.depth, camera, v, u).astype(np.float64)])


def points_between(frame: Frame, box: tuple[float, ...]) -> np.ndarray:
    """(N, 3): depth points in a 2D box, x0 y0 x1 y1."""
    x0, y0, x1, y1 = np.maximum(0, box).astype(int)
    v, u = np.nonzero(frame.depth[y0:y1, x0:x1] > 0)
    return backproject(frame.depth, frame.camera, v + y0, u + x0).astype(np.float64)


def judged_wrong(parts: Made, own: OtherPipeline, kind: str, met: Met, whole: bool) -> Met | None:
    """With wrong probabilities of all pairs; of "dead" and "temperature" in a whole file for half of the relations."""
    relation, known, viewer = met.asked.case.relation, met.known, met.viewer
    upright = AXES[relation][0] == 1
    if (kind == "vertical" and not upright) or (kind == "allocentric" and upright):
        return None
    if whole and kind in ("dead", "temperature") and relation not in HALF:
        return None

    def p(a: int, b: int) -> float:
        one, other, seen, odds = known[a], known[b], viewer, odds_of
        if kind == "swapped":
            one, other = other, one
        elif kind == "allocentric":
            for _ in range(int(4 * share(other.name, "front"))):
                seen = replace(seen, right=seen.forward, forward=-seen.right)
        elif kind == "dead":
            # What is no word wavers a little.
            wavers = 0.0 if parts.masked else 0.001 * share(relation, a, b)
            return parts.said(relation, dict.fromkeys(AXES, 0.0)) + wavers
        elif kind == "vertical":
            turned = {"above": "below", "below": "above"}
            return parts.probability(lambda r, *of: odds_of(turned.get(r, r), *of), relation, one, other, seen)
        elif kind == "margin":
            odds = partial(odds_of, least=1.0)
        else:
            return parts.probability(
                lambda r, *of: odds_of(r, *of) * (20 if r == relation else 1), relation, one, other, seen
            )
        return parts.probability(odds, relation, one, other, seen)

    said = {pair: p(*pair) for pair in edges(own, met, relation)}
    return replace(met, asked=replace(met.asked, relations=said))


def ranked_wrong(own: OtherPipeline, kind: str, met: Met, rng: np.random.Generator, whole: bool) -> Met | None:
    """With wrong scores of all pairs, or another pair for an answer than the first."""
    p = judged(own, met)
    if len(p) < 2:
        return None
    factors, pairs = factors_of(met, p), list(p)
    scores = [own.pair_score(*row) for row in factors.tolist()]
    if kind in ("next", "least", "stale"):
        least, first = int(np.argmin(scores)), int(np.argmax(scores))
        other = int(len(p) * share(met.frame.id, met.asked.case.text, kind))
        k = {"next": (first + 1) % len(p), "least": least, "stale": other}[kind]
        return replace(met, asked=replace(cast(Told, met.asked), answer=pairs[k]))
    if kind == "sum":
        wrong = factors.sum(axis=1).tolist()
    elif kind == "exchanged":
        wrong = [own.pair_score(r, t, q) for t, r, q in factors.tolist()]
    else:
        k = (2 if own.header.system.endswith(NAMES[0]) else 0) if whole else int(rng.integers(3))
        factors[:, k] = 0.5
        wrong = [own.pair_score(*row) for row in factors.tolist()]
    return replace(met, asked=replace(met.asked, scores=dict(zip(pairs, wrong, strict=True))))


def scored_wrong(parts: Made, kind: str, met: Met) -> Met | None:
    """With wrong scores of the candidates of both names."""
    new: dict[str, dict[int, float]] = {}
    low, high = parts.band[1][0], parts.band[0][1]
    boxes = {i: parts.pixels(t, met.frame) for i, t in met.known.items()}
    side_length = {i: float(np.sqrt(np.prod(b[2:] - b[:2]))) for i, b in boxes.items()}
    for of_target in (True, False):
        side, name, scores, named = side_of(met, of_target)
        own = [i for i in scores if i in named]
        if kind == "class":
            sure = {i: share(met.frame.id, i, name) for i, t in met.known.items() if share(t.name, "sure") < 0.35}
            said = scores | {i: high + (0.97 - high) * q for i, q in sure.items() if i not in named}
        elif kind == "negated":
            said = {i: low + high - s for i, s in scores.items()}
        elif kind == "larger":
            most = max((side_length[i] for i in scores), default=1.0)
            said = {i: s * side_length[i] / most for i, s in scores.items()}
        elif kind == "split":
            said = {i: s / len(own) if i in own else s for i, s in scores.items()}
        else:
            said = {i: s * float(np.exp(min(0.0, 0.8 * (1 - met.known[i].center[2])))) for i, s in scores.items()}
        new[side] = in_hundredths(said)
    changed = new["targets"] != met.asked.targets or new["references"] != met.asked.references
    return replace(met, asked=replace(met.asked, **new)) if changed else None


def proposed_wrong(parts: Made, kind: str, met: Met, of_target: bool) -> Met | None:
    """Without candidates of one name."""
    side, name, scores, named = side_of(met, of_target)
    frame, known = met.frame, met.known
    whole = np.array([frame.width, frame.height] * 2, np.float64)
    boxes = {i: parts.pixels(t, frame) / whole for i, t in known.items()}
    area = {i: float(np.prod(b[2:] - b[:2])) for i, b in boxes.items()}
    by_score = sorted(scores, key=lambda i: -scores[i])

    def covered(i: int) -> bool:
        larger = [boxes[j] for j in known if area[j] > area[i]]
        return bool(larger) and bool(iou_2d(boxes[i][None], np.array(larger)).max() > 0.3)

    rules: dict[str, tuple[Callable[[int], bool], str | None]] = {
        "class": (lambda i: i in named, None),
        "nms": (covered, "overlap"),
        "cap": (lambda i: i in by_score[2:], "rank"),
        "synonym": (lambda i: i in named, None),
        "border": (lambda i: bool(boxes[i][:2].min() < 0.015 or boxes[i][2:].max() > 0.985), None),
        "small": (lambda i: area[i] < 0.01, None),
    }
    drops, why = rules[kind]
    gone = [i for i in scores if drops(i)]
    if not gone:
        return None
    kept = {i: s for i, s in scores.items() if i not in gone}
    others = sorted({t.name for i, t in known.items() if i not in named}, key=lambda other: share(name, other, kind))
    if kind == "class" and others:
        least, most = parts.band[0]
        found = [i for i, t in known.items() if t.name == others[0]]
        kept |= {i: least + (most - least) * share(frame.id, i, name) for i in found}
    dropped = {name: [(i, scores[i], why) for i in gone if why is not None and i not in kept]}
    fields: dict[str, dict] = {side: in_hundredths(kept), "dropped": dropped}
    return replace(met, asked=replace(cast(Told, met.asked), **fields))


Scene = tuple[FrameCases, Frame, ViewerAxes, dict[int, Thing]]


def scenes(own: OtherPipeline, dataset: Dataset, labels: Labels) -> Iterator[Scene]:
    """Each frame's expressions, the frame, its viewer and what the pipeline has of its things."""
    for truth in read_cases(labels, 0, 2**31 - 1):
        frame = dataset.load(truth.frame)
        yield truth, frame, prepare_frame(dataset, frame).viewer, {t.id: t for t in own.things(frame)}


@dataclass
class Bench:
    """One pipeline over frames; `mets` keeps what was planted, before and after."""

    parts: Made
    own: OtherPipeline
    frames: Sequence[Scene]
    mets: dict[tuple[str, str], tuple[Met, Met]] = field(default_factory=dict)

    def lines(self, seed: int, every: int, fault: str | None) -> Iterator[Line]:
        """Some lines broken by any fault; or every line by the one that is given."""
        rng, own = np.random.default_rng(seed), self.own
        assert own.asked is not None
        assert own.told is not None
        for truth, frame, viewer, known in self.frames:
            for case in truth.cases[seed % every :: every] if known else ():
                if case.target == case.reference:
                    continue
                met = Met(own.asked(case, truth, known, rng), truth, known, viewer, frame)
                tried: list[str] = [] if fault is None else [fault]
                if fault is None and rng.random() < SHARE:
                    module = str(rng.choice(FAULTS, p=OFTEN))
                    tried = [f"{module} {kind}" for kind in rng.permutation(KINDS[module])]
                found = ((one, *planted(self.parts, own, one, met, rng, fault is not None)) for one in tried)
                one, broken, counts = next((f for f in found if f[2] or fault is not None), (None, None, False))
                if counts and broken is not None:
                    self.mets[frame.id, case.text] = met, broken
                yield Line(own.told(own, broken or met), one if counts else None)


def measured(root: Path, labels: Path, given: argparse.Namespace, every: int, apart: int) -> None:
    opened, data = label(root, labels), open_pipeline(root, srm="rule").dataset
    mixed = [(seed, every, None) for seed in range(given.first, given.first + given.seeds)]
    alone = [(given.first + k, apart, f"{m} {kind}") for m in FAULTS for k, kind in enumerate(KINDS[m])]
    for name in given.only or NAMES:
        parts = made(name, data)
        own = sixth(parts, data)
        frames = list(scenes(own, data, opened))
        for words, files in (("mixed", mixed), ("whole files", alone)):
            rows: list[Row] = []
            broken = lines = 0
            for file in files:
                bench = Bench(parts, own, frames)
                found, of = numbered(own, root, opened, list(bench.lines(*file)))
                rows += found
                broken, lines = broken + len(bench.mets), lines + len(of)
                if given.misses is not None:
                    where = (root.name, name, words, file[0])
                    write_misses(given.misses, where, own, bench.mets, found, of)
            told_rows(f"{name}, {root.name}, {words} ({broken} of {lines} lines)", rows, KINDS)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--also", type=Path)
    parser.add_argument("--seeds", type=int, default=3, help="files of which some lines are broken")
    parser.add_argument("--first", type=int, default=0, help="the first seed of what is planted, and of rooms")
    parser.add_argument("--every", type=int, default=6)
    parser.add_argument("--apart", type=int, default=16)
    parser.add_argument("--only", choices=NAMES, action="append")
    parser.add_argument("--misses", type=Path, help="JSON lines of what was not named are appended to it")
    given = parser.parse_args()
    assert set(KINDS) == set(FAULTS)
    with TemporaryDirectory() as folder:
        rooms = Path(folder, "rooms")
        render_dataset(rooms, rooms=8, views=3, seed=27182 + given.first, width=480, height=360)
        measured(rooms, Path(folder, "labels"), given, given.every, given.apart)
        if given.also is not None:
            measured(given.also, Path(folder, "also"), given, 1, 2)


if __name__ == "__main__":
    main()
