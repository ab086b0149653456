"""Relations of all pairs of a list of objects, scoring only the new pairs.

A pair is scored as a scene of its own with two objects in it, many at once: the
rule and the network judge each pair by these two alone, and so this gives the
numbers that scoring the whole list gives.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pipeline.answering.objects import SceneObject, appearance_of
from pipeline.geometry.frame import Frame
from pipeline.geometry.viewer import ViewerAxes
from pipeline.language.relation_names import PAIRWISE
from pipeline.proposals.base import Proposals
from pipeline.relations.model import OnnxScorer, combined
from pipeline.relations.pair_measures import AllMeasures, enclosed_share, points_decide, surface_heights
from pipeline.relations.relations import Profile, known_extents, measure_pairs, pair_states, pairwise_states
from pipeline.relations.scorer import RelationScorer, RelationScores, RuleScorer, rule_probabilities, stacked_extents
from pipeline.system.frozen import dataclass

_WHOLE = 0.5
"""From this share of new pairs on everything is scored anew, as one scene."""

_FEW_POINTS = 20

_Identity = tuple[int, str, bytes]


@dataclass(frozen=True)
class PairTables:
    """Scored pairs, with the scorer's inputs."""

    objects: tuple[SceneObject, ...]
    index: dict[_Identity, int]  # Identity of an object -> its index
    # lo, hi: (N, 3) float64: extents along (right, up, forward), metres
    lo: np.ndarray
    hi: np.ndarray
    clouds: tuple[np.ndarray, ...]  # tuple of (M, 3) float32: points along (right, up, forward)
    rows: np.ndarray  # (N, K) float64: what the network is given of each object; K is 0 for the rule
    scores: RelationScores  # Of PAIRWISE
    profile: Profile
    scored: int  # How many unordered pairs were scored anew


def identity(entry: SceneObject) -> _Identity:
    """Identity of an object to a scorer."""
    # `PairTables.objects` keeps the object alive, so that its number stays its own.
    return id(entry.lifted), entry.label, entry.bbox.tobytes()


def score_pairs(
    objects: Sequence[SceneObject],
    viewer: ViewerAxes,
    frame: Frame,
    scorer: RelationScorer,
    profile: Profile,
    before: PairTables | None = None,
) -> PairTables:
    """Score all relations of all ordered pairs.

    `before`: scored by the same scorer and viewer; pairs of two objects that are in it are taken from it, or, where it
    is of another profile and all objects are in it, what a network says of them.
    """
    objects = tuple(objects)
    n = len(objects)
    identities = [identity(o) for o in objects]
    known = {} if before is None else before.index
    old = np.array([known.get(i, -1) for i in identities], np.int64).reshape(-1)
    fresh = np.flatnonzero(old < 0)
    lo, hi = stacked_extents([o.lifted for o in objects])
    axes = viewer.matrix.T.astype(np.float32)
    clouds = tuple(
        o.lifted.points @ axes if k < 0 or before is None else before.clouds[k]
        for o, k in zip(objects, old.tolist(), strict=True)
    )
    rows = _described(objects, fresh, old, viewer, frame, scorer, before)
    other = before is not None and before.profile != profile
    new = np.triu((old < 0)[:, None] | (old < 0)[None, :] | other, 1)
    first, second = np.nonzero(new)
    if not isinstance(scorer, RuleScorer | OnnxScorer):
        # The thresholds of the rule are none of a scorer of one's own.
        scores = scorer.score([o.lifted for o in objects], viewer, appearance_of(objects, frame))
    elif before is None or len(first) > _WHOLE * n * (n - 1) / 2:
        states = pairwise_states(lo, hi, clouds, profile)
        network = None
        if isinstance(scorer, OnnxScorer):
            said = None if before is None or not other or len(fresh) else before.scores.probabilities
            network = scorer.probabilities(rows) if said is None else _of_vocabulary(said, old, scorer)
        scores = combined(states, network, scorer)
    else:
        scores = _renewed(old, first, second, (lo, hi), clouds, rows, scorer, profile, before)
    index = {one: at for at, one in enumerate(identities)}
    return PairTables(objects, index, lo, hi, clouds, rows, scores, profile, len(first))


def _of_vocabulary(probabilities: np.ndarray, old: np.ndarray, network: OnnxScorer) -> np.ndarray:
    """(N, N, V) float64: what a network has said of the objects `old`, from probabilities of PAIRWISE."""
    heads = [PAIRWISE.index(relation) for relation in network.contract.vocabulary]
    return probabilities[old[:, None], old][..., heads]


def _described(
    objects: tuple[SceneObject, ...],
    fresh: np.ndarray,
    old: np.ndarray,
    viewer: ViewerAxes,
    frame: Frame,
    scorer: RelationScorer,
    before: PairTables | None,
) -> np.ndarray:
    if not isinstance(scorer, OnnxScorer):
        return np.zeros((len(objects), 0))
    appearance = appearance_of([objects[k] for k in fresh], frame)
    seen = scorer.features.describe([objects[k].lifted for k in fresh], viewer, appearance)
    new = scorer.with_words(seen, appearance.labels)
    rows = np.empty((len(objects), new.shape[1]))
    rows[fresh] = new
    if before is not None:
        rows[old >= 0] = before.rows[old[old >= 0]]
    return rows


def _renewed(
    old: np.ndarray,
    first: np.ndarray,
    second: np.ndarray,
    extents: tuple[np.ndarray, np.ndarray],
    clouds: tuple[np.ndarray, ...],
    rows: np.ndarray,
    scorer: RuleScorer | OnnxScorer,
    profile: Profile,
    before: PairTables,
) -> RelationScores:
    """Score the pairs (first, second), and take all others from before."""
    n, kept = len(old), np.flatnonzero(old >= 0)
    states = np.empty((n, n, len(PAIRWISE)), np.int8)
    probabilities = np.empty((n, n, len(PAIRWISE)))
    if len(kept):
        block = np.ix_(old[kept], old[kept])
        states[np.ix_(kept, kept)] = before.scores.states[block]
        probabilities[np.ix_(kept, kept)] = before.scores.probabilities[block]
    found = _of_pairs(np.stack([first, second], axis=1), extents, clouds, rows, scorer, profile)
    states[first, second], states[second, first] = found.states[:, 0, 1], found.states[:, 1, 0]
    probabilities[first, second] = found.probabilities[:, 0, 1]
    probabilities[second, first] = found.probabilities[:, 1, 0]
    # Of an object to itself nothing holds, by rule.
    own = np.arange(n)
    states[own, own] = -1
    probabilities[own, own] = rule_probabilities(np.array(-1))
    return RelationScores(PAIRWISE, states, probabilities, found.scored_by)


def _of_pairs(
    pair: np.ndarray,
    extents: tuple[np.ndarray, np.ndarray],
    clouds: Sequence[np.ndarray],
    rows: np.ndarray,
    scorer: RuleScorer | OnnxScorer,
    profile: Profile,
) -> RelationScores:
    """Score pairs of objects, each pair as a scene of two.

    `pair`: (P, 2) int: indices in the lists; `extents`: ((N, 3), (N, 3)) float64: along (right, up, forward), metres;
    `clouds`: sequence of (M, 3); `rows`: (N, K) float64. Returns arrays (P, 2, 2, R): [p, 0, 1] is "first RELATION
    second".
    """
    known = known_extents(*extents)
    lo, hi = (np.where(known[:, None], e, 0.0) for e in extents)
    surface, share = (np.zeros((len(pair), 2, 2)) for _ in range(2))
    measures = measure_pairs(lo[pair], hi[pair], profile)
    seen, held = points_decide(measures, profile)
    # Of a few points one is more than extents can leave out.
    held |= np.array([len(cloud) < _FEW_POINTS for cloud in clouds], np.bool_)[pair][:, :, None]
    for side in (0, 1):
        a, b = pair[:, side], pair[:, 1 - side]
        for one, at in _grouped(b, seen[:, side, 1 - side]):
            heights = surface_heights(lo[a[at]], hi[a[at]], clouds[one], hi[one, 1], profile)
            surface[at, side, 1 - side] = heights
        for one, at in _grouped(a, held[:, side, 1 - side]):
            share[at, side, 1 - side] = enclosed_share(lo[one], hi[one], clouds[one], lo[b[at]], hi[b[at]], profile)
    states = pair_states(AllMeasures(measures, profile, given=(surface, share)), known[pair], PAIRWISE)
    return combined(states, scorer.probabilities(rows[pair]) if isinstance(scorer, OnnxScorer) else None, scorer)


def _grouped(indices: np.ndarray, wanted: np.ndarray) -> list[tuple[int, np.ndarray]]:
    """Group the wanted pairs ((P,) bool) by object ((P,) indices)."""
    order = np.flatnonzero(wanted)
    order = order[np.argsort(indices[order], kind="stable")]
    if not len(order):
        return []
    cuts = np.flatnonzero(np.diff(indices[order])) + 1
    return [(int(indices[group[0]]), group) for group in np.split(order, cuts)]


def detection_keys(name: str, found: Proposals) -> tuple[str, ...]:
    """Key of each detection of a run for a class name, in the run's order.

    A key means the same detection after a change of K, of a threshold, of an edit. "#12" is the detection with the
    detector's own identity 12. Where the detector has none, "chair/3" is the third best by score of all it found when
    asked for "chair", before anything is suppressed or cut off. The first kind has no slash and the second always has
    one, so that no key can be mistaken for another.

    `name`: as it was asked; `found`: all of the run.
    """
    index = np.empty(len(found), np.int64)
    index[np.argsort(-found.scores, kind="stable")] = np.arange(1, len(found) + 1)
    return tuple(
        f"#{number}" if number >= 0 else f"{name}/{at}" for number, at in zip(found.ids.tolist(), index, strict=True)
    )
