"""What a case keeps of its detector, or of another pipeline: what was given for each asked name, and played back.

Proposals are those before K and suppression, with and without the detector's minimum score. Their file is also a
recording of one frame (`pipeline.proposals.recorded`): what a recording does not have stands beside its "frames".
Predictions are the lines of the frame. A ranking and a scorer that cannot be asked again are known by all pairs of
their file (`pair_rules`, `fitted_models`); a case has those of one frame, and so keeps what was found.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import field, replace
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, Field

from pipeline.answering.ask import AskConfig
from pipeline.answering.detector_runs import detection_record, mask_record
from pipeline.answering.fitted_models import FittedScorer
from pipeline.answering.imported import ImportedDetector, ImportedPipeline, scorer_of
from pipeline.answering.pair_rules import RunRules
from pipeline.answering.predictions import Predictions, as_json
from pipeline.datasets.base import Dataset
from pipeline.diagnosis.cases.manifest import ShownRankingRecord, ShownRecord, validated
from pipeline.geometry.frame import Frame
from pipeline.geometry.masks import RunLength
from pipeline.language.naming import Synonyms
from pipeline.proposals.base import Detector, Proposals
from pipeline.proposals.recorded import Playback, RecordedDetection, as_arrays
from pipeline.relations import RelationScorer
from pipeline.system.errors import InputError, UnknownClass, as_input_error, require
from pipeline.system.frozen import dataclass
from pipeline.system.safe_files import parse_json, read_bytes


class KeptDetection(RecordedDetection, extra="forbid"):
    """Detection; `id` is left out without an identity, `mask` for a mere box."""

    mask: RunLength | None = None  # pyright: ignore[reportIncompatibleVariableOverride]
    segmented: bool = False


class KeptAnswer(BaseModel, extra="forbid"):
    """Indices of the detections of a name, in the detector's order, or the reason for refusing the name."""

    given: tuple[int, ...] = ()
    unfiltered: tuple[int, ...] = ()
    refused: str | None = None
    what: str | None = None  # First words of a longer reason: all that notes of words left out have


class KeptProposals(BaseModel, extra="forbid"):
    """File of kept proposals."""

    frames: dict[str, list[KeptDetection]] = Field(min_length=1, max_length=1)
    asked: dict[str, KeptAnswer]


def keep_proposals(frame: Frame, detector: Detector, unfiltered: Detector, names: Sequence[str]) -> dict[str, Any]:
    """Ask a detector for each name, and give the file's content."""
    detections: list[dict[str, Any]] = []
    indices: dict[str, int] = {}
    asked: dict[str, Any] = {}

    def keep(found: Proposals) -> list[int]:
        by_segmenter = np.zeros(len(found), np.bool_) if found.segmented is None else found.segmented
        rows = [detection_record(found, i, mask_record(found, i), bool(s)) for i, s in enumerate(by_segmenter)]
        index = []
        for row in rows:
            # Without an identity two equal detections are two things.
            key = json.dumps(row) if "id" in row else f"{len(detections)}"
            if key not in indices:
                indices[key] = len(detections)
                detections.append(row)
            index.append(indices[key])
        return index

    for name in dict.fromkeys(names):
        try:
            found = detector.detect(frame, [name])
        except InputError as error:
            asked[name] = {"refused": str(error), **({} if error.what == str(error) else {"what": error.what})}
            continue
        given = keep(found)
        # The same detector twice would keep what has no identity twice.
        every = given if unfiltered is detector else keep(unfiltered.detect(frame, [name]))
        asked[name] = {"given": given, "unfiltered": every}
    return {"frames": {frame.id: detections}, "asked": asked}


@dataclass(frozen=True)
class KeptDetector:
    """Detector playing back kept proposals."""

    name: str  # That of the detector they are from
    exact: bool
    vocabulary: tuple[str, ...] | None
    kept: KeptProposals
    path: Path  # The file, for errors
    print: str  # Hash of the file
    everything: bool = False  # Without the detector's minimum score
    _answers: dict[tuple[str, ...] | None, Proposals] = field(default_factory=dict, compare=False, repr=False)

    def fingerprint(self) -> str:
        # Unfiltered detections have the same identities and pixels.
        return f"kept:{self.print}"

    def detect(self, frame: Frame, labels: Sequence[str] | None) -> Proposals:
        key = None if labels is None else tuple(labels)
        if key not in self._answers:
            self._answers[key] = self._answer(frame, key)
        return self._answers[key]

    def _answer(self, frame: Frame, labels: tuple[str, ...] | None) -> Proposals:
        index: list[int] = []
        for name in self.kept.asked if labels is None else labels:
            answer = self.kept.asked.get(name)
            if answer is None:
                raise UnknownClass(
                    f"the case has no detections of {name!r}", expected=", ".join(self.kept.asked), path=self.path
                )
            if answer.refused is not None and labels is not None:
                error = UnknownClass(answer.refused)
                error.what = answer.what or error.what
                raise error
            index += answer.unfiltered if self.everything else answer.given
        rows = self.kept.frames.get(frame.id)
        if rows is None:
            raise InputError(f"the case has no detections in frame {frame.id}", path=self.path)
        found = replace(as_arrays(rows, {}), segmented=np.array([r.segmented for r in rows], np.bool_))
        playback = Playback(frame, found, self.path)
        return playback.proposals(np.array(list(dict.fromkeys(index)), np.int64))


def read_proposals(path: Path) -> tuple[KeptProposals, str]:
    """Read the file, and its hash."""
    data = read_bytes(path, "text")
    unreadable = "the detections of the case are not JSON"
    with as_input_error(unreadable, ValueError, got=lambda e: str(e)[:120], path=path):
        content = parse_json(data, path)
    kept = validated(KeptProposals, content, path)
    (rows,) = kept.frames.values()
    named = [i for a in kept.asked.values() for i in (*a.given, *a.unfiltered)]
    require(
        set(named) <= set(range(len(rows))),
        "the case names a detection that it does not hold",
        got=max(named, default=None),
        expected=len(rows),
        path=path,
    )
    return kept, hashlib.sha256(data).hexdigest()


def keep_predictions(pipeline: ImportedPipeline, frame: str) -> tuple[bytes, ShownRecord]:
    """Lines of a frame as a file of predictions, with the findings from the whole file."""
    file, rules, stand_in = pipeline.predictions, pipeline.rules, pipeline.stand_in
    lines = (as_json(thing) for thing in (replace(file.header, events=False), *file.of_frame(frame)))
    ranking = rules.shown and ShownRankingRecord(
        weights=tuple(rules.shown.weights.tolist()), unit=rules.shown.unit, scale=rules.shown.scale
    )
    relations = None
    if isinstance(stand_in, FittedScorer):
        relations = {k: None if w is None else tuple(w.tolist()) for k, w in stand_in.weights.items()}
    shown = ShownRecord(level=file.level, true_scores=rules.true_scores, ranking=ranking, relations=relations)
    return "".join(f"{line}\n" for line in lines).encode(), shown


def imported_source(
    read: Predictions,
    dataset: Dataset,
    scorer: RelationScorer,
    config: AskConfig,
    synonyms: Synonyms | None,
    rules: RunRules | None,
) -> ImportedPipeline:
    """Pipeline of a case by predictions; `scorer`: the one they name, or a stand-in for theirs."""
    relations = scorer_of(read, None, scorer)
    return ImportedPipeline(dataset, ImportedDetector(read), relations, config, synonyms, predictions=read, shown=rules)
