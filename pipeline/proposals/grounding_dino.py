"""GroundingDINO by ONNX Runtime: objects by any names, or by a whole sentence.

Both public exports are read, told apart by their declared inputs: that of transformers
(onnx-community/grounding-dino-tiny-ONNX) and that of the original code, which wants the tokens' blocks from outside.
A query is kept where its best token is above the box threshold, as in both code bases. Its name is the one whose
own tokens are likeliest: their way of reading a phrase off all tokens above the text threshold gives "cat dog"
where that threshold is low.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import xxhash

from pipeline.geometry.frame import Frame
from pipeline.proposals.base import NMS_IOU, Proposals
from pipeline.proposals.captions import (
    MAX_TOKENS,
    TOKENIZER,
    Caption,
    build_captions,
    check_bert,
    sigmoid,
    span_scores,
    token_blocks,
)
from pipeline.proposals.contracts import GROUNDING_DINO_CONTRACTS, grounding_dino_tensors
from pipeline.proposals.mismatch import fitting
from pipeline.proposals.network import (
    IMAGENET_MEAN,
    IMAGENET_STD,
    MAX_PER_NAME,
    TextDetector,
    normalised,
    pillow_resized,
    proposals_of,
    shortest_edge,
    to_pixels,
)
from pipeline.system.errors import require
from pipeline.system.onnx_session import run_session

TOKENIZERS = (TOKENIZER, "vocab.txt", "*vocab*.txt")
BOX_THRESHOLD, TEXT_THRESHOLD = 0.15, 0.10
"""Those of the paper."""


class GroundingDinoDetector(TextDetector):
    """GroundingDINO for any names."""

    name = "grounding-dino"
    default_score = BOX_THRESHOLD

    def __init__(
        self,
        path: str | Path,
        *,
        tokenizer: str | Path | None = None,
        min_score: float | None = None,
        text_threshold: float = TEXT_THRESHOLD,
        default_labels: Sequence[str] = (),
        nms_iou: float = NMS_IOU,
        k: int = MAX_PER_NAME,
    ) -> None:
        super().__init__(path, min_score, default_labels, nms_iou, k)
        self.text_threshold = text_threshold
        found = grounding_dino_tensors(self._session)
        self._picture, self._outputs = fitting(
            found, "a GroundingDINO model", self._session, self.path, GROUNDING_DINO_CONTRACTS
        )
        self._tokenizer = self._read_tokenizer(tokenizer, TOKENIZERS)
        check_bert(self._tokenizer, self.tokenizer_path)

    def fingerprint(self) -> str:
        return f"grounding-dino:{self._hash}:{self.min_score}:{self.text_threshold}:{self.nms_iou}:{self.k}"

    def detect(self, frame: Frame, labels: Sequence[str] | None) -> Proposals:
        """Detections of the given names, best first; `ids` encode caption and query."""
        names = self._asked(labels) or ()
        found = [self._run(frame, caption) for caption in build_captions(names, self._tokenizer, self._limit)]
        if not found:
            return proposals_of(np.zeros((0, 4)), np.zeros(0), np.zeros(0), names, np.zeros(0))
        boxes, scores, which, ids = (np.concatenate(parts) for parts in zip(*found, strict=True))
        return self._chosen(boxes, scores, which, names, ids)

    def detect_expression(self, frame: Frame, text: str) -> Proposals:
        """Detections of a whole sentence as a phrase (referring baseline)."""
        return self.detect(frame, [text])

    @property
    def _limit(self) -> int:
        declared = self._inputs["input_ids"][-1]
        return min(MAX_TOKENS, declared) if isinstance(declared, int) else MAX_TOKENS

    def _run(self, frame: Frame, caption: Caption) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Boxes (N, 4) in pixels, scores, name numbers, and ids (N,) for a caption."""
        feed = self._feed(frame, caption)
        logits, relative = run_session(self._session, self._outputs, feed, self.path)
        tokens = len(caption.ids)
        require(
            logits.ndim == 3 and relative.shape == (*logits.shape[:2], 4) and logits.shape[2] >= tokens,
            "the model's outputs do not fit one another",
            got=f"logits {list(logits.shape)}, boxes {list(relative.shape)} for {tokens} tokens",
            expected="logits [1, Q, T], boxes [1, Q, 4]",
            path=self.path,
        )
        probabilities = sigmoid(logits[0])
        best = probabilities.max(axis=1)
        by_name = span_scores(probabilities[:, :tokens], caption.spans)
        winner = by_name.argmax(axis=1)
        queries = np.flatnonzero((best > self.min_score) & (by_name.max(axis=1) > self.text_threshold))
        boxes = to_pixels(relative[0][queries], frame.width, frame.height, frame)
        # 37 and 16 bits: so many are whole numbers to every reader of JSON.
        run = xxhash.xxh3_64_intdigest(caption.text.encode()) >> 27
        return boxes, best[queries], caption.names[winner[queries]], (run << 16) + queries

    def _feed(self, frame: Frame, caption: Caption) -> dict[str, np.ndarray]:
        size = self._inputs["input_ids"][-1]
        tokens = len(caption.ids)
        ids = np.zeros(size if isinstance(size, int) else tokens, np.int64)
        ids[:tokens] = caption.ids
        mask, positions = token_blocks(ids)
        pixels = self._once(frame, self._tensor)
        values = {
            self._picture: pixels,
            "input_ids": ids[None],
            "token_type_ids": np.zeros((1, len(ids)), np.int64),
            "attention_mask": (np.arange(len(ids)) < tokens)[None],
            "pixel_mask": np.ones((1, *pixels.shape[2:]), np.bool_),
            "position_ids": positions[None],
            "text_token_mask": mask[None],
        }
        return {name: values[name] for name in self._inputs}

    def _tensor(self, frame: Frame) -> np.ndarray:
        free = shortest_edge(frame.height, frame.width)
        declared = self._inputs[self._picture][2:]
        height, width = (d if isinstance(d, int) else f for d, f in zip(declared, free, strict=True))
        return normalised(pillow_resized(frame.rgb, height, width), IMAGENET_MEAN, IMAGENET_STD)
