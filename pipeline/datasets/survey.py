"""What is in a dataset and what is broken in it, frame by frame."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from pipeline.datasets.base import Dataset
from pipeline.datasets.capabilities import dataset_notes, has_moves, moves
from pipeline.datasets.up_text import ASSUMED, DECLARE
from pipeline.geometry.camera import Camera, UpSource
from pipeline.geometry.frame import Frame
from pipeline.system.errors import InputError


@dataclass(frozen=True)
class FrameReport:
    """One line of a survey. Of a broken frame only index, id and problem are known.

    Attributes
    ----------
    index : int
        Place in the dataset, from 0.
    id : str
    ok : bool
        Whether the frame can be loaded.
    problem : str or None
        Why not: the file and the reason.
    width, height : int
        Pixels; 0 where broken.
    annotations : int
        How many objects are annotated.
    labels : tuple of str
        Their names, in the dataset's order, with repeats.
    depth_valid : float
        Share of the pixels that have depth, 0..1.
    median_depth : float or None
        Metres, over those pixels; None where broken.
    has_pose : bool
    up_source : str or None
        How the up vector that is used is known; see `camera.UpSource`.
    notes : tuple of str
        What was odd and could be left out.
    dataset_notes : tuple of str
        What the reader takes for granted in every frame; see `capabilities.dataset_notes`.
    moves : dict of str to str, or None
        Where the possible moves lead, in a dataset that has moves; see `capabilities.moves`.
    up : (x, y, z) or None
        The up vector that is used, in the camera frame.
    """

    index: int
    id: str
    ok: bool
    problem: str | None = None
    width: int = 0
    height: int = 0
    annotations: int = 0
    labels: tuple[str, ...] = ()
    depth_valid: float = 0.0
    median_depth: float | None = None
    has_pose: bool = False
    up_source: UpSource | None = None
    notes: tuple[str, ...] = ()
    dataset_notes: tuple[str, ...] = ()
    moves: dict[str, str] | None = None
    up: tuple[float, ...] | None = None


def survey(dataset: Dataset) -> Iterator[FrameReport]:
    """Load every frame in turn and report it; a broken one does not stop the rest."""
    from pipeline.datasets.scene_up import resolved_camera

    assumed = dataset_notes(dataset)
    for index, frame_id in enumerate(dataset.frame_ids):
        leads = moves(dataset, frame_id) if has_moves(dataset) else None
        try:
            frame = dataset.load(frame_id)
        except InputError as error:
            yield FrameReport(index, frame_id, ok=False, problem=str(error), dataset_notes=assumed, moves=leads)
            continue
        camera = resolved_camera(dataset, frame)
        valid = frame.depth[frame.depth > 0]
        yield FrameReport(
            index,
            frame_id,
            ok=True,
            width=frame.width,
            height=frame.height,
            annotations=len(frame.annotations),
            labels=tuple(annotation.label for annotation in frame.annotations),
            depth_valid=valid.size / frame.depth.size,
            median_depth=float(np.median(valid)),
            has_pose=frame.camera.T_world_camera is not None,
            up_source=camera.up_source,
            up=None if camera.up is None else tuple(camera.up.tolist()),
            notes=(*frame.notes, *up_notes(dataset, frame, camera)),
            dataset_notes=assumed,
            moves=leads,
        )


def up_notes(dataset: Dataset, frame: Frame, camera: Camera) -> tuple[str, ...]:
    """What is to be doubted about the up vector of a frame: that it is assumed, that its scene disagrees.

    Parameters
    ----------
    camera : Camera
        Of the frame, with its up vector resolved.
    """
    from pipeline.datasets.scene_up import own_disagreement, scene_vote

    notes = (f"{ASSUMED}; {DECLARE}",) if camera.up_source == "assumed" else ()
    if camera.T_world_camera is None or camera.up_source not in ("scene", "plane", "assumed"):
        return notes
    vote = scene_vote(dataset, frame.id)
    off = own_disagreement(frame, vote)
    if off is None:
        return notes
    most = f"{vote.agreeing} of {vote.voting} frames that were asked"
    return (*notes, f"its own level plane is {off:.0f} degrees off the up of its scene, on which {most} agree")
