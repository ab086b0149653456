"""Manifest of a case, validated on opening, and the truth of its frame, as JSON."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
from pydantic import BaseModel, BeforeValidator, ConfigDict, FiniteFloat

from pipeline.answering.ask import AskConfig
from pipeline.answering.fitted_models import FittedRanking, FittedScorer, Scale
from pipeline.answering.pair_rules import RunRules
from pipeline.answering.predictions import Predictions
from pipeline.datasets.base import Dataset
from pipeline.datasets.saved_case import CASE_FORMAT, DAMAGED, MANIFEST, Four, SavedFrame, Three
from pipeline.diagnosis.verdict import Unseen
from pipeline.labels.cases import Case, FrameCases
from pipeline.language.naming import Synonyms
from pipeline.language.relation_names import PAIRWISE
from pipeline.language.tree import Query
from pipeline.relations.relations import F, T, U
from pipeline.system.errors import InputError, as_input_error, require
from pipeline.system.reading import checked

_LETTERS = {int(T): "T", int(U): "U", int(F): "F"}
_STATES = {letter: state for state, letter in _LETTERS.items()}
NOT_JUDGED = "."
_GEOMETRY = {"lo": 3, "hi": 3, "center": 3, "R": 9, "size": 3}
_FACTS = ("distance", "occluded", "mask_pixels")

PROPOSALS, PREDICTIONS, NETWORK = "proposals.json", "predictions.jsonl", "relations.onnx"
"""What was detected; in a case of another pipeline what it gave; a relation network that came along."""


File = Literal["rgb.png", "depth.png", "depth.npy", "proposals.json", "predictions.jsonl", "relations.onnx"]
_Model = TypeVar("_Model", bound=BaseModel)


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)


class DetectorRecord(_Strict):
    """Detector of the kept proposals, unlike a `DetectorSetup`: a case opens without its files, elsewhere.

    The fingerprint is hashed: it may hold a path of somebody's machine.
    """

    name: str  # As on the command line
    exact: bool  # Its detections are the truth
    vocabulary: tuple[str, ...] | None  # Names that it is limited to; null for any
    fingerprint_sha256: str  # Hash of what identifies it


class ScorerRecord(_Strict):
    """Scorer of the relations: the rule, the shipped network, a file, or another pipeline."""

    # rule, the network that comes with the program, a file, or another pipeline
    kind: Literal["rule", "trained", "file", "imported"]
    name: str  # Of the scorer
    file: str | None = None  # Its file
    sha256: str | None = None  # Of the file
    in_case: bool = False  # The file is in the case


class ShownRankingRecord(_Strict):
    """`FittedRanking` as JSON."""

    weights: tuple[FiniteFloat, ...]  # Of the factors
    unit: FiniteFloat  # Of scores
    scale: Scale = "values"  # What scores are compared as


class ShownRecord(_Strict):
    """Findings from a whole file of predictions."""

    level: int  # Of the predictions: 0 to 3
    true_scores: tuple[FiniteFloat, FiniteFloat]  # Scores of what is right: of targets, of references
    ranking: ShownRankingRecord | None = None  # What stands in for the ranking
    # The scorer's fit by relation; None where the file names its scorer
    relations: dict[str, tuple[FiniteFloat, ...] | None] | None = None

    @property
    def rules(self) -> RunRules:
        """Rules for `ImportedPipeline`."""
        shown = self.ranking and FittedRanking(np.array(self.ranking.weights), self.ranking.unit, self.ranking.scale)
        return RunRules(shown, self.true_scores)

    def scorer(self, read: Predictions, dataset: Dataset) -> FittedScorer:
        """Stand-in for the scorer of the predictions."""
        told = {k: None if w is None else np.array(w) for k, w in (self.relations or {}).items()}
        return FittedScorer(read, dataset, told)


def config_record(config: AskConfig) -> dict[str, Any]:
    """Settings of an answer as JSON."""
    record = asdict(config)
    if config.score_calibration is not None:
        del record["score_calibration"]["detector"]
    return record


def _of_any_detector(record: Any) -> Any:
    """Calibration for the detections kept in the case."""
    calibration = record.get("score_calibration") if isinstance(record, dict) else None
    if not isinstance(calibration, dict):
        return record
    return {**record, "score_calibration": {**calibration, "detector": None}}


Config = Annotated[AskConfig, BeforeValidator(_of_any_detector)]
"""`config_record`, read again; a setting that an earlier release did not have is as by default."""


class ExpectedObject(BaseModel):
    """Object of the kept answer, without keys ignored in comparison."""

    id: int
    label: str
    score: FiniteFloat
    bbox: Four


class ExpectedAnswer(BaseModel):
    """Kept answer."""

    target: ExpectedObject
    reference: ExpectedObject | None
    second_reference: ExpectedObject | None = None
    probability: FiniteFloat
    p_relation: FiniteFloat
    product: FiniteFloat
    holds: bool | None = None
    """None in a case of an earlier release."""


class ExpectedDiagnosis(BaseModel):
    """Kept verdict."""

    verdict: str
    detail: str | None
    lucky: bool
    said: str


class ExpectedRecord(BaseModel):
    """Compared part of a kept `answer_record`."""

    answer: ExpectedAnswer | None
    judgement: ExpectedDiagnosis | None
    reason: str | None = None


class CaseManifest(_Strict):
    """`spatialviz-case.json`."""

    format: Literal["spatialviz-case-1"] = CASE_FORMAT  # Of the case
    name: str  # Of the case
    tool: str  # Program that wrote it, with its version
    created: str  # Time, UTC
    files: dict[File, str]  # SHA-256 of each file
    text: str  # The expression
    reading: Query | None = None
    """How the text was read, where it was not by the grammar."""
    frame: SavedFrame  # The frame without its pixels
    dataset: dict[str, str]  # Where the frame is from
    class_names: tuple[str, ...]  # Annotated classes of the dataset
    synonyms: Synonyms | None  # Names that mean the same
    detector: DetectorRecord  # What found the objects
    scorer: ScorerRecord  # What scored the relations
    shown: ShownRecord | None = None
    """Of a case of another pipeline."""
    config: Config  # Settings of the answer
    truth: dict[str, Any] | None  # What is true; null where it is not known
    unseen: Unseen | None = None
    """What the frame does not show and the object map of its scene does."""
    edits: dict[str, Any] | None  # Edits of a what-if
    run: dict[str, Any]  # Run and expression that it was saved from
    expected: dict[str, Any]  # The answer as it was, to compare with


def checked_manifest(root: Path, table: dict[str, Any]) -> tuple[CaseManifest, ExpectedRecord]:
    """Validate the manifest."""
    path = root / MANIFEST
    manifest = validated(CaseManifest, table, path)
    return manifest, checked_expected(manifest.expected, path)


def checked_expected(record: Any, path: Path) -> ExpectedRecord:
    """Validate the compared part of an answer's record; InputError for anything else."""
    return validated(ExpectedRecord, record, path, "expected")


def validated(model: type[_Model], record: Any, path: Path, *inside: str) -> _Model:
    """Validate a part of a case's file; InputError names a damaged field."""
    deep = f"the case is damaged at {'.'.join(inside) or 'the top'}"
    with as_input_error(deep, RecursionError, got="too deep", path=path):
        return checked(model.model_validate, record, DAMAGED, path, inside=inside)


class TrueObject(_Strict):
    """Labelled object; geometry in the frames of the labels, metres, null where unknown."""

    number: int  # In the labels
    label: str  # Class name
    bbox: Four  # x0, y0, x1, y1, pixels
    mask: str | None = None  # COCO's run-length code
    lo: Three | None  # Least right, up and forward of the points, viewer's axes
    hi: Three | None  # Greatest right, up and forward
    center: Three | None  # Of the 3D box, camera frame
    R: tuple[FiniteFloat, ...] | None  # Row by row
    size: Three | None  # Full edge lengths
    distance: FiniteFloat | None  # Median depth of the points
    occluded: FiniteFloat | None  # Share of the mask's border beside which something is nearer
    mask_pixels: FiniteFloat | None  # How many


class SavedExpression(_Strict):
    """Expression with its truth: a `Case` with lists for arrays, and null for a margin that is not known."""

    id: str  # In the labels
    text: str  # The sentence
    target: str  # Class name of what is asked for
    relation: str  # Relation that is asked
    reference: str  # Class name of what it stands in relation to
    target_object: int  # Place in `objects` of what was meant
    reference_object: int  # Place of its reference
    strict: tuple[int, ...]  # Places of what answers beyond doubt
    acceptable: tuple[int, ...]  # Places of what is acceptable
    ambiguous: bool  # More than one is acceptable
    margin: FiniteFloat | None  # Of the pair that was meant, metres

    @staticmethod
    def of(case: Case) -> dict[str, Any]:
        """JSON of a case."""
        lists = {name: getattr(case, name).tolist() for name in ("strict", "acceptable")}
        record = {name: getattr(case, name) for name in SavedExpression.model_fields}
        return {**record, **lists, "margin": _number(case.margin)}

    def case(self) -> Case:
        arrays = {name: np.array(getattr(self, name), np.int64) for name in ("strict", "acceptable")}
        margin = np.nan if self.margin is None else self.margin
        return Case(**{**dict(self), **arrays, "margin": margin})


class TruthRecord(_Strict):
    """Truth of a frame; rows of letters are tables of ordered pairs: row a, column b; T, U, F, or "." if not judged.

    `expression` is null where the truth of a sentence is worked out from the objects and their relations.
    """

    frame_index: int  # Of the frame in the dataset
    scene: str  # Place whose frames share a world
    objects: tuple[TrueObject, ...]  # All labelled objects of the frame
    alike: tuple[str, ...]  # Rows of 0 and 1: b is of a's class
    judged: tuple[str, ...]  # Rows of 0 and 1: the pair is judged
    states: dict[str, tuple[str, ...]]  # By relation, rows of letters
    expression: SavedExpression | None  # The expression with its right answers
    mark: Literal["BAD_LABEL", "BAD_BOX"] | None = None  # What a person found wrong with it
    confidence: FiniteFloat | None = None  # Score of an object that the detector missed


def truth_record(truth: FrameCases, case: Case, mark: str | None, confidence: float | None) -> dict[str, Any]:
    """Truth of an expression as JSON, exact to the last digit."""
    objects = [
        {"number": int(truth.numbers[k]), "label": label, "bbox": truth.boxes[k].tolist(), "mask": truth.masks[k]}
        | {name: _row(truth.geometry[name][k]) for name in _GEOMETRY}
        | {name: _number(truth.facts[name][k]) for name in _FACTS}
        for k, label in enumerate(truth.labels)
    ]
    return {
        "frame_index": truth.frame_index,
        "scene": truth.scene,
        "objects": objects,
        "alike": _bits(truth.alike),
        "judged": _bits(truth.judged),
        "states": {name: _letters(table, truth.judged) for name, table in truth.states.items()},
        "expression": None if case.meant is not None else SavedExpression.of(case),
        "mark": mark,
        "confidence": confidence,
    }


def read_truth(record: Any, frame_id: str, path: Path) -> tuple[FrameCases, Case | None, str | None, float | None]:
    """Truth, expression, a person's mark, and the confidence of recalled objects."""
    saved = validated(TruthRecord, record, path, "truth")
    n, case = len(saved.objects), None if saved.expression is None else saved.expression.case()
    indices = (
        []
        if case is None
        else [
            case.target_object,
            case.reference_object,
            *case.strict.tolist(),
            *case.acceptable.tolist(),
        ]
    )
    if not all(0 <= p < n for p in indices):
        among = f"objects 0 to {n - 1}"
        raise InputError("the case is damaged at truth.expression", got=indices, expected=among, path=path)
    require(
        (case is None or case.relation in saved.states) and set(saved.states) <= set(PAIRWISE),
        "the case is damaged at truth.states",
        got=list(saved.states),
        path=path,
    )
    require(
        not any(o.R is not None and len(o.R) != 9 for o in saved.objects),
        "the case is damaged at truth.objects",
        expected="R of nine numbers",
        path=path,
    )
    judged = _table(saved.judged, n, "judged", {"0": 0, "1": 1}, path).astype(np.bool_)
    known = {**_STATES, NOT_JUDGED: -1}
    states = {name: _table(rows, n, f"states.{name}", known, path) for name, rows in saved.states.items()}
    geometry = {
        name: np.array(
            [[np.nan] * width if (v := getattr(o, name)) is None else v for o in saved.objects], np.float64
        ).reshape(-1, width)
        for name, width in _GEOMETRY.items()
    }
    truth = FrameCases(
        frame_id,
        saved.frame_index,
        saved.scene,
        tuple(o.label for o in saved.objects),
        np.array([o.bbox for o in saved.objects], np.float64).reshape(-1, 4),
        _table(saved.alike, n, "alike", {"0": 0, "1": 1}, path).astype(np.bool_),
        states,
        () if case is None else (case,),
        np.array([o.number for o in saved.objects], np.int64),
        judged,
        geometry,
        {name: np.array([getattr(o, name) for o in saved.objects], np.float64) for name in _FACTS},
        tuple(o.mask for o in saved.objects),
    )
    return truth, case, saved.mark, saved.confidence


def _bits(table: np.ndarray) -> list[str]:
    return ["".join("1" if v else "0" for v in row) for row in table.tolist()]


def _letters(table: np.ndarray, judged: np.ndarray) -> list[str]:
    return [
        "".join(_LETTERS[v] if j or v >= 0 else NOT_JUDGED for v, j in zip(row, seen, strict=True))
        for row, seen in zip(table.tolist(), judged.tolist(), strict=True)
    ]


def _table(rows: tuple[str, ...], n: int, what: str, values: dict[str, int], path: Path) -> np.ndarray:
    """(n, n) int8 of n words of n letters."""
    require(
        len(rows) == n and not any(len(row) != n or not set(row) <= set(values) for row in rows),
        f"the case is damaged at truth.{what}",
        expected=f"{n} rows of {n} letters",
        path=path,
    )
    return np.array([[values[letter] for letter in row] for row in rows], np.int8).reshape(n, n)


def _row(values: np.ndarray) -> list[float] | None:
    return values.tolist() if np.isfinite(values).all() else None


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
