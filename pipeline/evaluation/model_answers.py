"""What a model's words mean: yes or no, or a box, in one of the many ways in which models write one."""

from __future__ import annotations

import math
import re
import unicodedata
from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

from pipeline.system.frozen import dataclass

_YES = frozenset({"yes", "yeah", "yep", "yup"})
_NO = frozenset({"nope", "nah"})
_AGREES = {"true": True, "correct": True, "affirmative": True, "false": False, "incorrect": False, "untrue": False}
_SAYS_OF = frozenset({"is", "it's", "that's", "is not", "isn't", "be", "are"})
_NEGATES = frozenset({"not", "never", "neither", "cannot", "can't", "isn't", "wouldn't", "don't", "doesn't", "without"})
_NO_ANSWERS = frozenset({"idea", "clue", "doubt", "problem", "way", "information", "answer", "comment"})
"""Nouns before which `no` answers nothing: `no idea`."""
_REASONING = re.compile(r"[<◁\[](/?)(?:think|thinking|thought|reasoning)[>▷\]]", re.IGNORECASE)
_ANSWER = re.compile(r"<answer>(.*?)(?:</answer>|$)", re.IGNORECASE | re.DOTALL)
_LONGEST = 4000
"""Characters of an answer that are read: its first and its last half so many."""
_INSTRUCTION = re.compile(r"\b(?:answer|respond|reply)\b[^.:!?\n]*?\byes(?: or |/)no\b(?: only)?")
_FINAL = re.compile(
    r"\banswer\b(?:\W*(?:is|would be|should be|must be)\b)?\W*(?:that\W+)?"
    r"(yes|no|true|false|correct|incorrect)\b(?![ -]?\d)"
)
_WORD = re.compile(r"[^\W\d_]+(?:'[^\W\d_]+)*|\d+|[^\w\s]|_|\n")
_WORD_LIKE = re.compile(r"[^\W_]")

_NUMBER = r"[-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:e[-+]?\d+)?"
_VALUE = (
    rf"(?:(?<![\w.])(?:{_NUMBER}|[-+]?(?:nan|inf(?:inity)?))(?![a-z\d]|\.\d)(?:\s*(?:%|px\b|pixels?\b))?|"
    rf"(?<![\w.]){_NUMBER}(?:px|pixels?)\b)"
)
_READ = re.compile(rf"({_NUMBER}|[-+]?(?:nan|inf(?:inity)?))\s*(%|px|pixels?)?")
_COMMA = r"\s*[,;|/]\s*|\s+"
_GROUP = re.compile(rf"[\[({{<]\s*((?:{_VALUE})(?:(?:{_COMMA})(?:{_VALUE}))*)\s*[,;]?\s*[\])}}>]")
_POINT = re.compile(rf"[\[({{]\s*x\s*[:=]\s*({_VALUE})(?:{_COMMA})y\s*[:=]\s*({_VALUE})\s*[\])}}]")
_RUN = re.compile(rf"{_VALUE}(?:(?:{_COMMA}|\s*,?\s*\b(?:to|and)\b\s*){_VALUE})+")
_NAMED = re.compile(
    r"(?<![a-z\d])[\"']?([xy][_ ]?(?:min|max|[012])|(?:min|max)[_ ]?[xy]|left|top|right|bottom|width|height|[xywh])"
    rf"[\"']?\s*[:=]\s*({_VALUE})"
)
_SCHEMES = (
    ("x0", "y0", "x1", "y1"),
    ("x1", "y1", "x2", "y2"),
    ("xmin", "ymin", "xmax", "ymax"),
    ("left", "top", "right", "bottom"),
)
_SIZED = ({"x", "y", "w", "h"}, {"x", "y", "width", "height"}, {"left", "top", "width", "height"})
_PALIGEMMA = re.compile(r"(?:<loc\d{4}>\s*){4}")
_FLORENCE = re.compile(r"(?:<loc_\d{1,3}>\s*){4}")
_QWEN = re.compile(r"(?:<box>|<\|box_start\|>)")


@dataclass(frozen=True)
class _BoxNumbers:
    """Numbers that stand together, as they were written."""

    values: tuple[float, ...]
    unit: Literal["", "%", "px"] = ""
    decimal: bool = False
    scale: float | None = None
    boxes: int = 1
    named: bool = False  # each corner has its name, so that their order is sure


def box_numbers(text: str) -> _BoxNumbers | str:
    """Numbers of the first box of a text in the order in which they stand, or a reason for none; not finite is none."""
    plain = unicodedata.normalize("NFKC", text).lower().replace("−", "-").replace("–", "-").replace("**", "")
    found = _numbers(plain)
    if not isinstance(found, str) and not all(map(math.isfinite, found.values)):
        return "numbers that are not finite"
    return found


def _numbers(text: str) -> _BoxNumbers | str:
    """Numbers of the first box in the order x0, y0, x1, y1, or a reason for none."""
    if match := _PALIGEMMA.search(text):
        y0, x0, y1, x1 = (float(n) for n in re.findall(r"\d{4}", match[0]))
        return _BoxNumbers((x0, y0, x1, y1), scale=1024, boxes=len(_PALIGEMMA.findall(text)))
    if match := _FLORENCE.search(text):
        values = tuple(float(n) for n in re.findall(r"\d{1,3}", match[0]))
        return _BoxNumbers(values, scale=1000, boxes=len(_FLORENCE.findall(text)))
    named = _by_name(text)
    if named is not None:
        return named
    return _in_brackets(text) or _in_a_row(text) or _refused(text)


def named_numbers(text: str) -> dict[str, list[str]]:
    """Numbers as written in a text in small letters by the names of edges and sizes before them: x, ymin, width, ..."""
    rows: dict[str, list[str]] = {}
    for key, value in _NAMED.findall(text):
        key = re.sub(r"[_ ]", "", key)
        key = key[3:] + key[:3] if key[:3] in ("min", "max") else key
        rows.setdefault(key, []).append(value)
    return rows


def _by_name(text: str) -> _BoxNumbers | str | None:
    rows = named_numbers(text)
    for scheme in _SCHEMES:
        if all(key in rows for key in scheme):
            boxes = min(len(rows[key]) for key in scheme)
            return replace(_found([rows[key][0] for key in scheme], boxes=boxes), named=True)
    if any(keys <= set(rows) for keys in _SIZED):
        return "a corner with width and height, not two corners"
    return None


def _in_brackets(text: str) -> _BoxNumbers | None:
    groups = [(m.start(), m.end(), re.findall(_VALUE, m[1])) for m in _GROUP.finditer(text)]
    groups += [(m.start(), m.end(), [m[1], m[2]]) for m in _POINT.finditer(text)]
    groups.sort()
    boxes: list[list[str]] = []
    index = 0
    while index < len(groups):
        _, end, values = groups[index]
        following = groups[index + 1] if index + 1 < len(groups) else None
        if len(values) == 4:
            boxes.append(values)
        elif len(values) == 2 and following and len(following[2]) == 2 and following[0] - end <= 60:
            boxes.append(values + following[2])
            index += 1
        index += 1
    scale = 1000 if _QWEN.search(text) else None
    return _found(boxes[0], boxes=len(boxes), scale=scale) if boxes else None


def _in_a_row(text: str) -> _BoxNumbers | None:
    runs = [re.findall(_VALUE, m[0]) for m in _RUN.finditer(text)]
    fours = [run for run in runs if len(run) == 4]
    return _found(fours[0], boxes=len(fours)) if fours else None


def _refused(text: str) -> str:
    counts = [len(re.findall(_VALUE, m[0])) for m in _RUN.finditer(text)]
    return f"{max(counts)} numbers, not the 4 of a box" if counts else "no box"


def _found(written: list[str], boxes: int, scale: float | None = None) -> _BoxNumbers:
    read = [_READ.match(value) for value in written]
    units = {match[2] for match in read if match} - {None}
    values = tuple(float(match[1]) for match in read if match)
    decimal = any("." in value or "e-" in value for value in written)
    return _BoxNumbers(values, "%" if "%" in units else "px" if units else "", decimal, scale, boxes)


@dataclass(frozen=True)
class YesNo:
    """A yes or a no."""

    value: bool | None  # None where the answer is neither, or both
    reason: str | None = None  # why there is none


def spoken_part(text: str) -> tuple[str, str | None]:
    """An answer without the model's leading reasoning, and the reason for an empty answer.

    Reasoning stands between <think>, [THINK] (Magistral) or ◁think▷ (Kimi-VL) and what closes it; the first mark may be
    in the prompt. Of what follows the last <answer> counts, where there is one.
    """
    closed, opened = 0, False
    for match in _REASONING.finditer(text):
        if match[1]:
            closed, opened = match.end(), False
        else:
            opened = True
    if opened:
        return "", "the answer ends within its reasoning"
    text = text[closed:].strip()
    tagged = _ANSWER.findall(text)
    text = tagged[-1].strip() if tagged else text
    if len(text) > _LONGEST:
        text = f"{text[: _LONGEST // 2]}\n...\n{text[-_LONGEST // 2 :]}"
    return (text, None) if text else ("", "an empty answer")


def parse_yes_no(text: str) -> YesNo:
    """Read an English answer as yes or no.

    "Yes.", "no, the mug is ...", "**Yes**", "The answer is yes", "That is not correct" are read. An explicit
    "answer: no" counts before everything else. Both in one answer, neither, and other languages give None.
    """
    text, reason = spoken_part(text)
    if reason:
        return YesNo(None, reason)
    plain = unicodedata.normalize("NFKC", text).lower().replace("’", "'").replace("‘", "'")
    plain = _INSTRUCTION.sub(" ", re.sub(r"[*_`~\"“”]+", "", plain))
    if plain.strip(" .!'()[]\n") in ("y", "n"):
        return YesNo(plain.strip(" .!'()[]\n") == "y")
    final = {_AGREES.get(word, word == "yes") for word in _FINAL.findall(plain)}
    found = final or _verdicts(_WORD.findall(plain))
    if len(found) == 1:
        return YesNo(found.pop())
    return YesNo(None, "both yes and no" if found else "neither yes nor no")


def _verdicts(tokens: Sequence[str]) -> set[bool]:
    """Collect the verdicts of an answer: a yes anywhere, a no by itself, a word of agreement."""
    found: set[bool] = set()
    first = next((i for i, token in enumerate(tokens) if _WORD_LIKE.match(token)), -1)
    for i, token in enumerate(tokens):
        before, after = tokens[max(i - 3, 0) : i], tokens[i + 1] if i + 1 < len(tokens) else ""
        alone = not _WORD_LIKE.match(after)
        if token in _YES and not _NEGATES & set(before):
            found.add(True)
        elif token in _NO:
            found.add(False)
        elif token == "no":
            numbered = after == "." and i + 2 < len(tokens) and tokens[i + 2].isdecimal()
            if not numbered and not _NEGATES & set(before) and (alone or (i == first and after not in _NO_ANSWERS)):
                found.add(False)
        elif token in _AGREES:
            last = before[-1] if before else ""
            if (i == first and alone) or last in _SAYS_OF or last == "not":
                found.add(_AGREES[token] != (last in ("not", "isn't")))
    return found
