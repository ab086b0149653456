"""Checking labels: every rule on every frame, one frame in memory at a time.

The rules on the up vector are here: something must say where up is, and the posed frames of a scene agree.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from pipeline.datasets.settings import ASSUMED
from pipeline.labels.check.expressions import ExpressionRules, Reader, check_expressions
from pipeline.labels.check.files import check_files, check_profile, profile_problem
from pipeline.labels.check.findings import Finding, chosen_rules
from pipeline.labels.check.geometry import EXPECTED, check_geometry
from pipeline.labels.check.objects import check_duplicates, check_objects
from pipeline.labels.check.relations import check_relations
from pipeline.labels.check.rows import check_rows
from pipeline.labels.check.sizes import SizeSurvey, check_sizes
from pipeline.labels.check.stream import TableStream, frames_of, open_streams
from pipeline.labels.check.view import FrameView, Names
from pipeline.labels.reading import Corrections, Labels, read_corrections
from pipeline.language.naming import normal_form
from pipeline.language.relation_names import PAIRWISE

OF_ANSWERS = ("expression/empty", "expression/sets", "expression/ambiguous", "expression/unreadable",
              "expression/state", "expression/article")  # fmt: skip
"""Rules on what an expression says and is true of, which a person may settle."""


def check_labels(labels: Labels, *, rules: Sequence[str] | None = None) -> Iterator[Finding]:
    """Check labels, also ones that were damaged or edited.

    What people set in corrected labels is not held against the rules.

    The tables are read twice: first the objects, for class names and sizes;
    then all, frame by frame. Memory grows with classes, not with frames.

    Parameters
    ----------
    labels : Labels
        From `open_labels`.
    rules : sequence of str, optional
        Names of rules or of groups ("relation"); all by default.

    Yields
    ------
    Finding
        First of whole files, then frame by frame.

    Raises
    ------
    InputError
        A rule has no such name; before anything is read.
    """
    return _findings(labels, chosen_rules(rules))


def _findings(labels: Labels, chosen: frozenset[str]) -> Iterator[Finding]:
    said = read_corrections(labels.root)
    for finding in _all_findings(labels, frozenset(rule.split("/")[0] for rule in chosen), chosen):
        if finding.rule in chosen and not _settled(finding, said):
            yield finding


def _settled(finding: Finding, said: Corrections) -> bool:
    """Whether a finding only tells that a person said otherwise than the rules."""
    if finding.frame is None or len(finding.objects) != 2:
        return False
    if finding.rule == "relation/geometry":
        return (finding.frame, *finding.objects, finding.figures.get("relation")) in said.relations
    return finding.rule in OF_ANSWERS and (finding.frame, finding.figures.get("id")) in said.expressions


def _all_findings(labels: Labels, groups: frozenset[str], chosen: frozenset[str]) -> Iterator[Finding]:
    manifest = labels.manifest
    streams = open_streams(labels.root)
    if "file" in groups:
        yield from check_files(labels, streams)
    if "profile" in groups:
        yield from check_profile(manifest)
    profile = str(manifest.profile.get("name"))
    expected_of = EXPECTED[profile] if profile_problem(manifest) is None else None
    names = Names(frozenset(normal_form(str(b)) for b in manifest.config.get("background", ())))
    relations = tuple(r for r in manifest.config.get("relations", ()) if r in PAIRWISE)
    class_names, survey = _surveyed(TableStream(labels.root / "objects.parquet", "objects"))
    expression_rules = ExpressionRules(Reader(class_names), manifest.seed, profile)
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
        view = FrameView(index, tables, names, relations)
        if groups & {"row", "frame", "file", "object"}:
            yield from check_rows(view)
        if "frame" in groups:
            yield from ups.add(view)
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
        yield from _broke_off(streams)


def _surveyed(objects: TableStream) -> tuple[tuple[str, ...], SizeSurvey]:
    """The class names of all objects, sorted, and how large their kinds are."""
    found: set[str] = set()
    survey = SizeSurvey()
    while (index := objects.peek()) is not None:
        rows = objects.take(index)
        found |= {label for label in rows["label"] if label is not None}
        survey.add(rows)
    return tuple(sorted(found)), survey


def _broke_off(streams: dict[str, TableStream]) -> Iterator[Finding]:
    """Tables whose damage showed only while they were read."""
    for name, stream in streams.items():
        if stream.problem is not None and stream.opened:
            message = f"{stream.path.name} could not be read to its end: {stream.problem}"
            yield Finding("file/unreadable", "error", None, (), message, {"table": name})


DISAGREE_DEG = 10.0
"""Ups of one scene that are further apart are not one: the doubtful band of a relation's cone is 10 degrees wide."""


class UpRules:
    """The frames of one scene are kept until the next begins, so that memory does not grow with scenes."""

    def __init__(self) -> None:
        self._scene: str | None = None
        self._ups: list[tuple[str | None, np.ndarray]] = []

    def add(self, view: FrameView) -> Iterator[Finding]:
        """What is to be said of a frame, and of the scene before where this one begins another."""
        frames = view.tables["frames"]
        if not view.usable or view.viewer is None:
            return
        if frames["scene"][0] != self._scene:
            yield from self.finish()
            self._scene = frames["scene"][0]
        if frames["up_source"][0] == "assumed":
            yield view.finding("frame/up-assumed", (), ASSUMED)
            return
        pose = frames["T_world_camera"][0].reshape(4, 4)
        if np.isfinite(pose).all():
            self._ups.append((view.id, pose[:3, :3] @ view.viewer.up))

    def finish(self) -> Iterator[Finding]:
        """The frames of the scene whose up is not that of most."""
        ups, self._ups = self._ups, []
        if len(ups) < 2:
            return
        vectors = np.array([up / max(np.linalg.norm(up), 1e-9) for _, up in ups])
        apart = np.degrees(np.arccos(np.clip(vectors @ vectors.T, -1, 1)))
        most = int((apart <= DISAGREE_DEG).sum(axis=1).argmax())
        agreeing = int((apart[most] <= DISAGREE_DEG).sum())
        for place in np.flatnonzero(apart[most] > DISAGREE_DEG):
            off = round(float(apart[most, place]), 1)
            message = f"its up is {off:g} degrees off that of {agreeing} of the {len(ups)} frames of {self._scene}"
            figures: dict[str, float | int | str] = {"degrees": off, "agreeing": agreeing, "frames": len(ups)}
            yield Finding("frame/up-disagrees", "warning", ups[place][0], (), message, figures)
