"""A huge file that declares too much is refused in little memory, whichever library would have read it."""

from __future__ import annotations

import re
import struct
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from pipeline.corrections.journal.examining import examine
from pipeline.datasets import open_dataset
from pipeline.labels import read_table
from pipeline.language.vectors import open_vectors
from pipeline.system import InputError
from tests.slow_cases import mostly_slow

if sys.platform == "linux":
    import resource

SIZE, MEMORY = 3 * 10**9, 300 * 10**6
MCAP, BAG = b"\x89MCAP0\r\n", b"#ROSBAG V2.0\n"
FOOTER = struct.pack("<BQQQI", 2, 20, 8, 0, 0) + MCAP
RECORD_OF_3G = MCAP + struct.pack("<BQ", 1, SIZE - 100)
HEADER_OF_2G = BAG + struct.pack("<I", 2**31 - 1)
MEMBERS_IN_2G = b"PK\x05\x06" + struct.pack("<HHHHIIH", 0, 0, 1, 1, 2**31, 1000, 0)
MANY_MEMBERS_IN_2G = b"PK\x05\x06" + struct.pack("<HHHHIIH", 0, 0, 65534, 65534, 2**31, 1000, 0)
PARQUET_2G = struct.pack("<I", 2 * 10**9) + b"PAR1"

FILES = (
    ("zero.bag", b"", b""),
    ("x.bag", HEADER_OF_2G, b""),
    ("zero.mcap", b"", b""),
    ("x.mcap", RECORD_OF_3G, FOOTER),
    ("x.r3d", b"PK\x03\x04", MEMBERS_IN_2G),
    ("y.r3d", b"PK\x03\x04", MANY_MEMBERS_IN_2G),
    ("zero.db3", b"", b""),
    ("x.parquet", b"PAR1", PARQUET_2G),
    ("zero.parquet", b"", b""),
    ("zero.r3d", b"", b""),
)


@pytest.fixture
def little_memory() -> Iterator[None]:
    """What a test takes beyond `MEMORY` is a MemoryError."""
    status = Path("/proc/self/status").read_text()
    held = re.search(r"VmData:\s+(\d+)", status)
    assert held is not None
    before = resource.getrlimit(resource.RLIMIT_DATA)
    resource.setrlimit(resource.RLIMIT_DATA, (int(held[1]) * 1024 + MEMORY, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_DATA, before)


def sparse(path: Path, head: bytes, tail: bytes) -> Path:
    """A file of 3 GB that takes no place on the disk."""
    with path.open("wb") as file:
        file.write(head)
        file.truncate(SIZE)
        file.seek(SIZE - len(tail))
        file.write(tail)
    return path


def refused(opening: Any) -> None:
    with pytest.raises(InputError) as error:
        opening()
    assert "\n" not in str(error.value)


pytestmark = [
    pytest.mark.skipif(sys.platform != "linux", reason="the memory of a process is bounded on Linux"),
    pytest.mark.usefixtures("little_memory"),
]


@pytest.mark.parametrize(("name", "head", "tail"), mostly_slow(FILES, (0, 3, 4, 5), several=True))
def test_a_huge_capture(name: str, head: bytes, tail: bytes, tmp_path: Path) -> None:
    path = sparse(tmp_path / name, head, tail)
    refused(lambda: open_dataset(path, browse=True))


def test_a_huge_description_of_a_recording(tmp_path: Path) -> None:
    (tmp_path / "x.db3").write_bytes(b"")
    sparse(tmp_path / "metadata.yaml", b"", b"")
    refused(lambda: open_dataset(tmp_path, browse=True))


def test_a_huge_end_of_a_table_of_labels(tmp_path: Path) -> None:
    path = sparse(tmp_path / "objects.parquet", b"PAR1", PARQUET_2G)
    refused(lambda: read_table(path, "objects"))


@pytest.mark.parametrize("head", [b"", b"SQLite format 3\0", b'{"a":"'])
def test_a_huge_journal(head: bytes, tmp_path: Path) -> None:
    path = sparse(tmp_path / "journal.sqlite", head, b"")
    assert examine(path).damage


def test_a_huge_log_of_a_journal(tmp_path: Path) -> None:
    path = tmp_path / "journal.sqlite"
    path.write_bytes(b"SQLite format 3\0" + bytes(4080))
    sparse(tmp_path / "journal.sqlite-wal", b"\x37\x7f\x06\x82", b"")
    assert "log" in examine(path).damage[0]


def test_a_huge_table_of_vectors(tmp_path: Path) -> None:
    path = sparse(tmp_path / "x.npz", b"PK\x03\x04", MEMBERS_IN_2G)
    refused(lambda: open_vectors(path))
