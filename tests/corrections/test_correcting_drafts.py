"""Drafts of pixels: what is drawn is one edit, what follows from it is told, and files of edits say the same."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from journal_world import FRAME, half_of, saved, widest

from pipeline.corrections import (
    Corrector,
    Draft,
    EffectiveFrame,
    Journal,
    Saved,
    actions_of,
    apply_actions,
    consequences,
    edits_of_draft,
    lifted_draft,
    needs_pictures,
    new_draft,
    object_ref,
    rebased,
    undo,
    with_depth_split,
    with_gesture,
)
from pipeline.corrections.journal import edits
from pipeline.corrections.journal.edits import pixels_of
from pipeline.corrections.journal.field_refs import FIRST_NEW_OBJECT
from pipeline.drawing import Canvas, Gesture
from pipeline.drawing.gestures import polygon_mask, rectangle_mask, stroke_mask
from pipeline.language import PAIRWISE
from pipeline.relations import T
from pipeline.system import InputError


@pytest.fixture
def frame(full_corrector: Corrector, journal: Journal) -> EffectiveFrame:
    return full_corrector.frame(FRAME, journal)


@pytest.fixture(scope="module")
def canvas(full_corrector: Corrector) -> Canvas:
    assert full_corrector.relifter is not None
    return Canvas(full_corrector.relifter.context(FRAME))


def middle(mask: np.ndarray) -> np.ndarray:
    rows, columns = np.nonzero(mask)
    return np.array([[columns.mean() + 0.5, rows.mean() + 0.5]])


def test_several_strokes_are_one_edit(frame: EffectiveFrame, full_corrector: Corrector, journal: Journal) -> None:
    number = widest(frame)
    before = pixels_of(frame, number)
    at = middle(before)
    draft = new_draft(frame, number)
    assert not draft.changed
    for shift in (0.0, 15.0, 30.0):
        draft = with_gesture(draft, Gesture("stroke", at + shift, False, 6.0))
    height, width = before.shape
    gone = np.logical_or.reduce([stroke_mask(at + s, 6.0, height, width) for s in (0.0, 15.0, 30.0)])
    np.testing.assert_array_equal(draft.mask, before & ~gone)
    (event,) = saved(journal, edits_of_draft(draft, frame))
    assert (event.ref.field, event.ref.numbers) == ("mask", (number,))
    np.testing.assert_array_equal(pixels_of(full_corrector.frame(FRAME, journal), number), before & ~gone)


def test_steps_are_taken_back_and_brought_back(frame: EffectiveFrame) -> None:
    number = widest(frame)
    at = middle(pixels_of(frame, number))
    steps = [new_draft(frame, number)]
    for radius in (4.0, 8.0, 12.0):
        steps.append(with_gesture(steps[-1], Gesture("stroke", at, False, radius)))
    draft = steps[-1]
    for earlier in reversed(steps[:-1]):
        draft = draft.back()
        np.testing.assert_array_equal(draft.mask, earlier.mask)
    assert draft.back() == draft
    assert not draft.changed
    np.testing.assert_array_equal(draft.forth().forth().forth().forth().mask, steps[-1].mask)
    other = with_gesture(draft.forth(), Gesture("stroke", at, True, 30.0))
    assert other.forth() == other
    # Painting what is painted already is no step.
    assert with_gesture(other, Gesture("stroke", at, True, 30.0)) == other


def test_drafts_that_cannot_be_applied_are_refused(frame: EffectiveFrame, canvas: Canvas) -> None:
    number = widest(frame)
    draft = new_draft(frame, number)
    everything = Gesture("rectangle", np.array([[0.0, 0.0], [draft.width, draft.height]]), False)
    for made, label, said in (
        (draft, "", "nothing has changed"),
        (with_gesture(draft, everything), "", "no pixel is left"),
        (new_draft(frame, None), "mug", "nothing is drawn"),
        (with_gesture(new_draft(frame, None), Gesture("stroke", np.array([[50.0, 50.0]]), True, 9.0)), " ", "class"),
    ):
        with pytest.raises(InputError, match=said) as caught:
            edits_of_draft(made, frame, label)
        assert "\n" not in str(caught.value)
    line = Gesture("cut", np.array([[0.0, 0.0], [1.0, 0.0]]))
    for wrong, said in ((new_draft(frame, None), "new object"), (draft, "empty")):
        with pytest.raises(InputError, match=said):
            with_gesture(wrong, line)
    with pytest.raises(InputError, match="new object"):
        with_depth_split(new_draft(frame, None), canvas)
    with pytest.raises(InputError, match="no object 999"):
        new_draft(frame, 999)


def test_pixels_that_somebody_changed_meanwhile_are_not_replaced_unasked(
    frame: EffectiveFrame, full_corrector: Corrector, journal: Journal
) -> None:
    number = widest(frame)
    at = middle(pixels_of(frame, number))
    draft = with_gesture(new_draft(frame, number), Gesture("stroke", at, False, 9.0))
    saved(journal, edits.set_mask(frame, number, half_of(frame, number)[0]), "bob")
    now = full_corrector.frame(FRAME, journal)
    with pytest.raises(InputError, match="bob"):
        edits_of_draft(draft, now)
    saved(journal, edits_of_draft(rebased(draft, now), now))
    np.testing.assert_array_equal(pixels_of(full_corrector.frame(FRAME, journal), number), draft.mask)


def cut_across(frame: EffectiveFrame, number: int) -> Draft:
    mask = pixels_of(frame, number)
    columns = np.flatnonzero(mask.any(axis=0))
    x = float(columns[len(columns) // 2])
    line = np.array([[x, 0.0], [x, mask.shape[0]]])
    return with_gesture(new_draft(frame, number), Gesture("cut", line))


def test_a_cut_makes_objects_that_share_no_pixel(
    frame: EffectiveFrame, full_corrector: Corrector, journal: Journal
) -> None:
    number = widest(frame)
    draft = cut_across(frame, number)
    with pytest.raises(InputError, match="is cut"):
        with_gesture(draft, Gesture("stroke", np.array([[5.0, 5.0]])))
    parts = draft.parts
    assert len(parts) == 2
    saved(journal, edits_of_draft(draft, frame))
    after = full_corrector.frame(FRAME, journal)
    (new,) = set(after.objects) - set(frame.objects)
    assert new >= FIRST_NEW_OBJECT
    assert after.objects[new]["label"] == frame.objects[number]["label"]
    np.testing.assert_array_equal(pixels_of(after, number), parts[0])
    np.testing.assert_array_equal(pixels_of(after, new), parts[1])
    np.testing.assert_array_equal(parts[0] ^ parts[1], pixels_of(frame, number))
    # Merged again, it has all its pixels.
    saved(journal, edits.merge_objects(after, [number, new]))
    again = full_corrector.frame(FRAME, journal)
    np.testing.assert_array_equal(pixels_of(again, number), pixels_of(frame, number))
    assert set(again.objects) == set(frame.objects)


def test_a_new_object_from_clicks_gets_the_box_that_was_shown(
    frame: EffectiveFrame, canvas: Canvas, full_corrector: Corrector, journal: Journal
) -> None:
    number = next(n for n, row in frame.objects.items() if row["label"] == "box")
    mask = pixels_of(frame, number)
    draft = with_gesture(new_draft(frame, None), Gesture("depth", middle(mask)), canvas)
    assert (draft.mask & mask).sum() / (draft.mask | mask).sum() > 0.8
    shown = lifted_draft(canvas, draft.mask)
    assert shown is not None
    assert shown.box is not None
    (event,) = saved(journal, edits_of_draft(draft, frame, "crate"))
    after = full_corrector.frame(FRAME, journal)
    row = after.objects[event.ref.numbers[0]]
    assert row["label"] == "crate"
    np.testing.assert_allclose(row["center"], shown.box.center, atol=1e-6)
    np.testing.assert_allclose(row["size"], shown.box.size, atol=1e-6)
    name = f"crate·{event.ref.numbers[0]}"
    told = consequences(frame, after)
    assert told.startswith(f"{name} added · 3D box of {name} fitted · ")
    assert told.endswith(" relations recomputed, none changed")


# ---- what follows -----------------------------------------------------------------------


def test_nothing_follows_from_nothing(frame: EffectiveFrame) -> None:
    assert consequences(frame, frame) == ""


def test_what_follows_from_other_pixels_is_counted_and_told(
    frame: EffectiveFrame, full_corrector: Corrector, journal: Journal
) -> None:
    number = widest(frame)
    saved(journal, edits.set_mask(frame, number, half_of(frame, number)[0]))
    after = full_corrector.frame(FRAME, journal)
    told = consequences(frame, after)
    old, new = (np.array(f.objects[number]["center"]) for f in (frame, after))
    name = f"{frame.objects[number]['label']}·{number}"
    assert told.startswith(f"3D box of {name} recomputed: moved {100 * np.linalg.norm(new - old):.1f} cm")
    assert told.count("3D box") == 1
    # By brute force: one for each relation and its mirror image that differs.
    differs, judged = set(), set()
    for a in frame.objects:
        for b in frame.objects:
            for relation in frame.setting.relations:
                if a == b or frame.pairs.index_of(a) is None or frame.pairs.index_of(b) is None:
                    continue
                inverse = frame.setting.inverse(relation)
                name = frozenset({(a, b, relation)} | ({(b, a, inverse)} if inverse else set()))
                if number in (a, b) and after.pairs.state(a, b, relation) is not None:
                    judged.add(name)
                if frame.pairs.state(a, b, relation) != after.pairs.state(a, b, relation):
                    differs.add(name)
    assert "\n" not in told
    assert f"{len(judged)} relations recomputed, {len(differs) or 'none'} changed" in told
    # Taken back, the same relations change back, and none was judged anew.
    undo(journal, "ann")
    back = consequences(after, full_corrector.frame(FRAME, journal))
    assert "recomputed," not in back
    assert (f"relations: {len(differs)} changed" in back) == bool(differs)


def test_what_a_person_set_is_no_consequence(bare_corrector: Corrector, journal: Journal) -> None:
    frame = bare_corrector.frame(FRAME, journal)
    k = PAIRWISE.index("left")
    i, j = np.argwhere(frame.pairs.states[..., k] == T)[0]
    a, b = int(frame.pairs.numbers[i]), int(frame.pairs.numbers[j])
    saved(journal, edits.set_relation(frame, a, b, "right", T))
    after = bare_corrector.frame(FRAME, journal)
    told = consequences(frame, after)
    # What was set rules out its opposite: that one follows.
    one, other = (f"{frame.objects[n]['label']}·{n}" for n in (a, b))
    assert told.endswith(("1 changed: " + f"{one} left of {other} T→F", "1 changed: " + f"{other} right of {one} T→F"))
    saved(journal, edits.set_mask(after, a, half_of(after, a)[0]))
    assert consequences(after, bare_corrector.frame(FRAME, journal)).endswith("stale: the dataset is not at hand")


def test_a_rejected_object_takes_expressions_with_it(bare_corrector: Corrector, journal: Journal) -> None:
    frame = bare_corrector.frame(FRAME, journal)
    row = next(iter(frame.expressions.values()))
    number = row["reference_object"]
    saved(journal, edits.set_status(frame, object_ref(frame.frame, number, "status"), "rejected"))
    after = bare_corrector.frame(FRAME, journal)
    told = consequences(frame, after)
    assert told.startswith(f"{frame.objects[number]['label']}·{number} left out · ")
    assert row["id"] not in after.expressions
    assert f"{len(frame.expressions.keys() - after.expressions.keys())} expressions withdrawn" in told


# ---- files of edits ---------------------------------------------------------------------


def applied(corrector: Corrector, journal: Journal, *entries: dict[str, Any]) -> EffectiveFrame:
    done = apply_actions(corrector, journal, actions_of([{"frame": FRAME, **e} for e in entries]), "ann")
    assert isinstance(done, Saved), done
    return corrector.frame(FRAME, journal)


def test_files_of_edits_draw_as_hands_do(
    frame: EffectiveFrame, full_corrector: Corrector, canvas: Canvas, journal: Journal
) -> None:
    number = widest(frame)
    mask = pixels_of(frame, number)
    height, width = mask.shape
    corners = [[100.5, 100.0], [180.0, 120.0], [130.0, 190.5]]
    shape = polygon_mask(np.array(corners), height, width)
    expected = mask
    for mode, combine in (("add", mask | shape), ("remove", mask & ~shape), ("replace", shape)):
        expected = combine
        now = applied(full_corrector, journal, {"edit": "mask", "object": number, "polygon": corners, "mode": mode})
        np.testing.assert_array_equal(pixels_of(now, number), expected)
        undo(journal, "ann")
    box = next(n for n, row in frame.objects.items() if row["label"] == "box")
    where = [float(x) for x in frame.objects[box]["bbox"]]
    now = applied(
        full_corrector,
        journal,
        {"edit": "new", "label": "carton", "rectangle": where},
        {"edit": "mask", "object": number, "rectangle": where},
    )
    by_label = {row["label"]: n for n, row in now.objects.items() if n >= FIRST_NEW_OBJECT}
    found = pixels_of(now, by_label["carton"])
    assert (found & pixels_of(frame, box)).sum() / (found | pixels_of(frame, box)).sum() > 0.8
    # Of an object that there is, a rectangle is the rectangle.
    corners2 = np.array(where).reshape(2, 2)
    np.testing.assert_array_equal(pixels_of(now, number), rectangle_mask(corners2, height, width))


@pytest.mark.parametrize(
    ("entry", "said"),
    [
        ({"edit": "mask", "object": 0}, "either"),
        ({"edit": "mask", "object": 0, "to": None, "polygon": [[0, 0], [9, 0], [9, 9]]}, "either"),
        ({"edit": "mask", "object": 0, "rectangle": [0, 0, 9]}, "at least 4 values"),
        ({"edit": "mask", "object": 0, "strokes": []}, "strokes"),
        ({"edit": "mask", "object": 0, "to": None, "mode": "add"}, "replaces"),
        ({"edit": "mask", "object": 0, "polygon": [[0, 0], [9, 0], [9, 9]], "mode": "xor"}, "mode"),
        ({"edit": "new", "label": "mug", "mask": "0", "rectangle": [1, 1, 5, 5]}, "either"),
    ],
)
def test_shapes_that_say_two_things_are_refused(entry: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=said) as caught:
        actions_of([{"frame": FRAME, **entry}])
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("entry", "said"),
    [
        ({"polygon": [[0, 0], [9, 0]]}, "polygon"),
        ({"polygon": [[0.0, 0.0], [float("nan"), 0.0], [9.0, 9.0]]}, "finite"),
        ({"polygon": [[9000.0, 0.0], [9000.0, 10.0], [9100.0, 9.0]]}, "outside"),
        ({"polygon": [[0, 0], [9, 0], [9, 9]], "rectangle": [0, 0, 9, 9]}, "both"),
        ({"rectangle": [5.0, 5.0, 5.0, 90.0]}, "no pixel"),
    ],
)
def test_shapes_that_mean_nothing_save_nothing(
    full_corrector: Corrector, journal: Journal, entry: dict[str, Any], said: str
) -> None:
    todo = actions_of([{"edit": "mask", "frame": FRAME, "object": 0, **entry}])
    with pytest.raises(InputError, match=said):
        apply_actions(full_corrector, journal, todo, "ann")
    assert journal.events() == ()


def test_only_what_follows_depth_needs_the_pictures(
    bare_corrector: Corrector, journal: Journal, tmp_path: Path
) -> None:
    where = [10.0, 10.0, 60.0, 60.0]
    drawn = actions_of([{"edit": "mask", "frame": FRAME, "object": 0, "rectangle": where, "mode": "add"}])
    grown = actions_of([{"edit": "new", "frame": FRAME, "label": "mug", "rectangle": where}])
    assert (needs_pictures(drawn), needs_pictures(grown)) == (False, True)
    assert isinstance(apply_actions(bare_corrector, journal, drawn, "ann"), Saved)
    with pytest.raises(InputError, match="pictures"):
        apply_actions(bare_corrector, journal, grown, "ann")
