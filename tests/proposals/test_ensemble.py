"""Fused detectors: weighted boxes as published, and that nothing but what was found decides."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from shelf import NAMES, SHELF, H, W, rows_of

from pipeline.answering import open_pipeline, record_detections
from pipeline.answering.ask import ask
from pipeline.evaluation import EvalSpec, spec_record
from pipeline.evaluation.run_folder import _read_spec
from pipeline.geometry import Frame
from pipeline.proposals import Proposals, SimulatedDetector, SimulationOptions, known_names, name_groups, same_name
from pipeline.proposals.ensemble import EnsembleDetector, _identity, fuse_boxes
from pipeline.system import InputError, UnknownClass, named_model
from pipeline.system.detector_setup import with_model

# Three detectors' boxes (0..1), scores and classes, and what ensemble-boxes 1.0.9 of the paper's authors made of them.
BOXES = [
    [[0.10, 0.10, 0.40, 0.50], [0.55, 0.20, 0.80, 0.60], [0.12, 0.60, 0.30, 0.90]],
    [[0.12, 0.09, 0.42, 0.48], [0.60, 0.22, 0.82, 0.63]],
    [[0.09, 0.12, 0.39, 0.53], [0.11, 0.62, 0.31, 0.88], [0.70, 0.70, 0.90, 0.95]],
]
SCORES = [[0.9, 0.6, 0.35], [0.7, 0.8], [0.5, 0.45, 0.3]]
CLASSES = [[0, 1, 0], [0, 1], [0, 0, 1]]
PUBLISHED_BOXES = [
    [0.10428572, 0.10142857, 0.40428573, 0.50047618],
    [0.57857144, 0.21142857, 0.81142861, 0.61714286],
    [0.11437500, 0.61125004, 0.30562502, 0.88875002],
    [0.70000000, 0.70000000, 0.90000000, 0.95000000],
]
PUBLISHED_SCORES = [0.69999999, 0.46666666, 0.26666667, 0.1]


def flat(parts: list[Any]) -> np.ndarray:
    return np.concatenate([np.array(part) for part in parts])


def test_weighted_boxes_are_those_of_the_authors_library() -> None:
    fused = fuse_boxes(flat(BOXES), flat(SCORES), flat(CLASSES), np.array([3, 3]))
    np.testing.assert_allclose(fused.boxes, PUBLISHED_BOXES, atol=1e-6)
    np.testing.assert_allclose(fused.scores, PUBLISHED_SCORES, atol=1e-6)
    assert fused.classes.tolist() == [0, 1, 0, 1]
    assert [len(m) for m in fused.members] == [3, 2, 2, 1]


@st.composite
def many_boxes(draw: st.DrawFn) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    n = draw(st.integers(0, 14))
    classes = draw(arrays(np.int64, n, elements=st.integers(0, 2)))
    corner = draw(arrays(np.float64, (n, 2), elements=st.floats(0, 40, width=32)))
    side = draw(arrays(np.float64, (n, 2), elements=st.floats(0, 30, width=32)))
    scores = draw(arrays(np.float64, n, elements=st.sampled_from([0.0, 0.1, 0.25, 0.5, 0.9, 1.0])))
    return np.concatenate([corner, corner + side], axis=1), scores, classes


@given(many_boxes(), st.integers(1, 4), st.randoms(use_true_random=False))
@settings(max_examples=25)
def test_fused_boxes_lie_in_the_hull_of_their_members(found: Any, detectors: int, random: Any) -> None:
    boxes, scores, classes = found
    could = np.full(3, detectors)
    fused = fuse_boxes(boxes, scores, classes, could)
    assert sorted(np.concatenate([np.zeros(0, np.int64), *fused.members]).tolist()) == list(range(len(boxes)))
    for box, score, kind, members in zip(fused.boxes, fused.scores, fused.classes, fused.members, strict=True):
        assert (box >= boxes[members].min(axis=0)).all()
        assert (box <= boxes[members].max(axis=0)).all()
        assert set(classes[members]) == {kind}
        assert 0 <= score <= scores[members].max() + 1e-12
    order = list(range(len(boxes)))
    random.shuffle(order)
    again = fuse_boxes(boxes[order], scores[order], classes[order], could)
    np.testing.assert_array_equal(again.scores, fused.scores)
    # Equal boxes with equal scores may change places, whatever their classes.
    one, other = (f.boxes[np.lexsort((f.classes, *f.boxes.T))] for f in (again, fused))
    np.testing.assert_array_equal(one, other)


# The detector.


def simulated(seed: int, names: tuple[str, ...] = NAMES, **options: Any) -> SimulatedDetector:
    return SimulatedDetector(SimulationOptions(seed=seed, **options), names)


class BoxesOnly:
    """A detector that gives what it is told to, without masks."""

    name = "boxes"
    exact = False
    reads_annotations = False

    def __init__(self, rows: list[tuple[str, float, list[float]]], vocabulary: tuple[str, ...] | None = None) -> None:
        self.rows = rows
        self.vocabulary = vocabulary

    def fingerprint(self) -> str:
        return f"boxes:{self.rows}"

    def detect(self, frame: Frame, labels: Any) -> Proposals:
        rows = [r for r in self.rows if labels is None or any(same_name(r[0], label) for label in labels)]
        names = tuple(dict.fromkeys(r[0] for r in rows))
        return Proposals(
            np.array([r[2] for r in rows], np.float32).reshape(-1, 4),
            np.array([r[1] for r in rows], np.float32),
            np.array([names.index(r[0]) for r in rows], np.int64),
            names,
            None,
            np.full(len(rows), -1, np.int64),
        )


@pytest.mark.parametrize("fusion", ["wbf", "nms"])
@pytest.mark.parametrize("labels", [None, ["mug"], ["mug", "book", "lamp"]])
def test_the_order_of_the_members_does_not_matter(fusion: str, labels: list[str] | None) -> None:
    one, two, three = simulated(1), simulated(2), simulated(3)
    found = EnsembleDetector((one, two, three), fusion).detect(SHELF, labels)
    again = EnsembleDetector((three, one, two), fusion).detect(SHELF, labels)
    assert len(found)
    assert sorted(rows_of(found)) == sorted(rows_of(again))
    assert EnsembleDetector((one, two), fusion).fingerprint() == EnsembleDetector((two, one), fusion).fingerprint()
    assert EnsembleDetector((one, two), "nms").fingerprint() != EnsembleDetector((one, two), "wbf").fingerprint()


def test_a_detector_fused_with_itself_finds_what_it_found() -> None:
    own = simulated(7, background=0, cross_class=0)
    found, fused = own.detect(SHELF, ["mug"]), EnsembleDetector((own, own)).detect(SHELF, ["mug"])
    assert len(found) == len(fused) > 0
    np.testing.assert_allclose(np.sort(fused.scores), np.sort(found.scores), atol=1e-6)
    np.testing.assert_allclose(fused.boxes, found.boxes[np.argsort(-found.scores)], atol=1e-3)
    assert fused.masks is not None
    assert found.masks is not None
    assert {m.tobytes() for m in fused.masks} == {m.tobytes() for m in found.masks}


def test_what_one_of_two_found_loses_half_its_score_unless_the_other_cannot_know_it() -> None:
    mug = ("mug", 0.8, [10.0, 10.0, 50.0, 60.0])
    blind = BoxesOnly([], ("mug", "lamp"))
    assert EnsembleDetector((BoxesOnly([mug]), blind)).detect(SHELF, ["mug"]).scores.tolist() == pytest.approx([0.4])
    other = BoxesOnly([], ("lamp",))
    assert EnsembleDetector((BoxesOnly([mug]), other)).detect(SHELF, ["mug"]).scores.tolist() == pytest.approx([0.8])
    assert EnsembleDetector((BoxesOnly([mug]), other)).detect(SHELF, None).scores.tolist() == pytest.approx([0.8])
    assert EnsembleDetector((BoxesOnly([mug]), blind)).detect(SHELF, None).scores.tolist() == pytest.approx([0.4])


def test_the_mask_is_the_best_members_that_has_one() -> None:
    disc = SHELF.annotations[0]
    box = [float(v) for v in disc.bbox]
    exact = simulated(
        0, recall=1, cross_class=0, background=0, box_jitter=0, mask_error=(0, 0), truncated=0, corrupted=0
    )
    fused = EnsembleDetector((BoxesOnly([("mug", 0.99, box), ("mug", 0.9, [300.0, 200.0, 318.0, 238.0])]), exact))
    found = fused.detect(SHELF, ["mug"])
    assert found.masks is not None
    assert found.has_mask is not None
    assert disc.mask is not None
    at = int(np.abs(found.boxes - disc.bbox).sum(axis=1).argmin())
    np.testing.assert_array_equal(found.masks[at], disc.mask)
    alone = int(np.abs(found.boxes - [300, 200, 318, 238]).sum(axis=1).argmin())
    assert not found.has_mask[alone]
    assert found.has_mask.sum() == len(found) - 1
    assert EnsembleDetector((BoxesOnly([("mug", 0.9, box)]), BoxesOnly([]))).detect(SHELF, ["mug"]).masks is None


def test_equal_numbers_mean_equal_detections() -> None:
    fused = EnsembleDetector((simulated(1), simulated(2)))
    seen: dict[int, tuple[bytes, bytes]] = {}
    for labels in (None, *([name] for name in NAMES)):
        found = fused.detect(SHELF, labels)
        assert found.masks is not None
        assert len(set(found.ids.tolist())) == len(found)
        for i in range(len(found)):
            looks = (found.boxes[i].tobytes(), found.masks[i].tobytes())
            assert seen.setdefault(int(found.ids[i]), looks) == looks


def test_another_mask_in_the_same_box_is_another_detection() -> None:
    box, mask = np.array([10, 10, 50, 60], np.float32), SHELF.annotations[0].mask
    assert mask is not None
    numbers = [_identity(box, mask), _identity(box, ~mask), _identity(box, None), _identity(box + 1, mask)]
    assert len(set(numbers)) == 4
    assert _identity(box.copy(), mask.copy()) == numbers[0]
    assert all(0 <= number < 2**53 for number in numbers)


def test_names_of_one_class_are_fused_and_others_are_not() -> None:
    box = [10.0, 10.0, 50.0, 60.0]
    one, two = BoxesOnly([("trash can", 0.8, box)]), BoxesOnly([("bin", 0.6, box), ("cup", 0.5, box)])
    found = EnsembleDetector((one, two)).detect(SHELF, None)
    assert [found.label(i) for i in range(len(found))] == ["trash can", "cup"]
    assert found.scores.tolist() == pytest.approx([0.7, 0.25])
    assert name_groups(["cracker box", "box", "mug"]) == name_groups(["mug", "box", "cracker box"])
    assert name_groups(["cracker box", "box"])["cracker box"] == "box"


def test_what_no_member_knows_is_unknown() -> None:
    fused = EnsembleDetector((simulated(1), simulated(2)))
    with pytest.raises(UnknownClass, match="none of the detectors"):
        fused.detect(SHELF, ["zebra"])
    assert fused.vocabulary == tuple(sorted(NAMES))
    mixed = EnsembleDetector((simulated(1), BoxesOnly([])))
    assert mixed.vocabulary is None
    assert len(mixed.detect(SHELF, ["zebra"])) == 0
    assert known_names(mixed) is None


def test_nothing_found_is_nothing() -> None:
    found = EnsembleDetector((BoxesOnly([]), BoxesOnly([]))).detect(SHELF, ["mug"])
    assert len(found) == 0
    assert found.masks is not None
    assert found.masks.shape == (0, H, W)


def test_boxes_without_area_or_score_do_no_harm() -> None:
    dot, line = ("mug", 0.0, [5.0, 5.0, 5.0, 5.0]), ("mug", 0.0, [0.0, 0.0, 40.0, 0.0])
    box = ("mug", 0.0, [10.0, 10.0, 50.0, 60.0])
    for fusion in ("wbf", "nms"):
        found = EnsembleDetector((BoxesOnly([dot, line, box]), BoxesOnly([box, dot])), fusion).detect(SHELF, ["mug"])
        assert np.isfinite(found.boxes).all()
        assert found.scores.tolist() == [0.0] * len(found)


@pytest.mark.parametrize("members", [0, 1])
def test_one_detector_cannot_be_fused(members: int) -> None:
    with pytest.raises(InputError, match="at least two detectors"):
        EnsembleDetector([simulated(1)] * members)


def test_an_unknown_fusion_is_refused() -> None:
    with pytest.raises(InputError, match="no fusion 'mean'; expected wbf or nms"):
        EnsembleDetector((simulated(1), simulated(2)), "mean")


# In the jobs.


def test_a_question_is_answered_by_fused_detectors() -> None:
    trace = ask(SHELF, "mug left of the laptop", EnsembleDetector((simulated(1), simulated(2))), class_names=NAMES)
    assert trace.ranking is not None
    assert trace.detector == "simulated&simulated"
    assert not trace.exact


def test_fused_detectors_are_opened_recorded_and_played_back(tmp_path: Path) -> None:
    (tmp_path / "other.toml").write_text("seed = 5\n")
    other = f"simulated={tmp_path / 'other.toml'}"
    source = open_pipeline("demo", detector="simulated", fuse=(other,), srm="rule", min_score=0.1)
    assert isinstance(source.detector, EnsembleDetector)
    assert [m.options.seed for m in source.detector.members if isinstance(m, SimulatedDetector)] == [0, 5]
    unfiltered = source.unfiltered_detector()
    frame_id = source.dataset.frame_ids[0]
    frame = source.dataset.load(frame_id)
    assert len(unfiltered.detect(frame, None)) > len(source.detector.detect(frame, None))
    out = tmp_path / "fused.json"
    record_detections(source, out, ("mug", "book"), frame_ids=[frame_id])
    played = open_pipeline("demo", detector="recorded", model=out, srm="rule").needed_detector().detect(frame, ["mug"])
    fused = source.detector.detect(frame, ["mug"])
    np.testing.assert_allclose(np.sort(played.scores), np.sort(fused.scores)[-len(played) :], atol=1e-4)


def test_a_run_remembers_what_was_fused(tmp_path: Path) -> None:
    model = tmp_path / "models" / "b.onnx"
    options = {"detector": "simulated", "fuse": (f"yolo-seg={model}", "simulated")}
    spec = EvalSpec("demo", str(tmp_path / "labels"), options)
    record = spec_record(spec, tmp_path / "run")
    assert record["options"]["fuse"] == ["yolo-seg=../models/b.onnx", "simulated"]
    moved = tmp_path / "elsewhere" / "run"
    assert _read_spec(record, moved).options["fuse"] == [f"yolo-seg={moved.parent / 'models' / 'b.onnx'}", "simulated"]


@pytest.mark.parametrize("text", ["", "=", "=x.onnx", "yolo-seg=", "  =a"])
def test_a_further_detector_needs_a_name_and_a_model(text: str) -> None:
    with pytest.raises(InputError, match="a further detector needs a name"):
        named_model(text)


def test_models_are_named_with_their_detector() -> None:
    assert named_model("recorded=C:\\a=b.json") == ("recorded", Path("C:\\a=b.json"))
    assert with_model("simulated", lambda path: "never") == "simulated"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"fuse": ("simulated",)}, "--fuse needs --detector"),
        ({"detector": "simulated", "fuse": ("nonsense",)}, "there is no detector 'nonsense'"),
        ({"detector": "simulated", "fuse": ("recorded",)}, "needs --model"),
        ({"detector": "simulated", "fuse": ("simulated",), "fusion": "mean"}, "no fusion 'mean'"),
    ],
)
def test_detectors_that_cannot_be_fused_say_why(options: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        open_pipeline("demo", srm="rule", **options)


def test_masks_of_other_frames_keep_their_size() -> None:
    small = replace(SHELF, id="scene/1")
    found = EnsembleDetector((simulated(1), simulated(2))).detect(small, None)
    assert found.masks is not None
    assert found.masks.shape[1:] == (H, W)
