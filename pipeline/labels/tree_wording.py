"""A noun phrase in words: the sentence of a tree, which the grammar reads back as that tree."""

from __future__ import annotations

from collections.abc import Collection

from pipeline.language.choices import EXTREMES, ORDINALS
from pipeline.language.noun_phrase import noun_phrase, readable
from pipeline.language.tree import Attachment, Choice, Node

FRAMES = ("{}", "{}", "{}", "find {}", "show me {}", "point to {}", "where {is_} {}?", "I am looking for {}")
_NUMBERED = {number: word for word, number in reversed(ORDINALS.items()) if word.isalpha()}


def tree_text(root: Node, several: Collection[int], key: int) -> str:
    """Sentence of a tree: `find the leftmost book that is on the table`.

    Parameters
    ----------
    several
        Mentions of the nouns that mean several things: they take `a`, since `the` would claim that there is one.
    key
        At least 0; it chooses among the forms. Equal input gives equal text.
    """
    key, frame = divmod(key, len(FRAMES))
    return FRAMES[frame].format(
        phrase_text(root, several, linked=key % 2 > 0), is_=noun_phrase(readable(root.name)).verb
    )


def phrase_text(node: Node, several: Collection[int], *, linked: bool = False) -> str:
    """Word a noun phrase; `linked` puts a relative clause before relations."""
    if node.viewer:
        return f"the {node.label}"
    before, after = zip(*(_around(choice) for choice in node.choices), strict=True) if node.choices else ((), ())
    words = [*before, node.label.removesuffix(node.name).strip(), readable(node.name)]
    noun = noun_phrase(" ".join(w for w in words if w))
    parts = [noun.indefinite() if node.mention in several else noun.definite(), *dict.fromkeys(after)]
    for number, attachment in enumerate(node.attachments):
        # `from the left on the table` would be hard to read.
        linked = linked or any(after)
        parts.append(_relation(attachment, several, number, linked=linked, verb=noun.verb))
    return " ".join(p for p in parts if p)


def _around(choice: Choice) -> tuple[str, str]:
    if choice.text in EXTREMES:
        return (choice.text if choice.rank == 1 else f"{_NUMBERED[choice.rank or 1]} {choice.text}"), ""
    first, _, rest = choice.text.partition(" ")
    return (first, rest) if first in ORDINALS else ("", choice.text)


def _relation(attachment: Attachment, several: Collection[int], number: int, *, linked: bool, verb: str) -> str:
    (end,) = attachment.nodes
    link = f"that {verb} " if not number and (linked or attachment.negated) else ""
    joint = "" if not number else "but " if attachment.negated else "and "
    negation = "not " if attachment.negated else ""
    return f"{joint}{link}{negation}{attachment.phrase} {phrase_text(end, several)}"
