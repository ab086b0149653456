"""Corrections of a frame proposed for the scene's other frames, saved and taken back as one step."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

import numpy as np
import pytest
from journal_world import FRAME, half_of, saved

from pipeline.corrections import Corrector, Journal, set_box, set_class, set_status, undo
from pipeline.corrections.journal.edits import add_object
from pipeline.corrections.journal.field_refs import box_of, object_ref
from pipeline.corrections.propagate import CARRIED, CarriedObject, proposals
from pipeline.system.errors import InputError

LAPTOP, LAMP, DESK = 2, 5, 0
OTHERS = "000001/000001", "000001/000002"


def proposed(
    corrector: Corrector, journal: Journal, numbers: Collection[int] | None = None
) -> dict[str, CarriedObject]:
    """Proposals for the two other frames, of which each has one."""
    found = {one.frame: one.proposals for one in proposals(corrector, journal, FRAME, numbers)}
    return {frame: made[0] for frame, made in found.items() if made}


def test_a_class_is_proposed_where_the_object_stands(full_corrector: Corrector, journal: Journal) -> None:
    saved(journal, set_class(full_corrector.frame(FRAME, journal), LAPTOP, "notebook"))
    found = proposed(full_corrector, journal)
    assert tuple(found) == OTHERS
    for frame, one in found.items():
        assert full_corrector.frame(frame, journal).objects[one.number]["label"] == "laptop"
        assert [e.ref for e in one.edits] == [object_ref(frame, one.number, "label")]
        assert one.iou > 0.8
        assert one.edits[0].reason.startswith(f"{CARRIED}{FRAME}, object {LAPTOP}: ")
        assert "confidence" in one.edits[0].reason
        assert one.record()["from"] == {"frame": FRAME, "object": LAPTOP}


def test_proposals_are_saved_and_taken_back_as_one_step(full_corrector: Corrector, journal: Journal) -> None:
    saved(journal, set_class(full_corrector.frame(FRAME, journal), LAPTOP, "notebook"))
    found = proposed(full_corrector, journal)
    events = saved(journal, tuple(e for one in found.values() for e in one.edits))
    assert len({e.group for e in events}) == 1
    labels = [full_corrector.frame(f, journal).objects[one.number]["label"] for f, one in found.items()]
    assert labels == ["notebook"] * 2
    # What stands there already is not proposed again.
    assert proposed(full_corrector, journal) == {}
    undo(journal, "ann")
    labels = [full_corrector.frame(f, journal).objects[one.number]["label"] for f, one in found.items()]
    assert labels == ["laptop"] * 2


def test_what_a_person_set_there_stays(full_corrector: Corrector, journal: Journal) -> None:
    saved(journal, set_class(full_corrector.frame(FRAME, journal), LAPTOP, "notebook"))
    found = proposed(full_corrector, journal)
    saved(journal, tuple(e for one in found.values() for e in one.edits))
    other, number = OTHERS[0], found[OTHERS[0]].number
    saved(journal, set_class(full_corrector.frame(other, journal), number, "screen"), "ben")
    saved(journal, set_class(full_corrector.frame(FRAME, journal), LAPTOP, "computer"))
    again = proposed(full_corrector, journal)
    assert again[other].edits == ()
    assert again[other].kept == ("label",)
    # A carried value, which nobody has looked at there, follows.
    assert [e.after for e in again[OTHERS[1]].edits] == ["computer"]


def test_a_carried_value_is_not_carried_on(full_corrector: Corrector, journal: Journal) -> None:
    saved(journal, set_class(full_corrector.frame(FRAME, journal), LAPTOP, "notebook"))
    saved(journal, tuple(e for one in proposed(full_corrector, journal).values() for e in one.edits))
    with pytest.raises(InputError, match="nobody has set anything"):
        list(proposals(full_corrector, journal, OTHERS[0]))


def test_an_object_that_is_nowhere_else_becomes_a_new_one(full_corrector: Corrector, journal: Journal) -> None:
    frame = full_corrector.frame(FRAME, journal)
    mask = half_of(frame, DESK)[0]
    mask[330:] = False
    saved(journal, add_object(frame, "desk pad", mask=mask, instance=7))
    found = proposed(full_corrector, journal)
    one = found[OTHERS[1]]
    assert one.new
    assert one.record()["fields"] == ["exists"]
    saved(journal, one.edits)
    row = full_corrector.frame(OTHERS[1], journal).objects[one.number]
    assert (row["label"], row["instance"]) == ("desk pad", 7)
    assert row["mask_pixels"] == one.mask.area


def test_a_box_is_proposed_at_its_place_in_the_world(full_corrector: Corrector, journal: Journal) -> None:
    frame = full_corrector.frame(FRAME, journal)
    box = box_of({k: frame.objects[DESK][k] for k in ("center", "R", "size")})
    saved(journal, set_box(frame, DESK, box))
    one = proposed(full_corrector, journal)[OTHERS[1]]
    assert full_corrector.dataset is not None
    poses = [full_corrector.dataset.load(f).camera.T_world_camera for f in (FRAME, OTHERS[1])]
    (edit,) = (e for e in one.edits if e.ref.field == "box")
    there = box_of(edit.after).transformed(poses[1])  # pyright: ignore[reportArgumentType]
    assert np.allclose(there.center, box.transformed(poses[0]).center, atol=1e-4)  # pyright: ignore[reportArgumentType]


def test_a_rejection_goes_to_the_object_at_the_same_place(full_corrector: Corrector, journal: Journal) -> None:
    saved(journal, set_status(full_corrector.frame(FRAME, journal), object_ref(FRAME, LAMP, "status"), "rejected"))
    found = proposed(full_corrector, journal)
    assert found
    for frame, one in found.items():
        assert not one.new
        assert [(e.ref.field, e.after) for e in one.edits] == [("status", "rejected")]
        assert full_corrector.frame(frame, journal).objects[one.number]["label"] == "lamp"


def test_a_named_object_is_carried_as_it_is(full_corrector: Corrector, journal: Journal) -> None:
    found = list(proposals(full_corrector, journal, FRAME, [3], [OTHERS[0]]))
    assert [one.frame for one in found] == [OTHERS[0]]
    assert [e.ref.field for e in found[0].proposals[0].edits] == ["mask"]
    assert found[0].record()["agree"] > 0.8


@pytest.mark.parametrize(
    ("numbers", "to", "match"),
    [
        (None, None, "nobody has set anything"),
        ([99], None, "no such object"),
        ([3], ["000002/000000"], "no posed frames of the scene"),
    ],
)
def test_what_cannot_be_carried_is_told(
    full_corrector: Corrector, journal: Journal, numbers: list[int] | None, to: list[str] | None, match: str
) -> None:
    with pytest.raises(InputError, match=match):
        list(proposals(full_corrector, journal, FRAME, numbers, to))


def test_without_the_dataset_nothing_is_carried(bare_corrector: Corrector, journal: Journal) -> None:
    with pytest.raises(InputError, match="the dataset is needed"):
        list(proposals(bare_corrector, journal, FRAME))


def test_further_labelled_frames_show_more_of_an_object(full_corrector: Corrector, journal: Journal) -> None:
    """The third frame gets a mask of which two frames together show more than one of them."""
    frame = full_corrector.frame(FRAME, journal)
    saved(journal, set_class(frame, LAPTOP, "notebook"))
    (alone,) = proposals(full_corrector, journal, FRAME, None, OTHERS[1:])
    (both,) = proposals(full_corrector, journal, FRAME, None, OTHERS[1:], also=OTHERS[:1])
    assert [p.label for p in both.proposals] == ["notebook"]
    assert both.proposals[0].mask.seen > alone.proposals[0].mask.seen
    assert {s.frame_id for s in both.proposals[0].mask.sightings} == {FRAME, OTHERS[0]}
    assert [one.frame for one in proposals(full_corrector, journal, FRAME, None, also=OTHERS[:1])] == [OTHERS[1]]


@pytest.mark.parametrize("instance", [-1, True, "7", 2**31, 1.5])
def test_an_instance_is_a_number(full_corrector: Corrector, journal: Journal, instance: object) -> None:
    (edit,) = add_object(full_corrector.frame(FRAME, journal), "desk pad", bbox=(10, 10, 40, 40))
    with pytest.raises(InputError, match="an instance is a number"):
        replace(edit, after={**edit.after, "instance": instance})
