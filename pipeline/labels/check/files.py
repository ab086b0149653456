"""Rules on whole files: readable, of the schema, as they were written, made by rules that are still the same."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from pathlib import Path

from pipeline.labels.check.findings import RULES, Figure, Finding, Severity
from pipeline.labels.check.geometry import EXPECTED
from pipeline.labels.check.stream import BATCH_ROWS, TableStream
from pipeline.labels.profiles import PROFILES
from pipeline.labels.reading import Labels
from pipeline.labels.schema import Manifest
from pipeline.labels.tables import RowHash

_CHUNK = 1 << 20


def _finding(rule: str, message: str, figures: dict[str, Figure], severity: Severity | None = None) -> Finding:
    return Finding(rule, severity or RULES[rule].severity, None, (), message, figures)


def check_files(labels: Labels, streams: dict[str, TableStream]) -> Iterator[Finding]:
    """What is wrong with the tables as files."""
    for name, stream in streams.items():
        if stream.problem is not None:
            yield _finding("file/unreadable", f"{stream.path.name}: {stream.problem}", {"table": name})
            continue
        for column in sorted(stream.lacking):
            yield _finding(
                "file/schema", f"{stream.path.name} has no usable column {column}", {"table": name, "column": column}
            )
        for words in stream.other_types:
            yield _finding("file/schema", f"{stream.path.name}: {words}", {"table": name}, "warning")
        for column in stream.extra:
            yield _finding(
                "file/schema", f"{stream.path.name} has an unknown column {column}", {"table": name, "column": column}
            )
        yield from _changed(labels, name, stream)
        if not stream.ordered:
            yield _finding("file/order", f"{stream.path.name} is not in the order of frames", {"table": name})
    yield from _counts(labels.manifest)


def _changed(labels: Labels, name: str, stream: TableStream) -> Iterator[Finding]:
    record = labels.manifest.tables.get(name)
    if record is None:
        yield _finding("file/changed", f"the manifest does not know {stream.path.name}", {"table": name})
        return
    rows, content = _content(stream, name)
    figures: dict[str, Figure] = {"table": name, "rows": rows, "rows_in_manifest": record.rows}
    if file_hash(stream.path) != record.sha256:
        same = content == record.content_hash and rows == record.rows
        what = "was written anew with the same rows" if same else "was changed after it was written"
        yield _finding("file/changed", f"{stream.path.name} {what}", figures)
    elif (content is not None and content != record.content_hash) or rows != record.rows:
        yield _finding("file/changed", f"the manifest's rows or hash of {stream.path.name} were changed", figures)


def file_hash(path: Path) -> str:
    """sha256 of a file, in hexadecimal."""
    digest = hashlib.sha256()
    with open(path, "rb") as file:
        while chunk := file.read(_CHUNK):
            digest.update(chunk)
    return digest.hexdigest()


def _content(stream: TableStream, name: str) -> tuple[int, str | None]:
    """Rows of a table and the hash of their content; None where its columns are not the schema's."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    file = pq.ParquetFile(stream.path, pre_buffer=False)
    if stream.lacking or stream.other_types:
        return file.metadata.num_rows, None
    digest = RowHash(name)
    for batch in file.iter_batches(BATCH_ROWS):
        digest.update(pa.Table.from_batches([batch]))
    return digest.rows, digest.hexdigest()


def _counts(manifest: Manifest) -> Iterator[Finding]:
    """The manifest against itself."""
    pairs = {"frames": "frames", "objects": "objects", "pairs": "relations", "expressions": "expressions"}
    for count, table in pairs.items():
        record = manifest.tables.get(table)
        if record is not None and count in manifest.counts and manifest.counts[count] != record.rows:
            yield _finding(
                "file/changed",
                f"the manifest counts {manifest.counts[count]} {count} and lists {record.rows} rows",
                {"table": table, "count": manifest.counts[count], "rows": record.rows},
            )


def profile_problem(manifest: Manifest) -> str | None:
    """Why geometry cannot be compared under the manifest's profile; None where it can."""
    name = str(manifest.profile.get("name"))
    if name not in PROFILES:
        return f"this release has no rule profile {name!r}"
    parameters = json.dumps(manifest.profile.get("parameters"), sort_keys=True)
    if parameters != json.dumps(PROFILES[name].parameters, sort_keys=True):
        return f"the manifest lists other thresholds for {name!r} than this release"
    if manifest.profile_hash not in PROFILES[name].hashes:
        return f"the labels were made with other rules under the name {name!r}"
    if name not in EXPECTED:
        return f"what geometry says under the rule profile {name!r} cannot be recomputed from labels"
    return None


def check_profile(manifest: Manifest) -> Iterator[Finding]:
    """Whether the rules that made the labels are still those of this release."""
    problem = profile_problem(manifest)
    if problem is not None:
        name = str(manifest.profile.get("name"))
        release = PROFILES[name].hash if name in PROFILES else ""
        figures: dict[str, Figure] = {"profile": name, "labels": manifest.profile_hash, "release": release}
        yield _finding("profile/changed", f"{problem}: states are not compared with geometry", figures)

