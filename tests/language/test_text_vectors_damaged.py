"""Damaged and hostile files of text vectors: one clear error, and no memory taken before sizes are checked."""

from __future__ import annotations

import gzip
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from vector_writers import npy_bytes, npz_with, vec_text, written

from pipeline.language import open_vectors
from pipeline.system import InputError


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "do not begin"),
        (b"mug 1 2\n", "do not begin"),
        (b"\xff\xfe1\x00 \x002\x00\n", "do not begin"),
        (b"1 0\nmug\n", "makes no sense"),
        (b"0 2\n", "makes no sense"),
        (b"1 99999999999\nmug 1\n", "makes no sense"),
        (b"999999999999999999 2\nmug 1 2\n", "1 words where its header says 999999999999999999"),
        (b"3 2\nmug 1 2\ncan 1 2\n", "2 words where its header says 3"),
        (b"1 2\nmug 1 2\ncan 1 2\n", "more than the 1 words"),
        (b"2 3\nmug 1 2\ncan 1 2\n", "2 numbers in line 2"),
        (b"2 2\nmug 1 2\ncan 1", "1 numbers in line 3"),
        (b"2 2\nmug 1 nan\ncan 1 2\n", "not finite"),
        (b"2 2\nmug 1 1e300\ncan 1 2\n", "not finite"),
        (b"2 2\nmug 1 x\ncan 1 2\n", "no number"),
        (b"1 2\nmug 1 " + b"1" * 100_000 + b"\n", "a line of over"),
    ],
)
def test_damaged_text_is_refused(tmp_path: Path, content: bytes, message: str) -> None:
    path = written(tmp_path / "bad.vec", content)
    with pytest.raises(InputError, match=message) as caught:
        open_vectors(path).phrases(["mug"])
    assert "\n" not in str(caught.value)
    with pytest.raises(InputError, match=message):
        open_vectors(written(tmp_path / "bad.vec.gz", gzip.compress(content))).phrases(["mug"])


def test_packed_text_cut_short_is_refused(tmp_path: Path) -> None:
    packed = gzip.compress(vec_text({"mug": np.arange(1.0, 40.0), "can": np.arange(2.0, 41.0)}))
    for end in (5, 60, len(packed) - 4):
        path = written(tmp_path / "cut.vec.gz", packed[:end])
        with pytest.raises(InputError):
            open_vectors(path).phrases(["mug"])


NAMES = npy_bytes(np.array(["mug", "can"]))
ROWS = npy_bytes(np.ones((2, 3), np.float32))


@pytest.mark.parametrize(
    ("members", "message"),
    [
        ({"vectors": ROWS}, "lacks its arrays"),
        ({"words": NAMES}, "lacks its arrays"),
        ({"words": NAMES, "phrases": NAMES, "vectors": ROWS}, "lacks its arrays"),
        ({"words": NAMES, "vectors": npy_bytes(np.ones((3, 3)))}, "differ in number"),
        ({"words": NAMES, "vectors": npy_bytes(np.ones((2, 3), int))}, "no table of vectors"),
        ({"words": NAMES, "vectors": npy_bytes(np.ones(2))}, "no table of vectors"),
        ({"words": NAMES, "vectors": npy_bytes(np.ones((2, 0)))}, "no table of vectors"),
        ({"words": NAMES, "vectors": npy_bytes(np.array([[1, 2], [np.nan, 1]]))}, "not finite; got that of 'can'"),
        ({"words": NAMES, "vectors": npy_bytes(np.array([[1, 2], [1e200, 1]]))}, "not finite"),
        ({"words": NAMES, "vectors": npy_bytes(np.ones((2, 3)), shape=(10**12, 300))}, "too large"),
        ({"words": NAMES, "vectors": ROWS[:-4]}, "cannot be read"),
        ({"words": NAMES, "vectors": b"no array"}, "cannot be read"),
        # A TokenError of Python's tokenizer, by which NumPy reads it.
        ({"words": NAMES.replace(b"{'descr'", b"(" * 8), "vectors": ROWS}, "cannot be read"),
        ({"words": NAMES, "vectors": ROWS, "kind": npy_bytes(np.array(["a", "b"]))}, "cannot be read"),
        ({"words": npy_bytes(np.array([1, 2])), "vectors": ROWS}, "no list of names"),
        ({"words": npy_bytes(np.array([b"\xff", b"a"])), "vectors": ROWS}, "not UTF-8"),
        ({"words": NAMES, "vectors": npy_bytes(np.zeros((120_000, 300), np.float64))}, "too large"),
    ],
)
def test_damaged_tables_are_refused(tmp_path: Path, members: dict[str, bytes], message: str) -> None:
    path = npz_with(tmp_path / "bad.npz", members)
    tracemalloc.start()
    with pytest.raises(InputError, match=message):
        open_vectors(path)
    assert tracemalloc.get_traced_memory()[1] < 5e6
    tracemalloc.stop()


def test_python_objects_are_never_unpickled(tmp_path: Path) -> None:
    np.savez(tmp_path / "bad.npz", words=np.array(["mug", None], object), vectors=np.ones((2, 3)))
    with pytest.raises(InputError, match="allow_pickle=False"):
        open_vectors(tmp_path / "bad.npz")


def test_a_table_cut_short_is_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "words.npz", words=np.array(["mug", "can"]), vectors=np.ones((2, 300)))
    content = (tmp_path / "words.npz").read_bytes()
    for end in range(0, len(content), 97):
        with pytest.raises(InputError):
            open_vectors(written(tmp_path / "cut.npz", content[:end]))


@pytest.mark.parametrize("name", ["none.vec", "model.ftz", "model.bin", "words.json", "words.txt", "words"])
def test_other_files_are_refused(tmp_path: Path, name: str) -> None:
    if not name.startswith("none"):
        written(tmp_path / name, b"1 1\nmug 1\n")
    with pytest.raises(InputError, match="expected"):
        open_vectors(tmp_path / name)
