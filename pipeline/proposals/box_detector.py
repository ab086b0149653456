"""Box detectors described by a TOML file (input, outputs, class names), without code, and decoding of the outputs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from pipeline.geometry.frame import Frame
from pipeline.geometry.picture_input import (
    ContractTable,
    InputPlacement,
    PictureInput,
    checked_input,
    checked_outputs,
    place_picture,
    read_description,
)
from pipeline.language.naming import Synonyms
from pipeline.proposals.base import Proposals, class_wise
from pipeline.proposals.class_names import metadata_names, names_hash, read_class_names
from pipeline.proposals.network import MAX_PER_NAME, NetworkDetector, proposals_of, sigmoid
from pipeline.system.errors import InputError, in_file, needed, require
from pipeline.system.frozen import dataclass
from pipeline.system.onnx_session import run_session

EXAMPLES = Path(__file__).with_name("detectors")
"""A TOML file for each form of output."""

Number = Literal["height", "width", "input_height", "input_width", "scale_y", "scale_x"]
"""Of the picture; of the network's input; input pixels per picture pixel."""
Column = Literal["box", "objectness", "scores", "score", "class"]


class BoxInput(PictureInput):
    """The input of a detector."""

    extra: dict[str, tuple[Number, ...]] = Field(default={})
    """More inputs, each a row of numbers: orig_target_sizes = ["width", "height"]."""


class BoxOutput(ContractTable):
    """Outputs of the detector; `form` selects the layout and the required keys."""

    form: Literal["rows", "separate", "distances"]
    """A row for each candidate, outputs for boxes and scores, or distances from the cells of a grid."""
    rows: str | None = None
    """rows: one output with a row for each candidate."""
    columns: tuple[Column, ...] = ("box", "scores")
    """rows: what a row holds, in order; `scores` is one for each class, `score` and `class` are one number each."""
    boxes: str | None = None
    """separate: the output of the boxes."""
    scores: str | tuple[str, ...] | None = None
    """separate: the output of the scores, one for each class, or one in all; distances: one output for each stride."""
    classes: str | None = None
    """separate: the output of the class numbers, where there is one score in all."""
    distances: tuple[str, ...] = ()
    """distances: one output for each stride, of distributions over the distances to the left, top, right and bottom."""
    strides: tuple[Annotated[int, Field(ge=1)], ...] = ()
    """distances: input pixels of a cell, for each output."""
    box: Literal["xyxy", "yxyx", "cxcywh", "xywh"] = "xyxy"
    """What the four numbers of a box are."""
    units: Literal["input", "share", "picture"] = "input"
    """Boxes are in pixels of the input, shares of it, or pixels of the picture."""
    activation: Literal["none", "sigmoid", "softmax"] = "none"
    """What makes probabilities of the scores."""
    background: Literal["none", "first", "last"] = "none"
    """A class that is none."""
    nms: bool = True
    """Rivals must still be suppressed: they are not in the file."""
    nms_iou: Annotated[float, Field(gt=0, le=1)] = 0.5
    """Overlap from which two boxes are rivals."""
    min_score: Annotated[float, Field(ge=0, le=1)] = 0.25
    """Candidates below it are dropped."""

    @model_validator(mode="after")
    def _of_one_form(self) -> BoxOutput:
        wanted = {
            "rows": self.rows is not None and "box" in self.columns,
            "separate": self.boxes is not None and isinstance(self.scores, str),
            "distances": isinstance(self.scores, tuple)
            and 0 < len(self.strides) == len(self.scores) == len(self.distances),
        }
        needs = {
            "rows": "the output `rows`, and a box among its `columns`",
            "separate": "the outputs `boxes` and `scores`",
            "distances": "as many `scores` and `distances` as `strides`",
        }
        if not wanted[self.form]:
            raise ValueError(f"the form {self.form!r} needs {needs[self.form]}")
        if len(set(self.columns)) != len(self.columns):
            raise ValueError("a column is named twice")
        one, all_of_them = "score" in self.columns, "scores" in self.columns
        if self.form == "rows" and (one == all_of_them or one != ("class" in self.columns)):
            raise ValueError("columns need either `scores`, or `score` and `class`")
        alone = self.classes is not None if self.form == "separate" else self.form == "rows" and one
        if alone and self.activation == "softmax":
            raise ValueError("softmax is over the scores of all classes, and there is one score in all")
        return self


class BoxModel(ContractTable):
    """The whole of the file."""

    input: BoxInput = BoxInput()
    """How the picture is given to the network."""
    output: BoxOutput
    """What its outputs hold."""
    names: tuple[str, ...] = ()
    """Class names in the order of the outputs; by default those in the model's metadata."""
    names_file: str | None = None
    """The same in a file, named as seen from the TOML; see `read_class_names`."""


def read_box_model(path: Path) -> BoxModel:
    """Read a detector's TOML file, with the names of `names_file` in `names`."""
    model = read_description(path, BoxModel, "detector")
    require(
        not (model.names and model.names_file),
        "the TOML file gives class names twice",
        expected="names or names_file",
        path=path,
    )
    if model.names_file:
        return model.model_copy(update={"names": read_class_names(path.parent / model.names_file)})
    return model


def find_box_model(model: Path) -> Path:
    """TOML file of a model: of the same name, or the only TOML file in the folder."""
    own = model.with_suffix(".toml")
    if own.is_file():
        return own
    others = sorted(model.parent.glob("*.toml")) if model.parent.is_dir() else []
    if len(others) == 1:
        return others[0]
    raise InputError(
        "nothing says what the detector's tensors are",
        expected=f"{own.name} beside it, or --model-config FILE.toml for that of --detector",
        cause=f"examples are in {EXAMPLES}",
        path=model,
    )


@dataclass(frozen=True)
class BoxCandidates:
    """All candidates of the network."""

    boxes: np.ndarray  # (N, 4) float64: x0, y0, x1, y1 in the units of the file's description
    scores: np.ndarray
    """(N, C) float32: Probabilities of the classes. Where the file gives one class for each box, the others are 0."""


def output_names(config: BoxOutput) -> list[str]:
    """Output names in a description."""
    given = (config.rows, config.boxes, config.scores, config.classes)
    names = [n for n in given if isinstance(n, str)]
    return [*names, *(config.scores if isinstance(config.scores, tuple) else ()), *config.distances]


def decode(outputs: Mapping[str, np.ndarray], config: BoxOutput, classes: int, size: tuple[int, int]) -> BoxCandidates:
    """Boxes and probabilities. `size` (int, int): Height and width of the input."""
    count = classes + (config.background != "none")
    if config.form == "rows":
        boxes, scores = _rows(outputs[config.rows or ""], config.columns, config.activation, count)
    elif config.form == "separate":
        boxes, scores = _separate(outputs, config, count)
    else:
        boxes, scores = _distances(outputs, config, count, size)
        return BoxCandidates(boxes, _foreground(scores, config))
    return BoxCandidates(_corners(boxes.astype(np.float64), config.box), _foreground(scores, config))


def _rows(values: np.ndarray, columns: Sequence[str], activation: str, count: int) -> tuple[np.ndarray, np.ndarray]:
    widths = {"box": 4, "scores": count, "objectness": 1, "score": 1, "class": 1}
    total = sum(widths[c] for c in columns)
    table = _unbatched(values, 2, "rows")
    # Ultralytics gives the columns first.
    if table.shape[1] != total and table.shape[0] == total:
        table = table.T
    require(
        table.shape[1] == total,
        "the output of the rows has another number of columns than the TOML file says",
        got=list(values.shape),
        expected=f"{total}: " + ", ".join(f"{widths[c]} of {c}" for c in columns),
    )
    ends = np.cumsum([widths[c] for c in columns])
    parts = dict(zip(columns, np.split(table, ends[:-1], axis=1), strict=True))
    if "scores" in parts:
        scores = _activated(parts["scores"], activation)
    else:
        scores = _one_hot(_activated(parts["score"][:, 0], activation), parts["class"][:, 0], count)
    if "objectness" in parts:
        scores = scores * _activated(parts["objectness"], "none" if activation == "none" else "sigmoid")
    return parts["box"], scores


def _separate(outputs: Mapping[str, np.ndarray], config: BoxOutput, count: int) -> tuple[np.ndarray, np.ndarray]:
    boxes = _unbatched(outputs[config.boxes or ""], 2, "boxes")
    values = outputs[str(config.scores)]
    require(boxes.shape[1] == 4, "the output of the boxes has another shape", got=list(boxes.shape), expected="[N, 4]")
    if config.classes is None:
        table = _unbatched(values, 2, "scores")
        if table.shape == (count, len(boxes)) and count != len(boxes):
            table = table.T
        require(
            table.shape == (len(boxes), count),
            "the output of the scores has another shape",
            got=list(values.shape),
            expected=f"{len(boxes)} boxes by {count} classes",
        )
        return boxes, _activated(table, config.activation)
    scores, classes = _unbatched(values, 1, "scores"), _unbatched(outputs[config.classes], 1, "classes")
    require(
        len(scores) == len(classes) == len(boxes),
        "boxes, scores and classes are not equally many",
        got=f"{len(boxes)}, {len(scores)}, {len(classes)}",
    )
    return boxes, _one_hot(_activated(scores, config.activation), classes, count)


def _distances(
    outputs: Mapping[str, np.ndarray], config: BoxOutput, count: int, size: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """Boxes of generalised focal loss heads: from a cell's centre the mean of each distribution, times the stride. Li
    et al., Generalized Focal Loss, NeurIPS 2020, equation 5. PicoDet and NanoDet give these maps."""
    boxes, scores = [], []
    assert isinstance(config.scores, tuple)
    for score_name, name, stride in zip(config.scores, config.distances, config.strides, strict=True):
        table, spread = _unbatched(outputs[score_name], 2, score_name), _unbatched(outputs[name], 2, name)
        height, width = -(-size[0] // stride), -(-size[1] // stride)
        bins = spread.shape[1] // 4
        require(
            not (
                table.shape != (height * width, count)
                or len(spread) != len(table)
                or spread.shape[1] != 4 * bins
                or not bins
            ),
            f"the outputs of stride {stride} have other shapes",
            got=f"{list(table.shape)}, {list(spread.shape)}",
            expected=f"[{height * width}, {count}], [{height * width}, 4 x bins]",
        )
        chance = _activated(spread.reshape(-1, 4, bins), "softmax")
        reach = (chance @ np.arange(bins, dtype=np.float64)) * stride
        y, x = np.divmod(np.arange(height * width), width)
        center = (np.stack([x, y], axis=1) + 0.5) * stride
        boxes.append(np.concatenate([center - reach[:, :2], center + reach[:, 2:]], axis=1))
        scores.append(_activated(table, config.activation))
    return np.concatenate(boxes), np.concatenate(scores)


def _unbatched(values: np.ndarray, rank: int, what: str) -> np.ndarray:
    """Array without leading axes of 1, and trailing axes of 1 for scalars."""
    found = values
    while found.ndim > rank and found.shape[0] == 1:
        found = found[0]
    while found.ndim > rank and found.shape[-1] == 1:
        found = found[..., 0]
    require(
        found.ndim == rank,
        f"the output of the {what} has another rank",
        got=list(values.shape),
        expected=f"rank {rank}",
    )
    return found


def _activated(values: np.ndarray, activation: str) -> np.ndarray:
    if activation == "sigmoid":
        return sigmoid(values)
    if activation == "softmax":
        raised = np.exp(values - values.max(axis=-1, keepdims=True))
        return raised / raised.sum(axis=-1, keepdims=True)
    return values


def _one_hot(scores: np.ndarray, classes: np.ndarray, count: int) -> np.ndarray:
    """(N, count); a number below 0 stands for no detection, as some exports pad their lists."""
    numbers = np.rint(classes).astype(np.int64)
    require(
        not len(numbers) or numbers.max() < count,
        "the network gives more classes than there are names",
        got=lambda: int(numbers.max()),
        expected=f"below {count}",
    )
    table = np.zeros((len(scores), count), np.float32)
    real = np.flatnonzero(numbers >= 0)
    table[real, numbers[real]] = scores[real]
    return table


def _foreground(scores: np.ndarray, config: BoxOutput) -> np.ndarray:
    part = {"none": slice(None), "first": slice(1, None), "last": slice(None, -1)}[config.background]
    scores = scores[:, part].astype(np.float32)
    require(
        not len(scores) or (scores.min() >= -1e-3 and scores.max() <= 1 + 1e-3),
        "the scores are no probabilities",
        got=lambda: f"{float(scores.min()):.3g} to {float(scores.max()):.3g}",
        expected="0..1",
        cause='are these logits? say activation = "sigmoid" or "softmax"',
    )
    return np.clip(scores, 0, 1)


def _corners(boxes: np.ndarray, form: str) -> np.ndarray:
    first, second = boxes[:, :2], boxes[:, 2:]
    low, high = {
        "xyxy": (first, second),
        "yxyx": (first[:, ::-1], second[:, ::-1]),
        "cxcywh": (first - second / 2, first + second / 2),
        "xywh": (first, first + second),
    }[form]
    return np.concatenate([low, high], axis=1)


OPTION = "--detector boxes"
VERSION = "1"


class BoxDetector(NetworkDetector):
    """A box detector described by a TOML file."""

    name = "boxes"

    def __init__(
        self,
        path: str | Path,
        *,
        config: str | Path | None = None,
        synonyms: Synonyms | None = None,
        min_score: float | None = None,
    ) -> None:
        super().__init__(path, 0.0, synonyms)
        self.config_path = Path(config) if config is not None else find_box_model(self.path)
        self.config = read_box_model(self.config_path)
        self.min_score = self.config.output.min_score if min_score is None else min_score
        self.vocabulary = self.config.names or needed(
            metadata_names(self._session),
            "the class names of the detector are not known",
            expected="names or names_file",
            path=self.config_path,
        )
        picture = self.config.input
        self._input, (height, width) = checked_input(self._session, picture, picture.extra, self.config_path)
        if height is None or width is None:
            raise InputError(
                "the model takes any size", expected="size = [HEIGHT, WIDTH] under [input]", path=self.config_path
            )
        self._sides = height, width
        self._outputs = output_names(self.config.output)
        checked_outputs(self._session, self._outputs, self.config_path)

    def fingerprint(self) -> str:
        described = self.config.model_dump_json(exclude={"names", "names_file"})
        parts = (VERSION, self._hash, described, names_hash(self.vocabulary or ()), self._synonyms_hash)
        return f"boxes:{self.min_score}:{':'.join(parts)}"

    def detect(self, frame: Frame, labels: Sequence[str] | None) -> Proposals:
        """Detections of the named classes, best first; `ids` are output rows."""
        wanted = self._wanted(labels)
        candidates, placement = self._once(frame, self._forward)
        score, which = self._best(candidates.scores, wanted)
        chosen = np.flatnonzero(score >= max(self.min_score, 1e-6))
        boxes = self._in_picture(candidates.boxes[chosen], placement, frame)
        nms_iou = self.config.output.nms_iou if self.config.output.nms else 1.0
        kept = class_wise(boxes, score[chosen], which[chosen], MAX_PER_NAME, nms_iou=nms_iou)
        chosen = chosen[kept]
        return proposals_of(boxes[kept], score[chosen], which[chosen], wanted, chosen)

    def _in_picture(self, boxes: np.ndarray, placement: InputPlacement, frame: Frame) -> np.ndarray:
        units = self.config.output.units
        if units == "share":
            boxes = boxes * ([placement.width, placement.height] * 2)
        if units != "picture":
            boxes = placement.to_picture(boxes)
        return np.clip(np.nan_to_num(boxes), 0, [frame.width, frame.height] * 2)

    def _forward(self, frame: Frame) -> tuple[BoxCandidates, InputPlacement]:
        tensor, placement = place_picture(frame.rgb, *self._sides, self.config.input)
        numbers = {
            "height": frame.height,
            "width": frame.width,
            "input_height": placement.height,
            "input_width": placement.width,
            "scale_y": placement.scale_y,
            "scale_x": placement.scale_x,
        }
        extra = {n: np.array([[numbers[w] for w in words]], np.float32) for n, words in self.config.input.extra.items()}
        values = run_session(self._session, self._outputs, {self._input: tensor, **extra}, self.path)
        outputs = dict(zip(self._outputs, values, strict=True))
        with in_file(self.config_path):
            return decode(outputs, self.config.output, len(self.vocabulary or ()), self._sides), placement
