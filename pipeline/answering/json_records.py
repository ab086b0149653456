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
        "id": entry.id,
        "label": entry.label,
        "score": _probability(entry.score),
        "bbox": _numbers(entry.bbox, 2),
        "center": None if box is None else _numbers(box.center),
        "size": None if box is None else _numbers(box.size),
        "R": None if box is None else _numbers(box.R, 6),
        "quality": {
            "mask_pixels": quality.mask_pixels,
            "points": quality.points,
            "kept": round(quality.kept, 4),
            "depth_missing": round(quality.depth_missing, 4),
            "touches_border": quality.touches_border,
            "distance": None if np.isnan(quality.distance) else round(quality.distance, 4),
            "yaw_confidence": round(entry.lifted.yaw_confidence, 4),
            "open_sides": None if entry.lifted.open_sides is None else list(entry.lifted.open_sides),
            "mask_source": quality.mask_source,
            "concerns": list(quality.concerns),
        },
    } | present(box_from=entry.box_from or None, whole=None if entry.whole is None else entry.whole.record())


def present(**values: Any) -> Record:
    """Arguments other than None."""
    return {name: value for name, value in values.items() if value is not None}


def viewer_record(viewer: ViewerAxes) -> Record:
    """Up vector used, its source, and with "up_doubt" evidence against it."""
    return {"up": _numbers(viewer.up, 6), "up_source": viewer.up_source} | present(up_doubt=viewer.up_doubt or None)


def expression_record(query: Query) -> Record:
    """Target, relation, reference (null without a relation), the tree, and the readings if several.

    With "inverse" the relation holds from the reference to the target: "table holding a lamp" is lamp on table.
    "unused" lists words left out, each with the reason; "mended" the misspelt words with their readings; "asked" the
    phrase asked of the detector for each noun, null for everything; "reader" the reader, if not the grammar.
    """
    e = query.expression
    record: Record = {
        "text": query.text,
        "target": query.target,
        "relation": None if e is None else e.relation,
        "reference": None if e is None else e.reference,
    }
    return record | present(
        inverse=None if e is None else e.inverse or None,
        second_reference=None if e is None else e.second_reference,
        mapped_from=None if e is None else e.mapped_from,
        reader=None if query.reader == "grammar" else query.reader,
        readings=[r.description for r in query.readings] if len(query.readings) > 1 else None,
        tree=noun_record(query.default.root),
        unused=[{"text": text, "why": why} for text, why in unused_words(query)] or None,
        mended=[{"said": said, "read_as": meant} for said, meant in query.mended] or None,
        asked=[{"name": name, "phrase": phrase} for name, phrase in query.asked] or None,
    )


def noun_record(node: Node) -> Record:
    """Noun phrase with its description, without empty fields."""
    return {"label": node.label} | present(
        head=node.head or None,
        viewer=node.viewer or None,
        count=node.count,
        attributes=[present(kind=a.kind, value=a.value, shade=a.shade) for a in node.attributes] or None,
        choices=[present(order=c.order, rank=c.rank, text=c.text) for c in node.choices] or None,
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
        excluded=[noun_record(n) for n in node.excluded] or None,
    )


def pair_record(trace: Trace, pair: ScoredPair) -> Record:
    """Ranked pair; target and reference are places in "proposals"."""
    return {
        "target": pair.target,
        "reference": pair.reference,
        "p_target": _probability(pair.p_target),
        "p_reference": _probability(pair.p_reference),
        "p_relation": _probability(pair.p_relation),
        "relation_probability": _asked_probability(trace, pair),
        "holds": stands(trace, pair),
        "product": _probability(pair.product),
        "probability": _probability(pair.probability),
        "log_factors": {k: round(v, 6) for k, v in pair.log_factors.items()},
    } | present(
        second_reference=pair.second_reference,
        links=[_link_record(x) for x in pair.links] if len(pair.links) > 1 else None,
        factors=[
            {"kind": f.kind, "text": f.text, "object": f.object, "probability": _probability(f.probability)}
            for f in pair.factors
        ]
        or None,
        worked_out=worked_out(trace, pair),
    )


def _link_record(link: Link) -> Record:
    return present(
        relation=link.relation,
        a=link.a,
        b=link.b,
        probability=_probability(link.probability),
        c=link.c,
        inverse=link.inverse or None,
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
    record: Record = {
        "expression": expression_record(trace.query) | present(names=[_name_record(*name) for name in names] or None),
        "frame": trace.frame.id,
        "answer": _best_record(trace),
        "pairs": [pair_record(trace, p) for p in pairs],
        "proposals": [{"index": i, **object_record(o)} for i, o in enumerate(trace.objects)],
        "relations": _relations_of_pairs(trace, pairs),
        "timings_ms": {k: round(v * 1000, 3) for k, v in trace.timings.items()},
        "detector": trace.detector,
        "scorer": trace.scorer,
        "viewer": viewer_record(trace.viewer),
    }
    ranked = (
        None
        if ranking is None
        else {
            "reading": ranking.reading.description,
            "margin": round(ranking.margin, 6),
            "log_margin": None if np.isinf(ranking.log_margin) else round(ranking.log_margin, 6),
            "entropy": round(ranking.entropy, 6),
            "degenerate": ranking.degenerate,
        }
    )
    return record | present(
        score_calibration=None if calibration is None else {"a": calibration.a, "b": calibration.b},
        reason=why_no_answer(trace),
        notes=list(reading_notes(trace)) or None,
        relations_worked_out=None
        if trace.scores.given is None
        else {
            f"{p.target},{p.reference}": trace.scores.worked_out(p.target, p.reference)
            for p in pairs
            if p.reference is not None
        },
        answered=trace.answered,
        ranking=ranked,
        depth_source=trace.frame.depth_source or None,
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
        "target": object_record(trace.under(trace.root.label, best.target)),
        "reference": None if best.reference is None else object_record(trace.under(names[0], best.reference)),
        "holds": holds(trace),
        "relation_probability": _asked_probability(trace, best),
        "probability": _probability(best.probability),
        "p_relation": _probability(best.p_relation),
        "product": _probability(best.product),
    } | present(
        worked_out=worked_out(trace, best),
        second_reference=None if second is None else object_record(trace.under(names[1], second)),
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
