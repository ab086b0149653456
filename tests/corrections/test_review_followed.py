"""States of a queue follow what people save."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from journal_world import FRAME, an_expression, saved
from state_checks import frame, left, some_pairs, states_of, status_cell  # noqa: F401

from pipeline.corrections import (
    NOTHING,
    Corrector,
    FieldRef,
    ItemKey,
    Journal,
    QueueJob,
    item_keys,
    open_journal,
    read_relation_labels,
    refreshed_worklist,
    relation_ref,
    review_queue,
    reviewed_labels,
    states_on_labels,
    undo,
    worklist,
)
from pipeline.corrections.journal import edits as actions
from pipeline.corrections.journal.replay import judgement_ref
from pipeline.corrections.review.items import NOBODY, SETTLED, judgements_of
from pipeline.corrections.review.label_jobs import make_queue
from pipeline.corrections.review.worklist import frame_states, gone_items, mark_of
from pipeline.labels import Labels
from pipeline.relations import F, T


def test_states_are_of_the_last_word(frame: Any, journal: Journal) -> None:
    """A random story of two people against a model that keeps everyone's last word."""
    rng = np.random.default_rng(1)
    pairs = some_pairs(frame(), 3)
    said: dict[tuple[int, int], dict[str, str]] = {}
    order: dict[tuple[int, int], str] = {}
    for _ in range(25):
        a, b = pairs[rng.integers(len(pairs))]
        author = ("ann", "bob")[rng.integers(2)]
        to = (None, "accepted", "unsure", "rejected")[rng.integers(4)]
        saved(journal, actions.judge(frame(), status_cell(a, b), to, author), author)
        said.setdefault((a, b), {})[author] = to or "unreviewed"
        order[a, b] = author
    found = judgements_of(journal)
    for (a, b), words in said.items():
        for author, status in words.items():
            assert found.states(author).get(left(a, b), "unreviewed") == status
        decided = {w for w in words.values() if w in SETTLED}
        if len(decided) > 1:
            assert found.state(left(a, b)) == "unsure"
        elif words[order[a, b]] != "unreviewed":
            assert found.state(left(a, b)) == words[order[a, b]]


def test_states_are_followed_as_a_new_queue_has_them(
    demo_labels: Labels, bare_corrector: Corrector, journal: Journal, frame: Any, tmp_path: Path
) -> None:
    (a, b), (c, d), (e, f), (g, h) = some_pairs(frame(), 4)
    number, name = max(frame().objects), an_expression(frame())["id"]
    saved(journal, actions.set_status(frame(), status_cell(a, b), "accepted"))
    saved(journal, actions.judge_relation(frame(), a, b, "left", T, "ben"), "ben")
    saved(journal, actions.judge_relation(frame(), c, d, "left", F, "ben"), "ben")
    saved(journal, actions.set_relation(frame(), e, f, "left", F))
    saved(journal, actions.set_relation(frame(), g, h, "left", F))
    undo(journal, "ann")
    saved(journal, actions.set_status(frame(), FieldRef("expression", FRAME, name, "status"), "accepted", author="ann"))
    # The labels were made again: what this was made on is no longer there.
    other = replace(actions.set_class(frame(), number, "kettle")[0], before="something else")
    saved(journal, (other,))
    newest = mark_of(journal.events())
    found = frame_states(frame(), journal.events(frame=FRAME))
    effective, judgements = reviewed_labels(demo_labels, journal, tmp_path / "labels")
    expected = states_on_labels(judgements, read_relation_labels(effective))
    assert {k: s for k, s in found.items() if s != "unreviewed"} == expected
    assert [found.get(left(*pair), "unreviewed") for pair in ((a, b), (c, d), (e, f), (g, h))] == [
        "accepted",
        "unsure",
        "corrected",
        "unreviewed",
    ]
    assert found.get(ItemKey(FRAME, "object", number, None, ""), "unreviewed") == "unreviewed"
    # Whoever works through a queue made now is shown the same.
    job = QueueJob(demo_labels.root, str(journal.location), networks=False)
    queue, last = make_queue(job, lambda _: None)
    assert last == newest
    work = worklist(queue)
    assert {k: work.state(k) for k in expected if k in work.indices} == {
        k: s for k, s in expected.items() if k in work.indices
    }
    assert work.counts["settled"] > 0


def test_what_a_rejected_object_takes_along_is_gone_until_it_is_back(
    demo_labels: Labels, bare_corrector: Corrector, journal: Journal, frame: Any, tmp_path: Path
) -> None:
    before = frame()
    number = some_pairs(before, 1)[0][0]
    whole = review_queue(demo_labels)
    of_frame = [k for k in item_keys(whole) if k.frame == FRAME]
    more = [ItemKey(FRAME, "expression", NOBODY, None, name) for name in before.expressions]
    more += [ItemKey(FRAME, "object", n, None, "") for n in before.objects]
    assert gone_items(before, [*of_frame, *more], {}) == frozenset()
    work = worklist(whole)
    saved(
        journal, actions.set_status(before, FieldRef("object", FRAME, str(number), "status"), "rejected", author="ann")
    )
    away, newest = refreshed_worklist(work, bare_corrector, journal, NOTHING)
    gone = {k for k, lost in zip(work.keys, away.gone, strict=True) if lost}
    assert gone == {k for k in of_frame if k.kind == "relation" and number in (k.a, k.b)}
    assert gone
    assert away.counts["items"] == work.counts["items"] - len(gone)
    # A queue made now has the same relations of the frame, and expressions only of what is left.
    now, _ = reviewed_labels(demo_labels, journal, tmp_path / "labels")
    made_now = item_keys(review_queue(now))
    assert {k for k in made_now if k.frame == FRAME and k.kind == "relation"} <= {k for k in of_frame if k not in gone}
    lost = gone_items(frame(), more, states_of(journal))
    said = {e["id"] for e in now.expressions.to_pylist() if e["frame"] == FRAME}
    assert {k.what for k in lost} == set(before.expressions) - said
    assert {k.kind for k in lost} == {"expression"}, "the object itself is settled"
    undo(journal, "ann")
    back, _ = refreshed_worklist(away, bare_corrector, journal, newest)
    assert not back.gone.any()
    assert back.counts == work.counts


def test_of_a_journal_that_was_replaced_nothing_is_kept(
    demo_labels: Labels, bare_corrector: Corrector, journal: Journal, frame: Any, tmp_path: Path
) -> None:
    work = worklist(review_queue(demo_labels))
    of_frame = [k for k in work.keys if (k.frame, k.kind, k.what) == (FRAME, "relation", "left")]
    (a, b), (c, d) = [(k.a, k.b or 0) for k in of_frame[:2]]
    saved(journal, actions.set_status(frame(), status_cell(a, b), "accepted", author="ann"))
    known, newest = refreshed_worklist(work, bare_corrector, journal, NOTHING)
    assert known.state(left(a, b)) == "accepted"
    assert refreshed_worklist(known, bare_corrector, journal, newest) == (known, newest)
    with open_journal(tmp_path / "another.sqlite") as another:
        empty, none = refreshed_worklist(known, bare_corrector, another, newest)
        assert (empty.counts, none) == (work.counts, NOTHING)
        # Its events have the numbers of those that were known.
        saved(another, actions.set_status(frame(), status_cell(c, d), "accepted", author="ben"))
        found, last = refreshed_worklist(known, bare_corrector, another, newest)
        assert [found.state(left(*pair)) for pair in ((a, b), (c, d))] == ["unreviewed", "accepted"]
        assert last == mark_of(another.events())
        assert last[0] == newest[0]


def test_a_cell_names_the_item_that_it_is_about() -> None:
    said = {
        "said of relation 21,22 on in f": judgement_ref("f", "relation", 21, 22, "on", "ann"),
        "said of object 3 in f": judgement_ref("f", "object", 3, None, "", "ann"),
        "said of expression e1 in f": judgement_ref("f", "expression", -1, None, "e1", "ann"),
        "left of relation 2,5 in f": relation_ref("f", 2, 5, "left"),
    }
    assert {str(cell) for cell in said.values()} == set(said)
