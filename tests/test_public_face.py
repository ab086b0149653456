"""The public face of the core: what it names, what it costs to import, what it answers, and how it prints."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from waiting import LONG_S

import pipeline
from pipeline.datasets import demo_labels, demo_run
from pipeline.geometry import Frame
from pipeline.relations import RuleScorer
from pipeline.system.lazy_exports import declared

ROOT = Path(__file__).resolve().parent.parent
QUESTION = "mug left of the laptop"


@pytest.fixture(scope="module")
def opened() -> pipeline.Opened:
    return pipeline.open("demo", srm="rule")


def test_each_public_name_is_loaded_from_where_its_declaration_says() -> None:
    module_of = declared(str(ROOT / "pipeline" / "__init__.py"))
    assert pipeline.__version__ in (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert set(module_of) == set(pipeline.__all__)
    for name in pipeline.__all__:
        assert getattr(pipeline, name).__module__.startswith("pipeline."), name
    with pytest.raises(AttributeError, match="no attribute 'opn'"):
        _ = pipeline.opn  # pyright: ignore[reportAttributeAccessIssue]


def test_importing_the_core_loads_nothing_but_the_standard_library() -> None:
    code = "import json, sys; import pipeline; dir(pipeline); print(json.dumps(sorted(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=LONG_S)
    ours = {name for name in json.loads(done.stdout) if name.split(".")[0] in ("pipeline", "numpy", "pydantic", "cv2")}
    assert ours == {"pipeline", "pipeline.system", "pipeline.system.lazy_exports", "pipeline.system.version"}


def test_the_library_that_runs_networks_keeps_no_report_for_its_maker(tmp_path: Path) -> None:
    """ONNX Runtime would keep an id of the machine and its use in the user's cache, and send them."""
    code = "import pipeline; pipeline.ask('demo', 0, 'mug left of the laptop')"
    own = {"XDG_CACHE_HOME": str(tmp_path), "HOME": str(tmp_path), "SPATIALVIZ_CACHE": str(tmp_path / "spatialviz")}
    environment = {name: value for name, value in os.environ.items() if name != "ORT_DISABLE_TELEMETRY"} | own
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, env=environment, check=True, timeout=LONG_S)
    assert {path.name for path in tmp_path.iterdir()} <= {"spatialviz"}


def test_an_answer_is_its_objects_its_figures_and_its_verdict(opened: pipeline.Opened) -> None:
    answer = opened.ask(0, QUESTION)
    assert answer.target is not None
    assert answer.reference is not None
    assert answer.target.box is answer.target.lifted.box is not None
    assert (answer.target.label, answer.reference.label, answer.holds) == ("mug", "laptop", True)
    best = answer.pairs[0]
    assert (answer.objects[best.target], answer.relation_probability) == (answer.target, best.relation_probability)
    assert answer.verdict == "CORRECT"
    record = answer.record()
    assert record["answer"]["target"]["label"] == "mug"
    assert record["verdict"]["verdict"] == answer.verdict


def test_a_frame_is_named_by_number_or_id_or_is_at_hand(opened: pipeline.Opened) -> None:
    frame = opened.frames[0]
    answers = [opened.ask(key, QUESTION) for key in (0, frame.id, frame)]
    assert {a.sentence for a in answers} == {answers[0].sentence}
    assert {a.verdict for a in answers} == {"CORRECT"}
    assert pipeline.ask(opened, frame.id, QUESTION).sentence == answers[0].sentence


def test_without_truth_there_is_no_verdict_and_the_answer_stands(opened: pipeline.Opened) -> None:
    frame = opened.frames[0]
    bare = Frame(frame.id, frame.rgb, frame.depth, frame.camera)

    class Kept:
        name, vocabulary, exact = "kept", None, True

        def fingerprint(self) -> str:
            return "kept"

        def detect(self, frame: pipeline.Frame, labels: object) -> pipeline.Proposals:
            return opened.pipeline.needed_detector().detect(opened.frames[0], labels)  # pyright: ignore

    answer = pipeline.ask(bare, 0, QUESTION, detector=Kept(), srm="rule")
    assert answer.holds
    assert (answer.verdict, answer.why) == (None, None)


def test_labels_that_are_named_give_the_verdict() -> None:
    opened = pipeline.open("demo", labels=demo_labels(), srm="rule")
    text = opened.labels.expressions.column("text")[0].as_py()  # pyright: ignore[reportOptionalMemberAccess]
    answer = opened.ask(0, text)
    assert answer.diagnosis is not None
    assert answer.diagnosis.case.id == opened.labels.expressions.column("id")[0].as_py()  # pyright: ignore


def test_a_name_that_is_not_there_gives_no_target_and_says_why(opened: pipeline.Opened) -> None:
    found = {a.label for a in opened.frames[0].annotations}
    missing = next(name for name in opened.pipeline.dataset.class_names if name not in found)
    answer = opened.ask(0, f"{missing} left of the laptop")
    assert (answer.target, answer.reference, answer.pairs, answer.relation_probability) == (None, None, (), None)
    assert not answer.holds
    assert f"no {missing!r} found" in answer.sentence


def test_what_if_answers_again_under_edits(opened: pipeline.Opened) -> None:
    before = opened.ask(0, QUESTION)
    assert before.target is not None
    edits = {"format": "spatialviz-edits-1", "hidden": [f"#{before.target.id}"]}
    after = before.what_if(edits)
    assert after.target is not None
    assert after.target.id != before.target.id
    assert (after.edits, after.verdict == "CORRECT") == (edits, False)
    with pytest.raises(pipeline.InputError, match="does not know what answered it"):
        pipeline.Answer(before.text, before.trace).what_if(edits)
    with pytest.raises(pipeline.InputError, match="edits are no mapping"):
        before.what_if(["#3"])  # type: ignore[arg-type]


def test_an_expression_that_could_not_be_asked_is_an_answer_without_a_trace() -> None:
    answer = pipeline.Answer("mug beyond the laptop", problem="no relation in it")
    assert (answer.objects, answer.pairs, answer.target, answer.reference) == ((), (), None, None)
    assert (answer.holds, answer.relation_probability, answer.verdict, answer.why) == (False, None, None, None)
    assert repr(answer) == "<Answer 'mug beyond the laptop': no relation in it; no verdict>"
    assert answer.record() == {
        "expression": {"text": "mug beyond the laptop"},
        "answer": None,
        "reason": "no relation in it",
    }
    with pytest.raises(pipeline.InputError, match=r"no trace of .*: no relation in it"):
        answer.needed_trace()


def test_frames_are_a_sequence_that_decodes_what_is_asked_for(opened: pipeline.Opened) -> None:
    frames = opened.frames
    assert len(frames) == len(opened.pipeline.dataset.frame_ids)
    assert [f.id for f in frames[:2]] == list(frames.ids[:2])
    assert frames[-1].id == frames.ids[-1]
    assert frames[frames.ids[1]].id == frames.ids[1]
    with pytest.raises(IndexError):
        _ = frames[len(frames)]
    with pytest.raises(pipeline.InputError, match="no frame"):
        _ = frames["nowhere"]


def test_arrays_become_a_frame_and_a_dataset() -> None:
    rgb, depth = np.zeros((40, 60, 3), np.uint8), np.full((40, 60), 2.0)
    depth[0, 0] = np.nan
    masks = np.zeros((2, 40, 60), np.bool_)
    masks[0, 10:20, 5:15], masks[1, 10:20, 40:50] = True, True
    K = np.array([[50.0, 0, 29.5], [0, 50, 19.5], [0, 0, 1]])
    frame = Frame.of_arrays(rgb, depth, K, masks=masks, names=["cup", "box"], up=(0, -1, 0))
    assert frame.depth.dtype == np.float32
    assert frame.depth[0, 0] == 0
    assert [a.bbox.tolist() for a in frame.annotations] == [[5, 10, 15, 20], [40, 10, 50, 20]]
    opened = pipeline.open([frame], srm="rule")
    assert opened.pipeline.dataset.class_names == ("box", "cup")
    answer = opened.ask("frame", "cup left of the box")
    assert (answer.holds, answer.verdict) == (True, "CORRECT")
    assert [a.label for a in Frame.of_arrays(rgb, depth, K, masks=masks).annotations] == ["object 1", "object 2"]
    with pytest.raises(pipeline.InputError, match="a name for each mask"):
        Frame.of_arrays(rgb, depth, K, masks=masks, names=["cup"])
    with pytest.raises(pipeline.InputError, match="the mask of 'box' is empty"):
        Frame.of_arrays(rgb, depth, K, masks=masks * [[[True]], [[False]]], names=["cup", "box"])
    with pytest.raises(pipeline.InputError, match="depth must be float metres"):
        Frame.of_arrays(rgb, np.full((40, 60), 2000, np.uint16), K)
    with pytest.raises(pipeline.InputError, match="ids of their own"):
        pipeline.open([frame, frame])


def test_what_is_made_already_takes_no_options_of_making_it(opened: pipeline.Opened) -> None:
    with pytest.raises(pipeline.InputError, match="depth_scale is not for a dataset that is open already"):
        pipeline.open(opened.pipeline.dataset, depth_scale=1000)
    with pytest.raises(pipeline.InputError, match="model is not for the detector annotations"):
        pipeline.open("demo", detector=opened.pipeline.needed_detector(), model="x.onnx")


def test_parts_may_be_objects_of_ones_own(opened: pipeline.Opened) -> None:
    class Never(RuleScorer):
        name = "never"

        def score(self, *args: Any, **options: Any) -> pipeline.RelationScores:
            found = super().score(*args, **options)
            return replace(found, probabilities=found.probabilities * 0)

    class Everything:
        name = "everything"

        def fingerprint(self) -> str:
            return "everything"

        def segment(self, frame: Frame, boxes: np.ndarray, labels: object) -> tuple[np.ndarray, np.ndarray]:
            masks = np.ones((len(boxes), frame.height, frame.width), np.bool_)
            return masks, np.ones(len(boxes), np.bool_)

    answer = pipeline.ask("demo", 0, QUESTION, srm=Never())
    assert (answer.holds, answer.relation_probability, answer.needed_trace().scorer) == (False, 0, "never")
    frame = opened.frames[0]
    bare = tuple(replace(a, mask=None, box=None) for a in frame.annotations)
    answer = pipeline.ask(replace(frame, annotations=bare), 0, QUESTION, srm="rule", segmenter=Everything())
    assert answer.target is not None
    assert answer.target.mask.all()
    assert answer.target.lifted.quality.mask_source == "segmenter"


def test_the_core_has_no_screen_and_says_so(opened: pipeline.Opened) -> None:
    for show in (opened.show, opened.ask(0, QUESTION).show):
        with pytest.raises(pipeline.InputError, match="no screen"):
            show()


def test_everything_prints_on_one_line(opened: pipeline.Opened) -> None:
    answer = opened.ask(0, QUESTION)
    trace, frame = answer.needed_trace(), opened.frames[0]
    shown = [
        opened,
        opened.pipeline,
        opened.frames,
        opened.ask(0, "mug behind the laptop"),
        answer,
        trace,
        trace.scores,
        trace.ranking,
        answer.pairs[0],
        answer.target,
        answer.objects[0].lifted,
        frame,
        frame.camera,
        frame.annotations[0],
        answer.objects[0].box,
        opened.pipeline.prepare(0),
        *trace.candidates.values(),
        opened.pipeline.needed_detector().detect(frame, None),
        pipeline.open_labels(demo_labels()),
        pipeline.open_run(demo_run()),
    ]
    for value in shown:
        assert "\n" not in repr(value)
        assert len(repr(value)) < 200, repr(value)
        assert type(value).__name__ in repr(value) or isinstance(value, pipeline.Opened)
    assert "mug·3 left of laptop·2" in repr(answer)


def test_labels_and_a_run_are_made_by_plain_arguments_and_give_tables(tmp_path: Path) -> None:
    labels = pipeline.label("demo", tmp_path / "labels", limit=2)
    assert repr(labels).startswith("<Labels labels: 2 frames, ")
    first = labels.expressions.slice(0, 1).to_pylist()[0]
    assert first["text"]
    run = pipeline.evaluate(
        "demo", labels, tmp_path / "run", detector="simulated", limit=12, plots=False, name="simulated here"
    )
    assert repr(run) == "<Run run: simulated here, 12 expressions>"
    assert sum(run.verdicts.values()) == run.records.num_rows == 12
    grounding = {row["row"]: row for row in run.tables["grounding"]}
    assert grounding["simulated here"]["n"] == 12
    assert pipeline.open_run(tmp_path / "run").tables == run.tables
    assert pipeline.open_run(demo_run()).tables == {}
