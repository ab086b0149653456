"""Rank an expression with every subset of the oracles (see `oracles`); a sentence by solving its whole tree anew."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from math import prod
from typing import Any

import numpy as np

from pipeline.answering.evidence import ATTRIBUTE_HOLDS, HOLDS, SceneEvidence
from pipeline.answering.objects import SceneObject
from pipeline.answering.pair_table import (
    MIN_RELATION,
    PairTable,
    RankConfig,
    ScoredPair,
    Side,
    pair_table,
    side,
)
from pipeline.answering.ranking import Candidates, SolvedReading, solve
from pipeline.diagnosis.frame_evidence import FrameEvidence
from pipeline.diagnosis.oracles import (
    ALL_ORACLES,
    CONF,
    LIFT,
    RECALL,
    SRM,
    SUBSETS,
    CandidateSet,
    OracleScores,
    decided,
    levelled,
    margins_of,
    relations_of,
    role_of,
    together,
)
from pipeline.geometry.frame import Frame
from pipeline.geometry.viewer import ViewerAxes
from pipeline.labels.cases import HIT, Case, Meant
from pipeline.language.attributes import Attribute
from pipeline.language.tree import Attachment
from pipeline.relations.scorer import probabilities_beyond
from pipeline.system.frozen import dataclass

PAIRS_AT_ONCE = 1 << 20
"""Pairs, under all subsets, of the expressions that are ranked together: a few dozen megabytes."""
_Roles = tuple[CandidateSet, CandidateSet]


def substitute(evidence: FrameEvidence, case: Case) -> OracleScores:
    """Rank an expression's pairs with every subset of the oracles, on its gold triple; a sentence as read."""
    return next(substitutions(evidence, [case]))


def substitutions(evidence: FrameEvidence, cases: Sequence[Case]) -> Iterator[OracleScores]:
    """Rank the pairs of each expression as `substitute` does, those with equally many candidates together."""
    # An imported ranking, and a scorer that cannot be asked again, know of one expression only.
    most = PAIRS_AT_ONCE if evidence.asked_again and evidence.answers.source.config.rank.rule is None else 0
    waiting: list[tuple[Case, _Roles]] = []
    size = 0
    for case in cases:
        if case.meant is not None:
            yield from _ranked(evidence, waiting)
            waiting, size = [], 0
            yield substitute_sentence(evidence, case, case.meant)
            continue
        target, reference = (role_of(evidence, name, asked) for name, asked in evidence.truth.roles(case))
        waiting.append((case, (target, reference)))
        size += SUBSETS * len(target.index) * len(reference.index)
        if size >= most:
            yield from _ranked(evidence, waiting)
            waiting, size = [], 0
    yield from _ranked(evidence, waiting)


def _ranked(evidence: FrameEvidence, asked: Sequence[tuple[Case, _Roles]]) -> list[OracleScores]:
    """Rank plain expressions, in their order."""
    alike: dict[tuple[int, int], list[int]] = {}
    for k, (_, (target, reference)) in enumerate(asked):
        alike.setdefault((len(target.index), len(reference.index)), []).append(k)
    found: dict[int, OracleScores] = {}
    for places in alike.values():
        cases, roles = zip(*(asked[k] for k in places), strict=True)
        found |= zip(places, _ranked_together(evidence, cases, roles), strict=True)
    return [found[k] for k in range(len(asked))]


def _ranked_together(evidence: FrameEvidence, cases: Sequence[Case], roles: Sequence[_Roles]) -> Iterator[OracleScores]:
    """Rank G plain expressions with equally many candidates, each under every subset."""
    truth, config = evidence.truth, evidence.answers.source.config.rank
    both = tuple(together(one) for one in zip(*roles, strict=True))
    target, reference = both
    p = relations_of(evidence, [case.relation for case in cases], target, reference)
    every = np.arange(SUBSETS)
    lift, srm, conf = (((every & bit) > 0).astype(int) for bit in (LIFT, SRM, CONF))
    here = target.index[:, :, None], reference.index[:, None, :]
    same, same_box = evidence.same[here], evidence.same_box[here]
    a, b = target.shape_of[:, :, None], reference.shape_of[:, None, :]
    # LIFT also gives the true masks, and those of two objects are never alike.
    same_lifted = np.where((a >= 0) & (b >= 0) & (a != b), same_box, same)
    unseen = [np.arange(one.index.shape[1]) >= np.array([[r[k].found] for r in roles]) for k, one in enumerate(both)]
    hidden = (unseen[0][:, :, None] | unseen[1][:, None, :])[:, None] & ((every & RECALL) == 0)[:, None, None]
    forbidden = np.where(lift[:, None, None] > 0, same_lifted[:, None], same[:, None]) | hidden
    weights = config.target_weight, config.reference_weight
    ends = [_side(one, conf, weight, config.true_scores) for one, weight in zip(both, weights, strict=True)]
    table = _table(ends, p[:, lift, srm], forbidden, evidence.mask_sizes, config)
    pairs = np.stack([truth.acceptable_pairs(case) for case in cases]).astype(np.float32)
    hits = [one.overlap >= HIT for one in both]
    covered = (hits[0].astype(np.float32) @ pairs @ hits[1].astype(np.float32).transpose(0, 2, 1)) > 0
    acceptable = np.zeros((len(cases), evidence.labelled), np.bool_)
    for k, case in enumerate(cases):
        acceptable[k, case.acceptable] = True
    right = np.asarray((hits[0] & acceptable[:, None]).any(axis=2))
    shape = len(cases), SUBSETS
    winners = table.first().reshape(shape)
    of_all = np.repeat(covered.reshape(len(cases), -1), SUBSETS, axis=0)
    margins = margins_of(levelled(table), of_all).reshape(shape)
    first = _part(table, [end.index[:, 0] for end in ends], np.s_[:, 0]).first(covered)
    for k, (mine, its) in enumerate(roles):
        yield OracleScores(
            target=mine,
            reference=its,
            table=_part(table, [mine.index, its.index], k),
            p_relation=p[k],
            covered=covered[k],
            right=right[k],
            winners=winners[k],
            margins=margins[k],
            first_acceptable=int(first[k]),
        )


def _side(roles: CandidateSet, conf: np.ndarray, weight: float, scores: tuple[float, float]) -> Side:
    """G roles under every subset; `conf` marks the subsets with true confidences, `scores` are these."""
    true = np.where(roles.object >= 0, *scores)
    both = side(roles.index, np.stack([roles.scores, true], axis=1), weight)
    of_subsets = both.scores[:, conf]
    return Side(np.broadcast_to(roles.index[:, None], of_subsets.shape), of_subsets, both.log[:, conf])


def _part(table: PairTable, index: Sequence[np.ndarray], at: Any) -> PairTable:
    """Part of the scenes, with the index of its target and reference."""
    target, reference = (
        Side(own, end.scores[at], end.log[at]) for own, end in zip(index, (table.target, *table.ends), strict=True)
    )
    return PairTable(target, (reference,), table.p_relation[at], table.log_score[at], table.sizes, table.config)


def _table(
    ends: Sequence[Side], p: np.ndarray, forbidden: np.ndarray, sizes: np.ndarray, config: RankConfig
) -> PairTable:
    """Pairs of G expressions under every subset; by an imported ranking of one."""
    target, *others = ends
    if config.rule is None:
        return pair_table(target, others, p, forbidden, sizes, config)
    one, *its = (Side(end.index[0, 0], end.scores[0], end.log[0]) for end in ends)
    ranked = pair_table(one, its, p[0], forbidden[0], sizes, config)
    return PairTable(target, tuple(others), p, ranked.log_score[None], sizes, config)


@dataclass(frozen=True, eq=False)
class SentenceScores(OracleScores):
    """Sentence pairs under all subsets of the oracles, with the solved tree."""

    tree: SubstitutedTree

    def pair_at(self, at: int) -> ScoredPair:
        """Pair of `plain` with links and factors."""
        solved, columns = self.tree.solved(0), self.covered.shape[1]
        pair = solved.pair(at // columns * prod(solved.table.shape[1:]) + at % columns)
        return self.tree.of_frame(replace(self.plain.pair(at), links=pair.links, factors=pair.factors))

    def decided_margin(self, subset: int) -> float:
        """Margin by decided relations and attributes."""
        table = self.tree.solved(subset, decide=True).table
        return float(margins_of(table, self.covered[: table.shape[0], : prod(table.shape[1:])])[0])


def substitute_sentence(evidence: FrameEvidence, case: Case, meant: Meant) -> SentenceScores:
    """Rank a sentence's pairs with every subset of the oracles; `meant` is that of the case."""
    tree, top = SubstitutedTree(evidence, meant), meant.root.pairwise
    roles = [tree.roles[name] for name in (meant.root.label, *(() if top is None else (top.nodes[0].label,)))]
    shape = tuple(len(role.index) for role in roles)
    subsets = 2 * SUBSETS if meant.attributes else SUBSETS
    log, p = np.full((subsets, *shape), -np.inf), np.full((subsets, *shape), MIN_RELATION)
    sides = [np.zeros((2, subsets, n)) for n in shape]
    for subset in range(subsets):
        table = tree.solved(subset).table
        part = (subset, *(slice(n) for n in table.shape))
        log[part], p[part] = table.log_score, table.p_relation
        for both, part_side in zip(sides, (table.target, *table.ends), strict=True):
            both[:, subset, : len(part_side.index)] = part_side.scores, part_side.log
    target, *ends = (Side(role.index, *both) for role, both in zip(roles, sides, strict=True))
    config = evidence.answers.source.config.rank
    hits = [(role.overlap >= HIT).astype(np.int32) for role in roles]
    right = np.asarray(hits[0][:, case.acceptable].any(axis=1))
    covered = right[:, None]
    if top is not None:
        covered = (hits[0] @ evidence.truth.acceptable_pairs(case).astype(np.int32) @ hits[1].T) > 0
    table = PairTable(target, tuple(ends), p, log, evidence.mask_sizes, config)
    return SentenceScores(
        target=roles[0],
        reference=_no_one(evidence) if top is None else roles[1],
        table=table,
        p_relation=p,
        covered=covered,
        right=right,
        winners=table.first(),
        margins=margins_of(levelled(table), covered),
        first_acceptable=int(table.scene(0).first(covered)[0]),
        tree=tree,
    )


class SubstitutedTree:
    """Sentence solved with some modules replaced by the truth.

    Candidates of all names stand in a single list of G entries, those of each name under its own.
    """

    def __init__(self, evidence: FrameEvidence, meant: Meant) -> None:
        self._evidence, self._meant = evidence, meant
        self.roles = {name: role_of(evidence, name, asked) for name, asked in meant.classes.items()}
        stops = np.cumsum([len(role.index) for role in self.roles.values()])
        self._entries = {
            name: np.arange(stop - len(role.index), stop)
            for (name, role), stop in zip(self.roles.items(), stops, strict=True)
        }
        parts = ("index", "scores", "object", "shape_of", "overlap")
        joined = {part: np.concatenate([getattr(role, part) for role in self.roles.values()]) for part in parts}
        self._all = everything = CandidateSet(found=0, **joined)
        grid, shape = np.ix_(everything.index, everything.index), everything.shape_of
        two = (shape[:, None] >= 0) & (shape[None] >= 0) & (shape[:, None] != shape[None])
        same = evidence.same[grid]
        self._same = same, np.where(two, evidence.same_box[grid], same)
        self._relations: dict[str, np.ndarray] = {}
        self._scenes: dict[tuple[int, bool, bool], SubstitutedEvidence] = {}
        self._judged: tuple[dict, dict] = ({}, {})

    def solved(self, subset: int, decide: bool = False) -> SolvedReading:
        """Tree under a subset of the oracles; with `decide` relations and attributes as in `decided_margin`."""
        recall, lift, srm, conf, attribute = (subset >> k & 1 for k in range(len(ALL_ORACLES)))
        every = self._all
        true = self._evidence.answers.source.config.rank.true_scores
        scores = np.where(every.object >= 0, *true) if conf else every.scores
        candidates = {}
        for name, role in self.roles.items():
            there = self._entries[name][: None if recall else role.found]
            candidates[name] = Candidates(there, scores[there])

        objects, known = self._evidence.answers.objects, self._evidence.detections
        ids = [objects[k].id if k < known else -1 for k in every.index.tolist()]
        beyond = getattr(self._evidence.answers.source.scorer, "beyond", {})

        def lookup(attachment: Attachment, heads: np.ndarray, ends: Sequence[np.ndarray]) -> np.ndarray:
            relation = attachment.relation
            if relation not in self._evidence.truth.states:
                given = beyond.get(relation)
                # The truth of these is what the rule says of true boxes.
                true = int(lift or (srm and given is not None))
                lifted = [o.lifted for o in self._scene(true, False, False).objects]
                given = None if srm else self._still_given(given, ids) if lift else given
                p = probabilities_beyond(relation, lifted, heads, ends, self._same[lift], given, ids)
            else:
                if relation not in self._relations:
                    one = together([every])
                    self._relations[relation] = relations_of(self._evidence, [relation], one, one)[0]
                table = self._relations[relation][lift, srm]
                p = table[np.ix_(ends[0], heads)].T if attachment.inverse else table[np.ix_(heads, ends[0])]
            return decided(p, HOLDS) if decide else p

        scene = self._scene(lift, bool(attribute), decide)
        config = self._evidence.answers.source.config.rank.of(ids)
        sizes = self._evidence.mask_sizes[every.index]
        return solve(self._meant.root, candidates, lookup, self._same[lift], sizes, config, scene)

    def _still_given(
        self, given: Mapping[tuple[int, ...], float] | None, ids: Sequence[int]
    ) -> Mapping[tuple[int, ...], float] | None:
        """Given probabilities of objects with true boxes: true boxes say nothing else of them."""
        if not given:
            return given
        off = self._evidence.off(self._all.index, self._all.shape_of)
        wrong = {i for i, gone in zip(ids, off.tolist(), strict=True) if gone}
        return {row: p for row, p in given.items() if wrong.isdisjoint(row)}

    def attribute(self, name: str, attribute: Attribute) -> np.ndarray | None:
        """(K,) float64: attribute of all candidates of a name by true pixels and boxes; None where not judged."""
        return self._scene(1, False, False).attribute(attribute, self._entries[name])

    def of_frame(self, pair: ScoredPair) -> ScoredPair:
        """Pair with entries of this list renumbered as in the evidence."""
        index = self._all.index.tolist()
        return replace(
            pair,
            factors=tuple(replace(f, object=index[f.object]) for f in pair.factors),
            links=tuple(
                replace(k, a=index[k.a], b=index[k.b], c=None if k.c is None else index[k.c]) for k in pair.links
            ),
        )

    def _scene(self, lift: int, attribute: bool, decide: bool) -> SubstitutedEvidence:
        key = (lift, attribute, decide)
        if key not in self._scenes:
            context = self._evidence.answers.context
            told: dict[str, np.ndarray] = {}
            for (name, text), known in self._meant.attributes.items() if attribute else ():
                entries, objects = self._entries[name], self.roles[name].object
                told.setdefault(text, np.full(len(self._all.index), np.nan))[entries] = np.where(
                    objects >= 0, known[objects], np.nan
                )
            self._scenes[key] = SubstitutedEvidence(
                self._objects(lift), context.frame, context.viewer, self._judged[lift], told, decide
            )
        return self._scenes[key]

    def _objects(self, lift: int) -> list[SceneObject]:
        every, evidence = self._all, self._evidence
        shown = np.where(every.shape_of >= 0, evidence.detections + every.shape_of, every.index)
        return [evidence.object_at(int(k)) for k in (shown if lift else every.index)]


class SubstitutedEvidence(SceneEvidence):
    """Attributes of a sentence's candidates, with some replaced by the truth.

    `told`: (G,) float64 by attribute, NaN for kept values; `decide`: attributes count as .99 where present and .01
    elsewhere; `judged`: cache of judgements by pixels and boxes.
    """

    def __init__(
        self,
        objects: Sequence[SceneObject],
        frame: Frame,
        viewer: ViewerAxes,
        judged: dict[tuple[str, bytes], np.ndarray | None],
        told: dict[str, np.ndarray],
        decide: bool,
    ) -> None:
        super().__init__(objects, frame, viewer)
        self._judged, self._told, self._decides = judged, told, decide

    def attribute(self, attribute: Attribute, index: np.ndarray) -> np.ndarray | None:
        """Attribute as by `SceneEvidence.attribute`, replaced where told."""
        text = str(attribute)
        key = text, index.tobytes()
        if key not in self._judged:
            self._judged[key] = super().attribute(attribute, index)
        found = self._judged[key]
        if text in self._told:
            told = self._told[text][index]
            found = np.where(np.isnan(told), HOLDS if found is None else found, told)
        return decided(found, ATTRIBUTE_HOLDS) if self._decides and found is not None else found


def _no_one(evidence: FrameEvidence) -> CandidateSet:
    """Empty reference."""
    none = np.array([-1])
    return CandidateSet(none, 1, np.ones(1), none, none, np.zeros((1, evidence.labelled)))
