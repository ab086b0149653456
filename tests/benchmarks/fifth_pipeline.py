"""Three more pipelines that are not ours (`fifth_parts`), whose relations are not of 3D boxes alone; held out.

OPM-TARGET, OPM-REF  a class's threshold drops all of it; duplicates of another thing take the places; a box is round
          far more than the thing; or all boxes of the name are in the pixels of a smaller picture, or lag behind
LIFT      boxes of right targets, or of the references that they are right by, stand on the background or have the depth
          of a place beside them; all boxes have depths in reverse, are not levelled, or are of a mirrored depth picture
SRM       sides from half of the references' own view; what is usual for two classes; P in the order of another axis; or
          what is near
OPM-CONF  one name's candidates have the scores of the other name's prompt, or those of their area, or each other's in
          reverse; right ones are put down as by soft suppression
PRM       targets and references exchanged in the relation; the least first; only the surest target goes on; scores made
          to sum to one along the wrong axis; by place in the list

What follows in the pipeline follows from the fault. It counts where the pipeline answers right without it, by a right
reference, and wrong with it, and where no other module is wrong in what decides. Rates are told by module and by kind.

    python -m benchmarks.fifth_pipeline --also FOLDER        (from tests/; FOLDER: another dataset with annotations)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import cast

import numpy as np

from pipeline.answering.placing import box_3d
from pipeline.geometry.boxes import iou_2d, iou_3d
from pipeline.geometry.frame import Frame

from .fifth_parts import VARIANTS, Found, Variant, factors_of, fifth, judged, points_in, ranked
from .fourth_parts import alone, right_pair, truly_wrong
from .fourth_pipeline import Study, main
from .other_pipeline import FAULTS, Met, OtherPipeline, Pair, Thing, right, right_ids
from .planted_parts import share
from .third_parts import Seen
from .third_pipeline import TRIES, put

KINDS = {
    "OPM-TARGET": ("threshold", "duplicates", "whole", "resized", "lagging"),
    "OPM-REF": ("threshold", "duplicates", "whole", "resized", "lagging"),
    "LIFT": ("background", "unregistered", "reverse", "pitch", "mirrored"),
    "SRM": ("intrinsic", "usual", "transposed", "near"),
    "OPM-CONF": ("prompt", "area", "reverse", "suppressed"),
    "PRM": ("converse", "least", "beam", "axis", "place"),
}
"""A fault is "MODULE kind"."""
APART = 0.4
"""A 2D box with less IoU is of no right thing."""


def planted(variant: Variant, own: OtherPipeline, fault: str, met: Met, rng: np.random.Generator) -> Met | None:
    """With the fault, where the answer was right by a right reference, and the fault makes it wrong."""
    assert own.told is not None
    if not right_pair(own.told(own, met), met):
        return None
    module, kind = fault.split()
    for _ in range(TRIES):
        broken = planted_once(variant, own, module, kind, met, rng)
        if broken is None:
            continue
        broken = broken if module == "PRM" else ranked(variant, own, broken)
        if right(own, own.told(own, broken), met):
            continue
        if truly(variant, own, module, met, broken) and alone(own, module, met, broken):
            return broken
    return None


def planted_once(
    variant: Variant, own: OtherPipeline, module: str, kind: str, met: Met, rng: np.random.Generator
) -> Met | None:
    good, ends = right_ids(met)
    if module == "SRM":
        said = judged_wrong(own, kind, met)
        return None if said is None else replace(met, asked=replace(met.asked, relations=said))
    if module == "PRM":
        said = ranked_wrong(variant, own, kind, met)
        return replace(met, asked=replace(met.asked, scores=said))
    of_target = module == "OPM-TARGET" or (module != "OPM-REF" and rng.random() < 0.5)
    ids = good if of_target else ends
    if not ids:
        return None
    if module == "LIFT":
        return lifted_wrong(variant, own, kind, met, ids, rng)
    change = scored_wrong if module == "OPM-CONF" else proposed_wrong
    return change(variant, kind, met, of_target, ids, rng)


def side_of(met: Met, of_target: bool) -> tuple[str, str, dict[int, float], set[int]]:
    """The field and the name of a role, its scores, and all things of the name."""
    seen, case = met.asked, met.asked.case
    side, name, scores, example = (
        ("targets", case.target, seen.targets, case.target_object)
        if of_target
        else ("references", case.reference, seen.references, case.reference_object)
    )
    return side, name, scores, set(met.truth.numbers[met.truth.alike[example]].tolist())


def truly(variant: Variant, own: OtherPipeline, module: str, met: Met, broken: Met) -> bool:
    """Whether the module is wrong in truth: no box of a right thing is left; a right one's score fell by three
    tenths, or the answer holds something of another class that is surer; else as `truly_wrong`."""
    if not module.startswith("OPM"):
        return truly_wrong(own, module, met, broken)
    assert own.told is not None
    good = dict(zip((True, False), right_ids(met), strict=True))
    if module != "OPM-CONF":
        of_target = module == "OPM-TARGET"
        given = [variant.pixels(broken.known[i], met.frame) for i in side_of(broken, of_target)[2]]
        true = met.truth.boxes[np.isin(met.truth.numbers, good[of_target])]
        return not given or bool(iou_2d(np.array(given), true).max() < APART)
    answer = own.told(own, broken).answer
    if answer is None:
        return False
    for of_target, one in ((True, answer.object), (False, answer.reference)):
        _, _, before, named = side_of(met, of_target)
        after = side_of(broken, of_target)[2]
        was, now = (max(scores[i] for i in good[of_target]) for scores in (before, after))
        if before != after and (now < 0.7 * was or (one not in named and after[cast(int, one)] > now)):
            return True
    return False


def proposed_wrong(
    variant: Variant, kind: str, met: Met, of_target: bool, ids: Sequence[int], rng: np.random.Generator
) -> Met | None:
    """Without the right candidates of one name."""
    side, name, scores, named = side_of(met, of_target)
    frame, known = met.frame, met.known
    gone: list[tuple[int, float, str]] = []
    kept = dict(scores)
    fresh: dict[int, Thing] = {}
    if kind == "threshold":
        gone = [(i, s, "threshold") for i, s in scores.items() if i in named]
        kept = {i: s for i, s in scores.items() if i not in named}
    elif kind == "duplicates":
        # What is cut off by K has less than what takes its place.
        surer = [i for i, s in scores.items() if i not in ids and s > max(scores[j] for j in ids)]
        if not surer:
            return None
        one = surer[int(rng.integers(len(surer)))]
        pixels = variant.pixels(known[one], frame)
        gone = [(i, scores[i], "rank") for i in ids]
        kept = {i: s for i, s in scores.items() if i not in ids}
        for _ in range(1 + int(rng.integers(3))):
            off = rng.uniform(-0.06, 0.06, 4) * np.tile(pixels[2:] - pixels[:2], 2)
            twin = variant.lifted(known[one], frame, np.clip(pixels + off, 0, [frame.width, frame.height] * 2))
            if twin is not None:
                new = 10_000 + 100 * int(rng.integers(10**9))
                fresh[new] = replace(twin, id=new)
                kept[new] = float(rng.uniform(max(scores[j] for j in ids), scores[one]))
    else:
        moving = ids if kind == "whole" else list(scores)
        new_things = {i: t for i in moving if (t := _elsewhere(variant, kind, known[i], met, ids, rng)) is not None}
        if not set(ids) <= set(new_things):
            return None
        # What has no depth there has no box either.
        lost = set(moving) - set(new_things)
        met = replace(met, asked=replace(met.asked, **{side: {i: s for i, s in scores.items() if i not in lost}}))
        return _only(met, put(met, new_things, rng), of_target)
    seen = replace(cast(Seen, met.asked), **{side: kept}, dropped={name: gone})
    return replace(met, asked=seen, known={**known, **fresh})


def _only(met: Met, broken: Met, of_target: bool) -> Met:
    """As broken in one role; things that are asked for by both names keep their boxes in the other."""
    other = "references" if of_target else "targets"
    kept = {other: getattr(met.asked, other)}
    return replace(broken, asked=replace(broken.asked, **kept))


def _elsewhere(
    variant: Variant, kind: str, t: Thing, met: Met, ids: Sequence[int], rng: np.random.Generator
) -> Found | None:
    """A thing as it is found in a wrong 2D box."""
    frame, pixels = met.frame, variant.pixels(t, met.frame)
    whole = np.array([frame.width, frame.height] * 2, np.float64)
    if kind == "whole":
        middle, half = (pixels[:2] + pixels[2:]) / 2, (pixels[2:] - pixels[:2]) / 2 * rng.uniform(1.9, 2.6)
        middle = middle + half * rng.uniform(-0.3, 0.3, 2)
        pixels = np.concatenate([middle - half, middle + half])
    elif kind == "resized":
        # One size for all boxes of the name.
        pixels = pixels * float((0.4, 0.5, 0.625)[int(3 * share(frame.id, met.asked.case.text, "size"))])
    else:
        first = variant.pixels(met.known[ids[0]], frame)
        angle = 2 * np.pi * share(frame.id, met.asked.case.text, "lag")
        pixels = pixels + np.tile(np.array([np.cos(angle), 0.5 * np.sin(angle)]) * (first[2:] - first[:2]), 2)
    pixels = np.clip(pixels, 0, whole)
    return variant.lifted(t, frame, pixels) if (pixels[2:] - pixels[:2]).min() >= 4 else None


def lifted_wrong(
    variant: Variant, own: OtherPipeline, kind: str, met: Met, ids: Sequence[int], rng: np.random.Generator
) -> Met | None:
    """With wrong 3D boxes: of these, or of all candidates, as far as they are off by it."""
    frame, known = met.frame, met.known
    every = list({**met.asked.targets, **met.asked.references})
    depths = np.array([known[i].center[2] for i in every])
    turn = float(rng.choice([-1, 1]) * rng.uniform(0.5, 1.2))
    away = float(rng.choice([-1, 1]) * rng.uniform(0.7, 1.6))
    new: dict[int, Thing] = {}
    for i in ids if kind in ("background", "unregistered") else every:
        t = known[i]
        pixels = variant.pixels(t, frame)
        center, size, z = t.center, t.size, t.center[2]
        if kind == "pitch":
            c, s = np.cos(turn), np.sin(turn)
            center = np.array([[1, 0, 0], [0, c, -s], [0, s, c]]) @ center
        else:
            if kind == "reverse":
                there: float | None = float(depths.min() + depths.max() - z)
            elif kind == "background":
                there = _behind(frame, pixels, z)
            elif kind == "unregistered":
                shift = away * (pixels[2] - pixels[0])
                there = _depth(frame, pixels + np.array([shift, 0, shift, 0]))
            else:
                x0, y0, x1, y1 = pixels
                there = _depth(frame, np.array([frame.width - x1, y0, frame.width - x0, y1]))
            if there is None:
                continue
            center, size = center * there / z, size * there / z
        moved = replace(t, center=center, size=size)
        was, now = (box_3d(own.written(x)[1], own.header, None) for x in (t, moved))
        if iou_3d(was, now) < 0.5:
            new[i] = moved
    if not new or (kind in ("background", "unregistered") and len(new) < len(ids)):
        return None
    return put(met, new, rng)


def _depth(frame: Frame, pixels: np.ndarray) -> float | None:
    points = points_in(frame, np.clip(pixels, 0, [frame.width, frame.height] * 2))
    return float(np.median(points[:, 2])) if len(points) >= 10 else None


def _behind(frame: Frame, pixels: np.ndarray, z: float) -> float | None:
    """The median depth of what lies behind, in and round a box."""
    middle, whole = (pixels[:2] + pixels[2:]) / 2, pixels[2:] - pixels[:2]
    points = points_in(frame, np.clip(np.concatenate([middle - 1.5 * whole, middle + 1.5 * whole]), 0, None))
    far = points[points[:, 2] > z + 0.25, 2]
    return float(np.median(far)) if len(far) >= 20 else None


def judged_wrong(own: OtherPipeline, kind: str, met: Met) -> dict[Pair, float] | None:
    """Wrong probabilities of all pairs."""
    case, known, p = met.asked.case, met.known, judged(own, met)
    low, high = min(p.values(), default=0.0), max(p.values(), default=1.0)
    if kind == "intrinsic":
        facing = {b for _, b in p if share(met.frame.id, b, "faces the viewer") < 0.5}
        return {(a, b): 1 - q if b in facing else q for (a, b), q in p.items()}
    if kind == "usual":
        habit = {(a, b): share(case.relation, known[a].name, known[b].name, "usual") for a, b in p}
        return {pair: low + (high - low) * q for pair, q in habit.items()}
    if kind == "near":
        away = {(a, b): float(np.linalg.norm(known[a].center - known[b].center)) for a, b in p}
        return {pair: low + (high - low) * float(np.exp(-d)) for pair, d in away.items()}
    rows, columns = list(met.asked.targets), list(met.asked.references)
    if min(len(rows), len(columns)) < 2:
        return None
    table = np.array([[p.get((a, b), (low + high) / 2) for b in columns] for a in rows])
    read = table.T.reshape(len(rows), len(columns))
    return {(a, b): float(read[k, j]) for k, a in enumerate(rows) for j, b in enumerate(columns) if a != b}


def ranked_wrong(variant: Variant, own: OtherPipeline, kind: str, met: Met) -> dict[Pair, float]:
    """Wrong scores of all pairs."""
    seen, known, p = met.asked, met.known, judged(own, met)
    scores = {pair: seen.scores[pair] for pair in p}
    if kind == "converse":
        back = {(a, b): own.probability(seen.case.relation, known[b], known[a], met.viewer) for a, b in p}
        return dict(zip(p, variant.ranks(factors_of(met, back)).tolist(), strict=True))
    if kind == "least":
        return {pair: -s for pair, s in scores.items()}
    if kind == "beam":
        first = max(seen.targets, key=seen.targets.__getitem__)
        below = 2 * max(abs(s) for s in scores.values()) + 1
        return {pair: s if pair[0] == first else s - below for pair, s in scores.items()}
    if kind == "axis":
        sums = {a: sum(s for (x, _), s in scores.items() if x == a) for a in seen.targets}
        return {pair: s / max(sums[pair[0]], 1e-6) for pair, s in scores.items()}
    return {pair: float(-k) for k, pair in enumerate(scores)}


def scored_wrong(
    variant: Variant, kind: str, met: Met, of_target: bool, ids: Sequence[int], rng: np.random.Generator
) -> Met | None:
    """With wrong scores of one name's candidates."""
    side, name, scores, _ = side_of(met, of_target)
    _, other, _, others = side_of(met, not of_target)
    if kind == "prompt":
        found = [i for i in met.known if i in others and i not in scores]
        sure = {i: (0.35, 1.0) if i in others else (0.0, 0.3) for i in [*scores, *found]}
        new = {i: variant.score(other, float(rng.uniform(*u))) for i, u in sorted(sure.items())}
    elif kind == "area":
        boxes = {i: variant.pixels(met.known[i], met.frame) for i in scores}
        area = {i: float(np.prod(b[2:] - b[:2])) / (met.frame.width * met.frame.height) for i, b in boxes.items()}
        new = {i: variant.score(name, min(1.0, 2 * a**0.5)) for i, a in area.items()}
    elif kind == "reverse":
        new = dict(zip(scores, list(scores.values())[::-1], strict=True))
    else:
        new = scores | {i: scores[i] * float(rng.uniform(0.3, 0.65)) for i in ids}
    return replace(met, asked=replace(met.asked, **{side: new})) if new != scores else None


if __name__ == "__main__":
    assert set(KINDS) == set(FAULTS)
    main(Study(list(VARIANTS), fifth, planted, KINDS), 31415, 6, 16, (1, 2))
