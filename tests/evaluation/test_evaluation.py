"""Evaluation: the same winners as `ask`, records that follow from the boxes, runs that can be compared."""

from __future__ import annotations

import csv
import io
import json
import os
import shutil
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from label_sets import write_labels
from slow_cases import mostly_slow

from pipeline.answering import AskConfig, FrameAnswers, PreparedFrame, alone, open_pipeline
from pipeline.datasets import demo_path
from pipeline.evaluation import EvalSpec, compare, evaluate_dataset, evaluate_labels, read_records, spec_record
from pipeline.evaluation.grounding_tables import make_tables, problem_warnings
from pipeline.evaluation.job import CHANGED
from pipeline.evaluation.records import COLUMNS, records_schema
from pipeline.evaluation.run import Evaluator, table_of
from pipeline.evaluation.run_folder import _read_spec
from pipeline.geometry import iou_2d
from pipeline.labels import HIT, SourceSpec, label_dataset, open_labels, read_cases
from pipeline.language import PHRASE
from pipeline.metrics import BootstrapConfig, Estimate, Row, Table, as_csv, latex, markdown
from pipeline.paper import Referring, Vlm, recorded_system
from pipeline.system import InputError

FRAMES = 4
QUICK = BootstrapConfig(resamples=200)


@pytest.fixture(scope="module")
def labels(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("eval") / "labels"
    label_dataset(SourceSpec("demo"), out, limit=FRAMES)
    return out


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What a poor detector says of the frames: boxes off by some pixels, some missing, some of a wrong class."""
    from pycocotools import mask as coco

    rng = np.random.default_rng(5)
    source = open_pipeline("demo")
    found = {}
    for frame_id in source.dataset.frame_ids[:FRAMES]:
        frame = source.dataset.load(frame_id)
        names = sorted({a.label for a in frame.annotations})
        entries = []
        for a in frame.annotations:
            assert a.mask is not None
            if rng.random() < 0.1:
                continue
            code: Any = coco.encode(np.asfortranarray(a.mask.astype(np.uint8)))
            wrong = rng.random() < 0.15
            x0, y0, x1, y1 = (a.bbox + rng.normal(0, 0.05 * (a.bbox[2] - a.bbox[0]), 4)).tolist()
            entries.append(
                {
                    "label": str(rng.choice(names)) if wrong else a.label,
                    "score": float(rng.uniform(0.2, 0.6) if wrong else rng.uniform(0.3, 0.95)),
                    "bbox": [max(min(x0, x1 - 1), 0), max(min(y0, y1 - 1), 0), min(x1, 640), min(y1, 480)],
                    "mask": {"size": list(a.mask.shape), "counts": code["counts"].decode()},
                }
            )
        found[frame_id] = entries
    path = tmp_path_factory.mktemp("recorded") / "found.json"
    path.write_text(json.dumps({"frames": found}))
    return path


def spec_of(labels: Path, recording: Path | None, **options: Any) -> EvalSpec:
    chosen: dict[str, Any] = {"srm": "rule", "config": AskConfig(k=10), **options}
    if recording is not None:
        chosen |= {"detector": "recorded", "model": recording}
    return EvalSpec("demo", str(labels), chosen)


# The simulated detector finds a thing under several names, and the trained network scores it by name.
CHOSEN = [{"srm": "trained"}, {"srm": "rule"}, {"srm": "trained", "detector": "simulated"}]


@pytest.mark.parametrize("chosen", mostly_slow(CHOSEN), ids=str)
def test_winners_are_those_of_ask(labels: Path, recording: Path, chosen: dict[str, Any]) -> None:
    evaluator = Evaluator(spec_of(labels, None if "detector" in chosen else recording, **chosen))
    asked = 0
    for truth in read_cases(evaluator.labels, 0, 2):
        context = PreparedFrame(evaluator.source.dataset.load(truth.frame))
        names = tuple(dict.fromkeys(n for c in truth.cases for n in (c.target, c.reference)))
        answers = FrameAnswers(evaluator.source, context, names)
        for case in truth.cases[:25]:
            trace = evaluator.source.ask(context, f"{case.target} {PHRASE[case.relation]} {case.reference}")
            scored = answers.score(case.target, case.relation, case.reference)
            place = -1 if scored is None else int(scored.first()[0])
            if trace.ranking is None or trace.ranking.degenerate:
                assert place < 0
                continue
            assert scored is not None
            pair, best = scored.pair(place), trace.ranking.pairs[0]
            asked += 1
            np.testing.assert_array_equal(answers.boxes[pair.target], trace.objects[best.target].bbox)
            np.testing.assert_array_equal(answers.boxes[pair.reference], trace.objects[best.reference or 0].bbox)
            assert pair.log_score == pytest.approx(best.log_score, abs=1e-9)
            assert pair.p_relation == pytest.approx(best.p_relation, abs=1e-9)
    assert asked > 20


@pytest.mark.slow
def test_the_truth_as_detector_answers_everything_rightly(labels: Path) -> None:
    (table, *_) = evaluate_labels(spec_of(labels, None))
    rows = table.to_pylist()
    assert len(rows) == open_labels(labels).expressions.num_rows
    assert all(r["parse_ok"] and r["strict_correct"] and r["pair_correct"] and r["reference_correct"] for r in rows)
    # One of several right answers need not be the labelled one.
    assert any(not r["correct"] for r in rows)
    assert all(r["ambiguous"] for r in rows if not r["correct"])
    assert all(r["label_state"] == 1 for r in rows)


def test_a_dataset_that_changes_under_the_run_is_told(labels: Path, tmp_path: Path) -> None:
    data = Path(shutil.copytree(demo_path(), tmp_path / "data"))
    depth = next((data / "000001" / "depth").iterdir())
    spec = EvalSpec(str(data), str(labels), limit=2, verdicts=False)
    still = evaluate_dataset(spec, tmp_path / "still", plots=False)
    changed = evaluate_dataset(spec, tmp_path / "changed", plots=False, progress=lambda *_: os.utime(depth, ns=(1, 1)))
    assert [CHANGED in found.warnings for found in (still, changed)] == [False, True]


def test_records_follow_from_boxes_and_labels(labels: Path, recording: Path) -> None:
    spec = spec_of(labels, recording)
    (table, *_) = evaluate_labels(spec)
    rows = table.to_pylist()
    truths = {t.frame: t for t in read_cases(open_labels(labels), 0, FRAMES)}
    assert {r["set_correct"] for r in rows} == {True, False}
    for row in rows:
        truth = truths[row["frame"]]
        case = next(c for c in truth.cases if c.id == row["id"])
        box = np.array([] if row["box"] is None else [row["box"]]).reshape(-1, 4)
        own, any_of = (iou_2d(box, truth.boxes[k]).max(initial=0) for k in ([case.target_object], case.acceptable))
        assert (row["iou"], row["set_iou"]) == pytest.approx((own, any_of), abs=1e-6)
        assert row["correct"] == (row["iou"] >= HIT)
        assert row["iou"] <= row["set_iou"] + 1e-6
        assert row["strict_iou"] <= row["set_iou"] + 1e-6
        if row["set_correct"]:
            assert row["target_rank"] is not None
        if row["pair_correct"]:
            assert row["set_correct"]
            assert row["reference_correct"]
            assert row["pair_covered"]
        if row["pair_covered"]:
            assert row["right_log_score"] <= row["log_score"] + 1e-6
            assert row["target_rank"] <= row["targets_found"]
        if row["matched_target"] is not None and row["matched_reference"] is not None:
            state = truth.states[case.relation][row["matched_target"], row["matched_reference"]]
            assert row["label_state"] == state


@pytest.mark.slow
def test_rows_do_not_depend_on_the_number_of_workers(labels: Path, recording: Path, monkeypatch: Any) -> None:
    import pyarrow as pa

    monkeypatch.setattr("pipeline.evaluation.run.FRAMES_A_BLOCK", 2)
    spec = spec_of(labels, recording)
    one = pa.concat_tables(list(evaluate_labels(spec)))
    two = pa.concat_tables(list(evaluate_labels(spec, workers=2)))
    assert one.equals(two)
    assert one.schema.equals(records_schema())


def test_a_sentence_that_cannot_be_read_is_a_wrong_answer(labels: Path) -> None:
    from dataclasses import replace

    evaluator = Evaluator(spec_of(labels, None))
    truth = next(iter(read_cases(evaluator.labels, 0, 1)))
    cases = (replace(truth.cases[0], text="left of the laptop"), replace(truth.cases[1], text="mug left of the laptop"))
    first, second = evaluator.frame(replace(truth, cases=cases))
    assert not first["parse_ok"]
    assert "the target is missing" in first["problem"]
    assert first["box"] is None
    assert first["iou"] == 0.0
    assert first["opm_iou"] > 0 or first["opm_set_iou"] > 0
    gold = (truth.cases[1].target, truth.cases[1].relation, truth.cases[1].reference)
    assert second["parse_ok"] == (gold == ("mug", "left", "laptop"))


def test_without_its_extra_a_run_has_no_plots_and_says_so(
    labels: Path, recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    report = evaluate_dataset(spec_of(labels, recording), tmp_path / "run", bootstrap=QUICK, plots=True)
    assert (tmp_path / "run" / "tables.md").exists()
    assert not (tmp_path / "run" / "plots").exists()
    assert any("spatialviz[report]" in warning for warning in report.warnings)


def test_a_run_folder_and_its_comparison(labels: Path, recording: Path, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib", reason="the extra report is not installed")
    first = evaluate_dataset(
        spec_of(labels, recording), tmp_path / "rule", bootstrap=QUICK, name="poor | odd_name & co", plots=True
    )
    second = evaluate_dataset(
        spec_of(labels, recording, config=AskConfig(k=1)),
        tmp_path / "k1",
        bootstrap=QUICK,
        others=[tmp_path / "rule"],
        against=tmp_path / "rule",
        plots=False,
    )
    names = {p.relative_to(tmp_path / "rule").as_posix() for p in (tmp_path / "rule").rglob("*") if p.is_file()}
    wanted = {"records.parquet", "run.json", "tables.md", "tables.tex", "tables/grounding.csv"}
    wanted |= {f"plots/{name}.png" for name in ("relations", "verdicts", "oracles")}
    assert names >= wanted
    assert "poor \\| odd_name & co" in (tmp_path / "rule" / "tables.md").read_text()
    assert "odd\\_name \\& co" in (tmp_path / "rule" / "tables.tex").read_text()
    lines = list(csv.DictReader(io.StringIO((tmp_path / "k1" / "tables" / "grounding.csv").read_text())))
    assert [line["row"] for line in lines][2:4] == ["poor | odd_name & co: OPM only", "poor | odd_name & co"]
    found = second.comparison
    assert found is not None
    before, after = read_records(tmp_path / "rule"), read_records(tmp_path / "k1")
    was, now = (np.array(t.column("set_correct").to_pylist()) for t in (before, after))
    assert len(found.fixed) == (~was & now).sum()
    assert len(found.broken) == (was & ~now).sum()
    assert found.differences["set_correct"].value == pytest.approx(now.mean() - was.mean())
    assert json.loads((tmp_path / "k1" / "comparison.json").read_text())["shared"] == before.num_rows
    # K = 1 leaves the relation no choice: the pipeline is then the detector alone, where it answers at all.
    answered = [r for r in after.to_pylist() if r["box"] is not None]
    assert all(r["box"] == r["opm_box"] for r in answered)
    with pytest.raises(InputError, match="not empty"):
        evaluate_dataset(spec_of(labels, recording), tmp_path / "rule", plots=False)
    assert first.expressions == before.num_rows


def test_labels_of_another_picture_are_refused(labels: Path, recording: Path, tmp_path: Path) -> None:
    other = tmp_path / "labels"
    shutil.copytree(labels, other)
    table = pq.read_table(other / "frames.parquet")
    place = table.column_names.index("rgb_hash")
    table = table.set_column(place, table.schema.field(place), [["0" * 32] * table.num_rows])
    pq.write_table(table, other / "frames.parquet")
    for system in (None, Referring()):
        spec = replace(spec_of(other, recording), system=system)
        with pytest.raises(InputError, match="another picture than the one that was labelled"):
            evaluate_dataset(spec, tmp_path / "run", workers=1, plots=False)
    assert [p.name for p in tmp_path.iterdir()] == ["labels"]


@pytest.mark.parametrize(("limit", "workers"), [(0, 1), (-3, 1), (None, 0)])
def test_counts_are_at_least_one(
    labels: Path, recording: Path, tmp_path: Path, limit: int | None, workers: int
) -> None:
    with pytest.raises(InputError, match="at least 1"):
        evaluate_dataset(replace(spec_of(labels, recording), limit=limit), tmp_path / "run", workers=workers)
    assert not (tmp_path / "run").exists()


def test_a_baseline_that_answers_nothing_says_so(labels: Path, recording: Path, tmp_path: Path) -> None:
    spec = replace(spec_of(labels, recording), system=Referring(), limit=6)
    report = evaluate_dataset(spec, tmp_path / "run", workers=1, plots=False, bootstrap=QUICK)
    assert report.causes[0].startswith("6 of 6 expressions have no answer")
    records = read_records(tmp_path / "run")
    place = records.column_names.index("problem")
    for problems, words in (([None] * 4 + ["x"] * 2, None), ([None] * 3 + ["x"] * 3, "3 of 6")):
        found = problem_warnings(records.set_column(place, records.schema.field(place), [problems]))
        assert found == () if words is None else found[0].startswith(words)


def test_a_run_of_relations_alone_is_told_from_no_run(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no evaluation run here"):
        read_records(tmp_path)
    (tmp_path / "relation_records.parquet").touch()
    with pytest.raises(InputError, match=r"has no expressions \(made with --tables relations\)"):
        read_records(tmp_path)


@pytest.mark.slow
def test_runs_on_other_labels_are_not_compared(labels: Path) -> None:
    (table, *_) = evaluate_labels(spec_of(labels, None))
    with pytest.raises(InputError, match="no expression in common"):
        compare(table, table.slice(0, 0))
    same = compare(table, table)
    assert same.fixed == same.broken == same.other_reason == ()
    assert same.differences["correct"].value == 0.0
    assert same.tests["correct"].p_value == 1.0
    with pytest.raises(InputError, match="no evaluation run"):
        read_records(labels)


def test_opm_only_takes_the_best_score(labels: Path, recording: Path) -> None:
    evaluator = Evaluator(spec_of(labels, recording))
    truth = next(iter(read_cases(evaluator.labels, 0, 1)))
    context = PreparedFrame(evaluator.source.dataset.load(truth.frame))
    names = tuple({c.target for c in truth.cases})
    answers = FrameAnswers(evaluator.source, context, names)
    seen = [answers.candidates[n] for n in names if len(answers.candidates[n].index)]
    assert len(seen) > 3
    for found in seen:
        first = alone(found)
        assert first is not None
        assert answers.objects[first].score == pytest.approx(found.scores.max())
    assert alone(answers.candidates[names[0]].__class__(np.zeros(0, np.int64), np.zeros(0))) is None


def test_tables_in_three_formats() -> None:
    cells = (Estimate(0.627, 0.599, 0.654, 100, 12), float("nan"), 7, None)
    table = Table("t", "A & B", ("Acc", "x", "n", "m"), (Row("ours", cells), Row("theirs", (0.5,) * 4, "reported")))
    text = markdown([table])
    assert "| ours | 62.7 [59.9, 65.4] | – | 7 | – |" in text
    assert "| theirs (reported) | 50.0 |" in text
    lines = list(csv.reader(io.StringIO(as_csv(table))))
    assert lines[0] == ["row", "source", "Acc", "Acc low", "Acc high", "x", "n", "m", "shares"]
    assert lines[1] == ["ours", "measured", "0.627", "0.599", "0.654", "", "7", "", ""]
    assert float(lines[2][2]) == 0.5
    tex = latex([table])
    assert "A \\& B" in tex
    assert "62.7 {\\scriptsize [59.9, 65.4]}" in tex
    assert "theirs$^\\dagger$" in tex


@pytest.mark.slow
def test_tables_of_a_run_hold_every_system(labels: Path, recording: Path) -> None:
    (poor, *_), (exact, *_) = evaluate_labels(spec_of(labels, recording)), evaluate_labels(spec_of(labels, None))
    grounding, relations, stages, *_ = make_tables({"poor": poor, "exact": exact}, QUICK)
    assert [r.name for r in grounding.rows[:4]] == ["poor: OPM only", "poor", "exact: OPM only", "exact"]
    best = grounding.rows[3].cells[2]
    assert isinstance(best, Estimate)
    assert best.value == 1.0
    assert relations.rows[-1].name == "expressions"
    assert sum(int(str(c)) for c in relations.rows[-1].cells) == poor.num_rows
    for row in stages.rows:
        values = [c for c in row.cells if isinstance(c, float)]
        assert values[1] >= values[2] >= values[3]


@pytest.mark.slow
def test_columns_are_all_filled(labels: Path) -> None:
    (table, *_) = evaluate_labels(spec_of(labels, None))
    empty = {name for name in COLUMNS if table.column(name).null_count == table.num_rows}
    # The annotations miss nothing.
    nothing_missed = {"problem", "missed_name", "missed_overlap", "missed_score", "missed_rank"}
    imported = {"worked_out", "untold"}
    assert empty - {"detail"} == nothing_missed | imported
    assert set(table.column("verdict").to_pylist()) == {"CORRECT", "LABEL"}
    assert set(table.column("detail").to_pylist()) == {None, "AMBIGUOUS"}
    assert not any(table.column("lucky").to_pylist())
    assert not any(table.column("degenerate").to_pylist())
    assert table_of([]).schema.equals(records_schema())


def test_a_vision_language_model_is_measured_by_its_boxes(labels: Path, tmp_path: Path, monkeypatch: Any) -> None:
    """A model that always points at the middle of the picture, behind a server that speaks the real protocol."""
    from chat_server import MODELS, Clock, running

    monkeypatch.setenv("SPATIALVIZ_CACHE", str(tmp_path / "cache"))
    with running(Clock()) as server:
        server.answer = lambda _: "[0.25, 0.25, 0.75, 0.75]"
        model = Vlm(server.url, MODELS[0])
        spec = EvalSpec("demo", str(labels), {"srm": "rule"}, system=model, limit=12)
        report = evaluate_dataset(spec, tmp_path / "vlm", plots=False, bootstrap=QUICK)
        asked = len(server.requests)
    rows = read_records(tmp_path / "vlm").to_pylist()
    assert report.expressions == asked == 12
    assert len({r["frame"] for r in rows}) == FRAMES
    # The picture is padded to a square above and below: a quarter of 640 pixels, and of the padded height.
    for row in rows:
        np.testing.assert_allclose(row["box"], [160, 80, 480, 400], atol=1.5)
        assert row["correct"] == (row["iou"] >= HIT)
        assert row["opm_iou"] is None
    (table, *_) = report.tables
    assert [r.name for r in table.rows] == [f"VLM {MODELS[0]}"]
    assert table.rows[0].cells[5] is None


def test_what_a_models_numbers_mean_is_decided_over_its_answers(labels: Path, tmp_path: Path, monkeypatch: Any) -> None:
    """An unknown model that writes [ymin, xmin, ymax, xmax] in thousandths of the square that it was sent."""
    from chat_server import MODELS, Clock, running

    monkeypatch.setenv("SPATIALVIZ_CACHE", str(tmp_path / "cache"))
    boxes = {c.text: t.boxes[c.target_object] for t in read_cases(open_labels(labels), 0, 2**31 - 1) for c in t.cases}

    def answer(request: Any) -> str:
        x0, y0, x1, y1 = boxes[request.prompt.partition(": ")[2]] + (0, 80, 0, 80)
        return str([round(v / 640 * 1000) for v in (y0, x0, y1, x1)])

    with running(Clock()) as server:
        server.answer = answer
        spec = EvalSpec("demo", str(labels), {"srm": "rule"}, system=Vlm(server.url, MODELS[0]), limit=40)
        report = evaluate_dataset(spec, tmp_path / "vlm", plots=False, bootstrap=QUICK)
        assert len(server.requests) == report.expressions == 40
    rows = read_records(tmp_path / "vlm").to_pylist()
    assert sum(row["iou"] > 0.9 for row in rows) > 36
    assert any("are thousandths, y first, two corners" in warning for warning in report.warnings)


def test_a_detector_is_fed_the_whole_expression(labels: Path, recording: Path) -> None:
    spec = spec_of(labels, recording)
    whole = EvalSpec(spec.dataset, spec.labels, spec.options, system=Referring(), limit=10)
    (table, *_) = evaluate_labels(whole)
    rows = table.to_pylist()
    assert len(rows) == 10
    # A recording knows class names only, and says so.
    assert all(r["box"] is None and r["problem"] for r in rows)
    with pytest.raises(InputError, match="no model is named"):
        recorded_system({"system": "vlm"})


@pytest.mark.parametrize("srm", ["rule", "trained"])
def test_scoring_only_what_is_asked_changes_nothing_of_it(srm: str) -> None:
    source = open_pipeline("demo", srm=srm)
    context = PreparedFrame(source.dataset.load(source.dataset.frame_ids[0]))
    objects = context.lift(source.needed_detector().detect(context.frame, None), source.needed_detector())
    whole, part = source.score(context, objects), source.score(context, objects, ("left", "above"))
    assert "on" not in part.relations
    for relation in ("left", "above"):
        np.testing.assert_array_equal(whole.of(relation), part.of(relation))
    np.testing.assert_array_equal(source.score(context, objects, ("left", "on")).of("on"), whole.of("on"))


def test_a_run_names_both_files_of_a_segmenter(tmp_path: Path) -> None:
    files = (tmp_path / "models/a.onnx", tmp_path / "models/b.onnx")
    spec = EvalSpec("demo", str(tmp_path / "labels"), {"segmenter": "sam", "segmenter_model": files})
    record = json.loads(json.dumps(spec_record(spec, tmp_path)))
    assert record["options"]["segmenter_model"] == ["models/a.onnx", "models/b.onnx"]
    assert _read_spec(record, tmp_path).options["segmenter_model"] == files


def test_labels_without_sentences_say_how_to_get_some(recording: Path, tmp_path: Path) -> None:
    write_labels(tmp_path / "labels", {})
    with pytest.raises(InputError, match=r"no expressions; expected some made by `label`, .*This pair is correct"):
        evaluate_dataset(spec_of(tmp_path / "labels", recording), tmp_path / "run", workers=1, plots=False)
