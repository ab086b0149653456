"""The sentences of questions; the words for objects and relations are those of the expressions."""

from __future__ import annotations

import re
from collections.abc import Sequence

from pipeline.labels.wording import can_be_worded, question_text
from pipeline.language.noun_phrase import noun_phrase, readable
from pipeline.language.relation_names import RELATIONS
from pipeline.system.errors import InputError

BRIEF = "Answer the question using a single word or phrase."
"""LLaVA's own words for a short answer."""

WHICH = (
    "Which object is {phrase} {the}?",
    "What is {phrase} {the}?",
    "Name the object {phrase} {the}.",
    "In this image, which object is {phrase} {the}?",
)
WHICH_PHRASE = {name: r.which or r.phrase for name, r in RELATIONS.items()}
"""`What is left of the lamp?` would ask for its remains."""

GROUNDING = (
    "Please provide the bounding box coordinate of the region this sentence describes: {text}",
    "Give the normalised bounding box of what this describes: {text}",
    "Locate the following as [x0, y0, x1, y1], each from 0 to 1: {text}",
)
DISTANCE = {
    "center": (
        "How far is it from the centre of {a} to the centre of {b}, in metres?",
        "What is the distance between the centres of {a} and {b}, in metres?",
    ),
    "gap": (
        "How wide is the gap between {a} and {b}, in metres?",
        "How far apart are {a} and {b} at their nearest sides, in metres?",
    ),
}
SIZE = {
    "height": ("How tall {verb} {a}, in metres?", "What is the height of {a}, in metres?"),
    "width": (
        "How wide {verb} {a} from side to side as seen from the camera, in metres?",
        "As seen from the camera, what is the width of {a}, in metres?",
    ),
}
_TOKEN = re.compile(r"<[^<>\s]+>")
"""What a tokenizer may take for one of its own marks: `<image>`, `</s>`, `<|im_end|>`."""


def can_be_asked(name: str) -> bool:
    """Whether a class name can stand in a question."""
    return can_be_worded(name) and bool(readable(name)) and not _TOKEN.search(name)


def _the(name: str) -> str:
    return noun_phrase(readable(name)).definite()


def _pick(templates: Sequence[str], key: int) -> str:
    return templates[key % len(templates)]


def _checked(text: str) -> str:
    if _TOKEN.search(text):
        raise InputError("a sentence that a tokenizer would misread", got=repr(text)[:80])
    return text


def ask_relation(relation: str, target: str, reference: str, key: int) -> str:
    return _checked(f"{question_text(relation, target, reference, key)}\n{BRIEF}")


def ask_which(relation: str, reference: str, key: int) -> str:
    return _checked(_pick(WHICH, key).format(phrase=WHICH_PHRASE[relation], the=_the(reference)) + f"\n{BRIEF}")


def ask_grounding(text: str, key: int) -> str:
    return _checked(_pick(GROUNDING, key).format(text=text))


def ask_distance(measure: str, a: str, b: str, key: int) -> str:
    return _checked(_pick(DISTANCE[measure], key).format(a=_the(a), b=_the(b)) + f"\n{BRIEF}")


def ask_size(measure: str, name: str, key: int) -> str:
    phrase = noun_phrase(readable(name))
    return _checked(_pick(SIZE[measure], key).format(a=phrase.definite(), verb=phrase.verb) + f"\n{BRIEF}")


def say_name(name: str) -> str:
    return readable(name)


def say_yes(holds: bool) -> str:
    return "Yes" if holds else "No"


def say_metres(value: float) -> str:
    return f"{value:.2f} m"


def say_box(bbox: Sequence[float], width: int, height: int, decimals: int) -> str:
    """[x0, y0, x1, y1] as shares of the picture's width and height."""
    shares = [min(max(x / of, 0.0), 1.0) for x, of in zip(bbox, (width, height, width, height), strict=True)]
    return "[" + ", ".join(f"{x:.{decimals}f}" for x in shares) + "]"
