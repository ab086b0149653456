"""What mending labels was worth: networks learnt before and after, measured on the same held-out pairs.

Both are trained with one configuration, one seed and one split of the frames.
The truth of the held-out pairs is that of the labels after.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import field
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.corrections.review.doubts import stacked
from pipeline.labels.reading import Labels
from pipeline.language.relation_names import PHRASE, VOCABULARIES
from pipeline.metrics.intervals import BootstrapConfig
from pipeline.metrics.relation_metrics import RelationEstimates, cell_outcomes, relation_estimates
from pipeline.metrics.splits import PARTS, TEST, SplitKind, SplitPlan, split_frames
from pipeline.metrics.tables import Row, Table
from pipeline.relations.features import LANGUAGE
from pipeline.relations.model import OnnxScorer
from pipeline.relations.relations import U, letter
from pipeline.system.errors import require
from pipeline.system.frozen import dataclass
from pipeline.system.whole_files import file_with_companions
from pipeline.training.card import network_path, rounded
from pipeline.training.label_data import LabelData, LabelledFrame, read_label_data
from pipeline.training.label_training import LabelTraining, train_on_labels
from pipeline.training.train import Epoch, TrainConfig, require_training

SHOWN_CELLS = 200
"""Of the cells that got better and of those that got worse, at most so many are listed: the largest changes."""


@dataclass(frozen=True)
class RetrainConfig:
    """How both networks are trained."""

    train: TrainConfig = field(default_factory=TrainConfig)
    split: SplitKind | None = None
    """See `split_frames`."""
    bootstrap: BootstrapConfig = field(default_factory=BootstrapConfig)

    def check(self) -> None:
        """Raise InputError where the comparison could not be made."""
        self.train.check()
        require(
            self.train.output == "sigmoid" and not self.train.features.endswith(LANGUAGE),
            "networks are compared relation by relation, by geometry",
            got=f"{self.train.features}, {self.train.vocabulary}",
            expected="the vocabulary avd, features without +lang",
        )


@dataclass(frozen=True)
class Retraining:
    """Two networks on the same held-out pairs."""

    relations: tuple[str, ...]
    pairs: int
    frames: int
    """Held out."""
    before: RelationEstimates
    after: RelationEstimates
    gain: RelationEstimates
    """`gain` is after less before, paired."""
    flips: dict[str, tuple[int, int]]
    """By relation, and "all": how many held-out cells became correct, became wrong."""
    changed: dict[str, dict[str, int]]
    """Labels that differ, by part of the split ("train", "validation", "test", "dropped") and relation."""
    better: tuple[dict[str, Any], ...]
    worse: tuple[dict[str, Any], ...]
    """Held-out cells that became correct, became wrong: frame, a, b, relation, label, before, after (probabilities)."""
    split: dict[str, Any]
    """See `SplitPlan.record`."""
    cluster: str
    """What intervals are drawn over, "scene" or "frame"."""
    cards: tuple[dict[str, Any], dict[str, Any]]
    """Of both networks."""
    caveats: tuple[str, ...] = ()
    """What the figures cannot show, since a network and the labels have a maker in common."""

    def table(self) -> Table:
        """F1 before and after, relation by relation and together."""
        columns = ("F1 before", "F1 after", "gain", "became correct", "became wrong", "labels changed")
        estimates = self.before, self.after, self.gain
        changed = {r: sum(part.get(r, 0) for part in self.changed.values()) for r in self.relations}
        rows = [
            Row(PHRASE[relation], (*(e.f1[k] for e in estimates), *self.flips[relation], changed[relation]))
            for k, relation in enumerate(self.relations)
        ]
        overall = (*(e.micro_f1 for e in estimates), *self.flips["all"], sum(changed.values()))
        rows.append(Row("all (micro-F1)", overall))
        return Table(
            "retrain",
            "Relation networks before and after labels were mended",
            columns,
            tuple(rows),
            f"Percent, on {self.pairs} pairs of {self.frames} frames that neither network has seen, against the labels "
            f"after. Brackets: 95 % bootstrap intervals over {self.cluster}s, paired for the gain.",
            self.caveats,
        )

    def record(self) -> dict[str, Any]:
        """The comparison as JSON."""

        def figures(found: RelationEstimates) -> dict[str, Any]:
            by_relation = {r: found.f1[k].record() for k, r in enumerate(found.relations)}
            return {"f1": by_relation, "micro_f1": found.micro_f1.record(), "macro_f1": found.macro_f1.record()}

        return rounded(
            {
                "held_out": {"pairs": self.pairs, "frames": self.frames, "cluster": self.cluster},
                "before": figures(self.before),
                "after": figures(self.after),
                "gain": figures(self.gain),
                "labels_changed": self.changed,
                "became_right": {"cells": self.flips["all"][0], "listed": list(self.better)},
                "became_wrong": {"cells": self.flips["all"][1], "listed": list(self.worse)},
                "split": self.split,
                "caveats": list(self.caveats),
                "networks": [
                    {"weights_xxh3_128": card["weights_xxh3_128"], "labels": card["labels"], "file": card["file"]}
                    for card in self.cards
                ],
            }
        )


def retrain(
    before: Labels,
    after: Labels,
    out: Path,
    config: RetrainConfig | None = None,
    *,
    progress: Callable[[str, Epoch], None] | None = None,
) -> Retraining:
    """Train on labels before and after, compare, and write the network of the latter.

    Writes `out`, its card beside it (.json), and the comparison (.comparison.json); all of it or nothing.

    `out`: the ONNX file to write. `progress`: called after each epoch with ("before" or "after", the epoch).

    Raises InputError: the labels have no held-out frame in common, cannot be used, or the configuration makes no sense.
    Raises MissingExtra: torch or onnx is not installed.
    """
    config = config or RetrainConfig()
    config.check()
    out = network_path(out)
    require_training()
    vocabulary = VOCABULARIES[config.train.vocabulary]
    was, now = (read_label_data(labels, config.train.features, vocabulary) for labels in (before, after))
    plan = shared_split(was, now, config)
    with file_with_companions(out) as made:
        files = made.parent / "before" / out.name, made
        cards = []
        for labels, file, name in ((before, files[0], "before"), (after, files[1], "after")):
            job = LabelTraining(labels.root, config.train, config.split)
            tell = None if progress is None else lambda epoch, name=name: progress(name, epoch)
            cards.append(train_on_labels(job, file, tell, plan=plan))
        found = compare_networks(
            OnnxScorer(files[0]), OnnxScorer(files[1]), was, now, plan, (cards[0], cards[1]), config.bootstrap
        )
        text = json.dumps(found.record(), indent=1) + "\n"
        made.with_suffix(".comparison.json").write_text(text, encoding="utf-8")
    return found


def shared_split(was: LabelData, now: LabelData, config: RetrainConfig) -> SplitPlan:
    """One split of the frames of both."""
    keys = {frame.key.frame: frame.key for data in (was, now) for frame in data.frames}
    plan = split_frames(sorted(keys.values(), key=lambda k: k.index), config.split, config.train.seed)
    for data, name in ((was, "before"), (now, "after")):
        parts = plan.for_frames([f.key for f in data.frames]).part
        lacking = [PARTS[k] for k in range(len(PARTS)) if not (parts == k).any()]
        require(
            not lacking or (name == "before" and lacking == ["test"]),
            f"the labels {name} have no frames to {''.join(lacking[:1])} on",
            cause="are both of one dataset?",
        )
    return plan


def _rows_of(frames: Sequence[LabelledFrame], data: LabelData) -> list[np.ndarray]:
    known = {(f.key.frame, int(n)): row for f in data.frames for n, row in zip(f.objects, f.rows, strict=True)}
    unknown = np.full(data.frames[0].rows.shape[1], np.nan)
    return [np.stack([known.get((f.key.frame, int(n)), unknown) for n in f.objects]) for f in frames]


def compare_networks(
    before: OnnxScorer,
    after: OnnxScorer,
    was: LabelData,
    now: LabelData,
    plan: SplitPlan,
    cards: tuple[dict[str, Any], dict[str, Any]],
    config: BootstrapConfig | None = None,
    fed_before: LabelData | None = None,
) -> Retraining:
    """Compare two networks on the held-out frames of `now`; see `Retraining`.

    `fed_before` is `now` as the network before is fed it, where that is something else.
    """
    own = plan.for_frames([f.key for f in now.frames])
    test = [now.frames[k] for k in own.indices(TEST)]
    truth = stacked([f.states for f in test])
    rows = _rows_of(test, fed_before or now), [f.rows for f in test]
    p = [stacked([scorer.probabilities(r) for r in fed]) for scorer, fed in zip((before, after), rows, strict=True)]
    scenes = {f.key.scene for f in test}
    names = [f.key.scene if len(scenes) > 1 else f.key.frame for f in test]
    clusters = np.repeat(np.array(names, np.str_), [len(f.rows) * (len(f.rows) - 1) for f in test])
    cells = [cell_outcomes(x, truth) for x in p]
    relations = now.vocabulary
    estimates = [
        relation_estimates(c, clusters, other=o, relations=relations, config=config)
        for c, o in ((cells[0], None), (cells[1], None), (cells[1], cells[0]))
    ]
    known, (old, new) = truth != U, (c.tp | c.tn for c in cells)
    right, wrong = new & ~old & known, old & ~new & known
    flips = {r: (int(right[:, k].sum()), int(wrong[:, k].sum())) for k, r in enumerate(relations)}
    better, worse = (_listed(test, relations, truth, p, chosen) for chosen in (right, wrong))
    return Retraining(
        relations=relations,
        pairs=len(truth),
        frames=len(test),
        before=estimates[0],
        after=estimates[1],
        gain=estimates[2],
        flips={**flips, "all": (int(right.sum()), int(wrong.sum()))},
        changed=_changed(was, now, plan),
        better=better,
        worse=worse,
        split=own.record(),
        cluster="scene" if len(scenes) > 1 else "frame",
        cards=cards,
    )


def _changed(was: LabelData, now: LabelData, plan: SplitPlan) -> dict[str, dict[str, int]]:
    earlier = {f.key.frame: f for f in was.frames}
    parts = plan.for_frames([f.key for f in now.frames]).part
    names = {**dict(enumerate(PARTS)), -1: "dropped"}
    found = {name: dict.fromkeys(now.vocabulary, 0) for name in names.values()}
    for frame, part in zip(now.frames, parts.tolist(), strict=True):
        other = earlier.get(frame.key.frame)
        if other is None:
            continue
        _, i, j = np.intersect1d(frame.objects, other.objects, return_indices=True)
        differ = (frame.states[np.ix_(i, i)] != other.states[np.ix_(j, j)]).sum(axis=(0, 1))
        for relation, count in zip(now.vocabulary, differ.tolist(), strict=True):
            found[names[part]][relation] += count
    return found


def _listed(
    frames: list[LabelledFrame], relations: tuple[str, ...], truth: np.ndarray, p: list[np.ndarray], chosen: np.ndarray
) -> tuple[dict[str, Any], ...]:
    rows, columns = np.nonzero(chosen)
    change = np.abs(p[1][rows, columns] - p[0][rows, columns])
    order = np.argsort(-change, kind="stable")[:SHOWN_CELLS]
    start = np.cumsum([0, *(len(f.rows) * (len(f.rows) - 1) for f in frames)])
    found = []
    for row, column in zip(rows[order].tolist(), columns[order].tolist(), strict=True):
        number = int(np.searchsorted(start, row, side="right") - 1)
        frame = frames[number]
        a, b = divmod(row - int(start[number]), len(frame.rows) - 1)
        found.append(
            {
                "frame": frame.key.frame,
                "a": int(frame.objects[a]),
                # A row of pairs leaves out the object itself.
                "b": int(frame.objects[b + (b >= a)]),
                "relation": relations[column],
                "label": letter(int(truth[row, column])),
                "before": float(p[0][row, column]),
                "after": float(p[1][row, column]),
            }
        )
    return tuple(found)
