"""A run made of predictions that are at hand in Python, as `import-run` makes one of a file."""

from __future__ import annotations

import json
import re
import tempfile
import warnings
from collections.abc import Iterable, Mapping
from itertools import chain
from pathlib import Path
from typing import Any

from pipeline.answering.predictions import Header, Prediction, as_json, parse_header
from pipeline.answering.tracing import plain
from pipeline.evaluation.importing import import_run
from pipeline.evaluation.run_folder import Run, open_run
from pipeline.system.errors import InputError, require
from pipeline.system.whole_files import scratch_folder

Record = Prediction | Mapping[str, Any]


def import_records(
    records: str | Path | Iterable[Header | Record],
    dataset: str | Path,
    labels: str | Path,
    out: str | Path | None = None,
    *,
    header: Header | Mapping[str, Any] | None = None,
    **options: Any,
) -> Run:
    """The run of predictions of another pipeline, as `spatialviz import-run` makes it of a file.

    Parameters
    ----------
    records : iterable of dict or Prediction, or path
        As the lines of `docs/predictions.md`, or the file of them; a header may come first.
    dataset, labels : str or Path
    out : str or Path, optional
        The run's folder; by default a temporary one.
    header : Header or mapping, optional
        Fields of the first line ("system", "ranking", ...), where `records` begins with none.
    options
        What `import_run` takes: name, workers, plots, overwrite, rescore.

    Raises
    ------
    InputError
        As `import_run`; messages count the records from 1, without the header. No record.

    Warns
    -----
    UserWarning
        What `import-run` tells of a file: lines that are not read or not judged.
    """
    return open_run(_judged(records, dataset, labels, out, header, options))


def _judged(
    records: str | Path | Iterable[Header | Record],
    dataset: str | Path,
    labels: str | Path,
    out: str | Path | None,
    header: Header | Mapping[str, Any] | None,
    options: Mapping[str, Any],
) -> Path:
    """The folder of the run."""
    folder = Path(tempfile.mkdtemp(prefix="spatialviz-run-")) / "run" if out is None else Path(out)
    if isinstance(records, str | Path):
        require(header is None, "a file has a header of its own", path=records)
        for told in import_run(records, dataset, labels, folder, **options).warnings:
            warnings.warn(told, stacklevel=3)
        return folder
    rest = iter(records)
    first = next(rest, None)
    if first is None:
        raise InputError("there are no predictions", expected="a record for each expression")
    if header is None and (isinstance(first, Header) or (not isinstance(first, Prediction) and VERSION_FIELD in first)):
        header = first
    else:
        rest = chain([first], rest)
    with scratch_folder() as place:
        file = Path(place) / "records.jsonl"
        try:
            if not isinstance(header, Header):
                header = parse_header({VERSION_FIELD: 1, **(header or {})}, file)
            with file.open("w", encoding="utf-8") as lines:
                for line in chain([header], rest):
                    lines.write(
                        as_json(line) if isinstance(line, (Header, Prediction)) else json.dumps(line, default=plain)
                    )
                    lines.write("\n")
            import_run(file, dataset, labels, folder, **options)
        except InputError as error:
            if error.path != file:
                raise
            raise InputError(_of_records(str(error).removesuffix(f" [{file}]"))) from error
    return folder


def _of_records(message: str) -> str:
    """A message about lines of a file, about the header and the records after it, from 1."""
    numbered = re.sub(r"\bline (\d+)", lambda found: f"record {int(found[1]) - 1}", message)
    return numbered.replace("record 0", "header")


VERSION_FIELD = "spatialviz_predictions"
