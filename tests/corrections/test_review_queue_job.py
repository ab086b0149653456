"""The review queue as a job: stored in the order of work, with what people have said so far."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import pytest
from journal_world import FRAME, saved

from pipeline.corrections import (
    NOTHING,
    Corrector,
    Journal,
    QueueJob,
    item_keys,
    judge_relation,
    worklist,
)
from pipeline.corrections.review.label_jobs import make_queue
from pipeline.corrections.review.worklist import mark_of
from pipeline.labels import Labels
from pipeline.relations import F, T
from pipeline.system import InputError


def test_a_queue_without_corrections_is_ordered_by_frames(demo_labels: Labels, tmp_path: Path) -> None:
    job = QueueJob(demo_labels.root, str(tmp_path / "none.sqlite"), networks=False)
    queue, last = make_queue(job, lambda step: None)
    assert last == NOTHING
    found = queue.column("frame").to_pylist()[:60]
    assert sum(x != y for x, y in pairwise(found)) == len(set(found)) - 1


def test_what_people_said_is_in_the_queue_and_its_figures(
    demo_labels: Labels, bare_corrector: Corrector, journal: Journal, tmp_path: Path
) -> None:
    frame = bare_corrector.frame(FRAME, journal)
    a, b, c = frame.pairs.numbers[:3].tolist()
    for author, state in (("ann", T), ("ben", F)):
        saved(journal, judge_relation(frame, a, b, "left", state, author), author)
        saved(journal, judge_relation(frame, a, c, "left", T, author), author)
    where = journal.location
    job = QueueJob(demo_labels.root, where, networks=False)
    queue, last = make_queue(job, lambda step: None)
    work = worklist(queue)
    assert last == mark_of(journal.events())
    top = work.next_item()
    assert top is not None
    assert work.disputed[work.indices[top.plain]]
    assert work.state(top) == "unsure"
    assert not work.disputed[-1]
    first = [(k.frame, k.a, k.b, k.what) for k in item_keys(queue)[:2]]
    assert set(first) == {(FRAME, a, b, "left"), (FRAME, b, a, "right")}


def test_what_cannot_be_read_is_told(tmp_path: Path) -> None:
    with pytest.raises(InputError):
        make_queue(QueueJob(tmp_path), lambda step: None)
