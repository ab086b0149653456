"""Network input from a picture, as a TOML file describes it, and the picture's place in the input."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import cv2
import numpy as np
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat

from pipeline.system.errors import InputError, require
from pipeline.system.frozen import dataclass
from pipeline.system.onnx_session import signature
from pipeline.system.reading import checked, parse_toml
from pipeline.system.safe_files import read_text

Triple = tuple[FiniteFloat, FiniteFloat, FiniteFloat]
Side = Annotated[int, Field(ge=8, le=8192)]


class ContractTable(BaseModel):
    """A table of such a file: an unknown key is an error."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class PictureInput(ContractTable):
    """The input of the picture: values are (v * scale - mean) / std of v in 0..255."""

    name: str | None = None
    """By default the only input that is not named otherwise."""
    size: tuple[Side, Side] | None = None
    """Height and width, where the file leaves them open."""
    layout: Literal["NCHW", "NHWC"] = "NCHW"
    """Order of the tensor: channels first or last."""
    colour: Literal["RGB", "BGR"] = "RGB"
    """Order of the channels."""
    scale: FiniteFloat = 1 / 255
    """Factor of a value of 0 to 255."""
    mean: Triple = (0.0, 0.0, 0.0)
    """Taken off after that, in the order of `colour`."""
    std: tuple[Annotated[float, Field(gt=0)], Annotated[float, Field(gt=0)], Annotated[float, Field(gt=0)]] = (1, 1, 1)
    """What is left is divided by it, in the order of `colour`."""
    fit: Literal["letterbox", "letterbox-top-left", "stretch"] = "letterbox"
    """How the picture fills the input: whole, in the middle or at the top left, or stretched."""
    pad: Annotated[int, Field(ge=0, le=255)] | Triple = 114
    """Padding around the picture: one value, or one each of red, green and blue."""
    interpolation: Literal["linear", "cubic", "area"] = "linear"
    """area: the mean over what a pixel covers where the picture shrinks, linear where it grows."""


Model = TypeVar("Model", bound=ContractTable)


def read_description(path: Path, kind: type[Model], what: str) -> Model:
    """Read the TOML file of a network (`what`: "detector"); InputError for a missing, unknown or wrong key."""
    try:
        table: dict[str, Any] = parse_toml(read_text(path, "utf-8-sig"))
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"the {what}'s TOML file cannot be read", got=str(error), path=path) from error

    def known(place: tuple[Any, ...]) -> Iterable[str]:
        inside: Any = kind
        for key in place[:-1]:
            inside = inside.model_fields[key].annotation
        return inside.model_fields

    return checked(kind.model_validate, table, f"the {what}'s TOML file is wrong at {{}}", path, keys=known)


def checked_input(
    session: Any, config: PictureInput, others: Collection[str], path: Path
) -> tuple[str, tuple[int | None, int | None]]:
    """Name of the picture's input, and its height and width; None where neither the model nor the file fixes them.

    `others` names the inputs that hold something else; `path` is the TOML file, for errors. InputError where the model
    has other inputs, another layout or another size.
    """
    shapes = {i.name: tuple(i.shape) for i in session.get_inputs()}
    unknown = [n for n in (config.name, *others) if n is not None and n not in shapes]
    rest = [n for n in shapes if n not in others]
    if unknown or len(rest) != 1 or (config.name is not None and rest != [config.name]):
        wanted = ", ".join([*([config.name] if config.name else []), *others]) or "one input"
        raise InputError(
            "the model has other inputs than the TOML file says",
            got=signature(session)[:240],
            expected=wanted,
            cause="inputs besides the picture are named under [input.extra]" if len(rest) > 1 else None,
            path=path,
        )
    shape = shapes[rest[0]]
    channels, sides = (shape[1:2], shape[2:]) if config.layout == "NCHW" else (shape[3:], shape[1:3])
    if len(shape) != 4 or (isinstance(channels[0], int) and channels[0] != 3):
        other = "NHWC" if config.layout == "NCHW" else "NCHW"
        raise InputError(
            f"the input {rest[0]} is not {config.layout}",
            got=list(shape),
            expected="3 channels",
            cause=f'is it layout = "{other}"?',
            path=path,
        )
    found: list[int | None] = []
    for declared, fixed in zip(sides, config.size or (None, None), strict=True):
        require(
            not isinstance(declared, int) or fixed is None or fixed == declared,
            "the model takes another size",
            got=list(config.size or ()),
            expected=list(sides),
            path=path,
        )
        found.append(declared if isinstance(declared, int) else fixed)
    return rest[0], (found[0], found[1])


def checked_outputs(session: Any, names: Collection[str], path: Path) -> None:
    """Raise InputError, naming the TOML file, where the model lacks an output."""
    known = [o.name for o in session.get_outputs()]
    missing = [n for n in names if n not in known]
    if missing:
        raise InputError(f"the model has no output {missing[0]}", got=", ".join(known)[:240], path=path)


@dataclass(frozen=True)
class InputPlacement:
    """Scale and offset of the picture in the network's input."""

    scale_x: float  # Input pixels per picture pixel
    scale_y: float
    left: int  # Input pixels before the picture
    top: int
    height: int  # Of the input, pixels
    width: int

    def to_picture(self, boxes: np.ndarray) -> np.ndarray:
        """Boxes in input pixels, (N, 4), as boxes in picture pixels."""
        return (boxes - [self.left, self.top] * 2) / ([self.scale_x, self.scale_y] * 2)


def place_picture(rgb: np.ndarray, height: int, width: int, config: PictureInput) -> tuple[np.ndarray, InputPlacement]:
    """Network input, (1, 3, height, width) or (1, height, width, 3) float32, and the picture's placement."""
    h, w = rgb.shape[:2]
    inner_h, inner_w = height, width
    if config.fit != "stretch":
        scale = min(height / h, width / w)
        inner_h, inner_w = min(max(round(h * scale), 1), height), min(max(round(w * scale), 1), width)
    left = top = 0
    if config.fit == "letterbox":
        # Of an odd rest the smaller half comes first, as in Ultralytics' own letterbox.
        left, top = round((width - inner_w) / 2 - 0.1), round((height - inner_h) / 2 - 0.1)
    kinds = {"linear": cv2.INTER_LINEAR, "cubic": cv2.INTER_CUBIC}
    # OpenCV's mean over areas takes the nearest pixel where a picture grows.
    interpolation = kinds.get(config.interpolation, cv2.INTER_AREA if inner_h < h else cv2.INTER_LINEAR)
    resized = rgb if (h, w) == (inner_h, inner_w) else cv2.resize(rgb, (inner_w, inner_h), interpolation=interpolation)
    image = np.full((height, width, 3), config.pad, np.float32 if isinstance(config.pad, tuple) else np.uint8)
    image[top : top + inner_h, left : left + inner_w] = resized
    if config.colour == "BGR":
        image = image[..., ::-1]
    scaled = image.astype(np.float32) * np.float32(config.scale)
    values = (scaled - np.array(config.mean, np.float32)) / np.array(config.std, np.float32)
    if config.layout == "NCHW":
        values = values.transpose(2, 0, 1)
    return np.ascontiguousarray(values[None]), InputPlacement(inner_w / w, inner_h / h, left, top, height, width)
