"""What a user says of a detector of their own in a TOML file: its input, its outputs, its class names."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, ValidationError, model_validator

from pipeline.proposals.class_names import read_class_names
from pipeline.system.errors import InputError
from pipeline.system.reading import parse_toml

EXAMPLES = Path(__file__).with_name("detectors")
"""A TOML file for each form of output."""

Triple = tuple[FiniteFloat, FiniteFloat, FiniteFloat]
Side = Annotated[int, Field(ge=8, le=8192)]
Number = Literal["height", "width", "input_height", "input_width", "scale_y", "scale_x"]
"""Of the picture; of the network's input; input pixels per picture pixel."""
Column = Literal["box", "objectness", "scores", "score", "class"]


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class BoxInput(_Table):
    """The input: values are (v * scale - mean) / std of v in 0..255."""

    name: str | None = None
    """By default the only input that `extra` does not name."""
    size: tuple[Side, Side] | None = None
    """Height and width, where the file leaves them open."""
    layout: Literal["NCHW", "NHWC"] = "NCHW"
    colour: Literal["RGB", "BGR"] = "RGB"
    scale: FiniteFloat = 1 / 255
    mean: Triple = (0.0, 0.0, 0.0)
    std: tuple[Annotated[float, Field(gt=0)], Annotated[float, Field(gt=0)], Annotated[float, Field(gt=0)]] = (1, 1, 1)
    """Mean and std in the order of `colour`."""
    fit: Literal["letterbox", "letterbox-top-left", "stretch"] = "letterbox"
    pad: Annotated[int, Field(ge=0, le=255)] = 114
    interpolation: Literal["linear", "cubic"] = "linear"
    extra: dict[str, tuple[Number, ...]] = {}
    """More inputs, each a row of numbers: orig_target_sizes = ["width", "height"]."""


class BoxOutput(_Table):
    """The outputs. `form` says how they are laid out, and which of the other keys it wants."""

    form: Literal["rows", "separate", "distances"]
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
    units: Literal["input", "share", "picture"] = "input"
    """Boxes are in pixels of the input, shares of it, or pixels of the picture."""
    activation: Literal["none", "sigmoid", "softmax"] = "none"
    """What makes probabilities of the scores."""
    background: Literal["none", "first", "last"] = "none"
    """A class that is none."""
    nms: bool = True
    """Rivals must still be suppressed: they are not in the file."""
    nms_iou: Annotated[float, Field(gt=0, le=1)] = 0.5
    min_score: Annotated[float, Field(ge=0, le=1)] = 0.25

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


class BoxModel(_Table):
    """The whole of the file."""

    input: BoxInput = BoxInput()
    output: BoxOutput
    names: tuple[str, ...] = ()
    """Class names in the order of the outputs; by default those in the model's metadata."""
    names_file: str | None = None
    """The same in a file, named as seen from the TOML; see `read_class_names`."""


def read_box_model(path: Path) -> BoxModel:
    """What a TOML file says of a detector; with the names of `names_file` in `names`.

    Raises
    ------
    InputError
        The file cannot be read, or a key is unknown, missing or wrong.
    """
    try:
        table: dict[str, Any] = parse_toml(path.read_text(encoding="utf-8-sig"))
    except (OSError, ValueError, RecursionError) as error:
        raise InputError("the detector's TOML file cannot be read", got=str(error), path=path) from error
    try:
        model = BoxModel.model_validate(table)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(p) for p in first["loc"]) or "the top"
        keys = {(): BoxModel, ("input",): BoxInput, ("output",): BoxOutput}.get(first["loc"][:-1])
        unknown = "extra" in first["type"] and keys is not None
        raise InputError(
            f"the detector's TOML file is wrong at {place}",
            got="a key that there is not" if unknown else first["msg"],
            expected="one of " + ", ".join(keys.model_fields) if unknown and keys else None,
            path=path,
        ) from error
    if model.names and model.names_file:
        raise InputError("the TOML file gives class names twice", expected="names or names_file", path=path)
    if model.names_file:
        return model.model_copy(update={"names": read_class_names(path.parent / model.names_file)})
    return model


def find_box_model(model: Path) -> Path:
    """The TOML file beside a model: of its name, or the only one in its folder.

    Raises
    ------
    InputError
        Where there is none.
    """
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
