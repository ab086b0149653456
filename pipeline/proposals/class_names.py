"""The class names of a network of a fixed vocabulary: where they are written, and which of them a query means."""

from __future__ import annotations

import ast
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import xxhash

from pipeline.language.naming import Synonyms, default_synonyms, match
from pipeline.proposals.base import unknown_class
from pipeline.system.errors import InputError
from pipeline.system.onnx_session import metadata

ADVICE = "all: `spatialviz models FILE`; another name for one: --synonyms FILE with {{\"groups\": [[{}, NAME]]}}"


def wanted_names(
    labels: Sequence[str] | None, vocabulary: Sequence[str], synonyms: Synonyms | None, where: str
) -> list[str]:
    """The names of the vocabulary that a query means, without repeats; all of them for None.

    Raises
    ------
    UnknownClass
        Where one of the labels means none of them.
    """
    if labels is None:
        return list(dict.fromkeys(vocabulary))
    wanted: dict[str, None] = {}
    for label in labels:
        matched = match(label, vocabulary, synonyms)
        if not matched:
            raise unknown_class(label, vocabulary, where, ADVICE.format(json.dumps(label)))
        wanted |= dict.fromkeys(matched)
    return list(wanted)


def synonyms_hash(synonyms: Synonyms | None) -> str:
    """Hash of what decides which names a query means, for fingerprints."""
    table = synonyms or default_synonyms()
    content = (sorted(sorted(group) for group in table.groups), sorted(table.exceptions))
    return xxhash.xxh3_64_hexdigest(repr(content).encode())


def names_hash(names: Sequence[str]) -> str:
    """Hash of class names in their order, for fingerprints."""
    return xxhash.xxh3_64_hexdigest("\x1f".join(names).encode())


def metadata_names(session: Any) -> tuple[str, ...] | None:
    """The class names in a file's metadata, as Ultralytics writes them; None where there are none."""
    text = metadata(session).get("names", "")
    try:
        names = ast.literal_eval(text)
    except (ValueError, TypeError, SyntaxError, MemoryError, RecursionError):
        return None
    if isinstance(names, dict):
        # Where the names went through JSON, their numbers became words.
        names = [names.get(i, names.get(str(i))) for i in range(len(names))]
    if not isinstance(names, list | tuple) or not names or not all(isinstance(n, str) for n in names):
        return None
    return tuple(str(n) for n in names)


def read_class_names(path: Path) -> tuple[str, ...]:
    """Class names from a file, in the order of the network's outputs.

    Parameters
    ----------
    path : Path
        A text file with one name a line; or a JSON file: a list of names, or an object whose `categories` are
        objects with `id` and `name`, as the annotation files of COCO and LVIS have them, taken by rising `id`.

    Raises
    ------
    InputError
        Where the file cannot be read, or holds something else.
    """
    try:
        # Some editors put a mark before the first name. Lines end as files have it: other breaks may be in a name.
        text = path.read_text(encoding="utf-8-sig")
        names: Any = json.loads(text) if path.suffix.lower() == ".json" else text.split("\n")
    except (OSError, ValueError, RecursionError) as error:
        raise InputError("the class names cannot be read", got=str(error), path=path) from error
    if isinstance(names, dict):
        names = _of_categories(names.get("categories"))
    elif path.suffix.lower() != ".json":
        names = [n.strip() for n in names]
        while names and not names[-1]:
            names.pop()
    if not isinstance(names, list) or not names or not all(isinstance(n, str) and n.strip() for n in names):
        raise InputError(
            "the file holds no list of class names",
            expected="one name a line, a JSON list, or the categories of a COCO or LVIS file",
            path=path,
        )
    return tuple(names)


def _of_categories(categories: Any) -> list[str] | None:
    """Networks number the classes without the gaps that COCO's ids have."""
    if not isinstance(categories, list):
        return None
    try:
        return [c["name"] for c in sorted(categories, key=lambda c: c["id"])]
    except (KeyError, TypeError):
        return None
