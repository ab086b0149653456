"""Rule profiles: named, hashed sets of rules that give every ordered pair its states and margins.

A second opinion may make a label undecided, where a relation network does not agree with the rules.
The rules see the extents that one view shows; the network has learned from
exact geometry what objects are like behind that, and that one the image border
cuts goes on. It never decides a label: it can only turn T or F into U.
On rooms of another maker (tests/box_worlds.py) sign flips against exact geometry
fall from 1.7 to 0.1 (cameras held high) or from 9.6 to 0.5 (held low) in a
thousand, for three to four per cent more undecided cells; on crowded rooms of a
third maker, whose code is removed (commit 86560629 holds it), from 8 to 19 to
between 1.3 and 2.1, for four to seven per cent more.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Collection, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.datasets import GivenExpression
from pipeline.geometry.lifting import LiftedObject
from pipeline.geometry.viewer import ViewerAxes
from pipeline.language.relation_names import DIRECTIONAL, HORIZONTAL, PAIRWISE, RELATIONS, version_numbers
from pipeline.relations import make_scorer, shipped_network
from pipeline.relations.features import Appearance
from pipeline.relations.model import OnnxScorer
from pipeline.relations.pair_measures import AllMeasures
from pipeline.relations.relations import (
    PROFILE,
    F,
    Profile,
    T,
    U,
    known_extents,
    measure_pairs,
    pair_margins,
    pair_states,
)
from pipeline.system.errors import InputError, require
from pipeline.system.frozen import dataclass
from pipeline.system.onnx_session import file_hash


@dataclass(frozen=True)
class JudgedPairs:
    """All ordered pairs of a frame, judged."""

    states: np.ndarray
    """(N, N, R) int8: 1 T, 0 U, -1 F, in the order of PAIRWISE."""
    margins: np.ndarray
    """(N, N, R) float64: metres: positive for T, negative for F, 0 for U."""
    distance: np.ndarray
    """(N, N) float64: metres between the extents of the two, NaN where either is unknown."""
    doubted: np.ndarray | None = None
    """(N, N) int32 or None: bit k is set where relation k is U for a second opinion's sake alone."""


RuleJudge = Callable[..., JudgedPairs]
"""Rules that judge every ordered pair of a frame's objects, called with `lo`, `hi`, `centroids`, (N, 3) float64 metres
along (right, up, forward); `clouds`, the objects' points along the same axes, a sequence of (M, 3) or None; and
`relations`, those that are wanted: the others may be left at U with margin 0."""


@dataclass(frozen=True)
class RuleProfile:
    """A set of rules under a name."""

    name: str
    relations: tuple[str, ...]
    """Those that the profile judges."""
    parameters: dict[str, Any]
    """Every threshold, as JSON."""
    judge: RuleJudge

    @property
    def hash(self) -> str:
        """sha256 of name, relations and parameters as canonical JSON."""
        return self.hash_of(self.relations)

    @property
    def hashes(self) -> set[str]:
        """`hash`, and the hashes of the same rules before newer relations were declared."""
        since = {name: version_numbers(RELATIONS[name].since) for name in self.relations}
        return {self.hash_of([name for name in since if since[name] <= version]) for version in since.values()}

    def hash_of(self, relations: Sequence[str]) -> str:
        return canonical_hash({"name": self.name, "relations": relations, "parameters": self.parameters})


def canonical_hash(content: Any) -> str:
    """sha256 of JSON with sorted keys, without white space, numbers as Python writes them."""
    return hashlib.sha256(
        json.dumps(content, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False).encode()
    ).hexdigest()


def judge_viewer_cone(
    lo: np.ndarray,
    hi: np.ndarray,
    centroids: np.ndarray,
    clouds: Sequence[np.ndarray] | None,
    relations: Collection[str] = PAIRWISE,
) -> JudgedPairs:
    """`viewer-cone-v1`: see `pipeline.relations.relations`. Centroids play no part."""
    profile = Profile()
    known = known_extents(lo, hi)
    pairs = measure_pairs(np.where(known[:, None], lo, 0.0), np.where(known[:, None], hi, 0.0), profile)
    # Those that are not of the extents' axes alone cost the most.
    names = DIRECTIONAL if set(relations) <= set(DIRECTIONAL) else PAIRWISE
    measured = AllMeasures(pairs, profile, clouds)
    # A relation after the other: numbers side by side are worked through several times as fast.
    shape, columns = (len(PAIRWISE), len(lo), len(lo)), [PAIRWISE.index(name) for name in names]
    found = pair_states(measured, known, names)
    both = known[:, None] & known[None, :] & ~np.eye(len(lo), dtype=np.bool_)
    states, margins = np.full(shape, U, np.int8), np.zeros(shape)
    states[columns] = np.moveaxis(found, -1, 0)
    margins[columns] = np.where(both, np.moveaxis(pair_margins(measured, found, names), -1, 0), 0.0)
    distance = np.where(both, np.linalg.norm(pairs.gap, axis=2), np.nan)
    return JudgedPairs(np.moveaxis(states, 0, -1), np.moveaxis(margins, 0, -1), distance)


SA_SCALE = 0.6
SA_COSINE = 0.6
SA_REACH_EXTENTS, SA_LEAST_REACH, SA_GREATEST_REACH = 2.0, 0.1, 1.0
"""The published thresholds of Semantic Abstraction; lengths in its scene units, of which one metre is 0.6."""


def judge_semantic_abstraction(
    lo: np.ndarray,
    hi: np.ndarray,
    centroids: np.ndarray,
    clouds: Sequence[np.ndarray] | None,
    relations: Collection[str] = PAIRWISE,
) -> JudgedPairs:
    """Semantic Abstraction's published geometry, in the viewer's axes.

    With disp from the target's mean point to the reference's, in scene units: a
    pair is related where |disp| <= min(max(2 max(reference's extents in plan),
    0.1), 1), and along the axis with which disp makes a cosine above 0.6. A pair
    that is on or in one another gets no direction. Their on and in come from the
    simulator; here they are those of `viewer-cone-v1`. There is no undecided band.
    """
    return semantic_abstraction_directions(lo, hi, centroids, judge_viewer_cone(lo, hi, centroids, clouds))


def semantic_abstraction_directions(
    lo: np.ndarray, hi: np.ndarray, centroids: np.ndarray, contact: JudgedPairs
) -> JudgedPairs:
    """Directions of `judge_semantic_abstraction`, given contact (on, in)."""
    known = known_extents(lo, hi) & np.isfinite(centroids).all(axis=1)
    both = known[:, None] & known[None, :] & ~np.eye(len(lo), dtype=np.bool_)
    disp = (centroids[:, None] - centroids[None, :]) * SA_SCALE
    disp = np.where(both[..., None], disp, 0.0)
    length = np.linalg.norm(disp, axis=2)
    plan = np.where(known, np.nan_to_num(hi - lo)[:, [0, 2]].max(axis=1), 0.0) * SA_SCALE
    reach = np.minimum(np.maximum(SA_REACH_EXTENTS * plan, SA_LEAST_REACH), SA_GREATEST_REACH)[None, :]
    states, margins = np.full_like(contact.states, F), np.zeros_like(contact.margins)
    on_in = [PAIRWISE.index("on"), PAIRWISE.index("in")]
    held = contact.margins[..., on_in].max(axis=2)
    held = np.maximum(held, held.T)
    joined = (contact.states[..., on_in] == T).any(axis=2)
    joined |= joined.T
    cosine = np.divide(disp, length[..., None], out=np.zeros_like(disp), where=length[..., None] > 0)
    for name, (axis, sign) in HORIZONTAL.items():
        along = sign * cosine[..., axis]
        in_cone = length * np.sin(np.arccos(SA_COSINE) - np.arccos(np.clip(along, -1, 1)))
        # Beyond a right angle to the cone the sine falls again; the distance itself is then the miss.
        in_cone = np.where(along < 0, np.minimum(in_cone, -length * np.sqrt(1 - SA_COSINE**2)), in_cone)
        slack = np.minimum(np.minimum(in_cone, reach - length) / SA_SCALE, -held)
        holds = (along > SA_COSINE) & (length <= reach) & ~joined
        k = PAIRWISE.index(name)
        states[..., k] = np.where(holds, T, F)
        margins[..., k] = np.where(holds, np.maximum(slack, 0), np.minimum(slack, 0))
    for k in on_in:
        states[..., k], margins[..., k] = contact.states[..., k], contact.margins[..., k]
    states[~both] = U
    margins[~both] = 0.0
    states[np.eye(len(lo), dtype=np.bool_)] = F
    return JudgedPairs(states, margins, contact.distance)


GIVEN = "given"
"""The profile whose relations are the dataset's own."""


def judge_nothing(lo: np.ndarray, hi: np.ndarray, centroids: np.ndarray, *_: Any, **__: Any) -> JudgedPairs:
    """`given`: geometry decides nothing, every pair is undecided until `as_given`."""
    measured = judge_viewer_cone(lo, hi, centroids, None, ())
    states = np.full(measured.states.shape, U, np.int8)
    states[np.eye(len(lo), dtype=np.bool_)] = F
    return JudgedPairs(states, np.zeros(measured.margins.shape), measured.distance)


PROFILES: dict[str, RuleProfile] = {
    p.name: p
    for p in (
        RuleProfile(PROFILE, PAIRWISE, asdict(Profile()), judge_viewer_cone),
        RuleProfile(
            "semantic-abstraction-published",
            (*HORIZONTAL, "on", "in"),
            {
                "scale": SA_SCALE,
                "cosine": SA_COSINE,
                "reach_extents": SA_REACH_EXTENTS,
                "least_reach": SA_LEAST_REACH,
                "greatest_reach": SA_GREATEST_REACH,
                "contact": asdict(Profile()),
            },
            judge_semantic_abstraction,
        ),
        RuleProfile(GIVEN, (*HORIZONTAL, "on", "in"), {}, judge_nothing),
    )
}
"""The profiles by name. A new one is a `RuleJudge` and an entry here."""


def profile_of(name: str) -> RuleProfile:
    """Rule profile by name.

    Raises InputError: there is none.
    """
    require(name in PROFILES, "no such rule profile", got=repr(name), expected=" | ".join(PROFILES))
    return PROFILES[name]


def as_given(judged: JudgedPairs, numbers: Sequence[int], given: Sequence[GivenExpression]) -> JudgedPairs:
    """Judgements with the states given by a dataset's expressions.

    An expression that means one target and one reference makes its relation T,
    and what no expression says of that pair F. Where several references (or
    targets) may be meant, their pairs stay U in that relation. A pair of which
    nothing is said stays U throughout: it may have been passed over.

    `judged`: of N objects; its states are U where nothing is given. `numbers`: the objects' indices in the dataset's
    own list of annotations. Margins are 0: no geometry was asked.
    """
    index_of = {number: k for k, number in enumerate(numbers)}
    sure, maybe = np.zeros(judged.states.shape, np.bool_), np.zeros(judged.states.shape, np.bool_)
    for expression in given:
        column = PAIRWISE.index(expression.relation)
        ends = [(a, b) for a in expression.target_indices for b in expression.reference_indices if a != b]
        for a, b in ends:
            if a in index_of and b in index_of:
                (sure if len(ends) == 1 else maybe)[index_of[a], index_of[b], column] = True
    states = judged.states.copy()
    states[sure.any(axis=2) & ~np.eye(len(numbers), dtype=np.bool_)] = F
    states[maybe & ~sure] = judged.states[maybe & ~sure]
    states[sure] = T
    return replace(judged, states=states, margins=np.zeros(judged.margins.shape))


NONE, TRAINED = "none", "trained"
LEAST_OF_T, MOST_OF_F = 0.95, 0.05
"""The network agrees with T from this probability on, and with F up to that one. Chosen so that in crowded rooms of
other makers about 2 in 1,000 cells at most are flipped. On rooms of analytic solids, where its
probabilities were calibrated, it is 1.1 in 1,000 decided ones (by 0.9 and 0.1 it would be 1.7, with one in a hundred
more decided)."""


def open_second_opinion(name: str) -> OnnxScorer | None:
    """Open a network by name: "trained" (the shipped one), the path of an ONNX file, or "none".

    Raises InputError: there is no such network, or it is a softmax network.
    """
    if name == NONE:
        return None
    scorer = make_scorer(name)
    if not isinstance(scorer, OnnxScorer):
        raise InputError("a second opinion is a network", got=repr(name), expected="trained, none, or an ONNX file")
    if scorer.contract.output != "sigmoid":
        # Its probabilities say which relation fits best, not whether one holds.
        raise InputError("a second opinion judges each relation alone", got="a softmax network", path=name)
    return scorer


def fingerprint(name: str) -> str:
    """Hash of the opinion's network file.

    Raises InputError: there is no such file.
    """
    if name == NONE:
        return NONE
    path = shipped_network() if name == TRAINED else Path(name)
    require(path.is_file(), "a second opinion is a network", got=repr(name), expected="trained, none, or an ONNX file")
    return file_hash(path)


def doubted(
    judged: JudgedPairs,
    network: OnnxScorer,
    objects: Sequence[LiftedObject],
    viewer: ViewerAxes,
    appearance: Appearance | None = None,
) -> JudgedPairs:
    """The judgements with U where the network finds T not likely enough, or F too likely.

    The network answers inverse questions alike, and so inverse labels stay inverse.
    """
    states, margins = judged.states.copy("K"), judged.margins.copy("K")
    apart = ~np.eye(len(states), dtype=np.bool_)
    found = network.of_pairs(objects, viewer, appearance, apart & (states != U).any(axis=2))
    bits = np.zeros(states.shape[:2], np.int32) if judged.doubted is None else judged.doubted.copy()
    for k, relation in enumerate(network.contract.vocabulary):
        column = PAIRWISE.index(relation)
        state, p = states[..., column], found[..., k]
        opposed = ((state == T) & (p < LEAST_OF_T)) | ((state == F) & (p > MOST_OF_F))
        opposed &= apart
        state[opposed] = U
        margins[..., column][opposed] = 0.0
        bits |= opposed.astype(np.int32) << column
    return JudgedPairs(states, margins, judged.distance, bits)
