"""The relation scorers that are measured beside each other, and what each of them is measured by."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from pipeline.language.relation_names import PAIRWISE
from pipeline.relations import RULE, TRAINED, RelationScorer, make_scorer, shipped_network
from pipeline.relations.contract import TrainedOn
from pipeline.relations.features import geometry_of
from pipeline.system.errors import InputError

if TYPE_CHECKING:
    from pipeline.labels.reading import Labels

PAPER_NAMES = {
    "geom2d8": "2D-Geom",
    "paper30": "3D-Geom",
    "canon30": "3D-Geom, canonical",
    "rel14": "relative extents",
    "rel26": "relative extents, places and cuts",
}
Geometry = Literal["lifted", "stored"]


@dataclass(frozen=True)
class RelationSpec:
    """How relations are measured alone, as plain values that a process can be given.

    Attributes
    ----------
    others : tuple of str
        Relation scorers beside the run's own: "trained", "rule", or paths of networks.
    vectors : str or None
        Text vectors for the language networks among all of them.
    geometry : str or None
        "lifted": the labelled objects as the dataset's annotations and depth give them now. "stored": their
        boxes and extents as the labels have them. By default lifted, where the labels were made of annotations.
    frames : int or None
        Only so many frames, spread evenly over those with labelled pairs.
    pairs : str
        "all", or "held-out": without the frames that any of the networks was trained or calibrated on.
    vlm_pairs : int
        How many pairs a vision-language model is asked about, drawn at random.
    seed : int
        Of that draw.
    """

    others: tuple[str, ...] = ()
    vectors: str | None = None
    geometry: Geometry | None = None
    frames: int | None = None
    pairs: Literal["all", "held-out"] = "all"
    vlm_pairs: int = 200
    seed: int = 0

    def __post_init__(self) -> None:
        for name, least in (("frames", 1), ("vlm_pairs", 1), ("seed", 0)):
            value = getattr(self, name)
            if value is not None and value < least:
                raise InputError(f"the number of {name.replace('_', ' ')}", got=value, expected=f"at least {least}")


@dataclass(frozen=True, eq=False)
class RelationSystem:
    """A relation scorer as a row of the tables.

    Attributes
    ----------
    name : str
        Unlike that of any other in the run; its name in the records.
    title : str
        What the tables call it.
    scorer : RelationScorer
    relations : tuple of str
        What it is measured on: the relations it judges itself, as far as they were labelled.
    unlabelled : tuple of str
        Those it judges which were not labelled.
    prior : tuple of float
        Of a softmax network, in the order of its vocabulary; else empty.
    trained_on : TrainedOn or None
    recorded : bool
        Whether it is known what it learnt from: False for networks of labels that do not say so.
    """

    name: str
    title: str
    scorer: RelationScorer
    relations: tuple[str, ...]
    unlabelled: tuple[str, ...] = ()
    prior: tuple[float, ...] = ()
    trained_on: TrainedOn | None = None
    recorded: bool = True

    @property
    def single_label(self) -> bool:
        """Whether it says which one relation fits best, and all it can say was labelled."""
        return bool(self.prior) and not self.unlabelled


def geometry_of_labels(spec: RelationSpec, labels: Labels) -> Geometry:
    """The geometry that is asked for, or the one that fits the labels.

    Raises
    ------
    InputError
        Objects are to be lifted from annotations, and the labels are of a detector.
    """
    detector = labels.manifest.models.get("detector", "")
    annotated = detector.startswith("annotations")
    if spec.geometry == "lifted" and not annotated:
        raise InputError(
            "the labelled objects are not the dataset's annotations: they cannot be lifted again",
            got=detector or "no detector in the manifest",
            expected="--relation-boxes stored",
            path=labels.root,
        )
    # Objects that people changed are no longer the dataset's annotations.
    corrected = bool((labels.manifest.corrections or {}).get("objects"))
    return spec.geometry or ("lifted" if annotated and not corrected else "stored")


def open_systems(options: Mapping[str, Any], spec: RelationSpec, labels: Labels) -> tuple[RelationSystem, ...]:
    """The run's own relation scorer, then the others.

    Parameters
    ----------
    options : mapping
        Arguments of `jobs.open_source`: srm, vectors.
    spec : RelationSpec
    labels : Labels

    Raises
    ------
    InputError
        A scorer that cannot be opened, or one that judges nothing of what was labelled.
    """
    vectors = spec.vectors if spec.vectors is not None else options.get("vectors")
    found: dict[str, RelationSystem] = {}
    seen: set[str] = set()
    wanted = False
    for which in (str(options.get("srm", TRAINED)), *spec.others):
        key = which if which in (RULE, TRAINED) else str(Path(which).resolve())
        if key in seen:
            continue
        seen.add(key)
        name = which if which in (RULE, TRAINED) else Path(which).stem
        # Networks of one name in several folders are told apart by these.
        if name in found:
            name = "/".join(Path(which).resolve().with_suffix("").parts[-2:])
        while name in found:
            name += "'"
        uses = vectors is not None and uses_language(which)
        wanted = wanted or uses
        system = _system(name, which, make_scorer(which, Path(str(vectors)) if uses else None), labels)
        found[system.name] = system
    if vectors is not None and not wanted:
        raise InputError("none of the relation scorers uses class names: leave out --vectors", path=vectors)
    return tuple(found.values())


def _system(name: str, which: str, scorer: RelationScorer, labels: Labels) -> RelationSystem:
    from pipeline.relations.model import OnnxScorer

    labelled = labels.relation_names
    if not isinstance(scorer, OnnxScorer):
        return RelationSystem(name, name, scorer, tuple(labelled))
    contract = scorer.contract
    kept = tuple(r for r in PAIRWISE if r in contract.vocabulary and r in labelled)
    if not kept:
        raise InputError(
            f"the relation network {name} judges none of the relations that were labelled",
            got=", ".join(contract.vocabulary),
            expected=", ".join(labelled),
            path=labels.root,
        )
    language = "+Lng" if contract.language is not None else ""
    kind = PAPER_NAMES.get(geometry_of(contract.features), contract.features) + language
    missing = tuple(r for r in contract.vocabulary if r not in labelled)
    known = contract.trained_on is not None or which == TRAINED or _of_rooms(Path(which))
    return RelationSystem(
        name, f"{name}, {kind}", scorer, kept, missing, contract.prior, contract.trained_on, recorded=known
    )


def uses_language(which: str) -> bool:
    """Whether a relation scorer is given class names; InputError where it cannot be opened."""
    from pipeline.relations.contract import Contract
    from pipeline.system.onnx_session import metadata, open_session

    if which == RULE:
        return False
    path = shipped_network() if which == TRAINED else Path(which)
    if not path.is_file():
        return False  # `make_scorer` says what is wrong.
    return Contract.read(metadata(open_session(path, threads=1)), path).language is not None


def _of_rooms(path: Path) -> bool:
    """Whether the card beside a network says that it was trained on rendered rooms."""
    try:
        return "rooms" in json.loads(path.with_suffix(".json").read_text(encoding="utf-8"))
    except (OSError, ValueError, TypeError):
        return False
