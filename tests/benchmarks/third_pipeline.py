"""A third pipeline that is not ours (`third_parts`), unlike the first two in its parts and faults; held out.

OPM-TARGET, OPM-REF  right targets, or references, are not seen; something else is seen for them; they are suppressed by
          an overlapping one; fall below the least score; or the box is round a part of them
LIFT      boxes of right targets, of the references that they are right by, or of both: run into the background, stand
          at another depth, are mirrored, joined with a neighbour's, stale, or exchanged with another candidate's
SRM       right pairs inverted; all pairs of the line near .5, of another relation, or turned round; a wrong one claimed
OPM-CONF  right targets or references score low, things of another class high, both, or the two exchange their scores
PRM       scores of a right and a wrong pair exchanged; right ones inverted, or below all; a wrong one above all; the
          relation left out

What follows in the pipeline follows from the fault; it counts where the pipeline answers right without it and wrong
with it. Rates are told by module and by kind.

    python -m benchmarks.third_pipeline --also FOLDER        (from tests/; FOLDER: another dataset with annotations)
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import cast

import numpy as np

from pipeline.answering.opening import open_pipeline
from pipeline.answering.predictions import Header
from pipeline.datasets.base import Dataset
from pipeline.datasets.synthetic import render_dataset
from pipeline.labels.job import label

from .other_pipeline import AXES, FAULTS, PLANTED_SHARE, Met, OtherPipeline, Row, Thing, lines, right, verdicts
from .third_parts import (
    TWIN,
    Mapped,
    Seen,
    asked,
    object_map,
    pair_score,
    part_of,
    probability,
    right_pair_proposed,
    told,
    written,
)

KINDS = {
    "OPM-TARGET": ("unseen", "mistaken", "suppressed", "threshold", "part"),
    "OPM-REF": ("unseen", "mistaken", "suppressed", "threshold", "part"),
    "LIFT": ("leaked", "depth", "mirrored", "joined", "stale", "exchanged"),
    "SRM": ("inverted", "squashed", "another", "turned", "claimed"),
    "OPM-CONF": ("low", "high", "both", "exchanged"),
    "PRM": ("exchanged", "inverted", "raised", "lowered", "deaf"),
}
"""A fault is "MODULE kind"."""


TRIES = 6
"""How often a fault is drawn anew that changes nothing: another direction, strength, role or pair."""


def planted(own: OtherPipeline, fault: str, met: Met, rng: np.random.Generator) -> Met | None:
    drawn = (planted_once(own, fault, met, rng) for _ in range(TRIES))
    broken = next((d for d in drawn if d is not None and not right(own, told(own, d), met)), None)
    # Where the detector missed the right pair already, a second module would be wrong.
    return broken if right_pair_proposed(met) else None


def planted_once(own: OtherPipeline, fault: str, met: Met, rng: np.random.Generator) -> Met | None:
    module, kind = fault.split()
    truth, case = met.truth, met.asked.case
    numbers = (truth.numbers[case.acceptable], truth.numbers[truth.acceptable_pairs(case).any(axis=0)])
    # Twins are as right as what they are twins of.
    good, ends = (
        [i for i in scores if i % TWIN in set(n.tolist())]
        for scores, n in zip((met.asked.targets, met.asked.references), numbers, strict=True)
    )
    if module == "LIFT":
        ids = [good, ends, [*good, *ends]][rng.choice(3, p=[0.45, 0.45, 0.1])]
        new = lifted_wrong(kind, list(dict.fromkeys(ids)), met, rng)
        return put(met, new, rng) if new else None
    if module in ("SRM", "PRM"):
        return judged_wrong(own, module, kind, met, good, rng)
    of_target = module == "OPM-TARGET" or (module == "OPM-CONF" and rng.random() < 0.5)
    return proposed_wrong(module, kind, met, of_target, good if of_target else ends, rng)


def put(met: Met, new: Mapping[int, Thing], rng: np.random.Generator) -> Met:
    """With other things in the place of these, under new ids: an id is one object in all lines of a frame."""
    ids = {i: 10_000 + 100 * int(rng.integers(10**9)) + k for k, i in enumerate(new)}
    targets, references = (
        {ids.get(i, i): s for i, s in scores.items()} for scores in (met.asked.targets, met.asked.references)
    )
    known = {**met.known, **{ids[i]: replace(t, id=ids[i]) for i, t in new.items()}}
    return replace(met, asked=replace(met.asked, targets=targets, references=references), known=known)


def lifted_wrong(kind: str, ids: Sequence[int], met: Met, rng: np.random.Generator) -> dict[int, Mapped]:
    """The things of these ids with wrong 3D boxes; none where there is nothing to be wrong by."""
    known = cast("dict[int, Mapped]", met.known)
    factor = float(rng.choice([rng.uniform(0.35, 0.65), rng.uniform(1.6, 2.4)]))
    angle = rng.uniform(0, 2 * np.pi)
    away = (np.cos(angle) * met.viewer.right + np.sin(angle) * met.viewer.forward) * rng.uniform(0.5, 1.8)
    rivals = [i for i in {**met.asked.targets, **met.asked.references} if i not in ids]
    new: dict[int, Mapped] = {}
    for i in ids:
        t = known[i]
        alone = [o for o in known if o < TWIN and o != i % TWIN]
        near = sorted(alone, key=lambda o: float(np.linalg.norm(known[o].center - t.center)))[:3]
        if kind == "depth":
            new[i] = replace(t, center=t.center * factor, size=t.size * factor)
        elif kind == "mirrored":
            new[i] = replace(t, center=t.center * [-1, 1, 1])
        elif kind == "stale":
            new[i] = replace(t, center=t.center + away)
        elif kind == "joined" and near:
            new[i] = t.joined(known[near[int(rng.integers(len(near)))]])
        elif kind == "exchanged" and rivals:
            other = known[rivals[int(rng.integers(len(rivals)))]]
            new[i] = replace(t, center=other.center, size=other.size)
            new[other.id] = replace(other, center=t.center, size=t.size)
        elif kind == "leaked":
            x, y, w, h = np.array(t.box) * np.tile([met.frame.width, met.frame.height], 2)
            rows, columns = (slice(int(max(0, m - 0.7 * s)), int(m + 0.7 * s) + 1) for m, s in ((y, h), (x, w)))
            behind = met.frame.depth[rows, columns]
            behind = behind[behind > t.center[2] + 0.2]
            if len(behind) >= 20:
                new[i] = t.joined(replace(t, center=t.center * float(np.percentile(behind, 80)) / t.center[2]))
    return new


def judged_wrong(
    own: OtherPipeline, module: str, kind: str, met: Met, good: list[int], rng: np.random.Generator
) -> Met | None:
    """With other probabilities, or other scores, of pairs."""
    seen, known, relation = met.asked, met.known, met.asked.case.relation
    every = [(a, b) for a in seen.targets for b in seen.references if a != b]
    of = {(a, b): own.probability(relation, known[a], known[b], met.viewer) for a, b in every}
    true, wrong = [p for p in every if p[0] in good], [p for p in every if p[0] not in good]
    if not true or not wrong:
        return None
    one = wrong[int(rng.integers(len(wrong)))]
    if module == "SRM":
        another = str(rng.choice([r for r in AXES if r != relation]))
        said = {
            "inverted": {p: 1 - of[p] for p in true},
            "squashed": {p: float(0.5 + 0.04 * rng.uniform(-1, 1)) for p in every},
            "another": {(a, b): own.probability(another, known[a], known[b], met.viewer) for a, b in every},
            "turned": {(a, b): own.probability(relation, known[b], known[a], met.viewer) for a, b in every},
            "claimed": {one: float(rng.uniform(0.95, 0.99))} if of[one] < 0.4 else {},
        }[kind]
        return replace(met, asked=replace(seen, relations=said)) if said else None
    scores = {(a, b): own.pair_score(seen.targets[a], seen.references[b], of[a, b]) for a, b in every}
    best = max(true, key=scores.__getitem__)
    scored = {
        "exchanged": {best: scores[one], one: scores[best]},
        "inverted": {p: 1 - scores[p] for p in true},
        "raised": {one: max(scores.values()) + float(rng.uniform(0.01, 0.3))},
        "lowered": {p: min(scores.values()) - float(rng.uniform(0.01, 0.3)) for p in true},
        "deaf": {(a, b): own.pair_score(seen.targets[a], seen.references[b], 0.5) for a, b in every},
    }[kind]
    return replace(met, asked=replace(seen, scores=scored))


def proposed_wrong(
    module: str, kind: str, met: Met, of_target: bool, ids: list[int], rng: np.random.Generator
) -> Met | None:
    """With other proposals, or other scores, of the target's name or of the reference's."""
    seen, known, case = cast(Seen, met.asked), cast("dict[int, Mapped]", met.known), met.asked.case
    side, name = ("targets", case.target) if of_target else ("references", case.reference)
    scores = seen.targets if of_target else seen.references
    alike = met.truth.alike[case.target_object if of_target else case.reference_object]
    named = set(met.truth.numbers[alike].tolist())
    unasked = [i for i in known if i % TWIN not in named and i not in {**seen.targets, **seen.references}]
    others = [int(i) for i in rng.permutation(unasked)]
    if not ids:
        return None
    if module == "OPM-CONF":
        low = {i: float(rng.uniform(0.10, 0.16)) for i in ids}
        high = {i: float(rng.uniform(0.33, 0.38)) for i in others[: 1 + int(rng.integers(3))]}
        mistaken = [i for i in scores if i % TWIN not in named]
        new = {"low": low, "high": high, "both": low | high}.get(kind, {})
        if kind == "exchanged" and mistaken:
            one = mistaken[int(rng.integers(len(mistaken)))]
            new = dict.fromkeys(ids, scores[one]) | {one: max(scores[i] for i in ids)}
        return replace(met, asked=replace(seen, **{side: scores | new})) if new else None
    if kind == "part":
        parts = [part_of(known[i], met.frame, rng) for i in ids]
        return put(met, {t.id: t for t in parts if t is not None}, rng)
    kept = {i: s for i, s in scores.items() if i not in ids}
    if kind == "mistaken" and others:
        kept[others[0]] = float(rng.uniform(0.26, 0.32))
    gone = {"suppressed": [(i, scores[i], "overlap") for i in ids],
            "threshold": [(i, float(rng.uniform(0.08, 0.14)), "threshold") for i in ids]}.get(kind, [])  # fmt: skip
    return replace(met, asked=replace(seen, **{side: kept}, dropped={name: gone}))


def told_rows(words: str, rows: Sequence[Row], kinds_of: Mapping[str, Sequence[str]] = KINDS) -> None:
    """Print n and rate by module and by kind, and what was named for what is not."""
    faults = [(*fault.split(), f"{v} {d}" if v in ("UNEXPLAINED", "COMPOUND") else v) for fault, v, d in rows if fault]
    hits = sum(module == verdict for module, _, verdict in faults)
    print(f"{words}: named {hits} of {len(faults)}, {hits / max(1, len(faults)):.1%}")
    for module in FAULTS:
        own = [(kind, verdict) for m, kind, verdict in faults if m == module]
        by = {k: [verdict == module for kind, verdict in own if kind == k] for k in kinds_of[module]}
        kinds = ", ".join(f"{k} {sum(v)}/{len(v)}" for k, v in by.items())
        wrong = Counter(verdict for _, verdict in own if verdict != module)
        hit, n = len(own) - wrong.total(), len(own)
        print(f"  {module:10} {hit}/{n} {hit / max(1, n):.1%} ({kinds}); else {dict(wrong.most_common())}")
    print(f"  clean      {dict(Counter(v for fault, v, _ in rows if fault is None).most_common())}", flush=True)


def map_pipeline(dataset: Dataset) -> OtherPipeline:
    posed, found = object_map(dataset)
    frame = "world" if posed else "camera_opengl"
    header = Header(1, "map of objects", "cxcywh", "shares", frame, "cm", "pair_scores")
    return OtherPipeline(header, lambda f: found[f.id], probability, pair_score, written, planted, asked, told)


def main(root: Path, labels: Path, seeds: int, every: int, apart: int) -> None:
    opened, data = label(root, labels), open_pipeline(root, srm="rule").dataset
    own = map_pipeline(data)
    kinds = {m: [f"{m} {k}" for k in KINDS[m]] for m in FAULTS}
    # Each module as often as any other.
    even = [fault for m in FAULTS for fault in kinds[m] for _ in range(60 // len(kinds[m]))]
    mixed = [(seed, every, PLANTED_SHARE, even) for seed in range(seeds)]
    for words, files in (("mixed", mixed), ("one module", [(seeds, apart, 1.0, kinds[m]) for m in FAULTS])):
        rows = [row for f in files for row in verdicts(own, root, opened, list(lines(own, data, opened, *f)))]
        told_rows(f"{own.header.system}, {root.name}, {words}", rows)


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--also", type=Path)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--every", type=int, default=4)
    parser.add_argument("--apart", type=int, default=10)
    given = parser.parse_args()
    with TemporaryDirectory() as folder:
        rooms = Path(folder, "rooms")
        render_dataset(rooms, rooms=8, views=3, seed=1913, width=480, height=360)
        main(rooms, Path(folder, "labels"), given.seeds, given.every, given.apart)
        if given.also is not None:
            main(given.also, Path(folder, "also"), given.seeds, 2, 2)
