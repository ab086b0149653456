"""Trained relation scorer: an ONNX file, its contract, and its probabilities.

The file's graph is the bare network. Its metadata says what goes in (the
feature contract and its columns, mean and deviation), what comes out (the
vocabulary) and how logits become probabilities (calibration); a file that does
not say so, or says something this program does not compute, is refused.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.geometry.lifting import LiftedObject
from pipeline.geometry.viewer import ViewerAxes
from pipeline.language.relation_names import PAIRWISE
from pipeline.metrics.calibration_metrics import antisymmetric, antisymmetric_log_softmax, sigmoid, softmax
from pipeline.relations.class_vectors import ClassLookup
from pipeline.relations.contract import NetworkContract
from pipeline.relations.features import Appearance
from pipeline.relations.scorer import RelationScorer, RelationScores, RuleScorer, rule_probabilities
from pipeline.system.errors import InputError, require
from pipeline.system.onnx_session import metadata, open_session, run_limited, signature

__all__ = ["NetworkContract", "OnnxScorer"]


class OnnxScorer:
    """Relation network run by ONNX Runtime; relations without an output are scored by the rule.

    `vectors`: the text vectors a language network was trained with, for classes it was not trained on; `name`: that of
    its feature contract; `path`: its file.

    Raises
    ------
    InputError
        The file is not a relation network, or one of another contract.
    """

    def __init__(self, path: Path, vectors: Path | None = None) -> None:
        path = Path(path)
        require(path.is_file(), "there is no relation network", path=path, cause="--srm takes trained, rule or a file")
        session = open_session(path, threads=1)
        self.contract = NetworkContract.read(metadata(session), path)
        self.name = self.contract.features
        self.path = path
        self.features = self.contract.feature_set
        self._session: Any = session
        inputs, outputs = session.get_inputs(), session.get_outputs()
        sizes = [list(v.shape)[1:] for v in (*inputs, *outputs)]
        require(
            sizes == [[self.features.dimension], [len(self.contract.vocabulary)]],
            "the relation network's graph does not fit its metadata",
            got=lambda: signature(session),
            expected=f"{self.features.dimension} numbers in, {len(self.contract.vocabulary)} out",
            path=path,
        )
        self._input = inputs[0].name
        self._classes: ClassLookup | None = None
        if self.contract.language is not None:
            self._classes = ClassLookup(path, self.contract.language, self.contract.classes, vectors)
        elif vectors is not None:
            raise InputError("the relation network uses no class names: leave out --vectors", got=self.name, path=path)

    def score(
        self,
        objects: Sequence[LiftedObject],
        viewer: ViewerAxes,
        appearance: Appearance | None = None,
        relations: Collection[str] = PAIRWISE,
    ) -> RelationScores:
        """Probabilities by the network; states are the rule's.

        Raises
        ------
        InputError
            The network is given 2D boxes or class names and there is no appearance, or a class it does not know.
        """
        rule = RuleScorer().score(objects, viewer, relations=relations)
        return combined(rule.states, self.of_pairs(objects, viewer, appearance), self, rule.relations)

    def of_pairs(
        self, objects: Sequence[LiftedObject], viewer: ViewerAxes, appearance: Appearance | None = None
    ) -> np.ndarray:
        """(N, N, R) float64: network's probabilities of the vocabulary, for all ordered pairs."""
        require(
            not self.features.needs_appearance or appearance is not None,
            f"the relation network's {self.name} needs what objects look like in the image",
            expected="their 2D boxes and class names (an Appearance)",
        )
        if appearance is not None and len(appearance.labels) != len(objects):
            raise InputError(
                "objects and their appearance differ in number", got=f"{len(objects)} and {len(appearance.labels)}"
            )
        rows = self.features.describe(objects, viewer, appearance)
        return self.probabilities(self.with_words(rows, () if appearance is None else appearance.labels))

    def with_words(self, rows: np.ndarray, labels: Sequence[str]) -> np.ndarray:
        """Rows of geometry, for a language network followed by the vector of each object's class name."""
        return rows if self._classes is None else np.concatenate([rows, self._classes.rows(labels)], axis=1)

    def logits(self, rows: np.ndarray) -> np.ndarray:
        """(N, N, R) float64 logits, antisymmetric, of all ordered pairs of objects described by (N, K) rows.

        Rows with leading dimensions are a batch of scenes.
        Those of a softmax network are logarithms of probabilities.
        """
        vocabulary = self.contract.vocabulary
        shape = (*rows.shape[:-1], rows.shape[-2], len(vocabulary))
        if 0 in shape:
            return np.zeros(shape)
        features = (self.features.pair(rows) - self.contract.mean) / self.contract.std
        flat = features.reshape(-1, features.shape[-1]).astype(np.float32)
        (found,) = run_limited(self._session, None, {self._input: flat}, self.path)
        mirrored = antisymmetric if self.contract.output == "sigmoid" else antisymmetric_log_softmax
        return mirrored(found.astype(np.float64).reshape(shape), vocabulary)

    def probabilities(self, rows: np.ndarray) -> np.ndarray:
        """(N, N, R) calibrated probabilities; 0.5 where either object is not known (NaN).

        A softmax network's classes are as frequent as its training pairs had
        them. What ranks pairs is P(relation | pair) / prior(relation), made
        to sum to 1 again: the answer as if all relations were equally frequent.
        """
        known = np.logical_and.reduce(np.isfinite(rows), axis=-1)
        scaled = self._calibrated(np.where(known[..., None], rows, 0.0))
        softened = self.contract.output == "softmax"
        result = softmax(scaled - np.log(self.contract.prior)) if softened else sigmoid(scaled)
        result[~(known[..., :, None] & known[..., None, :])] = 0.5
        return result

    def class_probabilities(self, rows: np.ndarray) -> np.ndarray:
        """(N, N, R) of a softmax network before the prior is divided out; NaN where either object is not known."""
        known = np.logical_and.reduce(np.isfinite(rows), axis=1)
        result = softmax(self._calibrated(np.where(known[:, None], rows, 0.0)))
        result[~(known[:, None] & known[None, :])] = np.nan
        return result

    def _calibrated(self, rows: np.ndarray) -> np.ndarray:
        slope, shift = np.array([self.contract.calibration[r] for r in self.contract.vocabulary]).T
        return self.logits(rows) * slope + shift


def combined(
    states: np.ndarray,
    network: np.ndarray | None,
    scorer: RelationScorer,
    relations: tuple[str, ...] = PAIRWISE,
) -> RelationScores:
    """Scores by the network where it has an output, else by the rule.

    `states`: (..., N, N, R) int8 of `relations`; `network`: (..., N, N, V) float64, None for the rule alone.
    """
    probabilities = rule_probabilities(states)
    scored_by: dict[str, str] = dict.fromkeys(relations, RuleScorer.name)
    if network is not None and isinstance(scorer, OnnxScorer):
        # What a thing is to itself is not a question for a network.
        own = np.eye(states.shape[-2], dtype=np.bool_)
        kept = probabilities[..., own, :]
        for k, relation in enumerate(scorer.contract.vocabulary):
            if relation in relations:
                probabilities[..., relations.index(relation)] = network[..., k]
                scored_by[relation] = scorer.name
        probabilities[..., own, :] = kept
    return RelationScores(relations, states, probabilities, scored_by)
