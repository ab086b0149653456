"""Doubts on relation labels, by networks that have learnt neither from a label nor from anything of its scene.

The network's answers are antisymmetric by construction: "a left of b" and "b
right of a" get the mean of their two logits. Both cells are of one frame, and
so in one fold: neither label is seen by the network that judges them. A label
is therefore never held against its mirror image; that comparison is the
linter's (`relation/inverse`). What the network gains from the mirror image is a
second look at the same geometry.

As in `pipeline.metrics.splits`, frames of one scene resemble each other. So scenes
are held out, or where there are few, blocks of camera positions with a gap.

Which labels are probably wrong then follows by confident learning (C. G. Northcutt, L. Jiang and I. L. Chuang, JAIR 70
(2021), 1373-1411): per-class thresholds, the confident joint of given and true labels, its calibration to the counts of
given labels (section 3.1). Each relation is a question of its own, as relations may hold together and cells that are
too close to call (U) have no label. The network is trained on given labels, and so its probability is that of the given
label. With the noise rates of the confident joint it is inverted to that of the true label, and Bayes' rule gives the
probability that a label is wrong.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import field, replace
from itertools import count
from typing import Literal

import numpy as np
import xxhash

from pipeline.language.relation_names import VOCABULARIES
from pipeline.metrics.calibration_metrics import antisymmetric, sigmoid
from pipeline.metrics.splits import FEWEST_SCENES, FRAME_GAP, GAP_M, FrameKey, along_spread
from pipeline.relations.features import LANGUAGE, feature_set
from pipeline.relations.relations import T, U
from pipeline.system.errors import require
from pipeline.system.frozen import dataclass
from pipeline.system.worker_pool import one_thread
from pipeline.training.label_data import LabelData, LabelledFrame, pair_set
from pipeline.training.train import TrainConfig, TrainedModel, train_pairs

FEWEST = 10
"""With fewer labels of either answer no noise rates are estimated."""
MOST_NOISE = 0.9
"""The two noise rates together; at 1 a label would say nothing."""
TRUSTED = 0.9
"""How far the inverted probability is trusted; for the rest the network's own counts, so that none is certain."""


@dataclass(frozen=True)
class Noise:
    """How labels of one question came to be wrong."""

    joint: np.ndarray
    """(2, 2) float64: labels by what they say [0: no, 1: yes] and what they should [0, 1]; sums to their number."""
    yes_for_no: float
    no_for_yes: float
    """Share of true noes that were labelled yes, and the reverse."""

    @property
    def wrong(self) -> float:
        """Estimated number of wrong labels."""
        return float(self.joint[0, 1] + self.joint[1, 0])


def estimate_noise(p: np.ndarray, says: np.ndarray) -> Noise:
    """Noise rates by the confident joint.

    `p` (M,) float: out-of-fold probability of "yes". `says` (M,) bool: what the labels say.

    Raises InputError: lengths differ, or a probability is not in 0..1.
    """
    require(p.ndim == 1 and p.shape == says.shape, "one probability a label is needed", got=p.shape)
    require(((p >= 0) & (p <= 1)).all(), "probabilities must lie between 0 and 1")
    counts = np.array([(~says).sum(), says.sum()], np.float64)
    if counts.min() < FEWEST:
        return Noise(np.diag(counts), 0.0, 0.0)
    table = confident_joint(p, says)[1]
    # One more of each kind of error: where none was seen, ranks still differ.
    table += [[0, 1], [1, 0]]
    joint = table / table.sum(axis=1, keepdims=True) * counts[:, None]
    # Columns are true classes; a class that is confidently seen nowhere leaves its rate at nothing.
    true = np.maximum(joint.sum(axis=0), 1e-12)
    yes_for_no, no_for_yes = joint[1, 0] / true[0], joint[0, 1] / true[1]
    scale = min(1.0, MOST_NOISE / max(yes_for_no + no_for_yes, 1e-12))
    return Noise(joint, float(yes_for_no * scale), float(no_for_yes * scale))


def confident_joint(p: np.ndarray, says: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Thresholds and the confident joint of given and true labels (equation 1 of the paper).

    `p` (M,) float; `says` (M,) bool, with either answer at least once.

    Returns `thresholds` (2,) float64: mean probability of each answer over the labels that give it. `counts` (2, 2)
    float64: by what labels say and what they should.
    """
    thresholds = np.array([(1 - p[~says]).mean(), p[says].mean()])
    confident = np.stack([1 - p >= thresholds[0], p >= thresholds[1]])
    # Where both are confident, the more probable one is what the label should be.
    truly_yes = np.where(confident.all(axis=0), p >= 0.5, confident[1])
    counted = confident.any(axis=0)
    table = np.zeros((2, 2))
    np.add.at(table, (says[counted].astype(np.int64), truly_yes[counted].astype(np.int64)), 1.0)
    return thresholds, table


def probability_wrong(p: np.ndarray, says: np.ndarray, noise: Noise | None = None) -> np.ndarray:
    """(M,) float64: how probably each label is wrong; arguments as of `estimate_noise`.

    P(says | x) = (1 - no_for_yes) P(yes | x) + yes_for_no P(no | x) is solved for
    P(yes | x), and P(wrong | x, says) follows by Bayes' rule. Without noise rates
    (too few labels) it is one less the self-confidence.
    """
    noise = noise or estimate_noise(p, says)
    e, d = noise.yes_for_no, noise.no_for_yes
    if not (e or d):
        return 1 - self_confidence(p, says)
    inverted = np.clip((p - e) / (1 - e - d), 0.0, 1.0)
    yes = np.clip(TRUSTED * inverted + (1 - TRUSTED) * p, 1e-9, 1 - 1e-9)
    right = np.where(says, (1 - d) * yes, (1 - e) * (1 - yes))
    wrong = np.where(says, e * (1 - yes), d * yes)
    return wrong / (wrong + right)


def self_confidence(p: np.ndarray, says: np.ndarray) -> np.ndarray:
    """(M,) float64: probability of the given label; the least first ranks errors.

    Of two answers it ranks as the normalised margin does, which is twice this less 1.
    """
    return np.where(says, p, 1 - p)


REVIEWED = "all"
"""The vocabulary of the networks: every relation is judged alone; those that were not labelled teach nothing."""
EPOCHS = 5
"""Half of the usual: longer training ranks no better, and takes wrong labels to heart."""
PASSES = 3
"""One pass overlooks 1.0 % of planted errors, three 0.5 % (in rendered rooms: `tests/benchmarks/planted_labels.py`).
Few that are left cost much: as many chosen at random cost at least as much F1, so it is their number that counts."""
PRUNED = 0.5
"""A label that is more probably wrong than right is not learnt from in the next pass."""
FOLDS = 5


@dataclass(frozen=True)
class DoubtConfig:
    """How labels are doubted."""

    folds: int = FOLDS
    passes: int = PASSES
    """After the first, networks are trained once more without the labels that were found probably wrong: better, for as
    long again. Which labels are left out is then known from networks that have seen the others."""
    train: TrainConfig = field(default_factory=lambda: TrainConfig(vocabulary=REVIEWED, epochs=EPOCHS))
    """Its features are those of the labels' rows; every relation is judged alone, whatever its vocabulary."""

    def check(self) -> None:
        """Raise InputError where the numbers make no sense."""
        self.train.check()
        require(
            self.folds >= 2 and self.passes >= 1,
            "there must be two folds and a pass",
            got=f"{self.folds} folds, {self.passes} passes",
        )
        require(
            not self.train.features.endswith(LANGUAGE),
            "labels are reviewed by geometry, without class names",
            got=self.train.features,
        )


@dataclass(frozen=True, eq=False)
class Doubts:
    """What networks that did not learn from them say of labels."""

    vocabulary: tuple[str, ...]
    """The order of R, that of the frames' states."""
    probabilities: tuple[np.ndarray, ...]
    """tuple of (N, N, R) float64: of each frame: how probably the relation holds. Of the diagonal it means nothing."""
    wrong: tuple[np.ndarray, ...]
    """tuple of (N, N, R) float64: how probably the label is wrong; NaN where it is U."""
    noise: dict[str, Noise]
    """By relation."""
    folds: Folds


def doubt_labels(
    data: LabelData,
    config: DoubtConfig | None = None,
    *,
    trusted: Sequence[np.ndarray] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Doubts:
    """Confident learning over a labels folder.

    `trusted` sequence of (N, N, R) bool: of each frame: labels that a person has settled. They are learnt from in every
    pass, and are not wrong: no noise is estimated from them, and what is estimated is of the others.

    Raises InputError: there is nothing to learn from, or the configuration makes no sense.
    Raises MissingExtra: torch is not installed.
    """
    config = config or DoubtConfig(train=TrainConfig(data.features, REVIEWED, epochs=EPOCHS))
    config.check()
    train = replace(config.train, vocabulary=REVIEWED)
    folds = make_folds([f.key for f in data.frames], config.folds, train.seed)
    done, total = count(1), config.passes * len(folds)
    trained = None if progress is None else lambda: progress(next(done), total)
    learnt_from, found, wrong, noise = data.frames, (), (), {}
    for number in range(config.passes):
        if number:
            learnt_from = [
                replace(f, states=np.where((w > PRUNED) & ~(False if trusted is None else trusted[k]), U, f.states))
                for k, (f, w) in enumerate(zip(data.frames, wrong, strict=True))
            ]
        found = out_of_fold(learnt_from, data.vocabulary, train, folds, trained)
        wrong, noise = _wrong(data.frames, found, data.vocabulary, trusted)
    return Doubts(data.vocabulary, found, wrong, noise, folds)


@one_thread()
def out_of_fold(
    frames: Sequence[LabelledFrame],
    vocabulary: Sequence[str],
    config: TrainConfig,
    folds: Folds,
    trained: Callable[[], None] | None = None,
) -> tuple[np.ndarray, ...]:
    """(N, N, R) float64 of each frame: probabilities by networks trained on the other folds.

    `trained`: called after each network.
    """
    outputs = VOCABULARIES[config.vocabulary]
    indices = [outputs.index(relation) for relation in vocabulary]
    found: list[np.ndarray] = [np.zeros(0)] * len(frames)
    for held, learnt in zip(folds.held, folds.learnt, strict=True):
        if not held.any():
            continue
        inside = [_padded(frames[k], indices, len(outputs)) for k in np.flatnonzero(learnt).tolist()]
        model = train_pairs(pair_set(inside, config.features, config.output), config)
        for k in np.flatnonzero(held).tolist():
            found[k] = network_probabilities(model, frames[k].rows)[..., indices]
        if trained is not None:
            trained()
    return tuple(found)


def network_probabilities(model: TrainedModel, rows: np.ndarray) -> np.ndarray:
    """(N, N, R) float64 bare probabilities of a sigmoid network, antisymmetric, from (N, K) described objects."""
    pairs = feature_set(model.config.features).pair(rows)
    x = ((pairs - model.mean) / model.std).reshape(-1, len(model.mean)).astype(np.float32)
    for number, (w, b) in enumerate(model.layers, start=1):
        x = x @ w + b
        if number < len(model.layers):
            np.maximum(x, 0, out=x)
    logits = x.astype(np.float64).reshape(*pairs.shape[:-1], len(model.vocabulary))
    return sigmoid(antisymmetric(logits, model.vocabulary))


def _padded(frame: LabelledFrame, indices: Sequence[int], outputs: int) -> LabelledFrame:
    states = np.full((*frame.states.shape[:2], outputs), U, np.int8)
    states[..., list(indices)] = frame.states
    return replace(frame, states=states)


def _wrong(
    frames: Sequence[LabelledFrame],
    found: Sequence[np.ndarray],
    vocabulary: Sequence[str],
    trusted: Sequence[np.ndarray] | None = None,
) -> tuple[tuple[np.ndarray, ...], dict[str, Noise]]:
    states, p = stacked([f.states for f in frames]), stacked(found)
    sure = np.zeros(p.shape, np.bool_) if trusted is None else stacked(trusted)
    wrong, noise = np.where(sure & (states != U), 0.0, np.nan), {}
    for k, relation in enumerate(vocabulary):
        known = (states[:, k] != U) & ~sure[:, k]
        says = states[known, k] == T
        noise[relation] = estimate_noise(p[known, k], says)
        wrong[known, k] = probability_wrong(p[known, k], says, noise[relation])
    return unstacked(wrong, [len(f.rows) for f in frames]), noise


def stacked(matrices: Sequence[np.ndarray]) -> np.ndarray:
    """(P, R) cells of the pairs of different objects of all frames, from (N, N, R) of each."""
    return np.concatenate([m[~np.eye(len(m), dtype=np.bool_)] for m in matrices])


def unstacked(cells: np.ndarray, sizes: Sequence[int]) -> tuple[np.ndarray, ...]:
    """Reverse of `stacked` for frames of so many objects; diagonals are NaN, or 0 of integers."""
    nothing = np.nan if cells.dtype.kind == "f" else 0
    found = tuple(np.full((n, n, cells.shape[1]), nothing, cells.dtype) for n in sizes)
    ends = np.cumsum([n * (n - 1) for n in sizes])
    for matrix, own in zip(found, np.split(cells, ends[:-1]), strict=True):
        matrix[~np.eye(len(matrix), dtype=np.bool_)] = own
    return found


@dataclass(frozen=True, eq=False)
class Folds:
    """What is held out, and what is learnt from, in each of K folds."""

    kind: Literal["scene", "blocks"]
    """ "scene": whole scenes; "blocks": blocks of camera positions in each scene."""
    held: np.ndarray
    """(K, F) bool: every frame is held out in exactly one fold."""
    learnt: np.ndarray
    """(K, F) bool: never a frame that is held out, nor one in a gap beside it."""
    gaps: dict[str, float | int]
    """Of "blocks", by scene: metres between blocks, or frames where the scene has no usable poses."""

    def __len__(self) -> int:
        return len(self.held)


def make_folds(frames: Sequence[FrameKey], folds: int = FOLDS, seed: int = 0) -> Folds:
    """Part the frames.

    `seed`: of the order in which scenes are dealt out.

    Raises InputError: fewer than two folds are asked for, or there are fewer than two frames.
    """
    require(folds >= 2, "there must be at least two folds", got=folds)
    require(len(frames) >= 2, "out-of-fold probabilities need at least two frames", got=len(frames))
    names = np.array([f.scene for f in frames], object)
    scenes = sorted(set(names.tolist()))
    return (
        _by_scene(names, scenes, min(folds, len(scenes)), seed)
        if len(scenes) >= FEWEST_SCENES
        else _by_block(frames, names, scenes, folds)
    )


def _by_scene(names: np.ndarray, scenes: Sequence[str], folds: int, seed: int) -> Folds:
    """Scenes in a seeded order, each to the fold that has fewest frames."""
    order = sorted(scenes, key=lambda s: (xxhash.xxh3_64_intdigest(f"{seed}\0{s}".encode("utf-8", "replace")), s))
    held, size = np.zeros((folds, len(names)), np.bool_), np.zeros(folds, np.int64)
    for rank, scene in enumerate(order):
        mine = names == scene
        # At first one scene each, so that no fold stays empty.
        fold = rank if rank < folds else int(size.argmin())
        held[fold] |= mine
        size[fold] += mine.sum()
    return Folds("scene", held, ~held, {})


def _by_block(frames: Sequence[FrameKey], names: np.ndarray, scenes: Sequence[str], folds: int) -> Folds:
    most = max(int((names == scene).sum()) for scene in scenes)
    folds = min(folds, max(most, 2))
    held, learnt = np.zeros((2, folds, len(frames)), np.bool_)
    gaps: dict[str, float | int] = {}
    for number, scene in enumerate(scenes):
        indices = np.flatnonzero(names == scene)
        along, gap = _along([frames[k] for k in indices.tolist()])
        rank = np.argsort(np.argsort(along, kind="stable"), kind="stable")
        # Scenes with few frames start at different folds.
        block = (rank * min(folds, len(indices)) // len(indices) + number) % folds
        gaps[scene] = _held_in_blocks(held, learnt, indices, block, along, gap)
    return Folds("blocks", held, learnt, gaps)


def _along(frames: Sequence[FrameKey]) -> tuple[np.ndarray, float | int]:
    positions = [f.position for f in frames]
    along = None if None in positions else along_spread(np.array(positions, np.float64))
    if along is not None and np.ptp(along) > 0.1:
        return along, GAP_M
    order = np.argsort([f.index for f in frames], kind="stable")
    return np.argsort(order, kind="stable").astype(np.float64), max(1, round(FRAME_GAP * len(frames)))


def _held_in_blocks(
    held: np.ndarray, learnt: np.ndarray, indices: np.ndarray, block: np.ndarray, along: np.ndarray, gap: float | int
) -> float | int:
    """Enter one scene's blocks; the gap is halved until at least half of the other frames are left to learn from."""
    mine = block[None] == np.arange(len(held))[:, None]
    held[:, indices] = mine
    while True:
        # A fold without frames of the scene has none in a gap.
        ends = [(along[inside].min(), along[inside].max()) if inside.any() else (np.inf, -np.inf) for inside in mine]
        near = np.array([(along > first - gap) & (along < last + gap) for first, last in ends])
        kept = ~near & ~mine
        enough = (kept.sum(axis=1) * 2 >= (~mine).sum(axis=1)).all()
        if enough or gap < 0.01:
            learnt[:, indices] = kept if enough else ~mine
            return gap if enough else 0
        gap = gap // 2 if isinstance(gap, int) else gap / 2
