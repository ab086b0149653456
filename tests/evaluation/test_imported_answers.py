"""Answers that stand beside proposals and probabilities: what was answered is judged, and nothing in its place."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import product, takewhile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from benchmarks.centre_rule import CENTRES
from benchmarks.fault_figures import lines
from slow_cases import mostly_slow

from pipeline.answering import (
    Header,
    PredictedAnswer,
    PredictedBox,
    Prediction,
    Proposal,
    open_pipeline,
    write_predictions,
)
from pipeline.answering.imported import open_imported
from pipeline.answering.pair_rules import factors_of
from pipeline.datasets import demo_labels
from pipeline.diagnosis import ask_and_judge
from pipeline.evaluation import RunReport, import_published, import_run, open_run
from pipeline.geometry import RunLength
from pipeline.labels import SourceSpec, label_dataset, open_labels
from pipeline.system import InputError

Import = Callable[..., tuple[RunReport, list[str]]]


@pytest.fixture(scope="module")
def one_frame(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Labels of the demo's first frame: what is told of a file does not depend on how many frames there are."""
    out = tmp_path_factory.mktemp("one_frame") / "labels"
    label_dataset(SourceSpec("demo"), out, limit=1)
    return out


def given_lines(labels: Path) -> list[Prediction]:
    """What a pipeline without a fault gives in level 3, where it answers right."""
    dataset = open_pipeline("demo", srm="rule").dataset
    return [x.line for x in lines(CENTRES, dataset, open_labels(labels), 4, every=10, share=0.0)]


@pytest.fixture(scope="module")
def given(one_frame: Path) -> list[Prediction]:
    """That of one frame."""
    return given_lines(one_frame)


def run_of(
    folder: Path, given: list[Prediction], header: Header = CENTRES.header, *, labels: Path
) -> tuple[RunReport, list[str]]:
    """The report of an imported file, and the verdicts in the order of its lines."""
    folder.mkdir(exist_ok=True)
    write_predictions(folder / "p.jsonl", header, given)
    report = import_run(folder / "p.jsonl", "demo", labels, folder / "run", plots=False)
    return report, open_run(folder / "run").records.column("verdict").to_pylist()


@pytest.fixture(scope="module")
def imported(one_frame: Path) -> Import:
    """Imports lines of that frame."""
    return partial(run_of, labels=one_frame)


@pytest.mark.slow
def test_answers_among_the_proposals_are_mostly_right(
    imported: Import, given: list[Prediction], tmp_path: Path
) -> None:
    assert imported(tmp_path, given)[1].count("CORRECT") > 0.6 * len(given)


ANSWERS = [PredictedAnswer(point=(5.0, 5.0)), PredictedAnswer(box=(0.0, 0.0, 20.0, 20.0)), PredictedAnswer(yes=False)]


@pytest.mark.parametrize(
    ("ranking", "answer"),
    mostly_slow(product(["pair_scores", "product", "none"], ANSWERS), fast=(3, 8), several=True),
)
def test_an_answer_that_is_no_proposal_is_not_replaced_by_the_best_pair(
    imported: Import, given: list[Prediction], tmp_path: Path, answer: PredictedAnswer, ranking: str
) -> None:
    pairs = {} if ranking == "pair_scores" else {"pairs": None}
    wrong = [replace(line, answer=answer, **pairs) for line in given]  # type: ignore[arg-type]
    header = replace(CENTRES.header, ranking=ranking)  # type: ignore[arg-type]
    _, verdicts = imported(tmp_path, wrong, header)
    assert len(verdicts) == len(given)
    assert set(verdicts) <= {"UNEXPLAINED", "LIFT", "OPM-TARGET", "OPM-REF", "LABEL"}


def test_ends_that_are_swapped_are_refused_with_their_line(
    imported: Import, given: list[Prediction], tmp_path: Path
) -> None:
    line = next(x for x in given if x.answer and x.answer.reference is not None)
    assert line.answer is not None
    swapped = PredictedAnswer(object=line.answer.reference, reference=line.answer.object)
    with pytest.raises(InputError, match=r"line 2, answer: the answer is no pair"):
        imported(tmp_path, [replace(line, answer=swapped)])
    assert not (tmp_path / "run").exists()


SMALL = RunLength((4, 8), (32,))


def _shares(x: float, size: int) -> float:
    return x / size


def _half(x: float, size: int) -> float:
    return x / 2


def resized(given: list[Prediction], change: Callable[[float, int], float]) -> list[Prediction]:
    """Level 1, with all 2D boxes changed."""
    found = []
    for line in given:
        proposals = {
            name: tuple(
                replace(p, mask=None, box=tuple(change(v, s) for v, s in zip(p.box, (640, 480, 640, 480), strict=True)))  # type: ignore[arg-type]
                for p in every
            )
            for name, every in (line.proposals or {}).items()
        }
        found.append(replace(line, proposals=proposals, boxes_3d=None, relations=None, pairs=None))
    return found


def test_boxes_that_are_smaller_than_a_pixel_are_refused(
    imported: Import, given: list[Prediction], tmp_path: Path
) -> None:
    with pytest.raises(InputError, match='"box_unit": "shares"'):
        imported(tmp_path, resized(given, _shares))


def test_a_mask_of_another_size_is_told_by_its_line(imported: Import, given: list[Prediction], tmp_path: Path) -> None:
    known = given[1].proposals or {}
    proposals = {name: tuple(replace(p, mask=SMALL) for p in every) for name, every in known.items()}
    with pytest.raises(InputError, match=r"line \d+, mask of \d+: the mask has another size; got \(4, 8\)"):
        imported(tmp_path, [replace(given[1], proposals=proposals)])


def test_boxes_that_lie_on_nothing_are_told(imported: Import, given: list[Prediction], tmp_path: Path) -> None:
    told = "lies on a labelled object"
    (words,) = [words for words in imported(tmp_path, resized(given, _half))[0].causes if told in words]
    assert "are their boxes of smaller pictures? Times 2, " in words
    (tmp_path / "corner").mkdir()
    at_corner = resized(given, lambda x, size: x / 40)
    (words,) = [words for words in imported(tmp_path / "corner", at_corner)[0].causes if told in words]
    assert words.endswith("are their boxes of another size of the pictures, or in another unit?")


@pytest.mark.slow
def test_boxes_that_lie_on_something_are_not_told(imported: Import, given: list[Prediction], tmp_path: Path) -> None:
    assert not any("lies on a labelled object" in words for words in imported(tmp_path, given)[0].causes)


def test_a_row_that_stands_twice_is_refused(imported: Import, given: list[Prediction], tmp_path: Path) -> None:
    line = given[0]
    assert line.relations is not None
    ((relation, rows),) = line.relations.items()
    a, b = rows[0][:2]
    twice = replace(line, relations={relation: (*rows, (a, b, 0.5))})
    with pytest.raises(InputError, match=rf"line 2, relations\.{relation}\.{len(rows)}: {a}, {b} stands in two rows"):
        imported(tmp_path, [twice])


@pytest.mark.slow
@pytest.mark.parametrize("encoding", mostly_slow(["utf-16", "latin-1"]))
def test_a_file_in_another_encoding_is_told(
    one_frame: Path, given: list[Prediction], tmp_path: Path, encoding: str
) -> None:
    file = tmp_path / "p.jsonl"
    write_predictions(file, replace(CENTRES.header, system="Gerät"), given)
    text = file.read_text("utf-8").replace("\\u00e4", "ä")
    file.write_bytes(text.encode(encoding))
    with pytest.raises(InputError, match="saved as UTF-8"):
        import_published(file, "demo", one_frame, tmp_path / "run")
    file.write_bytes(text.encode("utf-8-sig"))
    assert import_published(file, "demo", one_frame, tmp_path / "run", plots=False).folder == tmp_path / "run"


def test_a_missing_file_is_told_as_missing(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="there are no predictions"):
        import_published(tmp_path / "no.jsonl", "demo", demo_labels(), tmp_path / "run", key=tmp_path / "key.json")


def test_a_converted_file_is_told_by_its_own_name(tmp_path: Path) -> None:
    file, key = tmp_path / "coco.json", tmp_path / "key.json"
    images = [{"id": 1, "file_name": "000001/000000", "width": 640, "height": 480}]
    key.write_text(json.dumps({"images": images, "categories": [{"id": 1, "name": "mug"}], "annotations": []}))
    boxes = [[9000.0, 10.0, 20.0, 30.0]] * 3
    file.write_text(json.dumps([{"image_id": 1, "category_id": 1, "bbox": box, "score": 0.9} for box in boxes]))
    with pytest.raises(InputError, match=r"turned into lines of ours.*coco\.json\]$"):
        import_published(file, "demo", demo_labels(), tmp_path / "run", key=key)


def ranked(line: Prediction, change: Callable[[float], float]) -> Prediction:
    """With other probabilities, the sums of the logs of the factors as scores, and the answer by these."""
    rows = {k: tuple((*r[:-1], change(r[-1])) for r in pairs) for k, pairs in (line.relations or {}).items()}
    changed = replace(line, relations=rows)
    scores = {pair: float(np.log(np.clip(f, 1e-6, 1)).sum()) for pair, f in factors_of(changed).items()}
    first = max(scores, key=scores.__getitem__)
    pairs = tuple((a, b, s) for (a, b), s in scores.items())
    return replace(changed, pairs=pairs, answer=PredictedAnswer(object=first[0], reference=first[1]))


def numbered_apart(line: Prediction, k: int) -> Prediction:
    """With ids that no other line has."""

    def of(i: int) -> int:
        return 1000 * (k + 1) + i

    assert line.proposals is not None
    return replace(
        line,
        proposals={n: tuple(replace(p, id=of(p.id)) for p in found) for n, found in line.proposals.items()},
        boxes_3d={of(i): box for i, box in (line.boxes_3d or {}).items()},
        relations={n: tuple((of(r[0]), of(r[1]), r[-1]) for r in rows) for n, rows in (line.relations or {}).items()},
        pairs=None,
        answer=None,
    )


@pytest.mark.slow
def test_a_relation_that_is_as_probable_of_every_pair_is_the_scorers_fault(
    tmp_path: Path,
) -> None:
    asked = [line for line in given_lines(demo_labels()) if len(factors_of(line)) >= 3]
    _, verdicts = run_of(tmp_path, [ranked(line, lambda p: 0.31 + 0.01 * p) for line in asked], labels=demo_labels())
    wrong = [v for v in verdicts if v not in ("CORRECT", "LABEL")]
    assert wrong.count("SRM") > 0.5 * len(wrong) > 0
    assert "LIFT" not in wrong


@pytest.mark.slow
def test_a_relation_of_a_box_that_is_off_as_no_other_is_the_boxs_fault(tmp_path: Path) -> None:
    dataset, labels = open_pipeline("demo", srm="rule").dataset, open_labels(demo_labels())
    every = (x.line for x in lines(CENTRES, dataset, labels, 4, every=10, share=0.0))
    given = list(takewhile(lambda line: line.frame == dataset.frame_ids[0], every))
    asked = [numbered_apart(line, k) for k, line in enumerate(given) if len(factors_of(line)) >= 2]
    broken = [ranked(line, (lambda p: 1 - p) if k % 4 == 0 else float) for k, line in enumerate(asked)]

    def moved(line: Prediction) -> Prediction:
        def farther(box: PredictedBox | None) -> PredictedBox:
            assert box is not None
            assert box.center is not None
            x, y, z = box.center
            return replace(box, center=(x, y, z + 1.5))

        return replace(line, boxes_3d={i: farther(box) for i, box in (line.boxes_3d or {}).items()})

    _, as_usual = run_of(tmp_path / "usual", broken, labels=demo_labels())
    apart = [moved(line) if k % 4 == 0 else line for k, line in enumerate(broken)]
    _, off = run_of(tmp_path / "off", apart, labels=demo_labels())
    scorers = [k for k, v in enumerate(as_usual) if v == "SRM" and k % 4 == 0]
    assert len(scorers) >= 2
    assert all(off[k] == "LIFT" for k in scorers)
    # What another line's boxes are changes nothing where they are as they were.
    assert all(off[k] == v for k, v in enumerate(as_usual) if k % 4)


def of_three(
    path: Path, text: str, names: tuple[str, ...], relation: str, p: Callable[[tuple[int, ...]], float]
) -> Path:
    """A file of one sentence, of the annotated things of its names, with a row for each choice of them."""
    frame = open_pipeline("demo", srm="rule").dataset.load("000001/000000")
    things = {name: [a for a in frame.annotations if a.label == name] for name in names}
    proposals = {
        name: tuple(
            Proposal(a.index, 0.8, box=tuple(a.bbox.tolist()), mask=None if a.mask is None else RunLength.of(a.mask))
            for a in found
        )
        for name, found in things.items()
    }
    rows: Any = tuple((*row, p(row)) for row in product(*([a.index for a in found] for found in things.values())))
    line = Prediction(frame.id, text, proposals=proposals, relations={relation: rows})
    write_predictions(path, Header(ranking="product", exact=True), [line])
    return path


@pytest.mark.parametrize(
    ("text", "names", "relation"),
    [
        ("potted plant closest to the desk", ("potted plant", "desk"), "closest"),
        ("potted plant farthest from the desk", ("potted plant", "desk"), "farthest"),
        ("book between the laptop and the bookshelf", ("book", "laptop", "bookshelf"), "between"),
    ],
)
def test_what_is_given_of_three_things_is_not_worked_out(tmp_path: Path, text: str, names: Any, relation: str) -> None:
    frame = "000001/000000"
    (ours,) = ask_and_judge(open_pipeline("demo", srm="rule"), frame, [text])
    assert ours.trace is not None
    assert ours.trace.ranking is not None
    best, worst = (ours.trace.objects[ours.trace.ranking.pairs[k].target].id for k in (0, -1))
    assert best != worst
    for wanted in (best, worst):
        path = tmp_path / f"{wanted}.jsonl"
        of_three(path, text, names, relation, lambda row, wanted=wanted: 0.9 if row[0] == wanted else 0.1)
        (theirs,) = ask_and_judge(open_imported(path, "demo"), frame, [text])
        assert theirs.trace is not None
        assert theirs.trace.ranking is not None
        first = theirs.trace.ranking.pairs[0]
        assert (theirs.trace.objects[first.target].id, first.p_relation) == (wanted, pytest.approx(0.9))
        # What "between" is true of is not worked out from annotations.
        truly = None if relation == "between" else "CORRECT" if wanted == best else "SRM"
        assert theirs.verdict == truly
