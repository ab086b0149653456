"""Questions from text to answer: right on real and on constructed frames, honest where there is no answer."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dataset_writers import write_bop
from expression_checks import expression_of
from scenes import frame_of, upright

from pipeline.answering import (
    AskConfig,
    Pipeline,
    PreparedFrame,
    SceneObject,
    all_objects,
    contexts,
    frame_range,
    open_pipeline,
    open_sources,
    relate_frames,
    same_object,
)
from pipeline.answering.ask import ask
from pipeline.datasets import DEMO_EXPRESSION, demo_path, open_dataset
from pipeline.diagnosis import suggest_expressions
from pipeline.geometry import Frame
from pipeline.language import VOCABULARIES, match
from pipeline.proposals import AnnotationDetector, Proposals, make_detector
from pipeline.system import InputError

KNOWN = ("mug", "laptop", "book", "lamp", "table", "box")


@pytest.fixture(autouse=True)
def _own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SPATIALVIZ_CACHE", str(tmp_path / "cache"))


@pytest.fixture(scope="module")
def row() -> Frame:
    """From left to right on a table: mug 0, book 1, mug 2, laptop 3, mug 4."""
    things = [upright((x, 0.5, 1.5), (0.14, 0.16, 0.14)) for x in (-0.6, -0.3, 0.0, 0.3, 0.6)]
    table = upright((0, 0.63, 1.5), (1.6, 0.1, 0.6))
    return frame_of([*things, table], ["mug", "book", "mug", "laptop", "mug", "table"], pitch=25)


@pytest.fixture(scope="module")
def truth() -> AnnotationDetector:
    return AnnotationDetector(KNOWN)


def answer(
    frame: Frame | PreparedFrame, text: str, detector: AnnotationDetector, **more: Any
) -> tuple[int, int, float]:
    """(annotation that is the target, annotation that is the reference, p_relation)"""
    trace = ask(frame, text, detector, **more)
    assert trace.ranking is not None
    best = trace.ranking.pairs[0]
    assert best.reference is not None
    return trace.objects[best.target].id, trace.objects[best.reference].id, best.p_relation


@pytest.mark.parametrize(
    ("text", "targets"),
    [
        ("mug right of the laptop", {4}),
        ("the book to the left of the laptop", {1}),
        ("mug closest to the laptop", {2, 4}),
        ("mug farthest from the laptop", {0}),
        ("mug between the book and the laptop", {2}),
        ("book on the table", {1}),
        ("mug left of the book", {0}),
        ("mug left of the laptop and right of the book", {2}),
        ("mug right of the book left of the laptop", {2, 4}),
        ("table with a laptop on top", {5}),
        ("table under the laptop", {5}),
    ],
)
def test_expressions_of_a_known_row_are_answered_rightly(
    row: Frame, truth: AnnotationDetector, text: str, targets: set[int]
) -> None:
    target, _, p = answer(row, text, truth)
    assert target in targets
    assert p >= 0.5


def test_a_wrong_expression_gets_its_answer_at_a_low_probability(row: Frame, truth: AnnotationDetector) -> None:
    assert answer(row, "laptop left of the book", truth)[2] == 0.05


def test_between_names_both_ends(row: Frame, truth: AnnotationDetector) -> None:
    trace = ask(row, "mug between the book and the laptop", truth)
    assert trace.ranking is not None
    best = trace.ranking.pairs[0]
    assert best.second_reference is not None
    assert best.reference is not None
    ids = [trace.objects[k].id for k in (best.target, best.reference, best.second_reference)]
    assert ids == [2, 1, 3]
    assert best.p_relation == 0.95


def test_an_inverse_phrase_asks_for_the_other_direction(row: Frame, truth: AnnotationDetector) -> None:
    target, reference, p = answer(row, "table holding a laptop", truth)
    assert (target, reference) == (5, 3)
    straight = answer(row, "laptop on the table", truth)
    assert straight == (3, 5, p)


def test_a_vocabulary_without_on_asks_for_above(row: Frame, truth: AnnotationDetector) -> None:
    config = AskConfig(relations=VOCABULARIES["avd"])
    trace = ask(row, "laptop on the table", truth, config=config)
    assert trace.query.expression is not None
    assert trace.query.expression.mapped_from == "on"
    assert trace.ranking is not None
    assert trace.ranking.pairs[0].links[0].relation == "above"


def test_each_detection_stands_once_among_the_objects(row: Frame, truth: AnnotationDetector) -> None:
    trace = ask(row, "mug left of a mug", truth)
    assert [o.id for o in trace.objects] == [0, 2, 4]
    assert trace.ranking is not None
    pairs = {(p.target, p.reference) for p in trace.ranking.pairs}
    assert pairs == {(a, b) for a in range(3) for b in range(3) if a != b}


def test_a_context_lifts_an_object_once(row: Frame, truth: AnnotationDetector) -> None:
    context = PreparedFrame(row)
    first, second = ask(context, "mug left of the laptop", truth), ask(context, "laptop right of the mug", truth)
    lifted = {o.id: o.lifted for o in first.objects}
    assert all(lifted[o.id] is o.lifted for o in second.objects)
    assert second.timings["frame"] == first.timings["frame"] == context.seconds


def test_a_context_and_a_frame_give_the_same_answer(row: Frame, truth: AnnotationDetector) -> None:
    text = "mug right of the laptop"
    assert answer(row, text, truth) == answer(PreparedFrame(row), text, truth)


def test_the_timings_of_all_stages_are_there(row: Frame, truth: AnnotationDetector) -> None:
    trace = ask(row, "mug left of the laptop", truth)
    assert set(trace.timings) == {"parse", "frame", "opm", "lift", "srm", "prm"}
    assert all(seconds >= 0 for seconds in trace.timings.values())
    assert set(ask(row, "mug left of the lamp", truth).timings) == {"parse", "frame", "opm", "lift", "srm"}


def test_a_class_that_is_not_in_the_frame_is_missing(row: Frame, truth: AnnotationDetector) -> None:
    trace = ask(row, "lamp left of the mug", truth)
    assert trace.ranking is None
    assert trace.missing == ("lamp",)
    assert ask(row, "lamp left of the box", truth).missing == ("lamp", "box")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("mugg left of the laptop", "does not know the class 'mugg'.*'mug'"),
        ("mug left of", "reference is missing"),
        ("", "empty"),
    ],
)
def test_what_cannot_be_asked_is_refused(row: Frame, truth: AnnotationDetector, text: str, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        ask(row, text, truth)
    assert "\n" not in str(caught.value)


def test_one_object_for_both_names_is_no_pair(row: Frame, truth: AnnotationDetector) -> None:
    trace = ask(row, "laptop left of the laptop", truth)
    assert trace.ranking is not None
    assert trace.ranking.degenerate


def test_objects_without_depth_are_in_doubt_and_never_fail(row: Frame, truth: AnnotationDetector) -> None:
    depth = row.depth.copy()
    mask = row.annotations[3].mask
    assert mask is not None
    depth[mask] = 0
    blind = Frame(row.id, row.rgb, depth, row.camera, row.annotations)
    trace = ask(blind, "book left of the laptop", truth)
    assert trace.ranking is not None
    assert trace.ranking.pairs[0].p_relation == 0.5
    for text in ("mug closest to the laptop", "mug between the book and the laptop", "laptop on the table"):
        assert ask(blind, text, truth).ranking is not None


def test_the_best_k_of_a_detector_go_on_and_of_the_truth_all(row: Frame, truth: AnnotationDetector) -> None:
    class Guess:
        name, exact, vocabulary = "guess", False, None

        def fingerprint(self) -> str:
            return "guess"

        def detect(self, frame: Frame, labels: Any) -> Proposals:
            return truth.detect(frame, labels)

    assert len(ask(row, "mug left of the laptop", Guess(), config=AskConfig(k=2)).candidates["mug"].index) == 2
    assert len(ask(row, "mug left of the laptop", truth, config=AskConfig(k=2)).candidates["mug"].index) == 3


def scene_object(number: int, x0: int, x1: int, row: Frame, height: int = 100) -> SceneObject:
    mask = np.zeros(row.depth.shape, bool)
    mask[50 : 50 + height, x0:x1] = True
    lifted = PreparedFrame(row).lift(
        AnnotationDetector().detect(row, ["mug"]).take(np.array([0])), AnnotationDetector()
    )
    return SceneObject(number, "x", 0.5, np.array([x0, 50, x1, 50 + height], np.float32), mask, lifted[0].lifted)


def test_two_detections_of_one_thing_are_known_as_the_same(row: Frame) -> None:
    objects = [
        scene_object(0, 10, 110, row),
        scene_object(1, 15, 115, row),  # IoU 0.90 with the first
        scene_object(2, 40, 140, row),  # mask IoU 0.54 with the first
        scene_object(3, 50, 150, row),  # 0.43 with the first, 0.82 with the third
        scene_object(4, 200, 300, row),
        scene_object(4, 10, 20, row),  # the same number
        scene_object(-1, 150, 190, row, 40),
        scene_object(-1, 160, 165, row, 5),  # no number: nothing is known
    ]
    same = same_object(objects, exact=False)
    np.testing.assert_array_equal(same, same.T)
    assert same[0].tolist() == [True, True, True, False, False, False, False, False]
    assert same[2, 3]
    assert same[4, 5]
    assert not same[6, 7]
    assert same_object(objects, exact=True).sum() == len(objects) + 2
    assert same_object([], exact=False).shape == (0, 0)


# Real frames: the ground-truth poses decide what is right.


def ycb_pairs(root: Path) -> list[tuple[str, str, str]]:
    """(frame, left object, right object) where the poses leave no doubt."""
    found = []
    dataset = open_dataset(root)
    for frame_id in dataset.frame_ids:
        context = PreparedFrame(dataset.load(frame_id))
        scene, image = frame_id.split("/")
        poses = json.loads((root / scene / "scene_gt.json").read_text())[str(int(image))]
        right, _, forward = (np.array([p["cam_t_m2c"] for p in poses]) / 1000 @ context.viewer.matrix.T).T
        labels = [a.label for a in context.frame.annotations]
        for a, first in enumerate(labels):
            for b, second in enumerate(labels):
                aside = right[b] - right[a]
                if aside > 0.12 and aside > 1.5 * abs(forward[b] - forward[a]):
                    found.append((frame_id, first, second))
    return found


@pytest.mark.slow
def test_clear_pairs_of_real_frames_are_told_left_and_right(shared_data: Path) -> None:
    root = shared_data / "real" / "ycbv-bop"
    dataset = open_dataset(root)
    detector = AnnotationDetector(dataset.class_names)
    pairs = ycb_pairs(root)
    assert len(pairs) >= 10
    found = {f: PreparedFrame(dataset.load(f)) for f in {p[0] for p in pairs}}
    for frame_id, left, right in pairs:
        for text, holds in (
            (f"{left} left of the {right}", True),
            (f"{right} right of the {left}", True),
            (f"{left} right of the {right}", False),
            (f"{right} left of the {left}", False),
        ):
            trace = ask(found[frame_id], text, detector, class_names=dataset.class_names)
            assert trace.ranking is not None
            assert (trace.ranking.pairs[0].p_relation >= 0.5) == holds, (frame_id, text)


def test_nearer_and_farther_on_real_frames(shared_data: Path) -> None:
    dataset = open_dataset(shared_data / "real" / "ycbv-bop")
    detector = AnnotationDetector(dataset.class_names)
    # By eye: the marker lies in front, the bottle at the back; can, box and bottle stand in depth on the right.
    for frame_id in ("000002/000001", "000002/000020"):
        context = PreparedFrame(dataset.load(frame_id))
        for text, expected in (
            ("large marker in front of the mustard bottle", 0.95),
            ("mustard bottle behind the large marker", 0.95),
            ("mustard bottle in front of the large marker", 0.05),
            ("potted meat can above the banana", 0.05),
        ):
            trace = ask(context, text, detector, class_names=dataset.class_names)
            assert trace.ranking is not None
            assert trace.ranking.pairs[0].p_relation == expected, (frame_id, text)


def test_a_network_answers_on_a_real_frame(shared_data: Path) -> None:
    dataset = open_dataset(shared_data / "real" / "7scenes-redkitchen")
    detector = make_detector("yolo-seg", model=shared_data / "onnx" / "yolov8n_seg_480x640.onnx")
    trace = ask(dataset.load("frame-000540"), "cup on the dining table", detector)
    assert trace.ranking is not None
    best = trace.ranking.pairs[0]
    assert trace.objects[best.target].label == "cup"
    assert best.p_relation >= 0.5
    assert trace.frame.camera.up_source == "plane"
    places = [o.id for o in trace.objects]
    assert len(places) == len(set(places))


# The demo, and the jobs of the command line.


def test_the_demo_answers_its_own_question() -> None:
    source = open_pipeline("demo")
    trace = source.ask(source.prepare(0), DEMO_EXPRESSION)
    assert trace.ranking is not None
    assert trace.ranking.pairs[0].p_relation > 0.9
    assert trace.scorer == "rel32"
    assert demo_path().is_dir()


def test_suggested_expressions_have_exactly_one_right_answer() -> None:
    source = open_pipeline("demo")
    detector = source.needed_detector()
    asked = 0
    for context in islice(contexts(source, "all"), 0, None, 3):
        objects = all_objects(context, detector)
        scores = source.score(context, objects)
        texts = suggest_expressions(objects, scores, context.viewer, 3)
        assert len(texts) == len(set(texts)) <= 3
        for text in texts:
            trace = ask(context, text, detector, class_names=source.dataset.class_names)
            assert trace.ranking is not None
            right = [p for p in trace.ranking.pairs if p.p_relation >= 0.5]
            assert len(right) == 1, text
            asked += 1
        assert suggest_expressions([], scores, context.viewer) == ()
        # No example rests on an up that is only assumed.
        assert suggest_expressions(objects, scores, replace(context.viewer, up_source="assumed")) == ()
    assert asked >= 3


def test_suggestions_are_words_even_where_class_names_are_not() -> None:
    source = open_pipeline("demo")
    (context,) = contexts(source, 0)
    objects = all_objects(context, source.needed_detector())
    scores = source.score(context, objects)
    expected = suggest_expressions(objects, scores, context.viewer, 5)
    assert any("potted plant" in text for text in expected)
    raw = [replace(o, label=o.label.replace(" ", "_")) for o in objects]
    names = tuple(dict.fromkeys(o.label for o in raw))
    assert suggest_expressions(raw, scores, context.viewer, 5) == expected
    for text in expected:
        said = expression_of(text, class_names=names)
        assert len(match(said.target, names)) == len(match(said.reference or "", names)) == 1
    # A name that no words can stand for is said as it is spelled, or not at all.
    odd = [replace(o, label=f"{o.label} on the wall (3)") for o in objects]
    for text in suggest_expressions(odd, scores, context.viewer, 5):
        assert expression_of(text, class_names=tuple(o.label for o in odd)).target in {o.label for o in odd}


@pytest.fixture
def broken(tmp_path: Path) -> Pipeline:
    """Two frames, of which one has no depth file."""
    write_bop(tmp_path / "set", {"000001": [0, 1]})
    (tmp_path / "set" / "000001" / "depth" / "000000.png").unlink()
    return open_pipeline(tmp_path / "set")


def test_a_broken_frame_is_skipped_among_all_and_an_error_by_name(broken: Pipeline) -> None:
    skipped: list[tuple[str, str]] = []
    done = list(relate_frames(broken, "all", lambda frame, why: skipped.append((frame, why))))
    assert [d.frame_id for d in done] == ["000001/000001"]
    assert [frame for frame, _ in skipped] == ["000001/000000"]
    assert skipped[0][1]
    with pytest.raises(InputError):
        list(relate_frames(broken, "000001/000000"))


def test_a_frame_is_named_by_id_index_or_all(broken: Pipeline) -> None:
    every = ("000001/000000", "000001/000001")
    assert frame_range(broken.dataset, "all") == frame_range(broken.dataset, None) == every
    assert frame_range(broken.dataset, 1) == frame_range(broken.dataset, "1") == every[1:]
    assert frame_range(broken.dataset, every[0]) == every[:1]
    with pytest.raises(InputError):
        frame_range(broken.dataset, "000009/000000")


def test_a_dataset_without_annotations_needs_a_detector(shared_data: Path) -> None:
    source = open_pipeline(shared_data / "real" / "7scenes-redkitchen")
    with pytest.raises(InputError, match=r"no detector was named.*--detector"):
        source.ask(source.prepare(0), "cup on the table")


def test_a_model_without_its_kind_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="--model needs --detector"):
        open_pipeline("demo", model=tmp_path / "x.onnx")


def test_a_folder_of_datasets_opens_what_can_be_opened(shared_data: Path, tmp_path: Path) -> None:
    sources, left_out = open_sources(shared_data / "real")
    assert {"7scenes-redkitchen", "ycbv-bop"} <= set(sources)
    assert "--intrinsics" in left_out["slambook-diningroom"]
    assert not set(sources) & set(left_out)
    single, none = open_sources(shared_data / "real" / "ycbv-bop")
    assert list(single) == ["ycbv-bop"]
    assert none == {}
    (tmp_path / "empty").mkdir()
    for bad in (tmp_path, tmp_path / "empty", tmp_path / "absent"):
        with pytest.raises(InputError):
            open_sources(bad)


# Pictures.


def test_what_a_detector_lists_of_a_frame_is_asked_for_once(monkeypatch: pytest.MonkeyPatch) -> None:
    source, asked = open_pipeline("demo", detector="simulated"), list[object]()
    detector = source.needed_detector()
    detect = type(detector).detect

    def counted(own: Any, frame: Frame, labels: Any) -> Proposals:
        asked.append(labels)
        return detect(own, frame, labels)

    monkeypatch.setattr(type(detector), "detect", counted)
    context = source.prepare(0)
    traces = [source.ask(context, DEMO_EXPRESSION), source.ask(context, "book near the lamp")]
    assert asked.count(None) == 1
    objects = all_objects(context, detector)
    assert traces[0].numbers == traces[1].numbers == {o.id: place for place, o in enumerate(objects)}
    fresh = source.prepare(0)
    all_objects(fresh, detector)
    asked.clear()
    assert source.ask(fresh, DEMO_EXPRESSION).numbers == traces[0].numbers
    assert None not in asked
