"""Answers told in words; and traces, relations and frame reports as the stable keys of `--json`."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pipeline.answering.ask import Trace
from pipeline.answering.asked_names import taken_as, unused_words
from pipeline.answering.objects import SceneObject
from pipeline.answering.opening import FrameRelations
from pipeline.answering.pair_table import HOLDS, Link, ScoredPair
from pipeline.answering.ranking import Candidates, Ranking
from pipeline.answering.reading_notes import reading_notes
from pipeline.answering.worked_out import worked_out
from pipeline.datasets.frame_reports import FrameReport
from pipeline.geometry.viewer import ViewerAxes
from pipeline.language.lexicon import wording
from pipeline.language.naming import Meaning
from pipeline.language.relation_names import PAIRWISE
from pipeline.language.tree import Node, Query
from pipeline.language.unreadable import why_unused
from pipeline.relations.relations import letter

Record = dict[str, Any]


NOTHING = Candidates(np.zeros(0, np.int64), np.zeros(0))


def _numbers(values: np.ndarray, digits: int = 4) -> Any:
    return np.round(np.asarray(values, np.float64), digits).tolist()


def _probability(value: float) -> float:
    return round(float(value), 6)


def object_record(entry: SceneObject) -> Record:
    """label, score, bbox; center, size, R in the camera frame (null without depth); quality."""
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
            "mask_source": quality.mask_source,
            "concerns": list(quality.concerns),
        },
    } | present(box_from=entry.box_from or None)


def present(**values: Any) -> Record:
    """What is not None."""
    return {name: value for name, value in values.items() if value is not None}


def viewer_record(viewer: ViewerAxes) -> Record:
    """The up vector that was used, how it is known, and with "up_doubt" what the frame says against it."""
    return {"up": _numbers(viewer.up, 6), "up_source": viewer.up_source} | present(up_doubt=viewer.up_doubt or None)


def expression_record(query: Query) -> Record:
    """target, relation, reference (null without a relation), the tree, and, where there are several, the readings.

    With "inverse" the relation holds from the reference to the target: "table holding a lamp" is lamp on table.
    "unused" lists the words that say something and could not be used, each with the reason; "mended" the misspelt words
    with what each was read as; "asked" of each thing the phrase that the detector was asked for, null where that was
    everything; "reader" what read it, where it was not the grammar.
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
    """A noun phrase with all that is said of it; only what is said stands there."""
    return {"label": node.label} | present(
        head=node.head or None,
        viewer=node.viewer or None,
        count=node.count,
        attributes=[present(kind=a.kind, value=a.value, shade=a.shade) for a in node.attributes] or None,
        choices=[present(order=c.order, rank=c.rank, text=c.text) for c in node.choices] or None,
        relations=[
            present(
                relation=a.relation, phrase=a.phrase, inverse=a.inverse or None, negated=a.negated or None,
                of=[noun_record(n) for n in a.nodes],
            )
            for a in node.attachments
        ] or None,
        excluded=[noun_record(n) for n in node.excluded] or None,
    )  # fmt: skip


def pair_record(trace: Trace, pair: ScoredPair) -> Record:
    """One ranked pair; target and reference are places in "proposals"."""
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
        ] or None,
        worked_out=worked_out(trace, pair),
    )  # fmt: skip


def _link_record(link: Link) -> Record:
    return present(
        relation=link.relation, a=link.a, b=link.b, probability=_probability(link.probability), c=link.c,
        inverse=link.inverse or None,
    )  # fmt: skip


def trace_record(trace: Trace) -> Record:
    """The whole of `ask --json` for one expression on one frame.

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
    ranked = None if ranking is None else {
        "reading": ranking.reading.description,
        "margin": round(ranking.margin, 6),
        "log_margin": None if np.isinf(ranking.log_margin) else round(ranking.log_margin, 6),
        "entropy": round(ranking.entropy, 6),
        "degenerate": ranking.degenerate,
    }  # fmt: skip
    return record | present(
        score_calibration=None if calibration is None else {"a": calibration.a, "b": calibration.b},
        reason=why_no_answer(trace),
        notes=list(reading_notes(trace)) or None,
        relations_worked_out=None if trace.scores.given is None else {
            f"{p.target},{p.reference}": trace.scores.worked_out(p.target, p.reference)
            for p in pairs if p.reference is not None
        },
        answered=trace.answered,
        ranking=ranked,
        depth_source=trace.frame.depth_source or None,
    )


def _asked_probability(trace: Trace, pair: ScoredPair) -> float | None:
    """That a pair stands in what was asked; None where the only relation of the question was left out of it."""
    lost = pair.reference is None and asked_in_part(trace)
    return None if lost else _probability(pair.relation_probability)


def _name_record(text: str, meant: Meaning) -> Record:
    """A name of the question that stands for what the detector calls something else."""
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


def why_no_answer(trace: Trace) -> str | None:
    """One line saying why there is no answer; None where there is one."""
    if trace.answered is not None and trace.ranking is None:
        return trace.answered
    if trace.missing:
        names = " and no ".join(repr(n) for n in trace.missing)
        return f"no {names} found in frame {trace.frame.id}"
    if len(trace.tied) > 1:
        several = ", ".join(trace.name(k) for k in trace.tied[:SEVERAL]) + (", …" if len(trace.tied) > SEVERAL else "")
        unused = " and ".join(f"'{words}' ({why})" for words, why in unused_words(trace.query))
        told = f"; not used: {unused}" if unused else ""
        return f"{len(trace.tied)} things fit '{trace.query.text}' equally well: {several}{told}"
    if trace.ranking is None or trace.ranking.degenerate:
        return f"in frame {trace.frame.id} there are not enough different objects for all names of the expression"
    return None


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
    """One record for each ordered pair of objects; the sentence is "a RELATION b".

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


def frame_record(report: FrameReport) -> Record:
    """One record of `frames --json`; "moves" only where the dataset has moves. "dataset_notes" are the same in all."""
    return {
        "index": report.index,
        "frame": report.id,
        "ok": report.ok,
        "problem": report.problem,
        "width": report.width,
        "height": report.height,
        "annotations": report.annotations,
        "labels": list(report.labels),
        "depth_valid": report.depth_valid,
        "median_depth": report.median_depth,
        "has_pose": report.has_pose,
        "up_source": report.up_source,
        "up": None if report.up is None else _numbers(np.array(report.up), 6),
        "notes": list(report.notes),
        "dataset_notes": list(report.dataset_notes),
    } | present(moves=None if report.moves is None else dict(report.moves))


SEVERAL = 5
NO_SUCH_THING = "nothing is all of that; nearest is "
NO_SUCH_PAIR = "no such pair; nearest is "
IN_PART = "not all of it was used; by the rest it is "
SUPERLATIVES = ("closest", "farthest")
TIED = 5e-4
"""Posteriors that differ by less are called a tie."""


@dataclass(frozen=True)
class ToldAnswer:
    """The best pair in words.

    Attributes
    ----------
    holds : bool or None
        Every relation of the answer has a probability of at least a half; None where that is so of a question that was
        asked in part.
    lead : str
        What stands before the pair: nothing, that there is no such pair, or that a pair of less confidence is one.
    numbers : str
        The relation's probability (of several the weakest's) and the product of all factors.
    below : str
        The posterior over the candidate pairs, and its margin to the next one.
    fails : tuple of str
        Each relation that does not hold, where the expression has several.
    """

    holds: bool | None
    lead: str
    numbers: str
    below: str
    fails: tuple[str, ...]

    def sentence(self, pair: str) -> str:
        """All of it on one line, around the pair in words."""
        return f"{self.lead}{pair}: {', '.join((self.numbers, *self.fails))}"


def best_pair(trace: Trace) -> ScoredPair | None:
    """The answer; None where there is none: a name was not found, or all candidates are one thing."""
    ranking = trace.ranking
    none = ranking is None or ranking.degenerate or not ranking.pairs or len(trace.tied) > 1
    return None if none or ranking is None else ranking.pairs[0]


def holds(trace: Trace) -> bool | None:
    """Whether there is an answer that is all that was asked; None where it is, of a question that was asked in part."""
    best = best_pair(trace)
    return best is not None and stands(trace, best)


def stands(trace: Trace, pair: ScoredPair) -> bool | None:
    """`holds` of any pair of a trace."""
    return None if pair.holds and asked_in_part(trace) else pair.holds


def asked_in_part(trace: Trace) -> bool:
    """Whether words that tell things apart were left out of what was asked: nobody knows then what holds of them."""
    if why_unused(trace.query) is not None:
        return True
    # A detector that was asked for the whole phrase has judged `striped` by it.
    plain = [n for n in trace.query.nodes if n.label not in trace.candidates.get(n.label, NOTHING).labels]
    return any(not a.judged for n in plain for a in n.attributes)


def failing_links(pair: ScoredPair) -> tuple[Link, ...]:
    """The relations of an answer in which it does not stand."""
    return tuple(link for link in pair.links if link.probability < HOLDS)


def told(trace: Trace, name: Callable[[int], str], pair: ScoredPair | None = None) -> ToldAnswer:
    """The words of an answer, or of another of its pairs.

    Parameters
    ----------
    trace : Trace
        One that has an answer.
    name : callable
        What an object of the trace is called, by its index.
    pair : ScoredPair, optional
        By default the best one.
    """
    ranking = trace.ranking
    assert ranking is not None
    pair = pair or ranking.pairs[0]
    several = len(pair.links) > 1
    fails = [f"{link_words(link, name)} {probability(link.probability)}" for link in failing_links(pair) if several]
    fails += [f"{name(f.object)} {f.text} {probability(f.probability)}" for f in pair.factors if not f.holds]
    factors = {what: probability(p) for what, p in headline(pair, trace.own_scores)}
    return ToldAnswer(
        holds=stands(trace, pair),
        lead="" if trace.answered else _lead(trace, ranking, pair),
        numbers=trace.answered or ", ".join(f"{what} {p}" for what, p in factors.items()),
        below="" if trace.answered else _below(ranking, pair),
        fails=() if trace.answered else tuple(fails),
    )


def headline(pair: ScoredPair, own_scores: bool = False) -> tuple[tuple[str, float], ...]:
    """The numbers at the top of an answer: of its relation, of its attributes and choices, and the product.

    Without the product where a pair's score is another (`Trace.own_scores`), unless there is nothing else.
    """
    relation = "weakest relation" if len(pair.links) > 1 else "relation"
    asked = ((relation, pair.relation_probability),) if pair.reference is not None else ()
    attributes = (("attributes", pair.p_attributes),) if pair.factors else ()
    told = (*asked, *attributes)
    return told if told and own_scores else (*told, ("product", pair.product))


def pair_words(trace: Trace, pair: ScoredPair, name: Callable[[int], str]) -> str:
    """A pair as a sentence: "mug·4 left of laptop·2"; without a relation the thing alone."""
    ends = " and ".join(name(k) for k in (pair.reference, pair.second_reference) if k is not None)
    return f"{name(pair.target)} {trace.phrase} {ends}" if ends else name(pair.target)


def _lead(trace: Trace, ranking: Ranking, pair: ScoredPair) -> str:
    if pair.holds:
        return IN_PART if asked_in_part(trace) else ""
    weakest = pair.weakest
    if weakest is not None and weakest.relation in SUPERLATIVES:
        # There always is a closest one; the detector's scores overruled it.
        return f"another is the {weakest.relation}; best by all scores is "
    standing = next((rank for rank, p in enumerate(ranking.pairs, start=1) if p.holds), None)
    if standing is not None:
        return f"pair {standing} stands in it with a smaller product; best by all scores is "
    return NO_SUCH_PAIR if pair.reference is not None else NO_SUCH_THING


def _below(ranking: Ranking, pair: ScoredPair) -> str:
    count = len(ranking.pairs)
    if count == 1:
        return f"posterior {probability(pair.probability)}, the only candidate pair"
    if pair is not ranking.pairs[0]:
        rank = next(k for k, p in enumerate(ranking.pairs, start=1) if p is pair)
        best = probability(ranking.pairs[0].probability)
        return f"posterior {probability(pair.probability)}, rank {rank} of {count}; the answer has {best}"
    tied = np.isfinite(ranking.margin) and abs(ranking.margin) < TIED
    margin = "tied with the next" if tied else f"margin {ranking.margin:.2f}"
    return f"posterior {probability(pair.probability)}, {margin}, {count} pairs"


def link_words(link: Link, name: Callable[[int], str]) -> str:
    """A relation of an answer: "mug·4 left of laptop·2"."""
    second = "" if link.c is None else f" and {name(link.c)}"
    return f"{name(link.a)} {wording(link.relation, inverse=link.inverse)} {name(link.b)}{second}"


def probability(value: float) -> str:
    """Two digits; a small one with so many that it is not 0."""
    if 0 < value < 0.005:
        return f"{value:.1g}" if value >= 1e-4 else "<0.0001"
    return f"{value:.2f}"
