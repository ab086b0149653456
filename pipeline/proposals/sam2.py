"""SAM 2: the exports of samexporter, of osam and of transformers.js.

A picture is squashed to the encoder's square, divided by 255 and normalised by
the ImageNet mean and deviation. A box is two points with the labels 2 and 3
(the graph adds the padding point), or a box of its own in the transformers.js
export. Masks are those of the best predicted IoU, 256x256, and scaled to the
picture as they are.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pipeline.proposals.contracts import SAM2_DECODERS, SAM2_ENCODERS, SAM2_OPTION
from pipeline.proposals.model_pair import open_pair
from pipeline.proposals.prompted import best_mask, corners, resampled, stretched
from pipeline.system.errors import InputError

VERSION = "1"
SIDE = 1024
MEAN = np.array([0.485, 0.456, 0.406], np.float32)
STD = np.array([0.229, 0.224, 0.225], np.float32)
AT_ONCE = 8
"""Boxes in a run; each takes some 30 MB in the decoder."""


class Sam2Model:
    """SAM 2 and 2.1.

    Parameters
    ----------
    paths : sequence of Path
        Encoder and decoder.

    Raises
    ------
    InputError
        The files are not of this kind.
    """

    name = "sam2"

    def __init__(self, paths: Sequence[Path]) -> None:
        self.pair = open_pair(SAM2_OPTION, paths, SAM2_ENCODERS, SAM2_DECODERS)
        (spec,) = self.pair.encoder_inputs.values()
        height, width = spec.shape[2:]
        self._side = height if isinstance(height, int) else width if isinstance(width, int) else SIDE
        if self._side % 32:
            raise InputError(
                "the encoder takes squares of another side than SAM 2",
                got=self._side,
                expected=SIDE,
                cause="a side of 1008 is SAM 3's, which is normalised otherwise and not read",
                path=self.pair.encoder_path,
            )
        self._takes_boxes = "input_boxes" in self.pair.decoder_inputs
        many = self.pair.decoder_inputs["input_points" if self._takes_boxes else "point_coords"]
        free = isinstance(many.shape[1 if self._takes_boxes else 0], str)
        if self._takes_boxes:
            free &= isinstance(self.pair.decoder_inputs["input_boxes"].shape[1], str)
        self._at_once = AT_ONCE if free else 1

    def fingerprint(self) -> str:
        return f"sam2:{VERSION}:{self.pair.content_hash}"

    def encode(self, rgb: np.ndarray) -> dict[str, np.ndarray]:
        image = resampled(rgb, self._side, self._side).astype(np.float32) / np.float32(255)
        return self.pair.encode(np.ascontiguousarray(((image - MEAN) / STD).transpose(2, 0, 1)[None]))

    def boxes_at_once(self, height: int, width: int) -> int:
        return self._at_once

    def decode(self, features: dict[str, np.ndarray], boxes: np.ndarray, height: int, width: int) -> np.ndarray:
        boxes = boxes * np.array([self._side / width, self._side / height] * 2, np.float32)
        count = len(boxes)
        if self._takes_boxes:
            feed = {
                "input_points": np.zeros((1, count, 0, 2), np.float32),
                "input_labels": np.zeros((1, count, 0), np.int64),
                "input_boxes": boxes[None],
            }
            masks, scores = self.pair.decode({**features, **feed}, ["pred_masks", "iou_scores"])
            return best_mask(masks[0], scores[0])
        points, labels = corners(boxes)
        side = self._side // 4
        feed = {
            "point_coords": points,
            "point_labels": labels,
            "mask_input": np.zeros((count, 1, side, side), np.float32),
            "has_mask_input": np.zeros(1, np.float32),
            "orig_im_size": np.array([height, width], np.int64),
        }
        return best_mask(*self.pair.decode({**features, **feed}, ["masks", "iou_predictions"]))

    def to_picture(self, logits: np.ndarray, height: int, width: int) -> np.ndarray:
        return logits if logits.shape == (height, width) else stretched(logits, height, width)
