"""What keeps a run from answering, told before its figures."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import pytest

from pipeline.answering import open_pipeline
from pipeline.evaluation.causes import causes_of, with_figures
from pipeline.labels import SourceSpec, label_dataset, open_labels
from pipeline.metrics.intervals import Estimate
from pipeline.metrics.tables import Row, Table
from pipeline.system import pa


@dataclass(frozen=True)
class Detector:
    """Only what is asked of a detector here."""

    name: str = "coco"
    exact: bool = False
    vocabulary: tuple[str, ...] | None = ("laptop", "book")


@pytest.fixture(scope="module")
def labels(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("causes") / "labels"
    label_dataset(SourceSpec("demo"), out)
    return out


def test_unknown_names_and_frames_stand_first(labels: Path) -> None:
    source, read = open_pipeline("demo"), open_labels(labels)
    rows = [
        {"target": "mug", "reference": "laptop", "problem": "coco does not know mug"},
        {"target": "mug", "reference": "vase", "problem": "coco does not know mug"},
        {"target": "laptop", "reference": "book", "problem": None},
        {"target": "laptop", "reference": None, "problem": None},
    ]
    records = pa.Table.from_pylist(rows, pa.schema(dict.fromkeys(rows[0], "string")))
    detector: object = Detector()
    (cause,) = causes_of(records, source, read, detector)  # type: ignore[arg-type]
    assert cause.startswith("coco does not know 2 of 4 names that are asked for: mug (2), vase (1). 2 of 4 expressions")
    for nothing in (None, ()):
        # Of any words, and without proposals, as imported answers are.
        assert causes_of(records, source, read, Detector(vocabulary=nothing)) == (  # type: ignore[arg-type]
            "2 of 4 expressions have no answer that the system could give; the first: coco does not know mug",
        )
    held = replace(source, dataset=source.dataset)
    some = [*source.dataset.frame_ids[:-2]]
    frames = read.frames.filter(pa.array([frame in some for frame in read.frames.column("frame").to_pylist()]))
    bad = frames.set_column(frames.column_names.index("ok"), "ok", [[False] + [True] * (frames.num_rows - 1)])
    read.__dict__["frames"] = bad
    told = causes_of(records.slice(2), held, read, None)
    assert told[0].startswith(f"1 of {len(some)} frames could not be used when they were labelled")
    assert told[1].startswith(f"2 of {len(some) + 2} frames of the dataset are not in the labels")


def test_tables_that_say_nothing_are_left_out() -> None:
    nothing, none = Estimate(0.0, 0.0, 0.0, 4, 2), float("nan")
    tables = [
        Table("a", "A", ("x", "n"), (Row("one", (nothing, 4)), Row("two", (none, 4)))),
        Table("b", "B", ("x",), ()),
        Table("c", "C", ("x", "n"), (Row("one", (0.5, 4)),)),
    ]
    shown, empty = with_figures(tables)
    assert ([t.key for t in shown], [t.key for t in empty]) == (["c"], ["a", "b"])
