"""Replay of saved cases: changes of the answer, by object and by verdict.

What decides is the target, the reference, whether they stand in the relation, and the verdict. Probabilities that
move by more than a tolerance, and another detail of the same verdict, are warnings.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import repeat
from pathlib import Path
from typing import Any, Literal

import numpy as np

from pipeline.answering.coordinate_conventions import check_places
from pipeline.answering.imported import ImportedPipeline
from pipeline.answering.objects import SAME_BOX_IOU
from pipeline.answering.pair_rules import RunRules
from pipeline.answering.predictions import Predictions
from pipeline.datasets.saved_case import MANIFEST
from pipeline.diagnosis.answer import Answer, answer_record
from pipeline.diagnosis.cases.manifest import ExpectedObject, ExpectedRecord, checked_expected
from pipeline.diagnosis.cases.saving import OpenedCase, open_case
from pipeline.geometry.boxes import iou_2d
from pipeline.relations import make_scorer
from pipeline.system.errors import InputError, require
from pipeline.system.frozen import dataclass

Status = Literal["same", "changed", "updated", "damaged"]

TOLERANCE = 1e-4
"""By how much a probability may move without a word."""
RANKED = ("target", "reference", "product")
SAME_PLACE = 1e-3
"""By how much the numbers of a 3D box may move: metres, and the entries of a rotation."""
SAME_BOX_PIXELS = 0.05
"""Of kept detections, those with edges this close are one; their boxes are written with two digits."""


@dataclass(frozen=True)
class ReplayedCase:
    """Case answered again."""

    path: Path
    name: str
    # before, after: The kept answer and that of now, as far as they are compared
    before: ExpectedRecord
    after: ExpectedRecord
    changes: tuple[str, ...]  # What is another now, in words; empty where the answer is the same
    warnings: tuple[str, ...]  # What moved without changing the answer, and what the case was run with besides its own
    record: dict[str, Any]  # The whole answer of now
    answered: Answer
    # The first module whose own output is another now: PARSE, OPM, LIFT, SRM or PRM; None where none is. What follows
    # it gets another input, so that the verdict may blame a later one, or one that is as it was.
    moved: str | None = None

    @property
    def same(self) -> bool:
        """True for an unchanged answer."""
        return not self.changes


def find_cases(path: str | Path) -> tuple[Path, ...]:
    """Cases in a folder, or the folder itself if a case.

    Raises
    ------
    InputError
        There is none.
    """
    path = Path(path)
    if (path / MANIFEST).is_file():
        return (path,)
    require(path.is_dir(), "there is no such case", path=path)
    # A half-written case has a hidden name.
    files = (file.relative_to(path) for file in path.rglob(MANIFEST))
    found = sorted(path / f.parent for f in files if not any(part.startswith(".") for part in f.parts))
    require(found, "the folder holds no saved case", expected=f"folders with {MANIFEST}", path=path)
    return tuple(found)


def replay_case(opened: OpenedCase, tolerance: float = TOLERANCE, *, live: bool = False) -> ReplayedCase:
    """Answer a case again and compare.

    `tolerance`: A probability that moves by more is warned of; `live`: the detections are new ones: objects are the
    same where their 2D boxes overlap by 0.7.
    """
    require((np.isfinite(tolerance) and tolerance >= 0), "a tolerance must be at least 0", got=tolerance)
    now = opened.answer()
    record = answer_record(now)
    after = checked_expected(record, opened.root)
    changes, warnings = _compare(opened.expected, after, tolerance, live)
    return ReplayedCase(
        opened.root,
        opened.manifest.name,
        opened.expected,
        after,
        tuple(changes),
        (*opened.notes, *warnings),
        record,
        now,
        _first_moved(opened.manifest.expected, record, tolerance),
    )


def _first_moved(before: dict[str, Any], after: dict[str, Any], tolerance: float) -> str | None:
    """First module with an output differing between two records of an answer."""

    def of_objects(*keys: str) -> Callable[[dict[str, Any]], Any]:
        return lambda record: [[one.get(key) for key in keys] for one in record.get("proposals", ())]

    outputs: tuple[tuple[str, Callable[[dict[str, Any]], Any], float], ...] = (
        ("PARSE", lambda record: [record["expression"].get(k) for k in ("target", "relation", "reference")], 0),
        ("PARSE", lambda record: record.get("ranking", {}).get("reading"), 0),
        ("OPM", of_objects("label", "score"), tolerance),
        ("OPM", of_objects("bbox"), SAME_BOX_PIXELS),
        ("LIFT", of_objects("center", "size", "R"), SAME_PLACE),
        ("SRM", lambda record: record.get("relations"), tolerance),
        ("PRM", lambda record: [[p.get(k) for k in RANKED] for p in record.get("pairs", ())], tolerance),
    )
    return next((name for name, of, near in outputs if not _alike(of(before), of(after), near)), None)


def _alike(a: Any, b: Any, tolerance: float) -> bool:
    """True for equal JSON values up to small steps of numbers, and keys known to a single release."""
    if isinstance(a, dict) and isinstance(b, dict):
        return all(_alike(a[key], b[key], tolerance) for key in a.keys() & b.keys())
    if isinstance(a, list) and isinstance(b, list):
        return len(a) == len(b) and all(map(_alike, a, b, repeat(tolerance)))
    if isinstance(a, int | float) and isinstance(b, int | float):
        return abs(a - b) <= tolerance
    return a == b


def _compare(
    before: ExpectedRecord, after: ExpectedRecord, tolerance: float, live: bool
) -> tuple[list[str], list[str]]:
    changes: list[str] = []
    warnings: list[str] = []
    a, b = before.answer, after.answer
    if a is None or b is None:
        if a is not None:
            changes.append(f"there was an answer, and now there is none: {after.reason}")
        elif b is not None:
            changes.append(f"there was no answer ({before.reason}), and now there is one: {_named(b.target)}")
        elif before.reason != after.reason:
            warnings.append(f"no answer, for another reason: {before.reason} -> {after.reason}")
    else:
        for role in ("target", "reference", "second_reference"):
            one, other = getattr(a, role), getattr(b, role)
            if not _same_object(one, other, live):
                changes.append(f"{role.replace('_', ' ')}: {_named(one)} -> {_named(other)}")
            elif one is not None:
                warnings += _moved(f"score of the {role.replace('_', ' ')}", one.score, other.score, tolerance)
        # A null of an older case, or of an answer to a part of the question, says nothing of the pair.
        if None not in (a.holds, b.holds) and a.holds != b.holds:
            stands = ("there is no such pair", "the pair stands in the relation")
            was, now = (f"{stands[bool(x.holds)]} ({x.p_relation:.2f})" for x in (a, b))
            changes.append(f"{was} -> {now}")
        for what in ("p_relation", "product", "probability"):
            warnings += _moved(what, getattr(a, what), getattr(b, what), tolerance)
    one, other = before.judgement, after.judgement
    verdicts = [None if j is None else j.verdict for j in (one, other)]
    if verdicts[0] != verdicts[1]:
        changes.append(f"verdict: {verdicts[0] or 'none'} -> {verdicts[1] or 'none'}")
    elif one is not None and other is not None:
        if one.detail != other.detail:
            warnings.append(f"detail of the verdict: {one.detail} -> {other.detail}")
        if one.lucky != other.lucky:
            warnings.append("correct by luck now" if other.lucky else "correct and no longer by luck")
    return changes, warnings


def _same_object(one: ExpectedObject | None, other: ExpectedObject | None, live: bool) -> bool:
    if one is None or other is None:
        return one is other
    if live:
        return bool(iou_2d(np.array([one.bbox]), np.array([other.bbox]))[0, 0] >= SAME_BOX_IOU)
    near = max(abs(p - q) for p, q in zip(one.bbox, other.bbox, strict=True)) <= SAME_BOX_PIXELS
    return one.id == other.id and near


def _named(entry: ExpectedObject | None) -> str:
    if entry is None:
        return "nothing"
    x0, y0, x1, y1 = entry.bbox
    return f"{entry.label} at ({(x0 + x1) / 2:.0f}, {(y0 + y1) / 2:.0f})"


def _moved(what: str, before: float, after: float, tolerance: float) -> list[str]:
    return [f"{what}: {before:.4f} -> {after:.4f}"] if abs(after - before) > tolerance else []


@dataclass(frozen=True)
class ReplayResult:
    """Outcome of a case."""

    path: Path
    status: Status  # same, changed, updated (changed, and taken over) or damaged (could not be run)
    replay: ReplayedCase | None  # None where it could not be run
    problem: str | None = None  # Why not


def _check_places(folders: Sequence[Path], predictions: Predictions, rules: RunRules | None) -> None:
    """Check the coordinates of predictions with lines for these cases."""
    found = {}
    for folder in folders:
        try:
            opened = open_case(folder).with_predictions(predictions, rules)
        except InputError:
            # Told when its turn comes.
            continue
        assert isinstance(opened.source, ImportedPipeline)
        frame = opened.context.frame.id
        if predictions.of_frame(frame):
            found.setdefault(frame, (opened.source, frame))
    if found:
        check_places(list(found.values()))


def replay_all(
    folders: Sequence[Path],
    *,
    srm: str | Path | None = None,
    vectors: Path | None = None,
    tolerance: float = TOLERANCE,
    update: bool = False,
    detector: str | None = None,
    model: Path | None = None,
    min_score: float | None = None,
    predictions: Predictions | None = None,
) -> Iterator[ReplayResult]:
    """Run cases again, lazily.

    Parameters
    ----------
    srm, vectors
        As for `open_case`.
    tolerance : float
        As for `replay_case`.
    update : bool
        Take the answers of now as the expected ones.
    detector, model, min_score
        A detector that looks at the pictures now; None for the kept detections.
    predictions : Predictions, optional
        What another pipeline gives now, with a line for each case.

    Raises
    ------
    InputError
        The relation scorer that was asked for cannot be used with any case; the predictions are not in the coordinates
        that their header says.
    """
    if srm is not None:
        # Said once, and not of every case: none of them is damaged by it.
        make_scorer(srm, vectors)
    # To find what ranks takes longer than a case does.
    rules = None if predictions is None else RunRules.of(predictions)
    if predictions is not None:
        _check_places(folders, predictions, rules)
    for folder in folders:
        try:
            opened = open_case(folder, srm=srm, vectors=vectors)
            if detector is not None:
                opened = opened.with_detector(detector, model, min_score)
            if predictions is not None:
                opened = opened.with_predictions(predictions, rules)
            replay = replay_case(opened, tolerance, live=detector is not None or predictions is not None)
            moved = replay.record != opened.manifest.expected
            if update and moved:
                opened.expect(replay.record)
        except InputError as error:
            yield ReplayResult(folder, "damaged", None, str(error))
            continue
        yield ReplayResult(folder, "updated" if update and moved else "same" if replay.same else "changed", replay)
