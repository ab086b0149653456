"""Box-prompted segmentation networks: a run of the encoder per picture, then a cheap decoder per few boxes.

Picture encoder and prompt decoder are two ONNX files, opened together and checked against each other.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from pipeline.geometry.frame import Frame
from pipeline.proposals.contracts import (
    ALL_MASKS,
    EFFICIENTSAM_DECODERS,
    EFFICIENTSAM_ENCODERS,
    SAM2_DECODERS,
    SAM2_ENCODERS,
    SAM_DECODERS,
    SAM_ENCODERS,
    SAM_SIDE,
    DetectorContract,
    _fits,
    by_name,
    follows,
)
from pipeline.proposals.mismatch import fitting, shapes
from pipeline.proposals.network import IMAGENET_MEAN, IMAGENET_STD, pillow_resized
from pipeline.system.errors import InputError, require
from pipeline.system.onnx_session import model_hash, open_session, run_session
from pipeline.system.recent import Recent

_KEPT = 4
"""Pictures whose features are kept in memory; those of one are 4 to 20 MB."""
_TOLERANCE = 1e-2
"""By how much mask logits may differ, of their spread, between a box alone and the same box among others."""


class PromptedSegmenter:
    """A segmenter prompted by boxes, or by points, which are boxes without extent; masks do not depend on others."""

    independent = True
    takes_points = True

    def __init__(self, model: PairModel) -> None:
        self.model, self.name = model, model.name
        self._features: Recent[str, dict[str, np.ndarray]] = Recent(_KEPT)
        self._batches: bool | None = None

    def fingerprint(self) -> str:
        return self.model.fingerprint()

    def segment(self, frame: Frame, boxes: np.ndarray, labels: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
        """(N, H, W) bool masks, where the logits are above zero; (N,) bool, false where a mask is empty."""
        masks = np.zeros((len(boxes), frame.height, frame.width), np.bool_)
        if len(boxes):
            boxes = boxes.astype(np.float32)
            # A point outside the picture is none that the network was trained with.
            boxes = np.clip(boxes, 0, np.array([frame.width, frame.height] * 2, np.float32))
            for i, logits in enumerate(self._logits(frame, boxes)):
                masks[i] = self.model.to_picture(logits, frame.height, frame.width) > 0
        return masks, np.asarray(masks.any(axis=(1, 2)))

    def _logits(self, frame: Frame, boxes: np.ndarray) -> list[np.ndarray]:
        features = self._encoded(frame)
        size = (frame.height, frame.width)
        step = 1 if self._batches is False else self.model.boxes_at_once(*size)
        found: list[np.ndarray] = []
        for start in range(0, len(boxes), step):
            some = boxes[start : start + step]
            if len(some) > 1 and self._batches is None:
                self._batches, made = self._tried(features, some, size)
            elif self._batches is False:
                made = [self._checked(features, box[None], size)[0] for box in some]
            else:
                made = list(self._checked(features, some, size))
            found += made
        return found

    def _tried(
        self, features: dict[str, np.ndarray], boxes: np.ndarray, size: tuple[int, int]
    ) -> tuple[bool, list[np.ndarray]]:
        """Test whether several boxes in a run give the same masks as alone, and the logits. An exported graph may
        declare a free number of boxes and still hold the one that it was traced with."""
        last = self._checked(features, boxes[-1:], size)[0]
        try:
            together = self._checked(features, boxes, size)
        except InputError:
            together = None
        if together is not None:
            spread = float(np.abs(last).max())
            if np.allclose(together[-1], last, rtol=0, atol=_TOLERANCE * spread):
                return True, list(together)
        return False, [*(self._checked(features, box[None], size)[0] for box in boxes[:-1]), last]

    def _checked(self, features: dict[str, np.ndarray], boxes: np.ndarray, size: tuple[int, int]) -> np.ndarray:
        logits = self.model.decode(features, boxes, *size)
        require(
            logits.ndim == 3 and len(logits) == len(boxes),
            f"the decoder of --segmenter {self.name} must give one mask a box",
            got=f"{list(logits.shape)} for {len(boxes)} boxes",
        )
        require(
            np.isfinite(logits).all(),
            f"the decoder of --segmenter {self.name} gives values that are not finite",
            cause="is it a float16 file that overflows? try the float32 one",
        )
        return logits

    def _encoded(self, frame: Frame) -> dict[str, np.ndarray]:
        """The features of the picture; the encoder, the slow part, is run once for each."""
        return self._features.get(frame.content_hash, lambda: self.model.encode(frame.rgb))


def stretched(logits: np.ndarray, height: int, width: int) -> np.ndarray:
    """Bilinear resize (height, width) float32 between pixel centres, as `torch.nn.functional.interpolate`."""
    return cv2.resize(np.ascontiguousarray(logits, np.float32), (width, height), interpolation=cv2.INTER_LINEAR)


def corners(boxes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Boxes as points: (N, 2, 2) float32 x, y of the corners, and (N, 2) float32 their labels, 2 and 3.

    A box without extent is a point of the thing: label 1, and a padding point, label -1.
    """
    points, labels = boxes.reshape(-1, 2, 2).copy(), np.tile(np.array([2.0, 3.0], np.float32), (len(boxes), 1))
    single = are_points(boxes)
    points[single, 1], labels[single] = 0, (1, -1)
    return points, labels


def are_points(boxes: np.ndarray) -> np.ndarray:
    """Boxes without extent, (N,) bool."""
    return np.asarray((boxes[:, :2] == boxes[:, 2:]).all(axis=1))


def best_mask(masks: np.ndarray, scores: np.ndarray) -> np.ndarray:
    """Masks (N, h, w) of best predicted IoU ((N, M)) among ((N, M, h, w))."""
    require(
        masks.ndim == 4 and scores.shape == masks.shape[:2],
        "the decoder must give masks [N, M, h, w] and as many predicted IoUs",
        got=f"{list(masks.shape)}, {list(scores.shape)}",
    )
    return masks[np.arange(len(masks)), scores.argmax(axis=1)]


class PairModel:
    """Encoder and decoder sessions of a model.

    `encoder_input`: The picture, as the encoder declares it; `decoder_inputs, decoder_outputs`: As the decoder
    declares them, by name; `features`: Which input of the decoder each output of the encoder goes to.
    """

    name: str
    version = "1"
    encoders: Sequence[DetectorContract]
    decoders: Sequence[DetectorContract]  # Those that will do

    def __init__(self, paths: Sequence[Path]) -> None:
        option = self.encoders[0].option
        require(
            len(paths) == 2,
            f"{option} needs two model files",
            got=" ".join(str(p) for p in paths) or None,
            expected="--segmenter-model ENCODER.onnx DECODER.onnx",
        )
        self.encoder_path, self.decoder_path = paths
        self._encoder, self._decoder = open_session(self.encoder_path), open_session(self.decoder_path)
        encoder, decoder = _follows(self._encoder, self.encoders), _follows(self._decoder, self.decoders)
        turned = _follows(self._encoder, self.decoders), _follows(self._decoder, self.encoders)
        require(
            encoder is not None or decoder is not None or not all(turned),
            "encoder and decoder are the wrong way round",
            got=f"{paths[0].name} is the decoder, {paths[1].name} the encoder",
            expected=f"--segmenter-model {paths[1].name} {paths[0].name}",
        )
        encoder = fitting(encoder, f"the encoder that {option} reads", self._encoder, paths[0], self.encoders)
        fitting(decoder, f"the decoder that {option} reads", self._decoder, paths[1], self.decoders)
        (self.encoder_input,) = by_name(self._encoder.get_inputs()).values()
        self.decoder_inputs, self.decoder_outputs = (
            by_name(values) for values in (self._decoder.get_inputs(), self._decoder.get_outputs())
        )
        given, wanted = by_name(self._encoder.get_outputs()), [s.name for s in encoder.outputs]
        # The only output of an encoder may bear any name.
        one = len(wanted) == len(given) == 1
        self.features = {next(iter(given)): wanted[0]} if one else {n: n for n in wanted}
        for source, target in self.features.items():
            spec = self.decoder_inputs.get(target)
            # As far as both declare them.
            require(
                spec is not None and _fits(given[source], spec),
                "encoder and decoder do not belong together",
                got=f"the encoder {self.encoder_path.name} gives {given[source].name} {list(given[source].shape)}",
                expected=shapes((spec,)) if spec else ", ".join(self.decoder_inputs),
                cause="are they of the same export?",
                path=self.decoder_path,
            )

    @cached_property
    def _hash(self) -> str:
        return f"{model_hash(self.encoder_path)}:{model_hash(self.decoder_path)}"

    def fingerprint(self) -> str:
        """Cache key: content of both files, with external weights, and version of the code."""
        return f"{self.name}:{self.version}:{self._hash}"

    def encode(self, rgb: np.ndarray) -> dict[str, np.ndarray]:
        """Features of a picture ((H, W, 3) uint8), by input name of the decoder."""
        raise NotImplementedError

    def decode(self, features: dict[str, np.ndarray], boxes: np.ndarray, height: int, width: int) -> np.ndarray:
        """(N, h, w) float32 mask logits of boxes ((N, 4) float32, picture pixels); h, w are the model's own."""
        raise NotImplementedError

    def boxes_at_once(self, height: int, width: int) -> int:
        """Number of boxes in a decoder run, by the declared shapes."""
        return 1

    def to_picture(self, logits: np.ndarray, height: int, width: int) -> np.ndarray:
        """Mask logits (height, width) float32 of a box ((h, w) float32)."""
        return logits if logits.shape == (height, width) else stretched(logits, height, width)

    def _encoded(self, image: np.ndarray) -> dict[str, np.ndarray]:
        """Features of a picture in the encoder's contract, by input name of the decoder."""
        values = run_session(self._encoder, list(self.features), {self.encoder_input.name: image}, self.encoder_path)
        return dict(zip(self.features.values(), values, strict=True))

    def _decoded(self, feed: dict[str, np.ndarray], outputs: Sequence[str]) -> list[np.ndarray]:
        """The decoder's outputs as float32."""
        return run_session(self._decoder, outputs, {n: feed[n] for n in self.decoder_inputs}, self.decoder_path)


def _follows(session: Any, contracts: Sequence[DetectorContract]) -> DetectorContract | None:
    return next((c for c in contracts if follows(session, c)), None)


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
    """SAM or MobileSAM, with the public encoders and the decoder of the official exporter.

    A picture with a long side of 1024 lies at the top left of a square; a box is two points with the labels 2 and 3.
    Of four masks the first is taken, as by `SamPredictor.predict(box=..., multimask_output=False)`; an export of one
    mask chooses that one only with more than two points, and gets the padding point 0, 0 with the label -1 as well.
    Masks of 256x256 are preferred: segment-anything 1.0 freezes the crop of those in picture size.
    """

    name = "sam"
    encoders, decoders = SAM_ENCODERS, SAM_DECODERS

    def __init__(self, paths: Sequence[Path]) -> None:
        super().__init__(paths)
        self._low_res = "low_res_masks" in self.decoder_outputs
        count = self.decoder_outputs["iou_predictions"].shape[-1:]
        self._padded = count[0] != ALL_MASKS if count and isinstance(count[0], int) else None

    def encode(self, rgb: np.ndarray) -> dict[str, np.ndarray]:
        height, width = resized_shape(*rgb.shape[:2])
        image = pillow_resized(rgb, height, width).astype(np.float32)
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
        if are_points(boxes).all() and masks.ndim == 4 and masks.shape[1] == ALL_MASKS:
            # A point may mean a thing or a part of it: the first of four masks is for clear prompts.
            return best_mask(masks[:, 1:], scores[:, 1:])
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
    """SAM 2 and 2.1, as exported by samexporter, osam and transformers.js.

    A picture is squashed to the encoder's square; a box is two points with the labels 2 and 3, or a box of its own in
    the transformers.js export. The mask of best predicted IoU counts.
    """

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
        image = pillow_resized(rgb, self._side, self._side).astype(np.float32) / np.float32(255)
        return self._encoded(np.ascontiguousarray(((image - IMAGENET_MEAN) / IMAGENET_STD).transpose(2, 0, 1)[None]))

    def boxes_at_once(self, height: int, width: int) -> int:
        return AT_ONCE if self._free else 1

    def decode(self, features: dict[str, np.ndarray], boxes: np.ndarray, height: int, width: int) -> np.ndarray:
        boxes = boxes * np.array([self._side / width, self._side / height] * 2, np.float32)
        count = len(boxes)
        if self._takes_boxes:
            refused = "this export of SAM 2 takes boxes and no points"
            require(not are_points(boxes).any(), refused, path=self.decoder_path)
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
    """EfficientSAM-Ti and -S, as exported by its repository and labelme; the picture goes in whole, divided by 255.

    InputError also where the decoder takes single points only.
    """

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
        image = pillow_resized(rgb, height, width).astype(np.float32) / np.float32(255)
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
