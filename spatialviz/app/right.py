"""The right dock's upper part: the answer, the ranked pairs, every relation of the chosen pair, the object."""

from __future__ import annotations

from pipeline.answering.json_records import headline, probability, told, why_no_answer
from pipeline.answering.objects import SceneObject
from pipeline.answering.pair_table import ScoredPair
from pipeline.answering.ranking import alone
from pipeline.diagnosis.verdict import Diagnosis
from pipeline.geometry.lifting import Pixel
from pipeline.geometry.palette import DROPPED, RGB, hex_color, palette, second_color
from pipeline.language.relation_names import PHRASE
from pipeline.relations.relations import letter
from pipeline.relations.scorer import RelationScores
from spatialviz.app.before import before_html, changed
from spatialviz.app.beside_html import hollow, second_name
from spatialviz.app.state import State
from spatialviz.app.text import BAD, DOUBT, dot, heading, note, panel, safe, words
from spatialviz.app.up_html import level_html, up_chip
from spatialviz.app.why import mend_button, verdict_line

SHOWN_PAIRS = 30
KEPT: RGB = (53, 169, 107)


def answer_html(state: State, can_ask: bool = True) -> str:
    """The answer in one line, the relation's probability and the product, and below them the posterior."""
    trace = state.trace
    if state.error or state.problem:
        return panel('<div class="dim" style="padding:.7em 0">No answer: see the message at the left.</div>')
    if trace is None:
        hint = "Type TARGET RELATION REFERENCE at the left, for example “mug left of the laptop”, and press Enter."
        if not can_ask:
            hint = "Nothing can be asked: the dataset has no annotations, and no detector was named (--detector)."
        chip = f'<div class="under"><span></span>{up_chip(state)}</div>'
        return panel(level_html(state), f'<div class="dim" style="padding:.7em 0">{hint}</div>', chip)
    reason, before = why_no_answer(trace), before_html(state)
    if reason is not None:
        return panel(
            level_html(state),
            before,
            '<div style="height:.5em"></div>',
            note(reason[0].upper() + reason[1:], BAD),
            verdict_line(state),
            _alone(state),
            f'<div class="under"><span></span>{up_chip(state)}{mend_button(state)}</div>',
        )
    best, chosen = state.ranked[0], state.chosen
    pair = chosen or best
    answer = told(trace, lambda place: state.shown.names[state.shown.place[place]], pair)
    # Of the answer itself it is said that there is none; another pair that was clicked is only looked at.
    absent = note(_capital(answer.lead.strip()), DOUBT) if pair is best and answer.lead else ""
    numbers = f'<div class="dim">{safe("; ".join((answer.numbers, *answer.fails)))}</div>' if answer.fails else ""
    below = f'<div class="dim">{safe(answer.below)}</div>'
    parts = [
        level_html(state), before, absent, _sentence(state, pair), _headline(pair), numbers, below, verdict_line(state),
        f'<div class="under"><span></span>{up_chip(state)}{mend_button(state)}</div>',
    ]  # fmt: skip
    return panel(*parts)


def _alone(state: State) -> str:
    """What the verdict is of where there is no pair: as in an evaluation, the best target by its name alone."""
    trace = state.trace
    if trace is None or trace.missing or not isinstance(state.judged, Diagnosis):
        return ""
    name = trace.query.target
    candidates = trace.candidates.get(name)
    found = None if candidates is None else alone(candidates)
    if found is None:
        return ""
    said = f"The verdict is of the best {safe(name)} alone, as in an evaluation: "
    return f'<div class="dim">{said}{safe(state.shown.names[state.shown.place[found]])}</div>'


def _sentence(state: State, pair: ScoredPair) -> str:
    assert state.trace is not None
    colors = palette(state.dark)
    target, *ends = state.at(pair)
    references = () if pair.reference is None else ends
    ends = ' <span class="dim">and</span> '.join(_name(colors["reference"], state.shown.names[i]) for i in references)
    relation = f' <span class="dim">{safe(state.trace.phrase)}</span> {ends}' if references else ""
    return (
        f'<div class="big" style="flex-wrap:wrap">{_name(colors["target"], state.shown.names[target])}{relation}</div>'
    )


def _headline(pair: ScoredPair) -> str:
    """The two numbers at the top: that the pair stands in the relation, and the product of all factors."""
    titles = {
        "attributes": ("P(attributes)", "how surely the attributes and choices that were said fit the objects"),
        "product": ("product", "P(target) · P(reference) · P(relation), and P(attributes) where some were said"),
    }
    doubt = "" if pair.holds else f' style="color:{DOUBT}"'
    cells = []
    for what, value in headline(pair):
        name, title = titles.get(what, (f"P({what})", f"the probability of the {what}"))
        strong = "" if what == "product" else doubt
        cells.append(f'<span title="{title}">{name} <b{strong}>{probability(value)}</b></span>')
    return f'<div class="heads">{"".join(cells)}</div>'


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


def _name(color: RGB, name: str) -> str:
    return f'<span class="name">{dot(color)}<b>{safe(name)}</b></span>'


def _cell(color: RGB, name: str) -> str:
    return f'<td class="w" title="{safe(name)}">{dot(color)}{safe(name)}</td>'


def answer_in_words(state: State) -> str:
    """The answer as a line of the log."""
    trace = state.trace
    assert trace is not None
    reason = why_no_answer(trace)
    total = sum(trace.timings.values()) * 1000
    if reason is not None or state.pair is None:
        return f"“{state.text}”: {reason} ({total:.0f} ms)"
    names = ", ".join(state.shown.names[i] for i in dict.fromkeys(state.pair))
    answer = told(trace, lambda place: state.shown.names[state.shown.place[place]])
    return f"“{state.text}”: {answer.sentence(names)} ({total:.0f} ms)"


def pairs_html(state: State) -> str:
    """The ranked pairs with each factor; the weakest factor of a pair stands out."""
    if not state.ranked:
        return ""
    colors = palette(state.dark)
    rows = []
    attributes = any(p.factors for p in state.ranked)
    fit = '<th class="n" title="P(attributes and choices)">fit</th>' if attributes else ""
    for i, pair in enumerate(state.ranked[:SHOWN_PAIRS]):
        target, *others = state.at(pair)
        names = "" if pair.reference is None else ", ".join(state.shown.names[i] for i in others)
        factors = [pair.p_target, pair.p_reference, pair.p_relation, *([pair.p_attributes] if attributes else [])]
        weakest = min(factors)
        was = None if state.edited is None else state.edited.pair_before(pair)
        rank = None if state.edited is None else state.edited.rank_before(pair)
        old = [None] * 5
        if was is not None:
            told = [was.p_attributes] if attributes else []
            old = [was.p_target, was.p_reference, was.p_relation, *told, was.probability]
        marks = [changed(f, o) for f, o in zip((*factors, pair.probability), old, strict=False)]
        texts = [f"{f:.2f}" for f in factors]
        if pair.reference is None:
            texts[1] = texts[2] = "–"
        cells = "".join(
            f'<td class="n{" low" if f == weakest and f < 0.5 else ""}{mark}"{hint}>{text}</td>'
            for f, text, (mark, hint) in zip(factors, texts, marks, strict=False)
        )
        moved = "" if rank in (None, i + 1) else f' chg" title="was rank {rank}'
        rows.append(
            f'<tr class="r{" sel" if state.at(pair) == state.pair else ""}" onclick="sv(\'pair:{i}\')">'
            f'<td class="n dim{moved}">{i + 1}</td>'
            f"{_cell(colors['target'], state.shown.names[target])}"
            f"{_cell(colors['reference'], names) if names else '<td></td>'}"
            f'{cells}<td class="n{marks[-1][0]}"{marks[-1][1]}><b>{pair.probability:.2f}</b></td></tr>'
        )
    more = "" if len(state.ranked) <= SHOWN_PAIRS else f"best {SHOWN_PAIRS} of {len(state.ranked)}"
    head = (
        '<tr><th class="n">#</th><th>target</th><th>reference</th><th class="n" title="P(target | name)">tgt</th>'
        '<th class="n" title="P(reference | name)">ref</th><th class="n" title="P(relation)">rel</th>'
        f"{fit}"
        '<th class="n" title="posterior over all pairs">P</th></tr>'
    )
    return panel(
        heading("Ranked pairs", more),
        f'<div class="scroll" style="--mh:calc(18vh - 58px)"><table>{head}{"".join(rows)}</table></div>',
    )


def relations_html(state: State) -> str:
    """Every relation of the chosen pair, always in the same order; a click asks with that relation."""
    trace, pair = state.trace, state.chosen
    if trace is None or pair is None or pair.reference is None:
        return ""
    colors = palette(state.dark)
    # "the table holding the lamp" asks for the lamp on the table.
    a, b = (pair.reference, pair.target) if trace.inverse else (pair.target, pair.reference)
    rows = [
        _bar(
            PHRASE[relation],
            float(trace.scores.probabilities[a, b, n]),
            letter(trace.scores.states[a, b, n]),
            colors["target"] if relation == trace.relation else None,
            f"sv('relation:{n}')",
            None if state.edited is None else state.edited.relation_before(a, b, relation),
        )
        for n, relation in enumerate(trace.scores.relations)
    ]
    if trace.relation and trace.relation not in trace.scores.relations:
        rows.append(_bar(PHRASE[trace.relation], pair.p_relation, "", colors["target"], ""))
    names = (safe(state.shown.names[state.shown.place[i]]) for i in (a, b))
    by = safe(_scored_by(trace.scores, trace.scorer))
    return panel(heading("Relations", f"{' → '.join(names)} · by {by}"), *rows)


def _scored_by(scores: RelationScores, scorer: str) -> str:
    """The scorer, and what the relations it has nothing for are scored by: "rel26; on, in, near by rule"."""
    others: dict[str, list[str]] = {}
    for relation in scores.relations:
        if scores.scored_by[relation] != scorer:
            others.setdefault(scores.scored_by[relation], []).append(relation)
    return "; ".join([scorer, *(f"{', '.join(names)} by {other}" for other, names in others.items())])


def _bar(phrase: str, p: float, mark: str, asked: RGB | None, click: str, was: float | None = None) -> str:
    color = "#7d8896" if asked is None else hex_color(asked)
    title = f"{phrase}: {p:.3f}" + (f" ({mark}); click to ask it" if mark else "")
    moved = changed(p, was)[0]
    title += f"; was {was:.3f}" if moved else ""
    return (
        f'<div class="bar{"" if asked is None else " on"}" style="--c:{color}" onclick="{click}" title="{safe(title)}">'
        f"<span>{safe(phrase)}</span>"
        f'<span class="t"><span class="f" style="width:{p * 100:.0f}%"></span></span>'
        f'<span class="s">{mark}</span><span class="n{moved}">{p:.2f}</span></div>'
    )


def object_html(state: State) -> str:
    """What is selected, of the detector that answers and of one beside it, as far as they are shown."""
    i, j = state.selected, state.second_selected
    second, title = None, ""
    if j is not None and state.beside is not None and state.second_layer:
        second = state.second_layer[j]
        title = f"{hollow(hex_color(second_color(state.dark)))}B {safe(second_name(state.beside, j))}"
    if i is None or i >= len(state.shown.objects) or not state.own_layer:
        return "" if second is None else panel(_facts_html(second, title))
    own = f"{dot(palette(state.dark)[state.roles.get(i, 'other')])}{safe(state.shown.names[i])}"
    # In front of it: below the facts it would not be seen.
    return panel("" if second is None else _brief_html(second, title), _facts_html(state.shown.objects[i], own))


def _brief_html(entry: SceneObject, title: str) -> str:
    """An object in one line, beside one that is told in full."""
    said = [] if entry.score >= 0.9995 else [f"score {entry.score:.2f}"]
    if entry.lifted.box is not None:
        sides = " × ".join(f"{side:.2f}" for side in entry.lifted.box.size)
        said = [f"{sides} m", f"{entry.lifted.quality.distance:.2f} m away", *said]
    return heading(f"<b>{title}</b>", " · ".join(said))


def _facts_html(entry: SceneObject, title: str) -> str:
    """An object's size, its place, and what became of every pixel of its mask; the title is HTML already."""
    lifted, quality = entry.lifted, entry.lifted.quality
    facts = []
    if lifted.box is not None:
        width, height, depth = lifted.box.size
        facts += [
            ("size", f"{width:.2f} wide × {height:.2f} high × {depth:.2f} deep m"),
            ("distance", f"{quality.distance:.2f} m · yaw confidence {lifted.yaw_confidence:.2f}"),
        ]
    made = " by a segmenter" if quality.mask_source == "segmenter" else ""
    facts.append(("points", f"{quality.points:,} of {quality.mask_pixels:,} mask pixels{made} ({quality.kept:.0%})"))
    rows = "".join(f"<span>{k}</span><span>{v}</span>" for k, v in facts)
    score = "" if entry.score >= 0.9995 else f"score {entry.score:.2f}"
    parts = [heading(f"<b>{title}</b>", score)]
    if lifted.evidence is not None and quality.mask_pixels:
        counts = lifted.evidence.counts()
        pieces = [
            (words(reason), hex_color(color), counts[reason.name.lower()] / quality.mask_pixels)
            for reason, color in {Pixel.KEPT: KEPT, **DROPPED}.items()
        ]
        bar = "".join(f'<i style="--c:{c};width:{100 * share:.1f}%" title="{name}"></i>' for name, c, share in pieces)
        legend = "".join(
            f'<span><span class="dot" style="--c:{c}"></span>{name} {share:.0%}</span>'
            for name, c, share in pieces
            if share
        )
        parts.append(f'<div class="stack">{bar}</div><div class="legend">{legend}</div>')
    parts.append(f'<div class="facts">{rows}</div>')
    if quality.concerns:
        parts.append('<div style="height:.4em"></div>' + note("; ".join(quality.concerns), DOUBT))
    return "".join(parts)
