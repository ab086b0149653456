"""Rank an expression with every subset of the oracles (see `oracles`)."""

from __future__ import annotations

import numpy as np

from pipeline.answering.pair_table import (
    Side,
    one_object_twice,
    pair_table,
    side,
)
from pipeline.diagnosis.frame_evidence import FrameEvidence
from pipeline.diagnosis.oracles import (
    CONF,
    LIFT,
    RECALL,
    SRM,
    SUBSETS,
    CandidateSet,
    OracleScores,
    relation_of,
    role_of,
)
from pipeline.diagnosis.sentence_substitution import substitute_sentence
from pipeline.labels.cases import HIT, Case


def substitute(evidence: FrameEvidence, case: Case) -> OracleScores:
    """Rank an expression's pairs with every subset of the oracles, on its gold triple; a sentence as read."""
    if case.meant is not None:
        return substitute_sentence(evidence, case, case.meant)
    truth, answers = evidence.truth, evidence.answers
    target = role_of(evidence, case.target, truth.alike[case.target_object])
    reference = role_of(evidence, case.reference, truth.alike[case.reference_object])
    pairs = truth.acceptable_pairs(case).astype(np.int32)
    hits, ends = ((role.overlap >= HIT).astype(np.int32) for role in (target, reference))
    p = relation_of(evidence, case.relation, target, reference)
    config = answers.source.config.rank
    every = np.arange(SUBSETS)
    lift, srm, conf = (((every & bit) > 0).astype(int) for bit in (LIFT, SRM, CONF))
    unseen = (every & RECALL) == 0
    same, same_box = (
        one_object_twice((target.index, reference.index), table) for table in (evidence.same, evidence.same_box)
    )
    a, b = target.shape_of[:, None], reference.shape_of[None, :]
    # LIFT also gives the true masks, and those of two objects are never alike.
    same_lifted = np.where((a >= 0) & (b >= 0) & (a != b), same_box, same)
    forbidden = np.where(lift[:, None, None] > 0, same_lifted, same)
    forbidden[unseen, target.found :] = True
    forbidden[unseen, :, reference.found :] = True
    table = pair_table(
        _side(target, conf, config.target_weight, config.true_scores),
        (_side(reference, conf, config.reference_weight, config.true_scores),),
        p[lift, srm],
        forbidden,
        evidence.mask_sizes,
        config,
    )
    return OracleScores(
        target=target,
        reference=reference,
        table=table,
        p_relation=p,
        covered=(hits @ pairs @ ends.T) > 0,
        right=np.asarray(hits[:, case.acceptable].any(axis=1)),
    )


def _side(role: CandidateSet, conf: np.ndarray, weight: float, scores: tuple[float, float]) -> Side:
    """Role under every subset; `conf` marks the subsets with true confidences, `scores` are these."""
    true = np.where(role.object >= 0, *scores)
    both = side(role.index, np.stack([role.scores, true]), weight)
    return Side(both.index, both.scores[conf], both.log[conf])
