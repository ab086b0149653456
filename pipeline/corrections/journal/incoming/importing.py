"""Importing corrections made elsewhere: all of a file's, as one action in the journal, or none.

Corrections are told from conflicts by what was exported, what the file says, and
what is there now.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

from pipeline.corrections.journal import edits as actions
from pipeline.corrections.journal.effective_frame import EffectiveFrame
from pipeline.corrections.journal.events import Conflict, Edit, Saved, event_record, grouped
from pipeline.corrections.journal.field_refs import (
    LONGEST_NAME,
    FieldRef,
    box_of,
    object_ref,
    plain_text,
    same_value,
    shown_value,
)
from pipeline.corrections.journal.incoming.claims import Claim, Claims, States, TooManyProblems, read_lines
from pipeline.corrections.journal.incoming.coco_file import load_coco, read_instances
from pipeline.corrections.journal.journal import Journal
from pipeline.datasets import Dataset
from pipeline.labels.exports.base import ExportedFrom
from pipeline.labels.exports.exporting import MARK
from pipeline.labels.reading import Labels
from pipeline.labels.schema import TABLES
from pipeline.language.relation_names import PAIRWISE
from pipeline.system.errors import InputError, in_file, require
from pipeline.system.frozen import dataclass

COCO_FILE = "instances.json"
_NOT_READ = ("refs.json", "relations.json")
"""Sentences and relations of a COCO export."""
_BY_LINES = "sentences and relations come back by `export --format jsonl`"
NOW = "now"
ANSWERS = ("targets", "acceptable", "ambiguous")


@dataclass(frozen=True)
class ImportConfig:
    """Settings of an import."""

    format: Literal["coco", "jsonl"] | None = None  # by default by the file's name
    base: str | None = None  # folder of the export, or "now", in place of what the file says
    deleted: Literal["keep", "reject"] = "keep"  # of objects that listed frames lack
    skip_conflicts: bool = False  # save the others
    reason: str = ""  # by default the file's name
    dry_run: bool = False


@dataclass(frozen=True)
class ImportReport:
    """Result of an import, or of a dry run."""

    compared: int  # rows and annotations
    edits: tuple[Edit, ...]  # differences from the export
    saved: Saved | None
    agreed: int  # differences that the labels have by now
    conflicts: tuple[str, ...]  # keep everything from being saved, without `skip_conflicts`
    problems: tuple[str, ...]  # keep everything from being saved
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
    """Save the changes of an edited export in a single action, or nothing.

    `path` is a file or folder of a COCO or JSONL export; without `journal` nothing can be saved; `open_dataset` is
    called where the export holds what follows from corrected pixels. InputError for an unreadable file, or one of other
    labels or another journal; NotSaved as `Journal.append`.
    """
    config = config or ImportConfig()
    author = plain_text(author, "an author", LONGEST_NAME)
    require(
        labels.manifest.corrections is None,
        "these labels are corrected already",
        expected="the automatic ones",
        path=labels.root,
    )
    given = Path(path).expanduser()
    claims = Claims(States(labels, () if journal is None else journal.events(), open_dataset))
    reason = config.reason or f"imported from {given.name}"
    edits, conflicts, agreed, done = [], [], 0, None
    with suppress(TooManyProblems):
        _read(given, claims, config)
        edits, conflicts, agreed = settle(claims, reason[:2000])
    wanted = not claims.problems and (config.skip_conflicts or not conflicts)
    if edits and wanted and not config.dry_run and journal is not None:
        done = journal.append(edits, author)
    notes = [f"{text}: {n}" for text, n in claims.notes.items()]
    notes += [f"{n} values of {column!r} differ, which cannot be corrected" for column, n in claims.ignored.items()]
    told = (*conflicts, *map(str, done.rivals if isinstance(done, Conflict) else ()))
    return ImportReport(
        claims.compared,
        tuple(edits),
        done if isinstance(done, Saved) else None,
        agreed,
        told,
        tuple(claims.problems),
        tuple(notes),
    )


def _format(given: Path) -> Literal["coco", "jsonl"]:
    if given.is_dir():
        if (given / COCO_FILE).is_file():
            return "coco"
        if any((given / f"{name}.jsonl").is_file() for name in TABLES):
            return "jsonl"
    elif given.suffix in (".json", ".jsonl"):
        return "coco" if given.suffix == ".json" else "jsonl"
    raise InputError("neither a COCO nor a JSONL export", cause="--format says which", path=given)


def _read(given: Path, claims: Claims, config: ImportConfig) -> None:
    format = config.format or _format(given)
    require(given.exists(), "there is no such file", path=given)
    names = [f"{n}.jsonl" for n in TABLES] if format == "jsonl" else [COCO_FILE]
    paths = [given] if given.is_file() else [p for n in names if (p := given / n).is_file()]
    require(paths, f"no file of a {format.upper()} export here", path=given)
    state_of, reject = _state_of(claims.states, given, config.base), config.deleted == "reject"
    for path in paths:
        require(path.name not in _NOT_READ, f"of a COCO export {COCO_FILE} is read", cause=_BY_LINES, path=path)
        with in_file(path):
            if format == "jsonl":
                read_lines(path, claims, state_of, reject_deleted=reject)
            else:
                read_instances(load_coco(path), path.name, claims, state_of, reject_deleted=reject)
    left = [n for n in _NOT_READ if format == "coco" and given.is_dir() and (given / n).is_file()]
    if left:
        claims.notes[f"not read, for {_BY_LINES} ({', '.join(left)})"] += len(left)


def _state_of(states: States, given: Path, base: str | None) -> Callable[[Any], ExportedFrom]:
    """Base by what a row or file states: as the user says, as stated, or as the folder says.

    InputError for no state, or an unknown state.
    """
    fixed = None if base is None else states.now if base == NOW else _of_folder(Path(base).expanduser())
    known: dict[str, ExportedFrom] = {}

    def state(stated: Any) -> ExportedFrom:
        key = stated if isinstance(stated, str) else ""
        if key not in known:
            folder = given if given.is_dir() else given.parent
            found = fixed or (_of_folder(folder) if stated is None else ExportedFrom.parse(stated))
            states.check(found)
            known[key] = found
        return known[key]

    return state


def _of_folder(folder: Path) -> ExportedFrom:
    mark = folder / MARK
    require(
        mark.is_file(),
        "it is not said what the file was exported from",
        expected="--base EXPORT, the folder of the export, or --base now",
        path=folder,
    )
    content = load_coco(mark)
    return ExportedFrom.parse(content.get("base") if isinstance(content, dict) else None)


def import_record(report: ImportReport) -> dict[str, Any]:
    """`import --json`: counts, and every edit, conflict and problem."""
    return {
        "compared": report.compared,
        "edits": [
            {
                "kind": e.ref.kind,
                "frame": e.ref.frame,
                "key": e.ref.key,
                "field": e.ref.field,
                "before": e.before,
                "after": e.after,
                "base": e.base,
                "reason": e.reason,
            }
            for e in report.edits
        ],
        "saved": [] if report.saved is None else [event_record(e) for e in report.saved.events],
        "agreed": report.agreed,
        "conflicts": list(report.conflicts),
        "problems": list(report.problems),
        "notes": list(report.notes),
    }


def settle(claims: Claims, reason: str) -> tuple[list[Edit], list[str], int]:
    """Make edits of claims; return edits, contradictions (a line each), and the count of claims already fulfilled.

    A claim that cannot be done becomes a problem of the file.
    """
    edits: dict[FieldRef, tuple[Edit, str]] = {}
    contradictions: list[str] = []
    agreed, states = 0, claims.states
    # All answers of an expression are one action.
    groups = grouped(claims.found.values(), lambda c: replace(c.ref, field="targets") if _is_answer(c.ref) else c.ref)
    for ref, group in sorted(groups.items(), key=lambda found: found[0].frame):
        first = group[0]
        now, base = states.frame_now(ref.frame, first.base), states.frame(ref.frame, first.base)
        gone = _gone(first.ref, base, now, states)
        if gone is not None:
            contradictions += [f"{c.where}: {c.ref}: wanted {shown_value(c.ref, c.value)}, but {gone}" for c in group]
            continue
        with claims.reading(first.where):
            made = [e for e in _edits(group, now, reason) if not same_value(e.before, e.after)]
            agreed += not made
            against = [e for e in made if not same_value(base.value(e.ref), now.value(e.ref))]
            contradictions += [_contradiction(first.where, e, base.value(e.ref), states) for e in against]
            for edit in made if not against else ():
                before, where = edits.setdefault(edit.ref, (edit, first.where))
                if not same_value(before.after, edit.after):
                    claims.problem(first.where, f"{edit.ref} cannot be as here and as {where} has it")
    return [edit for edit, _ in edits.values()], contradictions, agreed


def _is_answer(ref: FieldRef) -> bool:
    return ref.kind == "expression" and ref.field in ANSWERS


def _contradiction(where: str, edit: Edit, exported: Any, states: States) -> str:
    """Word an edit against a later correction or consequence."""
    event = states.newest(edit.ref)
    by = "it was recomputed since"
    if event is not None:
        by = f"{event.author} corrected it at {event.time:%Y-%m-%d %H:%M:%S UTC}"
    was, wanted, now = (shown_value(edit.ref, value) for value in (exported, edit.after, edit.before))
    return f"{where}: {edit.ref}: exported as {was}, wanted {wanted}, is {now} now: {by}"


def _gone(ref: FieldRef, base: EffectiveFrame, now: EffectiveFrame, states: States) -> str | None:
    """Reason why nothing is left to correct, where it was taken away since."""
    if ref.field in ("status", "exists", "mark"):
        return None
    for number in ref.numbers:
        if number in base.objects and number not in now.objects:
            by = states.newest(object_ref(ref.frame, number, "status"))
            return f"object {number} was rejected since" + (f" by {by.author}" if by is not None else "")
    if ref.kind == "expression" and ref.key in base.expressions and ref.key not in now.expressions:
        return f"it was withdrawn since: {next((w.reason for w in now.withdrawn if w.id == ref.key), '')}"
    return None


def _edits(group: Sequence[Claim], now: EffectiveFrame, reason: str) -> tuple[Edit, ...]:
    ref, value = group[0].ref, group[0].value
    if _is_answer(ref):
        return _answers({c.ref.field: c.value for c in group}, ref.key, now, reason)
    if ref.kind == "relation" and ref.field in PAIRWISE:
        return actions.set_relation(now, *ref.numbers, ref.field, value, reason)  # pyright: ignore[reportCallIssue]
    if ref.field == "exists":
        # It was imported before, and may have been corrected or rejected since.
        if now.value(ref) is not None:
            return ()
        box = box_of(value["box"]) if "box" in value else None
        return actions.add_object(
            now,
            value["label"],
            mask=value.get("mask"),
            bbox=value.get("bbox"),
            box=box,
            number=ref.numbers[0],
            reason=reason,
        )
    pixels = {"mask": actions.set_mask, "bbox": actions.set_bbox}
    return (
        pixels[ref.field](now, ref.numbers[0], value, reason)
        if ref.field in pixels
        else actions.set_value(now, ref, value, reason)
    )


def _answers(claimed: dict[str, Any], name: str, now: EffectiveFrame, reason: str) -> tuple[Edit, ...]:
    """Edit answers; a single changed list brings the other."""
    if set(claimed) == {"ambiguous"}:
        return actions.set_ambiguous(now, name, claimed["ambiguous"], reason)
    row = now.expressions.get(name) or now.auto.expressions[name]
    targets = claimed.get("targets", row["targets"])
    acceptable = claimed.get("acceptable")
    if acceptable is None:
        acceptable = {*targets, *(set(row["acceptable"]) - set(row["targets"]))}
    elif "targets" not in claimed:
        targets = [n for n in targets if n in acceptable]
    made = actions.set_answers(now, name, targets, acceptable, reason)
    if "ambiguous" in claimed:
        made = tuple(replace(e, after=claimed["ambiguous"]) if e.ref.field == "ambiguous" else e for e in made)
    return made
