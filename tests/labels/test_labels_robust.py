"""Labelling when things go wrong: shared folders, damage, full disks, killed parents, odd names and numbers."""

from __future__ import annotations

import errno
import json
import os
import pickle
import shutil
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from label_checks import changed_within
from waiting import wait_until

from pipeline import __version__
from pipeline.datasets import demo_path
from pipeline.labels import (
    LabelConfig,
    LabelStore,
    SelectConfig,
    SourceSpec,
    label_dataset,
    label_shard,
    load_plan,
    make_plan,
    merge,
    merge_labels,
    open_labeller,
    open_labels,
    save_plan,
)
from pipeline.labels.plan import BY_TIME, files_hash
from pipeline.proposals.recorded import RecordedDetector
from pipeline.relations import shipped_network
from pipeline.system import InputError, MissingExtra, clear_abandoned, temporary_sibling, whole_files

DEMO = SourceSpec("demo")
QUICK = LabelConfig(second_opinion="none")


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Labels of two frames of the demo in two shards."""
    out = tmp_path_factory.mktemp("robust") / "labels"
    label_dataset(DEMO, out, QUICK, limit=2, frames_a_shard=1)
    return out


@pytest.fixture
def labels(made: Path, tmp_path: Path) -> Path:
    """A copy of them, to be damaged."""
    return Path(shutil.copytree(made, tmp_path / "labels"))


def contents(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def dead_pid() -> int:
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()
    return process.pid


# Writers that share a folder.


def test_two_writers_of_one_shard_do_not_meet(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plan = make_plan(DEMO, QUICK, limit=1, frames_a_shard=1)
    store, shard = LabelStore(tmp_path), plan.shards[0]
    store.prepare()
    labeller = open_labeller(plan.spec, plan.config)
    write, nested = whole_files.write_synced, []

    def write_while_another_does(path: Path, data: bytes) -> None:
        if not nested:
            # It has this process's number too, as writers in two containers can have.
            nested.append(True)
            label_shard(shard, labeller, LabelStore(tmp_path))
        write(path, data)

    monkeypatch.setattr("pipeline.labels.store.write_synced", write_while_another_does)
    label_shard(shard, labeller, store)
    assert nested
    store.check_part(shard.name, shard.key)
    assert [p.name for p in (tmp_path / "parts").iterdir()] == [shard.name]


def test_only_what_dead_writers_left_is_cleared(tmp_path: Path) -> None:
    living = temporary_sibling(tmp_path / "000001-a")
    dead = living.with_name(living.name.replace(f".{os.getpid()}.", f".{dead_pid()}."))
    far = living.with_name(f".000002-b.elsewhere.{os.getpid()}.0123abcd.tmp")
    old = living.with_name(f".000003-c.elsewhere.{os.getpid()}.0123abcd.tmp")
    for folder in (living, dead, far, old):
        folder.mkdir()
        (folder / "frames.parquet").write_bytes(b"")
    os.utime(old, (1, 1))
    clear_abandoned(tmp_path)
    assert set(tmp_path.iterdir()) == {living, far}


def test_the_first_plan_of_a_folder_stands(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first, second = (make_plan(DEMO, LabelConfig(seed=s, second_opinion="none"), limit=1) for s in (1, 2))
    store, late = LabelStore(tmp_path), LabelStore(tmp_path)
    save_plan(first, store)
    read, seen = late.read_text, []
    # The second task looked before the first had written.
    monkeypatch.setattr(late, "read_text", lambda name: read(name) if seen else seen.append(name))
    with pytest.raises(InputError, match="other seed"):
        save_plan(second, late)
    assert load_plan(store) == first


def test_a_resumed_run_leaves_a_running_one_alone(labels: Path) -> None:
    shutil.rmtree(labels / "parts" / load_plan(LabelStore(labels)).shards[0].name)
    other = temporary_sibling(labels / "parts" / "000000-other")
    other.mkdir()
    label_dataset(DEMO, labels, QUICK, limit=2, frames_a_shard=1, resume=True)
    assert other.is_dir()


def test_a_folder_of_something_else_is_refused_by_tasks_and_resumed_runs_too(tmp_path: Path) -> None:
    (tmp_path / "thesis.txt").write_text("mine")
    for more in ({"part": (1, 2)}, {"resume": True}):
        with pytest.raises(InputError, match="something else than labels"):
            label_dataset(DEMO, tmp_path, QUICK, limit=1, **more)  # pyright: ignore[reportArgumentType]
    assert [p.name for p in tmp_path.iterdir()] == ["thesis.txt"]


def test_more_tasks_than_shards(tmp_path: Path) -> None:
    report = label_dataset(DEMO, tmp_path / "out", QUICK, limit=2, frames_a_shard=1, part=(3, 5))
    assert (report.frames, report.broken) == (0, 0)


# Plans.


@pytest.mark.slow
def test_labels_may_go_into_the_dataset(tmp_path: Path) -> None:
    copy = Path(shutil.copytree(demo_path(), tmp_path / "data"))
    spec, out = SourceSpec(str(copy)), copy / "labels"
    for k in (1, 2):
        label_dataset(spec, out, QUICK, limit=2, frames_a_shard=1, part=(k, 2))
    assert label_dataset(spec, out, QUICK, limit=2, frames_a_shard=1, resume=True).reused == 2


def test_names_that_are_not_utf8_still_count_as_input(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"1")
    before = files_hash(tmp_path)
    try:
        Path(os.fsdecode(os.fsencode(tmp_path) + b"/\xff\xfe")).write_bytes(b"2")
    except OSError:
        pytest.skip("this file system has UTF-8 names only")
    assert files_hash(tmp_path) != before


def test_what_was_said_of_camera_and_names_is_part_of_the_plan(tmp_path: Path) -> None:
    synonyms = tmp_path / "synonyms.json"
    synonyms.write_text('{"groups": [["mug", "cup"]]}')
    plain = make_plan(DEMO, QUICK, limit=1)
    for options in ({"depth_scale": 500.0}, {"intrinsics": [1.0, 1.0, 1.0, 1.0]}, {"synonyms": str(synonyms)}):
        try:
            other = make_plan(SourceSpec("demo", options), QUICK, limit=1)
        except InputError:
            continue  # The demo has a camera of its own, and refuses another.
        assert other.key != plain.key
        store = LabelStore(tmp_path / "_".join(options))
        store.prepare()
        save_plan(plain, store)
        with pytest.raises(InputError, match="other " + next(iter(options)).replace("_", " ")):
            save_plan(other, store)


def test_shards_of_another_release_are_not_mixed_in(labels: Path) -> None:
    plan = load_plan(LabelStore(labels))
    assert plan.version == __version__
    older = replace(plan, version="0.0.1")
    assert not {s.key for s in older.shards} & {s.key for s in plan.shards}
    (labels / "plan.json").write_text(json.dumps(older.record()))
    with pytest.raises(InputError, match="other release"):
        save_plan(plan, LabelStore(labels))


@pytest.mark.parametrize("limit", [0, -1])
def test_a_limit_is_a_number_of_frames(limit: int) -> None:
    with pytest.raises(InputError, match="at least one frame"):
        make_plan(DEMO, QUICK, limit=limit)


@pytest.mark.parametrize("balance", [0.5, float("inf"), float("nan")])
def test_a_balance_is_a_number(balance: float) -> None:
    with pytest.raises(InputError, match="balance"):
        SelectConfig(balance=balance)


def test_the_plan_holds_absolute_paths(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shutil.copytree(demo_path(), tmp_path / "data")
    monkeypatch.chdir(tmp_path)
    label_dataset(SourceSpec("data"), "out", QUICK, limit=1)
    assert load_plan(LabelStore(tmp_path / "out")).spec.path == str(tmp_path / "data")
    assert SourceSpec("demo", {"model": "m.onnx"}).absolute() == SourceSpec("demo", {"model": str(tmp_path / "m.onnx")})
    fused = SourceSpec("demo", {"fuse": ["annotations", "yolo-seg=m.onnx"]}).absolute()
    assert fused.options == {"fuse": ["annotations", f"yolo-seg={tmp_path / 'm.onnx'}"]}


def test_a_dataset_that_changes_under_the_run_is_noticed(tmp_path: Path) -> None:
    copy = Path(shutil.copytree(demo_path(), tmp_path / "data"))
    image = next((copy / "000001" / "rgb").iterdir())
    with pytest.raises(InputError, match="changed while it was labelled"):
        label_dataset(
            SourceSpec(str(copy)), tmp_path / "out", QUICK, limit=1, progress=lambda *_: changed_within(image)
        )
    with pytest.raises(InputError, match="not merged yet"):
        open_labels(tmp_path / "out")


@pytest.mark.parametrize("written", ["pipeline.labels.store.write_synced", "pipeline.labels.reading.pq.write_table"])
def test_a_full_disk_is_told_and_gone_on_from(written: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: Any, **__: Any) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    out = tmp_path / "out"
    with monkeypatch.context() as patch:
        patch.setattr(written, full)
        with pytest.raises(InputError, match=r"cannot be written; got No space left .*--resume"):
            label_dataset(SourceSpec("demo"), out, QUICK, limit=1)
    assert not list(out.rglob(".*"))
    with pytest.raises(InputError):
        open_labels(out)
    label_dataset(SourceSpec("demo"), out, QUICK, limit=1, resume=True)
    assert open_labels(out).frames.num_rows == 1


# Damage.


def test_damaged_parts_are_named_when_merging(labels: Path) -> None:
    store = LabelStore(labels)
    first, second = load_plan(store).shards
    folder = labels / "parts" / first.name
    whole = contents(folder)
    data = bytearray(whole["relations.parquet"])
    data[len(data) // 2] ^= 1
    before = contents(labels)
    other = contents(labels / "parts" / second.name)
    for name, damaged, said in (
        ("relations.parquet", bytes(data), r"another content of relations\.parquet"),
        ("objects.parquet", whole["objects.parquet"][:100], r"another content of objects\.parquet"),
        ("part.json", b"", "unreadable part.json"),
        ("part.json", b'{"key": 1}', "unreadable part.json"),
        ("part.json", b"\xff", "unreadable part.json"),
        ("part.json", other["part.json"], "rows of another shard"),
    ):
        (folder / name).write_bytes(damaged)
        with pytest.raises(InputError, match=said):
            merge_labels(labels)
        (folder / name).write_bytes(whole[name])
    (folder / "frames.parquet").unlink()
    with pytest.raises(InputError, match=r"no frames\.parquet"):
        merge_labels(labels)
    (folder / "frames.parquet").write_bytes(whole["frames.parquet"])
    assert contents(labels) == before


def test_a_damaged_record_stops_a_resumed_run_in_one_line(labels: Path) -> None:
    (labels / "parts" / load_plan(LabelStore(labels)).shards[0].name / "part.json").write_text("{")
    with pytest.raises(InputError, match=r"damaged.*remove its folder"):
        label_dataset(DEMO, labels, QUICK, limit=2, frames_a_shard=1, resume=True)


def test_a_damaged_part_at_a_url_is_an_input_error(tmp_path: Path) -> None:
    fsspec = pytest.importorskip("fsspec")
    where = f"memory://damaged-{os.getpid()}"
    label_dataset(DEMO, where, QUICK, limit=1)
    store = LabelStore(where)
    (shard,) = load_plan(store).shards
    memory = fsspec.filesystem("memory")
    (path,) = memory.glob(f"/damaged-{os.getpid()}/parts/{shard.name}/frames-*.parquet")
    memory.pipe_file(path, b"PAR1")
    with pytest.raises(InputError, match="not a readable Parquet file"):
        store.read_part(shard.name, "frames")
    with pytest.raises(InputError, match="another content"):
        merge_labels(where, out=tmp_path)


@pytest.mark.parametrize("at", ["write_merged", "dataset_card", "write_schemas"])
def test_a_merge_that_fails_leaves_the_tables_as_they_were(
    labels: Path, monkeypatch: pytest.MonkeyPatch, at: str
) -> None:
    before = contents(labels)
    real, calls = getattr(merge, at), []

    def full(*arguments: object) -> object:
        calls.append(at)
        if at != "write_merged" or len(calls) == 3:
            raise OSError(28, "No space left on device")
        return real(*arguments)

    monkeypatch.setattr(merge, at, full)
    with pytest.raises(OSError, match="No space"):
        merge_labels(labels, SelectConfig(per_frame=1))
    assert contents(labels) == before


def test_a_merge_that_is_killed_leaves_no_labels_that_only_seem_whole(
    labels: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    move, moved = os.replace, []

    def killed(source: Path, final: Path) -> None:
        if len(moved) == 3:
            raise KeyboardInterrupt
        moved.append(final)
        move(source, final)

    monkeypatch.setattr(merge.os, "replace", killed)
    with pytest.raises(KeyboardInterrupt):
        merge_labels(labels, SelectConfig(per_frame=1))
    with pytest.raises(InputError, match="not merged yet"):
        open_labels(labels)
    monkeypatch.setattr(merge.os, "replace", move)
    manifest = merge_labels(labels, SelectConfig(per_frame=1))
    assert manifest.counts["expressions"] == 2
    assert open_labels(labels).expressions.num_rows == 2


def test_merging_into_a_file_is_refused(made: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="go into a folder"):
        merge_labels(made, out=tmp_path / "file")


def test_broken_frames_count_when_their_shard_is_kept_too(tmp_path: Path) -> None:
    copy = Path(shutil.copytree(demo_path(), tmp_path / "data"))
    sorted((copy / "000001" / "depth").iterdir())[0].write_bytes(b"not a picture")
    spec, out = SourceSpec(str(copy)), tmp_path / "out"
    first = label_dataset(spec, out, QUICK, limit=1)
    again = label_dataset(spec, out, QUICK, limit=1, resume=True)
    assert (first.broken, again.broken, again.reused) == (1, 1, 1)


# Workers.


def test_a_model_that_cannot_be_opened_is_told_before_anything_is_written(tmp_path: Path) -> None:
    junk = tmp_path / "junk.onnx"
    junk.write_text("junk")
    for name, said in ((str(junk), "cannot load the model"), (str(tmp_path / "none.onnx"), "is a network")):
        with pytest.raises(InputError, match=said):
            label_dataset(DEMO, tmp_path / "out", LabelConfig(second_opinion=name), workers=2)
    assert not (tmp_path / "out").exists()


def test_errors_of_workers_reach_their_parent_whole() -> None:
    for error in (MissingExtra("the engine ray", "cluster"), InputError("odd", got=1, path="x")):
        again = pickle.loads(pickle.dumps(error))
        assert (str(again), vars(again)) == (str(error), vars(error))


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="reads Linux's /proc")
def test_workers_end_with_a_parent_that_was_killed(tmp_path: Path) -> None:
    script = tmp_path / "run.py"
    script.write_text(
        "from pipeline.labels.job import *\n"
        f"if __name__ == '__main__': label_dataset(SourceSpec('demo'), {str(tmp_path / 'out')!r}, workers=2, "
        "frames_a_shard=1)"
    )
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).resolve().parents[2])}
    run = subprocess.Popen([sys.executable, str(script)], env=environment, start_new_session=True)
    parts = tmp_path / "out" / "parts"
    wait_until(lambda: run.poll() is not None or (parts.is_dir() and any(parts.glob("[!.]*"))))
    assert len(living(run.pid)) > 1, "the run ended before it could be killed"
    os.kill(run.pid, signal.SIGKILL)
    run.wait()
    try:
        assert wait_until(lambda: not living(run.pid))
    finally:
        if living(run.pid):
            os.killpg(run.pid, signal.SIGKILL)


def living(group: int) -> list[int]:
    """The processes of a group that have not ended."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = stat.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if int(fields[2]) == group and fields[0] != "Z":
            found.append(int(stat.parent.name))
    return found


# Machines.


def test_machines_with_copies_of_their_own_share_a_folder(tmp_path: Path) -> None:
    first, second = (tmp_path / name / "data" for name in ("one", "two"))
    shutil.copytree(demo_path(), first)
    shutil.copytree(demo_path(), second, copy_function=shutil.copyfile)
    opinion = shutil.copy(shipped_network(), tmp_path / "opinion.onnx")
    other = shutil.copy(opinion, tmp_path / "the_same.onnx")
    for k, (root, network) in enumerate(((first, opinion), (second, other)), 1):
        config = LabelConfig(second_opinion=str(network))
        label_dataset(SourceSpec(str(root)), tmp_path / "out", config, limit=2, frames_a_shard=1, part=(k, 2))
    assert merge_labels(tmp_path / "out").dataset["path"] == str(first)
    rows = {name: entry.content_hash for name, entry in open_labels(tmp_path / "out").manifest.tables.items()}
    alone = label_dataset(SourceSpec(str(second)), tmp_path / "alone", LabelConfig(second_opinion=str(other)), limit=2)
    assert alone.manifest is not None
    assert rows == {name: entry.content_hash for name, entry in alone.manifest.tables.items()}


def test_a_plan_by_times_of_change_is_gone_on_with(tmp_path: Path) -> None:
    """As plans were before files counted by content."""
    copy = Path(shutil.copytree(demo_path(), tmp_path / "data"))
    spec, out = SourceSpec(str(copy)), tmp_path / "out"
    store = LabelStore(out)
    store.prepare()
    plan = make_plan(spec.absolute(), QUICK, limit=2, frames_a_shard=1, out=out, like=BY_TIME)
    assert plan.input_hash == files_hash(copy, out, BY_TIME)
    assert len(plan.input_hash) == 64
    save_plan(plan, store)
    assert label_dataset(spec, out, QUICK, limit=2, frames_a_shard=1, part=(1, 2)).frames == 1
    report = label_dataset(spec, out, QUICK, limit=2, frames_a_shard=1, resume=True)
    assert (report.reused, load_plan(store)) == (1, plan)
    os.utime(next((copy / "000001" / "rgb").iterdir()), ns=(1, 1))
    with pytest.raises(InputError, match="other input files"):
        label_dataset(spec, out, QUICK, limit=2, frames_a_shard=1, resume=True)


def test_a_recording_counts_by_content_wherever_it_is(tmp_path: Path) -> None:
    recorded = tmp_path / "a" / "detections.json"
    recorded.parent.mkdir()
    recorded.write_text(json.dumps({"frames": {"000001/000000": []}}))
    copy = Path(shutil.copyfile(recorded, tmp_path / "detections.json"))
    os.utime(copy, ns=(1, 1))
    one, two = (RecordedDetector(path).fingerprint() for path in (recorded, copy))
    assert one == two
    assert str(tmp_path) not in one
    recorded.write_text(recorded.read_text().replace("000000", "000001"))
    assert RecordedDetector(recorded).fingerprint() != one
