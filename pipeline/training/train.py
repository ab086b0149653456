"""Training the relation network in torch as the paper says, and writing it as ONNX.

Three layers, Adam at 1e-3 halved every 3 epochs, 10 epochs; binary cross
entropy over all relations at once with the undecided cells (U) masked, or cross
entropy where exactly one relation fits. What the paper leaves open (width,
batch, initial weights) is that of the method notes: 128, 256, He. One thread
and torch's deterministic algorithms: equal pairs and seeds give equal bytes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import xxhash

from pipeline.language.relation_names import DIRECTIONAL, INVERSE, VOCABULARIES
from pipeline.language.vectors import LanguageContract
from pipeline.metrics.calibration_metrics import IDENTITY, Platt
from pipeline.relations.contract import NetworkContract, Output
from pipeline.relations.features import LANGUAGE, feature_set
from pipeline.relations.model import ClassVectors
from pipeline.relations.relations import T
from pipeline.system.errors import extra_module, require
from pipeline.system.frozen import dataclass
from pipeline.training.label_data import PairSet
from pipeline.training.training_data import FrameSamples, iterate_pairs

OUTPUTS: dict[str, Output] = {name: "softmax" if name == "semantic-abstraction" else "sigmoid" for name in VOCABULARIES}
"""What the paper trains on each vocabulary: several relations may hold, or exactly one fits. "all" is for review."""

Layers = tuple[tuple[np.ndarray, np.ndarray], ...]
"""W (inputs, outputs) and b of each layer, float32."""

FEWEST_EXAMPLES = 10
"""A class of a softmax network with fewer examples gets no output: the rule scores it."""

LARGEST_BATCH, SMALLEST_BATCH, STEPS = 256, 8, 290
"""Where no batch is given: about so many steps an epoch, or a thousand pairs would be 40 steps in all."""


@dataclass(frozen=True)
class TrainConfig:
    """How the network is trained; the defaults are the paper's, or the measured choice where it gives none."""

    features: str = "rel14"
    vocabulary: str = "avd"
    hidden: int = 128
    batch: int | None = None
    epochs: int = 10
    learning_rate: float = 1e-3
    halve_every: int = 3
    seed: int = 0
    members: int = 1
    """So many networks from other initial weights, as one of as many times the width: its logits are their means."""

    def check(self) -> None:
        """Raise InputError where the numbers make no sense."""
        require(
            min(self.hidden, self.epochs, self.halve_every, self.members, 1 if self.batch is None else self.batch) >= 1
            and self.learning_rate > 0,
            "width, batch, epochs, halving, members and learning rate must be positive",
            got=self,
        )
        require(0 <= self.seed < 1 << 63, "a seed must be from 0 to 2^63 - 1", got=self.seed)
        require(
            self.vocabulary in OUTPUTS, "no such vocabulary", got=repr(self.vocabulary), expected=" | ".join(OUTPUTS)
        )

    @property
    def output(self) -> Output:
        return OUTPUTS[self.vocabulary]

    def batch_of(self, pairs: int) -> int:
        """Pairs in a step."""
        return self.batch or min(max(pairs // STEPS, SMALLEST_BATCH), LARGEST_BATCH)


@dataclass(frozen=True)
class Epoch:
    """How far training is: the mean loss of the epoch, and micro-F1 (top-1 of a softmax network) on held-out pairs."""

    number: int
    loss: float
    metric: float | None


@dataclass(frozen=True)
class TrainedModel:
    """A network before calibration."""

    config: TrainConfig
    layers: Layers
    """tuple of (W, b): float32, W is (inputs, outputs)."""
    mean: np.ndarray
    std: np.ndarray
    """(D,) float64: of the training features."""
    curve: tuple[Epoch, ...]
    pairs: int
    """Training pairs."""
    data: str
    """Hash of features and labels."""
    vocabulary: tuple[str, ...] = DIRECTIONAL
    """The relation of each output."""
    prior: tuple[float, ...] = ()
    """Of a softmax network."""
    vectors: ClassVectors | None = None
    language: LanguageContract | None = None

    @property
    def losses(self) -> tuple[float, ...]:
        """Mean loss of each epoch."""
        return tuple(epoch.loss for epoch in self.curve)

    @property
    def weights_hash(self) -> str:
        """xxh3-128 of all weights."""
        digest = xxhash.xxh3_128()
        for w, b in self.layers:
            digest.update(np.ascontiguousarray(w).data)
            digest.update(np.ascontiguousarray(b).data)
        return digest.hexdigest()

    def contract(self, calibration: dict[str, Platt] | None = None) -> NetworkContract:
        """Contract of the ONNX file; without calibration probabilities are the bare sigmoid or softmax."""
        return NetworkContract(
            self.config.features,
            feature_set(self.config.features, 0 if self.language is None else self.language.dimension).columns,
            self.mean,
            self.std,
            self.vocabulary,
            calibration or dict.fromkeys(self.vocabulary, IDENTITY),
            self.config.seed,
            self.data,
            self.config.output,
            self.prior,
            self.language,
            "" if self.vectors is None else self.vectors.hash,
        )


def train_srm(
    samples: Sequence[FrameSamples],
    config: TrainConfig | None = None,
    progress: Callable[[int, float], None] | None = None,
) -> TrainedModel:
    """Train on the pairs of these rendered views.

    Parameters
    ----------
    progress
        Called after each epoch with (epochs done, mean loss).

    Raises InputError: there is nothing to learn from, or the configuration makes no sense.
    Raises MissingExtra: torch is not installed.
    """
    config = config or TrainConfig()
    check_room_config(config)
    dimension = feature_set(config.features).dimension
    views = list(iterate_pairs(samples, config.features))
    features = np.concatenate([f for f, _ in views]) if views else np.zeros((0, dimension))
    states = np.concatenate([s for _, s in views]) if views else np.zeros((0, len(DIRECTIONAL)), np.int8)
    tell = None if progress is None else lambda epoch: progress(epoch.number, epoch.loss)
    pairs = PairSet(features, states)
    found = [
        train_pairs(pairs, replace(config, seed=config.seed + k), progress=tell if k == 0 else None)
        for k in range(config.members)
    ]
    return replace(found[0], config=config, layers=averaged([model.layers for model in found]))


def averaged(networks: Sequence[Layers]) -> Layers:
    """Average networks of equal sizes, as a network of so many times the width."""
    if len(networks) == 1:
        return networks[0]
    first, *middle, last = zip(*networks, strict=True)
    share = np.float32(1 / len(networks))
    return (
        (np.concatenate([w for w, _ in first], axis=1), np.concatenate([b for _, b in first])),
        *((_blocks([w for w, _ in layer]), np.concatenate([b for _, b in layer])) for layer in middle),
        (np.concatenate([w for w, _ in last]) * share, np.sum([b for _, b in last], axis=0, dtype=np.float32) * share),
    )


def _blocks(matrices: Sequence[np.ndarray]) -> np.ndarray:
    """The matrices along the diagonal of one, zeros elsewhere."""
    rows, columns = np.array([m.shape for m in matrices]).T
    whole = np.zeros((rows.sum(), columns.sum()), np.float32)
    for matrix, row, column in zip(matrices, np.cumsum(rows), np.cumsum(columns), strict=True):
        whole[row - len(matrix) : row, column - matrix.shape[1] : column] = matrix
    return whole


def check_room_config(config: TrainConfig) -> None:
    """Raise InputError unless rendered rooms can teach this."""
    config.check()
    require(
        config.vocabulary == "avd" and not config.features.endswith(LANGUAGE),
        "rendered rooms teach the six directional relations, without class names",
        got=f"{config.features}, {config.vocabulary}",
        expected="labels for anything else",
    )


def train_pairs(
    pairs: PairSet,
    config: TrainConfig | None = None,
    *,
    validation: PairSet | None = None,
    language: LanguageContract | None = None,
    progress: Callable[[Epoch], None] | None = None,
) -> TrainedModel:
    """Train on these pairs.

    Parameters
    ----------
    pairs
        States in the order of the configured vocabulary; pairs that teach nothing are left out.
    validation
        For the metric of each epoch; it does not change the weights.
    language
        Where the pairs have class vectors: what they are.
    progress
        Called after each epoch.

    Raises InputError: there is nothing to learn from, or the configuration makes no sense.
    Raises MissingExtra: torch is not installed.
    """
    config = config or TrainConfig()
    config.check()
    torch = need_torch()
    contract = feature_set(config.features, pairs.language)
    pairs = pairs.take(pairs.learnable(config.output))
    vocabulary, prior = VOCABULARIES[config.vocabulary], ()
    if config.output == "softmax":
        kept = _classes_with_examples(pairs.states, vocabulary)
        # A pair whose only T is a class without output has no class any more.
        pairs, validation = _only(pairs, kept), None if validation is None else _only(validation, kept)
        vocabulary = tuple(vocabulary[k] for k in kept)
        prior = _prior(pairs.states, vocabulary)
    require(len(pairs) >= 2, "there are no pairs of objects to learn from", got=f"{len(pairs)} pairs")
    mean, std = pairs.moments()
    batch = config.batch_of(len(pairs))

    with deterministic(torch):
        generator = torch.Generator().manual_seed(config.seed)
        sizes = (contract.dimension, config.hidden, config.hidden, len(vocabulary))
        weights = [
            (torch.randn(i, o, generator=generator) * (2.0 / i) ** 0.5).requires_grad_() for i, o in pairwise(sizes)
        ]
        biases = [torch.zeros(o, requires_grad=True) for o in sizes[1:]]
        given = _inputs(torch, pairs, mean, std)
        loss_of = _loss(torch, config.output, pairs.states)
        measure = None if validation is None else _measure(torch, config.output, validation, mean, std)
        optimiser = torch.optim.Adam([*weights, *biases], lr=config.learning_rate)
        schedule = torch.optim.lr_scheduler.StepLR(optimiser, config.halve_every, 0.5)
        curve: list[Epoch] = []
        for number in range(1, config.epochs + 1):
            order = torch.randperm(len(pairs), generator=generator)
            total = 0.0
            for start in range(0, len(pairs), batch):
                rows = order[start : start + batch]
                loss = loss_of(forward(torch, given(rows), weights, biases), rows)
                optimiser.zero_grad()
                loss.backward()
                optimiser.step()
                total += float(loss.detach()) * len(rows)
            schedule.step()
            metric = None if measure is None else measure(weights, biases)
            curve.append(Epoch(number, total / len(pairs), metric))
            if progress is not None:
                progress(curve[-1])
        layers = tuple(
            (w.detach().numpy().copy(), b.detach().numpy().copy()) for w, b in zip(weights, biases, strict=True)
        )
    return TrainedModel(
        config, layers, mean, std, tuple(curve), len(pairs), pairs.hash(), vocabulary, prior, pairs.vectors, language
    )


def _classes_with_examples(states: np.ndarray, vocabulary: Sequence[str]) -> list[int]:
    enough = (states == T).sum(axis=0) >= FEWEST_EXAMPLES
    return [
        k
        for k, relation in enumerate(vocabulary)
        if enough[k] and (relation not in INVERSE or enough[vocabulary.index(INVERSE[relation])])
    ]


def _only(pairs: PairSet, kept: Sequence[int]) -> PairSet:
    fewer = PairSet(pairs.features, pairs.states[:, list(kept)], pairs.classes, pairs.vectors)
    return fewer.take(fewer.learnable("softmax"))


def _prior(states: np.ndarray, vocabulary: Sequence[str]) -> tuple[float, ...]:
    """Share of each class, the same for inverse classes."""
    require(
        len(vocabulary) >= 2,
        "there are too few relations to tell apart",
        got=", ".join(vocabulary) or "none",
        expected=f"at least two with {FEWEST_EXAMPLES} pairs of which only they hold",
    )
    count = (states == T).sum(axis=0)
    share = (count + count[[vocabulary.index(INVERSE.get(r, r)) for r in vocabulary]]) / 2
    require(not (share <= 0).any(), "a class has no training example", got=int((share <= 0).argmax()))
    return tuple((share / share.sum()).tolist())


def _inputs(torch: Any, pairs: PairSet, mean: np.ndarray, std: np.ndarray) -> Callable[[Any], Any]:
    """A function of rows that gives their standardised inputs."""
    geometry, first, second = (torch.from_numpy(array) for array in pairs.standardised(mean, std))
    if pairs.classes is None or pairs.vectors is None:
        return lambda rows: geometry[rows]
    a, b = torch.from_numpy(pairs.classes.T.astype(np.int64).copy())
    return lambda rows: torch.cat([geometry[rows], first[a[rows]], second[b[rows]]], dim=1)


def _loss(torch: Any, output: Output, states: np.ndarray) -> Callable[[Any, Any], Any]:
    """A function of (logits, rows): the mean loss of a batch."""
    functional = torch.nn.functional
    if output == "softmax":
        classes = torch.from_numpy((states == T).argmax(axis=1))
        return lambda logits, rows: functional.cross_entropy(logits, classes[rows])
    target = torch.from_numpy((states > 0).astype(np.float32))
    known = torch.from_numpy((states != 0).astype(np.float32))

    def masked(logits: Any, rows: Any) -> Any:
        cells = functional.binary_cross_entropy_with_logits(logits, target[rows], reduction="none")
        return (cells * known[rows]).sum() / known[rows].sum()

    return masked


def _measure(
    torch: Any, output: Output, pairs: PairSet, mean: np.ndarray, std: np.ndarray
) -> Callable[[Any, Any], float] | None:
    """A function of (weights, biases): micro-F1 at 0.5, or top-1, of the bare network; None without pairs."""
    pairs = pairs.take(pairs.learnable(output))
    if not len(pairs):
        return None
    given = _inputs(torch, pairs, mean, std)
    holds, known = pairs.states == T, pairs.states != 0

    def measure(weights: Any, biases: Any) -> float:
        with torch.no_grad():
            parts = torch.arange(len(pairs)).split(1 << 14)
            logits = torch.cat([forward(torch, given(rows), weights, biases) for rows in parts]).numpy()
        if output == "softmax":
            return float((logits.argmax(axis=1) == holds.argmax(axis=1)).mean())
        positive = (logits > 0) & known
        right, found, true = (positive & holds).sum(), positive.sum(), (holds & known).sum()
        return float(2 * right / max(found + true, 1))

    return measure


def forward(torch: Any, x: Any, weights: Sequence[Any], biases: Sequence[Any]) -> Any:
    for k, (w, b) in enumerate(zip(weights, biases, strict=True)):
        x = torch.addmm(b, x, w)
        if k + 1 < len(weights):
            x = torch.relu(x)
    return x


def need_torch() -> Any:
    """Import torch; MissingExtra if not installed."""
    return extra_module("torch", "training", "train")


def require_training() -> None:
    """Raise MissingExtra now, and not after the rooms are made, where torch or onnx is missing."""
    need_torch()
    extra_module("onnx", "writing ONNX files", "train")


@contextmanager
def deterministic(torch: Any) -> Iterator[None]:
    threads, strict = torch.get_num_threads(), torch.are_deterministic_algorithms_enabled()
    torch.set_num_threads(1)
    torch.use_deterministic_algorithms(True)
    try:
        yield
    finally:
        torch.use_deterministic_algorithms(strict)
        torch.set_num_threads(threads)
