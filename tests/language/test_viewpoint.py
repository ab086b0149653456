"""Viewpoints named in sentences: split off where there is one, and refused where no map is at hand."""

from __future__ import annotations

import string

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from pipeline.language import parse
from pipeline.language.views import SpokenViewpoint, spoken_viewpoint
from pipeline.system import InputError
from pipeline.system.errors import Unsupported

ASKED = "the chair left of the table"
BOTH, ONE = SpokenViewpoint("door", "window"), SpokenViewpoint("door", None)


@pytest.mark.parametrize(
    ("text", "found"),
    [
        (f"standing at the door, facing the window, {ASKED}", BOTH),
        (f"Standing at the door and looking at the window: {ASKED}", BOTH),
        (f"if you are standing by the door, looking towards the window, {ASKED}", BOTH),
        (f"imagine you're sitting on a door facing the window. {ASKED}", BOTH),
        (f"when I stand at the door and I look at the window, {ASKED}", BOTH),
        (f"from the door, looking at the window: {ASKED}", BOTH),
        (f"{ASKED}, as seen from the door facing the window", BOTH),
        (f"{ASKED} when you are standing at the door facing the window.", BOTH),
        (f"as seen from the door, {ASKED}", ONE),
        (f"{ASKED} as seen from the door", ONE),
        (f"{ASKED} from the door's point of view", ONE),
        (f"from the perspective of the door, {ASKED}", ONE),
    ],
)
def test_a_viewpoint_is_split_off_and_needs_a_map(text: str, found: SpokenViewpoint) -> None:
    assert spoken_viewpoint(text) == (ASKED, found)
    with pytest.raises(Unsupported, match=r"with a map of the scene: `ask --world`"):
        parse(text)


@pytest.mark.parametrize(
    "text",
    [
        ASKED,
        f"as seen from the camera, {ASKED}",
        f"{ASKED} from the robot's point of view",
        f"from my point of view, {ASKED}",
        f"{ASKED}, seen from above",
        f"{ASKED} as viewed from the other side",
        "the person standing at the door facing the window",
        "the lamp standing on the table",
    ],
)
def test_the_cameras_view_and_directions_are_no_viewpoints(text: str) -> None:
    assert spoken_viewpoint(text) == (text, None)


NAMES = st.lists(st.text(string.ascii_lowercase, min_size=1, max_size=8), min_size=1, max_size=3).map(" ".join)


@given(NAMES, NAMES, NAMES)
@example("the", "a", "x")
@example("from", "facing", "when")
def test_whatever_the_names_are_a_viewpoint_is_found_or_none(at: str, facing: str, asked: str) -> None:
    rest, found = spoken_viewpoint(f"standing at the {at}, facing the {facing}: {asked}")
    if found is None:
        assert rest.startswith("standing")
    else:
        assert rest.strip()
        assert found.at.strip()


PIECES = (
    *("standing", "from", "at the", "facing", "seen", "as", ",", ":", "x", "y's", "view", "when", ".", "if"),
    *("point of view", "looking at"),
)


@given(st.text(max_size=120) | st.lists(st.sampled_from(PIECES), min_size=1, max_size=20).map(" ".join))
def test_any_text_is_split_or_refused(text: str) -> None:
    try:
        rest, found = spoken_viewpoint(text)
    except InputError:
        return
    assert rest in text
    assert (rest == text) == (found is None)
    assert found is None or all(name is None or (name in text and name.strip()) for name in (found.at, found.facing))
