"""Tensors declared in an ONNX file, and the files of their values, read from protobuf without loading."""

from __future__ import annotations

import math
import mmap
from collections.abc import Iterator
from pathlib import Path

from pipeline.system.errors import require
from pipeline.system.frozen import dataclass
from pipeline.system.limits import LIMITS_OPTION, within
from pipeline.system.safe_files import checked_path, limits_of, opened

_INSIDE: dict[str, dict[int, str]] = {
    "model": {7: "graph", 25: "function"},
    "graph": {1: "node", 5: "tensor", 15: "sparse"},
    "function": {7: "node"},
    "node": {5: "attribute"},
    "attribute": {5: "tensor", 6: "graph", 10: "tensor", 11: "graph", 22: "sparse", 23: "sparse"},
    "sparse": {1: "tensor", 2: "tensor"},
    "tensor": {13: "entry"},
}
"""Which fields of which message hold what (onnx.proto); the other ones are stepped over."""
_BYTES = {1: 4, 4: 2, 5: 2, 6: 4, 7: 8, 8: 8, 10: 2, 11: 8, 12: 4, 13: 8, 14: 8, 15: 16, 16: 2}
"""Bytes of an element by TensorProto.DataType; else 1."""


@dataclass(frozen=True)
class Declared:
    """Tensor of a file: dimensions, bytes, and the file of its values ("" for this one)."""

    dims: tuple[int, ...]
    bytes: int
    location: str


def declared_tensors(path: Path) -> Iterator[Declared]:
    """Tensors of an ONNX file, up to any damage; raises as `opened`."""
    limits = limits_of(path)
    most = limits.members + 1
    with opened(path, "model") as file:
        if file.seek(0, 2) == 0:
            return
        with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
            left, seen = [("model", 0, len(content))], 0
            while left:
                kind, start, end = left.pop()
                dims: list[int] = []
                element, location = 1, ""
                try:
                    for number, value in _fields(content, start, end):
                        seen += 1
                        if seen % most == 0:
                            within(seen, "members", "a network's list of parts", path, limits)
                        if isinstance(value, tuple):
                            inside = _INSIDE[kind].get(number)
                            if inside == "entry":
                                entry = dict(_fields(content, *value))
                                key, text = (_bytes(content, entry.get(k)) for k in (1, 2))
                                location = text.decode("utf-8", "replace") if key == b"location" else location
                            elif inside:
                                left.append((inside, *value))
                            elif number == (3 if kind == "sparse" else 1) and kind in ("tensor", "sparse"):
                                dims += _packed(content, *value)
                        elif kind == "tensor" and number == 2:
                            element = _BYTES.get(value, 1)
                        elif number == (3 if kind == "sparse" else 1) and kind in ("tensor", "sparse"):
                            dims.append(value)
                except (IndexError, TypeError, OverflowError):  # No protobuf, or cut off: ONNX Runtime says so.
                    pass
                if kind in ("tensor", "sparse"):
                    yield Declared(tuple(dims), math.prod(dims) * element, location)


def check_network(path: Path) -> None:
    """Raise InputError for an ONNX file or weights too large, outside the folder, or no regular file.

    A declared tensor above the limit is refused too, whatever its file holds.
    """
    limits = limits_of(path)
    tensors = list(declared_tensors(path))
    for tensor in tensors:
        size = "x".join(map(str, tensor.dims))
        within(tensor.bytes, "tensor", f"a tensor of {size} in the network", path, limits)
    folder, beside = path.resolve().parent, path.parent.resolve()
    for name in sorted({tensor.location for tensor in tensors} - {""}):
        real = (path.parent / name).resolve()
        require(
            limits.links or real.is_relative_to(folder) or real.is_relative_to(beside),
            "weights outside the network's folder",
            got=repr(name[:80]),
            expected="a file beside it",
            cause=f"{LIMITS_OPTION} links=1 allows it, if you trust whoever made it",
            path=path,
        )
        if real.exists():
            checked_path(real, "model")


def weight_files(path: Path) -> list[str]:
    """Files of weights, relative to the model's folder."""
    return sorted({tensor.location for tensor in declared_tensors(path)} - {""})


def _fields(content: mmap.mmap, start: int, end: int) -> Iterator[tuple[int, int | tuple[int, int]]]:
    """Fields of a message: number, and value of a varint or (start, end) of longer bytes."""
    while start < end:
        key, start = _varint(content, start)
        wire = key & 7
        if wire == 0:
            value, start = _varint(content, start)
            yield key >> 3, value
        elif wire == 2:
            length, start = _varint(content, start)
            if start + length > end:
                raise IndexError("cut off")
            yield key >> 3, (start, start + length)
            start += length
        elif wire in (1, 5):
            start += 8 if wire == 1 else 4
        else:
            raise IndexError("no protobuf")


def _varint(content: mmap.mmap, at: int) -> tuple[int, int]:
    value = content[at]
    if value < 128:
        return value, at + 1
    value &= 127
    for k in range(1, 10):
        byte = content[at + k]
        value |= (byte & 127) << 7 * k
        if byte < 128:
            return value, at + k + 1
    raise IndexError("no varint")


def _packed(content: mmap.mmap, start: int, end: int) -> list[int]:
    values = []
    while start < end:
        value, start = _varint(content, start)
        values.append(value)
    return values


def _bytes(content: mmap.mmap, value: int | tuple[int, int] | None) -> bytes:
    return content[value[0] : value[1]] if isinstance(value, tuple) else b""
