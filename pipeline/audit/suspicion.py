"""An item of a benchmark whose truth may be wrong, the evidence, and how pieces of evidence make one probability.

Each piece of evidence has a weight: the probability that the truth is wrong where nothing else is known. Weights are
joined as likelihood ratios against PRIOR, as if they were independent:

    logit(score) = logit(PRIOR) + sum over pieces of (logit(weight) - logit(PRIOR))

One piece alone gives its weight; what speaks for the truth has a weight below PRIOR. Of one kind only the strongest
piece that speaks against the truth counts, for two findings about one pair are not two witnesses. (How well this ranks
planted errors is measured in `tests/benchmarks/audited.py`.)
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np

from pipeline.evaluation.records import read_records
from pipeline.evaluation.run_folder import RECORDS_FILE
from pipeline.evaluation.sentences import FILE
from pipeline.geometry.boxes import iou_2d
from pipeline.labels.cases import HIT
from pipeline.system.errors import InputError, as_input_error, first_line
from pipeline.system.frozen import dataclass
from pipeline.system.safe_files import parse_json, read_text

Kind = Literal["geometry", "several", "frame", "class", "systems", "region", "contradiction"]
KINDS: dict[Kind, str] = {
    "geometry": "the relation's rule says otherwise",
    "several": "several things are right, and the sentence says “the”",
    "frame": "right by the object's own left, right, front and back, and not by the viewer's",
    "class": "what is right has another name than the sentence asks for",
    "systems": "systems agree with each other against it",
    "region": "the points of the answer do not lie in its mask",
    "contradiction": "another item of the same picture says the opposite",
}
"""What each kind of evidence says, in words."""
PRIOR = 0.05
"""The share of wrong items where nothing is known: published audits of benchmarks find 3 to 30 %."""
LEAST, MOST = 0.005, 0.98
SHARE_RIGHT, SHARE_CHANCE = 0.6, 0.2
"""A system gives the right answer of an item so often, and any one other answer so often."""
CORRELATED = 0.6
"""Systems err alike: the evidence of each counts by this exponent."""


@dataclass(frozen=True)
class Evidence:
    """One piece: its kind, its weight, what it says in words, and the figures that it rests on."""

    kind: Kind
    weight: float
    text: str
    figures: tuple[tuple[str, float], ...] = ()

    def record(self) -> dict[str, Any]:
        figures = {name: round(value, 4) for name, value in self.figures}
        return {"kind": self.kind, "weight": round(self.weight, 4), "text": self.text, **figures}


@dataclass(frozen=True)
class AuditItem:
    """An item with what is known against its truth."""

    id: str
    """Its own in the benchmark or labels; of a file of lines the line's number."""
    frame: str
    text: str
    truth: str
    """What it says is right, in words."""
    seems: str | None = None
    """What seems right; None where nothing in particular does."""
    evidence: tuple[Evidence, ...] = ()
    """For and against it."""
    unjudged: str | None = None
    """Why geometry says nothing of it."""

    @property
    def score(self) -> float:
        return wrong_probability(self.evidence)

    @property
    def reasons(self) -> tuple[Evidence, ...]:
        """Evidence against the truth, the strongest first."""
        return tuple(sorted((e for e in self.evidence if e.weight > PRIOR), key=lambda e: -e.weight))

    def record(self, look: str = "") -> dict[str, Any]:
        return {
            "score": round(self.score, 4),
            "id": self.id,
            "frame": self.frame,
            "text": self.text,
            "truth": self.truth,
            "seems": self.seems,
            "evidence": [e.record() for e in self.reasons],
            "unjudged": self.unjudged,
            "look": look,
        }


def wrong_probability(evidence: Iterable[Evidence]) -> float:
    """Probability of a wrong truth by all evidence; PRIOR without any."""
    told: dict[str, float] = {}
    total = 0.0
    for piece in evidence:
        odds = logit(piece.weight) - logit(PRIOR)
        if odds > 0:
            told[piece.kind] = max(odds, told.get(piece.kind, 0.0))
        else:
            total += odds
    return 1 / (1 + math.exp(-(logit(PRIOR) + total + sum(told.values()))))


def logit(p: float) -> float:
    """Log odds of a weight kept between LEAST and MOST."""
    p = min(max(p, LEAST), MOST)
    return math.log(p / (1 - p))


def agreement_weight(against: int, agreeing: int) -> float:
    """Weight of systems' answers: `against` agree on another answer, `agreeing` give the truth.

    A system that gives the truth's answer speaks for it as one that gives that other answer speaks against it, by the
    ratio of SHARE_RIGHT to SHARE_CHANCE.
    """
    odds = CORRELATED * (against - agreeing) * math.log(SHARE_RIGHT / SHARE_CHANCE)
    return 1 / (1 + math.exp(-(logit(PRIOR) + odds)))


Key = tuple[str, str]
"""The frame and the text."""


@dataclass(frozen=True)
class SystemAnswers:
    """The boxes (x0, y0, x1, y1, pixels) that a system answered with; what it did not answer is left out."""

    name: str
    boxes: dict[Key, tuple[float, ...]]


def read_answers(folder: Path) -> SystemAnswers:
    """The answers of a run folder: of labels (`eval --labels`, `import-run`), or of sentences (`eval --sentences`).

    Raises InputError: it is no run folder, or damaged.
    """
    if (folder / RECORDS_FILE).is_file():
        rows = read_records(folder).select(["frame", "text", "box"]).to_pylist()
        found = {(r["frame"], r["text"]): tuple(r["box"]) for r in rows if r["box"] is not None}
        return SystemAnswers(folder.name, found)
    if not (folder / FILE).is_file():
        raise InputError("no run here", expected=f"a folder with {RECORDS_FILE} or {FILE}", path=folder)
    with as_input_error("the run is damaged", OSError, ValueError, KeyError, TypeError, got=first_line, path=folder):
        lines = [parse_json(line, folder) for line in read_text(folder / FILE).splitlines()]
        boxes = {(r["frame"], r["sentence"]): tuple(r["answer"]["bbox"]) for r in lines if r["answer"] is not None}
    return SystemAnswers(folder.name, boxes)


def system_evidence(
    systems: Sequence[SystemAnswers], key: Key, right: np.ndarray, named: Sequence[tuple[str, np.ndarray]] = ()
) -> tuple[Evidence, str | None] | None:
    """Evidence by systems' answers and the object meant by most; None without answers.

    `right` (K, 4) float: boxes that the truth accepts, pixels. `named` sequence of (str, (4,) float): the annotated
    objects by name, so that it can be told which one is meant.
    """
    answered = [(s.name, np.array(s.boxes[key], np.float64)) for s in systems if key in s.boxes]
    if not answered:
        return None
    boxes = np.stack([box for _, box in answered])
    agreeing = np.asarray((iou_2d(boxes, right) >= HIT).any(axis=1))
    others = boxes[~agreeing]
    together = iou_2d(others, others) >= HIT
    most = int(together.sum(axis=1).argmax()) if len(others) else -1
    against = int(together[most].sum()) if most >= 0 else 0
    weight = agreement_weight(against, int(agreeing.sum()))
    meant = _named(others[most], named) if most >= 0 else None
    names = ", ".join(name for (name, _), own in zip(answered, agreeing, strict=True) if not own) or "none"
    text = (
        f"{against} of {len(answered)} systems give the same other answer{'' if meant is None else f', {meant}'} "
        f"({names}); {int(agreeing.sum())} give the one that is said to be right"
    )
    figures = (("systems", float(len(answered))), ("against", float(against)), ("agreeing", float(agreeing.sum())))
    return Evidence("systems", weight, text, figures), meant if against > 1 else None


def _named(box: np.ndarray, named: Sequence[tuple[str, np.ndarray]]) -> str | None:
    overlaps = [float(iou_2d(box[None], other[None])[0, 0]) for _, other in named]
    best = int(np.argmax(overlaps)) if overlaps else -1
    return named[best][0] if best >= 0 and overlaps[best] >= HIT else None
