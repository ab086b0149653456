"""Words said of an answer, all of them in `story.json`: a tone, a head and sentences for each kind of every verdict.

Of the sentences the first is said that is short enough and whose values are all known. Values: `target`, `reference`,
`phrase` of the question; `mine`, `beside`: what the answer's target and reference really are; `name`: the class that is
spoken of, `really` what it is; `ours`, `theirs`: a number of the answer and of the right pair, `times` so much higher.
"""

from __future__ import annotations

import json
from dataclasses import asdict
from functools import cache
from pathlib import Path
from string import Formatter
from typing import Any, Literal, TypeAlias

from pipeline.system.frozen import dataclass

Tone: TypeAlias = Literal["right", "also right", "wrong", "none"]
LONGEST = 25
"""Words of a sentence."""
WORDS: dict[str, Any] = json.loads(Path(__file__).with_name("story.json").read_text("utf-8"))
STORIES: dict[str, tuple[Tone, str, tuple[str, ...]]] = {
    kind: (tone, head, tuple(sentences))
    for kinds in WORDS["stories"].values()
    for kind, (tone, head, *sentences) in kinds.items()
}
"""Tone, head and sentences by kind."""
TRUTHS: dict[str, str] = WORDS["truths"]
"""What each oracle puts in place."""


@dataclass(frozen=True)
class Change:
    """Smallest change that makes an answer right, as a what-if can try it."""

    # Of the edits of a what-if: "relations", "confidences", "boxes"; of an object that was missed "added", "masks";
    # "question": `name` is asked instead
    field: str
    name: str  # The relation, or the class name
    objects: tuple[int, ...] = ()  # Places in the trace's objects: a pair, or one, or both of a pair with one score
    before: float | None = None  # The number that changes; None where there was none
    after: float | None = None  # None where nothing but a box changes
    # Of objects that were missed: names with the numbers of the labelled objects that are to be found by them
    labelled: tuple[tuple[str, int], ...] = ()
    names: tuple[str, ...] = ()  # Of each of `objects`, where they have several


@dataclass(frozen=True)
class Story:
    """What is said of an answer."""

    kind: str  # One of STORIES
    tone: Tone
    head: str
    sentence: str
    mend: str = ""  # The smallest change in words; empty where nothing need change, or nothing is known to help
    change: Change | None = None  # The same for a what-if; None where no single number of an edit would do

    def __str__(self) -> str:
        return " ".join(filter(None, (self.sentence, self.mend)))


UNTOLD = Story("", "none", "", "")


def story(kind: str, **values: Any) -> Story:
    """Story of a kind with its values; those that are None are not known."""
    tone, head, sentences = STORIES[kind]
    known = [s for s in sentences if all(values.get(name) is not None for name in values_of(s))]
    said = [capital(s.format(**values)) for s in known]
    sentence = next((s for s in said if len(s.split()) <= LONGEST), min(said, key=lambda s: len(s.split())))
    return Story(kind, tone, capital(head.format(**values)), sentence)


def words(group: str, kind: str, **values: Any) -> str:
    """Words of another group of `story.json`."""
    return WORDS[group][kind].format(**values)


@cache
def values_of(template: str) -> set[str]:
    """Names of the values in a template."""
    return {name for _, name, _, _ in Formatter().parse(template) if name}


def capital(text: str) -> str:
    """Text with a capital first letter."""
    return text[:1].upper() + text[1:]


def story_record(told: Story) -> dict[str, Any]:
    """Story as in `ask --json`: the mend with the number that a what-if would change, or null."""
    change = None if told.change is None else asdict(told.change)
    mend = {"said": told.mend, "change": change} if told.mend else None
    return {
        "head": told.head,  # Right or wrong, in a few words
        "tone": told.tone,  # good, doubt, bad or none
        "kind": told.kind,  # Of what is said
        "said": told.sentence,  # Why, in a sentence
        "mend": mend,  # Smallest change that helps: said, change; null where none is known
    }
