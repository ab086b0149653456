"""What detectors that are networks share: their file, one run for a picture, their names, and how boxes come out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from pipeline.geometry.frame import Frame
from pipeline.language.naming import Synonyms
from pipeline.proposals.base import Proposals
from pipeline.proposals.captions import TOKENIZER, find_tokenizer, load_tokenizer
from pipeline.proposals.class_names import synonyms_hash, wanted_names
from pipeline.proposals.selection import class_wise
from pipeline.system.errors import require
from pipeline.system.onnx_session import file_hash, model_hash, open_session
from pipeline.system.recent import Recent

MAX_PER_NAME = 100
Made = TypeVar("Made")


class NetworkDetector:
    """An ONNX file that finds objects in the picture alone.

    Parameters
    ----------
    path : Path
        The ONNX file.
    min_score : float, optional
        Detections below it are dropped; by default those below `default_score`.
    synonyms : Synonyms, optional
        Of a network with a vocabulary of its own.

    Raises
    ------
    InputError
        Where the file is missing or no ONNX model.
    """

    name: str
    vocabulary: tuple[str, ...] | None = None
    default_score = 0.0
    exact = False
    reads_annotations = False

    def __init__(self, path: str | Path, min_score: float | None, synonyms: Synonyms | None = None) -> None:
        self.path, self.synonyms = Path(path), synonyms
        self.min_score = self.default_score if min_score is None else min_score
        self._session = open_session(self.path)
        self._last: Recent[str, Any] = Recent(1)

    @cached_property
    def _hash(self) -> str:
        return model_hash(self.path)

    @cached_property
    def _synonyms_hash(self) -> str:
        return synonyms_hash(self.synonyms)

    def _once(self, frame: Frame, make: Callable[[Frame], Made]) -> Made:
        """What is made once for a picture, however many names are asked for in turn."""
        return self._last.get(frame.content_hash, lambda: make(frame))

    def _wanted(self, labels: Sequence[str] | None) -> list[str]:
        """The names of the vocabulary that a query means; raises as `wanted_names`."""
        return wanted_names(labels, self.vocabulary or (), self.synonyms, f"the model {self.path.name}")

    def _best(self, scores: np.ndarray, wanted: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
        """The score (N,) and the place in `wanted` (N,) of each row's best class, of (N, C) scores of all classes.

        Vocabularies such as that of LVIS hold names twice. Where nothing is wanted, scores are below 0.
        """
        place = {name: k for k, name in enumerate(wanted)}
        columns = [c for c, name in enumerate(self.vocabulary or ()) if name in place]
        if not columns:
            return np.full(len(scores), -1, np.float32), np.zeros(len(scores), np.int64)
        scores = scores[:, columns]
        which = np.array([place[(self.vocabulary or ())[c]] for c in columns], np.int64)
        return scores.max(axis=1), which[scores.argmax(axis=1)]


class TextDetector(NetworkDetector):
    """A network that is asked for any names, with its tokenizer.

    Parameters
    ----------
    default_labels : sequence of str
        What is looked for where no names are asked for.
    nms_iou : float
        Overlap above which the weaker of two boxes of one name goes; 1 keeps all.
    k : int
        Detections of each name that are kept at most.
    """

    def __init__(
        self, path: str | Path, min_score: float | None, default_labels: Sequence[str], nms_iou: float, k: int
    ) -> None:
        super().__init__(path, min_score)
        self.default_labels = tuple(default_labels) or None
        self.nms_iou, self.k = nms_iou, k
        self._inputs = {i.name: tuple(i.shape) for i in self._session.get_inputs()}

    def _read_tokenizer(self, given: str | Path | None, patterns: Sequence[str] = (TOKENIZER,)) -> Any:
        """The tokenizer that was given, or the one beside the model; raises as the functions that read it."""
        self.tokenizer_path = Path(given) if given is not None else find_tokenizer(self.path, patterns)
        return load_tokenizer(self.tokenizer_path)

    @cached_property
    def _hash(self) -> str:
        return f"{model_hash(self.path)}:{file_hash(self.tokenizer_path)}"

    def _asked(self, labels: Sequence[str] | None, also_none: bool = False) -> tuple[str, ...] | None:
        """The names to look for; InputError where there are none, unless that will do."""
        names = self.default_labels if labels is None else tuple(labels)
        require(
            names is not None or also_none,
            f"{self.name} finds what it is asked for by name",
            expected="class names",
            cause="none were given",
        )
        return names

    def _chosen(
        self, boxes: np.ndarray, scores: np.ndarray, names: np.ndarray, labels: Sequence[str], ids: np.ndarray
    ) -> Proposals:
        """The best `k` of each name after the suppression of rivals, the better first."""
        kept = class_wise(boxes, scores, names, self.k, nms_iou=self.nms_iou)
        return proposals_of(boxes[kept], scores[kept], names[kept], labels, ids[kept])


def to_pixels(relative: np.ndarray, width: float, height: float, frame: Frame) -> np.ndarray:
    """(N, 4) float32 x0, y0, x1, y1 in pixels of the frame, clipped to it.

    Parameters
    ----------
    relative : (N, 4) float
        Centre and size as shares of what the network saw, as DETR-like networks give them.
    width, height : float
        The size of that in pixels of the frame: the frame itself, or the square it was padded to.
    frame : Frame
    """
    center, size = relative[:, :2].astype(np.float64), np.maximum(relative[:, 2:].astype(np.float64), 0)
    boxes = np.concatenate([center - size / 2, center + size / 2], axis=1) * [width, height, width, height]
    return np.clip(boxes, 0, [frame.width, frame.height] * 2).astype(np.float32)


def inside(boxes: np.ndarray) -> np.ndarray:
    """(N,) bool: clipped boxes ((N, 4)) of which something is in the picture."""
    return (boxes[:, 2] > boxes[:, 0]) & (boxes[:, 3] > boxes[:, 1])


def proposals_of(
    boxes: np.ndarray, scores: np.ndarray, names: np.ndarray, labels: Sequence[str], ids: np.ndarray
) -> Proposals:
    """Proposals without masks; boxes with nothing of them in the picture are left out."""
    seen = inside(boxes)
    return Proposals(
        boxes[seen].astype(np.float32),
        np.clip(scores[seen], 0, 1).astype(np.float32),
        names[seen].astype(np.int64),
        tuple(labels),
        None,
        ids[seen].astype(np.int64),
    )
