"""Training of the network that completes boxes: targets, mirror, calibration, and a tiny network from room to card."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from needs import needs

from pipeline.answering.whole_boxes import COLUMNS, BoxNetwork
from pipeline.geometry.boxes import Box3D
from pipeline.system.errors import InputError
from pipeline.training.box_training import (
    BoxSamples,
    BoxTraining,
    covered,
    exact_in,
    mirrored,
    resized,
    room_samples,
    train_box_network,
    with_wrong_names,
)

SEEN = Box3D(np.array([0.5, 0.2, 2]), np.eye(3), np.array([0.4, 0.2, 0.3]))


def test_exact_ends_are_along_the_seen_axes_whichever_the_exact_ones_are() -> None:
    quarter = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])
    low, high = exact_in(SEEN, Box3D(SEEN.center, quarter, SEEN.size[[2, 1, 0]]))
    np.testing.assert_allclose(low, SEEN.center - SEEN.size / 2)
    np.testing.assert_allclose(high, SEEN.center + SEEN.size / 2)


def test_resized_boxes_keep_their_nearer_sides() -> None:
    near = SEEN.center - SEEN.size / 2
    found = resized(SEEN, np.array([1.0, 1, 1]))
    np.testing.assert_allclose(found.center - found.size / 2, near)


def samples(n: int = 50) -> BoxSamples:
    rng = np.random.default_rng(1)
    rows = rng.normal(size=(n, len(COLUMNS)))
    sides = rng.normal(size=(n, 6))
    return BoxSamples(rows, np.ones((n, 3)), np.ones((n, 6)), sides > 0, sides, np.zeros((n, 3)))


def test_the_mirror_of_a_mirror_is_the_view() -> None:
    found = samples()
    once = mirrored(found)
    twice = mirrored(once)
    np.testing.assert_array_equal(twice.rows, found.rows)
    np.testing.assert_array_equal(twice.offsets, found.offsets)
    np.testing.assert_array_equal(once.offsets[:, 0], found.offsets[:, 1])
    left, right = COLUMNS.index("open_left"), COLUMNS.index("open_right")
    np.testing.assert_array_equal(once.rows[:, left], found.rows[:, right])


def test_wrong_names_change_nothing_but_names() -> None:
    rows = samples().rows
    found = with_wrong_names(rows, np.random.default_rng(0))
    changed = {COLUMNS[k] for k in np.flatnonzero((found != rows).any(axis=0))}
    assert changed
    assert changed <= {"class_known", "log_class_least", "log_class_most"}


def test_coverage_counts_free_sides_alone() -> None:
    found = samples()
    offsets = np.stack([found.offsets, found.offsets - 1, found.offsets + np.where(found.free, 1, -2)], axis=1)
    assert covered(offsets, found) == 1.0
    assert np.isnan(covered(offsets, replace(found, free=np.zeros_like(found.free))))


def test_training_refuses_what_makes_no_sense(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"\.onnx"):
        train_box_network(tmp_path / "a.txt")
    with pytest.raises(InputError, match="positive"):
        train_box_network(tmp_path / "a.onnx", BoxTraining(views=0))


@needs("embreex")
def test_samples_of_a_room_are_repeatable() -> None:
    job = (500_001, 1, 160, 120, "scattered")
    a, b = room_samples(job), room_samples(job)
    assert len(a.rows)
    np.testing.assert_array_equal(a.rows, b.rows)
    np.testing.assert_array_equal(a.offsets, b.offsets)
    assert np.isfinite(a.rows).all()


@needs("embreex", "torch", "onnx")
@pytest.mark.slow
def test_a_tiny_training_writes_a_network_and_its_card_and_is_repeatable(tmp_path: Path) -> None:
    config = BoxTraining(rooms=5, views=2, width=240, height=180, epochs=2, hidden=16)
    cards = [train_box_network(tmp_path / f"{name}.onnx", config) for name in "ab"]
    assert cards[0]["file_xxh3_128"] == cards[1]["file_xxh3_128"]
    card = json.loads((tmp_path / "a.json").read_text())
    held = card["held_out"]["scattered rooms that intervals are fitted on"]
    assert 0 < held["coverage"] <= 1
    assert BoxNetwork(tmp_path / "a.onnx").offsets(np.zeros((1, len(COLUMNS)))).shape == (1, 3, 6)
