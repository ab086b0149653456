"""States of a review from the journal: who said what, on what they differ, what is left for whom."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from journal_world import FRAME, an_expression, saved
from state_checks import frame, left, some_pairs, states_of, status_cell  # noqa: F401

from pipeline.corrections import (
    Conflict,
    Corrector,
    DoubtConfig,
    FieldRef,
    ItemKey,
    Journal,
    Saved,
    State,
    actions_of,
    apply_actions,
    item_keys,
    materialise,
    pair_agreements,
    read_relation_labels,
    redo,
    review_queue,
    reviewed_labels,
    states_on_labels,
    undo,
    worklist,
)
from pipeline.corrections.journal import edits as actions
from pipeline.corrections.review.doubts import doubt_labels
from pipeline.corrections.review.items import NOBODY, item_of, judgements_of
from pipeline.corrections.review.queue import Evidence
from pipeline.labels import Labels
from pipeline.relations import F, T
from pipeline.system import InputError
from pipeline.training import TrainConfig, read_label_data


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
    for wrong in (
        {"edit": "judge", "to": "fine", **pair},
        {"edit": "judge", "to": "T", "frame": FRAME},
        {"edit": "judge", "to": "T", **pair, "relation": "between"},
    ):
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
    ann, bob = np.array(said["ann"][1:]), np.array(said["bob"][1:])
    by_chance = sum((ann == state).mean() * (bob == state).mean() for state in (T, F))
    assert pair.all.kappa == pytest.approx(((ann == bob).mean() - by_chance) / (1 - by_chance))
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
    before = review_queue(demo_labels)
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
    effective, judgements = reviewed_labels(demo_labels, journal, tmp_path / "effective")
    queue = review_queue(effective, judgements=judgements)
    rows = dict(zip(item_keys(queue), queue.to_pylist(), strict=True))
    top = queue.slice(0, 1).to_pylist()[0]
    assert {top["a"], top["b"]} == {disputed.a, disputed.b}
    assert top["reasons"][0] == "reviewers disagree: ann says T, bob says F"
    assert rows[settled]["score"] == 0
    assert rows[settled]["label"] == "F"
    assert rows[settled]["reasons"] == []
    states = states_on_labels(judgements, read_relation_labels(effective))
    work = worklist(queue, states)
    left_over = {work.keys[k] for k in work.left()}
    assert settled not in left_over
    assert disputed in left_over
    assert work.counts["settled"] == 3
    assert ItemKey(FRAME, "object", number, None, "") in rows


def test_settled_labels_are_never_doubted(demo_labels: Labels) -> None:
    pytest.importorskip("torch")
    cells = read_relation_labels(demo_labels)
    some = np.flatnonzero(cells.states[:, 0] != 0)[::3]
    keys = [ItemKey(str(cells.frame[r]), "relation", int(cells.a[r]), int(cells.b[r]), "left") for r in some]
    settled = Evidence(cells, dict.fromkeys(keys, "accepted")).settled_cells.reshape(cells.states.shape)
    assert settled.sum() == len(keys)
    data = read_label_data(demo_labels, "rel14", demo_labels.relation_names)
    rows = [cells.rows_of_pairs(frame) for frame in data.frames]
    trusted = [(at >= 0)[..., None] & settled[at] for at in rows]
    known = [k for k in keys for f in data.frames if f.key.frame == k.frame and {k.a, k.b} <= set(f.objects.tolist())]
    assert sum(int(t.sum()) for t in trusted) == len(known) > 20
    config = DoubtConfig(folds=2, train=TrainConfig(vocabulary="all", epochs=1, batch=256))
    doubts = doubt_labels(data, config, trusted=trusted)
    for wrong, sure in zip(doubts.wrong, trusted, strict=True):
        assert (wrong[sure] == 0).all()
    untrusted = doubt_labels(data, config)
    assert doubts.noise["left"].joint.sum() == pytest.approx(untrusted.noise["left"].joint.sum() - len(known))


def test_what_is_left_for_a_second_reviewer(demo_labels: Labels, journal: Journal, frame: Any) -> None:
    queue = review_queue(demo_labels)
    of_frame = [k for k in item_keys(queue) if k.kind == "relation" and k.frame == FRAME][:60]
    edits = [
        e
        for k in of_frame
        for e in actions.set_status(
            frame(), FieldRef("relation", FRAME, f"{k.a},{k.b}", f"{k.what}.status"), "accepted", author="ann"
        )
    ]
    saved(journal, tuple(edits))
    judgements = judgements_of(journal)
    states = judgements.states()
    first = next(k for k in item_keys(queue) if k not in of_frame)
    own = {"ann": judgements.states("ann"), "bob": {first: "unsure"}}

    def shown(author: str) -> list[ItemKey]:
        found = worklist(queue, {**states, first: "unsure"}).of_reviewer(own[author])
        return [found.keys[k] for k in found.left()]

    left_over = [k for k in item_keys(queue) if k not in of_frame]
    assert shown("ann") == left_over, "what another is unsure of is asked where it stands"
    assert shown("bob") == [*left_over[1:], first], "and of one's own last"
