"""What a frame does not show and others do is not the detector's fault: a crate stands before a mug, says the map."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scenes import camera_of, frame_of, upright

from pipeline.answering import Pipeline, open_pipeline
from pipeline.datasets import InMemoryDataset
from pipeline.diagnosis import shown_verdicts
from pipeline.diagnosis.answer import Answer, answer_record
from pipeline.diagnosis.asking import ask_and_judge, frame_truth, judged
from pipeline.diagnosis.cases.replay import replay_case
from pipeline.diagnosis.cases.saving import open_case, save_case
from pipeline.diagnosis.not_seen import SceneMaps
from pipeline.geometry import Frame
from pipeline.proposals import Proposals
from pipeline.proposals.annotations import AnnotationDetector
from pipeline.scenes.object_map import map_scene

NAMES = ("lamp", "mug", "crate", "box", "spoon", "fork")
BEFORE, AFTER, NEITHER = "s/0", "s/1", "s/2"
LAMP, MUG, CRATE = ((-0.5, 1.0, 2.6), (0.2,) * 3), ((0.1, 1.1, 2.8), (0.2,) * 3), ((0.08, 0.9, 2.0), (0.7, 0.6, 0.2))


class Overlooks(AnnotationDetector):
    """Sees all that is in view but one mug."""

    def detect(self, frame: Frame, labels: Sequence[str] | None) -> Proposals:
        kept = tuple(a for a in frame.annotations if (a.label, frame.id) != ("mug", BEFORE))
        return super().detect(replace(frame, annotations=kept), labels)


def frames() -> list[Frame]:
    """Mug and lamp; the same with a crate before the mug; and a camera that looks elsewhere."""
    camera = replace(camera_of(), T_world_camera=np.eye(4))
    away = np.eye(4)
    away[:3, 3] = 40, 0, 0
    crates = [upright((x, 1.0, 2.6), (0.2,) * 3) for x in (-0.4, 0.4)]
    return [
        frame_of([upright(*LAMP), upright(*MUG)], ["lamp", "mug"], camera=camera, name=BEFORE),
        frame_of([upright(*LAMP), upright(*CRATE)], ["lamp", "crate"], camera=camera, name=AFTER),
        frame_of(crates, ["crate", "box"], camera=replace(camera, T_world_camera=away), name=NEITHER),
    ]


def opened(detector: AnnotationDetector) -> Pipeline:
    return open_pipeline(InMemoryDataset(frames()), detector=detector, srm="rule")


@pytest.fixture(scope="module")
def maps() -> SceneMaps:
    return SceneMaps({"s": map_scene(opened(AnnotationDetector(NAMES)), "s", (BEFORE, AFTER, NEITHER))})


def asked(frame_id: str, text: str, detector: AnnotationDetector | None = None) -> Answer:
    return next(ask_and_judge(opened(detector or AnnotationDetector(NAMES)), frame_id, [text]))


def asked_of_the_scene(text: str) -> Answer:
    """Answer on the frame with the crate, by labels of the scene that say what stands behind it."""
    pipeline = opened(AnnotationDetector(NAMES))
    truth = frame_truth(pipeline, pipeline.prepare(BEFORE))
    assert truth is not None
    context = pipeline.prepare(AFTER)
    return judged(pipeline.ask(context, text), pipeline, context, replace(truth, frame=AFTER))


@pytest.mark.parametrize(
    ("text", "blamed"), [("mug right of the lamp", "OPM-TARGET"), ("lamp left of the mug", "OPM-REF")]
)
def test_what_is_hidden_is_not_missed(maps: SceneMaps, text: str, blamed: str) -> None:
    before = asked_of_the_scene(text)
    assert before.verdict == blamed
    found = maps.answered(before)
    assert (found.verdict, found.diagnosis and found.diagnosis.detail) == ("NOT-SEEN", "HIDDEN")
    assert found.diagnosis is not None
    assert found.diagnosis.unseen is not None
    assert found.story.head == "Mug not in view"
    assert found.story.sentence == f"The correct mug is hidden in this picture; {BEFORE} shows it."
    assert found.story.tone == "wrong"
    record, number = found.record()["verdict"], found.diagnosis.unseen.object
    assert record["unseen"] == {"name": "mug", "object": number, "detail": "HIDDEN", "frames": (BEFORE,)}
    assert "missed" not in record
    assert "bad" not in {stage["mark"] for stage in found.record()["stages"]}
    # What is known of the answer stays as it was.
    assert found.record()["answer"] == before.record()["answer"]


def test_a_case_keeps_what_its_frame_does_not_show(maps: SceneMaps, tmp_path: Path) -> None:
    pipeline = opened(AnnotationDetector(NAMES))
    truth = frame_truth(pipeline, pipeline.prepare(BEFORE))
    assert truth is not None
    with_truth = {"truth": replace(truth, frame=AFTER), "maps": maps}
    kept = save_case(tmp_path / "known", pipeline, pipeline.prepare(AFTER), "mug right of the lamp", **with_truth)
    assert kept.verdict == "NOT-SEEN"
    again = open_case(tmp_path / "known")
    assert again.manifest.unseen is not None
    assert replay_case(again).same
    assert answer_record(again.answer()) == answer_record(kept)
    # And where no truth judges it.
    kept = save_case(tmp_path / "unknown", pipeline, pipeline.prepare(NEITHER), "mug right of the lamp", maps=maps)
    assert kept.unseen is not None
    assert open_case(tmp_path / "unknown").answer().unseen == kept.unseen


def test_what_is_in_view_and_was_overlooked_is_the_detectors_fault(maps: SceneMaps) -> None:
    before = asked(BEFORE, "mug right of the lamp", Overlooks(NAMES))
    assert before.verdict == "OPM-TARGET"
    assert maps.answered(before) == before
    # By its own map, too, which knows of no mug.
    made = map_scene(opened(Overlooks(NAMES)), "s", (BEFORE, AFTER, NEITHER))
    assert maps.answered(before).verdict == SceneMaps({"s": made}).answered(before).verdict == "OPM-TARGET"


def test_a_right_answer_and_a_frame_without_a_map_stay_as_they_are(maps: SceneMaps) -> None:
    right = asked(BEFORE, "mug right of the lamp")
    assert right.verdict == "CORRECT"
    assert maps.answered(right) == right
    wrong = asked_of_the_scene("mug right of the lamp")
    assert SceneMaps({}).answered(wrong) == wrong


def test_without_a_truth_of_the_frame_a_name_decides(maps: SceneMaps) -> None:
    found = maps.answered(asked(NEITHER, "mug right of the lamp"))
    assert (found.verdict, found.diagnosis) == ("NOT-SEEN", None)
    assert found.unseen is not None
    assert (found.unseen.name, found.unseen.detail, found.unseen.frames) == ("mug", "OUT", (BEFORE,))
    assert found.why == f"No mug is in this picture; {BEFORE} shows one."
    assert found.record()["verdict"]["verdict"] == "NOT-SEEN"
    assert "bad" not in {stage["mark"] for stage in found.record()["stages"]}
    # The crate is in view, and no map knows of a spoon.
    assert maps.answered(asked(NEITHER, "crate left of the box")).verdict == "CORRECT"
    unknown = asked(NEITHER, "spoon on the fork")
    assert maps.answered(unknown) == unknown


def test_what_was_found_is_not_denied_where_nothing_is_known_of_the_truth(maps: SceneMaps) -> None:
    own = maps.maps["s"]
    nowhere = replace(own, objects=tuple(replace(o, presence=dict.fromkeys(o.presence, "out")) for o in own.objects))
    found = replace(asked(NEITHER, "crate left of the box"), diagnosis=None)
    assert SceneMaps({"s": nowhere}).answered(found) == found
    assert SceneMaps({"s": nowhere}).answered(replace(found, unjudged="true of nothing")).verdict == "NOT-SEEN"


def test_a_verdict_that_no_map_gave_is_not_listed() -> None:
    assert "NOT-SEEN" not in shown_verdicts(())
    assert "NOT-SEEN" in shown_verdicts(("NOT-SEEN",))
