"""Pickles of other programs, read without trust: numbers, text, plain containers and numpy arrays.

Nothing that a file names is imported or called. Arrays and their types are rebuilt here from their bytes, and paths as
text; what a known library puts beside them (settings of OmegaConf, tensors) is passed over; any other name is refused.
What a file may make this process hold is bounded, and the bytes of an array are let go as soon as it is made.
"""

from __future__ import annotations

import gzip
import math
import pickle
import re
from collections.abc import Callable
from pathlib import Path, PurePosixPath
from typing import Any, BinaryIO, ClassVar

import numpy as np

from pipeline.system.errors import InputError, kind_and_text, needed, require
from pipeline.system.safe_files import opened

MOST_OF_ARRAY = 1 << 30
"""Bytes of one array."""
MOST_OF_REST = 1 << 28
"""Bytes of all that is no long array: each may become an object."""
MOST = 1 << 36
"""Bytes of a file, unpacked."""
LONG = 1 << 16
"""From so many bytes on a pickle writes an array outside its frames."""

_PASSED_OVER = ("omegaconf", "typing", "torch", "uuid")
_NUMBERS = ("int", "float", "str", "bool", "long")
_DTYPE = re.compile(r"[<>|=]?([biufcSU][0-9]{1,5})")


class Passed:
    """Object of a known library, passed over."""

    def __init__(self, *given: Any) -> None: ...

    def build(self, state: Any) -> None: ...

    def append(self, item: Any) -> None: ...

    def __setitem__(self, key: Any, item: Any) -> None: ...


class _Type:
    """numpy type by letter and size."""

    def __init__(self, text: str, *more: Any) -> None:
        self._code = _DTYPE.fullmatch(text)
        self._order = "="

    def build(self, state: tuple[Any, ...]) -> None:
        self._order = state[1]

    @property
    def numpy(self) -> np.dtype:
        code = needed(self._code, "an array of a type that is not read", expected="numbers, truth values or text")
        require(self._order in ("<", ">", "=", "|"), "an array with an unknown order of bytes", got=repr(self._order))
        return np.dtype(self._order.replace("|", "=") + code[1])


class Array:
    """Array of a file; `value` is the result of `keep` of `read_plain_pickle`, None before the reading."""

    def __init__(self, keep: Callable[[np.ndarray], Any]) -> None:
        self.value: Any = None
        self._keep = keep

    def build(self, state: tuple[Any, ...]) -> None:
        _, shape, kind, fortran, data = state
        self.fill(data, kind, shape, "F" if fortran else "C")

    def fill(self, data: Any, kind: _Type, shape: Any, order: Any) -> Array:
        require(
            isinstance(data, bytes | bytearray) and isinstance(kind, _Type), "an array of objects", expected="numbers"
        )
        require(
            isinstance(shape, tuple) and all(type(n) is int and n >= 0 for n in shape) and order in ("C", "F"),
            "an array without a shape",
        )
        dtype = kind.numpy
        require(
            math.prod(shape) * dtype.itemsize == len(data),
            "an array that does not fill its shape",
            got=f"{len(data)} bytes",
            expected=f"{shape} of {dtype}",
        )
        self.value = self._keep(np.frombuffer(data, dtype).reshape(shape, order=order))
        return self


class _Memo(dict[int, Any]):
    """Memory of an unpickler without bytes of arrays, every one of which would be kept to the end."""

    def __setitem__(self, index: int, value: Any) -> None:
        # An array's state is a tuple of its bytes.
        inside = value if isinstance(value, tuple) else (value,)
        long = any(isinstance(part, bytes | bytearray | str) and len(part) >= LONG for part in inside)
        super().__setitem__(index, None if long else value)


def _scalar(kind: _Type, data: bytes = b"") -> Any:
    found = np.frombuffer(data, kind.numpy)
    require(len(found) == 1, "a number that is none")
    return found[0].item()


def _path(*parts: str) -> str:
    return str(PurePosixPath(*parts))


def _encoded(text: str, encoding: str) -> bytes:
    require(encoding == "latin1", "bytes in an unknown encoding", got=repr(encoding))
    return text.encode("latin1")


_KNOWN: dict[tuple[str, str], Any] = {
    ("dtype", "numpy"): _Type,
    ("ndarray", "numpy"): Passed,
    ("scalar", "multiarray"): _scalar,
    ("encode", "_codecs"): _encoded,
    ("OrderedDict", "collections"): dict,
    ("defaultdict", "collections"): lambda *_: {},
    **{
        (kind.__name__, home): kind
        for kind in (dict, list, set, frozenset, tuple)
        for home in ("builtins", "__builtin__")
    },
    **{(name, home): Passed for name in _NUMBERS for home in ("builtins", "__builtin__")},
    # Bytes of none, as old protocols write them.
    ("bytes", "__builtin__"): lambda: b"",
}


class _PlainUnpickler(pickle._Unpickler):
    """Unpickler in Python: the one in C gives a file as much memory as it asks for."""

    stack: list[Any]
    memo: dict[int, Any]
    read: Callable[[int], bytes]
    dispatch: ClassVar[dict[int, Any]] = dict(pickle._Unpickler.dispatch)
    for _code in (pickle.EXT1, pickle.EXT2, pickle.EXT4):
        del dispatch[_code[0]]

    def __init__(self, file: Any, keep: Callable[[np.ndarray], Any]) -> None:
        super().__init__(file)
        self._keep, self.memo = keep, _Memo()

    def find_class(self, module: str, name: str) -> Any:
        parts = module.split(".")
        if parts[0] == "numpy" and parts[-1] in ("multiarray", "numeric"):
            if name == "_reconstruct":
                return lambda *_: Array(self._keep)
            if name == "_frombuffer":
                return lambda *given: Array(self._keep).fill(*given)
            parts = parts[-1:]
        if parts[0] == "pathlib" and name.endswith("Path"):
            return _path
        if parts[0] in _PASSED_OVER:
            return Passed
        what = "the pickle holds something that is not read"
        return needed(
            _KNOWN.get((name, ".".join(parts))), what, got=f"{module}.{name}", expected="arrays and plain containers"
        )

    def load_build(self) -> None:
        state = self.stack.pop()
        require(isinstance(self.stack[-1], Passed | _Type | Array), "the pickle changes what it did not make")
        self.stack[-1].build(state)

    dispatch[pickle.BUILD[0]] = load_build


class _Bounded:
    """File with a limit on the bytes given to a reader."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self._rest = self._all = 0

    def read(self, size: int) -> bytes:
        require(size <= MOST_OF_ARRAY, "an array is too large", got=f"{size} bytes", expected=f"to {MOST_OF_ARRAY}")
        return self._counted(self._file.read(size))

    def readline(self) -> bytes:
        return self._counted(self._file.readline(MOST_OF_REST))

    def _counted(self, data: bytes) -> bytes:
        self._all += len(data)
        # A pickle's frame is longer than LONG only by its last object.
        self._rest += len(data) if len(data) < 4 * LONG else 0
        require(self._all <= MOST and self._rest <= MOST_OF_REST, "it unpacks to too much", expected=f"{MOST} bytes")
        return data


def read_plain_pickle(path: Path, keep: Callable[[np.ndarray], Any] = np.asarray) -> Any:
    """Read a pickle, also one within gzip: numbers, text (paths too), containers, `Array` and `Passed`.

    `keep` makes `Array.value` of each array: the array itself, or something smaller. Raises InputError for no pickle,
    an unread name in it, or too much memory asked for.
    """
    try:
        with opened(path) as raw:
            packed = raw.read(2) == b"\x1f\x8b"
            raw.seek(0)
            source: Any = gzip.GzipFile(fileobj=raw) if packed else raw
            return _PlainUnpickler(_Bounded(source), keep).load()
    except InputError as error:
        raise InputError(str(error), path=path) from error
    except (Exception, MemoryError) as error:  # Damaged bytes fail in each part of the reader with another class.
        raise InputError("not a pickle that can be read", got=kind_and_text(error)[:120], path=path) from error


def plain(value: Any) -> Any:
    """Value of an array; anything else unchanged."""
    return value.value if isinstance(value, Array) else value
