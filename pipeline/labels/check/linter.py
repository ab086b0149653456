"""Checking labels: every rule on every frame, one frame in memory at a time.

The rules on rows as such are here (values, keys, references, and the frame's own camera), those on whole files
(readable, of the schema, as they were written, made by rules that are still the same), and those on the up vector:
something must say where up is, and the posed frames of a scene agree.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.datasets.settings import ASSUMED
from pipeline.datasets.up import OFF_SCENE
from pipeline.labels.check.expressions import TEXTS_KEPT, check_expressions, triple_of
from pipeline.labels.check.objects import (
    SizeSurvey,
    check_depth,
    check_duplicates,
    check_objects,
    check_sizes,
    rotation_fault,
)
from pipeline.labels.check.other_views import OtherViews
from pipeline.labels.check.relations import EXPECTED, check_geometry, check_relations
from pipeline.labels.check.stream import Rows, column_arrays, frame_rows, no_rows
from pipeline.labels.check.view import RULES, Figure, Finding, FrameView, chosen_rules
from pipeline.labels.frame_stream import by_frame, frame_blocks
from pipeline.labels.profiles import PROFILES
from pipeline.labels.reading import Labels, RowHash, provenance_rows
from pipeline.labels.schema import KEYS, TABLES, Manifest
from pipeline.language.naming import normal_form
from pipeline.language.relation_names import PAIRWISE
from pipeline.system.errors import InputError, as_input_error, first_line
from pipeline.system.whole_files import sha256_of

if TYPE_CHECKING:
    from pipeline.labels.check.other_masks import OtherMasks

OF_ANSWERS = (
    "expression/empty",
    "expression/sets",
    "expression/ambiguous",
    "expression/unreadable",
    "expression/state",
    "expression/article",
)
"""Rules on what an expression says and is true of, which a person may settle."""


def check_labels(
    labels: Labels, *, rules: Sequence[str] | None = None, masks: OtherMasks | None = None
) -> Iterator[Finding]:
    """Check labels, even damaged or edited.

    What people set in corrected labels is not held against the rules.

    The tables are read twice: first as files, with class names and sizes of the objects; then frame by frame. Memory
    grows with classes, not with frames.

    `rules`: names of rules or of groups ("relation"); all by default. `masks`: a new comparison of the labels' masks,
    see `other_masks`; without it they are not compared. Yields first of whole files, then frame by frame.

    Raises InputError: a rule has no such name; before anything is read.
    """
    chosen, by_people = chosen_rules(rules), set_by_people(labels.root)
    found = _all_findings(labels, frozenset(rule.split("/")[0] for rule in chosen), chosen, masks)
    return (finding for finding in found if finding.rule in chosen and not _settled(finding, by_people))


def set_by_people(root: Path) -> set[tuple[Any, ...]]:
    """Relations (frame, a, b, relation) and expressions (frame, id) that people set, or ruled out by what they set.

    Raises InputError: the provenance of the labels is damaged.
    """
    found: set[tuple[Any, ...]] = set()
    with as_input_error(
        "the provenance of the labels is damaged", ValueError, AttributeError, got=first_line, path=root
    ):
        for row in provenance_rows(root):
            human = row["origin"] == "human"
            # A relation that was ruled out follows from no geometry, and neither does its pair's.
            if row["table"] == "relations" and (human or (row["origin"] == "recomputed" and row["was"] == "1")):
                found.add((row["frame"], *map(int, row["key"].split(",")), row["column"]))
            elif row["table"] == "expressions" and human:
                found.add((row["frame"], row["key"]))
    return found


def _settled(finding: Finding, by_people: set[tuple[Any, ...]]) -> bool:
    if finding.rule == "relation/geometry":
        return (finding.frame, *finding.objects, finding.figures.get("relation")) in by_people
    return finding.rule in OF_ANSWERS and (finding.frame, finding.figures.get("id")) in by_people


def _all_findings(
    labels: Labels, groups: frozenset[str], chosen: frozenset[str], masks: OtherMasks | None
) -> Iterator[Finding]:
    manifest, profile = labels.manifest, str(labels.manifest.profile.get("name"))
    class_names: set[str] = set()
    survey = SizeSurvey()
    lost: set[str] = set()
    for name in TABLES:
        digest = RowHash(name)
        try:
            for block in frame_blocks(labels, name):
                digest.update(block)
                if name == "objects":
                    class_names |= set(block.column("label").unique().to_pylist())
                    survey.add(column_arrays(block, name))
        except InputError as error:
            lost.add(name)
            yield _finding("file/unreadable", str(error), {"table": name})
        else:
            yield from _changed(labels, name, digest)
    yield from check_profile(manifest)
    # What rests on a table that cannot be read would be one error a row.
    if lost & {"frames", "objects"}:
        return
    groups -= {"relation", "expression"} if "relations" in lost else {"expression"} if "expressions" in lost else set()
    expected_of = EXPECTED[profile] if profile_problem(manifest) is None else None
    background = frozenset(normal_form(str(b)) for b in manifest.config.get("background", ()))
    relations = tuple(r for r in manifest.config.get("relations", ()) if r in PAIRWISE)
    read = lru_cache(TEXTS_KEPT)(partial(triple_of, tuple(sorted(class_names))))
    scenes: dict[str, list[tuple[str | None, np.ndarray]]] = {}
    others = OtherViews()
    masks = masks if "object/other-masks" in chosen else None
    sound = (frame_rows(labels, name, checked="row" in groups) for name in TABLES if name not in lost)
    for index, tables in by_frame(*sound):
        view = FrameView(index, {name: tables.get(name) or no_rows(name) for name in TABLES}, background, relations)
        if groups & {"object", "relation"}:
            others.add(view)
        if masks is not None:
            yield from masks.add(view)
        if groups & {"row", "frame", "object"}:
            yield from check_rows(view)
        if "frame" in groups:
            yield from check_up(view, scenes)
            yield from check_depth(view)
        if "object" in groups:
            yield from check_objects(view)
            if "object/duplicate" in chosen:
                yield from check_duplicates(view)
            yield from check_sizes(view, survey)
        if "relation" in groups:
            expected = None if expected_of is None or not len(view.ids) else expected_of(view)
            yield from check_relations(view, expected, profile)
            if expected is not None:
                yield from check_geometry(view, expected)
        if "expression" in groups:
            yield from check_expressions(view, read)
    yield from check_scenes(scenes)
    yield from others.findings()
    if masks is not None:
        yield from masks.findings()


DISAGREE_DEG = 10.0
"""Ups of one scene that are further apart are not one: the undecided band of a relation's cone is 10 degrees wide."""


def check_up(view: FrameView, scenes: dict[str, list[tuple[str | None, np.ndarray]]]) -> Iterator[Finding]:
    """Find ups that are assumed or doubted; those of posed frames are added to their scene's."""
    frames = view.tables["frames"]
    if not view.usable or view.viewer is None:
        return
    if frames["up_source"][0] == "assumed":
        yield view.finding("frame/up-assumed", (), ASSUMED)
        return
    for note in frames["notes"][0]:
        if OFF_SCENE in note:
            yield view.finding("frame/up-disagrees", (), note)
    pose = frames["T_world_camera"][0].reshape(4, 4)
    if np.isfinite(pose).all():
        scenes.setdefault(frames["scene"][0], []).append((view.id, pose[:3, :3] @ view.viewer.up))


def check_scenes(scenes: dict[str, list[tuple[str | None, np.ndarray]]]) -> Iterator[Finding]:
    """Find frames with another up than most of their scene."""
    for scene, ups in scenes.items():
        vectors = np.array([up / max(np.linalg.norm(up), 1e-9) for _, up in ups])
        apart = np.degrees(np.arccos(np.clip(vectors @ vectors.T, -1, 1)))
        most = int((apart <= DISAGREE_DEG).sum(axis=1).argmax())
        agreeing = int((apart[most] <= DISAGREE_DEG).sum())
        for k in np.flatnonzero(apart[most] > DISAGREE_DEG):
            off = round(float(apart[most, k]), 1)
            message = f"its up is {off:g} degrees off that of {agreeing} of the {len(ups)} frames of {scene}"
            figures: dict[str, Figure] = {"degrees": off, "agreeing": agreeing, "frames": len(ups)}
            yield Finding("frame/up-disagrees", "warning", ups[k][0], (), message, figures)


def _finding(rule: str, message: str, figures: dict[str, Figure]) -> Finding:
    return Finding(rule, RULES[rule], None, (), message, figures)


def _changed(labels: Labels, name: str, found: RowHash) -> Iterator[Finding]:
    record = labels.manifest.tables.get(name)
    if record is None:
        yield _finding("file/changed", f"the manifest does not know {name}.parquet", {"table": name})
        return
    figures: dict[str, Figure] = {"table": name, "rows": found.rows, "rows_in_manifest": record.rows}
    same = (found.rows, found.hexdigest()) == (record.rows, record.content_hash)
    if sha256_of(labels.root / f"{name}.parquet") != record.sha256:
        what = "was written anew with the same rows" if same else "was changed after it was written"
        yield _finding("file/changed", f"{name}.parquet {what}", figures)
    elif not same:
        yield _finding("file/changed", f"the manifest's rows or hash of {name}.parquet were changed", figures)


def profile_problem(manifest: Manifest) -> str | None:
    """Reason against comparing geometry under the manifest's profile, or None."""
    name = str(manifest.profile.get("name"))
    if name not in PROFILES:
        return f"this release has no rule profile {name!r}"
    parameters = json.dumps(manifest.profile.get("parameters"), sort_keys=True)
    if parameters != json.dumps(PROFILES[name].parameters, sort_keys=True):
        return f"the manifest lists other thresholds for {name!r} than this release"
    if manifest.profile_hash not in PROFILES[name].hashes:
        return f"the labels were made with other rules under the name {name!r}"
    return None


def check_profile(manifest: Manifest) -> Iterator[Finding]:
    """Compare the rules of the labels with this release's."""
    problem = profile_problem(manifest)
    if problem is not None:
        name = str(manifest.profile.get("name"))
        release = PROFILES[name].hash if name in PROFILES else ""
        figures: dict[str, Figure] = {"profile": name, "labels": manifest.profile_hash, "release": release}
        yield _finding("profile/changed", f"{problem}: states are not compared with geometry", figures)


ROTATION_TOLERANCE = 1e-3
"""Greatest entry of R R^T - I: what datasets write with four decimals stays below it."""
NAMED_OBJECTS = {
    "frames": (),
    "objects": ("object",),
    "relations": ("a", "b"),
    "expressions": ("target_object", "reference_object"),
}
"""The columns of a table that name objects."""


def check_rows(view: FrameView) -> Iterator[Finding]:
    """Faults of rows as such, without their meaning."""
    for table, rows in view.tables.items():
        of_row = partial(_of_row, view, table)
        yield from (of_row(v.rule, v.row, v.message, {"column": v.column}) for v in rows.violations)
        yield from (of_row("row/duplicate-key", row, "a second row has this key") for row in _repeated(table, rows))
        yield from _references(view, table, rows, of_row)
    frames, objects = view.tables["frames"], view.objects
    if len(frames) and int(frames["objects"][0]) != len(objects):
        message = f"the frame is said to have {frames['objects'][0]} objects, and {len(objects)} are listed"
        yield view.finding("frame/objects", (), message, {"stated": frames["objects"][0], "listed": len(objects)})
    yield from _camera(view)
    for prefix in ("", "exact_"):
        yield from _rotations(view, prefix)


def _of_row(
    view: FrameView, table: str, rule: str, row: int | None, message: str, figures: dict[str, Figure] | None = None
) -> Finding:
    rows = view.tables[table]
    objects = () if row is None else tuple(int(rows[name][row]) for name in NAMED_OBJECTS[table])
    return view.finding(rule, objects, f"{table}: {message}", {"table": table, **(figures or {})})


def _repeated(table: str, rows: Rows) -> list[int]:
    """Rows with the key of an earlier row."""
    columns = [rows[name] for name in KEYS[table][1:]] if len(rows) > 1 else []
    codes = [np.unique(c.astype(str), return_inverse=True)[1] if c.dtype == object else c for c in columns]
    keys = np.stack([np.zeros(len(rows), np.int64), *codes], axis=1)
    return np.setdiff1d(np.arange(len(rows)), np.unique(keys, axis=0, return_index=True)[1]).tolist()


def _references(view: FrameView, table: str, rows: Rows, of_row: Callable[..., Finding]) -> Iterator[Finding]:
    """Frames and objects named by rows and missing."""
    frames = view.tables["frames"]
    if table == "frames" or not len(rows):
        return
    if not len(frames):
        message = f"{len(rows)} rows are of frame number {view.index}, which does not exist"
        yield of_row("row/dangling", None, message, {"rows": len(rows), "frame_index": view.index})
    else:
        for row in np.flatnonzero(rows["frame"] != frames["frame"][0]).tolist():
            name = f"{rows['frame'][row]!r}, its number is that of {frames['frame'][0]!r}"
            yield of_row("row/dangling", row, f"the row names frame {name}")
    if table == "objects":
        return
    named = np.stack([rows[name] for name in NAMED_OBJECTS[table]], axis=1)
    for row in np.flatnonzero(~np.isin(named, view.ids).all(axis=1)).tolist():
        missing = " nor ".join(str(int(n)) for n in named[row] if n not in view.row_of)
        yield of_row("row/dangling", row, f"there is no object {missing} in this frame")
    for row in range(len(rows)) if table == "expressions" else ():
        listed = np.union1d(rows["targets"][row], rows["acceptable"][row])
        absent = listed[~np.isin(listed, view.ids)].tolist()
        if absent:
            message = f"the answers name object {absent[0]}, which is not in this frame"
            yield of_row("row/dangling", row, message, {"object": absent[0]})


def _camera(view: FrameView) -> Iterator[Finding]:
    """Intrinsics, pose and up vector of a usable frame."""
    if not view.usable:
        return
    frames, K, fault = view.tables["frames"], view.K, partial(view.finding, "frame/camera", ())
    if K is None:
        yield fault("the frame has no intrinsics")
    elif not (K[0, 0] > 0 and K[1, 1] > 0 and np.array_equal(K[2], [0, 0, 1]) and K[1, 0] == 0):
        yield fault("K is not that of a pinhole camera", {"fx": K[0, 0], "fy": K[1, 1]})
    elif not (0 <= K[0, 2] <= view.size[1] and 0 <= K[1, 2] <= view.size[0]):
        yield fault("the principal point is outside the picture", {"cx": K[0, 2], "cy": K[1, 2]}, "warning")
    length = float(np.linalg.norm(frames["up"][0]))
    if view.viewer is None or abs(length - 1) > ROTATION_TOLERANCE:
        yield fault("up is not a unit vector", {"length": length})
    pose = frames["T_world_camera"][0].reshape(4, 4)
    turned = float(rotation_fault(pose[None, :3, :3])[0]) if np.isfinite(pose).all() else 0.0
    if np.isfinite(pose).all() and (turned > ROTATION_TOLERANCE or not np.array_equal(pose[3], [0, 0, 0, 1])):
        yield fault("the pose is not rigid", {"fault": turned})


def _rotations(view: FrameView, prefix: str) -> Iterator[Finding]:
    size, fault = view.objects[f"{prefix}size"], rotation_fault(view.objects[f"{prefix}R"].reshape(-1, 3, 3))
    yield from view.where(
        "object/rotation",
        fault > ROTATION_TOLERANCE,
        lambda k: f"{prefix}R is not a rotation",
        lambda k: {"fault": fault[k]},
    )
    yield from view.where(
        "object/rotation",
        np.asarray((size < 0).any(axis=1)),
        lambda k: f"{prefix}size has a negative edge",
        lambda k: {"shortest": size[k].min()},
    )
