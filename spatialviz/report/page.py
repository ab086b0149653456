"""The page itself. It loads nothing, and every string of the dataset is escaped."""

from __future__ import annotations

import re
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

from pipeline import __version__
from pipeline.answering.json_records import best_pair, told, why_no_answer
from pipeline.answering.objects import PreparedFrame
from pipeline.answering.opening import Pipeline
from pipeline.diagnosis.answer import Answer
from pipeline.diagnosis.cases.manifest import PROPOSALS
from pipeline.diagnosis.cases.saving import OpenedCase
from pipeline.diagnosis.verdict import Diagnosis
from pipeline.diagnosis.whatif.edits import Edits, read_edits
from pipeline.diagnosis.whatif.state import ViewState, encode
from pipeline.evaluation.shared_makers import Share, shares_of_answer, title_of
from pipeline.labels.reading import Labels
from pipeline.language.lexicon import wording
from pipeline.system.errors import InputError
from pipeline.system.whole_files import write_whole
from spatialviz.report.picture import AnswerRoles, answer_roles, picture_svg
from spatialviz.report.style import STYLE
from spatialviz.report.tables import decomposition_html, modules_html, pairs_html, relations_html

POLICY = "default-src 'none'; style-src 'unsafe-inline'; img-src data: blob:; frame-src 'self' data: blob:; " \
         "script-src 'unsafe-inline' 'unsafe-eval' 'wasm-unsafe-eval' blob: data:; worker-src blob: data:; " \
         "connect-src data: blob:; font-src data:"  # fmt: skip
"""The page and the scene in it may run what they hold, and fetch nothing from anywhere."""


def failure_page(
    answered: Answer, source: Pipeline, context: PreparedFrame, subject: Subject, scene: str | None = None
) -> str:
    """The page of one answer as HTML.

    Parameters
    ----------
    answered : Answer
    source : Pipeline
        What answered.
    context : PreparedFrame
    subject : Subject
    scene : str, optional
        A self-contained page of the scene in 3D, which is put into a frame of its own.
    """
    cast = answer_roles(answered)
    judged = answered.diagnosis
    title = f"{answered.text} · {subject.frame}"
    body = [
        _header(answered, subject, cast),
        modules_html(answered),
        _views(answered, context, cast, scene),
        '<div class="columns">',
        _card("The answer against the best right pair", "" if judged is None else decomposition_html(judged, cast)),
        _card("Relations of the pair", relations_html(answered, cast)),
        "</div>",
        f"<section>{_card('Ranked pairs', pairs_html(answered, cast))}</section>",
        '<div class="columns">',
        _card("See it again", _commands(subject)),
        _card("Made with", _facts(answered, source, context, subject, judged)),
        "</div>",
    ]
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        '<meta name="generator" content="spatialviz failure report">\n'
        f"<title>{escape(title)}</title>\n<style>{STYLE}</style></head>\n"
        f"<body><main>{''.join(body)}\n<footer>spatialviz {escape(__version__)}</footer></main></body></html>\n"
    )


def write_page(page: str, path: Path) -> None:
    """Write a page, whole or not at all.

    Raises
    ------
    InputError
        The place cannot be written.
    """
    write_whole(path, page.encode("utf-8", "replace"), "the report")


def headline(answered: Answer) -> str:
    """Why, in a sentence or two."""
    if answered.diagnosis is not None:
        return answered.diagnosis.text
    if answered.trace is None:
        return f"The expression cannot be asked: {answered.problem}"
    return why_no_answer(answered.trace) or "An answer without a verdict: " + (
        answered.unjudged or "nothing is known of what is true in this frame"
    )


def _header(answered: Answer, subject: Subject, cast: AnswerRoles) -> str:
    d = answered.diagnosis
    if d is None:
        chip = '<span class="verdict none">NO VERDICT</span>'
    else:
        text = " · ".join(x for x in (d.verdict, d.detail, "LUCKY" if d.lucky else None) if x)
        chip = f'<span class="verdict{" correct" if d.correct else ""}">{escape(text)}</span>'
    first, *rest = re.split(r"(?<=[.!]) +(?=[A-Z])", headline(answered), maxsplit=1)
    lead = f'<p class="lead">{escape(rest[0])}</p>' if rest else ""
    return (
        f'<header><div class="eyebrow">{chip}<span class="asked-for">{_expression(answered)}</span>'
        f"<span>{escape(subject.dataset)} · frame {escape(subject.frame)}</span></div>"
        f"<h1>{escape(first)}</h1>{lead}{_answer(answered, cast)}{_caveat(answered, subject)}</header>"
    )


def _caveat(answered: Answer, subject: Subject) -> str:
    """What the verdict is where answer and truth have a maker in common."""
    title = title_of(subject.shares) if answered.diagnosis is not None else ""
    return f'<p class="lead caveat">{escape(title[:1].upper() + title[1:])}.</p>' if title else ""


def _answer(answered: Answer, cast: AnswerRoles) -> str:
    """The answer in words, with the numbers at its top."""
    trace = answered.trace
    best = None if trace is None else best_pair(trace)
    if trace is None or best is None or best.reference is None:
        return ""
    second = "" if best.second_reference is None else f" and {cast.name(best.second_reference)}"
    phrase = wording(trace.asked.relation, inverse=trace.asked.inverse)
    answer = told(trace, cast.name)
    text = answer.sentence(f"{cast.name(best.target)} {phrase} {cast.name(best.reference)}{second}")
    return f'<p class="lead">Answer: {escape(text)}. <span class="quiet">{escape(answer.below)}</span></p>'


def _expression(answered: Answer) -> str:
    """The expression with its two roles in their colours, where it is one of two names."""
    trace = answered.trace
    if trace is None or len(trace.query.readings) > 1 or len(trace.query.labels) > 2:
        return f"“{escape(answered.text)}”"
    e = trace.query.expression
    phrase = wording(e.relation, inverse=e.inverse)
    return (
        f'“<span class="target">{escape(e.target)}</span> {escape(phrase)} '
        f'<span class="reference">{escape(e.reference)}</span>”'
    )


def _views(answered: Answer, context: PreparedFrame, cast: AnswerRoles, scene: str | None) -> str:
    keys = _key("target", "target") + _key("reference", "reference")
    truth = _key("truth", "true", " dashed") if cast.truth else ""
    picture = f'<figure>{picture_svg(context.frame, cast)}<figcaption>{keys}{truth}</figcaption></figure>'
    if scene is None:
        return f'<div class="views one">{picture}</div>'
    ghost = _key("truth", "true box") if any(o.lifted.box is not None for _, o in cast.truth.values()) else ""
    frame = (
        '<figure class="scene"><iframe title="The scene in 3D" sandbox="allow-scripts" '
        f'srcdoc="{escape(scene)}"></iframe>'
        f"<figcaption>{keys}{ghost}<span>drag to turn, wheel to zoom, right button to move</span></figcaption></figure>"
    )
    return f'<div class="views">{picture}{frame}</div>'


def _key(color: str, what: str, kind: str = "") -> str:
    return f'<span class="key{kind}" style="--c:var(--{color})">{what}</span>'


def _card(title: str, content: str) -> str:
    return f'<div class="card"><h2>{title}</h2>{content or "<p class=quiet>Nothing to show.</p>"}</div>'


def _commands(subject: Subject) -> str:
    shown = "".join(f"<pre>{escape(command)}</pre>" for command in subject.commands)
    if subject.state is not None:
        shown += f'<h3>The view as a string</h3><pre class="state">{escape(subject.state)}</pre>'
    return shown


def _facts(
    answered: Answer, source: Pipeline, context: PreparedFrame, subject: Subject, judged: Diagnosis | None
) -> str:
    config = source.config
    rank = config.rank
    facts = [
        ("detector", f"{source.needed_detector().name}, the best {config.k} of each name"),
        ("relations by", source.scorer.name),
        ("weights", f"target {rank.target_weight:g}, reference {rank.reference_weight:g}, "
                    f"relation {rank.relation_weight:g}, {rank.aggregate}"),
        ("picture", f"{context.frame.width}×{context.frame.height}, up {context.viewer.up_source}"),
    ]  # fmt: skip
    if answered.trace is not None and answered.trace.score_calibration is not None:
        c = answered.trace.score_calibration
        facts.append(("scores", f"calibrated, a {c.a:.3f}, b {c.b:.3f}"))
    if judged is not None:
        case = judged.case
        facts.append(("meant", f"{case.target} {wording(case.relation)} {case.reference}"))
        facts.append(("right answers", f"{len(case.strict)} beyond doubt, {len(case.acceptable)} with the undecided"))
        facts += [("judged by", share.sentence) for share in subject.shares]
    return '<dl class="facts">' + "".join(
        f"<dt>{escape(k)}</dt><dd>{escape(v)}</dd>" for k, v in (*facts, *subject.facts)
    ) + "</dl>"  # fmt: skip


@dataclass(frozen=True)
class Subject:
    """What the page says besides the answer.

    Attributes
    ----------
    dataset : str
        Its name.
    frame : str
    commands : tuple of str
        To see the same again.
    state : str or None
        The view as one string.
    facts : tuple of (str, str)
        More about where it is from.
    shares : tuple of Share
        What the answer has in common with what made the truth that its verdict is by.
    """

    dataset: str
    frame: str
    commands: tuple[str, ...]
    state: str | None = None
    facts: tuple[tuple[str, str], ...] = ()
    shares: tuple[Share, ...] = ()

    @staticmethod
    def of_case(opened: OpenedCase) -> Subject:
        """A kept case."""
        m = opened.manifest
        root = str(opened.root)
        facts = [("case", m.name), ("kept", f"{m.created} by {m.tool}")]
        facts += [(str(key), str(value)) for key, value in m.run.items()]
        facts += [("note", note) for note in opened.notes]
        dataset = m.dataset.get("name", "")
        recording = str(opened.root / PROPOSALS)
        commands = (
            shlex.join(["spatialviz", "replay", root]),
            shlex.join(["spatialviz", "view", root, "--detector", "recorded", "--model", recording]),
        )
        return Subject(
            dataset, m.frame.id, commands, view_state(dataset, m.frame.id, m.text, m.edits), tuple(facts),
        )  # fmt: skip

    @staticmethod
    def of_dataset(
        path: str, source: Pipeline, context: PreparedFrame, text: str, options: Sequence[str] = (),
        labels: Labels | None = None,
    ) -> Subject:
        """An expression on a frame of a dataset, judged by labels or its annotations; `options` of the command line."""
        frame = context.frame.id
        name = source.dataset.root.resolve().name
        commands = (
            shlex.join(["spatialviz", "ask", path, frame, text, *options]),
            shlex.join(["spatialviz", "save-case", path, frame, text, "--out", "CASE", *options]),
        )
        shares = shares_of_answer(source, labels)
        return Subject(name, frame, commands, view_state(name, frame, text, None), shares=shares)


def view_state(dataset: str, frame: str, text: str, edits: Mapping[str, Any] | None) -> str | None:
    """The view as a string that `spatialviz view --state` takes; None where it cannot be written."""
    try:
        return encode(ViewState(dataset, frame, text, edits=read_edits(dict(edits)) if edits else Edits()))
    except InputError:
        return None
