"""Pipeline stages of an answer in words, and the failed ones."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal, TypeAlias

from pipeline.answering.answer_words import best_pair, probability, why_no_answer
from pipeline.answering.ask import Trace
from pipeline.answering.detector_prompts import taken_as, unused_words
from pipeline.answering.json_records import relation_given
from pipeline.answering.pair_table import HOLDS, ScoredPair
from pipeline.diagnosis.verdict import MODULE_OF, Diagnosis
from pipeline.language.counted import counted
from pipeline.language.glossary import glossary

Mark: TypeAlias = Literal["good", "doubt", "bad", "idle"]
ALWAYS = ("PARSE", "OPM", "LIFT", "SRM", "PRM")
Judged: TypeAlias = "Diagnosis | str | None"
"""The verdict, why there is none, or None where nothing is known of the truth."""


@dataclass(frozen=True)
class Stage:
    """Stage of an answer: a mark ("idle" for nothing to say), words, and the time taken."""

    name: str
    mark: Mark
    words: str
    cost: str = ""

    def record(self) -> dict[str, Any]:
        """JSON record, without the time."""
        return {"name": self.name, "mark": self.mark, "words": self.words}


def failed_stages(trace: Trace | None, judged: Judged, refused: str = "PARSE") -> tuple[str, ...]:
    """Failed stages: by the verdict, else where the question stopped, `refused` without a trace.

    None does where the label is in doubt, and not the answer.
    """
    if isinstance(judged, Diagnosis):
        if judged.verdict != "COMPOUND":
            return (MODULE_OF[judged.verdict],) if judged.verdict in MODULE_OF and judged.verdict != "LABEL" else ()
        return tuple(dict.fromkeys("OPM" if part in ("CONF", "RECALL") else part for part in judged.repair))
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
    judged : Diagnosis, str or None
        The verdict, why there is none, or None where nothing is known of the truth.
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
    return tuple(
        replace(s, mark="bad" if s.name in failed else "good" if right and s.name != "LABEL" else s.mark)
        for s in (*filter(None, made), _label(judged, len(trace.frame.annotations)))
    )


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
    if ranking is None or ranking.degenerate or not any(p.factors for p in ranking.pairs):
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
    if isinstance(judged, str):
        return Stage("LABEL", "idle", "no verdict")
    words = f"the dataset annotates {counted(annotated, 'object')}" if annotated else "nothing is known of this frame"
    return Stage("LABEL", "good" if annotated else "idle", words)
