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
from box_worlds import box_world
from label_sets import validate_rows
from other_makers import FIGURES, FLIPS, REGIMES, figures, tallied
from scenes import frame_of, upright
from waiting import wait_until

from pipeline.answering.objects import PreparedFrame, all_objects
from pipeline.answering.opening import open_pipeline
from pipeline.datasets.demo import demo_path
from pipeline.geometry.frame import Annotation, Frame
from pipeline.geometry.lifting import LiftedObject
from pipeline.geometry.viewer import ViewerAxes
from pipeline.labels.config import LabelConfig, SelectConfig
from pipeline.labels.engines import label_shard, open_labeller
from pipeline.labels.job import label_dataset
from pipeline.labels.labelling import FrameLabels, in_doubt, judge_objects, label_objects, occluded_share
from pipeline.labels.merge import merge_labels
from pipeline.labels.plan import SourceSpec, load_plan, make_plan, part_of, save_plan
from pipeline.labels.profiles import PROFILES, doubted, open_second_opinion
from pipeline.labels.reading import open_labels
from pipeline.labels.schema import TABLES, Manifest
from pipeline.labels.store import Store
from pipeline.labels.tables import PART_TABLES, content_hash, read_table
from pipeline.language.naming import same_class
from pipeline.language.noun_phrase import readable
from pipeline.language.relation_names import DIRECTIONAL, INVERSE, PAIRWISE
from pipeline.proposals.annotations import AnnotationDetector
from pipeline.relations.model import OnnxScorer
from pipeline.relations.relations import directional_states
from pipeline.system.errors import InputError

DEMO = SourceSpec("demo")
FRAMES = 6
REQUIRED = os.environ.get("SPATIALVIZ_REQUIRE_EXTRAS") == "1"


def hashes(manifest: Manifest | None) -> dict[str, str]:
    assert manifest is not None
    return {name: table.content_hash for name, table in manifest.tables.items()}


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Labels of the first frames of the demo, made in this process in shards of two."""
    out = tmp_path_factory.mktemp("labels") / "demo"
    label_dataset(DEMO, out, limit=FRAMES, frames_a_shard=2)
    return out


# The same rows, whatever makes them.


@pytest.mark.parametrize(("workers", "frames_a_shard"), [(1, 1), (1, 100), (2, 3)])
def test_rows_depend_on_neither_workers_nor_shards(
    demo: Path, tmp_path: Path, workers: int, frames_a_shard: int
) -> None:
    report = label_dataset(DEMO, tmp_path / "out", limit=FRAMES, workers=workers, frames_a_shard=frames_a_shard)
    assert hashes(report.manifest) == hashes(open_labels(demo).manifest)


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
    ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False)
    try:
        report = label_dataset(DEMO, tmp_path / "out", limit=FRAMES, frames_a_shard=3, engine="ray", workers=2)
        assert hashes(report.manifest) == hashes(open_labels(demo).manifest)
        # A detector of its own stage: what it recorded of the same frames, labelled in this process and by Ray.
        recording = tmp_path / "found.json"
        write_recording(recording, 3)
        spec = SourceSpec("demo", {"detector": "recorded", "model": str(recording)})
        here = label_dataset(spec, tmp_path / "here", limit=3, frames_a_shard=1)
        there = label_dataset(spec, tmp_path / "there", limit=3, frames_a_shard=2, engine="ray", workers=2)
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


def test_a_second_run_has_the_same_hashes_and_another_seed_other_sentences(demo: Path, tmp_path: Path) -> None:
    first = open_labels(demo).manifest
    again = label_dataset(DEMO, tmp_path / "again", limit=FRAMES, frames_a_shard=2).manifest
    other = label_dataset(DEMO, tmp_path / "other", LabelConfig(seed=1), limit=FRAMES, frames_a_shard=2).manifest
    assert hashes(again) == hashes(first)
    assert other is not None
    assert hashes(other)["relations"] == hashes(first)["relations"]
    assert hashes(other)["expressions"] != hashes(first)["expressions"]
    assert other.config_hash != first.config_hash


def test_labels_at_a_url_are_merged_into_a_folder(demo: Path, tmp_path: Path) -> None:
    pytest.importorskip("fsspec")
    where = f"memory://labels-{os.getpid()}"
    report = label_dataset(DEMO, where, limit=FRAMES, frames_a_shard=2)
    assert report.manifest is None
    assert hashes(merge_labels(where, out=tmp_path / "merged")) == hashes(open_labels(demo).manifest)
    with pytest.raises(InputError, match="merged into a local folder"):
        merge_labels(where)


# Killed, resumed, refused.


def test_killed_in_the_middle_nothing_is_half_written_and_the_rest_is_kept(demo: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    code = (
        "from pipeline.labels.job import *\n"
        f"if __name__ == '__main__': label_dataset(SourceSpec('demo'), {str(out)!r}, limit={FRAMES}, "
        "frames_a_shard=1, workers=2)"
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
    store = Store(out)
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
    with pytest.raises(InputError, match=r"another (seed|vocabulary) and another (seed|vocabulary)"):
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
    store = Store(tmp_path)
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


# What is said is true.


def test_rows_fit_their_schema_and_their_hashes(demo: Path) -> None:
    labels = open_labels(demo)
    for name in TABLES:
        table = labels.table(name)
        validate_rows(table, name)
        assert content_hash(table, name) == labels.manifest.tables[name].content_hash
        assert table.num_rows == labels.manifest.tables[name].rows


def test_every_sentence_is_true_and_carries_all_its_answers(demo: Path) -> None:
    labels = open_labels(demo)
    label = {(o["frame"], o["object"]): o for o in labels.objects.to_pylist()}
    state = {
        (r["frame"], r["a"], r["b"], name): r[name]
        for r in labels.relations.to_pylist()
        for name in labels.relation_names
    }
    by_frame: dict[str, list[int]] = {}
    for frame, number in label:
        by_frame.setdefault(frame, []).append(number)
    rows = labels.expressions.to_pylist()
    assert len(rows) > 100
    for row in rows:
        frame, relation = row["frame"], row["relation"]
        target, reference = row["target_object"], row["reference_object"]
        assert state[frame, target, reference, relation] == 1
        assert row["margin"] >= 0
        assert label[frame, target]["usable"]
        assert label[frame, reference]["usable"]
        named = {n for n in by_frame[frame] if label[frame, n]["label"] == row["reference"]}
        for column, least in (("targets", 1), ("acceptable", 0)):
            wanted = {
                a
                for a in by_frame[frame]
                if label[frame, a]["label"] == row["target"]
                and any(state.get((frame, a, b, relation), -1) >= least for b in named if b != a)
            }
            assert set(row[column]) == wanted
        assert row["ambiguous"] == (len(row["acceptable"]) > 1)
        for role in ("target", "reference"):
            if sum(same_class(row[role], label[frame, n]["label"]) for n in by_frame[frame]) > 1:
                assert f"the {readable(row[role])}" not in row["text"]


def test_inverse_labels_mirror_exactly(demo: Path) -> None:
    rows = {(r["frame"], r["a"], r["b"]): r for r in open_labels(demo).relations.to_pylist()}
    assert rows
    for (frame, a, b), row in rows.items():
        for relation, inverse in INVERSE.items():
            assert row[relation] == rows[frame, b, a][inverse]
            assert row[f"{relation}_margin"] == rows[frame, b, a][f"{inverse}_margin"]


def labelled(frame: Frame, config: LabelConfig | None = None) -> FrameLabels:
    config = config or LabelConfig(second_opinion="none", min_pixels=20)
    context = PreparedFrame(frame)
    objects = all_objects(context, AnnotationDetector())
    return label_objects(context, objects, config, frame_index=0, scene="s", exact=True)


def three_boxes() -> Frame:
    at = ((-0.6, 0.9, 2.0), (0.6, 0.9, 2.0), (0.65, 0.9, 3.2))
    return frame_of([upright(p, (0.4, 0.4, 0.4)) for p in at], ["chair", "table", "chair"])


def test_a_question_with_two_right_answers_says_so() -> None:
    frame = three_boxes()
    found = labelled(frame).candidates
    said = {
        (t, r, o): (s, x)
        for t, r, o, s, x in zip(
            *(found[n] for n in ("target_object", "relation", "reference_object", "targets", "ambiguous")), strict=True
        )
    }
    assert said[0, "left", 1] == ([0], False)
    assert said[2, "behind", 1] == ([2], False)
    assert (1, "front", 2) in said
    assert not [k for k in said if k[0] == k[2]]


def test_walls_and_specks_are_not_asked_for() -> None:
    frame = three_boxes()
    wall = Annotation(3, "Wall", np.array([0, 0, 320, 60]), np.zeros((240, 320), bool))
    wall.mask[:60] = True  # pyright: ignore[reportOptionalSubscript]
    frame = Frame(frame.id, frame.rgb, frame.depth, frame.camera, (*frame.annotations, wall))
    found = labelled(frame, LabelConfig(second_opinion="none", min_pixels=10**5))
    assert found.objects["reason"] == ["fewer than 100000 pixels"] * 3 + ["background"]
    assert 3 not in set(found.relations["a"].tolist())
    assert found.candidates == {}
    assert len(found.relations["a"]) == 6


def test_something_in_front_counts_as_occlusion() -> None:
    behind = upright((0.0, 0.9, 3.0), (1.2, 0.6, 0.3))
    before = upright((0.45, 0.9, 1.8), (0.3, 0.6, 0.3))
    shares = []
    for boxes in ([behind], [behind, before]):
        frame = frame_of(boxes, ["sofa", "box"][: len(boxes)])
        context = PreparedFrame(frame)
        objects = all_objects(context, AnnotationDetector())
        shares.append([occluded_share(o.lifted.evidence, frame.depth) for o in objects if o.lifted.evidence])
    assert shares[0][0] < 0.02
    assert 0.08 < shares[1][0] < 0.5
    assert shares[1][1] < 0.02


def test_semantic_abstraction_as_published(tmp_path: Path) -> None:
    config = LabelConfig(
        profile="semantic-abstraction-published", vocabulary="semantic-abstraction", style="semantic-abstraction"
    )
    assert config.second_opinion == "none"
    label_dataset(DEMO, tmp_path / "out", config, limit=1)
    labels = open_labels(tmp_path / "out")
    assert labels.relation_names == ("left", "right", "front", "behind", "on", "in")
    assert set(labels.relations.column("above").to_pylist()) == {None}
    row = labels.expressions.to_pylist()[0]
    assert f"{row['target']} " in row["text"]
    with pytest.raises(InputError, match="no such vocabulary"):
        LabelConfig(vocabulary="nautical")


# Against exact geometry.


@pytest.fixture(scope="module")
def worlds() -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Of rooms of another maker: labels by the rules alone, labels with the second opinion, and exact states."""
    network = open_second_opinion("trained")
    assert network is not None
    found = []
    for seed in range(24):
        objects, exact, viewer, *_ = box_world(seed, 480, 360)
        if len(objects) < 2:
            continue
        rules = judge_objects(objects, viewer, LabelConfig())
        with_doubt = doubted(rules, network, objects, viewer)
        truth = directional_states(np.array([e[0] for e in exact]), np.array([e[1] for e in exact]))
        found.append((rules.states[..., :6], with_doubt.states[..., :6], truth))
    return found


def cells(views: list[np.ndarray]) -> np.ndarray:
    return np.concatenate([v[~np.eye(len(v), dtype=bool)] for v in views])


def test_labels_of_rooms_of_another_maker_agree_with_exact_geometry(
    worlds: list[tuple[np.ndarray, np.ndarray, np.ndarray]],
) -> None:
    said, truth = cells([w[1] for w in worlds]), cells([w[2] for w in worlds])
    assert len(said) > 2500
    decided = (said != 0) & (truth != 0)
    for k, relation in enumerate(DIRECTIONAL):
        yes, true = (said[:, k] > 0) & decided[:, k], (truth[:, k] > 0) & decided[:, k]
        f1 = 2 * (yes & true).sum() / (yes.sum() + true.sum())
        assert f1 >= 0.985, (relation, f1)
    assert 1000 * (said * truth == -1).mean() < 2
    # Doubt is no way out: nearly all that is decidable is decided.
    assert (decided.sum() / (truth != 0).sum()) > 0.92
    assert ((said > 0) & (truth > 0)).sum() / (truth > 0).sum() > 0.9


@pytest.mark.parametrize("regime", ["low", "usual", "high"])
def test_labels_hold_from_low_and_from_high(regime: str) -> None:
    network = open_second_opinion("trained")
    assert network is not None
    rows = []
    for seed in range(12):
        objects, exact, viewer, *_ = box_world(seed, 400, 300, REGIMES[regime])
        if len(objects) < 2:
            continue
        truth = directional_states(np.array([e[0] for e in exact]), np.array([e[1] for e in exact]))
        labels = judge_list_of(objects, viewer, network)
        rows.append(tallied(network.of_pairs(objects, viewer), labels, truth))
    found = dict(zip(FIGURES, figures(np.sum(rows, axis=0)[None])[0], strict=True))
    assert found["above/below F1 of labels"] >= 0.97
    assert found[FLIPS] < 3
    assert found["decided"] > 0.9


def judge_list_of(objects: list[LiftedObject], viewer: ViewerAxes, network: OnnxScorer) -> np.ndarray:
    rules = in_doubt(
        judge_objects(objects, viewer, LabelConfig()), np.array([o.quality.fallback for o in objects], np.bool_)
    )
    return doubted(rules, network, objects, viewer).states[..., :6]


def test_the_second_opinion_only_ever_doubts(worlds: list[tuple[np.ndarray, np.ndarray, np.ndarray]]) -> None:
    for rules, with_doubt, _ in worlds:
        changed = rules != with_doubt
        assert (with_doubt[changed] == 0).all()
        for relation, inverse in INVERSE.items():
            a, b = DIRECTIONAL.index(relation), DIRECTIONAL.index(inverse)
            np.testing.assert_array_equal(with_doubt[..., a], with_doubt[..., b].T)
        assert (with_doubt[np.eye(len(rules), dtype=bool)] == -1).all()
    rules, said, truth = (cells([w[k] for w in worlds]) for k in range(3))
    assert (said * truth == -1).sum() < 0.5 * (rules * truth == -1).sum()


def test_a_second_opinion_must_be_a_network() -> None:
    assert open_second_opinion("none") is None
    with pytest.raises(InputError, match="is a network"):
        open_second_opinion("rule")


def test_shards_can_be_labelled_alone(tmp_path: Path) -> None:
    plan = make_plan(DEMO, LabelConfig(), frames_a_shard=1)
    store = Store(tmp_path / "out")
    store.prepare()
    labeller = open_labeller(plan.spec, plan.config)
    first = label_shard(plan.shards[4], labeller, store)
    again = label_shard(plan.shards[4], labeller, store)
    assert (first.reused, again.reused) == (False, True)
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
