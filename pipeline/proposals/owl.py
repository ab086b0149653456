"""OWLv2 and OWL-ViT by ONNX Runtime, as exported by transformers.js and optimum: objects by any names.

The two differ in how they see a picture. OWL-ViT has it squashed to a square, so its boxes are shares of the
picture's width and height. OWLv2 has it padded to a square below or to the right, so its boxes are shares of the
longer side, on both axes.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.geometry.frame import Frame
from pipeline.proposals.base import NMS_IOU, Proposals
from pipeline.proposals.contracts import OWL_CONTRACTS, SIDES, TOKENS, Kind, owl_tensors
from pipeline.proposals.mismatch import fitting
from pipeline.proposals.network import (
    CLIP_MEAN,
    CLIP_STD,
    MAX_PER_NAME,
    TextDetector,
    inside,
    normalised,
    padded_square,
    pillow_resized,
    plain_name,
    proposals_of,
    sigmoid,
    to_pixels,
)
from pipeline.system.errors import InputError, require
from pipeline.system.onnx_session import run_session

BEGIN, END = "<|startoftext|>", "<|endoftext|>"
PAD = 0
MAX_QUERIES = 256
"""Names that are asked for in one run at most."""
PROMPT = "a photo of a {}"
MIN_SCORE = 0.1
"""That of the reference code."""


class OwlDetector(TextDetector):
    """OWLv2 or OWL-ViT for any names."""

    default_score = MIN_SCORE

    def __init__(
        self,
        path: str | Path,
        kind: Kind = "owlv2",
        *,
        tokenizer: str | Path | None = None,
        min_score: float | None = None,
        default_labels: Sequence[str] = (),
        prompt: str = PROMPT,
        fill: float = 0.0,
        nms_iou: float = NMS_IOU,
        k: int = MAX_PER_NAME,
    ) -> None:
        super().__init__(path, min_score, default_labels, nms_iou, k)
        self.name, self.prompt, self.fill = kind, prompt, fill
        self._outputs = _check_contract(self._session, kind, self.path)
        self._tokenizer = self._read_tokenizer(tokenizer)
        self._begin, self._end = _marks(self._tokenizer, self.tokenizer_path)

    def fingerprint(self) -> str:
        return f"{self.name}:{self._hash}:{self.min_score}:{self.prompt}:{self.fill}:{self.nms_iou}:{self.k}"

    def detect(self, frame: Frame, labels: Sequence[str] | None) -> Proposals:
        """Detections of the given names, best first; `ids` are patches."""
        names = self._asked(labels, also_none="objectness_logits" in self._outputs)
        if names is None:
            return self._objects(frame)
        plain = [plain_name(n) for n in names]
        return self._found(frame, names, [self.prompt.format(p) if p else "" for p in plain])

    def detect_expression(self, frame: Frame, text: str) -> Proposals:
        """Detections of a whole sentence (referring baseline)."""
        return self._found(frame, (text,), [text.strip().lower()])

    def _found(self, frame: Frame, names: tuple[str, ...], prompts: list[str]) -> Proposals:
        if not names:
            return proposals_of(np.zeros((0, 4)), np.zeros(0), np.zeros(0), names, np.zeros(0))
        rows = np.stack([self._tokens(n, p) for n, p in zip(names, prompts, strict=True)])
        logits, relative = self._run(frame, rows)
        scores = sigmoid(logits.max(axis=1))
        return self._of_patches(frame, relative, scores, logits.argmax(axis=1), names)

    def _objects(self, frame: Frame) -> Proposals:
        _, relative, objectness = self._run_once(frame, self._tokens("object", self.prompt.format("object"))[None])
        scores = sigmoid(objectness[0])
        return self._of_patches(frame, relative[0], scores, np.zeros(len(scores), np.int64), ("object",))

    def _of_patches(
        self, frame: Frame, relative: np.ndarray, scores: np.ndarray, names: np.ndarray, labels: tuple[str, ...]
    ) -> Proposals:
        patches = np.flatnonzero(scores > self.min_score)
        longer = max(frame.height, frame.width)
        width, height = (longer, longer) if self.name == "owlv2" else (frame.width, frame.height)
        boxes = to_pixels(relative[patches], width, height, frame)
        # A box in the padding is no rival of one in the picture.
        seen = inside(boxes)
        patches = patches[seen]
        return self._chosen(boxes[seen], scores[patches], names[patches], labels, patches)

    def _run(self, frame: Frame, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Logits (Q, L) of all rows (L, S) of tokens, a batch after another, and boxes (Q, 4)."""
        fixed = self._inputs["input_ids"][0]
        batch = fixed if isinstance(fixed, int) else min(MAX_QUERIES, len(rows))
        logits, relative = [], np.zeros((1, 0, 4), np.float32)
        for start in range(0, len(rows), batch):
            part = rows[start : start + batch]
            missing = batch - len(part) if isinstance(fixed, int) else 0
            # An empty row would be a text without an end; a name asked twice does no harm.
            filled = np.concatenate([part, np.repeat(part[:1], missing, axis=0)])
            found, relative, *_ = self._run_once(frame, filled)
            logits.append(found[0][:, : len(part)])
        return np.concatenate(logits, axis=1), relative[0]

    def _run_once(self, frame: Frame, rows: np.ndarray) -> list[np.ndarray]:
        # The end's number is the greatest, which is how the text tower itself finds it.
        ends = rows.argmax(axis=1)
        feed = {
            "input_ids": rows,
            "pixel_values": self._once(frame, self._tensor),
            "attention_mask": np.arange(rows.shape[1])[None, :] <= ends[:, None],
        }
        outputs = run_session(self._session, self._outputs, {n: feed[n] for n in self._inputs}, self.path)
        logits, relative = outputs[:2]
        require(
            logits.ndim == 3 and relative.shape == (1, logits.shape[1], 4) and logits.shape[::2] == (1, len(rows)),
            "the model's outputs do not fit what was asked",
            got=f"logits {list(logits.shape)}, boxes {list(relative.shape)} for {len(rows)} names",
            expected="logits [1, Q, L], boxes [1, Q, 4]",
            path=self.path,
        )
        return outputs

    def _tokens(self, name: str, prompt: str) -> np.ndarray:
        """(S,) int64: the marked tokens of a text, padded."""
        declared = self._inputs["input_ids"][1]
        size = declared if isinstance(declared, int) else TOKENS
        require(prompt, "a name has no words that can be looked for", got=repr(name[:60]))
        ids = [self._begin, *self._tokenizer.encode(prompt, add_special_tokens=False).ids, self._end]
        require(
            len(ids) <= size,
            "a text is too long for the model",
            got=f"{len(ids)} tokens of {prompt[:60]!r}",
            expected=f"at most {size}",
        )
        return np.array(ids + [PAD] * (size - len(ids)), np.int64)

    def _tensor(self, frame: Frame) -> np.ndarray:
        sides = [s if isinstance(s, int) else SIDES[self.name] for s in self._inputs["pixel_values"][2:]]
        if self.name == "owlv2":
            image = padded_square(frame.rgb, sides[0], self.fill)
        else:
            image = pillow_resized(frame.rgb, sides[0], sides[1], cubic=True)
        return normalised(image, CLIP_MEAN, CLIP_STD)


def _marks(tokenizer: Any, path: Path) -> tuple[int, int]:
    """Token numbers of the begin and end marks."""
    begin, end = tokenizer.token_to_id(BEGIN), tokenizer.token_to_id(END)
    require(
        None not in (begin, end) and end == tokenizer.get_vocab_size() - 1,
        "the tokenizer is not CLIP's",
        got=f"{BEGIN} = {begin}, {END} = {end} of {tokenizer.get_vocab_size()} tokens",
        expected="both, the last of them the very last token",
        path=path,
    )
    return begin, end


def _check_contract(session: Any, kind: Kind, path: Path) -> list[str]:
    found = owl_tensors(session)
    sides = {side for i in session.get_inputs() if i.name == "pixel_values" for side in i.shape[2:]}
    other = next((k for k, side in SIDES.items() if k != kind and side in sides), None)
    if found is not None and other is not None:
        # It would run, and its boxes would lie wrong in every picture that is no square.
        raise InputError(
            f"the ONNX file is not an {kind} model",
            got=f"a picture of {SIDES[other]} x {SIDES[other]}",
            expected=f"{SIDES[kind]} x {SIDES[kind]}, or another size",
            cause=f"this is {other}'s: use --detector {other}",
            path=path,
        )
    own = [c for c in OWL_CONTRACTS if c.option.endswith(kind)]
    return fitting(found, f"an {kind} model", session, path, own)
