"""The recorded output of any detector, from a JSON file or a folder of NPZ files.

JSON: `{"frames": {"<frame id>": [{"label": "mug", "score": 0.9, "bbox": [x0, y0, x1, y1],
"mask": {"size": [H, W], "counts": ...}}]}}`. A mask is COCO run-length encoding
(compressed string or list of counts) or the path of a PNG beside the file; it
may be left out. NPZ: one file a frame, named after the frame id with "/"
replaced by "__", with arrays boxes (N, 4), scores (N,), labels (N,) str and,
optionally, masks (N, H, W).
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, ValidationError

from pipeline.errors import FrameUnusable, InputError
from pipeline.frame import Frame
from pipeline.naming import Synonyms, match
from pipeline.proposals.annotations import box_mask
from pipeline.proposals.base import Proposals, no_proposals, unknown_class


class RunLength(BaseModel):
    """A COCO run-length encoded mask."""

    model_config = ConfigDict(extra="forbid")
    size: tuple[int, int]
    counts: str | list[int]


class RecordedDetection(BaseModel):
    """One detection of a recorded run."""

    label: str = Field(min_length=1)
    score: float = Field(ge=0, le=1)
    bbox: tuple[FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat]
    mask: RunLength | str | None = None


class Recording(BaseModel):
    """A recorded run: detections by frame id."""

    frames: dict[str, list[RecordedDetection]]


class RecordedDetector:
    """Plays back detections that were made elsewhere.

    Parameters
    ----------
    path : Path
        The JSON file, or the folder of NPZ files.

    Raises
    ------
    InputError
        For a file that does not follow the format; the message names the place.
    """

    name = "recorded"
    exact = False

    def __init__(self, path: str | Path, *, synonyms: Synonyms | None = None, min_score: float = 0.0) -> None:
        self.path = Path(path)
        self.synonyms = synonyms
        self.min_score = min_score
        if not self.path.exists():
            raise InputError("there is no recording of detections", path=self.path)
        self._recording = None if self.path.is_dir() else _read_json(self.path)

    @property
    def vocabulary(self) -> tuple[str, ...] | None:
        return self._names

    @cached_property
    def _names(self) -> tuple[str, ...]:
        if self._recording is not None:
            return tuple(sorted({d.label for found in self._recording.frames.values() for d in found}))
        names: set[str] = set()
        for file in sorted(self.path.glob("*.npz")):
            names.update(_read_labels(file))
        return tuple(sorted(names))

    def fingerprint(self) -> str:
        return f"recorded:{self.path.resolve()}:{self.path.stat().st_mtime_ns}:{self.min_score}"

    def detect(self, frame: Frame, labels: Sequence[str] | None) -> Proposals:
        boxes, scores, names, masks, has_mask = self._of_frame(frame)
        keep = scores >= self.min_score
        if labels is not None:
            known = self.vocabulary or ()
            wanted: set[str] = set()
            for label in labels:
                matched = match(label, known, self.synonyms)
                if not matched:
                    raise unknown_class(label, known, f"the recording {self.path.name}")
                wanted.update(matched)
            keep &= np.isin(names, list(wanted))
        if not keep.any():
            return no_proposals(frame.height, frame.width)
        vocabulary = tuple(dict.fromkeys(names[keep].tolist()))
        return Proposals(
            boxes[keep],
            scores[keep],
            np.array([vocabulary.index(n) for n in names[keep]], np.int64),
            vocabulary,
            masks[keep],
            np.flatnonzero(keep).astype(np.int64),
            has_mask[keep],
        )

    def _of_frame(self, frame: Frame) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """boxes (N, 4), scores (N,), names (N,), masks (N, H, W), and which of the masks are more than the box."""
        shape = (frame.height, frame.width)
        if self._recording is None:
            file = self.path / (frame.id.replace("/", "__") + ".npz")
            if not file.is_file():
                raise FrameUnusable(f"the recording has no detections for frame {frame.id}", path=file)
            boxes, scores, names, masks = _read_npz(file)
            has_mask = np.full(len(boxes), masks is not None)
            if masks is None:
                masks = np.stack([box_mask(b, *shape) for b in boxes]) if len(boxes) else np.zeros((0, *shape), bool)
            elif masks.shape[1:] != shape:
                raise InputError("recorded masks have another size", got=masks.shape[1:], expected=shape, path=file)
            return boxes, scores, names, masks, has_mask
        if frame.id not in self._recording.frames:
            raise FrameUnusable(f"the recording has no detections for frame {frame.id}", path=self.path)
        found = self._recording.frames[frame.id]
        masks = [self._mask(d, shape, f"frame {frame.id}, detection {i}") for i, d in enumerate(found)]
        return (
            np.array([d.bbox for d in found], np.float32).reshape(-1, 4),
            np.array([d.score for d in found], np.float32),
            np.array([d.label for d in found], dtype=np.str_),
            np.stack(masks) if masks else np.zeros((0, *shape), np.bool_),
            np.array([d.mask is not None for d in found], np.bool_),
        )

    def _mask(self, detection: RecordedDetection, shape: tuple[int, int], where: str) -> np.ndarray:
        if detection.mask is None:
            return box_mask(np.array(detection.bbox), *shape)
        if isinstance(detection.mask, RunLength):
            # The size is checked before memory for it is asked for.
            if detection.mask.size != shape:
                raise InputError(
                    f"{where}: the mask has another size", got=detection.mask.size, expected=shape, path=self.path
                )
            mask = decode_run_length(detection.mask.size, detection.mask.counts, where)
        else:
            mask = self._mask_file(detection.mask, where)
        if mask.shape != shape:
            raise InputError(f"{where}: the mask has another size", got=mask.shape, expected=shape, path=self.path)
        return mask

    def _mask_file(self, name: str, where: str) -> np.ndarray:
        import cv2

        try:
            file = (self.path.parent / name).resolve()
        except (OSError, ValueError, RuntimeError) as error:  # A NUL in the name, a loop of links.
            raise InputError(f"{where}: the mask is not a readable file", got=repr(name), path=self.path) from error
        if not file.is_relative_to(self.path.parent.resolve()):
            raise InputError(f"{where}: the mask lies outside the recording's folder", got=name, path=self.path)
        image = cv2.imread(str(file), cv2.IMREAD_UNCHANGED) if file.is_file() else None
        if image is None or image.ndim != 2:
            raise InputError(f"{where}: the mask is not a readable one-channel image", path=file)
        return image > 0


def decode_run_length(size: Sequence[int], counts: str | list[int], where: str = "mask") -> np.ndarray:
    """(H, W) bool from COCO run-length encoding, compressed or not."""
    from pycocotools import mask as coco

    height, width = int(size[0]), int(size[1])
    if isinstance(counts, list):
        if sum(counts) != height * width or min(counts, default=0) < 0:
            raise InputError(f"{where}: the run lengths do not fill the mask", got=sum(counts), expected=height * width)
        uncompressed: Any = {"size": [height, width], "counts": counts}
        encoded: Any = coco.frPyObjects(uncompressed, height, width)
    else:
        encoded = {"size": [height, width], "counts": counts.encode("ascii", "replace")}
        # The decoder trusts its input; the run lengths are checked here first.
        if not _fills(counts, height * width):
            raise InputError(f"{where}: the run lengths do not fill the mask", expected=f"{height * width} pixels")
    return coco.decode(encoded).astype(np.bool_)


def _fills(counts: str, pixels: int) -> bool:
    """Whether a compressed COCO string decodes to run lengths that sum to `pixels`."""
    runs: list[int] = []
    i = 0
    while i < len(counts):
        value, shift, more = 0, 0, True
        while more:
            if i >= len(counts):
                return False
            c = ord(counts[i]) - 48
            if not 0 <= c < 64:
                return False
            value |= (c & 0x1F) << shift
            more = bool(c & 0x20)
            i, shift = i + 1, shift + 5
            if not more and c & 0x10:
                value -= 1 << shift
        if len(runs) > 2:
            value += runs[-2]
        if value < 0:
            return False
        runs.append(value)
    return sum(runs) == pixels


def _read_json(path: Path) -> Recording:
    try:
        return Recording.model_validate(json.loads(path.read_text(encoding="utf-8")))
    except (OSError, json.JSONDecodeError, UnicodeDecodeError, RecursionError) as error:
        raise InputError("the recording is not JSON", got=str(error), path=path) from error
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(p) for p in first["loc"])
        raise InputError(
            f"the recording does not follow the format at {place or 'the top'}", got=first["msg"], path=path
        ) from error


def _read_labels(file: Path) -> list[str]:
    """The class names of one file, without its masks, which are far larger."""
    try:
        with np.load(file, allow_pickle=False) as data:
            return np.asarray(data["labels"]).astype(np.str_).ravel().tolist()
    except Exception:  # Whatever is wrong with the file is said in full where its detections are read.
        return []


def _read_npz(file: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray | None]:
    try:
        with np.load(file, allow_pickle=False) as data:
            boxes = np.asarray(data["boxes"], np.float32)
            scores = np.asarray(data["scores"], np.float32)
            labels = np.asarray(data["labels"]).astype(np.str_)
            masks = np.asarray(data["masks"]).astype(np.bool_) if "masks" in data else None
    except Exception as error:  # Damaged bytes fail in zipfile, zlib or NumPy, each with its own class.
        raise InputError(
            "not a recording of detections",
            got=(str(error) or type(error).__name__).splitlines()[0],
            expected="arrays boxes, scores, labels and, optionally, masks",
            path=file,
        ) from error
    if boxes.size == 0:
        boxes = boxes.reshape(0, 4)
    if boxes.ndim != 2 or boxes.shape[1] != 4 or scores.ndim != 1 or labels.ndim != 1:
        raise InputError(
            "the arrays of a recording have the wrong shape",
            got=f"boxes {boxes.shape}, scores {scores.shape}, labels {labels.shape}",
            expected="(N, 4), (N,), (N,)",
            path=file,
        )
    if not (len(boxes) == len(scores) == len(labels) == (len(boxes) if masks is None else len(masks))):
        raise InputError("the arrays of a recording differ in length", path=file)
    return boxes, scores, labels, masks
