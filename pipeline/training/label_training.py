"""Training on a labels folder: split, network, calibration, figures, and the card that says all of it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.labels.profiles import GIVEN
from pipeline.labels.reading import Labels, open_labels
from pipeline.language.relation_names import VOCABULARIES
from pipeline.language.vectors import LanguageContract, open_vectors
from pipeline.metrics.calibration_metrics import Platt, fit_calibration, fit_temperature
from pipeline.metrics.splits import PARTS, TEST, TRAIN, VALIDATION, SplitKind, SplitPlan, split_frames
from pipeline.relations.features import LANGUAGE, cli_features, feature_set, geometry_of
from pipeline.relations.model import ClassVectors, OnnxScorer
from pipeline.system.errors import require
from pipeline.system.frozen import dataclass
from pipeline.system.worker_pool import one_thread
from pipeline.training.card import evaluate, evaluate_classes, network_path, write_network
from pipeline.training.label_data import LabelData, LabelledFrame, pair_set, read_label_data, trained_on
from pipeline.training.train import Epoch, TrainConfig, TrainedModel, require_training, train_pairs

CIRCULAR = (
    "features and auto-labels come from the same points: a network that learns them imitates the rule that made them, "
    "and its figures say how well, not how true the labels are"
)


@dataclass(frozen=True)
class LabelTraining:
    """What is learnt from a labels folder."""

    labels: Path
    config: TrainConfig
    split: SplitKind | None = None
    """ "scene", "blocks", or the default of `split_frames`."""
    vectors: Path | None = None
    """File of text vectors, for "+lang" contracts."""
    normalised: bool = False
    """Word vectors are divided by their lengths before a phrase's mean is taken."""
    pairs: int | None = None
    """At most so many training pairs, drawn at random."""

    def check(self) -> None:
        """Raise InputError where the arguments do not fit each other."""
        self.config.check()
        language = self.config.features.endswith(LANGUAGE)
        feature_set(geometry_of(self.config.features))
        require(
            not language or self.vectors is not None,
            f"the features {cli_features(self.config.features)} need vectors of class names",
            expected="--vectors with a file of text vectors",
        )
        require(
            language or (self.vectors is None and not self.normalised),
            f"the features {cli_features(self.config.features)} use no class names",
            expected="--features with +lang, or no text vectors",
        )
        require(self.pairs is None or self.pairs >= 2, "there must be at least two pairs to learn from", got=self.pairs)


@one_thread()
def train_on_labels(
    job: LabelTraining,
    out: Path,
    progress: Callable[[Epoch], None] | None = None,
    *,
    plan: SplitPlan | None = None,
) -> dict[str, Any]:
    """Train on some of the labels, calibrate on others, and measure on the rest.

    Writes `out`, beside it with the suffix .json the card, and for language
    networks with .vectors.npz the vectors of all classes of the labels; each whole or not at all.

    Parameters
    ----------
    out
        The ONNX file to write; its folder is made if it is missing.
    progress
        Called after each epoch.
    plan
        A split that was made for several labels of the dataset; by default that of the job.

    Returns
    -------
    dict
        The card.

    Raises InputError: the labels, the vectors or the arguments cannot be used.
    Raises MissingExtra: torch or onnx is not installed.
    """
    job.check()
    out = network_path(out)
    require_training()
    config = job.config
    labels = open_labels(job.labels)
    data = read_label_data(labels, config.features, VOCABULARIES[config.vocabulary])
    vectors, language = _language(job, data)
    keys = [f.key for f in data.frames]
    plan = split_frames(keys, job.split, config.seed) if plan is None else plan.for_frames(keys)
    train, validation, test = ([data.frames[k] for k in plan.indices(part)] for part in (TRAIN, VALIDATION, TEST))
    learnt = pair_set(train, data.features, config.output, vectors=vectors, limit=job.pairs, seed=config.seed)
    watched = pair_set(validation, data.features, config.output, vectors=vectors)
    model = train_pairs(learnt, config, validation=watched, language=language, progress=progress)
    del learnt, watched
    kept = [data.vocabulary.index(relation) for relation in model.vocabulary]
    test, validation = ([replace(f, states=f.states[..., kept]) for f in frames] for frames in (test, validation))
    worded = {}
    if language is not None and vectors is not None:
        worded["language"] = {**asdict(language), "classes": len(vectors.names), "classes_xxh3_128": vectors.hash}
    return write_network(
        out,
        model,
        _command(job, out),
        lambda plain: _calibrate(plain, validation, data),
        lambda scorer, _: {
            "labels": _labels_record(labels, data),
            "training": _training_record(model, job, data),
            "split": plan.record(),
            "held_out": held_out(scorer, test, data.names),
            "warnings": _warnings(model, plan, data, labels.manifest.profile.get("name") == GIVEN),
            **worded,
        },
        trained_on(labels, plan),
    )


def _language(job: LabelTraining, data: LabelData) -> tuple[ClassVectors | None, LanguageContract | None]:
    if job.vectors is None:
        return None, None
    source = open_vectors(job.vectors)
    vectors = source.phrases(data.names, normalised=job.normalised)
    return ClassVectors(data.names, vectors), LanguageContract.of(source, normalised=job.normalised)


def _worded(scorer: OnnxScorer, frame: LabelledFrame, names: Sequence[str]) -> np.ndarray:
    return scorer.with_words(frame.rows, [names[int(k)] for k in frame.classes])


def _calibrate(scorer: OnnxScorer, frames: Sequence[LabelledFrame], data: LabelData) -> dict[str, Platt]:
    logits = [scorer.logits(_worded(scorer, frame, data.names)) for frame in frames]
    vocabulary = scorer.contract.vocabulary
    if scorer.contract.output == "softmax":
        return fit_temperature(logits, [frame.single() for frame in frames], vocabulary)
    return fit_calibration(logits, [frame.states for frame in frames], vocabulary)


def held_out(scorer: OnnxScorer, frames: Sequence[LabelledFrame], names: Sequence[str]) -> dict[str, Any]:
    """The figures of a network on labelled frames: of `evaluate`, or of `evaluate_classes` for a softmax network.

    The frames' relations are those of the network's vocabulary, in its order.
    """
    rows = [_worded(scorer, frame, names) for frame in frames]
    if scorer.contract.output == "softmax":
        found = [scorer.class_probabilities(r) for r in rows]
        truth = [frame.single() for frame in frames]
        report = evaluate_classes(found, truth, scorer.contract.prior, scorer.contract.vocabulary)
    else:
        report = evaluate([scorer.probabilities(r) for r in rows], [frame.states for frame in frames])
    return {"frames": len(frames), **report}


def _training_record(model: TrainedModel, job: LabelTraining, data: LabelData) -> dict[str, Any]:
    metric = "micro_f1" if model.config.output == "sigmoid" else "top1"
    record = {
        **asdict(model.config),
        "batch": model.config.batch_of(model.pairs),
        "output": model.config.output,
        "relations": list(model.vocabulary),
        "pairs": model.pairs,
        "pairs_asked": job.pairs,
        "curve": [{"epoch": e.number, "loss": e.loss, f"validation_{metric}": e.metric} for e in model.curve],
        "data_xxh3_128": model.data,
    }
    if model.prior:
        record["prior"] = dict(zip(model.vocabulary, model.prior, strict=True))
    return record


def _labels_record(labels: Labels, data: LabelData) -> dict[str, Any]:
    manifest = labels.manifest
    return {
        "folder": labels.root.resolve().name,
        "dataset": Path(str(manifest.dataset.get("path", ""))).name,
        "config_hash": manifest.config_hash,
        "profile": manifest.profile.get("name"),
        "profile_hash": manifest.profile_hash,
        "content": {name: manifest.tables[name].content_hash for name in ("frames", "objects", "relations")},
        "frames": len(data.frames),
        "scenes": len({f.key.scene for f in data.frames}),
        "classes": len(data.names),
    }


def _warnings(model: TrainedModel, plan: SplitPlan, data: LabelData, given: bool) -> list[str]:
    lost = [r for r in data.vocabulary if r not in model.vocabulary]
    empty = [name for k, name in enumerate(PARTS) if not (plan.part == k).any()]
    reasons = (
        (not given, CIRCULAR),
        (plan.warning, plan.warning),
        (lost, f"too few pairs of {', '.join(lost)} to learn from: the network has no output for them"),
        (empty, f"no frames for {', '.join(empty)}"),
    )
    return [text for holds, text in reasons if holds and text]


def _command(job: LabelTraining, out: Path) -> str:
    config = job.config
    words = [
        "spatialviz",
        "train",
        job.labels.resolve().name,
        "--out",
        out.name,
        "--features",
        cli_features(config.features),
        "--vocabulary",
        config.vocabulary,
        "--epochs",
        str(config.epochs),
        "--seed",
        str(config.seed),
    ]
    if job.vectors is not None:
        words += ["--vectors", job.vectors.name, *(["--normalised"] if job.normalised else [])]
    given = {"--split": job.split, "--batch": config.batch, "--pairs": job.pairs}
    return " ".join([*words, *(f"{option} {value}" for option, value in given.items() if value is not None)])
