"""The commands on corrections: journal, correct, undo, redo, effective."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import OmitArgPrefixes, Positional, arg

from pipeline.system.errors import InputError
from spatialviz.exits import FINE, NO
from spatialviz.options import print_json
from spatialviz.source_options import CameraOptions

if TYPE_CHECKING:
    from pipeline.corrections.journal.events import Conflict, Saved
    from pipeline.corrections.journal.journal import Journal
    from pipeline.datasets import Dataset
    from pipeline.labels.reading import Labels


@dataclass(frozen=True)
class JournalOptions:
    """Which journal."""

    journal: str | None = None
    """Path, or postgresql://user@host/database for a team. Default: journal.sqlite beside the labels."""
    project: str | None = None
    """Whose corrections, where several datasets share a database. Default: the name of the dataset's folder."""

    def open(self, labels: Labels, *, must_exist: bool = False) -> Journal:
        from pipeline.corrections.journal.journal import journal_of

        opened = journal_of(labels, self.journal, project=self.project, must_exist=must_exist)
        for warning in opened.warnings:
            print(f"spatialviz: {warning}", file=sys.stderr)
        return opened


@dataclass(frozen=True)
class DatasetOptions(CameraOptions):
    """Where the pictures are, for corrections of masks and boxes."""

    dataset: str | None = None
    """Dataset folder, or "demo". Default: where the labels say it was, if it is still there."""

    def open(self, labels: Labels) -> Dataset | None:
        from pipeline.labels.pictures import labelled_dataset

        try:
            return labelled_dataset(labels.manifest, self.dataset, **self.camera())
        except InputError as error:
            if self.dataset is not None:
                raise
            print(f"spatialviz: without the dataset ({error}); --dataset says where it is", file=sys.stderr)
            return None


@dataclass(frozen=True)
class ShowJournal:
    """List what people corrected in labels; exit status 1 where there are none, 2 without a journal.

    A journal is checked in full whenever it is opened, and refused where it is damaged. To go on with one that is:
    `--check` tells what is intact, `--recover NEW.sqlite` writes that into a new journal, which takes the place of the
    old one or is named by `--journal`.
    """

    labels: Positional[Path]
    """Labels folder."""
    journal: OmitArgPrefixes[JournalOptions] = JournalOptions()
    author: str | None = None
    """Only this person's."""
    kind: Literal["object", "relation", "expression", "frame", "review"] | None = None
    """Only of entities of this kind."""
    frame: str | None = None
    """Only of this frame."""
    key: str | None = None
    """Only of this entity: an object's number, a pair "3,5", the id of an expression."""
    last: int | None = None
    """Only the newest so many."""
    check: bool = False
    """Check the journal, and say which of its events are as they were saved; exit status 1 where not all are."""
    backup: Path | None = None
    """Write a copy with all that is saved, also while others save, and check it."""
    recover: Path | None = None
    """Write what is intact of a damaged journal into a new one; the damaged one is not changed."""
    json: bool = False
    """Print one JSON object for each event; of the check, the copy or the new journal, one."""

    def run(self) -> int:
        from pipeline.corrections.journal.events import event_record
        from pipeline.labels.reading import open_labels
        from spatialviz.printing_journal import print_events

        whole = [self.check, self.backup is not None, self.recover is not None]
        if any(whole):
            chosen = any(v is not None for v in (self.author, self.kind, self.frame, self.key, self.last))
            if sum(whole) > 1 or chosen:
                raise InputError("--check, --backup and --recover are of the whole journal, and one at a time")
            return self._as_a_whole()
        if self.last is not None and self.last < 1:
            raise InputError("--last must be at least 1", got=self.last)
        labels = open_labels(self.labels)
        with self.journal.open(labels, must_exist=True) as journal:
            events = journal.events(
                author=self.author, kind=self.kind, frame=self.frame, key=self.key, last=self.last
            )
        if self.json:
            for event in events:
                print_json(event_record(event))
        else:
            print_events(events)
        return FINE if events else NO

    def _as_a_whole(self) -> int:
        from pipeline.corrections.journal import rescue
        from pipeline.corrections.journal.journal import JOURNAL_FILE
        from pipeline.corrections.journal.rescue import examined_record, written_record
        from pipeline.labels.reading import open_labels
        from spatialviz.printing_journal import print_examined, print_written

        where = self.journal.journal or open_labels(self.labels).root / JOURNAL_FILE
        if self.check:
            found = rescue.check_journal(where).known()
            print_json(examined_record(found)) if self.json else print_examined(found)
            return NO if found.damage else FINE
        if self.backup is not None:
            made = found = rescue.back_up(where, self.backup)
        else:
            assert self.recover is not None
            found, made = rescue.recover(where, self.recover)
        print_json(written_record(found, made)) if self.json else print_written(found, made)
        return FINE


@dataclass(frozen=True)
class Correct:
    """Apply a file of edits to labels, all of them or none; exit status 1 where somebody else has been there."""

    labels: Positional[Path]
    """Labels folder."""
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
    json: bool = False
    """Print one JSON object."""

    def run(self) -> int:
        from pipeline.corrections.journal.batch import apply_actions, needs_pictures, read_actions
        from pipeline.corrections.journal.effective import Corrector
        from pipeline.labels.reading import open_labels

        labels = open_labels(self.labels)
        actions = read_actions(self.edits)
        dataset = self.pictures.open(labels) if needs_pictures(actions) else None
        with self.journal.open(labels) as journal, _told_how_to_try_again():
            done = apply_actions(Corrector(labels, dataset), journal, actions, self.author, again=self.again)
        return _told(done, "saved", self.json)


@dataclass(frozen=True)
class _OfPerson:
    """What undo and redo are of."""

    labels: Positional[Path]
    """Labels folder."""
    author: str
    """Whose."""
    group: str | None = None
    """This action, and not the newest; of redo, the undo that took it back."""
    again: str | None = None
    """The group that a try named which could not be saved: what was done after all is not followed by the next."""
    journal: OmitArgPrefixes[JournalOptions] = JournalOptions()
    json: bool = False
    """Print one JSON object."""

    def _take(self, way: Callable[..., Saved | Conflict | None], verb: str) -> int:
        from pipeline.labels.reading import open_labels

        with self.journal.open(open_labels(self.labels), must_exist=True) as journal, _told_how_to_try_again():
            return _told(way(journal, self.author, group=self.group, again=self.again), verb, self.json)


@dataclass(frozen=True)
class Undo(_OfPerson):
    """Take back a person's newest action; exit status 1 where there is none, or somebody built upon it."""

    def run(self) -> int:
        from pipeline.corrections.journal.undo import undo

        return self._take(undo, "taken back")


@dataclass(frozen=True)
class Redo(_OfPerson):
    """Bring back what a person took back last; exit status as of undo."""

    def run(self) -> int:
        from pipeline.corrections.journal.undo import redo

        return self._take(redo, "brought back")


@dataclass(frozen=True)
class Effective:
    """Write labels with all corrections applied, as an ordinary labels folder with provenance."""

    labels: Positional[Path]
    """Labels folder."""
    out: Path
    """Folder to write; it must not exist, or be empty."""
    source: OmitArgPrefixes[DatasetOptions] = DatasetOptions()
    journal: OmitArgPrefixes[JournalOptions] = JournalOptions()
    show: Annotated[int, arg(metavar="N")] = 20
    """Events that do not apply, shown of all."""
    json: bool = False
    """Print the manifest's part on corrections."""

    def run(self) -> int:
        from pipeline.corrections.journal.materialise import materialise
        from pipeline.labels.reading import open_labels
        from spatialviz.printing_journal import print_effective

        labels = open_labels(self.labels)
        with self.journal.open(labels, must_exist=True) as journal:
            manifest, found = materialise(labels, journal, self.out, dataset=self.source.open(labels))
        if self.json:
            print_json(manifest.corrections or {})
        else:
            print_effective(found, self.out, self.show)
        return FINE


@contextmanager
def _told_how_to_try_again() -> Iterator[None]:
    """A database that could not answer may have saved all the same: the next try says which one it repeats."""
    from pipeline.corrections.journal.events import NotSaved

    try:
        yield
    except NotSaved as error:
        print(f"spatialviz: to try this once more, and not twice, add --again {error.group}", file=sys.stderr)
        raise


def _told(done: Saved | Conflict | None, verb: str, json: bool) -> int:
    from pipeline.corrections.journal.events import outcome_record
    from spatialviz.printing_journal import print_outcome

    if json:
        print_json(outcome_record(done))
    else:
        print_outcome(done, verb)
    return FINE if done is not None and outcome_record(done)["saved"] else NO
