"""The commands that carry labels out, and corrections made elsewhere in."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from tyro.conf import OmitArgPrefixes, Positional

from pipeline.system.errors import InputError
from spatialviz.cli_journal import DatasetOptions, JournalOptions
from spatialviz.exits import BAD, FINE, NO
from spatialviz.options import print_json

if TYPE_CHECKING:
    from pipeline.corrections.journal.journal import Journal
    from pipeline.datasets import Dataset
    from pipeline.labels.reading import Labels


@dataclass(frozen=True)
class Export:
    """Write labels in another format, with where each value comes from."""

    labels: Positional[Path]
    """Labels folder."""
    out: Path
    """Folder to write; it must not exist, or be empty."""
    format: str
    """jsonl | coco | kitti (boxes only) | vqa (conversations for tuning a vision-language model) | parquet (Hugging
    Face's layout), or the name that a plugin gives its own."""
    images: Literal["none", "copy"] = "none"
    """copy: write the colour images beside the labels too."""
    dataset: str | None = None
    """Where the dataset is now, for its images, for corrected masks and boxes, and for the depth that vqa measures.
    Default: where it was labelled."""
    corrected: bool = False
    """Apply the journal first, as `effective` does."""
    journal: OmitArgPrefixes[JournalOptions] = field(default_factory=JournalOptions)
    overwrite: bool = False
    """Replace an earlier export."""
    licence: str | None = None
    """The labels' licence, for the card of parquet. Default: said to be unknown."""

    def run(self) -> int:
        from pipeline.labels.exports import export_labels
        from pipeline.labels.exports.hub import HubConfig
        from pipeline.labels.reading import open_labels
        from spatialviz.printing import rate_bar

        automatic = open_labels(self.labels)
        options = None
        if self.licence is not None:
            if self.format != "parquet":
                raise InputError("--licence is for the card of --format parquet")
            options = HubConfig(licence=self.licence)
        if not self.corrected and self.journal != JournalOptions():
            raise InputError("--journal and --project go with --corrected")
        _keep(automatic, self.out)
        with self._labels(automatic) as labels, rate_bar("exporting", "frames") as advance:
            report = export_labels(
                labels,
                self.format,
                self.out,
                images=self.images,
                dataset=self._pictures(automatic),
                overwrite=self.overwrite,
                options=options,
                progress=advance,
            )
        for note in report.notes:
            print(f"spatialviz: {note}", file=sys.stderr)
        if self.format in ("coco", "vqa") and self.images == "none":
            print("spatialviz: the files name images/ that are not there; --images copy writes them", file=sys.stderr)
        rows = ", ".join(f"{count} {name}" for name, count in report.rows.items())
        print(f"{rows} -> {self.out}")
        return FINE

    @contextmanager
    def _labels(self, automatic: Labels) -> Iterator[Labels]:
        """What is exported: the labels as they are, or with the journal applied, in a folder that does not stay."""
        if not self.corrected:
            yield automatic
            return
        from pipeline.corrections.journal.materialise import materialise
        from pipeline.labels.exports.exporting import MARK
        from pipeline.labels.reading import open_labels
        from pipeline.system.staging import check_target

        if automatic.manifest.corrections is not None:
            raise InputError("these labels are corrected already", cause="leave --corrected out", path=self.labels)
        check_target(self.out, overwrite=self.overwrite, mark=MARK)
        with tempfile.TemporaryDirectory(prefix="spatialviz-") as folder:
            where = Path(folder) / "corrected"
            with self.journal.open(automatic, must_exist=True) as journal:
                dataset = DatasetOptions(dataset=self.dataset).open(automatic)
                _, found = materialise(automatic, journal, where, dataset=dataset)
            stale = found.counts["stale"]
            if stale:
                print(f"spatialviz: {stale} values are stale: they need the dataset (--dataset)", file=sys.stderr)
            yield open_labels(where)

    def _pictures(self, labels: Labels) -> Dataset | None:
        if self.images != "copy" and not (self.format == "vqa" and self.dataset is not None):
            return None
        from pipeline.labels.plan import load_plan
        from pipeline.labels.store import Store

        if labels.manifest.corrections is not None:
            # A folder of corrected labels has no plan; its manifest names the dataset.
            return None if self.dataset is None else DatasetOptions(dataset=self.dataset).open(labels)
        plan = load_plan(Store(self.labels))
        spec = plan.spec if self.dataset is None else type(plan.spec)(self.dataset, plan.spec.options)
        return spec.open(plan.config).dataset


def _keep(labels: Labels, out: Path) -> None:
    target, root = out.expanduser().resolve(), labels.root.resolve()
    if target == root or target in root.parents:
        raise InputError("an export cannot replace the labels", expected="another folder", path=out)


@dataclass(frozen=True)
class Import:
    """Take over corrections made elsewhere, in a COCO or JSONL export of these labels: all of them, or none.

    What differs between the file and what was exported becomes edits in the journal. A value that was corrected in
    the journal since is never overwritten: it is told, and nothing is saved (exit status 1). Nor is anything saved
    where the file has problems (exit status 2).
    """

    labels: Positional[Path]
    """Labels folder that was exported."""
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
    crowds: bool = False
    """New COCO annotations with iscrowd 1 are objects too."""
    outline: float = 1.5
    """A polygon that nowhere lies farther than so many pixels from the mask that was exported is that mask."""
    skip_conflicts: bool = False
    """Save what does not contradict later corrections, instead of nothing."""
    reason: str = ""
    """Kept with each correction. Default: the file's name."""
    source: OmitArgPrefixes[DatasetOptions] = field(default_factory=DatasetOptions)
    journal: OmitArgPrefixes[JournalOptions] = field(default_factory=JournalOptions)
    dry_run: bool = False
    """Save nothing; say what would be done."""
    show: int = 20
    """Lines shown of each kind."""
    json: bool = False
    """Print one JSON object."""

    def run(self) -> int:
        from pipeline.corrections.journal.incoming.importing import ImportConfig, import_corrections, import_record
        from pipeline.labels.reading import open_labels
        from spatialviz.printing_journal import print_import

        labels = open_labels(self.labels)
        config = ImportConfig(
            format=self.format,
            base=self.base,
            deleted=self.deleted,
            crowds=self.crowds,
            outline=self.outline,
            skip_conflicts=self.skip_conflicts,
            reason=self.reason,
            dry_run=self.dry_run,
        )
        with self._journal(labels) as journal:
            report = import_corrections(
                labels, journal, self.file, self.author, config, open_dataset=lambda: self.source.open(labels)
            )
        if self.json:
            print_json(import_record(report))
        else:
            print_import(report, self.show)
        if report.problems:
            count, first = len(report.problems), report.problems[0]
            more = f" (and {count - 1} more problems)" if count > 1 else ""
            print(f"spatialviz: error: {first}{more}; nothing was saved", file=sys.stderr)
            return BAD
        return NO if report.conflicts else FINE

    @contextmanager
    def _journal(self, labels: Labels) -> Iterator[Journal | None]:
        """The journal; a dry run makes none where there is none."""
        from pipeline.corrections.journal.connection import is_url
        from pipeline.corrections.journal.journal import JOURNAL_FILE

        said = self.journal.journal
        missing = not (said is not None and is_url(said)) and not Path(said or labels.root / JOURNAL_FILE).exists()
        if self.dry_run and missing:
            yield None
            return
        with self.journal.open(labels) as journal:
            yield journal
