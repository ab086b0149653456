"""Answer with its verdict, for Python and as JSON."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from pipeline.answering.answer_words import holds, pair_words, why_no_answer, words_of_answer
from pipeline.answering.ask import Trace
from pipeline.answering.json_records import present, trace_record
from pipeline.answering.objects import SceneObject
from pipeline.answering.pair_table import ScoredPair
from pipeline.datasets.plausible import depth_doubt
from pipeline.diagnosis.oracles import RECALL, names_of
from pipeline.diagnosis.stages import stages_of
from pipeline.diagnosis.verdict import Diagnosis
from pipeline.system.errors import InputError
from pipeline.system.in_notebook import InNotebook

Edited = Mapping[str, Any]
"""Edits as JSON; see `pipeline.diagnosis.whatif`."""


class AnswerSource(Protocol):
    """Pipeline behind an answer, able to answer under edits, with or without a screen."""

    def what_if(self, answer: Answer, edits: Edited) -> Answer: ...

    def view(self, what: Any, **options: Any) -> Any: ...


@dataclass(frozen=True)
class Answer(InNotebook):
    """Answer to an expression, with its trace and verdict; positions in `pairs` are those in `objects`."""

    text: str  # The expression as it was asked
    trace: Trace | None = None  # Every stage's input and output; None where the expression cannot be read or asked
    problem: str | None = None  # Why it cannot
    diagnosis: Diagnosis | None = None  # None where there is no verdict
    # Why there is a truth and no verdict on this answer; None also where no truth is known at all
    unjudged: str | None = None
    origin: AnswerSource | None = None  # What answered it, where one is asked from Python: edits and the page need it
    edits: Edited | None = None  # What it was answered under, as JSON; None for none

    def __repr__(self) -> str:
        frame = "" if self.trace is None else f" on {self.trace.frame.id!r}"
        return f"<Answer {self.text!r}{frame}: {self.sentence}; {self.verdict or 'no verdict'}>"

    @property
    def objects(self) -> tuple[SceneObject, ...]:
        """Detections of all names of the expression, lifted."""
        return () if self.trace is None else self.trace.objects

    @property
    def pairs(self) -> tuple[ScoredPair, ...]:
        """Candidate pairs, best first; empty where a name was not found."""
        ranking = None if self.trace is None else self.trace.ranking
        return () if ranking is None or ranking.degenerate else ranking.pairs

    @property
    def target(self) -> SceneObject | None:
        """Answered object; None without an answer."""
        return self.objects[self.pairs[0].target] if self.pairs else None

    @property
    def reference(self) -> SceneObject | None:
        """Reference of the answered object; of "between" the first end."""
        number = self.pairs[0].reference if self.pairs else None
        return None if number is None else self.objects[number]

    @property
    def holds(self) -> bool | None:
        """True for an answer fulfilling all of the question; None for the same with parts of the question unused."""
        return self.trace is not None and holds(self.trace)

    @property
    def relation_probability(self) -> float | None:
        """Probability of the asked relation for the best pair, of several the weakest; None without a pair."""
        return self.pairs[0].relation_probability if self.pairs else None

    @property
    def sentence(self) -> str:
        """Answer in words, or the reason for none."""
        trace = self.trace
        if trace is None:
            return self.problem or "no answer"
        if not self.pairs:
            return why_no_answer(trace) or "no answer"
        return words_of_answer(trace, trace.name).sentence(pair_words(trace, self.pairs[0], trace.name))

    @property
    def verdict(self) -> str | None:
        """CORRECT, or the module that failed; None without a known truth."""
        return None if self.diagnosis is None else self.diagnosis.verdict

    @property
    def why(self) -> str | None:
        """Verdict in words with the smallest mending change; else the reason for none, if known."""
        return self.unjudged if self.diagnosis is None else self.diagnosis.text

    def needed_trace(self) -> Trace:
        """Trace; InputError where the expression could not be asked."""
        if self.trace is None:
            raise InputError(f"there is no trace of {self.text!r}: {self.problem}")
        return self.trace

    def record(self) -> dict[str, Any]:
        """Record of `ask --json`: `trace_record`, "stages" in words, and with a known truth "verdict", or null with
        "verdict_reason"."""
        record, judged, trace = _answer_record(self), self.diagnosis or self.unjudged, self.trace
        if trace is not None:
            odd = depth_doubt(trace.frame) is not None
            record["stages"] = [stage.record() for stage in stages_of(trace, judged, odd_depth=odd)]
        if self.diagnosis is not None:
            return {**record, "verdict": diagnosis_record(self.diagnosis)}
        return record | ({} if self.unjudged is None else {"verdict": None, "verdict_reason": self.unjudged})

    def what_if(self, edits: Edited) -> Answer:
        """Answer under edits, written as for `whatif --edits`; judged by the same truth.

        Raises
        ------
        InputError
            Edits that cannot be read, or an answer of another origin than `open`.

        >>> from pipeline import ask
        >>> answer = ask("demo", 0, "mug left of the laptop")
        >>> answer.what_if({"hidden": ["#3"]}).sentence
        'no such pair; nearest is mug·4 left of laptop·2: relation <0.0001, product <0.0001'
        """
        return self._origin().what_if(self, edits)

    def show(self, **options: Any) -> Any:
        """Open this answer in the page; `options` as for `spatialviz.show`."""
        return self._origin().view(self, **options)

    def _origin(self) -> AnswerSource:
        if self.origin is None:
            raise InputError("this answer does not know what answered it", expected="one that `ask` of `open` gave")
        return self.origin


def answer_record(answered: Answer) -> dict[str, Any]:
    """Record kept by a case: the answer as in `ask --json`, without times; "judgement" as in `diagnosis_record`."""
    record = _answer_record(answered)
    record.pop("timings_ms", None)
    record["judgement"] = None if answered.diagnosis is None else diagnosis_record(answered.diagnosis)
    return record


def _answer_record(answer: Answer) -> dict[str, Any]:
    if answer.trace is None:
        return {"expression": {"text": answer.text}, "answer": None, "reason": answer.problem}
    return trace_record(answer.trace)


def diagnosis_record(d: Diagnosis) -> dict[str, Any]:
    """Diagnosis as in `ask --json`: objects are indices of "proposals", those of `truth` the labels' numbers."""
    case, numbers = d.case, d.truth.numbers
    missed = (
        None
        if d.missed is None
        else {
            "name": d.missed_name,
            "kind": d.missed.kind,
            "overlap": round(d.missed.overlap, 4),
            "score": _rounded(d.missed.score),
            "rank": d.missed.rank,
            "suppressed": d.missed.suppressed,
        }
    )
    return {
        "verdict": d.verdict,
        "detail": d.detail,
        "lucky": d.lucky,
        "said": d.text,
        "repair": list(d.repair),
        "mends": list(d.mends),
        "truth": {
            "target": int(numbers[case.target_object]),
            "reference": int(numbers[case.reference_object]) if case.reference else None,
            "targets": numbers[case.strict].tolist(),
            "acceptable": numbers[case.acceptable].tolist(),
        },
        "winner": _pair_record(d.winner),
        "right": _pair_record(d.right),
        "contributions": None if d.contributions is None else {k: round(v, 6) for k, v in d.contributions.items()},
        "margins": {"+".join(names_of(s)) or "none": _rounded(d.margins[s]) for s in _shown(d)},
        "needed": [
            {
                "factor": n.factor,
                "right": round(n.right, 6),
                "winner": round(n.winner, 6),
                "right_above": _rounded(n.right_above),
                "winner_below": _rounded(n.winner_below),
            }
            for n in d.needed
        ],
    } | present(missed=missed)


def _shown(d: Diagnosis) -> tuple[int, ...]:
    """Subsets of oracles with printed margins: none, each alone but RECALL, these together, and all."""
    last = len(d.margins) - 1
    return (0, *(1 << k for k in range(1, len(d.oracles))), last - RECALL, last)


def _pair_record(pair: ScoredPair | None) -> dict[str, Any] | None:
    if pair is None:
        return None
    names = ("p_target", "p_reference", "p_relation", *(("p_attributes",) if pair.factors else ()), "log_score")
    factors = {name: round(getattr(pair, name), 6) for name in names}
    return {"target": pair.target, "reference": pair.reference, **factors}


def _rounded(value: float | None) -> float | None:
    return None if value is None or not np.isfinite(value) else round(float(value), 6)
