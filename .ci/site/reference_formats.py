"""Page of the file formats, from the classes and constants that read and write them."""

from __future__ import annotations

import functools
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import meanings
from markdown_tables import cell, code, table
from pydantic import TypeAdapter
from schemas import HEAD, class_tables, doc_of, fields_of, json_type

import pipeline
from pipeline.answering import json_records, prediction_schema
from pipeline.corrections.journal import batch, chain, events, field_refs
from pipeline.datasets import saved_case, settings
from pipeline.datasets.demo import demo_run
from pipeline.datasets.depth.contract import DepthContract
from pipeline.diagnosis import answer, marks, story_words
from pipeline.diagnosis.cases import manifest
from pipeline.diagnosis.whatif import edits, state
from pipeline.evaluation import job, records
from pipeline.labels import schema
from pipeline.language.relation_names import PAIRWISE
from pipeline.proposals.box_detector import BoxModel

INTRO = """# File formats

What stands in the files that the program reads and writes: each field with its type, its unit or frame, and its
meaning. Lengths are metres and pixels count from the top left, unless a field says otherwise. The camera frame is
OpenCV's: x to the right, y down, z forward.
"""


def _own(module: str, *more: str) -> Any:
    return lambda kind: kind.__module__ in (module, *more)


def labels_part() -> str:
    """Return the tables of a labels folder, and its manifest."""
    parts = [
        f"""## Labels

A folder that `label` writes: `manifest.json` and four Parquet tables. The schema has version {schema.SCHEMA_VERSION};
the folder holds it as JSON Schema in `schemas/`. Labels of an older version with the same first number are read:
columns that came later ({", ".join(f"`{c}` with {v}" for c, v in schema.ADDED_COLUMNS.items())}) then read as null.
Labels with another first number are refused. Rows are keyed by frame and object, of relations by frame and two objects.
"""
    ]
    for name, model in schema.TABLES.items():
        parts += [f"### {name}.parquet\n", f"{cell(doc_of(model))}\n", _label_table(model)]
    parts += ["### manifest.json\n", f"{cell(doc_of(schema.Manifest))}\n", class_tables(schema.Manifest, 4)]
    return "\n".join(parts)


def _label_table(model: type[schema.LabelRow]) -> str:
    """Return a table's columns; those of single relations, which are alike, in one row each."""
    rows = fields_of(model, TypeAdapter(model).json_schema(), lambda name: name)
    names = [code(name) for name in PAIRWISE]
    margins = [code(f"{name}_margin") for name in PAIRWISE]
    joined = []
    for alike in (names, margins):
        if found := [r for r in rows if r[0] in alike]:
            joined.append((", ".join(r[0] for r in found), *found[0][1:]))
            rows = [r for r in rows if r[0] not in alike]
    # Every column is there: what may be missing is null.
    return table(("column", "type", "meaning"), ((name, kind, said) for name, kind, _, said in [*rows, *joined]))


def runs_part() -> str:
    """Return what stands in a run folder."""
    made = json.loads((Path(demo_run()) / "run.json").read_text(encoding="utf-8"))
    kinds = {"string": "text", "int32": "whole number", "int8": "whole number", "bool": "true or false"}
    kinds |= {"float32": "number", "box": "4 numbers", "strings": "list of text"}
    columns = meanings.of_keys(records, "COLUMNS", "DIAGNOSIS_COLUMNS")
    rows = ((code(n), f"{kinds[k]} ({k})" if k[-1].isdigit() else kinds[k], cell(columns.get(n, "")))
            for n, k in records.COLUMNS.items())  # fmt: skip
    return f"""## Runs

A folder that `eval` or `import-run` writes: `run.json`, `records.parquet` with a row an expression, the same tables as
`tables.md`, `tables.tex` and `tables/*.csv`, and `plots/`. Runs of earlier releases are read; columns that they lack
read as null. One without `spec` in `run.json` must be made again.

### run.json

{keys_table(job, ("evaluate_dataset",), made)}
### records.parquet

Indices of objects are those of the labels. Ranks count from 1, and are null where nothing fits. Overlaps are shares of
intersection over union, 0 without an answer.

{table(("field", "type", "meaning"), rows)}"""


def keys_table(module: Any, functions: Sequence[str], *seen: Mapping[str, Any]) -> str:
    """Return a table of the keys of JSON that functions make, typed by what was seen of it."""
    said = meanings.of_keys(module, *functions)
    names = dict.fromkeys(name for one in seen for name in one)
    rows = ((code(n), json_type(one[n] for one in seen if n in one), cell(said.get(n, ""))) for n in names)
    return table(("key", "type", "meaning"), rows)


def predictions_part() -> str:
    """Return the lines of a file of predictions."""
    own = _own(prediction_schema.__name__, "pipeline.geometry.masks")
    return f"""## Predictions

What another pipeline gave, for `import-run`: JSON, one object a line. The first line is a header, each further line a
`Prediction`. [Bring your pipeline](../predictions.md) says how to write it. Version {prediction_schema.VERSION}; a file
of a later one is refused.

### Header

{cell(doc_of(prediction_schema.Header))}

{class_tables(prediction_schema.Header, 4, own)}
### Prediction

{cell(doc_of(prediction_schema.Prediction))}

{class_tables(prediction_schema.Prediction, 4, own)}"""


def cases_part() -> str:
    """Return the manifest of a saved case."""
    own = _own(manifest.__name__, saved_case.__name__)
    return f"""## Cases

A folder that `save-case` writes and `replay` runs again: `{saved_case.MANIFEST}`, the frame's colour and depth without
loss, and `{manifest.PROPOSALS}` (of another pipeline `{manifest.PREDICTIONS}`). The format is
`{saved_case.CASE_FORMAT}`.

### {saved_case.MANIFEST}

{class_tables(manifest.CaseManifest, 4, own)}
### truth

{cell(doc_of(manifest.TruthRecord))}

{class_tables(manifest.TruthRecord, 4, own)}"""


def edits_part() -> str:
    """Return both files of edits."""
    common = set(batch.Action.model_fields)
    rows = []
    for (name, (_, _, _)), model in zip(batch.KINDS.items(), batch._MODELS, strict=True):
        found = fields_of(model, TypeAdapter(model).json_schema(), lambda n: n)
        given = ", ".join(f"{f} ({kind}{', required' if d == 'required' else ''})" for f, kind, d, _ in found
                          if f.strip("`") not in common)  # fmt: skip
        rows.append((code(name), given, cell(meanings.of_keys(batch, "KINDS").get(name, ""))))
    return f"""## Edits of labels

A JSON list for `correct --edits`: each entry is an action, and all are saved or none. Pixels are COCO's compressed
run-length code, or `polygon`: `[[x, y], ...]`, or `rectangle`: `[x0, y0, x1, y1]`, in pixels.

### Fields of every action

{table(HEAD, fields_of(batch.Action, TypeAdapter(batch.Action).json_schema(), lambda n: n))}
### Actions

{table(("edit", "its own fields", "meaning"), rows)}
## Edits of a what-if

A JSON object for `whatif --edits`: what is changed of a frame's objects before the question is asked again. `whatif`
without edits lists the keys of the objects. The format is `{edits.FORMAT}`.

{class_tables(edits.Edits, 3, _own(edits.__name__, "pipeline.geometry.masks"))}"""


def marks_part() -> str:
    """Return a file of marks."""
    said = meanings.of_keys(marks, "_KEYS")
    rows = ((code(name), "text", "required", cell(said.get(name, ""))) for name in marks._KEYS)
    return f"""## Marks

A JSON list for `eval --marks`: expressions whose label or box a person found wrong. A mark is
{" or ".join(code(m) for m in marks.MARKS)}; further keys are left alone.

{table(HEAD, rows)}"""


def journal_part() -> str:
    """Return the journal's columns, and what can be corrected."""
    said = meanings.of_class(events.Event) | meanings.of_class(field_refs.FieldRef)
    given = meanings.of_keys(chain, "CONTENT")
    said["hash"] = " ".join((chain.link.__doc__ or "").split("\n\n")[0].split())
    rows = ((code(n), cell(given.get(n) or said.get(n, ""))) for n in (*chain.CONTENT, "hash"))
    can = ((code(kind), ", ".join(map(code, found))) for kind, found in field_refs.FIELDS.items())
    return f"""## Journal

The corrections of labels: `corrections.sqlite` in the labels folder, or a PostgreSQL database. Events are only added.
Each holds the SHA-256 of the event before, so that damage is found when the journal is opened. The tables have version
{chain.VERSION}; a journal of version 1 is carried over when it is first written to, and a copy of it is kept. `journal
--json` prints the same fields.

### Columns of an event

{table(("column", "meaning"), rows)}
### What can be corrected

{table(("kind", "fields"), can)}"""


def settings_part() -> str:
    """Return the keys of `spatialviz.toml`."""
    kinds = {f.name: f"{f.type}" for f in fields(settings.Settings)}
    said = meanings.of_class(settings.Settings)
    words = {"float": "number", "str": "text", "int": "whole number", "GivenUp": "text"}

    def kind(name: str) -> str:
        if name in settings.MEANT or name == "color_turned":
            return " or ".join(code(v) for v in settings.MEANT.get(name, settings.TURNS))
        first = kinds[name].removesuffix(" | None")
        count = first.count("float")
        return words.get(first) or ("table of 3 numbers" if "Mapping" in first else f"{max(count, 7)} numbers"
                                    if "..." in first else f"{count} numbers")  # fmt: skip

    rows = ((code(n), kind(n), cell(said.get(n, ""))) for n in (*settings.KEYS, settings.LIMITS_TABLE)
            if n != settings.LIMITS_TABLE)  # fmt: skip
    return f"""## {settings.FILE_NAME}

Beside the pictures of a recording: what its files do not say of the camera, the depth and up. `frames --remember` and
`doctor --apply` write it. Every key may be left out; an unknown one is an error. A table `[{settings.LIMITS_TABLE}]`
raises [limits](../limits.md) for this dataset; other tables are for people.

{table(("key", "type", "meaning"), rows)}"""


def networks_part() -> str:
    """Return the TOML files beside networks."""
    return f"""## Networks of your own

A TOML file beside an ONNX file says what its tensors hold. An unknown key is an error.

### Detector of boxes

Read with `--detector boxes`: `MODEL.toml` beside `MODEL.onnx`. [Detectors](../detectors.md) shows whole files.

{class_tables(BoxModel, 4)}
### Depth network

Read with `--depth-model FILE.onnx`. [Depth without a depth camera](../depth.md) shows whole files.

{class_tables(DepthContract, 4)}"""


def views_part() -> str:
    """Return a view as a string."""
    return f"""## View strings

A view of the page as text, for `view --state`: `sv{state.VERSION}:`, then URL-safe base64 of a zlib stream of this as
JSON. A string of another version is refused.

{class_tables(state.ViewState, 3, _own(state.__name__))}
[Edits](#edits-of-a-what-if) are those of a what-if.
"""


PARTS_OF_ANSWERS = {
    "The whole": ("", (json_records, ("trace_record",)), (answer, ("Answer.record",))),
    "expression": ("expression", (json_records, ("expression_record", "trace_record"))),
    "tree": ("expression.tree", (json_records, ("noun_record",))),
    "answer": ("answer", (json_records, ("_best_record", "pair_record"))),
    "pairs": ("pairs", (json_records, ("pair_record",))),
    "links": ("pairs.links", (json_records, ("_link_record",))),
    "proposals": ("proposals", (json_records, ("object_record", "trace_record"))),
    "quality": ("proposals.quality", (json_records, ("object_record",))),
    "viewer": ("viewer", (json_records, ("viewer_record",))),
    "ranking": ("ranking", (json_records, ("trace_record",))),
    "stages": ("stages", (answer, ("Stage.record",))),
    "verdict": ("verdict", (story_words, ("story_record",)), (answer, ("diagnosis_record",))),
    "needed": ("verdict.needed", (answer, ("_needed_record",))),
}
"""Parts of `ask --json`: where each stands, and the functions whose keys it has."""
INSIDE = ("answer", "quality", "ranking", "needed")
"""Those that are only a part of what their function makes."""
QUESTIONS = (
    "mug left of the laptop",
    "the white mug left of the laptop that is on the table",
    "the second mug from the left",
    "mgu left of the laptop",
    "mug between the laptop and the book",
    "from the door, the mug not left of the shiny laptop",
)


@functools.cache
def answers() -> tuple[dict[str, Any], ...]:
    """Return answers of the demo as JSON, whose keys differ: annotations, its simulated detector, refused questions."""
    run = pipeline.open_run(demo_run())
    failures = run.failures()
    demo = pipeline.open("demo")
    return (
        *(demo.ask(0, text).record() for text in QUESTIONS),
        *(failures[k].answer.record() for k in range(0, min(len(failures), 60), 12)),
    )


def parts_at(record: Any, place: str) -> Iterator[dict[str, Any]]:
    """Yield the objects of JSON at a place such as "pairs.links", in each entry of a list."""
    if isinstance(record, list):
        for one in record:
            yield from parts_at(one, place)
    elif isinstance(record, dict):
        first, _, rest = place.partition(".")
        if not first:
            yield record
        elif first in record:
            yield from parts_at(record[first], rest)


def answers_part() -> str:
    """Return the keys of `ask --json`."""
    parts = [
        """## Answers as JSON

What `ask --json` prints, an object an expression. Keys that have nothing to say are left out; the types are those of
answers on the demo.
"""
    ]
    for title, (place, *makers) in PARTS_OF_ANSWERS.items():
        seen = [one for record in answers() for one in parts_at(record, place)]
        said: dict[str, str] = {}
        for module, functions in makers:
            said = {**meanings.of_keys(module, *functions), **said}
        names = dict.fromkeys(name for one in seen for name in one)
        if title not in INSIDE:
            names |= dict.fromkeys(n for module, of in makers for n in meanings.left_out(module, of[0]))
        rows = ((code(n), json_type(one[n] for one in seen if n in one), cell(said.get(n, ""))) for n in names)
        at = f"`{place}`\n\n" if "." in place else ""
        parts += [f"### {title}\n\n{at}{table(('key', 'type', 'meaning'), rows)}"]
    return "\n".join(parts)


def page() -> str:
    """Return the page's Markdown."""
    parts = (labels_part, runs_part, predictions_part, cases_part, edits_part, marks_part, journal_part, settings_part,
             networks_part, views_part, answers_part)  # fmt: skip
    return "\n".join((INTRO, *(part() for part in parts)))
