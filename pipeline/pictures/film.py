"""Film of two seconds: an answer as it was given, and as it is with a change."""

from __future__ import annotations

import cv2
import numpy as np

from pipeline.diagnosis.answer import Answer
from pipeline.diagnosis.whatif.try_mend import try_mend
from pipeline.pictures.answer_card import answer_picture
from pipeline.pictures.writing import Film
from pipeline.system.errors import needed

SHOWN_MS, FADE_MS, FADES = 1000, 50, 3
"""How long each answer stands, and each picture between the two."""


def mending_film(answer: Answer, dataset: str = "", moving: bool = True) -> Film:
    """Film of an answer before and after the change that its story names; as `answer_film`.

    Raises
    ------
    InputError
        It names none: the answer is right, the truth is unknown, or no single change is known to mend it.
    """
    tried = needed(try_mend(answer), "there is no film: no single change is known that would mend this answer")
    return answer_film(answer, tried.answer, dataset, moving)


def answer_film(before: Answer, after: Answer, dataset: str = "", moving: bool = True) -> Film:
    """Film of an answer before and after a change.

    `dataset`: its name, told below; `moving`: with pictures in which one becomes the other.
    """
    sides = ((before, after, "before"), (after, before, "with the change"))
    first, last = (answer_picture(a, dataset=dataset, caption=said, beside=other) for a, other, said in sides)
    shares = np.linspace(0, 1, FADES + 2)[1:-1] if moving else ()
    between = [cv2.addWeighted(first, 1 - share, last, share, 0) for share in shares]
    return Film((first, *between, last), (SHOWN_MS, *[FADE_MS] * len(between), SHOWN_MS))
