"""An annotated frame as people's sentences see it: what is true of its things, and how surely a name means them.

Names are read generously, for a person may call a thing otherwise than its annotation does, or misspell it: what may
be meant is U, in doubt, and a name that nobody knows may mean anything. What was read otherwise than it is written, is
told.
"""

from __future__ import annotations

from collections.abc import Sequence
from difflib import SequenceMatcher

import numpy as np

from pipeline.answering.objects import PreparedFrame, all_objects
from pipeline.answering.pipeline import Pipeline
from pipeline.labels.cases import FrameCases
from pipeline.labels.tree_truth import DOUBT, TreeTruth
from pipeline.language.name_lookup import two_swapped
from pipeline.language.naming import default_synonyms, match, meanings, normal_form
from pipeline.language.relation_names import INVERSE, PAIRWISE
from pipeline.language.tree import Attachment
from pipeline.proposals.annotations import AnnotationDetector
from pipeline.relations.pair_measures import AllMeasures, F, Profile, T, U, known_extents, measure_pairs
from pipeline.relations.relations import PREDICATES, pair_margins, pair_states
from pipeline.system.frozen import dataclass

NEARLY_M = 0.4
"""Farther than this beyond the threshold of "near" nothing is near."""
ALIKE = 0.8
"""Share of letters that a misspelt name has in common with what is meant."""
ANOTHER, ELSEWHERE, NO_CLASS, MISREAD = 0.9, 0.6, 0.35, 0.3
"""Weights of what is right having another name than is asked for: where the frame has a thing of that name, where only
other frames have, where it is no name of the dataset, and where it was misspelt."""


def margins_of(truth: FrameCases, relation: str) -> np.ndarray:
    """(N, N) float64: distance of each pair from the rule's threshold, metres; positive where the relation holds,
    negative where not, NaN where extents do not tell."""
    lo, hi = truth.geometry["lo"], truth.geometry["hi"]
    known = known_extents(lo, hi)
    if relation not in PREDICATES or PREDICATES[relation].reads_points:
        return np.full(truth.judged.shape, np.nan)
    fill = known[:, None]
    measured = AllMeasures(measure_pairs(np.where(fill, lo, 0.0), np.where(fill, hi, 0.0), Profile()), Profile())
    found = pair_margins(measured, pair_states(measured, known, [relation]), [relation])[..., 0]
    return np.where(known[:, None] & known[None, :], found, np.nan)


@dataclass(frozen=True)
class NameRead:
    """A name as it is read in a frame."""

    states: np.ndarray
    """(N,) int8: T for what it means, U for what it may mean."""
    note: str = ""
    """How it was read otherwise than it is written."""
    weight: float = ANOTHER
    """Of a thing that it does not mean."""


class SeenTruth(TreeTruth):
    """Truth of a frame's annotated things; pairs that are not judged are in doubt."""

    def __init__(self, context: PreparedFrame, truth: FrameCases, source: Pipeline) -> None:
        objects = all_objects(context, AnnotationDetector())
        unknown = np.full(truth.judged.shape, U, np.int8)
        states = [np.where(truth.judged, truth.states.get(r, unknown), U) for r in PAIRWISE]
        super().__init__(
            context, objects, np.stack(states, axis=-1), [True] * len(objects), list(truth.facts["occluded"])
        )
        self.source, self.truth = source, truth
        self.names: dict[str, NameRead] = {}

    def _named(self, name: str) -> np.ndarray:
        return self.read(name).states

    def joined(self, named: np.ndarray, degrees: Sequence[np.ndarray]) -> np.ndarray:
        """(N,) float64: as of labels, but what nothing is known of leaves the rest as it is, if in doubt."""
        told = [degree for degree in degrees if degree.any()]
        found = super().joined(named, told)
        return found if len(told) == len(degrees) else np.minimum(found, DOUBT)

    def _stands(self, attachment: Attachment) -> np.ndarray:
        # What is not annotated may be anywhere.
        told = all(node.anything or (self.read(node.name).states == T).any() for node in attachment.nodes)
        return super()._stands(attachment) if told else np.zeros(len(self.objects))

    def _extreme(self, attachment: Attachment, fitting: np.ndarray) -> np.ndarray:
        told = (self.read(attachment.nodes[0].name).states == T).any()
        return super()._extreme(attachment, fitting) if told else np.zeros(len(self.objects))

    def _state(self, relation: str) -> np.ndarray:
        state = super()._state(relation)
        if relation in INVERSE:
            # What surely is the other way round is not so, however it looks.
            return np.where(super()._state(INVERSE[relation]) == T, F, state)
        if relation != "near":
            return state
        # People call near what is not by the rule, and of large things only a side is seen.
        margin = np.nan_to_num(margins_of(self.truth, relation))
        return np.where(state == T, T, np.clip(margin / NEARLY_M, F, 0))

    def read(self, name: str) -> NameRead:
        """What a name means here."""
        if name not in self.names:
            self.names[name] = self._read(name)
        return self.names[name]

    def _read(self, name: str) -> NameRead:
        labels = self.truth.labels
        known = tuple(dict.fromkeys([*labels, *self.source.dataset.class_names]))
        table = self.source.synonyms or default_synonyms()
        found = meanings(name, known, table)
        sure, near = set(match(name, known, table)), {m.name for m in found}
        if sure:
            states = self._of(sure, near)
            return NameRead(states, weight=ANOTHER if (states == T).any() else ELSEWHERE)
        like = {label for label in known if self._looks_like(name, label)}
        if found or like:
            mended = {m.name for m in found if m.score == found[0].score} if found else like
            note = f"“{name}” is read as “{found[0].via if found else sorted(like)[0]}”"
            return NameRead(self._of(mended, near | like), note, MISREAD)
        if normal_form(name) in table.words:
            return NameRead(self._of(set(), set()), weight=NO_CLASS)
        return NameRead(np.full(len(labels), U, np.int8), f"“{name}” is not known")

    def _of(self, sure: set[str], near: set[str]) -> np.ndarray:
        states = [T if label in sure else U if label in near else F for label in self.truth.labels]
        return np.array(states, np.int8)

    def _looks_like(self, name: str, label: str) -> bool:
        """Test for a misspelt name of a class: of its letters most are there, in their order, whatever the spaces; or
        one is the end of the other (`pack`, `dinnerplate`)."""
        form, table = normal_form(label), self.source.synonyms or default_synonyms()
        written = normal_form(name).replace(" ", "")
        for other in (form, *table.of(form)):
            meant = other.replace(" ", "")
            same = SequenceMatcher(None, written, meant).ratio() >= ALIKE
            ends = min(len(written), len(meant)) > 3 and (meant.endswith(written) or written.endswith(meant))
            if same or ends or written in two_swapped(meant):
                return True
        return False
