"""Notebook HTML of answers, runs and failures: a headline, a picture with the roles, tables with bars; self-contained,
without style sheets or scripts.

The elements are built as a tree and written by the standard library, which escapes every text and attribute.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any
from xml.etree.ElementTree import Element, tostring

from pipeline.answering.answer_words import probability
from pipeline.answering.ask import Trace
from pipeline.answering.pair_table import ScoredPair
from pipeline.diagnosis.answer import Answer
from pipeline.diagnosis.oracles import shown_oracle
from pipeline.diagnosis.verdict import Diagnosis
from pipeline.evaluation.plots import LOSS_COLORS
from pipeline.evaluation.run_folder import Failure, Failures, Run
from pipeline.evaluation.slices import figure_rows
from pipeline.evaluation.summary import cost_words, summarise_run
from pipeline.geometry.palette import ON_LIGHT, VERDICTS, hex_color
from pipeline.language.counted import counted
from pipeline.metrics.intervals import Estimate
from pipeline.pictures.answer_card import answer_picture
from pipeline.system.encoded_pictures import jpeg_url
from pipeline.system.errors import InputError, MissingExtra
from pipeline.system.in_notebook import InNotebook

SHOWN_PAIRS = 8
SHOWN_ROWS = 12
QUALITY = 86
_QUIET = "color:gray"
_COLORS = {verdict: hex_color(color) for verdict, color in VERDICTS.items()}


def notebook_html(shown: InNotebook) -> str:
    """HTML for a notebook of an answer, a run, a failure or several."""
    build = next(build for kind, build in _BUILDERS.items() if isinstance(shown, kind))
    return tostring(build(shown), encoding="unicode", method="html")


def element(tag: str, *children: Element | str | None, style: str = "", **attributes: str) -> Element:
    """Element with its children in order; text stays text."""
    found = Element(tag, {**attributes, **({"style": style} if style else {})})
    for child in children:
        if isinstance(child, Element):
            found.append(child)
        elif child is not None and len(found):
            found[-1].tail = (found[-1].tail or "") + child
        elif child is not None:
            found.text = (found.text or "") + child
    return found


def _answer(answer: Answer) -> Element:
    verdict = None if answer.verdict is None else _chip(answer.verdict, answer.verdict)
    trace, judged = answer.trace, answer.diagnosis
    frame = None if trace is None else element("span", f" {trace.frame.id}", style=_QUIET)
    picture = None if trace is None else jpeg_url(answer_picture(answer), quality=QUALITY)
    return element(
        "div",
        element("p", element("b", f"“{answer.text}”"), frame, verdict),
        element("p", answer.sentence),
        element("p", element("b", f"{answer.story.head}. "), str(answer.story)),
        None if picture is None else element("img", src=picture, style="max-width:100%", alt=answer.sentence),
        None if trace is None or not answer.pairs or trace.answered else _pairs(trace.name, answer.pairs),
        None if trace is None else element("p", _makers(trace), style=_QUIET),
        None if judged is None or not judged.contributions else _contributions(judged, judged.contributions),
    )


def _makers(trace: Trace) -> str:
    """Makers of proposals and relations."""
    asked = trace.scores.scored_by.get(trace.relation, trace.scorer)
    return f"detector {trace.detector} · relations by {asked} · up {trace.viewer.up_source}"


def _contributions(judged: Diagnosis, shares: Mapping[str, float]) -> Element | None:
    """Gains of the answer over the best correct pair, factor by factor; nothing for a right answer."""
    if judged.winner == judged.right:
        return None
    widest = max(map(abs, shares.values())) or 1.0
    rows = [
        (
            factor,
            *(f"{getattr(pair, f'p_{factor}'):.3f}" for pair in (judged.winner, judged.right)),
            f"{share:+.2f}",
            _bar(abs(share) / widest, hex_color(ON_LIGHT["bad" if share > 0 else "truth"])),
        )
        for factor, share in shares.items()
    ]
    return _table(
        ("factor", "answer", "best correct pair", "Δ ln product", "red for the answer, green against it"), rows
    )


def _failure(failure: Failure) -> Element:
    try:
        return _answer(failure.answer)
    except (InputError, MissingExtra) as error:
        row = failure.row
        lead = _chip(str(row["verdict"]), failure.verdict)
        frame = element("span", f" {row['frame']}", style=_QUIET)
        return element(
            "div",
            element("p", element("b", f"“{row['text']}”"), frame, lead),
            element("p", row["said"]),
            element("p", f"not answered again: {error}", style=_QUIET),
        )


def _failures(found: Failures) -> Element:
    shown = found[:SHOWN_ROWS]
    rows = [(str(f.row["frame"]), str(f.row["text"]), f.verdict, f.row["said"] or "") for f in shown]
    return element(
        "div",
        element("p", element("b", found.search or "failed"), f" {counted(len(found), 'expression')}"),
        _table(("frame", "text", "verdict", "said"), rows) if rows else None,
        _more(len(found) - len(shown), "expressions"),
    )


def _pairs(name: Callable[[int], str], pairs: Sequence[ScoredPair]) -> Element:
    rows = [
        (
            str(rank),
            name(pair.target),
            " and ".join(name(k) for k in (pair.reference, pair.second_reference) if k is not None),
            *(f"{p:.2f}" for p in (pair.p_target, pair.p_reference, pair.p_relation)),
            probability(pair.product),
            f"{pair.probability:.3f}",
            _bar(pair.probability, hex_color(ON_LIGHT["target"])),
        )
        for rank, pair in enumerate(pairs[:SHOWN_PAIRS], start=1)
    ]
    head = ("#", "target", "reference", "P(target)", "P(reference)", "P(relation)", "product", "posterior", "")
    return element("div", _table(head, rows), _more(len(pairs) - SHOWN_PAIRS, "pairs"))


def _run(run: Run) -> Element:
    summary = summarise_run(figure_rows(run.on_file)) if run.verdicts else None
    parts = (
        []
        if summary is None
        else [
            _shares("verdict", {name: share.estimate for name, share in summary.verdicts.items()}, _COLORS),
            *(
                [_shares("of all, lost to", {k: v for k, v in summary.loss.items() if k != "accuracy"}, LOSS_COLORS)]
                if summary.loss
                else []
            ),
            element("p", cost_words(summary), style=_QUIET),
        ]
    )
    theirs = run.manifest.get("imported")
    whose = "" if theirs is None else f", imported, level {theirs['level']} of 3"
    return element(
        "div",
        element("p", element("b", run.name), f" {counted(run.on_file.num_rows, 'expression')}{whose}"),
        *parts,
        *(_figures(name, rows) for name, rows in run.tables.items() if name == "grounding"),
        *(element("p", share.sentence, style=_QUIET) for share in run.shares),
    )


def _shares(name: str, shares: Mapping[str, Estimate], tones: Mapping[str, str]) -> Element:
    """Shares of all expressions with intervals and bars."""
    rows = [
        (
            shown_oracle(key),
            f"{100 * e.value:.1f} %",
            f"{100 * e.low:.1f} to {100 * e.high:.1f}",
            _bar(e.value, tones[key]),
        )
        for key, e in shares.items()
        if e.value
    ]
    return _table((name, "share", "95 %", ""), rows)


def _bar(share: float, color: str) -> Element:
    return element("div", style=f"background:{color};height:0.7em;width:{160 * min(max(share, 0.0), 1.0):.0f}px")


def _chip(verdict: str, text: str) -> Element:
    stripe = f"border-left:3px solid {_COLORS[verdict]}"
    return element("span", text, style=f"{stripe};background:rgba(128,128,128,0.18);padding:0 0.4em;margin-left:0.5em")


def _figures(name: str, rows: Sequence[dict[str, str | float]]) -> Element:
    columns = list(dict.fromkeys(column for row in rows for column in row))
    shown = [[_cell(row.get(column, "")) for column in columns] for row in rows[:SHOWN_ROWS]]
    return element("div", element("p", name), _table(columns, shown), _more(len(rows) - SHOWN_ROWS, "rows"))


def _cell(value: str | float) -> str:
    return value if isinstance(value, str) else f"{value:.3f}".rstrip("0").rstrip(".")


def _table(head: Sequence[str], rows: Iterable[Sequence[Element | str]]) -> Element:
    body = [element("tr", *(element("td", cell) for cell in row)) for row in rows]
    return element(
        "table", element("thead", element("tr", *(element("th", name) for name in head))), element("tbody", *body)
    )


def _more(count: int, what: str) -> Element | None:
    return element("p", f"and {count} more {what}", style=_QUIET) if count > 0 else None


_BUILDERS: dict[type[InNotebook], Callable[[Any], Element]] = {
    Answer: _answer,
    Failure: _failure,
    Failures: _failures,
    Run: _run,
}
