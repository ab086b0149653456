"""Reading what models write: yes and no, and boxes in the many ways they are written."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.evaluation.model_answers import box_numbers, parse_yes_no, spoken_part
from pipeline.evaluation.place_reading import PlacedLine, ReadPlace, read_places, told_reading
from pipeline.evaluation.written_places import written_place


def read_box(text: str, told: str = "", size: tuple[int, int] = (640, 480)) -> ReadPlace | None:
    """The place of one answer, of which nothing else is known; None for none."""
    place = written_place(spoken_part(text)[0])
    if place is None:
        return None
    (found,), _ = read_places([PlacedLine("it", place, size, np.zeros((0, 4)))], [told_reading(told)] if told else [])
    return found


YES = (
    "Yes",
    "yes.",
    "YES!",
    " **Yes** ",
    "‘Yes’",
    "y",
    "Yes, the mug is not behind it.",
    "The answer is yes",
    '{"answer": "yes"}',
    "Answer yes or no: yes",
    "Yes, there is no doubt.",
    "yes, no mug is there",
    "True",
    "Correct.",
    "That is true.",
    "<think>No. Or no?</think>\n\nYes",
    "reasoning ...</think> Yes.",
    "No doubt: yes",
    "Yep",
    "Is the mug left of it? Yes.",
    "It looks like no. Wait. Final answer: yes",
    "Ｙｅｓ",
    "It is not false.",
)
NO = (
    "No",
    "no.",
    "NO",
    "_No_",
    "n",
    "No, the mug is right of the laptop.",
    "No — it is behind.",
    "The answer is: *no*.",
    "I would say no.",
    "No mug is on the table.",
    "That is not correct.",
    "False",
    "No, that is not correct.",
    "Nope!",
    "The correct answer is no",
    "<think>yes</think>no",
    "No, it isn't.",
    "Answer: No",
)
UNKNOWN = (
    "",
    "  \n",
    "Ja",
    "はい",
    "Oui.",
    "Yes and no.",
    "Yes/No",
    "yes or no",
    "Yes\nNo",
    "No idea.",
    "I don't know.",
    "The mug is right of the laptop.",
    "there is no mug here",
    "I cannot answer yes or no.",
    "<think>Yes, it",
    "The answer is not yes",
    "it is object no. 5",
    "Answer: yes. Answer: no.",
    "left",
    "\x00\ud800",
    "12",
    "nobody",
    "yesterday",
    "noon",
)


@pytest.mark.parametrize(("text", "value"), [*((t, True) for t in YES), *((t, False) for t in NO)])
def test_yes_and_no_are_read(text: str, value: bool) -> None:
    assert parse_yes_no(text).value is value


@pytest.mark.parametrize("text", UNKNOWN)
def test_what_is_neither_or_both_is_said_to_be(text: str) -> None:
    found = parse_yes_no(text)
    assert found.value is None
    assert found.reason


@given(
    st.booleans(),
    st.sampled_from(["", "**", "_", '"', "`"]),
    st.sampled_from(["", ".", "!", ", it is.", ", as one can see in the picture."]),
    st.sampled_from(["", " ", "\n\n", "The answer is ", "Answer: ", "I would say: "]),
    st.sampled_from([str.lower, str.title, str.upper]),
)
def test_dressed_up_answers_are_read(value: bool, mark: str, tail: str, lead: str, case: Callable[[str], str]) -> None:
    word = case("yes" if value else "no")
    assert parse_yes_no(f"{lead}{mark}{word}{mark}{tail}").value is value


@settings(max_examples=30, deadline=None)
@given(st.text())
def test_no_text_is_too_odd(text: str) -> None:
    verdict = parse_yes_no(text)
    assert (verdict.value is None) == (verdict.reason is not None)
    found = box_numbers(text)
    assert isinstance(found, str) or len(found.values) == 4


@given(st.lists(st.sampled_from([*"0123456789.,-[](){}<>=:%ex nainf\n", "x1", "loc", "to", "bbox"]), max_size=40))
def test_no_run_of_numbers_is_too_odd(parts: list[str]) -> None:
    place = written_place("".join(parts))
    assert place is None or (len(place.values) in (2, 4) and np.isfinite(place.values).all())


def written(digits: int, factor: float) -> Callable[[float], str]:
    return lambda share: f"{share * factor:.{digits}f}"


STYLES: dict[str, tuple[str, int, float, str]] = {
    "list": ("[{}, {}, {}, {}]", 3, 1, ""),
    "tight": ("({},{},{},{})", 2, 1, ""),
    "in a sentence": ("The mug is at [{}, {}, {}, {}], left of the laptop 2.", 3, 1, ""),
    "spaces": ("{} {} {} {}", 3, 1, ""),
    "bare": ("Sure! {}, {}, {}, {}.", 3, 1, ""),
    "semicolons": ("[{}; {}; {}; {}]", 3, 1, ""),
    "bold": ("**[{}, {}, {}, {}]**", 3, 1, ""),
    "json": ('```json\n{{"bbox": [{}, {}, {}, {}], "label": "mug"}}\n```', 4, 1, ""),
    "json of corners": ('{{"x1": {}, "y1": {}, "x2": {}, "y2": {}}}', 4, 1, ""),
    "from zero": ("x0={} y0={} x1={} y1={}", 3, 1, ""),
    "min and max": ("x_min: {}, y_min: {}, x_max: {}, y_max: {}", 3, 1, ""),
    "sides": ("Left: {}\nTop: {}\nRight: {}\nBottom: {}", 3, 1, ""),
    "points": ("({}, {}), ({}, {})", 3, 1, ""),
    "nested": ("[[{}, {}], [{}, {}]]", 3, 1, ""),
    "named points": ("from (x={}, y={}) to (x={}, y={})", 3, 1, ""),
    "told corners": ("top-left ({}, {}) and bottom-right ({}, {})", 3, 1, ""),
    "per cent": ("[{}%, {}%, {}%, {}%]", 1, 100, ""),
    "per cent in a row": ("{} %, {} %, {} %, {} %", 0, 100, ""),
    "hundredths": ("[{}, {}, {}, {}]", 0, 100, "percent"),
    "thousandths": ("[{}, {}, {}, {}]", 0, 1000, "thousandths"),
    "thousandths, tagged": ("<|box_start|>({},{}),({},{})<|box_end|>", 0, 1000, ""),
    "pixels": ("[{}, {}, {}, {}]", 0, 4000, "pixels"),
    "pixels, signed": ("[{}px, {}px, {}px, {}px]", 0, 4000, ""),
    "PaliGemma": ("<loc{1:0>4}><loc{0:0>4}><loc{3:0>4}><loc{2:0>4}> mug", 0, 1024, ""),
    "Florence": ("mug<loc_{}><loc_{}><loc_{}><loc_{}>", 0, 1000, ""),
}


@pytest.mark.parametrize("style", STYLES)
@settings(max_examples=25, deadline=None)
@given(x=st.tuples(st.floats(0.0, 0.99), st.floats(0.0, 0.99)), y=st.tuples(st.floats(0.0, 0.99), st.floats(0, 0.99)))
def test_a_box_written_in_any_style_is_read_back(style: str, x: tuple[float, float], y: tuple[float, float]) -> None:
    form, digits, factor, told = STYLES[style]
    say = written(digits, factor)
    step = 10.0**-digits / factor
    (x0, x1), (y0, y1) = sorted(x), sorted(y)
    # Wide enough not to be rounded to nothing, nor taken for shares.
    if min(x1 - x0, y1 - y0) < 0.03:
        return
    order = "" if "loc" in form else ",xyxy"
    told = f"{told}{order}".strip(",")
    found = read_box(form.format(*(say(v) for v in (x0, y0, x1, y1))), told, (4000, 4000))
    assert found is not None
    assert found.box == pytest.approx((x0, y0, x1, y1), abs=step * 0.51 + 1e-9)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "empty answer"),
        ("There is no mug.", "no box"),
        ("[nan, 0.1, 0.2, 0.3]", "not finite"),
        ("[0.1, 0.1, inf, 0.3]", "not finite"),
        ('{"bbox": [0.1, NaN, 0.2, Infinity]}', "not finite"),
        ("[0.1, 0.1, 1e999, 0.3]", "not finite"),
        ("[0.1, 0.2, 0.3]", "3 numbers"),
        ("[0.1, 0.2, 0.3, 0.4, 0.9]", "5 numbers"),
        ("<think>[0.1, 0.2, 0.3, 0.4]", "within its reasoning"),
        ("version 1.2.3.4", "no box"),
    ],
)
def test_why_there_is_no_box(text: str, reason: str) -> None:
    spoken, why = spoken_part(text)
    assert written_place(spoken) is None
    assert reason in str(why or box_numbers(spoken))


@pytest.mark.parametrize(
    "piece", ["answer ", "<think>", "0.1 ", "[", "0.1,", "x1=", "0", "<loc0001>", "(x=1,y=1)", " "]
)
def test_endless_answers_are_read_in_no_time(piece: str) -> None:
    text = piece * (300_000 // len(piece))
    assert parse_yes_no(text).value is None
    assert written_place(spoken_part(text)[0]) is None or piece in ("<loc0001>", "(x=1,y=1)")
