"""The commands that evaluate, and that time it."""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from tyro.conf import OmitArgPrefixes, Positional

from pipeline.system.errors import InputError
from spatialviz.exits import FINE, NO
from spatialviz.options import print_json
from spatialviz.source_options import SourceOptions

if TYPE_CHECKING:
    from pipeline.evaluation.relation_cases import RelationSpec


@dataclass(frozen=True)
class Eval:
    """Answer every expression of labels, and write tables with intervals, plots and records."""

    dataset: Positional[str]
    """Dataset folder, or "demo"."""
    labels: Path
    """Labels folder."""
    out: Path
    """Run folder to write."""
    source: OmitArgPrefixes[SourceOptions] = SourceOptions()
    system: Literal["pipeline", "referring", "vlm"] = "pipeline"
    """pipeline | referring: the detector fed the whole expression | vlm: a vision-language model."""
    vlm_url: str | None = None
    """OpenAI-compatible server, such as http://localhost:8000/v1 (vLLM, Ollama, llama.cpp). Key: SPATIALVIZ_VLM_KEY."""
    vlm_model: str | None = None
    """The model's name on that server."""
    vlm_rate: float | None = None
    """Requests a minute at most."""
    marks: Path | None = None
    """JSON of labels that a person found wrong: [{"frame", "id", "mark": "BAD_LABEL" | "BAD_BOX"}]."""
    tables: Literal["grounding", "relations", "both", "paper"] | None = None
    """grounding: expressions | relations: relations alone, pair by pair | both | paper: both, printed as the paper's
    tables with its published rows. Default: both for --system pipeline, else grounding."""
    relations_of: tuple[str, ...] = ()
    """Further relation scorers to measure beside --srm: trained | rule | ONNX files. --vectors is for all of them."""
    relation_frames: int | None = None
    """Measure relations on so many frames, spread evenly. Default: all with labelled pairs."""
    relation_boxes: Literal["lifted", "stored"] | None = None
    """lifted: the labelled objects from the dataset's annotations and depth | stored: their boxes in the labels.
    Default: lifted, where the labels were made of annotations."""
    relation_pairs: Literal["all", "held-out"] = "all"
    """held-out: without frames that any of the relation networks was trained or calibrated on."""
    vlm_pairs: int = 200
    """About how many pairs the vision-language model is asked, drawn at random."""
    seed: int = 0
    """Of that draw."""
    verdicts: bool = True
    """Say of each expression which module failed. Without, no diagnosis is written, and it is faster."""
    limit: int | None = None
    """Only so many expressions, spread evenly."""
    name: str | None = None
    """Of the system in the tables. Default: detector and relation scorer."""
    others: tuple[Path, ...] = ()
    """Runs on the same labels whose systems become rows too."""
    compare: Path | None = None
    """A run to compare with: what was fixed, what was broken, what is right for another reason."""
    workers: int = os.cpu_count() or 1
    """Processes at once. The figures do not depend on it."""
    plots: bool = True
    """Draw plots (extra: report)."""
    overwrite: bool = False
    """Replace an earlier run."""
    show: int = 5
    """Expressions shown of each kind with --compare."""
    json: bool = False
    """Print one JSON object."""

    def run(self) -> int:
        from pipeline.diagnosis.verdict import read_marks
        from pipeline.evaluation.job import evaluate_dataset
        from pipeline.evaluation.run import EvalSpec
        from pipeline.evaluation.whole_expression import VlmOptions
        from spatialviz.printing import rate_bar
        from spatialviz.printing_eval import print_run, run_record

        vlm = None
        if self.vlm_url is not None and self.vlm_model is not None:
            vlm = VlmOptions(self.vlm_url, self.vlm_model, self.vlm_rate)
        elif self.system == "vlm":
            raise InputError("--system vlm needs a server and a model", expected="--vlm-url URL --vlm-model NAME")
        elif self.vlm_url is not None or self.vlm_model is not None:
            raise InputError("a server and its model go together", expected="--vlm-url URL --vlm-model NAME")
        tables = self._tables()
        grounding = tables != "relations"
        options = self.source.options()
        relations = None if tables == "grounding" else self._relations(options)
        spec = EvalSpec(
            self.dataset,
            str(self.labels),
            options,
            self.system,
            vlm,
            self.limit,
            grounding=grounding,
            relations=relations,
            verdicts=self.verdicts,
            marks={} if self.marks is None else read_marks(self.marks),
        )
        with rate_bar("evaluating", "expressions" if grounding else "frames") as advance:
            report = evaluate_dataset(
                spec,
                self.out,
                name=self.name,
                workers=self.workers,
                others=self.others,
                against=self.compare,
                paper=self.tables == "paper",
                plots=self.plots,
                overwrite=self.overwrite,
                progress=advance,
            )
        if self.json:
            print_json(run_record(report))
        else:
            print_run(report, self.show)
        for warning in report.warnings:
            print(f"spatialviz: {warning}", file=sys.stderr)
        return FINE

    def _tables(self) -> Literal["grounding", "relations", "both"]:
        """What is measured."""
        asked = "both" if self.tables == "paper" and self.system == "pipeline" else self.tables
        chosen = ("grounding" if asked == "paper" else asked) or ("both" if self.system == "pipeline" else "grounding")
        if chosen == "grounding" and self.tables != "grounding" and self.relations_of:
            chosen = "both"
        given = {"--relations-of": self.relations_of, "--relation-frames": self.relation_frames,
                 "--relation-boxes": self.relation_boxes}  # fmt: skip
        unused = [name for name, value in given.items() if value not in ((), None)]
        if chosen == "grounding" and unused:
            raise InputError(f"{unused[0]} belongs to relations alone", expected="--tables relations or both")
        if chosen == "relations" and (self.compare is not None or self.others or self.limit is not None):
            raise InputError("--compare, --others and --limit are about expressions", got="--tables relations")
        return chosen

    def _relations(self, options: dict[str, Any]) -> RelationSpec:
        """How relations are measured; `options` lose the vectors that the run's own scorer has no use for."""
        from pipeline.evaluation.relation_cases import RelationSpec, uses_language

        vectors = options["vectors"]
        if vectors is not None and self.relations_of and not uses_language(str(options["srm"])):
            options["vectors"] = None
        return RelationSpec(
            others=self.relations_of,
            vectors=None if vectors is None else str(vectors),
            geometry=self.relation_boxes,
            frames=self.relation_frames,
            pairs=self.relation_pairs,
            vlm_pairs=self.vlm_pairs,
            seed=self.seed,
        )

@dataclass(frozen=True)
class BenchEval:
    """Time evaluation with recorded proposals, stage by stage and beside asking one by one, and training."""

    dataset: Positional[str] = "demo"
    """Dataset folder, or "demo"."""
    labels: Path | None = None
    """Its labels folder. Default: the dataset is labelled for the occasion."""
    recording: Path | None = None
    """Recorded proposals. Default: those of the simulated detector."""
    workers: int = os.cpu_count() or 1
    """Processes of the whole job."""
    singly: int = 48
    """Expressions that are also asked one by one."""
    pairs: int = 75_000
    """Training pairs; the labels' own are repeated until there are so many."""
    json: bool = False
    """Print one JSON object."""

    def run(self) -> int:
        from pipeline.evaluation.bench import bench_evaluation
        from spatialviz.printing_bench import print_evaluation_bench

        record = bench_evaluation(
            self.dataset,
            self.labels,
            recording=self.recording,
            workers=self.workers,
            singly=self.singly,
            pairs=self.pairs,
        )
        if self.json:
            print_json(record)
        else:
            print_evaluation_bench(record)
        return FINE if not record["asked_singly"]["differ"] else NO
