"""The points of a frame as they are drawn."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.geometry import Camera, Cloud, Frame, cloud_of, drawn_pixels, viewer_axes
from pipeline.geometry.cloud import FAR

HEIGHT, WIDTH = 48, 64


@pytest.fixture(scope="module")
def frame() -> Frame:
    """A slope at about a metre, with a hole and a far wall."""
    depth = np.tile(np.linspace(0.9, 1.2, WIDTH, dtype=np.float32), (HEIGHT, 1))
    depth[:2, :2] = 0
    depth[-3:, -3:] = FAR + 1
    rgb = (np.arange(HEIGHT * WIDTH * 3) % 256).astype(np.uint8).reshape(HEIGHT, WIDTH, 3)
    K = np.array([[60.0, 0, WIDTH / 2], [0, 60, HEIGHT / 2], [0, 0, 1]])
    return Frame("f", rgb, depth, Camera(K, WIDTH, HEIGHT))


@pytest.fixture(scope="module")
def cloud(frame: Frame) -> Cloud:
    return cloud_of(frame, viewer_axes(np.array([0.0, -1.0, 0.0])))


def test_the_parts_hold_every_point_once_to_a_millimetre(frame: Frame, cloud: Cloud) -> None:
    assert len(cloud.points) == drawn_pixels(frame).sum()
    whole = np.concatenate([part.center + part.offsets.astype(np.float32) for part in cloud.parts])
    assert np.abs(whole - cloud.points).max() < 1e-3
    assert len({part.name for part in cloud.parts}) == len(cloud.parts)


def test_the_first_parts_are_one_point_in_four_and_come_first(cloud: Cloud) -> None:
    firsts = [part.first for part in cloud.parts]
    assert firsts == sorted(firsts, reverse=True)
    first = np.concatenate([np.arange(part.at.start, part.at.stop) for part in cloud.parts if part.first])
    assert not (cloud.v[first] % 2).any()
    assert not (cloud.u[first] % 2).any()


def test_points_lie_as_far_ahead_as_was_measured_in_the_colours_of_their_pixels(frame: Frame, cloud: Cloud) -> None:
    np.testing.assert_allclose(cloud.points[:, 1], frame.depth[cloud.v, cloud.u], atol=1e-5)
    np.testing.assert_array_equal(cloud.painted(frame.rgb), frame.rgb[cloud.v, cloud.u])


def test_a_stride_leaves_rows_and_columns_out_and_draws_larger_points(frame: Frame, cloud: Cloud) -> None:
    thin = cloud_of(frame, viewer_axes(np.array([0.0, -1.0, 0.0])), stride=3)
    assert not (thin.v % 3).any()
    assert not (thin.u % 3).any()
    assert max(part.size for part in thin.parts) > max(part.size for part in cloud.parts)
