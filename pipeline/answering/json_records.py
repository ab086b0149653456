"""JSON records of traces, relations and frame reports, with stable keys."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from pipeline.answering.answer_words import (
    asked_in_part,
    best_pair,
    failing_links,
    holds,
    reading_notes,
    stands,
    why_no_answer,
)
from pipeline.answering.ask import Trace
from pipeline.answering.detector_prompts import taken_as, unused_words
from pipeline.answering.objects import SceneObject
from pipeline.answering.pair_table import Link, ScoredPair
from pipeline.answering.pipeline import FrameRelations
from pipeline.geometry.viewer import ViewerAxes
from pipeline.language.naming import Meaning
from pipeline.language.relation_names import PAIRWISE
from pipeline.language.tree import Node, Query
from pipeline.relations.relations import letter

Record = dict[str, Any]


def _numbers(values: np.ndarray, digits: int = 4) -> Any:
    return np.round(np.asarray(values, np.float64), digits).tolist()


def _probability(value: float) -> float:
    return round(float(value), 6)


def object_record(entry: SceneObject) -> Record:
    """label, score, bbox; center, size, R in the camera frame (null without depth); quality; "whole", the completed
    box, where those were asked for."""
    box = entry.lifted.box
    quality = entry.lifted.quality
    return {
        "id": entry.id,  # The detector's own number of the object
        "label": entry.label,  # Name that the detector gives it
        "score": _probability(entry.score),  # P(object | name), 0..1
        "bbox": _numbers(entry.bbox, 2),  # x0, y0, x1, y1, pixels
        # Of the 3D box, camera frame, metres; null without depth
        "center": None if box is None else _numbers(box.center),
        "size": None if box is None else _numbers(box.size),  # Full edge lengths along its own axes, metres
        # Rotation of the box to the camera frame, three rows; its columns are the box's axes
        "R": None if box is None else _numbers(box.R, 6),
        # How far the box can be trusted
        "quality": {
            "mask_pixels": quality.mask_pixels,  # Pixels of the mask
            "points": quality.points,  # Of these, kept by the cleaning
            "kept": round(quality.kept, 4),  # Share of the mask that was kept
            "depth_missing": round(quality.depth_missing, 4),  # Share of it without depth
            "touches_border": quality.touches_border,  # The mask reaches the picture's border
            # Median depth of the points, metres
            "distance": None if np.isnan(quality.distance) else round(quality.distance, 4),
            "yaw_confidence": round(entry.lifted.yaw_confidence, 4),  # How sure the box's turn is, 0..1
            # Sides, by the viewer's axes, beyond which the object may go on; null of boxes of another fit
            "open_sides": None if entry.lifted.open_sides is None else list(entry.lifted.open_sides),
            "mask_source": quality.mask_source,  # What made the mask
            "concerns": list(quality.concerns),  # Reasons to doubt the box, in words
        },
    } | present(
        box_from=entry.box_from or None,  # Of imported predictions: whether the 3D box is theirs
        whole=None if entry.whole is None else entry.whole.record(),  # Box completed to the whole object, where asked
    )


def present(**values: Any) -> Record:
    """Arguments other than None."""
    return {name: value for name, value in values.items() if value is not None}


def viewer_record(viewer: ViewerAxes) -> Record:
    """Up vector used, its source, and with "up_doubt" evidence against it."""
    return {
        "up": _numbers(viewer.up, 6),  # Unit vector against gravity, camera frame
        "up_source": viewer.up_source,  # given, declared, imu, scene, plane or assumed
    } | present(
        up_doubt=viewer.up_doubt or None,  # What the frame itself says against it
    )


def expression_record(query: Query) -> Record:
    """Target, relation, reference (null without a relation), the tree, and the readings if several.

    With "inverse" the relation holds from the reference to the target: "table holding a lamp" is lamp on table.
    "unused" lists words left out, each with the reason; "mended" the misspelt words with their readings; "asked" the
    phrase asked of the detector for each noun, null for everything; "reader" the reader, if not the grammar.
    """
    e = query.expression
    record: Record = {
        "text": query.text,  # As it was asked
        "target": query.target,  # Name of what is asked for
        "relation": None if e is None else e.relation,  # Its relation; null where none is asked
        "reference": None if e is None else e.reference,  # Name of what it stands in relation to
    }
    return record | present(
        inverse=None if e is None else e.inverse or None,  # The relation holds from the reference to the target
        second_reference=None if e is None else e.second_reference,  # The other end of between
        mapped_from=None if e is None else e.mapped_from,  # Relation in the sentence, where another stands in for it
        reader=None if query.reader == "grammar" else query.reader,  # What read the words, where it was not the grammar
        # All readings in words, where there are several
        readings=[r.description for r in query.readings] if len(query.readings) > 1 else None,
        tree=noun_record(query.default.root),  # The words as a tree
        # Words that were left out: text, why
        unused=[{"text": text, "why": why} for text, why in unused_words(query)] or None,
        # Misspelt words: said, read_as
        mended=[{"said": said, "read_as": meant} for said, meant in query.mended] or None,
        # Phrase that the detector was asked for each name: name, phrase
        asked=[{"name": name, "phrase": phrase} for name, phrase in query.asked] or None,
    )


def noun_record(node: Node) -> Record:
    """Noun phrase with its description, without empty fields."""
    return {
        "label": node.label,  # Name as the detector knows it
    } | present(
        head=node.head or None,  # Its last word, where the name has several
        viewer=node.viewer or None,  # The one from whom it is seen
        count=node.count,  # How many are asked for
        # kind, value, shade of each
        attributes=[present(kind=a.kind, value=a.value, shade=a.shade) for a in node.attributes] or None,
        # Which of several: order, rank, text
        choices=[present(order=c.order, rank=c.rank, text=c.text) for c in node.choices] or None,
        # relation, phrase, inverse, negated, of (nouns) of each
        relations=[
            present(
                relation=a.relation,
                phrase=a.phrase,
                inverse=a.inverse or None,
                negated=a.negated or None,
                of=[noun_record(n) for n in a.nodes],
            )
            for a in node.attachments
        ]
        or None,
        excluded=[noun_record(n) for n in node.excluded] or None,  # Nouns that it is not
    )


def pair_record(trace: Trace, pair: ScoredPair) -> Record:
    """Ranked pair; target and reference are places in "proposals"."""
    return {
        "target": pair.target,  # Its place in `proposals`
        "reference": pair.reference,  # The same of its reference; null where none is asked
        "p_target": _probability(pair.p_target),  # P(target), 0..1
        "p_reference": _probability(pair.p_reference),  # P(reference)
        "p_relation": _probability(pair.p_relation),  # P(relation)
        # Of the asked relation, of several the weakest; null where it was left out
        "relation_probability": _asked_probability(trace, pair),
        "holds": stands(trace, pair),  # Every relation is at least as probable as not; null where words were not used
        "product": _probability(pair.product),  # Of all factors
        "probability": _probability(pair.probability),  # Posterior over the candidate pairs
        # Natural logarithm of each factor, without its weight
        "log_factors": {k: round(v, 6) for k, v in pair.log_factors.items()},
    } | present(
        second_reference=pair.second_reference,  # Place of the other end of between
        # All relations of the expression, where there are several
        links=[_link_record(x) for x in pair.links] if len(pair.links) > 1 else None,
        # Attributes and choices: kind, text, object, probability
        factors=[
            {"kind": f.kind, "text": f.text, "object": f.object, "probability": _probability(f.probability)}
            for f in pair.factors
        ]
        or None,
        worked_out=worked_out(trace, pair),  # Of imported predictions: numbers that the file does not give
    )


def _link_record(link: Link) -> Record:
    return present(
        relation=link.relation,  # Name of the relation
        a=link.a,  # Place of the object that it is said of
        b=link.b,  # Place of its reference
        probability=_probability(link.probability),  # P(a RELATION b)
        c=link.c,  # Place of the other end of between
        inverse=link.inverse or None,  # It is said of b
    )


def trace_record(trace: Trace) -> Record:
    """Record of `ask --json` for an expression on a frame.

    "answer" is the best pair, null without any: "holds" says whether every relation of the expression is at least as
    probable as not, null where words of it were not used and the rest holds, "relation_probability" is that of the
    weakest of them, "probability" the posterior over the candidate pairs; where it does not hold, "fails" lists the
    relations that do not. "answered" is there only where an imported answer came without what ranked it: then these
    numbers are ours, and no part of it. Of imported predictions "worked_out" names the numbers of a pair that the file
    does not give, "relations_worked_out" the relations of each pair, and "box_from" says whose a 3D box is.
    """
    ranking, calibration = trace.ranking, trace.score_calibration
    pairs = () if ranking is None else ranking.pairs
    names = taken_as(trace.query, {label: c.labels for label, c in trace.candidates.items()})
    expression = expression_record(trace.query) | present(
        names=[_name_record(*name) for name in names]
        or None,  # Names that stand for others: said, taken_as, how, score
    )
    proposals = [
        {
            "index": i,  # Its place in this list
            **object_record(entry),
        }
        for i, entry in enumerate(trace.objects)
    ]
    record: Record = {
        # What was asked, as it was read
        "expression": expression,
        "frame": trace.frame.id,  # Id of the frame
        "answer": _best_record(trace),  # The best pair; null where there is none
        "pairs": [pair_record(trace, p) for p in pairs],  # All candidate pairs, best first
        # Detections of all names, in 3D
        "proposals": proposals,
        "relations": _relations_of_pairs(trace, pairs),  # By "target,reference": each relation's probability
        "timings_ms": {k: round(v * 1000, 3) for k, v in trace.timings.items()},  # Time of each stage, milliseconds
        "detector": trace.detector,  # What found the objects
        "scorer": trace.scorer,  # What scored the relations
        "viewer": viewer_record(trace.viewer),  # Where up is
    }
    ranked = (
        None
        if ranking is None
        else {
            "reading": ranking.reading.description,  # Reading that was taken, in words
            "margin": round(ranking.margin, 6),  # Posterior of the best pair less that of the next
            # The same of the logarithms of their scores; null where there is one pair
            "log_margin": None if np.isinf(ranking.log_margin) else round(ranking.log_margin, 6),
            "entropy": round(ranking.entropy, 6),  # Of the posterior, nats
            "degenerate": ranking.degenerate,  # No pair was allowed: the detector's best target stands alone
        }
    )
    return record | present(
        # What made probabilities of scores: a, b
        score_calibration=None if calibration is None else {"a": calibration.a, "b": calibration.b},
        reason=why_no_answer(trace),  # Why there is no answer
        notes=list(reading_notes(trace)) or None,  # What a reader should know of the reading
        relations_worked_out=None  # Of imported predictions: relations of each pair that the file does not give
        if trace.scores.given is None
        else {
            f"{p.target},{p.reference}": trace.scores.worked_out(p.target, p.reference)
            for p in pairs
            if p.reference is not None
        },
        answered=trace.answered,  # Where an imported answer came without what ranked it: how it was given
        ranking=ranked,  # How the pairs were ranked
        depth_source=trace.frame.depth_source or None,  # Network that estimated the depth, in words
    )


def _asked_probability(trace: Trace, pair: ScoredPair) -> float | None:
    """Probability of the asked relation for a pair; None where the only relation was left out."""
    lost = pair.reference is None and asked_in_part(trace)
    return None if lost else _probability(pair.relation_probability)


def _name_record(text: str, meant: Meaning) -> Record:
    """Name of the question replaced by the detector's name."""
    return {"said": text, "taken_as": meant.name, "how": meant.how, "score": meant.score}


def _best_record(trace: Trace) -> Record | None:
    best = best_pair(trace)
    if best is None:
        return None
    second = best.second_reference
    names = [] if trace.asked is None else [n.label for n in trace.asked.nodes]
    return {
        "target": object_record(trace.under(trace.root.label, best.target)),  # The object, as in `proposals`
        # The same of its reference; null where none is asked
        "reference": None if best.reference is None else object_record(trace.under(names[0], best.reference)),
        "holds": holds(trace),
        "relation_probability": _asked_probability(trace, best),
        "probability": _probability(best.probability),
        "p_relation": _probability(best.p_relation),
        "product": _probability(best.product),
    } | present(
        worked_out=worked_out(trace, best),
        # The other end of between, as in `proposals`
        second_reference=None if second is None else object_record(trace.under(names[1], second)),
        # Relations that do not hold, where the answer does not
        fails=None if best.holds else [_link_record(link) for link in failing_links(best)],
    )


def _relations_of_pairs(trace: Trace, pairs: Sequence[ScoredPair]) -> Record:
    table = trace.scores
    return {
        f"{p.target},{p.reference}": {
            r: _probability(table.probabilities[p.target, p.reference, n]) for n, r in enumerate(table.relations)
        }
        for p in pairs
        if p.reference is not None
    }


def relation_records(found: FrameRelations, relations: Sequence[str] = PAIRWISE) -> Iterator[Record]:
    """Records of all ordered pairs of objects; the sentence is "a RELATION b".

    An object's index is its place in the dataset's own list where the objects
    are the dataset's, else its place among the detections.
    """
    objects, scores = found.objects, found.scores
    columns = [scores.relations.index(r) for r in relations]
    up = {} if found.viewer is None else viewer_record(found.viewer)
    up |= present(depth_source=found.depth_source or None)
    for i, a in enumerate(objects):
        for j, b in enumerate(objects):
            if i == j:
                continue
            yield {
                "frame": found.frame_id,
                "a": {"index": a.id if found.exact else i, "label": a.label},
                "b": {"index": b.id if found.exact else j, "label": b.label},
                "states": {r: letter(scores.states[i, j, c]) for r, c in zip(relations, columns, strict=True)},
                "probabilities": {
                    r: _probability(scores.probabilities[i, j, c]) for r, c in zip(relations, columns, strict=True)
                },
                **up,
            }


ALWAYS = ("product", "probability", "log_factors")
"""Numbers of a pair that no file gives."""


def worked_out(trace: Trace, pair: ScoredPair) -> tuple[str, ...] | None:
    """Names of a pair's computed numbers in `ask --json`; None without imported predictions."""
    if trace.scores.given is None:
        return None
    weakest, first = pair.weakest, relation_given(trace, pair)
    whole = first if weakest is None else _link_given(trace, weakest)
    return (*("p_relation",) * (not first), *("relation_probability",) * (not whole), *ALWAYS)


def relation_given(trace: Trace, pair: ScoredPair) -> bool:
    """True for a relation given by the file, and for nothing imported or no relation."""
    if pair.reference is None or not trace.relation:
        return True
    return _link_given(
        trace, Link(trace.relation, pair.target, pair.reference, 1.0, pair.second_reference, trace.inverse)
    )


def _link_given(trace: Trace, link: Link) -> bool:
    scores = trace.scores
    ends = (link.b, link.a) if link.inverse else (link.a, link.b)
    if link.relation in scores.relations or scores.given is None:
        return link.relation not in scores.worked_out(*ends)
    third = () if link.c is None else (link.c,)
    return tuple(trace.objects[k].id for k in (*ends, *third)) in scores.beyond.get(link.relation, {})
