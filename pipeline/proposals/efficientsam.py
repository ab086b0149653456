"""EfficientSAM: the exports of its own repository and of labelme.

The encoder takes the whole picture divided by 255, of any size, and scales and
normalises it itself; the decoder takes points in picture pixels, a box as two
with the labels 2 and 3, and gives masks in picture size. It does not sort
them: the one of the best predicted IoU counts.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pipeline.proposals.contracts import EFFICIENTSAM_DECODERS, EFFICIENTSAM_ENCODERS, EFFICIENTSAM_OPTION
from pipeline.proposals.model_pair import open_pair
from pipeline.proposals.prompted import best_mask, corners, resampled, stretched
from pipeline.system.errors import InputError

VERSION = "1"
SIDE = 1024
AT_ONCE = 8
_VALUES = 2**25
"""Mask logits in a run at most: three masks a box, in picture size."""


class EfficientSamModel:
    """EfficientSAM-Ti and -S.

    Parameters
    ----------
    paths : sequence of Path
        Encoder and decoder.

    Raises
    ------
    InputError
        The files are not of this kind, or the decoder takes single points only.
    """

    name = "efficientsam"

    def __init__(self, paths: Sequence[Path]) -> None:
        self.pair = open_pair(EFFICIENTSAM_OPTION, paths, EFFICIENTSAM_ENCODERS, EFFICIENTSAM_DECODERS)
        (self._input,) = self.pair.encoder_inputs.values()
        _, queries, points, _ = self.pair.decoder_inputs["batched_point_coords"].shape
        self._points = points if isinstance(points, int) else 2
        self._queries = queries if isinstance(queries, int) else None
        if self._points < 2:
            raise InputError(
                "the decoder takes one point a query, and a box is two",
                got=f"batched_point_coords [1, {queries}, {points}, 2]",
                expected="a free number of points",
                cause="export it with dynamic_axes 1 and 2 of batched_point_coords and batched_point_labels",
                path=self.pair.decoder_path,
            )

    def fingerprint(self) -> str:
        return f"efficientsam:{VERSION}:{self.pair.content_hash}"

    def encode(self, rgb: np.ndarray) -> dict[str, np.ndarray]:
        # The points are scaled by orig_im_size and so remain right, whatever size the picture goes in with.
        height, width = (
            declared if isinstance(declared, int) else actual
            for declared, actual in zip(self._input.shape[2:], rgb.shape[:2], strict=True)
        )
        image = resampled(rgb, height, width).astype(np.float32) / np.float32(255)
        return self.pair.encode(np.ascontiguousarray(image.transpose(2, 0, 1)[None]))

    def boxes_at_once(self, height: int, width: int) -> int:
        return self._queries or int(np.clip(_VALUES // (3 * height * width), 1, AT_ONCE))

    def decode(self, features: dict[str, np.ndarray], boxes: np.ndarray, height: int, width: int) -> np.ndarray:
        queries = self._queries or len(boxes)
        # Points that are none: the graph adds such ones itself, at -1, -1 in its own frame.
        coords = np.tile(np.array([-width / SIDE, -height / SIDE], np.float32), (queries, self._points, 1))
        labels = np.full((queries, self._points), -1, np.float32)
        coords[: len(boxes), :2], labels[: len(boxes), :2] = corners(boxes)
        feed = {
            "batched_point_coords": coords[None],
            "batched_point_labels": labels[None],
            "orig_im_size": np.array([height, width], np.int64),
        }
        masks, scores = self.pair.decode({**features, **feed}, ["output_masks", "iou_predictions"])
        return best_mask(masks[0], scores[0])[: len(boxes)]

    def to_picture(self, logits: np.ndarray, height: int, width: int) -> np.ndarray:
        return logits if logits.shape == (height, width) else stretched(logits, height, width)
