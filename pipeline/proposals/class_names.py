"""Class names of detectors: files, matching to queries, and equality of names."""

from __future__ import annotations

import ast
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import xxhash

from pipeline.language.naming import Synonyms, default_synonyms, match, same_or_kind
from pipeline.proposals.base import Detector, unknown_class
from pipeline.system.errors import as_input_error, require
from pipeline.system.onnx_session import metadata
from pipeline.system.safe_files import parse_json, read_text

ADVICE = 'all: `spatialviz models FILE`; another name for one: --synonyms FILE with {{"groups": [[{}, NAME]]}}'


def wanted_names(
    labels: Sequence[str] | None, vocabulary: Sequence[str], synonyms: Synonyms | None, where: str
) -> list[str]:
    """Names of the vocabulary meant by a query, without repeats; all for None."""
    if labels is None:
        return list(dict.fromkeys(vocabulary))
    meant = [meant_names(label, vocabulary, synonyms, where, ADVICE.format(json.dumps(label))) for label in labels]
    return list(dict.fromkeys(name for names in meant for name in names))


def meant_names(
    label: str, known: Sequence[str], synonyms: Synonyms | None, where: str, advice: str | None = None
) -> tuple[str, ...]:
    """Known names meant by a label; UnknownClass, naming `where`, if none."""
    meant = match(label, known, synonyms)
    if not meant:
        raise unknown_class(label, known, where, advice)
    return meant


def synonyms_hash(synonyms: Synonyms | None) -> str:
    """Hash of the synonyms, for fingerprints."""
    return (synonyms or default_synonyms()).fingerprint


def names_hash(names: Sequence[str]) -> str:
    """Hash of class names in their order, for fingerprints."""
    return xxhash.xxh3_64_hexdigest("\x1f".join(names).encode())


def metadata_names(session: Any) -> tuple[str, ...] | None:
    """Class names in a file's metadata, as written by Ultralytics; else None."""
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
    """Class names from a file, in the order of the network's outputs."""
    with as_input_error("the class names cannot be read", OSError, ValueError, got=str, path=path):
        # Some editors put a mark before the first name. Lines end as files have it: other breaks may be in a name.
        text = read_text(path, "utf-8-sig")
        names: Any = parse_json(text, path) if path.suffix.lower() == ".json" else text.split("\n")
    if isinstance(names, dict):
        names = _of_categories(names.get("categories"))
    elif path.suffix.lower() != ".json":
        names = [n.strip() for n in names]
        while names and not names[-1]:
            names.pop()
    require(
        isinstance(names, list) and names and all(isinstance(n, str) and n.strip() for n in names),
        "the file holds no list of class names",
        expected="one name a line, a JSON list, or the categories of a COCO or LVIS file",
        path=path,
    )
    return tuple(names)


def _of_categories(categories: Any) -> list[str] | None:
    """Category names by rising id; networks number classes without the gaps of COCO's ids."""
    if not isinstance(categories, list):
        return None
    try:
        return [c["name"] for c in sorted(categories, key=lambda c: c["id"])]
    except (KeyError, TypeError):
        return None


def known_names(detector: Detector) -> tuple[str, ...] | None:
    """Names of a detector asked for everything; None for any name."""
    if detector.vocabulary is not None:
        return detector.vocabulary
    found: object = detector
    while found is not None:
        names = getattr(found, "default_labels", None)
        if names is not None:
            return tuple(names)
        # What wraps a detector (a cache, a segmenter) has it as this attribute.
        found = getattr(found, "detector", None)
    return None


def knows(names: Sequence[str] | None, label: str, synonyms: Synonyms | None = None) -> bool:
    """Test whether a detector with these names (None: any) could find `label`."""
    return names is None or bool(match(label, names, synonyms))


def same_name(a: str, b: str, synonyms: Synonyms | None = None) -> bool:
    """Test whether two names mean the same class, or a kind of the other ("cracker box" and "box").

    Examples
    --------
    >>> from pipeline.proposals import same_name
    >>> same_name("cracker box", "box"), same_name("mug", "laptop")
    (True, False)
    """
    return a == b or same_or_kind(a, b, synonyms)


def is_cut(piece: str, name: str) -> bool:
    """Tell whether a text is most of a name that was cut within a word, at its end or its start.

    A piece of one word could be another thing ("table" of "tablet"), and is no cut name.

    >>> from pipeline.proposals.class_names import is_cut
    >>> is_cut("potted pl", "potted plant"), is_cut("tted plant", "potted plant"), is_cut("table", "tablet")
    (True, True, False)
    """
    piece, name = (" ".join(text.casefold().split()) for text in (piece, name))
    if len(piece) < max(4, 0.6 * len(name)) or len(piece) >= len(name) or " " not in piece:
        return False
    ends = name.startswith(piece) and name[len(piece)] != " " and piece[-1:] != " "
    starts = name.endswith(piece) and name[-len(piece) - 1] != " "
    return ends or starts


def name_groups(names: Sequence[str], synonyms: Synonyms | None = None) -> dict[str, str]:
    """Representative of each name: shorter names first, each joins the first equal name.

    It does not depend on the order of `names`.
    """
    chosen: list[str] = []
    stands: dict[str, str] = {}
    for name in sorted(set(names), key=lambda n: (len(n), n)):
        stands[name] = next((c for c in chosen if same_name(c, name, synonyms)), name)
        if stands[name] == name:
            chosen.append(name)
    return stands
