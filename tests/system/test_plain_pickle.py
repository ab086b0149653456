"""Pickles read without trust: nothing in them runs, and they get no more memory than they are worth."""

from __future__ import annotations

import gzip
import os
import pickle
import tracemalloc
from pathlib import Path
from typing import Any
from uuid import uuid4

import numpy as np
import pytest
from concept_graph_maps import CFG
from slow_cases import mostly_slow

from pipeline.system import InputError, plain, plain_pickle, read_plain_pickle
from pipeline.system.plain_pickle import Passed


class Runs:
    """What a hostile file holds."""

    def __init__(self, mark: Path) -> None:
        self.mark = mark

    def __reduce__(self) -> Any:
        return os.system, (f"touch {self.mark}",)


def of(folder: Path, content: bytes) -> Any:
    path = folder / "file.pkl"
    path.write_bytes(content)
    return read_plain_pickle(path)


@pytest.mark.parametrize("protocol", mostly_slow(range(6), fast=(0, 4)))
def test_arrays_and_plain_containers_are_read(tmp_path: Path, protocol: int) -> None:
    arrays = [
        np.arange(6).reshape(2, 3), np.asfortranarray(np.arange(6.0).reshape(2, 3)), np.zeros((0, 3), np.float32),
        np.array(["ab", "ü"]), np.random.default_rng(0).random((300, 200)) > 0.5, np.array([1, 2], ">i4"),
    ]  # fmt: skip
    content = {"a": arrays, "n": [np.float32(0.5), np.int64(3), np.bool_(True)], "t": (1, None, "x", {2}), "f": 0.25}
    data = pickle.dumps(content, protocol=protocol)
    for written in (data, gzip.compress(data), data.replace(b"numpy._core", b"numpy.core") if protocol == 2 else data):
        found = of(tmp_path, written)
        for mine, theirs in zip(found["a"], arrays, strict=True):
            np.testing.assert_array_equal(plain(mine), theirs)
        assert found["n"] == [0.5, 3, True]
        assert (found["t"], found["f"]) == ((1, None, "x", {2}), 0.25)


def test_settings_of_a_known_library_are_passed_over(tmp_path: Path) -> None:
    assert isinstance(of(tmp_path, CFG), Passed)
    assert of(tmp_path, pickle.dumps([Path("a/b"), Path("/")])) == ["a/b", "/"]
    assert isinstance(of(tmp_path, pickle.dumps(uuid4())), Passed)


def test_nothing_of_a_file_is_run(tmp_path: Path) -> None:
    mark = tmp_path / "ran"
    for protocol in range(6):
        for content in (Runs(mark), {"objects": [Runs(mark)]}, eval, print, Path.home, np.load, pickle.loads, Runs):
            data = pickle.dumps(content, protocol=protocol)
            with pytest.raises(InputError, match=r"holds something that is not read; got \w+") as error:
                of(tmp_path, data)
            assert "\n" not in str(error.value)
    # A name within a library that is passed over is not looked up either.
    of(tmp_path, b"ctorch\nos.system\n(X\x0b\x00\x00\x00touch /nonetR.")
    assert not mark.exists()


HUGE = (1 << 40).to_bytes(8, "little")


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"junk",
        b"\x80\x04",
        b"\x80\x04]\x94h\x07.",
        b"\x80\x04N" * 9,
        b"\x80\x04\x8e" + HUGE + b".",  # Bytes of a terabyte,
        b"\x80\x05\x96" + HUGE + b".",  # a bytearray of one,
        b"\x80\x04\x95" + HUGE + b"N.",  # a frame of one,
        b"\x80\x04Nr\xff\xff\xff\x7fN",  # a memo of 2**31 entries.
        b"cnumpy.core.multiarray\n_reconstruct\n(tR}b.",
        pickle.dumps(np.array([{}], object)),
        b"cnumpy.core.numeric\n_frombuffer\n(U\x02abcnumpy\ndtype\n(U\x02f8tRK\x01\x85U\x01CtR.",
        b"cnumpy\ndtype\n}U\x05numpyK\x01sb.",  # Changing a class,
        b"\x80\x04]N}\x86b.",  # a list's state.
        b"\x82\x01.",  # A registered extension.
        b"Pthing\n.",
        b"\x97.",
    ],
)
def test_damaged_and_hostile_files_are_refused_in_one_line(tmp_path: Path, content: bytes) -> None:
    tracemalloc.start()
    with pytest.raises(InputError) as error:
        of(tmp_path, content)
    assert tracemalloc.get_traced_memory()[1] < 1 << 24
    tracemalloc.stop()
    assert "\n" not in str(error.value)


def test_what_a_file_unpacks_to_is_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(plain_pickle, "MOST_OF_REST", 1 << 20)
    many = gzip.compress(pickle.dumps([{"k": k} for k in range(200_000)]), 1)
    with pytest.raises(InputError, match="it unpacks to too much"):
        of(tmp_path, many)
    monkeypatch.setattr(plain_pickle, "MOST_OF_ARRAY", 1 << 20)
    with pytest.raises(InputError, match="an array is too large"):
        of(tmp_path, gzip.compress(pickle.dumps(np.zeros(1 << 18)), 1))


@pytest.mark.slow
def test_the_bytes_of_arrays_are_let_go(tmp_path: Path) -> None:
    path = tmp_path / "file.pkl"
    path.write_bytes(pickle.dumps([np.zeros((1 << 10, 1 << 10), np.bool_) for _ in range(64)]))
    tracemalloc.start()
    found = read_plain_pickle(path, lambda array: int(array.sum()))
    assert tracemalloc.get_traced_memory()[1] < 8 << 20
    tracemalloc.stop()
    assert [plain(array) for array in found] == [0] * 64
