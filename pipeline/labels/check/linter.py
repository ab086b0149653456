"""Checking labels: every rule on every frame, one frame in memory at a time.

The rules on rows as such are here (values, keys, references, and the frame's own camera), those on whole files
(readable, of the schema, as they were written, made by rules that are still the same), and those on the up vector:
something must say where up is, and the posed frames of a scene agree.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache, partial

import numpy as np

from pipeline.datasets.settings import ASSUMED
from pipeline.datasets.up import OFF_SCENE
from pipeline.labels.check.expressions import TEXTS_KEPT, ExpressionRules, check_expressions, triple_of
from pipeline.labels.check.objects import (
    SizeSurvey,
    check_depth,
    check_duplicates,
    check_objects,
    check_sizes,
    rotation_fault,
)
from pipeline.labels.check.relations import EXPECTED, check_geometry, check_relations
from pipeline.labels.check.stream import BATCH_ROWS, Rows, TableStream, frames_of
from pipeline.labels.check.view import RULES, Figure, Finding, FrameView, Severity, chosen_rules
from pipeline.labels.profiles import PROFILES
from pipeline.labels.reading import Corrections, Labels, RowHash, read_corrections
from pipeline.labels.schema import KEYS, TABLES, Manifest
from pipeline.language.naming import normal_form
from pipeline.language.relation_names import PAIRWISE
from pipeline.system.arrow import pa
from pipeline.system.safe_files import open_parquet
from pipeline.system.whole_files import sha256_of

OF_ANSWERS = (
    "expression/empty",
    "expression/sets",
    "expression/ambiguous",
    "expression/unreadable",
    "expression/state",
    "expression/article",
)
"""Rules on what an expression says and is true of, which a person may settle."""


def check_labels(labels: Labels, *, rules: Sequence[str] | None = None) -> Iterator[Finding]:
    """Check labels, even damaged or edited.

    What people set in corrected labels is not held against the rules.

    The tables are read twice: first the objects, for class names and sizes;
    then all, frame by frame. Memory grows with classes, not with frames.

    `rules`: names of rules or of groups ("relation"); all by default. Yields first of whole files, then frame by frame.

    Raises InputError: a rule has no such name; before anything is read.
    """
    chosen, by_people = chosen_rules(rules), read_corrections(labels.root)
    found = _all_findings(labels, frozenset(rule.split("/")[0] for rule in chosen), chosen)
    return (finding for finding in found if finding.rule in chosen and not _settled(finding, by_people))


OF_ROWS = frozenset({"row", "frame", "file", "object"})
"""Groups of rules that look at the rows of a frame one by one."""


def _settled(finding: Finding, by_people: Corrections) -> bool:
    if finding.frame is None or len(finding.objects) != 2:
        return False
    return (
        (finding.frame, *finding.objects, finding.figures.get("relation")) in by_people.relations
        if finding.rule == "relation/geometry"
        else finding.rule in OF_ANSWERS and (finding.frame, finding.figures.get("id")) in by_people.expressions
    )


def _all_findings(labels: Labels, groups: frozenset[str], chosen: frozenset[str]) -> Iterator[Finding]:
    manifest = labels.manifest
    checked = bool(groups & OF_ROWS)
    streams = {name: TableStream(labels.root / f"{name}.parquet", name, checked) for name in TABLES}
    if "file" in groups:
        yield from check_files(labels, streams)
    if "profile" in groups:
        yield from check_profile(manifest)
    profile = str(manifest.profile.get("name"))
    expected_of = EXPECTED[profile] if profile_problem(manifest) is None else None
    background = frozenset(normal_form(str(b)) for b in manifest.config.get("background", ()))
    relations = tuple(r for r in manifest.config.get("relations", ()) if r in PAIRWISE)
    class_names, survey = _surveyed(TableStream(labels.root / "objects.parquet", "objects", checked=False))
    expression_rules = ExpressionRules(lru_cache(TEXTS_KEPT)(partial(triple_of, class_names)), manifest.seed, profile)
    # What rests on a table that cannot be read, or lacks columns, would be one error a row.
    lost = {name for name, stream in streams.items() if stream.problem is not None or stream.lacking}
    if lost & {"frames", "objects"}:
        groups -= {"row", "frame", "object", "relation", "expression"}
    elif "relations" in lost:
        groups -= {"relation", "expression"}
    elif "expressions" in lost:
        groups -= {"expression"}
    ups = UpRules()
    for index, tables in frames_of(streams):
        view = FrameView(index, tables, background, relations)
        if groups & OF_ROWS:
            yield from check_rows(view)
        if "frame" in groups:
            yield from ups.add(view)
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
            yield from check_expressions(view, expression_rules)
    yield from ups.finish()
    if "file" in groups:
        for name, stream in streams.items():
            # Damage that showed only while the table was read.
            if stream.problem is not None and stream.opened:
                yield _finding(
                    "file/unreadable",
                    f"{stream.path.name} could not be read to its end: {stream.problem}",
                    {"table": name},
                )


def _surveyed(objects: TableStream) -> tuple[tuple[str, ...], SizeSurvey]:
    """The class names of all objects, sorted, and how large their kinds are."""
    found: set[str] = set()
    survey = SizeSurvey()
    while (index := objects.peek()) is not None:
        rows = objects.take(index)
        found |= {label for label in rows["label"] if label is not None}
        survey.add(rows)
    return tuple(sorted(found)), survey


DISAGREE_DEG = 10.0
"""Ups of one scene that are further apart are not one: the undecided band of a relation's cone is 10 degrees wide."""


class UpRules:
    """The frames of one scene are kept until the next begins, so that memory does not grow with scenes."""

    def __init__(self) -> None:
        self._scene: str | None = None
        self._ups: list[tuple[str | None, np.ndarray]] = []

    def add(self, view: FrameView) -> Iterator[Finding]:
        """Findings of a frame, and of the scene before at the start of another."""
        frames = view.tables["frames"]
        if not view.usable or view.viewer is None:
            return
        if frames["scene"][0] != self._scene:
            yield from self.finish()
            self._scene = frames["scene"][0]
        if frames["up_source"][0] == "assumed":
            yield view.finding("frame/up-assumed", (), ASSUMED)
            return
        for note in frames["notes"][0]:
            if OFF_SCENE in note:
                yield view.finding("frame/up-disagrees", (), note)
        pose = frames["T_world_camera"][0].reshape(4, 4)
        if np.isfinite(pose).all():
            self._ups.append((view.id, pose[:3, :3] @ view.viewer.up))

    def finish(self) -> Iterator[Finding]:
        """Frames of the scene with another up than most."""
        ups, self._ups = self._ups, []
        if len(ups) < 2:
            return
        vectors = np.array([up / max(np.linalg.norm(up), 1e-9) for _, up in ups])
        apart = np.degrees(np.arccos(np.clip(vectors @ vectors.T, -1, 1)))
        most = int((apart <= DISAGREE_DEG).sum(axis=1).argmax())
        agreeing = int((apart[most] <= DISAGREE_DEG).sum())
        for k in np.flatnonzero(apart[most] > DISAGREE_DEG):
            off = round(float(apart[most, k]), 1)
            message = f"its up is {off:g} degrees off that of {agreeing} of the {len(ups)} frames of {self._scene}"
            figures: dict[str, float | int | str] = {"degrees": off, "agreeing": agreeing, "frames": len(ups)}
            yield Finding("frame/up-disagrees", "warning", ups[k][0], (), message, figures)


def _finding(rule: str, message: str, figures: dict[str, Figure], severity: Severity | None = None) -> Finding:
    return Finding(rule, severity or RULES[rule].severity, None, (), message, figures)


def check_files(labels: Labels, streams: dict[str, TableStream]) -> Iterator[Finding]:
    """Faults of the tables as files."""
    for name, stream in streams.items():
        file, table = stream.path.name, dict[str, Figure](table=name)
        if stream.problem is not None:
            yield _finding("file/unreadable", f"{file}: {stream.problem}", table)
            continue
        for column in sorted(stream.lacking):
            yield _finding("file/schema", f"{file} has no usable column {column}", {**table, "column": column})
        for words in stream.other_types:
            yield _finding("file/schema", f"{file}: {words}", table, "warning")
        for column in stream.extra:
            yield _finding("file/schema", f"{file} has an unknown column {column}", {**table, "column": column})
        yield from _changed(labels, name, stream)
        if not stream.ordered:
            yield _finding("file/order", f"{file} is not in the order of frames", table)
    yield from _counts(labels.manifest)


def _changed(labels: Labels, name: str, stream: TableStream) -> Iterator[Finding]:
    record = labels.manifest.tables.get(name)
    if record is None:
        yield _finding("file/changed", f"the manifest does not know {stream.path.name}", {"table": name})
        return
    rows, content = _content(stream, name)
    figures: dict[str, Figure] = {"table": name, "rows": rows, "rows_in_manifest": record.rows}
    if sha256_of(stream.path) != record.sha256:
        same = (rows, content) == (record.rows, record.content_hash)
        what = "was written anew with the same rows" if same else "was changed after it was written"
        yield _finding("file/changed", f"{stream.path.name} {what}", figures)
    elif (content is not None and content != record.content_hash) or rows != record.rows:
        yield _finding("file/changed", f"the manifest's rows or hash of {stream.path.name} were changed", figures)


def _content(stream: TableStream, name: str) -> tuple[int, str | None]:
    """Rows of a table and the hash of their content; None where its columns are not the schema's."""
    file = open_parquet(stream.path, pre_buffer=False)
    if stream.lacking or stream.other_types:
        return file.metadata.num_rows, None
    digest = RowHash(name)
    for batch in file.iter_batches(BATCH_ROWS):
        digest.update(pa.Table.from_batches([batch]))
    return digest.rows, digest.hexdigest()


def _counts(manifest: Manifest) -> Iterator[Finding]:
    """The manifest against itself."""
    pairs = {"frames": "frames", "objects": "objects", "pairs": "relations", "expressions": "expressions"}
    for count, table in pairs.items():
        record = manifest.tables.get(table)
        if record is not None and count in manifest.counts and manifest.counts[count] != record.rows:
            yield _finding(
                "file/changed",
                f"the manifest counts {manifest.counts[count]} {count} and lists {record.rows} rows",
                {"table": table, "count": manifest.counts[count], "rows": record.rows},
            )


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
    if name not in EXPECTED:
        return f"what geometry says under the rule profile {name!r} cannot be recomputed from labels"
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
        if not _in_order(table, rows):
            yield of_row("file/order", None, "the rows of the frame are out of order")
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


def _in_order(table: str, rows: Rows) -> bool:
    rank = {relation: k for k, relation in enumerate(PAIRWISE)}
    columns = [rows[name] for name in KEYS[table][1:]] if len(rows) > 1 else []
    keys = [np.array([rank.get(v, -1) for v in c]) if c.dtype == object else c for c in columns]
    return not keys or np.array_equal(np.lexsort(keys[::-1]), np.arange(len(rows)))


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
