"""Decision map: winning answer for each position of an object on the floor.

The object slides on the level plane at its own height. Its pairs with the other
candidates are scored for all cells at once; everything else stays as it is.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from time import perf_counter
from typing import Any

import cv2
import numpy as np

from pipeline.answering.ask import relation_lookup, scene_evidence
from pipeline.answering.objects import SceneObject
from pipeline.answering.pair_table import PairTable, RankConfig, one_object_twice, pair_table, side
from pipeline.answering.ranking import rank
from pipeline.diagnosis.whatif.edits import Edits
from pipeline.diagnosis.whatif.pair_tables import describe
from pipeline.diagnosis.whatif.rerun import Baseline, Outcome, rerun, with_superlatives
from pipeline.geometry.palette import instance_colors
from pipeline.language.relation_names import PAIRWISE
from pipeline.language.tree import Node
from pipeline.relations.model import OnnxScorer, combined
from pipeline.relations.pair_measures import AllMeasures, enclosed_share, surface_heights
from pipeline.relations.predicates import pair_states, predicates_of
from pipeline.relations.relations import Profile, measure_pairs
from pipeline.relations.scorer import RuleScorer, stacked_extents
from pipeline.system.errors import require

_PairTable = dict[int, np.ndarray]
"""Other object -> (C, 2, 9): P("moved RELATION other") and P("other RELATION moved") at each cell."""
_Found = tuple[np.ndarray, np.ndarray, np.ndarray]
CELL_PIXELS = 12
_INK, _PAPER, _NOTHING = (20, 20, 20), (245, 245, 245), (200, 200, 200)
_LINE_PIXELS = 22

CELLS = 48
MOST_CELLS = 256
MARGIN = 0.5
"""Metres of floor around the objects."""
_AT_ONCE = 512
"""Cells whose pairs are ranked at once."""


@dataclass(frozen=True)
class DecisionMap:
    """Winning answers by position of an object."""

    key: str  # The object that is moved
    # right, forward: (G,) float64: where the centre of its extents stands in each column and row, metres along the
    # viewer's axes
    right: np.ndarray
    forward: np.ndarray
    floor: float  # Height of the lowest object, metres along up
    keys: tuple[str, ...]  # All objects
    # winner, reference: (G, G) int64: index in `keys` of the target and of the reference that win at [row of forward,
    # column of right]; -1 where no pair is allowed
    winner: np.ndarray
    reference: np.ndarray
    margin: np.ndarray  # (G, G) float64: posterior of the winning pair less that of the next
    corners: np.ndarray  # (G + 1, G + 1, 3) float64: of the cells, on the floor, camera frame, metres
    seconds: float  # What it cost


def decision_map(baseline: Baseline, edits: Edits, key: str, cells: int = CELLS, margin: float = MARGIN) -> DecisionMap:
    """Compute the winner with the object at each cell of the floor.

    Parameters
    ----------
    key : str
        Any candidate of the question, target or reference.
    cells : int
        On each side.
    margin : float
        Floor around the objects, metres.

    Raises
    ------
    InputError
        The object is no candidate or has no place in space, the question has no answer, or the scorer is one that
        judges a list only as a whole.
    """
    start = perf_counter()
    require(
        2 <= cells <= MOST_CELLS, "a decision map needs a number of cells", got=cells, expected=f"2 to {MOST_CELLS}"
    )
    require(
        (np.isfinite(margin) and 0 <= margin <= 100),
        "the margin of a decision map is out of range",
        got=margin,
        expected="0 to 100 m",
    )
    outcome = rerun(baseline, edits)
    trace = outcome.trace
    require(key in outcome.keys, f"there is no candidate {key!r}", expected=", ".join(outcome.keys) or "any at all")
    require(trace.ranking is not None, "a question without candidates for every name has no decision map")
    lo, hi = stacked_extents([o.lifted for o in trace.objects])
    moved = outcome.keys.index(key)
    require(
        np.isfinite(lo[moved]).all() and trace.objects[moved].lifted.box is not None,
        f"{key} has no place in space, and so it cannot be moved",
    )
    known = np.isfinite(lo).all(axis=1)
    low, high = lo[known].min(axis=0), hi[known].max(axis=0)
    edge_r, edge_f = (np.linspace(low[k] - margin, high[k] + margin, cells + 1) for k in (0, 2))
    right, forward = ((e[1:] + e[:-1]) / 2 for e in (edge_r, edge_f))
    shift = np.zeros((cells * cells, 3))
    shift[:, 2], shift[:, 0] = (grid.ravel() for grid in np.meshgrid(forward, right, indexing="ij"))
    middle = (lo[moved] + hi[moved]) / 2
    shift[:, [0, 2]] -= middle[[0, 2]]
    pairs = _pair_probabilities(baseline, edits, outcome, moved, shift)
    simple = _simple(trace.query.readings)
    config = replace(baseline.source.config.rank, **edits.rank)
    config = config.of([o.id for o in trace.objects], baseline.same(trace.objects))
    found = (_vectorised if simple else _one_by_one)(baseline, edits, outcome, moved, shift, pairs, config)
    corners = np.empty((cells + 1, cells + 1, 3))
    corners[..., 2], corners[..., 0] = np.meshgrid(edge_f, edge_r, indexing="ij")
    corners[..., 1] = low[1]
    winner, reference, margins = (values.reshape(cells, cells) for values in found)
    return DecisionMap(
        key=key,
        right=right,
        forward=forward,
        floor=float(low[1]),
        keys=outcome.keys,
        winner=winner,
        reference=reference,
        margin=margins,
        corners=corners @ trace.viewer.matrix,
        seconds=perf_counter() - start,
    )


def _simple(readings: tuple) -> bool:
    """True for a single reading with a single relation of two objects, rankable for all cells at once."""
    if len(readings) != 1 or readings[0].root.triple is None:
        return False
    attachment = readings[0].root.triple
    return attachment.relation in PAIRWISE and len(attachment.nodes) == 1


def _asked(node: Node) -> set[str]:
    """Relations of an expression."""
    return {a.relation for a in node.attachments} | {r for a in node.attachments for n in a.nodes for r in _asked(n)}


def _pair_probabilities(
    baseline: Baseline, edits: Edits, outcome: Outcome, moved: int, shift: np.ndarray
) -> _PairTable:
    trace = outcome.trace
    scorer = baseline.scorer(edits.scorer)
    require(
        isinstance(scorer, RuleScorer | OnnxScorer),
        "this relation scorer has no decision map",
        got=scorer.name,
        expected="a network, or the rule",
    )
    profile = replace(Profile(), **edits.profile)
    relations = {r for reading in trace.query.readings for r in _asked(reading.root)}
    lo, hi = stacked_extents([o.lifted for o in trace.objects])
    axes = trace.viewer.matrix.T.astype(np.float32)
    count = len(shift)
    surface, share = np.zeros((count, 2, 2)), np.zeros((count, 2, 2))
    rows = moved_rows = np.zeros((0, 0))
    if isinstance(scorer, OnnxScorer):
        rows = describe(trace.objects, trace.viewer, trace.frame, scorer)
        moved_rows = _sliding_rows(outcome, moved, shift, scorer)
    cloud = trace.objects[moved].lifted.points @ axes
    index = {k: at for at, k in enumerate(outcome.keys)}
    found: _PairTable = {}
    for other in range(len(trace.objects)):
        known = np.isfinite(lo[other]).all()
        if other == moved:
            continue
        other_lo, other_hi = (np.nan_to_num(e[other]) for e in (lo, hi))
        if any(p.reads_points for p in predicates_of(relations & set(PAIRWISE))):
            points = trace.objects[other].lifted.points @ axes
            own = lo[moved] + shift, hi[moved] + shift
            # That the one moves by a shift is that the other moves by its opposite.
            seen = other_lo - shift, other_hi - shift
            surface[:, 0, 1] = surface_heights(*own, points, other_hi[1], profile)
            surface[:, 1, 0] = surface_heights(*seen, cloud, hi[moved, 1], profile)
            share[:, 0, 1] = enclosed_share(lo[moved], hi[moved], cloud, *seen, profile)
            share[:, 1, 0] = enclosed_share(other_lo, other_hi, points, *own, profile)
        both_lo, both_hi = (
            np.stack([e[moved] + shift, np.broadcast_to(o, (count, 3))], axis=1)
            for e, o in ((lo, other_lo), (hi, other_hi))
        )
        measured = AllMeasures(measure_pairs(both_lo, both_hi, profile), profile, given=(surface, share))
        states = pair_states(measured, np.broadcast_to([True, known], (count, 2)), PAIRWISE)
        network = None
        if isinstance(scorer, OnnxScorer):
            fixed = np.broadcast_to(rows[other], moved_rows.shape)
            network = scorer.probabilities(np.stack([moved_rows, fixed], axis=1))
        table = combined(states, network, scorer).probabilities
        found[other] = np.stack([table[:, 0, 1], table[:, 1, 0]], axis=1)
    for (relation, a, b), p in edits.relations.items():
        if relation in PAIRWISE and outcome.keys[moved] in (a, b) and {a, b} <= index.keys():
            way = 0 if index[a] == moved else 1
            found[index[b] if way == 0 else index[a]][:, way, PAIRWISE.index(relation)] = p
    return found


def _sliding_rows(outcome: Outcome, moved: int, shift: np.ndarray, scorer: OnnxScorer) -> np.ndarray:
    """(C, K): network's input of the object at each cell. Every contract is affine in a shift."""
    trace, entry = outcome.trace, outcome.trace.objects[moved]
    matrix = trace.viewer.matrix

    def at(offset: np.ndarray) -> SceneObject:
        box = entry.lifted.box
        assert box is not None
        return replace(entry, lifted=entry.lifted.moved_to(replace(box, center=box.center + offset), trace.viewer))

    base, along_right, along_forward = describe(
        [entry, at(matrix[0]), at(matrix[2])], trace.viewer, trace.frame, scorer
    )
    step_right, step_forward = along_right - base, along_forward - base
    return base + shift[:, :1] * step_right + shift[:, 2:] * step_forward


def _vectorised(
    baseline: Baseline,
    edits: Edits,
    outcome: Outcome,
    moved: int,
    shift: np.ndarray,
    pairs: _PairTable,
    config: RankConfig,
) -> _Found:
    """Ranking of all cells at once, with its rules for ties."""
    trace = outcome.trace
    root = trace.query.readings[0].root
    attachment = root.triple
    assert attachment is not None
    column = PAIRWISE.index(attachment.relation)
    targets, references = trace.candidates[root.label], trace.candidates[attachment.nodes[0].label]
    table = trace.scores.of(attachment.relation)
    if attachment.inverse:
        table = table.T
    indices = targets.index, references.index
    base = table[np.ix_(*indices)]
    ends = (
        side(targets.index, targets.scores, config.target_weight),
        side(references.index, references.scores, config.reference_weight),
    )
    forbidden = one_object_twice(indices, baseline.same(trace.objects))
    sizes = np.array([o.lifted.quality.mask_pixels for o in trace.objects])
    forth, back = (1, 0) if attachment.inverse else (0, 1)
    found = []
    for first in range(0, len(shift), _AT_ONCE):
        at = slice(first, min(first + _AT_ONCE, len(shift)))
        p = np.repeat(base[None], at.stop - at.start, axis=0)
        for i, target in enumerate(targets.index.tolist()):
            for j, reference in enumerate(references.index.tolist()):
                if (target == moved) != (reference == moved):
                    a, way = (reference, forth) if target == moved else (target, back)
                    p[:, i, j] = pairs[a][at, way, column]
        found.append(_winners(pair_table(ends[0], ends[1:], p, forbidden, sizes, config)))
    winner, reference, margin = (np.concatenate([part[k] for part in found]) for k in range(3))
    return winner, reference, margin


def _winners(table: PairTable) -> _Found:
    """Winner, its reference and the margin of each cell."""
    first = table.first()
    second = table.second(first)
    every, found = np.arange(len(first)), first >= 0
    i, j = np.unravel_index(np.maximum(first, 0), table.shape)
    runner_up = np.where(second >= 0, table.posterior[every, second], 0.0)
    return (
        np.where(found, table.target.index[i], -1),
        np.where(found, table.ends[0].index[j], -1),
        np.where(found, table.posterior[every, first] - runner_up, 0.0),
    )


def _one_by_one(
    baseline: Baseline,
    edits: Edits,
    outcome: Outcome,
    moved: int,
    shift: np.ndarray,
    pairs: _PairTable,
    config: RankConfig,
) -> _Found:
    """Ranking cell by cell, for trees of relations, several readings, between and superlatives."""
    trace = outcome.trace
    same = baseline.same(outcome.trace.objects)
    sizes = np.array([o.lifted.quality.mask_pixels for o in trace.objects])
    others = np.array(sorted(pairs), np.int64)
    stacked = np.stack([pairs[k] for k in others.tolist()], axis=1) if len(others) else np.zeros((len(shift), 0, 2, 9))
    entry = trace.objects[moved]
    found = np.full((len(shift), 3), -1.0)
    for c, offset in enumerate(shift):
        probabilities = trace.scores.probabilities.copy()
        probabilities[moved, others], probabilities[others, moved] = stacked[c, :, 0], stacked[c, :, 1]
        slid = replace(entry, lifted=replace(entry.lifted, lo=entry.lifted.lo + offset, hi=entry.lifted.hi + offset))
        objects = tuple(slid if k == moved else o for k, o in enumerate(trace.objects))
        scores = replace(trace.scores, probabilities=probabilities)
        lookup = with_superlatives(relation_lookup(scores, objects, same), outcome.keys, edits)
        scene = scene_evidence(replace(trace, objects=objects))
        ranking = rank(trace.query.readings, trace.candidates, lookup, same, sizes, config, scene)
        pair = ranking.pairs[0]
        if not ranking.degenerate:
            found[c] = pair.target, -1 if pair.reference is None else pair.reference, ranking.margin
    return found[:, 0].astype(np.int64), found[:, 1].astype(np.int64), np.maximum(found[:, 2], 0.0)


def map_record(found: DecisionMap) -> dict[str, Any]:
    """Map as a JSON object: the grid, and each winner's share."""
    winners, counts = np.unique(found.winner, return_counts=True)
    return {
        "key": found.key,
        "cells": len(found.right),
        "right": [round(float(found.right[k]), 4) for k in (0, -1)],
        "forward": [round(float(found.forward[k]), 4) for k in (0, -1)],
        "keys": list(found.keys),
        "winner": found.winner.tolist(),
        "margin": np.round(found.margin, 4).tolist(),
        "share": {
            found.keys[w] if w >= 0 else "none": round(int(n) / found.winner.size, 6)
            for w, n in zip(winners.tolist(), counts.tolist(), strict=True)
        },
        "seconds": round(found.seconds, 3),
    }


def map_picture(found: DecisionMap, outcome: Outcome) -> np.ndarray:
    """(H, W, 3) uint8 RGB: each cell in the colour of its winner, paler for a small margin.

    The outlines are those of the other objects' extents. Below stand the winners with their share of the floor.
    """
    colors = instance_colors(len(found.keys)).astype(np.float64)
    cells = np.where((found.winner >= 0)[..., None], colors[np.maximum(found.winner, 0)], np.array(_NOTHING, float))
    strength = (0.35 + 0.65 * np.clip(found.margin, 0, 1))[..., None]
    cells = np.round(cells * strength + 255 * (1 - strength)).astype(np.uint8)
    # Far is up on the page.
    image = np.ascontiguousarray(np.kron(cells[::-1], np.ones((CELL_PIXELS, CELL_PIXELS, 1), np.uint8)))
    lo, hi = stacked_extents([o.lifted for o in outcome.trace.objects])
    step_r, step_f = (float(axis[1] - axis[0]) for axis in (found.right, found.forward))
    left, near = found.right[0] - step_r / 2, found.forward[0] - step_f / 2
    for k, key in enumerate(found.keys):
        if not np.isfinite(lo[k]).all():
            continue
        x0, x1 = (round((v - left) / step_r * CELL_PIXELS) for v in (lo[k, 0], hi[k, 0]))
        y0, y1 = (image.shape[0] - round((v - near) / step_f * CELL_PIXELS) for v in (hi[k, 2], lo[k, 2]))
        cv2.rectangle(image, (x0, y0), (x1, y1), _INK, 1 if key != found.key else 2)
        _write(image, key, (x0 + 2, min(y1 - 3, image.shape[0] - 3)), 0.35)
    return np.concatenate([image, _legend(found, outcome, image.shape[1], colors)])


def _legend(found: DecisionMap, outcome: Outcome, width: int, colors: np.ndarray) -> np.ndarray:
    winners, counts = np.unique(found.winner, return_counts=True)
    strip = np.full((_LINE_PIXELS * (len(winners) + 1) + 8, width, 3), _PAPER, np.uint8)
    _write(strip, f"{outcome.trace.query.text}: who wins where {found.key} stands", (8, _LINE_PIXELS - 4), 0.45)
    for line, (winner, count) in enumerate(sorted(zip(winners.tolist(), counts.tolist(), strict=True)), start=2):
        base = line * _LINE_PIXELS - 4
        color = _NOTHING if winner < 0 else tuple(int(c) for c in colors[winner])
        cv2.rectangle(strip, (8, base - 12), (22, base + 2), color, -1)
        label = "no pair" if winner < 0 else f"{outcome.trace.objects[winner].label} {found.keys[winner]}"
        _write(strip, f"{label}: {count / found.winner.size:.0%} of the floor", (30, base), 0.45)
    return strip


def _write(image: np.ndarray, text: str, at: tuple[int, int], scale: float) -> None:
    plain = text.encode("ascii", "replace").decode()
    cv2.putText(image, plain, at, cv2.FONT_HERSHEY_SIMPLEX, scale, _INK, 1, cv2.LINE_AA)
