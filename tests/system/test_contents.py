"""Datasets by content: alike on every machine, and another where a file is another."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest

from pipeline.datasets import demo_path
from pipeline.system import contents
from pipeline.system.contents import PIECE, contents_hash


@pytest.fixture(autouse=True)
def cache(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    monkeypatch.setenv("SPATIALVIZ_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture
def data(tmp_path: Path) -> Path:
    root = tmp_path / "data"
    (root / "b" / "c").mkdir(parents=True)
    (root / "a.txt").write_text("one\n" * 10_000)
    (root / "b" / "big.bin").write_bytes(bytes(100_000))
    (root / "b" / "c" / "small.png").write_bytes(b"\x89PNG\0")
    (root / ".hidden").write_text("does not count")
    return root


def rewritten(path: Path, at: int) -> None:
    """Another byte at this place; size and time stay."""
    state, content = path.stat(), bytearray(path.read_bytes())
    content[at] ^= 1
    path.write_bytes(content)
    os.utime(path, ns=(state.st_atime_ns, state.st_mtime_ns))


def test_copies_elsewhere_and_of_another_time_are_alike(data: Path, tmp_path: Path) -> None:
    copy = tmp_path / "elsewhere" / "other"
    shutil.copytree(data, copy, copy_function=shutil.copyfile)
    os.utime(copy / "a.txt", ns=(1, 1))
    (copy / ".hidden").unlink()
    assert contents_hash(copy) == contents_hash(data)
    assert contents_hash(copy / "a.txt") == contents_hash(Path(shutil.copy(data / "a.txt", tmp_path / "b.txt")))


@pytest.mark.parametrize(
    ("name", "at"),
    [("a.txt", 20_001), ("b/big.bin", 0), ("b/big.bin", 50_001), ("b/big.bin", 99_999), ("b/c/small.png", 2)],
)
def test_another_content_of_the_same_size_and_time_is_another(data: Path, name: str, at: int) -> None:
    before = contents_hash(data)
    rewritten(data / name, at)
    assert contents_hash(data) != before
    rewritten(data / name, at)
    assert contents_hash(data) == before


def test_of_a_large_file_that_is_no_text_three_pieces_count(data: Path) -> None:
    before = contents_hash(data)
    rewritten(data / "b/big.bin", 2 * PIECE)
    assert contents_hash(data) == before


def test_a_file_more_less_or_renamed_is_another_dataset(data: Path) -> None:
    seen = {contents_hash(data)}
    (data / "b" / "new").write_text("")
    seen.add(contents_hash(data))
    (data / "b" / "new").rename(data / "new")
    seen.add(contents_hash(data))
    (data / "a.txt").rename(data / "A.txt")
    seen.add(contents_hash(data))
    (data / "A.txt").write_text("")
    seen.add(contents_hash(data))
    assert len(seen) == 5
    assert contents_hash(data, leave_out=data / "b") != contents_hash(data)


def test_the_order_in_which_a_file_system_lists_names_does_not_count(
    data: Path, monkeypatch: pytest.MonkeyPatch, cache: Path
) -> None:
    before, walk = contents_hash(data), contents.walk
    shutil.rmtree(cache)
    monkeypatch.setattr(contents, "walk", lambda *where: reversed(list(walk(*where))))
    assert contents_hash(data) == before


def test_what_was_read_once_is_not_read_again(data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    opened, read = [], os.open
    monkeypatch.setattr(
        contents.os, "open", lambda path, flags, *mode: (opened.append(path), read(path, flags, *mode))[1]
    )
    before = contents_hash(data)
    assert len([path for path in opened if str(data) in str(path)]) == 3
    opened.clear()
    assert contents_hash(data) == before
    assert not [path for path in opened if str(data) in str(path)]
    os.utime(data / "a.txt")
    assert contents_hash(data) == before
    assert [path for path in opened if str(data) in str(path)]


@pytest.mark.skipif(os.name != "posix", reason="links and special files of POSIX")
def test_links_and_special_files(data: Path, tmp_path: Path) -> None:
    plain = contents_hash(data)
    shutil.move(data / "a.txt", tmp_path / "kept.txt")
    (data / "a.txt").symlink_to(tmp_path / "kept.txt")
    assert contents_hash(data) == plain, "a file and a link to it are alike"
    rewritten(tmp_path / "kept.txt", 7)
    assert contents_hash(data) != plain
    seen = {contents_hash(data)}
    (data / "loop").symlink_to(data)
    seen.add(contents_hash(data))
    os.mkfifo(data / "b" / "fifo")
    (data / "b" / "device").symlink_to("/dev/zero")
    (data / "b" / "nowhere").symlink_to("/nowhere/at/all")
    seen.add(contents_hash(data))
    assert len(seen) == 3


def test_a_damaged_cache_is_no_hash(data: Path, cache: Path) -> None:
    before = contents_hash(data)
    (kept,) = (cache / "contents").iterdir()
    for content in (b"", b"\xff" * 64, b"too short"):
        kept.write_bytes(content)
        assert contents_hash(data) == before
    shutil.rmtree(cache)
    cache.write_text("no folder")
    assert contents_hash(data) == before


def test_the_demo_is_the_same_everywhere(tmp_path: Path) -> None:
    copy = shutil.copytree(demo_path(), tmp_path / "demo", copy_function=shutil.copyfile)
    assert contents_hash(Path(copy)) == contents_hash(demo_path())
