"""Object cards, giving fields back, boxes fitted and snapped, and relations while a box is being moved."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from journal_world import FRAME, half_of, saved, widest
from slow_cases import mostly_slow

from pipeline.corrections import (
    Corrector,
    EffectiveFrame,
    Journal,
    MovingBox,
    Waiting,
    back_to_automatic,
    bring_back,
    fit_to_points,
    journal_of,
    labelled_box,
    object_ref,
    pair_card,
    relation_ref,
    same_value,
    snap_to_support,
    support_of,
)
from pipeline.corrections.journal import edits
from pipeline.corrections.journal.events import new_ulid
from pipeline.corrections.object_card import FIELDS, object_card
from pipeline.diagnosis import box_numbers
from pipeline.geometry import Box3D
from pipeline.language import PAIRWISE
from pipeline.relations import F, T
from pipeline.system import InputError


def box_of_object(frame: EffectiveFrame, number: int) -> Box3D:
    box = labelled_box(frame.objects[number])
    assert box is not None
    return box


def shifted(box: Box3D, by: tuple[float, ...], scale: float = 1.0) -> Box3D:
    return Box3D(box.center + np.array(by), box.R, box.size * scale)


def same_tables(a: EffectiveFrame, b: EffectiveFrame) -> bool:
    return all(table.equals(b.tables()[name]) for name, table in a.tables().items())


def test_a_card_says_of_every_field_what_it_is_and_where_from(full_corrector: Corrector, journal: Journal) -> None:
    frame = full_corrector.frame(FRAME, journal)
    number = widest(frame)
    card = object_card(frame, number)
    assert tuple(line.field for line in card.fields) == FIELDS
    assert all(line.origin.source == "auto" and not line.settled for line in card.fields)
    assert "viewer-cone-v1" in str(card.line("box").origin)
    assert (card.status, card.stands, card.added_by) == (None, True, "")
    assert sum(card.states.values()) == (len(frame.pairs.numbers) - 1) * len(frame.setting.relations)
    assert full_corrector.relifter is not None
    viewer = full_corrector.relifter.context(FRAME).viewer
    assert card.numbers is not None
    assert same_value(card.record()["box"]["center"], list(box_numbers(box_of_object(frame, number), viewer).center))
    saved(journal, edits.set_class(frame, number, "throne", "it has a crown"), "bob")
    saved(journal, edits.set_mask(full_corrector.frame(FRAME, journal), number, half_of(frame, number)[0]))
    after = object_card(full_corrector.frame(FRAME, journal), number)
    assert after.label == after.line("label").value == "throne"
    assert (after.line("label").origin.author, after.line("label").automatic) == ("bob", card.label)
    record = after.record()["fields"]
    assert (record["label"]["origin"], record["label"]["reason"]) == ("human", "it has a crown")
    assert (record["mask"]["author"], record["box"]["origin"], record["bbox"]["origin"]) == ("ann", *["recomputed"] * 2)
    assert not after.line("box").settled


def test_without_the_pictures_what_follows_is_stale(bare_corrector: Corrector, journal: Journal) -> None:
    frame = bare_corrector.frame(FRAME, journal)
    number = widest(frame)
    saved(journal, edits.set_mask(frame, number, half_of(frame, number)[0]))
    frame = bare_corrector.frame(FRAME, journal)
    assert object_card(frame, number).line("box").origin.source == "stale"
    saved(journal, edits.set_box(frame, number, shifted(box_of_object(frame, number), (0.1, 0, 0))))
    saved(journal, fit_to_points(bare_corrector.frame(FRAME, journal), number, bare_corrector))
    assert object_card(bare_corrector.frame(FRAME, journal), number).line("box").origin.source == "stale"
    with pytest.raises(InputError, match="dataset"):
        snap_to_support(bare_corrector.frame(FRAME, journal), number, bare_corrector)


def test_a_rejected_object_has_a_card_and_comes_back(full_corrector: Corrector, journal: Journal) -> None:
    before = full_corrector.frame(FRAME, journal)
    number = widest(before)
    saved(journal, edits.set_status(before, object_ref(before.frame, number, "status"), "rejected", "a reflection"))
    gone = full_corrector.frame(FRAME, journal)
    card = object_card(gone, number)
    assert (card.stands, card.status, card.line("status").settled) == (False, "rejected", True)
    saved(journal, back_to_automatic(gone, number, "status"))
    after = full_corrector.frame(FRAME, journal)
    assert same_tables(before, after)
    assert object_card(after, number).status is None
    with pytest.raises(InputError, match="no object 77"):
        object_card(after, 77)


def test_each_person_judges_an_object_and_bringing_it_back_takes_the_own_word_back(
    full_corrector: Corrector, journal: Journal
) -> None:
    before = full_corrector.frame(FRAME, journal)
    number = widest(before)
    cell = object_ref(FRAME, number, "status")
    with pytest.raises(InputError, match="not rejected"):
        bring_back(before, number, "ann")
    saved(journal, edits.set_status(before, cell, "unsure", author="bob"), "bob")
    saved(journal, edits.set_status(full_corrector.frame(FRAME, journal), cell, "rejected", author="ann"))
    gone = full_corrector.frame(FRAME, journal)
    card = object_card(gone, number)
    assert (card.stands, card.status, card.statuses) == (False, "rejected", {"ann": "rejected", "bob": "unsure"})
    assert len(saved(journal, bring_back(gone, number, "ann"))) == 2
    after = full_corrector.frame(FRAME, journal)
    assert same_tables(before, after)
    assert object_card(after, number).statuses == {"bob": "unsure"}
    assert object_card(after, number).record()["said"] == {"bob": "unsure"}


@pytest.mark.parametrize("field", mostly_slow(FIELDS, fast=(0, 1)))
def test_a_field_given_back_leaves_the_labels_as_they_were(
    field: str, full_corrector: Corrector, journal: Journal
) -> None:
    before = full_corrector.frame(FRAME, journal)
    number = widest(before)
    with pytest.raises(InputError, match="nobody has changed"):
        back_to_automatic(before, number, field)
    left, _ = half_of(before, number)
    made: dict[str, Any] = {
        "label": lambda: edits.set_class(before, number, "throne"),
        "status": lambda: edits.set_status(before, object_ref(FRAME, number, "status"), "unsure"),
        "mask": lambda: edits.set_mask(before, number, left),
        "bbox": lambda: edits.set_bbox(before, number, [1, 2, 30, 40]),
        "box": lambda: edits.set_box(before, number, shifted(box_of_object(before, number), (0.2, 0, 0.1))),
    }
    saved(journal, made[field]())
    changed = full_corrector.frame(FRAME, journal)
    assert object_card(changed, number).line(field).settled
    (event,) = saved(journal, back_to_automatic(changed, number, field))
    assert event.ref == object_ref(FRAME, number, field)
    after = full_corrector.frame(FRAME, journal)
    assert same_tables(before, after)
    assert after.unapplied == ()
    assert not object_card(after, number).line(field).settled
    with pytest.raises(InputError, match="nobody has changed"):
        back_to_automatic(after, number, field)
    # What is made on it afterwards counts, too.
    saved(journal, edits.set_box(after, number, shifted(box_of_object(after, number), (0, 0.3, 0))))
    last = full_corrector.frame(FRAME, journal)
    assert last.unapplied == ()
    assert object_card(last, number).line("box").origin.source == "human"


def test_a_box_that_is_fitted_follows_the_mask_again(full_corrector: Corrector, journal: Journal) -> None:
    before = full_corrector.frame(FRAME, journal)
    number = widest(before)
    with pytest.raises(InputError, match="already"):
        fit_to_points(before, number, full_corrector)
    left, right = half_of(before, number)
    saved(journal, edits.set_mask(before, number, left))
    halved = full_corrector.frame(FRAME, journal)
    saved(journal, edits.set_box(halved, number, shifted(box_of_object(before, number), (0.3, 0, 0), 2.0)))
    placed = full_corrector.frame(FRAME, journal)
    (event,) = saved(journal, fit_to_points(placed, number, full_corrector))
    assert (event.after, event.reason) == (None, "fitted to its points")
    fitted = full_corrector.frame(FRAME, journal)
    assert same_value(fitted.objects[number]["center"], halved.objects[number]["center"])
    assert object_card(fitted, number).line("box").origin.source == "recomputed"
    saved(journal, edits.set_mask(fitted, number, right))
    other = full_corrector.frame(FRAME, journal)
    assert not same_value(other.objects[number]["center"], halved.objects[number]["center"])
    assert other.unapplied == ()


def test_an_object_added_as_a_box_is_fitted_to_the_points_in_it(full_corrector: Corrector, journal: Journal) -> None:
    frame = full_corrector.frame(FRAME, journal)
    like = box_of_object(frame, 3)
    saved(journal, edits.add_object(frame, "mug", box=shifted(like, (0, 0, 0), 1.5)), "bob")
    added = full_corrector.frame(FRAME, journal)
    (number,) = added.objects.keys() - frame.objects.keys()
    card = object_card(added, number)
    assert (card.added_by, card.line("box").automatic) == ("bob", None)
    saved(journal, fit_to_points(added, number, full_corrector))
    fitted = box_of_object(full_corrector.frame(FRAME, journal), number)
    assert fitted.volume < 0.7 * like.volume * 1.5**3
    with pytest.raises(InputError, match="nobody has changed"):
        back_to_automatic(full_corrector.frame(FRAME, journal), number, "label")


def test_a_box_is_snapped_to_the_desk_it_stands_on(full_corrector: Corrector, journal: Journal) -> None:
    frame = full_corrector.frame(FRAME, journal)
    assert frame.objects[4]["label"] == "mug"
    support, gap = support_of(frame, 4, full_corrector)
    assert support.number is not None
    assert frame.objects[support.number]["label"] == "desk"
    assert 0.001 < gap < 0.05
    size = box_of_object(frame, 4).size
    for way in ("move", "extend"):
        (event,) = saved(journal, snap_to_support(frame, 4, full_corrector, way))
        assert "desk" in event.reason
        frame = full_corrector.frame(FRAME, journal)
        assert support_of(frame, 4, full_corrector)[1] == pytest.approx(0, abs=0.002)
        assert same_value(box_of_object(frame, 4).size[[0, 2]].tolist(), size[[0, 2]].tolist())
        with pytest.raises(InputError, match="already"):
            snap_to_support(frame, 4, full_corrector, way)
        saved(journal, fit_to_points(frame, 4, full_corrector))
        frame = full_corrector.frame(FRAME, journal)


@pytest.fixture(scope="module")
def settled(full_corrector: Corrector, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Journal]:
    """A journal in which somebody has already said something of the pairs of the mug 4, and added an object."""
    with journal_of(full_corrector.labels, tmp_path_factory.mktemp("moving") / "j.sqlite") as journal:
        frame = full_corrector.frame(FRAME, journal)
        saved(journal, edits.set_relation(frame, 4, 2, "left", T), "bob")
        saved(journal, edits.set_relation(full_corrector.frame(FRAME, journal), 9, 4, "behind", T), "bob")
        frame = full_corrector.frame(FRAME, journal)
        saved(journal, edits.add_object(frame, "cup", box=box_of_object(frame, 3)), "bob")
        yield journal


@settings(max_examples=6)
@given(
    place=st.integers(0, 3),
    by=st.tuples(*(st.floats(-0.6, 0.6) for _ in range(3))),
    scale=st.floats(0.5, 2.0),
    turned=st.booleans(),
)
def test_relations_while_a_box_moves_are_those_that_saving_it_makes(
    settled: Journal, full_corrector: Corrector, place: int, by: tuple[float, ...], scale: float, turned: bool
) -> None:
    frame = full_corrector.frame(FRAME, settled)
    added = max(frame.objects)
    number, other = [(4, 2), (4, 9), (added, 4), (11, added)][place]
    pair = (other, number) if turned else (number, other)
    box = shifted(box_of_object(frame, number), by, scale)
    moved = MovingBox(frame, full_corrector, number, pair).moved(box)
    assert moved.card is not None
    events = settled.events()
    (edit,) = edits.set_box(frame, number, box)
    waiting = Waiting((edit,), "ann", new_ulid(), events[-1].time, "").events(events[-1].id + 1, "")
    after = pair_card(full_corrector.frame(FRAME, [*events, *waiting]), *pair)
    assert [(x.relation, x.state) for x in moved.card.lines] == [(x.relation, x.state) for x in after.lines]
    for live, kept in zip(moved.card.lines, after.lines, strict=True):
        assert live.margin == pytest.approx(kept.margin, abs=1e-5), live.relation
    assert moved.card.distance == pytest.approx(after.distance, abs=1e-5)
    before = pair_card(frame, *pair)
    assert moved.changed == tuple(
        x.relation for x, y in zip(after.lines, before.lines, strict=True) if x.state != y.state
    )


def test_what_a_person_said_stands_while_a_box_moves(settled: Journal, full_corrector: Corrector) -> None:
    frame = full_corrector.frame(FRAME, settled)
    far = shifted(box_of_object(frame, 4), (3.0, 0, 0))
    moved = MovingBox(frame, full_corrector, 4, (4, 2)).moved(far)
    assert moved.card is not None
    states = {line.relation: line.state for line in moved.card.lines}
    assert (states["left"], states["right"]) == (T, F)
    assert frame.origin(relation_ref(FRAME, 4, 2, "left")).author == "bob"
    assert set(moved.changed) <= set(PAIRWISE)
    assert moved.number == 4


def test_a_box_can_move_where_there_is_no_pair(full_corrector: Corrector, bare_corrector: Corrector) -> None:
    for corrector, pair in ((full_corrector, None), (full_corrector, (2, 3)), (bare_corrector, (4, 2))):
        frame = corrector.frame(FRAME, ())
        moved = MovingBox(frame, corrector, 4, pair).moved(box_of_object(frame, 4))
        assert (moved.card, moved.changed) == (None, ())
    with pytest.raises(InputError, match="no object 77"):
        MovingBox(full_corrector.frame(FRAME, ()), full_corrector, 77)
