"""Damages to labels, one at a time: relations and expressions."""

from __future__ import annotations

from functools import partial

from damaged_labels import Tables
from label_damages import Listed, Where, item, pair, put, row_of, said
from label_damages import damages as damages_into

from pipeline.datasets import OFF_SCENE

PAIR_DAMAGES: Listed = []
damages = partial(damages_into, into=PAIR_DAMAGES)


@damages("relation/inverse")
def left_is_no_longer_right_mirrored(t: Tables) -> set[Where]:
    put(pair(t, "room/1", 0, 2), left=-1)
    return {("room/1", (0, 2))}


@damages("relation/antisymmetry")
def left_holds_both_ways(t: Tables) -> set[Where]:
    put(pair(t, "room/1", 2, 0), left=1)
    return {("room/1", (0, 2))}


@damages("relation/antisymmetry")
def on_holds_both_ways_against_the_extents(t: Tables) -> set[Where]:
    put(pair(t, "room/1", 1, 3), on=1)
    return {("room/1", (1, 3))}


@damages("relation/exclusive")
def left_and_right_hold(t: Tables) -> set[Where]:
    put(pair(t, "room/1", 0, 2), right=1)
    return {("room/1", (0, 2))}


@damages("relation/exclusive")
def above_and_below_hold(t: Tables) -> set[Where]:
    put(pair(t, "room/1", 3, 1), below=1)
    return {("room/1", (3, 1))}


@damages("relation/pair-missing")
def one_way_is_removed(t: Tables) -> set[Where]:
    t["relations"].remove(pair(t, "room/2", 1, 0))
    return {("room/2", (1, 0))}


@damages("relation/pair-missing")
def both_ways_are_removed(t: Tables) -> set[Where]:
    t["relations"].remove(pair(t, "room/2", 1, 0))
    t["relations"].remove(pair(t, "room/2", 0, 1))
    return {("room/2", (0, 1))}


@damages("relation/pair-missing")
def a_state_is_removed(t: Tables) -> set[Where]:
    put(pair(t, "room/2", 1, 0), near=None)
    return {("room/2", (1, 0))}


@damages("relation/unexpected")
def the_wall_takes_part(t: Tables) -> set[Where]:
    rows = t["relations"]
    row = pair(t, "room/0", 4, 3)
    rows.insert(rows.index(row) + 1, {**row, "b": 5})
    return {("room/0", (4, 5))}


@damages("relation/unexpected")
def an_object_is_left_of_itself(t: Tables) -> set[Where]:
    rows = t["relations"]
    row = pair(t, "room/0", 0, 1)
    rows.insert(rows.index(row), {**row, "b": 0})
    return {("room/0", (0, 0))}


@damages("relation/cycle")
def boxes_run_in_a_circle(t: Tables) -> set[Where]:
    put(pair(t, "room/1", 0, 2), left=-1)
    put(pair(t, "room/1", 2, 0), left=1)
    return {("room/1", (0, 1, 2))}


@damages("relation/cycle")
def sofa_pillow_and_lamp_lie_on_one_another(t: Tables) -> set[Where]:
    # The pillow does lie on the sofa; what is added closes the circle.
    assert pair(t, "room/2", 3, 0)["on"] == 1
    for a, b in ((0, 1), (1, 3)):
        put(pair(t, "room/2", a, b), on=1)
    return {("room/2", (0, 1, 3))}


@damages("relation/geometry")
def a_direction_is_turned(t: Tables) -> set[Where]:
    put(pair(t, "room/2", 0, 2), left=-1, left_margin=-0.1)
    return {("room/2", (0, 2))}


@damages("relation/geometry")
def something_far_is_on(t: Tables) -> set[Where]:
    put(pair(t, "room/1", 0, 2), on=1, on_margin=0.1)
    return {("room/1", (0, 2))}


@damages("relation/geometry")
def something_far_is_in(t: Tables) -> set[Where]:
    put(pair(t, "room/1", 0, 2), in_margin=0.1, **{"in": 1})
    return {("room/1", (0, 2))}


@damages("relation/geometry")
def something_near_is_not(t: Tables) -> set[Where]:
    put(pair(t, "room/1", 1, 3), near=-1, near_margin=-0.1)
    return {("room/1", (1, 3))}


@damages("relation/geometry", "warning")
def a_direction_is_called_doubtful(t: Tables) -> set[Where]:
    put(pair(t, "room/2", 0, 2), left=0, left_margin=0.0)
    return {("room/2", (0, 2))}


@damages("relation/geometry", "warning")
def a_margin_has_the_other_sign(t: Tables) -> set[Where]:
    row = pair(t, "room/2", 0, 2)
    put(row, left_margin=-row["left_margin"])
    return {("room/2", (0, 2))}


@damages("relation/geometry", "warning")
def a_margin_is_edited(t: Tables) -> set[Where]:
    row = pair(t, "room/2", 0, 2)
    put(row, left_margin=row["left_margin"] + 0.01)
    return {("room/2", (0, 2))}


@damages("relation/geometry", "warning")
def a_distance_is_edited(t: Tables) -> set[Where]:
    put(pair(t, "room/2", 0, 1), distance=9.0)
    return {("room/2", (0, 1))}


@damages("expression/empty")
def targets_are_emptied(t: Tables) -> set[Where]:
    put(said(t, "room/1", "book on box"), targets=[])
    return {("room/1", (3, 1))}


@damages("expression/empty")
def its_own_target_is_left_out(t: Tables) -> set[Where]:
    put(said(t, "room/1", "box left of box"), targets=[1])
    return {("room/1", (0, 1))}


@damages("expression/everything", "warning")
def every_box_is_acceptable(t: Tables) -> set[Where]:
    put(said(t, "room/1", "box left of box"), acceptable=[0, 1, 2])
    return {("room/1", (0, 1))}


@damages("expression/state")
def its_relation_no_longer_holds(t: Tables) -> set[Where]:
    put(pair(t, "room/1", 3, 1), on=-1)
    return {("room/1", (3, 1))}


@damages("expression/state")
def its_relation_is_not_labelled(t: Tables) -> set[Where]:
    put(said(t, "room/1", "book on box"), relation="between")
    return {("room/1", (3, 1))}


@damages("expression/margin", "warning")
def its_margin_is_edited(t: Tables) -> set[Where]:
    row = said(t, "room/1", "book on box")
    put(row, margin=row["margin"] + 0.01)
    return {("room/1", (3, 1))}


@damages("expression/sets")
def a_target_is_added(t: Tables) -> set[Where]:
    put(said(t, "room/0", "mug left of mug"), targets=[1, 2, 3])
    return {("room/0", (1, 3))}


@damages("expression/sets")
def an_acceptable_one_is_lost(t: Tables) -> set[Where]:
    put(said(t, "room/0", "mug left of mug"), acceptable=[1])
    return {("room/0", (1, 3))}


@damages("expression/class")
def its_target_is_renamed(t: Tables) -> set[Where]:
    put(said(t, "room/2", "lamp behind sofa"), target="stool")
    return {("room/2", (1, 0))}


@damages("expression/class")
def its_reference_is_renamed(t: Tables) -> set[Where]:
    put(said(t, "room/2", "lamp behind sofa"), reference="stool")
    return {("room/2", (1, 0))}


@damages("expression/unreadable")
def its_text_has_no_relation(t: Tables) -> set[Where]:
    put(said(t, "room/2", "lamp behind sofa"), text="lamp sofa")
    return {("room/2", (1, 0))}


@damages("expression/unreadable")
def its_text_says_the_opposite(t: Tables) -> set[Where]:
    put(said(t, "room/2", "lamp behind sofa"), text="lamp in front of sofa")
    return {("room/2", (1, 0))}


@damages("expression/unreadable")
def its_text_says_more(t: Tables) -> set[Where]:
    put(said(t, "room/2", "lamp behind sofa"), text="lamp behind sofa left of trash can")
    return {("room/2", (1, 0))}


@damages("expression/article", "warning")
def its_text_speaks_as_of_the_only_one(t: Tables) -> set[Where]:
    row = said(t, "room/1", "book on box")
    put(row, text="book on the box")
    return {("room/1", (row["target_object"], row["reference_object"]))}


@damages("expression/ambiguous")
def a_flag_is_turned(t: Tables) -> set[Where]:
    put(said(t, "room/1", "box left of box"), ambiguous=False)
    return {("room/1", (0, 1))}


@damages("expression/unusable")
def the_book_is_no_longer_usable(t: Tables) -> set[Where]:
    put(item(t, "room/1", 3), usable=False, reason="fewer than 300 pixels")
    named = [(r["target_object"], r["reference_object"]) for r in t["expressions"] if r["frame"] == "room/1"]
    return {("room/1", p) for p in named if 3 in p}


@damages("frame/implausible-depth", "warning")
def all_depth_is_five_times_too_far(t: Tables) -> set[Where]:
    for row in t["objects"]:
        if row["frame"] == "room/0":
            put(row, size=[5 * edge for edge in row["size"]])
    return {("room/0", ())}


@damages("frame/up-disagrees", "warning")
def a_frame_said_that_its_plane_is_another(t: Tables) -> set[Where]:
    put(row_of(t["frames"], frame="room/0"), notes=[f"its own level plane is 40 {OFF_SCENE}"])
    return {("room/0", ())}


@damages("object/other-views", "warning")
def another_view_calls_it_another_class(t: Tables) -> set[Where]:
    put(item(t, "room/0", 1), instance=7)
    put(item(t, "room/1", 0), instance=7)
    return {("room/0", (1,)), ("room/1", (0,))}


@damages("object/other-places", "warning")
def another_object_has_the_number(t: Tables) -> set[Where]:
    for row in t["frames"]:
        row["T_world_camera"] = [float(i == j) for i in range(4) for j in range(4)]
    for frame, number, x in (("room/0", 1, 0.0), ("room/1", 1, 0.0), ("room/2", 2, 1.5)):
        row = item(t, frame, number)
        put(row, instance=7, center=[x, 0.0, 2.0])
        row["label"] = "mug"
    return {("room/2", (2,))}


@damages("relation/other-views", "warning")
def another_view_shows_it_beside_and_not_above(t: Tables) -> set[Where]:
    for frame, mug, table in (("room/0", 1, 0), ("room/2", 2, 0)):
        put(item(t, frame, mug), instance=1)
        put(item(t, frame, table), instance=2)
    # Above in the one, and not in the other; below the other way round.
    return {("room/0", (1, 0)), ("room/0", (0, 1)), ("room/2", (2, 0)), ("room/2", (0, 2))}
