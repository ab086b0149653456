"""What made labels: their masks, their boxes and their relations, as far as the manifest tells."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import PurePath
from typing import Any

from pipeline.labels.profiles import NONE, canonical_hash
from pipeline.labels.schema import Manifest
from pipeline.system.frozen import dataclass

ANNOTATIONS = "annotations"
RECORDED = "recorded"
OF_ANNOTATIONS = (ANNOTATIONS, "simulated", "planted")
"""Detectors that are made of the dataset's own annotations."""
SHOWN_HASH = 12

_HASHES = {
    "yolo-seg": (1, 2), "grounding-dino": (1, 2), "owlv2": (1, 2), "owlvit": (1, 2), "detic": (2, 3), "boxes": (3, 4),
    "sam": (2, 4), "sam2": (2, 4), "efficientsam": (2, 4),
}  # fmt: skip
"""Where the hashes of model files stand among the parts of a fingerprint; the others are thresholds and names."""


@dataclass(frozen=True)
class Model:
    """A detector or a segmenter, told apart by its model and not by its thresholds."""

    name: str
    """As on the command line."""
    content: str | None = None
    """Hash of its files; of one without files that are known, what its fingerprint says; None where that is nothing."""

    def __str__(self) -> str:
        if self.content is None:
            return self.name
        if self.name == RECORDED:
            # Where somebody keeps it, and when it was written, is nobody's business.
            return f"{self.name} ({PurePath(self.content.rpartition(':')[0]).name})"
        return f"{self.name} ({'model ' if self.name in _HASHES else ''}{self.content[:SHOWN_HASH]})"


@dataclass(frozen=True)
class MaskMakers:
    """What finds objects and their masks."""

    detectors: tuple[Model, ...]
    """Several where they are fused."""
    segmenters: tuple[Model, ...] = ()
    """What gives masks to boxes that have none."""

    def __str__(self) -> str:
        found = " & ".join(map(str, self.detectors))
        masks = " & ".join(map(str, self.segmenters))
        return found + (f", boxes without a mask by {masks}" if masks else "")

    def record(self) -> dict[str, Any]:
        """Makers as JSON: `makers` of a labels' manifest and of a run."""
        return {"detectors": [asdict(m) for m in self.detectors], "segmenters": [asdict(m) for m in self.segmenters]}


def mask_makers(text: str) -> MaskMakers | None:
    """Makers of masks from a manifest's "name: fingerprint" of a detector; None if empty.

    `text`: `models["detector"]` of labels, `detector` of a run; see `Detector.fingerprint`.
    """
    name, colon, fingerprint = text.partition(": ")
    if not colon or not name:
        return None
    segmenters: tuple[Model, ...] = ()
    if "+" in name:
        name, _, segmenter = name.rpartition("+")
        fingerprint, _, behind = fingerprint.rpartition("|")
        segmenters = (_model(segmenter, behind.removeprefix("masks:")),)
    members = [fingerprint]
    if fingerprint.startswith("ensemble:"):
        members = fingerprint.split(":", 2)[-1].split("&")
        name = ""
    found = [_played_back(name or member.partition(":")[0], member) for member in members]
    return MaskMakers(
        tuple(dict.fromkeys(m for one in found for m in one.detectors)),
        tuple(dict.fromkeys((*(m for one in found for m in one.segmenters), *segmenters))),
    )


def _played_back(name: str, fingerprint: str) -> MaskMakers:
    recorded = mask_makers(fingerprint.partition("<")[2]) if name == RECORDED else None
    return recorded or MaskMakers((_model(name, fingerprint),))


def _model(name: str, fingerprint: str) -> Model:
    if name == ANNOTATIONS:
        return Model(name)
    if name == RECORDED:
        # Name and content, of labels made before path and time of change; what stands behind them is a threshold.
        return Model(name, fingerprint.partition(":")[2].rpartition(":")[0] or None)
    parts = fingerprint.split(":")
    if name in _HASHES and parts[0] == name:
        return Model(name, ":".join(parts[slice(*_HASHES[name])]) or None)
    return Model(name, fingerprint.removeprefix(f"{name}:") or None)


BOX_FITS = {
    "upright": "upright, sides along the outline",
    "gravity": "upright, turned by PCA (the fit before 0.2)",
    "pca": "turned freely by PCA (the paper's)",
    "pca-raw": "turned freely by PCA, axes in its order",
}
"""Fits of 3D boxes (`estimator` of an object, `lift.box` of settings) in words."""


@dataclass(frozen=True)
class Decided:
    """How much of labels people decided: set, accepted or rejected it."""

    objects: tuple[int, int]
    relations: tuple[int, int]
    expressions: tuple[int, int]
    """How many of how many; of relations the cells, one for each pair and relation."""


@dataclass(frozen=True)
class Makers:
    """What made labels."""

    masks: MaskMakers | None
    """None where it is not known."""
    boxes: str
    """Release and hash of the settings by which boxes and extents were lifted from masks and depth."""
    rule: str | None
    rule_hash: str | None
    """The profile that judged relations."""
    second_opinion: str | None
    """Hash of the network that had a vote, "none", or None where it is not known."""
    second_opinion_name: str | None
    """What it was called: "trained", or a path."""
    corrected: bool = False
    """Whether people's corrections are in the labels."""
    decided: Decided | None = None
    """What people decided; None where nothing, or where it was not counted."""
    fit: str = "unknown fit"
    """That of the boxes, in words."""

    @property
    def annotated(self) -> bool:
        """Tell masks from the dataset's own annotations."""
        return self.masks is not None and self.masks.detectors == (Model(ANNOTATIONS),)

    def lines(self) -> dict[str, str]:
        """Makers of masks, boxes and relations, and people's share, in words."""
        masks = "unknown" if self.masks is None else str(self.masks)
        if self.annotated:
            masks = masks.replace(ANNOTATIONS, "the dataset's annotations", 1)
        opinion = {NONE: "no second opinion", None: "whether a network had a vote is unknown"}.get(
            self.second_opinion,
            f"second opinion {self.second_opinion_name or ''} ({(self.second_opinion or '')[:SHOWN_HASH]})",
        )
        people = "how much was not counted" if self.corrected else "nothing"
        if self.decided is not None:
            people = ", ".join(f"{n} of {of} {what}" for what, (n, of) in asdict(self.decided).items())
        return {
            "masks": masks,
            "boxes": f"{self.fit}, lifted from these masks and the depth, settings {self.boxes}",
            "relations": f"rule {self.rule or 'unknown'} ({(self.rule_hash or '')[:SHOWN_HASH]}), {opinion}",
            "decided by people": people,
        }

    def record(self) -> dict[str, Any]:
        """Makers as JSON: `makers` of a labels' manifest and of a run."""
        return {
            "masks": None if self.masks is None else self.masks.record(),
            "boxes": {"lifted": self.boxes},
            "relations": {
                "rule": self.rule,
                "rule_hash": self.rule_hash,
                "second_opinion": self.second_opinion,
                "second_opinion_name": self.second_opinion_name,
            },
            "decided": None if self.decided is None else {k: list(v) for k, v in asdict(self.decided).items()},
        }


def makers_of(manifest: Manifest) -> Makers:
    """Makers of the labels of a manifest of any release; None if unknown."""
    config, made = manifest.config, manifest.corrections
    lift = config.get("lift")
    counted = (made or {}).get("decided")
    name = config.get("second_opinion")
    return Makers(
        mask_makers(str(manifest.models.get("detector", ""))),
        f"{manifest.version}:{canonical_hash(lift)[:SHOWN_HASH]}" if lift else manifest.version,
        str(manifest.profile["name"]) if manifest.profile.get("name") else None,
        manifest.profile_hash or None,
        manifest.models.get("second_opinion", NONE if name == NONE else None),
        None if name is None else str(name),
        made is not None,
        None if counted is None else Decided(**{k: (int(n), int(of)) for k, (n, of) in counted.items()}),
        BOX_FITS.get(str((lift or {}).get("box")), Makers.fit),
    )
