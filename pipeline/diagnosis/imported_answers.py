"""Verdicts on imported predictions: by the answer alone, by its parts, or by a foreign ranking."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from pipeline.answering.pipeline import file_of, line_of
from pipeline.diagnosis.frame_evidence import FrameEvidence
from pipeline.diagnosis.missed import NEAR_MISS, not_proposed
from pipeline.diagnosis.oracles import CONF, LIFT, ORACLES, RECALL, SRM, SUBSETS, OracleScores, margins_of, names_of
from pipeline.diagnosis.substitution import substitute
from pipeline.diagnosis.verdict import Diagnosis, Missed
from pipeline.geometry.boxes import iou_2d
from pipeline.geometry.frame import Frame
from pipeline.geometry.masks import decode_run_length, mask_box
from pipeline.labels.cases import HIT, Case, FrameCases

if TYPE_CHECKING:
    from pipeline.answering.predictions import Prediction, Predictions

LIKELY = float(np.log(19))
"""Log odds: a ranking is to blame that put a right pair below others where its like would put it first so probably."""

FEWEST_ALIKE, ALIKE = 3, 0.05
"""A relation says nothing whose probabilities of all pairs, so many or more, lie within this."""


def unavailable_oracles(evidence: FrameEvidence, case: Case, gold: bool) -> dict[str, str]:
    """Oracles without a basis in a line of predictions, with the reasons; none for our own answers."""
    pipeline = evidence.answers.source
    line = pipeline.line
    if line is None:
        return {}
    from pipeline.answering.pair_rules import missing_row

    nothing = answers_nothing(line)
    rule = pipeline.config.rank.rule
    why = ""
    if line.relations is None:
        why = "no relation probabilities are given"
    elif not line.ranked and not nothing:
        why = "the answer does not follow from what is given"
    elif not gold and missing_row(line, (case.target, case.relation, case.reference)) is not None:
        why = "no probabilities are given of what was meant"
    elif rule is not None and rule.model is None:
        why = "what the ranking goes by is not given, and does not show"
    if why:
        return dict.fromkeys(ORACLES, why)
    predictions = file_of(pipeline)
    boxed = [predictions.box_of(line.frame, i) is not None for i in line.objects]
    if line.boxes_3d is None if not boxed else not any(boxed):
        return dict.fromkeys(("RECALL", "LIFT"), "no 3D boxes are given")
    return {}


def answers_nothing(line: Prediction) -> bool:
    """True for a line without an answer for lack of any candidate pair: more objects would have given a ranking."""
    from pipeline.answering.pair_rules import has_pairs

    return line.relations is not None and line.answer is None and not has_pairs(line)


def answered_box(line: Prediction, predictions: Predictions, frame: Frame, end: str = "object") -> np.ndarray | None:
    """(4,) float64: 2D box of the answer, or of its "reference", pixels; None for a point or nothing."""
    from pipeline.answering.coordinate_conventions import box_2d

    answer, size = line.answer, (frame.width, frame.height)
    number = None if answer is None else getattr(answer, end)
    if number is not None:
        box = line.objects[number].box
        return None if box is None else box_2d(box, predictions.header, *size)
    if answer is None or end != "object":
        return None
    if answer.mask is not None:
        mask = answer.mask.decoded(
            (frame.height, frame.width), predictions.where(line, "answer.mask"), predictions.path
        )
        return np.array(mask_box(mask), np.float64)
    return None if answer.box is None else box_2d(answer.box, predictions.header, *size)


def answered_overlap(line: Prediction, predictions: Predictions, truth: FrameCases, frame: Frame) -> np.ndarray:
    """(N,) float64: IoU of the answer with each labelled object; of a point 1 for objects containing the pixel."""
    box = answered_box(line, predictions, frame)
    if box is not None:
        return iou_2d(box[None], truth.boxes)[0]
    found = np.zeros(len(truth.labels))
    if line.answer is None or line.answer.point is None:
        return found
    from pipeline.answering.coordinate_conventions import pixel_scale

    u, v = np.array(line.answer.point) * pixel_scale(predictions.header, frame.width, frame.height)
    for k, (x0, y0, x1, y1) in enumerate(truth.boxes):
        code = truth.masks[k]
        if x0 <= u < x1 and y0 <= v < y1 and 0 <= u < frame.width and 0 <= v < frame.height:
            found[k] = 1.0 if code is None else decode_run_length((frame.height, frame.width), code)[int(v), int(u)]
    return found


def judge_without_ranking(evidence: FrameEvidence, case: Case, parse_ok: bool, mark: str | None) -> Diagnosis:
    """Verdict on an answer without a ranking: levels 0 to 2, and lines without an answer."""
    pipeline = evidence.answers.source
    line, predictions = line_of(pipeline), file_of(pipeline)
    truth, frame = evidence.truth, evidence.answers.context.frame
    overlap = answered_overlap(line, predictions, truth, frame)
    hits, pairs = overlap >= HIT, truth.acceptable_pairs(case)
    reference = answered_box(line, predictions, frame, "reference")
    ends = np.ones(len(hits), np.bool_) if reference is None else iou_2d(reference[None], truth.boxes)[0] >= HIT
    fits = bool((pairs & hits[:, None] & ends[None]).any())
    diagnosis = Diagnosis(
        verdict="",
        detail=None,
        lucky=False,
        repair=(),
        right_with=None,
        margins=np.full(SUBSETS, np.nan),
        winner=None,
        right=None,
        gold=parse_ok,
        untold=unavailable_oracles(evidence, case, parse_ok),
        case=case,
        evidence=evidence,
    )
    correct = bool(hits[case.target_object]) or bool(line.answer is not None and line.answer.yes)
    right, lucky = bool(hits[case.acceptable].any()), reference is not None and not fits
    if (known := decided_by_label(diagnosis, correct, mark, right, fits, lucky)) is not None:
        return known
    if line.level == 0:
        return replace(diagnosis, verdict="UNEXPLAINED", detail="ANSWER")
    found = substitute(evidence, case)
    if len(diagnosis.untold) < len(ORACLES):
        # Without an answer the best target alone is none either.
        right_with = found.right_target & (found.winners >= 0)
        diagnosis = replace(diagnosis, right_with=int((right_with << np.arange(SUBSETS)).sum()))
    unproposed = not_proposed(evidence, case, found, diagnosis)
    if unproposed is None and line.answer is None:
        unproposed = _one_for_both(evidence, case, found, diagnosis)
    if unproposed is not None:
        return unproposed
    if line.boxes_3d is None:
        return replace(diagnosis, verdict="UNEXPLAINED", detail="PROPOSALS")
    if _misplaced(evidence, found, line):
        return replace(diagnosis, verdict="LIFT", repair=("LIFT",), mends=("LIFT",))
    return replace(diagnosis, verdict="UNEXPLAINED", detail="BOXES")


def decided_by_label(
    diagnosis: Diagnosis, correct: bool, mark: str | None, right: bool, fits: bool, lucky: bool
) -> Diagnosis | None:
    """CORRECT, PARSE or LABEL; None for a wrong answer, of which a later module is to blame.

    `right`: the answer is another acceptable target; `fits`: the labels' relations hold of the answered pair.
    """
    if correct:
        return replace(diagnosis, verdict="CORRECT", lucky=lucky)
    if not diagnosis.gold:
        return replace(diagnosis, verdict="PARSE")
    detail = "AMBIGUOUS" if right else mark or ("SUSPECT" if fits else None)
    return None if detail is None else replace(diagnosis, verdict="LABEL", detail=detail)


def _one_for_both(evidence: FrameEvidence, case: Case, found: OracleScores, diagnosis: Diagnosis) -> Diagnosis | None:
    """OPM-REF where a single object covers both ends of every right pair ("book above another book"); else None."""
    t, r = found.target.found, found.reference.found
    two = found.target.index[:t, None] != found.reference.index[None, :r]
    if not case.reference or (found.covered[:t, :r] & two).any():
        return None
    taken = found.target.index[:t][found.covered[:t, :r].any(axis=1)]
    others = ~np.isin(found.reference.index[:r], taken)
    wanted = evidence.truth.acceptable_pairs(case).any(axis=0)
    best = float(found.reference.overlap[:r][others][:, wanted].max(initial=0.0))
    missed = Missed("LOCALISATION" if best >= NEAR_MISS else "ABSENT", best)
    return replace(diagnosis, verdict="OPM-REF", detail=missed.kind, missed=missed, missed_name=case.reference)


def _misplaced(evidence: FrameEvidence, found: OracleScores, line: Prediction) -> bool:
    """True for wrong 3D boxes: given boxes deny every right pair or allow the answer, true boxes the opposite."""
    t, r = found.target.found, found.reference.found
    theirs, true = found.pair_relations[[0, LIFT], :t, :r]
    right = found.covered[:t, :r]
    denied = bool((theirs[right] < HIT).all() and (true[right] >= HIT).any())
    answer = line.answer
    if answer is None or answer.object is None:
        return denied
    ids = np.array([o.id for o in evidence.answers.objects])
    chosen = ids[found.target.index[:t]] == answer.object
    ends = ids[found.reference.index[:r]] == answer.reference
    pair = np.ix_(chosen, ends if answer.reference is not None else np.ones(r, np.bool_))
    held = theirs[pair] > HIT
    return denied or bool(held.any() and (true[pair][held] < HIT).all())


def judge_foreign_ranking(found: OracleScores, diagnosis: Diagnosis) -> Diagnosis | None:
    """Verdict on a right pair that lost by a foreign ranking at fault, or beyond judgement; None leaves the decision to
    the oracles."""
    rule, table = found.table.config.rule, found.table
    shown = [s for s in range(found.subsets) if not s & RECALL]
    if not np.isfinite(found.table.flat[shown][:, found.covered.ravel()]).any():
        # The two things of every right pair count as one: whatever ranks, none is among the pairs.
        return replace(diagnosis, verdict="PRM", detail="DEGENERATE", repair=())
    # A ranking that can be asked again need not rise with its factors.
    outdone = (rule.model is None or rule.unit > 0) and _outdone(found)
    if rule.model is None:
        if outdone:
            return replace(diagnosis, verdict="PRM", detail="SCORE", repair=(), right_with=None)
        return replace(diagnosis, verdict="UNEXPLAINED", detail="NOT-SEPARABLE", repair=(), right_with=None)
    regular = np.where(
        np.isfinite(table.log_score), rule.scores(table.target, table.ends, table.p_relation, True), -np.inf
    )
    ahead = margins_of(replace(table, log_score=regular), found.covered)
    mended = any(found.mends(s) for s in shown)
    lost = ahead[0] > rule.unit * LIKELY or outdone
    if not lost and _says_nothing(found) and not _misled(found, diagnosis):
        return replace(diagnosis, verdict="SRM", detail="CONSTANT", repair=names_of(SRM))
    if lost or (not mended and (ahead[shown] > 0).any()):
        return replace(diagnosis, verdict="PRM", detail="SCORE", repair=())
    return None if mended else replace(diagnosis, verdict="UNEXPLAINED", detail="NOT-SEPARABLE", repair=())


def _says_nothing(found: OracleScores) -> bool:
    """True for an uninformative relation: about equal for all pairs, and true of the right pair, not of the answer."""
    p = found.pair_relations[[0, LIFT, SRM]].reshape(3, -1)
    ranked = p[:2, np.isfinite(found.plain.flat[0])]
    mine, its = p[2, int(found.winners[0])], p[2, found.first_acceptable]
    return bool(ranked.shape[1] >= FEWEST_ALIKE and (np.ptp(ranked, axis=1) < ALIKE).all() and mine < HIT < its)


def _outdone(found: OracleScores) -> bool:
    """True where a right pair beats the answer in some factor and loses in none: no rising ranking puts it lower."""
    plain, ends = found.plain, found.reference.scores
    p = plain.p_relation.reshape(found.covered.shape)
    parts = np.broadcast_arrays(found.target.scores[:, None], ends if len(ends) else np.ones(1), p)
    factors = np.stack(parts).reshape(3, -1)
    allowed = found.covered.ravel() & np.isfinite(plain.flat[0])
    more = factors[:, allowed] - factors[:, int(found.winners[0]), None]
    return bool(((more >= 0).all(axis=0) & (more > 0).any(axis=0)).any())


def blamed_together(found: OracleScores, diagnosis: Diagnosis, bits: Sequence[int]) -> list[int]:
    """Oracles to blame, among those mending an imported answer only together.

    Confidences in favour of the right pair are left out, and so is the source of its relation where in favour; of
    geometry and relation the first is kept. The truth is at times less sure of a right pair than a scorer (.50 where
    the label says U), and so takes true confidences, too, to mend the scorer's error.
    """
    winner, right = diagnosis.winner, diagnosis.right
    if diagnosis.evidence.asked_again or winner is None or right is None:
        return list(bits)
    surer = winner.p_target > right.p_target or winner.p_reference > right.p_reference
    related = [bit for bit in bits if bit in (LIFT, SRM)] if _denied(found) else []
    blamed = related[:1] + [bit for bit in bits if bit == CONF and surer]
    rule = found.table.config.rule
    # One module is wrong more often than two: one that all but mends, for all that is known of the ranking.
    nearly = [bit for bit in blamed if rule is not None and found.margins[bit] > -rule.unit * LIKELY]
    return nearly if len(nearly) == 1 else blamed


def _denied(found: OracleScores) -> bool:
    """True where the relation favoured the answer, or is wrong of the right pair or of the answer."""
    p = found.pair_relations[[0, SRM]].reshape(2, -1)
    (mine, true_mine), (its, true_its) = (p[:, k] for k in (int(found.winners[0]), found.first_acceptable))
    return bool(mine > its or mine > HIT > true_mine or its < HIT < true_its)


def blamed_alone(found: OracleScores, diagnosis: Diagnosis, flips: Sequence[int]) -> list[int]:
    """Oracles to blame, among those mending an answer alone; of an imported ranking a single one.

    A factor in favour of the right pair is not to blame, though a surer truth would have helped. Of the others the
    first of the chain is taken: an object of no such class, surer than the right one; a box that is off and explains
    the given probability; that probability; the confidences of real objects.
    """
    winner, right = diagnosis.winner, diagnosis.right
    if diagnosis.evidence.asked_again or winner is None or right is None:
        return list(flips)
    false = (diagnosis.false_target and winner.p_target > right.p_target) or (
        diagnosis.false_reference and winner.p_reference > right.p_reference
    )
    related = _denied(found)
    chain = [(CONF, false), (LIFT, related), (SRM, related), (CONF, True)]
    first = [bit for bit, spoke in chain if spoke and bit in flips][:1] or list(flips)
    return [LIFT] if first == [SRM] and (_follows(found) or _misled(found, diagnosis)) else first


def _misled(found: OracleScores, diagnosis: Diagnosis) -> bool:
    """True where a box of the answer or of the right pair is unusually far off for the frame."""
    r = found.covered.shape[1]
    pairs = (int(found.winners[0]), found.first_acceptable)
    ends = np.array([(found.target.index[k // r], found.reference.index[k % r]) for k in pairs]).ravel()
    return bool(diagnosis.evidence.unusual(ends).any())


def _follows(found: OracleScores) -> bool:
    """True where true boxes move the relation of the right pair at least half the way to the answer's likelier one."""
    p = np.clip(found.pair_relations[[0, LIFT]].reshape(2, -1), 0.01, 0.99)
    odds = np.log(p / (1 - p))
    right = found.first_acceptable
    before, after = odds[:, right] - odds[:, int(found.winners[0])]
    return bool(before < 0 and after > before / 2)
