"""Masks that other views of the same object contradict."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from damaged_labels import Tables, copied, damage

from pipeline.answering.pipeline import open_pipeline
from pipeline.corrections.review.label_jobs import QueueJob, make_queue
from pipeline.corrections.review.queue import review_queue
from pipeline.datasets import Dataset, demo_path, open_dataset
from pipeline.datasets.base import ChangedFrames
from pipeline.geometry import Frame
from pipeline.geometry.masks import decode_run_length, encode_run_length
from pipeline.labels import LabelConfig, Labels, SourceSpec, check_labels, label_dataset, open_labels
from pipeline.labels.check import Finding
from pipeline.labels.check.other_masks import other_masks
from pipeline.scenes.map_files import save_map
from pipeline.scenes.object_map import map_scene
from pipeline.scenes.views import posed_frames
from pipeline.system import InputError
from pipeline.system.arrow import pa

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


def found(labels: Labels, dataset: Dataset) -> dict[tuple[str | None, int], Finding]:
    findings = check_labels(labels, rules=[RULE], masks=other_masks(labels, dataset))
    return {(f.frame, f.objects[0]): f for f in findings}


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
    assert not list(check_labels(shifted, rules=[RULE])), "there is nothing to compare with without pictures"


def place_of(queue: pa.Table, frame: str, number: int) -> int:
    """Place of an object in a queue, or its end."""
    items = zip(*(queue.column(name).to_pylist() for name in ("kind", "frame", "a")), strict=True)
    return next((k for k, item in enumerate(items) if item == ("object", frame, number)), len(queue))


def test_the_review_queue_begins_with_it(shifted: Labels, demo: Dataset) -> None:
    queue, without = review_queue(shifted, masks=other_masks(shifted, demo)), review_queue(shifted)
    place = place_of(queue, FRAME, LAPTOP)
    assert place < min(10, place_of(without, FRAME, LAPTOP))
    assert any(reason.startswith(RULE) for reason in queue.column("reasons")[place].as_py())


def test_the_queue_of_a_page_compares_masks_where_it_can(shifted: Labels) -> None:
    queue, _ = make_queue(QueueJob(shifted.root, networks=False), lambda step: None)
    assert any(reason.startswith(RULE) for reasons in queue.column("reasons").to_pylist() for reason in reasons)
    queue, _ = make_queue(QueueJob(shifted.root, dataset="/no/such", networks=False), lambda step: None)
    assert not any(reason.startswith(RULE) for reasons in queue.column("reasons").to_pylist() for reason in reasons)


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
    def unnumbered(tables: Tables) -> None:
        for row in tables["objects"]:
            row["instance"] = None

    root = copied(labels.root, tmp_path / "labels")
    damage(root, unnumbered)
    with pytest.raises(InputError, match="label --map MAP"):
        other_masks(open_labels(root), demo)
    with pytest.raises(InputError, match="dataset is needed"):
        other_masks(labels, None)


class Larger(ChangedFrames):
    """Pictures of another size than the labels'."""

    def changed(self, frame: Frame) -> Frame:
        size = {"width": frame.camera.width + 8, "height": frame.camera.height}
        rgb, depth = (np.pad(a, [(0, 0), (0, 8), *[(0, 0)] * (a.ndim - 2)]) for a in (frame.rgb, frame.depth))
        return replace(frame, rgb=rgb, depth=depth, annotations=(), camera=replace(frame.camera, **size))


def test_pictures_of_another_size_are_told(labels: Labels, demo: Dataset) -> None:
    with pytest.raises(InputError, match="not of the labels' size"):
        found(labels, Larger(demo))
