"""Decoding colour, depth and mask files, with the checks a decoder leaves out.

A decoder may return what it could read of a cut-off file. Every file is therefore walked to its end first: a PNG chunk
by chunk with its checksums, a JPEG marker by marker to its end-of-image marker, a PGM by its size.
"""

from __future__ import annotations

import io
import os
import re
import zlib
from pathlib import Path

import cv2
import numpy as np

from pipeline.datasets.files import CUT_OFF, Blob, Part, read_bytes, shortened
from pipeline.datasets.png_masks import above_zero, mask_of_png
from pipeline.geometry.masks import PictureMask
from pipeline.system import safe_files
from pipeline.system.errors import InputError, as_input_error, needed, require

DEPTH_SUFFIXES = (".png", ".pgm", ".tif", ".tiff", ".exr", ".npy", ".npz", ".pfm")
INTEGER_DEPTH_SUFFIXES = (".png", ".pgm")

_MAGIC = {
    b"\x89PNG\r\n\x1a\n": "png",
    b"\xff\xd8": "jpeg",
    b"P5": "pnm",
    b"P6": "pnm",
    b"II*\0": "tiff",
    b"MM\0*": "tiff",
    b"\x76\x2f\x31\x01": "exr",
    b"\x93NUMPY": "npy",
    b"PK\x03\x04": "npz",
}
_HEADS = {
    "pfm": re.compile(rb"Pf\s+(?P<width>[0-9]{1,6})\s+(?P<height>[0-9]{1,6})\s+(?P<scale>-?[0-9.eE+]{1,20})\s"),
    "colmap": re.compile(rb"(?P<width>[0-9]{1,6})&(?P<height>[0-9]{1,6})&1&"),
}
"""The heads of floats without a frame: PFM, http://netpbm.sourceforge.net/doc/pfm.html, whose scale below 0 means that
they are little-endian; and arrays of COLMAP, `scripts/python/read_write_dense.py`."""
_ARRAYS = ("exr", "npy", "npz", *_HEADS)
"""Kinds that hold numbers and no picture."""


def read_color(path: Blob, upright: bool = False) -> np.ndarray:
    """A colour file as (H, W, 3) uint8 RGB.

    The orientation tag is ignored, since depth maps carry none, unless the picture stands alone and is to be `upright`.

    Raises
    ------
    InputError
        Missing, empty, cut off, corrupt, or no image.
    """
    content = path.read() if isinstance(path, Part) else read_bytes(path)
    if isinstance(content, np.ndarray):
        return content
    kind = _checked(content, path, "png, jpeg, tiff or ppm")
    require(kind not in _ARRAYS, "a colour file must be a png, jpeg, tiff or ppm", got=kind, path=path)
    bgr = _decode(content, kind, path, cv2.IMREAD_COLOR | (0 if upright else cv2.IMREAD_IGNORE_ORIENTATION))
    return cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB)


def read_numbers(path: Blob) -> np.ndarray:
    """Stored mask or label picture, (H, W) or (H, W, C)."""
    return _decode(*_mask_bytes(path), path, cv2.IMREAD_UNCHANGED)


def _mask_bytes(path: Blob) -> tuple[bytes, str]:
    """Bytes of a complete mask file, and its kind."""
    data = read_bytes(path)
    kind = _checked(data, path, "png")
    require(kind not in _ARRAYS, "a mask must be a png", got=kind, path=path)
    return data, kind


def valid_pixels(path: Blob, size: tuple[int, ...]) -> np.ndarray:
    """A validity picture or array of (H, W) as bool: where it is not 0."""
    data = read_bytes(path)
    numbers = np.squeeze(_decode_numpy(data, path)) if _checked(data, path, "png or npy") == "npy" else read_mask(path)
    require(
        numbers.shape == size, "validity of another size than the depth", got=numbers.shape, expected=size, path=path
    )
    return numbers != 0


def read_mask(path: Blob) -> np.ndarray:
    """A mask file as (H, W) bool: whatever is above 0 in any channel but alpha."""
    return read_held_mask(path).whole


def read_held_mask(path: Blob) -> PictureMask:
    """A mask file as of `read_mask`, held by its crop."""
    data, kind = _mask_bytes(path)
    if kind == "png" and (found := mask_of_png(data)) is not None:
        return found
    return PictureMask.of(above_zero(_decode(data, kind, path, cv2.IMREAD_UNCHANGED)))


END_OF_RANGE = 0.01
"""Share of the pixels above which a value at the end of a range of whole bits stands for no depth."""
FARTHEST_FLOAT = 1e5
"""A float from here on is no depth in metres or millimetres, where more than `END_OF_RANGE` of the pixels hold it."""


def end_of_range(stored: np.ndarray) -> float | None:
    """The value of stored depth (H, W) that stands for "nothing" at the end of its range, or None: 65535, and what ends
    a range of 11 to 15 bits or of decimals, or lies beyond any room, in more than 1 % of the pixels. 0, NaN and inf
    need no telling.
    """
    if not stored.size:
        return None
    if stored.dtype.kind == "f":
        largest = float(np.max(stored, initial=0.0, where=np.isfinite(stored)))
        # Floats may be millimetres; 65535 may stand as these or in metres, and 65504 is the largest of 16 bits.
        ends = largest >= FARTHEST_FLOAT or largest in (65504, 65535) or abs(largest - 65.535) < 1e-4
    else:
        largest = int(stored.max())
        if largest == np.iinfo(np.uint16).max:
            return largest
        ends = largest + 1 in (1 << bits for bits in (11, 12, 13, 14, 15, 31, 32))
        # A decimal end, such as 9999 or 50000, needs that nothing was measured in the upper half beside it.
        decimal = largest >= 9999 and (largest % 5000 == 0 or largest + 1 in (10**4, 10**5))
        ends |= decimal and not ((stored > largest // 2) & (stored != largest)).any()
    return largest if ends and np.mean(stored == stored.dtype.type(largest)) > END_OF_RANGE else None


def read_depth(
    path: Blob,
    units_per_metre: float | None,
    nothing: float | None = None,
    rotated: int = 0,
    notes: list[str] | None = None,
) -> np.ndarray:
    """A depth file as (H, W) float32 metres, 0 where nothing was measured. `units_per_metre`: 1000 for millimetres.

    `nothing` is a stored value, besides 0, that means nothing; by default what `end_of_range` finds, told in `notes`.
    """
    stored = read_stored(path, rotated)
    if nothing is None and (nothing := end_of_range(stored)) is not None and notes is not None:
        share = float(np.mean(stored == stored.dtype.type(nothing)))
        notes.append(f"{share:.0%} of the pixels hold {nothing:g}, the end of the range: taken for no depth")
    if units_per_metre is None:
        require(
            stored.dtype.kind == "f",
            "the unit of integer depth is not known",
            expected="--depth-scale UNITS_PER_METRE, 1000 for millimetres",
            path=path,
        )
        units_per_metre = 1.0
    with np.errstate(over="ignore", invalid="ignore"):
        depth = np.divide(stored, np.float32(units_per_metre), dtype=np.float32, casting="same_kind")
        # Integers are metres at least 0 as they stand, but for a unit that is next to nothing.
        if stored.dtype.kind != "u" or not np.isfinite(depth.max()):
            depth[~(np.isfinite(depth) & (depth > 0))] = 0
    if nothing is not None:
        depth[stored == nothing] = 0
    return depth


def read_stored(path: Blob, rotated: int = 0) -> np.ndarray:
    """Stored depth (H, W) of 16-bit or larger integers or floats; see `read_depth`."""
    content = path.read() if isinstance(path, Part) else read_bytes(path)
    stored = content if isinstance(content, np.ndarray) else _decode_depth(content, path)
    if stored.ndim == 3 and 1 in (stored.shape[0], stored.shape[2]):
        stored = stored[..., 0] if stored.shape[2] == 1 else stored[0]
    require(
        stored.dtype.itemsize != 1,
        "depth of 8 bits",
        got=stored.dtype,
        expected="16-bit integers or floats",
        cause="is this a picture of the depth, made for looking at, or a lossy copy?",
        path=path,
    )
    require(stored.ndim == 2, "depth must have one channel", got=f"shape {stored.shape}", path=path)
    require(stored.size, "depth without a pixel", got=f"shape {stored.shape}", path=path)
    require(stored.dtype.kind in "uif", "depth must be numbers", got=stored.dtype, path=path)
    if rotated:
        require(stored.dtype == np.uint16, "depth with rotated bits must have 16", got=stored.dtype, path=path)
        stored = (stored >> rotated) | (stored << (16 - rotated))
    return stored


def _decode_depth(data: bytes, path: Blob) -> np.ndarray:
    kind = _checked(data, path, "png, pgm, tiff, exr, npy, npz or pfm")
    if kind in ("npy", "npz"):
        return _decode_numpy(data, path)
    if kind in _HEADS:
        return _decode_floats(data, kind, path)
    return _decode_exr(data, path) if kind == "exr" else _decode(data, kind, path, cv2.IMREAD_UNCHANGED)


EXIF_TABLE, FOCAL_35MM = 0x8769, 0xA405
"""Tags of EXIF 2.3: where its own tags stand, and FocalLengthIn35mmFilm."""
DIAGONAL_35MM = 43.2666
"""Of 36 by 24 millimetres."""


def exif_focal(path: Blob, height: int, width: int) -> tuple[float, float] | None:
    """Focal length of the picture's EXIF: (pixels, millimetres as of 35 mm film), or None. The diagonals are compared,
    as in `depth_pro/utils.py` of apple/ml-depth-pro (CIPA DCG-001)."""
    from PIL import Image

    try:
        with Image.open(io.BytesIO(read_bytes(path))) as picture:
            millimetres = float(picture.getexif().get_ifd(EXIF_TABLE).get(FOCAL_35MM) or 0)
    except (OSError, ValueError, TypeError, SyntaxError, Image.DecompressionBombError):
        return None
    return (millimetres * float(np.hypot(height, width)) / DIAGONAL_35MM, millimetres) if millimetres > 0 else None


def picture_size(path: Path) -> tuple[int, int] | None:
    """Picture size (width, height) from the header, or None."""
    from PIL import Image

    try:
        with safe_files.opened(path) as file, Image.open(file) as picture:
            return picture.size
    except (OSError, ValueError, Image.DecompressionBombError):
        return None


def _checked(data: bytes, path: Blob, expected: str) -> str:
    """Kind of a complete image file."""
    known = (name for magic, name in _MAGIC.items() if data.startswith(magic))
    kind = needed(
        next(known, None) or next((name for name, head in _HEADS.items() if head.match(data)), None),
        "not an image that can be read",
        got=f"a file that begins with {data[:8]!r}",
        expected=f"a {expected}",
        cause="is it a text file, a Git LFS pointer or a saved web page?",
        path=path,
    )
    whole = {"png": _check_png, "jpeg": _check_jpeg, "pnm": _check_pnm}
    if kind in whole:
        whole[kind](data, path)
    if kind not in _ARRAYS:
        safe_files.check_pixels(data, path)
    return kind


def _check_png(data: bytes, path: Blob) -> None:
    """Walk the PNG chunks to IEND and check CRC-32 (PNG 1.2, section 3)."""
    view, position = memoryview(data), 8
    while position + 12 <= len(data):
        length = int.from_bytes(view[position : position + 4], "big")
        end = position + 12 + length
        if end > len(data):
            break
        require(
            zlib.crc32(view[position + 4 : end - 4]) == int.from_bytes(view[end - 4 : end], "big"),
            "a corrupt PNG: wrong checksum",
            got=f"at byte {position}",
            path=path,
        )
        if view[position + 4 : position + 8] == b"IEND":
            return
        position = end
    raise InputError("a PNG that is cut off", got=f"{len(data)} bytes", cause=CUT_OFF, path=path)


def _check_jpeg(data: bytes, path: Blob) -> None:
    """Walk the markers to EOI (ITU T.81, annex B). Segments are skipped by their length, so that the end of an embedded
    thumbnail is not taken for the end of the picture."""
    position = 2
    while position + 2 <= len(data):
        require(data[position] == 0xFF, "a corrupt JPEG: no marker", got=f"at byte {position}", path=path)
        marker = data[position + 1]
        if marker == 0xD9:
            return
        if marker == 0xFF:
            position += 1
        elif marker == 0x01 or 0xD0 <= marker <= 0xD7:
            position += 2
        else:
            position += 2 + int.from_bytes(data[position + 2 : position + 4], "big")
            if marker == 0xDA:
                # Entropy-coded data: runs to the first marker that is no stuffed 0 and no restart.
                following = re.compile(rb"\xff[^\x00\xd0-\xd7\xff]").search(data, position)
                if following is None:
                    break
                position = following.start()
    raise InputError("a JPEG that is cut off", got=f"{len(data)} bytes", cause=CUT_OFF, path=path)


def _check_pnm(data: bytes, path: Blob) -> None:
    """Check the header and the length of a binary PGM (P5) or PPM (P6)."""
    gap, number = rb"(?:\s|#[^\n]*\n)+", rb"([0-9]{1,9})"
    found = re.match(rb"P([56])" + gap + number + gap + number + gap + number + rb"\s", data)
    header = needed(found, "a PGM or PPM with a malformed header", got=repr(data[:20]), path=path)
    width, height, largest = (int(header[k]) for k in (2, 3, 4))
    sound = width * height > 0 and 0 < largest < 65536
    require(sound, "a PGM or PPM with a malformed header", got=repr(header[0]), path=path)
    wanted = width * height * (3 if header[1] == b"6" else 1) * (2 if largest > 255 else 1)
    require(
        len(data) - header.end() >= wanted,
        "a PGM or PPM that is cut off",
        got=f"{len(data) - header.end()} bytes of pixels",
        expected=wanted,
        cause=CUT_OFF,
        path=path,
    )


def _decode(data: bytes, kind: str, path: Blob, flags: int) -> np.ndarray:
    broken = f"a {kind} that cannot be decoded"
    with as_input_error(broken, cv2.error, got=lambda error: str(error)[-120:], path=path):
        pixels = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    return needed(pixels, broken, cause="is the file cut off or corrupt?", path=path)


def _decode_numpy(data: bytes, path: Blob) -> np.ndarray:
    """Array of an NPY or NPZ: the only array, or the array named for depth."""
    kind = Path(path).suffix[1:].upper() or "array"
    # Damaged bytes fail in zipfile, zlib, numpy or the tokenizer that it uses, each with its own class.
    with as_input_error(f"an {kind} that cannot be read", Exception, got=shortened, cause=CUT_OFF, path=path):
        array = safe_files.load_arrays(data, path)
        if isinstance(array, np.lib.npyio.NpzFile):
            names = [name for name in array.files if len(array.files) == 1 or "depth" in name.lower()]
            require(len(names) == 1, "an NPZ without one array of depth", got=", ".join(array.files), path=path)
            array = array[names[0]]
    return np.asarray(array)


def _decode_floats(data: bytes, kind: str, path: Blob) -> np.ndarray:
    """Array (H, W) of floats behind one of `_HEADS`. PFM has the bottom row first."""
    head = needed(_HEADS[kind].match(data), f"a {kind} without a head", path=path)
    shape = int(head["height"]), int(head["width"])
    rest = data[head.end() :]
    whole = 4 * shape[0] * shape[1]
    require(len(rest) == whole, f"a {kind} of a wrong size", got=len(rest), expected=whole, cause=CUT_OFF, path=path)
    big = kind == "pfm" and not head["scale"].startswith(b"-")
    stored = np.frombuffer(rest, ">f4" if big else "<f4").reshape(shape).astype(np.float32)
    return stored[::-1] if kind == "pfm" else stored


def _decode_exr(data: bytes, path: Blob) -> np.ndarray:
    """Single channel of an OpenEXR file, or the first of several equal channels.

    OpenCV's wheels either lack OpenEXR (5.0) or hide it behind an environment variable that is read when OpenCV is
    imported (4.x), so the format's own package reads it.
    """
    try:
        import OpenEXR  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise InputError(
            "an EXR file needs the OpenEXR package, which is not installed",
            expected="pip install OpenEXR",
            cause="the wheels of OpenCV cannot be relied on to read EXR",
            path=path,
        ) from error
    safe_files.check_pixels(data, path)
    # The package raises plain RuntimeError and ValueError alike.
    with (
        as_input_error("an EXR that cannot be read", Exception, got=shortened, path=path),
        OpenEXR.File(os.fspath(path), separate_channels=True) as image,
    ):
        channels = [np.array(channel.pixels) for channel in image.channels().values()]
    require(
        channels and not any(not np.array_equal(channels[0], other, equal_nan=True) for other in channels[1:]),
        "depth must have one channel",
        got=f"{len(channels)} different ones",
        path=path,
    )
    return channels[0]
