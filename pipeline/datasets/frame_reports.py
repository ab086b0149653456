"""Survey of a dataset: reports per frame, counts over all frames, and the cameras of a scene from above."""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Iterable, Iterator
from typing import Any

import numpy as np

from pipeline.datasets.base import Dataset, dataset_notes, has_moves, load_picture, load_pose, moves, scene_of
from pipeline.datasets.cameras import or_note
from pipeline.datasets.settings import ASSUMED, DECLARE, DEPTH_SCALE
from pipeline.datasets.up import resolved_camera, scene_doubt, scene_vote
from pipeline.geometry.camera import UpSource
from pipeline.geometry.frame import Frame
from pipeline.system.errors import InputError
from pipeline.system.frozen import dataclass


@dataclass(frozen=True)
class FrameReport:
    """Survey line of a frame. For a broken frame only index, id and problem are known.

    Attributes
    ----------
    index : int
        Place in the dataset, from 0.
    decoded : bool
        Whether pictures were decoded. If not, files and their headers alone were looked at: nothing is known of depth,
        annotations and up, nor whether the pictures are whole.
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
        Metres, over those pixels; None where broken, and where nothing tells the unit.
    up_source : str or None
        How the up vector that is used is known; see `camera.UpSource`.
    notes : tuple of str
        What was odd and could be left out.
    dataset_notes : tuple of str
        What the reader takes for granted in every frame; see `base.dataset_notes`.
    moves : dict of str to str, or None
        Where the possible moves lead, in a dataset that has moves; see `base.moves`.
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
    decoded: bool = True


def spread(count: int, most: int) -> list[int]:
    """Indices of at most so many of `count` frames, evenly spread."""
    return np.linspace(0, count - 1, min(count, most)).astype(int).tolist()


def survey(
    dataset: Dataset, most_decoded: int | None = None, seen: Callable[[int, Frame], object] = lambda index, frame: None
) -> Iterator[FrameReport]:
    """Report every frame in turn; broken frames do not stop the survey. With `most_decoded` only so many frames are
    decoded, evenly spread; where a dataset can, of the others only files and headers are looked at. `seen` is called
    with each decoded frame."""
    assumed, peek = dataset_notes(dataset), getattr(dataset, "peek", None)
    count = len(dataset.frame_ids)
    chosen = None if most_decoded is None or peek is None else set(spread(count, most_decoded))
    for index, frame_id in enumerate(dataset.frame_ids):
        leads = moves(dataset, frame_id) if has_moves(dataset) else None
        try:
            if peek is not None and chosen is not None and index not in chosen:
                width, height = peek(frame_id)
                yield FrameReport(
                    index,
                    frame_id,
                    ok=True,
                    width=width,
                    height=height,
                    has_pose=load_pose(dataset, frame_id) is not None,
                    dataset_notes=assumed,
                    moves=leads,
                    decoded=False,
                )
                continue
            frame = dataset.load(frame_id)
        except InputError as error:
            yield FrameReport(index, frame_id, ok=False, problem=str(error), dataset_notes=assumed, moves=leads)
            continue
        seen(index, frame)
        # Of a camera that is only a stand-in no level plane can be asked.
        untold = frame.camera.untold
        camera = frame.camera if untold else resolved_camera(dataset, frame)
        valid = frame.depth[frame.depth > 0]
        assumed_up = f"{ASSUMED}; {DECLARE}" if camera.up_source == "assumed" else ""
        doubts = (note for note in (assumed_up, scene_doubt(dataset, frame, camera)) if note)
        yield FrameReport(
            index,
            frame_id,
            ok=True,
            width=frame.width,
            height=frame.height,
            annotations=len(frame.annotations),
            labels=tuple(annotation.label for annotation in frame.annotations),
            depth_valid=valid.size / frame.depth.size,
            median_depth=None if DEPTH_SCALE in untold else float(np.median(valid)),
            has_pose=frame.camera.T_world_camera is not None,
            up_source=camera.up_source,
            up=None if camera.up is None else tuple(camera.up.tolist()),
            notes=(*frame.notes, *doubts),
            dataset_notes=assumed,
            moves=leads,
        )


LITTLE_DEPTH = 0.1
"""Share of the pixels with depth below which a frame counts as having little."""


class SurveyCounts:
    """Running counts of a survey; memory grows with the classes only."""

    def __init__(self) -> None:
        self._counts: Counter[str] = Counter()
        self._named: defaultdict[str, Counter[str]] = defaultdict(Counter)
        self._notes: tuple[str, ...] = ()
        self._remedies: dict[str, str] = {}
        self._depth = 0.0

    def add(self, report: FrameReport) -> None:
        """Count a frame."""
        self._notes = report.dataset_notes
        self._counts.update(frames=1, frames_usable=report.ok, frames_broken=not report.ok)
        if not report.ok:
            self._named["problems"][reason := _reason(report)] += 1
            self._remedies.setdefault(reason, _remedy(report))
            return
        self._counts.update(frames_without_pose=not report.has_pose, frames_decoded=report.decoded)
        if report.width:
            self._named["sizes"][f"{report.width}x{report.height}"] += 1
        if not report.decoded:
            return
        self._depth += report.depth_valid
        self._counts.update(
            objects=report.annotations,
            frames_with_little_depth=report.depth_valid < LITTLE_DEPTH,
            frames_without_objects=not report.annotations,
            frames_with_notes=bool(report.notes),
        )
        self._named["classes"].update(report.labels)
        self._named["up_source"][report.up_source or "unknown"] += 1

    def watch(self, reports: Iterable[FrameReport]) -> Iterator[FrameReport]:
        """Yield frames unchanged while counting."""
        for report in reports:
            self.add(report)
            yield report

    def record(self) -> dict[str, Any]:
        """The counts so far, over the frames of a survey.

        Returns
        -------
        dict
            JSON-able: frames, frames_usable, frames_broken, frames_decoded (of the usable ones; only these tell of
            depth, objects, notes and up), notes (what no file states, see `base.dataset_notes`),
            problems ({reason: frames}), remedies ({reason: what the first such frame was, and would have to be}, where
            that is known); of the usable frames frames_with_little_depth (less than a tenth of the
            pixels), frames_without_pose, frames_without_objects, frames_with_notes, sizes ({"WxH": frames}),
            up_source ({source: frames}), depth_valid (mean share of the pixels, 0..1, or None), objects,
            objects_per_frame (mean or None), and classes ({name: objects}). What is counted by name runs from the
            most frequent on.
        """
        counts, decoded = self._counts, self._counts["frames_decoded"]
        missing = ("with_little_depth", "without_pose", "without_objects", "with_notes")
        return {
            **{name: counts[name] for name in ("frames", "frames_usable", "frames_broken", "frames_decoded")},
            "notes": list(self._notes),
            "problems": _sorted(self._named["problems"]),
            "remedies": {reason: text for reason, text in self._remedies.items() if text},
            **{f"frames_{name}": counts[f"frames_{name}"] for name in missing},
            "sizes": _sorted(self._named["sizes"]),
            "up_source": _sorted(self._named["up_source"]),
            "depth_valid": round(self._depth / decoded, 6) if decoded else None,
            "objects": counts["objects"],
            "objects_per_frame": round(counts["objects"] / decoded, 6) if decoded else None,
            "classes": _sorted(self._named["classes"]),
        }


def _sorted(counter: Counter[str]) -> dict[str, int]:
    return dict(sorted(counter.items(), key=lambda item: (-item[1], item[0])))


def _reason(report: FrameReport) -> str:
    """Problem text without the frame's name, value and file."""
    text = (report.problem or "unknown").split("; ")[0].split(" [")[0].split(" (")[0]
    return re.sub(rf"(?<!\w){re.escape(report.id)}(?!\w)", "…", text).removeprefix("frame …: ")


def _remedy(report: FrameReport) -> str:
    """What a problem says behind its reason, without the file: what was got and expected, and the likely cause."""
    text = re.sub(r" \[[^\]]*\]$", "", report.problem or "")
    return text[min((at for mark in ("; ", " [", " (") if (at := text.find(mark)) >= 0), default=len(text)) :].lstrip(
        "; "
    )


MOST_CAMERAS = 120
"""Of a longer scene so many are shown, evenly spread over its frames."""
NEIGHBOURS = 20_000
"""So many frames of either side are asked for their scene."""


@dataclass(frozen=True, eq=False)
class CameraPlan:
    """The cameras of a scene from above."""

    scene: str
    frame_ids: tuple[str, ...]  # Of the frames with a pose, in the dataset's order
    positions: np.ndarray  # (N, 2) float: Metres; the first axis is that in which the cameras are spread most
    headings: np.ndarray  # (N, 2) float: Where they look, of length one; 0, 0 for one that looks straight up or down


def camera_plan(
    dataset: Dataset, frame_id: str, most: int = MOST_CAMERAS, also: Collection[str] = ()
) -> CameraPlan | None:
    """Plan of the cameras in a frame's scene; None with fewer than two poses.

    Up is what the frame declares, else what the scene's frames vote for, else what the cameras hold upwards. At most
    `most` frames are asked for their poses, this one, and `also` these.
    """
    at, scene = dataset.frame_ids.index(frame_id), scene_of(dataset, frame_id)
    start = max(0, at - NEIGHBOURS)
    ids = [i for i in dataset.frame_ids[start : at + NEIGHBOURS] if scene_of(dataset, i) == scene]
    chosen = {ids[k] for k in np.linspace(0, len(ids) - 1, min(most, len(ids))).astype(int)} | {frame_id, *also}
    found = {i: or_note([], "", load_pose, dataset, i) for i in ids if i in chosen}
    poses = {i: pose for i, pose in found.items() if pose is not None}
    if len(poses) < 2:
        return None
    matrices = np.stack(list(poses.values()))
    camera = getattr(or_note([], "", load_picture, dataset, frame_id), "camera", None)
    if camera is not None and camera.up is not None and frame_id in poses:
        up = poses[frame_id][:3, :3] @ camera.up
    else:
        up = scene_vote(dataset, frame_id).up
    up = -matrices[:, :3, 1].mean(axis=0) if up is None else up
    return CameraPlan(scene, tuple(poses), *_from_above(matrices, up / max(float(np.linalg.norm(up)), 1e-9)))


def _from_above(poses: np.ndarray, up: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(N, 2) positions and headings of poses ((N, 4, 4), world, metres) along the level axes of most and least spread.
    The second axis is the first turned left, seen from above."""
    centered = poses[:, :3, 3] - poses[:, :3, 3].mean(axis=0)
    level = centered - np.outer(centered @ up, up)
    first = np.linalg.svd(level)[2][0]
    if np.abs(level).max() < 1e-6 or abs(first @ up) > 0.5:
        first = np.eye(3)[int(np.argmin(np.abs(up)))]
    first = first - (first @ up) * up
    axes = np.stack([first / np.linalg.norm(first), np.cross(up, first / np.linalg.norm(first))], axis=1)
    headings = poses[:, :3, 2] @ axes
    lengths = np.linalg.norm(headings, axis=1, keepdims=True)
    return level @ axes, np.where(lengths > 1e-3, headings / np.maximum(lengths, 1e-9), 0.0)
