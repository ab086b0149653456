"""Runs imported from predictions: a run of ours comes back the same, levels say what they can, bad files end."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from slow_cases import mostly_slow

from pipeline.answering import (
    Header,
    ImportedPipeline,
    PredictedAnswer,
    Prediction,
    check_places,
    open_pipeline,
    read_predictions,
    write_predictions,
)
from pipeline.answering.imported import open_imported
from pipeline.diagnosis import answer_record, ask_and_judge, open_case, save_case
from pipeline.diagnosis.asking import edited_trace
from pipeline.evaluation import EvalSpec, Run, evaluate_dataset, export_run, import_run, open_run
from pipeline.evaluation.row_stories import row_head
from pipeline.geometry import RunLength
from pipeline.labels import SourceSpec, label_dataset
from pipeline.system import InputError

ASKED = 40


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Labels of two frames of the demo, a poor detector's run on them, its export, and that imported again."""
    folder = tmp_path_factory.mktemp("imported")
    label_dataset(SourceSpec("demo"), folder / "labels", limit=2)
    found = {}
    rng = np.random.default_rng(5)
    dataset = open_pipeline("demo", srm="rule").dataset
    for frame_id in dataset.frame_ids[:2]:
        frame = dataset.load(frame_id)
        names = sorted({a.label for a in frame.annotations})
        entries = []
        for a in frame.annotations:
            wrong = rng.random() < 0.25
            assert a.mask is not None
            code = RunLength.of(a.mask)
            entries.append(
                {
                    "label": str(rng.choice(names)) if wrong else a.label,
                    "score": float(rng.uniform(0.2, 0.9)),
                    "bbox": a.bbox.astype(float).tolist(),
                    "mask": {"size": list(code.size), "counts": code.counts} if rng.random() < 0.9 else None,
                }
            )
        found[frame_id] = entries
    (folder / "found.json").write_text(json.dumps({"frames": found}))
    options = {"detector": "recorded", "model": folder / "found.json", "srm": "trained", "min_score": 0.25}
    spec = EvalSpec("demo", str(folder / "labels"), options, limit=ASKED)
    evaluate_dataset(spec, folder / "run", plots=False)
    export_run(open_run(folder / "run"), folder / "run.jsonl")
    import_run(folder / "run.jsonl", "demo", folder / "labels", folder / "again", plots=False)
    return folder


def test_a_detection_with_a_box_for_each_of_two_names_comes_back(folder: Path) -> None:
    spec = EvalSpec("demo", str(folder / "labels"), {"detector": "simulated", "srm": "rule"})
    evaluate_dataset(spec, folder / "simulated", plots=False)
    export_run(open_run(folder / "simulated"), folder / "simulated.jsonl")
    import_run(folder / "simulated.jsonl", "demo", folder / "labels", folder / "simulated again", plots=False)
    before, after = (rows(open_run(folder / name)) for name in ("simulated", "simulated again"))
    assert [r["verdict"] for r in after] == [r["verdict"] for r in before]


@pytest.fixture(scope="module")
def imported(folder: Path) -> ImportedPipeline:
    source = open_run(folder / "again").source
    assert isinstance(source, ImportedPipeline)
    return source


def rows(run: Run) -> list[dict[str, Any]]:
    return run.records.to_pylist()


def test_a_run_of_ours_comes_back_record_for_record(folder: Path) -> None:
    first, again = open_run(folder / "run"), open_run(folder / "again")
    assert len(rows(again)) == ASKED
    # What no file gives is marked, and there is no more that differs.
    assert {r["worked_out"] for r in rows(first)} == {None}
    assert {n for r in rows(again) for n in r["worked_out"] or ()} == {"log_score", "right_log_score"}
    assert [r | {"worked_out": None} for r in rows(again)] == rows(first)
    assert len(first.verdicts) >= 4
    diagnoses = [json.loads((folder / name / "diagnosis.json").read_text())["systems"] for name in ("run", "again")]
    assert next(iter(diagnoses[0].values())) == next(iter(diagnoses[1].values()))


def test_one_thing_found_by_two_names_has_a_number_for_each(folder: Path, tmp_path: Path) -> None:
    # The simulated detector gives both the id of the thing, and their classes give them different boxes.
    spec = EvalSpec("demo", str(folder / "labels"), {"detector": "simulated"}, limit=60)
    evaluate_dataset(spec, tmp_path / "run", plots=False)
    export_run(open_run(tmp_path / "run"), tmp_path / "run.jsonl")
    assert len(read_predictions(tmp_path / "run.jsonl").lines) == 60


def test_the_run_keeps_what_it_was_made_of(folder: Path) -> None:
    run = open_run(folder / "again")
    assert run.manifest["spec"]["options"] == {"predictions": "predictions.jsonl"} | {
        k: v for k, v in run.manifest["spec"]["options"].items() if k != "predictions"
    }
    assert (run.folder / "predictions.jsonl").read_bytes() == (folder / "run.jsonl").read_bytes()
    assert run.manifest["imported"]["level"] == 3
    assert "imported, level 3" in run.manifest["detector"]


def test_an_imported_run_can_be_asked_and_edited(folder: Path, imported: ImportedPipeline) -> None:
    row = next(r for r in rows(open_run(folder / "again")) if r["verdict"] not in ("CORRECT", "PARSE"))
    labels = open_run(folder / "again").labels
    (answer,) = ask_and_judge(imported, row["frame"], [row["text"]], labels)
    assert answer.verdict == row["verdict"]
    assert answer.trace is not None
    assert "imported, level 3" in answer.trace.detector
    with pytest.raises(InputError, match="has no line for this expression"):
        imported.ask(imported.prepare(row["frame"]), "a zebra left of a unicorn")
    kept = save_case(folder / "case", imported, imported.prepare(row["frame"]), row["text"])
    assert answer_record(kept) == answer_record(open_case(folder / "case").answer())


def at_level(folder: Path, level: int) -> Path:
    """The run's predictions with less in them."""
    read = read_predictions(folder / "run.jsonl")
    path = folder / f"level{level}.jsonl"
    if path.exists():
        return path
    lines = []
    for line in read.lines.values():
        if level == 0:
            box = None if line.answer is None or line.answer.object is None else line.objects[line.answer.object].box
            answer = None if box is None else PredictedAnswer(box=box)
            lines.append(Prediction(line.frame, line.text, answer, None if answer else "nothing"))
        else:
            none = None if line.answer else "nothing"
            boxes = line.boxes_3d if level > 1 else None
            lines.append(replace(line, relations=None, boxes_3d=boxes, problem=none))
    header = Header(system="less", same=read.header.same)
    write_predictions(path, header, lines)
    return path


@pytest.mark.parametrize("level", mostly_slow([2, 0, 1], fast=(0, 1)))
def test_a_level_says_what_it_can_and_no_more(folder: Path, level: int) -> None:
    import_run(at_level(folder, level), "demo", folder / "labels", folder / f"run{level}", plots=False)
    ours = {r["id"]: r for r in rows(open_run(folder / "run"))}
    theirs = rows(open_run(folder / f"run{level}"))
    (costs,) = json.loads((folder / f"run{level}" / "diagnosis.json").read_text())["systems"].values()
    assert (costs["oracles"], costs["residual"]) == (None, None), "a table of zeros says what is not known"
    known = {0: set(), 1: {"OPM-TARGET", "OPM-REF"}, 2: {"OPM-TARGET", "OPM-REF", "LIFT"}}[level]
    assert {r["verdict"] for r in theirs} <= {"CORRECT", "LABEL", "PARSE", "UNEXPLAINED"} | known
    for row in theirs:
        assert row["set_correct"] == ours[row["id"]]["set_correct"]
        full = ours[row["id"]]["verdict"]
        same = full in {"CORRECT", "LABEL"} | (known - {"LIFT"})
        assert (row["verdict"] == full) if same else row["verdict"] in {"UNEXPLAINED", "LIFT"}, (row, full)
        assert row["right_with"] is None
        assert (row_head(row)[1] == "A 3D box is off") == (row["verdict"] == "LIFT"), row["said"]
        assert ("level" in row["said"]) == (row["verdict"] == "UNEXPLAINED")


def test_relations_without_boxes_are_level_3(folder: Path, tmp_path: Path) -> None:
    def bare(lines: list[dict[str, Any]]) -> None:
        for line in lines[1:]:
            del line["boxes_3d"]
        del lines[0]["scorer"]

    source = open_imported(changed(folder, tmp_path, bare), "demo")
    assert source.predictions.level == 3


def test_rows_of_other_things_are_no_answer_that_was_passed_over(folder: Path, tmp_path: Path) -> None:
    """Without any target there is nothing to rank, also where the line tells how its references stand."""
    costs = []
    for told in (False, True):

        def blind(lines: list[dict[str, Any]], told: bool = told) -> None:
            for line in lines[1:]:
                first, second, *_ = [*line["proposals"], None]
                ids = [p["id"] for p in line["proposals"].get(second, ()) if not p.get("dropped")]
                if len(ids) < 2 or line.get("answer") is None:
                    continue
                line["proposals"][first] = []
                line["boxes_3d"] = {k: v for k, v in line["boxes_3d"].items() if int(k) in ids}
                between = [[a, b, 0.5] for a in ids for b in ids if a != b] if told else []
                line |= {"answer": None, "problem": "nothing", "relations": dict.fromkeys(line["relations"], between)}

        path = changed(folder, tmp_path, blind)
        import_run(path, "demo", folder / "labels", tmp_path / str(told), plots=False)
        run = open_run(tmp_path / str(told))
        assert any(r["right_with"] for r in rows(run) if r["verdict"] == "OPM-TARGET")
        costs.append(json.loads((run.folder / "diagnosis.json").read_text())["systems"])
    assert costs[0] == costs[1]


def test_answers_beside_the_ranking_that_the_header_names_are_told(folder: Path, tmp_path: Path) -> None:
    """Answered by the relation alone, or by the product that is named."""

    def by_relation(lines: list[dict[str, Any]]) -> None:
        del lines[0]["scorer"]
        lines[0]["same"] = "ids"
        for line in lines[1:]:
            rows = next(iter(line["relations"].values()), [])
            if line.get("answer") and rows:
                a, b, _ = min(rows, key=lambda row: row[-1])
                line["answer"] = {"object": a, "reference": b}

    told = [
        import_run(path, "demo", folder / "labels", tmp_path / path.stem, plots=False).causes
        for path in (folder / "run.jsonl", changed(folder, tmp_path, by_relation))
    ]
    assert not any("best product" in words for words in told[0])
    (words,) = (words for words in told[1] if "best product" in words)
    assert re.match(r"\d+ of \d+ answers are not .*; the first: line \d+, answer. .*pair_scores", words)


@pytest.mark.parametrize(("unit", "far"), [("pixels", 1), ("shares", 640)])
def test_points_in_another_unit_are_refused(folder: Path, tmp_path: Path, unit: Any, far: float) -> None:
    def point(k: int) -> tuple[float, float]:
        return 0.1 * far * k, 0.09 * far * k

    asked = [*read_predictions(folder / "run.jsonl").lines][:8]
    lines = [Prediction(f, t, PredictedAnswer(point=point(k))) for k, (f, t) in enumerate(asked, 1)]
    write_predictions(tmp_path / "points.jsonl", Header(box_unit=unit), lines)
    with pytest.raises(InputError, match=r"line \d, answer: 8 of 8 answers lie .*box_unit") as caught:
        import_run(tmp_path / "points.jsonl", "demo", folder / "labels", tmp_path / "run", plots=False)
    assert f'"{unit}"' in str(caught.value)


@pytest.mark.parametrize("level", mostly_slow([1, 0, 2], fast=(0, 1)))
def test_an_answer_without_its_ranking_is_shown_as_it_was_given(folder: Path, level: int) -> None:
    source = open_imported(at_level(folder, level), "demo")
    labels, seen = open_run(folder / "run").labels, set()
    known = [line for line in source.predictions.lines.values() if not line.unknown]
    for frame in dict.fromkeys(x.frame for x in known):
        lines = [x for x in known if x.frame == frame]
        context, texts = source.prepare(frame), [line.text for line in lines]
        for line, answer in zip(lines, ask_and_judge(source, frame, texts, labels), strict=True):
            if answer.trace is None:
                continue
            assert (answer.target and answer.target.id) == (line.answer and line.answer.object)
            assert "less" in answer.sentence
            assert "product" not in answer.sentence
            with pytest.raises(InputError, match="do not tell what ranked it"):
                edited_trace(source, context, line.text, {"k": 1})
            seen.add(line.text)
    assert len(seen) > 30


def changed(folder: Path, tmp_path: Path, change: Callable[[list[dict[str, Any]]], None]) -> Path:
    """The file with its lines changed as JSON."""
    lines = [json.loads(text) for text in (folder / "run.jsonl").read_text().splitlines()]
    change(lines)
    path = tmp_path / "changed.jsonl"
    path.write_text("".join(json.dumps(line) + "\n" for line in lines))
    return path


def _first(line: dict[str, Any]) -> dict[str, Any]:
    return next(found[0] for found in line["proposals"].values() if found)


def _boxes(lines: list[dict[str, Any]], change: Callable[[dict[str, Any]], None]) -> None:
    done = set()
    for line in lines[1:]:
        for i, box in line["boxes_3d"].items():
            if box is not None and (line["frame"], i, id(box)) not in done:
                change(box)


def _scaled(box: dict[str, Any]) -> None:
    box["center"], box["size"] = ([1000 * x for x in box[k]] for k in ("center", "size"))


def _opengl(box: dict[str, Any]) -> None:
    flip = np.diag([1.0, -1.0, -1.0])
    box["center"] = (flip @ box["center"]).tolist()
    box["rotation"] = (flip @ np.reshape(box["rotation"], (3, 3))).ravel().tolist()


def _in_world(pose: np.ndarray) -> Callable[[dict[str, Any]], None]:
    def change(box: dict[str, Any]) -> None:
        box["center"] = (pose[:3, :3] @ box["center"] + pose[:3, 3]).tolist()
        box["rotation"] = (pose[:3, :3] @ np.reshape(box["rotation"], (3, 3))).ravel().tolist()

    return change


def _worlds(lines: list[dict[str, Any]]) -> None:
    dataset = open_pipeline("demo", srm="rule").dataset
    for line in lines[1:]:
        pose = dataset.load(line["frame"]).camera.T_world_camera
        assert pose is not None
        _boxes([{}, line], _in_world(pose))


def _swap(box: dict[str, Any]) -> None:
    box["center"], box["size"] = box["size"], box["center"]


def _order(lines: list[dict[str, Any]]) -> None:
    for line in lines[1:]:
        for found in line["proposals"].values():
            for p in found:
                if "box" in p:
                    x0, y0, x1, y1 = p["box"]
                    p["box"] = [x0, y0, x1 - x0, y1 - y0]


@pytest.mark.parametrize(
    ("change", "wanted"),
    [
        (lambda lines: _boxes(lines, _scaled), '"length": "mm"'),
        (lambda lines: _boxes(lines, _opengl), '"coordinates": "camera_opengl"'),
        (_worlds, '"coordinates": "world"'),
        (lambda lines: _boxes(lines, _swap), "center and size swapped"),
    ],
)
def test_boxes_of_another_convention_are_refused_with_its_name(
    folder: Path, tmp_path: Path, change: Callable[[list[dict[str, Any]]], None], wanted: str
) -> None:
    path = changed(folder, tmp_path, change)
    with pytest.raises(InputError, match=r"line \d+, boxes_3d\.\d+.*: .*" + wanted):
        import_run(path, "demo", folder / "labels", tmp_path / "run", plots=False)
    assert not (tmp_path / "run").exists()
    if "swapped" in wanted:
        return
    # Declared, they are the same boxes.
    given = dict(part.split(": ") for part in wanted.split(" and "))
    declared = [json.loads(text) for text in path.read_text().splitlines()]
    declared[0] |= {k.strip('"'): v.strip('"') for k, v in given.items()}
    path.write_text("".join(json.dumps(line) + "\n" for line in declared))
    source = open_imported(path, "demo")
    check_places([(source, frame) for frame in sorted({line.frame for line in source.predictions.lines.values()})])


def test_boxes_in_another_order_are_refused(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"line \d+, (boxes|proposals\..*box)"):
        import_run(changed(folder, tmp_path, _order), "demo", folder / "labels", tmp_path / "run", plots=False)


def _set(line: int, **values: Any) -> Callable[[list[dict[str, Any]]], None]:
    return lambda lines: lines[line].update(values)


def _without_a_row(lines: list[dict[str, Any]]) -> None:
    next(rows for line in lines[1:] for rows in line["relations"].values() if rows).pop()


def _other_box(lines: list[dict[str, Any]]) -> None:
    first = _first(lines[1])
    for line in lines[2:]:
        for found in line["proposals"].values():
            for p in found:
                if p["id"] == first["id"] and line["frame"] == lines[1]["frame"]:
                    p["box"] = [1, 2, 30, 40]
                    return
    raise AssertionError("no second line of the object")


def _elsewhere(lines: list[dict[str, Any]]) -> None:
    first = lines[1]["frame"]
    for line in lines[1:]:
        line["frame"] = "nowhere/1" if line["frame"] == first else line["frame"]


def _upside_down(lines: list[dict[str, Any]]) -> None:
    del lines[2:]
    _first(lines[1])["box"] = [50, 50, 10, 10]


def _answers_nothing(lines: list[dict[str, Any]]) -> None:
    next(line for line in lines[1:] if line["answer"])["answer"]["object"] = 987654


@pytest.mark.parametrize(
    ("change", "wanted"),
    [
        (_set(0, spatialviz_predictions=2), "line 1, spatialviz_predictions: another version"),
        (_set(0, boxs="xyxy"), "line 1, boxs"),
        (_elsewhere, "line 2, frame: the dataset has no such frame"),
        (_set(2, answr=1), "line 3, answr"),
        (lambda lines: _first(lines[1]).update(score=float("nan")), r"line 2, proposals\.[^.]+\.0\.score"),
        (lambda lines: _first(lines[1]).update(score=1.2), r"line 2, proposals\.[^.]+\.0\.score"),
        (lambda lines: _first(lines[1]).update(box=[0, 0, float("inf"), 9]), r"line 2, proposals\.[^.]+\.0\.box"),
        (_upside_down, r"line 2, proposals\.[^.]+\.0\.box: no box of this header"),
        (_answers_nothing, r"line \d+, answer\.object: the id 987654"),
        (lambda lines: lines[1]["boxes_3d"].update({"987654": None}), r"line 2, boxes_3d\.987654"),
        (_set(1, relations={"left": [[0, 1, 1.5]]}), r"line 2, relations\.left\.0"),
        (_set(1, relations={"leftish": []}), r"line 2, relations\.leftish: no such relation"),
        (_other_box, r"line \d+, proposals\..*: the object \d+ .* another box than in line 2"),
        (lambda lines: lines.append(lines[1]), r"line \d+, text: the expression stands in the file already"),
        (lambda lines: lines[1].pop("text"), "line 2, text"),
        (_without_a_row, r"line \d+, relations\.\w+: no probability of the pair \d+, \d+"),
        (lambda lines: lines[1].update(text="an unheard of thing"), ""),
    ],
)
def test_bad_files_end_in_one_line(
    folder: Path, tmp_path: Path, change: Callable[[list[dict[str, Any]]], None], wanted: str
) -> None:
    path = changed(folder, tmp_path, change)
    if not wanted:
        report = import_run(path, "demo", folder / "labels", tmp_path / "run", plots=False)
        assert any("no expression of the labels" in cause for cause in report.causes)
        return
    with pytest.raises(InputError, match=wanted) as caught:
        import_run(path, "demo", folder / "labels", tmp_path / "run", plots=False)
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "run").exists()


def test_a_killed_writer_leaves_whole_lines(folder: Path, tmp_path: Path) -> None:
    text = (folder / "run.jsonl").read_text()
    path = tmp_path / "cut.jsonl"
    path.write_text(text[:-40])
    report = import_run(path, "demo", folder / "labels", tmp_path / "run", plots=False)
    assert f"line {ASKED + 1} is cut off, as a killed writer leaves it, and is not read" in report.warnings
    assert len(read_predictions(path).lines) == ASKED - 1
