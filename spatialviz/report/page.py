"""Failure page as HTML, self-contained, with every string of the dataset escaped."""

from __future__ import annotations

import re
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

from pipeline import __version__
from pipeline.answering.answer_words import best_pair, pair_words, why_no_answer, words_of_answer
from pipeline.answering.objects import PreparedFrame
from pipeline.answering.pipeline import Pipeline
from pipeline.diagnosis.answer import Answer
from pipeline.diagnosis.cases.manifest import PROPOSALS
from pipeline.diagnosis.cases.saving import OpenedCase
from pipeline.diagnosis.verdict import Diagnosis, shown_verdict
from pipeline.diagnosis.whatif.edits import Edits, read_edits
from pipeline.diagnosis.whatif.state import ViewState, encode
from pipeline.evaluation.leakage import Share, shares_of_answer, title_of
from pipeline.geometry.palette import Role, hex_color, palette
from pipeline.labels.reading import Labels
from pipeline.language.lexicon import wording
from pipeline.system.errors import InputError
from pipeline.system.whole_files import write_whole
from spatialviz.report.picture import AnswerRoles, answer_roles, picture_svg
from spatialviz.report.tables import decomposition_html, modules_html, pairs_html, relations_html

POLICY = (
    "default-src 'none'; style-src 'unsafe-inline'; img-src data: blob:; frame-src 'self' data: blob:; "
    "script-src 'unsafe-inline' 'unsafe-eval' 'wasm-unsafe-eval' blob: data:; worker-src blob: data:; "
    "connect-src data: blob:; font-src data:"
)
"""The page and the scene in it may run what they hold, and fetch nothing from anywhere."""


def failure_page(
    answered: Answer, source: Pipeline, context: PreparedFrame, subject: Subject, scene: str | None = None
) -> str:
    """HTML page of an answer.

    `scene`: a self-contained page of the scene in 3D, put into a frame of its own.
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
    """Write a page, whole or not at all."""
    write_whole(path, page.encode("utf-8", "replace"), "the report")


def headline(answered: Answer) -> str:
    """Reason of the verdict, in a sentence or two."""
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
        text = shown_verdict(d.verdict, d.detail, d.lucky).replace(" ", " · ", 1)
        chip = f'<span class="verdict{" correct" if d.correct else ""}">{escape(text)}</span>'
    first, *rest = re.split(r"(?<=[.!]) +(?=[A-Z])", headline(answered), maxsplit=1)
    lead = f'<p class="lead">{escape(rest[0])}</p>' if rest else ""
    return (
        f'<header><div class="eyebrow">{chip}<span class="asked-for">{_expression(answered)}</span>'
        f"<span>{escape(subject.dataset)} · frame {escape(subject.frame)}</span></div>"
        f"<h1>{escape(first)}</h1>{lead}{_answer(answered, cast)}{_caveat(answered, subject)}</header>"
    )


def _caveat(answered: Answer, subject: Subject) -> str:
    """Meaning of the verdict where answer and truth share a maker."""
    title = title_of(subject.shares) if answered.diagnosis is not None else ""
    return f'<p class="lead caveat">{escape(title[:1].upper() + title[1:])}.</p>' if title else ""


def _answer(answered: Answer, cast: AnswerRoles) -> str:
    """Answer in words, with the top numbers."""
    trace = answered.trace
    best = None if trace is None else best_pair(trace)
    if trace is None or best is None:
        return ""
    answer = words_of_answer(trace, cast.name)
    text = answer.sentence(pair_words(trace, best, cast.name))
    return f'<p class="lead">Answer: {escape(text)}. <span class="quiet">{escape(answer.below)}</span></p>'


def _expression(answered: Answer) -> str:
    """Expression with its two roles in their colours, if made of two names."""
    trace = answered.trace
    e = None if trace is None else trace.query.expression
    if trace is None or e is None or len(trace.query.readings) > 1 or trace.query.default.root.triple is None:
        return f"“{escape(answered.text)}”"
    phrase = wording(e.relation, inverse=e.inverse)
    return (
        f'“<span class="target">{escape(e.target)}</span> {escape(phrase)} '
        f'<span class="reference">{escape(e.reference)}</span>”'
    )


def _views(answered: Answer, context: PreparedFrame, cast: AnswerRoles, scene: str | None) -> str:
    keys = _key("target", "target") + _key("reference", "reference")
    truth = _key("truth", "true", " dashed") if cast.truth else ""
    picture = f"<figure>{picture_svg(context.frame, cast)}<figcaption>{keys}{truth}</figcaption></figure>"
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
        (
            "weights",
            f"target {rank.target_weight:g}, reference {rank.reference_weight:g}, relation {rank.relation_weight:g}",
        ),
        ("picture", f"{context.frame.width}×{context.frame.height}, up {context.viewer.up_source}"),
    ]
    if context.frame.depth_source:
        facts.append(("depth", context.frame.depth_source))
    if answered.trace is not None and answered.trace.score_calibration is not None:
        c = answered.trace.score_calibration
        facts.append(("scores", f"calibrated, a {c.a:.3f}, b {c.b:.3f}"))
    if judged is not None:
        case = judged.case
        meant = f"{case.target} {wording(case.relation)} {case.reference}" if case.meant is None else case.text
        facts.append(("meant", meant))
        facts.append(("right answers", f"{len(case.strict)} beyond doubt, {len(case.acceptable)} with the undecided"))
        facts += [("judged by", share.sentence) for share in subject.shares]
    return (
        '<dl class="facts">'
        + "".join(f"<dt>{escape(k)}</dt><dd>{escape(v)}</dd>" for k, v in (*facts, *subject.facts))
        + "</dl>"
    )


@dataclass(frozen=True)
class Subject:
    """Description of the page's subject, besides the answer."""

    dataset: str  # Its name
    frame: str
    commands: tuple[str, ...]  # To see the same again
    state: str | None = None  # The view as one string
    facts: tuple[tuple[str, str], ...] = ()  # More about where it is from
    shares: tuple[Share, ...] = ()  # What the answer has in common with what made the truth that its verdict is by

    @staticmethod
    def of_case(opened: OpenedCase) -> Subject:
        """Description of a saved case."""
        m = opened.manifest
        root = str(opened.root)
        facts = [("case", m.name), ("kept", f"{m.created} by {m.tool}")]
        facts += [(str(key), str(value)) for key, value in m.run.items()]
        facts += [("note", note) for note in opened.notes]
        dataset = m.dataset.get("name", "")
        recording = str(opened.root / PROPOSALS)
        view = shlex.join(["spatialviz", "view", root, "--detector", "recorded", "--model", recording])
        commands = (shlex.join(["spatialviz", "replay", root]), *([view] if PROPOSALS in m.files else []))
        return Subject(
            dataset,
            m.frame.id,
            commands,
            view_state(dataset, m.frame.id, m.text, m.edits),
            tuple(facts),
        )

    @staticmethod
    def of_dataset(
        path: str,
        source: Pipeline,
        context: PreparedFrame,
        text: str,
        options: Sequence[str] = (),
        labels: Labels | None = None,
    ) -> Subject:
        """Description of an expression on a frame, judged by labels or annotations; `options` of the command line."""
        frame = context.frame.id
        name = source.dataset.root.resolve().name
        commands = (
            shlex.join(["spatialviz", "ask", path, frame, text, *options]),
            shlex.join(["spatialviz", "save-case", path, frame, text, "--out", "CASE", *options]),
        )
        shares = shares_of_answer(source, labels)
        return Subject(name, frame, commands, view_state(name, frame, text, None), shares=shares)


def view_state(dataset: str, frame: str, text: str, edits: Mapping[str, Any] | None) -> str | None:
    """View string for `spatialviz view --state`; None where too large."""
    try:
        return encode(ViewState(dataset, frame, text, edits=read_edits(dict(edits)) if edits else Edits()))
    except InputError:
        return None


def _roles(dark: bool) -> str:
    roles: tuple[Role, ...] = ("target", "reference", "truth")
    return "".join(f" --{name}: {hex_color(palette(dark)[name])};" for name in roles)


_DARK = f"""color-scheme: dark; --page: #0f1216; --card: #171b21; --sunk: #11151a; --ink: #e9edf2; --quiet: #98a2b0;
  --line: #2a313a; --fail: #ff7a85; --fail-soft: #3a1d22; --soft: #1e242c; --track: #2b323c;{_roles(True)}"""
_LIGHT = f"""color-scheme: light; --page: #f5f6f8; --card: #ffffff; --sunk: #eef0f3; --ink: #161b22; --quiet: #5a6472;
  --line: #dfe3e8; --fail: #bd1f36; --fail-soft: #fbe9ec; --soft: #f1f3f6; --track: #e3e7ec;{_roles(False)}"""
STYLE = f"""
:root {{ {_LIGHT} }}
@media screen and (prefers-color-scheme: dark) {{ :root {{ {_DARK} }} }}
* {{ box-sizing: border-box; }}
body {{ margin: 0; background: var(--page); color: var(--ink); -webkit-font-smoothing: antialiased;
  font: 14px/1.5 Inter, "Segoe UI", -apple-system, "Helvetica Neue", "Liberation Sans", Arial, system-ui, sans-serif; }}
main {{ max-width: 1400px; margin: 0 auto; padding: 28px 32px 56px; }}
header {{ padding: 0 2px 18px; }}
.eyebrow {{ display: flex; flex-wrap: wrap; gap: 8px 12px; align-items: center; color: var(--quiet); font-size: 13px; }}
.verdict {{ font-weight: 650; font-size: 12px; letter-spacing: .04em; padding: 3px 10px; border-radius: 999px;
  background: var(--fail-soft); color: var(--fail); white-space: nowrap; }}
.verdict.correct {{ color: var(--truth); background: var(--soft); }}
.verdict.none {{ color: var(--quiet); background: var(--soft); }}
h1 {{ font-size: 25px; line-height: 1.28; font-weight: 620; letter-spacing: -.012em; margin: 12px 0 0; max-width: 58em;
  text-wrap: pretty; overflow-wrap: anywhere; }}
.lead {{ font-size: 15.5px; color: var(--quiet); margin: 6px 0 0; max-width: 70em; overflow-wrap: anywhere; }}
.asked-for {{ color: var(--ink); font-weight: 550; overflow-wrap: anywhere; }}
.asked-for .target, td.name.target {{ color: var(--target); }}
.asked-for .reference, td.name.reference {{ color: var(--reference); }}
h2 {{ font-size: 13px; font-weight: 620; margin: 0 0 12px; }}
h3 {{ font-size: 13px; font-weight: 600; margin: 18px 0 4px; }}
.card {{ background: var(--card); border: 1px solid var(--line); border-radius: 10px; padding: 16px 18px 18px;
  min-width: 0; }}
.views, .columns {{ display: grid; grid-template-columns: minmax(0, 1fr) minmax(0, 1fr); gap: 16px; margin-top: 16px; }}
.views.one {{ grid-template-columns: minmax(0, 1fr); }}
.views.one .picture {{ max-height: 70vh; }}
figure {{ margin: 0; background: var(--card); border: 1px solid var(--line); border-radius: 10px; overflow: hidden;
  display: flex; flex-direction: column; }}
.picture {{ display: block; width: 100%; height: auto; background: #101318; flex: 1; }}
iframe {{ border: 0; width: 100%; flex: 1; min-height: 380px; background: #14171c; display: block; }}
figcaption {{ padding: 9px 14px; color: var(--quiet); font-size: 12.5px; display: flex; flex-wrap: wrap; gap: 4px 16px;
  border-top: 1px solid var(--line); }}
.key {{ display: inline-flex; align-items: center; gap: 6px; white-space: nowrap; }}
.key::before {{ content: ""; width: 12px; height: 12px; border-radius: 3px; background: var(--c); }}
.key.dashed::before {{ background: none; border: 2px dashed var(--c); }}
.picture path {{ fill: none; stroke-linejoin: round; stroke-linecap: round; }}
.picture .target {{ --c: {hex_color(palette(True)["target"])}; }}
.picture .reference {{ --c: {hex_color(palette(True)["reference"])}; }}
.picture .truth {{ --c: {hex_color(palette(True)["truth"])}; }}
.picture path.mask {{ fill: var(--c); fill-opacity: .26; fill-rule: evenodd; stroke: var(--c);
  stroke-width: calc(1.3px * var(--u)); }}
.picture path.box {{ stroke: var(--c); stroke-width: calc(1.6px * var(--u)); stroke-opacity: .95; }}
.picture path.true {{ stroke: {hex_color(palette(True)["truth"])}; stroke-width: calc(2px * var(--u));
  stroke-dasharray: calc(5px * var(--u)) calc(4px * var(--u)); }}
.picture .tag rect {{ fill: var(--c); }}
.picture .tag text {{ fill: #14171c; font-weight: 600; }}
.modules {{ list-style: none; display: grid; grid-template-columns: repeat(6, 1fr); gap: 1px; margin: 0; padding: 0;
  background: var(--line); border: 1px solid var(--line); border-radius: 10px; overflow: hidden; }}
.modules li {{ background: var(--card); padding: 10px 14px; display: grid; gap: 0 8px;
  grid-template-columns: 1fr auto; }}
.modules b {{ font-weight: 620; }} .modules span {{ color: var(--quiet); grid-row: 2; font-size: 12.5px; }}
.modules em {{ font-style: normal; font-variant-numeric: tabular-nums; color: var(--quiet); }}
.modules .blamed {{ background: var(--fail-soft); box-shadow: inset 0 3px 0 var(--fail); }}
.modules .blamed b {{ color: var(--fail); }}
.sr {{ position: absolute; width: 1px; height: 1px; overflow: hidden; clip-path: inset(50%); }}
.scroll {{ overflow-x: auto; }}
table {{ border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums; }}
th, td {{ padding: 6px 10px; text-align: right; white-space: nowrap; vertical-align: middle; }}
th:first-child, td:first-child {{ text-align: left; padding-left: 4px; }}
td:last-child, th:last-child {{ padding-right: 4px; }}
thead th {{ color: var(--quiet); font-weight: 500; font-size: 12.5px; border-bottom: 1px solid var(--line);
  vertical-align: bottom; }}
thead small {{ display: block; font-size: 11.5px; color: var(--quiet); max-width: 18em; overflow: hidden;
  text-overflow: ellipsis; margin-left: auto; }}
tbody th {{ font-weight: 500; }}
tbody tr + tr > * {{ border-top: 1px solid var(--line); }}
.name {{ text-align: left; font-weight: 550; max-width: 16em; overflow: hidden; text-overflow: ellipsis; }}
tr.winner > * {{ background: var(--soft); }}
tr.gap td {{ text-align: center; color: var(--quiet); padding: 0; }}
.chip {{ font-size: 11px; font-weight: 600; color: var(--truth); border: 1px solid currentcolor; border-radius: 999px;
  padding: 0 7px; margin-left: 6px; }}
tr.asked > * {{ background: var(--soft); font-weight: 620; }}
.state {{ text-align: center; color: var(--quiet); }}
.meter {{ display: inline-block; width: 64px; height: 6px; border-radius: 3px; overflow: hidden;
  background: var(--track);
  vertical-align: middle; margin-right: 8px; }}
.meter span {{ display: block; height: 100%; background: var(--quiet); }}
.asked .meter span, .winner .meter span {{ background: var(--ink); }}
.number {{ display: inline-block; min-width: 3em; }}
.wide {{ width: 38%; min-width: 150px; }}
.axis {{ display: block; position: relative; height: 14px;
  background: linear-gradient(var(--line), var(--line)) 50% 0 / 1px 100% no-repeat; }}
.bar {{ position: absolute; top: 2px; height: 10px; border-radius: 2px; min-width: 2px; }}
.bar.ours {{ left: 50%; background: var(--fail); }} .bar.theirs {{ right: 50%; background: var(--truth); }}
tr.sum > * {{ font-weight: 620; }}
th.hint {{ font-size: 11.5px; text-align: center; }} th.hint span {{ display: inline-block; width: 50%; }}
th.hint span:first-child {{ text-align: right; padding-right: 6px; }}
th.hint span + span {{ text-align: left; padding-left: 6px; }}
.needed {{ margin: 0; padding-left: 18px; }} .needed li::marker {{ color: var(--quiet); }}
.quiet {{ color: var(--quiet); font-size: 12.5px; margin: 10px 0 0; }}
dl.facts {{ display: grid; grid-template-columns: max-content 1fr; gap: 4px 20px; margin: 0; }}
dl.facts dt {{ color: var(--quiet); }} dl.facts dd {{ margin: 0; overflow-wrap: anywhere; }}
pre {{ margin: 0 0 10px; background: var(--sunk); border: 1px solid var(--line); border-radius: 7px; padding: 10px 12px;
  font: 12.5px/1.55 ui-monospace, "SF Mono", Menlo, Consolas, "Liberation Mono", monospace; white-space: pre-wrap;
  overflow-wrap: anywhere; }}
pre.state {{ text-align: left; color: inherit; max-height: 8.5em; overflow: auto; }}
section {{ margin-top: 16px; }}
footer {{ margin-top: 20px; color: var(--quiet); font-size: 12.5px; }}
@media (max-width: 1000px) {{ .views, .columns {{ grid-template-columns: minmax(0, 1fr); }}
  .modules {{ grid-template-columns: repeat(3, 1fr); }} main {{ padding: 20px 16px 40px; }} }}
@media print {{
  :root {{ {_LIGHT} --page: #fff; }}
  body {{ font-size: 10.5px; }} main {{ max-width: none; padding: 0; }} h1 {{ font-size: 17px; }}
  figure.scene {{ display: none; }} .views, .columns {{ grid-template-columns: minmax(0, 1fr); gap: 10px; }}
  .picture {{ max-height: 46vh; }} .card, figure, .modules {{ break-inside: avoid; }}
  th, td {{ padding: 3px 6px; }} pre.state {{ max-height: none; }}
  * {{ print-color-adjust: exact; -webkit-print-color-adjust: exact; }}
}}
"""
