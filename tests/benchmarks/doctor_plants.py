"""Errors planted in what is read of a recording, and what became of each when `doctor` looked at it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from pose_files import as_convention

from pipeline.datasets import InMemoryDataset
from pipeline.datasets.doctor.examine import Examination, chosen_frames, examine_frames
from pipeline.datasets.meant import laid_over, mirrored_frame, ray_lengths
from pipeline.geometry import Frame, Registration, intrinsics, registered
from pipeline.system import InputError

UNITS = 1000.0
SCALE_WITHIN, FOCAL_WITHIN, CENTER_WITHIN = 0.1, 0.08, 0.03
WARP_WITHIN = 0.4
"""A warp is right where it leaves less of the pixels by which the one that was planted moves things."""
OPPOSITE = {"90": "270", "270": "90"}
OUTCOMES = ("right", "named", "abstains", "missed", "wrong mend", "false alarm", "refused")
"""The error is mended; it is named, and no mend is offered; nothing is called wrong and it is said that nothing tells;
or that all is fine. What is wrong: a mend that does not undo it, something else called wrong."""


@dataclass(frozen=True)
class Planted:
    """One error.

    Attributes
    ----------
    about : str
        The subject it is of, "" for none.
    by : float, str or tuple
        Factor, name, places, pixels or warp by which what is read differs from the truth.
    """

    about: str
    by: Any = ""

    @property
    def subjects(self) -> set[str]:
        """What may be called wrong."""
        of_camera = {"focal length", "principal point"}
        if self.about == "registration":
            # Depth of another camera is read with that one's intrinsics, too.
            return {self.about, *of_camera}
        return of_camera if self.about == "picture size" else {self.about}

    def read(self, frames: Sequence[Frame]) -> list[Frame]:
        """A recording as it is read with the error; what is declared of its world is right, and carried by poses."""
        if self.about == "time":
            return [
                _posed(f, frames[min(max(k + self.by, 0), len(frames) - 1)].camera.T_world_camera)
                for k, f in enumerate(frames)
            ]
        return [self._read(frame) for frame in frames]

    def _read(self, frame: Frame) -> Frame:
        camera, by, K = frame.camera, self.by, frame.camera.K.copy()
        if self.about == "depth kind":
            length = ray_lengths(K, frame.depth.shape)
            inverse = np.divide(1, frame.depth, out=np.zeros_like(frame.depth), where=frame.depth > 0)
            return replace(frame, depth=inverse if by == "inverse" else (frame.depth * length).astype(np.float32))
        if self.about == "depth map":
            return replace(frame, depth=laid_over(frame.depth, OPPOSITE.get(by, str(by))))
        if self.about == "pictures":
            found = mirrored_frame(frame, by)
            # Whoever mirrors pictures does not know it: the camera stays.
            return replace(found, camera=replace(found.camera, K=K))
        if self.about == "missing depth":
            return replace(frame, depth=np.where(frame.depth > 0, frame.depth, np.float32(by)))
        if self.about == "depth scale":
            return replace(frame, depth=frame.depth * np.float32(by))
        if self.about == "poses" and camera.T_world_camera is not None:
            return _posed(frame, as_convention(camera.T_world_camera, str(by)))
        if self.about == "up" and camera.T_world_camera is not None:
            wrong = np.array(by, np.float64)
            return replace(frame, camera=camera.with_up(camera.T_world_camera[:3, :3].T @ wrong, "declared"))
        if self.about == "registration":
            f, *shift, tx, ty = by
            back = Registration(camera.fx / f, camera.fy / f, camera.cx - shift[0], camera.cy - shift[1], -tx, -ty)
            return replace(frame, depth=registered(frame.depth, camera, back)[0])
        if self.about == "focal length":
            K[[0, 1], [0, 1]] *= float(by)
        elif self.about == "picture size":
            K[:2] *= by
        elif by == "other side":
            K[:2, 2] = [camera.width - 1 - camera.cx, camera.height - 1 - camera.cy]
        elif self.about == "principal point":
            K[:2, 2] = K[1::-1, 2] if by == "swapped" else K[:2, 2] + np.array(by)
        return replace(frame, camera=replace(camera, K=K))

    def undone(self, found: Examination, frames: Sequence[Frame], read: Sequence[Frame]) -> bool:
        """Whether what is said to mend it does; `frames` are the true ones, `read` those with the error."""
        mends, truth = found.mends, frames[0].camera
        if self.about == "depth kind":
            # One inverse metre was read as a metre.
            unit = mends.get("depth_scale", UNITS) / UNITS
            return mends["depth_is"] == self.by and (self.by != "inverse" or abs(unit - 1) < SCALE_WITHIN)
        if self.about == "depth map":
            return mends["depth_turned"] == self.by
        if self.about == "missing depth":
            return abs(mends["depth_nothing"] / UNITS / self.by - 1) < 1e-3
        if self.about == "depth scale":
            return abs(mends["depth_scale"] / (UNITS * float(self.by)) - 1) < SCALE_WITHIN
        if self.about == "poses":
            return mends["poses"] == self.by
        if self.about == "time":
            return mends["pose_shift"] == -int(self.by)
        if self.about == "up":
            return np.allclose([float(n) for n in mends["up"].partition(":")[2].split(",")], (0, 0, 1))
        if self.about == "registration":
            return "registration" not in mends or warp_left(found, frames, read) < WARP_WITHIN
        fx, _, cx, cy = mends["intrinsics"]
        off = max(abs(cx - truth.cx), abs(cy - truth.cy))
        near = CENTER_WITHIN if self.by in ("swapped", "other side", 0.5, 2.0) else 2 * CENTER_WITHIN
        return abs(fx / truth.fx - 1) < FOCAL_WITHIN and off < near * truth.width


def warp_left(found: Examination, frames: Sequence[Frame], read: Sequence[Frame]) -> float:
    """How many of the pixels that are read with a wrong depth have one with the mend: 0 is mended, above 1 is harm."""
    warp, K = Registration(*found.mends["registration"]), read[0].camera.K
    if "intrinsics" in found.mends:
        K = intrinsics(*found.mends["intrinsics"])
    mended = [replace(f, depth=registered(f.depth, replace(f.camera, K=K), warp)[0]) for f in read]
    left, first = (np.mean([_misfit(f, t) for f, t in zip(some, frames, strict=True)]) for some in (mended, read))
    return float(left / max(first, 1e-9))


def _misfit(frame: Frame, true: Frame) -> float:
    """Share of the pixels that have a depth in both whose depths differ by more than 2 %; with a pixel's tolerance."""
    kernel = np.ones((3, 3), np.uint8)
    low, high = cv2.erode(np.where(true.depth > 0, true.depth, 99), kernel), cv2.dilate(true.depth, kernel)
    both = (frame.depth > 0) & (true.depth > 0)
    return float(((frame.depth < 0.98 * low) | (frame.depth > 1.02 * high))[both].mean()) if both.any() else 1.0


def _posed(frame: Frame, T: np.ndarray | None) -> Frame:
    """A frame with another pose, which carries the up of the same world."""
    camera, old = frame.camera, frame.camera.T_world_camera
    if camera.up is None or old is None or T is None:
        return replace(frame, camera=replace(camera, T_world_camera=T))
    return replace(frame, camera=replace(camera, T_world_camera=T, up=T[:3, :3].T @ old[:3, :3] @ camera.up))


@dataclass(frozen=True)
class Judged:
    """A case and what became of it; `found` None where the reader itself refused."""

    recording: str
    planted: Planted
    outcome: str
    found: Examination | None
    said: str


def judge(
    recording: str, frames: Sequence[Frame], planted: Planted, read: Sequence[Frame] = (), passed: Sequence[str] = ()
) -> Judged:
    """Plant an error and see what is said; `read` is the recording with it, `passed` subjects are wrong anyway."""
    try:
        read = read or planted.read(frames)
        dataset = InMemoryDataset(read)
        found = examine_frames(dataset, chosen_frames(dataset), UNITS)
    except InputError as error:
        return Judged(recording, planted, "refused", None, str(error))
    wrong = {o.about for o in found.wrong} - set(passed)
    told = [o for o in found.opinions if o.about in wrong | planted.subjects]
    said = " | ".join(f"{o.about}: {o.text} {o.option or ''}" for o in told)
    return Judged(recording, planted, outcome_of(found, wrong, planted, frames, read), found, said)


def outcome_of(
    found: Examination, wrong: set[str], planted: Planted, frames: Sequence[Frame], read: Sequence[Frame]
) -> str:
    """One of `OUTCOMES`; "right" too where nothing is planted and nothing is found."""
    if not planted.about or not wrong <= planted.subjects:
        return "false alarm" if wrong else "right"
    if wrong:
        if not any(o.mend for o in found.wrong if o.about in wrong):
            return "named"
        return "right" if planted.undone(found, frames, read) else "wrong mend"
    states = {found.of(about).state for about in planted.subjects}
    return "abstains" if "unknown" in states else "missed"
