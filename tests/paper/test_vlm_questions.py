"""What a vision-language model is asked about a picture, and what is made of its answers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from chat_server import ChatServer, Make, Script, completion, error
from scenes import frame_of, upright

from pipeline.evaluation.place_reading import told_reading
from pipeline.geometry import Frame
from pipeline.paper.pointing import PADDING, point_by_model, view_of
from pipeline.paper.systems import score_pairs
from pipeline.system import InputError


@pytest.fixture(scope="module")
def frame() -> Frame:
    boxes = [upright((x, 1.0, z), (0.3, 0.4, 0.3)) for x, z in ((-0.6, 2.5), (0.0, 2.0), (0.6, 2.5))]
    return frame_of(boxes, ["mug", "laptop", "mug"])


def test_pictures_become_square_and_boxes_find_back() -> None:
    rng = np.random.default_rng(3)
    for height, width in ((480, 640), (640, 480), (1080, 1920), (100, 100), (5, 3)):
        rgb = rng.integers(0, 256, (height, width, 3)).astype(np.uint8)
        view = view_of(rgb)
        side = max(height, width)
        assert view.size == (side, side)
        x, y = view.offset
        assert np.array_equal(view.picture.rgb[y : y + height, x : x + width], rgb)
        if y:
            assert (view.picture.rgb[0] == PADDING).all()
        found = view.to_frame((x / side, y / side, 1, 1))
        assert found is not None
        assert np.abs(found - (0, 0, width, height)).max() < 1e-3
        assert view.to_frame((0.4, 0, 0.6, y / side)) is None


def test_relations_by_yes_and_no(server: ChatServer, client_of: Make, frame: Frame) -> None:
    said = {
        "Is the mug left of the laptop?": "**Yes**",
        "Is the mug behind the laptop?": "No, it is not.",
        "Is the laptop left of the mug?": "Perhaps.",
        "Is the laptop behind the mug?": "Yes and no.",
    }
    server.answer = lambda request: said[request.prompt.split("\n")[0]]
    pairs = np.array([[0, 1], [1, 0], [2, 1]])
    found = score_pairs(client_of(), frame, frame.annotations, pairs, ("left", "behind"))
    assert found.probabilities.tolist() == [[1, 0], [0.5, 0.5], [1, 0]]
    assert found.texts[1] == ("Perhaps.", "Yes and no.")
    assert found.reasons == {"neither yes nor no": 1, "both yes and no": 1}
    # Both mugs ask the same words about the same picture.
    assert len(server.requests) == 4
    assert server.requests[0].prompt.endswith("\nAnswer the question using a single word or phrase.")
    assert server.requests[0].picture.shape == (320, 320, 3)


def test_relations_go_on_without_some_answers(server: ChatServer, client_of: Make, frame: Frame) -> None:
    replies: dict[str, Script] = {"left": error(400, "refused"), "right": completion("The mug", finish="length")}
    server.answer = lambda request: next((r for word, r in replies.items() if f" {word} of" in request.prompt), "No")
    found = score_pairs(client_of(), frame, frame.annotations, np.array([[0, 1]]), ("left", "right", "on"))
    assert found.probabilities.tolist() == [[0.5, 0.5, 0.0]]
    assert found.reasons == {"the server failed": 1, "neither yes nor no, cut off by max_tokens": 1}


def test_names_that_cannot_be_asked_and_no_pairs(server: ChatServer, client_of: Make, frame: Frame) -> None:
    odd = [replace(frame.annotations[0], label="<image>"), frame.annotations[1]]
    found = score_pairs(client_of(), frame, odd, np.array([[0, 1]]), ("left",))
    assert found.probabilities.tolist() == [[0.5]]
    assert found.reasons == {"a name that cannot stand in a question": 1}
    empty = score_pairs(client_of(), frame, frame.annotations, np.zeros((0, 2), int), ("left", "on"))
    assert empty.probabilities.shape == (0, 2)
    assert server.requests == []


def test_grounding_finds_the_box_in_the_frame(server: ChatServer, client_of: Make, frame: Frame) -> None:
    """The picture of 320 x 240 is sent as a square of 320, with 40 rows of padding above and below."""
    server.script = ["[0.25, 0.25, 0.5, 0.5]"]
    found = point_by_model(client_of(), frame, ["the mug left of the laptop"])[0]
    assert found.box is not None
    assert found.box == pytest.approx([80, 40, 160, 120])
    assert found.problem is None
    assert server.requests[0].prompt == (
        "Please provide the bounding box coordinate of the region this sentence describes: the mug left of the laptop"
    )
    assert server.requests[0].picture.shape == (320, 320, 3)


def test_grounding_reads_other_scales_and_says_why_there_is_no_box(
    server: ChatServer, client_of: Make, frame: Frame
) -> None:
    said: dict[str, Script] = {
        "a": "[250, 250, 500, 500]",
        "b": "I see no such thing.",
        "c": "[0.1, 0.0, 0.9, 0.1]",
        "d": "[0.2, 0.1, 0.9",
        "f": "[0.5, 0.5, 0.25, 0.25]",
        "g": "[0.6, 0.5]",
        "h": "[5000, 300, 6000, 900]",
        "e": error(400, "refused"),
    }
    server.answer = lambda request: said[request.prompt[-1]]
    boxes = point_by_model(client_of(), frame, list("abce"))
    assert boxes[0].box == pytest.approx([80, 40, 160, 120])
    assert [g.problem for g in boxes[1:2]] == ["no box"]
    assert boxes[2].box is None
    assert "refused" in str(boxes[3].problem)
    padded = point_by_model(client_of(), frame, ["c", "d"])
    assert [g.problem for g in padded] == ["an empty box, or one in the padding", "3 numbers, not the 4 of a box"]
    put_right, point, far = point_by_model(client_of(), frame, ["f", "g", "h"], readings=[told_reading("shares,xyxy")])
    assert put_right.box == pytest.approx([80, 40, 160, 120])
    assert point.problem == "a point, no box"
    assert "far outside" in str(far.problem)
    asked = len(server.requests)
    for text in (" ", "the <image> there"):
        with pytest.raises(InputError):
            point_by_model(client_of(), frame, [text])
    assert len(server.requests) == asked
