"""States of a review from the journal: who said what, on what they differ, what is left for whom."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from journal_world import FRAME, an_expression, saved
from sklearn.metrics import cohen_kappa_score

from pipeline.corrections.journal import edits as actions
from pipeline.corrections.journal.batch import actions_of, apply_actions
from pipeline.corrections.journal.effective import Corrector
from pipeline.corrections.journal.effective_frame import EffectiveFrame
from pipeline.corrections.journal.events import Conflict, Saved
from pipeline.corrections.journal.field_refs import FieldRef, relation_ref
from pipeline.corrections.journal.journal import Journal, open_journal
from pipeline.corrections.journal.materialise import materialise
from pipeline.corrections.journal.replay import judgement_ref
from pipeline.corrections.journal.undo import redo, undo
from pipeline.corrections.review.evidence import read_relation_labels
from pipeline.corrections.review.items import (
    NOBODY,
    SETTLED,
    ItemKey,
    State,
    item_keys,
    item_of,
    judgements_of,
    left_to_review,
)
from pipeline.corrections.review.label_jobs import QueueJob, make_queue
from pipeline.corrections.review.out_of_fold import DoubtConfig, doubt_labels
from pipeline.corrections.review.queue import QueueConfig, review_queue
from pipeline.corrections.review.reviewed import (
    left_for,
    pair_agreements,
    review_progress,
    reviewed_labels,
    settled_relations,
    states_on_labels,
    trusted_of_data,
    without_gone,
    wrong_left,
)
from pipeline.corrections.review.worklist import (
    NOTHING,
    frame_states,
    gone_items,
    mark_of,
    read_queue,
    refreshed_worklist,
    worklist,
)
from pipeline.labels.reading import Labels
from pipeline.relations.relations import F, T
from pipeline.system.errors import InputError
from pipeline.training.label_data import read_label_data
from pipeline.training.train import TrainConfig

RULES_ONLY = QueueConfig(doubts=None)


def states_of(journal: Journal, author: str | None = None) -> dict[ItemKey, State]:
    """The state of every reviewed item, over all or by one person."""
    return judgements_of(journal).states(author)


@pytest.fixture
def frame(bare_corrector: Corrector, journal: Journal) -> Any:
    """The frame as it is each time it is asked for."""
    return lambda: bare_corrector.frame(FRAME, journal)


def some_pairs(frame: EffectiveFrame, count: int) -> list[tuple[int, int]]:
    """Pairs of which the first is left of the second, no two of the same two objects."""
    k = 0
    places = np.argwhere(frame.pairs.present & (frame.pairs.states[..., k] == T))[:count]
    return [(int(a), int(b)) for a, b in frame.pairs.numbers[places]]


def left(a: int, b: int) -> ItemKey:
    return ItemKey(FRAME, "relation", a, b, "left")


def status_cell(a: int, b: int) -> FieldRef:
    return FieldRef("relation", FRAME, f"{a},{b}", "left.status")


def test_every_state_has_its_edit_and_undo_takes_it_back(frame: Any, journal: Journal) -> None:
    (a, b), (c, d), *_ = some_pairs(frame(), 4)
    number = frame().pairs.numbers.tolist()[0]
    spoken = an_expression(frame())["id"]
    saved(journal, actions.set_relation(frame(), a, b, "left", F))
    saved(journal, actions.set_status(frame(), status_cell(c, d), "accepted", author="ann"))
    saved(
        journal, actions.set_status(frame(), FieldRef("object", FRAME, str(number), "status"), "unsure", author="ann")
    )
    saved(journal, actions.set_mark(frame(), spoken, "BAD_LABEL"))
    expected: dict[ItemKey, State] = {
        left(a, b): "corrected",
        ItemKey(FRAME, "relation", b, a, "right"): "corrected",
        left(c, d): "accepted",
        ItemKey(FRAME, "object", number, None, ""): "unsure",
        ItemKey(FRAME, "expression", NOBODY, None, spoken): "rejected",
    }
    assert states_of(journal) == states_of(journal, "ann") == expected
    assert states_of(journal, "bob") == {}
    assert judgements_of(journal).words[left(c, d)]["ann"].verdict == "T"
    kept = [expected]
    while undo(journal, "ann") is not None:
        kept.append(states_of(journal))
    assert kept[-1] == {}
    assert all(len(one) > len(two) for one, two in pairwise(kept))
    while kept:
        assert states_of(journal) == kept.pop()
        redo(journal, "ann")


def test_what_is_accepted_of_a_relation_is_not_asked_again_the_other_way_round(frame: Any, journal: Journal) -> None:
    (a, b), (c, d) = some_pairs(frame(), 2)
    saved(journal, actions.judge_both_ways(frame(), status_cell(a, b), "accepted", "ann"), "ann")
    saved(journal, actions.judge_both_ways(frame(), status_cell(c, d), "unsure", "ann"), "ann")
    mirrors = [ItemKey(FRAME, "relation", y, x, "right") for x, y in ((a, b), (c, d))]
    expected = dict.fromkeys((left(a, b), mirrors[0]), "accepted") | dict.fromkeys((left(c, d), mirrors[1]), "unsure")
    assert states_of(journal, "ann") == expected
    assert judgements_of(journal).words[mirrors[0]]["ann"].verdict == "T"
    undo(journal, "ann")
    undo(journal, "ann")
    assert states_of(journal) == {}


def test_setting_back_what_the_labels_said_accepts_it(frame: Any, journal: Journal) -> None:
    ((a, b),) = some_pairs(frame(), 1)
    saved(journal, actions.set_relation(frame(), a, b, "left", F))
    saved(journal, actions.set_relation(frame(), a, b, "left", T), "bob")
    assert states_of(journal, "ann")[left(a, b)] == "corrected"
    assert states_of(journal, "bob")[left(a, b)] == "accepted"
    assert states_of(journal)[left(a, b)] == "unsure", "they say different things"


def test_a_status_of_an_older_journal_counts_for_the_value_that_it_was_of(frame: Any, journal: Journal) -> None:
    (a, b), (c, d), *_ = some_pairs(frame(), 4)
    saved(journal, actions.set_status(frame(), status_cell(a, b), "accepted"))
    saved(journal, actions.set_relation(frame(), a, b, "left", F), "bob")
    saved(journal, actions.set_status(frame(), status_cell(c, d), "accepted"))
    found = judgements_of(journal, automatic={left(c, d): T}.get)
    assert {w.author: w.verdict for w in found.words[left(a, b)].values()} == {"ann": "T", "bob": "F"}
    assert found.differ(left(a, b))
    assert found.words[left(c, d)]["ann"].verdict == "T"
    assert judgements_of(journal).words[left(c, d)]["ann"].verdict == "accepted"


def test_who_accepts_a_correction_agrees_with_it(frame: Any, journal: Journal) -> None:
    number = frame().pairs.numbers.tolist()[0]
    status = FieldRef("object", FRAME, str(number), "status")
    saved(journal, actions.set_class(frame(), number, "notebook"))
    saved(journal, actions.set_status(frame(), status, "accepted", author="bob"), "bob")
    key = ItemKey(FRAME, "object", number, None, "")
    assert not judgements_of(journal).differ(key)
    assert states_of(journal)[key] == "accepted"
    saved(journal, actions.set_status(frame(), status, "rejected", author="cay"), "cay")
    assert judgements_of(journal).differ(key)
    assert number in frame().left_out


def folded(key: ItemKey) -> ItemKey:
    """The first of "a left of b" and "b right of a"."""
    assert key.b is not None
    return min(key, ItemKey(key.frame, key.kind, key.b, key.a, "right"))


def test_a_second_opinion_neither_conflicts_nor_changes_the_label(frame: Any, journal: Journal) -> None:
    ((a, b),) = some_pairs(frame(), 1)
    as_both_see_it = frame()
    saved(journal, actions.set_relation(as_both_see_it, a, b, "left", F))
    saved(journal, actions.judge_relation(as_both_see_it, a, b, "left", T, "bob"), "bob")
    assert frame().pairs.state(a, b, "left") == F
    found = judgements_of(journal)
    assert found.state(left(a, b)) == "unsure"
    assert found.state(ItemKey(FRAME, "relation", b, a, "right")) == "unsure"
    (pair,) = pair_agreements(found, frame().setting.inverse)
    assert pair.differ == ((folded(left(a, b)), "F", "T"),), "said once, also of the inverse"
    saved(journal, actions.settle(frame(), status_cell(a, b), "corrected", state=T), "cay")
    assert frame().pairs.state(a, b, "left") == T
    found = judgements_of(journal)
    assert found.state(left(a, b)) == "corrected"
    assert found.verdict(left(a, b)) == "T"
    (pair,) = pair_agreements(found, frame().setting.inverse)
    assert [k for k, _, _ in pair.differ] == [folded(left(a, b))], "a settlement is no judgement"
    assert "cay" not in found.authors
    undo(journal, "cay")
    assert judgements_of(journal).state(left(a, b)) == "unsure"
    redo(journal, "cay")
    saved(journal, actions.judge_relation(frame(), a, b, "left", F, "ann"))
    assert judgements_of(journal).state(left(a, b)) == "unsure", "a word after the settlement opens it again"


@pytest.mark.parametrize("kind", ["object", "expression"])
def test_who_takes_back_a_rejection_takes_it_back_for_all(frame: Any, journal: Journal, kind: Any) -> None:
    number, name = min(frame().objects), an_expression(frame())["id"]
    cell = FieldRef(kind, FRAME, str(number) if kind == "object" else name, "status")

    def stands() -> bool:
        return number in frame().objects if kind == "object" else name in frame().expressions

    saved(journal, actions.set_status(frame(), cell, "rejected", author="ann"))
    assert not stands()
    # Another reviewer only says so: the two differ, until somebody settles it.
    saved(journal, actions.set_status(frame(), cell, "accepted", author="ben"), "ben")
    assert not stands()
    saved(journal, actions.set_status(frame(), cell, "accepted", author="ann"))
    assert stands()
    key = item_of(cell)
    assert key is not None
    assert judgements_of(journal).state(key) == "accepted"
    undo(journal, "ann")
    assert not stands()


def test_judgements_go_through_a_file_of_edits(bare_corrector: Corrector, journal: Journal) -> None:
    a, b = some_pairs(bare_corrector.frame(FRAME, journal), 1)[0]
    pair = {"frame": FRAME, "a": a, "b": b, "relation": "left"}
    for author, to in (("ann", "F"), ("bob", "accepted")):
        todo = actions_of([{"edit": "judge", "to": to, **pair}])
        assert isinstance(apply_actions(bare_corrector, journal, todo, author), Saved)
    assert judgements_of(journal).differ(left(a, b))
    todo = actions_of([{"edit": "settle", "to": "F", **pair}])
    assert isinstance(apply_actions(bare_corrector, journal, todo, "cay"), Saved)
    assert bare_corrector.frame(FRAME, journal).pairs.state(a, b, "left") == F
    assert states_of(journal)[left(a, b)] == "corrected"
    assert isinstance(apply_actions(bare_corrector, journal, todo, "dan"), Conflict)
    for wrong in ({"edit": "judge", "to": "fine", **pair}, {"edit": "judge", "to": "T", "frame": FRAME},
                  {"edit": "judge", "to": "T", **pair, "relation": "between"}):  # fmt: skip
        with pytest.raises(InputError):
            apply_actions(bare_corrector, journal, actions_of([wrong]), "ann")


def test_kappa_is_of_what_each_said(frame: Any, journal: Journal) -> None:
    seen = frame()
    pairs = some_pairs(seen, 12)
    rng = np.random.default_rng(3)
    said: dict[str, list[int]] = {"ann": [], "bob": []}
    for a, b in pairs:
        for author, states in said.items():
            states.append(int(rng.choice([T, T, F])))
            # Each says it their own way round.
            way = (a, b, "left") if author == "ann" else (b, a, "right")
            saved(journal, actions.judge_relation(seen, *way, states[-1], author), author)
    saved(journal, actions.set_status(frame(), status_cell(*pairs[0]), "unsure", author="ann"))
    (pair,) = pair_agreements(judgements_of(journal), seen.setting.inverse)
    assert pair.all.items == 11
    assert pair.all.kappa == pytest.approx(cohen_kappa_score(said["ann"][1:], said["bob"][1:]))
    assert len(pair.differ) == sum(x != y for x, y in zip(said["ann"][1:], said["bob"][1:], strict=True))
    assert set(pair.kinds) == {"relation"}
    assert pair_agreements(judgements_of(journal.events(author="ann")), seen.setting.inverse) == ()
    (apart,) = pair_agreements(judgements_of(journal), lambda _: None)
    assert apart.all.items == 23, "where nothing is mirrored, each of the two is an item of its own"


def test_judgements_change_no_label(demo_labels: Labels, journal: Journal, frame: Any, tmp_path: Path) -> None:
    for a, b in some_pairs(frame(), 3):
        saved(journal, actions.judge_relation(frame(), a, b, "left", F, "ann"))
    manifest, found = materialise(demo_labels, journal, tmp_path / "effective")
    assert found.unapplied == ()
    for name in ("objects", "relations", "expressions", "frames"):
        assert manifest.tables[name].content_hash == demo_labels.manifest.tables[name].content_hash
    key = ItemKey(FRAME, "relation", *some_pairs(frame(), 1)[0], "left")
    states = states_on_labels(judgements_of(journal), read_relation_labels(demo_labels))
    assert states[key] == "unsure", "the label is not what the only word on it says"


def test_the_queue_takes_what_was_said(demo_labels: Labels, journal: Journal, frame: Any, tmp_path: Path) -> None:
    before = review_queue(demo_labels, RULES_ONLY)
    mirrored = ("left", "right", "front", "behind")
    doubted = [k for k in item_keys(before) if k.what in mirrored and k.frame == FRAME]
    settled = doubted[0]
    disputed = next(k for k in doubted if {k.a, k.b} != {settled.a, settled.b})
    saved(journal, actions.set_relation(frame(), settled.a, settled.b or 0, settled.what, F))
    seen = frame()
    for author, state in (("ann", T), ("bob", F)):
        saved(journal, actions.judge_relation(seen, disputed.a, disputed.b or 0, disputed.what, state, author), author)
    number = frame().pairs.numbers.tolist()[-1]
    status = FieldRef("object", FRAME, str(number), "status")
    saved(journal, actions.set_status(frame(), status, "accepted", author="bob"), "bob")
    reviewed = reviewed_labels(demo_labels, journal, tmp_path / "effective")
    queue = review_queue(reviewed.labels, RULES_ONLY, judgements=reviewed.judgements)
    rows = dict(zip(item_keys(queue), queue.to_pylist(), strict=True))
    top = queue.slice(0, 1).to_pylist()[0]
    assert {top["a"], top["b"]} == {disputed.a, disputed.b}
    assert top["reasons"][0] == "reviewers disagree: ann says T, bob says F"
    assert rows[settled]["score"] == 0
    assert rows[settled]["label"] == "F"
    assert rows[settled]["reasons"] == []
    states = states_on_labels(reviewed.judgements, read_relation_labels(reviewed.labels))
    hidden = item_keys(left_to_review(queue, states))
    assert settled not in hidden
    assert disputed in hidden
    assert ItemKey(FRAME, "object", number, None, "") in rows
    record = review_progress(queue, reviewed.judgements, states)
    assert record["reviewers"]["ann"]["corrected"] + record["reviewers"]["ann"]["accepted"] == 4
    assert record["disagreements"] == 2
    assert record["settled"] == 3
    assert record["share"] == pytest.approx(3 / queue.num_rows)
    assert sum(record["days"].values()) == 5
    assert record["kinds"]["object"]["accepted"] == 1
    assert record["estimated_wrong"] is None


def test_settled_labels_are_never_doubted(demo_labels: Labels) -> None:
    cells = read_relation_labels(demo_labels)
    rows = np.flatnonzero(cells.states[:, 0] != 0)[::3]
    keys = [ItemKey(str(cells.frame[r]), "relation", int(cells.a[r]), int(cells.b[r]), "left") for r in rows]
    settled = settled_relations(cells, dict.fromkeys(keys, "accepted"))
    assert settled.sum() == len(keys)
    data = read_label_data(demo_labels, "rel14", demo_labels.relation_names)
    trusted = trusted_of_data(cells, settled, data)
    known = [k for k in keys for f in data.frames if f.key.frame == k.frame and {k.a, k.b} <= set(f.objects.tolist())]
    assert sum(int(t.sum()) for t in trusted) == len(known) > 20
    config = DoubtConfig(folds=2, train=TrainConfig(vocabulary="all", epochs=1, batch=256))
    doubts = doubt_labels(data, config, trusted=trusted)
    for wrong, sure in zip(doubts.wrong, trusted, strict=True):
        assert (wrong[sure] == 0).all()
    untrusted = doubt_labels(data, config)
    assert doubts.noise["left"].joint.sum() == pytest.approx(untrusted.noise["left"].joint.sum() - len(known))
    queue = review_queue(demo_labels, RULES_ONLY, doubts=(data, untrusted))
    assert wrong_left(queue, {}) == pytest.approx(float((queue.schema.metadata or {})[b"estimated_wrong"]))
    assert wrong_left(queue, dict.fromkeys(item_keys(queue), "accepted")) == 0


def test_what_is_left_for_a_second_reviewer(demo_labels: Labels, journal: Journal, frame: Any) -> None:
    queue = review_queue(demo_labels, RULES_ONLY)
    of_frame = [k for k in item_keys(queue) if k.kind == "relation" and k.frame == FRAME][:60]
    edits = [e for k in of_frame for e in actions.set_status(frame(), FieldRef("relation", FRAME, f"{k.a},{k.b}",
             f"{k.what}.status"), "accepted", author="ann")]  # fmt: skip
    saved(journal, tuple(edits))
    judgements = judgements_of(journal)
    states = judgements.states()
    keys = set(item_keys(queue))

    def shown(**options: Any) -> list[ItemKey]:
        return item_keys(left_for(queue, judgements, states, "bob", **options))

    assert set(shown()) == keys - set(of_frame)
    assert set(shown(overlap=1.0)) == keys
    third = set(shown(overlap=0.3)) & set(of_frame)
    assert 5 < len(third) < 35
    assert third <= set(shown(overlap=0.6)), "a larger share holds the smaller one"
    assert set(shown(second_opinion_of="ann")) == set(of_frame)
    assert set(shown(second_opinion_of="ann", overlap=0.3)) == third
    order = shown(overlap=0.3)
    assert [k for k in order if k not in third] == [k for k in item_keys(queue) if k not in of_frame]
    assert order.index(min(third, key=order.index)) < len(order) - len(third), "they are not all at the end"
    assert set(item_keys(left_for(queue, judgements, states, "ann"))) == keys - set(of_frame)
    assert set(left_for(queue, judgements, states, "bob", overlap=1.0).column("state").to_pylist()) == {"unreviewed"}
    for wrong in ({"overlap": 1.5}, {"overlap": float("nan")}, {"second_opinion_of": "bob"}):
        with pytest.raises(InputError):
            shown(**wrong)


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
    reviewed = reviewed_labels(demo_labels, journal, tmp_path / "labels")
    expected = states_on_labels(reviewed.judgements, read_relation_labels(reviewed.labels))
    assert {k: s for k, s in found.items() if s != "unreviewed"} == expected
    assert [found.get(left(*pair), "unreviewed") for pair in ((a, b), (c, d), (e, f), (g, h))] == [
        "accepted", "unsure", "corrected", "unreviewed",
    ]  # fmt: skip
    assert found.get(ItemKey(FRAME, "object", number, None, ""), "unreviewed") == "unreviewed"
    # Whoever works through a queue made now is shown the same.
    job = QueueJob(demo_labels.root, tmp_path / "queue.parquet", str(journal.location), networks=False)
    assert make_queue(job, lambda _: None)["last"] == newest
    work = worklist(read_queue(job.out))
    assert {k: work.state(k) for k in expected if k in work.indices} == {
        k: s for k, s in expected.items() if k in work.indices
    }
    assert work.counts["settled"] > 0


def test_what_a_rejected_object_takes_along_is_gone_until_it_is_back(
    demo_labels: Labels, bare_corrector: Corrector, journal: Journal, frame: Any, tmp_path: Path
) -> None:
    before = frame()
    number = some_pairs(before, 1)[0][0]
    whole = review_queue(demo_labels, QueueConfig(doubts=None, linter=False))
    of_frame = [k for k in item_keys(whole) if k.frame == FRAME]
    more = [ItemKey(FRAME, "expression", NOBODY, None, name) for name in before.expressions]
    more += [ItemKey(FRAME, "object", n, None, "") for n in before.objects]
    assert gone_items(before, [*of_frame, *more], {}) == frozenset()
    work = worklist(whole)
    saved(
        journal, actions.set_status(before, FieldRef("object", FRAME, str(number), "status"), "rejected", author="ann")
    )
    away, newest = refreshed_worklist(work, bare_corrector, journal, NOTHING)
    gone = {k for k in work.keys if away.is_gone(k)}
    assert gone == {k for k in of_frame if k.kind == "relation" and number in (k.a, k.b)}
    assert gone
    assert away.counts["items"] == work.counts["items"] - len(gone)
    # A queue made now has the same relations of the frame, and expressions only of what is left.
    now = reviewed_labels(demo_labels, journal, tmp_path / "labels").labels
    made_now = item_keys(review_queue(now, QueueConfig(doubts=None, linter=False)))
    assert {k for k in made_now if k.frame == FRAME and k.kind == "relation"} <= {k for k in of_frame if k not in gone}
    assert item_keys(without_gone(whole, now, states_of(journal))) == [k for k in work.keys if k not in gone]
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
    work = worklist(review_queue(demo_labels, QueueConfig(doubts=None, linter=False)))
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
