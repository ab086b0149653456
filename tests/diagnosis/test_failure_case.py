"""Cases that are kept: what comes back from the folder, what counts as changed, and what a damaged folder says."""

from __future__ import annotations

import builtins
import json
import os
import shutil
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from whatif_scenes import RowDataset, ScoringDetector, context_of, row, source

from pipeline.answering import Pipeline, PreparedFrame
from pipeline.answering.ranking import RankConfig
from pipeline.datasets import MANIFEST, open_dataset
from pipeline.diagnosis import (
    Edits,
    annotated_truth,
    answer_record,
    edits_record,
    find_cases,
    open_case,
    replay_all,
    save_case,
)
from pipeline.diagnosis.cases.replay import replay_case
from pipeline.geometry import Camera, LiftConfig
from pipeline.proposals import FittedFrame, ScoreCalibration
from pipeline.relations import make_scorer
from pipeline.system import InputError

TEXT = "mug left of the laptop"


class NamedDataset(RowDataset):
    format = "row"


def made(detector: object = None, **config: Any) -> Pipeline:
    return replace(source(detector, **config), dataset=NamedDataset())  # pyright: ignore


def keep(folder: Path, detector: object = None, context: PreparedFrame | None = None, **options: Any) -> Path:
    used = made(detector)
    context = context or context_of()
    truth = annotated_truth(context, used)
    save_case(folder, used, context, options.pop("text", TEXT), truth=truth, **options)
    return folder


@pytest.fixture(scope="module")
def scored(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A case of a detector without identities; not to be changed."""
    return keep(tmp_path_factory.mktemp("cases") / "scored", ScoringDetector())


def test_a_name_that_the_dataset_lacks_is_the_reason_not_to_keep_a_case(tmp_path: Path) -> None:
    used, context = made(), context_of()
    with pytest.raises(InputError, match=r"cannot be asked.*'zebra'"):
        save_case(tmp_path / "case", used, context, "zebra left of the laptop")
    assert not list(tmp_path.iterdir())


def test_a_case_of_an_earlier_release_replays_and_another_standing_is_a_change(scored: Path, tmp_path: Path) -> None:
    folder = tmp_path / "case"
    shutil.copytree(scored, folder)
    table = json.loads((folder / MANIFEST).read_text())
    answer = table["expected"]["answer"]
    stood = answer["holds"]
    for name in ("holds", "relation_probability", "fails"):
        answer.pop(name, None)
    for pair in table["expected"]["pairs"]:
        del pair["holds"], pair["relation_probability"]
    (folder / MANIFEST).write_text(json.dumps(table))
    assert replay_case(open_case(folder)).same
    answer["holds"] = not stood
    (folder / MANIFEST).write_text(json.dumps(table))
    (change,) = replay_case(open_case(folder)).changes
    assert "there is no such pair" in change


def test_what_is_kept_twice_is_the_same_to_the_byte(tmp_path: Path) -> None:
    folders = [keep(tmp_path / name) for name in ("first", "second")]
    first, second = ({f.name: f.read_bytes() for f in folder.rglob("*") if f.is_file()} for folder in folders)
    assert first == second


def test_a_case_of_calibrated_scores_comes_back(tmp_path: Path) -> None:
    fitted = (FittedFrame("room/000001", "room", "0" * 16),)
    calibration = ScoreCalibration(None, 0.8, -0.3, 60, 70, 10, "rooms", fitted)
    used = made(ScoringDetector(), score_calibration=calibration)
    kept = save_case(tmp_path / "case", used, context_of(), TEXT)
    opened = open_case(tmp_path / "case")
    assert opened.source.config.score_calibration == calibration
    assert answer_record(opened.answer()) == answer_record(kept)


def test_a_missing_network_damages_no_case(scored: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no relation network"):
        list(replay_all([scored], srm=tmp_path / "none.onnx"))


@pytest.mark.parametrize("detector", [None, ScoringDetector()], ids=["annotations", "scoring"])
@pytest.mark.parametrize("scorer", ["rule", "trained"])
def test_the_folder_gives_the_answer_to_the_last_digit(tmp_path: Path, detector: object, scorer: str) -> None:
    used, context = made(detector, scorer=scorer), context_of()
    truth = annotated_truth(context, used)
    kept = save_case(tmp_path / "case", used, context, TEXT, truth=truth, name="ünïcode", run={"id": 7})
    again = open_case(tmp_path / "case").answer()
    assert answer_record(again) == answer_record(kept)
    assert kept.trace is not None
    assert again.trace is not None
    assert kept.diagnosis is not None
    assert again.diagnosis is not None
    np.testing.assert_array_equal(again.trace.scores.probabilities, kept.trace.scores.probabilities)
    for a, b in zip(again.trace.objects, kept.trace.objects, strict=True):
        np.testing.assert_array_equal(a.lifted.points, b.lifted.points)
        np.testing.assert_array_equal(a.mask, b.mask)
    np.testing.assert_array_equal(again.diagnosis.margins, kept.diagnosis.margins)
    replayed = replay_case(open_case(tmp_path / "case"), tolerance=0.0)
    assert replayed.same
    assert not replayed.warnings


def test_the_frame_is_a_dataset_and_comes_back_whole(tmp_path: Path) -> None:
    pose = np.eye(4)
    pose[:3, 3] = (0.1, -2.0, 1 / 3)
    frame = row()
    up = frame.camera.up
    camera = Camera(frame.camera.K, frame.width, frame.height, pose, up, "imu")
    frame = replace(frame, camera=camera, notes=("odd <b>",))
    folder = keep(tmp_path / "case", context=PreparedFrame(frame))
    dataset = open_dataset(folder)
    found = dataset.load(dataset.frame_ids[0])
    assert (dataset.format, found.id, found.notes, found.camera.up_source) == ("case", frame.id, frame.notes, "imu")
    for a, b in ((found.rgb, frame.rgb), (found.depth, frame.depth), (found.camera.up, up), (found.camera.K, camera.K)):
        np.testing.assert_array_equal(a, b)
    np.testing.assert_array_equal(found.camera.T_world_camera, pose)
    for a, b in zip(found.annotations, frame.annotations, strict=True):
        assert (a.index, a.label, a.visible, a.instance) == (b.index, b.label, b.visible, b.instance)
        np.testing.assert_array_equal(a.mask, b.mask)
        np.testing.assert_array_equal(a.bbox, b.bbox)
        assert a.box is not None
        assert b.box is not None
        np.testing.assert_array_equal(a.box.corners, b.box.corners)


@pytest.mark.parametrize(("units", "file"), [(1000.0, "depth.png"), (5000.0, "depth.png"), (None, "depth.npy")])
def test_depth_is_kept_in_its_own_units_and_exactly_where_it_has_none(
    tmp_path: Path, units: float | None, file: str
) -> None:
    frame = row()
    if units is not None:
        stored = np.round(frame.depth * units).astype(np.uint16)
        frame = replace(frame, depth=np.divide(stored, np.float32(units), dtype=np.float32, casting="same_kind"))
    folder = keep(tmp_path / "case", context=PreparedFrame(frame))
    assert (folder / file).is_file()
    np.testing.assert_array_equal(open_dataset(folder).load(frame.id).depth, frame.depth)


def test_an_up_vector_that_the_depth_gives_is_kept_with_its_source(tmp_path: Path) -> None:
    frame = row()
    context = PreparedFrame(replace(frame, camera=replace(frame.camera, up=None, up_source=None)))
    assert context.viewer.up_source == "plane"
    folder = keep(tmp_path / "case", context=context)
    assert json.loads((folder / MANIFEST).read_text())["frame"]["up_source"] == "plane"
    viewer = open_case(folder).context.viewer
    assert viewer.up_source == "plane"
    np.testing.assert_array_equal(viewer.up, context.viewer.up)


def test_an_older_case_without_an_up_vector_takes_that_of_its_answer(tmp_path: Path) -> None:
    frame = row()
    camera = frame.camera.with_up(np.array([0.2, -0.9, -0.3]), "plane")
    folder = keep(tmp_path / "case", context=PreparedFrame(replace(frame, camera=camera)))
    table = json.loads((folder / MANIFEST).read_text())
    table["frame"].update(up=None, up_source=None)
    (folder / MANIFEST).write_text(json.dumps(table))
    viewer = open_case(folder).context.viewer
    assert viewer.up_source == "plane"
    assert camera.up is not None
    np.testing.assert_allclose(viewer.up, camera.up, atol=1e-5)


def test_detections_below_k_and_suppressed_ones_are_kept(scored: Path) -> None:
    kept = json.loads((scored / "proposals.json").read_text())
    assert len(kept["asked"]["mug"]["given"]) == 6
    opened = open_case(scored)
    assert len(opened.source.needed_detector().detect(opened.context.frame, ["mug"])) == 6
    assert opened.answer().trace is not None


def test_edits_are_part_of_a_case(tmp_path: Path) -> None:
    plain = keep(tmp_path / "plain")
    edits = edits_record(Edits().with_hidden("#0").with_relation("left", "#2", "#3", 0.25))
    edited = keep(tmp_path / "edited", edits=edits)
    assert open_case(plain).expected.answer != open_case(edited).expected.answer
    assert replay_case(open_case(edited), tolerance=0.0).same
    table = json.loads((edited / MANIFEST).read_text())
    table["edits"]["scorer"] = "/etc/passwd"
    (edited / MANIFEST).write_text(json.dumps(table))
    with pytest.raises(InputError, match="name a relation network by its path"):
        replay_case(open_case(edited))


def test_another_network_changes_the_answer_and_update_takes_it(tmp_path: Path, scored: Path) -> None:
    folder = tmp_path / "case"
    shutil.copytree(scored, folder)

    class Reversed:
        """The network's word turned round."""

        name = "reversed"

        def score(self, *args: Any) -> Any:
            found = made(scorer="trained").scorer.score(*args)
            return replace(found, probabilities=1 - found.probabilities)

    changed = replay_case(open_case(folder, scorer=Reversed()))  # pyright: ignore
    assert not changed.same
    assert any(c.startswith(("target", "verdict")) for c in changed.changes)
    rule = replay_case(open_case(folder, srm="rule"))
    assert any("scored by rule" in w for w in rule.warnings)
    assert any(w.startswith("p_relation") for w in rule.warnings)
    table = json.loads((folder / MANIFEST).read_text())
    table["expected"]["answer"]["target"]["id"] = 99
    (folder / MANIFEST).write_text(json.dumps(table))
    assert [r.status for r in replay_all([folder])] == ["changed"]
    assert [r.status for r in replay_all([folder], update=True)] == ["updated"]
    assert [r.status for r in replay_all([folder])] == ["same"]


def test_small_moves_of_probabilities_are_warnings_by_tolerance(tmp_path: Path, scored: Path) -> None:
    folder = tmp_path / "case"
    shutil.copytree(scored, folder)
    table = json.loads((folder / MANIFEST).read_text())
    table["expected"]["answer"]["probability"] -= 0.01
    (folder / MANIFEST).write_text(json.dumps(table))
    strict, loose = (replay_case(open_case(folder), tolerance=t) for t in (0.005, 0.02))
    assert strict.same
    assert loose.same
    assert [w.split(":")[0] for w in strict.warnings] == ["probability"]
    assert not loose.warnings


@pytest.mark.parametrize(
    ("module", "change"),
    [
        (None, {}),
        ("OPM", {"k": 1}),
        ("LIFT", {"lift": LiftConfig(box="pca")}),
        ("PRM", {"rank": RankConfig(relation_weight=0.0)}),
    ],
)
def test_the_first_module_that_gives_something_else_is_named(
    module: str | None, change: dict[str, Any], scored: Path
) -> None:
    opened = open_case(scored)
    moved = replace(opened.source, config=replace(opened.source.config, **change))
    assert replay_case(replace(opened, source=moved)).moved == module
    scorer = make_scorer("rule")
    assert replay_case(replace(opened, source=replace(moved, scorer=scorer))).moved == (
        module if module in ("OPM", "LIFT") else "SRM"
    )
    other = deepcopy(opened.manifest.expected)
    other["expression"]["relation"] = "right"
    asked_else = replace(opened, source=moved, manifest=opened.manifest.model_copy(update={"expected": other}))
    assert replay_case(asked_else).moved == "PARSE"


def test_a_network_of_ones_own_comes_along_and_is_asked_for_where_it_did_not(tmp_path: Path) -> None:
    from pipeline.relations import make_scorer, shipped_network

    file = tmp_path / "mine.onnx"
    shutil.copyfile(shipped_network(), file)
    used, context = replace(made(), scorer=make_scorer(file)), context_of()
    case = tmp_path / "case"
    save_case(case, used, context, TEXT)
    file.unlink()
    assert replay_case(open_case(case)).same
    assert str(tmp_path) not in (case / MANIFEST).read_text()
    # A case of before may lack it.
    table = json.loads((case / MANIFEST).read_text())
    table["scorer"]["in_case"] = False
    (case / MANIFEST).write_text(json.dumps(table))
    with pytest.raises(InputError, match=r"'mine.onnx' is not in the case; expected --srm FILE"):
        open_case(case)
    given = replay_case(open_case(case, srm=shipped_network()))
    assert given.same
    assert not given.warnings


def test_a_case_that_cannot_be_asked_is_kept_with_its_verdict(tmp_path: Path) -> None:
    used, context = made(), context_of()
    plain = keep(tmp_path / "plain")
    truth, case = open_case(plain).truth, open_case(plain).case
    assert case is not None
    odd = "mug abov the laptop"
    now = save_case(tmp_path / "odd", used, context, odd, truth=truth, case=replace(case, text=odd))
    assert now.diagnosis is not None
    assert now.diagnosis.verdict == "PARSE"
    assert replay_case(open_case(tmp_path / "odd")).same


def test_nothing_is_written_where_it_fails(tmp_path: Path) -> None:
    (tmp_path / "used").mkdir()
    (tmp_path / "used" / "file").touch()
    with pytest.raises(InputError, match="not empty"):
        keep(tmp_path / "used")

    class Moody(ScoringDetector):
        calls: list[int] = []  # noqa: RUF012

        def detect(self, frame: Any, labels: Any) -> Any:
            self.calls.append(1)
            found = super().detect(frame, labels)
            return replace(found, scores=found.scores * np.float32(0.9 ** len(self.calls)))

    with pytest.raises(InputError, match="does not come back"):
        save_case(tmp_path / "moody", made(Moody()), context_of(), TEXT)
    with pytest.raises(InputError, match="cannot be written as JSON"):
        keep(tmp_path / "nan", run={"x": float("nan")})
    assert sorted(p.name for p in tmp_path.iterdir()) == ["used"]


def _cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def _set(table: dict[str, Any], keys: tuple[Any, ...], value: Any) -> None:
    for key in keys[:-1]:
        table = table[key]
    table[keys[-1]] = value


DAMAGES: dict[str, Any] = {
    "no manifest": lambda f: (f / MANIFEST).unlink(),
    "cut manifest": lambda f: _cut(f / MANIFEST),
    "manifest of zeros": lambda f: (f / MANIFEST).write_bytes(b"\0" * 100),
    "manifest a list": lambda f: (f / MANIFEST).write_text("[]"),
    "deep manifest": lambda f: (f / MANIFEST).write_text("[" * 100_000),
    "no rgb": lambda f: (f / "rgb.png").unlink(),
    "cut rgb": lambda f: _cut(f / "rgb.png"),
    "no depth": lambda f: [p.unlink() for p in f.glob("depth.*")],
    "cut proposals": lambda f: _cut(f / "proposals.json"),
    "changed proposals": lambda f: (f / "proposals.json").write_text(
        (f / "proposals.json").read_text().replace("mug", "mub")
    ),
    "link out": lambda f: ((f / "rgb.png").unlink(), os.symlink("/etc/hostname", f / "rgb.png")),
    "format": (("format",), "spatialviz-case-9"),
    "other file": (("files",), {"../../etc/passwd": "0"}),
    "depth elsewhere": (("frame", "depth"), "../depth.png"),
    "K": (("frame", "K"), [[1, 0, 0], [0, 1, 0]]),
    "negative focal": (("frame", "K", 0, 0), -5.0),
    "size": (("frame", "width"), 17),
    "pose": (("frame", "T_world_camera"), [[2, 0, 0, 0], [0, 2, 0, 0], [0, 0, 2, 0], [0, 0, 0, 1]]),
    "mask": (("frame", "annotations", 0, "mask", "counts"), "0"),
    "annotation box": (("frame", "annotations", 0, "bbox"), [0, 0, "x", 1]),
    "k": (("config", "k"), 0),
    "lift": (("config", "lift", "box"), "sphere"),
    "truth index": (("truth", "expression", "target_object"), 55),
    "truth table": (("truth", "alike"), ["1"]),
    "truth letters": (("truth", "states", "left", 0), "TTTXTT"),
    "truth relation": (("truth", "expression", "relation"), "inside-out"),
    "answer": (("expected", "answer"), {"target": 5}),
    "text": (("text",), 5),
    "edits": (("edits",), {"k": "many"}),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_case_says_so_in_one_line(tmp_path: Path, damage: str, scored: Path) -> None:
    folder = tmp_path / "case"
    shutil.copytree(scored, folder)
    how = DAMAGES[damage]
    if isinstance(how, tuple):
        table = json.loads((folder / MANIFEST).read_text())
        _set(table, *how)
        (folder / MANIFEST).write_text(json.dumps(table))
    else:
        how(folder)
    (result,) = replay_all([folder])
    assert result.status == "damaged"
    assert result.problem
    assert "\n" not in result.problem
    assert len(result.problem) < 600


def test_a_suite_goes_on_past_a_damaged_case(tmp_path: Path, scored: Path) -> None:
    for name in ("a", "b/c", ".half"):
        shutil.copytree(scored, tmp_path / name)
    (tmp_path / "a" / "rgb.png").unlink()
    found = find_cases(tmp_path)
    assert [p.relative_to(tmp_path).as_posix() for p in found] == ["a", "b/c"]
    assert [r.status for r in replay_all(found)] == ["damaged", "same"]
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="holds no saved case"):
        find_cases(tmp_path / "empty")


def test_only_files_of_the_case_are_read(scored: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    folder = tmp_path / "case"
    shutil.copytree(scored, folder)
    table = json.loads((folder / MANIFEST).read_text())
    table["scorer"] = {"kind": "rule", "name": "rule"}
    table["run"] = {"file": "/etc/passwd"}
    (folder / MANIFEST).write_text(json.dumps(table))
    read: list[Path] = []
    plain_open, plain_bytes, plain_descriptor = builtins.open, Path.read_bytes, os.open
    assets = Path(__file__).resolve().parents[2]

    def watched(file: Any, *args: Any, **kwargs: Any) -> Any:
        if isinstance(file, (str, Path)):
            read.append(Path(file).resolve())
        return plain_open(file, *args, **kwargs)

    def watched_bytes(path: Path) -> bytes:
        read.append(path.resolve())
        return plain_bytes(path)

    def watched_descriptor(file: Any, *args: Any, **kwargs: Any) -> int:
        read.append(Path(file).resolve())
        return plain_descriptor(file, *args, **kwargs)

    monkeypatch.setattr(builtins, "open", watched)
    monkeypatch.setattr(Path, "read_bytes", watched_bytes)
    monkeypatch.setattr(os, "open", watched_descriptor)
    replay_case(open_case(folder))
    inside = {p.name for p in read if p.is_relative_to(folder)}
    assert {MANIFEST, "rgb.png", "proposals.json"} <= inside
    strangers = [p for p in read if not p.is_relative_to(folder) and not p.is_relative_to(assets)]
    assert not [p for p in strangers if p.suffix not in (".py", ".pyc", ".pyi", ".so", ".json", ".txt")]
