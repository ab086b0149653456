"""A question with its answer, as a record of a LLaVA-style conversation file."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal

from pipeline.system.errors import require

Kind = Literal["relation", "which", "grounding", "distance", "size"]
KINDS: tuple[Kind, ...] = ("relation", "which", "grounding", "distance", "size")
IMAGE_TOKEN = "<image>"
CONVERSATIONS_FILE = "conversations.json"


@dataclass(frozen=True)
class VqaConfig:
    """What is asked.

    Attributes
    ----------
    per_frame : int
        At most so many questions of a frame.
    kinds : tuple of str
        Out of KINDS; they take turns.
    min_margin : float
        Metres that a relation must stand from its thresholds to be asked for.
    max_occluded : float
        Gaps, and distances and sizes without a given 3D box, are asked only of
        objects with at most this share of their border covered, that do not touch
        the picture's border.
    min_visible : float
        And of which the dataset, where it says so, sees at least this share.
    max_depth_missing : float
        And with at most this share of their pixels without depth.
    min_kept : float
        And of whose mask cleaning kept at least this share.
    min_distance : float
        Distances below it, metres, are not asked for.
    box_decimals : int
        2 or 3: digits of the normalised box in an answer.
    seed : int
        Of the row hashes that choose questions and wordings.
    """

    per_frame: int = 24
    kinds: tuple[Kind, ...] = KINDS
    min_margin: float = 0.05
    max_occluded: float = 0.05
    min_visible: float = 0.9
    max_depth_missing: float = 0.5
    min_kept: float = 0.6
    min_distance: float = 0.1
    box_decimals: int = 3
    seed: int = 0

    def __post_init__(self) -> None:
        require(self.per_frame >= 1, "per_frame must be at least 1", got=self.per_frame)
        require(
            self.kinds and not (set(self.kinds) - set(KINDS)),
            "kinds of questions",
            got=", ".join(self.kinds) or "none",
            expected=" | ".join(KINDS),
        )
        require(self.box_decimals in (2, 3), "box_decimals", got=self.box_decimals, expected="2 or 3")
        require(self.min_margin >= 0 and self.min_distance >= 0, "a least margin or distance cannot be negative")


@dataclass(frozen=True)
class Question:
    """One question about one frame.

    Attributes
    ----------
    id : str
    image : str
        File name of the picture, relative to the export.
    kind : str
    frame : str
    frame_index : int
    objects : tuple of int
        relation: (target, reference). which: (answer, reference). grounding:
        (target, reference). distance: the two. size: the one.
    about : str
        The relation; or what is measured: "center", "gap", "height", "width".
    question, answer : str
        What the human says without the image token, and what the model is to say.
    source : str or None
        Of a grounding question the id of its expression.
    rests_on : str or None
        Of a distance or a size what its figure was measured on: see `vqa_geometry`.
    """

    id: str
    image: str
    kind: Kind
    frame: str
    frame_index: int
    objects: tuple[int, ...]
    about: str
    question: str
    answer: str
    source: str | None = field(default=None)
    rests_on: str | None = field(default=None)

    def record(self) -> dict[str, Any]:
        """As LLaVA's training data has it, with `metadata` beside."""
        return {
            "id": self.id,
            "image": self.image,
            "conversations": [
                {"from": "human", "value": f"{IMAGE_TOKEN}\n{self.question}"},
                {"from": "gpt", "value": self.answer},
            ],
            "metadata": {
                "kind": self.kind,
                "frame": self.frame,
                "frame_index": self.frame_index,
                "objects": list(self.objects),
                "about": self.about,
                "source": self.source,
                "rests_on": self.rests_on,
            },
        }
