"""Labels at a URL: whole or not there, read like others, corrected with a journal elsewhere."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any
from uuid import uuid4

import pytest
from label_checks import DEMO, FRAMES, demo  # noqa: F401

from pipeline.corrections.journal.journal import journal_of
from pipeline.datasets import demo_path
from pipeline.labels import LabelStore, SelectConfig, SourceSpec, begun_labels, label_dataset, merge_labels, open_labels
from pipeline.labels import store as stores
from pipeline.labels.check import check_labels
from pipeline.labels.job import LabelReport, finished
from pipeline.labels.plan import load_plan
from pipeline.labels.reading import MANIFEST_FILE
from pipeline.system import InputError, remote, remote_folder

fsspec = pytest.importorskip("fsspec")
TABLES = ("frames", "objects", "relations", "expressions")


class Full:
    """A store that fails at the n-th file."""

    def __init__(self, memory: Any, monkeypatch: pytest.MonkeyPatch, at: int) -> None:
        self.left, put = at, memory.pipe_file

        def pipe_file(path: str, value: bytes, **options: Any) -> None:
            self.left -= 1
            if not self.left:
                raise OSError("the connection was reset")
            put(path, value, **options)

        monkeypatch.setattr(memory, "pipe_file", pipe_file)


@pytest.fixture
def memory() -> Any:
    return fsspec.filesystem("memory")


@pytest.fixture
def url(memory: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> str:
    monkeypatch.setenv("SPATIALVIZ_CACHE", str(tmp_path / "cache"))
    return f"memory://bucket-{uuid4().hex}/labels"


@pytest.fixture
def there(demo: Path, url: str, memory: Any) -> str:
    """The labels of `demo`, in three shards by three tasks, merged."""
    for k in (1, 2, 3):
        label_dataset(DEMO, url, limit=FRAMES, frames_a_shard=2, part=(k, 3))
    merge_labels(url)
    return url


def hashes(where: str | Path) -> dict[str, str]:
    return {name: entry.content_hash for name, entry in open_labels(where).manifest.tables.items()}


def test_tasks_that_share_a_url_give_the_labels_of_one_machine(there: str, demo: Path, memory: Any) -> None:
    labels = open_labels(there)
    assert hashes(there) == hashes(demo)
    for name in TABLES:
        assert labels.table(name).equals(open_labels(demo).table(name))
    assert [(f.rule, f.frame) for f in check_labels(labels)] == [
        (f.rule, f.frame) for f in check_labels(open_labels(demo))
    ]
    # The shards are neither listed nor fetched by who reads.
    assert not (labels.root / "parts").exists()
    assert repr(labels) == repr(open_labels(demo)).replace("<Labels demo", "<Labels labels")


def test_labels_that_are_merged_anew_are_read_anew(there: str) -> None:
    before = open_labels(there).expressions.num_rows
    merge_labels(there, SelectConfig(per_frame=1))
    assert open_labels(there).expressions.num_rows == FRAMES < before


def test_of_a_part_that_breaks_off_nothing_counts_and_the_rest_is_kept(
    url: str, demo: Path, memory: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    label_dataset(DEMO, url, limit=FRAMES, frames_a_shard=2, part=(1, 3))
    with monkeypatch.context() as patch:
        Full(memory, patch, at=3)
        with pytest.raises(
            InputError, match=r"URL cannot be reached; got OSError: the connection was reset .*parts/000001"
        ):
            label_dataset(DEMO, url, limit=FRAMES, frames_a_shard=2, part=(2, 3))
    with pytest.raises(InputError, match="2 of 3 shards are missing; got 1, 2"):
        merge_labels(url)
    with pytest.raises(InputError, match="not merged yet"):
        open_labels(url)
    report = label_dataset(DEMO, url, limit=FRAMES, frames_a_shard=2, resume=True)
    assert (report.reused, report.manifest is not None) == (2, True)
    assert hashes(url) == hashes(demo)


def test_a_merge_that_breaks_off_leaves_no_labels_that_only_seem_whole(
    there: str, demo: Path, memory: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    put, count = memory.put_file, []

    def put_file(path: str, to: str, **options: Any) -> None:
        count.append(to)
        if len(count) == 3:
            raise PermissionError("Access Denied")
        put(path, to, **options)

    with monkeypatch.context() as patch:
        patch.setattr(memory, "put_file", put_file)
        with pytest.raises(InputError, match="URL cannot be reached; got PermissionError: Access Denied"):
            merge_labels(there)
    remote.list_anew()
    with pytest.raises(InputError, match="not merged yet"):
        open_labels(there)
    merge_labels(there)
    assert hashes(there) == hashes(demo)
    assert len(count) == 3
    assert not any(MANIFEST_FILE in name for name in count)


def test_two_tasks_at_one_shard_leave_it_whole_though_they_write_otherwise(
    url: str, demo: Path, memory: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As two releases of pyarrow do; the other one is in the middle of its files when this one ends."""
    bytes_of = stores.parquet_bytes
    put, other = memory.pipe_file, {"at": 0}

    def pipe_file(path: str, value: bytes, **options: Any) -> None:
        put(path, value, **options)
        if "/relations-" in path and not other["at"]:
            other["at"] = 1
            with monkeypatch.context() as patch:
                patch.setattr(
                    stores,
                    "parquet_bytes",
                    lambda rows: bytes_of(rows.replace_schema_metadata({**rows.schema.metadata, b"by": b"another"})),
                )
                label_dataset(DEMO, url, limit=2, frames_a_shard=2, part=(1, 1))

    with monkeypatch.context() as patch:
        patch.setattr(memory, "pipe_file", pipe_file)
        label_dataset(DEMO, url, limit=2, frames_a_shard=2, part=(1, 1))
    shard = load_plan(LabelStore(url)).shards[0]
    assert len(memory.glob(f"{url.removeprefix('memory:/')}/parts/{shard.name}/relations-*.parquet")) == 2
    assert merge_labels(url).counts["frames"] == 2
    assert isinstance(finished(shard, LabelStore(url)), LabelReport)


def test_a_record_that_names_files_elsewhere_leads_nowhere(there: str, memory: Any, tmp_path: Path) -> None:
    root = there.removeprefix("memory:/")
    (path,) = memory.glob(f"{root}/parts/000001-*/part.json")
    record = json.loads(memory.cat_file(path))
    record["files"]["../../../outside"] = {"rows": 1, "sha256": "0", "file": "x.parquet"}
    record["files"]["frames"]["file"] = "../../../../frames.parquet"
    memory.pipe_file(path, json.dumps(record).encode())
    with pytest.raises(InputError, match="URL cannot be reached; got FileNotFoundError"):
        merge_labels(there, out=tmp_path / "merged")
    memory.pipe_file(path, b"{")
    with pytest.raises(InputError, match=r"finished shard is damaged; got an unreadable part.json .*memory://"):
        merge_labels(there, out=tmp_path / "merged")


def test_a_folder_of_something_else_is_left_alone(url: str, memory: Any, tmp_path: Path) -> None:
    memory.pipe_file(f"{url}/thesis.txt", b"mine")
    memory.pipe_file(f"{url}/odd\nname\\", b"odd")
    with pytest.raises(InputError, match="not empty"):
        label_dataset(DEMO, url, limit=1)
    with pytest.raises(InputError, match="something else than labels"):
        label_dataset(DEMO, url, limit=1, part=(1, 1))
    label_dataset(DEMO, tmp_path / "labels", limit=1)
    with pytest.raises(InputError, match="something else"):
        merge_labels(tmp_path / "labels", out=url)
    assert sorted(path.rpartition("/")[2] for path in memory.ls(url, detail=False)) == ["odd\nname\\", "thesis.txt"]
    merge_labels(tmp_path / "labels", out=f"{url}/below")
    assert hashes(f"{url}/below") == hashes(tmp_path / "labels")


def test_urls_that_cannot_be_written_are_told_in_one_line(
    url: str, memory: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(InputError, match="this kind of URL cannot be reached"):
        label_dataset(DEMO, "nonsense://x/y", limit=1)
    with pytest.raises(InputError, match=r"there are no labels; expected a folder .*\[memory"):
        open_labels(url)
    with pytest.raises(InputError, match="no labels here"):
        merge_labels(url)

    class NoCredentialsError(Exception):
        """As of botocore, which is no OSError."""

    def refuse(*_: Any, **__: Any) -> None:
        raise NoCredentialsError("Unable to locate credentials")

    monkeypatch.setattr(memory, "pipe_file", refuse)
    with pytest.raises(InputError, match=r"URL cannot be reached; got NoCredentialsError: Unable .*plan\.json\]"):
        label_dataset(DEMO, url, limit=1)


def test_no_bucket_is_made_by_the_way(url: str, memory: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[str] = []
    monkeypatch.setattr(memory, "makedirs", lambda path, exist_ok=False: made.append(path))
    monkeypatch.setattr(memory, "protocol", ("s3", "s3a"))
    folder = remote_folder.RemoteFolder(url)
    folder.put("a/b.txt", b"1")
    assert (made, folder.read("a/b.txt")) == ([], b"1")
    monkeypatch.setattr(memory, "protocol", "sftp")
    remote_folder.RemoteFolder(url).put("a/c.txt", b"1")
    assert len(made) == 1


def test_a_journal_is_never_kept_in_the_copy_of_a_url(there: str, tmp_path: Path, memory: Any) -> None:
    labels = open_labels(there)
    with pytest.raises(InputError, match=r"no journal beside them; expected --journal .*\[memory:"):
        journal_of(labels)
    memory.pipe_file(f"{there}/journal.sqlite", b"somebody put it here")
    remote.list_anew()
    with pytest.raises(InputError, match="no journal beside them"):
        journal_of(open_labels(there), must_exist=True)
    with journal_of(labels, tmp_path / "mine.sqlite") as journal:
        assert journal.location == str(tmp_path / "mine.sqlite")
    assert not (labels.root / "journal.sqlite").exists() or (labels.root / "journal.sqlite").stat().st_mode & 0o777 == 0
    with pytest.raises(InputError, match="begun by hand in a folder of this machine"):
        begun_labels(DEMO.open(load_plan(LabelStore(there)).config).dataset, f"{there}-by-hand")


def test_a_file_url_is_a_folder_of_this_machine(demo: Path, tmp_path: Path) -> None:
    label_dataset(DEMO, f"file://{tmp_path}/labels", limit=FRAMES, frames_a_shard=2)
    assert (tmp_path / "labels" / MANIFEST_FILE).is_file()
    assert hashes(f"file://{tmp_path}/labels") == hashes(demo)


def test_input_at_a_url_and_output_at_a_url(url: str, demo: Path, memory: Any) -> None:
    root = url.removesuffix("labels") + "demo"
    for path in demo_path().rglob("*"):
        if path.is_file():
            memory.pipe_file(f"{root}/{path.relative_to(demo_path()).as_posix()}", path.read_bytes())
    label_dataset(SourceSpec(root), url, limit=FRAMES, frames_a_shard=2)
    assert hashes(url) == hashes(demo)
    shutil.rmtree(remote.local_path(root).parent)
    remote.list_anew()
    # Another machine: of the same versions, and so of the same plan.
    assert label_dataset(SourceSpec(root), url, limit=FRAMES, frames_a_shard=2, resume=True).reused == FRAMES
    # What changes there meanwhile is noticed, of whatever size.
    path = f"{root}/000004/rgb/000002.jpg"

    def changed(*_: Any) -> None:
        memory.pipe_file(path, memory.cat_file(path)[::-1])

    with pytest.raises(InputError, match="changed while it was labelled"):
        label_dataset(SourceSpec(root), f"{url}-again", limit=1, progress=changed)
