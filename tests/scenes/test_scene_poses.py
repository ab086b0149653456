"""Poses of a scene: what does not fit is found and left out, and refinement is offered, or used if asked for."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from posed_worlds import SCENE, demo

from pipeline.datasets import demo_path, open_dataset
from pipeline.scenes.object_map import map_scene
from pipeline.scenes.pose_fit import bad_poses
from pipeline.scenes.poses import NEAR, PoseAgreement, agreement, misfits, partners, refine
from pipeline.scenes.views import posed_frames, views_of
from pipeline.system.errors import FrameUnusable

OFF = {SCENE[1]: (0.03, 0.0, 0.0)}


def test_a_pose_that_is_3_cm_off_is_left_out_with_how_far_refinement_moves_it() -> None:
    made = map_scene(demo(moved=OFF), "s", SCENE)
    assert list(made.left_out) == [SCENE[1]]
    assert "does not fit" in made.left_out[SCENE[1]]
    (offered,) = made.refinements
    assert (offered.frame_id, offered.better, offered.used) == (SCENE[1], True, False)
    assert offered.moved_m == pytest.approx(0.03, abs=0.008)
    assert offered.turned_deg < 0.3
    np.testing.assert_array_equal(made.poses[SCENE[1]], made.declared[SCENE[1]])


def test_refined_poses_are_used_where_that_is_asked_for_and_are_told() -> None:
    sound, made = map_scene(demo(), "s", SCENE), map_scene(demo(moved=OFF), "s", SCENE, refined=True)
    assert not made.left_out
    assert {r.frame_id: r.used for r in made.refinements if r.used} == {SCENE[1]: True}
    gap = made.poses[SCENE[1]][:3, 3] - sound.poses[SCENE[1]][:3, 3]
    assert np.linalg.norm(gap) < 0.02
    assert [o.numbers for o in made.objects] == [o.numbers for o in sound.objects]


def test_every_pair_of_the_demo_agrees_and_a_view_that_shares_nothing_is_not_judged() -> None:
    one, other, away = views_of(open_dataset(demo_path()), (*SCENE[:2], "000002/000000"))
    assert (agreement(one, other).agree or 0) > 0.9
    T = np.eye(4)
    T[:3, 3] = 50.0
    away = away.moved(T)
    assert agreement(one, away).agree is None
    assert refine(one, [away]) is None


def test_what_comes_later_changes_no_pair_of_before_and_few_pairs_are_compared() -> None:
    rng = np.random.default_rng(0)
    poses = [np.vstack([np.hstack([np.eye(3), rng.normal(size=(3, 1))]), [0, 0, 0, 1]]) for _ in range(120)]
    assert partners(poses, 5) == (0, 1, 2, 3, 4)
    for place in (30, 77):
        found = partners(poses, place)
        assert found == partners(poses[: place + 1], place)
        assert set(range(place - NEAR, place)) < set(found)
        assert len(found) <= 2 * NEAR


def test_what_fits_is_told_by_what_is_usual_in_the_recording() -> None:
    assert 0.85 < misfits([0.94, 0.93, 0.95, 0.7]) < 0.93
    assert misfits([0.77, 0.7, 0.8, 0.75, 0.9]) < 0.7
    assert misfits([]) == 0.0


def pair(one: int, other: int, agree: float, shared: float = 0.5) -> PoseAgreement:
    return PoseAgreement(str(one), str(other), round(1000 * agree), round(1000 * (1 - agree)), shared, 0.01)


def test_a_view_that_fits_one_other_by_chance_does_not_fit() -> None:
    good = [pair(i, j, 0.75 + 0.01 * i) for i, j in combinations(range(6), 2)]
    astray = [pair(i, 6, 0.8 if i == 2 else 0.4) for i in range(6)]
    assert bad_poses(good) == {}
    assert list(bad_poses([*good, *astray])) == ["6"]
    # The chance fit of a view with a few others is all that there is to judge by.
    assert bad_poses([*good, *astray[1:4]]) == {}
    # Of views that share much and fit, and others that share little and do not, the former decide.
    little = [pair(i, 6, 0.8 if i < 3 else 0.2, 0.9 if i < 3 else 0.1) for i in range(6)]
    assert bad_poses([*good, *little]) == {}


def test_frames_without_poses_are_refused_in_a_line_that_says_what_is_needed() -> None:
    dataset = open_dataset(demo_path())
    ids = posed_frames(dataset, SCENE[0])
    assert ids == SCENE
    pairs = list(combinations(range(3), 2))
    assert len(map_scene(demo(), "s", ids).agreements) == len(pairs)

    class Unposed:
        root, frame_ids, load_pose = dataset.root, dataset.frame_ids, staticmethod(lambda frame_id: None)

    with pytest.raises(FrameUnusable, match="joined by their camera poses"):
        posed_frames(Unposed(), SCENE[0])  # pyright: ignore[reportArgumentType]
