"""The JSON Schemas of the labels as files, kept under the schema's version.

Written anew after a change of `pipeline.labels.schema` by

    python -m pipeline.labels.schema_files
"""

from __future__ import annotations

import json
from pathlib import Path

from pipeline.labels.schema import SCHEMA_VERSION, json_schemas

SCHEMA_FOLDER = Path(__file__).with_name("schemas") / SCHEMA_VERSION


def schema_text(schema: dict[str, object]) -> str:
    """A schema as it stands in its file."""
    return json.dumps(schema, indent=1, ensure_ascii=False) + "\n"


def write_schemas(folder: Path = SCHEMA_FOLDER) -> tuple[Path, ...]:
    """Write one file a table, and one for the manifest."""
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for name, schema in json_schemas().items():
        written.append(folder / f"{name}.json")
        written[-1].write_text(schema_text(schema), encoding="utf-8", newline="\n")
    return tuple(written)


if __name__ == "__main__":
    for path in write_schemas():
        print(path)
