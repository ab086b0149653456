"""Networks of `--segmenter sam`, `sam2` and `efficientsam`: SAM and MobileSAM, SAM 2, EfficientSAM.

SAM takes the public picture encoders, and the decoder of the official exporter. A picture is scaled to a long side of
1024 and lies at the top left of a square. The encoder takes either that picture as it is ((h, w, 3), 0..255; what
follows is in its graph), or the normalised square (1, 3, 1024, 1024), zero where the picture is not. A box is two
points with the labels 2 and 3 in that frame. Of an export of four masks the first is taken: exactly what
`SamPredictor.predict(box=..., multimask_output=False)` does (https://github.com/facebookresearch/segment-anything). An
export of a single mask chooses that one only where there are more than two points, and so gets the padding point 0, 0
with the label -1 as well; the network sees it, and the mask differs a little from the predictor's. The decoder's masks
in picture size are not used where it gives those of 256x256 too: segment-anything 1.0 freezes the crop of the padding
at the aspect ratio of the picture it was exported with.

SAM 2 takes the exports of samexporter, of osam and of transformers.js. A picture is squashed to the encoder's square,
divided by 255 and normalised by the ImageNet mean and deviation. A box is two points with the labels 2 and 3 (the graph
adds the padding point), or a box of its own in the transformers.js export. Masks are those of the best predicted IoU,
256x256, and scaled to the picture as they are.

EfficientSAM takes the exports of its own repository and of labelme. The encoder takes the whole picture divided by 255,
of any size, and scales and normalises it itself; the decoder takes points in picture pixels, a box as two with the
labels 2 and 3, and gives masks in picture size. It does not sort them: the one of the best predicted IoU counts.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pipeline.proposals.contracts import (
    ALL_MASKS,
    EFFICIENTSAM_DECODERS,
    EFFICIENTSAM_ENCODERS,
    SAM2_DECODERS,
    SAM2_ENCODERS,
    SAM_DECODERS,
    SAM_ENCODERS,
    SAM_SIDE,
)
from pipeline.proposals.network import IMAGENET_MEAN, IMAGENET_STD
from pipeline.proposals.prompted import PairModel, best_mask, corners, resampled, stretched
from pipeline.system.errors import require

MEAN = np.array([123.675, 116.28, 103.53], np.float32)
STD = np.array([58.395, 57.12, 57.375], np.float32)
AT_ONCE = 8
"""Boxes in a run of SAM 2 and EfficientSAM; each takes some 30 MB in SAM 2's decoder."""
_VALUES = 2**25
"""Mask logits in a run of EfficientSAM at most: three masks a box, in picture size."""


def resized_shape(height: int, width: int, side: int = SAM_SIDE) -> tuple[int, int]:
    """Height and width of a picture with a long side of `side`."""
    scale = side / max(height, width)
    return max(int(height * scale + 0.5), 1), max(int(width * scale + 0.5), 1)


def _declared_or(declared: Sequence[int | str], actual: Sequence[int]) -> tuple[int, int]:
    """Height and width as declared in a file, else the actual size."""
    height, width = (d if isinstance(d, int) else a for d, a in zip(declared, actual, strict=True))
    return height, width


class SamModel(PairModel):
    """SAM or MobileSAM; see `PairModel`."""

    name = "sam"
    encoders, decoders = SAM_ENCODERS, SAM_DECODERS

    def __init__(self, paths: Sequence[Path]) -> None:
        super().__init__(paths)
        self._low_res = "low_res_masks" in self.decoder_outputs
        count = self.decoder_outputs["iou_predictions"].shape[-1:]
        self._padded = count[0] != ALL_MASKS if count and isinstance(count[0], int) else None

    def encode(self, rgb: np.ndarray) -> dict[str, np.ndarray]:
        height, width = resized_shape(*rgb.shape[:2])
        image = resampled(rgb, height, width).astype(np.float32)
        if len(self.encoder_input.shape) == 3:
            return self._encoded(self._fitted(image))
        square = np.zeros((1, 3, SAM_SIDE, SAM_SIDE), np.float32)
        square[0, :, :height, :width] = ((image - MEAN) / STD).transpose(2, 0, 1)
        return self._encoded(square)

    def decode(self, features: dict[str, np.ndarray], boxes: np.ndarray, height: int, width: int) -> np.ndarray:
        if self._padded is None:
            # Where the file does not declare how many masks it gives, a run tells.
            _, scores = self._run(features, boxes, height, width, padded=True)
            self._padded = scores.shape[-1] != ALL_MASKS
        masks, scores = self._run(features, boxes, height, width, self._padded)
        return masks[:, 0] if masks.ndim == 4 and masks.shape[1] == ALL_MASKS else best_mask(masks, scores)

    def _run(
        self, features: dict[str, np.ndarray], boxes: np.ndarray, height: int, width: int, padded: bool
    ) -> tuple[np.ndarray, np.ndarray]:
        """Mask logits ((1, M, h, w)) and predicted IoUs ((1, M)) of a box."""
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
        masks, scores, *low_res = self._decoded(feed, outputs)
        # A low-resolution output of one value throughout is one that the file does not fill.
        return (low_res[0] if low_res and np.ptp(low_res[0]) > 0 else masks), scores

    def to_picture(self, logits: np.ndarray, height: int, width: int) -> np.ndarray:
        if logits.shape == (height, width) and logits.shape != (256, 256):
            return logits
        new_height, new_width = resized_shape(height, width)
        return stretched(stretched(logits, SAM_SIDE, SAM_SIDE)[:new_height, :new_width], height, width)

    def _fitted(self, image: np.ndarray) -> np.ndarray:
        """Picture (h, w, 3) padded to the declared size, if any."""
        height, width = _declared_or(self.encoder_input.shape[:2], image.shape[:2])
        if (height, width) == image.shape[:2]:
            return image
        require(
            height >= image.shape[0] and width >= image.shape[1],
            "the encoder takes pictures of one shape only",
            got=f"{image.shape[1]}x{image.shape[0]} with the long side {SAM_SIDE}",
            expected=f"{width}x{height}",
            cause="export it with a free height and width",
            path=self.encoder_path,
        )
        # The mean colour is zero once it is normalised, which is what padding is made of.
        padded = np.tile(MEAN, (height, width, 1))
        padded[: image.shape[0], : image.shape[1]] = image
        return padded


class Sam2Model(PairModel):
    """SAM 2 and 2.1; see `PairModel`."""

    name = "sam2"
    encoders, decoders = SAM2_ENCODERS, SAM2_DECODERS

    def __init__(self, paths: Sequence[Path]) -> None:
        super().__init__(paths)
        self._side = next((n for n in self.encoder_input.shape[2:] if isinstance(n, int)), SAM_SIDE)
        require(
            not (self._side % 32),
            "the encoder takes squares of another side than SAM 2",
            got=self._side,
            expected=SAM_SIDE,
            cause="a side of 1008 is SAM 3's, which is normalised otherwise and not read",
            path=self.encoder_path,
        )
        self._takes_boxes = "input_boxes" in self.decoder_inputs
        many = {"input_points": 1, "input_boxes": 1} if self._takes_boxes else {"point_coords": 0}
        self._free = all(isinstance(self.decoder_inputs[name].shape[axis], str) for name, axis in many.items())

    def encode(self, rgb: np.ndarray) -> dict[str, np.ndarray]:
        image = resampled(rgb, self._side, self._side).astype(np.float32) / np.float32(255)
        return self._encoded(np.ascontiguousarray(((image - IMAGENET_MEAN) / IMAGENET_STD).transpose(2, 0, 1)[None]))

    def boxes_at_once(self, height: int, width: int) -> int:
        return AT_ONCE if self._free else 1

    def decode(self, features: dict[str, np.ndarray], boxes: np.ndarray, height: int, width: int) -> np.ndarray:
        boxes = boxes * np.array([self._side / width, self._side / height] * 2, np.float32)
        count = len(boxes)
        if self._takes_boxes:
            feed = {
                "input_points": np.zeros((1, count, 0, 2), np.float32),
                "input_labels": np.zeros((1, count, 0), np.int64),
                "input_boxes": boxes[None],
            }
            masks, scores = self._decoded({**features, **feed}, ["pred_masks", "iou_scores"])
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
        return best_mask(*self._decoded({**features, **feed}, ["masks", "iou_predictions"]))


class EfficientSamModel(PairModel):
    """EfficientSAM-Ti and -S; see `PairModel`. InputError also where the decoder takes single points only."""

    name = "efficientsam"
    encoders, decoders = EFFICIENTSAM_ENCODERS, EFFICIENTSAM_DECODERS

    def __init__(self, paths: Sequence[Path]) -> None:
        super().__init__(paths)
        _, queries, points, _ = self.decoder_inputs["batched_point_coords"].shape
        self._points = points if isinstance(points, int) else 2
        self._queries = queries if isinstance(queries, int) else None
        require(
            self._points >= 2,
            "the decoder takes one point a query, and a box is two",
            got=f"batched_point_coords [1, {queries}, {points}, 2]",
            expected="a free number of points",
            cause="export it with dynamic_axes 1 and 2 of batched_point_coords and batched_point_labels",
            path=self.decoder_path,
        )

    def encode(self, rgb: np.ndarray) -> dict[str, np.ndarray]:
        # The points are scaled by orig_im_size and so remain right, whatever size the picture goes in with.
        height, width = _declared_or(self.encoder_input.shape[2:], rgb.shape[:2])
        image = resampled(rgb, height, width).astype(np.float32) / np.float32(255)
        return self._encoded(np.ascontiguousarray(image.transpose(2, 0, 1)[None]))

    def boxes_at_once(self, height: int, width: int) -> int:
        return self._queries or int(np.clip(_VALUES // (3 * height * width), 1, AT_ONCE))

    def decode(self, features: dict[str, np.ndarray], boxes: np.ndarray, height: int, width: int) -> np.ndarray:
        queries = self._queries or len(boxes)
        # Points that are none: the graph adds such ones itself, at -1, -1 in its own frame.
        coords = np.tile(np.array([-width / SAM_SIDE, -height / SAM_SIDE], np.float32), (queries, self._points, 1))
        labels = np.full((queries, self._points), -1, np.float32)
        coords[: len(boxes), :2], labels[: len(boxes), :2] = corners(boxes)
        feed = {
            "batched_point_coords": coords[None],
            "batched_point_labels": labels[None],
            "orig_im_size": np.array([height, width], np.int64),
        }
        masks, scores = self._decoded({**features, **feed}, ["output_masks", "iou_predictions"])
        return best_mask(masks[0], scores[0])[: len(boxes)]
