"""Pictures and films in files: whole or not at all, and what was drawn."""

from __future__ import annotations

import os
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from pipeline.pictures.writing import Film, encoded_film, is_film, write_film, write_picture
from pipeline.system.errors import InputError

IMAGE = np.random.default_rng(0).integers(0, 255, (20, 30, 3), np.uint8)
FILM = Film((np.full((20, 30, 3), 200, np.uint8), np.full((20, 30, 3), 20, np.uint8)), (1000, 500))


def test_a_picture_is_saved_whole(tmp_path: Path) -> None:
    for name in ("answer.png", "answer.jpg"):
        write_picture(IMAGE, tmp_path / name)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["answer.jpg", "answer.png"]
    png = cv2.imread(str(tmp_path / "answer.png"))
    assert png is not None
    np.testing.assert_array_equal(png[..., ::-1], IMAGE)


def test_what_cannot_be_saved_leaves_nothing(tmp_path: Path) -> None:
    (tmp_path / "folder.png").mkdir()
    for path, message in (
        (tmp_path / "absent" / "x.png", "folder for the picture does not exist"),
        (tmp_path / "x.txt", "picture of this kind.*.txt.*png"),
        (tmp_path / "x", "picture of this kind"),
        (tmp_path / "folder.png", "cannot be written"),
        (Path("/proc/answer.png"), "cannot be written"),
    ):
        with pytest.raises(InputError, match=message) as caught:
            write_picture(IMAGE, path)
        assert "\n" not in str(caught.value)
    for path, message in (
        (tmp_path / "absent" / "x.gif", "folder for the film does not exist"),
        (tmp_path / "x.mp4", "film of this kind.*mp4.*gif"),
        (Path("/proc/answer.gif"), "cannot be written"),
    ):
        with pytest.raises(InputError, match=message):
            write_film(FILM, path)
    assert [p.name for p in tmp_path.iterdir()] == ["folder.png"]


def test_a_failed_save_keeps_the_old_picture(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.png"
    path.write_bytes(b"old")

    def full(number: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(InputError, match="No space left"):
        write_picture(IMAGE, path)
    assert path.read_bytes() == b"old"
    assert [p.name for p in tmp_path.iterdir()] == ["a.png"]


@pytest.mark.parametrize("ending", [".gif", ".webp", ".GIF"])
def test_a_film_shows_its_pictures_in_turn_for_ever(ending: str, tmp_path: Path) -> None:
    path = tmp_path / f"film{ending}"
    assert is_film(path)
    write_film(FILM, path)
    assert path.read_bytes() == encoded_film(FILM, ending)
    with Image.open(path) as image:
        assert image.n_frames == 2  # pyright: ignore[reportAttributeAccessIssue]
        assert image.info.get("loop") == 0
        shown, times = [], []
        for number in range(2):
            image.seek(number)
            shown.append(np.asarray(image.convert("RGB")).mean())
            times.append(image.info["duration"])
    assert shown == pytest.approx([200, 20], abs=4)
    assert sum(times) == pytest.approx(1500, abs=20)
