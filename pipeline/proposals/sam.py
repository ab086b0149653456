"""SAM and MobileSAM: the public picture encoders, and the decoder of the official exporter.

A picture is scaled to a long side of 1024 and lies at the top left of a square.
The encoder takes either that picture as it is ((h, w, 3), 0..255; what follows
is in its graph), or the normalised square (1, 3, 1024, 1024), zero where the
picture is not. A box is two points with the labels 2 and 3 in that frame. Of an
export of four masks the first is taken: exactly what
`SamPredictor.predict(box=..., multimask_output=False)` does
(https://github.com/facebookresearch/segment-anything). An export of a single
mask chooses that one only where there are more than two points, and so gets the
padding point 0, 0 with the label -1 as well; the network sees it, and the mask
differs a little from the predictor's.

The decoder's masks in picture size are not used where it gives those of 256x256
too: segment-anything 1.0 freezes the crop of the padding at the aspect ratio of
the picture it was exported with.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pipeline.proposals.contracts import ALL_MASKS, SAM_DECODERS, SAM_ENCODERS, SAM_OPTION, SAM_SIDE
from pipeline.proposals.model_pair import open_pair
from pipeline.proposals.prompted import best_mask, corners, resampled, stretched
from pipeline.system.errors import InputError

VERSION = "1"
MEAN = np.array([123.675, 116.28, 103.53], np.float32)
STD = np.array([58.395, 57.12, 57.375], np.float32)


def resized_shape(height: int, width: int, side: int = SAM_SIDE) -> tuple[int, int]:
    """Height and width of a picture whose long side is `side`."""
    scale = side / max(height, width)
    return max(int(height * scale + 0.5), 1), max(int(width * scale + 0.5), 1)


class SamModel:
    """SAM or MobileSAM.

    Parameters
    ----------
    paths : sequence of Path
        Encoder and decoder.

    Raises
    ------
    InputError
        The files are not of this kind.
    """

    name = "sam"

    def __init__(self, paths: Sequence[Path]) -> None:
        self.pair = open_pair(SAM_OPTION, paths, SAM_ENCODERS, SAM_DECODERS)
        (self._input,) = self.pair.encoder_inputs.values()
        outputs = self.pair.decoder_outputs()
        self._low_res = "low_res_masks" in outputs
        count = outputs["iou_predictions"].shape[-1:]
        self._padded = count[0] != ALL_MASKS if count and isinstance(count[0], int) else None

    def fingerprint(self) -> str:
        return f"sam:{VERSION}:{self.pair.content_hash}"

    def encode(self, rgb: np.ndarray) -> dict[str, np.ndarray]:
        height, width = resized_shape(*rgb.shape[:2])
        image = resampled(rgb, height, width).astype(np.float32)
        if len(self._input.shape) == 3:
            return self.pair.encode(self._fitted(image))
        square = np.zeros((1, 3, SAM_SIDE, SAM_SIDE), np.float32)
        square[0, :, :height, :width] = ((image - MEAN) / STD).transpose(2, 0, 1)
        return self.pair.encode(square)

    def boxes_at_once(self, height: int, width: int) -> int:
        return 1

    def decode(self, features: dict[str, np.ndarray], boxes: np.ndarray, height: int, width: int) -> np.ndarray:
        if self._padded is None:
            # Where the file does not declare how many masks it gives, a run tells.
            _, scores = self._run(features, boxes, height, width, padded=True)
            self._padded = scores.shape[-1] != ALL_MASKS
        masks, scores = self._run(features, boxes, height, width, self._padded)
        if masks.ndim == 4 and masks.shape[1] == ALL_MASKS:
            return masks[:, 0]
        return best_mask(masks, scores)

    def _run(
        self, features: dict[str, np.ndarray], boxes: np.ndarray, height: int, width: int, padded: bool
    ) -> tuple[np.ndarray, np.ndarray]:
        """Mask logits ((1, M, h, w)) and predicted IoUs ((1, M)) of one box."""
        new_height, new_width = resized_shape(height, width)
        points, labels = corners(boxes * np.array([new_width / width, new_height / height] * 2, np.float32))
        if padded:
            points = np.concatenate([points, np.zeros((1, 1, 2), np.float32)], axis=1)
            labels = np.concatenate([labels, np.full((1, 1), -1, np.float32)], axis=1)
        feed = {
            **features,
            "point_coords": points,
            "point_labels": labels,
            "mask_input": np.zeros((1, 1, 256, 256), np.float32),
            "has_mask_input": np.zeros(1, np.float32),
            "orig_im_size": np.array([height, width], np.float32),
        }
        outputs = ["masks", "iou_predictions", *(["low_res_masks"] if self._low_res else [])]
        masks, scores, *low_res = self.pair.decode(feed, outputs)
        # A low-resolution output of one value throughout is one that the file does not fill.
        return (low_res[0] if low_res and np.ptp(low_res[0]) > 0 else masks), scores

    def to_picture(self, logits: np.ndarray, height: int, width: int) -> np.ndarray:
        if logits.shape == (height, width) and logits.shape != (256, 256):
            return logits
        new_height, new_width = resized_shape(height, width)
        return stretched(stretched(logits, SAM_SIDE, SAM_SIDE)[:new_height, :new_width], height, width)

    def _fitted(self, image: np.ndarray) -> np.ndarray:
        """(h, w, 3) of the size that the file declares, where it declares one."""
        height, width = (
            declared if isinstance(declared, int) else actual
            for declared, actual in zip(self._input.shape[:2], image.shape[:2], strict=True)
        )
        if (height, width) == image.shape[:2]:
            return image
        if height < image.shape[0] or width < image.shape[1]:
            raise InputError(
                "the encoder takes pictures of one shape only",
                got=f"{image.shape[1]}x{image.shape[0]} with the long side {SAM_SIDE}",
                expected=f"{width}x{height}",
                cause="export it with a free height and width",
                path=self.pair.encoder_path,
            )
        # The mean colour is zero once it is normalised, which is what padding is made of.
        padded = np.tile(MEAN, (height, width, 1))
        padded[: image.shape[0], : image.shape[1]] = image
        return padded
