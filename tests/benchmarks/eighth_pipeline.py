"""Two more pipelines that are not ours (`eighth_parts`), with faults that stand in code: each is a rule; held out.

OPM-TARGET, OPM-REF  a name gets the other name's boxes, or none; things inside larger ones are suppressed, small and
          thin ones dropped; of targets only the two largest go on
LIFT      boxes of all candidates: depth wrapped round beyond a range; masks that run over; another picture's pose;
          joined with what they stand on; points of the thing beside; depths scaled by what a class usually measures;
          depth read at another stride
SRM       arguments swapped; sides of a room instead of the viewer's; the matrix laid out by columns; a margin in
          another unit; yes for no
OPM-CONF  sure of a thing whatever its name; a class turned round; a class that is sure of any name; larger ones surer;
          all turned round; one place along
PRM       a factor ignored; any factor for all; the second; an index taken apart by the wrong width; the first
          that will do; the least; a winner by the place of another line's

Two ways: some lines of a file broken, each by some kind; and a file for each kind, in which the rule is applied to
every line, also where the answer stays as it was. A fault counts where the pipeline answers right without it, by a
right reference and no rounding, and wrong with it, where the module is wrong in truth and no other is wrong in what
decides (`pure`).

    python -m benchmarks.eighth_pipeline --also FOLDER        (from tests/; FOLDER: another dataset with annotations)
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import cast

import cv2
import numpy as np

from pipeline.answering.opening import open_pipeline
from pipeline.datasets.base import Dataset
from pipeline.datasets.synthetic import render_dataset
from pipeline.geometry.camera import backproject
from pipeline.geometry.frame import Frame
from pipeline.labels.job import label

from .eighth_parts import NAMES, dual_softmax, eighth, parts_of, trained_heads
from .fifth_parts import judged
from .fifth_pipeline import side_of
from .fourth_parts import Oriented, alone, edges, false_pairs, points_of, right_pair, true_pairs
from .fourth_pipeline import numbered, write_misses
from .other_pipeline import AXES, FAULTS, Line, Met, OtherPipeline, Pair, Row, Thing, right
from .planted_parts import share
from .seventh_parts import Parts
from .seventh_pipeline import Bench
from .sixth_parts import Made, Told
from .sixth_pipeline import HALF, Scene, scenes, truly
from .sixth_pipeline import wrong_points as by_sixth
from .third_pipeline import put, told_rows

KINDS = {
    "OPM-TARGET": ("phrase", "vocabulary", "largest", "inside", "thin"),
    "OPM-REF": ("phrase", "vocabulary", "inside", "thin"),
    "LIFT": ("wrapped", "bleeding", "pose", "support", "switched", "scale", "stride"),
    "SRM": ("swapped", "room", "columns", "margin", "no"),
    "OPM-CONF": ("objectness", "turned", "oversure", "larger", "negated", "along"),
    "PRM": ("ignores", "any", "second", "width", "first", "least", "stale"),
}
"""A fault is "MODULE kind"."""
SHARE = 0.5
"""Of the lines in which a fault is tried; many of them keep their answer, so that some fifth is broken."""
OFTEN = np.array([1, 1.5, 6, 3, 2, 2]) / 15.5
"""How often each of FAULTS is tried; boxes seldom change an answer."""
RARE = {"largest", "inside", "thin", "bleeding", "support", "stride", "larger", "any"}
"""Kinds that seldom change an answer: tried before others of their module where some lines are broken."""
DENSER = {
    **dict.fromkeys((f"{m} {k}" for m in ("OPM-TARGET", "OPM-REF") for k in ("inside", "thin")), 2.5),
    **dict.fromkeys((f"LIFT {k}" for k in KINDS["LIFT"]), 2.0),
    **dict.fromkeys((f"LIFT {k}" for k in ("bleeding", "support", "stride")), 4.5),
    "OPM-TARGET vocabulary": 0.4, "OPM-REF vocabulary": 0.4, "OPM-REF phrase": 2.0,
    "SRM swapped": 0.7, "SRM margin": 1.5, "OPM-CONF larger": 2.5,
}  # fmt: skip
"""How many times as many expressions a whole file has of a kind than one of the others."""


def planted(
    parts: Parts, own: OtherPipeline, fault: str, met: Met, rng: np.random.Generator, whole: bool, after: Frame
) -> tuple[Met | None, bool]:
    """The expression with the fault, None where the rule changes nothing; and whether it counts."""
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
    return broken, broken is not None and pure(parts, own, module, met, broken)


def pure(parts: Parts, own: OtherPipeline, module: str, met: Met, broken: Met) -> bool:
    """Whether the answer was right, by more than rounding, and is wrong by the module alone."""
    assert own.told is not None
    before, after = parts.ranked(own, met), parts.ranked(own, broken)
    if not right_pair(own.told(own, met), met) or right(own, own.told(own, broken), met):
        return False
    scores, true = before.asked.scores, true_pairs(met)
    best = max(scores[pair] for pair in scores if pair in true)
    others = [score for pair, score in scores.items() if pair not in true]
    if others and best - max(others) < 0.01 * (best - min(others)):
        return False
    # The same thing has another id where its box was planted.
    place = {t.box: t.id for t in after.known.values()}
    now = {i: place[t.box] for i, t in met.known.items()}
    answer = own.told(own, after).answer
    given = None if answer is None else cast(Pair, (answer.object, answer.reference))
    was = {j: i for i, j in now.items()}
    used = {i for pair in scores if pair in true for i in pair} | {was.get(j, -1) for j in given or ()}
    if any(box_off(met, i) for i in used & met.known.keys()):
        return False
    p = judged(own, after)
    factors = dict(zip(p, parts.factors(after, p)[:, :3], strict=True))
    there = [(now[a], now[b]) for a, b in true if a in now and b in now and (now[a], now[b]) in factors]
    if module != "PRM" and given is not None and any((factors[pair] >= factors[given]).all() for pair in there):
        return False
    if module == "LIFT":
        rise = {(i, j): p[now[i], now[j]] - q for (i, j), q in edges(own, met, met.asked.case.relation).items()}
        lowered = [d for pair, d in rise.items() if pair in true]
        false = cast(Pair, tuple(was[j] for j in given or ()))
        raised = false in false_pairs(met) and rise[false] >= 0.05
        if not raised and max(lowered) > -0.05:
            return False
    return truly(cast(Made, parts), own, module, met, broken) and alone(own, module, met, after)


def box_off(met: Met, i: int) -> bool:
    """Whether the box of a thing is off by 5 cm and by a third of its extent."""
    place = np.flatnonzero(met.truth.numbers == i)
    if not len(place):
        return False
    center, size = (met.truth.geometry[n][place[0]] for n in ("center", "size"))
    away = float(np.linalg.norm(met.known[i].center - center))
    return away > 0.05 and away > float(np.max(size)) / 3


def lifted_wrong(parts: Parts, kind: str, met: Met, after: Frame) -> dict[int, Oriented]:
    """All candidates as they are lifted with the fault; `after` is the next picture of the dataset."""
    new: dict[int, Oriented] = {}
    for i in {**met.asked.targets, **met.asked.references}:
        points = wrong_points(parts, kind, met, met.known[i], after)
        moved = parts.lifted(met.known[i], points[np.isfinite(points).all(axis=1)], met.viewer)
        if moved is not None:
            new[i] = moved
    return new


def wrong_points(parts: Parts, kind: str, met: Met, t: Thing, after: Frame) -> np.ndarray:
    """(N, 3): the depth points that a thing is lifted from with the fault."""
    frame, camera = met.frame, met.frame.camera
    if kind == "support":
        return by_sixth(cast(Made, parts), kind, frame, t)
    points = points_of(frame, t.id)
    z = points[:, 2:]
    if kind == "wrapped":
        far = float(np.quantile(frame.depth[frame.depth > 0], 0.5))
        return points * ((z % far) / z)[:, :1]
    if kind == "pose":
        own, other = camera.T_world_camera, after.camera.T_world_camera
        if own is None or other is None:
            return points
        moved = np.linalg.inv(own) @ other
        return points @ moved[:3, :3].T + moved[:3, 3]
    if kind == "scale":
        return points * (0.6, 0.8, 1.3, 1.7)[int(4 * share(t.name, kind))]
    if kind == "switched":
        x = parts.pixels(t, frame)
        others = [o for o in met.known.values() if o.id != t.id]
        if not others or share(frame.id, t.id, kind) < 0.4:
            return points
        near = min(others, key=lambda o: float(np.abs(parts.pixels(o, frame) - x).sum()))
        return points_of(frame, near.id)
    mask = next(a.mask for a in frame.annotations if a.index == t.id)
    assert mask is not None
    if kind == "bleeding":
        wide = max(3, round(0.05 * frame.width))
        mask = cv2.dilate(mask.astype(np.uint8), np.ones((2 * wide + 1,) * 2, np.uint8)).astype(bool)
        v, u = np.nonzero(mask & (frame.depth > 0))
        return backproject(frame.depth, camera, v, u).astype(np.float64)
    v, u = np.nonzero(mask)
    depth = np.zeros_like(frame.depth)
    depth[v, u] = frame.depth[v // 2, u // 2]
    v, u = np.nonzero(depth > 0)
    return backproject(depth, camera, v, u).astype(np.float64)


def judged_wrong(parts: Parts, own: OtherPipeline, kind: str, met: Met, whole: bool) -> Met | None:
    """With wrong probabilities of all pairs; some kinds in a whole file for half of the relations."""
    relation, known, viewer = met.asked.case.relation, met.known, met.viewer
    if kind == "room" and AXES[relation][0] == 1:
        return None
    if whole and kind == "no" and relation not in HALF:
        return None
    right_ones = edges(own, met, relation)
    if kind == "room":
        for _ in range(1 + int(3 * share(met.truth.scene, kind))):
            viewer = replace(viewer, right=viewer.forward, forward=-viewer.right)

    def p(a: int, b: int) -> float:
        one, other = known[a], known[b]
        if kind == "swapped":
            return parts.probability(relation, other, one, viewer)
        if kind == "margin":
            return parts.judge(relation, one, other, viewer, 1.0, 1.0)
        if kind == "no":
            return 1 - right_ones[a, b]
        return parts.probability(relation, one, other, viewer)

    if kind == "columns":
        by_columns = sorted(right_ones, key=lambda pair: list(met.asked.references).index(pair[1]))
        said = dict(zip(by_columns, right_ones.values(), strict=True))
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
    if kind in ("ignores", "any"):
        if kind == "any":
            wrong = 1 - np.prod(1 - factors[:, :3], axis=1)
        elif parts.masked and (whole or rng.random() < 0.5):
            # Over the references of each target alone, so that how sure the target is falls out.
            wrong = dual_softmax(factors, pairs, (0,))
        else:
            factors[:, 2 if whole else int(rng.integers(3))] = 0.5
            wrong = parts.ranks(factors, pairs)
        return replace(met, asked=replace(met.asked, scores=dict(zip(pairs, wrong.tolist(), strict=True))))
    order = np.argsort(-scores, kind="stable")
    columns, rows = list(met.asked.references), list(met.asked.targets)
    # Flat numbers are of all candidates by all, and are taken apart by how many targets there are.
    place = rows.index(pairs[order[0]][0]) * len(columns) + columns.index(pairs[order[0]][1])
    apart = rows[place // len(rows) % len(rows)], columns[place % len(rows) % len(columns)]
    k = {
        "second": int(order[1]),
        "least": int(order[-1]),
        "stale": int(len(p) * share(met.frame.id, met.asked.case.text, kind)),
        "first": next((k for k, q in enumerate(p.values()) if q > 0.5), 0),
        "width": pairs.index(apart) if apart in p else int(order[0]),
    }[kind]
    return replace(met, asked=replace(cast(Told, met.asked), answer=pairs[k]))


def scored_wrong(parts: Parts, kind: str, met: Met) -> Met | None:
    """With wrong scores of the candidates of both names."""
    new: dict[str, dict[int, float]] = {}
    low, high = parts.sure(0.0), parts.sure(1.0)
    boxes = {i: parts.pixels(t, met.frame) for i, t in met.known.items()}
    side_length = {i: float(np.sqrt(np.prod(b[2:] - b[:2]))) for i, b in boxes.items()}
    for of_target in (True, False):
        side, name, scores, named = side_of(met, of_target)
        if kind == "objectness":
            said = {i: parts.sure(share(met.frame.id, i, kind)) for i in scores}
        elif kind == "turned":
            said = {i: low + high - s if share(met.known[i].name, kind) < 0.4 else s for i, s in scores.items()}
        elif kind == "oversure":
            sure = [i for i, t in met.known.items() if i not in named and share(t.name, kind) < 0.35]
            said = scores | {i: parts.sure(0.9 + 0.15 * share(met.frame.id, i, name)) for i in sure}
        elif kind == "larger":
            most = max((side_length[i] for i in scores), default=1.0)
            said = {i: s * (side_length[i] / most) ** 2.5 for i, s in scores.items()}
        elif kind == "negated":
            said = {i: low + high - s for i, s in scores.items()}
        else:
            said = dict(zip(scores, np.roll(list(scores.values()), 1).tolist(), strict=True))
        new[side] = {i: round(min(max(s, 0.0005), 0.9995), 4) for i, s in sorted(said.items())}
    changed = new["targets"] != met.asked.targets or new["references"] != met.asked.references
    return replace(met, asked=replace(met.asked, **new)) if changed else None


def proposed_wrong(parts: Parts, kind: str, met: Met, of_target: bool) -> Met | None:
    """Without candidates of one name."""
    side, name, scores, _ = side_of(met, of_target)
    other = side_of(met, not of_target)[2]
    whole = np.array([met.frame.width, met.frame.height] * 2, np.float64)
    boxes = {i: parts.pixels(t, met.frame) / whole for i, t in met.known.items()}
    sides = {i: b[2:] - b[:2] for i, b in boxes.items()}
    by_area = sorted(scores, key=lambda i: -sides[i].prod())

    def inside(i: int) -> bool:
        a = boxes[i]
        common = [np.minimum(a[2:], b[2:]) - np.maximum(a[:2], b[:2]) for j, b in boxes.items() if j != i
                  and sides[j].prod() > sides[i].prod()]  # fmt: skip
        return any(c.min() > 0 and c.prod() > 0.4 * sides[i].prod() for c in common)

    rules: dict[str, tuple[Callable[[int], bool], str | None]] = {
        "phrase": (lambda i: True, None),
        "vocabulary": (lambda i: True, None),
        "largest": (lambda i: i in by_area[2:], "rank"),
        "inside": (inside, "overlap"),
        "thin": (lambda i: bool(sides[i].min() < 0.1), None),
    }
    drops, why = rules[kind]
    gone = [i for i in scores if drops(i)]
    if not gone:
        return None
    kept = {i: s for i, s in scores.items() if i not in gone} if kind != "phrase" else dict(other)
    dropped = {name: [(i, scores[i], why) for i in gone if why is not None]}
    fields: dict[str, dict] = {side: kept, "dropped": dropped}
    return replace(met, asked=replace(cast(Told, met.asked), **fields))


class Planting(Bench):
    """As its base, with the faults of this file."""

    def lines(self, seed: int, every: int, fault: str | None) -> Iterator[Line]:
        """Some lines broken by any fault; or every line by the one that is given."""
        rng, own, parts = np.random.default_rng(seed), self.own, self.parts
        assert own.told is not None
        for met, after in self.asked(rng, seed, every):
            tried: list[str] = [] if fault is None else [fault]
            if fault is None and rng.random() < SHARE:
                module = str(rng.choice(FAULTS, p=OFTEN))
                kinds = sorted(rng.permutation(KINDS[module]).tolist(), key=lambda kind: kind not in RARE)
                tried = [f"{module} {kind}" for kind in kinds]
            found = ((one, *planted(parts, own, one, met, rng, fault is not None, after)) for one in tried)
            one, broken, counts = next((f for f in found if f[2] or fault is not None), (None, None, False))
            if counts and broken is not None:
                key = met.frame.id, met.asked.case.text
                self.mets[key] = parts.ranked(own, met), parts.ranked(own, broken)
            yield Line(own.told(own, broken or met), one if counts else None)


def made(name: str, data: Dataset, frames: Sequence[Scene]) -> tuple[Parts, OtherPipeline]:
    """One of them, trained on the labels of the frames."""
    parts = parts_of(name)
    if name == "harmonic":
        parts = parts_of(name, trained_heads([(truth, viewer, known) for truth, _, viewer, known in frames]))
    return parts, eighth(parts, data)


def measured(root: Path, labels: Path, given: argparse.Namespace, every: int, apart: int) -> None:
    opened, data = label(root, labels), open_pipeline(root, srm="rule").dataset
    mixed = [(seed, every, None) for seed in range(given.first, given.first + given.seeds)]
    alone = [
        (given.first + k, max(1, round(apart / DENSER.get(f"{m} {kind}", 1.0))), f"{m} {kind}")
        for m in FAULTS
        for k, kind in enumerate(KINDS[m])
    ]
    for name in given.only or NAMES:
        frames = list(scenes(eighth(parts_of(name), data), data, opened))
        parts, own = made(name, data, frames)
        for words, files in (("mixed", mixed), ("whole files", alone)):
            rows: list[Row] = []
            broken = lines = 0
            for file in files:
                bench = Planting(parts, own, frames)
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
    parser.add_argument("--seed", type=int, default=14142, help="of the rooms")
    parser.add_argument("--first", type=int, default=0, help="the first seed of what is planted; added to the rooms'")
    parser.add_argument("--every", type=int, default=6)
    parser.add_argument("--apart", type=int, default=56)
    parser.add_argument("--only", choices=NAMES, action="append")
    parser.add_argument("--misses", type=Path, help="JSON lines of what was not named are appended to it")
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
