"""Labels of a scene with an object map know which object of one frame is which of another."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pipeline.answering.ask import AskConfig
from pipeline.answering.objects import all_objects
from pipeline.answering.pipeline import open_pipeline
from pipeline.corrections.sightings import Sightings
from pipeline.geometry import LiftConfig
from pipeline.labels import LabelConfig, Labels, SourceSpec, label_dataset, open_labels
from pipeline.labels.instances import open_instances
from pipeline.scenes.map_files import read_map, save_map
from pipeline.scenes.object_map import map_scene
from pipeline.scenes.views import posed_frames
from pipeline.system import InputError

FRAMES = ("000001/000000", "000001/000001", "000001/000002")


@pytest.fixture(scope="module")
def maps(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pipeline, folder = open_pipeline("demo"), tmp_path_factory.mktemp("maps")
    save_map(map_scene(pipeline, "000001", posed_frames(pipeline.dataset, FRAMES[0])), folder)
    return folder


@pytest.fixture(scope="module")
def labels(maps: Path, tmp_path_factory: pytest.TempPathFactory) -> Labels:
    out = tmp_path_factory.mktemp("labels") / "demo"
    label_dataset(SourceSpec("demo"), out, LabelConfig(map=str(maps)), limit=4)
    return open_labels(out)


def test_instances_are_the_maps_ids(maps: Path, labels: Labels) -> None:
    made = read_map(maps / "000001.npz")
    rows = labels.objects.select(["frame", "object", "instance"]).to_pylist()
    found = {(r["frame"], r["object"]): r["instance"] for r in rows}
    for frame in FRAMES:
        own = [instance for (of, _), instance in found.items() if of == frame]
        assert None not in own
        assert len(set(own)) == len(own)
    for entry in made.objects:
        assert {found[frame, number] for frame, number in entry.numbers.items()} == {entry.id}
    assert {instance for (frame, _), instance in found.items() if frame not in FRAMES} == {None}, "not in the map"


def test_an_object_is_followed_from_frame_to_frame(labels: Labels) -> None:
    sightings = Sightings(labels)
    (laptop, *_) = [
        r["object"] for r in labels.objects.to_pylist() if (r["frame"], r["label"]) == (FRAMES[0], "laptop")
    ]
    found = sightings.of(FRAMES[0], laptop)
    assert [s.frame for s in found] == list(FRAMES)
    assert {s.label for s in found} == {"laptop"}
    assert sightings.beside(FRAMES[0], laptop, 1) == found[1]
    assert sightings.beside(FRAMES[1], found[1].number, -1) == found[0]
    assert sightings.beside(FRAMES[2], found[2].number, 1) is None
    assert sightings.of("000002/000000", 0) == ()


def test_sizes_of_labels_are_of_the_boxes_that_the_views_of_a_scene_tell(maps: Path) -> None:
    pipeline = open_pipeline("demo", config=AskConfig(lift=LiftConfig(boxes="completed")))
    detector, made = pipeline.needed_detector(), read_map(maps / "000001.npz")
    prepared = pipeline.prepare(FRAMES[0])
    seen = all_objects(prepared, detector)
    instances = open_instances(str(maps), detector, pipeline.dataset)
    found = instances.completed(FRAMES[0], seen, detector.exact, prepared.viewer)
    for one, other in zip(seen, found, strict=True):
        entry = made.of_object(FRAMES[0], one.id)
        assert entry is not None
        assert other.whole is not None
        assert other.whole.views == len(entry.numbers)
        assert (other.lifted, other.held) == (one.lifted, one.held)
        if other.whole.views > 1:
            np.testing.assert_allclose(np.sort(other.size_box.size), np.sort(made.boxes[entry.id].box.size))  # type: ignore[union-attr]
    assert instances.completed("000002/000000", seen, detector.exact, prepared.viewer) == seen


def test_a_map_changes_the_plan_and_none_does_not(maps: Path) -> None:
    plain = LabelConfig()
    assert "map" not in plain.settings
    assert replace(plain, map=str(maps)).hash != plain.hash


def test_a_map_of_another_detector_is_refused(maps: Path, tmp_path: Path) -> None:
    made = read_map(maps / "000001.npz")
    save_map(replace(made, settings={**made.settings, "detector": "another"}), tmp_path / "other")
    with pytest.raises(InputError, match="another detector's objects"):
        label_dataset(SourceSpec("demo"), tmp_path / "out", LabelConfig(map=str(tmp_path / "other")), limit=1)
    with pytest.raises(InputError, match="no object maps here"):
        label_dataset(SourceSpec("demo"), tmp_path / "out", LabelConfig(map=str(tmp_path / "nothing")), limit=1)
