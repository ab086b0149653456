"""Predictions of another pipeline become a run in Python: of records at hand, or traced as the pipeline runs."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import pipeline
from pipeline.answering import Header, read_predictions
from pipeline.datasets import demo_labels
from pipeline.evaluation import import_run

ASKED = 6


@pytest.fixture(scope="module")
def traced(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A pipeline that knows the annotations and compares centres, and takes left for right among things of a kind; its
    last expression it does not answer."""
    opened = pipeline.open("demo", srm="rule")
    rows = pipeline.open_labels(demo_labels()).expressions.to_pylist()
    frame = opened.frames[0]
    plain = {"left": -1, "right": 1}
    asked = [row for row in rows if row["frame"] == frame.id and row["relation"] in plain][:ASKED]
    with pipeline.trace(tmp_path_factory.mktemp("trace") / "run", system="centres", ranking="product") as t:
        for row in asked:
            t.expression(
                frame.id, row["text"], target=row["target"], relation=row["relation"], reference=row["reference"]
            )
            x: dict[int, float] = {}
            ends = []
            for name in (row["target"], row["reference"]):
                answer = opened.ask(0, f"the {name}")
                found = [o for o in answer.objects if o.label == name]
                ids = t.proposals(name, [o.bbox for o in found], [0.9] * len(found), masks=[o.mask for o in found])
                t.boxes({i: o.box for i, o in zip(ids, found, strict=True)})
                x |= {i: float(o.box.center[0]) for i, o in zip(ids, found, strict=True) if o.box is not None}
                ends.append(ids)
            sign = plain[row["relation"]] * (-1 if row["target"] == row["reference"] else 1)
            p = {(a, b): 0.9 if sign * (x[a] - x[b]) > 0 else 0.1 for a in ends[0] for b in ends[1] if a != b}
            t.relations({row["relation"]: p})
            if row is asked[-1]:
                t.answer(problem="out of time")
            else:
                t.answer(*max(p, key=lambda pair: p[pair]))
    return t.path


@pytest.fixture(scope="module")
def imported(traced: Path, tmp_path_factory: pytest.TempPathFactory) -> pipeline.Run:
    folder = tmp_path_factory.mktemp("runs") / "imported"
    import_run(traced, "demo", demo_labels(), folder, plots=False)
    return pipeline.open_run(folder)


def test_what_is_traced_is_imported_and_judged(imported: pipeline.Run) -> None:
    assert (imported.name, imported.records.num_rows) == ("centres", ASKED)
    assert imported.verdicts["CORRECT"] == ASKED - 2
    failure, unanswered = imported.failures()
    assert (failure.verdict, failure.row["pair_correct"]) == ("SRM", False)
    assert (unanswered.row["problem"], unanswered.row["pair_correct"]) == ("out of time", False)
    pairs = next(row["pair"] for row in imported.tables["grounding"] if row["row"] == "centres")
    assert pairs == pytest.approx((ASKED - 2) / ASKED)
    answer = failure.answer
    assert answer.verdict == "SRM"
    assert "centres (imported, level 3)" in (answer.needed_trace().detector, answer.needed_trace().scorer)


@pytest.mark.slow
def test_records_at_hand_are_the_run_of_the_file(traced: Path, imported: pipeline.Run) -> None:
    header = Header(system="centres", ranking="product")
    lines = read_predictions(traced).lines.values()
    run = pipeline.import_records((line for line in (header, *lines)), "demo", demo_labels(), plots=False)
    assert run.name == "centres"
    assert run.records.equals(imported.records)


def test_dicts_are_records_and_what_is_wrong_with_one_names_its_number(traced: Path, tmp_path: Path) -> None:
    contents = [json.loads(line) for line in traced.read_text(encoding="utf-8").splitlines()]
    contents[3]["proposals"] = {"mug": [{"id": 1, "score": 3}]}
    with pytest.raises(pipeline.InputError, match=r"^record \d+, proposals.mug[^\[]*score[^\[]*$"):
        pipeline.import_records(contents, "demo", demo_labels(), tmp_path / "a", plots=False)
    with pytest.raises(pipeline.InputError, match=r"^header, rank: .*expected one of .*ranking"):
        pipeline.import_records(contents[1:], "demo", demo_labels(), header={"rank": "product"})
    with pytest.raises(pipeline.InputError, match="there are no predictions"):
        pipeline.import_records([], "demo", demo_labels(), tmp_path / "a")
    assert not (tmp_path / "a").exists()


@pytest.mark.slow
def test_a_line_that_a_killed_writer_left_is_told(traced: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut.jsonl"
    cut.write_bytes(traced.read_bytes().rstrip()[:-3])
    told = read_predictions(cut).unread
    assert told is not None
    assert told.endswith("is cut off, as a killed writer leaves it, and is not read")
    with pytest.warns(UserWarning, match=f"^{told}$"):
        pipeline.import_records(cut, "demo", demo_labels(), tmp_path / "run", plots=False)
