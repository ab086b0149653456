"""Frames that several look at: loaded once, a few kept, the next made ready, pictures made behind."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import cv2
import numpy as np
import pytest
from waiting import LONG_S

from pipeline.answering import BackgroundPictures, FrameStore, Pipeline, UpHint, open_pipeline
from pipeline.answering.frame_store import FEWEST_KEPT, frame_colors
from pipeline.geometry.palette import ON_DARK, instance_colors
from pipeline.system import InputError


@pytest.fixture(scope="module")
def source() -> Pipeline:
    return open_pipeline("demo", srm="rule")


def test_a_frame_is_loaded_once_whoever_asks_for_it(source: Pipeline) -> None:
    store, first = FrameStore({"demo": source}), source.dataset.frame_ids[0]
    assert store.kept("demo", first) is None
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda _: store.load("demo", first), range(4)))
    assert {id(loaded) for loaded in found} == {id(store.kept("demo", first))}
    loaded = found[0]
    assert (loaded.problem, loaded.up_hint, loaded.doubt) == ("", None, "")
    assert len(loaded.objects) == len(loaded.context.frame.annotations)
    colors = loaded.painted("rgb", lambda: loaded.context.frame.rgb)
    assert loaded.painted("rgb", lambda: pytest.fail("made twice")) is colors
    assert colors.shape == loaded.cloud.points.shape
    box = loaded.objects[0].bbox
    assert loaded.thumb(box) is loaded.thumb(box)


def test_what_a_frame_holds_is_known(source: Pipeline) -> None:
    loaded = FrameStore({"demo": source}).load("demo", source.dataset.frame_ids[0])
    frame, cloud = loaded.context.frame, loaded.cloud
    arrays = [frame.rgb, frame.depth, cloud.points, cloud.u, cloud.v, *(part.offsets for part in cloud.parts)]
    masks = [thing.mask for thing in (*frame.annotations, *loaded.objects)]
    arrays += [mask for mask in masks if mask is not None]
    assert loaded.nbytes == pytest.approx(sum(array.nbytes for array in arrays), rel=0.15)


@pytest.mark.parametrize(("most", "kept"), [(0, FEWEST_KEPT), (FEWEST_KEPT + 2, FEWEST_KEPT + 2)])
def test_the_frames_used_last_are_kept_and_those_that_somebody_holds(
    source: Pipeline, monkeypatch: pytest.MonkeyPatch, most: int, kept: int
) -> None:
    store, ids = FrameStore({"demo": source}), source.dataset.frame_ids[: kept + 3]
    held = store.load("demo", ids[0])
    monkeypatch.setattr("pipeline.answering.frame_store.KEPT_BYTES", most * 100)
    monkeypatch.setattr(type(held), "nbytes", 100)
    for frame_id in ids[1:]:
        store.load("demo", frame_id)
    assert store.kept("demo", ids[0]) is held
    assert [store.kept("demo", frame_id) is not None for frame_id in ids[1:]] == [False, False] + [True] * kept
    store.let_go()
    assert [frame_id for frame_id in ids if store.kept("demo", frame_id) is not None] == [ids[0]]


def test_what_is_made_ahead_waits_while_somebody_is_answered(source: Pipeline) -> None:
    busy, ready = threading.Event(), threading.Event()
    busy.set()
    store, ids = FrameStore({"demo": source}, busy.is_set), source.dataset.frame_ids
    store.prepare("demo", ["no such frame", ids[1]], lambda _: ready.set())
    assert not ready.wait(0.1)
    assert store.load("demo", ids[0]) is store.kept("demo", ids[0])
    busy.clear()
    assert ready.wait(LONG_S)
    assert store.kept("demo", ids[1]) is not None


def test_a_broken_frame_is_told_every_time(source: Pipeline, monkeypatch: pytest.MonkeyPatch) -> None:
    store, first = FrameStore({"demo": source}), source.dataset.frame_ids[0]

    def broken(frame_id: str) -> Any:
        raise InputError("the picture is damaged", path="x.png")

    with monkeypatch.context() as patch:
        patch.setattr(source.dataset, "load", broken)
        for _ in range(2):
            with pytest.raises(InputError, match="damaged"):
                store.load("demo", first)
    assert store.load("demo", first).context.frame.id == first


def test_up_that_was_told_holds_for_all_until_it_is_taken_back(source: Pipeline) -> None:
    store, first = FrameStore({"demo": source}), source.dataset.frame_ids[0]
    before = store.load("demo", first)
    told = UpHint(first, (12, 34), (0.0, -1.0, 0.0))
    assert told.words == f"{first}:12,34"
    store.set_up_hint("demo", told)
    after = store.load("demo", first)
    assert after.up_hint == told
    assert after.context.viewer.up_source == "given"
    np.testing.assert_allclose(after.context.viewer.up, [0, -1, 0], atol=1e-6)
    store.set_up_hint("demo", None)
    np.testing.assert_array_equal(store.load("demo", first).context.viewer.up, before.context.viewer.up)


def test_pictures_and_plans_are_made_behind(source: Pipeline, monkeypatch: pytest.MonkeyPatch) -> None:
    behind, ids, told = BackgroundPictures({"demo": source}), source.dataset.frame_ids, list[Any]()
    done = threading.Event()
    behind.plan("demo", ids[0], lambda plan: (told.append(plan), done.set()))
    data = behind.picture("demo", ids[0], 160).result(LONG_S)
    picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    rgb = source.dataset.load(ids[0]).rgb
    assert picture.shape[:2] == (round(160 * rgb.shape[0] / rgb.shape[1]), 160)
    assert done.wait(LONG_S)
    assert told[0] is None or ids[0] in told[0].frame_ids
    monkeypatch.setattr("pipeline.answering.frame_store.load_picture", _broken)
    assert behind.picture("demo", ids[0], 160).result(LONG_S) == data, "kept"
    assert behind.picture("demo", ids[1], 160).result(LONG_S) == b""


def _broken(*_: object) -> Any:
    raise InputError("the picture is damaged")


@pytest.mark.parametrize("dark", [True, False])
def test_the_colours_of_things_are_their_pixels_beside_a_colour(source: Pipeline, dark: bool) -> None:
    """Greyed and mixed as floats would be, to the byte."""
    loaded = FrameStore({"demo": source}).load("demo", source.dataset.frame_ids[0])
    frame, objects = loaded.context.frame, loaded.objects
    grey = frame.rgb.mean(axis=2, keepdims=True).repeat(3, axis=2)
    expected = (grey * 0.55 + (20 if dark else 110)).astype(np.uint8)
    colors = instance_colors(len(objects))
    for i in sorted(range(len(objects)), key=lambda i: -int(objects[i].lifted.quality.mask_pixels)):
        color, mask = np.array(ON_DARK["target"] if i == 2 else colors[i]), objects[i].mask
        expected[mask] = (expected[mask] * 0.35 + color * 0.65).astype(np.uint8)
    found = frame_colors("objects", frame, objects, {2: "target"}, dark)
    np.testing.assert_array_equal(found, expected)
