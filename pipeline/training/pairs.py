"""Training pairs as arrays, with the numbers that standardise them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xxhash

from pipeline.relations.class_vectors import ClassVectors
from pipeline.relations.relations import T
from pipeline.system.errors import require

_BLOCK = 1 << 16


@dataclass(frozen=True, eq=False)
class PairSet:
    """Ordered pairs of objects: what the network is given of each, and what is true of it.

    Class names stand once each, and not in every pair: 75,000 pairs with 300
    numbers for either name would be 180 MB, a million 2.4 GB.

    Attributes
    ----------
    features : (P, G) float32 or float64
        Geometry, not standardised.
    states : (P, R) int8
        T, U, F of each relation of the vocabulary.
    classes : (P, 2) int32 or None
        Indices of both class names in `vectors`.
    vectors : ClassVectors or None
        For "+lang" contracts.
    """

    features: np.ndarray
    states: np.ndarray
    classes: np.ndarray | None = None
    vectors: ClassVectors | None = None

    def __len__(self) -> int:
        return len(self.features)

    @property
    def language(self) -> int:
        """Dimension of the phrase vectors, 0 without."""
        return 0 if self.vectors is None else self.vectors.vectors.shape[1]

    def take(self, which: np.ndarray) -> PairSet:
        """Those pairs: a mask or indices."""
        classes = None if self.classes is None else self.classes[which]
        return PairSet(self.features[which], self.states[which], classes, self.vectors)

    def learnable(self, output: str) -> np.ndarray:
        """(P,) bool: pairs with finite features and something to learn.

        Where each relation is a question of its own, any state but U; where one
        relation fits best, exactly one T: a pair with two right answers or
        none has no single class.
        """
        finite = np.isfinite(self.features).all(axis=1)
        if output == "softmax":
            return finite & ((self.states == T).sum(axis=1) == 1)
        return finite & (self.states != 0).any(axis=1)

    def moments(self) -> tuple[np.ndarray, np.ndarray]:
        """Mean and deviation of all D inputs, (D,) float64 each; a deviation of nothing is 1."""
        means, deviations = ([of(axis=0, dtype=np.float64)] for of in (self.features.mean, self.features.std))
        if self.vectors is not None and self.classes is not None:
            table = self.vectors.vectors.astype(np.float64)
            for side in range(2):
                share = np.bincount(self.classes[:, side], minlength=len(table)) / len(self)
                means.append(share @ table)
                deviations.append(np.sqrt(share @ np.square(table - means[-1])))
        mean, std = np.concatenate(means), np.concatenate(deviations)
        return mean, np.where(std > 1e-9, std, 1.0)

    def standardised(self, mean: np.ndarray, std: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The inputs, standardised, as the geometry of each pair and a table of class vectors for either side.

        Returns
        -------
        geometry : (P, G) float32
        first, second : (C, L) float32
            Empty (0, 0) without language.
        """
        width = self.features.shape[1]
        geometry = np.empty(self.features.shape, np.float32)
        for start in range(0, len(self), _BLOCK):
            block = slice(start, start + _BLOCK)
            geometry[block] = ((self.features[block] - mean[:width]) / std[:width]).astype(np.float32)
        if self.vectors is None:
            return geometry, np.zeros((0, 0), np.float32), np.zeros((0, 0), np.float32)
        tables = []
        for side in range(2):
            columns = slice(width + side * self.language, width + (side + 1) * self.language)
            tables.append(((self.vectors.vectors - mean[columns]) / std[columns]).astype(np.float32))
        return geometry, tables[0], tables[1]

    def hash(self) -> str:
        """xxh3-128 of features, states and classes."""
        digest = xxhash.xxh3_128(np.ascontiguousarray(self.features).data)
        digest.update(np.ascontiguousarray(self.states).data)
        if self.classes is not None and self.vectors is not None:
            digest.update(np.ascontiguousarray(self.classes).data)
            digest.update(self.vectors.hash.encode())
        return digest.hexdigest()


def class_shares(states: np.ndarray, inverse: dict[int, int]) -> np.ndarray:
    """Share of each class among pairs with exactly one T, the same for inverse classes.

    Parameters
    ----------
    states : (P, R) int8
    inverse : dict of int to int
        Class -> its inverse, for those that have one.

    Returns
    -------
    (R,) float64
        Summing to 1.

    Raises
    ------
    InputError
        A class without an example.
    """
    count = (states == T).sum(axis=0).astype(np.float64)
    mirrored = np.array([inverse.get(k, k) for k in range(len(count))])
    share = (count + count[mirrored]) / 2
    require(not (share <= 0).any(), "a class has no training example", got=int((share <= 0).argmax()))
    return share / share.sum()
