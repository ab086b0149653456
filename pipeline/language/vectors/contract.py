"""The contract of a relation network on the text vectors of its training."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from pipeline.language.vectors.phrases import VectorFile
from pipeline.system.errors import InputError, require

CONTRACT = "spatialviz-language-1"
"""Also the rules by which a name becomes words and words become a vector: a change of these must change it."""

PREFIX = "srm.language."
"""Every metadata key begins so."""


@dataclass(frozen=True)
class LanguageContract:
    """The language features of a relation network."""

    name: str  # The file of vectors, for people
    dimension: int
    normalised: bool  # Vectors were divided by their lengths before the mean was taken
    fingerprint: str  # Of the vectors

    @classmethod
    def of(cls, vectors: VectorFile, *, normalised: bool = False) -> LanguageContract:
        return cls(vectors.name, vectors.dimension, normalised, vectors.fingerprint())

    def to_metadata(self) -> dict[str, str]:
        """Contract as string properties of an ONNX file."""
        values = {
            "contract": CONTRACT,
            "name": self.name,
            "dimension": str(self.dimension),
            "normalised": "true" if self.normalised else "false",
            "fingerprint": self.fingerprint,
        }
        return {PREFIX + key: value for key, value in values.items()}

    @classmethod
    def from_metadata(cls, metadata: Mapping[str, str], path: Path | None = None) -> LanguageContract | None:
        """Contract from the properties of an ONNX file; None for a network without language.

        InputError where the properties speak of other language features than this program makes.
        """
        stored = {key.removeprefix(PREFIX): value for key, value in metadata.items() if key.startswith(PREFIX)}
        if not stored:
            return None
        if stored.get("contract") != CONTRACT:
            raise InputError(
                "the network's language features are not known",
                got=repr(stored.get("contract")),
                expected=repr(CONTRACT),
                path=path,
            )
        try:
            dimension = int(stored["dimension"])
            normalised = {"true": True, "false": False}[stored["normalised"]]
            contract = cls(stored["name"], dimension, normalised, stored["fingerprint"])
        except (KeyError, ValueError) as error:
            raise InputError(
                "the network's language features cannot be read", got=f"{type(error).__name__}: {error}", path=path
            ) from error
        require(
            dimension >= 1 and contract.fingerprint,
            "the network's language features cannot be read",
            got=contract,
            path=path,
        )
        return contract

    def check(self, vectors: VectorFile) -> None:
        """Raise InputError for other vectors than those of the network's training."""
        require(
            vectors.dimension == self.dimension,
            "the text vectors have another dimension than the network wants",
            got=f"{vectors.dimension} numbers of {vectors.name}",
            expected=f"{self.dimension} numbers of {self.name}",
        )
        found = vectors.fingerprint()
        require(
            found == self.fingerprint,
            "the text vectors are other ones than the network was trained with",
            got=f"{vectors.name}, fingerprint {found}",
            expected=f"{self.name}, fingerprint {self.fingerprint}",
        )
