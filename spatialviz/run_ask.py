"""Commands on answers and words, with their output for people."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipeline.answering.answer_words import probability, reading_notes, why_no_answer, words_of_answer
from pipeline.answering.ask import Trace
from pipeline.answering.detector_prompts import taken_as, unused_words
from pipeline.answering.pair_table import ScoredPair
from pipeline.answering.pipeline import Pipeline
from pipeline.datasets.demo import DEMO_NAME, demo_run
from pipeline.diagnosis.answer import Answer
from pipeline.diagnosis.asking import ask_and_judge
from pipeline.diagnosis.suggestions import SURE, MissedNames, missed_names
from pipeline.diagnosis.verdict import shown_verdict
from pipeline.language.counted import listed
from pipeline.language.glossary import find_term, glossary, glossary_markdown
from pipeline.system.errors import require
from spatialviz.cli_ask import (
    AskCommand,
    GlossaryCommand,
)
from spatialviz.options import ALL_FRAMES, FINE, NO, SourceOptions, warn_skipped
from spatialviz.printing import print_rows, say, say_lines
from spatialviz.run_relations import warn_assumed

if TYPE_CHECKING:
    from pipeline.evaluation.run_folder import Run
    from pipeline.labels.reading import Labels

SHOWN_PAIRS = 5


def run_ask(command: AskCommand) -> int:
    require(command.expressions, "an expression is missing", expected='for example "mug left of the laptop"')
    require(
        command.save is None or (command.frame != ALL_FRAMES and len(command.expressions) <= 1),
        "--save takes one frame and one expression",
        path=command.save,
    )
    if command.save is not None:
        from pipeline.pictures.writing import check_target

        check_target(command.save, films=True)
    answered = 0
    pipeline, labels, run = _opened(command)
    known = {} if run is None else {"marks": run.spec.marks, "confidence": run.spec.confidence}
    maps = None if run is None else run.maps
    if command.map is not None:
        from pipeline.diagnosis.not_seen import open_scene_maps

        maps = open_scene_maps(command.map, pipeline.dataset)
    for answer in ask_and_judge(pipeline, command.frame, command.expressions, labels, warn_skipped, **known):
        answer = answer if maps is None else maps.answered(answer)
        trace = answer.needed_trace()
        answered += answer.holds is True
        tried = _tried(answer, run) if command.try_mend else {}
        command.write(answer.record() | tried, print_answer, answer, trace)
        if tried and not command.json:
            over = tried["over_run"]
            say_lines((f"Tried: {tried['tried']['said']}", *([f"Over the run: {over['said']}"] if over else [])))
        if trace.missing and command.frame != ALL_FRAMES and not command.json:
            print_overlooked(missed_names(pipeline, trace))
        if command.save is not None:
            save_answer(answer, pipeline.dataset.root.name, command.save)
    return FINE if answered else NO


def save_answer(answer: Answer, dataset: str, path: Path) -> None:
    """Write an answer as a picture or a film, by the file's ending."""
    from pipeline.pictures.answer_card import answer_picture
    from pipeline.pictures.film import mending_film
    from pipeline.pictures.writing import is_film, write_film, write_picture

    if is_film(path):
        write_film(mending_film(answer, dataset, moving=path.suffix.lower() != ".gif"), path)
    else:
        write_picture(answer_picture(answer, dataset=dataset), path)


def _opened(command: AskCommand) -> tuple[Pipeline, Labels | None, Run | None]:
    """Pipeline of a command, labels, and an asked run."""
    labels = None
    if command.labels is not None:
        from pipeline.labels.reading import open_labels

        labels = open_labels(command.labels)
    if command.run_folder is None:
        if command.dataset == DEMO_NAME and not command.json:
            by = "by the demo's annotations; " if command.source == SourceOptions() else ""
            say(f"{by}--run demo answers as `view` does", style="dim")
        return command.source.open(command.dataset, command.frame, labels), labels, None
    require(command.source == SourceOptions(), "--run brings its own detector and relation scorer")
    from pipeline.evaluation.run_folder import open_run

    built_in = str(command.run_folder) == DEMO_NAME and not command.run_folder.exists()
    run = open_run(
        demo_run() if built_in else command.run_folder,
        dataset=None if command.dataset == DEMO_NAME else command.dataset,
        labels=None if command.labels is None else str(command.labels),
    )
    return run.source, run.labels, run


def _tried(answer: Answer, run: Run | None) -> dict[str, Any]:
    """What would make an answer right tried on it, and a setting of its kind on a run."""
    from pipeline.diagnosis.whatif.try_mend import try_mend
    from pipeline.evaluation.mend_counts import count_mends, mend_setting

    tried, d = try_mend(answer), answer.diagnosis
    setting = None if run is None or d is None else mend_setting(run, d)
    asked = None if d is None else (d.truth.frame, d.case.id)
    over = None if run is None or setting is None else count_mends(run, setting, asked).record()
    told = (
        {"said": "Nothing to try: no single change is known to mend this answer."} if tried is None else tried.record()
    )
    return {} if answer.story.tone != "wrong" else {"tried": told, "over_run": over}


def run_glossary(command: GlossaryCommand) -> None:
    if command.markdown:
        print(glossary_markdown(), end="")
        return
    terms = glossary().values() if command.word is None else [find_term(command.word)]
    command.write(map(asdict, terms), say_lines, [f"{term.name} ({term.group}): {term.hint}" for term in terms])


def print_answer(answer: Answer, trace: Trace) -> None:
    """Print the answer, the ranked pairs with their factors, the doubts, the cost of each stage, and the verdict."""
    say(("frame ", "dim"), trace.frame.id, "  ", (trace.query.text, "bold"))
    no_answer = why_no_answer(trace)
    say_lines([no_answer or ""], "yellow")
    if trace.ranking is not None and no_answer is None:
        print_ranking(trace)
    warn_assumed(trace.viewer, trace.frame.depth_source)
    stages = " · ".join(f"{k} {v * 1000:.1f} ms" for k, v in trace.timings.items())
    made = f"detector {trace.detector} · relations by {trace.scorer} · up {trace.viewer.up_source}"
    say(f"{stages} · {made}", style="dim")
    found = answer.diagnosis or answer.unseen
    if answer.verdict is not None and found is not None:
        name = shown_verdict(answer.verdict, found.detail, answer.diagnosis is not None and answer.diagnosis.lucky)
        style = "bold green" if answer.verdict == "CORRECT" else "bold yellow"
        say(("verdict ", "dim"), (name, style), f"  {answer.story.head}")
        say_lines(filter(None, (answer.story.sentence, answer.story.mend)))
    elif answer.unjudged is not None:
        say(f"no verdict: {answer.unjudged}", style="dim")


def print_ranking(trace: Trace) -> None:
    """Print the best pair, the reason for "no such pair", and the first pairs with all factors."""

    def name(index: int | None) -> str:
        assert index is not None
        return trace.name(index)

    assert trace.ranking is not None
    phrase = trace.phrase
    pairs = trace.ranking.pairs
    best = pairs[0]
    second = "" if best.second_reference is None else f" and {name(best.second_reference)}"
    answer = words_of_answer(trace, name)
    say(
        (answer.lead, "yellow"),
        (name(best.target), "bold dark_orange"),
        f" {phrase} " if phrase else "",
        ("" if best.reference is None else name(best.reference) + second, "bold dodger_blue2"),
        (f"   {answer.numbers}", "bold" if answer.holds else "yellow"),
    )
    say_lines((f"does not hold: {failing}" for failing in answer.fails), "yellow")
    say(answer.below, style="dim")
    taken = taken_as(trace.query, {label: c.labels for label, c in trace.candidates.items()})
    say_lines((f"'{text}' taken as {meant.name} ({meant.how})" for text, meant in taken), "dim")
    say_lines((f"'{said}' read as '{meant}'" for said, meant in trace.query.mended), "dim")
    say_lines((f"not used: '{words}': {why}" for words, why in unused_words(trace.query)), "yellow")
    say_lines(reading_notes(trace), "dim")
    if len(trace.query.readings) > 1 or trace.query.default.root.triple is None:
        say(f"read as: {trace.ranking.reading.description}", style="dim")
    columns: dict[str, Callable[[ScoredPair], str]] = {"target": lambda p: name(p.target)}
    if phrase:
        columns["reference"] = lambda p: ", ".join(name(k) for k in (p.reference, p.second_reference) if k is not None)
    columns[">P(target)"] = lambda p: f"{p.p_target:.2f}"
    if any(p.factors for p in pairs):
        columns[">P(attributes)"] = lambda p: f"{p.p_attributes:.2f}"
    if phrase:
        columns[">P(reference)"] = lambda p: f"{p.p_reference:.2f}"
        columns[f">P({phrase})"] = lambda p: f"{p.p_relation:.2f}"
    columns[">product"] = lambda p: probability(p.product)
    columns[">posterior"] = lambda p: f"{p.probability:.3f}"
    print_rows(
        ("#", *columns),
        ((str(rank), *(of(p) for of in columns.values())) for rank, p in enumerate(pairs[:SHOWN_PAIRS], start=1)),
    )
    if len(pairs) > SHOWN_PAIRS:
        say(f"and {len(pairs) - SHOWN_PAIRS} more pairs", style="dim")
    for role, index in (("target", best.target), ("reference", best.reference)):
        if index is not None:
            lifted = trace.objects[index].lifted
            say_lines((f"{role} {name(index)}: {concern}" for concern in lifted.quality.concerns), "yellow")
            say_lines([lifted.goes_on and f"{role} {name(index)} {lifted.goes_on}"], "dim")


def print_overlooked(found: MissedNames) -> None:
    """Print the detector's other findings for missing names, a line each."""
    for name, score in found.below.items():
        least = math.floor(score * 100) / 100
        if least:
            say(f"the best {name!r} has {score:.3f}: --min-score {least:.2f} keeps it", style="yellow")
    if found.seen:
        say(f"detections of at least {SURE:.2f}: {listed(found.seen)}", style="dim")
