"""The command that answers under edits."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tyro.conf import OmitArgPrefixes, Positional

from pipeline.system.errors import InputError
from spatialviz.exits import FINE, NO
from spatialviz.options import print_json
from spatialviz.source_options import SourceOptions

if TYPE_CHECKING:
    from pipeline.diagnosis.whatif import Baseline, Edits, Outcome


@dataclass(frozen=True)
class WhatIf:
    """Answer an expression with and without edits: moved boxes, other masks, confidences, thresholds.

    Exit status: 0 where a pair stands in the relation after the edits, 1 where none does, 2 for bad usage or input.
    """

    dataset: Positional[str]
    """Dataset folder, or "demo"."""
    frame: Positional[str]
    """Frame id, or its index."""
    expression: Positional[str]
    """TARGET RELATION REFERENCE, in quotes."""
    source: OmitArgPrefixes[SourceOptions] = SourceOptions()
    edits: Path | None = None
    """JSON file of edits. Without it the objects are listed with the keys that edits name them by."""
    decision_map: Path | None = None
    """Write a picture (.png or .jpg): the floor, coloured by which answer wins if one object stands there."""
    move: str | None = None
    """Key of the object that the decision map moves. Default: the target of the answer."""
    cells: int = 48
    """Cells of the decision map on each side."""
    labels: Path | None = None
    """Labels that say what is true. Default: the frame's annotations."""
    json: bool = False
    """Print one JSON object."""

    def run(self) -> int:
        from pipeline.answering.objects import prepare_frame
        from pipeline.answering.told_answer import holds
        from pipeline.datasets import resolve_frame
        from pipeline.diagnosis.asking import edited_verdicts
        from pipeline.diagnosis.whatif import Baseline, Edits, load_edits, rerun
        from pipeline.diagnosis.whatif.rerun import foreign_keys
        from pipeline.labels.reading import open_labels
        from spatialviz.printing_whatif import print_change

        edits = Edits() if self.edits is None else load_edits(self.edits)
        source = self.source.open(self.dataset, self.frame)
        frame = source.dataset.load(resolve_frame(source.dataset, self.frame))
        context = prepare_frame(source.dataset, frame, source.config.lift)
        baseline = Baseline(source, context, self.expression)
        unknown = foreign_keys(baseline, edits)
        if unknown:
            known = ", ".join(sorted(baseline.all_keys)[:30])
            raise InputError("edits of objects that are not there", got=", ".join(unknown), expected=known)
        after = rerun(baseline, edits)
        weights = replace(source.config.rank, **edits.rank)
        labels = None if self.labels is None else open_labels(self.labels)
        verdicts = edited_verdicts(source, context, baseline.outcome.trace, after.trace, weights, labels)
        record = whatif_record(baseline, after, edits, verdicts)
        if self.decision_map is not None:
            record["decision_map"] = self._map(baseline, after, edits)
        if self.json:
            print_json(record)
        else:
            print_change(record)
        return FINE if holds(after.trace) else NO

    def _map(self, baseline: Baseline, after: Outcome, edits: Edits) -> dict[str, Any]:
        from pipeline.diagnosis.whatif.decision_map import decision_map, map_picture, map_record
        from spatialviz.report.picture import write_picture

        assert self.decision_map is not None
        ranking = after.trace.ranking
        key = self.move or ("" if ranking is None else after.keys[ranking.pairs[0].target])
        found = decision_map(baseline, edits, key, self.cells)
        write_picture(map_picture(found, after), self.decision_map)
        return map_record(found)


def whatif_record(
    baseline: Baseline, after: Outcome, edits: Edits, verdicts: tuple[str | None, str | None] | None = None
) -> dict[str, Any]:
    """The whole of `whatif --json`."""
    from pipeline.diagnosis.whatif import edits_record, what_changed
    from pipeline.diagnosis.whatif.placement import place_in_region
    from pipeline.language.relation_names import PAIRWISE
    from pipeline.relations.relations import Profile

    trace = after.trace
    record: dict[str, Any] = {
        "frame": trace.frame.id,
        "expression": baseline.text,
        "edits": edits_record(edits),
        "objects": [
            {"key": key, "label": o.label, "score": round(float(o.score), 6)}
            for key, o in zip(after.keys, trace.objects, strict=True)
        ],
        **what_changed(baseline.outcome, after, verdicts=verdicts),
        "timings_ms": {stage: round(seconds * 1000, 3) for stage, seconds in trace.timings.items()},
        "pairs_scored": after.pairs_scored,
    }
    relation = trace.asked.relation
    if trace.ranking is not None and trace.ranking.pairs[0].reference is not None and relation in PAIRWISE:
        pair = trace.ranking.pairs[0]
        ends = [trace.objects[k].lifted for k in (pair.target, pair.reference) if k is not None]
        first, second = ends[::-1] if trace.asked.inverse else ends
        placed = place_in_region(first, second, relation, trace.viewer, Profile(**edits.profile))
        record["placement"] = {
            "relation": relation,
            "state": placed.letter,
            "why": placed.why,
            "measures": {name: round(value, 6) for name, value in placed.measures.items()},
        }
    return record
