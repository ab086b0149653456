"""Films: the answer, then what the change of its story makes of it, seen from one place."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline import InputError, Run, open_run
from pipeline.datasets.demo import demo_run
from pipeline.pictures.answer_card import MARKS, SIZE, STAGE
from pipeline.pictures.film import answer_film, mending_film


@pytest.fixture(scope="module")
def run() -> Run:
    return open_run(demo_run())


@pytest.mark.parametrize("search", ["verdict:OPM-CONF", "verdict:OPM-TARGET detail:ABSENT"])
def test_a_film_goes_from_wrong_to_right_in_two_seconds(run: Run, search: str) -> None:
    film = mending_film(run.failures(search)[0].answer, "demo")
    assert len(film.pictures) == len(film.milliseconds)
    assert 1900 <= sum(film.milliseconds) <= 2300
    assert {p.shape for p in film.pictures} == {(SIZE[1], SIZE[0], 3)}
    wrong, right = (color for color, _, _ in (MARKS["wrong"], MARKS["right"]))
    for picture, color in ((film.pictures[0], wrong), (film.pictures[-1], right)):
        assert (picture == color).all(axis=2).sum() > 500


def test_both_are_seen_from_one_place(run: Run) -> None:
    found = run.failures("verdict:SRM")[0].answer
    first, last = mending_film(found, moving=False).pictures
    x, y, width, height = STAGE
    half = slice(y + height // 2, y + height - 60), slice(x + 20, x + width - 20)
    alike = (np.abs(first[half].astype(int) - last[half]).max(axis=2) < 80).mean()
    assert alike > 0.7
    same = answer_film(found, found, moving=False)
    np.testing.assert_array_equal(same.pictures[0][:, : STAGE[0]], same.pictures[1][:, : STAGE[0]])


def test_where_nothing_mends_there_is_no_film(run: Run) -> None:
    with pytest.raises(InputError, match="no single change is known"):
        mending_film(run.failures("verdict:CORRECT")[0].answer)
