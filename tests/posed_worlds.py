"""Posed recordings for tests of scenes: the demo with planted faults, and boxes that are moved between frames."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from scenes import camera_of, frame_of, upright

from pipeline.answering import Pipeline, open_pipeline
from pipeline.datasets import Dataset, InMemoryDataset, demo_path, open_dataset
from pipeline.datasets.base import ChangedFrames, load_pose
from pipeline.geometry import Annotation, Frame

SCENE = ("000001/000000", "000001/000001", "000001/000002")


class Planted(ChangedFrames):
    """A dataset with the poses of some frames moved, in their cameras' axes, and annotations changed."""

    def __init__(
        self,
        inner: Dataset,
        moved: Mapping[str, tuple[float, float, float]] | None = None,
        annotated: Callable[[str, Annotation], Annotation | None] = lambda frame_id, a: a,
    ) -> None:
        super().__init__(inner)
        self.moved, self.annotated, self.loaded = moved or {}, annotated, list[str]()

    def load_pose(self, frame_id: str) -> np.ndarray:
        pose = np.array(load_pose(self.inner, frame_id))
        pose[:3, 3] += pose[:3, :3] @ np.array(self.moved.get(frame_id, (0.0, 0.0, 0.0)))
        return pose

    def load(self, frame_id: str) -> Frame:
        self.loaded.append(frame_id)
        return super().load(frame_id)

    def changed(self, frame: Frame) -> Frame:
        found = (self.annotated(frame.id, a) for a in frame.annotations)
        camera = replace(frame.camera, T_world_camera=self.load_pose(frame.id))
        return replace(frame, camera=camera, annotations=tuple(a for a in found if a is not None))


def demo(**planted: object) -> Pipeline:
    """The demo's pipeline, with faults."""
    return open_pipeline(Planted(open_dataset(demo_path()), **planted), srm="rule")  # pyright: ignore


def boxes_at(places: Sequence[Mapping[str, tuple[float, float, float]]]) -> Pipeline:
    """A camera that stands still before boxes of 20 cm, by name the centre (right, down, forward) in each frame."""
    camera = replace(camera_of(), T_world_camera=np.eye(4))
    return open_pipeline(
        InMemoryDataset(
            frame_of(
                [upright(center, (0.2, 0.2, 0.2)) for center in frame.values()],
                list(frame),
                camera=camera,
                name=f"s/{k}",
            )
            for k, frame in enumerate(places)
        ),
        srm="rule",
    )
