"""Answers of another pipeline as regression cases: kept with what it gave, run again, and answered by a later version.

The pipeline is that of `benchmarks/centre_rule.py`: it ranks by scores of its own, and one module of it is broken.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from benchmarks.centre_rule import CENTRES
from benchmarks.fault_figures import Line, lines
from slow_cases import mostly_slow

from pipeline.answering import ImportedPipeline, Prediction, open_pipeline, read_predictions, write_predictions
from pipeline.answering.imported import open_imported
from pipeline.datasets import MANIFEST, demo_labels
from pipeline.diagnosis import ReplayResult, frame_truth, open_case, replay_all, save_case
from pipeline.diagnosis.cases.manifest import PREDICTIONS
from pipeline.labels import Labels, open_labels
from pipeline.system import InputError

FRAMES, EVERY = 2, 6
RIGHT = ("CORRECT", "LABEL")
"""The answer is right, or as right as the label."""


@pytest.fixture(scope="module")
def labels() -> Labels:
    return open_labels(demo_labels())


@pytest.fixture(scope="module")
def asked(labels: Labels) -> list[tuple[Line, Line]]:
    """Lines of a few frames as the pipeline gives them with one module broken, and those of a version without."""
    dataset = open_pipeline("demo", srm="rule").dataset
    broken, whole = (list(_of_frames(lines(CENTRES, dataset, labels, 4, every=10, share=s))) for s in (0.7, 0.0))
    clean = {(x.line.frame, x.line.text): x for x in whole}
    return [(x, clean[x.line.frame, x.line.text]) for x in broken]


def _of_frames(found: Iterator[Line]) -> Iterator[Line]:
    """Those of the first frames; what comes after them is not asked for."""
    frames: set[str] = set()
    for line in found:
        frames.add(line.line.frame)
        if len(frames) > FRAMES:
            return
        yield line


def written(path: Path, found: list[Prediction]) -> Path:
    write_predictions(path, CENTRES.header, found)
    return path


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory, labels: Labels, asked: list[tuple[Line, Line]]) -> Path:
    """A case of every few lines, by the verdict that the whole file gives."""
    folder = tmp_path_factory.mktemp("cases")
    source = open_imported(written(folder / "first.jsonl", [x.line for x, _ in asked]), "demo")
    for k, (x, _) in enumerate(asked[::EVERY]):
        context = source.prepare(x.line.frame)
        save_case(
            folder / "cases" / f"{k:03d}", source, context, x.line.text, truth=frame_truth(source, context, labels)
        )
    return folder


def replayed(folder: Path, predictions: Path | None = None) -> Iterator[ReplayResult]:
    read = None if predictions is None else read_predictions(predictions)
    return replay_all(sorted((folder / "cases").iterdir()), predictions=read)


def test_a_case_holds_what_its_verdict_was_found_by(kept: Path, asked: list[tuple[Line, Line]]) -> None:
    results = list(replayed(kept))
    assert {r.status for r in results} == {"same"}
    assert all(r.replay is not None and not r.replay.warnings for r in results)
    verdicts = {r.replay.after.judgement.verdict for r in results if r.replay and r.replay.after.judgement}
    assert len(verdicts - {"CORRECT", "LABEL"}) >= 3
    case = json.loads((kept / "cases" / "000" / MANIFEST).read_text())
    assert case["scorer"]["kind"] == "imported"
    assert case["shown"]["level"] == 3
    # One frame of the file, and no more.
    inside = [json.loads(line) for line in (kept / "cases" / "000" / PREDICTIONS).read_text().splitlines()[1:]]
    assert {line["frame"] for line in inside} == {case["frame"]["id"]}
    assert isinstance(open_case(kept / "cases" / "000").source, ImportedPipeline)


@pytest.mark.slow
def test_a_later_version_is_judged_by_the_same_cases(kept: Path, asked: list[tuple[Line, Line]]) -> None:
    later = written(kept / "later.jsonl", [y.line for _, y in asked])
    faults = [x.fault for x, _ in asked[::EVERY]]
    for fault, result in zip(faults, replayed(kept, predictions=later), strict=True):
        assert result.replay is not None
        before, after = result.replay.before.judgement, result.replay.after.judgement
        assert before is not None
        assert after is not None
        if fault is not None:
            assert result.status == "changed"
            assert f"verdict: {before.verdict} -> {after.verdict}" in result.replay.changes
            assert before.verdict not in RIGHT
            assert after.verdict in RIGHT


@pytest.mark.slow
def test_a_file_that_lacks_a_case_is_told(kept: Path, asked: list[tuple[Line, Line]]) -> None:
    others = written(kept / "others.jsonl", [replace(asked[0][0].line, text="cup left of cup")])
    results = list(replayed(kept, predictions=others))
    assert all(r.replay and "has no line for this expression" in r.replay.changes[0] for r in results)
    with pytest.raises(InputError, match="line 1: not JSON"):
        list(replayed(kept, predictions=kept / "cases" / "000" / MANIFEST))


WRONG = [{"length": "mm"}, {"coordinates": "camera_opengl"}, {"boxes": "xywh"}]


@pytest.mark.slow
@pytest.mark.parametrize("wrong", mostly_slow(WRONG))
def test_a_later_file_in_other_coordinates_is_refused(
    kept: Path, asked: list[tuple[Line, Line]], wrong: dict[str, str], tmp_path: Path
) -> None:
    file = tmp_path / "wrong.jsonl"
    write_predictions(file, replace(CENTRES.header, **wrong), [y.line for _, y in asked])  # type: ignore[arg-type]
    with pytest.raises(InputError, match=next(iter(wrong.values()))):
        list(replayed(kept, predictions=file))


def test_what_cannot_be_run_again_is_told(kept: Path) -> None:
    opened = open_case(kept / "cases" / "000")
    with pytest.raises(InputError, match="--predictions FILE"):
        opened.with_detector("live", None)


@pytest.mark.parametrize("damage", ["shown", "scorer", "file", "level"])
def test_a_damaged_case_is_told(kept: Path, tmp_path: Path, damage: str) -> None:
    root = tmp_path / "case"
    root.mkdir()
    for file in (kept / "cases" / "000").iterdir():
        (root / file.name).write_bytes(file.read_bytes())
    table = json.loads((root / MANIFEST).read_text())
    if damage == "shown":
        del table["shown"]
    elif damage == "scorer":
        table["shown"]["ranking"] = {"weights": ["x"], "unit": 1}
    elif damage == "level":
        table["shown"]["level"] = "three"
    else:
        (root / PREDICTIONS).write_text("{}\n")
    (root / MANIFEST).write_text(json.dumps(table))
    with pytest.raises(InputError, match=r"case|damaged|changed"):
        open_case(root).answer()
