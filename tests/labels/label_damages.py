"""Damages to labels, one at a time: files, rows, frames and objects."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

from damaged_labels import Tables

Where = tuple[str | None, tuple[int, ...]]
"""Frame and objects of a finding."""

Damage = Callable[[Tables], set[Where]]
"""Edits the rows; returns what must be found then."""

Listed = list[tuple[str, str, Damage]]
"""(rule, severity, damage)."""


def row_of(rows: list[dict[str, Any]], **values: Any) -> dict[str, Any]:
    (found,) = [r for r in rows if all(r[k] == v for k, v in values.items())]
    return found


def pair(tables: Tables, frame: str, a: int, b: int) -> dict[str, Any]:
    return row_of(tables["relations"], frame=frame, a=a, b=b)


def item(tables: Tables, frame: str, number: int) -> dict[str, Any]:
    return row_of(tables["objects"], frame=frame, object=number)


def said(tables: Tables, frame: str, text: str) -> dict[str, Any]:
    """The row whose sentence this is, but for articles."""
    rows = [r for r in tables["expressions"] if r["frame"] == frame]
    (found,) = [r for r in rows if re.sub(" (?:the|a|another) ", " ", r["text"]) == text]
    return found


def put(row: dict[str, Any], **values: Any) -> None:
    assert all(row[k] != v for k, v in values.items()), "this would damage nothing"
    row.update(values)


DAMAGES: Listed = []


def damages(rule: str, severity: str = "error", into: Listed = DAMAGES) -> Callable[[Damage], Damage]:
    """Lists a function as the damage that a rule must find."""

    def listed(change: Damage) -> Damage:
        into.append((rule, severity, change))
        return change

    return listed


@damages("file/changed", "warning")
def a_cell_is_edited(t: Tables) -> set[Where]:
    put(item(t, "room/1", 1), score=0.5)
    return {(None, ())}


@damages("profile/changed", "warning")
def rules_had_other_thresholds(t: Tables) -> set[Where]:
    t["manifest"][0]["profile_hash"] = "0" * 64
    # Geometry must then not be compared.
    put(pair(t, "room/2", 0, 2), left_margin=9.0)
    return {(None, ())}


@damages("row/model")
def a_state_is_none_of_three(t: Tables) -> set[Where]:
    put(pair(t, "room/1", 0, 1), left=5)
    return {("room/1", (0, 1))}


@damages("row/model")
def a_vector_has_two_numbers(t: Tables) -> set[Where]:
    put(item(t, "room/1", 3), lo=[0.0, 1.0])
    return {("room/1", (3,))}


@damages("row/model")
def a_share_is_above_one(t: Tables) -> set[Where]:
    put(item(t, "room/0", 2), occluded=1.5)
    return {("room/0", (2,))}


@damages("row/non-finite")
def a_length_is_nan(t: Tables) -> set[Where]:
    put(item(t, "room/0", 3), size=[0.1, float("nan"), 0.1])
    return {("room/0", (3,))}


@damages("row/non-finite")
def a_margin_is_infinite(t: Tables) -> set[Where]:
    put(pair(t, "room/0", 1, 2), above_margin=float("-inf"))
    return {("room/0", (1, 2))}


@damages("row/duplicate-key")
def a_row_is_doubled(t: Tables) -> set[Where]:
    rows = t["relations"]
    k = rows.index(pair(t, "room/2", 1, 3))
    rows.insert(k, dict(rows[k]))
    return {("room/2", (1, 3))}


@damages("row/duplicate-key")
def a_frame_is_doubled(t: Tables) -> set[Where]:
    t["frames"].insert(1, dict(t["frames"][1]))
    return {("room/1", ())}


@damages("row/dangling")
def an_expression_names_a_missing_object(t: Tables) -> set[Where]:
    put(said(t, "room/0", "chair right of table"), reference_object=77)
    return {("room/0", (4, 77))}


@damages("row/dangling")
def answers_name_a_missing_object(t: Tables) -> set[Where]:
    put(said(t, "room/0", "chair right of table"), acceptable=[4, 77])
    return {("room/0", (4, 0))}


@damages("row/dangling")
def a_frame_is_removed(t: Tables) -> set[Where]:
    t["frames"].remove(row_of(t["frames"], frame="room/1"))
    return {("room/1", ())}


@damages("row/dangling")
def a_row_names_another_frame(t: Tables) -> set[Where]:
    put(item(t, "room/2", 1), frame="room/0")
    return {("room/2", (1,))}


@damages("frame/camera")
def up_is_too_long(t: Tables) -> set[Where]:
    frame = row_of(t["frames"], frame="room/2")
    put(frame, up=[2 * x for x in frame["up"]])
    return {("room/2", ())}


@damages("frame/camera")
def the_focal_length_is_negative(t: Tables) -> set[Where]:
    frame = row_of(t["frames"], frame="room/0")
    put(frame, K=[-frame["K"][0], *frame["K"][1:]])
    return {("room/0", ())}


@damages("frame/up-assumed", "warning")
def nothing_tells_where_up_is(t: Tables) -> set[Where]:
    put(row_of(t["frames"], frame="room/2"), up_source="assumed")
    return {("room/2", ())}


@damages("frame/up-disagrees", "warning")
def a_pose_makes_up_another(t: Tables) -> set[Where]:
    """The cameras look down by 20, 25 and 20 degrees; the pose of the first is turned by 37 more."""
    for frame in t["frames"]:
        put(frame, T_world_camera=[1.0, 0, 0, 0, 0, 1.0, 0, 0, 0, 0, 1.0, 0, 0, 0, 0, 1.0])
    t["frames"][0]["T_world_camera"] = [1.0, 0, 0, 0, 0, 0.8, -0.6, 0, 0, 0.6, 0.8, 0, 0, 0, 0, 1.0]
    return {("room/0", ())}


@damages("frame/camera")
def the_pose_is_scaled(t: Tables) -> set[Where]:
    put(row_of(t["frames"], frame="room/0"), T_world_camera=[2.0, 0, 0, 0, 0, 2.0, 0, 0, 0, 0, 2.0, 0, 0, 0, 0, 1.0])
    return {("room/0", ())}


@damages("frame/objects")
def an_object_is_removed(t: Tables) -> set[Where]:
    t["objects"].remove(item(t, "room/1", 2))
    return {("room/1", ())}


@damages("object/mask")
def a_mask_breaks_off(t: Tables) -> set[Where]:
    mask = item(t, "room/1", 2)
    put(mask, mask=mask["mask"][: len(mask["mask"]) // 2])
    return {("room/1", (2,))}


@damages("object/mask")
def a_mask_is_of_a_larger_picture(t: Tables) -> set[Where]:
    # The whole frame as one run of 640 x 480 zeros.
    put(item(t, "room/1", 2), mask="PPP`5")
    return {("room/1", (2,))}


@damages("object/mask")
def an_area_is_edited(t: Tables) -> set[Where]:
    put(item(t, "room/2", 0), mask_pixels=17)
    return {("room/2", (0,))}


@damages("object/rotation")
def a_rotation_is_sheared(t: Tables) -> set[Where]:
    box = item(t, "room/1", 0)
    put(box, R=[box["R"][0] + 0.01, *box["R"][1:]])
    return {("room/1", (0,))}


@damages("object/rotation")
def an_exact_rotation_is_a_mirror(t: Tables) -> set[Where]:
    box = item(t, "room/1", 0)
    put(box, exact_R=[-x for x in box["exact_R"]])
    return {("room/1", (0,))}


@damages("object/bbox-mask")
def a_2d_box_is_moved(t: Tables) -> set[Where]:
    bbox = item(t, "room/1", 1)
    put(bbox, bbox=[bbox["bbox"][0] + 90, bbox["bbox"][1], bbox["bbox"][2] + 90, bbox["bbox"][3]])
    return {("room/1", (1,))}


@damages("object/bbox-mask", "warning")
def a_2d_box_is_cut(t: Tables) -> set[Where]:
    bbox = item(t, "room/1", 1)["bbox"]
    put(item(t, "room/1", 1), bbox=[bbox[0], bbox[1], bbox[2], bbox[1] + 0.5 * (bbox[3] - bbox[1])])
    return {("room/1", (1,))}


@damages("object/box-mask")
def a_3d_box_is_behind_the_camera(t: Tables) -> set[Where]:
    box = item(t, "room/2", 2)
    put(box, center=[*box["center"][:2], -box["center"][2]])
    return {("room/2", (2,))}


@damages("object/box-mask")
def a_3d_box_is_moved(t: Tables) -> set[Where]:
    box = item(t, "room/2", 2)
    put(box, center=[box["center"][0] - 0.6, *box["center"][1:]])
    return {("room/2", (2,))}


@damages("object/box-mask", "warning")
def a_3d_box_is_half_off(t: Tables) -> set[Where]:
    box = item(t, "room/2", 2)
    put(box, center=[box["center"][0] - 0.34, *box["center"][1:]])
    return {("room/2", (2,))}


@damages("object/extent-box")
def extents_are_moved(t: Tables) -> set[Where]:
    row = item(t, "room/2", 0)
    put(row, lo=[row["lo"][0] + 1, *row["lo"][1:]], hi=[row["hi"][0] + 1, *row["hi"][1:]])
    return {("room/2", (0,))}


@damages("object/extent-box", "warning")
def extents_are_a_little_higher(t: Tables) -> set[Where]:
    row = item(t, "room/2", 0)
    put(row, hi=[row["hi"][0], row["hi"][1] + 0.1, row["hi"][2]])
    return {("room/2", (0,))}


@damages("object/extent-box", "warning")
def a_mean_point_is_elsewhere(t: Tables) -> set[Where]:
    put(item(t, "room/2", 3), centroid=[3.0, 0.0, 2.0])
    return {("room/2", (3,))}


@damages("object/duplicate")
def a_mask_is_given_twice(t: Tables) -> set[Where]:
    one, other = item(t, "room/0", 1), item(t, "room/0", 2)
    put(other, mask=one["mask"])
    return {("room/0", (1, 2))}


@damages("object/duplicate")
def a_3d_box_is_given_twice(t: Tables) -> set[Where]:
    one, other = item(t, "room/1", 0), item(t, "room/1", 2)
    put(other, center=one["center"], size=one["size"])
    other["R"] = one["R"]  # Both stand alike.
    return {("room/1", (0, 2))}


@damages("object/duplicate", "warning")
def a_mask_is_given_under_two_names(t: Tables) -> set[Where]:
    put(item(t, "room/0", 4), mask=item(t, "room/0", 0)["mask"])
    return {("room/0", (0, 4))}


@damages("object/few-points", "warning")
def few_points_are_left(t: Tables) -> set[Where]:
    put(item(t, "room/1", 3), points=20)
    return {("room/1", (3,))}


@damages("object/no-depth", "warning")
def depth_is_missing(t: Tables) -> set[Where]:
    put(item(t, "room/1", 3), depth_missing=0.75)
    return {("room/1", (3,))}


@damages("object/border", "warning")
def an_object_is_cut(t: Tables) -> set[Where]:
    put(item(t, "room/1", 3), touches_border=True)
    return {("room/1", (3,))}


@damages("object/implausible-size")
def a_mug_is_a_metre_long(t: Tables) -> set[Where]:
    put(item(t, "room/0", 2), size=[0.14, 1.0, 0.1])
    return {("room/0", (2,))}


@damages("object/implausible-size", "warning")
def a_mug_is_a_centimetre_long(t: Tables) -> set[Where]:
    put(item(t, "room/0", 2), exact_size=[0.01, 0.01, 0.01])
    return {("room/0", (2,))}
