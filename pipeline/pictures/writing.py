"""Pictures and films written to files, whole or not at all; the format follows the file's ending."""

from __future__ import annotations

import io
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from pipeline.system.errors import as_input_error, require
from pipeline.system.frozen import dataclass
from pipeline.system.whole_files import write_whole

FILMS = (".gif", ".webp")
"""Endings of films."""
QUALITY = 82
"""Of a film's pictures in WebP, 0 to 100."""


@dataclass(frozen=True, eq=False)
class Film:
    """Pictures in turn, again and again."""

    pictures: tuple[np.ndarray, ...]  # (H, W, 3) uint8 RGB each
    milliseconds: tuple[int, ...]  # How long each is shown


def check_target(path: Path, films: bool = False) -> None:
    """Refuse, before it is drawn, a picture whose folder or kind of file is not known; `films`: a film will do, too."""
    require(path.parent.is_dir(), "the folder for the picture does not exist", path=path.parent)
    known = bool(path.suffix) and cv2.haveImageWriter(f"picture{path.suffix.lower()}")
    expected = ".png or .jpg" + (f", or for a film {' or '.join(FILMS)}" if films else "")
    require(known, "cannot write a picture of this kind", got=path.suffix, expected=expected, path=path)


def write_picture(image: np.ndarray, path: Path) -> None:
    """Write a picture ((H, W, 3) uint8 RGB), whole or not at all; the format follows the file's ending."""
    check_target(path)
    write_whole(path, encoded_picture(image, path.suffix.lower()), "the picture")


def encoded_picture(image: np.ndarray, ending: str = ".png") -> bytes:
    """Bytes of a picture ((H, W, 3) uint8 RGB)."""
    return cv2.imencode(ending, np.ascontiguousarray(image[..., ::-1]))[1].tobytes()


def write_film(film: Film, path: Path) -> None:
    """Write a film, whole or not at all, as GIF or WebP by the file's ending."""
    require(path.parent.is_dir(), "the folder for the film does not exist", path=path.parent)
    write_whole(path, encoded_film(film, path.suffix), "the film")


def is_film(path: Path) -> bool:
    """Whether a file is a film by its ending."""
    return path.suffix.lower() in FILMS


def encoded_film(film: Film, ending: str = ".gif") -> bytes:
    """Bytes of a film.

    WebP keeps all colours; GIF has 256 for each picture, and only those that stand still: it is shown everywhere.
    """
    kind, pictures, times = ending.lower().removeprefix("."), film.pictures, list(film.milliseconds)
    require(f".{kind}" in FILMS, "cannot write a film of this kind", got=ending, expected=" or ".join(FILMS))
    images = [Image.fromarray(picture) for picture in pictures]
    options: dict[str, object] = {"quality": QUALITY, "method": 4}
    if kind == "gif":
        images, options = [image.quantize(256, dither=Image.Dither.FLOYDSTEINBERG) for image in images], {}
    file = io.BytesIO()
    with as_input_error("a film of this kind cannot be written here", KeyError, OSError, ValueError, got=str):
        images[0].save(file, kind.upper(), save_all=True, append_images=images[1:], duration=times, loop=0, **options)
    return file.getvalue()
