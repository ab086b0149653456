"""Importing corrections made elsewhere: all of a file's, as one action in the journal, or none."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from pipeline.corrections.journal.events import Conflict, Edit, Saved
from pipeline.corrections.journal.field_refs import LONGEST_NAME, plain_text
from pipeline.corrections.journal.incoming.claims import MOST_PROBLEMS, Claims, TooManyProblems
from pipeline.corrections.journal.incoming.coco_file import CocoOptions, load_coco, read_instances
from pipeline.corrections.journal.incoming.coco_refs import annotated, read_refs, read_relations
from pipeline.corrections.journal.incoming.jsonl_file import read_lines
from pipeline.corrections.journal.incoming.states import States
from pipeline.corrections.journal.incoming.three_way import Contradiction, settle
from pipeline.corrections.journal.journal import Journal
from pipeline.corrections.journal.records import event_record
from pipeline.datasets import Dataset
from pipeline.labels.exports.exporting import MARK
from pipeline.labels.exports.provenance import ExportedFrom
from pipeline.labels.reading import Labels
from pipeline.labels.schema import TABLES
from pipeline.system.errors import InputError

COCO_FILES = ("instances.json", "refs.json", "relations.json")
NOW = "now"


@dataclass(frozen=True)
class ImportConfig:
    """How a file is imported.

    Attributes
    ----------
    format : {"coco", "jsonl"}, optional
        By the file's name where it is not given.
    base : str, optional
        The folder of the export that the file came from, or "now", in place of what the file says.
    deleted : {"keep", "reject"}
        What becomes of objects that the file lacks, in frames that it has.
    crowds : bool
        New COCO annotations with `iscrowd` 1 are objects.
    outline : float
        Pixels by which a polygon may differ from the mask that was exported, and be the same.
    skip_conflicts : bool
        Save what no later correction stands against.
    reason : str
        Kept with each edit; the file's name where it is empty.
    dry_run : bool
        Save nothing.
    """

    format: Literal["coco", "jsonl"] | None = None
    base: str | None = None
    deleted: Literal["keep", "reject"] = "keep"
    crowds: bool = False
    outline: float = 1.5
    skip_conflicts: bool = False
    reason: str = ""
    dry_run: bool = False

    def __post_init__(self) -> None:
        if not 0 <= self.outline <= 100:
            raise InputError("outline", got=self.outline, expected="0 to 100 pixels")


@dataclass(frozen=True)
class ImportReport:
    """What an import did, or would do.

    Attributes
    ----------
    compared : int
        Rows and annotations of the file.
    edits : tuple of Edit
        What differs from what was exported, and is to be saved.
    saved : Saved or None
        None where nothing was: a dry run, nothing to save, problems or conflicts.
    agreed : int
        Differences that the labels have by now.
    conflicts : tuple of str
        One line each. Without `skip_conflicts`, any of them keeps everything from being saved.
    problems : tuple of str
        One line each, with file and line or annotation. Any of them keeps everything from being saved.
    notes : tuple of str
    """

    compared: int
    edits: tuple[Edit, ...]
    saved: Saved | None
    agreed: int
    conflicts: tuple[str, ...]
    problems: tuple[str, ...]
    notes: tuple[str, ...]


def import_corrections(
    labels: Labels,
    journal: Journal | None,
    path: str | Path,
    author: str,
    config: ImportConfig | None = None,
    *,
    open_dataset: Callable[[], Dataset | None] | None = None,
) -> ImportReport:
    """Turn what somebody changed in an export into events of the journal, in one action, or save nothing.

    Parameters
    ----------
    labels : Labels
        The automatic labels that the journal is of.
    journal : Journal or None
        None where there is none yet: then nothing can be saved.
    path : str or Path
        A file of a COCO or JSONL export, or the folder of one.
    author : str
    config : ImportConfig, optional
    open_dataset : callable, optional
        Gives the dataset; called where the export holds what follows from corrected pixels.

    Raises
    ------
    InputError
        The file cannot be read, or is not of these labels or this journal.
    NotSaved
        As `Journal.append`.
    """
    config = config or ImportConfig()
    author = plain_text(author, "an author", LONGEST_NAME)
    if labels.manifest.corrections is not None:
        raise InputError("these labels are corrected already", expected="the automatic ones", path=labels.root)
    place = Path(path).expanduser()
    format = config.format or _format(place)
    states = States(labels, () if journal is None else journal.events(), open_dataset)
    claims, source = Claims(states), _Source(states, place, config.base)
    try:
        _read(place, format, claims, source, config)
    except TooManyProblems:
        claims.notes[f"reading stopped after {MOST_PROBLEMS} problems"] += 1
    reason = config.reason or f"imported from {place.name}"
    conflicts: list[Contradiction] = []
    edits: tuple[Edit, ...] = ()
    agreed, saved, rivals = 0, None, ()
    try:
        settled = settle(claims, reason[:2000])
        conflicts, edits, agreed = settled.contradictions, tuple(settled.edits.values()), settled.agreed
    except TooManyProblems:
        claims.notes[f"reading stopped after {MOST_PROBLEMS} problems"] += 1
    wanted = not claims.problems and (config.skip_conflicts or not conflicts)
    if edits and wanted and not config.dry_run and journal is not None:
        done = journal.append(edits, author)
        if isinstance(done, Conflict):
            rivals = done.rivals
        else:
            saved = done
    notes = [f"{text}: {n}" for text, n in claims.notes.items()]
    notes += [f"{n} values of {column!r} differ, which cannot be corrected" for column, n in claims.ignored.items()]
    told = (*map(str, conflicts), *map(str, rivals))
    return ImportReport(claims.compared, edits, saved, agreed, told, tuple(claims.problems), tuple(notes))


def _format(place: Path) -> Literal["coco", "jsonl"]:
    if place.is_dir():
        if (place / COCO_FILES[0]).is_file():
            return "coco"
        if any((place / f"{name}.jsonl").is_file() for name in TABLES):
            return "jsonl"
    elif place.suffix in (".json", ".jsonl"):
        return "coco" if place.suffix == ".json" else "jsonl"
    raise InputError("neither a COCO nor a JSONL export", cause="--format says which", path=place)


def _read(place: Path, format: str, claims: Claims, source: _Source, config: ImportConfig) -> None:
    reject = config.deleted == "reject"
    if not place.exists():
        raise InputError("there is no such file", path=place)
    if format == "jsonl":
        paths = [place] if place.is_file() else [p for n in TABLES if (p := place / f"{n}.jsonl").is_file()]
        if not paths:
            raise InputError("no file of a JSONL export here", path=place)
        for path in paths:
            read_lines(path, claims, source.state, reject_deleted=reject)
        return
    paths = [place] if place.is_file() else [p for n in COCO_FILES if (p := place / n).is_file()]
    if not paths:
        raise InputError("no file of a COCO export here", path=place)
    options = CocoOptions(reject, config.crowds, config.outline)
    beside: Any = None
    for path in paths:
        content = load_coco(path)
        if isinstance(content, dict) and "annotations" in content:
            beside = content
            with _in_file(path):
                read_instances(content, path.name, claims, source.state, options)
            continue
        if beside is None:
            beside = load_coco(path.with_name(COCO_FILES[0]))
        # What is wrong with instances.json is its own import's to tell.
        frames, objects, stated = annotated(beside, COCO_FILES[0], Claims(claims.states))
        state, read = source.state(stated), read_refs if isinstance(content, list) else read_relations
        with _in_file(path):
            read(content, path.name, frames, objects, state, claims)


@contextmanager
def _in_file(path: Path) -> Iterator[None]:
    try:
        yield
    except InputError as error:
        if str(path) in str(error):
            raise
        raise InputError(str(error), path=path) from error


class _Source:
    """What a file was exported from: as the user says, as the file says, as the export says that it lies in."""

    def __init__(self, states: States, place: Path, base: str | None) -> None:
        self._states = states
        self._folder = place if place.is_dir() else place.parent
        self._said = None if base is None else states.now if base == NOW else self._of_folder(Path(base).expanduser())
        self._known: dict[Any, ExportedFrom] = {}

    def state(self, stated: Any) -> ExportedFrom:
        """The state that a row or a file names; InputError where none is named or it cannot be used."""
        key = stated if isinstance(stated, str) else None
        if key not in self._known:
            found = self._said
            if found is None and stated is not None:
                found = ExportedFrom.parse(stated)
            if found is None:
                found = self._of_folder(self._folder)
            self._states.check(found)
            self._known[key] = found
        return self._known[key]

    def _of_folder(self, folder: Path) -> ExportedFrom:
        mark = folder / MARK
        if not mark.is_file():
            raise InputError(
                "it is not said what the file was exported from",
                expected="--base EXPORT, the folder of the export, or --base now", path=folder,
            )  # fmt: skip
        content = load_coco(mark)
        return ExportedFrom.parse(content.get("base") if isinstance(content, dict) else None)


def import_record(report: ImportReport) -> dict[str, Any]:
    """`import --json`: counts, and every edit, conflict and problem."""
    return {
        "compared": report.compared,
        "edits": [
            {
                "kind": e.cell.kind, "frame": e.cell.frame, "key": e.cell.key, "field": e.cell.field,
                "before": e.before, "after": e.after, "base": e.base, "reason": e.reason,
            }
            for e in report.edits
        ],
        "saved": [] if report.saved is None else [event_record(e) for e in report.saved.events],
        "agreed": report.agreed,
        "conflicts": list(report.conflicts),
        "problems": list(report.problems),
        "notes": list(report.notes),
    }  # fmt: skip
