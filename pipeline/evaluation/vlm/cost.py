"""What was asked, and what it costs."""

from __future__ import annotations

import math
from dataclasses import dataclass

from pipeline.system.errors import InputError

CHARACTERS_A_TOKEN = 4
PICTURE_TOKENS = 576
"""For a server that does not count: English text has about four characters a token, and LLaVA-1.5 turns a picture into
24 x 24 tokens. Models that tile large pictures take more."""


@dataclass(frozen=True)
class Usage:
    """Counts of one client since it was made.

    Attributes
    ----------
    requests : int
        Questions sent, every try counted.
    answers : int
        Answers that came over the wire.
    cached : int
        Answers that the cache had.
    prompt_tokens, completion_tokens : int
        Of `answers`.
    cached_prompt_tokens, cached_completion_tokens : int
        Of `cached`: what they took when they were asked.
    estimated : int
        How many of all these answers have estimated tokens, for want of the server's count.
    """

    requests: int = 0
    answers: int = 0
    cached: int = 0
    prompt_tokens: int = 0
    completion_tokens: int = 0
    cached_prompt_tokens: int = 0
    cached_completion_tokens: int = 0
    estimated: int = 0


@dataclass(frozen=True)
class Prices:
    """Money for a million tokens, in any currency."""

    per_million_in: float
    per_million_out: float

    def __post_init__(self) -> None:
        if not all(0 <= price < math.inf for price in (self.per_million_in, self.per_million_out)):
            raise InputError(
                "a price of a million tokens must be 0 or more", got=f"{self.per_million_in}, {self.per_million_out}"
            )


def money(usage: Usage, prices: Prices, *, with_cached: bool = False) -> float:
    """What the answers cost; with `with_cached`, what they would cost without a cache.

    Tries that brought no answer are not counted: servers differ in whether they charge for them.
    """
    tokens_in = usage.prompt_tokens + (usage.cached_prompt_tokens if with_cached else 0)
    tokens_out = usage.completion_tokens + (usage.cached_completion_tokens if with_cached else 0)
    return (tokens_in * prices.per_million_in + tokens_out * prices.per_million_out) / 1e6


def estimated_tokens(text: str) -> int:
    """Tokens of a text, about."""
    return math.ceil(len(text) / CHARACTERS_A_TOKEN)
