"""Base of network detectors: model file, cached inference, class names, box conversion.

Pictures become the tensors that networks were trained on, resized by the very algorithms of their reference code.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from pipeline.geometry.frame import Frame
from pipeline.language.naming import Synonyms
from pipeline.proposals.base import Proposals, class_wise
from pipeline.proposals.class_names import synonyms_hash, wanted_names
from pipeline.system.errors import InputError, as_input_error, extra_module, first_line, require
from pipeline.system.onnx_session import file_hash, model_hash, open_session
from pipeline.system.recent import Recent
from pipeline.system.safe_files import checked_path

MAX_PER_NAME = 100
TOKENIZER = "tokenizer.json"
Made = TypeVar("Made")


class NetworkDetector:
    """An ONNX object detector on pictures."""

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
        """Result computed a single time per picture."""
        return self._last.get(frame.content_hash, lambda: make(frame))

    def _wanted(self, labels: Sequence[str] | None) -> list[str]:
        """Names of the vocabulary meant by a query."""
        return wanted_names(labels, self.vocabulary or (), self.synonyms, f"the model {self.path.name}")

    def _best(self, scores: np.ndarray, wanted: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
        """The score (N,) and the index in `wanted` (N,) of each row's best class, of (N, C) scores of all classes.
        Vocabularies such as that of LVIS hold names twice. Where nothing is wanted, scores are below 0."""
        index_of = {name: k for k, name in enumerate(wanted)}
        columns = [c for c, name in enumerate(self.vocabulary or ()) if name in index_of]
        if not columns:
            return np.full(len(scores), -1, np.float32), np.zeros(len(scores), np.int64)
        scores = scores[:, columns]
        which = np.array([index_of[(self.vocabulary or ())[c]] for c in columns], np.int64)
        return scores.max(axis=1), which[scores.argmax(axis=1)]


class TextDetector(NetworkDetector):
    """An open-vocabulary network with a tokenizer."""

    def __init__(
        self, path: str | Path, min_score: float | None, default_labels: Sequence[str], nms_iou: float, k: int
    ) -> None:
        super().__init__(path, min_score)
        self.default_labels = tuple(default_labels) or None
        self.nms_iou, self.k = nms_iou, k
        self._inputs = {i.name: tuple(i.shape) for i in self._session.get_inputs()}

    def _read_tokenizer(self, given: str | Path | None, patterns: Sequence[str] = (TOKENIZER,)) -> Any:
        """Given tokenizer, or the file next to the model."""
        self.tokenizer_path = Path(given) if given is not None else find_tokenizer(self.path, patterns)
        return load_tokenizer(self.tokenizer_path)

    @cached_property
    def _hash(self) -> str:
        return f"{model_hash(self.path)}:{file_hash(self.tokenizer_path)}"

    def _asked(self, labels: Sequence[str] | None, also_none: bool = False) -> tuple[str, ...] | None:
        """Names to look for; InputError without any, unless allowed."""
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
        """Best `k` of each name after non-maximum suppression, best first."""
        kept = class_wise(boxes, scores, names, self.k, nms_iou=self.nms_iou)
        return proposals_of(boxes[kept], scores[kept], names[kept], labels, ids[kept])


def to_pixels(relative: np.ndarray, width: float, height: float, frame: Frame) -> np.ndarray:
    """Boxes (N, 4) float32 x0, y0, x1, y1 in pixels of the frame, clipped.

    `relative` (N, 4) float: Centre and size as shares of what the network saw, as DETR-like networks give them;
    `width, height`: the size of that in pixels of the frame: the frame itself, or the square it was padded to.
    """
    center, size = relative[:, :2].astype(np.float64), np.maximum(relative[:, 2:].astype(np.float64), 0)
    boxes = np.concatenate([center - size / 2, center + size / 2], axis=1) * [width, height, width, height]
    return np.clip(boxes, 0, [frame.width, frame.height] * 2).astype(np.float32)


def inside(boxes: np.ndarray) -> np.ndarray:
    """Clipped boxes ((N, 4)) with area in the picture, (N,) bool."""
    return (boxes[:, 2] > boxes[:, 0]) & (boxes[:, 3] > boxes[:, 1])


def proposals_of(
    boxes: np.ndarray, scores: np.ndarray, names: np.ndarray, labels: Sequence[str], ids: np.ndarray
) -> Proposals:
    """Proposals without masks, for boxes with area in the picture."""
    seen = inside(boxes)
    return Proposals(
        boxes[seen].astype(np.float32),
        np.clip(scores[seen], 0, 1).astype(np.float32),
        names[seen].astype(np.int64),
        tuple(labels),
        None,
        ids[seen].astype(np.int64),
    )


IMAGENET_MEAN = np.array([0.485, 0.456, 0.406], np.float32)
IMAGENET_STD = np.array([0.229, 0.224, 0.225], np.float32)
CLIP_MEAN = np.array([0.48145466, 0.4578275, 0.40821073], np.float32)
CLIP_STD = np.array([0.26862954, 0.26130258, 0.27577711], np.float32)


def pillow_resized(rgb: np.ndarray, height: int, width: int, *, cubic: bool = False) -> np.ndarray:
    """Resize (height, width, 3) uint8 as Pillow does, with a wider filter for downscaling. OpenCV's bilinear filter
    skips pixels there, and its cubic filter has another coefficient (-0.75, not -0.5)."""
    from PIL import Image

    resample = Image.Resampling.BICUBIC if cubic else Image.Resampling.BILINEAR
    return np.asarray(Image.fromarray(rgb).resize((width, height), resample))


def shortest_edge(height: int, width: int, shortest: int = 800, longest: int = 1333) -> tuple[int, int]:
    """Height and width with the shorter side `shortest`, and the longer at most `longest`.

    The roundings are those of `get_size_with_aspect_ratio` in transformers and in IDEA-Research/GroundingDINO; a side
    that they round to nothing is 1.
    """
    low, high = min(height, width), max(height, width)
    exact = longest * low / high if high / low * shortest > longest else float(shortest)
    short = round(exact)
    if low == short:
        return height, width
    short, long = max(short, 1), max(int(exact * high / low), 1)
    return (long, short) if width < height else (short, long)


def normalised(image: np.ndarray, mean: np.ndarray, std: np.ndarray) -> np.ndarray:
    """(1, 3, H, W) float32 of (H, W, 3) uint8, or of float32 in 0..1."""
    values = image.astype(np.float32) * np.float32(1 / 255) if image.dtype == np.uint8 else image
    return np.ascontiguousarray(((values - mean) / std).transpose(2, 0, 1)[None], dtype=np.float32)


def padded_square(rgb: np.ndarray, side: int, fill: float = 0.0) -> np.ndarray:
    """Picture in the top left of a square of the longer side, resized: (side, side, 3) float32 in 0..1.

    The algorithm of OWLv2's reference code, which is that of `skimage.transform.resize`: a Gaussian of
    sigma (factor - 1) / 2 where the picture shrinks, then linear interpolation between pixel centres with mirrored
    edges, then clipped to the values that were there.

    `rgb` (H, W, 3) uint8; `fill`: what the padding is made of, 0..1.
    """
    from scipy.ndimage import gaussian_filter

    longest = max(rgb.shape[:2])
    square = np.full((longest, longest, 3), fill, np.float32)
    square[: rgb.shape[0], : rgb.shape[1]] = rgb.astype(np.float32) * np.float32(1 / 255)
    low, high = square.min(), square.max()
    sigma = max(0.0, (longest / side - 1) / 2)
    if sigma:
        square = gaussian_filter(square, (sigma, sigma, 0), mode="mirror")
    position = (np.arange(side) + 0.5) * longest / side - 0.5
    before = np.floor(position).astype(np.int64)
    share = (position - before).astype(np.float32)
    first, second = _mirrored(before, longest), _mirrored(before + 1, longest)
    rows = square[first] * (1 - share)[:, None, None] + square[second] * share[:, None, None]
    return np.clip(rows[:, first] * (1 - share)[:, None] + rows[:, second] * share[:, None], low, high)


def _mirrored(index: np.ndarray, size: int) -> np.ndarray:
    """Indices just outside 0..size-1 reflected about the centre of the edge pixel."""
    return np.clip(np.where(index < 0, -index, np.where(index >= size, 2 * (size - 1) - index, index)), 0, size - 1)


_SEPARATORS = re.compile(r"[.?]")
_GAPS = re.compile(r"[\s_]+")


def plain_name(name: str) -> str:
    """Class name as in captions: lower case, no separators (`T.V._stand` becomes `tv stand`)."""
    return _GAPS.sub(" ", _SEPARATORS.sub("", name)).strip().lower()


def sigmoid(logits: np.ndarray) -> np.ndarray:
    """1 / (1 + exp(-x)) in float32 for any x, the infinities included."""
    # Beyond 88 the exponential of float32 is infinite.
    return (0.5 * (1 + np.tanh(np.clip(logits.astype(np.float64), -80, 80) / 2))).astype(np.float32)


def find_tokenizer(model: Path, patterns: Sequence[str] = (TOKENIZER,)) -> Path:
    """Tokenizer file in the model's folder or the parent folder, as on model hubs."""
    for folder in (model.parent, model.resolve().parent.parent):
        for pattern in patterns:
            found = sorted(p for p in folder.glob(pattern) if p.is_file())
            if len(found) > 1:
                names = ", ".join(p.name for p in found[:4])
                raise InputError("several tokenizers stand beside the model", got=names, expected="one", path=folder)
            if found:
                return found[0]
    raise InputError(
        "there is no tokenizer for the model",
        expected=f"{' or '.join(patterns)} in its folder or the one above",
        cause="it is published with the model",
        path=model,
    )


def load_tokenizer(path: Path) -> Any:
    """Load a `tokenizers.Tokenizer` without padding, truncation and special tokens in text."""
    tokenizers = extra_module("tokenizers", "a detector that reads text", "hub")
    require(path.is_file(), "there is no tokenizer file", path=path)
    # The library raises bare Exceptions.
    with as_input_error("the tokenizer cannot be read", Exception, got=first_line, path=path):
        file = checked_path(path, "text")
        tokenizer = _word_pieces(file) if file.suffix == ".txt" else tokenizers.Tokenizer.from_file(str(file))
    tokenizer.no_padding()
    tokenizer.no_truncation()
    # A class name "[SEP]" must not end the sentence.
    tokenizer.encode_special_tokens = True
    return tokenizer


def _word_pieces(path: Path) -> Any:
    from tokenizers import Tokenizer, models, normalizers, pre_tokenizers

    tokenizer = Tokenizer(models.WordPiece.from_file(str(path), unk_token="[UNK]"))
    tokenizer.normalizer = normalizers.BertNormalizer(lowercase=True)
    tokenizer.pre_tokenizer = pre_tokenizers.BertPreTokenizer()
    return tokenizer
