"""What a vision-language model is asked about a picture, and what is made of its answers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from chat_server import ChatServer, Make, Script, completion, error, flat
from scenes import frame_of, upright

from pipeline.geometry import Frame
from pipeline.paper.questions import GroundingConfig, RelationConfig, ground_many, score_pairs
from pipeline.paper.view import PADDING, marked, view_of
from pipeline.system import InputError


@pytest.fixture(scope="module")
def frame() -> Frame:
    boxes = [upright((x, 1.0, z), (0.3, 0.4, 0.3)) for x, z in ((-0.6, 2.5), (0.0, 2.0), (0.6, 2.5))]
    return frame_of(boxes, ["mug", "laptop", "mug"])


def test_pictures_become_square_and_boxes_find_back() -> None:
    rng = np.random.default_rng(3)
    for height, width, most in ((480, 640, None), (640, 480, 336), (1080, 1920, 672), (100, 100, None), (5, 3, 2)):
        rgb = rng.integers(0, 256, (height, width, 3)).astype(np.uint8)
        view = view_of(rgb, max_side=most)
        side = view.size[0]
        assert view.size == (side, side)
        assert side == min(max(height, width), most or 10_000)
        x, y = map(int, view.offset)
        if most is None:
            assert np.array_equal(view.picture.rgb[y : y + height, x : x + width], rgb)
        if y:
            assert (view.picture.rgb[0] == PADDING).all()
        found = view.to_frame((x / side, y / side, 1, 1))
        assert found is not None
        assert np.abs(found - (0, 0, width, height)).max() < 1e-3
        assert view.to_frame((0.4, 0, 0.6, y / side)) is None
    plain = view_of(flat(9, 48, 64), square=False)
    assert plain.size == (64, 48)
    assert plain.to_frame((0.25, 0.5, 0.5, 1)) == pytest.approx([16, 24, 32, 48])


def test_marks_are_drawn_on_the_boxes_and_nowhere_else() -> None:
    rgb = flat(200, 200, 300)
    boxes = [np.array([20, 30, 120, 130], np.float32), np.array([250, 150, 400, 260], np.float32)]
    image = marked(rgb, boxes)
    assert (rgb == 200).all()
    changed = (image != 200).any(axis=2)
    for x0, y0, x1, y1 in np.clip(boxes, 0, (300, 200, 300, 200)).astype(int):
        assert changed[y0:y1, x0].all()
        assert changed[y1 - 1, x0:x1].all()
        changed[y0 - 2 : y1 + 2, x0 - 2 : x1 + 2] = False
    # The number of a box at the corner is moved inside the picture.
    changed[165:, 250:] = changed[165:, 220:] = False
    assert not changed.any()


def test_relations_by_yes_and_no(server: ChatServer, client_of: Make, frame: Frame) -> None:
    said = {
        "Is the mug left of the laptop?": "**Yes**",
        "Is the mug behind the laptop?": "No, it is not.",
        "Is the laptop left of the mug?": "Perhaps.",
        "Is the laptop behind the mug?": "Yes and no.",
    }
    server.answer = lambda request: said[request.prompt.split("\n")[0]]
    pairs = np.array([[0, 1], [1, 0], [2, 1]])
    seen: list[tuple[int, int]] = []
    found = score_pairs(
        client_of(), frame, frame.annotations, pairs, ("left", "behind"), progress=lambda *n: seen.append(n)
    )
    assert found.probabilities.tolist() == [[1, 0], [0.5, 0.5], [1, 0]]
    assert found.known.tolist() == [[True, True], [False, False], [True, True]]
    assert found.texts[1] == ("Perhaps.", "Yes and no.")
    assert found.reasons == {"neither yes nor no": 1, "both yes and no": 1}
    assert seen == [(n, 4) for n in (1, 2, 3, 4)]
    assert found.ambiguous.all()
    assert not found.by_logprobs.any()
    # Both mugs ask the same words about the same picture.
    assert len(server.requests) == 4
    assert server.requests[0].prompt.endswith("\nAnswer the question using a single word or phrase.")
    assert server.requests[0].picture.shape == (320, 320, 3)
    assert not any("logprobs" in r.body for r in server.requests)


def test_relations_of_marked_things(server: ChatServer, client_of: Make, frame: Frame) -> None:
    config = RelationConfig(mark=True, square=False)
    found = score_pairs(client_of(), frame, frame.annotations, [(0, 1), (2, 1)], ("left", "front"), config=config)
    assert found.known.all()
    assert not found.ambiguous.any()
    assert {r.prompt.split("\n")[0] for r in server.requests} == {
        "Is the mug (box 1) left of the laptop (box 2)?",
        "Is the mug (box 1) in front of the laptop (box 2)?",
    }
    assert len(server.requests) == 4
    assert len({r.picture.tobytes() for r in server.requests}) == 2
    assert server.requests[0].picture.shape == frame.rgb.shape


def test_relations_by_log_probabilities(server: ChatServer, client_of: Make, frame: Frame) -> None:
    rows = [
        {"token": "\n", "logprob": -0.1, "top_logprobs": []},
        {
            "token": "Yes",
            "logprob": np.log(0.5),
            "top_logprobs": [
                {"token": t, "logprob": float(np.log(p))}
                for t, p in (("Yes", 0.5), ("No", 0.2), (" yes", 0.1), ("Maybe", 0.1))
            ],
        },
    ]
    server.script = [completion("Yes", logprobs={"content": rows}), completion("No", logprobs=None)]
    config = RelationConfig(logprobs=True, workers=1)
    found = score_pairs(client_of(), frame, frame.annotations, [(0, 1)], ("left", "right"), config=config)
    assert found.probabilities == pytest.approx(np.array([[0.75, 0.0]]))
    assert found.by_logprobs.tolist() == [[True, False]]
    assert server.requests[0].body["logprobs"] is True


def test_relations_go_on_without_some_answers(server: ChatServer, client_of: Make, frame: Frame) -> None:
    replies: dict[str, Script] = {"left": error(400, "refused"), "right": completion("The mug", finish="length")}
    server.answer = lambda request: next((r for word, r in replies.items() if f" {word} of" in request.prompt), "No")
    config = RelationConfig(keep_going=True)
    found = score_pairs(client_of(), frame, frame.annotations, [(0, 1)], ("left", "right", "on"), config=config)
    assert found.probabilities.tolist() == [[0.5, 0.5, 0.0]]
    assert found.reasons == {"the server failed": 1, "neither yes nor no, cut off by max_tokens": 1}


def test_names_that_cannot_be_asked_and_pairs_that_are_none(server: ChatServer, client_of: Make, frame: Frame) -> None:
    odd = [replace(frame.annotations[0], label="<image>"), frame.annotations[1]]
    for mark in (False, True):
        found = score_pairs(client_of(), frame, odd, [(0, 1)], ("left",), config=RelationConfig(mark=mark))
        assert found.probabilities.tolist() == [[0.5]]
        assert found.reasons == {"a name that cannot stand in a question": 1}
    empty = score_pairs(client_of(), frame, frame.annotations, np.zeros((0, 2), int), ("left", "on"))
    assert empty.probabilities.shape == (0, 2)
    assert empty.ambiguous.shape == (0,)
    assert server.requests == []
    for pairs, relations in (([(0, 3)], ["left"]), ([(-1, 0)], ["left"]), ([(0, 1, 2)], ["left"]), ([(0, 1)], ["up"])):
        with pytest.raises(InputError):
            score_pairs(client_of(), frame, frame.annotations, pairs, relations)  # type: ignore[arg-type]


def test_grounding_finds_the_box_in_the_frame(server: ChatServer, client_of: Make, frame: Frame) -> None:
    """The picture of 320 x 240 is sent as a square of 320, with 40 rows of padding above and below."""
    server.script = ["[0.25, 0.25, 0.5, 0.5]"]
    found = ground_many(client_of(), frame, ["the mug left of the laptop"])[0]
    assert found.box is not None
    assert found.box == pytest.approx([80, 40, 160, 120])
    assert (found.raw, found.reason, found.notes) == ("[0.25, 0.25, 0.5, 0.5]", None, ())
    assert server.requests[0].prompt == (
        "Please provide the bounding box coordinate of the region this sentence describes: the mug left of the laptop"
    )
    assert server.requests[0].picture.shape == (320, 320, 3)


def test_grounding_reads_other_scales_and_says_why_there_is_no_box(
    server: ChatServer, client_of: Make, frame: Frame
) -> None:
    said: dict[str, Script] = {
        "a": "[250, 250, 500, 500]", "b": "I see no such thing.", "c": "[0.1, 0.0, 0.9, 0.1]", "d": "[0.2, 0.1, 0.9",
        "e": error(400, "refused"),
    }  # fmt: skip
    server.answer = lambda request: said[request.prompt[-1]]
    config = GroundingConfig(box_scale=1000, square=False, keep_going=True)
    boxes = ground_many(client_of(), frame, list("abce"), config=config)
    assert boxes[0].box == pytest.approx([80, 60, 160, 120])
    assert [g.reason for g in boxes[1:2]] == ["no box"]
    assert boxes[2].box is not None
    assert boxes[2].notes == ("shares, not numbers up to 1000",)
    assert "refused" in str(boxes[3].reason)
    padded = ground_many(client_of(), frame, ["c", "d"])
    assert [g.reason for g in padded] == ["a box outside the frame, in the padding", "3 numbers, not the 4 of a box"]
    asked = len(server.requests)
    with pytest.raises(InputError, match="scale"):
        ground_many(client_of(), frame, ["a"], config=GroundingConfig(box_scale=-1))
    for text in (" ", "the <image> there"):
        with pytest.raises(InputError):
            ground_many(client_of(), frame, [text])
    assert len(server.requests) == asked
