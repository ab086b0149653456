"""The pipeline as connected stages: how each fared, which one failed and why, and the evidence of the open one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

from pipeline.answering.ask import Trace
from pipeline.answering.json_records import probability, why_no_answer
from pipeline.answering.pair_table import HOLDS
from pipeline.diagnosis.verdict import MODULE_OF, Diagnosis
from pipeline.language.counted import counted
from spatialviz.app.failures import MEANING
from spatialviz.app.markup import Child, Element, h
from spatialviz.app.stage_objects import candidates_evidence, lift_evidence
from spatialviz.app.stage_pairs import pairs_evidence
from spatialviz.app.stage_parse import parse_evidence, parse_notes
from spatialviz.app.stage_relations import attributes_evidence, relations_evidence
from spatialviz.app.stage_verdict import verdict_evidence
from spatialviz.app.state import State

EVIDENCE: dict[str, Callable[[State, Trace], list[Child]]] = {
    "PARSE": parse_evidence,
    "OPM": candidates_evidence,
    "LIFT": lift_evidence,
    "SRM": relations_evidence,
    "ATTRIBUTE": attributes_evidence,
    "PRM": pairs_evidence,
    "LABEL": verdict_evidence,
}
MEANS = {
    "PARSE": "what the words say",
    "OPM": "object proposals: which objects may be meant",
    "LIFT": "their geometry in 3D",
    "SRM": "spatial relations between them",
    "ATTRIBUTE": "how they fit what is said of them alone",
    "PRM": "which pair is meant",
    "LABEL": "what is known to be true",
}


@dataclass(frozen=True)
class Stage:
    """How a stage fared: by a mark, in plain words, and what it took."""

    name: str
    mark: Literal["good", "doubt", "bad", "idle"]
    words: str
    cost: str = ""


def failed_stages(state: State) -> tuple[str, ...]:
    """The stages that failed: by the verdict, else where the question stopped."""
    judged = state.judged
    if state.error:
        return ("PARSE",)
    if isinstance(judged, Diagnosis):
        repair = ("OPM" if part in ("CONF", "RECALL") else part for part in judged.repair)
        told = repair if judged.verdict == "COMPOUND" else (MODULE_OF.get(judged.verdict, ""),)
        return tuple(dict.fromkeys(filter(None, told)))
    if state.trace is None or why_no_answer(state.trace) is None:
        return ()
    return ("OPM",) if state.trace.missing else ("PRM",)


def opened(state: State) -> str:
    """The stage whose evidence is open: the one that was chosen, else the one that failed, else that of the pairs."""
    return state.stage or next(iter(failed_stages(state)), "PRM")


def stages_html(state: State, open_stage: str = "") -> Element:
    """The stages in order, each with the evidence below its head where it is the open one.

    `open_stage` is as `State.stage`: a name of EVIDENCE, "" for `opened`, and anything else for none.
    """
    failed = failed_stages(state)
    open_stage = open_stage or opened(state)
    return h.ol((_item(state, stage, open_stage, failed) for stage in stages(state)), cls="stages")


def _item(state: State, stage: Stage, open_stage: str, failed: tuple[str, ...]) -> Element:
    trace, key, has_failed = state.trace, stage.name.lower(), stage.name in failed
    is_open = trace is not None and stage.name == open_stage
    marks = [mark for mark, is_so in (("open", is_open), ("failed", has_failed)) if is_so]
    head = h.button(
        h.b(stage.name),
        h.span(stage.words, cls="line"),
        h.span(stage.cost, cls="cost"),
        cls="head",
        do=f"stage:{stage.name}",
        id=f"head-{key}",
        aria_expanded=str(is_open).lower(),
        aria_controls=f"evidence-{key}",
        title=f"{stage.name}: {MEANS[stage.name]}",
    )
    evidence = None
    if is_open and trace is not None:
        found = EVIDENCE[stage.name](state, trace)
        label = f"evidence of {stage.name}"
        evidence = h.div(found, cls="evidence", id=f"evidence-{key}", role="region", aria_label=label)
    sentence = _sentence(state) if failed[:1] == (stage.name,) else None
    return h.li(head, sentence, evidence, cls=" ".join(("stage", stage.mark, *marks)), id=f"stage-{key}")


def _sentence(state: State) -> Element:
    """Why the answer is wrong, or why there is none."""
    if isinstance(state.judged, Diagnosis):
        return h.p(state.judged.text, cls="sentence")
    reason = state.error or (why_no_answer(state.trace) or "" if state.trace is not None else "")
    return h.p(reason, cls="sentence refused" if state.error else "sentence")


def stages(state: State) -> list[Stage]:
    """All stages: one that failed stands out, and where the answer is right no other is in doubt."""
    trace, failed = state.trace, failed_stages(state)
    if trace is None:
        found = [Stage(name, "idle", MEANS[name]) for name in EVIDENCE if name not in ("ATTRIBUTE", "LABEL")]
        if state.error:
            found[0] = Stage("PARSE", "bad", "could not be asked")
        return [*found, _label(state)]
    made = (_parse(trace), _opm(trace), _lift(state, trace), _srm(state, trace), _attribute(state), _prm(trace))
    found = [*filter(None, made), _label(state)]
    right = isinstance(state.judged, Diagnosis) and state.judged.correct
    marked = (("bad" if s.name in failed else "good" if right and s.name != "LABEL" else s.mark, s) for s in found)
    return [replace(s, mark=mark) for mark, s in marked]


def _ms(trace: Trace, stage: str) -> str:
    value = trace.timings.get(stage, 0.0) * 1000
    return f"{value:.1f} ms" if value < 100 else f"{value:.0f} ms"


def _parse(trace: Trace) -> Stage:
    reading = trace.query.default if trace.ranking is None else trace.ranking.reading
    several = f"one of {len(trace.query.readings)} readings" if len(trace.query.readings) > 1 else ""
    words = "; ".join(filter(None, (reading.description, several, *parse_notes(trace))))
    unused = any(note.startswith("not used") for note in parse_notes(trace))
    return Stage("PARSE", "doubt" if unused else "good", words, _ms(trace, "parse"))


def _opm(trace: Trace) -> Stage:
    counts = ", ".join(f"{len(c.index)} for “{name}”" for name, c in trace.candidates.items())
    words = f"candidates: {counts} (detector: {trace.detector})"
    return Stage("OPM", "bad" if trace.missing else "good", words, _ms(trace, "opm"))


def _lift(state: State, trace: Trace) -> Stage:
    objects = [(state.shown.names[i], state.shown.objects[i].lifted.quality.concerns) for i in state.roles]
    doubts = [f"{name}: {concern}" for name, concerns in objects for concern in concerns]
    doubts += ["the up vector is assumed to be image-up"] if trace.viewer.up_source == "assumed" else []
    words = "; ".join(doubts) or f"{counted(len(trace.objects), 'object')} in 3D"
    # An object that was lifted for an earlier question costs nothing now.
    cost = _ms(trace, "lift") if trace.timings.get("lift", 0.0) > 1e-4 else "cached"
    return Stage("LIFT", "doubt" if doubts else "good", words, cost)


def _srm(state: State, trace: Trace) -> Stage:
    chosen = state.chosen
    if chosen is None or chosen.reference is None:
        return Stage(
            "SRM", "good" if trace.objects else "idle", f"relations are scored by {trace.scorer}", _ms(trace, "srm")
        )
    doubt = not chosen.holds or abs(chosen.relation_probability - HOLDS) < 0.1
    words = f"“{trace.phrase}” has {probability(chosen.p_relation)} for the chosen pair (scorer: {trace.scorer})"
    return Stage("SRM", "doubt" if doubt else "good", words, _ms(trace, "srm"))


def _attribute(state: State) -> Stage | None:
    """Of questions that say something of an object alone."""
    if not any(pair.factors for pair in state.ranked):
        return None
    factors = () if state.chosen is None else state.chosen.factors
    words = ", ".join(f"“{f.text}” has {probability(f.probability)}" for f in factors) or "no pair is chosen"
    return Stage("ATTRIBUTE", "good" if all(f.holds for f in factors) else "doubt", words)


def _prm(trace: Trace) -> Stage:
    reason, ranking = why_no_answer(trace), trace.ranking
    if reason is not None or ranking is None:
        return Stage("PRM", "idle" if trace.missing else "bad", "nothing to rank" if trace.missing else reason or "")
    if len(ranking.pairs) == 1:
        return Stage("PRM", "good", "the only candidate pair", _ms(trace, "prm"))
    close = ranking.margin < 0.1
    words = f"{len(ranking.pairs)} pairs, the best leads by {ranking.margin:.2f}"
    return Stage("PRM", "doubt" if close else "good", words, _ms(trace, "prm"))


def _label(state: State) -> Stage:
    annotated = 0 if state.loaded is None else len(state.loaded.context.frame.annotations)
    if isinstance(state.judged, Diagnosis):
        return Stage("LABEL", "good" if state.judged.correct else "idle", MEANING[state.judged.verdict])
    if isinstance(state.judged, str):
        return Stage("LABEL", "idle", "no verdict")
    words = f"the dataset annotates {counted(annotated, 'object')}" if annotated else "nothing is known of this frame"
    return Stage("LABEL", "good" if annotated else "idle", words)
