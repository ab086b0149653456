"""Pictures of a video, one by one."""

from __future__ import annotations

import re
from functools import lru_cache
from pathlib import Path
from threading import Lock

import cv2
import numpy as np

from pipeline.datasets.files import CUT_OFF
from pipeline.system.errors import require
from pipeline.system.limits import within
from pipeline.system.safe_files import checked_path, limits_of, opened

MOVIE = re.compile(rb"....(ftyp|moov|mdat|free|skip|wide)|\x1aE\xdf\xa3", re.DOTALL)
"""How files of MP4, QuickTime and Matroska begin."""
MOST_SKIPPED = 60
"""So many pictures are decoded on the way to a later one; beyond it the video is searched."""


class Video:
    """An open video, read picture by picture; safe for several threads."""

    def __init__(self, path: Path) -> None:
        self.path, self._lock, self._next = checked_path(path, "unpacked"), Lock(), 0
        # OpenCV goes by the content: a list of other files, or a picture with others beside it, would be a video too.
        with opened(path, "unpacked") as file:
            require(MOVIE.match(file.read(8)), "neither MP4 nor Matroska", cause=CUT_OFF, path=path)
        self._capture = cv2.VideoCapture(str(path))
        # What a container says of turning is for players; depth beside it is not turned.
        self._capture.set(cv2.CAP_PROP_ORIENTATION_AUTO, 0)
        sides = [int(self._capture.get(side)) for side in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT)]
        require(
            self._capture.isOpened() and min(sides) > 0,
            "a video that OpenCV cannot read",
            expected=f"its pictures: mkdir rgb && ffmpeg -i {path.name} -start_number 0 rgb/%06d.png",
            path=path,
        )
        within(sides[0] * sides[1], "pixels", "a picture of a video", path, limits_of(path))
        self.size = sides[0], sides[1]  # (width, height), pixels, of the pictures as they are stored
        self.count = int(self._capture.get(cv2.CAP_PROP_FRAME_COUNT))

    def picture(self, number: int) -> np.ndarray:
        """Picture `number`, from 0, as (H, W, 3) uint8 RGB; InputError where there is none."""
        with self._lock:
            if not 0 <= number - self._next <= MOST_SKIPPED:
                self._capture.set(cv2.CAP_PROP_POS_FRAMES, number)
                self._next = number
            while self._next < number and self._capture.grab():
                self._next += 1
            found, bgr = self._capture.read()
            self._next += 1
            if not found:
                self._next = -MOST_SKIPPED * 2  # The next picture is searched.
        require(found, f"no picture {number} in the video", got=f"{self.count} pictures", path=self.path)
        return np.ascontiguousarray(bgr[..., ::-1])


def open_video(path: Path) -> Video:
    """The video at a path, kept open; InputError where it cannot be read."""
    return _opened(path, path.stat().st_mtime_ns)


@lru_cache(maxsize=2)
def _opened(path: Path, written: int) -> Video:
    return Video(path)
