"""Recordings at a URL: listed once, each file fetched once, through the door with its limits."""

from __future__ import annotations

from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread
from uuid import uuid4

import numpy as np
import pytest
from dataset_writers import write_folder, write_png
from reader_checks import FOLDER, refused
from recording_checks import check_frame, truths

from pipeline.answering import open_sources
from pipeline.datasets import open_dataset
from pipeline.labels.plan import files_hash
from pipeline.system import LIMITS_VARIABLE, remote

fsspec = pytest.importorskip("fsspec")


class Bucket:
    """A place in fsspec's memory, and the files of it that were opened."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.system = fsspec.filesystem("memory")
        self.name = f"/{uuid4().hex}"
        self.url = f"memory:/{self.name}/room"
        self.fetched: list[str] = []
        opened = self.system.open

        def open_(path: str, *args: object, **options: object) -> object:
            self.fetched.append(path.removeprefix(f"{self.name}/room/"))
            return opened(path, *args, **options)

        monkeypatch.setattr(self.system, "open", open_)

    def put(self, name: str, data: bytes) -> None:
        self.system.pipe_file(f"{self.name}/room/{name}", data)
        self.fetched.clear()

    def put_all(self, folder: Path) -> None:
        for path in folder.rglob("*"):
            if path.is_file():
                self.put(path.relative_to(folder).as_posix(), path.read_bytes())


@pytest.fixture
def bucket(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Bucket:
    monkeypatch.setenv("SPATIALVIZ_CACHE", str(tmp_path / "cache"))
    return Bucket(monkeypatch)


@pytest.fixture
def room(bucket: Bucket, tmp_path: Path) -> Bucket:
    for number, truth in enumerate(truths(3)):
        write_png(tmp_path / f"here/color/{number}.png", truth.rgb)
        write_png(tmp_path / f"here/depth/{number}.png", truth.millimetres)
    bucket.put_all(tmp_path / "here")
    return bucket


def listed_again() -> None:
    remote._mirrored.cache_clear()


def test_a_recording_at_a_url_opens_and_each_file_is_fetched_once(room: Bucket) -> None:
    dataset = open_dataset(room.url, **FOLDER)
    assert dataset.frame_ids == ("0", "1", "2")
    assert dataset.root.name == "room"
    assert not room.fetched
    before = files_hash(dataset.root)
    for _ in range(2):
        check_frame(dataset.load("1"), truths(3)[1])
    assert room.fetched == ["color/1.png", "depth/1.png"]
    listed_again()
    check_frame(open_dataset(room.url, **FOLDER).load("1"), truths(3)[1])
    assert room.fetched == ["color/1.png", "depth/1.png"]
    assert files_hash(dataset.root) == before


def test_what_changed_there_is_fetched_again_and_what_is_gone_goes(room: Bucket) -> None:
    dataset = open_dataset(room.url, **FOLDER)
    before = files_hash(dataset.root)
    for frame_id in dataset.frame_ids:
        dataset.load(frame_id)
    changed = np.zeros_like(truths(1)[0].rgb)
    other = Path(dataset.root).parent / "other.png"
    write_png(other, changed)
    room.put("color/1.png", other.read_bytes())
    for part in ("color", "depth"):
        room.system.rm(f"{room.name}/room/{part}/2.png")
    (dataset.root / "spatialviz.toml").write_text("depth_scale = 1000\n")
    listed_again()
    dataset = open_dataset(room.url, **FOLDER)
    assert dataset.frame_ids == ("0", "1")
    assert not dataset.load("1").rgb.any()
    check_frame(dataset.load("0"), truths(3)[0])
    assert room.fetched == ["color/1.png"]
    assert files_hash(dataset.root) != before
    assert (dataset.root / "spatialviz.toml").is_file()


def test_a_file_that_changed_since_it_was_listed_is_no_frame(room: Bucket) -> None:
    dataset = open_dataset(room.url, **FOLDER)
    room.put("depth/1.png", b"x" * 10_000)
    refused(lambda: dataset.load("1"), "changed since it was listed", "depth/1.png", "again")
    room.system.rm(f"{room.name}/room/depth/2.png")
    refused(lambda: dataset.load("2"), "cannot be fetched", "depth/2.png")
    check_frame(dataset.load("0"), truths(3)[0])


def test_limits_hold_before_anything_is_fetched(room: Bucket, monkeypatch: pytest.MonkeyPatch) -> None:
    room.put("color/0.png", bytes(2_000_000))
    monkeypatch.setenv(LIMITS_VARIABLE, "bytes=1M")
    dataset = open_dataset(room.url, **FOLDER)
    refused(lambda: dataset.load("0"), "too large", "2M bytes", "--limits bytes=3M")
    assert not room.fetched
    check_frame(dataset.load("1"), truths(3)[1])
    listed_again()
    monkeypatch.setenv(LIMITS_VARIABLE, "names=5")
    refused(lambda: open_dataset(room.url, **FOLDER), "too large", "names")


def test_a_size_that_is_not_told_is_limited_while_it_is_fetched(room: Bucket, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(remote, "_entry", lambda info: (None, ""))
    room.put("color/0.png", bytes(2_000_000))
    dataset = open_dataset(room.url, **FOLDER)
    monkeypatch.setenv(LIMITS_VARIABLE, "bytes=1M")
    refused(lambda: dataset.load("0"), "too large", "0.png")
    check_frame(dataset.load("1"), truths(3)[1])


def test_names_that_lead_out_or_hide_are_left_out(bucket: Bucket, monkeypatch: pytest.MonkeyPatch) -> None:
    names = [
        "../out.png",
        "color/../../out.png",
        ".hidden",
        "color//x",
        "..\\..\\out.png",
        "b",
        "b/c.txt",
        f"{'n' * 300}.png",
        "d.txt",
    ]
    entries = {name: {"name": f"{bucket.name}/room/{name}", "size": 1, "type": "file"} for name in names}
    monkeypatch.setattr(bucket.system, "info", lambda path: {"type": "directory"})
    monkeypatch.setattr(bucket.system, "walk", lambda path, **options: [(path, {}, entries)])
    root = remote.local_path(bucket.url)
    found = [path.relative_to(root).as_posix() for path in root.rglob("*") if path.is_file()]
    assert sorted(found) == ["b/c.txt", "d.txt"]
    assert not list(root.parent.glob("out*"))


def test_a_capture_and_a_folder_of_datasets_at_a_url(bucket: Bucket, tmp_path: Path) -> None:
    for name in ("a", "b"):
        write_folder(tmp_path / "rooms" / name, [1])
    bucket.put_all(tmp_path / "rooms")
    sources, left_out = open_sources(bucket.url, **FOLDER)
    assert (list(sources), left_out) == (["a", "b"], {})
    sources["b"].dataset.load("1")
    bucket.put("x.bag", b"no bag")
    assert remote.local_path(f"{bucket.url}/x.bag").is_file()


def test_urls_that_cannot_be_read_are_told_in_one_line(room: Bucket, tmp_path: Path) -> None:
    refused(lambda: open_dataset(f"{room.url}/none"), "there is no such dataset", "none")
    refused(lambda: open_dataset("nonsense://x/y"), "this kind of URL", "nonsense")
    open_dataset(room.url, **FOLDER)
    listed_again()

    def broken(path: str) -> None:
        raise OSError("no network")

    room.system.info = broken
    try:
        line = refused(lambda: open_dataset(room.url, **FOLDER), "cannot be listed", "no network", "what was fetched")
    finally:
        del room.system.info
    kept = Path(line.partition("what was fetched is in ")[2].partition(")")[0])
    check_frame(open_dataset(kept, **FOLDER).load("0"), truths(3)[0])
    assert remote.local_path(f"file://{tmp_path}/a%20b") == tmp_path / "a b"


def test_a_web_server_that_lists_its_folders(room: Bucket, tmp_path: Path) -> None:
    pytest.importorskip("aiohttp")
    asked: list[str] = []

    class Handler(SimpleHTTPRequestHandler):
        def log_message(self, format: str, *args: object) -> None:
            asked.append(str(args[0]).split()[1])

    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(Handler, directory=str(tmp_path)))
    Thread(target=server.serve_forever, daemon=True).start()
    try:
        dataset = open_dataset(f"http://127.0.0.1:{server.server_address[1]}/here", **FOLDER)
        assert not [path for path in asked if path.endswith(".png")]
        check_frame(dataset.load("1"), truths(3)[1])
        assert {path for path in asked if path.endswith(".png")} == {"/here/color/1.png", "/here/depth/1.png"}
    finally:
        server.shutdown()
        server.server_close()
    refused(lambda: dataset.load("2"), "cannot be fetched", "2.png")


def test_a_url_that_only_a_file_names_is_not_asked(room: Bucket) -> None:
    refused(lambda: remote.named_before(room.url), "not opened here", room.url)
    open_dataset(room.url, **FOLDER)
    assert remote.named_before(room.url) == room.url
    assert remote.named_before("/some/folder") == "/some/folder"


def test_without_fsspec_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "fsspec", None)
    with pytest.raises(ImportError, match="remote"):
        open_dataset("memory://anything/at-all")
