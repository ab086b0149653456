"""Detector prompts: each noun phrase of a question as a name known to the detector."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

from pipeline.geometry.frame import Frame
from pipeline.language.naming import (
    DETERMINERS,
    Meaning,
    Synonyms,
    is_named,
    match,
    meanings,
    normal_form,
    singular,
    spelt,
)
from pipeline.language.tree import Attachment, Choice, Node, Query, Reading, Span, described
from pipeline.proposals.base import Detector, Proposals
from pipeline.system.errors import UnknownClass


def name_for(node: Node, detector: Detector, synonyms: Synonyms | None = None) -> str | None:
    """Name asked of a detector: the whole phrase, or the noun without its attributes; None for everything.

    A detector of open vocabulary is given the phrase as it stands. One of its own names only is asked for the phrase if
    known (`red bull`), else for the noun alone (`red mug`); if misspelt, for the name a letter away (`chiar`), as
    `taken_as` tells.
    """
    if detector.vocabulary is None:
        return node.label
    if node.anything and not match(node.name, detector.vocabulary, synonyms):
        return None
    whole = node.label == node.name or any(is_named(node.label, name, synonyms) for name in detector.vocabulary)
    return spelt(node.label if whole else node.name, detector.vocabulary, synonyms)


def detections(
    frame: Frame, detector: Detector, query: Query, synonyms: Synonyms | None = None
) -> tuple[dict[str, Proposals], Query]:
    """Detector's whole run for each noun phrase, and the question without parts it cannot be asked.

    A reference unknown to the detector is left out together with its relation where the rest still tells the target:
    with other relations, choices or attributes, or a single object of the name.
    """
    query = whole_names(query, detector, synonyms)
    query = replace(query, asked=tuple((n.label, name_for(n, detector, synonyms)) for n in query.nodes))
    query = without_strangers(query, detector, synonyms)
    found: dict[str, Proposals] = {}
    unknown: dict[str, UnknownClass] = {}
    for label, name in dict(query.asked).items():
        try:
            found[label] = detector.detect(frame, None if name is None else [name])
        except UnknownClass as error:
            if label == query.target:
                raise
            unknown[label] = error
    if not unknown:
        return found, query
    left = without(query, {label: str(error.what) for label, error in unknown.items()})
    root = left.default.root
    if not (root.attachments or root.choices or root.attributes) and len(found[query.target]) > 1:
        raise next(iter(unknown.values()))
    asked = {n.label for reading in left.readings for n in reading.root.walk()}
    return {label: run for label, run in found.items() if label in asked}, left


def whole_names(query: Query, detector: Detector, synonyms: Synonyms | None = None) -> Query:
    """Question with phrases known whole to a detector of limited vocabulary stripped of attributes."""

    def whole(node: Node) -> bool:
        return bool(node.attributes and node.head) and name_for(node, detector, synonyms) == node.label

    if detector.vocabulary is None or not any(whole(n) for n in query.nodes):
        return query
    labels = {n.label for n in query.nodes if whole(n)}

    def read(node: Node) -> Node:
        attachments = tuple(replace(a, nodes=tuple(map(read, a.nodes))) for a in node.attachments)
        node = replace(node, attachments=attachments, excluded=tuple(map(read, node.excluded)))
        return replace(node, head="", attributes=()) if node.label in labels else node

    return replace(query, readings=tuple(replace(r, root=read(r.root)) for r in query.readings))


SMALL = frozenset({"of", "with", "and", "for", "in", "on", "without", "from"})
"""Words of a name that say nothing alone."""
GROUND = frozenset({"floor", "ground"})
"""Where it is no thing of the dataset, what is on it is lower than its like; the word stays among the unused."""
STRANGER = "in no name that the detector knows"


def without_strangers(query: Query, detector: Detector, synonyms: Synonyms | None = None) -> Query:
    """Question with words marked unused if in no name of the detector: `zorb` of `zorb mug`, `with a lid` of `jar with
    a lid`. A detector of open vocabulary is asked for all of them."""
    if detector.vocabulary is None:
        return query
    spans = query.spans
    for node in query.nodes:
        asked = name_for(node, detector, synonyms)
        tail = node.label.partition(node.name)[2].split() if asked != node.label else []
        best = meanings(node.name, detector.vocabulary, synonyms)[:1]
        words = normal_form(node.name).split()
        strangers = [words[k] for k in best[0].left] if best and asked is not None else []
        if strangers or tail:
            # What is meant and what is not may stand in one stretch: `the red, not the red mug with a lid`.
            own = any(s.index == node.mention for s in spans if s.role in ("target", "reference"))
            spans = _marked(query.text, spans, node.mention if own else 0, strangers, len(tail))
    return replace(query, spans=spans)


def _marked(text: str, spans: Sequence[Span], mention: int, words: list[str], after: int) -> tuple[Span, ...]:
    """Spans, those of a noun cut at its unused words and last words."""
    found: list[Span] = []
    for span in spans:
        if span.role not in ("target", "reference") or span.index != mention:
            found.append(span)
            continue
        at, said = span.start, list(re.finditer(r"[^\s,;_/‐-―-]+", text[span.start : span.end]))
        for n, word in enumerate(said):
            plain = normal_form(word[0])
            hit = any(w in (plain, word[0].lower()) or singular(w) == plain for w in words)
            if not hit and n < len(said) - after:
                continue
            if word[0].lower() in SMALL or word[0].lower() in DETERMINERS:
                continue
            start, end = span.start + word.start(), span.start + word.end()
            found += [replace(span, start=at, end=start)] if text[at:start].strip() else []
            found.append(Span(start, end, "unused", 0, STRANGER, unknown=True))
            at = end
        found += [replace(span, start=at)] if text[at : span.end].strip() else []
    return tuple(found)


def without(query: Query, reasons: dict[str, str]) -> Query:
    """Question without relations to the objects of some labels, their words marked unused with the reason."""
    readings: list[Reading] = []
    for reading in query.readings:
        root = _pruned(reading.root, reasons)
        words = described(root)
        if not any(r.description == words for r in readings):
            readings.append(Reading(root, not readings, words))
    gone = {n.mention: reasons[n.label] for n in query.nodes if n.label in reasons}
    spans = tuple(
        replace(s, role="unused", index=0, note=gone[s.index], unknown=True)
        if s.role == "reference" and s.index in gone
        else s
        for s in query.spans
    )
    asked = tuple((label, name) for label, name in query.asked if label not in reasons)
    return replace(query, readings=tuple(readings), spans=spans, asked=asked)


def _pruned(node: Node, gone: Collection[str]) -> Node:
    """Node without unknown nouns; their descriptions pass to the node: `on the wall above the bed`."""
    kept: list[Attachment] = []
    choices = node.choices
    for attachment in node.attachments:
        nodes = tuple(_pruned(n, gone) for n in attachment.nodes)
        if any(n.label in gone and not n.viewer for n in nodes):
            if attachment.relation in ("on", "near") and nodes[0].label in gone and nodes[0].name in GROUND:
                order = "high" if attachment.negated else "low"
                choices += (Choice(order, None, f"{attachment.phrase} {nodes[0].name}"),)
            kept += [a for n in nodes if n.label in gone and not attachment.negated for a in n.attachments]
        else:
            kept.append(replace(attachment, nodes=nodes))
    excluded = tuple(n for n in node.excluded if n.label not in gone)
    return replace(node, attachments=tuple(kept), excluded=excluded, choices=choices)


def unused_words(query: Query) -> tuple[tuple[str, str], ...]:
    """Unused words of a question, each with the reason."""
    unused = [(query.text[s.start : s.end], s.note) for s in query.unused]
    attributes = dict.fromkeys(a for n in query.nodes for a in n.attributes if not a.judged)
    return (*unused, *((str(a), "is not judged here, and left to the detector") for a in attributes))


def taken_as(query: Query, found: Mapping[str, Sequence[str]]) -> tuple[tuple[str, Meaning], ...]:
    """Names of a question replaced by other names of the detector.

    `found`: what the detector calls what it found, by label of the question.
    """
    replaced = []
    for node in query.nodes:
        if not node.anything:
            names = tuple(dict.fromkeys(found.get(node.label, ())))
            replaced += [(node.name, m) for m in meanings(node.name, names) if m.how != "exact"]
    return tuple(dict.fromkeys(replaced))
