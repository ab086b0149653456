"""Effective labels written as an ordinary labels folder, so that whatever reads labels reads corrected ones."""

from __future__ import annotations

import json
from datetime import datetime, timezone
from pathlib import Path

from pipeline.corrections.journal.effective import EffectiveLabels, effective_tables
from pipeline.corrections.journal.events import who_and_what
from pipeline.corrections.journal.field_refs import shown_value
from pipeline.corrections.journal.journal import Journal
from pipeline.datasets import Dataset
from pipeline.labels.merge import environment, write_labels, write_merged
from pipeline.labels.reading import MARKS_FILE, PROVENANCE_FILE, STATUSES_FILE, Labels, write_table
from pipeline.labels.schema import SCHEMA_VERSION, SENTENCES_OF, TABLES, Manifest, labels_version
from pipeline.system.errors import require
from pipeline.system.version import __version__
from pipeline.system.whole_files import temporary_folder, write_synced

UNAPPLIED_FILE = "unapplied.json"


def materialise(
    labels: Labels, journal: Journal, out: str | Path, *, dataset: Dataset | None = None
) -> tuple[Manifest, EffectiveLabels]:
    """Write corrected labels as a labels folder, whole or not at all.

    Beside the tables stand `provenance.parquet` (values that are not the labeller's), `unapplied.json` (events without
    effect, withdrawn expressions), `marks.json` (for `eval --marks`) and `statuses.json` (reviews and notes). `out` is
    a new or empty folder. Without `dataset`, what follows from new masks and boxes is marked stale. InputError for a
    folder in use, or unreadable labels, journal or frame.
    """
    folder = Path(out).expanduser().absolute()
    require(
        not folder.exists() or (folder.is_dir() and not any(folder.iterdir())),
        "corrected labels go into a new or empty folder",
        path=folder,
    )
    require(folder.parent.is_dir(), "the folder to write into does not exist", path=folder.parent)
    found = effective_tables(labels, journal, dataset=dataset)
    with temporary_folder(folder) as staging:
        manifest = _write(found, journal, staging)
        if folder.exists():
            folder.rmdir()
        staging.rename(folder)
    return manifest, found


def _write(found: EffectiveLabels, journal: Journal, folder: Path) -> Manifest:
    was = found.manifest
    tables = {name: write_merged(folder, name, iter([found.tables[name]])) for name in TABLES}
    write_table(found.provenance, folder / PROVENANCE_FILE)
    listed = {
        "events": [
            {
                **who_and_what(u.event),
                "wanted": shown_value(u.event.ref, u.event.after),
                "because": u.kind,
                "reason": u.reason,
            }
            for u in found.unapplied
        ],
        "expressions": [{"frame": w.frame, "id": w.id, "text": w.text, "reason": w.reason} for w in found.withdrawn],
    }
    marks = [{"frame": frame, "id": name, "mark": mark} for (frame, name), mark in sorted(found.marks.items())]
    statuses = [{**vars(ref), "value": value} for ref, value in sorted(found.statuses.items())]
    for name, content in ((UNAPPLIED_FILE, listed), (MARKS_FILE, marks), (STATUSES_FILE, statuses)):
        write_synced(folder / name, json.dumps(content, indent=1, ensure_ascii=False).encode())
    manifest = was.model_copy(
        update={
            "schema_version": SCHEMA_VERSION,
            "version": __version__,
            "counts": {
                # Sentences are made of automatic labels, and are not carried over.
                **{name: count for name, count in was.counts.items() if not name.startswith(SENTENCES_OF)},
                "frames": tables["frames"].rows,
                "frames_usable": sum(found.frames.column("ok").to_pylist()),
                "objects": tables["objects"].rows,
                "pairs": tables["relations"].rows,
                "expressions": tables["expressions"].rows,
            },
            "tables": tables,
            "environment": environment(),
            "created": datetime.now(timezone.utc).isoformat(timespec="seconds"),
            "corrections": {
                "journal": journal.location,
                "project": journal.project,
                "events": found.events,
                "last": found.last,
                "relifted": found.relifted,
                "automatic": labels_version(was),
                **found.counts,
                "decided": {what: list(counts) for what, counts in found.decided.items()},
            },
        }
    )
    return write_labels(folder, manifest)
