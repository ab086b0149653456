"""Kept cases as people and programs read them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rich.text import Text

from pipeline.answering.told_answer import NO_SUCH_PAIR
from pipeline.diagnosis.asking import JudgedAnswer
from pipeline.diagnosis.cases.manifest import Expected
from pipeline.diagnosis.cases.replay import Result
from pipeline.language.counted import counted
from spatialviz.printing import make_console

_STYLE = {"same": "green", "updated": "yellow", "changed": "red", "damaged": "red"}


def print_saved(now: JudgedAnswer, folder: Path) -> None:
    """What was kept, and how it is run again."""
    console = make_console()
    if now.diagnosis is not None:
        console.print(Text.assemble((now.diagnosis.verdict, "bold"), "  ", now.diagnosis.text))
    elif now.problem or now.unjudged:
        console.print(Text(now.problem or now.unjudged or "", "yellow"))
    console.print(f"kept -> {folder}   run it again: spatialviz replay {folder}", markup=False)


def print_replay(result: Result, updated: bool = False) -> None:
    """Before and after of one case."""
    console = make_console()
    head = Text.assemble((f"{result.status:<8}", _STYLE[result.status]), " ", (str(result.path), "bold"))
    console.print(head)
    if result.replay is None:
        console.print(Text(f"         {result.problem}", "red"))
        return
    replay = result.replay
    if replay.changes:
        console.print(Text(f"  before {in_words(replay.before)}"))
        console.print(Text(f"  after  {in_words(replay.after)}"))
        for change in replay.changes:
            console.print(Text(f"         {change}", "yellow" if updated else "red"))
    for warning in replay.warnings:
        console.print(Text(f"         warning: {warning}", "yellow"))


def in_words(state: Expected) -> str:
    """An answer and its verdict on one line."""
    verdict = "" if state.judgement is None else f"   {state.judgement.verdict}: {state.judgement.said}"
    if state.answer is None:
        return f"no answer ({state.reason}){verdict}"
    target, reference = state.answer.target, state.answer.reference
    other = "" if reference is None else f" with {reference.label} ({reference.score:.2f})"
    lead = "" if state.answer.holds in (None, True) else NO_SUCH_PAIR
    return f"{lead}{target.label} ({target.score:.2f}){other}, relation {state.answer.p_relation:.2f}{verdict}"


def print_totals(totals: dict[str, int]) -> None:
    """The last line of a run."""
    shown = ", ".join(f"{n} {status}" for status, n in totals.items() if n or status in ("same", "changed"))
    count = sum(totals.values())
    make_console().print(f"{counted(count, 'case')}: {shown}", markup=False)


def replay_record(result: Result) -> dict[str, Any]:
    """One line of `replay --json`."""
    replay = result.replay
    if replay is None:
        return {"case": str(result.path), "status": result.status, "problem": result.problem}
    return {
        "case": str(result.path), "name": replay.name, "status": result.status, "changes": list(replay.changes),
        "warnings": list(replay.warnings), "before": replay.before.model_dump(mode="json"),
        "after": replay.after.model_dump(mode="json"),
    }  # fmt: skip


def totals_record(totals: dict[str, int]) -> dict[str, Any]:
    """The last line of `replay --json`."""
    return {"cases": sum(totals.values()), **totals}
