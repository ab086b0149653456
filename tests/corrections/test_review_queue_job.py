"""The review queue as a job: stored in the order of work, with what people have said so far."""

from __future__ import annotations

import json
import pickle
from itertools import pairwise
from pathlib import Path

import pytest
from journal_world import FRAME, saved

from pipeline.answering import open_pipeline
from pipeline.corrections import (
    Corrector,
    ItemKey,
    Journal,
    QueueJob,
    detector_evidence,
    item_keys,
    judge_relation,
    read_queue,
    second_setup,
    worklist,
)
from pipeline.corrections.review.label_jobs import Step, make_queue
from pipeline.corrections.review.worklist import mark_of
from pipeline.datasets import Dataset
from pipeline.labels import Labels
from pipeline.relations import F, T
from pipeline.system import InputError


def test_a_queue_without_corrections_with_a_second_detector(
    demo_labels: Labels, demo_dataset: Dataset, tmp_path: Path
) -> None:
    first, second = demo_labels.frames.column("frame").to_pylist()[:2]
    frames: dict[str, list[dict]] = {}
    for row in demo_labels.objects.to_pylist():
        frames.setdefault(row["frame"], []).append({"label": row["label"], "score": 0.9, "bbox": list(row["bbox"])})
    planted = frames[first][2]
    planted["label"] = "zebra"
    del frames[second]
    recording = tmp_path / "recording.json"
    recording.write_text(json.dumps({"frames": frames}))
    source = open_pipeline(demo_dataset.root, detector="annotations", also=f"recorded={recording}", srm="rule")
    chosen = second_setup(source, demo_labels)
    assert chosen is not None
    assert chosen[0] == "recorded"
    job = QueueJob(
        demo_labels.root, tmp_path / "q.parquet", str(tmp_path / "none.sqlite"), dataset=str(demo_dataset.root),
        networks=False, detector=pickle.loads(pickle.dumps(chosen[1])),
    )  # fmt: skip
    steps: list[Step] = []
    made = make_queue(job, steps.append)
    total = demo_labels.frames.num_rows
    assert steps == [("frames", n, total) for n in range(1, total + 1)]
    said = made.pop("detector")
    assert (said["name"], said["frames"], list(said["skipped"])) == ("recorded", total - 1, [second])
    queue = read_queue(job.out)
    rows = dict(zip(item_keys(queue), queue.to_pylist(), strict=True))
    (named,) = (k for k, r in rows.items() if any("'zebra'" in reason for reason in r["reasons"]))
    assert made == {"items": len(rows), "last": (0, ""), "estimated_wrong": None, "agreement": []}
    numbers = [r["object"] for r in demo_labels.objects.to_pylist() if r["frame"] == first]
    assert named == ItemKey(first, "object", numbers[2], None, "")
    assert source.second_detector is not None
    as_reviewed = {i.key: i.reason for i in detector_evidence(demo_labels, demo_dataset, source.second_detector).items}
    spoken = {k: [x for x in r["reasons"] if x.startswith("the detector ")] for k, r in rows.items()}
    assert {k: x for k, (x,) in ((k, x) for k, x in spoken.items() if x)} == as_reviewed
    found = queue.column("frame").to_pylist()[:60]
    assert sum(x != y for x, y in pairwise(found)) == len(set(found)) - 1


def test_the_detector_that_made_the_labels_is_no_second_one(demo_labels: Labels, demo_dataset: Dataset) -> None:
    own = open_pipeline(demo_dataset.root, detector="annotations", srm="rule")
    assert second_setup(own, demo_labels) is None
    with_masks = open_pipeline(demo_dataset.root, segmenter="depth", srm="rule")
    assert second_setup(with_masks, demo_labels) is None, "masks are another matter"
    other = open_pipeline(demo_dataset.root, detector="simulated", also="annotations", srm="rule")
    chosen = second_setup(other, demo_labels)
    assert chosen is not None
    assert chosen[0] == "simulated"


def test_what_people_said_is_in_the_queue_and_its_figures(
    demo_labels: Labels, bare_corrector: Corrector, journal: Journal, tmp_path: Path
) -> None:
    frame = bare_corrector.frame(FRAME, journal)
    a, b, c = frame.pairs.numbers[:3].tolist()
    for author, state in (("ann", T), ("ben", F)):
        saved(journal, judge_relation(frame, a, b, "left", state, author), author)
        saved(journal, judge_relation(frame, a, c, "left", T, author), author)
    where = str(journal.engine.url.database)
    job = QueueJob(demo_labels.root, tmp_path / "q.parquet", where, networks=False)
    made = make_queue(job, lambda step: None)
    assert made["detector"] is None
    (pair,) = made["agreement"]
    assert pair["reviewers"] == ["ann", "ben"]
    # Two relations, each with its mirror one item, of which one is judged alike.
    assert pair["items"] == 2
    work = worklist(read_queue(job.out))
    assert made["last"] == mark_of(journal.events())
    top = work.next_item()
    assert top is not None
    assert work.is_disputed(top)
    assert not work.is_disputed(work.keys[-1])
    first = [(k.frame, k.a, k.b, k.what) for k in item_keys(read_queue(job.out))[:2]]
    assert set(first) == {(FRAME, a, b, "left"), (FRAME, b, a, "right")}


def test_what_cannot_be_read_is_told(tmp_path: Path) -> None:
    with pytest.raises(InputError):
        make_queue(QueueJob(tmp_path, tmp_path / "q.parquet"), lambda step: None)
