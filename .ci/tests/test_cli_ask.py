"""Browse and ask from the command line: frames, answers, relations, distances, edits, and what is refused."""

from __future__ import annotations

import json
import os
import warnings
from pathlib import Path

import cv2
import pytest
from command_line import misused, spatialviz
from PIL import Image

from pipeline import __version__

TEXT = "mug left of the laptop"
BEHIND = "mug behind the laptop"
SMALL = ["--rooms", 1, "--views", 1, "--width", 160, "--height", 120]


def test_version_and_help() -> None:
    assert spatialviz(0, "--version").out == f"spatialviz {__version__}\n"
    assert "usage: spatialviz" in spatialviz(0, "--help").out


def test_the_doctor_finds_the_demo_well(tmp_path: Path) -> None:
    found = spatialviz(0, "doctor", "demo", "--overlay", tmp_path / "edges.png", "--json").record
    assert {opinion["about"]: opinion["state"] for opinion in found["opinions"]}["poses"] == "fine"
    picture = cv2.imread(str(tmp_path / "edges.png"))
    assert picture is not None
    assert picture.shape == (4 * 480, 2 * 640, 3)


def test_every_frame_of_the_demo_is_fine() -> None:
    assert all(record["ok"] for record in spatialviz(0, "frames", "demo", "--json").records)


def test_an_answer_is_printed_and_saved_as_a_picture(tmp_path: Path) -> None:
    answer = spatialviz(0, "ask", "demo", 0, TEXT, "--json").record["answer"]
    assert answer["target"]["label"] == "mug"
    spatialviz(0, "ask", "demo", 0, TEXT, "--save", tmp_path / "answer.png")
    picture = cv2.imread(str(tmp_path / "answer.png"))
    assert picture is not None
    assert picture.shape == (630, 1200, 3)
    misused("ask", "demo", 0, TEXT, "--save", tmp_path / "answer.txt")
    misused("ask", "demo", 0, TEXT, "--save", tmp_path / "nowhere" / "answer.png")
    misused("ask", "demo", 0, TEXT, "--save", tmp_path / "right.gif")
    assert [p.name for p in tmp_path.iterdir()] == ["answer.png"]


def test_an_answer_is_saved_as_a_film_of_what_would_mend_it(tmp_path: Path) -> None:
    text = "which potted plant is on the left side of a shelf?"
    for name in ("film.gif", "film.webp"):
        spatialviz(0, "ask", "demo", 0, text, "--run", "demo", "--save", tmp_path / name)
        with Image.open(tmp_path / name) as film:
            assert film.size == (1200, 630)
            assert film.n_frames >= 2  # pyright: ignore[reportAttributeAccessIssue]


def test_a_run_answers_in_the_shell_as_in_the_page() -> None:
    told = spatialviz(0, "ask", "demo", 0, TEXT, "--run", "demo").out
    assert "mug·3 left of laptop·10" in told
    assert "CORRECT LUCKY" in told
    assert "--run demo" in spatialviz(0, "ask", "demo", 0, TEXT).out
    misused("ask", "demo", 0, TEXT, "--run", "demo", "--detector", "annotations")


def test_without_an_answer_or_with_words_left_out_nothing_is_called_true() -> None:
    tied = spatialviz(1, "ask", "demo", 0, "mug", "--json").record
    assert (tied["answer"], tied["verdict"]) == (None, None)
    dropped = spatialviz(1, "ask", "demo", 0, "the laptop to the right of the unicorn", "--json").record
    assert (dropped["answer"]["holds"], dropped["answer"]["relation_probability"]) == (None, None)
    assert "unicorn" in dropped["verdict_reason"]
    assert "not all of it was used" in spatialviz(1, "ask", "demo", 0, "the laptop to the right of the unicorn").out


def test_what_does_not_hold_is_told_with_the_nearest_pair_and_by_the_status() -> None:
    assert "no such pair; nearest is" in spatialviz(1, "ask", "demo", 0, BEHIND).out
    answer = spatialviz(1, "ask", "demo", 0, BEHIND, "--json").record["answer"]
    assert not answer["holds"]
    assert answer["relation_probability"] < 0.5 < answer["probability"]
    # Of several questions one that holds is enough.
    spatialviz(0, "ask", "demo", 0, BEHIND, TEXT)


def test_relations_are_true_undecided_or_false() -> None:
    for record in spatialviz(0, "relations", "demo", 0, "--json").records:
        assert set(record["states"].values()) <= {"T", "U", "F"}


def test_up_is_what_was_given() -> None:
    for record in spatialviz(0, "relations", "demo", 0, "--up", "camera:0,-1,0", "--json").records:
        assert (record["up"], record["up_source"]) == ([0, -1, 0], "given")
    asked = spatialviz(0, "ask", "demo", 0, TEXT, "--level-at", "300,400", "--json").record
    assert asked["viewer"]["up_source"] == "given"


def test_a_distance_is_measured_along_the_viewers_axes_too() -> None:
    found = spatialviz(0, "measure", "demo", 0, "120,200", "420,330", "--json").record
    assert found["right"] > 1
    assert found["distance"] > found["right"]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["measure", "demo", 0, "120,200", "420,9999"], "no such pixel; got 420,9999"),
        (["measure", "demo", 0, "120", "420,330"], "a pixel is two numbers"),
        (["relations", "demo", 0, "--up", "0,0"], "up must be a vector"),
        (["relations", "demo", 0, "--level-at", "9999,4"], "no such pixel; got 9999,4"),
        (["relations", "demo", 0, "--level-at", "abc"], "got 'abc'"),
        (["ask", "demo", 0, ""], "the expression is empty"),
        (["ask", "demo", 0, "zzz beside qqq"], "does not know the class 'zzz'"),
        (["ask", "demo", 0, "mug touching the laptop"], "'touching' is not a known relation"),
        (["ask", "demo", 9999, TEXT], "no frame '9999' among 12"),
        (["ask", "nowhere", 0, TEXT], "there is no such dataset"),
        (["whatif", "demo", 0, TEXT, "--do", "dance"], "there is no such edit; got dance"),
        (["frames", "demo", "--depth-model", "unidepth"], "its weights are CC BY-NC"),
    ],
    ids=lambda found: found if isinstance(found, str) else found[0],
)
def test_what_cannot_be_done_is_told_in_a_line(words: list[object], message: str) -> None:
    assert message in spatialviz(2, *words).err


@pytest.mark.parametrize(
    ("words", "message"),
    [(["ask", "demo"], "Missing from spatialviz ask"), (["nonsense"], "Unrecognized options: nonsense")],
)
def test_words_that_are_no_command_are_told_how_it_is_used(words: list[str], message: str) -> None:
    assert message in misused(*words).err


def test_what_a_command_sets_ends_with_it() -> None:
    def settings() -> dict[str, str]:
        return {name: value for name, value in os.environ.items() if name.startswith("SPATIALVIZ_")}

    shown, before = warnings.showwarning, settings()
    ask = ["ask", "demo", 0, TEXT]
    assert "too large to be read" in spatialviz(2, "--limits", "text=3", *ask).err
    spatialviz(0, *ask, "--provider", "cpu", "--verbose")
    assert settings() == before
    assert warnings.showwarning is shown
    spatialviz(0, *ask)


def test_rooms_are_rendered_once_and_remember_where_up_is(tmp_path: Path) -> None:
    rooms = tmp_path / "rooms"
    spatialviz(0, "render", rooms, *SMALL)
    spatialviz(0, "frames", rooms)
    spatialviz(0, "frames", rooms, "--up", "-1,0,0", "--remember")
    assert 'up = "world:-1,0,0"' in (rooms / "spatialviz.toml").read_text().splitlines()
    assert all(record["up_source"] == "given" for record in spatialviz(0, "frames", rooms, "--json").records)
    assert "the output folder is not empty" in spatialviz(2, "render", rooms, *SMALL).err


def test_edits_say_what_the_answer_would_be(tmp_path: Path) -> None:
    edits = tmp_path / "edits.json"
    edits.write_text(json.dumps({"hidden": ["#3"]}), encoding="utf-8")
    found = spatialviz(1, "whatif", "demo", 0, TEXT, "--edits", edits, "--json").record
    assert found["before"]["holds"]
    assert not found["after"]["holds"]
    said = spatialviz(1, "whatif", "demo", 0, TEXT, "--do", "hide", "set:k:5", "--json").record["edits"]
    assert (said["hidden"], said["k"]) == (["#3"], 5)
