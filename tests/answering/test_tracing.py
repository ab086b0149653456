"""Predictions written as a pipeline runs: what a trace leaves, also when it is killed, is a file of predictions."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from waiting import LONG_S

import pipeline
from pipeline.answering import PredictedAnswer, PredictedBox, Prediction, Proposal, read_predictions
from pipeline.answering.predictions import read_contents
from pipeline.answering.tracing import Tracer
from pipeline.geometry import Box3D, RunLength

QUESTION = "mug left of the laptop"
MASK = np.zeros((6, 8), np.bool_)
MASK[2:4, 1:5] = True


def tell(t: Tracer, frame: str, text: str = QUESTION) -> list[int]:
    """One expression with all that level 3 has; returns the ids."""
    t.expression(frame, text, target="mug", relation="left", reference="laptop")
    mugs = t.proposals("mug", np.array([[1, 2, 5, 4], [0, 0, 2, 2]], np.float32), [0.9, 0.1], masks=[MASK, None])
    laptops = t.proposals("laptop", [[4, 1, 8, 5]], np.array([0.8]), names=["notebook"])
    t.boxes({mugs[0]: Box3D(np.array([0, 0, 1.5]), np.eye(3), np.ones(3)), laptops[0]: None})
    t.boxes({mugs[1]: {"center": (0, 0, 1), "size": np.ones(3), "rotation": np.eye(3)}})
    t.relations({"left": {(mugs[0], laptops[0]): 0.9}})
    t.relations({"left": [(mugs[1], laptops[0], np.float64(0.2))], "near": []})
    t.attributes({"red": {mugs[0]: 0.7}})
    t.pairs({(mugs[0], laptops[0]): 3.5})
    t.answer(mugs[0], laptops[0])
    return [*mugs, *laptops]


def test_a_trace_is_the_predictions_that_were_told(tmp_path: Path) -> None:
    with pipeline.trace(tmp_path / "run", system="ours", ranking="pair_scores") as t:
        assert tell(t, "a") == [0, 1, 2]
        assert tell(t, "b", "other words") == [0, 1, 2]
    found = read_predictions(tmp_path / "run.jsonl")
    assert (found.header.system, found.header.ranking, found.header.events, found.level) == (
        "ours",
        "pair_scores",
        True,
        3,
    )
    unit, axes = (1.0, 1.0, 1.0), (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
    assert found.lines["a", QUESTION] == Prediction(
        "a", QUESTION, PredictedAnswer(0, 2), target="mug", relation="left", reference="laptop",
        proposals={
            "mug": (Proposal(0, 0.9, (1, 2, 5, 4), mask=RunLength.of(MASK)), Proposal(1, 0.1, (0, 0, 2, 2))),
            "laptop": (Proposal(2, 0.8, (4, 1, 8, 5), "notebook"),),
        },
        boxes_3d={0: PredictedBox((0, 0, 1.5), unit, axes), 2: None, 1: PredictedBox((0, 0, 1), unit, axes)},
        relations={"left": ((0, 2, 0.9), (1, 2, 0.2)), "near": ()},
        attributes={"red": ((0, 0.7),)}, pairs=((0, 2, 3.5),),
    )  # fmt: skip
    assert list(found.lines) == [("a", QUESTION), ("b", "other words")]


def test_wherever_a_trace_breaks_off_only_the_event_that_was_open_is_lost(tmp_path: Path) -> None:
    with pipeline.trace(tmp_path / "run", ranking="pair_scores") as t:
        tell(t, "a")
        tell(t, "b")
    whole = t.path.read_bytes()
    lines = whole.splitlines(keepends=True)
    broken = tmp_path / "broken.jsonl"
    for cut in range(len(lines[0]) + len(lines[1]), len(whole), 17):
        broken.write_bytes(whole[:cut])
        # A last line that lacks only its end is whole.
        kept = [event for _, event in read_contents(broken)]
        assert kept == [json.loads(line) for line in lines[: len(kept)]]
        assert 0 <= cut - sum(map(len, lines[: len(kept)])) + 1 < len(([*lines, b""])[len(kept)])
        for line in read_predictions(broken).lines.values():
            told = {name for event in kept[1:] if event["frame"] == line.frame for name in event}
            assert (line.proposals is not None) == ("proposals" in told)
            assert (line.answer is not None) == (line.relations is not None) == ("answer" in told)
            assert line.problem == (None if line.answer else "no answer was recorded")


def test_a_killed_process_loses_nothing_that_it_had_told_and_another_goes_on(tmp_path: Path) -> None:
    code = """
import os, signal, sys
import pipeline
t = pipeline.trace(sys.argv[1], ranking="product")
t.expression("a", "mug left of the laptop")
t.proposals("mug", [[1, 2, 5, 4]], [0.9])
t.answer(0)
t.expression("b", "mug left of the laptop")
t.proposals("mug", [[3, 2, 5, 4], [0, 0, 1, 1]], [0.9, 0.3])
os.kill(os.getpid(), signal.SIGKILL)
"""
    path = tmp_path / "run.jsonl"
    done = subprocess.run([sys.executable, "-c", code, str(path)], capture_output=True, text=True, timeout=LONG_S)
    assert done.returncode == -9, done.stderr
    first, second = read_predictions(path).lines.values()
    assert first.answer == PredictedAnswer(0)
    assert (second.frame, len((second.proposals or {})["mug"]), second.problem) == ("b", 2, "no answer was recorded")
    with path.open("ab") as file:
        file.write(b'{"frame": "b", "te')  # As a full disk leaves it.
    with pipeline.trace(path, append=True, ranking="product") as t:
        t.expression("b", QUESTION)
        assert t.proposals("mug", [[0, 0, 1, 1], [7, 7, 8, 8]], [0.9, 0.4]) == [1, 2]
        t.answer(2)
    first, second = read_predictions(path).lines.values()
    assert first.answer == PredictedAnswer(0)
    assert ([p.id for p in (second.proposals or {})["mug"]], second.answer) == ([1, 2], PredictedAnswer(2))


def test_threads_have_expressions_of_their_own(tmp_path: Path) -> None:
    met = threading.Barrier(4)

    def work(t: Tracer, frame: str) -> None:
        t.expression(frame, QUESTION)
        met.wait(LONG_S)
        ids = t.proposals("mug", [[0, 0, 1, 1]], [0.5])
        met.wait(LONG_S)
        t.answer(ids[0])

    with pipeline.trace(tmp_path / "run") as t:
        threads = [threading.Thread(target=work, args=(t, f"{k}")) for k in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(LONG_S)
    lines = read_predictions(t.path).lines
    assert {frame for frame, _ in lines} == {"0", "1", "2", "3"}
    assert all(line.answer == PredictedAnswer(0) and line.level == 1 for line in lines.values())


WRONG: dict[str, tuple[Callable[[Tracer], Any], str]] = {
    "logits": (lambda t: t.proposals("cup", [[0, 0, 1, 1]], [3.2]), r"proposals\.cup\.0\.score"),
    "nan": (lambda t: t.proposals("cup", [[0, 0, np.nan, 1]], [0.2]), r"proposals\.cup\.0\.box\.2"),
    "three numbers": (lambda t: t.proposals("cup", [[0, 0, 1]], [0.2]), r"proposals\.cup\.0\.box"),
    "lengths": (lambda t: t.proposals("cup", [[0, 0, 1, 1]], [0.2, 0.3]), "'cup' differ in number; got .*'score': 2"),
    "a mask of numbers": (lambda t: t.proposals("cup", [[0, 0, 1, 1]], [0.2], masks=[MASK * 0.5]), "bool .*float64"),
    "an unknown object": (lambda t: t.answer(9), "answer: no such object among the proposals; got 9"),
    "an unknown pair": (lambda t: t.relations({"left": {(0, 9): 0.5}}), "relations: no such object .*got 9"),
    "a bad box": (lambda t: t.boxes({0: {"center": [0, 0, 0], "width": 3}}), "boxes_3d.0.*width"),
    "no answer": (lambda t: t.answer(), "neither an answer nor a problem"),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_the_schema_refuses_is_refused_when_it_is_told_and_leaves_no_line(name: str, tmp_path: Path) -> None:
    call, words = WRONG[name]
    with pipeline.trace(tmp_path / "run") as t:
        t.expression("a", QUESTION)
        t.proposals("mug", [[1, 2, 5, 4]], [0.9])
        before = t.path.read_bytes()
        with pytest.raises(pipeline.InputError, match=words) as raised:
            call(t)
        assert "\n" not in str(raised.value)
        assert t.path.read_bytes() == before
        t.answer(0)
    assert read_predictions(t.path).lines["a", QUESTION].answer == PredictedAnswer(0)


def test_a_trace_says_why_it_cannot_begin(tmp_path: Path) -> None:
    with pytest.raises(pipeline.InputError, match=r"lenght: .*expected one of .*length"):
        pipeline.trace(tmp_path / "run", lenght="mm")
    with pipeline.trace(tmp_path / "run") as t, pytest.raises(pipeline.InputError, match="no expression is open"):
        t.answer(point=(3, 4))
    with pytest.raises(pipeline.InputError, match="the file exists; expected append=True"):
        pipeline.trace(tmp_path / "run")
    with pytest.raises(pipeline.InputError, match="begun with another header"):
        pipeline.trace(tmp_path / "run", append=True, length="mm")
    with pytest.raises(pipeline.InputError, match="cannot be written"):
        pipeline.trace(tmp_path / "no folder" / "run")


def test_what_two_events_tell_otherwise_is_a_fault_that_names_both_lines(tmp_path: Path) -> None:
    path = tmp_path / "run.jsonl"
    asked = {"frame": "a", "text": QUESTION}
    events = [asked, asked | {"answer": {"yes": True}}, asked | {"answer": {"yes": False}}]
    lines = [{"spatialviz_predictions": 1, "events": True}, *events]
    path.write_text("".join(json.dumps(line) + "\n" for line in lines))
    with pytest.raises(pipeline.InputError, match=r"line 4, answer: told before, and otherwise, .* line 2 begins"):
        read_predictions(path)
