"""Files of text vectors as FastText and numpy write them, with words and numbers of one's choice."""

from __future__ import annotations

import io
import struct
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

VOCABULARY = (
    "</s>",
    "the",
    "chair",
    "table",
    "mug",
    "trash",
    "can",
    "bin",
    "shirt",
    "t",
    "of",
    "box",
    "tissue",
    "TV",
    "Polaroid",
    "café",
    "über",
    "naïve",
    "стол",
    "椅子",
    "🪑x",
)


def fasttext_bytes(
    words: Sequence[str] = VOCABULARY,
    labels: Sequence[str] = (),
    *,
    dimension: int = 7,
    buckets: int = 101,
    lengths: tuple[int, int] = (3, 6),
    version: int = 12,
    model: int = 2,
    quantised: bool = False,
    pruned: int = -1,
    matrix: np.ndarray | None = None,
) -> bytes:
    """A model as FastText's saveModel writes it, the output matrix included."""
    if matrix is None:
        rng = np.random.default_rng(5)
        matrix = rng.normal(size=(len(words) + buckets, dimension)).astype("<f4")
    loss = 3 if model == 3 else 2
    out = [
        struct.pack("<14id", 793712314, version, dimension, 5, 5, 1, 5, 1, loss, model, buckets, *lengths, 100, 1e-4)
    ]
    out.append(struct.pack("<3i2q", len(words) + len(labels), len(words), len(labels), 1000, pruned))
    for kind, names in ((0, words), (1, labels)):
        out += [name.encode() + b"\0" + struct.pack("<qb", 97, kind) for name in names]
    out.append(struct.pack("<?2q", quantised, *matrix.shape) + matrix.tobytes())
    output = np.zeros((len(words), dimension), "<f4")
    out.append(struct.pack("<?2q", False, *output.shape) + output.tobytes())
    return b"".join(out)


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
