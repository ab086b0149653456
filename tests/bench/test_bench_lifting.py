"""The bench of lifting measures what it says, on truth that it makes itself."""

from __future__ import annotations

import os

import numpy as np
import pytest

from pipeline.bench.lift_part import (
    FIRST_ROOM,
    BenchView,
    bench_views,
    face_errors,
    open3d_recipe,
    our_lifting,
    pairs_per_second,
    trimesh_bounds,
)

REQUIRED = os.environ.get("SPATIALVIZ_REQUIRE_EXTRAS") == "1"


@pytest.fixture(scope="module")
def views() -> list[BenchView]:
    return bench_views(FIRST_ROOM)


@pytest.mark.slow
def test_faces_of_exact_extents_have_no_error(views: list[BenchView]) -> None:
    for view in views:
        assert len(view.masks) >= 5
        assert (view.hi > view.lo).all()
        assert not face_errors((view.lo, view.hi), view).any()


@pytest.mark.slow
def test_our_lifting_finds_the_visible_surface(views: list[BenchView]) -> None:
    errors = np.concatenate([face_errors(our_lifting(view), view) for view in views])
    assert np.isfinite(errors).all()
    assert np.median(errors) < 0.02
    assert errors.mean() < 0.06


@pytest.mark.slow
def test_the_recipe_of_others_is_no_better(views: list[BenchView]) -> None:
    if not REQUIRED:
        pytest.importorskip("open3d", reason="the extra open3d is not installed")
    view = views[0]
    ours, theirs = face_errors(our_lifting(view), view), face_errors(open3d_recipe(view), view)
    assert theirs.shape == ours.shape
    assert np.isfinite(theirs).all()
    assert ours.mean() <= theirs.mean()


@pytest.mark.slow
def test_peers_take_the_same_views(views: list[BenchView]) -> None:
    trimesh_bounds(views[0])
    assert all(rate > 1000 for rate in pairs_per_second(1))
