"""The commands that show, correct and review labels."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import OmitArgPrefixes, arg

from spatialviz.options import (
    DatasetOptions,
    Flag,
    JournalOptions,
    NewFolder,
    OneFrameArg,
    OnLabels,
    PairFeatures,
    SecondDetectorOptions,
)


@dataclass(frozen=True)
class Show(OnLabels):
    """Show the labels of a frame's objects, of one object or of a pair, field by field, with who or what made each."""

    frame: OneFrameArg
    object: int | None = None
    """Only this object, rejected ones included."""
    pair: str | None = None
    """A,B: every relation of "A RELATION B"."""
    journal: OmitArgPrefixes[JournalOptions] = JournalOptions()
    source: OmitArgPrefixes[DatasetOptions] = DatasetOptions()
    support: Flag = False
    """With --object: what it stands on, found in the depth around it."""


@dataclass(frozen=True)
class ShowJournal(OnLabels):
    """List what people corrected in labels; exit status 1 where there are none, 2 without a journal.

    A journal is checked in full whenever it is opened, and refused where it is damaged. To go on with one that is:
    `--check` tells what is intact, `--recover NEW.sqlite` writes that into a new journal, which takes the place of the
    old one or is named by `--journal`.
    """

    journal: OmitArgPrefixes[JournalOptions] = JournalOptions()
    author: str | None = None
    """Only this person's."""
    kind: Literal["object", "relation", "expression", "frame", "review"] | None = None
    """Only of entities of this kind."""
    frame: str | None = None
    """Only of this frame: its id, or its index."""
    key: str | None = None
    """Only of this entity: an object's number, a pair "3,5", the id of an expression."""
    last: int | None = None
    """Only the newest so many."""
    check: Flag = False
    """Check the journal, and say which of its events are as they were saved; exit status 1 where not all are."""
    backup: Path | None = None
    """Write a copy with all that is saved, also while others save, and check it."""
    recover: Path | None = None
    """Write what is intact of a damaged journal into a new one; the damaged one is not changed."""


@dataclass(frozen=True)
class Correct(OnLabels):
    """Apply a file of edits to labels, all of them or none; exit status 1 where somebody else has been there."""

    edits: Path
    """JSON: a list such as [{"edit": "relation", "frame": "000001/000000", "a": 2, "b": 5, "relation": "left",
    "to": "T", "reason": "..."}]; edits are class, status, judge, settle, mask, bbox, box, new, merge, split, relation,
    text, answers, ambiguous, mark, note, and value: any one field as the journal keeps it (kind, key, field, to).
    Pixels of mask and new are a run-length code, or "polygon": [[x, y], ...], "rectangle": [x0, y0, x1, y1], "strokes":
    [{"points", "radius"}], "seeds": [[x, y], ...]; with "mode": add, remove, replace."""
    author: str
    """Who says so."""
    again: str | None = None
    """The group that a try named which could not be saved: what was saved after all is not saved twice."""
    journal: OmitArgPrefixes[JournalOptions] = JournalOptions()
    pictures: OmitArgPrefixes[DatasetOptions] = DatasetOptions()


@dataclass(frozen=True)
class OfPerson(OnLabels):
    """What undo and redo are of."""

    author: str
    """Whose."""
    group: str | None = None
    """This action, and not the newest; of redo, the undo that took it back."""
    again: str | None = None
    """The group that a try named which could not be saved: what was done after all is not followed by the next."""
    journal: OmitArgPrefixes[JournalOptions] = JournalOptions()


@dataclass(frozen=True)
class Undo(OfPerson):
    """Take back a person's newest action; exit status 1 where there is none, or somebody built upon it."""


@dataclass(frozen=True)
class Redo(OfPerson):
    """Bring back what a person took back last; exit status as of undo."""


@dataclass(frozen=True)
class Effective(OnLabels):
    """Write labels with all corrections applied, as an ordinary labels folder with provenance."""

    out: NewFolder
    source: OmitArgPrefixes[DatasetOptions] = DatasetOptions()
    journal: OmitArgPrefixes[JournalOptions] = JournalOptions()
    show: Annotated[int, arg(metavar="N")] = 20
    """Events that do not apply, shown of all."""


@dataclass(frozen=True)
class Review(OnLabels):
    """Rank labels by how probably they are wrong, each with the reasons; tell how far a review of them has come."""

    limit: int = 50
    """Show so many; --out holds all."""
    out: Path | None = None
    """Write the whole queue as Parquet: with what is settled."""
    queue: Path | None = None
    """Read a queue that --out wrote, and do not build it anew."""
    all: Flag = False
    """Show what is settled too."""
    author: str | None = None
    """What is left for this reviewer, without what others said."""
    overlap: float = 0.0
    """With --author: ask again this share of what others have settled, so that agreement can be measured."""
    second_opinion_of: str | None = None
    """With --author: only what this person has judged."""
    agreement: Flag = False
    """Print how far each two reviewers agree (Cohen's kappa), and on what they differ; exit status 1 where no two have
    judged the same item."""
    progress: Flag = False
    """Print how far the review has come."""
    journal: OmitArgPrefixes[JournalOptions] = JournalOptions()
    other: Path | None = None
    """Labels of the same dataset by another detector or run: what they say otherwise counts too."""
    second: OmitArgPrefixes[SecondDetectorOptions] = SecondDetectorOptions()
    source: OmitArgPrefixes[DatasetOptions] = DatasetOptions()
    networks: bool = True
    """Ask networks that have not learnt from a label (confident learning)."""
    linter: bool = True
    """Count what `spatialviz check` finds."""
    features: PairFeatures = "rel14"
    folds: int = 5
    """Each network learns from all scenes but those of one fold, or from all blocks of camera positions but one."""
    passes: int = 3
    """Training again without the labels that were found wrong, so often in all. 1 is three times as fast, and worse."""
    seed: int = 0
    """Of folds and networks."""
