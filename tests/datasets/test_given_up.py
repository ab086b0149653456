"""Up as a person tells it: the same for every reader, and kept beside the data."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import every_format
import numpy as np
import pytest
from dataset_writers import (
    HEIGHT,
    WIDTH,
    K,
    random_rotation,
    write_folder,
    write_png,
    write_seven_scenes,
)
from hypothesis import given, settings
from hypothesis import strategies as st
from slow_cases import mostly_slow

from pipeline.answering import open_pipeline, relate_frames, relation_records
from pipeline.datasets import (
    SOURCES,
    Dataset,
    demo_path,
    open_dataset,
    parse_level_at,
    read_settings,
    survey,
    told_doubts,
    told_up,
    with_frame_up,
    write_settings,
)
from pipeline.datasets.settings import GivenUp
from pipeline.evaluation import EvalSpec, evaluate_dataset
from pipeline.labels import LabelConfig, SourceSpec, label_dataset, labelled_dataset, labelled_up, make_plan
from pipeline.system import InputError

CAMERA: dict[str, Any] = {"intrinsics": (60.0, 61.0, 31.5, 23.5), "depth_scale": 1000.0}


WRITERS = {**every_format.WRITERS, "folder without poses": lambda root: write_folder(root, [1, 2], poses=False)}
UNPOSED = ("folder without poses", "sunrgbd", "sunrgbd-votenet")


@pytest.fixture(scope="module")
def roots(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    found = {}
    for name, write in WRITERS.items():
        found[name] = tmp_path_factory.mktemp("data")
        write(found[name])
    return found


def refused(action: Callable[[], object], *words: str) -> None:
    with pytest.raises(InputError) as caught:
        action()
    assert "\n" not in str(caught.value)
    for word in words:
        assert word in str(caught.value), str(caught.value)


def opened(root: Path, **told: Any) -> Dataset:
    camera = CAMERA if (root / "rgb").is_dir() else {}
    if (root / "rgb.txt").is_file():
        camera = {"intrinsics": CAMERA["intrinsics"]}
    return open_dataset(root, **camera, **told)


@pytest.mark.parametrize("name", mostly_slow(WRITERS, fast=(0, 1, 2, 3)))
def test_what_is_told_wins_in_every_format(roots: dict[str, Path], name: str) -> None:
    root, posed = roots[name], name not in UNPOSED
    vector = np.array([0.2, -0.9, -0.3])
    vector /= np.linalg.norm(vector)
    text = ",".join(map(str, vector))
    for said, frame_of in ((text, None), (f"world:{text}", "world"), (f"camera:{text}", "camera")):
        if frame_of == "world" and not posed:
            refused(lambda said=said: opened(root, up=said), "no frame has a pose", "camera:X,Y,Z")
            continue
        dataset = opened(root, up=said)
        for frame_id in dataset.frame_ids:
            frame, own = dataset.load(frame_id), opened(root).load(frame_id)
            pose = frame.camera.T_world_camera
            assert (pose is not None) == posed
            assert frame.camera.up is not None
            assert frame.camera.up_source == "given"
            in_camera = frame_of == "camera" or pose is None
            expected = vector if in_camera or pose is None else pose[:3, :3].T @ vector
            np.testing.assert_allclose(frame.camera.up, expected, atol=1e-9)
            taken = "camera" if in_camera else "world"
            assert (frame_of is None) == any(f"is taken as {taken}:" in note for note in frame.notes)
            assert np.array_equal(frame.depth, own.depth)


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in WRITERS if name not in UNPOSED])
def test_the_settings_declare_for_every_format(tmp_path: Path, name: str) -> None:
    WRITERS[name](tmp_path)
    (tmp_path / "spatialviz.toml").write_text("world_up = [0, 3, 4]\n")
    dataset = opened(tmp_path)
    camera = dataset.load(dataset.frame_ids[0]).camera
    assert camera.T_world_camera is not None
    assert camera.up is not None
    assert camera.up_source == "declared"
    np.testing.assert_allclose(camera.T_world_camera[:3, :3] @ camera.up, [0, 0.6, 0.8], atol=1e-9)
    told = opened(tmp_path, up="world:1,0,0").load(dataset.frame_ids[0]).camera
    assert (told.up_source, np.round(told.up @ camera.up, 9)) == ("given", 0)


def test_pictures_without_annotations_have_it_too(roots: dict[str, Path]) -> None:
    dataset: Any = open_dataset(roots["bop"], up="camera:0,-1,0")
    picture = dataset.load_picture(dataset.frame_ids[0])
    assert not picture.annotations
    assert picture.camera.up.tolist() == [0, -1, 0]


def level_views(root: Path, up: np.ndarray, poses: bool = True) -> None:
    """Two views of one plane, by cameras that stand 1.5 m from it, one of them turned by 25 degrees."""
    write_folder(root, [1, 2], poses=False)
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    rays = np.stack([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], np.ones((HEIGHT, WIDTH))], axis=-1)
    c, s = np.cos(np.deg2rad(25)), np.sin(np.deg2rad(25))
    turn = np.array([[1, 0, 0], [0, c, s], [0, -s, c]])
    lines = []
    for number, R_wc in ((1, np.eye(3)), (2, turn)):
        towards = -(rays @ (R_wc.T @ up))
        z = np.where(towards > 0.1, 1.5 / np.maximum(towards, 0.1), 0)
        write_png(root / "depth" / f"{number}.png", np.where(z < 12, z * 1000, 0).astype(np.uint16))
        qx = -np.sin(np.deg2rad(12.5)) if number == 2 else 0.0
        lines.append(f"0 0 0 {qx:.9f} 0 0 {np.sqrt(1 - qx**2):.9f}")
    if poses:
        (root / "pose.txt").write_text("\n".join(lines))


def up_of(dataset: Dataset, frame_id: str) -> np.ndarray:
    found = dataset.load(frame_id).camera.up
    assert found is not None
    return found


def degrees(a: np.ndarray | None, b: np.ndarray) -> float:
    assert a is not None
    return float(np.degrees(np.arccos(np.clip(a @ b, -1, 1))))


@pytest.mark.parametrize("poses", [True, False])
def test_a_level_surface_is_carried_by_the_poses(tmp_path: Path, poses: bool) -> None:
    up = np.array([0.1, -0.6, -0.79])
    up /= np.linalg.norm(up)
    level_views(tmp_path, up, poses)
    first, second = (opened(tmp_path, level_at="1:30,30").load(i).camera for i in ("1", "2"))
    assert first.up_source == "given"
    assert degrees(first.up, up) < 0.5
    if not poses:
        assert second.up is None
        return
    assert second.T_world_camera is not None
    assert second.up_source == "given"
    assert degrees(second.T_world_camera[:3, :3] @ second.up, up) < 0.5
    known = opened(tmp_path, level_at="1:30,30")
    # The frame by its index, and the first one where none is named.
    for text in ("0:30,30", "30,30"):
        assert up_of(opened(tmp_path, level_at=text), "1").tolist() == up_of(known, "1").tolist()
    # What is said of a frame is kept for it, and wins over what is said of all.
    write_settings(tmp_path, CAMERA["intrinsics"], 1000, *told_up(known))
    assert up_of(open_dataset(tmp_path), "2").tolist() == up_of(known, "2").tolist()
    assert degrees(up_of(open_dataset(tmp_path, up="world:0,-1,0"), "2"), np.array([0, -1, 0])) > 20
    # The last one that was told counts.
    level = with_frame_up(open_dataset(tmp_path), "2", (0.0, -1.0, 0.0))
    assert up_of(level, "2").tolist() == [0, -1, 0]
    other = level.load("1").camera
    assert degrees(other.up, up) < 0.5  # its own frame keeps what was told of it


def test_an_up_that_contradicts_the_planes_of_its_frame_is_doubted_and_stands(tmp_path: Path) -> None:
    up = np.array([0.1, -0.75, -0.65])
    level_views(tmp_path, up / np.linalg.norm(up))
    known = opened(tmp_path, level_at="1:30,30")
    assert told_doubts(known) == {}
    wrong = with_frame_up(known, "1", (0.0, -0.79, 0.6))
    ((doubt,),) = told_doubts(wrong).values()
    assert "degrees off the level planes" in doubt
    assert wrong.load("1").notes == (*known.load("1").notes, doubt)
    np.testing.assert_allclose(up_of(wrong, "1"), np.array([0, -0.79, 0.6]) / np.hypot(0.79, 0.6))


@pytest.mark.parametrize(("degrees_off", "doubted"), [(0, False), (4, False), (7, True), (90, True)])
def test_an_up_that_contradicts_the_declared_one_is_noted(tmp_path: Path, degrees_off: float, doubted: bool) -> None:
    write_seven_scenes(tmp_path, 2)
    (tmp_path / "spatialviz.toml").write_text("world_up = [0, 0, 1]\n")
    assert not any("off the dataset's own" in note for note in open_dataset(tmp_path).load("frame-000000").notes)
    a = np.deg2rad(degrees_off)
    told = open_dataset(tmp_path, up=f"world:{np.sin(a)},0,{np.cos(a)}")
    notes = [note for note in told.load("frame-000000").notes if "off the dataset's own" in note]
    if doubted:
        assert notes == [f"the up that was set is {degrees_off} degrees off the dataset's own: {SOURCES['declared']}"]
        assert list(told_doubts(told).values()) == [tuple(notes)]
    else:
        assert notes == []
        assert told_doubts(told) == {}


@pytest.mark.parametrize(
    ("told", "words"),
    [
        ({"up": "0,0,0"}, ["up must be a vector"]),
        ({"up": "1e308,0,0"}, ["up must be a vector"]),
        ({"up": "0,nan,1"}, ["X,Y,Z"]),
        ({"up": "sky:0,0,1"}, ["world:X,Y,Z"]),
        ({"up": "0,1"}, ["got '0,1'"]),
        ({"level_at": "3"}, ["FRAME:U,V"]),
        ({"level_at": "-1,2"}, ["FRAME:U,V"]),
        ({"level_at": ":1,2"}, ["FRAME:U,V"]),
        ({"level_at": "9:1,2"}, ["no frame '9'"]),
        ({"level_at": "1:999,2"}, ["pixel"]),
        ({"level_at": "1:3,3", "up": "0,0,1"}, ["one of them"]),
    ],
)
def test_what_cannot_be_is_refused(tmp_path: Path, told: dict[str, str], words: list[str]) -> None:
    write_folder(tmp_path, [1])
    refused(lambda: opened(tmp_path, **told), *words)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("up = 3", ["up must be a string", "world:0,0,1"]),
        ('up = "up"', ["up must be a vector", "spatialviz.toml"]),
        ("frame_up = 3", ["frame_up must be a table"]),
        ("[frame_up]\n1 = [0, 0, 0]", ["frame_up of '1'", "point somewhere"]),
        ("[frame_up]\n7 = [0, 0, 1]", ["no frame '7'"]),
    ],
)
def test_malformed_settings_are_told(tmp_path: Path, content: str, words: list[str]) -> None:
    write_folder(tmp_path, [1])
    (tmp_path / "spatialviz.toml").write_text(content)
    refused(lambda: opened(tmp_path), *words)


def test_up_is_kept_beside_the_data(tmp_path: Path) -> None:
    write_folder(tmp_path, [1, 2])
    (tmp_path / "spatialviz.toml").write_text('name = "a"\n[generator]\nseed = 3\n')
    write_settings(tmp_path, CAMERA["intrinsics"], 1000, None, {'od"d': (0.1, 0.2, 0.3)})
    write_settings(tmp_path, None, None, None, {"2": (0.0, 0.0, 1.0)})
    kept = read_settings(tmp_path)
    assert kept.frame_up == {'od"d': (0.1, 0.2, 0.3), "2": (0.0, 0.0, 1.0)}
    assert kept.name == "a"
    # What is told of all frames takes the place of what was told of some.
    write_settings(tmp_path, None, None, *told_up(open_dataset(tmp_path, up="0,0,1")))
    assert read_settings(tmp_path).frame_up == {}
    assert read_settings(tmp_path).up == GivenUp((0, 0, 1), "world")
    assert (tmp_path / "spatialviz.toml").read_text().count("[generator]\nseed = 3") == 1


@settings(max_examples=30, deadline=None)
@given(
    vector=st.tuples(*[st.floats(-1e6, 1e6)] * 3).filter(lambda v: np.linalg.norm(v) > 1e-6),
    frame=st.sampled_from([None, "world", "camera"]),
)
def test_the_words_of_an_up_are_read_back(vector: tuple[float, float, float], frame: Any) -> None:
    assert GivenUp.parse(str(GivenUp(vector, frame))) == GivenUp(vector, frame)


def test_the_words_of_a_pixel() -> None:
    assert parse_level_at("3,4") == (None, 3, 4)
    assert parse_level_at(" a:b/1:3,4") == ("a:b/1", 3, 4)


def test_labels_are_opened_with_the_up_that_they_were_made_with() -> None:
    spec = SourceSpec(str(demo_path()), {"up": "camera:0,-1,0"})
    plan, plain = (make_plan(s, LabelConfig(), limit=1) for s in (spec, SourceSpec(str(demo_path()))))
    assert plan.models["up"] == '"camera:0,-1,0"'
    assert plan.shards[0].key != plain.shards[0].key

    said: Any = SimpleNamespace(dataset={"path": str(demo_path()), "options": spec.options})
    cases: list[tuple[dict[str, Any], list[int]]] = [({}, [0, -1, 0]), ({"up": "camera:1,0,0"}, [1, 0, 0])]
    for told, expected in cases:
        assert labelled_up(said, told)["up"] == f"camera:{','.join(map(str, expected))}"
        dataset = labelled_dataset(said, **told)
        assert up_of(dataset, dataset.frame_ids[0]).tolist() == expected


@pytest.mark.slow
def test_an_evaluation_answers_with_the_up_of_its_labels(tmp_path: Path) -> None:
    spec = SourceSpec("demo", {"up": "camera:0,-1,0"})
    label_dataset(spec, tmp_path / "labels", limit=1)
    for given_up, expected in ((None, "camera:0,-1,0"), ("camera:0,-1,0.1", "camera:0,-1,0.1")):
        asked = EvalSpec("demo", str(tmp_path / "labels"), {"srm": "rule", "up": given_up}, limit=2)
        evaluate_dataset(asked, tmp_path / "run", plots=False, overwrite=True)
        run = json.loads((tmp_path / "run" / "run.json").read_text())
        assert run["spec"]["options"]["up"] == expected


def test_relations_say_which_up_they_rest_on() -> None:
    (found,) = relate_frames(open_pipeline("demo", up="camera:0,-1,0"), 0)
    record = next(relation_records(found))
    assert (record["up"], record["up_source"]) == ([0, -1, 0], "given")


def test_a_survey_tells_which_up_is_used(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    write_folder(tmp_path, [1, 2], poses=False)
    for number in (1, 2):  # A wall straight ahead tells nothing of up.
        write_png(tmp_path / "depth" / f"{number}.png", np.full((HEIGHT, WIDTH), 1500, np.uint16))
    reports = list(survey(opened(tmp_path)))
    assert [r.up_source for r in reports] == ["assumed", "assumed"]
    assert all("--level-at" in r.notes[-1] for r in reports)
    assert reports[0].up == (0, -1, 0)
    given_up = random_rotation(rng)[0]
    told = list(survey(opened(tmp_path, up="camera:" + ",".join(map(str, given_up)))))
    assert [(r.up_source, r.notes) for r in told] == [("given", ()), ("given", ())]
