"""The commands that make, check and carry labels."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from tyro.conf import OmitArgPrefixes, Positional

from spatialviz.options import (
    CPUS,
    Box,
    DatasetArg,
    DatasetOptions,
    Flag,
    JournalOptions,
    LabelledOptions,
    LabelsArg,
    NewFolder,
    OnLabels,
    Output,
    Overwrite,
    Workers,
)


@dataclass(frozen=True)
class Selection:
    """Which of all candidate expressions are kept."""

    expressions: int | None = None
    """At most so many, level over relations and classes. Default: as many as the other rules allow."""
    per_frame: int = 40
    """At most so many of one frame."""
    balance: float = 3.0
    """No relation has more than so many times the expressions of the rarest one; 0 for no such limit."""
    selection_seed: int = 0
    """Another seed chooses others."""
    keep_vague: Flag = False
    """Keep sentences that every object of the target's class answers."""


@dataclass(frozen=True)
class Label(Output):
    """Label a dataset: objects, every relation between them, and sentences that are true of them."""

    dataset: DatasetArg
    out: str
    """Folder for the labels, or a URL that fsspec knows; what is at a URL is then merged with `merge --to`."""
    source: OmitArgPrefixes[LabelledOptions] = LabelledOptions()
    selection: OmitArgPrefixes[Selection] = Selection()
    vocabulary: Literal["avd", "semantic-abstraction", "all"] = "avd"
    """Which relations."""
    profile: Literal["viewer-cone-v1", "semantic-abstraction-published", "given"] = "viewer-cone-v1"
    """The rules that decide them; given: no rule of ours, what the dataset's own expressions say."""
    second_opinion: str = "trained"
    """trained | none | an ONNX file: a network that makes labels undecided where it does not agree."""
    style: Literal["varied", "plain", "semantic-abstraction"] = "varied"
    """How sentences are worded."""
    box: Box = "gravity"
    seed: int = 0
    """The same seed gives the same labels."""
    engine: Literal["local", "ray"] = "local"
    """Processes of this machine, or a Ray cluster (extra: cluster)."""
    workers: Workers = CPUS
    gpus_a_detector: float = 0.0
    """Share of a GPU for each detector of the engine ray."""
    shard: str | None = None
    """k/N: only this task of N that share the folder, for arrays of jobs; then run `merge`."""
    resume: Flag = False
    """Go on in a folder where a run was stopped."""
    limit: int | None = None
    """Only the first so many frames."""
    frames_of: tuple[str, ...] = ()
    """Only the frames of these splits of the dataset's own, such as vool/train."""


@dataclass(frozen=True)
class Merge(Output):
    """Merge the shards of `label --shard`, or select expressions anew."""

    labels: Positional[str]
    """Labels folder, or URL."""
    to: Path | None = None
    """Where the merged tables go. Default: the labels folder."""
    selection: OmitArgPrefixes[Selection] = Selection()


@dataclass(frozen=True)
class Check(OnLabels):
    """Say what is wrong with labels; exit status 1 where errors stand."""

    report: Path | None = None
    """Folder for statistics as pictures and a page."""
    rules: tuple[str, ...] = ()
    """Only these rules, or groups of them such as "expression"."""
    show: int = 20
    """Findings shown of each rule."""


@dataclass(frozen=True)
class Export:
    """Write labels in another format, with where each value comes from."""

    labels: LabelsArg
    out: NewFolder
    format: str
    """jsonl | coco | kitti (boxes only) | vqa (conversations for tuning a vision-language model) | parquet (Hugging
    Face's layout), or the name that a plugin gives its own."""
    images: Literal["none", "copy"] = "none"
    """copy: write the colour images beside the labels too."""
    dataset: str | None = None
    """Where the dataset is now, for its images, for corrected masks and boxes, and for the depth that vqa measures.
    Default: where it was labelled."""
    corrected: Flag = False
    """Apply the journal first, as `effective` does."""
    journal: OmitArgPrefixes[JournalOptions] = JournalOptions()
    overwrite: Overwrite = False
    licence: str | None = None
    """The labels' licence, for the card of parquet. Default: said to be unknown."""


@dataclass(frozen=True)
class Import(OnLabels):
    """Take over corrections made elsewhere, in a COCO or JSONL export of these labels: all of them, or none.

    What differs between the file and what was exported becomes edits in the journal. A value that was corrected in
    the journal since is never overwritten: it is told, and nothing is saved (exit status 1). Nor is anything saved
    where the file has problems (exit status 2).
    """

    file: Positional[Path]
    """instances.json, refs.json or relations.json; objects.jsonl, relations.jsonl, expressions.jsonl, frames.jsonl; or
    the folder of them."""
    author: str
    """Who made the corrections."""
    format: Literal["coco", "jsonl"] | None = None
    """Default: by the file's name."""
    base: str | None = None
    """What the file was exported from, where it does not say so itself any more: the folder of that export, or "now"
    where nobody has corrected anything since."""
    deleted: Literal["keep", "reject"] = "keep"
    """reject: an object that the file lacks, in a picture or frame that it has, is rejected."""
    crowds: Flag = False
    """New COCO annotations with iscrowd 1 are objects too."""
    outline: float = 1.5
    """A polygon that nowhere lies farther than so many pixels from the mask that was exported is that mask."""
    skip_conflicts: Flag = False
    """Save what does not contradict later corrections, instead of nothing."""
    reason: str = ""
    """Kept with each correction. Default: the file's name."""
    source: OmitArgPrefixes[DatasetOptions] = DatasetOptions()
    journal: OmitArgPrefixes[JournalOptions] = JournalOptions()
    dry_run: Flag = False
    """Save nothing; say what would be done."""
    show: int = 20
    """Lines shown of each kind."""
