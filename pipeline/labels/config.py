"""What labels depend on: how they are made, and which expressions are kept."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from math import inf
from typing import Any, Literal

from pipeline.geometry.lifting import LiftConfig
from pipeline.labels.profiles import RuleProfile, canonical_hash, profile_of
from pipeline.language.naming import normal_form
from pipeline.language.relation_names import PAIRWISE, VOCABULARIES
from pipeline.relations.relations import PROFILE
from pipeline.system.errors import require

TextStyle = Literal["varied", "plain", "semantic-abstraction"]

BACKGROUND = (
    "background", "wall", "floor", "ceiling", "ground", "room", "carpet", "unknown", "unlabeled", "otherprop",
    "otherstructure", "otherfurniture",
)  # fmt: skip
"""Classes that surround the others: nobody stands left of the floor."""


@dataclass(frozen=True)
class LabelConfig:
    """How a frame is labelled. Everything here changes the labels, and so their hash.

    Attributes
    ----------
    profile : str
        Rule profile, see `pipeline.labels.profiles`.
    vocabulary : str
        "avd", "semantic-abstraction" or "all".
    lift : LiftConfig
    min_pixels, min_points : int
        An object with fewer is not asked for.
    background : tuple of str
        Classes that take no part in relations.
    style : str
        How expressions are worded.
    seed : int
        Of the row hashes, which choose wordings and, in the merge, expressions.
    second_opinion : str
        "trained", "none", or the path of a network: see `labels.profiles`.
        Published geometry is taken as published, without one.
    """

    profile: str = PROFILE
    vocabulary: str = "avd"
    lift: LiftConfig = field(default_factory=LiftConfig)
    min_pixels: int = 200
    min_points: int = 16
    background: tuple[str, ...] = BACKGROUND
    style: TextStyle = "varied"
    seed: int = 0
    second_opinion: str = "trained"

    def __post_init__(self) -> None:
        if self.profile != PROFILE:
            object.__setattr__(self, "second_opinion", "none")
        require(
            self.vocabulary in VOCABULARIES,
            "no such vocabulary",
            got=repr(self.vocabulary),
            expected=" | ".join(VOCABULARIES),
        )
        require(self.relations, f"profile {self.profile} judges no relation of the vocabulary {self.vocabulary}")
        require(self.seed >= 0, "a seed must be at least 0", got=self.seed)

    @property
    def rules(self) -> RuleProfile:
        return profile_of(self.profile)

    @property
    def relations(self) -> tuple[str, ...]:
        """The vocabulary's relations that the profile judges, in the order of PAIRWISE."""
        wanted = VOCABULARIES[self.vocabulary]
        return tuple(r for r in PAIRWISE if r in wanted and r in self.rules.relations)

    def is_background(self, label: str) -> bool:
        return normal_form(label) in {normal_form(b) for b in self.background}

    def record(self) -> dict[str, Any]:
        """As JSON, the hash of the profile's thresholds included."""
        return {**asdict(self), "background": list(self.background), "profile_hash": self.rules.hash}

    @property
    def hash(self) -> str:
        """sha256 of `record`."""
        return canonical_hash(self.record())


@dataclass(frozen=True)
class SelectConfig:
    """Which of all candidate expressions are kept.

    Attributes
    ----------
    total : int or None
        At most so many; None for as many as the other rules allow.
    per_frame : int or None
        At most so many of one frame.
    balance : float or None
        No relation has more than so many times the expressions of the rarest
        one; None keeps the relations as they come.
    telling : bool
        Leave out what is true of every object of the target's class, where there
        are several: such a sentence tells nothing apart.
    seed : int
    """

    total: int | None = None
    per_frame: int | None = 40
    balance: float | None = 3.0
    seed: int = 0
    telling: bool = True

    def __post_init__(self) -> None:
        for name in ("total", "per_frame"):
            value = getattr(self, name)
            require(value is None or value >= 1, f"{name} must be at least 1", got=value)
        require(
            self.balance is None or 1 <= self.balance < inf, "balance must be a number of at least 1", got=self.balance
        )
