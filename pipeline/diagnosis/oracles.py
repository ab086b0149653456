"""Oracle subsets: an expression ranked with every subset of modules replaced by the truth, 16 or with attributes 32.

Each oracle replaces what one module gave by the truth, and nothing else.

RECALL
    Every labelled object of an asked class that no candidate overlaps by half
    joins the candidates, with its own pixels lifted and with the median
    confidence of the run's right detections.
LIFT
    Every candidate that is an object gets that object's true geometry; the
    relation scorer then scores it anew. Two of them that are different objects
    no longer count as one thing because their masks are alike, only because
    their 2D boxes are. What is no object stays as it is.
SRM
    The relation of two candidates that are both objects is .99, .50 or .01, as
    the label says T, U or F. Where one is no object, or the pair was not
    judged, it stays.
CONF
    A candidate that is an object of the asked class is given .99, every other one .01.
ATTRIBUTE
    P(attribute | x) of a candidate that is an object of the asked class is .99,
    .50 or .01, as the truth has it; where nobody knows (`sentence_truth`) it
    stays. With LIFT alone attributes are judged anew by the true pixels and box.

Choices among things ("leftmost", "second from the left"), negations and what is
said of the viewer have no oracle: they follow from geometry, attributes,
relations and confidences, and are worked out anew from what these became.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from pipeline.answering.evidence import HOLDS
from pipeline.answering.pair_table import (
    MIN_RELATION,
    PairTable,
    ScoredPair,
)
from pipeline.diagnosis.frame_evidence import FrameEvidence, matched
from pipeline.geometry.boxes import iou_2d
from pipeline.labels.cases import HIT
from pipeline.system.frozen import dataclass

ORACLES = ("RECALL", "LIFT", "SRM", "CONF")
ALL_ORACLES = (*ORACLES, "ATTRIBUTE")
"""Of an expression that speaks of attributes."""
NAMED_BY = {
    "PARSE": ("PARSE",),
    "RECALL": ("OPM-TARGET", "OPM-REF"),
    "LIFT": ("LIFT",),
    "ATTRIBUTE": ("ATTRIBUTE",),
    "SRM": ("SRM",),
    "CONF": ("OPM-CONF", "PRM"),
}
"""The verdicts that each oracle takes away, by which people are told of it; of PARSE the gold triple does."""
RECALL, LIFT, SRM, CONF, ATTRIBUTE = (1 << k for k in range(5))
SUBSETS = 16
STATE_PROBABILITY = {1: 0.99, 0: 0.50, -1: 0.01}
NEARLY = 0.25
"""Log odds by which a fitted ranking does not tell which of two is first."""
TIED = 0.05
"""A ranking that was only fitted does not tell which of two is first that are apart by this share of what they were."""
SURE = 0.95
"""Beyond this, or below one less this, a probability of true boxes is as sure as any."""
EXPLAINED = 0.3
"""A probability that is nearer to what a box says than this share of what boxes of the frame say, or on the same
side of a half, follows from the box."""


@dataclass(frozen=True, eq=False)
class CandidateSet:
    """Candidates of a place of the expression, then the labelled objects added by RECALL."""

    index: np.ndarray  # (K,) int64: in the list of the frame's evidence
    found: int  # How many of them are candidates
    scores: np.ndarray  # (K,) float64
    object: np.ndarray  # (K,) int64: the labelled object of the asked class that each is; -1 for a false positive
    # (K,) int64: the labelled object whose geometry LIFT gives it, of whatever class; -1 where it keeps its own
    shape_of: np.ndarray
    overlap: np.ndarray  # (K, N) float64: with every labelled object


@dataclass(frozen=True, eq=False)
class OracleScores:
    """Candidate pairs of an expression under all subsets of the oracles."""

    target: CandidateSet
    reference: CandidateSet
    # One scene a subset, of which there are S; no pair is there whose objects are one thing, or not recalled
    table: PairTable
    # (2, 2, T, R) float64: without and with LIFT, without and with SRM; of a sentence (S, T, R) or, without a relation,
    # (S, T)
    p_relation: np.ndarray
    covered: np.ndarray  # (T, R) bool: acceptable pairs; without a relation R is 1
    right: np.ndarray  # (T,) bool: targets of which the expression is or may be true
    winners: np.ndarray  # (S,) int64: winning pair under each subset as i * R + j; -1 without a pair
    # (S,) float64: margin of the best acceptable pair over the best other; -inf, inf where either is missing
    margins: np.ndarray
    first_acceptable: int  # Highest acceptable pair by the ranking's order, without any oracle; -1 for none

    @property
    def subsets(self) -> int:
        """Number of subsets."""
        return len(self.table.flat)

    def pair_at(self, at: int) -> ScoredPair:
        """Pair of `plain`, with all statements of a sentence about it."""
        return self.plain.pair(at)

    @property
    def pair_relations(self) -> np.ndarray:
        """(S, T, R) float64: P(relation) of each pair under each subset."""
        return self.table.p_relation.reshape(-1, *self.covered.shape)

    @cached_property
    def plain(self) -> PairTable:
        """Pairs without any oracle, as ranked."""
        return self.table.scene(0)

    @property
    def best_acceptable(self) -> tuple[int, int] | None:
        """Highest acceptable pair as indices in the two roles."""
        at = self.first_acceptable
        return None if at < 0 else divmod(at, self.covered.shape[1])

    def pair(self, subset: int = 0) -> tuple[int, int] | None:
        """Winner under a subset as indices in the two roles."""
        at = int(self.winners[subset])
        return None if at < 0 else divmod(at, self.covered.shape[1])

    @cached_property
    def accepted(self) -> np.ndarray:
        """(S,) bool: an acceptable pair wins."""
        there = self.winners >= 0
        return there & self.covered.ravel()[self.winners] if there.any() else there

    def mends(self, subset: int) -> bool:
        """True where an acceptable pair wins under a subset, or nearly ties by a merely fitted ranking."""
        rule, behind = self.table.config.rule, self.margins[0]
        # Of two pairs that are both true an oracle says the same, and so leaves a tie.
        near = rule is not None and self.margins[subset] > min(max(-NEARLY * rule.unit, behind / 2), behind * TIED)
        return bool(self.accepted[subset] or near)

    @cached_property
    def right_target(self) -> np.ndarray:
        """(S,) bool: right target by set-valued accuracy; without any pair the best target answers."""
        found = self.winners >= 0
        nothing = np.flatnonzero(~found).tolist()
        if found.any():
            found = found & self.right[self.winners // self.covered.shape[1]]
        for subset in nothing:
            target = self.alone(subset)
            found[subset] = target is not None and self.right[target]
        return found

    def alone(self, subset: int = 0) -> int | None:
        """Answering target where all pairs are a single object; None for a role without candidates."""
        t, r = ((len(x.index) if subset & RECALL else x.found) for x in (self.target, self.reference))
        if self.winners[subset] >= 0 or not t or not r:
            return None
        return int(np.argmax(self.table.target.scores[subset, :t]))

    def decided_margin(self, subset: int) -> float:
        """Margin by decided relations: above .5 counts as the truth's .99, below as .01.

        An attribute likewise from its threshold on.
        """
        table = self.table.scene(subset)
        return float(margins_of(levelled(table.with_relation(decided(table.p_relation, HOLDS))), self.covered)[0])


def levelled(table: PairTable) -> PairTable:
    """Table with the scores of a fitted ranking on their fitted scale."""
    rule = table.config.rule
    if rule is None or rule.scale == "values":
        return table
    there = np.isfinite(table.log_score)
    return replace(table, log_score=np.where(there, rule.level(np.where(there, table.log_score, 0.5)), -np.inf))


def margins_of(table: PairTable, covered: np.ndarray) -> np.ndarray:
    """(B,) float64: S of the best covered pair of each scene less that of the best other one; NaN without any pair.

    `covered`, (T, R) bool or (B, P) with pairs of every scene.
    """
    flat = table.flat
    pairs = flat.shape[1]
    right = covered.reshape(covered.size // pairs if pairs else 1, pairs)
    best = np.where(right, flat, -np.inf).max(axis=1, initial=-np.inf)
    other = np.where(right, -np.inf, flat).max(axis=1, initial=-np.inf)
    with np.errstate(invalid="ignore"):
        return best - other


def role_of(evidence: FrameEvidence, name: str, asked: np.ndarray) -> CandidateSet:
    """Candidates of a name, and the missing labelled objects ((N,) bool, of the asked class).

    Made once for all expressions of the frame with this name.
    """
    key, candidates = (name, asked.tobytes()), evidence.answers.candidates[name]
    if key in evidence.roles:
        return evidence.roles[key]
    overlap = evidence.overlap[candidates.index]
    own, objects = np.where(asked, overlap, 0.0), matched(overlap, asked)
    shapes = np.where(objects >= 0, objects, evidence.match[candidates.index])
    shapes = np.where((shapes >= 0) & evidence.objects.known[shapes], shapes, -1) if evidence.labelled else shapes
    covered = (own >= HIT).any(axis=0) if len(own) else np.zeros(evidence.labelled, np.bool_)
    missing = np.flatnonzero(asked & ~covered & evidence.objects.known)
    truth = evidence.truth.boxes
    evidence.roles[key] = CandidateSet(
        index=np.concatenate([candidates.index, evidence.detections + missing]).astype(np.int64),
        found=len(candidates.index),
        scores=np.concatenate([candidates.scores, np.full(len(missing), evidence.confidence)]),
        object=np.concatenate([objects, missing]).astype(np.int64),
        shape_of=np.concatenate([shapes, missing]).astype(np.int64),
        overlap=np.concatenate([overlap, iou_2d(truth[missing], truth).reshape(len(missing), evidence.labelled)]),
    )
    return evidence.roles[key]


def relations_of(
    evidence: FrameEvidence, relations: Sequence[str], target: CandidateSet, reference: CandidateSet
) -> np.ndarray:
    """(G, 2, 2, T, R): of G expressions without and with LIFT, without and with SRM.

    `target`, `reference`: roles of all of them, side by side (`together`).
    """
    names = list(dict.fromkeys(relations))
    which = np.array([names.index(name) for name in relations])[:, None, None]
    table = np.stack([evidence.probabilities(name) for name in names])
    base = table[which, target.index[:, :, None], reference.index[:, None, :]]
    shaped = [
        np.where(role.shape_of >= 0, evidence.detections + role.shape_of, role.index) for role in (target, reference)
    ]
    lifted = table[which, shaped[0][:, :, None], shaped[1][:, None, :]]
    # Two candidates that are one object stand in no relation to each other.
    lifted = np.where(shaped[0][:, :, None] == shaped[1][:, None, :], STATE_PROBABILITY[-1], lifted)
    moved = (target.shape_of >= 0)[:, :, None] | (reference.shape_of >= 0)[:, None, :]
    lifted = np.where(moved & np.isfinite(lifted), lifted, base)
    if not evidence.asked_again:
        for k, relation in enumerate(relations):
            ends = [(role.index[k], role.shape_of[k]) for role in (target, reference)]
            lifted[k] = _as_told(evidence, relation, ends, base[k], lifted[k])
    found = np.empty((len(base), 2, 2, *base.shape[1:]))
    found[:, 0] = base[:, None]
    found[:, 1] = lifted[:, None]
    a, b = (np.where(role.object >= 0, role.object, evidence.match_at(role.index)) for role in (target, reference))
    if evidence.labelled:
        known = np.array([STATE_PROBABILITY[k] for k in (-1, 0, 1)])
        states = np.stack([evidence.truth.states[name] for name in names])[which, a[:, :, None], b[:, None, :]]
        both = (a >= 0)[:, :, None] & (b >= 0)[:, None, :]
        one = (a[:, :, None] == b[:, None, :]) & both
        told = np.where(one, STATE_PROBABILITY[-1], known[states.astype(int) + 1])
        judged = (evidence.truth.judged[a[:, :, None], b[:, None, :]] & both) | one
        found[:, :, 1] = np.where(judged[:, None], told[:, None], found[:, :, 1])
    return np.where(np.isfinite(found), found, MIN_RELATION)


def _as_told(
    evidence: FrameEvidence,
    relation: str,
    ends: Sequence[tuple[np.ndarray, np.ndarray]],
    base: np.ndarray,
    lifted: np.ndarray,
) -> np.ndarray:
    """(T, R): relation with LIFT of a scorer that cannot be asked again; `ends`: index and shape_of of both roles.

    It says the same as before, but where a box is off and what stands in for it decides as it did: then the box is what
    it went by, and of a true one it would say so much more or less.
    """
    stand_in = evidence.stand_in(relation)
    if stand_in is None:
        return lifted
    shaped = [np.where(shape_of >= 0, evidence.detections + shape_of, index) for index, shape_of in ends]
    before, after = stand_in[ends[0][0][:, None], ends[1][0]], stand_in[shaped[0][:, None], shaped[1]]
    off = [evidence.off(index, shape_of) for index, shape_of in ends]
    low, high = np.nanquantile(stand_in, [0.05, 0.95]) if np.isfinite(stand_in).any() else (0.0, 1.0)
    explained = (np.abs(base - before) < EXPLAINED * (high - low)) | ((base > HOLDS) == (before > HOLDS))
    changed = explained & (off[0][:, None] | off[1]) & (np.abs(after - before) > 1e-9) & evidence.follows(relation)
    shifted = 1 / (1 + np.exp(-(_odds(base) + _odds(after) - _odds(before))))
    # What it decides of a true box it decides as surely as it does elsewhere: a stand-in never is.
    surest = max(STATE_PROBABILITY[1], float(np.nanmax(base, initial=0.0)))
    sides = ((after > HOLDS) != (before > HOLDS)) | (shifted > SURE) | (shifted < 1 - SURE)
    sure = np.where(after > HOLDS, surest, STATE_PROBABILITY[-1])
    told = np.where(sides, sure, shifted)
    if len(evidence.words):
        told = evidence.words[np.abs(told[..., None] - evidence.words).argmin(axis=-1)]
    return np.where(changed, told, base)


def together(roles: Sequence[CandidateSet]) -> CandidateSet:
    """Roles of G expressions with equally many candidates: each array with an axis of G in front."""
    parts = ("index", "scores", "object", "shape_of", "overlap")
    return CandidateSet(found=0, **{part: np.stack([getattr(role, part) for role in roles]) for part in parts})


def names_of(subset: int) -> tuple[str, ...]:
    """Oracles of a subset, a number with a bit for each."""
    return tuple(name for k, name in enumerate(ALL_ORACLES) if subset >> k & 1)


def shown_oracle(name: str) -> str:
    """Printed name of an oracle: the verdicts taken away by it."""
    return ", ".join(NAMED_BY.get(name, (name,)))


def _odds(p: np.ndarray) -> np.ndarray:
    clear = np.clip(p, STATE_PROBABILITY[-1], STATE_PROBABILITY[1])
    return np.log(clear / (1 - clear))


def decided(p: np.ndarray, holds: float) -> np.ndarray:
    return np.where(p > holds, STATE_PROBABILITY[1], np.where(p < holds, STATE_PROBABILITY[-1], p))
