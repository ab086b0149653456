"""Audits of sentences, or of RoboSpatial-Home's questions: the ranked list, its counts, and a maintainer's files."""

from __future__ import annotations

import json
import shlex
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.answering.pipeline import Pipeline, open_pipeline
from pipeline.audit.benchmarks import NO_RELATION, Statement, is_benchmark, open_benchmark, read_benchmark
from pipeline.audit.sentences import HOLDS, audit_sentences
from pipeline.audit.statements import ONE_OF_TWO, Triple, audit_statements, implied, of_geometry, triple_of
from pipeline.audit.suspicion import KINDS, PRIOR, AuditItem, Evidence, agreement_weight, read_answers
from pipeline.datasets.files import read_bytes
from pipeline.diagnosis.whatif.state import ViewState, encode
from pipeline.evaluation.robospatial import (
    Question,
    QuestionAnswers,
    drawn,
    is_robospatial,
    points_of,
    published_right,
    read_question_answers,
    read_questions,
    score_table,
)
from pipeline.evaluation.sentence_files import read_sentence_file
from pipeline.labels.reading import MANIFEST_FILE
from pipeline.metrics.tables import Row, Table
from pipeline.system.errors import InputError, needed, require
from pipeline.system.frozen import dataclass
from pipeline.system.reading import Content
from pipeline.system.whole_files import write_whole

UNUSABLE = 0.95
"""An answer that the published metric can never count as right."""
OUTSIDE, APART, SAME_REGION = 0.1, 0.8, 0.5
"""The share of an answer's points that may lie outside its mask; the weight where all do; the least IoU of the polygon
that is scored with the mask that was drawn."""
SAME_PLACE = 0.1
"""Points of systems that differ by less of the picture's size are one answer."""


def audit_questions(
    questions: Sequence[Question],
    systems: Sequence[QuestionAnswers] = (),
    source: Pipeline | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Iterator[AuditItem]:
    """Audit every question in order; `progress` is told (done, in all).

    `source`: the benchmark's frames with a detector, for the geometry of yes/no questions; without it that is left out.

    Raises InputError: a picture or mask cannot be read.
    """
    against = _contradictions(questions)
    for number, question in enumerate(questions, start=1):
        item = AuditItem(question.id, question.frame, question.text, question.answer, None, tuple(against[question.id]))
        if question.yes is None:
            found = _of_region(question)
        else:
            found, why = _of_geometry(question, source)
            item = replace(item, unjudged=why)
        yield replace(item, evidence=(*item.evidence, *found, *_of_systems(question, systems)))
        if progress is not None:
            progress(number, len(questions))


def _statement(question: Question) -> Triple | None:
    asked = question.yes is not None and question.category == "configuration"
    return triple_of(question.text) if asked else None


def _contradictions(questions: Sequence[Question]) -> dict[str, list[Evidence]]:
    found: dict[str, list[Evidence]] = {q.id: [] for q in questions}
    told: dict[tuple[str, Triple], tuple[Question, bool]] = {}
    for question in questions:
        statement = _statement(question)
        if statement is None or question.yes is None:
            continue
        picture = sha256(read_bytes(question.picture)).hexdigest()
        for same, truth in implied(statement, question.yes):
            other = told.setdefault((picture, same), (question, truth))
            if other[1] != truth:
                for one, rival in ((question, other[0]), (other[0], question)):
                    text = f"{rival.id} of the same picture says {rival.answer} to “{rival.text}”"
                    piece = Evidence("contradiction", ONE_OF_TWO, text)
                    # Both say it again of the mirrored statement.
                    found[one.id] += [piece] if piece not in found[one.id] else []
    return found


def _of_region(question: Question) -> list[Evidence]:
    polygon, region = question.polygon, question.region()
    if not len(polygon):
        return [Evidence("region", UNUSABLE, "the answer is neither yes, no, nor three points")]
    if region is None:
        return []
    size = np.array(region.shape[::-1]) - 1
    column, row = np.clip(np.round(polygon * size), 0, size).astype(int).T
    outside = float((~region[row, column]).mean())
    scored = drawn(polygon, (region.shape[0], region.shape[1]))
    iou = float((scored & region).sum() / max((scored | region).sum(), 1))
    figures = (("outside", outside), ("iou", iou))
    if outside > OUTSIDE:
        text = f"{outside:.0%} of the answer's points lie outside its mask (IoU of the two {iou:.2f})"
        return [Evidence("region", APART * outside + 0.1, text, figures)]
    if iou < SAME_REGION:
        text = f"the polygon that is scored overlaps the mask by an IoU of {iou:.2f}: correct points count as wrong"
        return [Evidence("region", 0.1 + APART * (SAME_REGION - iou), text, figures)]
    return [Evidence("region", HOLDS, f"the points lie in the mask (IoU {iou:.2f})", figures)]


def _of_geometry(question: Question, source: Pipeline | None) -> tuple[list[Evidence], str | None]:
    if _statement(question) is None:
        return [], NO_RELATION
    stated = Statement(question.id, question.frame, question.text, bool(question.yes), question.answer)
    return of_geometry(stated, question.frame, source, "no detector looked at the picture (--detector)")


def _of_systems(question: Question, systems: Sequence[QuestionAnswers]) -> list[Evidence]:
    texts = [(s.name, s.texts[question.id]) for s in systems if question.id in s.texts]
    if not texts:
        return []
    wrong = [(name, text) for name, text in texts if not published_right(question, text)]
    if question.yes is None:
        places = np.array([points[0] for _, text in wrong if (points := points_of(text))]).reshape(-1, 2)
        near = np.linalg.norm(places[:, None] - places[None], axis=2) < SAME_PLACE
        against = int(near.sum(axis=1).max(initial=0))
    else:
        opposite = "no" if question.yes else "yes"
        against = sum(published_right(replace(question, answer=opposite), text) for _, text in wrong)
    agreeing = len(texts) - len(wrong)
    text = f"{against} of {len(texts)} systems give the same other answer ({', '.join(n for n, _ in wrong) or 'none'})"
    figures = (("systems", float(len(texts))), ("against", float(against)), ("agreeing", float(agreeing)))
    return [Evidence("systems", agreement_weight(against, agreeing), text, figures)]


LIKELY = 0.5
"""From this score on an item is more probably wrong than not."""


@dataclass(frozen=True)
class AuditReport:
    """Audited items, the most suspicious first; of equal ones in the order of the benchmark."""

    dataset: str
    """As it is named on the command line, for `look`."""
    items: tuple[AuditItem, ...]
    systems: Table | None = None
    """The systems that were compared, where the benchmark has a metric of its own."""

    @classmethod
    def ranked(cls, dataset: str, items: Iterable[AuditItem], systems: Table | None = None) -> AuditReport:
        return cls(dataset, tuple(sorted(items, key=lambda item: -item.score)), systems)

    @property
    def likely(self) -> int:
        """Number of items more probably wrong than not."""
        return sum(item.score >= LIKELY for item in self.items)

    @property
    def suspicious(self) -> tuple[AuditItem, ...]:
        """Items with evidence against their truth."""
        return tuple(item for item in self.items if item.score > PRIOR and item.reasons)

    @property
    def kinds(self) -> Table:
        """Suspicious items by kind of evidence, and by the strongest kind."""
        every = Counter(kind for item in self.suspicious for kind in {e.kind for e in item.reasons})
        first = Counter(item.reasons[0].kind for item in self.suspicious)
        rows = tuple(Row(kind, (every[kind], first[kind], words)) for kind, words in KINDS.items() if every[kind])
        return Table("audit", "What speaks against the truth", ("items", "foremost", "what it says"), rows)

    def look(self, item: AuditItem) -> str:
        """Command for opening the page on an item; empty without a dataset."""
        if not self.dataset:
            return ""
        view = encode(ViewState(Path(self.dataset).name, item.frame, item.text))
        return shlex.join(["spatialviz", "view", self.dataset, "--state", view])

    def record(self) -> dict[str, Any]:
        """Counts as JSON."""
        return {
            "items": len(self.items),
            "suspicious": len(self.suspicious),
            "likely_wrong": self.likely,
            "expected_wrong": round(sum(item.score for item in self.items), 1),
            "unjudged": sum(item.unjudged is not None for item in self.items),
            "unjudged_because": dict(Counter(item.unjudged for item in self.items if item.unjudged).most_common()),
            "kinds": {row.name: row.cells[0] for row in self.kinds.rows},
        }

    def records(self) -> Iterator[dict[str, Any]]:
        """Every item by rank, as JSON."""
        return ({"rank": n, **item.record(self.look(item))} for n, item in enumerate(self.items, start=1))

    def write(self, path: Path) -> None:
        """Every item by rank, as JSON lines.

        Raises InputError: it cannot be written, or its name ends in .csv, as in earlier versions.
        """
        require(path.suffix != ".csv", "an audit is written as JSON lines", expected="a name such as audit.jsonl")
        lines = (json.dumps(record, ensure_ascii=False) + "\n" for record in self.records())
        write_whole(path, "".join(lines).encode(), "the audit")


def audit(
    target: Path,
    dataset: str | None = None,
    runs: Sequence[Path] = (),
    *,
    options: dict[str, Any] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> AuditReport:
    """The items of a benchmark, ranked by how probably their truth is wrong.

    `target`: the folder of RoboSpatial-Home; a file of statements as VSR, BLINK, CV-Bench, What'sUp, ScanRefer or Nr3D
    publish them (`pipeline.audit.benchmarks`); or, about the frames of `dataset`, a file of sentences as `eval
    --sentences` takes it. `runs`: run folders of systems that answered the same items; of RoboSpatial-Home files of
    answers in its form. `options`: arguments of `open_pipeline`.

    Raises InputError: something cannot be read, or --dataset is missing.
    """
    if is_robospatial(target):
        return _of_questions(target, dataset, runs, options or {}, progress)
    systems = [read_answers(run) for run in runs]
    require(target.exists(), "there is nothing to audit", expected="a benchmark's file", path=target)
    labels = (target / MANIFEST_FILE).is_file()
    require(not labels, "labels are reviewed, not audited", expected=f"spatialviz review {target}", path=target)
    content = _benchmark(target)
    if content is not None:
        require(not runs, "runs are compared on sentences and RoboSpatial-Home alone", got=f"{len(runs)} runs")
        _, stated = read_benchmark(content)
        seen = None if dataset is None else open_pipeline(dataset, **(options or {}))
        return AuditReport.ranked(dataset or "", audit_statements(stated, seen, progress))
    where = needed(dataset, "sentences are audited on their dataset", expected="--dataset DATASET", path=target)
    source = open_pipeline(where, **(options or {}))
    asked = read_sentence_file(target, source, where if where == "demo" else None)
    return AuditReport.ranked(where, audit_sentences(source, asked, systems, progress))


def _benchmark(target: Path) -> Content | None:
    """Content of a benchmark of statements, or of a file that is none of sentences either; None for other files."""
    if target.suffix not in (".json", ".jsonl", ".csv", ".parquet"):
        return None
    with suppress(InputError):
        content = open_benchmark(target)
        if is_benchmark(content) or (content.first and not {"frame", "sentence", "sentences"} & content.first.keys()):
            return content
    return None


def _of_questions(
    root: Path,
    dataset: str | None,
    runs: Sequence[Path],
    options: dict[str, Any],
    progress: Callable[[int, int], None] | None,
) -> AuditReport:
    where = dataset or str(root)
    questions = read_questions(root)
    systems = [read_question_answers(run, questions) for run in runs]
    source = open_pipeline(where, **options) if options.get("detector") else None
    items = list(audit_questions(questions, systems, source, progress))
    doubted = {item.id for item in items if item.score >= LIKELY}
    table = score_table(questions, systems, doubted) if systems else None
    return AuditReport.ranked(where, items, table)
