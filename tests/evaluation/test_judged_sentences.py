"""Sentences with their own truth: each way to say what is right, classes of failure, files that cannot be used."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest
from rewording import reword
from slow_cases import mostly_slow

from pipeline.answering import Pipeline, open_pipeline, record_detections
from pipeline.evaluation import EvalSpec, SentenceReport, evaluate_labels, evaluate_sentences, summarise_run
from pipeline.labels import Labels, open_labels
from pipeline.language import PHRASE
from pipeline.system import InputError, pa

FRAME = "000001/000000"
LEFT_MUG = "the mug left of the laptop"
MUG, OTHER_MUG = 3, 4


@pytest.fixture(scope="module")
def source() -> Pipeline:
    return open_pipeline("demo")


def judged(source: Pipeline, path: Path, *lines: Any, **options: Any) -> SentenceReport:
    """The report of a file of these lines: objects, whose frame is FRAME where none is given, or text as it is."""
    texts = [x if isinstance(x, str) else json.dumps({"frame": FRAME, **x}) for x in lines]
    path.write_text("\n".join(texts) + "\n", encoding="utf-8")
    return evaluate_sentences(path, source, name="demo", **options)


def outcome(source: Pipeline, path: Path, sentence: str, **truth: Any) -> tuple[str, str | None, bool]:
    (one,) = judged(source, path, {"sentence": sentence, **truth}).judged
    assert one.right == (one.outcome == "CORRECT")
    assert one.read == (one.outcome != "PARSE")
    assert one.answered == (one.reason is None)
    return one.outcome, one.detail, one.answered


def test_three_ways_to_say_what_is_right(source: Pipeline, tmp_path: Path) -> None:
    boxes = {a.index: [float(v) for v in a.bbox] for a in source.prepare(FRAME).frame.annotations}
    x0, y0, x1, y1 = boxes[MUG]
    inside, wide = [(x0 + x1) / 2, (y0 + y1) / 2], x1 - x0
    right: list[dict[str, Any]] = [
        {"targets": [MUG]},
        {"targets": [OTHER_MUG, MUG]},
        {"points": [[0, 0], inside]},
        {"point": inside},
        {"boxes": [boxes[OTHER_MUG], boxes[MUG]]},
        {"boxes": [[x0, y0, x0 + 0.51 * wide, y1]]},
    ]
    wrong: list[dict[str, Any]] = [
        {"targets": [OTHER_MUG]},
        {"points": [[x1 + 1, y1 + 1]]},
        {"boxes": [boxes[OTHER_MUG]]},
        {"boxes": [[x0, y0, x0 + 0.49 * wide, y1]]},
    ]
    path = tmp_path / "s.jsonl"
    assert {outcome(source, path, LEFT_MUG, **truth) for truth in right} == {("CORRECT", None, True)}
    assert {outcome(source, path, LEFT_MUG, **truth) for truth in wrong} == {("WRONG", "OBJECT", True)}
    # A detector's boxes are not the annotations: what overlaps an acceptable one by half is right.
    other = open_pipeline("demo", detector="recorded", model=recorded(source, tmp_path))
    assert outcome(other, path, LEFT_MUG, targets=[MUG]) == ("CORRECT", None, True)
    assert outcome(other, path, LEFT_MUG, targets=[OTHER_MUG]) == ("WRONG", "OBJECT", True)


def recorded(source: Pipeline, folder: Path) -> Path:
    record_detections(source, folder / "found.json", source.dataset.class_names, frame_ids=(FRAME,))
    return folder / "found.json"


@pytest.mark.parametrize("truth", mostly_slow(["targets", "points", "boxes"]))
def test_where_nothing_is_right_a_refusal_is(source: Pipeline, tmp_path: Path, truth: str) -> None:
    path, nothing = tmp_path / "s.jsonl", {truth: []}
    assert outcome(source, path, LEFT_MUG, **nothing) == ("WRONG", "NOTHING", True)
    # Told as "no such pair; nearest is", not read, of no known name, and several that fit.
    for refused in ("the mug behind the laptop", "left of", "the zebra left of the laptop", "the book"):
        assert outcome(source, path, refused, **nothing) == ("CORRECT", None, False), refused


@pytest.mark.slow
@pytest.mark.parametrize(
    ("sentence", "failed"),
    [
        ("the zebra left of the laptop", ("PARSE", "WORDS")),
        ("book near the zebra", ("PARSE", "WORDS")),
        ("left of", ("PARSE", "GRAMMAR")),
        ("the book touching the mug", ("PARSE", "UNSUPPORTED")),
        ("the book facing the mug", ("PARSE", "UNSUPPORTED")),
        ("the book far from the mug", ("PARSE", "UNSUPPORTED")),
        ("put the mug on the table", ("PARSE", "UNSUPPORTED")),
        ("the mug left of it", ("PARSE", "UNSUPPORTED")),
        ("how many mugs are there?", ("PARSE", "UNSUPPORTED")),
        ("the book", ("REFUSED", "TIED")),
        ("the bed", ("REFUSED", "MISSING")),
    ],
)
def test_classes_of_failure(source: Pipeline, tmp_path: Path, sentence: str, failed: tuple[str, str]) -> None:
    assert outcome(source, tmp_path / "s.jsonl", sentence, targets=[MUG]) == (*failed, False)


def test_things_that_fit_equally_well_are_right_where_each_is(source: Pipeline, tmp_path: Path) -> None:
    path, mugs = tmp_path / "s.jsonl", [o.index for o in source.dataset.load(FRAME).annotations if o.label == "mug"]
    assert {MUG, OTHER_MUG} <= set(mugs)
    assert outcome(source, path, "a mug", targets=mugs) == ("CORRECT", None, True)
    for one in mugs:
        assert outcome(source, path, "a mug", targets=[one]) == ("REFUSED", "TIED", False)


def test_the_report_counts_what_the_lines_say(source: Pipeline, tmp_path: Path) -> None:
    lines = [
        {"sentence": LEFT_MUG, "targets": [MUG], "kind": "relation", "note": "other keys are let be"},
        {"sentence": "the book", "targets": [MUG], "kind": "bare", "dataset": "demo"},
        {"sentence": LEFT_MUG, "targets": [OTHER_MUG], "kind": "relation", "frame": 0},
        {"sentence": "left of", "targets": []},
        {"sentence": "elsewhere", "targets": [0], "dataset": "other", "frame": "nowhere"},
        {"sentence": "the zebra left of the mug", "targets": [MUG]},
    ]
    found = judged(source, tmp_path / "s.jsonl", *lines, out=tmp_path / "out")
    rows = [json.loads(line) for line in (tmp_path / "out" / "sentences.jsonl").read_text("utf-8").splitlines()]
    assert [r["line"] for r in rows] == [1, 2, 3, 4, 6]
    assert [r["outcome"] for r in rows] == ["CORRECT", "REFUSED", "WRONG", "CORRECT", "PARSE"]
    assert rows[0]["answer"]["object"] == MUG
    assert rows[0]["expression"]["relation"] == "left"
    assert "fit 'the book' equally well" in rows[1]["reason"]
    assert "zebra" in rows[4]["reason"]
    record = json.loads(json.dumps(found.record(), allow_nan=False))
    assert record["skipped"] == {"other": 1}
    assert list(record["kinds"]) == ["relation", "bare", "unsorted"]
    for part, own in (("all", rows), *((k, [r for r in rows if r["kind"] == k]) for k in record["kinds"])):
        shares = record["all"] if part == "all" else record["kinds"][part]
        assert shares["sentences"] == len(own)
        for name in ("read", "answered", "right"):
            share = shares[name]
            assert share["n"] == len(own)
            assert share["value"] == sum(r[name] for r in own) / len(own)
            assert share["low"] <= share["value"] <= share["high"]
    assert (record["all"]["refused_rightly"]["value"], record["all"]["refused_rightly"]["n"]) == (1, 1)
    assert record["all"]["told"]["value"] == pytest.approx(2 / 3)
    assert record["kinds"]["bare"]["refused_rightly"]["value"] is None
    assert sum(f["count"] for f in record["failures"]) == 3
    shown, failures, *_ = found.tables
    assert [row.name for row in shown.rows] == [*record["kinds"], "all"]
    assert [(row.name, row.cells[0]) for row in failures.rows] == [
        ("PARSE: WORDS", 1),
        ("REFUSED: TIED", 1),
        ("WRONG: OBJECT", 1),
    ]


def test_what_failed_is_named_by_module(source: Pipeline, tmp_path: Path) -> None:
    lines = [
        {"sentence": "the red mug", "targets": [MUG]},
        {"sentence": "the red mug", "targets": [OTHER_MUG]},
        {"sentence": "leftmost mug", "targets": [MUG]},
        {"sentence": LEFT_MUG, "targets": [MUG]},
        {"sentence": "left of", "targets": [MUG]},
        {"sentence": "the book", "targets": [MUG]},
        {"sentence": "the zebra", "targets": []},
        {"sentence": "the bed", "targets": [MUG]},
    ]
    found = judged(source, tmp_path / "s.jsonl", *lines, out=tmp_path / "out")
    assert [j.verdict for j in found.judged] == [
        "CORRECT",
        "ATTRIBUTE",
        "CORRECT",
        "CORRECT",
        "PARSE",
        None,
        None,
        "OPM-TARGET",
    ]
    rows = [json.loads(line) for line in (tmp_path / "out" / "sentences.jsonl").read_text("utf-8").splitlines()]
    assert rows[1]["verdict"]["repair"] == ["ATTRIBUTE"]
    assert rows[1]["verdict"]["said"].startswith("“red” got")
    assert "tie" in rows[5]["verdict_reason"] or "equally" in rows[5]["verdict_reason"]
    assert rows[4]["verdict"] is rows[6]["verdict"] is None
    record = json.loads(json.dumps(found.record(), allow_nan=False))
    assert record["verdicts"] == {"CORRECT": 3, "PARSE": 1, "OPM-TARGET": 1, "ATTRIBUTE": 1}
    oracles = record["oracles"]
    assert set(oracles["shapley"]) == {"RECALL", "LIFT", "SRM", "CONF", "ATTRIBUTE"}
    assert oracles["shapley_sum"] == pytest.approx(oracles["loss_explained"])
    assert oracles["single"]["ATTRIBUTE"]["value"] == pytest.approx(1 / oracles["expressions"])
    whole = sum(e["value"] for e in oracles["shapley"].values()) + oracles["value"]["none"] + oracles["residual"]
    assert whole == pytest.approx(1)
    assert [t.key for t in found.tables] == ["sentences", "failures", "verdicts", "oracles"]


def test_without_attributes_there_is_no_oracle_of_them(source: Pipeline, tmp_path: Path) -> None:
    found = judged(source, tmp_path / "s.jsonl", {"sentence": "leftmost mug", "targets": [MUG]})
    assert found.deltas is not None
    assert set(found.deltas.shapley) == {"RECALL", "LIFT", "SRM", "CONF"}


FINE = {"sentence": LEFT_MUG, "targets": [MUG]}


@pytest.mark.parametrize(
    ("line", "told"),
    [
        ("{", "expected JSON"),
        ("[1]", "object"),
        ('{"frame": 0, "sentence": "\\ud800", "targets": []}', "expected JSON"),
        ({"targets": [MUG]}, "sentence"),
        ({"sentence": " ", "targets": [MUG]}, "sentence"),
        ({"sentence": LEFT_MUG}, "one of targets, points and boxes"),
        ({**FINE, "boxes": []}, "one of targets, points and boxes"),
        ({**FINE, "targets": [-1]}, "targets.0"),
        ({**FINE, "targets": [True]}, "targets.0"),
        ({**FINE, "targets": [999]}, "no annotation"),
        ({**FINE, "frame": True}, "frame"),
        ({**FINE, "frame": "nowhere"}, "no frame 'nowhere'"),
        ({"sentence": LEFT_MUG, "points": [[1]]}, "points.0"),
        ({"sentence": LEFT_MUG, "points": [[1, float("nan")]]}, "points.0.1"),
        ({"sentence": LEFT_MUG, "boxes": [[5, 5, 1, 9]]}, "x0 < x1"),
    ],
)
def test_lines_that_cannot_be_used(source: Pipeline, tmp_path: Path, line: Any, told: str) -> None:
    with pytest.raises(InputError) as error:
        judged(source, tmp_path / "s.jsonl", FINE, "", line, out=tmp_path / "out")
    message = str(error.value)
    assert "line 3" in message
    assert "s.jsonl" in message
    assert told in message
    assert "\n" not in message
    assert not (tmp_path / "out").exists()


def test_files_that_cannot_be_used(source: Pipeline, tmp_path: Path) -> None:
    path = tmp_path / "s.jsonl"
    for lines in ([], [{**FINE, "dataset": "other"}]):
        with pytest.raises(InputError, match="no sentence of this dataset"):
            judged(source, path, *lines)
    with pytest.raises(InputError, match="cannot be read"):
        evaluate_sentences(tmp_path / "none.jsonl", source)
    judged(source, path, FINE, out=tmp_path / "out")
    with pytest.raises(InputError, match="not empty"):
        judged(source, path, FINE, out=tmp_path / "out")
    judged(source, path, FINE, FINE, out=tmp_path / "out", overwrite=True)
    assert len((tmp_path / "out" / "sentences.jsonl").read_text().splitlines()) == 2


@pytest.mark.slow
def test_a_label_that_was_not_read_as_meant_says_why(demo_labels: Labels, tmp_path: Path) -> None:
    shutil.copytree(demo_labels.root, tmp_path / "labels")
    rows = demo_labels.expressions.slice(0, 5).to_pylist()
    words = [(r["target"], PHRASE[r["relation"]], r["reference"]) for r in rows]
    other = next(phrase for phrase in ("left of", "behind") if phrase != words[3][1])
    texts = {
        f"{words[0][0]} {words[0][1]} the zebra": "WORDS",
        f"{words[1][0]} facing the {words[1][2]}": "UNSUPPORTED",
        f"{words[2][0]} {words[2][1]}": "GRAMMAR",
        f"{words[3][0]} {other} the {words[3][2]}": "GRAMMAR",
        f"zebra {words[4][1]} {words[4][2]}": "WORDS",
    }
    reword(tmp_path / "labels", {(r["frame"], r["id"]): t for r, t in zip(rows, texts, strict=True)})
    spec = EvalSpec("demo", str(open_labels(tmp_path / "labels").root), {"detector": "simulated"})
    records = pa.concat_tables(evaluate_labels(spec))
    found = {r["text"]: (r["verdict"], r["detail"]) for r in records.to_pylist() if r["text"] in texts}
    assert found == {text: ("PARSE", detail) for text, detail in texts.items()}
    summary = summarise_run(records)
    assert {k: s.count for k, s in summary.details.items() if k[0] == "PARSE"} == {
        ("PARSE", "WORDS"): 2,
        ("PARSE", "GRAMMAR"): 2,
        ("PARSE", "UNSUPPORTED"): 1,
    }
    # Runs of before have no such detail.
    before = [None if r["verdict"] == "PARSE" else r["detail"] for r in records.to_pylist()]
    at = records.schema.get_field_index("detail")
    old = summarise_run(records.set_column(at, records.schema.field(at), pa.array(before, pa.string())))
    assert old.verdicts == summary.verdicts
    assert not any(v == "PARSE" for v, _ in old.details)
