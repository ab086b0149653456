"""Contract of a relation network, declared in the metadata of its ONNX file."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np

from pipeline.language.phrase_vectors import LanguageContract
from pipeline.language.relation_names import INVERSE, PAIRWISE
from pipeline.metrics.calibration_metrics import Platt
from pipeline.relations.features import FEATURES, FeatureSet, feature_set, geometry_of
from pipeline.system.errors import InputError, require
from pipeline.system.frozen import dataclass
from pipeline.system.safe_files import parse_json

CONTRACT = "spatialviz-srm-1"
PREFIX = "srm."
"""Every metadata key begins so."""

Output = Literal["sigmoid", "softmax"]


@dataclass(frozen=True)
class NetworkContract:
    """Contract of a relation network, as declared by its file."""

    features: str  # Name of the feature contract
    columns: tuple[str, ...]
    # mean, std: (D,) float64: inputs are standardised by these
    mean: np.ndarray
    std: np.ndarray
    vocabulary: tuple[str, ...]  # The relation of each output
    # Platt's sigmoid of each relation; of a softmax network the inverse temperature and 0
    calibration: dict[str, Platt]
    seed: int  # Seed of data and training
    data: str  # Hash of the training data
    # "sigmoid": each relation is a question of its own. "softmax": exactly one relation of the vocabulary fits a pair
    # best.
    output: Output = "sigmoid"
    # Share of each class in the training pairs of a softmax network, in the order of the vocabulary; else empty
    prior: tuple[float, ...] = ()
    language: LanguageContract | None = None  # The text vectors behind a "+lang" contract
    classes: str = ""  # Hash of the class vectors beside the file, see `ClassVectors`; "" without language
    trained_on: TrainedOn | None = None  # The scenes or frames of labels that it learnt from; None for rendered rooms

    @property
    def feature_set(self) -> FeatureSet:
        """Features fed to the network."""
        return feature_set(self.features, 0 if self.language is None else self.language.dimension)

    def metadata(self) -> dict[str, str]:
        """String properties for an ONNX file; floats keep every digit, and defaults are left out."""
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
        if self.output != "sigmoid":
            values |= {"output": self.output, "prior": json.dumps(self.prior)}
        if self.classes:
            values["classes"] = self.classes
        if self.trained_on is not None:
            values["trained_on"] = self.trained_on.to_json()
        stored = {PREFIX + key: value for key, value in values.items()}
        return stored if self.language is None else {**stored, **self.language.to_metadata()}

    @classmethod
    def read(cls, metadata: Mapping[str, str], path: Path | None = None) -> NetworkContract:
        """Read the contract from the properties of an ONNX file.

        Raises
        ------
        InputError
            Where they are not those of a relation network that this program can feed.
        """
        stored = metadata.get(PREFIX + "contract")
        require(
            stored == CONTRACT,
            "the model is not a relation network",
            got="no contract" if stored is None else f"contract {stored!r}",
            expected=f"contract {CONTRACT!r} in its metadata",
            cause="was it made by `spatialviz train`?",
            path=path,
        )
        language = LanguageContract.from_metadata(metadata, path)
        try:
            values = {key: metadata[PREFIX + key] for key in ("features", "data", "seed")}
            loaded = {
                key: parse_json(metadata[PREFIX + key], path)
                for key in ("columns", "mean", "std", "vocabulary", "calibration")
            }
            output: Any = metadata.get(PREFIX + "output", "sigmoid")
            contract = cls(
                features=values["features"],
                columns=tuple(str(c) for c in loaded["columns"]),
                mean=np.array(loaded["mean"], np.float64),
                std=np.array(loaded["std"], np.float64),
                vocabulary=tuple(str(r) for r in loaded["vocabulary"]),
                calibration={str(k): (float(a), float(b)) for k, (a, b) in loaded["calibration"].items()},
                seed=int(values["seed"]),
                data=values["data"],
                output=output,
                prior=tuple(float(p) for p in parse_json(metadata.get(PREFIX + "prior", "[]"), path)),
                language=language,
                classes=metadata.get(PREFIX + "classes", ""),
                trained_on=TrainedOn.from_json(learnt) if (learnt := metadata.get(PREFIX + "trained_on")) else None,
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
        """Raise InputError for features or relations unknown to this program."""
        base = geometry_of(self.features)
        require(
            base in FEATURES,
            "the relation network wants features that are not known",
            got=repr(self.features),
            expected=", ".join(FEATURES),
            path=path,
        )
        require(
            (self.features != base) == bool(self.classes) == (self.language is not None),
            "the relation network's language features do not fit its feature contract",
            got=f"{self.features} {'without' if self.language is None else 'with'} text vectors",
            path=path,
        )
        expected = self.feature_set.columns
        others = [ours for ours, theirs in zip(self.columns, expected, strict=False) if ours != theirs]
        require(
            self.columns == expected,
            f"the relation network's {self.features} is another one than this program's",
            got=f"{len(self.columns)} features{f', {others[0]!r} out of place' if others else ''}",
            expected=f"{len(expected)} features, {expected[0]} to {expected[-1]}",
            path=path,
        )
        require(
            not (
                self.mean.shape != (len(expected),)
                or self.std.shape != (len(expected),)
                or not np.isfinite(np.concatenate([self.mean, self.std])).all()
                or (self.std <= 0).any()
            ),
            "mean and deviation of the relation network do not fit its features",
            got=f"shapes {self.mean.shape}, {self.std.shape}",
            expected=f"{len(expected)} finite numbers each, deviations above 0",
            path=path,
        )
        unknown = [r for r in self.vocabulary if r not in PAIRWISE]
        require(
            not unknown and self.vocabulary and len(set(self.vocabulary)) == len(self.vocabulary),
            "the relation network's vocabulary is not known",
            got=", ".join(self.vocabulary) or "nothing",
            expected=f"each at most once: {', '.join(PAIRWISE)}",
            path=path,
        )
        self._check_calibration(path)
        self._check_output(path)

    def _check_calibration(self, path: Path | None) -> None:
        pairs = self.calibration
        require(
            set(pairs) == set(self.vocabulary),
            "the calibration is for other relations than the vocabulary",
            got=sorted(pairs),
            path=path,
        )
        broken = [
            r
            for r, (a, b) in pairs.items()
            if not (np.isfinite([a, b]).all() and a > 0)
            # Two sigmoids for one logit would undo the antisymmetry.
            or pairs.get(INVERSE.get(r, r), (a, b)) != (a, b)
        ]
        require(
            not broken,
            "the calibration must be finite, rising, and the same for inverse relations",
            got=broken,
            path=path,
        )

    def _check_output(self, path: Path | None) -> None:
        if self.output == "sigmoid" and not self.prior:
            return
        require(
            self.output == "softmax",
            "the relation network's output is not known",
            got=f"{self.output!r}{' with a prior' if self.prior else ''}",
            expected="sigmoid, or softmax with a prior",
            path=path,
        )
        prior = dict(zip(self.vocabulary, self.prior, strict=False))
        require(
            not (
                len(self.prior) != len(self.vocabulary)
                or not all(0 < p <= 1 for p in self.prior)
                or abs(sum(self.prior) - 1) > 1e-6
                or any(prior.get(INVERSE.get(r, r), p) != p for r, p in prior.items())
            ),
            "the prior must be a share above 0 of each relation, the same for inverse ones, 1 in all",
            got=self.prior,
            path=path,
        )
        require(
            len(set(self.calibration.values())) <= 1,
            "a softmax network has one temperature",
            got=self.calibration,
            path=path,
        )


@dataclass(frozen=True)
class TrainedOn:
    """Part of a dataset used to train and calibrate a network."""

    dataset: str  # Name of its folder
    input_hash: str  # Of the dataset's files, as the labels' manifest has it
    content_hash: str  # Of the labels' table of frames
    split: str  # "scene": `train` and `validation` name scenes. "blocks", and "random" of before: frames.
    train: tuple[str, ...]
    validation: tuple[str, ...]
    scenes: tuple[str, ...]  # Of all frames in either

    def to_json(self) -> str:
        """One line of JSON."""
        return json.dumps({k: list(v) if isinstance(v, tuple) else v for k, v in vars(self).items()})

    @classmethod
    def from_json(cls, text: str) -> TrainedOn:
        """Read `to_json`; KeyError, TypeError or ValueError for anything else."""
        stored = parse_json(text)
        texts: dict[str, Any] = {k: str(stored[k]) for k in ("dataset", "input_hash", "content_hash", "split")}
        if not all(isinstance(stored[k], list) for k in ("train", "validation", "scenes")):
            raise ValueError("what was learnt from must be lists of names")
        lists: dict[str, Any] = {k: tuple(map(str, stored[k])) for k in ("train", "validation", "scenes")}
        return cls(**texts, **lists)
