"""The timeline: sent once, a byte a frame; steps, counts by request, pictures by address."""

from __future__ import annotations

import asyncio
import base64
import re
import threading
from concurrent.futures import Future
from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from pipeline.answering.frame_store import FrameStore
from pipeline.answering.pipeline import Pipeline, open_pipeline
from pipeline.datasets import MOVES
from pipeline.datasets.base import scene_of
from pipeline.datasets.demo import demo_run
from pipeline.datasets.odd_frames import OddFrame
from pipeline.datasets.timeline import ALL, UNKNOWN
from pipeline.evaluation.run_figures import Listing, figures_of
from pipeline.evaluation.run_folder import Run, open_run
from pipeline.evaluation.search import FAILURES
from spatialviz.app.browse import Browse, listed_words
from spatialviz.app.channel import Call, Command, Patch, write
from spatialviz.app.context import Context, Idle, Shared, commands_of
from spatialviz.app.figures_html import Sample, summary_html
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

    def __init__(self, runs: dict[str, Run], source: Pipeline | None = None) -> None:
        pipeline = opened()[1] if source is None else source
        super().__init__("0" * 32, Shared(FrameStore({"demo": pipeline}), runs, {}, {}, {}), **NOTHING_DONE)
        self.sent: list[Any] = []
        self.page = BrowserPage(self.sent.append)
        self.browse = Browse(self)
        if runs:
            self.state = replace(self.state, listing=Listing(figures_of(runs["demo"], None)))

    def calls(self, name: str) -> list[Any]:
        return [m.data for m in self.sent if isinstance(m, Call) and m.name == name]

    @property
    def words(self) -> str:
        return "".join(html for m in self.sent if isinstance(m, Patch) for _, html in m.parts)

    def rows(self, *numbers: int) -> list[list[Any]]:
        self.browse.rows(list(numbers))
        return self.calls("frameRows")[-1]


def shares(data: dict[str, Any]) -> np.ndarray:
    return np.frombuffer(base64.b64decode(data["shares"]), np.uint8)


def test_the_timeline_is_of_the_wrong_answers_of_a_run() -> None:
    run, ids = opened()[0], opened()[1].dataset.frame_ids
    desk = Desk({"demo": run})
    desk.browse.follow()
    (line,) = desk.calls("timeline")
    right = np.array(run.records.column("set_correct").to_pylist(), bool)
    frames = np.array(run.records.column("frame").to_pylist())
    wrong = [float((~right[frames == i]).mean()) for i in ids]
    assert line["kind"] == "wrong"
    np.testing.assert_allclose(shares(line) / ALL, wrong, atol=1 / ALL)
    assert line["scenes"][0] == (0, scene_of(opened()[1].dataset, ids[0]))
    rows = desk.rows(3, 0, 900)
    assert [row[:2] for row in rows] == [[3, ids[3]], [0, ids[0]]]
    assert [row[3] / (row[2] + row[3]) for row in rows] == [wrong[3], wrong[0]]


def test_a_step_sends_where_it_leads_and_not_the_frames_again() -> None:
    ids = tuple(f"{k // 500:04d}/{k:06d}" for k in range(100_000))
    dataset: Any = SimpleNamespace(frame_ids=ids, root=opened()[1].dataset.root)
    source = replace(opened()[1], dataset=dataset)
    desk = Desk({"demo": replace(opened()[0])}, source)
    vars(desk.run)["frame_counts"] = {i: (k % 7, k % 3) for k, i in enumerate(ids)}
    desk.browse.follow()
    assert sum(len(write(m)) for m in desk.sent) < 200_000
    for k in (1, 50_000):
        desk.sent.clear()
        desk.state = replace(desk.state, frame_id=ids[k])
        desk.browse.follow()
        assert {m.name for m in desk.sent if isinstance(m, Call)} == {"frameAt"}
        assert sum(len(write(m)) for m in desk.sent) < 4000


def test_in_label_a_settled_item_sends_its_frame_alone() -> None:
    desk, ids = Desk({}), opened()[1].dataset.frame_ids
    label: Any = SimpleNamespace()
    desk.state = replace(desk.state, labels=label, correctable=True)
    desk.reviewed = dict.fromkeys(ids, (0, 2))
    desk.browse.follow()
    assert desk.calls("timeline")[-1]["kind"] == "open"
    assert f"1 of {len(ids)} with open items" in desk.words
    desk.reviewed = {**desk.reviewed, ids[2]: (2, 0)}
    desk.browse.follow()
    assert desk.calls("frameShares") == [[[2, 0]]]
    there: list[str] = []
    desk.open_frame = there.append
    desk.state = replace(desk.state, frame_id=ids[1])
    desk.browse.step_open(1)
    desk.browse.step_open(-1)
    assert there == [ids[3], ids[0]]
    # Who connects again is sent what there is now.
    desk.sent.clear()
    desk.page.again()
    assert shares(desk.calls("timeline")[-1])[2] == 0


def test_without_a_run_it_is_of_the_depth_once_that_is_read() -> None:
    desk, ids = Desk({}), opened()[1].dataset.frame_ids
    read = Future[Any]()
    desk.shared.pictures._odd["demo"] = read
    desk.browse.follow()
    assert not desk.calls("timeline")[-1]["read"]
    assert set(shares(desk.calls("timeline")[-1])) == {UNKNOWN}
    assert "Frame 1 of" in desk.words
    done, odd = (
        threading.Event(),
        tuple(OddFrame(i, 0.5, 2.0 * (k == 3), ("it turns",) * (k == 3)) for k, i in enumerate(ids)),
    )
    read.set_result(odd)
    desk.post(done.set)
    assert done.wait(60)
    assert desk.calls("timeline")[-1]["read"]
    assert set(shares(desk.calls("timeline")[-1])) == {127}
    assert desk.calls("oddFrames")[-1] == {"name": "demo", "frames": [(3, "it turns")]}


@pytest.mark.parametrize(
    ("query", "place", "words"),
    [
        (FAILURES, 2, "Failure 3 of 505"),
        (FAILURES, None, "505 failures"),
        ("relation:left", 0, "1 of 505 found"),
        ("", None, "505 found"),
    ],
)
def test_the_place_in_the_list_of_the_run(query: str, place: int | None, words: str) -> None:
    assert listed_words(Listing(figures_of(opened()[0], None), query, found=np.arange(505)), place) == words


def test_a_bar_of_what_a_module_costs_lists_its_failures() -> None:
    listing = Listing(figures_of(opened()[0], None), "")
    bars = re.findall(r'class="fall"[^>]* data-do="find:([^"]+)"', summary_html(Sample(listing.figures)).html)
    counts = {query: len(listing.figures.rows.find(query)) for query in bars}
    assert counts[f"{FAILURES} verdict:OPM-TARGET,OPM-REF"] == 273 + 89
    assert min(counts.values()) > 0, counts


def test_a_frame_is_opened_with_its_first_failure_that_is_listed() -> None:
    """Of the search that is on; without one it keeps the question."""
    desk, ids = Desk({"demo": opened()[0]}), opened()[1].dataset.frame_ids
    done: list[Any] = []
    desk.open_frame, desk.handle = done.append, done.append
    listing = desk.state.listing
    assert listing is not None
    rows = listing.figures.rows
    desk.state = replace(desk.state, listing=replace(listing, found=rows.find(f"{FAILURES} frame:{ids[4]}")))
    desk.browse.open(4)
    desk.browse.open(5)
    desk.browse.open(900)
    assert done == [Command("failure", (0,)), ids[5]]


def test_ids_are_offered_by_what_is_typed_else_those_around() -> None:
    desk, ids = Desk({}), opened()[1].dataset.frame_ids
    desk.browse.complete("2/00")
    desk.browse.complete("")
    assert desk.calls("frameIds") == [[i for i in ids if "2/00" in i], list(ids[:20])]


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


@pytest.mark.parametrize("numbers", ["", "1", [-1, 4], [1.5], ["a"], None])
def test_what_are_no_numbers_are_not_answered(numbers: Any) -> None:
    desk = Desk({})
    with pytest.raises(Idle):
        commands_of(desk.browse)["frame-rows"](numbers)
    assert not desk.sent


def test_pictures_are_of_the_frame_and_of_the_one_width() -> None:
    source = opened()[1]
    pictures = FramePictures({"demo": source})
    frame = source.dataset.frame_ids[2]
    found = asyncio.run(pictures.get("/app/frame/0/2/480.jpg"))
    assert found is not None
    picture = cv2.imdecode(np.frombuffer(found, np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    rgb = source.dataset.load(frame).rgb
    assert picture.shape[1] == 480
    small = cv2.resize(rgb, picture.shape[1::-1], interpolation=cv2.INTER_AREA)[..., ::-1]
    assert np.abs(small.astype(int) - picture).mean() < 4
    for path in ("0/2/481.jpg", "1/2/480.jpg", "0/99999/480.jpg", "0/2/480.png", "0/../480.jpg", "a/2/480.jpg"):
        assert asyncio.run(pictures.get("/app/frame/" + path)) is None
