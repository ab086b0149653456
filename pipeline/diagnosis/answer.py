"""Answer with its stages in words and its verdict, for Python and as JSON."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any, Literal, Protocol, TypeAlias

import numpy as np

from pipeline.answering.answer_words import best_pair, holds, pair_words, probability, why_no_answer, words_of_answer
from pipeline.answering.ask import Trace
from pipeline.answering.detector_prompts import taken_as, unused_words
from pipeline.answering.json_records import present, relation_given, trace_record
from pipeline.answering.objects import SceneObject
from pipeline.answering.pair_table import HOLDS, ScoredPair
from pipeline.datasets.plausible import depth_doubt
from pipeline.diagnosis.oracles import RECALL, names_of
from pipeline.diagnosis.story import unjudged_story
from pipeline.diagnosis.story_words import Story, story_record
from pipeline.diagnosis.verdict import MODULE_OF, NOT_SEEN, Diagnosis, FactorRepair, Unseen
from pipeline.language.counted import counted
from pipeline.language.glossary import glossary
from pipeline.system.errors import InputError
from pipeline.system.frozen import dataclass
from pipeline.system.in_notebook import InNotebook

Mark: TypeAlias = Literal["good", "doubt", "bad", "idle"]
ALWAYS = ("PARSE", "OPM", "LIFT", "SRM", "PRM")
Judged: TypeAlias = "Diagnosis | Unseen | str | None"
"""The verdict, what is not in view, why there is none, or None where nothing is known of the truth."""


@dataclass(frozen=True)
class Stage:
    """Stage of an answer: a mark ("idle" for nothing to say), words, and the time taken."""

    name: str
    mark: Mark
    words: str
    cost: str = ""

    def record(self) -> dict[str, Any]:
        """JSON record, without the time."""
        return {
            "name": self.name,  # Module
            "mark": self.mark,  # good, doubt, bad or idle
            "words": self.words,  # As the page shows them
        }


def failed_stages(trace: Trace | None, judged: Judged, refused: str = "PARSE") -> tuple[str, ...]:
    """Failed stages: by the verdict, else where the question stopped, `refused` without a trace.

    None does where the label is in doubt, and not the answer.
    """
    if isinstance(judged, Diagnosis):
        if judged.verdict != "COMPOUND":
            return (MODULE_OF[judged.verdict],) if judged.verdict in MODULE_OF and judged.verdict != "LABEL" else ()
        return tuple(dict.fromkeys("OPM" if part in ("CONF", "RECALL") else part for part in judged.repair))
    if isinstance(judged, Unseen):
        return ()
    if trace is None:
        return (refused,)
    return () if why_no_answer(trace) is None else ("OPM",) if trace.missing else ("PRM",)


def stages_of(
    trace: Trace,
    judged: Judged,
    *,
    pair: ScoredPair | None = None,
    name: Callable[[int], str] | None = None,
    odd_depth: bool = False,
) -> tuple[Stage, ...]:
    """Stages in order: failed ones stand out, and with a right answer no other is in doubt.

    Parameters
    ----------
    judged : Diagnosis, Unseen, str or None
        The verdict, what is not in view, why there is none, or None where nothing is known of the truth.
    pair : ScoredPair, optional
        The one that is looked at; by default the best.
    name : callable, optional
        The name of an object by its index in the trace.
    odd_depth : bool
        Something speaks against the depth (`pipeline.datasets.plausible`).
    """
    pair, name = pair or best_pair(trace), name or trace.name
    failed, right = failed_stages(trace, judged), isinstance(judged, Diagnosis) and judged.correct
    made = (
        _parse(trace),
        _opm(trace),
        _lift(trace, pair, name, odd_depth),
        _srm(trace, pair),
        _attribute(trace, pair),
        _prm(trace),
    )
    every = (*filter(None, made), _label(judged, len(trace.frame.annotations)))
    # A wrong thing among the answer's is the detector's doing, whatever is to blame; what was not found is not lifted.
    marks: dict[str, Mark] = dict.fromkeys(("LIFT", "SRM"), "idle") if trace.missing else {}
    if isinstance(judged, Diagnosis) and (judged.false_target or judged.false_reference):
        marks["OPM"] = "doubt"
    if isinstance(judged, Diagnosis) and (judged.verdict, judged.detail) == ("PRM", "DEGENERATE"):
        marks["OPM"] = "doubt"
    excused = isinstance(judged, Unseen) or (isinstance(judged, Diagnosis) and judged.verdict in ("LABEL", NOT_SEEN))
    if excused and trace.missing:
        marks["OPM"] = "doubt"
    marks |= dict.fromkeys(failed, "bad")
    return tuple(replace(s, mark=marks.get(s.name, "good" if right and s.name != "LABEL" else s.mark)) for s in every)


def _ms(trace: Trace, stage: str) -> str:
    value = trace.timings.get(stage, 0.0) * 1000
    return f"{value:.1f} ms" if value < 100 else f"{value:.0f} ms"


def _sound(is_so: object) -> Mark:
    return "good" if is_so else "doubt"


def _parse(trace: Trace) -> Stage:
    several = f"one of {len(trace.query.readings)} readings" if len(trace.query.readings) > 1 else ""
    reading = trace.query.default if trace.ranking is None else trace.ranking.reading
    words = "; ".join(filter(None, (reading.description, several, *parse_notes(trace))))
    return Stage("PARSE", _sound(not unused_words(trace.query)), words, _ms(trace, "parse"))


def parse_notes(trace: Trace) -> list[str]:
    """Notes on replaced and unused words, each with the reason."""
    expression = trace.query.expression
    notes = [expression.note] if expression is not None and expression.note else []
    labels = {label: c.labels for label, c in trace.candidates.items()}
    notes += [f"“{text}” taken as {meant.name}" for text, meant in taken_as(trace.query, labels)]
    return notes + [f"not used: “{words}”: {why}" for words, why in unused_words(trace.query)]


def _opm(trace: Trace) -> Stage:
    if trace.answered is not None and not any(len(c.index) for c in trace.candidates.values()):
        return Stage("OPM", "idle", f"no proposals are given (detector: {trace.detector})")
    counts = ", ".join(f"{len(c.index)} for “{name}”" for name, c in trace.candidates.items())
    words = f"candidates: {counts} (detector: {trace.detector})"
    return Stage("OPM", "bad" if trace.missing else "good", words, _ms(trace, "opm"))


def _lift(trace: Trace, pair: ScoredPair | None, name: Callable[[int], str], odd_depth: bool) -> Stage:
    ends = (
        ()
        if pair is None
        else (pair.reference, *(end for link in pair.links for end in (link.a, link.b, link.c)), pair.target)
    )
    objects = [i for i in dict.fromkeys(ends) if i is not None]
    doubts = [f"{name(i)}: {concern}" for i in objects for concern in trace.objects[i].lifted.quality.concerns]
    doubts += ["the up vector is assumed"] if trace.viewer.up_source == "assumed" else []
    doubts += ["the depth is estimated"] if trace.frame.depth_source else []
    doubts += ["the depth looks odd"] if odd_depth else []
    words = "; ".join(doubts) or f"{counted(len(trace.objects), 'object')} in 3D"
    # An object that was lifted for an earlier question costs nothing now.
    cost = _ms(trace, "lift") if trace.timings.get("lift", 0.0) > 1e-4 else "cached"
    return Stage("LIFT", _sound(not doubts), words, cost)


def _srm(trace: Trace, pair: ScoredPair | None) -> Stage:
    if trace.answered is not None and trace.scorer != trace.detector:
        return Stage("SRM", "idle", "relations are not given")
    cost = _ms(trace, "srm")
    if pair is None or pair.reference is None:
        return Stage("SRM", "good" if trace.objects else "idle", f"relations are scored by {trace.scorer}", cost)
    whose = trace.scorer if relation_given(trace, pair) else "worked out, the file gives none"
    words = f"“{trace.phrase}” has {probability(pair.p_relation)} for the chosen pair (scorer: {whose})"
    return Stage("SRM", _sound(pair.holds and abs(pair.relation_probability - HOLDS) >= 0.1), words, cost)


def _attribute(trace: Trace, pair: ScoredPair | None) -> Stage | None:
    """Stage of questions about attributes."""
    ranking = trace.ranking
    if ranking is None or ranking.degenerate or not ranking.pairs[0].factors:
        return None
    factors = () if pair is None else pair.factors
    words = ", ".join(f"“{f.text}” has {probability(f.probability)}" for f in factors) or "no pair is chosen"
    return Stage("ATTRIBUTE", _sound(all(f.holds for f in factors)), words)


def _prm(trace: Trace) -> Stage:
    reason, ranking, cost = why_no_answer(trace), trace.ranking, _ms(trace, "prm")
    if trace.answered is not None:
        return Stage("PRM", "idle", f"{trace.answered}; what ranked it is not given")
    if reason is not None or ranking is None:
        return Stage("PRM", "idle" if trace.missing else "bad", "nothing to rank" if trace.missing else reason or "")
    if len(ranking.pairs) == 1:
        return Stage("PRM", "good", "the only candidate pair", cost)
    words = f"{len(ranking.pairs)} pairs, the best leads by {ranking.margin:.2f}"
    return Stage("PRM", _sound(ranking.margin >= 0.1), words, cost)


def unasked_stages(judged: Judged, annotated: int, refused: str) -> tuple[Stage, ...]:
    """Stages of a frame with `annotated` objects and no question, or a question `refused` at a stage."""
    failed = failed_stages(None, judged, refused) if refused else ()
    found = [Stage(name, "idle", glossary()[name].short) for name in ALWAYS]
    found = [Stage(s.name, "bad", "could not be asked") if s.name in failed else s for s in found]
    return (*found, _label(judged, annotated))


def _label(judged: Judged, annotated: int) -> Stage:
    """Stage of the label: the known truth."""
    if isinstance(judged, Diagnosis):
        mark: Mark = "good" if judged.correct else "doubt" if judged.verdict == "LABEL" else "idle"
        return Stage("LABEL", mark, glossary()[judged.verdict].verdict)
    if isinstance(judged, str | Unseen):
        return Stage("LABEL", "idle", glossary()[NOT_SEEN].verdict if isinstance(judged, Unseen) else "no verdict")
    words = f"the dataset annotates {counted(annotated, 'object')}" if annotated else "nothing is known of this frame"
    return Stage("LABEL", "good" if annotated else "idle", words)


Edited = Mapping[str, Any]
"""Edits as JSON; see `pipeline.diagnosis.whatif`."""


class AnswerSource(Protocol):
    """Pipeline behind an answer, able to answer under edits, with or without a screen."""

    def what_if(self, answer: Answer, edits: Edited) -> Answer: ...

    def view(self, what: Any, **options: Any) -> Any: ...


@dataclass(frozen=True)
class Answer(InNotebook):
    """Answer to an expression, with its trace and verdict; positions in `pairs` are those in `objects`.

    >>> from pipeline import ask
    >>> answer = ask("demo", 0, "mug left of the laptop")
    >>> answer
    <Answer 'mug left of the laptop' on '000001/000000': mug·3 left of laptop·2: relation 1.00, product 1.00; CORRECT>
    >>> answer.target.label, answer.holds, len(answer.pairs)
    ('mug', True, 2)
    >>> answer.target.box.center.round(1)
    array([-0.3,  0.1,  1.9])
    """

    text: str  # The expression as it was asked
    trace: Trace | None = None  # Every stage's input and output; None where the expression cannot be read or asked
    problem: str | None = None  # Why it cannot
    diagnosis: Diagnosis | None = None  # None where there is no verdict
    # Why there is a truth and no verdict on this answer; None also where no truth is known at all
    unjudged: str | None = None
    unseen: Unseen | None = None  # What it needs and the frame does not show, where no truth of the frame judges it
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
    def pairs(self) -> Sequence[ScoredPair]:
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
        return self.diagnosis.verdict if self.diagnosis is not None else None if self.unseen is None else NOT_SEEN

    @property
    def story(self) -> Story:
        """What is said of the answer: right or wrong in a few words, why, and what would mend it."""
        d = self.diagnosis
        if d is None and self.unseen is not None:
            return self.unseen.story("any")
        return unjudged_story(self.trace, self.problem, self.unjudged) if d is None else d.story

    @property
    def why(self) -> str | None:
        """Verdict in a sentence; else the reason for none, if known."""
        return self.story.sentence if self.diagnosis is not None or self.unseen is not None else self.unjudged

    def needed_trace(self) -> Trace:
        """Trace; InputError where the expression could not be asked."""
        if self.trace is None:
            raise InputError(f"there is no trace of {self.text!r}: {self.problem}")
        return self.trace

    def record(self) -> dict[str, Any]:
        """Record of `ask --json`: `trace_record`, "stages" in words, and with a known truth "verdict", or null with
        "verdict_reason"."""
        record, judged, trace = _answer_record(self), self.diagnosis or self.unseen or self.unjudged, self.trace
        if trace is not None:
            odd = depth_doubt(trace.frame) is not None
            # How each module fared, in order
            record["stages"] = [stage.record() for stage in stages_of(trace, judged, odd_depth=odd)]
        if self.diagnosis is not None:
            # Which module failed, where the truth is known
            return {**record, "verdict": diagnosis_record(self.diagnosis)}
        if self.unseen is not None:
            told = {"verdict": NOT_SEEN, "detail": self.unseen.detail, **story_record(self.story)}
            return {**record, "verdict": told | {"unseen": asdict(self.unseen)}}
        if self.unjudged is None:
            return record
        return {
            **record,
            "verdict": None,
            "verdict_reason": self.unjudged,  # Why there is no verdict
        }

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
            "name": d.missed_name,  # Name whose right object was not proposed
            "kind": d.missed.kind,  # How it was missed
            "overlap": round(d.missed.overlap, 4),  # Best overlap of a proposal with it
            "score": _rounded(d.missed.score),  # Score of that proposal
            "rank": d.missed.rank,  # Its rank among those of the name
            "suppressed": d.missed.suppressed,  # It overlapped a better one
        }
    )
    return {
        "verdict": d.verdict,  # CORRECT, or the module that failed
        "detail": d.detail,  # Finer kind of the verdict
        "lucky": d.lucky,  # Right, but with a pair that is not acceptable
        **story_record(d.story),
        "repair": list(d.repair),  # Smallest set of modules whose truth would make it right
        "mends": list(d.mends),  # Each module whose truth alone would
        # Numbers of the labels: target, reference, targets, acceptable
        "truth": {
            "target": int(numbers[case.target_object]),
            "reference": int(numbers[case.reference_object]) if case.reference else None,
            "targets": numbers[case.strict].tolist(),
            "acceptable": numbers[case.acceptable].tolist(),
        },
        "winner": _pair_record(d.winner),  # The answer's pair
        "right": _pair_record(d.right),  # Best acceptable pair among the candidates
        # What each factor gave the answer over the right pair, of the logarithm of the score
        "contributions": None if d.contributions is None else {k: round(v, 6) for k, v in d.contributions.items()},
        # Lead of the right pair by true modules: none, one, or several
        "margins": {"+".join(names_of(s)) or "none": _rounded(d.margins[s]) for s in _shown(d)},
        # What one factor alone would have to be for the right pair to win
        "needed": [_needed_record(n) for n in d.needed],
    } | present(
        missed=missed,  # With OPM: what the detector gave in place of the right object
        unseen=None if d.unseen is None else asdict(d.unseen),  # With NOT-SEEN: which frames see it
    )


def _needed_record(n: FactorRepair) -> dict[str, Any]:
    return {
        "factor": n.factor,  # target, reference or relation
        "right": round(n.right, 6),  # What it is of the best acceptable pair
        "winner": round(n.winner, 6),  # What it is of the answer's pair
        "right_above": _rounded(n.right_above),  # The first would have to be above; null where nothing helps
        "winner_below": _rounded(n.winner_below),  # Or the second below
    }


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
