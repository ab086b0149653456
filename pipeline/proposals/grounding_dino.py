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
from typing import Any

import numpy as np
import xxhash

from pipeline.geometry.frame import Frame
from pipeline.proposals.base import NMS_IOU, Proposals
from pipeline.proposals.contracts import GROUNDING_DINO_CONTRACTS, grounding_dino_tensors
from pipeline.proposals.mismatch import fitting
from pipeline.proposals.network import (
    IMAGENET_MEAN,
    IMAGENET_STD,
    MAX_PER_NAME,
    TOKENIZER,
    TextDetector,
    normalised,
    pillow_resized,
    plain_name,
    proposals_of,
    shortest_edge,
    sigmoid,
    to_pixels,
)
from pipeline.system.errors import require
from pipeline.system.frozen import dataclass
from pipeline.system.onnx_session import run_session

MAX_TOKENS = 256
SPECIAL = {"[CLS]": 101, "[SEP]": 102, ".": 1012, "?": 1029}
"""The tokens that part a caption, by the numbers that the network has built in."""
_CLS, _SEP, _STOP = 101, 102, 1012

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


@dataclass(frozen=True)
class Caption:
    """Caption of a single run."""

    text: str
    ids: np.ndarray  # (S,) int64: Tokens, with those that begin and end the text
    names: np.ndarray  # (N,) int64: Which of the names asked for, in their order in the text
    spans: np.ndarray  # (N, 2) int64: The first token of each name, and the one after its last


def check_bert(tokenizer: Any, path: Path) -> None:
    """Raise InputError unless token numbers are those of uncased BERT, as in GroundingDINO."""
    found = {token: tokenizer.token_to_id(token) for token in SPECIAL}
    require(
        found == SPECIAL,
        "the tokenizer is not the one of GroundingDINO",
        got=", ".join(f"{t} = {n}" for t, n in found.items()),
        expected=", ".join(f"{t} = {n}" for t, n in SPECIAL.items()),
        cause="it must be that of bert-base-uncased",
        path=path,
    )
    require(
        tokenizer.token_to_id("[UNK]") is not None,
        "the tokenizer has no token for unknown words",
        expected="[UNK]",
        path=path,
    )


def build_captions(names: Sequence[str], tokenizer: Any, limit: int = MAX_TOKENS) -> list[Caption]:
    """Fewest captions holding all names in order, at most `limit` tokens each; names are never cut. Names that read the
    same stand in a caption once, for the first of them."""
    groups: list[list[tuple[int, str, list[int]]]] = [[]]
    length = 2
    seen: set[str] = set()
    for number, name in enumerate(names):
        plain = plain_name(name)
        if plain in seen:
            continue
        seen.add(plain)
        tokens = _tokens(name, plain, tokenizer, limit)
        if length + len(tokens) + 1 > limit:
            groups.append([])
            length = 2
        groups[-1].append((number, plain, tokens))
        length += len(tokens) + 1
    return [_caption(group) for group in groups if group]


def _tokens(name: str, plain: str, tokenizer: Any, limit: int) -> list[int]:
    require(plain, "a name has no words that can be looked for", got=repr(name[:60]))
    tokens = tokenizer.encode(plain, add_special_tokens=False).ids
    unknown = tokenizer.token_to_id("[UNK]")
    require(
        tokens and not all(t == unknown for t in tokens),
        "the model's tokenizer knows no word of a name",
        got=repr(name[:60]),
    )
    require(not set(tokens) & set(SPECIAL.values()), "a name holds a mark that parts names", got=repr(name[:60]))
    require(
        len(tokens) + 3 <= limit,
        "a name is too long for the model",
        got=f"{len(tokens)} tokens in {name[:40]!r}",
        expected=f"at most {limit - 3}",
    )
    return tokens


def _caption(group: list[tuple[int, str, list[int]]]) -> Caption:
    ids = [_CLS]
    spans = []
    for _, _, tokens in group:
        spans.append((len(ids), len(ids) + len(tokens)))
        ids += [*tokens, _STOP]
    return Caption(
        ". ".join(plain for _, plain, _ in group) + ".",
        np.array([*ids, _SEP], np.int64),
        np.array([number for number, _, _ in group], np.int64),
        np.array(spans, np.int64),
    )


def token_blocks(ids: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Attention mask and positions of tokens: each name separately, with the following stop.

    As `generate_masks_with_special_tokens_and_transfer_map` of IDEA-Research/GroundingDINO (bertwarper.py): a block
    ends with its special token, which belongs to it; the first and the last token, and those behind the last special
    one, attend to themselves.

    `ids` (S,) int64; `positions` (S,) int64: Counted from 0 in each block.
    """
    special = np.isin(ids, list(SPECIAL.values()))
    block = np.cumsum(special) - special
    last = len(ids) - 1
    closed = np.append(np.flatnonzero(special), len(ids))[block]
    inside = (closed > 0) & (closed < last)
    mask = (block[:, None] == block[None, :]) & inside[:, None]
    np.fill_diagonal(mask, True)
    begins = np.append(0, np.flatnonzero(special) + 1)[block]
    return mask, np.where(inside, np.arange(len(ids)) - begins, 0)


def span_scores(probabilities: np.ndarray, spans: np.ndarray) -> np.ndarray:
    """(Q, N): the greatest probability of each name's tokens, of (Q, S) probabilities and (N, 2) spans."""
    edges = spans.reshape(-1)
    # Each name is followed by its stop, so that the maxima between spans are those of single tokens, left out.
    return np.maximum.reduceat(probabilities, edges, axis=1)[:, ::2]
