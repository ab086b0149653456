"""Proposals of a detector for each asked name, before K and suppression, with and without its minimum score.

The file is also a recording of one frame (`pipeline.proposals.recorded`): what
a recording does not have stands beside its "frames". Scores and boxes are
written so that reading gives the same float32 numbers.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, Field

from pipeline.answering.recording import detection_record, finding_of
from pipeline.diagnosis.cases.manifest import validated
from pipeline.geometry.frame import Frame
from pipeline.geometry.masks import RunLength
from pipeline.proposals.base import Detector, Proposals
from pipeline.proposals.recorded import Playback, RecordedDetection, as_arrays
from pipeline.system.errors import InputError, UnknownClass, as_input_error, require
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
        rows = [detection_record(frame, finding_of(found, i), bool(s)) for i, s in enumerate(by_segmenter)]
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
            asked[name] = {"refused": str(error)}
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
                raise UnknownClass(answer.refused)
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
