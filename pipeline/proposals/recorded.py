"""The recorded output of any detector, from a JSON file or a folder of NPZ files.

JSON: `{"frames": {"<frame id>": [{"label": "mug", "score": 0.9, "bbox": [x0, y0, x1, y1], "mask": {"size": [H, W],
"counts": ...}, "id": 3}]}}`. A mask is COCO run-length encoding (compressed string or list of counts) or the path of a
PNG beside the file; it may be left out. NPZ: one file a frame, named after the frame id with "/" replaced by "__", with
arrays boxes (N, 4), scores (N,), labels (N,) str and, optionally, masks (N, H, W), or mask_counts (N,) of compressed
run-length codes (empty for none) with mask_size (2,), and ids (N,) int, below 0 for none.

Either may say which detector made it: `"made_by": "<name>: <fingerprint>"` beside "frames", or in a file
`recording.json` in the folder.

Files that other programs publish (`pipeline.proposals.detection_files`: COCO results, the sinks of supervision,
Grounded SAM), or a folder of them, are played back too.
An id says which thing a detection is of: one and the same thing, found under several names, has one id. Where any
detection of a frame has none, each is a thing of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import TypeAdapter

from pipeline.datasets.frame_names import FrameNames, Picture, fit
from pipeline.geometry.frame import Frame
from pipeline.geometry.masks import MaskCrop, RunLength
from pipeline.language.naming import Synonyms, match
from pipeline.proposals.annotations import box_mask
from pipeline.proposals.base import Proposals, no_proposals
from pipeline.proposals.class_names import is_cut, meant_names
from pipeline.proposals.coco_files import (
    Corners,
    Detections,
    MaskCode,
    RecordedDetection,
    SceneMap,
    scored,
    without_score,
)
from pipeline.proposals.detection_files import DETECTION_FORMATS, detection_files, format_of, read_detections
from pipeline.system.contents import contents_hash
from pipeline.system.errors import FrameUnusable, InputError, as_input_error, first_line, needed, require
from pipeline.system.frozen import dataclass
from pipeline.system.reading import Content, checked, read_content
from pipeline.system.recent import Recent
from pipeline.system.safe_files import checked_texts, opened_arrays, read_picture

KEPT_ANSWERS = 32
"""Answers about the frame that was asked last, kept for when the same names are asked again."""

MADE_BY, MADE_BY_FILE = "made_by", "recording.json"
_WHAT = "the recording"


@dataclass(frozen=True)
class FrameDetections:
    """Recorded detections of a frame, with encoded masks."""

    boxes: np.ndarray  # (N, 4) float32
    scores: np.ndarray  # (N,) float32
    names: tuple[str, ...]
    ids: np.ndarray  # (N,) int64: -1 where there is none
    masks: Sequence[MaskCode | None] | np.ndarray  # sequence of MaskCode or None, or (N, H, W) bool
    segmented: np.ndarray | None = None  # (N,) bool or None: As of `Proposals`


class Playback:
    """Playback of a recorded frame; masks are decoded on demand, within their boxes."""

    def __init__(self, frame: Frame, found: FrameDetections, path: Path) -> None:
        self.frame_id, self.shape = frame.id, (frame.height, frame.width)
        self.found = found
        self.names = np.array(found.names, dtype=np.str_)
        self.answers: Recent[tuple[str, ...] | None, Proposals] = Recent(KEPT_ANSWERS)
        self._path = path
        self._crops: dict[RunLength, MaskCrop] = {}

    def shows(self, frame: Frame) -> bool:
        return self.frame_id == frame.id and self.shape == (frame.height, frame.width)

    def proposals(self, index: np.ndarray) -> Proposals:
        """The detections at `index` ((M,) int) with their masks."""
        names = self.names[index].tolist()
        vocabulary = tuple(dict.fromkeys(names))
        has_mask = np.ones(len(index), np.bool_)
        stored = self.found.masks
        masks = stored[index] if isinstance(stored, np.ndarray) else np.zeros((len(index), *self.shape), np.bool_)
        if not isinstance(stored, np.ndarray):
            has_mask[:] = [self._paint(int(i), mask) for i, mask in zip(index, masks, strict=True)]
        try:
            return Proposals(
                self.found.boxes[index],
                self.found.scores[index],
                np.array([vocabulary.index(n) for n in names], np.int64),
                vocabulary,
                masks,
                self.found.ids[index],
                has_mask,
                None if self.found.segmented is None else self.found.segmented[index],
            )
        except InputError as error:
            raise InputError(f"frame {self.frame_id}: {error}", path=self._path) from error

    def _paint(self, i: int, picture: np.ndarray) -> bool:
        """Paint the mask of a detection into an empty picture; False for a box only."""
        code = self.found.masks[i]
        if code is None:
            picture |= box_mask(self.found.boxes[i], *self.shape)
            return False
        where = f"frame {self.frame_id}, detection {i}"
        if isinstance(code, RunLength):
            # One thing that was found under several names is decoded once.
            self._crops[code] = crop = self._crops.get(code) or code.crop(self.shape, where, self._path)
            crop.paint(picture)
            return True
        mask = _mask_file(self._path, code, where)
        require(
            mask.shape == self.shape,
            f"{where}: the mask has another size",
            got=mask.shape,
            expected=self.shape,
            path=self._path,
        )
        picture |= mask
        return True


class RecordedDetector:
    """Detector of recorded detections.

    Parameters
    ----------
    path : Path
        The JSON file, the folder of NPZ files, or a published file or a folder of them.
    key : Path, optional
        What the numbers of a published file mean: COCO's annotation file, a list of class names.
    frame_ids : sequence of str
        All frames that a published file's pictures may be of; without them each frame is looked for by itself.
    unscored : bool
        COCO annotations without scores are read as detections of score 1.

    Attributes
    ----------
    made_by : str or None
        "name: fingerprint" of the detector that was recorded, where the recording says so.
    scoreless : (int, int)
        Detections of a published file without a score, which count with 1, and all.
    cut : dict of str to tuple of str
        Asked names that stand in the recording as cut words, with these.
    corners : dict of int to Corners
        Of the objects of a map: the corners of their 3D boxes in the world, metres, by id; empty otherwise.

    Raises
    ------
    InputError
        For a file that does not follow the format; the message names the place.
    """

    name = "recorded"
    exact = False
    lists_things = True
    reads_annotations = False

    def __init__(
        self,
        path: str | Path,
        *,
        key: Path | None = None,
        frame_ids: Sequence[str] = (),
        synonyms: Synonyms | None = None,
        min_score: float = 0.0,
        unscored: bool = False,
    ) -> None:
        self.path = Path(path)
        self.synonyms = synonyms
        self.min_score = min_score
        require(self.path.exists(), "there is no recording of detections", path=self.path)
        self._recording: dict[str, FrameDetections] | None = None
        self._published: Detections | None = None
        self.made_by: str | None = None
        self.scoreless = (0, 0)
        self.cut: dict[str, tuple[str, ...]] = {}
        if self.path.is_dir():
            if (self.path / MADE_BY_FILE).is_file():
                self.made_by = _maker(_object(read_content(self.path / MADE_BY_FILE, _WHAT)))
            files = [] if any(self.path.glob("*.npz")) else detection_files(self.path, _WHAT)
        else:
            (content,) = detection_files(self.path, _WHAT)
            content = scored(content) if unscored else content
            files = [content]
            if not format_of(content):
                files = []
                self.made_by, self._recording = _maker(_object(content)), _read_frames(_object(content), self.path)
        require(files or key is None, "a recording of our own needs no file beside it", path=key)
        self.corners: dict[int, Corners] = {}
        self.elsewhere: list[Picture] = []
        if files:
            self._published = read_detections(files, key)
            self.scoreless = without_score(self._published)
            if len(files) == 1 and isinstance(files[0].value, SceneMap):
                self.corners = files[0].value.corners
            if frame_ids:
                self._recording, self.elsewhere = _of_frames(self._published, frame_ids, self.path)
                some = next(iter(self._published), None)
                require(
                    self._recording or some is None,
                    "no picture of the recording is a frame of the dataset",
                    got=f"such as {some!r}",
                    expected=f"such as {frame_ids[0]!r}",
                    path=self.path,
                )
        self._files = (self.path,) if key is None else (self.path, key)
        self._meanings: dict[str, tuple[str, ...]] = {}
        self._last: Playback | None = None
        self._hashed: tuple[list[tuple[int, int, int]], str] = [], ""

    @property
    def vocabulary(self) -> tuple[str, ...] | None:
        return self._names

    @cached_property
    def _names(self) -> tuple[str, ...]:
        if self._published is not None:
            return tuple(sorted({row.label for rows in self._published.values() for row in rows}))
        if self._recording is not None:
            return tuple(sorted({name for found in self._recording.values() for name in found.names}))
        return tuple(sorted({name for file in sorted(self.path.glob("*.npz")) for name in _read_labels(file)}))

    def fingerprint(self) -> str:
        seen = [(state.st_ino, state.st_size, state.st_mtime_ns) for state in map(Path.stat, self._files)]
        if self._hashed[0] != seen:
            # Asked for each name of each frame: to look at all files of a folder takes longer than an answer.
            self._hashed = seen, ":".join(f"{path.resolve().name}:{contents_hash(path)}" for path in self._files)
        return f"recorded:{self._hashed[1]}:{self.min_score}" + ("" if self.made_by is None else f"<{self.made_by}")

    def assumed(self) -> list[str]:
        """Assumptions so far, a sentence each: scores that the file lacks, and names that it has cut."""
        missing, every = self.scoreless
        told = [f"{missing} of {every} detections have no score in the file: 1 is taken"] if missing else []
        told += [] if self._published is None else self._published.assumed
        cut = ((name, " and ".join(map(repr, pieces))) for name, pieces in self.cut.items())
        return told + [f"{name!r} is written {w} in the file, cut within a word, and found by that" for name, w in cut]

    def detect(self, frame: Frame, labels: Sequence[str] | None) -> Proposals:
        playback = self._of_frame(frame)
        key = None if labels is None else tuple(labels)
        return playback.answers.get(key, lambda: self._answer(frame, playback, key))

    def _answer(self, frame: Frame, playback: Playback, labels: tuple[str, ...] | None) -> Proposals:
        keep = playback.found.scores >= self.min_score
        if labels is not None:
            wanted = [name for label in labels for name in self._meant(label)]
            keep &= np.isin(playback.names, wanted)
        index = np.flatnonzero(keep)
        if not len(index):
            return no_proposals(frame.height, frame.width)
        index = _each_thing_once(index, playback.found)
        # Best first, as `top_k` wants them.
        return playback.proposals(index[np.argsort(-playback.found.scores[index], kind="stable")])

    def _meant(self, label: str) -> tuple[str, ...]:
        """Recorded names meant by a name."""
        meant = self._meanings.get(label)
        if meant is None:
            known, where = self.vocabulary or (), f"the recording {self.path.name}"
            if pieces := tuple(name for name in known if is_cut(name, label)):
                self.cut[label] = pieces
            meant = tuple(dict.fromkeys((*match(label, known, self.synonyms), *pieces)))
            self._meanings[label] = meant = meant or meant_names(label, known, self.synonyms, where)
        return meant

    def _of_frame(self, frame: Frame) -> Playback:
        if self._last is None or not self._last.shows(frame):
            recording = self._recording
            if recording is None and self._published is not None:
                # Of pictures that may be of this frame, the one that fits best.
                fits = {picture: fit(frame.id, picture) for picture in self._published}
                best = [picture for picture, how in fits.items() if how and how == max(fits.values())]
                near = Detections({picture: self._published[picture] for picture in best})
                recording, _ = _of_frames(near, (frame.id,), self.path)
            found = needed(
                self._read_arrays(frame) if recording is None else recording.get(frame.id),
                f"the recording has no detections for frame {frame.id}",
                path=self.path,
                error=FrameUnusable,
            )
            if (found.ids < 0).any():
                found = replace(found, ids=np.arange(len(found.ids)))
            self._last = Playback(frame, found, self.path)
        return self._last

    def _read_arrays(self, frame: Frame) -> FrameDetections | None:
        file = self.path / (frame.id.replace("/", "__") + ".npz")
        missing = f"the recording has no detections for frame {frame.id}"
        require(file.is_file(), missing, path=file, error=FrameUnusable)
        found = _read_npz(file)
        if isinstance(found.masks, np.ndarray) and found.masks.shape[1:] != (frame.height, frame.width):
            raise InputError(
                "recorded masks have another size",
                got=found.masks.shape[1:],
                expected=(frame.height, frame.width),
                path=file,
            )
        return found


def _mask_file(path: Path, name: str, where: str) -> np.ndarray:
    errors = (OSError, ValueError, RuntimeError)  # A NUL in the name, a loop of links.
    with as_input_error(f"{where}: the mask is not a readable file", *errors, got=repr(name), path=path):
        file = (path.parent / name).resolve()
    require(
        file.is_relative_to(path.parent.resolve()),
        f"{where}: the mask lies outside the recording's folder",
        got=name,
        path=path,
    )
    image = read_picture(file) if file.is_file() else None
    if image is None or image.ndim != 2:
        raise InputError(f"{where}: the mask is not a readable one-channel image", path=file)
    return image > 0


def _each_thing_once(index: np.ndarray, found: FrameDetections) -> np.ndarray:
    """Rows of `index` ((M,) int, rising) without repeats of a thing of lower score."""
    ids = found.ids[index]
    if len(np.unique(ids)) == len(ids):
        return index
    order = np.lexsort((index, -found.scores[index], ids))
    first = np.diff(ids[order], prepend=-1) != 0
    return np.sort(index[order[first]])


def _of_frames(found: Detections, ids: Sequence[str], path: Path) -> tuple[dict[str, FrameDetections], list[Picture]]:
    """Published detections by frame, and unmatched pictures; FrameUnusable for an ambiguous picture."""
    names, shared = FrameNames(ids), dict[str, str]()
    frames: dict[str, FrameDetections] = {}
    elsewhere: list[Picture] = []
    for picture, rows in found.items():
        frame_id = names.find(picture)
        if frame_id is None:
            elsewhere.append(picture)
            continue
        several = f"two pictures may be frame {frame_id}; the second is {picture!r}"
        require(frame_id not in frames, several, path=path, error=FrameUnusable)
        frames[frame_id] = as_arrays(rows, shared)
    return frames, elsewhere


def _object(content: Content) -> dict[str, Any]:
    """JSON object; other JSON counts as empty."""
    return content.value if isinstance(content.value, dict) else {}


def _maker(content: dict[str, Any]) -> str | None:
    """Detector named in the recording, or None."""
    maker = content.get(MADE_BY)
    return maker if isinstance(maker, str) and maker else None


def _read_frames(content: dict[str, Any], path: Path) -> dict[str, FrameDetections]:
    frames = content.get("frames")
    if not isinstance(frames, dict):
        raise InputError(
            "the recording does not follow the format at the top",
            expected='{"frames": {"<frame id>": [...]}}, or ' + " | ".join(DETECTION_FORMATS),
            path=path,
        )
    reader = TypeAdapter(list[RecordedDetection])
    shared: dict[str, str] = {}
    found: dict[str, FrameDetections] = {}
    for frame_id in list(frames):
        # What was read goes, frame by frame, so that both forms never stand side by side.
        wrong = "the recording does not follow the format at {}"
        entries = checked(reader.validate_python, frames.pop(frame_id), wrong, path, inside=("frames", frame_id))
        found[frame_id] = as_arrays(entries, shared)
    return found


def as_arrays(entries: Sequence[RecordedDetection], shared: dict[str, str]) -> FrameDetections:
    """Detections as arrays, sharing equal names over frames and equal masks within a frame."""
    codes: dict[MaskCode | None, MaskCode | None] = {}
    with np.errstate(over="ignore"):  # What becomes infinite is refused where it is asked for.
        boxes = np.array([e.bbox for e in entries], np.float32)
    return FrameDetections(
        boxes.reshape(-1, 4),
        np.array([e.score for e in entries], np.float32),
        tuple(shared.setdefault(e.label, e.label) for e in entries),
        np.array([-1 if e.id is None else e.id for e in entries], np.int64),
        [codes.setdefault(e.mask, e.mask) for e in entries],
    )


def _read_labels(file: Path) -> list[str]:
    """Class names of a file, without decoding masks."""
    try:
        with opened_arrays(file) as data:
            return checked_texts(np.asarray(data["labels"])).ravel().tolist()
    except Exception:  # Whatever is wrong with the file is said in full where its detections are read.
        return []


_ARRAYS = "arrays boxes, scores, labels and, optionally, masks or mask_counts with mask_size, and ids"


def _read_npz(file: Path) -> FrameDetections:
    # Damaged bytes fail in zipfile, zlib or NumPy, each with its own class.
    with (
        as_input_error(
            "not a recording of detections",
            Exception,
            got=lambda e: first_line(e) or type(e).__name__,
            expected=_ARRAYS,
            path=file,
        ),
        opened_arrays(file) as data,
    ):
        boxes = np.asarray(data["boxes"], np.float32)
        scores = np.asarray(data["scores"], np.float32)
        labels = checked_texts(np.asarray(data["labels"]))
        ids = np.asarray(data["ids"], np.int64) if "ids" in data else np.arange(len(scores))
        masks = np.asarray(data["masks"]).astype(np.bool_) if "masks" in data else None
        counts = checked_texts(np.asarray(data["mask_counts"])) if "mask_counts" in data else None
        size = np.zeros(2, np.int64) if counts is None else np.asarray(data["mask_size"], np.int64)
    if boxes.size == 0:
        boxes = boxes.reshape(0, 4)
    flat = all(a.ndim == 1 for a in (scores, labels, ids, *([] if counts is None else [counts])))
    require(
        boxes.shape[1:] == (4,) and flat and size.shape == (2,),
        "the arrays of a recording have the wrong shape",
        got=f"boxes {boxes.shape}, scores {scores.shape}, labels {labels.shape}, ids {ids.shape}",
        expected="(N, 4), (N,), (N,), (N,), and mask_counts (N,) with mask_size (2,)",
        path=file,
    )
    codes: Sequence[MaskCode | None] | np.ndarray = [None] * len(scores)
    if masks is not None:
        codes = masks
    elif counts is not None:
        shape = (int(size[0]), int(size[1]))
        codes = [RunLength(shape, code) if code else None for code in counts.tolist()]
    require(
        len(boxes) == len(scores) == len(labels) == len(ids) == len(codes),
        "the arrays of a recording differ in length",
        path=file,
    )
    return FrameDetections(boxes, scores, tuple(labels.tolist()), ids, codes)
