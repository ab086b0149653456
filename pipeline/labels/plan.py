"""The plan of a labelling run: what is labelled, how, and in which shards."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Sequence
from dataclasses import asdict, field
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from pipeline.answering.ask import AskConfig
from pipeline.answering.pipeline import Pipeline, open_pipeline
from pipeline.datasets import Dataset, splits
from pipeline.geometry.cleaning import LiftConfig
from pipeline.labels.profiles import RuleProfile, canonical_hash, fingerprint, profile_of
from pipeline.language.naming import normal_form
from pipeline.language.relation_names import PAIRWISE, VOCABULARIES
from pipeline.relations.relations import PROFILE
from pipeline.system.contents import contents_hash, walk
from pipeline.system.detector_setup import with_files
from pipeline.system.errors import InputError, needed, require
from pipeline.system.frozen import dataclass
from pipeline.system.model_files import parse_hub_id
from pipeline.system.remote import is_url
from pipeline.system.safe_files import parse_json, read_bytes
from pipeline.system.version import __version__

if TYPE_CHECKING:
    from pipeline.labels.store import LabelStore

BY_CONTENT, BY_TIME = "content:", ""
"""What a hash of a dataset's files by content begins with; those by time of change have no such mark."""
MOST_FRAMES_A_SHARD = 64
FEWEST_FRAMES_A_SHARD = 4
SHARDS_WANTED = 32
"""Small datasets get small shards, so that workers share them and progress shows."""
CAMERA = ("intrinsics", "depth_scale", "up", "level_at", "depth_model", "poses", "registration")
"""The options that say what the camera is, how it stands, and where depth comes from."""


@dataclass(frozen=True)
class SourceSpec:
    """How a worker opens the dataset and its models: the arguments of `open_pipeline`, as plain values."""

    path: str
    options: dict[str, Any] = field(default_factory=dict)

    def open(self, config: LabelConfig) -> Pipeline:
        """Open the dataset with models; relations are judged by the rules, and so no network is loaded."""
        return open_pipeline(self.path, srm="rule", config=AskConfig(lift=config.lift), **self.options)

    def absolute(self) -> SourceSpec:
        """Source with absolute paths: workers, and later readers of the plan, may stand in another folder."""
        path = Path(self.path)
        return SourceSpec(str(path.absolute()) if path.exists() else self.path, with_files(self.options, _absolute))


def _absolute(path: str | Path) -> str:
    """A path as absolute words; an id on the model hub as it is."""
    return str(parse_hub_id(path) or Path(path).absolute())


@dataclass(frozen=True)
class Shard:
    """A run of frames that is labelled as one."""

    index: int
    """Its index among the shards."""
    first: int
    """Index of its first frame in the dataset."""
    frames: tuple[str, ...]
    key: str
    """Hash of everything its rows depend on: configuration, models, input."""

    @property
    def name(self) -> str:
        """Folder of the shard's files, below `parts/`."""
        return f"{self.index:06d}-{self.key[:16]}"


@dataclass(frozen=True)
class Plan:
    """All shards of a run."""

    spec: SourceSpec
    config: LabelConfig
    frames: tuple[str, ...]
    """All frames of the dataset, in order."""
    models: dict[str, str]
    """Fingerprints of detector and segmenter, of the second opinion, and of what was declared of camera and names."""
    input_hash: str
    """Hash of the dataset's files: see `files_hash`."""
    format: str
    """The dataset's format."""
    exact: bool
    """The objects are the dataset's own annotations."""
    frames_a_shard: int
    version: str = __version__
    """Of this program: shards of two releases do not mix."""

    @property
    def key(self) -> str:
        """Hash of all inputs of a row."""
        return canonical_hash(
            {"config": self.config.hash, "models": self.models, "input": self.input_hash, "version": self.version}
        )

    @property
    def shards(self) -> tuple[Shard, ...]:
        key, size = self.key, self.frames_a_shard
        found = []
        for index, first in enumerate(range(0, len(self.frames), size)):
            frames = self.frames[first : first + size]
            found.append(Shard(index, first, frames, canonical_hash([key, first, frames])))
        return tuple(found)

    def record(self) -> dict[str, Any]:
        """JSON of `plan.json`."""
        return {**asdict(self), "config": self.config.settings, "frames": list(self.frames), "key": self.key}


def make_plan(
    spec: SourceSpec,
    config: LabelConfig,
    *,
    frames_a_shard: int | None = None,
    limit: int | None = None,
    frames_of: Sequence[str] = (),
    out: str | Path | None = None,
    like: str = BY_CONTENT,
) -> Plan:
    """Look at the dataset and lay out the shards; no image is decoded.

    `limit`: only the first so many frames. `frames_of`: only the frames of these splits of the dataset's own, in their
    order. `out`: where the labels go: within the dataset's folder, that folder is not part of the input. `like`: the
    input's hash in the plan that is there already, see `files_hash`.

    Raises InputError: the dataset cannot be opened, has no frames, or nothing finds objects in it.
    """
    require(limit is None or limit >= 1, "the limit must be at least one frame", got=limit)
    require(frames_a_shard is None or frames_a_shard >= 1, "a shard needs at least one frame", got=frames_a_shard)
    source = spec.open(config)
    detector = source.needed_detector()
    frames = (frames_of_splits(source.dataset, frames_of) if frames_of else source.dataset.frame_ids)[:limit]
    require(frames, "the dataset has no frames", path=source.dataset.root)
    odd = next((f for f in frames if any("\ud800" <= c <= "\udfff" for c in f)), None)
    require(odd is None, "the name of a frame is not UTF-8", got=ascii(odd), path=ascii(str(source.dataset.root)))
    if frames_a_shard is None:
        even = -(-len(frames) // SHARDS_WANTED)
        frames_a_shard = min(max(even, FEWEST_FRAMES_A_SHARD), MOST_FRAMES_A_SHARD)
    return Plan(
        spec,
        config,
        tuple(frames),
        {
            "detector": f"{detector.name}: {detector.fingerprint()}",
            "second_opinion": fingerprint(config.second_opinion),
            **({"map": _maps_hash(Path(config.map))} if config.map else {}),
            **_declared(spec.options),
        },
        _input_hash(source, out, like),
        source.dataset.format,
        detector.exact,
        frames_a_shard,
    )


def _maps_hash(folder: Path) -> str:
    require(folder.is_dir(), "no object maps here", expected="what `spatialviz map` wrote", path=folder)
    return contents_hash(folder)


def frames_of_splits(dataset: Dataset, names: Sequence[str]) -> tuple[str, ...]:
    """The frames of the dataset's own splits of these names, each frame once.

    Raises InputError: the dataset has no such split.
    """
    there = splits(dataset)
    absent = next((name for name in names if name not in there), None)
    require(
        absent is None,
        "the dataset has no such split",
        got=absent,
        expected=" | ".join(there) or "no splits at all",
        path=dataset.root,
    )
    return tuple(dict.fromkeys(frame for name in names for frame in there[name]))


def input_changed(plan: Plan, out: str | Path) -> bool:
    """Tell a dataset changed since the plan was made; no model is loaded."""
    source = SourceSpec(plan.spec.path, {n: plan.spec.options.get(n) for n in CAMERA}).open(plan.config)
    return _input_hash(source, out, plan.input_hash) != plan.input_hash


def _input_hash(source: Pipeline, out: str | Path | None, like: str) -> str:
    return files_hash(source.dataset.root, None if out is None or is_url(out) else Path(out).expanduser(), like)


def _declared(options: dict[str, Any]) -> dict[str, str]:
    found = {n: json.dumps(options[n]) for n in CAMERA if options.get(n) is not None}
    if options.get("depth_model") is not None:
        from pipeline.datasets.depth.estimator import open_depth_model

        found["depth_model"] = canonical_hash(open_depth_model(str(options["depth_model"])).fingerprint)
    if options.get("synonyms") is not None:
        found["synonyms"] = hashlib.sha256(read_bytes(Path(options["synonyms"]))).hexdigest()
    return found


def files_hash(root: Path, leave_out: Path | None = None, like: str = BY_CONTENT) -> str:
    """Hash of all files below a folder, or of a file, by relative path and content: see `contents_hash`.

    `like`: a hash to compare with, or only the mark of its kind: without one, as of labels made before, files count by
    size and time of change. Hidden files are left out, and so is the folder `leave_out`.
    """
    if like.startswith(BY_CONTENT):
        return BY_CONTENT + contents_hash(root, leave_out)
    if root.is_file():
        return canonical_hash((root.name, root.stat().st_size, root.stat().st_mtime_ns))
    # A name that is not UTF-8 still counts.
    found = (
        (os.fsencode(name).decode(errors="backslashreplace"), state.st_size, state.st_mtime_ns)
        for name, _, state in walk(root, leave_out)
    )
    return canonical_hash(sorted(found))


def save_plan(plan: Plan, store: LabelStore) -> Plan:
    """Write `plan.json`, or compare with the plan found in the folder; returns the plan that is there.

    Another machine may have written it: of another path to the same files, and so its shards are those that count.

    Raises InputError: the folder holds labels made otherwise: which setting differs.
    """
    from pipeline.labels.store import PLAN_FILE

    if store.read_text(PLAN_FILE) is None:
        store.write_text(PLAN_FILE, json.dumps(plan.record(), indent=1, ensure_ascii=False))
    # Read back also then: another task may have written its own first.
    kept = load_plan(store)
    mine, theirs = _settings(plan), _settings(kept)
    differing = [name.replace("_", " ") for name in {**mine, **theirs} if mine.get(name) != theirs.get(name)]
    require(
        not differing,
        "this folder holds labels made otherwise",
        got="other " + ", ".join(differing[:3]),
        cause="use another folder, or remove this one",
        path=store.where,
    )
    return kept


def _settings(plan: Plan) -> dict[str, Any]:
    """All that the rows depend on, by the names that people know."""
    whole = {"frames": plan.frames, "input_files": plan.input_hash, "release": plan.version, "format": plan.format}
    return {**vars(plan.config), **plan.models, **whole, "exact": plan.exact, "frames_a_shard": plan.frames_a_shard}


def load_plan(store: LabelStore) -> Plan:
    """The plan of a labels folder.

    Raises InputError: there is none, or it is damaged.
    """
    from pipeline.labels.store import PLAN_FILE

    expected = f"a folder with the {PLAN_FILE} of `label`"
    text = needed(store.read_text(PLAN_FILE), "no labels here", expected=expected, path=store.where)
    try:
        record = parse_json(text, store.where)
        config = dict(record["config"])
        config["lift"] = LiftConfig(**config["lift"])
        config["background"] = tuple(config["background"])
        return Plan(
            SourceSpec(**record["spec"]),
            LabelConfig(**config),
            tuple(record["frames"]),
            dict(record["models"]),
            str(record["input_hash"]),
            str(record["format"]),
            bool(record["exact"]),
            int(record["frames_a_shard"]),
            str(record["version"]),
        )
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(f"{PLAN_FILE} is damaged", got=f"{type(error).__name__}: {error}", path=store.where) from error


def part_of(shards: Sequence[Shard], k: int, n: int) -> tuple[Shard, ...]:
    """Shards of task k of n (k from 1): every n-th, so that long scenes are shared evenly.

    Raises InputError: k is not 1..n.
    """
    require(1 <= k <= n, "no such part", got=f"{k}/{n}", expected=f"1/{n} to {n}/{n}")
    return tuple(shards[k - 1 :: n])


TextStyle = Literal["varied", "plain", "semantic-abstraction"]
SENTENCE_KINDS = ("attribute", "ordinal", "extreme", "side", "two-relations", "negation")
"""The sentences that `pipeline.labels.sentence_maker` makes besides the expressions."""
BACKGROUND = (
    "background",
    "wall",
    "floor",
    "ceiling",
    "ground",
    "room",
    "carpet",
    "unknown",
    "unlabeled",
    "otherprop",
    "otherstructure",
    "otherfurniture",
)
"""Classes that surround the others: nobody stands left of the floor."""


@lru_cache(maxsize=8)
def _normal_forms(names: tuple[str, ...]) -> frozenset[str]:
    return frozenset(map(normal_form, names))


@dataclass(frozen=True)
class LabelConfig:
    """How a frame is labelled. Everything here changes the labels, and so their hash."""

    profile: str = PROFILE
    """Rule profile, see `pipeline.labels.profiles`."""
    vocabulary: str = "avd"
    """ "avd", "semantic-abstraction" or "all"."""
    lift: LiftConfig = field(default_factory=LiftConfig)
    min_pixels: int = 200
    min_points: int = 16
    """An object with fewer is not asked for."""
    background: tuple[str, ...] = BACKGROUND
    """Classes that take no part in relations."""
    style: TextStyle = "varied"
    """How expressions are worded."""
    seed: int = 0
    """Of the row hashes, which choose wordings and, in the merge, expressions."""
    second_opinion: str = "trained"
    """ "trained", "none", or the path of a network: see `labels.profiles`. Published geometry is taken as published,
    without one."""
    sentences: tuple[str, ...] = ()
    """Kinds of sentences that are made besides the expressions, of SENTENCE_KINDS."""
    sentences_a_kind: int = 4
    """At most so many of each kind in a frame."""
    map: str = ""
    """Folder of object maps, which say what is one object in several frames; empty for none."""

    def __post_init__(self) -> None:
        unknown = next((k for k in self.sentences if k not in SENTENCE_KINDS), None)
        require(unknown is None, "no such kind of sentence", got=unknown, expected=" | ".join(SENTENCE_KINDS))
        kinds = tuple(k for k in SENTENCE_KINDS if k in self.sentences)
        object.__setattr__(self, "sentences", kinds)
        require(self.sentences_a_kind >= 1, "at least one sentence of a kind", got=self.sentences_a_kind)
        if self.profile != PROFILE:
            object.__setattr__(self, "second_opinion", "none")
        require(
            self.vocabulary in VOCABULARIES,
            "no such vocabulary",
            got=repr(self.vocabulary),
            expected=" | ".join(VOCABULARIES),
        )
        require(self.relations, f"profile {self.profile} judges no relation of the vocabulary {self.vocabulary}")
        require(self.seed >= 0, "a seed must be at least 0", got=self.seed)

    @property
    def rules(self) -> RuleProfile:
        return profile_of(self.profile)

    @property
    def relations(self) -> tuple[str, ...]:
        """Relations of the vocabulary judged by the profile, in the order of PAIRWISE."""
        wanted = VOCABULARIES[self.vocabulary]
        return tuple(r for r in PAIRWISE if r in wanted and r in self.rules.relations)

    def is_background(self, label: str) -> bool:
        return normal_form(label) in _normal_forms(self.background)

    @property
    def settings(self) -> dict[str, Any]:
        """Settings as JSON; sentences, map and completed boxes only if wanted: other labels keep their hash."""
        found = {**asdict(self), "background": list(self.background), "sentences": list(self.sentences)}
        if self.lift.boxes == "seen":
            del found["lift"]["boxes"]
        wanted = {"sentences": self.sentences, "sentences_a_kind": self.sentences, "map": self.map}
        return {name: value for name, value in found.items() if wanted.get(name, True)}

    def record(self) -> dict[str, Any]:
        """Its settings, with the hash of the profile's thresholds."""
        return {**self.settings, "profile_hash": self.rules.hash}

    @property
    def hash(self) -> str:
        """sha256 of `record`."""
        return canonical_hash(self.record())
