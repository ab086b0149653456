"""Unit, order and kind of answers in numbers: files written by the conventions of the makers' own documentation.

Qwen2-VL counts in thousandths, Qwen2.5-VL in pixels of the resized picture (QwenLM/Qwen3-VL#866, #721), Qwen3-VL in
thousandths again (#1486); Gemini's box_2d is [ymin, xmin, ymax, xmax] and its point [y, x], in thousandths
(ai.google.dev/gemini-api/docs/image-understanding); Molmo writes x="61.5" y="40.4" per cent (allenai/Molmo-7B-O-0924),
Molmo2 coords="1 1 386 645" in thousandths (its model card).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from pipeline.evaluation.place_habits import far_edges, habit_of, smart_resize
from pipeline.evaluation.place_reading import PlacedLine, read_places, told_reading
from pipeline.evaluation.written_places import written_place
from pipeline.system import InputError

SIZE = (640, 480)
Write = Callable[..., str]


def in_order(order: str, box: np.ndarray) -> list[float]:
    x0, y0, x1, y1 = box.tolist()
    u, v = (x0 + x1) / 2, (y0 + y1) / 2
    return {
        "xyxy": [x0, y0, x1, y1],
        "yxyx": [y0, x0, y1, x1],
        "xywh": [x0, y0, x1 - x0, y1 - y0],
        "cxcywh": [u, v, x1 - x0, y1 - y0],
        "xy": [u, v],
        "yx": [v, u],
    }[order]


def a_file(
    unit: str, order: str, form: str = "", *, model: str = "", count: int = 24, wrong: float = 0.0, size=SIZE
) -> tuple[list[PlacedLine], np.ndarray]:
    """Lines about pictures of two things of the asked name, and the boxes (N, 4) that are meant, in shares."""
    rng = np.random.default_rng([count, len(unit), len(order)])
    lines, meant = [], []
    for k in range(count):
        low = rng.uniform(0.02, 0.75, (2, 2))
        things = np.concatenate([low, low + rng.uniform(0.06, 0.22, (2, 2))], axis=1)
        box = things[k % 2]
        if rng.random() < wrong:
            start = rng.uniform(0, 0.7, 2)
            box = np.concatenate([start, start + rng.uniform(0.05, 0.3, 2)])
        numbers = in_order(order, box * np.tile(far_edges(unit, size), 2))
        digits = {"shares": 3, "percent": 1}.get(unit, 0)
        said = ", ".join(f"{number:.{digits}f}" for number in numbers)
        text = f'```json\n[{{"{form}": [{said}], "label": "mug"}}]\n```' if form else f"({said})"
        place = written_place(text)
        assert place is not None
        lines.append(PlacedLine(f"line {k + 1}", place, size, things, model))
        meant.append(box)
    return lines, np.array(meant)


def places_of(lines: list[PlacedLine], *told: str) -> tuple[np.ndarray, str]:
    found, notes = read_places(lines, [told_reading(text) for text in told])
    return np.array([place.box for place in found]), notes[0]


def is_as_meant(found: np.ndarray, meant: np.ndarray) -> bool:
    if (found[:, :2] == found[:, 2:]).all():
        meant = np.tile((meant[:, :2] + meant[:, 2:]) / 2, 2)
    return bool((np.abs(found - meant).max(axis=1) < 0.02).mean() > 0.9)


@pytest.mark.parametrize("order", ["xyxy", "yxyx", "xywh", "cxcywh", "xy", "yx"])
@pytest.mark.parametrize("unit", ["pixels", "thousandths", "shares", "percent", "pixels:1024", "pixels:320"])
def test_a_file_says_by_itself_what_its_numbers_mean(unit: str, order: str) -> None:
    for wrong in (0.0, 0.5):
        lines, meant = a_file(unit, order, wrong=wrong, count=60)
        found, note = places_of(lines, *([unit] if unit.startswith("pixels:") and len(order) == 2 else []))
        assert is_as_meant(found, meant), note


@pytest.mark.parametrize("count", [1, 2, 4, 8, 24])
def test_nothing_is_read_wrong_where_little_tells(count: int) -> None:
    """Few lines, half of them beside any thing: what is not sure is asked for."""
    asked = wrong = 0
    for unit in ("pixels", "thousandths", "percent", "pixels:1024", "pixels:320"):
        for order in ("xyxy", "yxyx", "xywh", "xy", "yx"):
            lines, meant = a_file(unit, order, wrong=0.5, count=count)
            try:
                wrong += not is_as_meant(places_of(lines)[0], meant)
            except InputError as error:
                asked += "--places" in str(error)
    assert wrong <= (2 if count < 8 else 0), (asked, wrong)


@pytest.mark.parametrize(
    ("model", "unit", "order", "form"),
    [
        ("Qwen2-VL-7B-Instruct", "thousandths", "xyxy", "bbox_2d"),
        ("Qwen/Qwen2.5-VL-7B-Instruct", "pixels:qwen", "xyxy", "bbox_2d"),
        ("Qwen2.5-VL-7B-Instruct", "pixels:qwen", "xy", "point_2d"),
        ("Qwen__Qwen3-VL-8B-Instruct", "thousandths", "xy", "point_2d"),
        ("gemini-2.5-pro", "thousandths", "yxyx", "box_2d"),
        ("gemini-2.5-pro", "thousandths", "yx", "point"),
    ],
)
def test_a_known_model_is_read_as_its_maker_says(model: str, unit: str, order: str, form: str) -> None:
    """One line is enough; where its picture is large, Qwen2.5-VL's pixels are those of a smaller one."""
    for size in (SIZE, (4000, 6000)):
        lines, meant = a_file(unit, order, form, model=model, count=1, size=size)
        found, note = places_of(lines)
        assert is_as_meant(found, meant), note
        habit = habit_of(model)
        assert habit is not None
        assert habit[2] in note


def test_qwen_with_fewer_pixels_is_read_as_such() -> None:
    """max_pixels of 256 tokens makes 504x364 of 640x480, as `smart_resize` does."""
    lines, meant = a_file("pixels:qwen-256", "xyxy", "bbox_2d", model="Qwen2.5-VL-7B-Instruct")
    assert far_edges("pixels:qwen-256", SIZE) == (504, 364)
    found, note = places_of(lines)
    assert is_as_meant(found, meant), note
    assert "as Qwen2.5-VL resizes it to 256 tokens" in note
    assert str(told_reading("padded")) == "padded"


def test_shares_of_a_padded_picture_are_read_as_such() -> None:
    """LLaVA-1.5 was trained on pictures padded to a square (README of haotian-liu/LLaVA: image_aspect_ratio pad)."""
    lines, meant = a_file("shares", "xyxy", count=30)
    padded = []
    for line, box in zip(lines, meant, strict=True):
        inner = box * [1, 0.75, 1, 0.75] + [0, 0.125, 0, 0.125]
        place = written_place(f"[{', '.join(f'{value:.2f}' for value in inner)}]")
        assert place is not None
        padded.append(replace(line, place=place))
    found, note = places_of(padded)
    assert is_as_meant(found, meant), note
    assert "shares of the picture padded to a square" in note
    one, _ = places_of([replace(padded[0], model="llava-v1.5-7b", things=np.zeros((0, 4)))])
    assert is_as_meant(one, meant[:1])


def test_evidence_goes_before_habit_and_says_so() -> None:
    lines, meant = a_file("thousandths", "xyxy", "bbox_2d", model="Qwen2.5-VL-7B-my-finetune")
    found, note = places_of(lines)
    assert is_as_meant(found, meant)
    assert (
        "24 answers written as bbox_2d are thousandths, x first, two corners: 24 of 24 in the picture, 24 of 24" in note
    )
    assert "though Qwen2.5-VL-7B-my-finetune writes pixels:qwen" in note


def test_where_two_readings_fit_alike_the_option_is_asked_for() -> None:
    lines = [PlacedLine("line 7", written_place("(200, 100)"), SIZE, np.zeros((0, 4)))]  # type: ignore[arg-type]
    with pytest.raises(InputError, match=r"line 7: .* two ways: .*; expected --places \w+,xy or --places \w+,xy$"):
        read_places(lines)
    assert places_of(lines, "thousandths")[0][0].tolist() == pytest.approx([0.2, 0.1, 0.2, 0.1])
    assert places_of(lines, "pixels:1280x960,yx")[0][0, :2].tolist() == pytest.approx([100 / 1280, 200 / 960])
    for text in ("inches", "pixels:", "pixels:0", "xy,yx", "pixels,shares", "pixels:99999999x2"):
        with pytest.raises(InputError, match="--places: not how numbers are meant"):
            told_reading(text)


def test_a_size_that_is_none_of_the_usual_is_asked_for() -> None:
    lines, meant = a_file("pixels:277", "xyxy", count=40)
    with pytest.raises(InputError, match=r"fit no usual size of a picture: best .* longer side is 2[78]"):
        read_places(lines)
    assert is_as_meant(places_of(lines, "pixels:277")[0], meant)


def test_two_brackets_are_corners_where_a_model_writes_nothing_else_so() -> None:
    boxes, meant = a_file("pixels", "xyxy", count=20)
    corners = []
    for line in boxes:
        a, b, c, d = (int(v) for v in line.place.values)
        place = written_place(f"({a}, {b}), ({c}, {d})")
        assert place is not None
        corners.append(PlacedLine(line.where, place, SIZE, line.things))
    assert is_as_meant(places_of(corners)[0], meant)
    points, _ = a_file("pixels", "xy", count=20)
    found, _ = read_places([*points, *corners])
    assert all(place.point for place in found)


@pytest.mark.parametrize(
    ("text", "values", "fixed"),
    [
        ('<point x="61.5" y="40.4" alt="mug">mug</point>', (61.5, 40.4), ""),
        ('<points coords="1 1 386 645 2 100 200">mugs</points>', (386, 645), ""),
        ("<|box_start|>(100,200),(300,400)<|box_end|>", (100, 200, 300, 400), ""),
        ("<loc0256><loc0128><loc0512><loc0768> mug", (128, 256, 768, 512), "1024ths"),
        ("x1=10%, y1=20%, x2=30%, y2=40%", (10, 20, 30, 40), "percent"),
        ('{"x": 10, "y": 20, "width": 30, "height": 40}', (10, 20, 30, 40), ""),
        ('{"x": 12.5, "y": 20}', (12.5, 20), ""),
        ("x_min: 1, y_min: 2, x_max: 3, y_max: 4", (1, 2, 3, 4), ""),
        (f"({'9' * 400}, 2)", None, ""),
        (f'"bbox": [1, 2, 3, {"9" * 400}]', None, ""),
        ("no place at all", None, ""),
        ("[nan, 1, 2, 3]", None, ""),
        ('"point_2d": [1, 2, 3]', None, ""),
    ],
)
def test_numbers_are_found_as_they_are_written(text: str, values: tuple[float, ...] | None, fixed: str) -> None:
    place = written_place(text)
    assert (None if place is None else (place.values, place.fixed)) == (None if values is None else (values, fixed))


def test_pictures_are_resized_as_qwen_does() -> None:
    """By hand after `smart_resize` of qwen_vl_utils."""
    assert smart_resize((640, 480), 1280 * 28 * 28) == (644, 476)
    assert smart_resize((1920, 1440), 1280 * 28 * 28) == (1148, 840)
    assert smart_resize((20, 20), 1280 * 28 * 28) == (56, 56)
    assert far_edges("pixels:320", SIZE) == (320, 240)


def test_any_text_is_read_or_none() -> None:
    """Pieces of the ways of writing in any order: no error but the one that asks."""
    marks = ["[", "]", "(", ")", "{", "}", '"bbox_2d":', '"point":', "<box>", "</box>", "coords=", '"', "x1=", "y:"]
    marks += ["%", "px", ",", "and", "x", "=", "nan", "1e5", "99999999999"]
    pieces = [*marks, "(12, 0.5)", "[1, 2, 3, 4]", "<loc0012>" * 4, "x=3, y=4", "12, 30, 40, 50", "\u0663", "\n", " "]
    rng = np.random.default_rng(0)
    lines = []
    for _ in range(3000):
        place = written_place("".join(rng.choice(pieces, rng.integers(1, 9))))
        if place is not None:
            assert len(place.values) in (2, 4)
            lines.append(PlacedLine("line 1", place, SIZE, rng.uniform(0, 1, (2, 4))))
    assert len(lines) > 100
    for line in lines[:300]:
        try:
            ((x0, y0, x1, y1),) = (place.box for place in read_places([line])[0])
        except InputError as error:
            assert "--places" in str(error)  # noqa: PT017
        else:
            assert np.isfinite([x0, y0, x1, y1]).all()
