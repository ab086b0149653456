"""Exporting labels and reading them back, by the name of the format."""

from __future__ import annotations

import dataclasses
import json
import shutil
from collections.abc import Mapping
from pathlib import Path
from types import NoneType
from typing import Any, Literal

from pipeline.datasets import Dataset
from pipeline.labels.exports import coco, kitti, row_files, vqa_questions
from pipeline.labels.exports.base import ExportFormat, ExportReport, Job, Progress
from pipeline.labels.exports.provenance import load_json, open_provenance
from pipeline.labels.reading import MANIFEST_FILE, Labels, content_hash, labelled_dataset
from pipeline.system.arrow import pa
from pipeline.system.errors import as_input_error, present, require
from pipeline.system.plugins import load_plugins
from pipeline.system.staging import staged_folder, write_json
from pipeline.system.version import __version__

FORMATS: dict[str, ExportFormat] = {
    "jsonl": row_files.JSONL,
    "coco": coco.FORMAT,
    "kitti": kitti.FORMAT,
    "vqa": vqa_questions.FORMAT,
    "parquet": row_files.PARQUET,
}
"""The formats by name. A new one is one file and one line here."""

ENTRY_POINT_GROUP = "spatialviz.exports"
"""Entry points of this group name an ExportFormat, and so add a format."""

MARK = "export.json"
"""Written into every export; only a folder that holds it is ever replaced."""


def export_labels(
    labels: Labels,
    format: str,
    out: str | Path,
    *,
    images: Literal["none", "copy"] = "none",
    dataset: Dataset | None = None,
    overwrite: bool = False,
    options: Any = None,
    progress: Progress | None = None,
) -> ExportReport:
    """Write labels in another tool's format. Either the whole folder appears, or nothing does.

    Every format says of its rows where their values come from: see
    `pipeline.labels.exports.provenance`. Of labels that nobody corrected, all is the labeller's.

    Parameters
    ----------
    labels : Labels
    format : str
        A name of FORMATS, or a plugin's.
    out : str or Path
        A folder that does not exist yet or is empty.
    images : {"none", "copy"}
        Whether the colour images of the frames come too.
    dataset : Dataset, optional
        Where they come from, and the depth for what is measured; the dataset that the manifest names by default.
    overwrite : bool
        Replace an earlier export in `out`; a folder of anything else is never replaced.
    options : dataclass, optional
        The format's own options, such as `vqa.VqaConfig`.
    progress : callable, optional
        Called with (frames done, frames in all).

    Raises
    ------
    InputError
        An unknown format, a target that is not empty, damaged labels, or pictures that are not those of the labels.
    """
    chosen = _format(format)
    kind = chosen.options or NoneType
    require(kind is not NoneType or options is None, f"the format {format} has no options")
    options = kind() if options is None else options
    require(
        isinstance(options, kind), f"options of the format {format}", got=type(options).__name__, expected=kind.__name__
    )
    require(images in ("none", "copy"), "images", got=repr(images), expected="none | copy")
    out = Path(out).expanduser()
    target, root = out.resolve(), labels.root.resolve()
    require(
        target != root and target not in root.parents,
        "an export cannot replace the labels",
        expected="another folder",
        path=out,
    )

    def opened() -> Dataset:
        return dataset or labelled_dataset(labels.manifest)

    with staged_folder(out, overwrite=overwrite, mark=MARK) as folder:
        copy = opened() if images == "copy" else None
        provenance = open_provenance(labels)
        tell = progress or (lambda done, of: None)
        written = chosen.write(Job(labels, folder, copy, tell, options, provenance, opened))
        shutil.copyfile(labels.root / MANIFEST_FILE, folder / MANIFEST_FILE)
        record = {
            "tool": "spatialviz",
            "version": __version__,
            "format": format,
            "files": written.files,
            "rows": written.rows,
            "notes": written.notes,
            "base": provenance.base,
            "made_by": provenance.made_by,
            "options": None if options is None else dataclasses.asdict(options),
        }
        write_json(folder / MARK, record)
    return ExportReport((*written.files, MANIFEST_FILE, MARK), written.rows, written.notes, out)


def import_labels(path: str | Path, format: str, *, verify: bool = True) -> dict[str, pa.Table]:
    """Read the tables of an export back.

    Parameters
    ----------
    path : str or Path
        The folder that `export_labels` wrote.
    format : str
    verify : bool
        Of a lossless format, check that the rows are those that were exported, by
        the hashes in the manifest.

    Returns
    -------
    dict of str to pa.Table
        Of a lossless format all four tables, equal in every row and value to the
        originals. Of another, the columns that survive; see its module.

    Raises
    ------
    InputError
        An unknown format or one without labels, files that are missing, damaged or changed.
    """
    root = Path(path).expanduser()
    chosen = _format(format)
    read = present(chosen.read, f"the format {format} holds no labels to read back", path=root)
    require(root.is_dir(), "there is no such export", expected="a folder", path=root)
    mark = _read_mark(root)
    stated = format if mark is None else mark.get("format")
    require(stated == format, "an export in another format", got=stated, expected=format, path=root)
    tables = dict(read(root))
    if chosen.lossless and verify:
        _check_hashes(root, tables)
    return tables


def _check_hashes(root: Path, tables: Mapping[str, pa.Table]) -> None:
    manifest = load_json(root / MANIFEST_FILE)
    for name, table in tables.items():
        with as_input_error("the manifest is damaged", KeyError, TypeError, got=repr, path=root / MANIFEST_FILE):
            known = manifest["tables"][name]
            rows, known_hash = known["rows"], known["content_hash"]
        require(
            rows == table.num_rows,
            f"the table {name} is not whole",
            got=f"{table.num_rows} rows",
            expected=rows,
            path=root,
        )
        require(
            content_hash(table, name) == known_hash, f"the table {name} was changed after it was exported", path=root
        )


def _read_mark(folder: Path) -> dict[str, object] | None:
    """The record that an export left of itself, or None."""
    try:
        found = json.loads((folder / MARK).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return found if isinstance(found, dict) else None


def _format(name: str) -> ExportFormat:
    formats = FORMATS
    if name not in FORMATS:
        formats = {**dict(load_plugins(ENTRY_POINT_GROUP, "export", ExportFormat)), **FORMATS}
    require(name in formats, "no such export format", got=repr(name), expected=" | ".join(formats))
    return formats[name]
