"""The strip of frames: what it lists, its names and marks by range, its pictures by address."""

from __future__ import annotations

import asyncio
from functools import cache
from typing import Any

import cv2
import numpy as np
import pytest

from pipeline.answering.frame_store import FrameStore
from pipeline.answering.pipeline import Pipeline, open_pipeline
from pipeline.datasets import MOVES
from pipeline.datasets.demo import demo_run
from pipeline.evaluation.run_folder import Run, open_run
from spatialviz.app.browse import Browse
from spatialviz.app.channel import Call, Command
from spatialviz.app.context import Context, Idle, Shared, commands_of
from spatialviz.app.frames import FramePictures
from spatialviz.app.keys import keys_of, meant
from spatialviz.app.layout import BrowserPage
from spatialviz.app.toolbar import moves_html


@cache
def opened() -> tuple[Run, Pipeline]:
    return open_run(demo_run()), open_pipeline("demo")


NOTHING_DONE: Any = dict.fromkeys(("receive", "clicked", "draw", "handle", "open_frame"), lambda *_, **__: None)


class Desk(Context):
    """A page without a browser."""

    def __init__(self, runs: dict[str, Run]) -> None:
        super().__init__("0" * 32, Shared(FrameStore({"demo": opened()[1]}), runs, {}, {}, {}), **NOTHING_DONE)
        self.calls: dict[str, Any] = {}
        self.page = BrowserPage(lambda m: self.calls.update({m.name: m.data}) if isinstance(m, Call) else None)
        self.browse = Browse(self)
        self.browse.follow()

    def said(self) -> Any:
        return self.calls["strip"]

    def rows(self, first: int, after: int) -> list[list[Any]]:
        self.calls.pop("frameRows", None)
        self.browse.rows(first, after)
        return self.calls["frameRows"]["rows"]


def test_rows_are_the_frames_with_their_answers_right_and_wrong() -> None:
    desk, run = Desk({"demo": opened()[0]}), opened()[0]
    rows = desk.rows(0, 60)
    ids = opened()[1].dataset.frame_ids
    assert [row[:2] for row in rows] == [[n, ids[n]] for n in range(len(ids))]
    right = np.array(run.records.column("set_correct").to_pylist(), bool)
    frames = np.array(run.records.column("frame").to_pylist())
    for _, frame, well, bad in rows:
        assert (well, bad) == (right[frames == frame].sum(), (~right[frames == frame]).sum())
    assert sum(well + bad for _, _, well, bad in rows) == run.records.num_rows
    assert desk.rows(3, 5) == rows[3:5]
    assert desk.rows(900, 905) == []


def test_what_is_listed_follows_the_choice_and_the_frame_is_found_in_it() -> None:
    desk = Desk({"demo": opened()[0]})
    everything = desk.rows(0, 60)
    assert desk.said()["kinds"] == {"all": "all", "failed": "with failures", "right": "all right"}
    desk.browse.choose("failed")
    failed = [row for row in everything if row[3]]
    assert desk.rows(0, 60) == failed
    assert desk.said()["count"] == len(failed)
    desk.browse.choose("right")
    assert desk.said()["count"] == len(everything) - len(failed)
    assert (desk.said()["at"] >= 0) == (everything[0] not in failed)


def test_without_a_run_there_is_nothing_to_choose_by() -> None:
    desk = Desk({})
    assert desk.said()["kinds"] == {}
    desk.browse.choose("failed")
    assert desk.said()["count"] == desk.said()["all"]
    assert desk.rows(0, 2)[0][2:] == [0, 0]


def test_a_robots_moves_have_buttons_and_keys_where_the_dataset_tells_them(monkeypatch: pytest.MonkeyPatch) -> None:
    desk, dataset = Desk({}), opened()[1].dataset
    there: list[str] = []
    desk.open_frame = there.append
    assert not desk.shared.moving
    desk.browse.move("forward")
    assert there == []
    leads = {"forward": dataset.frame_ids[1]}
    monkeypatch.setattr(type(dataset), "moves", lambda *_: leads, raising=False)
    assert desk.shared.moving
    buttons = moves_html(leads).html
    assert buttons.count("<button") == len(keys_of(False)["Moves"]) == 6
    assert buttons.count("disabled") == 5
    desk.browse.move("forward")
    desk.browse.move("left")
    assert there == [leads["forward"]]
    assert not keys_of(False, moving=False)["Moves"]
    assert {meant(Command("key", (str(n),)), False).arguments for n in range(4, 10)} == {(m,) for m in MOVES}


@pytest.mark.parametrize(
    "text", [*(f"frame-rows:{said}" for said in ("", "1", "a,b", "-1,4", "1,2,3", "1e3,2")), "frames-of:nonsense"]
)
def test_what_is_no_range_or_choice_is_not_answered(text: str) -> None:
    desk, said = Desk({}), Command.read(text)
    desk.calls.clear()
    with pytest.raises(Idle):
        commands_of(desk.browse)[said.name](*said.arguments)
    assert not desk.calls


def test_pictures_are_of_the_frame_and_of_the_widths_that_there_are() -> None:
    source = opened()[1]
    pictures = FramePictures({"demo": source})
    frame = source.dataset.frame_ids[2]
    assert pictures.url("demo", frame) == "/app/frame/0/2/160.jpg"
    found = asyncio.run(pictures.get("/app/frame/0/2/480.jpg"))
    assert found is not None
    picture = cv2.imdecode(np.frombuffer(found, np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    rgb = source.dataset.load(frame).rgb
    assert picture.shape[1] == 480
    small = cv2.resize(rgb, picture.shape[1::-1], interpolation=cv2.INTER_AREA)[..., ::-1]
    assert np.abs(small.astype(int) - picture).mean() < 4
    for path in ("0/2/481.jpg", "1/2/160.jpg", "0/99999/160.jpg", "0/2/160.png", "0/../160.jpg", "a/2/160.jpg"):
        assert asyncio.run(pictures.get("/app/frame/" + path)) is None
