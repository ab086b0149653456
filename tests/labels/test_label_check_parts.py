"""What the linter is built of: run-length codes, constraints, cycles, sizes, projections, and what profiles promise."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError
from scenes import camera_of, frame_of, upright

from pipeline.geometry import MaskCrop, encode_run_length, paired_iou_2d
from pipeline.labels import PROFILES, TABLES, expression_text, projected, says_the
from pipeline.labels.check.objects import SizeSurvey, corners_of, moved_towards
from pipeline.labels.check.relations import has_cycle, shortest_cycle
from pipeline.labels.check.stream import Violation, column_arrays, violations
from pipeline.labels.check.view import read_mask
from pipeline.labels.reading import arrow_schema
from pipeline.language import DIRECTIONAL, PAIRWISE, size_range
from pipeline.language.class_sizes import size_table
from pipeline.language.counted import counted
from pipeline.relations import T


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 40), st.integers(1, 40), st.floats(0, 1))
def test_runs_of_any_mask(seed: int, height: int, width: int, share: float) -> None:
    mask = np.random.default_rng(seed).random((height, width)) < share
    found = read_mask(encode_run_length(mask), height, width)
    assert isinstance(found, MaskCrop)
    assert found.area == mask.sum()
    v, u = np.nonzero(mask)
    expected = [u.min(), v.min(), u.max() + 1, v.max() + 1] if len(v) else [0, 0, 0, 0]
    assert list(found.box) == expected


def test_runs_of_large_blocks() -> None:
    mask = np.zeros((480, 640), np.bool_)
    mask[100:300, 50:600] = True
    found = read_mask(encode_run_length(mask), 480, 640)
    assert isinstance(found, MaskCrop)
    assert (found.area, list(found.box)) == (200 * 550, [50, 100, 600, 300])
    assert isinstance(read_mask(encode_run_length(mask), 480, 641), str)


@settings(max_examples=75, deadline=None)
@given(st.text(st.characters(min_codepoint=0, max_codepoint=300), max_size=40))
def test_a_code_is_read_as_pycocotools_reads_it_or_refused(code: str) -> None:
    """Whatever is accepted decodes, without a byte written beyond the mask, to the area that was said."""
    found = read_mask(code, 6, 7)
    if isinstance(found, MaskCrop):
        from pycocotools import mask as coco

        assert int(coco.decode({"size": [6, 7], "counts": code.encode("ascii")}).sum()) == found.area


def broken(rows: pa.Table, table: str) -> list[Violation]:
    return violations(rows, column_arrays(rows, table), table)


VALUES = [None, -2, -1, 0, 1, 2, 0.5, 1.5, "x", "plane", [0.0] * 3, [0.0] * 9, [1.0, None, 2.0], [1, 2], [], True]


def test_a_side_that_is_none_is_refused() -> None:
    row = GOOD_ROWS["objects"] | {"open_sides": ["left", "x"]}
    rows = pa.Table.from_pylist([row], schema=pa.schema([pa.field(f.name, f.type) for f in arrow_schema("objects")]))
    assert [v.column for v in broken(rows, "objects")] == ["open_sides"]


@settings(max_examples=50, deadline=None)
@given(st.data())
def test_constraints_agree_with_the_models(data: st.DataObject) -> None:
    """A cell is refused where, and only where, pydantic refuses it, for every column that can hold the value at all."""
    table = data.draw(st.sampled_from(list(TABLES)))
    field = data.draw(st.sampled_from(list(arrow_schema(table))))
    value = data.draw(st.sampled_from(VALUES))
    row = GOOD_ROWS[table] | {field.name: value}
    try:
        rows = pa.Table.from_pylist([row], schema=pa.schema([pa.field(f.name, f.type) for f in arrow_schema(table)]))
    except (pa.ArrowInvalid, pa.ArrowTypeError):
        return
    if value is None and not field.nullable:
        # Refused where the file is read.
        return
    (stored,) = rows.to_pylist()
    try:
        TABLES[table].model_validate(stored)
        refused = set()
    except ValidationError as error:
        refused = {str(e["loc"][0]) for e in error.errors()}
    assert {v.column for v in broken(rows, table)} == refused


def test_what_a_cell_may_not_be_is_told_in_plain_words() -> None:
    row = GOOD_ROWS["objects"] | {"score": 1.5, "bbox": [0.0]}
    rows = pa.Table.from_pylist([row], schema=pa.schema([pa.field(f.name, f.type) for f in arrow_schema("objects")]))
    assert {v.column: v.message for v in broken(rows, "objects")} == {
        "score": "score: got 1.5; expected at most 1",
        "bbox": "bbox: got [0.0]; expected at least 4 values",
    }


ROW = {"frame": "f", "frame_index": 0}
GOOD_ROWS = {
    "frames": ROW
    | {
        "scene": "s",
        "ok": True,
        "problem": None,
        "width": 4,
        "height": 3,
        "K": [1.0] * 9,
        "T_world_camera": None,
        "up": [0.0, -1.0, 0.0],
        "up_source": "imu",
        "rgb_hash": "",
        "depth_hash": "",
        "objects": 1,
        "notes": ["n"],
    },
    "objects": ROW
    | {
        "object": 1,
        "label": "mug",
        "score": 1.0,
        "instance": None,
        "bbox": [0.0] * 4,
        "mask": None,
        "mask_source": "box",
        "mask_pixels": 1,
        "points": 1,
        "kept": 1.0,
        "depth_missing": 0.0,
        "touches_border": False,
        "fallback": False,
        "distance": 1.0,
        "center": [0.0] * 3,
        "R": [0.0] * 9,
        "size": [0.0] * 3,
        "yaw_confidence": 0.0,
        "estimator": "gravity",
        "lo": [0.0] * 3,
        "hi": [0.0] * 3,
        "centroid": None,
        "exact_center": None,
        "exact_R": None,
        "exact_size": None,
        "visible": None,
        "occluded": 0.0,
        "usable": True,
        "reason": None,
    },
    "relations": ROW
    | {"a": 0, "b": 1, "distance": 0.5, "doubted": 0}
    | dict.fromkeys(PAIRWISE, 0)
    | {f"{r}_margin": 0.0 for r in PAIRWISE},
    "expressions": ROW
    | {
        "id": "0",
        "text": "t",
        "target": "a",
        "relation": "left",
        "reference": "b",
        "target_object": 0,
        "reference_object": 1,
        "targets": [0],
        "acceptable": [0],
        "ambiguous": False,
        "margin": 0.1,
        "judged_in": "viewer",
        "up_source": "plane",
        "profile": "p",
    },
}


@pytest.mark.parametrize("table", TABLES)
def test_a_good_row_breaks_nothing(table: str) -> None:
    rows = pa.Table.from_pylist([GOOD_ROWS[table]], schema=arrow_schema(table))
    assert broken(rows, table) == []


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10**6), st.sampled_from(list(PROFILES)))
def test_directions_never_lead_back(seed: int, name: str) -> None:
    """T of a direction orders centres along its axis: no cycle, however objects lie; so a cycle is always an error."""
    rng = np.random.default_rng(seed)
    half = rng.uniform(0.005, 0.8, (12, 3))
    center = rng.uniform((-1.5, -1.5, 1.5), (1.5, 1.5, 4.5), (12, 3))
    states = PROFILES[name].judge(center - half, center + half, center, None).states
    for relation in DIRECTIONAL:
        if relation in PROFILES[name].relations:
            axis = {"left": 0, "right": 0, "above": 1, "below": 1, "front": 2, "behind": 2}[relation]
            order = np.argsort(center[:, axis])
            holds = (states[..., PAIRWISE.index(relation)] == T)[np.ix_(order, order)]
            assert not (np.tril(holds) if relation in ("left", "below", "front") else np.triu(holds)).any()


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10**6), st.integers(3, 9))
def test_a_shortest_cycle_is_a_cycle_and_none_is_shorter(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    holds = np.zeros((n, n), np.bool_)
    ring = rng.permutation(n)
    holds[ring, np.roll(ring, -1)] = True
    a, b = rng.integers(0, n, 2)
    holds[a, b] |= a != b and not holds[b, a]
    assert has_cycle(np.stack([np.zeros_like(holds), holds]))
    assert not has_cycle(np.triu(holds, 1)[None])
    cycle = shortest_cycle(holds)
    assert holds[cycle, np.roll(cycle, -1)].all()
    assert len(set(cycle.tolist())) == len(cycle)
    assert cycle[0] == cycle.min()
    power, length = holds.copy(), 1
    while not np.diagonal(power).any():
        power, length = power.astype(int) @ holds > 0, length + 1
    assert len(cycle) == length


def test_a_box_is_projected_onto_its_own_pixels() -> None:
    box = upright((0.1, 0.2, 2.0), (0.4, 0.3, 0.5), 30)
    frame = frame_of([box], ["box"], floor=None, pitch=0.0)
    annotation = frame.annotations[0]
    assert annotation.box is not None
    corners = corners_of(annotation.box.center[None], annotation.box.R[None], annotation.box.size[None])
    np.testing.assert_allclose(corners[0], annotation.box.corners, atol=1e-12)
    # Rays through pixel centres miss at most a pixel at each side.
    np.testing.assert_allclose(projected(corners, camera_of().K)[0], annotation.bbox, atol=1.0)


def test_slack_moves_sides_no_farther_than_the_target() -> None:
    box, target = np.array([[0.0, 10, 100, 50]]), np.array([[3.0, 20, 90, 50]])
    moved = moved_towards(box, target, np.array([[4.0]]))
    assert moved.tolist() == [[3, 14, 96, 50]]
    assert paired_iou_2d(moved, target)[0] > paired_iou_2d(box, target)[0]


def rows_of_lengths(label: str, lengths: np.ndarray) -> dict[str, np.ndarray]:
    n = len(lengths)
    size = np.stack([lengths, lengths / 2, lengths / 3], axis=1)
    no = np.zeros(n, np.bool_)
    return {
        "label": np.full(n, label, object),
        "size": size,
        "exact_size": np.full((n, 3), np.nan),
        "touches_border": no,
        "occluded": np.zeros(n),
        "fallback": no,
    }


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10**6), st.integers(9, 60))
def test_the_survey_knows_the_median_to_a_step(seed: int, n: int) -> None:
    lengths = np.exp(np.random.default_rng(seed).normal(-1, 0.4, n))
    survey = SizeSurvey()
    for part in np.array_split(lengths, 3):
        survey.add(rows_of_lengths("mug", part))
    median, deviation, count = survey.spread("mug")
    logs = np.sort(np.log(lengths))
    low, high = logs[(n - 1) // 2], logs[n // 2]
    assert count == n
    assert low - 0.02 <= median <= high + 0.02
    # An even number of examples leaves the choice between two middle ones.
    mads = [np.median(np.abs(logs - m)) for m in (low, high)]
    assert 0.6 * min(mads) - 0.06 <= deviation / 1.4826 <= 1.6 * max(mads) + 0.06
    assert survey.spread("unknown")[2] == 0


def test_sizes_are_found_by_any_name_and_make_sense() -> None:
    assert all(0 < low < high for low, high in size_table().values())
    assert size_range("the_Mugs") == size_range("mug")
    assert size_range("couch") == size_range("sofa")
    assert size_range("zeppelin") is None


@pytest.mark.parametrize(
    ("text", "target", "reference", "expected"),
    [
        ("the mug left of a laptop", "mug", "laptop", [True, False]),
        ("find the mug holder left of a mug", "mug holder", "mug", [True, False]),
        ("find the mug holder left of the mug", "mug holder", "mug", [True, True]),
        ("is a mug behind the hot dog?", "mug", "hot_dog", [False, True]),
        ('Mug on the left of the "left shoe"', "mug", "left shoe", [False, True]),
    ],
)
def test_the_is_of_the_name_that_follows(text: str, target: str, reference: str, expected: list[bool]) -> None:
    assert says_the(text, [target, reference]) == expected


@pytest.mark.parametrize("several", [(False, False), (True, False), (False, True), (True, True)])
def test_what_is_worded_for_several_never_says_the(several: tuple[bool, bool]) -> None:
    for key in range(0, 4000, 7):
        text = expression_text("coffee table", "left", "table", key, several=several)
        said = says_the(text, ["coffee table", "table"])
        assert not any(x and y for x, y in zip(said, several, strict=True)), text


@settings(max_examples=30)
@given(st.integers(0, 10**7), st.sampled_from(["scene", "class", "label"]))
def test_only_one_thing_is_singular(count: int, what: str) -> None:
    number, noun = counted(count, what).split()
    assert int(number.replace(",", "")) == count
    assert (noun == what) == (count == 1)
