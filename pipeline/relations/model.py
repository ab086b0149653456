"""Trained relation scorer: an ONNX file, its contract, and its probabilities.

The file's graph is the bare network. Its metadata says what goes in (the
feature contract and its columns, mean and deviation), what comes out (the
vocabulary) and how logits become probabilities (calibration); a file that does
not say so, or says something this program does not compute, is refused.
"""

from __future__ import annotations

import io
import os
import re
import shutil
from collections.abc import Collection, Sequence
from functools import cached_property
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
import xxhash

from pipeline.geometry.lifting import LiftedObject
from pipeline.geometry.viewer import ViewerAxes
from pipeline.language.naming import normal_form
from pipeline.language.relation_names import PAIRWISE
from pipeline.language.vectors import LanguageContract, open_vectors, read_npz
from pipeline.metrics.calibration_metrics import antisymmetric, antisymmetric_log_softmax, sigmoid, softmax
from pipeline.relations.contract import NetworkContract
from pipeline.relations.features import Appearance
from pipeline.relations.scorer import RelationScorer, RelationScores, RuleScorer, rule_probabilities
from pipeline.system.errors import InputError, require
from pipeline.system.frozen import dataclass
from pipeline.system.onnx_session import metadata, open_session, run_blocks, signature
from pipeline.system.whole_files import file_with_companions

BLOCK = 1024
"""Pairs that a network is given together: with more, what lies between its layers leaves the processor's cache."""
_NAMED = 8


@dataclass(frozen=True, eq=False)
class ClassVectors:
    """Class names of a language network's training and their phrase vectors, kept beside it as `NAME.vectors.npz`.

    The network's metadata holds their hash, so that neither goes with another's.
    """

    names: tuple[str, ...]  # As the labels spell them, each once
    vectors: np.ndarray  # (C, D) float32

    @property
    def hash(self) -> str:
        """Hash (xxh3-128) of names and vectors."""
        digest = xxhash.xxh3_128("\0".join(self.names).encode("utf-8", "surrogatepass"))
        digest.update(np.ascontiguousarray(self.vectors, "<f4").tobytes())
        return digest.hexdigest()

    def content(self) -> bytes:
        """Content of an .npz file, readable by `pipeline.language.vectors.open_vectors` too."""
        file = io.BytesIO()
        np.savez(
            file, names=np.array(self.names, np.str_), vectors=self.vectors.astype(np.float32), kind=np.str_("phrase")
        )
        return file.getvalue()

    @classmethod
    def read(cls, path: Path) -> ClassVectors:
        """Read an .npz file of class vectors; InputError for another file."""
        table = read_npz(path)
        return cls(table.names, table.vectors.astype(np.float32))


def vectors_path(network: Path) -> Path:
    """Path of the class vectors of an ONNX file."""
    return network.with_suffix(".vectors.npz")


class ClassLookup:
    """Vectors of class names for a network.

    `language`: text vectors by the network's contract; `expected`: hash of the class vectors; `vectors`: file of text
    vectors, for classes outside the training.
    """

    def __init__(self, network: Path, language: LanguageContract, expected: str, vectors: Path | None = None) -> None:
        self.language = language
        self._file = None if vectors is None else open_vectors(vectors)
        path = vectors_path(network)
        if path.is_file():
            known = ClassVectors.read(path)
            require(
                known.hash == expected and known.vectors.shape[1] == language.dimension,
                "these class vectors belong to another network",
                got=known.hash,
                expected=expected,
                path=path,
            )
        elif self._file is None:
            raise InputError(
                "the network's class vectors are missing",
                expected=f"{path.name} beside the network, or --vectors {language.name}",
                path=path,
            )
        else:
            known = ClassVectors((), np.zeros((0, language.dimension), np.float32))
        self._known = known

    @cached_property
    def _by_name(self) -> dict[str, np.ndarray]:
        """Known vectors by exact spelling, and by normal form wherever all spellings share one vector."""
        found: dict[str, np.ndarray] = {}
        clashing: set[str] = set()
        for name, vector in zip(self._known.names, self._known.vectors, strict=True):
            key = normal_form(name)
            if key in found and not np.array_equal(found[key], vector):
                clashing.add(key)
            found.setdefault(key, vector)
        for key in clashing:
            del found[key]
        return {**found, **dict(zip(self._known.names, self._known.vectors, strict=True))}

    def rows(self, labels: Sequence[str]) -> np.ndarray:
        """(N, D) float64 vectors of the class names."""
        known = self._by_name
        unknown = list(dict.fromkeys(n for n in labels if n not in known and normal_form(n) not in known))
        if unknown and self._file is None:
            more = f" and {len(unknown) - _NAMED} more" if len(unknown) > _NAMED else ""
            raise InputError(
                "the network was not trained on these classes",
                got=", ".join(repr(n) for n in unknown[:_NAMED]) + more,
                expected=f"--vectors with the file {self.language.name}",
            )
        if unknown and self._file is not None:
            found = self._file.phrases(unknown, normalised=self.language.normalised)
            # Its pass through the file has worked out the fingerprint, too.
            self.language.check(self._file)
            known.update(zip(unknown, found, strict=True))
        rows = [known[n] if n in known else known[normal_form(n)] for n in labels]
        return np.array(rows, np.float64).reshape(len(rows), self.language.dimension)


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
        wanted: np.ndarray | None = None,
    ) -> RelationScores:
        """Probabilities by the network, perhaps NaN beyond the `wanted` pairs, (N, N) bool; states are the rule's.

        Raises
        ------
        InputError
            The network is given 2D boxes or class names and there is no appearance, or a class it does not know.
        """
        rule = RuleScorer().score(objects, viewer, relations=relations)
        return combined(rule.states, self.of_pairs(objects, viewer, appearance, wanted), self, rule.relations)

    def of_pairs(
        self,
        objects: Sequence[LiftedObject],
        viewer: ViewerAxes,
        appearance: Appearance | None = None,
        wanted: np.ndarray | None = None,
    ) -> np.ndarray:
        """(N, N, R) float64: network's probabilities of the vocabulary, for all ordered pairs.

        `wanted`, (N, N) bool, by default all; the others may be NaN.
        """
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
        rows = self.with_words(rows, () if appearance is None else appearance.labels)
        return self.probabilities(rows, None if wanted is None else wanted | wanted.T)

    def with_words(self, rows: np.ndarray, labels: Sequence[str]) -> np.ndarray:
        """Rows of geometry, for a language network followed by the vector of each object's class name."""
        return rows if self._classes is None else np.concatenate([rows, self._classes.rows(labels)], axis=1)

    def logits(self, rows: np.ndarray, wanted: np.ndarray | None = None) -> np.ndarray:
        """(N, N, R) float64 logits, antisymmetric, of all ordered pairs of objects described by (N, K) rows.

        Rows with leading dimensions are a batch of scenes. `wanted`, (N, N) bool, of each pair both ways or neither:
        the others are NaN.
        Those of a softmax network are logarithms of probabilities.
        """
        vocabulary = self.contract.vocabulary
        *batch, n, width = rows.shape
        count = prod(batch) * n
        # A relation after the other: numbers side by side are worked through several times as fast.
        found = np.full((len(vocabulary), count, n), np.nan)
        if not count * n:
            return np.zeros((*batch, n, n, len(vocabulary)))
        scenes = np.ascontiguousarray(np.moveaxis(rows.reshape(-1, n, width), -1, 0))
        chosen = (
            np.ones((count, n), np.bool_) if wanted is None else np.broadcast_to(wanted, (*batch, n, n)).reshape(-1, n)
        )
        step = max(1, BLOCK // n)
        blocks = [slice(start, start + step) for start in range(0, count, step)]
        feeds = (self._feed(scenes, block, chosen[block]) for block in blocks)
        for block, logits in zip(blocks, run_blocks(self._session, feeds, self.path), strict=True):
            found[:, block][:, chosen[block]] = logits[0].T
        mirrored = antisymmetric if self.contract.output == "sigmoid" else antisymmetric_log_softmax
        return mirrored(np.moveaxis(found.reshape(-1, *batch, n, n), 0, -1), vocabulary)

    def _feed(self, scenes: np.ndarray, block: slice, chosen: np.ndarray) -> dict[str, np.ndarray]:
        """Network's input, (P, D) float32, of chosen pairs, (B, N) bool, of a block of all scenes' objects, (K, M, N),
        with each of its scene.
        """
        width, _, n = scenes.shape
        first = scenes.reshape(width, -1)[:, block, None]
        # What is of an object alone is worked out once where all are of one scene.
        others = scenes if scenes.shape[1] == 1 else scenes[:, np.arange(block.start, block.start + len(chosen)) // n]
        features = self.features.between(first, others)[:, chosen]
        scaled = (features - self.contract.mean[:, None]) / self.contract.std[:, None]
        return {self._input: np.ascontiguousarray(scaled.T, np.float32)}

    def probabilities(self, rows: np.ndarray, wanted: np.ndarray | None = None) -> np.ndarray:
        """(N, N, R) calibrated probabilities; 0.5 where either object is not known (NaN), NaN beyond `wanted` pairs.

        A softmax network's classes are as frequent as its training pairs had
        them. What ranks pairs is P(relation | pair) / prior(relation), made
        to sum to 1 again: the answer as if all relations were equally frequent.
        """
        known = np.logical_and.reduce(np.isfinite(rows), axis=-1)
        scaled = self._calibrated(np.where(known[..., None], rows, 0.0), wanted)
        softened = self.contract.output == "softmax"
        result = softmax(scaled - np.log(self.contract.prior)) if softened else sigmoid(scaled)
        if not known.all():
            result[~(known[..., :, None] & known[..., None, :])] = 0.5
        return result

    def class_probabilities(self, rows: np.ndarray) -> np.ndarray:
        """(N, N, R) of a softmax network before the prior is divided out; NaN where either object is not known."""
        known = np.logical_and.reduce(np.isfinite(rows), axis=1)
        result = softmax(self._calibrated(np.where(known[:, None], rows, 0.0)))
        result[~(known[:, None] & known[None, :])] = np.nan
        return result

    def _calibrated(self, rows: np.ndarray, wanted: np.ndarray | None = None) -> np.ndarray:
        slope, shift = np.array([self.contract.calibration[r] for r in self.contract.vocabulary]).T
        return self.logits(rows, wanted) * slope + shift


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


_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}")
TAKEN = ("rule", "trained")


def network_folder() -> Path:
    """Folder of installed networks: the user's, or SPATIALVIZ_NETWORKS."""
    from platformdirs import user_data_path

    given = os.environ.get("SPATIALVIZ_NETWORKS")
    return Path(given) if given else user_data_path("spatialviz") / "networks"


def installed_networks() -> tuple[Path, ...]:
    """Files of all installed networks, in the order of their names, which are the files' stems."""
    folder = network_folder()
    files = sorted(folder.glob("*.onnx")) if folder.is_dir() else []
    return tuple(f for f in files if _NAME.fullmatch(f.stem))


def installed_network(name: str) -> Path | None:
    """File of an installed network; None for an unknown name."""
    if not _NAME.fullmatch(name):
        return None
    path = network_folder() / f"{name}.onnx"
    return path if path.is_file() else None


def is_named(scorer: str | None) -> bool:
    """True for a relation scorer named by something known here: None, rule, trained, or an installed network."""
    return scorer in (None, *TAKEN) or (scorer is not None and installed_network(scorer) is not None)


def install_network(network: Path, name: str, *, overwrite: bool = False) -> Path:
    """Copy a network, with its card and its vectors, to where `--srm NAME` finds it; returns the copy.

    Raises
    ------
    InputError
        No such network, one that cannot be fed, a name that is none or is taken, a folder that cannot be written.
    """
    require(
        _NAME.fullmatch(name) and name not in TAKEN and not name.endswith(".onnx"),
        "no name for a network",
        got=repr(name),
        expected="letters, digits, . _ -; not rule or trained",
    )
    OnnxScorer(network)
    folder = network_folder()
    target = folder / f"{name}.onnx"
    require(
        not (target.exists() and not overwrite),
        "there is a network of this name",
        expected="another name, or --overwrite",
        path=target,
    )
    companions = (network.with_suffix(".json"), vectors_path(network))
    try:
        with file_with_companions(target) as made:
            for source in (*(f for f in companions if f.is_file()), network):
                shutil.copyfile(source, made.parent / f"{name}{source.name.removeprefix(network.stem)}")
    except OSError as error:
        raise InputError("the network cannot be installed", got=error.strerror or str(error), path=folder) from error
    return target
