"""Turning a published file into one of predictions, by the name of its format or by what it holds."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.answering.pipeline import open_pipeline
from pipeline.answering.predictions import VERSION, Header, Prediction, parse_header, parse_line, write_predictions
from pipeline.datasets import Dataset
from pipeline.evaluation.adapters.answers import ANSWER_FORMATS
from pipeline.evaluation.adapters.formats import FORMATS
from pipeline.evaluation.adapters.published import PredictionFormat, Published
from pipeline.evaluation.importing import import_run
from pipeline.evaluation.job import RunReport
from pipeline.evaluation.place_reading import told_reading
from pipeline.labels.reading import Labels, open_labels, read_table
from pipeline.language.expression import parse
from pipeline.proposals.detection_files import detection_files
from pipeline.system.errors import FrameUnusable, InputError, needed, require
from pipeline.system.frozen import dataclass
from pipeline.system.plugins import load_plugins
from pipeline.system.safe_files import opened
from pipeline.system.whole_files import scratch_folder

ENTRY_POINT_GROUP = "spatialviz.predictions"
"""Entry points of this group name a PredictionFormat, and so add a format."""
OWN = "spatialviz"
"""The format that needs no adapter."""


@dataclass(frozen=True)
class Converted:
    """A file that was turned into predictions."""

    format: str
    path: Path
    header: Header
    # lines, answers: how many lines there are, and how many of them have an answer
    lines: int
    answers: int
    notes: tuple[str, ...]


def convert_predictions(
    path: str | Path,
    out: str | Path,
    *,
    dataset: Dataset,
    labels: Labels,
    format: str | None = None,
    key: Path | None = None,
    places: Sequence[str] = (),
) -> Converted:
    """Write a published file as predictions.

    `path`: the file, or a folder of files. `dataset`: its frames are what pictures are matched to. `labels`: their
    expressions are what is asked of detections, and how questions are worded. `format`: a name of FORMATS, or a
    plugin's; by default what the file's content says. `key`: what the file leaves open; see the format's `needs`.
    `places`: what the numbers of answers mean, as `told_reading` reads it; by default all lines together say it.

    Raises InputError: no such format or none that the file is of; what does not follow it, with its line or entry; a
    picture that may be of several frames; a file of which no picture is the dataset's, or with nothing to ask.
    """
    path = Path(path)
    require(path.exists(), "there are no predictions", path=path)
    name, chosen = _chosen(path, format)
    require(key is None or chosen.needs, f"the format {name} needs no --key", path=key)
    told = [told_reading(text) for text in places]
    require(not told or name in ANSWER_FORMATS, f"--places is for answers in words, not for {name}", path=path)
    labelled = _labelled(labels) if name in ANSWER_FORMATS else {}
    published = Published(path, key, dataset, _sentences(dataset, labels), labelled=labelled, places=told)
    given, lines = chosen.read(published)
    header = given if isinstance(given, Header) else parse_header({"spatialviz_predictions": VERSION, **given}, path)
    counts, seen = Counter[str](), set[tuple[str, str]]()

    def counted() -> Iterator[Prediction]:
        for number, found in enumerate(lines, 2):
            line = found if isinstance(found, Prediction) else parse_line(found, number, path)
            twice = f"two lines ask {line.text!r} of frame {line.frame}"
            require((line.frame, line.text) not in seen, twice, path=path)
            seen.add((line.frame, line.text))
            counts["lines"] += 1
            counts["answers"] += line.answer is not None
            yield line

    write_predictions(out, header, counted())
    elsewhere = published.elsewhere
    if elsewhere:
        known = f"such as {dataset.frame_ids[0]}" if dataset.frame_ids else "one with frames"
        wrong = "the dataset holds no picture that the file is about"
        require(counts["lines"], wrong, got=elsewhere[0], expected=known, path=path, error=FrameUnusable)
        of = f"{len(elsewhere)} of {len(elsewhere) + counts['lines']} lines"
        first = f"(first: {elsewhere[0]})"
        published.notes.append(f"left out: {of}, about pictures that the dataset does not hold {first}")
    require(counts["lines"], "the file holds no predictions", path=path)
    return Converted(name, Path(out), header, counts["lines"], counts["answers"], tuple(published.notes))


def import_published(
    predictions: str | Path,
    dataset: str | Path,
    labels: str | Path,
    out: str | Path,
    *,
    format: str | None = None,
    key: Path | None = None,
    places: Sequence[str] = (),
    **more: Any,
) -> RunReport:
    """Import any file of predictions as `import_run` does; other formats are converted first.

    Raises InputError: as those two; nothing is written then.
    """
    path = Path(predictions)
    require(path.exists(), "there are no predictions", path=path)
    if format == OWN or (format is None and not is_published(path)):
        require(key is None, "predictions of our own schema need no --key", path=key)
        require(not places, "predictions of our own schema say in their header what --places says", path=path)
        return import_run(path, dataset, labels, out, **more)
    camera = {name: more[name] for name in ("intrinsics", "depth_scale", "up", "level_at") if name in more}
    opened = open_pipeline(dataset, **camera).dataset
    with scratch_folder() as folder:
        converted = convert_predictions(
            path,
            Path(folder) / path.name,
            dataset=opened,
            labels=open_labels(labels),
            format=format,
            key=key,
            places=places,
        )
        try:
            report = import_run(converted.path, dataset, labels, out, **more)
        except InputError as error:
            if error.path != converted.path:
                raise
            # The file with these lines goes away.
            told = str(error).removesuffix(f" [{converted.path}]")
            raise InputError(f"as {converted.format} it was turned into lines of ours; {told}", path=path) from error
    return replace(report, warnings=(*converted.notes, *report.warnings))


def is_published(path: Path) -> bool:
    """Tell whether a file is of another schema: without our header."""
    if path.is_dir():
        return True
    with suppress(OSError), opened(path, "unpacked") as file:
        return b'"spatialviz_predictions"' not in file.readline(1 << 16)
    return False


def _chosen(path: Path, name: str | None) -> tuple[str, PredictionFormat]:
    known = FORMATS
    if name not in FORMATS:
        known = {**dict(load_plugins(ENTRY_POINT_GROUP, "prediction", PredictionFormat)), **FORMATS}
    if name is not None:
        found = needed(known.get(name), "no such format of predictions", got=repr(name), expected=" | ".join(known))
        return name, found
    if path.is_dir() and any(path.glob("*.npz")):
        return "recording", FORMATS["recording"]
    for content in detection_files(path, "the file")[:1]:
        for name, form in known.items():
            if form.recognises(content):
                return name, form
    raise InputError(
        "the file does not say of which format it is", expected=f"--format {' | '.join((OWN, *known))}", path=path
    )


def _sentences(dataset: Dataset, labels: Labels) -> dict[str, dict[str, tuple[str, ...]]]:
    """Expressions of the labels by frame, in order, each with the names in the text."""
    table = labels.expressions.select(["frame", "text", "target", "reference"])
    found: dict[str, dict[str, tuple[str, ...]]] = {}
    for row in table.to_pylist():
        names: dict[str, Any] = dict.fromkeys(name for name in (row["target"], row["reference"]) if name)
        with suppress(InputError):
            names |= dict.fromkeys(parse(row["text"], class_names=dataset.class_names).labels)
        found.setdefault(row["frame"], {})[row["text"]] = tuple(names)
    return found


def _labelled(labels: Labels) -> dict[str, tuple[list[str], np.ndarray]]:
    """Names and boxes ((N, 4) float64, pixels) of the labelled things by frame."""
    found: dict[str, tuple[list[str], list[list[float]]]] = {}
    # Masks, the most of the table, are not read.
    for row in read_table(labels.root / "objects.parquet", "objects", ["frame", "label", "bbox"]).to_pylist():
        names, boxes = found.setdefault(row["frame"], ([], []))
        names.append(row["label"])
        boxes.append(row["bbox"])
    return {frame: (names, np.array(boxes, np.float64)) for frame, (names, boxes) in found.items()}
