"""One expression ranked sixteen times: with every subset of the oracles in place of what the modules gave."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pipeline.boxes import iou_2d
from pipeline.diagnosis.frame_evidence import FrameEvidence
from pipeline.diagnosis.oracles import (
    CONF,
    EVEN,
    LIFT,
    RECALL,
    RIGHT_SCORE,
    SRM,
    STATE_PROBABILITY,
    SUBSETS,
    WRONG_SCORE,
)
from pipeline.evaluation.cases import Case
from pipeline.evaluation.records import HIT
from pipeline.ranking import MIN_RELATION, MIN_SCORE, TIE, Candidates

_ALL = np.arange(SUBSETS)


@dataclass(frozen=True, eq=False)
class Role:
    """What may fill one place of the expression: its candidates, then the labelled objects that RECALL adds.

    Attributes
    ----------
    places : (K,) int64
        In the list of the frame's evidence.
    found : int
        How many of them are candidates.
    scores : (K,) float64
    object : (K,) int64
        The labelled object of the asked class that each is; -1 for a false positive.
    shape_of : (K,) int64
        The labelled object whose geometry LIFT gives it, of whatever class; -1 where it keeps its own.
    overlap : (K, N) float64
        With every labelled object.
    """

    places: np.ndarray
    found: int
    scores: np.ndarray
    object: np.ndarray
    shape_of: np.ndarray
    overlap: np.ndarray


@dataclass(frozen=True, eq=False)
class Substituted:
    """All candidate pairs of one expression under all subsets of the oracles.

    Attributes
    ----------
    target, reference : Role
    log_score : (16, T, R) float64
        S under each subset; -inf where a pair is not there or is one thing.
    p_relation : (2, 2, T, R) float64
        Without and with LIFT, without and with SRM.
    covered : (T, R) bool
        Acceptable pairs.
    right : (T,) bool
        Targets of which the expression is or may be true.
    """

    target: Role
    reference: Role
    log_score: np.ndarray
    p_relation: np.ndarray
    covered: np.ndarray
    right: np.ndarray
    mask_sizes: np.ndarray

    @cached_property
    def winners(self) -> np.ndarray:
        """(16,) int64: the winning pair under each subset as i * R + j; -1 where there is no pair."""
        if not self.covered.size:
            return np.full(SUBSETS, -1, np.int64)
        return self._tops(self.log_score.reshape(SUBSETS, -1))

    @cached_property
    def best_acceptable(self) -> tuple[int, int] | None:
        """The acceptable pair among the candidates that stands highest, by the ranking's order, without any oracle."""
        if not self.covered.size:
            return None
        at = int(self._tops(np.where(self.covered, self.log_score[0], -np.inf).reshape(1, -1))[0])
        return None if at < 0 else divmod(at, self.covered.shape[1])

    def _tops(self, flat: np.ndarray) -> np.ndarray:
        """(S,) int64: the first place by the ranking's order of each row of scores, that of subset s; -1 for none."""
        top = flat.max(axis=1)
        near = np.round(flat / TIE) >= np.round(top / TIE)[:, None]
        found = np.where(np.isfinite(top), flat.argmax(axis=1), -1)
        for subset in np.flatnonzero((near.sum(axis=1) > 1) & np.isfinite(top)):
            found[subset] = self._first(int(subset), np.flatnonzero(near[subset]))
        return found

    def _first(self, subset: int, tied: np.ndarray) -> int:
        """The tied pair that the ranking's rules put first: relation, target score, mask, lower places."""
        i, j = np.divmod(tied, self.covered.shape[1])
        lift, srm = int(bool(subset & LIFT)), int(bool(subset & SRM))
        targets, references = self.target.places[i], self.reference.places[j]
        keys = zip(
            (-self.p_relation[lift, srm, i, j]).tolist(),
            (-self._target_scores(subset)[i]).tolist(),
            (-self.mask_sizes[targets]).tolist(),
            targets.tolist(),
            references.tolist(),
            tied.tolist(),
            strict=True,
        )
        # A handful of pairs: plain tuples are compared sooner than arrays are sorted.
        return min(keys)[-1]

    def _target_scores(self, subset: int) -> np.ndarray:
        return given_scores(self.target) if subset & CONF else self.target.scores

    def pair(self, subset: int = 0) -> tuple[int, int] | None:
        """The winner under a subset as places in the two roles."""
        at = int(self.winners[subset])
        return None if at < 0 else divmod(at, self.covered.shape[1])

    @cached_property
    def accepted(self) -> np.ndarray:
        """(16,) bool: an acceptable pair wins."""
        flat = self.covered.ravel()
        return np.array([w >= 0 and bool(flat[w]) for w in self.winners])

    @cached_property
    def right_target(self) -> np.ndarray:
        """(16,) bool: the answer's target is right by set-valued accuracy; without any pair the best target answers."""
        found = np.zeros(SUBSETS, np.bool_)
        for subset, winner in enumerate(self.winners):
            if winner >= 0:
                found[subset] = self.right[winner // self.covered.shape[1]]
                continue
            alone = self.alone(subset)
            found[subset] = alone is not None and self.right[alone]
        return found

    def alone(self, subset: int = 0) -> int | None:
        """The target that answers where all pairs are one thing; None where a role has no candidate at all."""
        t, r = ((len(x.places) if subset & RECALL else x.found) for x in (self.target, self.reference))
        if self.winners[subset] >= 0 or not t or not r:
            return None
        return int(np.argmax(self._target_scores(subset)[:t]))

    @cached_property
    def margins(self) -> np.ndarray:
        """(16,) float64: S of the best acceptable pair less S of the best other pair; -inf, inf where one lacks."""
        return _margins(self.log_score, self.covered)

    def decided_margin(self, subset: int, relation_weight: float) -> float:
        """The margin by what the network decides: a relation above .5 counts as the truth's .99, one below as .01."""
        lift, srm = int(bool(subset & LIFT)), int(bool(subset & SRM))
        p = self.p_relation[lift, srm]
        decided = np.where(p > EVEN, STATE_PROBABILITY[1], np.where(p < EVEN, STATE_PROBABILITY[-1], p))
        shift = relation_weight * (np.log(decided) - np.log(np.maximum(p, MIN_RELATION)))
        return float(_margins((self.log_score[subset] + shift)[None], self.covered)[0])


def _margins(log_score: np.ndarray, covered: np.ndarray) -> np.ndarray:
    flat, right = log_score.reshape(len(log_score), -1), covered.ravel()
    best = np.where(right, flat, -np.inf).max(axis=1, initial=-np.inf)
    other = np.where(right, -np.inf, flat).max(axis=1, initial=-np.inf)
    found = np.full(len(flat), np.nan)
    either = np.isfinite(best) | np.isfinite(other)
    found[either] = best[either] - other[either]
    return found


def given_scores(role: Role) -> np.ndarray:
    """(K,) float64: what CONF says of each."""
    return np.where(role.object >= 0, RIGHT_SCORE, WRONG_SCORE)


def role_of(evidence: FrameEvidence, candidates: Candidates, asked: np.ndarray) -> Role:
    """The candidates of a name and the labelled objects that are missing among them.

    Parameters
    ----------
    evidence : FrameEvidence
    candidates : Candidates
    asked : (N,) bool
        Labelled objects of the asked class.
    """
    overlap = evidence.overlap[candidates.index]
    own = np.where(asked, overlap, 0.0)
    best = own.argmax(axis=1) if own.size else np.zeros(len(own), np.int64)
    is_one = own[np.arange(len(own)), best] >= HIT if own.size else np.zeros(len(own), np.bool_)
    objects = np.where(is_one, best, -1)
    shapes = np.where(is_one, best, evidence.match[candidates.index])
    shapes = np.where((shapes >= 0) & evidence.known[shapes], shapes, -1) if evidence.labelled else shapes
    covered = (own >= HIT).any(axis=0) if len(own) else np.zeros(evidence.labelled, np.bool_)
    missing = np.flatnonzero(asked & ~covered & evidence.known)
    everyone = np.concatenate([objects, missing]).astype(np.int64)
    truth = evidence.truth.boxes
    return Role(
        places=np.concatenate([candidates.index, evidence.detections + missing]).astype(np.int64),
        found=len(candidates.index),
        scores=np.concatenate([candidates.scores, np.full(len(missing), evidence.confidence)]),
        object=everyone,
        shape_of=np.concatenate([shapes, missing]).astype(np.int64),
        overlap=np.concatenate([overlap, iou_2d(truth[missing], truth).reshape(-1, evidence.labelled)]),
    )


def _role(evidence: FrameEvidence, name: str, asked: np.ndarray) -> Role:
    """The role of a name, made once for all expressions of the frame that ask for it."""
    key = (name, asked.tobytes())
    if key not in evidence.roles:
        evidence.roles[key] = role_of(evidence, evidence.answers.candidates[name], asked)
    return evidence.roles[key]


def substitute(evidence: FrameEvidence, case: Case) -> Substituted:
    """Rank an expression's pairs with every subset of the oracles, on its gold triple."""
    truth, answers = evidence.truth, evidence.answers
    target = _role(evidence, case.target, truth.alike[case.target_object])
    reference = _role(evidence, case.reference, truth.alike[case.reference_object])
    pairs = truth.acceptable_pairs(case).astype(np.int32)
    hits, ends = ((role.overlap >= HIT).astype(np.int32) for role in (target, reference))
    p = _relation(evidence, case.relation, target, reference)
    config = answers.source.config.rank
    own, other = (
        np.log(np.clip(np.stack([role.scores, given_scores(role)]), MIN_SCORE, 1 - MIN_SCORE))
        for role in (target, reference)
    )
    lift, srm, conf = (((_ALL & bit) > 0).astype(int) for bit in (LIFT, SRM, CONF))
    # In the order in which the ranking adds them, so that S is the same to the last bit.
    score = config.target_weight * own[conf][:, :, None] + (
        config.relation_weight * np.log(np.maximum(p[lift, srm], MIN_RELATION))
        + config.reference_weight * other[conf][:, None, :]
    )
    same, same_box = (table[np.ix_(target.places, reference.places)] for table in (evidence.same, evidence.same_box))
    a, b = target.shape_of[:, None], reference.shape_of[None, :]
    # LIFT also gives the true masks, and those of two objects are never alike.
    same_lifted = np.where((a >= 0) & (b >= 0) & (a != b), same_box, same)
    score[np.stack([same, same_lifted])[lift]] = -np.inf
    unseen = (_ALL & RECALL) == 0
    score[unseen, target.found :] = -np.inf
    score[unseen, :, reference.found :] = -np.inf
    return Substituted(
        target=target,
        reference=reference,
        log_score=score,
        p_relation=p,
        covered=(hits @ pairs @ ends.T) > 0,
        right=np.asarray(hits[:, case.acceptable].any(axis=1)),
        mask_sizes=evidence.mask_sizes,
    )


def _relation(evidence: FrameEvidence, relation: str, target: Role, reference: Role) -> np.ndarray:
    """(2, 2, T, R): without and with LIFT, without and with SRM."""
    table = evidence.probabilities(relation)
    base = table[np.ix_(target.places, reference.places)]
    shaped = [
        np.where(role.shape_of >= 0, evidence.detections + role.shape_of, role.places) for role in (target, reference)
    ]
    lifted = table[np.ix_(*shaped)]
    # Two candidates that are one object stand in no relation to each other.
    lifted = np.where(shaped[0][:, None] == shaped[1][None, :], STATE_PROBABILITY[-1], lifted)
    moved = (target.shape_of >= 0)[:, None] | (reference.shape_of >= 0)[None, :]
    lifted = np.where(moved & np.isfinite(lifted), lifted, base)
    a, b = (
        np.where(role.object >= 0, role.object, evidence.match_at(role.places)) for role in (target, reference)
    )
    if evidence.labelled:
        known = np.array([STATE_PROBABILITY[k] for k in (-1, 0, 1)])
        states = evidence.truth.states[relation][a[:, None], b[None, :]]
        judged = evidence.truth.judged[a[:, None], b[None, :]] & (a >= 0)[:, None] & (b >= 0)[None, :]
        told = np.where(
            (a[:, None] == b[None, :]) & (a >= 0)[:, None], STATE_PROBABILITY[-1], known[states.astype(int) + 1]
        )
        judged |= (a[:, None] == b[None, :]) & (a >= 0)[:, None]
    else:
        judged, told = np.zeros(base.shape, np.bool_), base
    found = np.stack([np.stack([p, np.where(judged, told, p)]) for p in (base, lifted)])
    return np.where(np.isfinite(found), found, MIN_RELATION)
