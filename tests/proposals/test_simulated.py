"""The simulated detector: its rates, and that nothing but its keys decides."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from shelf import DEPTH, NAMES, SHELF, H, U, V, W, rows_of, shelf

from pipeline.answering import PreparedFrame
from pipeline.geometry import Annotation, LiftConfig, iou_2d
from pipeline.proposals import SimulatedDetector, SimulationOptions, make_detector
from pipeline.proposals.simulated import FIRST_REGION_ID, leaked, read_options, resized, surroundings, truncated
from pipeline.system import InputError

SEEDS = st.integers(0, 2**32 - 1)
MANY = [replace(SHELF, id=f"scene/{k}") for k in range(150)]


def simulated(**options: Any) -> SimulatedDetector:
    return SimulatedDetector(SimulationOptions(**options), NAMES)


QUIET: dict[str, Any] = {
    "recall": 1,
    "cross_class": 0,
    "background": 0,
    "box_jitter": 0,
    "mask_error": (0, 0),
    "truncated": 0,
    "corrupted": 0,
}


def within_binomial(count: int, n: int, p: float) -> bool:
    """Inside five standard deviations: a right rate fails once in two million."""
    return abs(count - n * p) <= 5 * np.sqrt(n * p * (1 - p)) + 1


GOLDEN_IDS = [0, 15, 5, 10, 4294967299]
GOLDEN_SCORES = [0.4915672, 0.2221164, 0.2112802, 0.1849365, 0.1758888]
GOLDEN_BOX = [14.3956, 12.9724, 49.0181, 47.8646]


# What decides.


@pytest.mark.slow
@given(SEEDS, st.permutations(NAMES), st.integers(0, 40))
@settings(max_examples=15, deadline=None)
def test_nothing_depends_on_the_order_of_calls(seed: int, order: list[str], other: int) -> None:
    once = {name: rows_of(simulated(seed=seed).detect(SHELF, [name])) for name in NAMES}
    busy = simulated(seed=seed)
    busy.detect(MANY[other], None)
    for name in order:
        assert rows_of(busy.detect(SHELF, [name])) == once[name]
    together = busy.detect(SHELF, list(order))
    assert rows_of(together) == rows_of(busy.detect(SHELF, None))
    assert set(together.ids.tolist()) == {row[0] for rows in once.values() for row in rows}
    assert len(set(together.ids.tolist())) == len(together)
    assert (np.diff(together.scores) <= 0).all()


def test_a_thing_looks_the_same_under_every_name() -> None:
    detector = simulated(cross_class=1, most_confused=10, background=8)
    seen: dict[int, tuple[bytes, bytes]] = {}
    names: dict[int, set[str]] = {}
    for name in NAMES:
        for number, label, _, box, mask in rows_of(detector.detect(SHELF, [name])):
            assert label == name
            assert seen.setdefault(number, (box, mask)) == (box, mask)
            names.setdefault(number, set()).add(label)
    assert max(map(len, names.values())) > 2
    assert any(number >= FIRST_REGION_ID and len(n) > 1 for number, n in names.items())


def test_an_object_keeps_its_own_name_where_that_found_it() -> None:
    detector = simulated(cross_class=1, most_confused=20, recall=0.5, confused_logit=3)
    own = {row[0] for name in NAMES for row in rows_of(detector.detect(SHELF, [name])) if name == NAMES[row[0] % 5]}
    joint = detector.detect(SHELF, None)
    for i in range(len(joint)):
        number = int(joint.ids[i])
        if number < FIRST_REGION_ID:
            assert (joint.label(i) == NAMES[number % 5]) == (number in own)
    assert 0 < len(own) < len(joint)


def test_the_spelling_of_a_name_decides_nothing() -> None:
    detector = simulated()
    assert rows_of(detector.detect(SHELF, ["the mugs"])) == rows_of(detector.detect(SHELF, ["mug"]))
    with pytest.raises(InputError, match=r"does not know the class 'lammp'.*'lamp'"):
        detector.detect(SHELF, ["lammp"])


def test_the_hashes_are_those_of_every_machine() -> None:
    """Golden figures: another version must not make other detections of the same seed."""
    found = simulated(seed=7).detect(SHELF, ["mug"])
    assert found.ids.tolist() == GOLDEN_IDS
    np.testing.assert_allclose(found.scores, GOLDEN_SCORES, atol=1e-6)
    np.testing.assert_allclose(found.boxes[0], GOLDEN_BOX, atol=1e-3)


@given(SEEDS, st.floats(0, 1), st.floats(0, 1))
@settings(max_examples=25, deadline=None)
def test_a_lower_recall_only_takes_objects_away(seed: int, a: float, b: float) -> None:
    few = simulated(seed=seed, **QUIET | {"recall": min(a, b)}).detect(SHELF, None)
    more = simulated(seed=seed, **QUIET | {"recall": max(a, b)}).detect(SHELF, None)
    assert set(rows_of(few)) <= set(rows_of(more))


def test_the_fingerprint_covers_every_option() -> None:
    changes: dict[str, Any] = {
        "seed": 1,
        "recall": 0.5,
        "cross_class": 0.5,
        "most_confused": 3,
        "background": 0.5,
        "box_jitter": 0.05,
        "mask_error": (-1, 3),
        "truncated": 0.5,
        "corrupted": 0.5,
        "true_logit": 0.1,
        "confused_logit": 0.1,
        "background_logit": 0.1,
        "score_spread": 0.5,
        "class_spread": 0.5,
        "doubted": 0.5,
        "doubted_logit": -3.0,
    }
    assert set(changes) == set(SimulationOptions.model_fields)
    prints = {simulated(**{key: value}).fingerprint() for key, value in changes.items()}
    prints |= {simulated().fingerprint(), SimulatedDetector(None, NAMES, min_score=0.1).fingerprint()}
    assert len(prints) == len(changes) + 2
    assert SimulatedDetector().fingerprint() == simulated().fingerprint()
    assert not simulated().exact


# Its rates.


@pytest.mark.slow
@given(SEEDS, st.floats(0.05, 1), st.floats(0, 1), st.floats(0, 4))
@settings(max_examples=4, deadline=None)
def test_the_rates_are_those_that_were_asked_for(seed: int, recall: float, cross: float, background: float) -> None:
    detector = simulated(**QUIET | {"recall": recall, "cross_class": cross, "background": background, "seed": seed})
    hits = crossed = regions = possible = 0
    for frame in MANY[:40]:
        for name in NAMES:
            ids = detector.detect(frame, [name]).ids
            own = {a.index for a in frame.annotations if a.label == name}
            objects = {int(i) for i in ids if i < FIRST_REGION_ID}
            hits += len(own & objects)
            crossed += bool(objects - own)
            assert len(objects - own) <= 2
            regions += int((ids >= FIRST_REGION_ID).sum())
        possible += sum(detector._region(frame, k) is not None for k in range(16)) * len(NAMES)
    assert within_binomial(hits, 40 * 20, recall)
    assert within_binomial(crossed, 40 * 5, cross)
    assert within_binomial(regions, possible, background / 16)


def test_the_defaults_are_the_documented_ones() -> None:
    o = SimulationOptions()
    assert (o.recall, o.cross_class, o.corrupted, o.mask_error) == (0.93, 0.35, 0.06, (-2, 3))


def test_masks_err_by_the_pixels_that_were_asked_for() -> None:
    detector = simulated(**QUIET | {"mask_error": (-2, 3)})
    ious = []
    for frame in MANY[:20]:
        found = detector.detect(frame, None)
        assert found.masks is not None
        for i, number in enumerate(found.ids):
            truth = frame.annotations[number].mask
            assert truth is not None
            ious.append((found.masks[i] & truth).sum() / (found.masks[i] | truth).sum())
    kinds = np.unique(np.round(ious, 3), return_counts=True)
    # A disc of radius 18: two pixels less leave about (16 / 18)^2 of it, three more make (21 / 18)^2.
    assert len(kinds[0]) == 6
    assert kinds[0].min() == pytest.approx((18 / 21.3) ** 2, abs=0.05)
    assert kinds[0].max() == 1
    assert all(within_binomial(int(n), len(ious), 1 / 6) for n in kinds[1])


@pytest.mark.slow
def test_boxes_are_shifted_and_scaled_by_their_size() -> None:
    detector = simulated(**QUIET | {"box_jitter": 0.03})
    errors = []
    for frame in MANY:
        found = detector.detect(frame, None)
        errors.append((found.boxes - np.stack([frame.annotations[i].bbox for i in found.ids])) / 37)
    # An edge moves with the shift, and by half of the scale.
    assert np.concatenate(errors).std() == pytest.approx(0.03 * np.sqrt(1.25), rel=0.05)


@pytest.mark.slow
def test_some_masks_are_cut_and_some_leak() -> None:
    cut = leak = n = 0
    detector = simulated(**QUIET | {"truncated": 0.2, "corrupted": 0.3})
    for frame in MANY[:60]:
        found = detector.detect(frame, None)
        assert found.masks is not None
        for i, number in enumerate(found.ids):
            truth = frame.annotations[number].mask
            assert truth is not None
            inside = (found.masks[i] & truth).sum() / truth.sum()
            beyond = (found.masks[i] & ~truth).sum() / truth.sum()
            others = np.any([a.mask for a in frame.annotations if a.index != number and a.mask is not None], axis=0)
            cut += inside < 0.99
            leak += beyond > 0
            assert inside > 0.49
            assert beyond == 0 or beyond > 0.2
            assert not (found.masks[i] & others).any()
            n += 1
    assert within_binomial(leak, n, 0.3)
    # What is cut off may be covered again by a leak.
    assert within_binomial(int(cut), n, 0.2) or 0.2 * 0.7 * n - 5 * np.sqrt(0.2 * n) < cut < 0.2 * n


def test_a_corrupted_mask_corrupts_the_lift() -> None:
    """The wall two metres away comes into the box of what stands in front of it."""
    depth = DEPTH.copy()
    for a in SHELF.annotations:
        assert a.mask is not None
        depth[a.mask] = 1.2
    frame = replace(SHELF, depth=depth)
    sizes = {}
    for share in (0.0, 1.0):
        detector = simulated(**QUIET | {"corrupted": share})
        lifted = PreparedFrame(frame, LiftConfig()).lift(detector.detect(frame, None), detector)
        assert all(o.lifted.box is not None for o in lifted)
        boxes = {o.id: o.lifted.box for o in lifted}
        sizes[share] = np.array([np.linalg.norm(boxes[i].size) for i in sorted(boxes)])  # pyright: ignore
    assert np.median(sizes[1.0] / sizes[0.0]) > 1.3


@pytest.mark.slow
def test_scores_overlap_and_are_no_probabilities() -> None:
    detector = simulated()
    scores: dict[bool, list[float]] = {True: [], False: []}
    for frame in MANY:
        for name in NAMES:
            found = detector.detect(frame, [name])
            for i, number in enumerate(found.ids):
                right = number < FIRST_REGION_ID and frame.annotations[number].label == name
                scores[right].append(float(found.scores[i]))
    right, wrong = np.array(scores[True]), np.array(scores[False])
    better = (right[:, None] > wrong[None, :]).mean()
    assert 0.7 < better < 0.95
    everything = np.concatenate([right, wrong])
    assert len(right) / len(everything) - everything.mean() > 0.15
    assert everything.min() >= 0.01
    assert everything.max() <= 0.99


# Odd input.


def test_annotations_without_masks_make_a_detector_of_boxes() -> None:
    found = simulated(truncated=0.5, background=5).detect(shelf("a", masks=False), None)
    assert found.has_mask is not None
    assert not found.has_mask.any()
    assert (found.ids >= FIRST_REGION_ID).any()
    assert found.masks is not None
    assert found.masks.any(axis=(1, 2)).all()


@given(SEEDS, st.floats(0, 0.5), st.booleans())
@settings(max_examples=25, deadline=None)
def test_every_box_lies_in_the_picture(seed: int, jitter: float, masks: bool) -> None:
    rng = np.random.default_rng(seed)
    low = np.array([[-3, -3], [W - 4, H - 4], [0, 0]]) + rng.uniform(-3, 3, (3, 2))
    boxes = np.concatenate([low, low + rng.uniform(1, 300, (3, 2))], axis=1).astype(np.float32)
    found = []
    for k, box in enumerate(boxes):
        mask = (box[0] < U + 0.5) & (box[2] > U + 0.5) & (box[1] < V + 0.5) & (box[3] > V + 0.5)
        found.append(Annotation(k, NAMES[k], box, mask if masks else None))
    options = {"seed": seed, "recall": 1, "box_jitter": jitter, "truncated": 0.5, "corrupted": 0.5, "background": 8}
    boxes = simulated(**options).detect(replace(SHELF, annotations=tuple(found)), None).boxes
    assert (boxes[:, :2] >= 0).all()
    assert (boxes[:, 2:] <= [W, H]).all()
    assert (boxes[:, 2:] - boxes[:, :2] >= 0.999).all()


def test_background_lies_beside_the_objects() -> None:
    found = simulated(**QUIET | {"recall": 0, "background": 16}).detect(SHELF, ["mug"])
    assert len(found) > 3
    assert iou_2d(found.boxes, np.stack([a.bbox for a in SHELF.annotations])).max() <= 0.3


def test_an_empty_frame_has_only_background() -> None:
    bare = replace(SHELF, annotations=())
    assert (simulated(background=5).detect(bare, None).ids >= FIRST_REGION_ID).all()
    assert len(simulated(background=0, cross_class=1).detect(bare, ["mug"])) == 0


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("recall = 1.5", "wrong at recall"),
        ("recal = 0.5", "wrong at recal.*seed, recall"),
        ("mask_error = [3, -2]", "the smaller first"),
        ("mask_error = [1]", "mask_error"),
        ("background = 17", "background"),
        ("true_logit = nan", "true_logit"),
        ("seed = -1", "seed"),
        ("recall =", "cannot be read"),
    ],
)
def test_hostile_options_are_refused_in_one_line(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "options.toml"
    path.write_text(text)
    with pytest.raises(InputError, match=message) as caught:
        read_options(path)
    assert "\n" not in str(caught.value)


def test_options_come_from_toml_and_json(tmp_path: Path) -> None:
    (tmp_path / "o.toml").write_text("recall = 0.5\nmask_error = [-1, 1]\n")
    (tmp_path / "o.json").write_text('{"recall": 0.5, "mask_error": [-1, 1]}')
    expected = SimulationOptions(recall=0.5, mask_error=(-1, 1))
    assert read_options(tmp_path / "o.toml") == read_options(tmp_path / "o.json") == expected
    made = make_detector("simulated", model=tmp_path / "o.toml", class_names=NAMES)
    assert made.fingerprint() == SimulatedDetector(expected, NAMES).fingerprint()
    with pytest.raises(InputError, match="needs a dataset with annotations"):
        make_detector("simulated")


# Masks.


@given(SEEDS, st.integers(-4, 4), st.floats(0, 6.3), st.floats(0.5, 0.9))
@settings(max_examples=30, deadline=None)
def test_damage_does_what_it_says(seed: int, pixels: int, angle: float, share: float) -> None:
    rng = np.random.default_rng(seed)
    mask = np.zeros((60, 80), np.bool_)
    y, x = rng.integers(0, 50, 2)
    mask[y : y + rng.integers(4, 30), x : x + rng.integers(4, 30)] = True
    crop = surroundings(mask, 5)
    whole = np.zeros_like(mask)
    crop.paint(whole)
    np.testing.assert_array_equal(whole, mask)
    changed = resized(crop.mask, pixels)
    assert (changed >= crop.mask).all() if pixels >= 0 else (changed <= crop.mask).all()
    assert changed.sum() >= 0.25 * crop.mask.sum()
    cut = truncated(crop.mask, angle, share)
    assert (cut <= crop.mask).all()
    # All pixels of a row may lie equally far along the cut.
    assert share * mask.sum() - 1 <= cut.sum() <= share * mask.sum() + 31
    free = rng.random(crop.mask.shape) < 0.5
    leak = leaked(crop.mask, angle, free)
    assert ((leak & ~crop.mask) <= free).all()
    assert (leak >= crop.mask).all()


@pytest.mark.slow
def test_doubted_objects_are_the_same_with_lower_scores() -> None:
    before = simulated(seed=2, **QUIET)
    after = simulated(seed=2, **QUIET, doubted=1, doubted_logit=-6.0)
    some = simulated(seed=2, **QUIET, doubted=0.5, doubted_logit=-6.0)
    fell = total = 0
    for frame in MANY[:40]:
        scores = [
            dict(zip(f.ids.tolist(), f.scores.tolist(), strict=True))
            for f in (d.detect(frame, None) for d in (before, after, some))
        ]
        assert set(scores[0]) == set(scores[1]) == set(scores[2])
        for k in scores[0]:
            assert scores[1][k] < scores[0][k]
            assert scores[2][k] in (scores[0][k], scores[1][k])
            fell += scores[2][k] == scores[1][k]
            total += 1
    assert within_binomial(fell, total, 0.5)
