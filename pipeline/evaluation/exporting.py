"""Runs of the pipeline written as predictions, with every step of each answer."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, replace
from itertools import count
from pathlib import Path

from pipeline.answering.batch import FrameAnswers
from pipeline.answering.objects import SceneObject, prepare_frame
from pipeline.answering.predictions import (
    Header,
    PredictedAnswer,
    PredictedBox,
    Prediction,
    Proposal,
    Weights,
    write_predictions,
)
from pipeline.answering.ranking import alone
from pipeline.evaluation.run_folder import Run
from pipeline.evaluation.systems import OWN
from pipeline.geometry.boxes import Box3D
from pipeline.geometry.masks import RunLength
from pipeline.labels.cases import FrameCases, read_cases
from pipeline.system.errors import InputError, require


def export_run(run: Run, out: str | Path) -> int:
    """Write a run of ours as predictions of level 3; gives the number of lines.

    Raises InputError: the file exists, the run is not of the pipeline, or its data cannot be opened.
    """
    kept = run.spec.options.get("predictions")
    require(not kept, "the run is made of predictions already", expected="nothing to write: the file", path=kept)
    require(
        run.system == OWN,
        "only a run of the pipeline can be written as predictions",
        got=run.system,
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
    """The lines of one frame; masks stand at the first mention of an object."""
    frame = answers.context.frame
    known = [o.id for o in answers.objects]
    own = min(known, default=0) >= 0
    number = max(known, default=0) + 1 if own else len(known)
    dropped = {name: tuple(_dropped(answers, name, number, own)) for name in answers.candidates}
    ids = _ids(answers.objects, max((p.id for found in dropped.values() for p in found), default=0))
    told: set[int] = set()
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
            answer = PredictedAnswer(ids[pair.target], None if pair.reference is None else ids[pair.reference])
        elif table is not None and (target := alone(answers.candidates[case.target])) is not None:
            answer = PredictedAnswer(ids[target])
        here, there = (answers.candidates[name].index.tolist() for name in (case.target, case.reference))
        p = answers.probabilities(case.relation)
        rows = () if p is None else tuple((ids[a], ids[b], float(p[a, b])) for a in here for b in there if a != b)
        used = dict.fromkeys([*here, *there])
        yield Prediction(
            frame.id,
            case.text,
            answer,
            proposals=proposals,
            relations={case.relation: rows},
            unknown={n: answers.unknown[n] for n in (case.target, case.reference) if n in answers.unknown} or None,
            boxes_3d={ids[k]: _given_box(answers.objects[k].box) for k in used},
        )


def _ids(objects: Sequence[SceneObject], above: int) -> list[int]:
    """Ids of the detector, where it has any; of a detection whose second name gives another 3D box, two."""
    if any(o.id < 0 for o in objects):
        return list(range(len(objects)))
    free = count(max((above, *(o.id for o in objects))) + 1)
    boxes: dict[int, PredictedBox | None] = {}
    ids = []
    for o in objects:
        box = _given_box(o.box)
        ids.append(o.id if boxes.setdefault(o.id, box) == box else next(free))
    return ids


def _given_box(box: Box3D | None) -> PredictedBox | None:
    if box is None:
        return None
    center, R, size = (tuple(a.ravel().tolist()) for a in (box.center, box.R, box.size))
    return PredictedBox(center, size, R)  # type: ignore[arg-type]


def _dropped(answers: FrameAnswers, name: str, number: int, own: bool) -> Iterator[Proposal]:
    """Discarded detections for a name, with the reasons; with ids of their own, or from a number on."""
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
                at = i if own and i >= 0 else number + len(seen)
                yield Proposal(at, score, tuple(map(float, box)), dropped=reason)  # type: ignore[arg-type]
