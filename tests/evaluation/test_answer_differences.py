"""Answers of two runs, or of two files of answers, side by side without verdicts."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from pipeline.datasets import demo_run
from pipeline.evaluation import answer_differences
from pipeline.system import InputError

HERE, NEAR, THERE = [0.0, 0.0, 10.0, 10.0], [0.0, 0.0, 10.0, 9.0], [50.0, 0.0, 60.0, 10.0]


def line(text: str, target: Any, reference: Any = None) -> str:
    ends = {
        name: None if box is None else {"bbox": box}
        for name, box in zip(("target", "reference"), (target, reference), strict=True)
    }
    answer = None if target is None else ends
    return json.dumps({"expression": {"text": text}, "frame": "a/0", "answer": answer})


def test_answers_that_overlap_are_the_same_and_others_stand_side_by_side(tmp_path: Path) -> None:
    first, second = tmp_path / "a.jsonl", tmp_path / "b.jsonl"
    first.write_text(
        "\n".join(
            [
                line("same", HERE, THERE),
                line("none", None),
                line("target", HERE),
                line("reference", HERE, THERE),
                line("unanswered", HERE),
                line("only here", HERE),
            ]
        )
    )
    second.write_text(
        "\n".join(
            [
                line("same", NEAR, THERE),
                line("none", None),
                line("target", THERE),
                line("reference", HERE, HERE),
                line("unanswered", None),
                "",
            ]
        )
    )
    found = answer_differences(first, second)
    assert [(one["text"], one["differs"]) for one in found["answers"]] == [
        ("target", "target"),
        ("reference", "reference"),
        ("unanswered", "target"),
    ]
    assert found["answers"][0] == {
        "frame": "a/0",
        "text": "target",
        "differs": "target",
        "first": {"box": HERE, "reference_box": None},
        "second": {"box": THERE, "reference_box": None},
    }
    counts = {name: found[name] for name in ("shared", "same", "only_first", "only_second")}
    assert counts == {"shared": 5, "same": 2, "only_first": 1, "only_second": 0}


def test_a_run_answers_as_itself() -> None:
    found = answer_differences(demo_run(), demo_run())
    assert found["same"] == found["shared"] > 0
    assert found["answers"] == []


@pytest.mark.parametrize("text", ["[1]", '{"frame": "a/0"}', "nonsense", line("bad", [1, 2])])
def test_what_is_no_answer_is_said(tmp_path: Path, text: str) -> None:
    path = tmp_path / "a.jsonl"
    path.write_text(text)
    with pytest.raises(InputError, match=r"a\.jsonl"):
        answer_differences(path, path)
