"""Auto-labelling: the same rows by every way of making them, nothing lost when killed, and only true sentences."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from label_checks import DEMO, FRAMES, changed_within, demo  # noqa: F401
from slow_cases import mostly_slow
from waiting import wait_until

from pipeline.answering import open_pipeline
from pipeline.datasets import demo_path
from pipeline.labels import (
    PROFILES,
    SCHEMA_VERSION,
    LabelConfig,
    LabelStore,
    Manifest,
    SelectConfig,
    SourceSpec,
    label_dataset,
    label_shard,
    load_plan,
    make_plan,
    merge_labels,
    open_labeller,
    open_labels,
    read_table,
    save_plan,
)
from pipeline.labels.plan import part_of
from pipeline.labels.reading import PART_TABLES
from pipeline.language import DIRECTIONAL, PAIRWISE
from pipeline.system import InputError

REQUIRED = os.environ.get("SPATIALVIZ_REQUIRE_EXTRAS") == "1"


def hashes(manifest: Manifest | None) -> dict[str, str]:
    assert manifest is not None
    return {name: table.content_hash for name, table in manifest.tables.items()}


# The same rows, whatever makes them.


@pytest.mark.parametrize(("workers", "frames_a_shard"), mostly_slow([(2, 3), (1, 1), (1, 100)], several=True))
def test_rows_depend_on_neither_workers_nor_shards(
    demo: Path, tmp_path: Path, workers: int, frames_a_shard: int
) -> None:
    report = label_dataset(DEMO, tmp_path / "out", limit=FRAMES, workers=workers, frames_a_shard=frames_a_shard)
    assert hashes(report.manifest) == hashes(open_labels(demo).manifest)


@pytest.mark.slow
def test_tasks_of_an_array_in_any_order_give_the_same_rows(demo: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    for k in (3, 1, 2):
        report = label_dataset(DEMO, out, limit=FRAMES, frames_a_shard=2, part=(k, 3))
        assert report.manifest is None
        assert report.frames == 2
    assert hashes(merge_labels(out)) == hashes(open_labels(demo).manifest)


def test_ray_gives_the_same_rows(demo: Path, tmp_path: Path) -> None:
    if not REQUIRED:
        pytest.importorskip("ray", reason="the extra cluster is not installed")
    ray: Any = import_module("ray")
    ray.init("local", num_cpus=2, include_dashboard=False, log_to_driver=False)
    try:
        report = label_dataset(DEMO, tmp_path / "out", limit=FRAMES, frames_a_shard=3, engine="ray", workers=2)
        assert hashes(report.manifest) == hashes(open_labels(demo).manifest)
        # A detector of its own stage: what it recorded of the same frames, labelled in this process and by Ray.
        recording = tmp_path / "found.json"
        write_recording(recording, 3)
        spec = SourceSpec("demo", {"detector": "recorded", "model": str(recording)})
        here = label_dataset(spec, tmp_path / "here", limit=3, frames_a_shard=1)
        there = label_dataset(spec, tmp_path / "there", limit=3, frames_a_shard=2, engine="ray", workers=1)
        assert here.objects > 20
        assert hashes(there.manifest) == hashes(here.manifest)
        again = label_dataset(spec, tmp_path / "there", limit=3, frames_a_shard=2, engine="ray", resume=True)
        assert again.reused == 3
    finally:
        ray.shutdown()


def write_recording(path: Path, frames: int) -> None:
    """Detections of the first frames of the demo: its boxes and masks, with scores below 1."""
    from pycocotools import mask as coco

    source = open_pipeline("demo")
    found = {}
    for frame_id in source.dataset.frame_ids[:frames]:
        frame = source.dataset.load(frame_id)
        entries = []
        for a in frame.annotations:
            assert a.mask is not None
            code: Any = coco.encode(np.asfortranarray(a.mask.astype(np.uint8)))
            entries.append(
                {
                    "label": a.label,
                    "score": 0.5 + 0.4 / (1 + a.index),
                    "bbox": a.bbox.tolist(),
                    "mask": {"size": list(a.mask.shape), "counts": code["counts"].decode()},
                }
            )
        found[frame_id] = entries
    path.write_text(json.dumps({"frames": found}))


@pytest.mark.slow
def test_a_second_run_has_the_same_hashes_and_another_seed_other_sentences(demo: Path, tmp_path: Path) -> None:
    first = open_labels(demo).manifest
    again = label_dataset(DEMO, tmp_path / "again", limit=FRAMES, frames_a_shard=2).manifest
    other = label_dataset(DEMO, tmp_path / "other", LabelConfig(seed=1), limit=FRAMES, frames_a_shard=2).manifest
    assert hashes(again) == hashes(first)
    assert other is not None
    assert hashes(other)["relations"] == hashes(first)["relations"]
    assert hashes(other)["expressions"] != hashes(first)["expressions"]
    assert other.config_hash != first.config_hash


@pytest.mark.slow
def test_labels_at_a_url_are_merged_there_or_into_a_folder(demo: Path, tmp_path: Path) -> None:
    pytest.importorskip("fsspec")
    where = f"memory://labels-{os.getpid()}"
    report = label_dataset(DEMO, where, limit=FRAMES, frames_a_shard=2)
    expected = hashes(open_labels(demo).manifest)
    assert hashes(report.manifest) == expected
    assert hashes(merge_labels(where, out=tmp_path / "merged")) == expected
    assert hashes(merge_labels(where)) == expected


# Killed, resumed, refused.


@pytest.mark.parametrize("workers", mostly_slow([1, 2]))
def test_killed_in_the_middle_nothing_is_half_written_and_the_rest_is_kept(
    demo: Path, tmp_path: Path, workers: int
) -> None:
    out = tmp_path / "out"
    code = (
        "from pipeline.labels.job import *\n"
        f"if __name__ == '__main__': label_dataset(SourceSpec('demo'), {str(out)!r}, limit={FRAMES}, "
        f"frames_a_shard=1, workers={workers})"
    )
    script = tmp_path / "run.py"
    script.write_text(code)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(Path(__file__).resolve().parents[2])])}
    run = subprocess.Popen([sys.executable, str(script)], env=environment, start_new_session=True)
    wait_until(lambda: len(parts(out)) >= 2 or run.poll() is not None)
    os.killpg(run.pid, signal.SIGKILL)
    run.wait()
    # Its workers are of the same group, and die a little later.
    with suppress(ProcessLookupError):
        wait_until(lambda: os.killpg(run.pid, 0))
    finished = parts(out)
    assert finished, "the run was killed before anything was finished"
    store = LabelStore(out)
    for name in finished:
        assert store.has_part(name)
        for table in PART_TABLES:
            read_table(out / "parts" / name / f"{table}.parquet", table)
    report = label_dataset(DEMO, out, limit=FRAMES, frames_a_shard=1, resume=True)
    assert report.reused == len(finished)
    assert hashes(report.manifest) == hashes(open_labels(demo).manifest)
    assert not list((out / "parts").glob(".*"))


def parts(out: Path) -> list[str]:
    return sorted(p.name for p in (out / "parts").glob("[!.]*")) if (out / "parts").is_dir() else []


def test_a_folder_with_something_in_it_is_left_alone(demo: Path, tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("mine")
    with pytest.raises(InputError, match="not empty"):
        label_dataset(DEMO, tmp_path, limit=1)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["mine.txt"]
    with pytest.raises(InputError, match="a file"):
        label_dataset(DEMO, tmp_path / "mine.txt", limit=1, resume=True)


def test_labels_made_otherwise_are_not_mixed(demo: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    shutil.copytree(demo, out)
    with pytest.raises(InputError, match="other vocabulary, seed"):
        label_dataset(DEMO, out, LabelConfig(seed=5, vocabulary="all"), limit=FRAMES, frames_a_shard=2, resume=True)
    with pytest.raises(InputError, match="other frames"):
        label_dataset(DEMO, out, limit=2, frames_a_shard=2, resume=True)


def test_a_changed_input_file_is_noticed(tmp_path: Path) -> None:
    copy = tmp_path / "dataset"
    shutil.copytree(demo_path(), copy)
    out = tmp_path / "out"
    label_dataset(SourceSpec(str(copy)), out, limit=1)
    image = next((copy / "000001" / "rgb").iterdir())
    os.utime(image, ns=(1, 1))
    assert label_dataset(SourceSpec(str(copy)), out, limit=1, resume=True).reused == 1
    changed_within(image)
    with pytest.raises(InputError, match="other input files"):
        label_dataset(SourceSpec(str(copy)), out, limit=1, resume=True)


def test_missing_shards_are_named_with_the_command_that_makes_them(tmp_path: Path) -> None:
    out = tmp_path / "out"
    label_dataset(DEMO, out, limit=4, frames_a_shard=1, part=(1, 2))
    with pytest.raises(InputError, match=r"2 of 4 shards are missing; got 1, 3 .*--resume"):
        merge_labels(out)
    with pytest.raises(InputError, match="not merged yet"):
        open_labels(out)
    with pytest.raises(InputError, match="no labels here"):
        open_labels(tmp_path / "nowhere")
    (tmp_path / "manifest.json").write_text(json.dumps({"schema_version": SCHEMA_VERSION, "name": 3}))
    with pytest.raises(InputError, match=r"manifest is damaged at \w+; got .*; expected .*manifest\.json"):
        open_labels(tmp_path)
    (out / "plan.json").write_text('{"spec": 3')
    with pytest.raises(InputError, match=r"plan.json is damaged"):
        merge_labels(out)


def test_plans_survive_the_disk_and_parts_of_them_cover_every_shard_once() -> None:
    plan = make_plan(DEMO, LabelConfig(), frames_a_shard=1)
    assert len(plan.shards) == 12
    for n in (1, 2, 5, 12, 20):
        covered = [s.index for k in range(1, n + 1) for s in part_of(plan.shards, k, n)]
        assert sorted(covered) == list(range(12))
    with pytest.raises(InputError, match="no such part"):
        part_of(plan.shards, 0, 3)
    assert len({s.key for s in plan.shards}) == 12
    other = make_plan(DEMO, LabelConfig(min_pixels=201), frames_a_shard=1)
    assert not {s.key for s in plan.shards} & {s.key for s in other.shards}


def test_a_plan_is_read_back_as_it_was(tmp_path: Path) -> None:
    plan = make_plan(DEMO, LabelConfig(vocabulary="all", seed=3), frames_a_shard=5)
    store = LabelStore(tmp_path)
    save_plan(plan, store)
    assert load_plan(store) == plan


def test_a_broken_frame_is_listed_with_its_reason_and_the_rest_goes_on(tmp_path: Path) -> None:
    copy = tmp_path / "dataset"
    shutil.copytree(demo_path(), copy)
    broken = sorted((copy / "000001" / "depth").iterdir())[1]
    broken.write_bytes(b"not a picture")
    report = label_dataset(SourceSpec(str(copy)), tmp_path / "out", limit=3)
    labels = open_labels(tmp_path / "out")
    rows = labels.frames.to_pylist()
    assert report.broken == 1
    assert [r["ok"] for r in rows] == [True, False, True]
    assert broken.name in rows[1]["problem"]
    assert any(broken.name in w for w in labels.manifest.warnings)
    assert set(labels.objects.column("frame_index").to_pylist()) == {0, 2}


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="reads the peak from Linux's /proc")
def test_a_worker_stays_under_half_a_gigabyte() -> None:
    code = (
        "from pipeline.labels.job import *\nimport tempfile\n"
        "folder = tempfile.mkdtemp()\n"
        "label_dataset(SourceSpec('demo'), folder + '/out', frames_a_shard=12)\n"
        "print(next(x for x in open('/proc/self/status') if x.startswith('VmHWM')).split()[1])"
    )
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).resolve().parents[2])}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    assert int(done.stdout.split()[-1]) < 500_000


def test_shards_can_be_labelled_alone(tmp_path: Path) -> None:
    plan = make_plan(DEMO, LabelConfig(), frames_a_shard=1)
    store = LabelStore(tmp_path / "out")
    store.prepare()
    labeller = open_labeller(plan.spec, plan.config)
    first = label_shard(plan.shards[4], labeller, store)
    again = label_shard(plan.shards[4], labeller, store)
    assert (first.reused, again.reused) == (0, 1)
    assert (again.objects, again.pairs, again.candidates) == (first.objects, first.pairs, first.candidates)
    assert parts(tmp_path / "out") == [plan.shards[4].name]


def test_the_selection_keeps_to_its_limits(demo: Path, tmp_path: Path) -> None:
    merge_labels(demo, SelectConfig(total=60, per_frame=20, balance=None), tmp_path)
    rows = open_labels(tmp_path).expressions.to_pylist()
    assert len(rows) == 60
    counts = {r: sum(x["relation"] == r for x in rows) for r in PAIRWISE}
    assert {counts[r] for r in DIRECTIONAL} == {10}
    questions = [(r["frame"], r["target"], r["relation"], r["reference"]) for r in rows]
    assert len(set(questions)) == len(questions)
    assert max(sum(r["frame"] == f for r in rows) for f in {r["frame"] for r in rows}) <= 20


def test_merged_tables_do_not_go_among_other_files(demo: Path, tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("mine")
    with pytest.raises(InputError, match="something else"):
        merge_labels(demo, out=tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == ["mine.txt"]


def test_profiles_are_what_the_manifest_names(demo: Path) -> None:
    manifest = open_labels(demo).manifest
    assert manifest.profile_hash == PROFILES["viewer-cone-v1"].hash
    assert manifest.config["second_opinion"] == "trained"
    assert len(manifest.models["second_opinion"]) == 32
