"""Audits of sentences or questions: the ranked list, its counts, and the files for a maintainer."""

from __future__ import annotations

import json
import shlex
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pipeline.answering.pipeline import open_pipeline
from pipeline.audit.questions import audit_questions
from pipeline.audit.sentences import audit_sentences
from pipeline.audit.suspicion import KINDS, PRIOR, AuditItem, read_answers
from pipeline.diagnosis.whatif.state import ViewState, encode
from pipeline.evaluation.robospatial import is_robospatial, read_question_answers, read_questions, score_table
from pipeline.evaluation.sentence_files import read_sentence_file
from pipeline.labels.reading import MANIFEST_FILE
from pipeline.metrics.tables import Row, Table
from pipeline.system.errors import needed, require
from pipeline.system.whole_files import write_whole

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
        """Command for opening the page on an item."""
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

    `target`: the folder of RoboSpatial-Home; or, about the frames of `dataset`, a file of sentences as `eval
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
    where = needed(dataset, "sentences are audited on their dataset", expected="--dataset DATASET", path=target)
    source = open_pipeline(where, **(options or {}))
    asked = read_sentence_file(target, source, where if where == "demo" else None)
    return AuditReport.ranked(where, audit_sentences(source, asked, systems, progress))


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
