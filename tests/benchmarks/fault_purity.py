"""Purity of planted faults: the answer was right, is wrong now, and only the planted module is to blame.

A fault that is not pure does not count: where a second module is wrong too, no verdict is the right one.
"""

from __future__ import annotations

from dataclasses import replace
from typing import cast

import numpy as np
from benchmarks.foreign_pipelines import (
    ForeignPipeline,
    Pair,
    Question,
    Thing,
    factors_of,
    given_box,
    is_right,
    judged,
    predicted,
    probabilities,
    ranked,
    right_ids,
    side_of,
)

from pipeline.answering.coordinate_conventions import box_3d
from pipeline.answering.predictions import Prediction
from pipeline.geometry.boxes import iou_2d, iou_3d
from pipeline.relations.relations import F

APART = 0.4
"""A 2D box with less IoU is of no right thing."""
ROUNDING = 0.01
"""Of the range of a question's scores: a right pair that leads by less is right by rounding alone."""


def true_pairs(q: Question) -> set[Pair]:
    """Right targets with the references that they are right by."""
    rows = q.truth.numbers[np.argwhere(q.truth.acceptable_pairs(q.case))]
    return {(int(a), int(b)) for a, b in rows}


def false_pairs(q: Question) -> set[Pair]:
    """Pairs of which the labels say that the relation does not hold, of all things, whatever their class."""
    rows = q.truth.numbers[np.argwhere(q.truth.judged & (q.truth.states[q.case.relation] == F))]
    return {(int(a), int(b)) for a, b in rows}


def answered(line: Prediction) -> Pair | None:
    return None if line.answer is None else cast(Pair, (line.answer.object, line.answer.reference))


def right_pair(own: ForeignPipeline, q: Question) -> bool:
    """Check whether the answer is right by a right reference."""
    return answered(predicted(own, q)) in true_pairs(q)


def turned_wrong(own: ForeignPipeline, q: Question, broken: Question) -> bool:
    """Check whether the answer was right and is wrong now, by whatever reference."""
    return is_right(own, predicted(own, q), q) and not is_right(own, predicted(own, broken), q)


def proposals_wrong(own: ForeignPipeline, of_target: bool, q: Question, broken: Question) -> bool:
    """Check whether no box of a right thing is left among the candidates."""
    given = [own.pixels(broken.known[i], q.frame) for i in side_of(broken, of_target)[2]]
    true = q.truth.boxes[np.isin(q.truth.numbers, right_ids(q)[0 if of_target else 1])]
    return not given or bool(iou_2d(np.array(given), true).max() < APART)


def confidences_wrong(own: ForeignPipeline, q: Question, broken: Question) -> bool:
    """Check whether a right thing's score fell by three tenths, or the answer holds a surer thing of another class."""
    answer = answered(predicted(own, broken))
    if answer is None:
        return False
    for of_target, one, ids in zip((True, False), answer, right_ids(q), strict=True):
        _, _, before, named = side_of(q, of_target)
        after = side_of(broken, of_target)[2]
        was, now = (max(scores[i] for i in ids) for scores in (before, after))
        if before != after and (now < 0.7 * was or (one not in named and after[one] > now)):
            return True
    return False


def relations_wrong(own: ForeignPipeline, q: Question, broken: Question) -> bool:
    """Check whether all right pairs are less likely, or the false pair that is answered is more likely."""
    rise = {pair: broken.relations.get(pair, p) - p for pair, p in probabilities(own, q, q.case.relation).items()}
    given = cast(Pair, answered(predicted(own, broken)))
    lowered = all(d < -0.05 for pair, d in rise.items() if pair in true_pairs(q))
    return lowered or (rise[given] > 0.05 and given in false_pairs(q))


def box_moved(own: ForeignPipeline, before: Thing, after: Thing) -> bool:
    """Check whether the 3D boxes hardly meet."""
    return iou_3d(*(box_3d(given_box(own, t), own.header, None) for t in (before, after))) < 0.5


def all_boxes_moved(own: ForeignPipeline, q: Question, broken: Question) -> bool:
    """Check whether every new thing has a 3D box far from the one that it had."""
    was = {t.box: t for t in q.known.values()}
    return all(box_moved(own, was[t.box], t) for i, t in broken.known.items() if i not in q.known)


def used_box_moved(own: ForeignPipeline, q: Question, broken: Question) -> bool:
    """Check whether a thing of the answer or of a right pair has a 3D box far from the one that it had."""
    now = ids_after(q, broken)
    was = {j: q.known[i] for i, j in now.items()}
    used = {*cast(Pair, answered(predicted(own, broken)))}
    used |= {now[i] for pair in true_pairs(q) for i in pair if i in q.known}
    return any(box_moved(own, was[i], broken.known[i]) for i in used)


def ids_after(q: Question, broken: Question) -> dict[int, int]:
    """Id before -> id after, of all things: one that was planted has a new id, and its 2D box as before."""
    place = {t.box: t.id for t in broken.known.values()}
    return {i: place[t.box] for i, t in q.known.items()}


def off_from_truth(q: Question, i: int, least: float, parts: int) -> bool:
    """Check whether the 3D box of a thing is off by more than `least` metres and one of so many parts of its extent."""
    place = np.flatnonzero(q.truth.numbers == i)
    if not len(place):
        return False
    center, size = (q.truth.geometry[n][place[0]] for n in ("center", "size"))
    away = float(np.linalg.norm(q.known[i].center - center))
    return away > least and away > float(np.max(size)) / parts


def alone(own: ForeignPipeline, module: str, q: Question, broken: Question) -> bool:
    """Check whether no module but this one decides.

    No right pair scores as the answer does. Before the fault no other module put the pair of the answer above the right
    ones, and no box of theirs was far off.
    """
    given = answered(predicted(own, broken))
    if given is None:
        return True
    true, scores = true_pairs(q), ranked(own, broken)
    if any(abs(scores[pair] - scores[given]) < 1e-6 for pair in scores if pair in true):
        return False
    before = {t.box: t.id for t in q.known.values()}
    a, b = (before.get(broken.known[i].box, -1) for i in given)
    for of_target, one, ids in zip((True, False), (a, b), right_ids(q), strict=True):
        _, _, scored, named = side_of(q, of_target)
        surer = ids and scored.get(one, 0.0) > max(scored[i] for i in ids)
        if module != "OPM-CONF" and one not in named and surer:
            return False
    p = probabilities(own, q, q.case.relation)
    most = max((x for pair, x in p.items() if pair in true), default=0.0)
    if module != "SRM" and (a, b) in false_pairs(q) and p.get((a, b), 0.0) > most:
        return False
    used = {a, b, *(i for pair in p if pair in true for i in pair)} - {-1}
    return module == "LIFT" or not any(off_from_truth(q, i, 0.15, 4) for i in used)


def pure(own: ForeignPipeline, module: str, q: Question, broken: Question) -> bool:
    """Check whether the answer was right by a right reference, and the module alone made it wrong."""
    if not turned_from_right_pair(own, q, broken):
        return False
    wrong = all_boxes_moved(own, q, broken) if module == "LIFT" else module_wrong(own, module, q, broken)
    return wrong and alone(own, module, q, broken)


def pure_by_rule(own: ForeignPipeline, module: str, q: Question, broken: Question, least: float) -> bool:
    """Check for purity as `pure` does, of a rule that breaks all candidates of a question, and so may mend some.

    The answer was right by more than rounding, with boxes in their places, and no right pair is now at least as good as
    it in all factors. Wrong boxes moved the relation; with scores as they were (`least` for new candidates), the answer
    would be right.
    """
    if not turned_from_right_pair(own, q, broken) or right_by_rounding(own, q):
        return False
    now = ids_after(q, broken)
    was = {j: i for i, j in now.items()}
    true, given = true_pairs(q), answered(predicted(own, broken))
    used = {i for pair in q.pairs if pair in true for i in pair} | {was.get(j, -1) for j in given or ()}
    if any(off_from_truth(q, i, 0.05, 3) for i in used & q.known.keys()):
        return False
    p = judged(own, broken)
    factors = dict(zip(p, factors_of(broken, p), strict=True))
    there = [(now[a], now[b]) for a, b in true if a in now and b in now and (now[a], now[b]) in factors]
    if module != "PRM" and given is not None and any((factors[pair] >= factors[given]).all() for pair in there):
        return False
    if module == "LIFT":
        wrong = relation_moved(own, q, broken) and used_box_moved(own, q, broken)
    else:
        honest = module != "OPM-CONF" or right_with_scores_of(own, q, broken, least)
        wrong = honest and module_wrong(own, module, q, broken)
    return wrong and alone(own, module, q, broken)


def turned_from_right_pair(own: ForeignPipeline, q: Question, broken: Question) -> bool:
    """Check whether the answer was right by a right reference, and is wrong now."""
    return right_pair(own, q) and not is_right(own, predicted(own, broken), q)


def module_wrong(own: ForeignPipeline, module: str, q: Question, broken: Question) -> bool:
    """Check whether a module other than LIFT is wrong in truth."""
    if module == "OPM-CONF":
        return confidences_wrong(own, q, broken)
    if module.startswith("OPM"):
        return proposals_wrong(own, module == "OPM-TARGET", q, broken)
    return module == "PRM" or relations_wrong(own, q, broken)


def right_by_rounding(own: ForeignPipeline, q: Question) -> bool:
    """Check whether the best right pair leads by less than ROUNDING of the range of the scores."""
    true, scores = true_pairs(q), ranked(own, q)
    best = max(scores[pair] for pair in scores if pair in true)
    others = [score for pair, score in scores.items() if pair not in true]
    return bool(others) and best - max(others) < ROUNDING * (best - min(others))


def relation_moved(own: ForeignPipeline, q: Question, broken: Question) -> bool:
    """Check whether wrong boxes make all right pairs less likely, or the false pair that is answered more likely."""
    p, now = judged(own, broken), ids_after(q, broken)
    was = {j: i for i, j in now.items()}
    rise = {(a, b): p[now[a], now[b]] - x for (a, b), x in probabilities(own, q, q.case.relation).items()}
    given = cast(Pair, tuple(was[j] for j in answered(predicted(own, broken)) or ()))
    true = true_pairs(q)
    raised = given in false_pairs(q) and rise[given] >= 0.05
    return raised or max(d for pair, d in rise.items() if pair in true) <= -0.05


def right_with_scores_of(own: ForeignPipeline, q: Question, broken: Question, least: float) -> bool:
    """Check whether the answer is right with the scores of `q`; else other candidates make it wrong."""
    targets = {i: q.targets.get(i, least) for i in broken.targets}
    references = {i: q.references.get(i, least) for i in broken.references}
    return is_right(own, predicted(own, replace(broken, targets=targets, references=references)), q)
