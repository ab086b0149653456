"""Runs of other pipelines: predictions become a run, after a look at their coordinates; a run becomes predictions."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.answering.answering import FrameAnswers
from pipeline.answering.imported import GivenDetector, ImportedPipeline
from pipeline.answering.objects import PreparedFrame, prepare_frame
from pipeline.answering.pair_rules import Rescore
from pipeline.answering.placing import (
    IN_ORDER,
    MEETS,
    box_2d,
    box_3d,
    box_overlap,
    checked_box,
    holds,
    other_conventions,
    pixel_scale,
    seen_box,
    try_box,
)
from pipeline.answering.predictions import (
    GivenAnswer,
    GivenBox,
    Header,
    Prediction,
    Predictions,
    Proposal,
    Weights,
    write_predictions,
)
from pipeline.answering.ranking import alone
from pipeline.evaluation.job import RunReport, evaluate_dataset
from pipeline.evaluation.run import EvalSpec, Progress
from pipeline.evaluation.run_folder import Run
from pipeline.geometry.boxes import Box3D
from pipeline.geometry.masks import RunLength, mask_box
from pipeline.labels.cases import FrameCases, read_cases
from pipeline.proposals.base import Proposals
from pipeline.system.errors import InputError, require

LOOKED_AT = 24
"""Frames whose coordinates are looked at, spread evenly."""
LEAST_PLACED = 3
"""Of fewer answers in points or boxes nothing is said of their unit."""
FEW_MEET, MOST_MEET = 0.5, 0.7
"""Boxes are of another convention where fewer than this share meet their objects, and by another at least this."""


def import_run(
    predictions: str | Path,
    dataset: str | Path,
    labels: str | Path,
    out: str | Path,
    *,
    name: str | None = None,
    workers: int = 1,
    plots: bool = True,
    overwrite: bool = False,
    rescore: Rescore | None = None,
    progress: Progress | None = None,
    **options: Any,
) -> RunReport:
    """Judge the predictions of another pipeline on a dataset and its labels; the run folder keeps a copy of them.

    Parameters
    ----------
    predictions : str or Path
        A file as `docs/predictions.md` describes it.
    dataset, labels, out
        As for `evaluate`.
    name : str, optional
        Of the system in tables; the header's by default.
    rescore : callable, optional
        Ranks pairs anew as the pipeline does; see `pair_rules.Rescore`. With it one process works.
    workers, plots, overwrite, progress
        As for `evaluate_dataset`.
    options
        Of the dataset: intrinsics, depth_scale, up, ...

    Raises
    ------
    InputError
        The file does not follow the schema, its frames or coordinates are not the dataset's, or no line is an
        expression of the labels; nothing is written then.
    """
    given: dict[str, Any] = {"predictions": Path(predictions), **options}
    if rescore is not None:
        given["rescore"], workers = rescore, 1
    spec = EvalSpec(str(dataset), str(labels), given)
    source, read = spec.open()
    assert isinstance(source, ImportedPipeline)
    file = source.predictions
    asked = {(t.frame, c.text) for t in read_cases(read, 0, 2**31 - 1) for c in t.cases if file.line(t.frame, c.text)}
    first = next(iter(file.lines.values()))
    require(
        asked,
        "no line of the file is an expression of the labels",
        got=f"{first.text!r} on frame {first.frame}, and {len(file.lines) - 1} more",
        expected="the words of an expression of the labels",
        path=file.path,
    )
    check_places(source, sorted({frame for frame, _ in asked}))
    spec = replace(spec, confidence=file.header.confidence)
    report = evaluate_dataset(
        spec, Path(out), name=name or file.header.system, workers=workers, plots=plots, overwrite=overwrite,
        progress=progress,
    )  # fmt: skip
    unasked, total = len(file.lines) - len(asked), read.manifest.counts["expressions"]
    warnings = report.warnings
    if unasked > 0:
        warnings += (f"{unasked} of {len(file.lines)} lines are no expression of the labels, and are not judged",)
    if len(asked) < total:
        warnings += (f"the file has lines for {len(asked)} of the {total} expressions of the labels",)
    return replace(report, warnings=warnings)


def check_places(source: ImportedPipeline, frames: Sequence[str]) -> None:
    """Look whether 2D boxes lie in the picture, and 3D boxes where their pixels are.

    Raises
    ------
    InputError
        A box that is none by the header; or most boxes do not meet their pixels, and by another convention they do.
    """
    predictions = source.predictions
    header, detector = predictions.header, source.needed_detector()
    assert isinstance(detector, GivenDetector)
    conventions = list(other_conventions(header))
    met: list[list[float]] = [[] for _ in range(1 + len(conventions))]
    flat: dict[str, list[float]] = {order: [] for order in IN_ORDER}
    worst: tuple[str, int] | None = None
    placed: list[tuple[Prediction, bool]] = []
    chosen = np.unique(np.linspace(0, len(frames) - 1, min(LOOKED_AT, len(frames))).astype(int))
    for frame_id in (frames[int(k)] for k in chosen):
        frame = source.dataset.load(frame_id)
        context = prepare_frame(source.dataset, frame, source.config.lift)
        camera = context.frame.camera
        for line in predictions.of_frame(frame_id):
            spot = _answered_spot(line, header, frame.width, frame.height)
            if spot is not None:
                inside = (spot >= 0).all() and (spot <= [frame.width, frame.height]).all() and (spot > 1).any()
                placed.append((line, bool(inside)))
            for name, found in (line.proposals or {}).items():
                for k, p in enumerate(found):
                    where = predictions.where(line, f"proposals.{name}.{k}.box")
                    assert p.box is not None
                    checked_box(p.box, header, frame.width, frame.height, where, predictions.path)
        plain = _Plain(predictions)
        proposals = detector.detect(context.frame, None) if detector.vocabulary else None
        for o in context.lift(proposals, plain) if proposals is not None else ():
            given = predictions.box_of(frame_id, o.id)
            line = next(one for one in predictions.of_frame(frame_id) if o.id in one.objects)
            box2 = line.objects[o.id].box
            assert box2 is not None
            own = None if given is None else _placed(given, source, context, line, o.id)
            seen = None if own is None else seen_box(own, camera)
            if o.lifted.quality.mask_source != "box":
                seen = np.array(mask_box(np.ascontiguousarray(o.mask)), np.float64)
            if seen is not None:
                for order in IN_ORDER:
                    read = replace(header, boxes=order)
                    flat[order].append(box_overlap(box2, read, seen, frame.width, frame.height))
            points = o.lifted.points
            if own is None or given is None or len(points) < 20:
                continue
            met[0].append(holds(own, points))
            if met[0][-1] < MEETS and worst is None:
                worst = predictions.where(line, f"boxes_3d.{o.id}"), o.id
            for k, (_, other, swapped) in enumerate(conventions, 1):
                tried = try_box(given, other, camera, swapped)
                met[k].append(0.0 if tried is None else holds(tried, points))
    wrong = [line for line, inside in placed if not inside]
    if len(placed) >= LEAST_PLACED and len(wrong) > len(placed) / 2:
        where = predictions.where(wrong[0], "answer")
        raise InputError(
            f"{where}: {len(wrong)} of {len(placed)} answers lie outside the picture or in its first pixel",
            got=f'"box_unit": "{header.box_unit}"',
            expected="pixels, shares or thousandths of width and height, as the answers are",
            path=predictions.path,
        )
    _judge_flat(flat, header, predictions)
    if not met[0] or worst is None:
        return
    shares = [float((np.array(m) >= MEETS).mean()) for m in met]
    best = int(np.argmax(shares))
    if shares[0] < FEW_MEET and shares[best] >= max(MOST_MEET, 2 * shares[0]):
        raise InputError(
            f"{worst[0]}: the box does not meet its object's pixels, like {1 - shares[0]:.0%} of {len(met[0])} boxes",
            got=f'"coordinates": "{header.coordinates}", "length": "{header.length}"',
            expected=conventions[best - 1][0],
            cause=f"by that {shares[best]:.0%} meet",
            path=predictions.path,
        )


def _answered_spot(line: Prediction, header: Header, width: int, height: int) -> np.ndarray | None:
    """(2,) float64: the point that was answered, or the centre of the box, pixels; None for another answer."""
    if line.answer is None or (line.answer.point is None and line.answer.box is None):
        return None
    if line.answer.point is not None:
        return np.array(line.answer.point) * pixel_scale(header, width, height)
    assert line.answer.box is not None
    return box_2d(line.answer.box, header, width, height).reshape(2, 2).mean(axis=0)


class _Plain:
    """A detector by name only, whose objects are lifted here from their pixels, whatever boxes the file has."""

    exact, reads_annotations, vocabulary = False, False, None

    def __init__(self, predictions: Predictions) -> None:
        self.name = predictions.header.system

    def fingerprint(self) -> str:
        return "as it is lifted here"

    def detect(self, frame: Any, labels: Sequence[str] | None) -> Proposals:
        raise NotImplementedError


def _placed(given: GivenBox, source: ImportedPipeline, context: PreparedFrame, line: Prediction, i: int) -> Box3D:
    try:
        return box_3d(given, source.predictions.header, context.frame.camera)
    except InputError as error:
        where = source.predictions.where(line, f"boxes_3d.{i}")
        raise InputError(f"{where}: {error.what}", path=source.predictions.path) from error


def _judge_flat(flat: dict[str, list[float]], header: Header, predictions: Predictions) -> None:
    """InputError where 2D boxes, read in another order, lie on their objects and, as the header says, do not."""
    if len(flat[header.boxes]) < 3:
        return
    found = {order: float(np.median(values)) for order, values in flat.items()}
    best = max(found, key=found.__getitem__)
    require(
        found[header.boxes] >= 0.3 or found[best] < max(0.6, 2 * found[header.boxes]),
        f"line 1, boxes: the boxes overlap their objects by {found[header.boxes]:.0%}",
        got=f'"{header.boxes}"',
        expected=f'"{best}", by which they overlap by {found[best]:.0%}',
        path=predictions.path,
    )


def export_run(run: Run, out: str | Path) -> int:
    """Write a run of ours as predictions of level 3; gives the number of lines.

    Raises
    ------
    InputError
        The file exists, the run is not of the pipeline, or its data cannot be opened.
    """
    kept = run.spec.options.get("predictions")
    require(not kept, "the run is made of predictions already", expected="nothing to write: the file", path=kept)
    require(
        run.spec.system == "pipeline",
        "only a run of the pipeline can be written as predictions",
        got=run.spec.system,
        path=run.folder,
    )
    require(not Path(out).exists(), "the file exists", expected="another name", path=out)
    source, config = run.source, run.source.config
    detector, srm = source.needed_detector(), run.spec.options.get("srm") or "trained"
    header = Header(
        system=run.name,
        ranking="product",
        weights=Weights(config.rank.target_weight, config.rank.reference_weight, config.rank.relation_weight),
        same="ids" if detector.exact else "overlap",
        exact=detector.exact,
        scorer=str(srm) if isinstance(srm, str | Path) else None,
        confidence=run.spec.confidence,
        settings=json.loads(json.dumps(asdict(replace(config, score_calibration=None)), default=str)),
    )
    lines = list(_exported(run))
    write_predictions(out, header, lines)
    return len(lines)


def _exported(run: Run) -> Iterator[Prediction]:
    source = run.source
    asked = set(zip(run.records.column("frame").to_pylist(), run.records.column("id").to_pylist(), strict=True))
    index = run.records.column("frame_index").to_pylist()
    for truth in read_cases(run.labels, min(index, default=0), max(index, default=-1) + 1):
        cases = [c for c in truth.cases if (truth.frame, c.id) in asked]
        if cases:
            context = prepare_frame(source.dataset, source.dataset.load(truth.frame), source.config.lift)
            names = tuple(dict.fromkeys(name for c in cases for name in (c.target, c.reference)))
            answers = FrameAnswers(source, context, names, {c.relation for c in cases})
            yield from _lines(replace(truth, cases=tuple(cases)), answers)


def _lines(truth: FrameCases, answers: FrameAnswers) -> Iterator[Prediction]:
    """The lines of one frame; masks stand where an object is named first."""
    frame = answers.context.frame
    known = [o.id for o in answers.objects]
    ids = known if min(known, default=0) >= 0 else list(range(len(known)))
    told: set[int] = set()
    dropped = {name: tuple(_dropped(answers, name, max(ids, default=0) + 1)) for name in answers.candidates}
    for case in truth.cases:
        proposals = {}
        for name in dict.fromkeys((case.target, case.reference)):
            candidates = answers.candidates[name]
            labels = candidates.labels or ("",) * len(candidates.index)
            found = []
            for k, score, label in zip(candidates.index.tolist(), candidates.scores.tolist(), labels, strict=True):
                o, new = answers.objects[k], ids[k] not in told
                told.add(ids[k])
                box = tuple(map(float, o.bbox)) if new else None
                masked = new and o.lifted.quality.mask_source != "box"
                called = "" if label == name else label
                found.append(Proposal(ids[k], score, box, called, RunLength.of(o.mask) if masked else None))  # type: ignore[arg-type]
            if name not in answers.unknown:
                proposals[name] = (*found, *dropped[name])
        table, answer = answers.score(case.target, case.relation, case.reference), None
        first = -1 if table is None else int(table.first()[0])
        if table is not None and first >= 0:
            pair = table.pair(first)
            answer = GivenAnswer(ids[pair.target], None if pair.reference is None else ids[pair.reference])
        elif table is not None and (target := alone(answers.candidates[case.target])) is not None:
            answer = GivenAnswer(ids[target])
        here, there = (answers.candidates[name].index.tolist() for name in (case.target, case.reference))
        p = answers.probabilities(case.relation)
        rows = () if p is None else tuple((ids[a], ids[b], float(p[a, b])) for a in here for b in there if a != b)
        used = dict.fromkeys([*here, *there])
        yield Prediction(
            frame.id, case.text, answer, proposals=proposals, relations={case.relation: rows},
            unknown={n: answers.unknown[n] for n in (case.target, case.reference) if n in answers.unknown} or None,
            boxes_3d={ids[k]: _given_box(answers.objects[k].box) for k in used},
        )  # fmt: skip


def _given_box(box: Box3D | None) -> GivenBox | None:
    if box is None:
        return None
    center, R, size = (tuple(a.ravel().tolist()) for a in (box.center, box.R, box.size))
    return GivenBox(center, size, R)  # type: ignore[arg-type]


def _dropped(answers: FrameAnswers, name: str, number: int) -> Iterator[Proposal]:
    """What the detector gave for a name, and what did not go on of it."""
    source, frame = answers.source, answers.context.frame
    went = {answers.objects[k].bbox.tobytes() for k in answers.candidates[name].index.tolist()}
    seen = set(went)
    for detector, reason in ((source.needed_detector(), "rank"), (source.unfiltered_detector(), "threshold")):
        try:
            found = detector.detect(frame, [name])
        except InputError:
            continue
        for box, score, i in zip(found.boxes, found.scores.tolist(), found.ids.tolist(), strict=True):
            if box.tobytes() not in seen:
                seen.add(box.tobytes())
                yield Proposal(number + len(seen) if i < 0 else i, score, tuple(map(float, box)), dropped=reason)  # type: ignore[arg-type]
