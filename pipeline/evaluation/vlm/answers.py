"""What a model's words mean: yes or no."""

from __future__ import annotations

import math
import re
import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass

from pipeline.evaluation.vlm.protocol import Alternatives

_YES = frozenset({"yes", "yeah", "yep", "yup"})
_NO = frozenset({"nope", "nah"})
_AGREES = {"true": True, "correct": True, "affirmative": True, "false": False, "incorrect": False, "untrue": False}
_SAYS_OF = frozenset({"is", "it's", "that's", "is not", "isn't", "be", "are"})
_NEGATES = frozenset({"not", "never", "neither", "cannot", "can't", "isn't", "wouldn't", "don't", "doesn't", "without"})
_NO_ANSWERS = frozenset({"idea", "clue", "doubt", "problem", "way", "information", "answer", "comment"})
"""Nouns before which `no` answers nothing: `no idea`."""

_REASONING = re.compile(r"<(/?)(?:think|thinking|reasoning)>", re.IGNORECASE)
_LONGEST = 4000
"""Characters of an answer that are read: its first and its last half so many."""

_INSTRUCTION = re.compile(r"\b(?:answer|respond|reply)\b[^.:!?\n]*?\byes(?: or |/)no\b(?: only)?")
_FINAL = re.compile(
    r"\banswer\b(?:\W*(?:is|would be|should be|must be)\b)?\W*(?:that\W+)?"
    r"(yes|no|true|false|correct|incorrect)\b(?![ -]?\d)"
)
_WORD = re.compile(r"[^\W\d_]+(?:'[^\W\d_]+)*|\d+|[^\w\s]|_|\n")
_WORD_LIKE = re.compile(r"[^\W_]")


@dataclass(frozen=True)
class YesNo:
    """A yes or a no.

    Attributes
    ----------
    value : bool or None
        None where the answer is neither, or both.
    reason : str or None
        Why there is none.
    """

    value: bool | None
    reason: str | None = None


def spoken_part(text: str) -> tuple[str, str | None]:
    """An answer without the reasoning that some models write before it, and why nothing is left, if so."""
    closed, opened = 0, False
    for match in _REASONING.finditer(text):
        if match[1]:
            closed, opened = match.end(), False
        else:
            opened = True
    if opened:
        return "", "the answer ends within its reasoning"
    text = text[closed:].strip()
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
    """All that is said as an answer: a yes anywhere, a no that stands for itself, a word of agreement about it."""
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


def yes_probability(logprobs: Sequence[Alternatives]) -> float | None:
    """P(yes) / (P(yes) + P(no)) at the first token of an answer that is one of them; None where none is.

    Spellings ("Yes", " yes", "YES") are summed. One that is not among the alternatives counts as zero.
    """
    for place in logprobs:
        if not place or _plain_token(place[0][0]) not in ("yes", "no"):
            continue
        mass = {"yes": 0.0, "no": 0.0}
        for token, logprob in place:
            word = _plain_token(token)
            if word in mass:
                mass[word] += math.exp(logprob)
        total = mass["yes"] + mass["no"]
        return mass["yes"] / total if total > 0 else None
    return None


def _plain_token(token: str) -> str:
    """A token without the marks by which tokenizers write a space, and without punctuation."""
    return re.sub(r"[\W_ĠĊ▁]+", "", token).lower()
