"""Files of predictions by themselves: which lines set the level, what a kill leaves, what is said of wrong ones."""

from __future__ import annotations

import copy
import json
from pathlib import Path
from typing import Any

import pytest

from pipeline.answering import read_predictions
from pipeline.system import InputError

HEADER = {"spatialviz_predictions": 1, "ranking": "product"}
MASK = {"size": [480, 640], "counts": [480 * 640]}
LINE: dict[str, Any] = {
    "frame": "a",
    "text": "mug left of the laptop",
    "answer": {"object": 3, "reference": 7},
    "proposals": {
        "mug": [{"id": 3, "score": 0.9, "box": [290, 180, 330, 230], "mask": MASK}],
        "laptop": [{"id": 7.0, "score": 1, "box": [350, 150, 520, 300], "name": "notebook"}],
    },
    "boxes_3d": {"3": {"center": [0.1, 0.2, 1.4], "size": [0.08, 0.1, 0.08]}, "7": None},
    "relations": {"left": [[3, 7, 0.93]], "between": [[3, 7, 7, 0.1]]},
    "attributes": {"red": [[3, 0.8]]},
    "pairs": [[3, 7, 4]],
}
"""A line of level 3, with whole numbers where others may stand and 7.0 for 7."""


def written(path: Path, *lines: Any) -> Path:
    path.write_text("".join(json.dumps(line) + "\n" for line in lines), encoding="utf-8")
    return path


def less(text: str, *parts: str, **more: Any) -> dict[str, Any]:
    return {k: v for k, v in LINE.items() if k not in parts} | {"text": text} | more


def test_a_file_tells_which_lines_keep_its_level(tmp_path: Path) -> None:
    both = ("relations", "boxes_3d", "pairs", "attributes")
    lines = [LINE, less("b", *both), less("c", *both), less("d", "boxes_3d"), less("e", *both[:1], "pairs")]
    nothing = less("f", *both, "proposals", answer=None, problem="refused")
    read = read_predictions(written(tmp_path / "some.jsonl", HEADER, nothing, *lines))
    assert (read.level, read.lacking) == (1, ("boxes_3d", [4, 5]))
    assert read.record()["lacks"] == {"field": "boxes_3d", "line": 4, "lines": 2}
    whole = read_predictions(written(tmp_path / "whole.jsonl", HEADER, LINE))
    assert (whole.lacking, whole.record()["lacks"]) == (("", []), None)
    assert [p.id for p in (whole.lines["a", LINE["text"]].proposals or {})["laptop"]] == [7]
    # Where no line has an answer, those that reach furthest set the level.
    other = less("g", *both, answer=None, problem="x")
    read = read_predictions(written(tmp_path / "none.jsonl", HEADER, nothing, other))
    assert read.lacking == ("boxes_3d", [3])


def test_what_a_killed_writer_left_of_a_line_is_told(tmp_path: Path) -> None:
    text = written(tmp_path / "cut.jsonl", HEADER, LINE).read_text()
    path = tmp_path / "cut.jsonl"
    for end, cut in (("", None), ('{"text": "b', 3), ('{"text": "café', 3)):
        path.write_bytes((text + end).encode()[: -1 if end else None])
        assert read_predictions(path).cut_off == cut
    path.write_text(text[:-1])
    assert (len(read_predictions(path).lines), read_predictions(path).cut_off) == (1, None)
    for content, words in (
        (text[: text.index("\n") + 40], "no predictions; expected whole lines after the first"),
        ("nonsense\n", "line 1: not JSON"),
        (text + '{"text": "b\n', "line 3: not JSON"),
        (text + f'{{"text": {"1" * 5000}}}\n', "line 3: not JSON"),
    ):
        path.write_text(content)
        with pytest.raises(InputError, match=words):
            read_predictions(path)
    path.write_bytes(text.encode() + b'{"text": "\xff"}\n')
    with pytest.raises(InputError, match="line 3: not UTF-8"):
        read_predictions(path)


BOX = ("proposals", "mug", 0, "box")
THERE = ("boxes_3d", "3")
WRONG: list[tuple[tuple[Any, ...], Any, str]] = [
    (("proposals", "mug", 0, "score"), "0.5", 'proposals.mug.0.score: {}; got "0.5"; expected a number'),
    (("proposals", "mug", 0, "score"), None, "proposals.mug.0.score: {}; got null; expected a number"),
    (("proposals", "mug", 0, "score"), 1.5, "proposals.mug.0.score: {}; got 1.5; expected at most 1"),
    (("proposals", "mug", 0, "score"), True, "proposals.mug.0.score: {}; got true; expected a number"),
    (("proposals", "mug", 0, "id"), "3", 'proposals.mug.0.id: {}: no whole number; got "3"'),
    (("proposals", "mug", 0, "id"), 3.5, "proposals.mug.0.id: {}; got 3.5; expected a whole number"),
    (("proposals", "mug", 0, "id"), -1, "proposals.mug.0.id: {}; got -1; expected at least 0"),
    (("proposals", "mug", 0, "bbox"), [1], "mug.0.bbox: {}; got a field of another name; expected one of id, "),
    (("proposals", "mug", 0, "mask"), "x", 'proposals.mug.0.mask: {}; got "x"; expected an object {...}'),
    (("proposals", "mug", 0, "mask", "rle"), 1, "proposals.mug.0.mask.rle: {}; got a field of another name; "),
    (("proposals", "mug", 0, "mask", "counts"), [1.5], "mask.counts.0: {}; got 1.5; expected a whole number"),
    (("proposals", "mug"), {"id": 3}, 'proposals.mug: {}; got {"id": 3}; expected a list'),
    (("proposals", "mug", 0, "dropped"), "nms", "got \"nms\"; expected 'rank', 'overlap' or 'threshold'"),
    (BOX, [1, 2, 3], "proposals.mug.0.box: {}; got [1, 2, 3]; expected 4 values"),
    (BOX, [1, 2, 3, 4, 5], "proposals.mug.0.box: {}; got [1, 2, 3, 4, 5]; expected at most 4 values"),
    (BOX, [[1, 2], [3, 4]], "proposals.mug.0.box.0: {}; got [1, 2]; expected a number"),
    (BOX, [1, 2, float("nan"), 4], "proposals.mug.0.box.2: {}; got NaN; expected a finite number"),
    (BOX, [1, 2, 3, 10**400], f"proposals.mug.0.box.3: {{}}; got 1{'0' * 56}...; expected a number"),
    (("answer",), 3, "answer: {}; got 3; expected an object {...}"),
    (("answer", "yes"), "no", 'answer.yes: {}; got "no"; expected true or false'),
    (("boxes_3d", "mug"), None, 'boxes_3d.mug: {}; got "mug"; expected a whole number'),
    ((*THERE, "rotation"), [1, 0, 0, 0], "boxes_3d.3.rotation: {}; got [1, 0, 0, 0]; expected at least 9 values"),
    ((*THERE, "yaw"), 1, "boxes_3d.3.yaw: {}; got a field of another name; expected one of center, size, "),
    (("relations", "left"), [[3, 7]], "relations.left.0: {}; got [3, 7]; expected 3 values"),
    (("relations", "left"), [[3, 7, 1.5]], "relations.left.0.2: {}; got 1.5; expected at most 1"),
    (("relations", "left"), [["a", 7, 0.5]], 'relations.left.0.0: {}: no whole number; got "a"'),
    (("relations", "between"), [[3, 7, 7, "0.5"]], 'relations.between.0.3: {}; got "0.5"; expected a number'),
    (("attributes", "red"), {"3": 0.5}, 'attributes.red: {}; got {"3": 0.5}; expected a list'),
    (("pairs",), [[3, 7, float("inf")]], "pairs.0.2: {}; got Infinity; expected a finite number"),
    (("text",), None, "text: {}; got null; expected text"),
    (("frame",), "", 'frame: {}; got ""; expected text that is not empty'),
    (("answr",), 1, "answr: {}; got a field of another name; expected one of frame, text, "),
]


@pytest.mark.parametrize(("place", "value", "words"), WRONG)
def test_what_is_wrong_is_told_by_line_and_field_with_what_stands_there(
    tmp_path: Path, place: tuple[Any, ...], value: Any, words: str
) -> None:
    line: Any = copy.deepcopy(LINE)
    inside = line
    for part in place[:-1]:
        inside = inside[part]
    inside[place[-1]] = value
    with pytest.raises(InputError) as caught:
        read_predictions(written(tmp_path / "wrong.jsonl", HEADER, LINE | {"text": "fine"}, line))
    message = str(caught.value)
    assert message.startswith("line 3, ")
    assert words.replace("{}", "not as the schema has it", 1) in message
    assert not any(word in message for word in ("Input should", "tuple", "constrained", "[key]", "keyword", "Field"))


def test_what_is_missing_and_what_is_no_line_are_told_too(tmp_path: Path) -> None:
    for lines, words in (
        ([HEADER, less("b", "frame")], "line 2, frame: .*; got nothing; expected a value"),
        ([HEADER, [1, 2]], r"line 2, the top: .*; got \[1, 2\]; expected an object"),
        ([{**HEADER, "exact": "false"}, LINE], 'line 1, exact: .*; got "false"; expected true or false'),
        ([{**HEADER, "weights": {"goal": 1}}, LINE], "line 1, weights.goal: .*one of target, reference, relation"),
        ([{**HEADER, "weights": {"target": "1"}}, LINE], 'line 1, weights.target: .*got "1"; expected a number'),
    ):
        with pytest.raises(InputError, match=words):
            read_predictions(written(tmp_path / "wrong.jsonl", *lines))
