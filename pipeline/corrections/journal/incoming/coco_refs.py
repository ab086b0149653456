"""Corrections in the two other files of a COCO export: `refs.json` and `relations.json`.

Both name annotations: `instances.json` of the same export must stand beside
them, and say of which object each is.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from pipeline.corrections.journal.field_refs import relation_cell
from pipeline.corrections.journal.incoming.claims import Claims
from pipeline.corrections.journal.incoming.coco_file import expression_cell, images_of, listed, number_of
from pipeline.corrections.journal.incoming.jsonl_file import check_pair
from pipeline.labels.exports.provenance import ExportedFrom
from pipeline.language.relation_names import PAIRWISE
from pipeline.system.errors import InputError

Annotations = dict[int, tuple[str, int]]
"""Frame and object of annotations, by id."""
StateOf = Callable[[Any], ExportedFrom]


def annotated(instances: Any, name: str, claims: Claims) -> tuple[dict[int, str], Annotations, Any]:
    """Frames by image, objects by annotation, and the state that `info` names.

    Raises
    ------
    InputError
        No COCO, or annotations that do not say which object they are of.
    """
    frames = images_of(listed(instances, "images", name), name, claims)
    found: Annotations = {}
    for row in listed(instances, "annotations", name):
        number = number_of(row) if isinstance(row, dict) else None
        if number is not None and row.get("image_id") in frames and type(row.get("id")) is int:
            found[row["id"]] = frames[row["image_id"]], number
    info = instances.get("info")
    return frames, found, info.get("base") if isinstance(info, dict) else None


def read_refs(
    refs: Any, name: str, frames: dict[int, str], annotations: Annotations, state: ExportedFrom, claims: Claims
) -> None:
    """Read `refs.json`: sentences, answers, marks and statuses."""
    if not isinstance(refs, list):
        raise InputError(f"{name} is a list", got=type(refs).__name__)
    seen: set[tuple[str, str]] = set()
    for place, ref in enumerate(refs):
        where = f"{name} ref {ref.get('ref_id') if isinstance(ref, dict) else place!r}"
        try:
            if not isinstance(ref, dict) or type(ref.get("image_id")) is not int or ref["image_id"] not in frames:
                raise InputError("it is of no image that instances.json lists")
            frame, own = frames[ref["image_id"]], ref.get("id")
            if not isinstance(own, str) or own not in claims.base(frame, state).auto.expressions:
                raise InputError(f"frame {frame} has no such expression", got=repr(own)[:60])
            if (frame, own) in seen:
                raise InputError("the second one of its expression")
            seen.add((frame, own))
            claims.compared += 1
            if "sentences" in ref:
                claims.say(where, expression_cell(frame, own, "text"), _raw(ref["sentences"]), state)
            for key, field in (("target_ann_ids", "targets"), ("acceptable_ann_ids", "acceptable")):
                if key in ref:
                    numbers = _objects(ref[key], frame, annotations, key)
                    claims.say(where, expression_cell(frame, own, field), numbers, state)
            for field in ("ambiguous", "mark", "status"):
                if field in ref:
                    claims.say(where, expression_cell(frame, own, field), ref[field], state)
        except InputError as error:
            claims.problem(where, error)


def _raw(sentences: Any) -> Any:
    first = sentences[0] if isinstance(sentences, list) and sentences else None
    if not isinstance(first, dict):
        raise InputError("sentences is a list of sentences", got=repr(sentences)[:40])
    return first.get("raw")


def _objects(ids: Any, frame: str, annotations: Annotations, what: str) -> list[int]:
    if not isinstance(ids, list) or not all(type(n) is int for n in ids):
        raise InputError(f"{what} is a list of annotations", got=repr(ids)[:40])
    for n in ids:
        if annotations.get(n, ("", 0))[0] != frame:
            raise InputError(f"{what} names annotation {n}, which instances.json does not give an object of this image")
    return [annotations[n][1] for n in ids]


def read_relations(
    content: Any, name: str, frames: dict[int, str], annotations: Annotations, state: ExportedFrom, claims: Claims
) -> None:
    """Read `relations.json`: the columns of states."""
    seen: set[int] = set()
    for place, image in enumerate(listed(content, "images", name)):
        where = f"{name} image {image.get('image_id') if isinstance(image, dict) else place!r}"
        try:
            if not isinstance(image, dict) or type(image.get("image_id")) is not int:
                raise InputError("it has no image_id")
            if image["image_id"] not in frames or image["image_id"] in seen:
                raise InputError("it is of no image that instances.json lists, or of one a second time")
            seen.add(image["image_id"])
            _columns(image, where, frames[image["image_id"]], annotations, state, claims)
        except InputError as error:
            claims.problem(where, error)


def _columns(
    image: dict[str, Any], where: str, frame: str, annotations: Annotations, state: ExportedFrom, claims: Claims
) -> None:
    a, b = (_objects(image.get(end), frame, annotations, end) for end in ("a", "b"))
    base = claims.base(frame, state)
    relations = [r for r in PAIRWISE if r in image]
    for relation in relations:
        if not isinstance(image[relation], list) or len(image[relation]) != len(a):
            raise InputError(f"the column {relation!r} has not one state a pair")
    if len(a) != len(b) or len(set(zip(a, b, strict=True))) != len(a):
        raise InputError("the columns a and b do not give each pair once")
    claims.compared += len(a)
    for m, n in zip(a, b, strict=True):
        check_pair(base, m, n)
    for relation in relations:
        for m, n, said in zip(a, b, image[relation], strict=True):
            if said == base.pairs.state(m, n, relation) and type(said) in (int, type(None)):
                continue
            if relation not in base.setting.relations:
                raise InputError(f"the labels hold no relation {relation!r}")
            claims.say(f"{where}, pair {m},{n}", relation_cell(frame, m, n, relation), said, state)
    if "statuses" in image:
        _statuses(image["statuses"], where, frame, annotations, state, claims)


def _statuses(
    statuses: Any, where: str, frame: str, annotations: Annotations, state: ExportedFrom, claims: Claims
) -> None:
    base = claims.base(frame, state)
    found: dict[Any, Any] = {}
    for entry in statuses if isinstance(statuses, list) else [None]:
        if not isinstance(entry, dict) or entry.get("relation") not in base.setting.relations:
            raise InputError("statuses is a list of {a, b, relation, status}", got=repr(entry)[:60])
        m, n = _objects([entry.get("a"), entry.get("b")], frame, annotations, "statuses")
        found[relation_cell(frame, m, n, f"{entry['relation']}.status")] = entry.get("status")
    # One that was exported and is not listed any more was taken off.
    gone = [c for c in base.statuses if c.kind == "relation" and c not in found]
    for cell, status in (*found.items(), *((c, None) for c in gone)):
        claims.say(where, cell, status, state)
