"""What would make an answer right: a score of what was missed or scored too low, or one labelled 3D box."""

from __future__ import annotations

from math import exp, inf, log

import numpy as np

from pipeline.answering.pair_table import MIN_SCORE
from pipeline.diagnosis.frame_evidence import FrameEvidence
from pipeline.diagnosis.oracles import RECALL, OracleScores, margins_of
from pipeline.labels.cases import HIT, Case
from pipeline.system.frozen import dataclass

Named = tuple[tuple[str, int], ...]


@dataclass(frozen=True)
class NeededScore:
    """What must be found, and which score is needed, for the right pair to win."""

    missing: Named  # Names of the question with the labelled objects (indices) that they should find
    scored: Named  # Names with the candidates (places in the list of detections) that need the same score
    # above, below: 0 and 1 for any
    above: float
    below: float
    # Place of the detection whose box is to fit instead; None where the object joins the candidates
    loose: int | None = None


def needed_score(
    evidence: FrameEvidence, case: Case, found: OracleScores, loose: int | None = None, missed: bool = True
) -> NeededScore | None:
    """Lowest score that is enough, of the missing objects of a right pair, else of both its objects; None for none.

    Exact on the table of all pairs. `loose`: a candidate whose box fits too badly and would fit; `missed`: no right
    pair stood among the candidates.
    """
    if case.meant is not None or found.table.config.rule is not None:
        return None
    ways = [_of_missing(evidence, case, found, loose, whole) for whole in ((False, True) if missed else (True,))]
    return next((way for way in ways if way is not None), None)


def _of_missing(
    evidence: FrameEvidence, case: Case, found: OracleScores, loose: int | None, whole: bool
) -> NeededScore | None:
    """Lowest score of what was missed of a right pair, or of its `whole`."""
    table, d, best = found.table.scene(RECALL), evidence.detections, None
    roles, names = (found.target, found.reference), (case.target, case.reference)
    weights = (table.config.target_weight, table.config.reference_weight)
    logs, scores = (table.target.log, table.ends[0].log), table.flat[0].reshape(found.covered.shape)
    for at in np.argwhere(found.covered & np.isfinite(scores)).tolist():
        ends = [int(role.index[k]) for role, k in zip(roles, at, strict=True)]
        moved = [end for end in ends if whole or end >= d]
        if not moved:
            continue
        # Nothing else is found anew, and a box that fits is no longer the loose one.
        shown = [
            np.isin(r.index, ends) | ((r.index < d) & (r.index != (-1 if loose is None else loose))) for r in roles
        ]
        rises = [weight * np.isin(role.index, moved) for role, weight in zip(roles, weights, strict=True)]
        moves = [
            np.where(rise > 0, rise * log(evidence.confidence) - own, 0) for rise, own in zip(rises, logs, strict=True)
        ]
        moved_to, rise = scores + moves[0][:, None] + moves[1], rises[0][:, None] + rises[1]
        others = shown[0][:, None] & shown[1] & np.isfinite(scores) & ~found.covered
        lead, gain = moved_to[tuple(at)] - moved_to[others], rise[tuple(at)] - rise[others]
        if (lead[gain == 0] <= 0).any():
            continue
        least = float((-lead[gain > 0] / gain[gain > 0]).max(initial=-inf))
        most = float((lead[gain < 0] / -gain[gain < 0]).min(initial=inf))
        above, below = (min(evidence.confidence * exp(min(x, 700.0)), 1.0) for x in (least, most))
        both = dict.fromkeys(zip(names, ends, strict=True))
        missing = tuple((name, end - d) for name, end in both if end >= d)
        better = best is None or (len(missing), above) < (len(best.missing), best.above)
        if above < min(below, 1 - MIN_SCORE) and better:
            scored = tuple((name, end) for name, end in both if end in moved and end < d)
            best = NeededScore(missing, scored, 0.0 if above <= MIN_SCORE else above, below, loose)
    return best


def loose_candidate(evidence: FrameEvidence, name: str, objects: np.ndarray, least: float) -> int | None:
    """Candidate of a name that overlaps one of these labelled objects most, by `least` up to a half; None for none."""
    index = evidence.answers.candidates[name].index
    overlap = evidence.overlap[np.ix_(index, objects)].max(axis=1, initial=0.0)
    k = int(overlap.argmax()) if len(overlap) else -1
    return int(index[k]) if k >= 0 and least <= overlap[k] < HIT else None


def needed_box(evidence: FrameEvidence, case: Case, found: OracleScores) -> tuple[int, int] | None:
    """Detection (place in the list) of the answer or the best right pair that with its labelled 3D box would make a
    right pair win, and the labelled object (index); of several the one that makes it win most clearly, None for none.

    Exact on the table of all pairs.
    """
    if case.meant is not None or not evidence.asked_again or found.best_acceptable is None:
        return None
    plain, roles, p = found.plain, (found.target, found.reference), evidence.probabilities(case.relation)
    pairs = (found.best_acceptable, divmod(int(found.winners[0]), found.covered.shape[1]))
    ways: list[tuple[float, int, int]] = []
    for place, k in {(int(r.index[n]), int(r.shape_of[n])) for pair in pairs for r, n in zip(roles, pair, strict=True)}:
        if k >= 0:
            index = [np.where(role.index == place, evidence.detections + k, role.index) for role in roles]
            moved = p[index[0][:, None], index[1]].reshape(plain.p_relation.shape)
            table = plain.with_relation(np.where(np.isfinite(moved), moved, plain.p_relation))
            ways.append((float(margins_of(table, found.covered)[0]), place, k))
    best = max(ways, default=(0.0, 0, 0))
    return best[1:] if best[0] > 0 else None
