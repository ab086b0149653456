"""Box-prompted segmentation networks: a run of the encoder per picture, then a cheap decoder per few boxes.

Picture encoder and prompt decoder are two ONNX files, opened together and checked against each other.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, Protocol

import cv2
import numpy as np

from pipeline.geometry.frame import Frame
from pipeline.proposals.contracts import DetectorContract, _fits, by_name, follows
from pipeline.proposals.mismatch import explain_mismatch, shapes
from pipeline.proposals.network import pillow_resized
from pipeline.system.errors import InputError, as_input_error, first_line, require
from pipeline.system.onnx_session import as_declared, model_hash, open_session, run_limited, signature
from pipeline.system.recent import Recent

_KEPT = 4
"""Pictures whose features are kept in memory; those of one are 4 to 20 MB."""
_TOLERANCE = 1e-2
"""By how much mask logits may differ, of their spread, between a box alone and the same box among others."""


class PromptModel(Protocol):
    """An encoder and a decoder."""

    @property
    def name(self) -> str: ...

    def fingerprint(self) -> str:
        """Cache key: content of both files and version of the code."""
        ...

    def encode(self, rgb: np.ndarray) -> dict[str, np.ndarray]:
        """Features of a picture ((H, W, 3) uint8), by input name of the decoder."""
        ...

    def boxes_at_once(self, height: int, width: int) -> int:
        """Number of boxes in a decoder run, by the declared shapes."""
        ...

    def decode(self, features: dict[str, np.ndarray], boxes: np.ndarray, height: int, width: int) -> np.ndarray:
        """(N, h, w) float32 mask logits of boxes ((N, 4) float32, picture pixels); h, w are the model's own."""
        ...

    def to_picture(self, logits: np.ndarray, height: int, width: int) -> np.ndarray:
        """Mask logits (height, width) float32 of a box ((h, w) float32)."""
        ...


class PromptedSegmenter:
    """A box-prompted segmenter; masks do not depend on other boxes."""

    independent = True

    def __init__(self, model: PromptModel) -> None:
        self.model, self.name = model, model.name
        self.encoder_runs = 0
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

        def run() -> dict[str, np.ndarray]:
            found = self.model.encode(frame.rgb)
            self.encoder_runs += 1
            return found

        return self._features.get(frame.content_hash, run)


def resampled(rgb: np.ndarray, height: int, width: int) -> np.ndarray:
    """Picture (height, width, 3) uint8 scaled by Pillow, as in training."""
    return rgb if rgb.shape[:2] == (height, width) else pillow_resized(rgb, height, width)


def stretched(logits: np.ndarray, height: int, width: int) -> np.ndarray:
    """Bilinear resize (height, width) float32 between pixel centres, as `torch.nn.functional.interpolate`."""
    return cv2.resize(np.ascontiguousarray(logits, np.float32), (width, height), interpolation=cv2.INTER_LINEAR)


def corners(boxes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Boxes as points: (N, 2, 2) float32 x, y of the corners, and (N, 2) float32 their labels, 2 and 3."""
    return boxes.reshape(-1, 2, 2), np.tile(np.array([2.0, 3.0], np.float32), (len(boxes), 1))


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
        if encoder is None:
            raise _not_fitting(option, "encoder", self._encoder, paths[0], self.encoders, turned[0])
        if decoder is None:
            raise _not_fitting(option, "decoder", self._decoder, paths[1], self.decoders, turned[1])
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

    def boxes_at_once(self, height: int, width: int) -> int:
        """Number of boxes in a decoder run, by the declared shapes."""
        return 1

    def to_picture(self, logits: np.ndarray, height: int, width: int) -> np.ndarray:
        """Mask logits (height, width) float32 of a box ((h, w) float32)."""
        return logits if logits.shape == (height, width) else stretched(logits, height, width)

    def _encoded(self, image: np.ndarray) -> dict[str, np.ndarray]:
        """Features of a picture in the encoder's contract, by input name of the decoder."""
        values = run(self._encoder, list(self.features), {self.encoder_input.name: image}, self.encoder_path)
        return dict(zip(self.features.values(), values, strict=True))

    def _decoded(self, feed: dict[str, np.ndarray], outputs: Sequence[str]) -> list[np.ndarray]:
        """The decoder's outputs as float32."""
        feed = {n: feed[n] for n in self.decoder_inputs}
        return [o.astype(np.float32, copy=False) for o in run(self._decoder, outputs, feed, self.decoder_path)]


def run(session: Any, outputs: Sequence[str], feed: dict[str, np.ndarray], path: Path) -> list[np.ndarray]:
    """Run a session on inputs converted to the declared types."""
    feed = as_declared(session, feed, path)
    shown = ", ".join(f"{n} {list(v.shape)}" for n, v in feed.items())

    def failed(error: Exception) -> str:
        return f"{(first_line(error) or type(error).__name__)[:160]} for {shown}"

    # ONNX Runtime raises its own classes, which differ between releases.
    with as_input_error("the model cannot be run", Exception, got=failed, path=path):
        return run_limited(session, outputs, feed, path)


def _follows(session: Any, contracts: Sequence[DetectorContract]) -> DetectorContract | None:
    return next((c for c in contracts if follows(session, c)), None)


def _not_fitting(
    option: str, role: str, session: Any, path: Path, wanted: Sequence[DetectorContract], other: DetectorContract | None
) -> InputError:
    """Error for a file of another kind, named where known."""
    found = "a decoder" if role == "encoder" else "an encoder"
    return InputError(
        f"the ONNX file is not the {role} that {option} reads",
        got=signature(session)[:240],
        expected=" or ".join(dict.fromkeys(shapes(c.inputs) for c in wanted)),
        cause=explain_mismatch(session, option) if other is None else f"this is {found}: the other file is missing",
        path=path,
    )
