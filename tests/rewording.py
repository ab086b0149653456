"""Other sentences for expressions of merged labels: as a person said them, whether the parser can read them or not."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pipeline.labels.merge import write_manifest, write_merged
from pipeline.labels.reading import MANIFEST_FILE, Labels, open_labels
from pipeline.system.arrow import pa
from pipeline.system.errors import InputError, as_input_error, require
from pipeline.system.safe_files import read_json
from pipeline.system.whole_files import temporary_folder


def read_sentences(path: Path) -> dict[tuple[str, str], str]:
    """Sentences by (frame, id of the expression), from JSON: a list of {"frame", "id", "text"}.

    Raises
    ------
    InputError
        The file cannot be read, or an entry lacks one of these.
    """
    with as_input_error("the sentences cannot be read", OSError, ValueError, RecursionError, got=str, path=path):
        entries: Any = read_json(Path(path))
    keys = ("frame", "id", "text")
    require(
        isinstance(entries, list)
        and all(isinstance(e, dict) and all(isinstance(e.get(k), str) for k in keys) for e in entries),
        'sentences must be a list of {"frame", "id", "text"}, all texts',
        path=path,
    )
    return {(e["frame"], e["id"]): e["text"] for e in entries}


def reword(folder: Path, sentences: Mapping[tuple[str, str], str]) -> int:
    """Put other sentences in place of those of merged labels; the triples and the truth stay. How many there were.

    Raises
    ------
    InputError
        No labels, or an expression that they do not have.
    """
    labels = open_labels(folder)
    table = labels.expressions
    keys = list(zip(*(table.column(n).to_pylist() for n in ("frame", "id")), strict=True))
    unknown = set(sentences) - set(keys)
    require(not unknown, "the labels have no such expression", got=" ".join(min(unknown, default=())), path=folder)
    texts = [sentences.get(key, text) for key, text in zip(keys, table.column("text").to_pylist(), strict=True)]
    index = table.schema.get_field_index("text")
    table = table.set_column(index, table.schema.field(index), pa.array(texts, pa.string()))
    with temporary_folder(folder / "reworded") as staging:
        tables = {**labels.manifest.tables, "expressions": write_merged(staging, "expressions", iter([table]))}
        manifest = labels.manifest.model_copy(update={"tables": tables})
        # Without a manifest there are no labels: a crash in between leaves nothing half new.
        (folder / MANIFEST_FILE).unlink()
        (staging / "expressions.parquet").replace(folder / "expressions.parquet")
        write_manifest(Labels(folder, manifest))
    return len(sentences)


if __name__ == "__main__":
    import sys

    if len(sys.argv) != 3:
        sys.exit("usage: python tests/rewording.py LABELS SENTENCES.json")
    try:
        print(f"{reword(Path(sys.argv[1]), read_sentences(Path(sys.argv[2])))} sentences")
    except InputError as error:
        sys.exit(str(error))
