"""Object cards, giving fields back, and boxes fitted."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from journal_world import FRAME, half_of, saved, widest
from slow_cases import mostly_slow

from pipeline.corrections import (
    Corrector,
    EffectiveFrame,
    Journal,
    back_to_automatic,
    bring_back,
    fit_to_points,
    labelled_box,
    object_ref,
    same_value,
)
from pipeline.corrections.journal import edits
from pipeline.corrections.object_card import FIELDS, object_card
from pipeline.diagnosis import box_numbers
from pipeline.geometry import Box3D
from pipeline.labels.provenance import BOX_FITS
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
    assert (card.fit, object_card(frame, 3).fit) == ("", BOX_FITS[frame.objects[3]["estimator"]])
    saved(journal, fit_to_points(added, number, full_corrector))
    fitted = box_of_object(full_corrector.frame(FRAME, journal), number)
    assert fitted.volume < 0.8 * like.volume * 1.5**3
    with pytest.raises(InputError, match="nobody has changed"):
        back_to_automatic(full_corrector.frame(FRAME, journal), number, "label")
