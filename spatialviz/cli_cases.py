"""The commands that keep cases, run them again, and report one as a page."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from tyro.conf import OmitArgPrefixes, Positional

from pipeline.system.errors import InputError
from spatialviz.exits import BAD, FINE, NO
from spatialviz.options import print_json
from spatialviz.source_options import SourceOptions

if TYPE_CHECKING:
    from pipeline.answering.objects import PreparedFrame
    from pipeline.answering.opening import Pipeline
    from pipeline.labels.cases import FrameCases


def truth_of(source: Pipeline, context: PreparedFrame, labels: Path | None) -> FrameCases | None:
    """What is true of a frame: by labels where they are named, else by its annotations."""
    from pipeline.diagnosis.asking import known_truth
    from pipeline.labels.reading import open_labels

    return known_truth(source, context, None if labels is None else open_labels(labels))


@dataclass(frozen=True)
class SaveCase:
    """Keep one answer as a small folder that `replay` runs again: a failure becomes a regression test."""

    dataset: Positional[str]
    """Dataset folder, or "demo"."""
    frame: Positional[str]
    """Frame id, or its index."""
    expression: Positional[str]
    """TARGET RELATION REFERENCE, in quotes."""
    out: Path
    """Folder to write; it must not exist, or be empty."""
    source: OmitArgPrefixes[SourceOptions] = SourceOptions()
    labels: Path | None = None
    """Labels that say what is true. Default: the frame's annotations."""
    edits: Path | None = None
    """Edits as a JSON file."""
    name: str | None = None
    """Title of the case."""
    copy_srm: bool = False
    """Put the file of the relation network into the case."""
    json: bool = False
    """Print one JSON object."""

    def run(self) -> int:
        from pipeline.diagnosis.cases import answer_record, save_case
        from spatialviz.printing_cases import print_saved

        source = self.source.open(self.dataset, self.frame)
        context = _one_context(source, self.frame)
        edits = None
        if self.edits is not None:
            from pipeline.diagnosis.whatif import edits_record, load_edits

            edits = edits_record(load_edits(self.edits))
        now = save_case(
            self.out, source, context, self.expression, truth=truth_of(source, context, self.labels), edits=edits,
            name=self.name, copy_network=self.copy_srm,
        )  # fmt: skip
        if self.json:
            print_json({"case": str(self.out), **answer_record(now)})
        else:
            print_saved(now, self.out)
        return FINE


def _one_context(source: Pipeline, frame: str) -> PreparedFrame:
    from pipeline.answering.opening import ALL_FRAMES, contexts

    if frame == ALL_FRAMES:
        raise InputError("one frame is needed", got="all")
    return next(contexts(source, frame))


@dataclass(frozen=True)
class Replay:
    """Run kept cases again; status 1 when an answer changed, 2 when a case is damaged."""

    cases: Positional[tuple[Path, ...]]
    """Case folders, or folders that hold cases."""
    srm: str | None = None
    """Another relation scorer: trained | rule | an ONNX file. Default: the case's own."""
    vectors: Path | None = None
    """Text vectors of a language network."""
    detector: str = "kept"
    """kept: the detections in the case | live: its detector looks at the picture again | another detector's name."""
    model: Path | None = None
    """Model file or options for a detector that looks again."""
    min_score: float | None = None
    """Its minimum score."""
    tolerance: float = 1e-4
    """A probability that moves by more is shown as a warning."""
    update: bool = False
    """Take the answers of now as the expected ones."""
    json: bool = False
    """Print one JSON object for each case, and one of totals."""

    def run(self) -> int:
        from pipeline.diagnosis.cases import find_cases
        from pipeline.diagnosis.cases.replay import replay_all
        from spatialviz.printing_cases import print_replay, print_totals, replay_record, totals_record

        if not self.cases:
            raise InputError("a case is missing", expected="the folder that save-case wrote")
        if self.detector == "kept" and (self.model is not None or self.min_score is not None):
            raise InputError("--model and --min-score need --detector", expected="live or a detector's name")
        folders = [folder for path in self.cases for folder in find_cases(path)]
        totals = {"same": 0, "changed": 0, "updated": 0, "damaged": 0}
        for result in replay_all(
            folders, srm=self.srm, vectors=self.vectors, tolerance=self.tolerance, update=self.update,
            detector=None if self.detector == "kept" else self.detector, model=self.model, min_score=self.min_score,
        ):  # fmt: skip
            totals[result.status] += 1
            if self.json:
                print_json(replay_record(result))
            else:
                print_replay(result, updated=result.status == "updated")
        if self.json:
            print_json(totals_record(totals))
        else:
            print_totals(totals)
        return BAD if totals["damaged"] else NO if totals["changed"] else FINE


@dataclass(frozen=True)
class Report:
    """One self-contained page of an answer: why it failed, the picture, the scene in 3D, all tables."""

    dataset: Positional[str]
    """Case folder; or a dataset folder or "demo", with FRAME and EXPRESSION."""
    frame: Positional[str | None] = None
    """Frame id, or its index."""
    expression: Positional[str | None] = None
    """TARGET RELATION REFERENCE, in quotes."""
    out: Path = Path("report.html")
    """File to write."""
    source: OmitArgPrefixes[SourceOptions] = SourceOptions()
    labels: Path | None = None
    """Labels that say what is true. Default: the frame's annotations."""
    scene: bool = True
    """The scene in 3D, about 1.5 MB."""
    overwrite: bool = False
    """Replace an earlier report."""
    json: bool = False
    """Print one JSON object."""

    def run(self) -> int:
        from pipeline.datasets.saved_case import MANIFEST
        from pipeline.diagnosis.asking import known_truth
        from pipeline.diagnosis.cases import answer, open_case
        from pipeline.labels.reading import open_labels
        from spatialviz.report import Subject, failure_page, write_page
        from spatialviz.report.scene import scene_html

        if self.out.is_dir() or (self.out.exists() and not self.overwrite):
            raise InputError("the report would replace a file", expected="--overwrite", path=self.out)
        if self.frame is None and not (Path(self.dataset) / MANIFEST).is_file():
            raise InputError("FRAME and EXPRESSION are missing", cause=f"{self.dataset} is no saved case")
        if self.frame is None:
            srm = None if self.source.srm == "trained" else self.source.srm
            opened = open_case(self.dataset, srm=srm, vectors=self.source.vectors)
            source, context, answered = opened.source, opened.context, opened.answer()
            subject = Subject.of_case(opened)
        else:
            if self.expression is None:
                raise InputError("EXPRESSION is missing", expected='for example "mug left of the laptop"')
            source = self.source.open(self.dataset, self.frame)
            context = _one_context(source, self.frame)
            labels = None if self.labels is None else open_labels(self.labels)
            answered = answer(source, context, self.expression, truth=known_truth(source, context, labels))
            subject = Subject.of_dataset(
                self.dataset, source, context, self.expression, self.source.words(), labels
            )
        page = failure_page(
            answered, source, context, subject, scene_html(answered, context) if self.scene else None
        )
        write_page(page, self.out)
        verdict = None if answered.diagnosis is None else answered.diagnosis.verdict
        if self.json:
            print_json({"report": str(self.out), "bytes": len(page.encode()), "verdict": verdict})
        else:
            print(f"{verdict or 'no verdict'} -> {self.out} ({len(page.encode()) / 2**20:.1f} MB)")
        return FINE
