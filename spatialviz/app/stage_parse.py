"""Evidence of the stage PARSE: what each word of the question was taken for, its readings and the tree of the one."""

from __future__ import annotations

from pipeline.answering.ask import Trace
from pipeline.answering.asked_names import taken_as, unused_words
from pipeline.geometry.palette import hex_color, palette
from pipeline.language.lexicon import wording
from pipeline.language.tree import Attachment, Node, Span
from spatialviz.app.markup import Child, Element, h
from spatialviz.app.state import State


def parse_evidence(state: State, trace: Trace) -> list[Child]:
    """Words, readings, notes and the tree."""
    return [
        h.div((_chip(state, trace.query.text[span.start : span.end], span) for span in trace.query.spans), cls="chips"),
        _readings(trace),
        [h.p(note, cls="dim") for note in parse_notes(trace)],
        h.ul(_noun(trace.root), cls="tree"),
    ]


def parse_notes(trace: Trace) -> list[str]:
    """What was taken for something else, and what was not used, each with the reason."""
    expression = trace.query.expression
    notes = [expression.note] if expression is not None and expression.note else []
    labels = {label: c.labels for label, c in trace.candidates.items()}
    notes += [f"“{text}” taken as {meant.name}" for text, meant in taken_as(trace.query, labels)]
    return notes + [f"not used: “{words}”: {why}" for words, why in unused_words(trace.query)]


def _chip(state: State, text: str, span: Span) -> Element:
    if span.role in ("target", "reference"):
        color = hex_color(palette(state.dark)["target" if span.role == "target" else "reference"])
        return h.button(text, cls="chip", css={"--c": color}, do=f"chip:{span.role}", title=f"select the {span.role}")
    if span.role == "unused":
        return h.span(h.s(text), cls="chip rel unused", title=f"not used: {span.note}")
    return h.span(text, cls="chip rel", title=span.role)


def _readings(trace: Trace) -> Element | None:
    """The readings, where there are several, with the score of each."""
    ranking, readings = trace.ranking, trace.query.readings
    if len(readings) < 2 or ranking is None:
        return None
    return h.ul(
        (
            h.li(
                h.span("read as " if reading is ranking.reading else "or ", cls="dim"),
                reading.description,
                cls="taken" if reading is ranking.reading else "",
                title=f"best score {score:.2f}",
            )
            for reading, score in zip(readings, ranking.reading_scores, strict=True)
        ),
        cls="readings",
    )


def _noun(node: Node) -> Element:
    """A noun with all that is said of it below it."""
    said = [*(str(a) for a in node.attributes), *(c.text for c in node.choices)]
    below = [_attachment(a) for a in node.attachments]
    below += [h.li(h.i("not", cls="neg"), h.ul(_noun(other))) for other in node.excluded]
    count = f" × {node.count}" if node.count else ""
    return h.li(h.b(node.name), count, ((" ", h.span(a, cls="attr")) for a in said), h.ul(below) if below else None)


def _attachment(attachment: Attachment) -> Element:
    phrase = h.i(f"not {attachment.phrase}" if attachment.negated else attachment.phrase)
    meant = wording(attachment.relation, inverse=attachment.inverse)
    told = h.span(f" {meant}", cls="dim") if meant != attachment.phrase else None
    nodes = h.ul(_noun(n) for n in attachment.nodes)
    return h.li(phrase, told, nodes, cls="neg" if attachment.negated else "")
