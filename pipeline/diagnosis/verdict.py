"""Verdict of an answer with the evidence behind it; `decision` finds it, `story` says it in words."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import field
from typing import Literal

import numpy as np

from pipeline.answering.pair_table import ScoredPair, one_object_twice
from pipeline.diagnosis.frame_evidence import FrameEvidence
from pipeline.diagnosis.minimal_repair import FactorRepair
from pipeline.diagnosis.needed_score import NeededScore
from pipeline.diagnosis.oracles import names_of
from pipeline.diagnosis.story_words import UNTOLD, Story, story
from pipeline.diagnosis.substitution import substitute
from pipeline.geometry.boxes import Box3D
from pipeline.labels.cases import Case, FrameCases
from pipeline.system.frozen import dataclass

Miss = Literal["RANK", "THRESHOLD", "LOCALISATION", "ABSENT"]

NOT_SEEN = "NOT-SEEN"
VERDICTS: tuple[str, ...] = (
    "CORRECT",
    "PARSE",
    "LABEL",
    NOT_SEEN,
    "OPM-TARGET",
    "OPM-REF",
    "LIFT",
    "ATTRIBUTE",
    "SRM",
    "OPM-CONF",
    "PRM",
    "COMPOUND",
    "UNEXPLAINED",
)
"""In the order in which they are decided; ATTRIBUTE only of expressions with attributes, UNEXPLAINED only of imported
predictions, NOT-SEEN only with an object map."""


def shown_detail(detail: str | None, lucky: bool = False) -> str:
    """Detail of a verdict as printed; modules by the names of verdicts: `SRM+CONF` is SRM+OPM-CONF."""
    if lucky:
        return "LUCKY"
    return "+".join({"RECALL": "OPM", "CONF": "OPM-CONF"}.get(part, part) for part in (detail or "").split("+"))


def shown_verdict(verdict: str, detail: str | None, lucky: bool = False) -> str:
    """Verdict in a line: `OPM-TARGET RANK`, `CORRECT LUCKY`.

    >>> shown_verdict("COMPOUND", "SRM+CONF"), shown_verdict("CORRECT", None, lucky=True)
    ('COMPOUND SRM+OPM-CONF', 'CORRECT LUCKY')
    """
    return f"{verdict} {shown_detail(detail, lucky)}".strip()


RULES_VERSION = 2
"""Of the rules by which verdicts are found; another number where the same answer may have another verdict."""


def shown_verdicts(occurring: Collection[str]) -> tuple[str, ...]:
    """VERDICTS; ATTRIBUTE, NOT-SEEN, UNEXPLAINED only where present: plain expressions of our own never have them.

    Where some are unexplained, a module that none names is not known to cost nothing, and is left out.
    """
    always = (
        VERDICTS[:3]
        if "UNEXPLAINED" in occurring
        else tuple(v for v in VERDICTS[:-1] if v not in ("ATTRIBUTE", NOT_SEEN))
    )
    return tuple(v for v in VERDICTS if v in always or v in occurring)


MODULE_OF = {
    "PARSE": "PARSE",
    "LABEL": "LABEL",
    "OPM-TARGET": "OPM",
    "OPM-REF": "OPM",
    "LIFT": "LIFT",
    "ATTRIBUTE": "ATTRIBUTE",
    "SRM": "SRM",
    "OPM-CONF": "OPM",
    "PRM": "PRM",
}
"""The module that a verdict blames; COMPOUND blames those of its repair."""


@dataclass(frozen=True)
class Diagnosis:
    """Verdict with the repair, and the evidence behind both."""

    verdict: str  # One of VERDICTS
    # WORDS, GRAMMAR, UNSUPPORTED (not in files of earlier versions); AMBIGUOUS, BAD_LABEL, BAD_BOX, SUSPECT; OUT,
    # HIDDEN (NOT-SEEN); RANK, THRESHOLD, LOCALISATION, ABSENT; DEGENERATE; CHOICE; CONSTANT (of imported relations:
    # about as probable of every pair); SCORE (of imported pair scores: the right pair would stand first by what all
    # others scored); the oracles of COMPOUND; of UNEXPLAINED what the file gives (ANSWER, PROPOSALS, BOXES), or
    # NOT-SEPARABLE
    detail: str | None
    lucky: bool  # Right, but with a pair that is not acceptable
    # The smallest set of oracles with which an acceptable pair wins; empty where none is needed or none helps
    repair: tuple[str, ...]
    # Bit s is set where the target is right with the oracles of subset s (`oracles`), on the gold triple; None where
    # predictions that were imported do not tell
    right_with: int | None
    # (S,) float64: of all S subsets, sixteen or with attributes thirty-two: S of the best acceptable pair less S of the
    # best other one under each subset; NaN without any pair
    margins: np.ndarray
    # winner, right: The answer, and the best acceptable pair among the candidates
    winner: ScoredPair | None
    right: ScoredPair | None
    # false_target, false_reference: The answer's objects are of no labelled object of the asked class
    false_target: bool = False
    false_reference: bool = False
    missed: Missed | None = None  # With OPM-TARGET and OPM-REF
    missed_name: str | None = None  # The class name of which the right object is missing
    unseen: Unseen | None = None  # With NOT-SEEN
    # Where an acceptable pair stood among the candidates and lost: every oracle that alone makes one win
    mends: tuple[str, ...] = ()
    # What one factor alone would have to be for the best acceptable pair to win; empty where one wins
    needed: tuple[FactorRepair, ...] = ()
    # What would have to be found, or scored together, where no factor of `needed` is enough
    needed_score: NeededScore | None = None
    # With LIFT: the detection that its labelled 3D box alone would mend, and the labelled object (indices)
    needed_box: tuple[int, int] | None = None
    story: Story = UNTOLD  # What is said of it, once it is decided
    # Of imported predictions: the oracles that cannot be put in place by what the file gives, and why; what
    # `right_with` says of subsets with these counts nowhere
    untold: dict[str, str] = field(default_factory=dict)
    # The expression was read as meant; else the evidence is that of the gold names, not the trace's own
    gold: bool = True
    case: Case = field(kw_only=True)
    evidence: FrameEvidence = field(kw_only=True, repr=False)

    @property
    def oracles(self) -> tuple[str, ...]:
        """Oracles of `margins` and `right_with`, in the order of their bits."""
        return names_of(len(self.margins) - 1)

    @property
    def truth(self) -> FrameCases:
        """Truth of the frame."""
        return self.evidence.truth

    @property
    def text(self) -> str:
        """Verdict in a sentence."""
        return self.story.sentence

    @property
    def correct(self) -> bool:
        """True for the verdict CORRECT."""
        return self.verdict == "CORRECT"

    @property
    def contributions(self) -> dict[str, float] | None:
        """Share of each factor in S(winner) - S(right), unweighted logs; positive favours the winner.

        "attributes" only where something is said of the objects alone.
        """
        if self.winner is None or self.right is None or self.evidence.answers.source.config.rank.rule is not None:
            return None
        ours, theirs = self.winner.log_factors, self.right.log_factors
        return {name: ours[name] - theirs[name] for name in ours}

    def acceptable_pairs(self) -> set[tuple[int, int]]:
        """Acceptable candidate pairs, as indices of the trace's objects; none without a relation."""
        if not self.gold or not self.case.reference:
            return set()
        found = substitute(self.evidence, self.case)
        targets, references = (role.index[: role.found] for role in (found.target, found.reference))
        covered = found.covered[: len(targets), : len(references)]
        here = np.argwhere(covered & ~one_object_twice((targets, references), self.evidence.same))
        return {(int(targets[i]), int(references[j])) for i, j in here}

    @property
    def labelled(self) -> dict[str, int]:
        """Labelled objects by role: target, and reference if asked."""
        ends = {"target": self.case.target_object}
        return ends | ({"reference": self.case.reference_object} if self.case.reference else {})

    def labelled_boxes(self) -> dict[str, Box3D]:
        """Labelled target and reference in 3D, with known geometry."""
        found = ((role, self.evidence.objects.get(k, points=False)) for role, k in self.labelled.items())
        return {role: o.lifted.box for role, o in found if o is not None and o.lifted.box is not None}


@dataclass(frozen=True)
class Missed:
    """Reason for an object missing among the candidates."""

    # kind: RANK: the detector gave it, but others stood before it (K) or over it (suppression of overlapping boxes).
    # THRESHOLD: it gave it with less than the minimum score. LOCALISATION: the best box overlaps it by .1 to .5.
    # ABSENT: nothing overlaps it by .1.
    kind: Miss
    overlap: float  # The best IoU of all boxes seen
    score: float | None = None  # Of the box that was cut off, or of the best overlapping one
    rank: int | None = None  # With RANK: its rank from 1 by score, before suppression
    suppressed: bool = False  # With RANK: a better-scored box overlapped it too much


@dataclass(frozen=True)
class Unseen:
    """Object of a scene that a frame does not show, by the scene's object map."""

    name: str  # As asked, or what was meant by it
    object: int  # Id in the map
    detail: str  # OUT: outside the picture; HIDDEN: behind something, or nothing was measured there
    frames: tuple[str, ...]  # Frames that see it, by the distance of their cameras, nearest first

    def story(self, of: Literal["right", "any"]) -> Story:
        """Story of a right object that is not in view, or of any that has the name."""
        return story(f"unseen.{self.detail.lower()}.{of}", name=self.name, frame=self.frames[0])
