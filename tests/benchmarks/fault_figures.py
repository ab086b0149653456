"""Figures of planted faults: files of broken lines, their verdicts, and how often these name the module.

A file has some lines broken, each by some fault, or every line by the same one. A fault counts where the pipeline
answers right without it and wrong with it (`ForeignPipeline.counts`); what follows in the pipeline follows from it.
"""

from __future__ import annotations

import argparse
import json
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np
from benchmarks.fault_purity import true_pairs
from benchmarks.foreign_pipelines import (
    ForeignPipeline,
    Question,
    Rng,
    Scene,
    is_right,
    judged,
    predicted,
    questions,
    ranked,
    scenes,
)

from pipeline.answering.pipeline import open_pipeline
from pipeline.answering.predictions import Prediction, write_predictions
from pipeline.datasets.base import Dataset
from pipeline.datasets.demo import demo_labels
from pipeline.evaluation.run import Evaluator
from pipeline.evaluation.systems import EvalSpec
from pipeline.labels.cases import read_cases
from pipeline.labels.job import label
from pipeline.labels.reading import Labels, open_labels
from pipeline.metrics.intervals import share_estimate
from pipeline.synthetic import render_dataset

FAULTS = ("OPM-TARGET", "OPM-REF", "LIFT", "SRM", "OPM-CONF", "PRM")
"""The modules in which faults are planted; each is the verdict that names it. A fault is one, or "MODULE kind"."""
PLANTED_SHARE = 0.35
Tried = Callable[[Rng, bool], Sequence[str]]
"""Faults to try in a line, until one counts, by the generator and by whether the answer is right."""


@dataclass(frozen=True)
class Line:
    """A line of predictions.

    Attributes
    ----------
    line : Prediction
    fault : str or None
        The fault that counts in it.
    right : bool
        Without a fault the answer is right.
    before, after : Question
        Without and with what is broken in it.
    """

    line: Prediction
    fault: str | None
    right: bool
    before: Question
    after: Question


def random_fault(faults: Sequence[str], share: float) -> Tried:
    """Fault of a list, in a share of the lines whose answers are right."""
    return lambda rng, right: [str(rng.choice(faults))] if rng.random() < share and right else []


def broken_lines(
    own: ForeignPipeline, frames: Iterable[Scene], seed: int, every: int, tried: Tried, whole: bool = False
) -> Iterator[Line]:
    """Lines of each so manieth expression; in a `whole` file a fault stays also where the answer is as it was."""
    rng = np.random.default_rng(seed)
    for q in questions(own, frames, rng, seed, every):
        clean = predicted(own, q)
        right, broken, counts = is_right(own, clean, q), None, None
        for fault in tried(rng, right):
            broken = own.planted(fault, q, rng, whole)
            if broken is not None and own.counts(fault.split()[0], q, broken):
                counts = fault
                break
            broken = broken if whole else None
        yield Line(clean if broken is None else predicted(own, broken), counts, right, q, broken or q)


def lines(
    own: ForeignPipeline,
    dataset: Dataset,
    labels: Labels,
    seed: int,
    every: int = 1,
    share: float = PLANTED_SHARE,
    faults: Sequence[str] = FAULTS,
) -> Iterator[Line]:
    """Lines of the expressions of labels, some of them with a fault."""
    return broken_lines(own, scenes(own, dataset, labels), seed, every, random_fault(faults, share))


class Row(NamedTuple):
    """A line with its verdict."""

    line: Line
    verdict: str
    detail: str | None

    @property
    def words(self) -> str:
        return f"{self.verdict} {self.detail}" if self.verdict in ("UNEXPLAINED", "COMPOUND") else self.verdict


def verdicts(own: ForeignPipeline, dataset: str | Path, labels: Labels, found: Sequence[Line]) -> list[Row]:
    """Judge every line as `import-run` does."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "predictions.jsonl"
        write_predictions(path, own.header, [f.line for f in found])
        evaluator = Evaluator(EvalSpec(str(dataset), str(labels.root), {"predictions": path}))
        lines = {(f.line.frame, f.line.text): f for f in found}
        judged = (row for truth in read_cases(labels, 0, 2**31 - 1) for row in evaluator.frame(truth))
        return [Row(lines[r["frame"], r["text"]], r["verdict"], r["detail"]) for r in judged]


def tally(rows: Iterable[Row]) -> dict[str, Counter[str]]:
    """Verdicts and how often they are given, by module; of lines without a fault under "clean"."""
    found: dict[str, Counter[str]] = {}
    for row in rows:
        module = "clean" if row.line.fault is None else row.line.fault.split()[0]
        found.setdefault(module, Counter())[row.words] += 1
    return found


def table(title: str, rows: Sequence[Row], kinds: Mapping[str, Sequence[str]]) -> Iterator[str]:
    """Lines of text: shares of faults that are named, in all, by module and by kind, and what is named for others."""
    planted = Counter(r.line.fault for r in rows if r.line.fault is not None)
    named = Counter(r.line.fault for r in rows if r.line.fault is not None and r.verdict == r.line.fault.split()[0])
    counts = tally(rows)
    yield f"{title}: named {named.total()} of {planted.total()}, {interval(named.total(), planted.total())}"
    for module in FAULTS:
        others = counts.get(module, Counter())
        n, hits = others.total(), others.pop(module, 0)
        by_kind = ", ".join(f"{k} {named[f'{module} {k}']}/{planted[f'{module} {k}']}" for k in kinds[module])
        of_kinds = f" ({by_kind})" if by_kind else ""
        yield f"  {module:10} {hits}/{n} {interval(hits, n)}{of_kinds}; else {dict(others.most_common())}"
    yield f"  clean      {dict(counts.get('clean', Counter()).most_common())}"


def interval(hits: int, n: int) -> str:
    """Share with Wilson's 95 % interval, percent; each line for itself."""
    return f"{share_estimate(np.arange(n) < hits, np.arange(n)).formatted()} %"


def readable(own: ForeignPipeline, q: Question) -> dict[str, Any]:
    """Question for people: answer, scores by id, centers and sizes (metres), and pairs with P and score."""
    answer, scores, p = predicted(own, q).answer, ranked(own, q), judged(own, q)
    used = [q.known[i] for i in {**q.targets, **q.references}]
    return {
        "answer": answer and (answer.object, answer.reference),
        "targets": {i: round(s, 3) for i, s in q.targets.items()},
        "references": {i: round(s, 3) for i, s in q.references.items()},
        "things": {t.id: [t.name, *np.round([*t.center, *t.size], 2).tolist()] for t in used},
        "pairs": [[*pair, round(p[pair], 3), round(score, 4)] for pair, score in scores.items()],
    }


def write_misses(path: Path, where: Sequence[object], own: ForeignPipeline, rows: Sequence[Row]) -> None:
    """Append a JSON line for each fault that was not named."""
    with path.open("a") as file:
        for row in rows:
            fault, q = row.line.fault, row.line.before
            if fault is not None and fault.split()[0] != row.verdict:
                line = {
                    "in": where,
                    "frame": q.frame.id,
                    "text": q.case.text,
                    "fault": fault,
                    "verdict": row.verdict,
                    "detail": row.detail,
                    "true": sorted(true_pairs(q)),
                    "before": readable(own, q),
                    "after": readable(own, row.line.after),
                }
                file.write(json.dumps(line) + "\n")


@dataclass(frozen=True)
class File:
    """One file of predictions: arguments of `broken_lines`."""

    seed: int
    every: int
    tried: Tried
    whole: bool = False


Ways = Callable[[range, int, int], Mapping[str, Sequence[File]]]
"""Files by a title, of the seeds of mixed files, and of two densities: every so manieth expression in these, and in
files of one fault or module."""


@dataclass(frozen=True)
class Study:
    """Pipelines by name, with what is planted in them, and what they are measured on.

    Attributes
    ----------
    names : sequence of str
    make : callable
    kinds : mapping of str to sequence of str
        Kinds of faults by module.
    ways : callable
    seeds, every, apart : int
        Number of mixed files, and the two densities.
    rooms : int or None
        Seed of rendered rooms; None for the demo.
    also : tuple of int
        The two densities on another dataset.
    """

    names: Sequence[str]
    make: Callable[[str], ForeignPipeline]
    kinds: Mapping[str, Sequence[str]]
    ways: Ways
    seeds: int
    every: int
    apart: int
    rooms: int | None = None
    also: tuple[int, int] = (1, 1)


def measure(study: Study, root: str | Path, labels: Labels, files: Mapping[str, Sequence[File]], given: Any) -> None:
    """Print a table for each pipeline and each kind of files."""
    data = open_pipeline(root, srm="rule").dataset
    for name in given.only or study.names:
        own = study.make(name)
        frames = list(scenes(own, data, labels))
        for words, kind in files.items():
            rows: list[Row] = []
            found: list[Line] = []
            for file in kind:
                lines = list(broken_lines(own, frames, file.seed, file.every, file.tried, file.whole))
                found += lines
                if not given.count:
                    rows += (judged_lines := verdicts(own, root, labels, lines))
                    if given.misses is not None:
                        write_misses(given.misses, (Path(root).name, name, words, file.seed), own, judged_lines)
            counts = Counter(line.fault for line in found if line.fault is not None)
            right = sum(line.right for line in found) / max(1, len(found))
            title = f"{name}, {Path(root).name}, {words} ({counts.total()} of {len(found)} lines; "
            title += f"right without faults {right:.1%})"
            faults = [f"{m} {k}" for m in FAULTS for k in study.kinds[m]]
            counted = [title, *(f"  {fault} {counts[fault]}" for fault in faults)]
            print(*(counted if given.count else table(title, rows, study.kinds)), sep="\n", flush=True)


def main(study: Study) -> None:
    """Print rates on the demo or on rendered rooms, and on another dataset."""
    assert set(study.kinds) == set(FAULTS)
    parser = argparse.ArgumentParser()
    parser.add_argument("--seeds", type=int, default=study.seeds, help="number of files with mixed faults")
    parser.add_argument("--first", type=int, default=0, help="the first seed of what is planted; added to the rooms'")
    parser.add_argument("--every", type=int, default=study.every, help="each so manieth expression in mixed files")
    parser.add_argument("--apart", type=int, default=study.apart, help="the same in files of one fault or module")
    parser.add_argument("--rooms", type=int, default=study.rooms, help="seed of the rooms")
    parser.add_argument("--also", type=Path, help="another dataset with annotations")
    parser.add_argument("--only", choices=study.names, action="append")
    parser.add_argument("--misses", type=Path, help="JSON lines of what was not named are appended to it")
    parser.add_argument("--count", action="store_true", help="count what is planted, and judge nothing")
    given = parser.parse_args()
    seeds = range(given.first, given.first + given.seeds)
    files = study.ways(seeds, given.every, given.apart)
    with TemporaryDirectory() as folder:
        if given.rooms is None:
            measure(study, "demo", open_labels(demo_labels()), files, given)
        else:
            rooms = Path(folder, "rooms")
            render_dataset(rooms, rooms=8, views=3, seed=given.rooms + given.first, width=480, height=360)
            measure(study, rooms, label(rooms, Path(folder, "labels")), files, given)
        if given.also is not None:
            labels = label(given.also, Path(folder, "also"))
            measure(study, given.also, labels, study.ways(seeds, *study.also), given)
