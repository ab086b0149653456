"""Imported predictions as a pipeline: given proposals, boxes, probabilities and scores, unchanged.

A detector with given proposals, a relation scorer with given probabilities, a ranking with given scores: none is
computed anew. Where the truth replaces a part, relations of new objects are scored by the scorer named in the file,
else by the rule, a stand-in named as such.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import asdict, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import TypeAdapter

from pipeline.answering.ask import AskConfig
from pipeline.answering.coordinate_conventions import box_2d, box_3d
from pipeline.answering.fitted_models import FittedScorer
from pipeline.answering.objects import PreparedFrame, SceneObject
from pipeline.answering.pair_rules import (
    RuledConfig,
    RunRules,
    factors_of,
    given_names,
    line_rule,
    missing_row,
)
from pipeline.answering.pipeline import Pipeline, open_pipeline
from pipeline.answering.predictions import Prediction, Predictions, Proposal, read_predictions
from pipeline.geometry.boxes import Box3D
from pipeline.geometry.frame import Frame
from pipeline.language.expression import parse
from pipeline.language.naming import suggest
from pipeline.language.relation_names import PAIRWISE, PHRASE
from pipeline.language.tree import Query
from pipeline.proposals.base import Proposals, no_proposals
from pipeline.proposals.class_names import meant_names
from pipeline.relations import make_scorer
from pipeline.relations.scorer import RelationScorer, SuppliedRelations
from pipeline.system.errors import InputError, UnknownClass, require
from pipeline.system.frozen import dataclass
from pipeline.system.reading import checked


def label_of(predictions: Predictions) -> str:
    """Label of predictions, shown with any part of them: system and level."""
    return f"{predictions.header.system} (imported, level {predictions.level})"


class ImportedDetector:
    """Detector giving the proposals of a line; without a line those of all lines of the frame.

    `below`: `detect_with_dropped` holds also what was below the minimum score; `final`: what is given goes on as it is:
    nothing is suppressed, cut off or calibrated; `told_by_ids`: only one id is one thing.
    """

    final = True
    reads_annotations = False
    lists_things = True

    def __init__(self, predictions: Predictions, line: Prediction | None = None, below: bool = False) -> None:
        self.predictions, self.line, self.below = predictions, line, below
        self.name = label_of(predictions)
        self.exact = predictions.header.exact
        self.told_by_ids = predictions.header.same == "ids"
        self._drops = {"rank", "overlap", "threshold"} if below else {"rank", "overlap"}
        lines = predictions.lines.values() if line is None else (line,)
        self.vocabulary = tuple(dict.fromkeys(name for one in lines for name in one.proposals or {}))

    def fingerprint(self) -> str:
        return f"imported:{self.predictions.content_hash}"

    def detect(self, frame: Frame, labels: Sequence[str] | None) -> Proposals:
        return self._found(frame, labels, lambda p: p.dropped is None)

    def detect_with_dropped(self, frame: Frame, labels: Sequence[str] | None) -> Proposals:
        """Detections with the dropped ones."""
        return self._found(frame, labels, lambda p: p.dropped is None or p.dropped in self._drops)

    def _found(self, frame: Frame, labels: Sequence[str] | None, keep: Callable[[Proposal], bool]) -> Proposals:
        if self.line is not None and self.line.proposals is None:
            return no_proposals(frame.height, frame.width)
        header, lines = self.predictions.header, self.predictions.of_frame(frame.id)
        lines = lines if self.line is None else (self.line,)
        names = self.vocabulary
        for label in labels or ():
            if self.line is not None and label in (self.line.unknown or {}):
                raise UnknownClass((self.line.unknown or {})[label])
        if labels is not None:
            where = f"the file {self.predictions.path.name}"
            meant = ((label,) if label in names else meant_names(label, names, None, where) for label in labels)
            names = tuple(dict.fromkeys(name for found in meant for name in found))
        best: dict[int, tuple[str, Proposal]] = {}
        at: dict[int, Prediction] = {}
        for line in lines:
            for name in names:
                for p in (line.proposals or {}).get(name, ()):
                    at.setdefault(p.id, line)
                    if keep(p) and (p.id not in best or best[p.id][1].score < p.score):
                        best[p.id] = p.name or name, p
        if not best:
            return no_proposals(frame.height, frame.width)
        found = [p for _, p in best.values()]
        called = [name for name, _ in best.values()]
        known = tuple(dict.fromkeys(called))
        masks = np.zeros((len(found), frame.height, frame.width), np.bool_)
        for k, p in enumerate(found):
            if p.mask is not None:
                masks[k] = p.mask.decoded(
                    masks.shape[1:], self.predictions.where(at[p.id], f"mask of {p.id}"), self.predictions.path
                )
        assert all(p.box is not None for p in found)
        boxes = [box_2d(p.box, header, frame.width, frame.height) for p in found if p.box is not None]
        return Proposals(
            np.array(boxes, np.float32).reshape(-1, 4),
            np.array([p.score for p in found], np.float32),
            np.array([known.index(name) for name in called], np.int64),
            known,
            masks,
            np.array([p.id for p in found], np.int64),
            np.array([p.mask is not None for p in found], np.bool_),
        )

    def box(self, frame: Frame, i: int) -> Box3D | None:
        """3D box of an object; None if not given."""
        given = self.predictions.box_of(frame.id, i)
        return None if given is None else box_3d(given, self.predictions.header, frame.camera)

    def finished(self, entry: SceneObject, context: PreparedFrame) -> SceneObject:
        """Object as lifted here, with the given box, its points moved to match, and given attributes."""
        attributes = (
            {}
            if self.line is None
            else {name: p for name, rows in (self.line.attributes or {}).items() for i, p in rows if i == entry.id}
        )
        box = self.box(context.frame, entry.id)
        moved = entry.lifted
        if box is not None and not (moved.box is not None and alike(moved.box, box)):
            moved = moved.moved_to(box, context.viewer)
        return replace(
            entry, lifted=moved, given_attributes=attributes, box_from="worked out" if box is None else "given"
        )


def alike(a: Box3D, b: Box3D) -> bool:
    """True for equal boxes, up to rounding."""
    return all(np.allclose(x, y, atol=1e-6) for x, y in ((a.center, b.center), (a.R, b.R), (a.size, b.size)))


def scorer_of(predictions: Predictions, line: Prediction | None, stand_in: RelationScorer) -> SuppliedRelations:
    """Relation probabilities of a line, and for missing pairs those of a stand-in, asked again if their origin."""
    relations = {} if line is None or line.relations is None else line.relations
    name = stand_in.name if line is not None and line.relations is None else label_of(predictions)
    return SuppliedRelations(relations, stand_in, name, predictions.header.scorer is not None)


@dataclass(frozen=True)
class ImportedPipeline(Pipeline):
    """Dataset with the predictions of another pipeline, of the whole file or of a single `line`."""

    predictions: Predictions = field(kw_only=True)
    shown: RunRules | None = None  # What the whole file showed of its ranking, where these are some of its lines

    @cached_property
    def rules(self) -> RunRules:
        """Ranking rules shown by the file."""
        return self.shown or RunRules.of(self.predictions)

    @property
    def stand_in(self) -> RelationScorer:
        """Scorer of pairs missing in the file."""
        assert isinstance(self.scorer, SuppliedRelations)
        return self.scorer.stand_in

    def asked(self, frame_id: str, text: str) -> Pipeline:
        """Pipeline of a single expression; InputError for an expression without a line."""
        file = self.predictions
        line = file.line(frame_id, text)
        if line is None:
            known = [p.text for p in file.of_frame(frame_id)]
            close = suggest(text, known)
            raise InputError(
                f"{label_of(file)} has no line for this expression on frame {frame_id}",
                got=repr(text),
                expected=f"one of {len(known)} lines" + (f", such as {close[0]!r}" if close else ""),
                path=file.path,
            )
        if line is self.line:
            return self
        detector = ImportedDetector(file, line)
        scorer = scorer_of(file, line, self.stand_in)
        rule = line_rule(self.rules, file.header, line)
        config = self.config
        if rule is not None:
            config = replace(config, rank=RuledConfig(**vars(config.rank), pairs=rule))
        below = ImportedDetector(file, line, below=True)
        reader = _given_reader(line, label_of(file)) if line.relation and line.target else self.reader
        return replace(
            self,
            detector=detector,
            scorer=scorer,
            config=config,
            line=line,
            open_unfiltered=lambda: below,
            reader=reader,
        )


def _given_reader(line: Prediction, system: str) -> Callable[..., Query]:
    """Reader giving the parse of the line."""

    def read(text: str, **options: Any) -> Query:
        phrase = PHRASE.get(line.relation or "", line.relation)
        names = tuple(n for n in (line.target, line.reference) if n)
        options["class_names"] = (*names, *options.get("class_names", ()))
        words = f"{line.target} {phrase} {line.reference}" if line.reference else str(line.target)
        return replace(parse(words, **options), text=text, spans=(), reader=system)

    return read


def open_imported(predictions: Path, dataset: Any, **options: Any) -> ImportedPipeline:
    """Open a dataset with the predictions of a file.

    `dataset`, `options`: as for `open_pipeline`; what names models is refused, and of `config` only `lift` counts.
    """
    for name in ("detector", "model", "segmenter", "fuse", "also"):
        require(not options.get(name), f"{name} is not for imported predictions", cause="the file says what was seen")
    require(
        not options.pop("rescored", False),
        "the run's ranking was asked again by a function, which no file holds: only its records stand",
        expected="import-run FILE, judged by the scores of its pairs",
        path=predictions,
    )
    options.pop("srm", None)
    pipeline = open_pipeline(dataset, srm="rule", **options)
    read = read_predictions(predictions)
    config = config_of(read)
    if options.get("config") is not None:
        config = replace(config, lift=options["config"].lift)
    known = set(pipeline.dataset.frame_ids)
    for line in read.lines.values():
        if line.frame not in known:
            close = suggest(line.frame, pipeline.dataset.frame_ids, 1)
            cause = f"did you mean {close[0]!r}?" if close else "is it another dataset?"
            raise InputError(
                f"{read.where(line, 'frame')}: the dataset has no such frame",
                got=repr(line.frame),
                cause=cause,
                path=read.path,
            )
    named = read.header.scorer
    scorer = FittedScorer(read, pipeline.dataset) if named is None else make_scorer(named, options.get("vectors"))
    return ImportedPipeline(
        pipeline.dataset,
        ImportedDetector(read),
        scorer_of(read, None, scorer),
        config,
        pipeline.synonyms,
        predictions=read,
    )


def config_of(predictions: Predictions) -> AskConfig:
    """Settings of the header; InputError for invalid settings."""
    config, header = AskConfig(), predictions.header
    if header.settings is not None:
        check, wrong = TypeAdapter(AskConfig).validate_python, "line 1, {}: not the settings of a run"
        return checked(check, header.settings, wrong, predictions.path, inside=("settings",))
    weights = {f"{name}_weight": weight for name, weight in asdict(header.weights).items()}
    return replace(config, rank=replace(config.rank, **weights))


def open_source(dataset: Any, **options: Any) -> Pipeline:
    """Open a pipeline, with `predictions` an imported one."""
    if options.get("predictions") is None:
        return open_pipeline(dataset, **{k: v for k, v in options.items() if k != "predictions"})
    return open_imported(dataset=dataset, **options)


def needed_names(line: Prediction, names: Collection[str], predictions: Predictions) -> None:
    """Raise InputError for a line with proposals but none, not even an empty list, for an asked name."""
    for name in names:
        require(
            line.proposals is None or name in (line.unknown or {}) or given_names(name, line),
            f"{predictions.where(line, 'proposals')}: nothing for {name!r}, which the expression asks for",
            got=", ".join(line.proposals or ()) or "no names",
            expected="an empty list where nothing was found",
            path=predictions.path,
        )


def needed_rows(line: Prediction, predictions: Predictions, gold: tuple[str, str, str] | None = None) -> None:
    """Raise InputError for a line with relations but no probability of an asked pair, or answering another pair.

    `gold` is target, relation and reference, where known.
    """
    missing = missing_row(line, gold) if line.ranked else None
    if missing is not None and missing[0] in PAIRWISE:
        relation, a, b = missing
        raise InputError(
            f"{predictions.where(line, f'relations.{relation}')}: no probability of the pair {a}, {b}",
            expected="a row for every ordered pair of the candidates of the expression",
            path=predictions.path,
        )
    answer, pairs = line.answer, factors_of(line) if line.ranked else {}
    if answer is None or not pairs:
        return
    require(
        any(a == answer.object and answer.reference in (None, b) for a, b in pairs),
        f"{predictions.where(line, 'answer')}: the answer is no pair of a target and a reference that are proposed",
        got=f"{answer.object}, {answer.reference}" if answer.reference is not None else answer.object,
        expected="object: an id of the target's proposals; reference: one of the reference's",
        path=predictions.path,
    )
