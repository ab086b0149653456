"""*This pair is right*: the answer to a question becomes what is true, by which it is judged from then on."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import datetime, timezone

import numpy as np

from pipeline.answering.ask import Trace
from pipeline.answering.objects import SceneObject
from pipeline.answering.pair_table import Link, ScoredPair
from pipeline.corrections.journal.edits import Edits, add_object, add_sentence, new_numbers, set_relation
from pipeline.corrections.journal.effective_frame import EffectiveFrame
from pipeline.corrections.journal.events import new_ulid
from pipeline.corrections.journal.field_refs import relation_ref
from pipeline.corrections.label_editor import NOT_IN_THE_JOURNAL, LabelEditor
from pipeline.corrections.scene import labelled_objects
from pipeline.corrections.unsaved import Waiting
from pipeline.labels.cases import HIT
from pipeline.language.naming import same_class
from pipeline.language.relation_names import PAIRWISE
from pipeline.language.tree import Attachment, Node, Query
from pipeline.relations.relations import T
from pipeline.system.errors import needed, require

REASON = "this pair is right"


def right_pair(editor: LabelEditor, trace: Trace, pair: ScoredPair) -> Edits:
    """Edits to make a pair of an answer right: missing objects of the pair, and the pair's relations.

    The sentence is kept for one relation between two names. For several, or the inverse, the relations of the answer's
    objects are: such truth follows from the labels. The editor's labels hold the frame (see `take_in`). InputError
    where the question cannot be kept (`why_not_kept`), or the labels say so already.
    """
    why, text = why_not_kept(trace.root), trace.query.text
    require(not why, "the answer cannot be kept as true", got=text, cause=why)
    reference = needed(pair.reference, "the answer is no pair")
    links = pair.links or (Link(trace.relation, pair.target, reference, 1.0, inverse=trace.inverse),)
    attached = tuple(_attachments(trace.root))
    require(len(links) == len(attached), "the answer does not say which objects its other relations mean", got=text)
    nodes = {pair.target: trace.root} | {link.b: a.nodes[0] for a, link in zip(attached, links, strict=True)}
    frame = editor.frame(trace.frame.id)
    numbers: dict[int, int] = {}
    new: Edits = ()
    for (at, node), free in zip(nodes.items(), new_numbers(frame, len(nodes)), strict=True):
        entry = trace.objects[at]
        name = entry.label if node.anything else node.name
        number = _labelled(name, entry, frame)
        if number is None:
            made = add_object(frame, name, mask=entry.mask, number=free)
            number, new = free, (*new, *made)
        numbers[at] = number
    if new:
        # The relations and the sentence are made on the frame with these objects in it.
        waiting = Waiting(new, editor.author, new_ulid(), datetime.now(timezone.utc), "")
        events = [*editor.events(frame.frame), *waiting.events(NOT_IN_THE_JOURNAL, "")]
        frame = editor.corrector.frame(frame.frame, events)
    words = words_of(trace.query)
    if words is not None:
        return (*new, *add_sentence(frame, text, words, numbers[pair.target], numbers[reference], REASON))
    for link in links:
        a, b = (numbers[at] for at in ((link.b, link.a) if link.inverse else (link.a, link.b)))
        if frame.value(relation_ref(frame.frame, a, b, link.relation)) != T:
            said = {edit.ref for edit in new}
            new = (*new, *(e for e in set_relation(frame, a, b, link.relation, T, REASON) if e.ref not in said))
    require(new, "the labels say so already", got=text)
    return new


def words_of(query: Query) -> tuple[str, str, str] | None:
    """Target, relation and reference of a question; None for any other form."""
    e, top = query.expression, query.default.root.triple
    plain = e is not None and top is not None and len(query.readings) == 1 and not e.inverse
    return (e.target, e.relation, e.reference) if plain and e is not None and e.second_reference is None else None


def why_not_kept(root: Node) -> str:
    """Reason why the objects of an answer cannot be kept as the truth of a noun phrase; "" where all its relations have
    labels.
    """
    nodes, attached = tuple(root.walk()), tuple(_attachments(root))
    unlabelled = next((a.relation for a in attached if a.relation not in PAIRWISE), "")
    if not attached:
        return "it names no relation"
    if any(n.attributes for n in nodes):
        return "how things look is judged by the pixels of the labelled things"
    if any(n.choices or n.excluded or n.viewer for n in nodes) or any(a.negated for a in attached):
        return "which of several things it means follows from all that are labelled"
    return f"“{unlabelled}” is judged by geometry, no label says it" if unlabelled else ""


def _attachments(node: Node) -> Iterator[Attachment]:
    """All relations of a noun phrase, in the order of the links of an answer."""
    for attachment in node.attachments:
        yield attachment
        for end in attachment.nodes:
            yield from _attachments(end)


def _labelled(name: str, entry: SceneObject, frame: EffectiveFrame) -> int | None:
    """Labelled object of an answer's object: of its class, and with the greatest overlap of pixels."""
    best: tuple[float, int | None] = (HIT, None)
    for other in labelled_objects(frame):
        if other.label == name or same_class(other.label, name):
            both = np.count_nonzero(other.mask & entry.mask)
            overlap = both / max(np.count_nonzero(other.mask | entry.mask), 1)
            best = max(best, (overlap, other.id), key=lambda found: found[0])
    return best[1]
