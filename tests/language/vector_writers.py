"""Files of text vectors as FastText and numpy write them, with words and numbers of one's choice."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np


def vec_text(vectors: Mapping[str, np.ndarray] | Sequence[tuple[str, np.ndarray]]) -> bytes:
    """As FastText's saveVectors writes it: a space after every number too."""
    rows = list(vectors.items()) if isinstance(vectors, Mapping) else list(vectors)
    lines = [f"{len(rows)} {len(rows[0][1])}"]
    lines += [f"{word} {' '.join(repr(float(x)) for x in vector)} " for word, vector in rows]
    return "\n".join([*lines, ""]).encode()


def npz_with(path: Path, members: Mapping[str, bytes]) -> Path:
    """An archive of raw members, which need be no arrays."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(f"{name}.npy", content)
    return path


def npy_bytes(array: np.ndarray, *, shape: tuple[int, ...] | None = None) -> bytes:
    """An array file, perhaps with another shape in its header than its data have."""
    file = io.BytesIO()
    header = np.lib.format.header_data_from_array_1_0(array)
    np.lib.format.write_array_header_1_0(file, {**header, "shape": shape or array.shape})
    return file.getvalue() + array.tobytes()


def written(path: Path, content: bytes) -> Path:
    """The path, after the content was written there."""
    path.write_bytes(content)
    return path
