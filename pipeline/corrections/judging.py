"""Verdicts on answers by a frame's labels as corrected, a run's, or annotations; and an answer's pair kept as true."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from datetime import datetime, timezone
from typing import Any

import numpy as np

from pipeline.answering.ask import Trace
from pipeline.answering.objects import PreparedFrame, SceneObject
from pipeline.answering.pair_table import Link, ScoredPair
from pipeline.answering.pipeline import Pipeline
from pipeline.answering.ranking import RankConfig
from pipeline.corrections.journal.edits import Edits, add_object, add_sentence, new_numbers, set_relation
from pipeline.corrections.journal.effective_frame import EffectiveFrame
from pipeline.corrections.journal.events import new_ulid
from pipeline.corrections.journal.field_refs import relation_ref
from pipeline.corrections.label_editor import NOT_IN_THE_JOURNAL, LabelEditor
from pipeline.corrections.scene import answered_case, effective_mark, effective_truth, labelled_objects, withdrawn_by
from pipeline.corrections.unsaved import Waiting
from pipeline.diagnosis.answer import Answer, Judged
from pipeline.diagnosis.asking import annotated_truth, judge_refused, judge_trace, labelled_case, labelled_truth
from pipeline.diagnosis.cases.saving import OpenedCase
from pipeline.diagnosis.not_seen import SceneMaps, not_seen
from pipeline.diagnosis.verdict import Diagnosis, Unseen
from pipeline.diagnosis.whatif.answer_view import OtherAnswer
from pipeline.evaluation.run_folder import Run
from pipeline.evaluation.run_names import told_apart
from pipeline.labels.cases import HIT, FrameCases
from pipeline.labels.reading import Labels
from pipeline.language.naming import same_class
from pipeline.language.relation_names import PAIRWISE
from pipeline.language.tree import Attachment, Node, Query
from pipeline.relations.relations import T
from pipeline.system.errors import InputError, needed, require


class Judge:
    """Judgement of answers about frames of named sources; the truth of the last frame is kept.

    `runs` and `labels` are by source, labels of a run first; `others` are runs to compare with; `corrected` gives a
    frame's corrected labels, or None; `cases`: saved cases by source, whose truth is their own; `names`: of both runs
    of a source, so that they can be told apart.
    """

    def __init__(
        self,
        runs: Mapping[str, Run],
        labels: Mapping[str, Labels],
        others: Mapping[str, Run],
        corrected: Callable[[str, str], EffectiveFrame | None],
        cases: Mapping[str, OpenedCase] | None = None,
    ) -> None:
        self._runs, self._labels, self._others, self._corrected = runs, labels, others, corrected
        self._cases = cases or {}
        self.names = {name: told_apart(runs[name], other) for name, other in others.items() if name in runs}
        self._kept: tuple[tuple[str, str, bytes], EffectiveFrame | None, FrameCases | None] | None = None

    def labels(self, name: str) -> Labels | None:
        """Labels with the truth of a source."""
        return self._runs[name].labels if name in self._runs else self._labels.get(name)

    def truth(self, name: str, source: Pipeline, context: PreparedFrame) -> FrameCases | None:
        """Truth of a frame by corrected labels, else by annotations; None for neither; InputError for unreadable
        labels.
        """
        # Annotations are true under the up vector that is known now.
        key, frame = (name, context.frame.id, context.viewer.up.tobytes()), context.frame.id
        corrected, labels = self._corrected(name, frame), self.labels(name)
        if self._kept is None or self._kept[0] != key or self._kept[1] is not corrected:
            if corrected is not None:
                found = effective_truth(corrected)
            elif name in self._cases:
                found = self._cases[name].truth
            else:
                found = None if labels is None else labelled_truth(frame, source, labels)
            self._kept = key, corrected, annotated_truth(context, source) if found is None else found
        return self._kept[2]

    def labelled(self, name: str, source: Pipeline, context: PreparedFrame) -> FrameCases | None:
        """Truth of a frame by labels; None for no readable labels."""
        try:
            return self.truth(name, source, context) if self.labels(name) is not None else None
        except InputError:
            return None

    def judge(
        self,
        name: str,
        source: Pipeline,
        context: PreparedFrame,
        trace: Trace,
        expression: str | None = None,
        rank: RankConfig | None = None,
        before: Judged = None,
    ) -> Judged:
        """Verdict on an answer, what its frame does not show, the reason why none is possible, or None without truth.

        `name` is the source of the truth, `source` what has answered, `expression` the id of the labelled one that was
        asked, `rank` the weights of an edited trace, `before` what came of it before the last edit.
        """
        try:
            truth, corrected = self.truth(name, source, context), self._corrected(name, context.frame.id)
            if truth is None:
                return self._unseen(name, trace, None)
            rejected = None if corrected is None or expression is None else withdrawn_by(corrected, expression)
            if rejected is not None:
                return rejected
            known = self.known(name, context.frame.id, truth, expression, source)
            case = known["case"] or labelled_case(truth, trace.query.text)
            if corrected is not None and case is not None:
                known["case"] = answered_case(corrected, truth, case, trace)
            evidence = before.evidence if isinstance(before, Diagnosis) else None
            found = judge_trace(trace, source, context, truth, rank=rank, before=evidence, **known)
        except InputError as error:
            found = str(error)
        if isinstance(found, str):
            return self._unseen(name, trace, found) or found
        return self._mapped(name, found, trace.query.text)

    def judge_refused(
        self, name: str, source: Pipeline, context: PreparedFrame, expression: str | None
    ) -> Diagnosis | str | None:
        """Verdict on a labelled expression beyond asking; None for any other."""
        try:
            truth = self.truth(name, source, context)
            known = self.known(name, context.frame.id, truth, expression, source)
            if truth is None or known["case"] is None:
                return None
            case = known.pop("case")
            found = judge_refused(source, context, truth, case, **known)
            return found if isinstance(found, str) else self._mapped(name, found, case.text)
        except InputError as error:
            return str(error)

    def _mapped(self, name: str, found: Diagnosis, text: str) -> Diagnosis:
        """Verdict by the object maps of a source's run, or by what its saved case keeps of one, if there is any."""
        if name in self._cases:
            unseen = self._kept_unseen(name, text)
            return found if unseen is None else not_seen(found, unseen)
        maps = self._maps(name)
        return found if maps is None else maps.judged(found)

    def _unseen(self, name: str, trace: Trace, reason: str | None) -> Unseen | None:
        """What the frame does not show, of an answer without a verdict for a reason."""
        if name in self._cases:
            return self._kept_unseen(name, trace.query.text)
        maps = self._maps(name)
        return None if maps is None else maps.answered(Answer(trace.query.text, trace, unjudged=reason)).unseen

    def _maps(self, name: str) -> SceneMaps | None:
        return None if name not in self._runs else self._runs[name].maps

    def _kept_unseen(self, name: str, text: str) -> Unseen | None:
        kept = self._cases[name].manifest
        return kept.unseen if kept.text == text else None

    def known(
        self, name: str, frame: str, truth: FrameCases | None, expression: str | None, source: Pipeline | None = None
    ) -> dict[str, Any]:
        """Case, mark and confidence of a labelled expression in a run, as arguments of `judge_trace`.

        `source`: of the run; by default the first.
        """
        second = self._others.get(name)
        run = second if second is not None and second.source is source else self._runs.get(name)
        corrected = self._corrected(name, frame)
        mark = None if run is None else run.spec.marks.get((frame, expression or ""))
        confidence, kept = None if run is None else run.spec.confidence, self._cases.get(name)
        if kept is not None:
            mark, confidence = kept.mark if kept.case and kept.case.id == expression else None, kept.confidence
        if corrected is not None and expression is not None:
            mark = effective_mark(corrected, expression, mark)
        return {
            "case": None if truth is None else next((c for c in truth.cases if c.id == expression), None),
            "mark": mark,
            "confidence": confidence,
        }

    def other(
        self, name: str, context: PreparedFrame, text: str, expression: str | None = None, second: bool = True
    ) -> OtherAnswer | None:
        """Answer and verdict of the run to compare with, by the same truth; None for none.

        `second`: the second run's, beside an answer of the first; else the other way round.
        """
        run = (self._others if second else self._runs).get(name)
        if run is None or name not in self.names:
            return None
        named, source = self.names[name][second], run.source
        try:
            context = context.under(source.config.lift)
            trace = source.ask(context, text)
        except InputError as error:
            return OtherAnswer(text, problem=str(error), name=named)
        found = self.judge(name, source, context, trace, expression)
        if isinstance(found, Diagnosis):
            return OtherAnswer(text, trace, diagnosis=found, name=named)
        if isinstance(found, Unseen):
            return OtherAnswer(text, trace, unseen=found, name=named)
        return OtherAnswer(text, trace, unjudged=found, name=named)


REASON = "this pair is correct"


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
