"""Two more pipelines that are not ours (`ninth_parts`), with faults that stand in code: each is a rule; held out.

OPM-TARGET, OPM-REF  a name gets another class's boxes, or none; only the first two from the left are listed; what is
          beyond the sensor's range, is small, or (of targets) touches the border, is dropped
LIFT      boxes of all candidates: another unit in half of the picture; a picture that is turned upright, its points
          not; masks in their crop's pixels; masks that run over; disparity taken for depth; masks of the mirrored
          picture; most depths of dark things filled by a constant
SRM       arguments swapped; sides of the reference's own front; a dead head; near for far; a margin in another unit;
          a relation that is far too flat; P kept by the two names alone; the head of the next relation
OPM-CONF  a class that is sure of any name; all turned round; larger ones surer; divided by area; the other name's
          prompt; surer the earlier in the list
PRM       ranked by the P of the relation before; a factor counted the wrong way; the next target in the list; the
          least; a winner by the place of another line's

Two ways: some lines of a file broken, each by some kind; and a file for each kind, in which the rule is applied to
every line, also where the answer stays as it was. A fault counts as for the eighth (`pure`).

    python -m benchmarks.ninth_pipeline --also FOLDER        (from tests/; FOLDER: another dataset with annotations)
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import cast

import numpy as np

from pipeline.answering.opening import open_pipeline
from pipeline.datasets.synthetic import render_dataset
from pipeline.geometry.camera import backproject
from pipeline.geometry.frame import Frame
from pipeline.labels.job import label

from .eighth_pipeline import pure
from .eighth_pipeline import wrong_points as by_eighth
from .fifth_parts import judged
from .fifth_pipeline import side_of
from .fourth_parts import Oriented, edges, points_of
from .fourth_pipeline import numbered, write_misses
from .ninth_parts import NAMES, ninth, parts_of
from .other_pipeline import AXES, FAULTS, Line, Met, OtherPipeline, Row, Thing, right
from .planted_parts import share
from .seventh_parts import Parts
from .seventh_pipeline import TURNED, Bench
from .sixth_parts import Made, Told
from .sixth_pipeline import HALF, scenes
from .sixth_pipeline import wrong_points as by_sixth
from .third_pipeline import put, told_rows

MISSED = ("class", "synonym", "listed", "far", "small")
KINDS = {
    "OPM-TARGET": (*MISSED, "border"),
    "OPM-REF": MISSED,
    "LIFT": ("region", "rotated", "crop", "bleeding", "disparity", "mirrored", "filled"),
    "SRM": ("swapped", "allocentric", "dead", "depth", "margin", "temperature", "names", "index"),
    "OPM-CONF": ("class", "negated", "larger", "area", "prompt", "position"),
    "PRM": ("former", "sign", "next", "least", "stale"),
}  # fmt: skip
"""A fault is "MODULE kind"."""
SHARE = 0.6
"""Of the lines in which a fault is tried; many of them keep their answer, so that some fifth is broken."""
OFTEN = np.array([1, 3, 5, 3.5, 1.5, 1.5]) / 15.5
"""How often each of FAULTS is tried; boxes seldom change an answer."""
RARE = {
    *(f"{m} {k}" for m in ("OPM-TARGET", "OPM-REF") for k in (*MISSED[2:], "border")),
    *(f"LIFT {k}" for k in ("region", "bleeding", "filled", "disparity")),
    *(f"SRM {k}" for k in ("dead", "depth", "margin", "temperature", "names")),
    "OPM-CONF larger", "OPM-CONF position",
}  # fmt: skip
"""Kinds that seldom change an answer: tried before others of their module where some lines are broken."""
DENSER = {
    **dict.fromkeys(("OPM-TARGET class", "OPM-TARGET synonym", "OPM-CONF class", "OPM-CONF negated"), 0.5),
    **dict.fromkeys(("SRM swapped", "SRM index", "PRM next", "PRM least"), 0.5),
    **dict.fromkeys(("LIFT mirrored", "OPM-CONF prompt", "OPM-CONF position", "PRM stale"), 0.7),
    **dict.fromkeys(("OPM-TARGET listed", "OPM-TARGET small", "OPM-CONF larger", "PRM former"), 1.4),
    **dict.fromkeys(("LIFT crop", "LIFT disparity", "LIFT filled", "OPM-TARGET border"), 2.0),
    **dict.fromkeys((f"OPM-REF {k}" for k in MISSED[:4]), 3.0),
    **dict.fromkeys(("LIFT region", "SRM depth", "SRM margin", "SRM temperature"), 3.0),
    **dict.fromkeys(("OPM-REF small", "SRM dead"), 4.0),
    **dict.fromkeys(("LIFT bleeding", "SRM names"), 5.0),
}
"""How many times as many expressions a whole file has of a kind than one of the others."""
NEXT = dict(zip(AXES, [*AXES][1:] + [*AXES][:1], strict=True))
FAR_M = 2.5
FILLED_M = 4.0
Lifts = dict[tuple[str, str, int], Oriented | None]
"""Kind, frame and thing -> the thing as it is lifted with the fault, for one pipeline over one dataset."""


def planted(
    parts: Parts, own: OtherPipeline, fault: str, met: Met, rng: np.random.Generator, whole: bool, after: Frame,
    lifts: Lifts,
) -> tuple[Met | None, bool]:  # fmt: skip
    """The expression with the fault, None where the rule changes nothing; and whether it counts."""
    module, kind = fault.split()
    if module == "LIFT":
        new = lifted_wrong(parts, kind, met, after, lifts)
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
    return broken, broken is not None and pure(parts, own, module, met, broken)


def lifted_wrong(parts: Parts, kind: str, met: Met, after: Frame, lifts: Lifts) -> dict[int, Oriented]:
    """All candidates as they are lifted with the fault."""
    new: dict[int, Oriented] = {}
    for i in {**met.asked.targets, **met.asked.references}:
        key = kind, met.frame.id, i
        if key not in lifts:
            points = wrong_points(parts, kind, met, met.known[i], after)
            lifts[key] = parts.lifted(met.known[i], points[np.isfinite(points).all(axis=1)], met.viewer)
        moved = lifts[key]
        if moved is not None:
            new[i] = moved
    return new


def wrong_points(parts: Parts, kind: str, met: Met, t: Thing, after: Frame) -> np.ndarray:
    """(N, 3): the depth points that a thing is lifted from with the fault."""
    frame, camera = met.frame, met.frame.camera
    if kind == "region":
        return by_sixth(cast(Made, parts), kind, frame, t)
    if kind == "bleeding":
        return by_eighth(parts, kind, met, t, after)
    points = points_of(frame, t.id)
    x, y, z = points.T
    if kind == "rotated":
        # The picture was turned by a quarter for the segmenter; the same way over a whole sequence.
        side = 1 if share(frame.id.split("/")[0], kind) < 0.5 else -1
        return np.stack([-side * y, side * x, z], axis=1)
    if kind == "crop":
        x0, y0 = parts.pixels(t, frame)[:2]
        return points - z[:, None] * np.array([x0 / camera.fx, y0 / camera.fy, 0])
    if kind == "disparity":
        return points * (float(np.median(frame.depth[frame.depth > 0])) / z)[:, None] ** 2
    if kind == "mirrored":
        mask = next(a.mask for a in frame.annotations if a.index == t.id)
        assert mask is not None
        v, u = np.nonzero(mask[:, ::-1] & (frame.depth > 0))
        return backproject(frame.depth, camera, v, u).astype(np.float64)
    # "filled": dark or shining things have no depth in most of them.
    lacks = share(frame.id, t.id, "lacks") < 0.5
    there = (y / z > np.quantile(y / z, 0.25)) & lacks
    return np.where(there[:, None], points * (FILLED_M / z)[:, None], points)


def judged_wrong(parts: Parts, own: OtherPipeline, kind: str, met: Met, whole: bool) -> Met | None:
    """With wrong probabilities of all pairs; some kinds in a whole file for half of the relations."""
    relation, known, viewer = met.asked.case.relation, met.known, met.viewer
    axis = AXES[relation][0]
    if (kind == "allocentric" and axis == 1) or (kind == "depth" and axis != 2):
        return None
    if whole and kind in ("dead", "temperature") and relation not in HALF:
        return None
    right_ones = edges(own, met, relation)
    kept: dict[tuple[str, str], float] = {}

    def p(a: int, b: int) -> float:
        one, other, seen = known[a], known[b], viewer
        if kind == "swapped":
            return parts.probability(relation, other, one, seen)
        if kind == "dead":
            # Its bias, and what its weights leave.
            return 0.4 + 0.02 * share(relation, a, b)
        if kind in ("depth", "index"):
            return parts.probability((TURNED if kind == "depth" else NEXT)[relation], one, other, seen)
        if kind == "margin":
            return parts.judge(relation, one, other, seen, 1.0, 1.0)
        if kind == "temperature":
            return parts.judge(relation, one, other, seen, 0.0, 0.06)
        if kind == "names":
            return kept.setdefault((one.name, other.name), right_ones[a, b])
        for _ in range(1 + int(3 * share(met.truth.scene, other.id, "front"))):
            seen = replace(seen, right=seen.forward, forward=-seen.right)
        return parts.probability(relation, one, other, seen)

    return replace(met, asked=replace(met.asked, relations={pair: p(*pair) for pair in right_ones}))


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
        (a, b), rows = pairs[int(np.argmax(scores))], list(met.asked.targets)
        after = rows[(rows.index(a) + 1) % len(rows)], b
        following = pairs.index(after) if after in p else other
        k = {"next": following, "least": int(np.argmin(scores)), "stale": other}[kind]
        return replace(met, asked=replace(cast(Told, met.asked), answer=pairs[k]))
    if kind == "former":
        # The relation of the line before.
        others = [r for r in AXES if AXES[r][0] != AXES[met.asked.case.relation][0]]
        before = edges(own, met, others[int(len(others) * share(met.frame.id, met.asked.case.text, kind))])
        factors[:, 2] = [before[pair] for pair in pairs]
    else:
        # In a whole file always the same one.
        k = (0 if parts.masked else 1) if whole else int(rng.integers(3))
        factors[:, k] = 1 - factors[:, k]
    wrong = parts.ranks(factors, pairs)
    return replace(met, asked=replace(met.asked, scores=dict(zip(pairs, wrong.tolist(), strict=True))))


def scored_wrong(parts: Parts, kind: str, met: Met) -> Met | None:
    """With wrong scores of the candidates of both names."""
    new: dict[str, dict[int, float]] = {}
    low, high = parts.sure(0.0), parts.sure(1.0)
    boxes = {i: parts.pixels(t, met.frame) for i, t in met.known.items()}
    area = {i: float(np.prod(b[2:] - b[:2])) for i, b in boxes.items()}
    for of_target in (True, False):
        side, name, scores, named = side_of(met, of_target)
        most, least = (f((area[i] for i in scores), default=1.0) for f in (max, min))
        if kind == "class":
            sure = [i for i, t in met.known.items() if i not in named and share(t.name, "sure of any") < 0.35]
            said = scores | {i: parts.sure(0.9 + 0.15 * share(met.frame.id, i, name)) for i in sure}
        elif kind == "negated":
            said = {i: low + high - s for i, s in scores.items()}
        elif kind == "larger":
            said = {i: s * (area[i] / most) ** 0.6 for i, s in scores.items()}
        elif kind == "area":
            said = {i: s * (least / area[i]) ** 0.5 for i, s in scores.items()}
        elif kind == "prompt":
            asked = side_of(met, not of_target)[3]
            said = {i: parts.sure(0.5 * (i in asked) + 0.5 * share(met.frame.id, i, name)) for i in scores}
        else:
            said = {i: s * 0.75**k for k, (i, s) in enumerate(scores.items())}
        new[side] = {i: round(min(max(s, 0.0005), 0.9995), 4) for i, s in sorted(said.items())}
    changed = new["targets"] != met.asked.targets or new["references"] != met.asked.references
    return replace(met, asked=replace(met.asked, **new)) if changed else None


def proposed_wrong(parts: Parts, kind: str, met: Met, of_target: bool) -> Met | None:
    """Without candidates of one name."""
    side, name, scores, named = side_of(met, of_target)
    frame, known = met.frame, met.known
    whole = np.array([frame.width, frame.height] * 2, np.float64)
    boxes = {i: parts.pixels(t, frame) / whole for i, t in known.items()}
    area = {i: float(np.prod(b[2:] - b[:2])) for i, b in boxes.items()}
    from_left = sorted(scores, key=lambda i: float(boxes[i][0]))

    rules: dict[str, tuple[Callable[[int], bool], str | None]] = {
        "class": (lambda i: i in named, None),
        "synonym": (lambda i: i in named, None),
        "listed": (lambda i: i in from_left[2:], None),
        "far": (lambda i: bool(known[i].center[2] > FAR_M), None),
        "border": (lambda i: bool(boxes[i][:2].min() < 0.02 or boxes[i][2:].max() > 0.98), None),
        "small": (lambda i: area[i] < 0.012, None),
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
    dropped = {name: [(i, scores[i], why) for i in gone if why is not None]}
    fields: dict[str, dict] = {side: dict(sorted(kept.items())), "dropped": dropped}
    return replace(met, asked=replace(cast(Told, met.asked), **fields))


class Planting(Bench):
    """As its base, with the faults of this file; `asked_right` counts the lines that are right without them."""

    asked_right = 0
    lifts: Lifts

    def lines(self, seed: int, every: int, fault: str | None) -> Iterator[Line]:
        """Some lines broken by any fault; or every line by the one that is given."""
        rng, own, parts = np.random.default_rng(seed), self.own, self.parts
        assert own.told is not None
        for met, after in self.asked(rng, seed, every):
            self.asked_right += right(own, own.told(own, met), met)
            tried: list[str] = [] if fault is None else [fault]
            if fault is None and rng.random() < SHARE:
                module = str(rng.choice(FAULTS, p=OFTEN))
                kinds = [f"{module} {kind}" for kind in rng.permutation(KINDS[module]).tolist()]
                tried = sorted(kinds, key=lambda one: one not in RARE)
            found = ((one, *planted(parts, own, one, met, rng, fault is not None, after, self.lifts)) for one in tried)
            one, broken, counts = next((f for f in found if f[2] or fault is not None), (None, None, False))
            if counts and broken is not None:
                key = met.frame.id, met.asked.case.text
                self.mets[key] = parts.ranked(own, met), parts.ranked(own, broken)
            yield Line(own.told(own, broken or met), one if counts else None)


def measured(root: Path, labels: Path, given: argparse.Namespace, every: int, apart: int) -> None:
    opened, data = label(root, labels), open_pipeline(root, srm="rule").dataset
    mixed = [(seed, every, None) for seed in range(given.first, given.first + given.seeds)]
    alone = [
        (given.first + k, max(1, round(apart / DENSER.get(f"{m} {kind}", 1.0))), f"{m} {kind}")
        for m in FAULTS
        for k, kind in enumerate(KINDS[m])
    ]
    for name in given.only or NAMES:
        parts = parts_of(name)
        own = ninth(parts, data)
        frames = list(scenes(own, data, opened))
        lifts: Lifts = {}
        for words, files in (("mixed", mixed), ("whole files", alone)):
            rows: list[Row] = []
            counts: Counter[str] = Counter()
            lines = asked_right = 0
            for file in files:
                bench = Planting(parts, own, frames)
                bench.lifts = lifts
                found = list(bench.lines(*file))
                counts += Counter(f.fault for f in found if f.fault is not None)
                lines, asked_right = lines + len(found), asked_right + bench.asked_right
                if given.count:
                    continue
                told, of = numbered(own, root, opened, found)
                rows += told
                if given.misses is not None:
                    where = (root.name, name, words, file[0])
                    write_misses(given.misses, where, own, bench.mets, told, of)
            title = f"{name}, {root.name}, {words} ({counts.total()} of {lines} lines; "
            title += f"right without faults {asked_right / max(1, lines):.1%})"
            if given.count:
                ones = [f"{m} {k}" for m in FAULTS for k in KINDS[m]]
                print(title, *(f"  {one} {counts[one]}" for one in ones), sep="\n", flush=True)
            else:
                told_rows(title, rows, KINDS)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--also", type=Path)
    parser.add_argument("--seeds", type=int, default=3, help="files of which some lines are broken")
    parser.add_argument("--seed", type=int, default=17320, help="of the rooms")
    parser.add_argument("--first", type=int, default=0, help="the first seed of what is planted; added to the rooms'")
    parser.add_argument("--every", type=int, default=6)
    parser.add_argument("--apart", type=int, default=62)
    parser.add_argument("--only", choices=NAMES, action="append")
    parser.add_argument("--misses", type=Path, help="JSON lines of what was not named are appended to it")
    parser.add_argument("--count", action="store_true", help="count what is planted, and judge nothing")
    given = parser.parse_args()
    assert set(KINDS) == set(FAULTS)
    with TemporaryDirectory() as folder:
        rooms = Path(folder, "rooms")
        render_dataset(rooms, rooms=8, views=3, seed=given.seed + given.first, width=480, height=360)
        measured(rooms, Path(folder, "labels"), given, given.every, given.apart)
        if given.also is not None:
            measured(given.also, Path(folder, "also"), given, 1, 6)


if __name__ == "__main__":
    main()
