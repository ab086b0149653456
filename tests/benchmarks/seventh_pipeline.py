"""Two more pipelines that are not ours (`seventh_parts`), with faults that stand in code: each is a rule; held out.

OPM-TARGET, OPM-REF  things of a name are taken for another class, unknown by that name, suppressed by what overlaps
          them, cut by the seam of two tiles, beyond the greatest depth, too long and thin, or below a raised threshold
LIFT      boxes of all candidates: by intrinsics of another resolution, of depth in another unit in half of the picture,
          by a transposed rotation, joined with what they stand on, from all of the 2D box instead of the mask, with
          holes filled by the mean depth, by a depth picture some pixels aside, from less than half of a split mask, or
          by the depth of the next picture
SRM       arguments swapped; sides of the reference's own front; a dead head; one axis turned round; a margin in another
          unit; a relation far too sure; the probability of the pair before
OPM-CONF  a class that is sure of whatever name; scores from one down; divided by area; less beside the middle;
          sorted, but their boxes not
PRM       a factor ignored; factors in another order; the next pair; the least; only the first four pairs scored; a far
          too strong wish for what is near; a winner by the place of another line's

Two ways: some lines of a file broken, each by some kind; and a file for each kind, in which the rule is applied to
every line, also where the answer stays as it was. A fault counts where the pipeline answers right without it, by a
right reference, and wrong with it, where the module is wrong in truth and no other is wrong in what decides.

    python -m benchmarks.seventh_pipeline --also FOLDER        (from tests/; FOLDER: another dataset with annotations)
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import cast

import numpy as np

from pipeline.answering.opening import open_pipeline
from pipeline.datasets.base import Dataset
from pipeline.datasets.synthetic import render_dataset
from pipeline.geometry.boxes import iou_2d
from pipeline.geometry.camera import backproject
from pipeline.geometry.frame import Frame
from pipeline.labels.job import label

from .fifth_parts import judged
from .fifth_pipeline import side_of
from .fourth_parts import Oriented, alone, edges, points_of, right_pair, true_pairs
from .fourth_pipeline import numbered, write_misses
from .other_pipeline import AXES, FAULTS, Line, Met, OtherPipeline, Row, Thing, right
from .planted_parts import share
from .seventh_parts import NAMES, Parts, parts_of, seventh, trained
from .sixth_parts import Made, Told
from .sixth_pipeline import HALF, Scene, points_between, scenes, truly
from .sixth_pipeline import wrong_points as by_sixth
from .third_pipeline import put, told_rows

MISSED = ("class", "synonym", "nms", "seam", "far", "thin", "threshold")
KINDS = {
    "OPM-TARGET": MISSED,
    "OPM-REF": MISSED,
    "LIFT": (
        "resolution", "region", "transposed", "support", "boxed", "holes", "registered", "half", "lagging",
    ),
    "SRM": ("swapped", "allocentric", "dead", "flipped", "margin", "temperature", "stale"),
    "OPM-CONF": ("class", "negated", "area", "centre", "order"),
    "PRM": ("ignores", "columns", "next", "least", "batch", "near", "stale"),
}  # fmt: skip
"""A fault is "MODULE kind"."""
SHARE = 0.6
"""Of the lines in which a fault is tried; many of them keep their answer, so that some fifth is broken."""
OFTEN = np.array([1, 1, 5, 3, 2, 2]) / 14
"""How often each of FAULTS is tried; boxes seldom change an answer."""
DENSER = {"LIFT": 3.0, "SRM": 2.5}
"""How many times as many expressions a whole file has of a module than one of the others."""
TURNED = {"left": "right", "right": "left", "above": "below", "below": "above", "front": "behind", "behind": "front"}
FAR_M = 2.5
BATCH = 4


def planted(
    parts: Parts, own: OtherPipeline, fault: str, met: Met, rng: np.random.Generator, whole: bool, after: Frame
) -> tuple[Met | None, bool]:
    """The expression with the fault, None where the rule changes nothing; and whether it counts."""
    assert own.told is not None
    module, kind = fault.split()
    if module == "LIFT":
        new = lifted_wrong(parts, kind, met, after)
        # In a whole file a thing has the same wrong box in every line.
        known = {**met.known, **new}
        broken = replace(met, known=known) if whole else put(met, cast("dict[int, Thing]", new), rng)
    elif module == "SRM":
        broken = judged_wrong(parts, own, kind, met, whole)
    elif module == "PRM":
        broken = ranked_wrong(parts, own, kind, met, rng, whole)
    elif module == "OPM-CONF":
        broken = scored_wrong(parts, kind, met)
    else:
        broken = proposed_wrong(parts, kind, met, module == "OPM-TARGET")
    if broken is None:
        return None, False
    counts = (
        right_pair(own.told(own, met), met)
        and not right(own, own.told(own, broken), met)
        and truly(cast(Made, parts), own, module, met, broken)
        and alone(own, module, met, parts.ranked(own, broken))
    )
    return broken, counts


def lifted_wrong(parts: Parts, kind: str, met: Met, after: Frame) -> dict[int, Oriented]:
    """All candidates as they are lifted with the fault; `after` is the next picture of the dataset."""
    new: dict[int, Oriented] = {}
    for i in {**met.asked.targets, **met.asked.references}:
        points = wrong_points(parts, kind, met, met.known[i], after)
        moved = parts.lifted(met.known[i], points, met.viewer)
        if moved is not None:
            new[i] = moved
    return new


def wrong_points(parts: Parts, kind: str, met: Met, t: Thing, after: Frame) -> np.ndarray:
    """(N, 3): the depth points that a thing is lifted from with the fault."""
    frame, camera = met.frame, met.frame.camera
    if kind in ("resolution", "region", "support"):
        return by_sixth(cast(Made, parts), kind, frame, t)
    points = points_of(frame, t.id)
    if kind == "transposed":
        twice = met.viewer.R_level_camera.T @ met.viewer.R_level_camera.T
        return points @ twice.T
    if kind == "boxed":
        x0, y0, x1, y1 = parts.pixels(t, frame).tolist()
        return points_between(frame, (x0, y0, x1, y1))
    if kind in ("half", "holes"):
        # What is left or filled lies on one side of the thing in the picture.
        k, sign = divmod(int(4 * share(frame.id, t.id, kind)), 2)
        along = (1 - 2 * sign) * points[:, k] / points[:, 2]
        there = along > np.quantile(along, 0.6)
        if kind == "half":
            return points[there]
        holed = share(frame.id, t.id, "holed") < 0.6
        filled = points / points[:, 2:] * float(frame.depth[frame.depth > 0].mean())
        return np.where(there[:, None], filled, points) if holed else points
    mask = next(a.mask for a in frame.annotations if a.index == t.id)
    assert mask is not None
    depth = frame.depth
    v, u = np.nonzero(mask)
    if kind == "registered":
        side = 1 if share(frame.id.split("/")[0], kind) < 0.5 else -1
        u = np.clip(u + round(0.05 * frame.width) * side, 0, frame.width - 1)
    elif after.depth.shape == depth.shape:
        depth = after.depth
    there = depth[v, u] > 0
    return backproject(depth, camera, v[there], u[there]).astype(np.float64)


def judged_wrong(parts: Parts, own: OtherPipeline, kind: str, met: Met, whole: bool) -> Met | None:
    """With wrong probabilities of all pairs; some kinds in a whole file for half of the relations."""
    relation, known, viewer = met.asked.case.relation, met.known, met.viewer
    if kind == "allocentric" and AXES[relation][0] == 1:
        return None
    if whole and kind == "flipped" and AXES[relation][0] != 0:
        return None
    if whole and kind in ("dead", "temperature") and relation not in HALF:
        return None
    right_ones = edges(own, met, relation)

    def p(a: int, b: int) -> float:
        one, other, seen = known[a], known[b], viewer
        if kind == "swapped":
            return parts.probability(relation, other, one, seen)
        if kind == "dead":
            # Its bias, and what its weights leave.
            return 0.3 + 0.02 * share(relation, a, b)
        if kind == "flipped":
            return parts.probability(TURNED[relation], one, other, seen)
        if kind == "margin":
            return parts.judge(relation, one, other, seen, 1.0, 1.0)
        if kind == "temperature":
            return parts.judge(relation, one, other, seen, 0.0, 15.0)
        for _ in range(int(4 * share(other.name, "front"))):
            seen = replace(seen, right=seen.forward, forward=-seen.right)
        return parts.probability(relation, one, other, seen)

    if kind == "stale":
        values = list(right_ones.values())
        said = dict(zip(right_ones, values[-1:] + values[:-1], strict=True))
    else:
        said = {pair: p(*pair) for pair in right_ones}
    return replace(met, asked=replace(met.asked, relations=said))


def ranked_wrong(
    parts: Parts, own: OtherPipeline, kind: str, met: Met, rng: np.random.Generator, whole: bool
) -> Met | None:
    """With wrong scores of all pairs, or another pair for an answer than the first."""
    p = judged(own, met)
    if len(p) < 2:
        return None
    factors, pairs = parts.factors(met, p), list(p)
    scores = parts.ranks(factors, pairs)
    if kind in ("next", "least", "stale"):
        other = int(len(p) * share(met.frame.id, met.asked.case.text, kind))
        first, least = int(np.argmax(scores)), int(np.argmin(scores))
        k = {"next": (first + 1) % len(p), "least": least, "stale": other}[kind]
        return replace(met, asked=replace(cast(Told, met.asked), answer=pairs[k]))
    if kind == "columns":
        wrong = parts.ranks(factors[:, [2, 0, 1, 3]], pairs)
    elif kind == "batch":
        wrong = np.where(np.arange(len(p)) < BATCH, scores, min(0.0, float(scores.min())) - 1)
    elif kind == "near":
        wrong = scores - 2 * scores.std() * factors[:, 3]
    else:
        factors[:, (2 if parts.masked else 0) if whole else int(rng.integers(3))] = 0.5
        wrong = parts.ranks(factors, pairs)
    return replace(met, asked=replace(met.asked, scores=dict(zip(pairs, wrong.tolist(), strict=True))))


def scored_wrong(parts: Parts, kind: str, met: Met) -> Met | None:
    """With wrong scores of the candidates of both names."""
    new: dict[str, dict[int, float]] = {}
    whole = np.array([met.frame.width, met.frame.height] * 2, np.float64)
    boxes = {i: parts.pixels(t, met.frame) / whole for i, t in met.known.items()}
    area = {i: float(np.prod(b[2:] - b[:2])) for i, b in boxes.items()}
    beside = {i: float(np.linalg.norm((b[:2] + b[2:]) / 2 - 0.5)) for i, b in boxes.items()}
    for of_target in (True, False):
        side, name, scores, named = side_of(met, of_target)
        if kind == "class":
            sure = {i: share(met.frame.id, i, name) for i, t in met.known.items() if share(t.name, "sure of") < 0.35}
            said = scores | {i: parts.sure(0.9 + 0.2 * q) for i, q in sure.items() if i not in named}
        elif kind == "negated":
            said = {i: 1 - s for i, s in scores.items()}
        elif kind == "area":
            least = min((area[i] for i in scores), default=1.0)
            said = {i: s * (least / area[i]) ** 0.5 for i, s in scores.items()}
        elif kind == "centre":
            said = {i: s * float(np.exp(-2 * beside[i])) for i, s in scores.items()}
        else:
            said = dict(zip(scores, sorted(scores.values(), reverse=True), strict=True))
        new[side] = {i: round(min(max(s, 0.0005), 0.9995), 4) for i, s in sorted(said.items())}
    changed = new["targets"] != met.asked.targets or new["references"] != met.asked.references
    return replace(met, asked=replace(met.asked, **new)) if changed else None


def proposed_wrong(parts: Parts, kind: str, met: Met, of_target: bool) -> Met | None:
    """Without candidates of one name."""
    side, name, scores, named = side_of(met, of_target)
    frame, known = met.frame, met.known
    whole = np.array([frame.width, frame.height] * 2, np.float64)
    boxes = {i: parts.pixels(t, frame) for i, t in known.items()}
    sides = {i: b[2:] - b[:2] for i, b in boxes.items()}

    def covered(i: int) -> bool:
        larger = [boxes[j] for j in known if sides[j].prod() > sides[i].prod()]
        return bool(larger) and bool(iou_2d(boxes[i][None], np.array(larger)).max() > 0.25)

    rules: dict[str, tuple[Callable[[int], bool], str | None]] = {
        "class": (lambda i: i in named, None),
        "synonym": (lambda i: i in named, None),
        "nms": (covered, "overlap"),
        "seam": (lambda i: bool((boxes[i] / whole)[0] < 0.5 < (boxes[i] / whole)[2]), None),
        "far": (lambda i: bool(known[i].center[2] > FAR_M), None),
        "thin": (lambda i: bool(sides[i].max() > 2 * sides[i].min()), None),
        "threshold": (lambda i: scores[i] < parts.sure(0.7), "threshold"),
    }
    drops, why = rules[kind]
    gone = [i for i in scores if drops(i)]
    if not gone:
        return None
    kept = {i: s for i, s in scores.items() if i not in gone}
    others = sorted({t.name for i, t in known.items() if i not in named}, key=lambda other: share(name, other, kind))
    if kind == "class" and others:
        found = [i for i, t in known.items() if t.name == others[0]]
        kept |= {i: parts.sure(0.45 + 0.55 * share(frame.id, i, name)) for i in found}
    dropped = {name: [(i, scores[i], why) for i in gone if why is not None and i not in kept]}
    fields: dict[str, dict] = {side: dict(sorted(kept.items())), "dropped": dropped}
    return replace(met, asked=replace(cast(Told, met.asked), **fields))


@dataclass
class Bench:
    """One pipeline over frames, with the picture after each; `mets` keeps what was planted, before and after."""

    parts: Parts
    own: OtherPipeline
    frames: Sequence[Scene]

    def __post_init__(self) -> None:
        self.mets: dict[tuple[str, str], tuple[Met, Met]] = {}

    def asked(self, rng: np.random.Generator, part: int, every: int) -> Iterator[tuple[Met, Frame]]:
        """Each so manieth expression of each frame as the pipeline meets it, and the next picture."""
        assert self.own.asked is not None
        for k, (truth, frame, viewer, known) in enumerate(self.frames):
            for case in truth.cases[part % every :: every] if known else ():
                if case.target != case.reference:
                    met = Met(self.own.asked(case, truth, known, rng), truth, known, viewer, frame)
                    yield met, self.frames[(k + 1) % len(self.frames)][1]

    def lines(self, seed: int, every: int, fault: str | None) -> Iterator[Line]:
        """Some lines broken by any fault; or every line by the one that is given."""
        rng, own, parts = np.random.default_rng(seed), self.own, self.parts
        assert own.told is not None
        for met, after in self.asked(rng, seed, every):
            tried: list[str] = [] if fault is None else [fault]
            if fault is None and rng.random() < SHARE:
                module = str(rng.choice(FAULTS, p=OFTEN))
                tried = [f"{module} {kind}" for kind in rng.permutation(KINDS[module])]
            found = ((one, *planted(parts, own, one, met, rng, fault is not None, after)) for one in tried)
            one, broken, counts = next((f for f in found if f[2] or fault is not None), (None, None, False))
            if counts and broken is not None:
                key = met.frame.id, met.asked.case.text
                self.mets[key] = parts.ranked(own, met), parts.ranked(own, broken)
            yield Line(own.told(own, broken or met), one if counts else None)


def pipeline_of(name: str, data: Dataset, every: int, frames: Sequence[Scene]) -> Bench:
    """One of them over the frames; what its network learns from is another draw than any that is measured."""
    parts = parts_of(name)
    own = seventh(parts, data)
    if name == "learnt":
        known = []
        for met, _ in Bench(parts, own, frames).asked(np.random.default_rng(10**6), 1, every):
            p = judged(own, met)
            known.append((parts.factors(met, p), np.array([pair in true_pairs(met) for pair in p], np.float64)))
        parts = replace(parts, ranks=trained(known).ranks)
        own = seventh(parts, data)
    return Bench(parts, own, frames)


def measured(root: Path, labels: Path, given: argparse.Namespace, every: int, apart: int) -> None:
    opened, data = label(root, labels), open_pipeline(root, srm="rule").dataset
    mixed = [(seed, every, None) for seed in range(given.first, given.first + given.seeds)]
    alone = [
        (given.first + k, max(1, round(apart / DENSER.get(m, 1.0))), f"{m} {kind}")
        for m in FAULTS
        for k, kind in enumerate(KINDS[m])
    ]
    for name in given.only or NAMES:
        frames = list(scenes(seventh(parts_of(name), data), data, opened))
        made = pipeline_of(name, data, every, frames)
        for words, files in (("mixed", mixed), ("whole files", alone)):
            rows: list[Row] = []
            broken = lines = 0
            for file in files:
                bench = Bench(made.parts, made.own, frames)
                found, of = numbered(bench.own, root, opened, list(bench.lines(*file)))
                rows += found
                broken, lines = broken + len(bench.mets), lines + len(of)
                if given.misses is not None:
                    where = (root.name, name, words, file[0])
                    write_misses(given.misses, where, bench.own, bench.mets, found, of)
            told_rows(f"{name}, {root.name}, {words} ({broken} of {lines} lines)", rows, KINDS)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--also", type=Path)
    parser.add_argument("--seeds", type=int, default=4, help="files of which some lines are broken")
    parser.add_argument("--first", type=int, default=0, help="the first seed of what is planted, and of rooms")
    parser.add_argument("--every", type=int, default=6)
    parser.add_argument("--apart", type=int, default=40)
    parser.add_argument("--only", choices=NAMES, action="append")
    parser.add_argument("--misses", type=Path, help="JSON lines of what was not named are appended to it")
    given = parser.parse_args()
    assert set(KINDS) == set(FAULTS)
    with TemporaryDirectory() as folder:
        rooms = Path(folder, "rooms")
        render_dataset(rooms, rooms=8, views=3, seed=16180 + given.first, width=480, height=360)
        measured(rooms, Path(folder, "labels"), given, given.every, given.apart)
        if given.also is not None:
            measured(given.also, Path(folder, "also"), given, 1, 4)


if __name__ == "__main__":
    main()
