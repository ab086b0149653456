"""Importing corrections made elsewhere: all of a file's, as one action in the journal, or none.

Corrections are told from conflicts by what was exported, what the file says, and
what is there now.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

from pipeline.corrections.journal import edits as actions
from pipeline.corrections.journal.effective_frame import EffectiveFrame
from pipeline.corrections.journal.events import Conflict, Edit, Saved, event_record, grouped
from pipeline.corrections.journal.field_refs import LONGEST_NAME, FieldRef, box_of, plain_text, same_value, shown_value
from pipeline.corrections.journal.incoming.claims import Claim, Claims, States, read_lines
from pipeline.corrections.journal.incoming.coco_file import (
    annotated,
    load_coco,
    read_instances,
    read_refs,
    read_relations,
)
from pipeline.corrections.journal.journal import Journal
from pipeline.datasets import Dataset
from pipeline.labels.exports.exporting import MARK
from pipeline.labels.exports.row_provenance import ExportedFrom
from pipeline.labels.reading import Labels
from pipeline.labels.schema import TABLES
from pipeline.language.relation_names import PAIRWISE
from pipeline.system.errors import InputError, require

COCO_FILES = ("instances.json", "refs.json", "relations.json")
NOW = "now"
ANSWERS = ("targets", "acceptable", "ambiguous")


@dataclass(frozen=True)
class ImportConfig:
    """Settings of an import."""

    format: Literal["coco", "jsonl"] | None = None  # by default by the file's name
    base: str | None = None  # folder of the export, or "now", in place of what the file says
    deleted: Literal["keep", "reject"] = "keep"  # of objects that listed frames lack
    crowds: bool = False  # take new annotations with `iscrowd` 1
    outline: float = 1.5  # pixels
    skip_conflicts: bool = False  # save the others
    reason: str = ""  # by default the file's name
    dry_run: bool = False

    def __post_init__(self) -> None:
        require(0 <= self.outline <= 100, "outline", got=self.outline, expected="0 to 100 pixels")


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
    format = config.format or _format(given)
    states = States(labels, () if journal is None else journal.events(), open_dataset)
    claims, source = Claims(states), _Source(states, given, config.base)
    reason = config.reason or f"imported from {given.name}"
    edits, conflicts, agreed, done = [], [], 0, None
    with claims.stopping():
        _read(given, format, claims, source, config)
    with claims.stopping():
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
        if (given / COCO_FILES[0]).is_file():
            return "coco"
        if any((given / f"{name}.jsonl").is_file() for name in TABLES):
            return "jsonl"
    elif given.suffix in (".json", ".jsonl"):
        return "coco" if given.suffix == ".json" else "jsonl"
    raise InputError("neither a COCO nor a JSONL export", cause="--format says which", path=given)


def _read(given: Path, format: str, claims: Claims, source: _Source, config: ImportConfig) -> None:
    reject, names = config.deleted == "reject", [f"{n}.jsonl" for n in TABLES] if format == "jsonl" else COCO_FILES
    require(given.exists(), "there is no such file", path=given)
    paths = [given] if given.is_file() else [p for n in names if (p := given / n).is_file()]
    require(paths, f"no file of a {format.upper()} export here", path=given)
    instances: Any = None
    for path in paths:
        if format == "jsonl":
            read_lines(path, claims, source.state, reject_deleted=reject)
            continue
        content = load_coco(path)
        if isinstance(content, dict) and "annotations" in content:
            instances = content
            with _in_file(path):
                read_instances(
                    content,
                    path.name,
                    claims,
                    source.state,
                    reject_deleted=reject,
                    crowds=config.crowds,
                    outline=config.outline,
                )
            continue
        if instances is None:
            instances = load_coco(path.with_name(COCO_FILES[0]))
        # What is wrong with instances.json is its own import's to tell.
        frames, objects, stated = annotated(instances, COCO_FILES[0], Claims(claims.states))
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
    """Base of a file: as the user says, as the file says, or as its folder says."""

    def __init__(self, states: States, given: Path, base: str | None) -> None:
        self._states = states
        self._folder = given if given.is_dir() else given.parent
        self._given = None if base is None else states.now if base == NOW else self._of_folder(Path(base).expanduser())
        self._known: dict[Any, ExportedFrom] = {}

    def state(self, stated: Any) -> ExportedFrom:
        """State named by a row or file; InputError for no state, or an unknown state."""
        key = stated if isinstance(stated, str) else None
        if key not in self._known:
            told = None if stated is None or self._given is not None else ExportedFrom.parse(stated)
            found = self._given or told or self._of_folder(self._folder)
            self._states.check(found)
            self._known[key] = found
        return self._known[key]

    def _of_folder(self, folder: Path) -> ExportedFrom:
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
    agreed = 0
    for group in _grouped(claims.found.values()):
        first = group[0]
        now = claims.states.frame_now(first.ref.frame, first.base)
        base = claims.states.frame(first.ref.frame, first.base)
        gone = _gone(first.ref, base, now, claims)
        if gone is not None:
            contradictions += [f"{c.where}: {c.ref}: wanted {shown_value(c.ref, c.value)}, but {gone}" for c in group]
            continue
        with claims.reading(first.where):
            made = [e for e in _edits(group, base, now, reason) if not same_value(e.before, e.after)]
            agreed += not made
            against = [e for e in made if not same_value(base.value(e.ref), now.value(e.ref))]
            contradictions += [_contradiction(first.where, e, base.value(e.ref), claims) for e in against]
            for edit in made if not against else ():
                before, where = edits.setdefault(edit.ref, (edit, first.where))
                if not same_value(before.after, edit.after):
                    claims.problem(first.where, f"{edit.ref} cannot be as here and as {where} has it")
    return [edit for edit, _ in edits.values()], contradictions, agreed


def _contradiction(where: str, edit: Edit, exported: Any, claims: Claims) -> str:
    """Word an edit against a later correction or consequence."""
    event = claims.states.newest(edit.ref.frame, edit.ref)
    by = "it was recomputed since"
    if event is not None:
        by = f"{event.author} corrected it at {event.time:%Y-%m-%d %H:%M:%S UTC}"
    was, wanted, now = (shown_value(edit.ref, value) for value in (exported, edit.after, edit.before))
    return f"{where}: {edit.ref}: exported as {was}, wanted {wanted}, is {now} now: {by}"


def _grouped(claims: Iterable[Claim]) -> list[list[Claim]]:
    """Group claims into actions (with all answers of an expression), by frame."""

    def action(claim: Claim) -> Any:
        ref = claim.ref
        answers = ref.kind == "expression" and ref.field in ANSWERS
        return (ref.frame, ref.key, "answers") if answers else ref

    return sorted(grouped(claims, action).values(), key=lambda group: group[0].ref.frame)


def _gone(ref: FieldRef, base: EffectiveFrame, now: EffectiveFrame, claims: Claims) -> str | None:
    """Reason why nothing is left to correct, where it was taken away since."""
    if ref.kind in ("object", "relation") and ref.field not in ("status", "exists"):
        for number in ref.numbers:
            if number in base.objects and number not in now.objects:
                by = claims.states.newest(ref.frame, FieldRef("object", ref.frame, str(number), "status"))
                return f"object {number} was rejected since" + (f" by {by.author}" if by is not None else "")
    if ref.kind == "relation" and any(
        base.pairs.index_of(n) is not None and now.pairs.index_of(n) is None for n in ref.numbers
    ):
        return "one of its objects takes part in no relation any more"
    told = ref.kind == "expression" and ref.field not in ("status", "mark")
    if told and ref.key in base.expressions and ref.key not in now.expressions:
        return f"it was withdrawn since: {next((w.reason for w in now.withdrawn if w.id == ref.key), '')}"
    return None


def _edits(group: Sequence[Claim], base: EffectiveFrame, now: EffectiveFrame, reason: str) -> tuple[Edit, ...]:
    ref, value = group[0].ref, group[0].value
    if ref.kind == "expression" and ref.field in ANSWERS:
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
    elif not set(targets) <= set(acceptable):
        require("targets" not in claimed, "targets must be acceptable too", got=f"{targets} and {acceptable}")
        targets = [n for n in targets if n in acceptable]
    made = actions.set_answers(now, name, targets, acceptable, reason)
    if "ambiguous" in claimed:
        made = tuple(replace(e, after=claimed["ambiguous"]) if e.ref.field == "ambiguous" else e for e in made)
    return made
