"""Numbers of imported predictions are the file's, for each id under each name, or are marked as worked out."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import product
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.answering import (
    FrameAnswers,
    Header,
    ImportedPipeline,
    PredictedAnswer,
    PredictedBox,
    Prediction,
    PreparedFrame,
    Proposal,
    open_pipeline,
    read_predictions,
    trace_record,
)
from pipeline.answering.imported import needed_rows, open_imported
from pipeline.answering.predictions import as_json
from pipeline.datasets import demo_labels
from pipeline.diagnosis import FrameEvidence, substitute
from pipeline.labels import Case, FrameCases, open_labels, read_cases
from pipeline.labels.cases import is_gold, read_query
from pipeline.system import InputError

T = TypeVar("T")
SHARES = st.integers(1, 999).map(lambda k: k / 1000)
OTHERS = ("near", "behind", "on")
"""Relations that nobody asks, of which a file may tell some pairs."""


@dataclass(frozen=True)
class World:
    """A frame, its truth, and the expressions that are asked of it."""

    context: PreparedFrame
    truth: FrameCases
    cases: tuple[Case, ...]
    boxes: dict[int, Any]


@lru_cache(maxsize=1)
def world() -> World:
    source = open_pipeline("demo", srm="rule")
    truth = next(read_cases(open_labels(demo_labels()), 0, 1))
    context = source.prepare(truth.frame)
    boxes = {a.index: tuple(map(float, a.bbox)) for a in context.frame.annotations if min(a.bbox[2:] - a.bbox[:2]) > 8}
    wanted = [c for c in truth.cases if c.target != c.reference and c.relation in ("left", "right", "behind", "near")]
    return World(context, truth, tuple(wanted[::7]), boxes)


@st.composite
def files(draw: st.DrawFn, ranking: str | None = None) -> tuple[Case, Header, Prediction]:
    """A line of one expression: ids in any order, under one name or both, each with scores of its own."""
    w = world()
    case = draw(st.sampled_from(w.cases))
    ids = draw(st.lists(st.sampled_from(sorted(w.boxes)), min_size=2, max_size=5, unique=True))
    names = (case.target, case.reference)
    under = {name: draw(st.lists(st.sampled_from(ids), min_size=1, max_size=4, unique=True)) for name in names}
    pairs = [(a, b) for a in under[names[0]] for b in under[names[1]] if a != b]
    ranking = ranking or draw(st.sampled_from(["product", "pair_scores", "none"]))
    proposals = {
        name: tuple(
            Proposal(i, draw(SHARES), w.boxes[i], name=draw(st.sampled_from(["", "thing", name]))) for i in under[name]
        )
        for name in draw(st.permutations(names))
    }
    # Both directions, more pairs than are asked, and other relations of some of them.
    more = [(a, b) for a in ids for b in ids if a != b and {a, b} <= {*under[names[0]], *under[names[1]]}]
    told = {case.relation: [*pairs, *draw(st.lists(st.sampled_from(more), unique=True))] if more else pairs}
    for relation in OTHERS:
        if relation != case.relation and more:
            told[relation] = draw(st.lists(st.sampled_from(more), unique=True, max_size=3))
    rows: Any = {
        relation: tuple((*pair, draw(SHARES)) for pair in draw(st.permutations(list(dict.fromkeys(some)))))
        for relation, some in draw(st.permutations(list(told.items())))
    }
    boxes = {
        i: None if draw(st.booleans()) else PredictedBox((0.1 * i, 0.0, 2.0), (0.2, 0.3, 0.2))
        for i in dict.fromkeys((*under[names[0]], *under[names[1]]))
    }
    a, b = draw(st.sampled_from(pairs)) if pairs else (None, None)
    answer = None if a is None else PredictedAnswer(a, b if draw(st.booleans()) else None)
    line = Prediction(
        w.truth.frame,
        case.text,
        answer,
        None if pairs else "no pair",
        proposals=proposals,
        relations=rows,
        boxes_3d=boxes if draw(st.booleans()) else None,
    )
    if ranking == "pair_scores":
        scale = draw(st.sampled_from([1.0, 1e-11, -40.0]))
        scored = draw(st.permutations(pairs))
        line = replace(line, pairs=tuple((*p, scale * draw(SHARES)) for p in scored))
    return case, Header(ranking=ranking, same=draw(st.sampled_from(["ids", "ids", "overlap"]))), line  # type: ignore[arg-type]


def opened(header: Header, *lines: Prediction) -> ImportedPipeline:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "p.jsonl")
        path.write_text("".join(f"{as_json(x)}\n" for x in (header, *lines)))
        source = open_imported(path, "demo")
        _ = source.predictions.content_hash
        return source


def unless_one_thing(header: Header, make: Callable[[], T]) -> T | None:
    """None where by overlap the answer is no pair, which only the file's maker can mend."""
    try:
        return make()
    except InputError as error:
        if header.same == "overlap" and "one thing" in str(error):
            return None
        raise


def scores_of(line: Prediction, name: str) -> dict[int, float]:
    return {p.id: p.score for p in (line.proposals or {})[name]}


def rows_of(line: Prediction) -> Mapping[str, dict[tuple[int, int], float]]:
    return {name: {(r[0], r[1]): r[-1] for r in rows} for name, rows in (line.relations or {}).items()}


@given(files())
def test_every_number_that_is_judged_by_is_the_files(drawn: tuple[Case, Header, Prediction]) -> None:
    case, header, line = drawn
    w, own = world(), opened(header, line).asked(line.frame, line.text)
    names = (case.target, case.reference)
    answers = unless_one_thing(header, lambda: FrameAnswers(own, w.context, names, (case.relation,)))
    if answers is None:
        return
    asked = {name: scores_of(line, name) for name in (case.target, case.reference)}
    ids = [o.id for o in answers.objects]
    for name, scores in asked.items():
        found = answers.candidates[name]
        assert {ids[k]: s for k, s in zip(found.index, found.scores, strict=True)} == pytest.approx(scores, rel=1e-6)
    rows = rows_of(line)[case.relation]
    p = answers.probabilities(case.relation)
    assert p is not None
    evidence = FrameEvidence(w.truth, answers, cases=(case,))
    found = substitute(evidence, case)
    judged = found.pair_relations[0]
    for i, a in enumerate(answers.candidates[case.target].index):
        for j, b in enumerate(answers.candidates[case.reference].index):
            if ids[a] != ids[b]:
                assert p[a, b] == judged[i, j] == rows[ids[a], ids[b]]
                assert not answers.worked_out(case.relation, a, b)
    first, (query, _) = int(found.winners[0]), read_query(case, names)
    # An answer to other words than are meant stands first among the pairs of those words.
    if line.answer is None or first < 0 or query is None or not is_gold(query, case):
        return
    pair = found.plain.pair(first)
    assert ids[pair.target] == line.answer.object
    assert line.answer.reference in (None, ids[pair.reference or 0])
    told = {(a, b): s for a, b, s in line.pairs or ()}
    table = found.plain
    for at in np.flatnonzero(np.isfinite(table.flat[0])) if told else ():
        one = table.pair(int(at))
        key = ids[one.target], ids[one.reference or 0]
        # The answer is put over a tie, or over what scored more.
        assert one.log_score == pytest.approx(told[key], rel=1e-12) or at == first


@given(files())
def test_every_number_that_is_shown_is_the_files_or_marked(drawn: tuple[Case, Header, Prediction]) -> None:
    case, header, line = drawn
    w, source = world(), opened(header, line)
    trace = unless_one_thing(header, lambda: source.ask(w.context, line.text))
    if trace is None:
        return
    record: dict[str, Any] = trace_record(trace)
    ids = [p["id"] for p in record["proposals"]]
    rows = rows_of(line)
    scores = [scores_of(line, name) for name in (case.target, case.reference)]
    read = trace.query.expression
    if read is None or (read.target, read.relation, read.reference) != (case.target, case.relation, case.reference):
        return
    for pair in record["pairs"]:
        a, b = ids[pair["target"]], None if pair["reference"] is None else ids[pair["reference"]]
        assert pair["p_target"] == pytest.approx(scores[0][a], abs=1e-6)
        if b is not None:
            assert pair["p_reference"] == pytest.approx(scores[1][b], abs=1e-6)
            assert pair["p_relation"] == pytest.approx(rows[case.relation][a, b], abs=1e-6)
        assert "product" in pair["worked_out"]
        assert "p_relation" not in pair["worked_out"]
    for key, numbers in record["relations"].items():
        a, b = (ids[int(k)] for k in key.split(","))
        marked = record["relations_worked_out"][key]
        for relation, p in numbers.items():
            if relation in marked:
                assert (a, b) not in rows.get(relation, {})
            else:
                assert p == pytest.approx(rows[relation][a, b], abs=1e-6)
    given_boxes = {i for i, box in (line.boxes_3d or {}).items() if box is not None}
    for entry in record["proposals"]:
        assert entry["box_from"] == ("given" if entry["id"] in given_boxes else "worked out")
    if line.answer is not None and record["answer"] is not None:
        assert record["answer"]["target"]["id"] == line.answer.object


@given(files(), st.data())
def test_a_missing_probability_of_an_asked_pair_is_refused(
    drawn: tuple[Case, Header, Prediction], data: st.DataObject
) -> None:
    case, header, line = drawn
    rows = (line.relations or {})[case.relation]
    asked = [r for r in rows if r[0] in scores_of(line, case.target) and r[1] in scores_of(line, case.reference)]
    if not asked or not line.ranked:
        return
    gone = data.draw(st.sampled_from(asked))
    lacking = replace(line, relations={**(line.relations or {}), case.relation: tuple(r for r in rows if r != gone)})
    file = opened(header, lacking).predictions
    with pytest.raises(InputError, match=f"no probability of the pair {gone[0]}, {gone[1]}"):
        needed_rows(lacking, file, (case.target, case.relation, case.reference))


@given(files("none"), files("none"), st.booleans())
def test_which_line_tells_of_an_object_does_not_matter(
    one: tuple[Case, Header, Prediction], other: tuple[Case, Header, Prediction], turned: bool
) -> None:
    first, second = one[2], replace(other[2], text=f"{other[2].text} again", boxes_3d=None)
    known = {p.id for found in (first.proposals or {}).values() for p in found}
    # The second leaves out what the first says.
    bare = {
        name: tuple(replace(p, box=None) if p.id in known else p for p in found)
        for name, found in (second.proposals or {}).items()
    }
    lines = [first, replace(second, proposals=bare)]
    file = opened(one[1], *(lines[::-1] if turned else lines)).predictions
    for line in file.lines.values():
        for p in (p for found in (line.proposals or {}).values() for p in found):
            assert p.box == world().boxes[p.id]


SENTENCES = [
    ("potted plant closest to the desk", ("potted plant", "desk"), "closest"),
    ("book between the laptop and the bookshelf", ("book", "laptop", "bookshelf"), "between"),
    ("red book left of the laptop", ("book", "laptop"), "left"),
]


@pytest.mark.parametrize(("text", "names", "relation"), SENTENCES)
@pytest.mark.parametrize("ranking", ["product", "pair_scores", "none"])
def test_what_was_answered_to_a_sentence_stands(text: str, names: tuple[str, ...], relation: str, ranking: str) -> None:
    w = world()
    things = {n: [a.index for a in w.context.frame.annotations if a.label == n and a.index in w.boxes] for n in names}
    proposals = {n: tuple(Proposal(i, 0.8, w.boxes[i]) for i in found) for n, found in things.items()}
    rows: Any = {relation: tuple((*row, 0.5) for row in product(*things.values()))}
    pairs: Any = tuple((*row[:2], 1.0) for row in product(*list(things.values())[:2]))
    for i in things[names[0]][:3]:
        line = Prediction(
            w.truth.frame,
            text,
            PredictedAnswer(i),
            proposals=proposals,
            relations=rows,
            boxes_3d={},
            pairs=pairs if ranking == "pair_scores" else None,
        )
        trace = opened(Header(ranking=ranking), line).ask(w.context, text)  # type: ignore[arg-type]
        answer = trace_record(trace)["answer"]
        assert answer["target"]["id"] == i


def test_what_stands_twice_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "p.jsonl"
    head = as_json(Header(system="twice"))
    line = '{"frame": "000001/000000", "text": "mug left of the lamp", "answer": {"yes": true}}'
    path.write_text(f"{head}\n{line}\n{line.replace('mug', 'Mug ')}\n")
    with pytest.raises(InputError, match="line 3, text: the expression stands in the file already"):
        read_predictions(path)
    path.write_text(f'{head}\n{line[:-1]}, "answer": {{"yes": false}}}}\n')
    with pytest.raises(InputError, match="line 2: the key 'answer' stands twice"):
        read_predictions(path)
