"""One row an expression: what was asked, what every stage gave, and what of it was right."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.answering.batch import FrameAnswers
from pipeline.answering.pair_table import PairTable, ScoredPair
from pipeline.answering.ranking import alone
from pipeline.diagnosis.frame_evidence import matched
from pipeline.diagnosis.oracles import CONF, LIFT, SRM
from pipeline.diagnosis.verdict import Diagnosis
from pipeline.labels.cases import HIT, Case, FrameCases, is_gold
from pipeline.language.expression import sentence_kind
from pipeline.language.tree import Query
from pipeline.system.arrow import pa, typed
from pipeline.system.errors import InputError, as_input_error, first_line, require
from pipeline.system.safe_files import read_parquet

DIAGNOSIS_COLUMNS: dict[str, str] = {
    "verdict": "string",  # CORRECT, or the module that failed
    "detail": "string",  # Finer kind of the verdict
    "lucky": "bool",  # Right, but with a pair that is not acceptable
    "said": "string",  # Verdict in a sentence
    "repair": "strings",  # Smallest set of modules whose truth would make it right
    "mends": "strings",  # Each module whose truth alone would
    "right_with": "int32",  # Bit s set: right with subset s of the true modules (RECALL 1, LIFT 2, SRM 4, CONF 8)
    "margin": "float32",  # Score of the best acceptable pair less that of the best other one
    "margin_lift": "float32",  # The same with true 3D boxes
    "margin_srm": "float32",  # The same with true relations
    "margin_conf": "float32",  # The same with true confidences
    "false_target": "bool",  # The answered target is no labelled object
    "false_reference": "bool",  # Its reference is no labelled object
    "untold": "strings",  # Of imported predictions: modules that cannot be replaced, and why
    "missed_name": "string",  # Name whose right object was not proposed
    "missed_overlap": "float32",  # Best overlap of a proposal with it
    "missed_score": "float32",  # Score of that proposal
    "missed_rank": "int32",  # Its rank among those of the name
    "object_size": "float32",  # Longest edge of the labelled target's box, metres
    "object_distance": "float32",  # Of the labelled target, metres
    "object_occluded": "float32",  # Occluded share of its border
    "object_pixels": "int32",  # Pixels of its mask
}
"""`verdict` and the rest of `pipeline.diagnosis.verdict.Diagnosis`; `said` is it in words; `mends` names each oracle
that alone would do. `right_with` has bit s set where the target is right with subset s of the oracles (RECALL 1, LIFT
2, SRM 4, CONF 8). `margin…` is S of the best acceptable pair less S of the best other one, as it is and with one
oracle. `object_…` is the labelled target: longest edge of its box and distance in metres, occluded share of its border,
pixels of its mask. `untold` is of imported predictions: each oracle that cannot be put in place, and why, as "LIFT: the
file gives no 3D boxes"; what `right_with` says of it is no part of what a module costs."""


COLUMNS: dict[str, str] = {
    "id": "string",  # Of the expression in the labels
    "frame": "string",  # Id of the frame
    "frame_index": "int32",  # Its index in the dataset
    "scene": "string",  # Place whose frames share a world
    "text": "string",  # The sentence
    "kind": "string",  # Kind of sentence
    "target": "string",  # Class name of what is asked for
    "relation": "string",  # Relation that is asked
    "reference": "string",  # Class name of what it stands in relation to
    "target_object": "int32",  # Object that was meant
    "reference_object": "int32",  # Its reference
    "answers_strict": "int32",  # Objects that answer beyond doubt
    "answers": "int32",  # Objects that are acceptable
    "same_class": "int32",  # Objects of the target's class
    "ambiguous": "bool",  # More than one is acceptable
    "label_margin": "float32",  # Of the pair that was meant, metres
    "parse_ok": "bool",  # The words were read as the labels mean them
    "problem": "string",  # Why there is no answer
    "degenerate": "bool",  # All pairs are one thing: the detector's best target answers alone
    "opm_box": "box",  # The detector's best target alone: x0, y0, x1, y1, pixels
    "opm_score": "float32",  # Its score
    "opm_iou": "float32",  # Its overlap with the object that was meant
    "opm_strict_iou": "float32",  # Its best overlap with an object that answers beyond doubt
    "opm_set_iou": "float32",  # Its best overlap with an acceptable one
    "targets_found": "int32",  # Candidates for the target
    "references_found": "int32",  # Candidates for the reference
    "target_rank": "int32",  # Rank of the best right target
    "reference_rank": "int32",  # Rank of the best right reference
    "pair_covered": "bool",  # A right pair is among the candidates
    "box": "box",  # Of the answer: x0, y0, x1, y1, pixels
    "reference_box": "box",  # Of its reference
    "iou": "float32",  # Overlap of the answer with the object that was meant
    "strict_iou": "float32",  # Its best overlap with an object that answers beyond doubt
    "set_iou": "float32",  # Its best overlap with an acceptable one
    "correct": "bool",  # `iou` is at least .5
    "strict_correct": "bool",  # `strict_iou` is
    "set_correct": "bool",  # `set_iou` is
    "reference_correct": "bool",  # The reference is right
    "pair_correct": "bool",  # Target and reference are right together
    "matched_target": "int32",  # Labelled object that the answer is
    "matched_reference": "int32",  # Labelled object that its reference is
    "label_state": "int8",  # State of the relation between these two: 1 T, 0 U, -1 F
    "p_target": "float32",  # P(target) of the answer
    "p_reference": "float32",  # P(reference)
    "p_relation": "float32",  # P(relation)
    "log_score": "float32",  # Logarithm of its weighted product
    "log_margin": "float32",  # How far it leads the next pair, in that logarithm
    "right_p_target": "float32",  # P(target) of the best right pair
    "right_p_reference": "float32",  # P(reference) of it
    "right_p_relation": "float32",  # P(relation) of it
    "right_log_score": "float32",  # Logarithm of its product
    "worked_out": "strings",  # Of imported predictions: numbers that the file does not give
    "target_points": "int32",  # 3D points of the answer
    "target_depth_missing": "float32",  # Share of its mask without depth
    "target_distance": "float32",  # From the camera, metres
    **DIAGNOSIS_COLUMNS,
}
"""The columns of `records.parquet`. Indices of objects are those of the labels, ranks count from 1 and are null where
nothing fits; `right_…` is the best-scoring acceptable pair among the candidates; overlaps are 0 without an answer.
`worked_out` names, of imported predictions, which of p_relation, log_score and those of the right pair no file gives.
`degenerate` is set where all pairs are one thing, so that the detector's best target answers alone, as in `ask`.
The columns of the diagnosis are null for systems that are not the pipeline."""


ASKED = ("id", "frame", "frame_index", "scene", "text", "target", "relation", "reference", "correct", "iou")
JUDGED = ("detail", "lucky", "said")
"""Columns that every release wrote, and those that it wrote beside verdicts."""


def records_schema() -> pa.Schema:
    """The Arrow schema of `COLUMNS`; a box is four numbers in pixels."""
    kinds = {
        "string": pa.string(),
        "int32": pa.int32(),
        "int8": pa.int8(),
        "bool": pa.bool_(),
        "float32": pa.float32(),
        "box": pa.list_(pa.float32(), 4),
        "strings": pa.list_(pa.string()),
    }
    return pa.schema([pa.field(name, kinds[kind]) for name, kind in COLUMNS.items()])


def asked_columns(case: Case, truth: FrameCases, query: Query | None = None) -> dict[str, Any]:
    """Row of an unanswered expression: question and truth; `query` spares reading."""
    read = None if query is None or query.text != case.text else query.kind
    return dict.fromkeys(COLUMNS) | {
        "id": case.id,
        "frame": truth.frame,
        "frame_index": truth.frame_index,
        "scene": truth.scene,
        "text": case.text,
        "kind": read or sentence_kind(case.text, (case.target, case.reference)),
        "target": case.target,
        "relation": case.relation,
        "reference": case.reference,
        "target_object": case.target_object,
        "reference_object": case.reference_object,
        "answers_strict": len(case.strict),
        "answers": len(case.acceptable),
        "same_class": int(truth.alike[case.target_object].sum()),
        "ambiguous": case.ambiguous,
        "label_margin": case.margin,
    }


def record(
    case: Case,
    truth: FrameCases,
    answers: FrameAnswers,
    parsed: tuple[Query | None, InputError | None],
    overlap: np.ndarray,
) -> dict[str, Any]:
    """Row of an expression; `overlap` is (D, N) float64, the IoU of each detection with each labelled object."""
    query, problem = parsed
    gold = query is not None and is_gold(query, case)
    row = asked_columns(case, truth, query)
    row["parse_ok"] = gold
    unread = None if problem is None else str(problem)
    row["problem"] = unread or answers.unknown.get(case.target) or answers.unknown.get(case.reference)
    pairs = truth.acceptable_pairs(case)
    _opm(row, case, answers, overlap)
    covered = _coverage(row, case, pairs, answers, overlap >= HIT)
    winner = target = None
    with answers.clock.stage("rank"):
        table = answers.score(case.target, case.relation, case.reference) if gold else None
        first = -1 if table is None else int(table.first()[0])
    if table is not None and first >= 0:
        winner = table.pair(first)
        target = winner.target
        _right(row, table, first, covered)
    elif table is not None:
        target = alone(answers.candidates[case.target])
    row["degenerate"] = winner is None and target is not None
    _answer(row, case, truth, answers, target, overlap)
    if winner is not None:
        _winner(row, case, truth, winner, answers, pairs, overlap)
    return row


def overlaps(detection: int | None, case: Case, overlap: np.ndarray) -> tuple[float, float, float]:
    """Best overlap of a detection with the target, with a strict answer and with an acceptable answer."""
    if detection is None:
        return 0.0, 0.0, 0.0
    own = overlap[detection]
    strict, acceptable = (float(own[k].max()) if len(k) else 0.0 for k in (case.strict, case.acceptable))
    return float(own[case.target_object]), strict, acceptable


def _opm(row: dict[str, Any], case: Case, answers: FrameAnswers, overlap: np.ndarray) -> None:
    """The detector's best target alone."""
    first = alone(answers.candidates[case.target])
    row["opm_iou"], row["opm_strict_iou"], row["opm_set_iou"] = overlaps(first, case, overlap)
    if first is not None:
        row["opm_box"] = answers.boxes[first].tolist()
        row["opm_score"] = float(answers.candidates[case.target].scores.max())


def _coverage(row: dict[str, Any], case: Case, pairs: np.ndarray, answers: FrameAnswers, hit: np.ndarray) -> np.ndarray:
    """(T, R) bool: acceptable candidate pairs; the ranks of the right pairs go into the row."""
    targets, references = answers.candidates[case.target], answers.candidates[case.reference]
    hits, other = hit[targets.index], hit[references.index]
    covered = (hits.astype(np.int32) @ pairs.astype(np.int32) @ other.T.astype(np.int32)) > 0
    row |= {
        "targets_found": len(targets.index),
        "references_found": len(references.index),
        "target_rank": _rank(targets.scores, np.asarray(hits[:, case.acceptable].any(axis=1))),
        "reference_rank": _rank(references.scores, np.asarray(other[:, pairs.any(axis=0)].any(axis=1))),
        "pair_covered": bool(covered.any()),
    }
    return covered


def _rank(scores: np.ndarray, right: np.ndarray) -> int | None:
    """Rank, from 1, of the best-scored right candidate."""
    if not right.any():
        return None
    return int(np.flatnonzero(right[np.argsort(-scores, kind="stable")])[0]) + 1


def _right(row: dict[str, Any], table: PairTable, first: int, covered: np.ndarray) -> None:
    """Fill in the best acceptable pair among the candidates, and the winner's lead."""
    at = int(table.first(covered)[0])
    if at >= 0:
        right = table.pair(at)
        row |= {
            "right_p_target": right.p_target,
            "right_p_reference": right.p_reference,
            "right_p_relation": right.p_relation,
            "right_log_score": right.log_score,
        }
    lead = table.lead(first)
    row["log_margin"] = lead if np.isfinite(lead) else None


def _answer(
    row: dict[str, Any],
    case: Case,
    truth: FrameCases,
    answers: FrameAnswers,
    target: int | None,
    overlap: np.ndarray,
) -> None:
    """Fill in the answering target (an index of the frame's objects) and the correctness."""
    row["iou"], row["strict_iou"], row["set_iou"] = overlaps(target, case, overlap)
    row |= {
        "correct": row["iou"] >= HIT,
        "strict_correct": row["strict_iou"] >= HIT,
        "set_correct": row["set_iou"] >= HIT,
        "reference_correct": False,
        "pair_correct": False,
    }
    if target is None:
        return
    scores = answers.candidates[case.target]
    (same,) = matched(overlap[[target]], truth.alike[[case.target_object]])
    quality = answers.objects[target].lifted.quality
    row |= {
        "box": answers.boxes[target].tolist(),
        "p_target": float(scores.scores[scores.index == target].max()),
        "matched_target": None if same < 0 else int(same),
        "target_points": quality.points,
        "target_depth_missing": quality.depth_missing,
        "target_distance": None if np.isnan(quality.distance) else quality.distance,
    }


def _winner(
    row: dict[str, Any],
    case: Case,
    truth: FrameCases,
    winner: ScoredPair,
    answers: FrameAnswers,
    pairs: np.ndarray,
    overlap: np.ndarray,
) -> None:
    """Fill in the winning pair."""
    assert winner.reference is not None
    both = overlap[[winner.target, winner.reference]]
    hits = both >= HIT
    a, b = matched(both, truth.alike[[case.target_object, case.reference_object]])
    row |= {
        "reference_box": answers.boxes[winner.reference].tolist(),
        "p_target": winner.p_target,
        "p_reference": winner.p_reference,
        "p_relation": winner.p_relation,
        "log_score": winner.log_score,
        "reference_correct": bool(hits[1][pairs.any(axis=0)].any()),
        "pair_correct": bool((hits[0][:, None] & hits[1][None, :] & pairs).any()),
        "matched_reference": None if b < 0 else int(b),
        "label_state": None if a < 0 or b < 0 else int(truth.states[case.relation][a, b]),
    }


def diagnosis_columns(d: Diagnosis) -> dict[str, Any]:
    """Cells of a diagnosis."""
    missed, truth, k = d.missed, d.truth, d.case.target_object
    return {
        "verdict": d.verdict,
        "detail": d.detail,
        "lucky": d.lucky,
        "said": d.text,
        "repair": list(d.repair),
        "mends": list(d.mends),
        "right_with": d.right_with,
        "margin": _finite(d.margins[0]),
        "margin_lift": _finite(d.margins[LIFT]),
        "margin_srm": _finite(d.margins[SRM]),
        "margin_conf": _finite(d.margins[CONF]),
        "false_target": d.false_target,
        "false_reference": d.false_reference,
        "untold": [f"{name}: {why}" for name, why in d.untold.items()] or None,
        "missed_name": d.missed_name,
        "missed_overlap": None if missed is None else missed.overlap,
        "missed_score": None if missed is None else missed.score,
        "missed_rank": None if missed is None else missed.rank,
        "object_size": _finite(truth.geometry["size"][k].max()),
        "object_distance": _finite(truth.facts["distance"][k]),
        "object_occluded": _finite(truth.facts["occluded"][k]),
        "object_pixels": int(truth.facts["mask_pixels"][k]),
    }


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def read_records(run: Path, columns: list[str] | None = None) -> pa.Table:
    """Read the records of a run folder, or some columns; with none only the file's head.

    Raises InputError: there is no run, or it measured relations alone.
    """
    path = Path(run) / "records.parquet"
    with as_input_error("the records of the run cannot be read", ValueError, OSError, got=first_line, path=path):
        alone = not path.is_file() and path.with_name("relation_records.parquet").is_file()
        require(not alone, "this run has no expressions", cause="made with --tables relations", path=run)
        require(path.is_file(), "no evaluation run here", expected="a folder that `eval` wrote", path=run)
        read = read_parquet(path, columns)
        read.validate(full=True)  # Text that is no UTF-8
        rows = typed(read, records_schema(), "the records", path)
    if columns is None:
        need_columns(rows.column_names, path)
    return rows


def need_columns(names: Collection[str], path: Path) -> None:
    """Raise InputError where a file lacks a column that its release wrote."""
    needed = ASKED + JUDGED if "verdict" in names else ASKED
    lost = next((name for name in needed if name not in names), None)
    require(lost is None, f"the records lack the column {lost!r}", cause="is this a run of `eval`?", path=path)
