"""Masks that other views of the same object contradict."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from damaged_labels import Tables, copied, damage

from pipeline.answering.pipeline import open_pipeline
from pipeline.corrections.review.queue import review_queue
from pipeline.datasets import Dataset, demo_path, open_dataset
from pipeline.datasets.base import ChangedFrames
from pipeline.geometry import Frame
from pipeline.geometry.masks import decode_run_length, encode_run_length
from pipeline.labels import LabelConfig, Labels, SourceSpec, check_labels, label_dataset, open_labels
from pipeline.labels.check import Finding
from pipeline.labels.check.other_masks import check_comparable
from pipeline.scenes.map_files import save_map
from pipeline.scenes.object_map import map_scene
from pipeline.scenes.views import posed_frames
from pipeline.system import InputError

FRAME, LAPTOP = "000001/000000", 2
RULE = "object/other-masks"


@pytest.fixture(scope="module")
def labels(tmp_path_factory: pytest.TempPathFactory) -> Labels:
    """One scene of three views, and a frame that no map knows."""
    pipeline, folder = open_pipeline("demo"), tmp_path_factory.mktemp("compared")
    save_map(map_scene(pipeline, "000001", posed_frames(pipeline.dataset, FRAME)), folder / "maps")
    label_dataset(SourceSpec("demo"), folder / "labels", LabelConfig(map=str(folder / "maps")), limit=4)
    return open_labels(folder / "labels")


@pytest.fixture(scope="module")
def demo() -> Dataset:
    return open_dataset(demo_path())


@pytest.fixture(scope="module")
def shifted(labels: Labels, tmp_path_factory: pytest.TempPathFactory) -> Labels:
    """The same with a mask that stands a quarter of its width beside its object."""
    root = copied(labels.root, tmp_path_factory.mktemp("shifted") / "labels")

    def shift(tables: Tables) -> None:
        (row,) = [r for r in tables["objects"] if (r["frame"], r["object"]) == (FRAME, LAPTOP)]
        size = tuple(tables["frames"][0][name] for name in ("height", "width"))
        mask = decode_run_length(size, row["mask"])
        width = int(np.ptp(np.nonzero(mask)[1])) + 1
        moved = np.roll(mask, width // 4, axis=1)
        row.update(mask=encode_run_length(moved), mask_pixels=int(moved.sum()))

    damage(root, shift)
    return open_labels(root)


def found(labels: Labels, dataset: Dataset | None) -> dict[tuple[str | None, int], Finding]:
    return {(f.frame, f.objects[0]): f for f in check_labels(labels, rules=[RULE], dataset=dataset)}


def test_a_shifted_mask_is_found_with_the_frame_that_shows_it_otherwise(
    labels: Labels, shifted: Labels, demo: Dataset
) -> None:
    clean, damaged = found(labels, demo), found(shifted, demo)
    assert len(clean) <= 1, "of 72"
    assert damaged.keys() - clean.keys() == {(FRAME, LAPTOP)}
    finding = damaged[FRAME, LAPTOP]
    assert finding.severity == "warning"
    assert finding.figures["other"] in posed_frames(demo, FRAME)[1:]
    assert str(finding.figures["other"]) in finding.message
    assert finding.figures["views"] == 2
    assert not found(shifted, None), "there is nothing to compare with without pictures"


def test_the_review_queue_begins_with_it(shifted: Labels, demo: Dataset) -> None:
    with_masks, without = (review_queue(shifted, dataset=dataset).to_pylist() for dataset in (demo, None))
    places = [
        [k for k, r in enumerate(rows) if (r["kind"], r["frame"], r["a"]) == ("object", FRAME, LAPTOP)]
        for rows in (with_masks, without)
    ]
    assert places[0] < [10]
    assert not places[1] or places[1] > places[0]
    assert any(reason.startswith(RULE) for reason in with_masks[places[0][0]]["reasons"])


class Astray(ChangedFrames):
    """Frames whose declared poses are half a metre off, each its own way."""

    def load_pose(self, frame_id: str) -> np.ndarray:
        pose = np.array(open_dataset(demo_path()).load(frame_id).camera.T_world_camera)
        pose[:3, 3] += np.random.default_rng(int(frame_id[-1])).normal(size=3)
        return pose

    def changed(self, frame: Frame) -> Frame:
        return replace(frame, camera=replace(frame.camera, T_world_camera=self.load_pose(frame.id)))


def test_the_poses_are_those_of_the_map(shifted: Labels, demo: Dataset) -> None:
    assert found(shifted, Astray(demo)).keys() == found(shifted, demo).keys()


def test_labels_say_what_a_comparison_needs(labels: Labels, demo: Dataset, tmp_path: Path) -> None:
    check_comparable(labels)

    def unnumbered(tables: Tables) -> None:
        for row in tables["objects"]:
            row["instance"] = None

    root = copied(labels.root, tmp_path / "labels")
    damage(root, unnumbered)
    assert not found(open_labels(root), demo)
    with pytest.raises(InputError, match="label --map MAP"):
        check_comparable(open_labels(root))


class Larger(ChangedFrames):
    """Pictures of another size than the labels'."""

    def changed(self, frame: Frame) -> Frame:
        size = {"width": frame.camera.width + 8, "height": frame.camera.height}
        rgb, depth = (np.pad(a, [(0, 0), (0, 8), *[(0, 0)] * (a.ndim - 2)]) for a in (frame.rgb, frame.depth))
        return replace(frame, rgb=rgb, depth=depth, annotations=(), camera=replace(frame.camera, **size))


def test_pictures_of_another_size_are_told(labels: Labels, demo: Dataset) -> None:
    with pytest.raises(InputError, match="not of the labels' size"):
        found(labels, Larger(demo))
