"""The trained relation scorer: an ONNX file, what it declares about itself, and its probabilities.

The file's graph is the bare network. Its metadata says what goes in (the
feature contract and its columns, mean and deviation), what comes out (the
vocabulary) and how logits become probabilities (calibration); a file that does
not say so, or says something this program does not compute, is refused.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.errors import InputError
from pipeline.lifting import LiftedObject
from pipeline.proposals.onnx_session import open_session, signature
from pipeline.relations import INVERSE, PAIRWISE
from pipeline.srm.calibration import Platt, antisymmetric, sigmoid
from pipeline.srm.features import FEATURES, FeatureSet, feature_set
from pipeline.srm.scorer import RelationScores, RuleScorer
from pipeline.viewer import ViewerAxes

CONTRACT = "spatialviz-srm-1"
PREFIX = "srm."
"""Every metadata key begins so."""


@dataclass(frozen=True)
class Contract:
    """What a relation network declares about itself.

    Attributes
    ----------
    features : str
        Name of the feature contract.
    columns : tuple of str
    mean, std : (D,) float64
        Inputs are standardised by these.
    vocabulary : tuple of str
        The relation of each output.
    calibration : dict of str to (a, b)
        Platt's sigmoid of each relation.
    seed : int
        Seed of data and training.
    data : str
        Hash of the training data.
    """

    features: str
    columns: tuple[str, ...]
    mean: np.ndarray
    std: np.ndarray
    vocabulary: tuple[str, ...]
    calibration: dict[str, Platt]
    seed: int
    data: str

    def metadata(self) -> dict[str, str]:
        """As string properties of an ONNX file; floats keep every digit."""
        values = {
            "contract": CONTRACT,
            "features": self.features,
            "columns": json.dumps(self.columns),
            "mean": json.dumps(self.mean.tolist()),
            "std": json.dumps(self.std.tolist()),
            "vocabulary": json.dumps(self.vocabulary),
            "calibration": json.dumps(self.calibration),
            "seed": str(self.seed),
            "data": self.data,
        }
        return {PREFIX + key: value for key, value in values.items()}

    @classmethod
    def read(cls, metadata: Mapping[str, str], path: Path | None = None) -> Contract:
        """From the properties of an ONNX file.

        Raises
        ------
        InputError
            Where they are not those of a relation network that this program can feed.
        """
        said = metadata.get(PREFIX + "contract")
        if said != CONTRACT:
            raise InputError(
                "the model is not a relation network",
                got="no contract" if said is None else f"contract {said!r}",
                expected=f"contract {CONTRACT!r} in its metadata",
                cause="was it made by `spatialviz train`?",
                path=path,
            )
        try:
            values = {key: metadata[PREFIX + key] for key in ("features", "data", "seed")}
            loaded = {
                key: json.loads(metadata[PREFIX + key])
                for key in ("columns", "mean", "std", "vocabulary", "calibration")
            }
            contract = cls(
                features=values["features"],
                columns=tuple(str(c) for c in loaded["columns"]),
                mean=np.array(loaded["mean"], np.float64),
                std=np.array(loaded["std"], np.float64),
                vocabulary=tuple(str(r) for r in loaded["vocabulary"]),
                calibration={str(k): (float(a), float(b)) for k, (a, b) in loaded["calibration"].items()},
                seed=int(values["seed"]),
                data=values["data"],
            )
        except (KeyError, ValueError, TypeError, AttributeError) as error:
            raise InputError(
                "the relation network's metadata cannot be read",
                got=f"{type(error).__name__}: {error}",
                path=path,
            ) from error
        contract.check(path)
        return contract

    def check(self, path: Path | None = None) -> None:
        """Raise InputError unless this program computes these features and knows these relations."""
        if self.features not in FEATURES:
            raise InputError(
                "the relation network wants features that are not known",
                got=repr(self.features),
                expected=", ".join(FEATURES),
                path=path,
            )
        expected = feature_set(self.features).columns
        if self.columns != expected:
            raise InputError(
                f"the relation network's {self.features} is another one than this program's",
                got=_differing(self.columns, expected),
                expected=f"{len(expected)} features, {expected[0]} to {expected[-1]}",
                path=path,
            )
        if (
            self.mean.shape != (len(expected),)
            or self.std.shape != (len(expected),)
            or not np.isfinite(np.concatenate([self.mean, self.std])).all()
            or (self.std <= 0).any()
        ):
            raise InputError(
                "mean and deviation of the relation network do not fit its features",
                got=f"shapes {self.mean.shape}, {self.std.shape}",
                expected=f"{len(expected)} finite numbers each, deviations above 0",
                path=path,
            )
        unknown = [r for r in self.vocabulary if r not in PAIRWISE]
        if unknown or not self.vocabulary or len(set(self.vocabulary)) != len(self.vocabulary):
            raise InputError(
                "the relation network's vocabulary is not known",
                got=", ".join(self.vocabulary) or "nothing",
                expected=f"each at most once: {', '.join(PAIRWISE)}",
                path=path,
            )
        self._check_calibration(path)

    def _check_calibration(self, path: Path | None) -> None:
        pairs = self.calibration
        if set(pairs) != set(self.vocabulary):
            raise InputError("the calibration is for other relations than the vocabulary", got=sorted(pairs), path=path)
        broken = [
            r
            for r, (a, b) in pairs.items()
            if not (np.isfinite([a, b]).all() and a > 0)
            # Two sigmoids for one logit would undo the antisymmetry.
            or pairs.get(INVERSE.get(r, r), (a, b)) != (a, b)
        ]
        if broken:
            raise InputError(
                "the calibration must be finite, rising, and the same for inverse relations", got=broken, path=path
            )


def _differing(got: Sequence[str], expected: Sequence[str]) -> str:
    if len(got) != len(expected):
        return f"{len(got)} features"
    k = next(k for k, (a, b) in enumerate(zip(got, expected, strict=True)) if a != b)
    return f"{got[k]!r} in place {k}"


class OnnxScorer:
    """A trained network by ONNX Runtime; relations it has no output for are scored by the rule.

    Parameters
    ----------
    path : Path

    Attributes
    ----------
    name : str
        That of its feature contract.
    contract : Contract

    Raises
    ------
    InputError
        The file is not a relation network, or one of another contract.
    """

    def __init__(self, path: Path) -> None:
        path = Path(path)
        if not path.is_file():
            raise InputError("there is no relation network", path=path, cause="--srm takes trained, rule or a file")
        session = open_session(path, threads=1)
        self.contract = Contract.read(session.get_modelmeta().custom_metadata_map, path)
        self.name = self.contract.features
        self._features: FeatureSet = feature_set(self.name)
        self._session: Any = session
        inputs, outputs = session.get_inputs(), session.get_outputs()
        sizes = [list(v.shape)[1:] for v in (*inputs, *outputs)]
        if sizes != [[self._features.dimension], [len(self.contract.vocabulary)]]:
            raise InputError(
                "the relation network's graph does not fit its metadata",
                got=signature(session),
                expected=f"{self._features.dimension} numbers in, {len(self.contract.vocabulary)} out",
                path=path,
            )
        self._input = inputs[0].name

    def score(self, objects: Sequence[LiftedObject], viewer: ViewerAxes) -> RelationScores:
        """Probabilities by the network; states are the rule's."""
        rule = RuleScorer().score(objects, viewer)
        probabilities = rule.probabilities.copy()
        scored_by = dict(rule.scored_by)
        found = self.of_pairs(objects, viewer)
        for k, relation in enumerate(self.contract.vocabulary):
            probabilities[..., rule.relations.index(relation)] = found[..., k]
            scored_by[relation] = self.name
        # What a thing is to itself is not a question for a network.
        same = np.eye(len(objects), dtype=np.bool_)
        probabilities[same] = rule.probabilities[same]
        return RelationScores(rule.relations, rule.states, probabilities, scored_by)

    def of_pairs(self, objects: Sequence[LiftedObject], viewer: ViewerAxes) -> np.ndarray:
        """(N, N, R) float64: the network's probabilities of its vocabulary, for all ordered pairs."""
        return self.probabilities(self._features.describe(objects, viewer))

    def logits(self, rows: np.ndarray) -> np.ndarray:
        """(N, N, R) float64 logits, antisymmetric, of all ordered pairs of objects described by (N, K) rows."""
        n, vocabulary = len(rows), self.contract.vocabulary
        if n == 0:
            return np.zeros((0, 0, len(vocabulary)))
        features = (self._features.pair(rows) - self.contract.mean) / self.contract.std
        flat = features.reshape(n * n, -1).astype(np.float32)
        (found,) = self._session.run(None, {self._input: flat})
        return antisymmetric(found.astype(np.float64).reshape(n, n, len(vocabulary)), vocabulary)

    def probabilities(self, rows: np.ndarray) -> np.ndarray:
        """(N, N, R) calibrated probabilities; 0.5 where either object is not known (NaN)."""
        known = np.logical_and.reduce(np.isfinite(rows), axis=1)
        logits = self.logits(np.where(known[:, None], rows, 0.0))
        slope, shift = np.array([self.contract.calibration[r] for r in self.contract.vocabulary]).T
        result = sigmoid(logits * slope + shift)
        result[~(known[:, None] & known[None, :])] = 0.5
        return result
