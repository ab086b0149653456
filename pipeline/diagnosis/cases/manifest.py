"""The manifest of a case: what is validated when a case is opened."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, ValidationError

from pipeline.answering.ask import AskConfig
from pipeline.answering.ranking import RankConfig
from pipeline.datasets.saved_case import CASE_FORMAT, MANIFEST, Four, SavedFrame, damaged
from pipeline.geometry.lifting import LiftConfig
from pipeline.system.errors import InputError

PROPOSALS, NETWORK = "proposals.json", "relations.onnx"
FILES = ("rgb.png", "depth.png", "depth.npy", PROPOSALS, NETWORK)


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid")


class DetectorRecord(_Strict):
    """What made the proposals; the fingerprint is hashed, since it may hold a path of somebody's machine."""

    name: str
    exact: bool
    vocabulary: tuple[str, ...] | None
    fingerprint_sha256: str


class ScorerRecord(_Strict):
    """What scored the relations: the rule, the network that comes with the program, or a file."""

    kind: Literal["rule", "trained", "file"]
    name: str
    file: str | None = None
    sha256: str | None = None
    in_case: bool = False


class CalibrationRecord(_Strict):
    """`ScoreCalibration` but for the detector it is of."""

    a: FiniteFloat = Field(gt=0)
    b: FiniteFloat
    positives: int = Field(ge=0)
    negatives: int = Field(ge=0)
    k: int = Field(ge=1)


class LiftRecord(_Strict):
    """`pipeline.geometry.lifting.LiftConfig`."""

    near: FiniteFloat
    far: FiniteFloat
    edge: FiniteFloat
    edge_relative: FiniteFloat
    erode: FiniteFloat
    erode_keep: FiniteFloat
    part: FiniteFloat
    min_pixels: int
    max_points: int
    box: Literal["gravity", "pca", "pca-raw"]


class RankRecord(_Strict):
    """`pipeline.answering.ranking.RankConfig`."""

    target_weight: FiniteFloat
    reference_weight: FiniteFloat
    relation_weight: FiniteFloat
    aggregate: Literal["max", "marginal"]


class ConfigRecord(_Strict):
    """`pipeline.answering.ask.AskConfig`."""

    k: int = Field(ge=1)
    lift: LiftRecord
    rank: RankRecord
    relations: tuple[str, ...] | None
    score_calibration: CalibrationRecord | None

    def config(self) -> AskConfig:
        """The settings themselves."""
        from pipeline.proposals.score_calibration import ScoreCalibration

        c = self.score_calibration
        calibration = None if c is None else ScoreCalibration(None, c.a, c.b, c.positives, c.negatives, c.k)
        lift, rank = LiftConfig(**self.lift.model_dump()), RankConfig(**self.rank.model_dump())
        return AskConfig(self.k, lift, rank, self.relations, calibration)


def config_record(config: AskConfig) -> dict[str, Any]:
    """The settings of an answer as JSON."""
    record = asdict(config)
    if config.score_calibration is not None:
        del record["score_calibration"]["detector"]
    return record


class SynonymsRecord(_Strict):
    """A table of synonyms that is not the program's own."""

    groups: tuple[tuple[str, ...], ...]
    exceptions: tuple[str, ...]


class ExpectedObject(BaseModel):
    """An object of the kept answer; what else is kept of it is not compared."""

    model_config = ConfigDict(extra="ignore")
    id: int
    label: str
    score: FiniteFloat
    bbox: Four


class ExpectedAnswer(BaseModel):
    """The kept answer."""

    model_config = ConfigDict(extra="ignore")
    target: ExpectedObject
    reference: ExpectedObject | None
    second_reference: ExpectedObject | None = None
    probability: FiniteFloat
    p_relation: FiniteFloat
    product: FiniteFloat
    holds: bool | None = None
    """None in a case of an earlier release."""


class ExpectedJudgement(BaseModel):
    """The kept verdict."""

    model_config = ConfigDict(extra="ignore")
    verdict: str
    detail: str | None
    lucky: bool
    said: str


class Expected(BaseModel):
    """The kept record of `answer_record`, as far as it is compared."""

    model_config = ConfigDict(extra="ignore")
    answer: ExpectedAnswer | None
    judgement: ExpectedJudgement | None
    reason: str | None = None


class Manifest(_Strict):
    """`spatialviz-case.json`."""

    format: Literal["spatialviz-case-1"] = CASE_FORMAT
    name: str
    tool: str
    created: str
    files: dict[Literal["rgb.png", "depth.png", "depth.npy", "proposals.json", "relations.onnx"], str]
    text: str
    frame: SavedFrame
    dataset: dict[str, str]
    class_names: tuple[str, ...]
    synonyms: SynonymsRecord | None
    detector: DetectorRecord
    scorer: ScorerRecord
    config: ConfigRecord
    truth: dict[str, Any] | None
    edits: dict[str, Any] | None
    run: dict[str, Any]
    expected: dict[str, Any]


def checked_manifest(root: Path, table: dict[str, Any]) -> tuple[Manifest, Expected]:
    """The manifest, validated.

    Raises
    ------
    InputError
        It is damaged; the message names the place.
    """
    path = root / MANIFEST
    try:
        manifest = Manifest.model_validate(table)
    except ValidationError as error:
        raise damaged(error, path) from error
    return manifest, checked_expected(manifest.expected, path)


def checked_expected(record: Any, path: Path) -> Expected:
    """What is compared of an answer's record.

    Raises
    ------
    InputError
        It is not one.
    """
    try:
        return Expected.model_validate(record)
    except ValidationError as error:
        raise damaged(error, path, "expected") from error
    except RecursionError as error:
        raise InputError("the case is damaged at expected", got="too deep", path=path) from error
