"""Checking labels: every rule on every frame, one frame in memory at a time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from pipeline.labels.check.duplicates import check_duplicates
from pipeline.labels.check.expressions import ExpressionRules, Reader, check_expressions
from pipeline.labels.check.files import check_files, check_profile, profile_problem
from pipeline.labels.check.findings import Finding, chosen_rules
from pipeline.labels.check.geometry import EXPECTED, check_geometry
from pipeline.labels.check.objects import check_objects
from pipeline.labels.check.relations import check_relations
from pipeline.labels.check.rows import check_rows
from pipeline.labels.check.sizes import SizeSurvey, check_sizes
from pipeline.labels.check.stream import TableStream, frames_of, open_streams
from pipeline.labels.check.up import UpRules
from pipeline.labels.check.view import FrameView, Names
from pipeline.labels.corrections import Corrections, read_corrections
from pipeline.labels.reading import Labels
from pipeline.naming import normal_form
from pipeline.relations import PAIRWISE

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
