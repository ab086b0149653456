"""Placeholder until the wording branch lands: the names that exports use of it."""

from dataclasses import dataclass


@dataclass(frozen=True)
class NounPhrase:
    words: str

    @property
    def verb(self) -> str:
        return "is"

    def definite(self) -> str:
        return f"the {self.words}"


def noun_phrase(words: str) -> NounPhrase:
    return NounPhrase(words)


def readable(name: str) -> str:
    return " ".join(name.replace("_", " ").split())
