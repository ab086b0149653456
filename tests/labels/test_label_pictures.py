"""The dataset of labels, opened again."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dataset_writers import write_folder
from depth_graphs import write_network, write_picture

from pipeline.datasets import open_dataset
from pipeline.labels import Labels, begun_labels, default_folder, labelled_dataset, with_frames
from pipeline.system import InputError


def test_a_recording_keeps_the_camera_that_was_said_when_it_was_labelled(demo_labels: Labels, tmp_path: Path) -> None:
    write_folder(tmp_path / "moved", [1])

    def opened(options: dict[str, Any], path: str | None = str(tmp_path / "moved"), **said: Any) -> tuple[float, float]:
        manifest = demo_labels.manifest.model_copy(update={"dataset": {"path": "/absent", "options": options}})
        frame = (dataset := labelled_dataset(manifest, path, **said)).load(dataset.frame_ids[0])
        return float(frame.camera.K[0, 0]), float(frame.depth.max())

    options = {"intrinsics": "(60.0, 61.0, 31.5, 23.5)", "depth_scale": "1000.0", "segmenter": "depth"}
    focal, deepest = opened(options)
    assert focal == 60
    assert opened({**options, "intrinsics": [60.0, 61.0, 31.5, 23.5], "depth_scale": 1000}) == (focal, deepest)
    other = opened(options, intrinsics=(90.0, 90.0, 31.5, 23.5), depth_scale=500.0)
    np.testing.assert_allclose(other, (90, 2 * deepest), rtol=1e-6)
    for strange in ({"intrinsics": "1,2,3"}, {"intrinsics": 7}, {"depth_scale": "many"}):
        with pytest.raises(InputError, match="the labels name"):
            opened({**options, **strange})
    with pytest.raises(InputError):
        opened(options, None)


def test_a_recording_keeps_the_network_that_estimated_its_depth(demo_labels: Labels, tmp_path: Path) -> None:
    write_picture(tmp_path / "pictures" / "1.png")
    model = write_network(tmp_path / "network.onnx", "moge-2")
    record = {"path": str(tmp_path / "pictures"), "options": {"depth_model": str(model)}}
    dataset = labelled_dataset(demo_labels.manifest.model_copy(update={"dataset": record}))
    assert "network.onnx" in dataset.load("1").depth_source


def test_labels_of_a_single_picture_are_begun(tmp_path: Path) -> None:
    write_picture(tmp_path / "1.png")
    model = write_network(tmp_path / "network.onnx", "moge-2")
    dataset = open_dataset(tmp_path / "1.png", depth_model=str(model))
    before = with_frames(begun_labels(dataset, default_folder(dataset, tmp_path), {"depth_model": str(model)}), dataset)
    assert before.root == tmp_path / "1.png-labels"
    write_picture(tmp_path / "1.png", mm=26)
    after = with_frames(begun_labels(dataset, tmp_path / "after"), dataset)
    assert after.manifest.dataset["input_hash"] != before.manifest.dataset["input_hash"]


def test_the_demo_is_where_it_is_installed(demo_labels: Labels) -> None:
    assert set(labelled_dataset(demo_labels.manifest).frame_ids) >= set(demo_labels.frames.column("frame").to_pylist())
