"""What became of sentences that people wrote: shares with intervals by kind, classes of failure, a line for each."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, get_args

import numpy as np

from pipeline.answering.pipeline import Pipeline
from pipeline.diagnosis.oracles import shown_oracle
from pipeline.diagnosis.verdict import VERDICTS
from pipeline.evaluation.costs import Deltas, oracle_deltas
from pipeline.evaluation.sentence_files import ACC_AT, SentenceFile, read_sentence_file
from pipeline.evaluation.sentences import Judged, Outcome, judge_sentences
from pipeline.metrics.intervals import Estimate, share_estimate
from pipeline.metrics.tables import Cell, Row, Table
from pipeline.system.whole_files import check_target, staged_folder, text_file

FILE = "sentences.jsonl"
ACC_NOTE = (
    "The share of answers whose 3D box overlaps the right one's by more than that, both upright along the viewer's "
    "axes; refusals count as wrong. Sentences whose right object has no 3D box are left out."
)


SHARES = {
    "read": "read",
    "answered": "answered",
    "right": "right",
    "refused_rightly": "refused rightly",
    "told": "refused of not right",
}
"""Shares and their columns in the table: of all sentences; `refused_rightly` of those where nothing is right; `told`,
refused with a reason, of those that are not right."""
Shares = dict[str, "Estimate | int"]
"""How many `sentences`, and each of SHARES."""


@dataclass(frozen=True)
class SentenceReport:
    """A judged file."""

    asked: SentenceFile
    judged: tuple[Judged, ...]
    overall: Shares
    kinds: dict[str, Shares]  # in the order in which the kinds first stand in the file
    # failures dict of (outcome, detail) to int: in the order of Outcome, the most frequent first
    failures: dict[tuple[str, str | None], int]

    @property
    def verdicts(self) -> dict[str, int]:
        """Count sentences by verdict, in the order of VERDICTS; verdicts without any are left out."""
        counts = Counter(j.verdict for j in self.judged)
        return {name: counts[name] for name in VERDICTS if counts[name]}

    @cached_property
    def deltas(self) -> Deltas | None:
        """Costs of modules over the diagnosed sentences, ATTRIBUTE where any has attributes; None without any."""
        found = [(d, d.right_with, j.sentence.frame) for j in self.judged if (d := j.diagnosis) is not None]
        if not found:
            return None
        oracles = max((d.oracles for d, *_ in found), key=len)
        # Without attributes the oracle of attributes changes nothing.
        right = [
            with_ | (with_ << len(d.margins) if len(d.oracles) < len(oracles) else 0)
            for d, with_, _ in found
            if with_ is not None
        ]
        frames = [frame for _, with_, frame in found if with_ is not None]
        return oracle_deltas(np.array(right, np.int64), np.array(frames), oracles=oracles)

    @property
    def tables(self) -> tuple[Table, ...]:
        """Shares by kind and over all, failures, verdicts, costs of each module (possibly empty); for a published
        benchmark also the benchmark's metric."""
        note = (
            "In percent, with Wilson's 95 % intervals, each sentence for itself. Read: also what was refused rightly. "
        )
        note += "Refused rightly: of the sentences for which nothing is right."
        rows = [Row(name, tuple(shares.values())) for name, shares in (*self.kinds.items(), ("all", self.overall))]
        total = len(self.judged)
        failed = [Row(": ".join(filter(None, name)), (count, count / total)) for name, count in self.failures.items()]
        judged, costs = sum(self.verdicts.values()), self.deltas
        verdicts = [Row(name, (count, count / judged)) for name, count in self.verdicts.items()]
        unjudged = f"{total - judged} have none: nothing is right, several things tie, or no truth is to be had."
        shapley = (
            "Points gained with a module replaced by the truth, over the sentences that were diagnosed: by it alone, "
            "and its fair share over all orders of replacing. The second column adds up to 100."
        )
        modules = () if costs is None else _costs(costs)
        return (
            Table("sentences", "Sentences", ("sentences", *SHARES.values()), tuple(rows), note),
            Table("failures", "Failures", ("sentences", "share"), tuple(failed)),
            Table("verdicts", "Verdicts", ("sentences", "share"), tuple(verdicts), unjudged),
            Table("oracles", "What each module costs", ("alone", "Shapley"), modules, shapley),
            *self._published_table(),
        )

    def _published_table(self) -> Iterator[Table]:
        if self.published:
            rows = tuple(Row(name, cells) for name, cells in self.published.items())
            columns = ("sentences", *(f"Acc@{at:g}" for at in ACC_AT))
            yield Table("published", "As the benchmark publishes it", columns, rows, ACC_NOTE)

    @cached_property
    def published(self) -> dict[str, tuple[Any, ...]]:
        """Acc@IoU at each of ACC_AT and the number of right 3D boxes, by kind and "all", of a published benchmark."""
        rows = [(j.sentence.kind, j.iou_3d) for j in self.judged if j.iou_3d is not None]
        found = {}
        for kind in dict.fromkeys([k for k, _ in rows] + ["all"] * bool(rows)):
            iou = np.array([v for k, v in rows if kind in (k, "all")])
            found[kind] = len(iou), *(share_estimate(iou > at, np.arange(len(iou))) for at in ACC_AT)
        return found

    def record(self) -> dict[str, Any]:
        """Convert to JSON: `eval --sentences --json`."""
        return {
            "file": str(self.asked.path),
            "skipped": self.asked.skipped,
            "all": _record(self.overall),
            "kinds": {kind: _record(shares) for kind, shares in self.kinds.items()},
            "verdicts": self.verdicts,
            "oracles": None if self.deltas is None else self.deltas.record(),
            "published": {
                kind: {"sentences": n, **{f"acc@{at:g}": c.record() for at, c in zip(ACC_AT, cells, strict=True)}}
                for kind, (n, *cells) in self.published.items()
            },
            "failures": [
                {"outcome": outcome, "detail": detail, "count": n, "share": n / len(self.judged)}
                for (outcome, detail), n in self.failures.items()
            ],
        }


def _costs(found: Deltas) -> tuple[Row, ...]:
    lines: list[tuple[str, tuple[Cell, Cell]]] = [("as answered", (None, float(found.value[0])))]
    lines += [(shown_oracle(name), (found.single[name], found.shapley[name])) for name in found.single]
    lines.append(("residual", (None, float(1 - found.value[-1]))))
    return tuple(Row(name, cells) for name, cells in lines)


def _record(shares: Shares) -> dict[str, Any]:
    return {name: value if isinstance(value, int) else value.record() for name, value in shares.items()}


def report_sentences(asked: SentenceFile, judged: Sequence[Judged]) -> SentenceReport:
    """Count shares by kind and over all, and failures."""
    kinds: dict[str, list[Judged]] = {}
    for one in judged:
        kinds.setdefault(one.sentence.kind, []).append(one)
    failures = Counter((j.outcome, j.detail) for j in judged if not j.right)
    order = sorted(failures, key=lambda f: (get_args(Outcome).index(f[0]), -failures[f], str(f[1])))
    shares = {kind: _shares(own) for kind, own in kinds.items()}
    return SentenceReport(asked, tuple(judged), _shares(judged), shares, {f: failures[f] for f in order})


def _shares(judged: Sequence[Judged]) -> Shares:
    def share(holds: Callable[[Judged], bool], of: Callable[[Judged], bool] = lambda j: True) -> Estimate:
        counted = [j for j in judged if of(j)]
        return share_estimate(np.array([holds(j) for j in counted], np.bool_), [j.sentence.frame for j in counted])

    return {
        "sentences": len(judged),
        "read": share(lambda j: j.read),
        "answered": share(lambda j: j.answered),
        "right": share(lambda j: j.right),
        "refused_rightly": share(lambda j: j.right, lambda j: j.sentence.nothing),
        "told": share(lambda j: not j.answered, lambda j: not j.right),
    }


def evaluate_sentences(
    path: Path,
    source: Pipeline,
    *,
    name: str | None = None,
    out: Path | None = None,
    overwrite: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> SentenceReport:
    """Judge the sentences of a file; with `out`, a folder with a line for each sentence in `sentences.jsonl`.

    Raises InputError: as `read_sentence_file` and `judge_sentences`; or the folder cannot be written. Nothing is left
    of it then.
    """
    if out is not None:
        check_target(out, overwrite=overwrite, mark=FILE)
    asked = read_sentence_file(path, source, name)
    report = report_sentences(asked, judge_sentences(source, asked, progress))
    if out is not None:
        with staged_folder(out, overwrite=overwrite, mark=FILE) as folder, text_file(folder / FILE) as file:
            file.writelines(json.dumps(j.record(), ensure_ascii=False, allow_nan=False) + "\n" for j in report.judged)
    return report
