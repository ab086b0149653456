"""A survey decodes so many frames, and looks at files, headers and poses of the others."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from pipeline.datasets import SurveyCounts, open_dataset, survey
from pipeline.system import InputError


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """Nine frames; the last three have pictures that cannot be decoded, of one the header, too, and no depth file."""
    for name in ("color", "depth", "pose"):
        (tmp_path / name).mkdir()
    for k in range(9):
        files = tmp_path / "color" / f"{k}.png", tmp_path / "depth" / f"{k}.png"
        cv2.imwrite(str(files[0]), np.full((48, 64, 3), 90, np.uint8))
        cv2.imwrite(str(files[1]), np.full((48, 64), 2000, np.uint16))
        np.savetxt(tmp_path / "pose" / f"{k}.txt", np.eye(4))
        if k == 6:
            files[0].write_bytes(files[0].read_bytes()[:60])
        if k == 7:
            files[1].write_bytes(b"no picture")
    (tmp_path / "spatialviz.toml").write_text("intrinsics = [60, 60, 31.5, 23.5]\ndepth_scale = 1000\n")
    return tmp_path


def test_pictures_that_are_not_decoded_are_looked_at_by_their_headers(recording: Path) -> None:
    counts = SurveyCounts()
    reports = list(counts.watch(survey(open_dataset(recording), most_decoded=2)))
    assert [report.decoded for report in reports if report.ok] == [True, *(False,) * 6, True]
    # A picture that is cut off has its header; one that is none is told without decoding.
    assert [report.ok for report in reports] == [True] * 7 + [False, True]
    assert "cannot be read" in (reports[7].problem or "")
    assert {(report.width, report.height, report.has_pose) for report in reports if report.ok} == {(64, 48, True)}
    record = counts.record()
    assert (record["frames_usable"], record["frames_decoded"], record["depth_valid"]) == (8, 2, 1.0)
    assert record["frames_without_pose"] == 0


def test_all_frames_are_decoded_where_nothing_else_is_said(recording: Path) -> None:
    reports = list(survey(open_dataset(recording)))
    assert all(report.decoded for report in reports)
    assert [report.ok for report in reports] == [True] * 6 + [False, False, True]


def test_a_file_that_went_away_is_told(recording: Path) -> None:
    dataset = open_dataset(recording)
    (recording / "depth" / "3.png").unlink()
    with pytest.raises(InputError, match="missing"):
        dataset.peek("3")  # type: ignore[attr-defined]


def test_a_kind_of_broken_frame_says_what_would_do_once(recording: Path) -> None:
    for k in (1, 2):
        cv2.imwrite(str(recording / "depth" / f"{k}.png"), np.full((48, 64), 200, np.uint8))
    cv2.imwrite(str(recording / "color" / "4.png"), np.full((64, 48, 3), 90, np.uint8))
    counts = SurveyCounts()
    for report in survey(open_dataset(recording)):
        counts.add(report)
    record = counts.record()
    assert record["problems"]["depth of 8 bits"] == 2
    assert record["remedies"]["depth of 8 bits"].startswith("got uint8; expected 16-bit integers or floats (is this")
    (turned,) = (text for reason, text in record["remedies"].items() if "turned" in reason)
    assert "color_turned = " in turned
    assert str(recording) not in str(record["remedies"])
    assert record["remedies"].keys() <= record["problems"].keys()
