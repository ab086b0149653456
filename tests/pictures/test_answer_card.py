"""Picture of an answer: every verdict of the demo's run, hostile words, no truth, no depth, no answer."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from test_ask import row, truth

from pipeline import Answer, import_records, open_run
from pipeline import open as open_dataset
from pipeline.answering.ask import ask
from pipeline.datasets import demo_labels, demo_run
from pipeline.diagnosis.verdict import VERDICTS
from pipeline.evaluation.run_folder import Run
from pipeline.geometry.frame import Frame
from pipeline.geometry.palette import ON_DARK, RGB
from pipeline.pictures.answer_card import BACK, EDGE, LEFT, MARKS, SIZE, STAGE, answer_picture
from pipeline.pictures.looks import frame_picture
from pipeline.proposals import AnnotationDetector

__all__ = ["row", "truth"]
LONG = "extraordinarily-well-upholstered-armchairs"
HOSTILE = "<b>\x00\u202e猫🪑\ud800" + "W" * 300


@cache
def run() -> Run:
    return open_run(demo_run())


@cache
def first(search: str) -> Answer:
    return run().failures(search)[0].answer


def checked(image: np.ndarray) -> np.ndarray:
    """The picture, whose margins and gutters are empty: nothing is wider or longer than its place."""
    assert image.shape == (SIZE[1], SIZE[0], 3)
    assert image.dtype == np.uint8
    x, y, _, height = STAGE
    for part in (
        image[:, : EDGE - 2],
        image[:, SIZE[0] - EDGE + 2 :],
        image[:20],
        image[SIZE[1] - 14 :],
        image[y : y + height + 4, EDGE + LEFT + 4 : x - 1],
        image[y + height + 8 : y + height + 16],
    ):
        assert (part == BACK).all()
    return image


def has(image: np.ndarray, color: RGB, least: int = 20) -> bool:
    return int((image == color).all(axis=2).sum()) >= least


def occurring() -> list[str]:
    return [v for v in VERDICTS if v in run().verdicts]


def test_the_run_has_most_verdicts() -> None:
    assert len(occurring()) >= 10


@pytest.mark.parametrize("verdict", occurring())
def test_every_verdict_has_its_picture(verdict: str) -> None:
    answer = first(f"verdict:{verdict} -lucky" if verdict == "CORRECT" else f"verdict:{verdict}")
    image = checked(answer_picture(answer, dataset="demo"))
    assert has(image, MARKS[answer.story.tone][0])
    for named in ("target", "reference") if answer.pairs else ():
        assert has(image, ON_DARK[named]), named
    if verdict != "CORRECT":
        assert has(image, ON_DARK["truth"])
    np.testing.assert_array_equal(image, answer_picture(answer, dataset="demo"))


def test_a_right_answer_needs_no_second_box() -> None:
    x, y, width, height = STAGE
    stage = answer_picture(first("verdict:CORRECT -lucky"))[y : y + height, x : x + width]
    assert not has(stage, ON_DARK["truth"], 5)


@pytest.mark.parametrize("text", [HOSTILE, "mug left of " * 40, "", " ", LONG * 3])
@pytest.mark.parametrize("search", ["verdict:OPM-CONF", "verdict:PARSE"])
def test_any_words_stay_in_their_place(search: str, text: str) -> None:
    answer = first(search)
    told = replace(answer.story, head=f"Wrong {text}", sentence=f"The “{text}” is {text}.", mend=f"It is {text}.")
    assert answer.diagnosis is not None
    trace = answer.trace
    if trace is not None:
        named = tuple(replace(o, label=text or LONG) for o in trace.objects)
        trace = replace(trace, objects=named, query=replace(trace.query, text=text))
    odd = replace(answer, text=text, trace=trace, diagnosis=replace(answer.diagnosis, story=told))
    checked(answer_picture(odd, dataset=text * 3, caption=text[:20]))


def test_names_of_forty_letters(row: Frame) -> None:
    long = replace(row, annotations=tuple(replace(a, label=f"{LONG[:38]} {a.index % 3}") for a in row.annotations))
    target, reference = (long.annotations[k].label for k in (0, 1))
    answer = open_dataset(long).ask(0, f"{target} left of the {reference}")
    assert answer.pairs
    assert max(len(o.label) for o in answer.objects) == 40
    checked(answer_picture(answer, long, dataset=LONG))


def test_an_answer_without_any_truth(row: Frame, truth: AnnotationDetector) -> None:
    for text in ("mug right of the laptop", "mug between the book and the laptop", "lamp left of the mug", "mug"):
        checked(answer_picture(Answer(text, ask(row, text, truth))))


@pytest.mark.filterwarnings("ignore:the file has lines for 1")
@pytest.mark.parametrize("answered", [{"point": [320, 240]}, {"box": [300, 200, 380, 300]}])
def test_what_an_imported_answer_points_at_is_drawn(answered: dict[str, list[int]], tmp_path: Path) -> None:
    row = run().failures("verdict:OPM-CONF")[0].row
    lines = [{"spatialviz_predictions": 1}, {"frame": row["frame"], "text": row["text"], "answer": answered}]
    (tmp_path / "lines.jsonl").write_text("\n".join(map(json.dumps, lines)))
    import_records(tmp_path / "lines.jsonl", "demo", demo_labels(), tmp_path / "run", plots=False)
    image = checked(answer_picture(open_run(tmp_path / "run").failures()[0].answer))
    x, y, width, height = STAGE
    assert has(image[y : y + height, x : x + width], ON_DARK["target"])


@pytest.mark.parametrize(("width", "height"), [(24, 18), (40, 400), (1600, 40)])
def test_frames_of_any_shape(width: int, height: int) -> None:
    rgb = np.random.default_rng(0).integers(0, 255, (height, width, 3), np.uint8)
    masks = np.zeros((2, height, width), np.bool_)
    masks[0, :, : width // 3], masks[1, :, -width // 3 :] = True, True
    K = np.array([[width, 0, width / 2], [0, width, height / 2], [0, 0, 1.0]])
    depth = np.full((height, width), 1.5, np.float32)
    frame = Frame.of_arrays(rgb, depth, K, masks=masks, names=["mug", "laptop"], up=(0, -1, 0))
    checked(answer_picture(open_dataset(frame).ask(0, "mug left of the laptop")))


def test_a_question_that_was_refused() -> None:
    frame = open_dataset("demo").frames[0]
    refused = Answer("what is this", problem="'what is this' cannot be read")
    with_frame, without = (checked(answer_picture(refused, f)) for f in (frame, None))
    assert with_frame[300, 800].tolist() != without[300, 800].tolist()


def test_an_object_without_depth_is_shown_in_the_picture(row: Frame, truth: AnnotationDetector) -> None:
    mask = row.annotations[1].mask
    assert mask is not None
    blind = Frame(row.id, row.rgb, np.where(mask, 0, row.depth), row.camera, row.annotations)
    image = checked(answer_picture(Answer("book left of the laptop", ask(blind, "book left of the laptop", truth))))
    assert has(image, ON_DARK["target"])


def test_the_frame_alone_is_no_larger_than_asked() -> None:
    answer = first("verdict:OPM-CONF")
    assert answer.trace is not None
    image = frame_picture(answer, answer.trace.frame, 320)
    assert image.shape == (240, 320, 3)
    assert has(image, ON_DARK["target"])
