"""Text on pictures: it fits where it is put, whatever it says."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.pictures.text import MOST, Text, draw_text, fitted, font, on_one_line, plain, shortened, width_of, wrapped

WHITE = (255, 255, 255)
SAID = "the potted plant that stands left of the shelf"


@given(st.text(max_size=80), st.integers(20, 400), st.integers(1, 4))
@settings(max_examples=60, deadline=None)
def test_no_line_is_wider_than_its_place(text: str, width: int, most: int) -> None:
    face = font(16)
    lines = wrapped(plain(text, WHITE), face, width, most)
    assert len(lines) <= most
    # A single letter, or the ellipsis alone, may be as wide as it is.
    assert all(width_of(line, face) <= max(width, 2 * face.size) for line in lines)


@given(st.text(max_size=60), st.floats(-40, 90), st.floats(-20, 60))
@settings(max_examples=60, deadline=None)
def test_any_text_is_drawn_anywhere(text: str, x: float, y: float) -> None:
    image = np.zeros((40, 80, 3), np.uint8)
    draw_text(image, plain(text, WHITE), (x, y), font(14, True))
    assert image.shape == (40, 80, 3)


def test_letters_that_the_font_lacks_are_boxes() -> None:
    drawn = []
    for text in ("猫", "犬", "mug", "čaj", "чай", "τσάι"):
        image = np.zeros((30, 120, 3), np.uint8)
        draw_text(image, plain(text, WHITE), (4, 22), font(16))
        drawn.append(image.tobytes())
        assert image.any()
    assert drawn[0] == drawn[1]
    assert len(set(drawn)) == len(drawn) - 1


def test_lines_hold_all_words_in_order() -> None:
    lines = wrapped(plain(SAID, WHITE), font(18), 150, 9)
    assert " ".join(map(str, lines)) == SAID
    short = wrapped(plain(SAID, WHITE), font(18), 150, 2)
    assert len(short) == 2
    assert str(short[-1]).endswith("…")
    assert str(shortened(plain(SAID, WHITE), font(18), 5000)) == SAID


def test_a_word_that_is_too_long_is_cut() -> None:
    lines = wrapped(plain("x" * 60, WHITE), font(18), 100, 50)
    assert "".join(map(str, lines)) == "x" * 60
    assert len(lines) > 4


def test_text_is_as_large_as_fits_whole() -> None:
    sizes = [fitted(plain(SAID, WHITE), (40, 20, 10), False, width, 1)[0].size for width in (1000, 600, 60)]
    assert sizes == [40, 20, 10]
    face, (line,) = fitted(plain(SAID, WHITE), (40, 10), False, 60, 1)
    assert str(line).endswith("…")
    assert width_of(line, face) <= 60


def test_colors_stay_with_their_words() -> None:
    text = Text((("red ", (255, 0, 0)), ("blue words here", (0, 0, 255))))
    first, *rest = wrapped(text, font(16), 70, 5)
    assert [color for _, color in first.joined()] == [(255, 0, 0), (0, 0, 255)]
    assert {color for line in rest for _, color in line.joined()} == {(0, 0, 255)}


def test_a_text_is_one_short_line() -> None:
    assert on_one_line("a\nb\t c\x00d\u202ee") == "a b c d e"
    assert on_one_line("\ud800x") == "\ufffdx"
    assert len(on_one_line("y" * 10_000)) == MOST
