"""A mend is tried and measured again, region by region, before anybody reads it; what makes one worse is withdrawn.

Without this a user would be told to warp a recording that is right.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from benchmarks.doctor_plants import Planted, judge
from benchmarks.doctor_scenes import Rendered, shelf_scan, table_top, walk
from pose_files import as_convention

from pipeline.datasets import InMemoryDataset, demo_path, open_dataset, overlay
from pipeline.datasets.doctor.examine import Examination, examine_frames
from pipeline.datasets.doctor.search import Cause, causes
from pipeline.datasets.doctor.seen import Seen
from pipeline.datasets.doctor.suspicions import Opinion, RegionAgreement, Suspicion, diagnosed
from pipeline.datasets.settings import Settings
from pipeline.geometry import Frame, Registration, registered
from pipeline.geometry.camera import CONVENTIONS, composed, standard_poses


@pytest.fixture(scope="module")
def room() -> list[Frame]:
    """Three views of one room."""
    dataset = open_dataset(demo_path())
    return [dataset.load(i) for i in dataset.frame_ids if i.startswith("000001/")]


def seen_of(frames: Sequence[Frame]) -> Seen:
    return Seen(InMemoryDataset(frames), tuple(frames), 1000.0)


# Trying


@dataclass(frozen=True)
class Doubled:
    """Thinks that depth is read twice too far where it is beyond some metres, and measures what it is told to."""

    measure: RegionAgreement
    beyond: float = 1.0

    @property
    def suspicion(self) -> Suspicion:
        return Suspicion(self.opinions, self.measured)

    def opinions(self, seen: Seen, known: Sequence[Opinion]) -> list[Opinion]:
        far = float(np.median(seen.frames[0].depth)) > self.beyond
        mend: dict[str, Any] = {"depth_scale": seen.units * 2} if far and seen.units else {}
        return [Opinion("depth scale", "wrong" if far else "fine", "it is far", mend, "--depth-scale 2000")]

    def measured(self, seen: Seen, mended: Seen) -> tuple[RegionAgreement, ...]:
        return (self.measure,)


def measured(*gains: float) -> RegionAgreement:
    return RegionAgreement(np.full(len(gains), 0.3), 0.3 + np.array(gains), 0.05)


BETTER = measured(0.1, 0.1, 0.2, 0.1)


def test_a_mend_that_helps_is_kept_and_what_follows_sees_it(room: list[Frame]) -> None:
    seen = seen_of(room)
    once = float(np.median(seen.frames[0].depth)) * 0.6
    (opinion,), mended = diagnosed(seen, [Doubled(BETTER, once).suspicion])
    assert (opinion.state, opinion.mend) == ("wrong", {"depth_scale": 2000.0})
    np.testing.assert_allclose(mended.frames[0].depth, room[0].depth / 2)


@pytest.mark.parametrize(
    ("measure", "beyond", "why"),
    [
        (measured(0.4, 0.4, 0.4, -0.1), 0.9, "1 of 4 regions of the picture agree less"),
        (measured(0.9, 0.0, 0.0, 0.0), 0.9, "1 of 4 regions of the picture agree better"),
        (measured(0.03, 0.03, 0.03, 0.03), 0.9, "4 of 4 regions of the picture agree better"),
        (RegionAgreement(np.array([0.3]), np.array([np.nan]), 0.05), 0.9, "no region of the picture"),
        (BETTER, 0.01, "another one is asked for"),
    ],
)
def test_a_mend_that_does_not_is_withdrawn(
    room: list[Frame], measure: RegionAgreement, beyond: float, why: str
) -> None:
    seen = seen_of(room)
    (opinion,), mended = diagnosed(seen, [Doubled(measure, beyond).suspicion])
    assert (opinion.state, opinion.mend, opinion.option) == ("unknown", {}, None)
    assert "tried and withdrawn" in opinion.text
    assert why in opinion.text
    assert mended is seen


def test_every_cause_is_what_is_mended(room: list[Frame]) -> None:
    """Frames read with a convention, and with the intrinsics of half the picture, are what they should be."""
    found = {cause.words: cause for cause in causes(seen_of(room))}
    assert set(found) >= {f"poses are {name}" for name in CONVENTIONS[1:]}
    T = np.asarray(room[0].camera.T_world_camera)
    read = replace(room[0], camera=replace(room[0].camera, T_world_camera=as_convention(T, "world-to-camera ros")))
    (mended,) = seen_of([read]).mended(found["poses are world-to-camera ros"].mend).frames
    np.testing.assert_allclose(np.asarray(mended.camera.T_world_camera), T, atol=1e-9)
    K = room[0].camera.K * np.array([0.5, 0.5, 1.0])[:, None]
    half = [replace(f, camera=replace(f.camera, K=K)) for f in room]
    (cause,) = [cause for cause in causes(seen_of(half)) if "0.5 times as large" in cause.words]
    np.testing.assert_allclose(seen_of(half).mended(cause.mend).frames[0].camera.K, room[0].camera.K)


def test_a_cause_that_is_added_is_weighed_against_the_others(
    room: list[Frame], monkeypatch: pytest.MonkeyPatch
) -> None:
    """One more entry in the list is judged; where a scale alone does as well, neither is guessed."""
    added = Cause("meaning", "depth is in quarters", {"depth_scale": 4000.0})
    monkeypatch.setattr("pipeline.datasets.doctor.search.causes", lambda *of: (*causes(*of), added))
    read = [replace(frame, depth=frame.depth * np.float32(4)) for frame in room]
    found = examine_frames(InMemoryDataset(read), read, 1000.0)
    assert (found.of("meaning").state, found.mends) == ("unknown", {})
    assert "depth is in quarters or depth 0.2" in found.of("meaning").text


# Up


def test_up_is_judged_with_mended_poses(room: list[Frame]) -> None:
    """A right `world_up` is carried by poses that are read the wrong way: the poses are wrong, up is not."""
    read = []
    for frame in room:
        T = as_convention(np.asarray(frame.camera.T_world_camera), "camera-to-world opengl")
        camera = replace(frame.camera, T_world_camera=T).with_up(T[:3, :3].T @ np.array([0.0, 0.0, 1.0]), "declared")
        read.append(replace(frame, camera=camera))
    found = examine_frames(InMemoryDataset(read), read, 1000.0)
    assert {opinion.about for opinion in found.wrong} == {"poses"}
    assert found.of("up").state == "fine"


def test_up_is_not_judged_by_poses_that_nothing_shows_to_hold(room: list[Frame]) -> None:
    apart = replace(room[0], id="alone")
    T = as_convention(np.asarray(apart.camera.T_world_camera), "camera-to-world ros")
    up = T[:3, :3].T @ np.array([0.0, 0.0, 1.0])
    alone = [replace(apart, camera=replace(apart.camera, T_world_camera=T).with_up(up, "declared"))]
    found = examine_frames(InMemoryDataset(alone), alone, 1000.0)
    assert (found.of("up").state, found.mends) == ("unknown", {})


# Registration, on what is rendered


@pytest.fixture(scope="module")
def table() -> list[Rendered]:
    """A table-top from above, with arms whose depth is bad."""
    return table_top(3, count=3, width=320)


def test_arms_at_the_border_are_no_misregistration(table: list[Rendered]) -> None:
    case = judge("table-top", [one.frame for one in table], Planted(""))
    assert case.outcome == "right", case.said


def test_a_misregistered_table_top_is_named_and_mended_for_good(table: list[Rendered]) -> None:
    frames = [one.frame for one in table]
    case = judge("table-top", frames, Planted("registration", "unaligned"), [one.unaligned for one in table])
    assert case.outcome == "right", case.said
    assert case.found is not None
    again = examine_frames(InMemoryDataset(case.found.mended), case.found.mended, 1000.0)
    assert again.of("registration").state == "fine"
    picture = overlay(case.found, most=2)
    assert picture.shape == (480, 640, 3)
    green = (picture == (40, 220, 90)).all(axis=2)
    assert green[:, 320:].sum() > 2 * green[:, :320].sum()


@pytest.mark.slow
def test_a_shelf_scanned_by_a_robot_is_fine() -> None:
    frames = [one.frame for one in shelf_scan(5, count=4, width=320)]
    case = judge("shelf", frames, Planted(""))
    assert case.outcome == "right", case.said


@pytest.mark.slow
@pytest.mark.parametrize("places", [-3])
def test_late_poses_are_no_depth_scale(places: int) -> None:
    frames = [one.frame for one in walk(4, count=22, width=160)]
    case = judge("walk", frames, Planted("time", places))
    assert case.outcome in ("right", "named", "abstains"), case.said


# As it is kept


def test_a_warp_after_a_declared_one_is_both(room: list[Frame]) -> None:
    own = room[0].camera
    first = Registration(own.fx * 1.1, own.fy * 1.1, own.cx + 3, own.cy, 0.02, 0.01, 0.0)
    then = Registration(own.fx, own.fy, own.cx - 4, own.cy + 2, -0.01, 0.0, 0.005)
    u, v, z = np.array([100.0, 300.0, 500.0]), np.array([80.0, 240.0, 400.0]), np.array([1.0, 2.0, 3.0])
    _, between = registered(room[0].depth, own, first)
    columns, rows, far = first.pixels(u, v, z, own)
    in_turn = then.pixels(columns, rows, far, between)
    np.testing.assert_allclose(in_turn, then.after(first).pixels(u, v, z, own))


@pytest.mark.parametrize("first", CONVENTIONS[:4])
def test_conventions_in_turn(first: str) -> None:
    assert composed(first, CONVENTIONS[0]) == first
    T = np.asarray(open_dataset(demo_path()).load("000001/000000").camera.T_world_camera)
    both = composed(first, first)
    if both is not None:
        np.testing.assert_allclose(standard_poses(T, both), standard_poses(standard_poses(T, first), first), atol=1e-9)


@pytest.mark.slow
def test_the_mend_of_declared_poses_takes_their_place(room: list[Frame]) -> None:
    """Poses that were told to be the wrong way and are not: what is kept is what the files mean."""
    read = [
        replace(f, camera=replace(f.camera, T_world_camera=np.linalg.inv(np.asarray(f.camera.T_world_camera))))
        for f in room
    ]
    told = Settings(poses="world-to-camera opencv")
    found: Examination = examine_frames(InMemoryDataset(read), read, 1000.0, told)
    assert found.mends == {"poses": "camera-to-world opencv"}
