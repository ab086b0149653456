"""A view's string comes back as the same view, and what is none is refused."""

from __future__ import annotations

import base64
import json
import zlib
from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.diagnosis import CameraView, Edits, ViewState, decode, encode
from pipeline.diagnosis.whatif.state import LARGEST_CONTENT, read_state, state_record
from pipeline.geometry import Box3D
from pipeline.system import InputError

texts = st.text(st.characters(exclude_categories=["Cs"]), max_size=30)
numbers = st.floats(-1e5, 1e5)
vectors = st.tuples(numbers, numbers, numbers)


@st.composite
def views(draw: st.DrawFn) -> ViewState:
    edits = Edits()
    if draw(st.booleans()):
        center = np.array([draw(st.floats(-900, 900)) for _ in range(3)])
        edits = edits.with_box("#1", Box3D(center, np.eye(3), np.abs(center)))
        edits = edits.with_mask("mug/2", np.eye(7, 9, dtype=bool))
        edits = edits.with_settings("profile", gap_switch_band=(0.01, draw(st.floats(0.01, 1))))
    return ViewState(
        dataset=draw(texts),
        frame=draw(texts),
        expression=draw(texts),
        selection=tuple(draw(st.lists(texts, max_size=4))),
        pair=draw(st.none() | st.tuples(texts, texts)),
        camera=draw(st.none() | st.builds(CameraView, vectors, vectors, vectors)),
        toggles=draw(st.dictionaries(texts, st.booleans() | st.integers(-9, 9) | numbers | texts, max_size=4)),
        edits=edits,
        run=draw(st.none() | texts),
        expression_id=draw(st.none() | texts),
        colors=draw(st.none() | texts),
    )


@given(views())
def test_there_and_back(state: ViewState) -> None:
    text = encode(state)
    assert text.startswith("sv1:")
    assert text.isascii()
    assert not any(c in text for c in "+/= \n")
    back = decode(text)
    assert back == state
    assert {k: type(v) for k, v in back.toggles.items()} == {k: type(v) for k, v in state.toggles.items()}
    assert encode(back) == text
    assert decode("\n " + "\n".join(text[i : i + 20] for i in range(0, len(text), 20)) + " ") == state
    assert read_state(json.dumps(state_record(state))) == state


@given(views(), st.data())
def test_damage_is_never_another_view(state: ViewState, data: st.DataObject) -> None:
    text = encode(state)
    at = data.draw(st.integers(0, len(text) - 1))
    broken = text[:at] + data.draw(st.sampled_from("Aa0-_:é")) + text[at + 1 :]
    for damaged in (broken, text[:at], text + "AAAA"):
        # A mark at the end may stand for bits that are not read; nothing else may pass.
        with suppress(InputError):
            assert decode(damaged) == state


def _packed(content: bytes, version: str = "sv1:") -> str:
    return version + base64.urlsafe_b64encode(zlib.compress(content)).decode().rstrip("=")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "no state string"),
        ("hello", "no state string"),
        ("sv1:", "damaged"),
        ("sv1:####", "damaged"),
        (_packed(b"{}", "sv2:"), "newer spatialviz"),
        (_packed(b"{}", "sv0:"), "another version"),
        (_packed(b"{}"), "dataset"),
        (_packed(b"not json"), "JSON"),
        (_packed(b"[" * 200_000), "JSON"),
        (_packed(b'{"dataset": "a", "frame": "b", "more": 1}'), "more"),
        (_packed(b'{"dataset": "a", "frame": "b", "edits": {"k": 0}}'), "edits.k"),
        (_packed(b'{"dataset": "a", "frame": "b", "edits": {"profile": {"cone": 1000}}}'), "cone"),
        (_packed(b'{"dataset": "a", "frame": "\xff"}'), "JSON"),
        (_packed(b'{"dataset": "a", "frame": "b"}')[:-4], "damaged"),
    ],
)
def test_what_is_no_view_is_refused(text: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        decode(text)


@pytest.mark.parametrize("times", [1, 4])
def test_what_unpacks_to_too_much_is_refused(times: int) -> None:
    with pytest.raises(InputError, match="too much"):
        decode(_packed(b" " * (times * LARGEST_CONTENT + 1)))


def test_a_string_that_is_too_long_is_refused() -> None:
    with pytest.raises(InputError, match="too long"):
        decode("sv1:" + "A" * (4 * 2**20))


def test_what_cannot_be_written_is_refused() -> None:
    with pytest.raises(InputError):
        encode(ViewState("a", "b", camera=CameraView((float("nan"), 0, 0), (0, 0, 0), (0, 0, 1))))
    with pytest.raises(InputError):
        encode(ViewState("a", "b", expression="\ud800"))
