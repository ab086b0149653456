"""Commands to evaluate, to look into runs, and to debug a single answer."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from tyro.conf import Positional

from pipeline.system.frozen import dataclass
from spatialviz.options import (
    CPUS,
    DatasetArg,
    Flag,
    JournalArg,
    JournalOptions,
    NewFolder,
    OfAnswer,
    OfCamera,
    Output,
    Overwrite,
    RunArg,
    SourceArg,
    SourceOptions,
    Truth,
    Workers,
)


@dataclass(frozen=True, kw_only=True)
class WritesRun(Output):
    """Command writing a run."""

    name: str | None = None
    """Of the system in the tables. Default: detector and relation scorer, or as the file names it."""
    workers: Workers = CPUS
    plots: bool = True
    """Draw plots (extra: report)."""
    overwrite: Overwrite = False


@dataclass(frozen=True, kw_only=True)
class EvalCommand(WritesRun):
    """Answer every expression of labels, and write tables with intervals, plots and records; --sentences: sentences
    written by people, judged without labels; --judge-again: results of an earlier version."""

    dataset: DatasetArg
    labels: str | None = None
    """Labels folder, or URL."""
    sentences: Path | None = None
    """In place of labels: JSON lines {"frame", "sentence"} with what is right, one of "targets" (indices of acceptable
    annotations), "points" ([u, v] pixels inside one) and "boxes" ([x0, y0, x1, y1] pixels), empty where nothing is. The
    table is cut by "kind"; lines that name another "dataset" are skipped. SUN-Refer (SUNREFER_v2.json, SUNSPOT_3D.pkl)
    and SUN-Spot (refs(boulder).p) are taken as published, with Acc@IoU. Goes with --detector and the like, --out,
    --overwrite and --json."""
    out: Path | None = None
    """Run folder to write; with --sentences, where it is given, one with a line for each in sentences.jsonl."""
    source: SourceArg = SourceOptions()
    system: Literal["pipeline", "referring", "vlm"] = "pipeline"
    """pipeline | referring: the detector fed the whole expression | vlm: a vision-language model."""
    vlm_url: str | None = None
    """OpenAI-compatible server, such as http://localhost:8000/v1 (vLLM, Ollama, llama.cpp). Key: SPATIALVIZ_VLM_KEY."""
    vlm_model: str | None = None
    """The model's name on that server."""
    vlm_rate: float | None = None
    """Requests a minute at most."""
    places: tuple[str, ...] = ()
    """What the numbers of its boxes mean, where a sample of its answers does not say it; as of import-run."""
    marks: Path | None = None
    """JSON of labels that a person found wrong: [{"frame", "id", "mark": "BAD_LABEL" | "BAD_BOX"}]."""
    map: Path | None = None
    """Folder of object maps that `map` wrote. What a frame does not show, and others do, is NOT-SEEN then, and not the
    detector's fault."""
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
    others: tuple[Path, ...] = ()
    """Runs on the same labels whose systems become rows too."""
    compare: Path | None = None
    """A run to compare with: what was fixed, what was broken, what is correct for another reason."""
    show: int = 5
    """Expressions shown of each kind with --compare."""


@dataclass(frozen=True, kw_only=True)
class ImportRunCommand(WritesRun, OfCamera):
    """Judge the predictions of another pipeline: a run with verdicts as far as the file allows, and everything else of
    a run.

    The file is described in docs/predictions.md. Whatever it gives is taken as it stands.
    """

    predictions: Positional[Path]
    """JSON lines: a header, and a line for each expression. Or what another program publishes, see --format."""
    dataset: str
    """Dataset folder, or demo."""
    labels: str
    """Labels folder or URL that says what is asked and right."""
    out: Path
    """Run folder to write."""
    format: str | None = None
    """spatialviz | coco | supervision | boxes | grounded-sam2 | grounded-sam | concept-graphs | recording | roborefer |
    spatialrgpt | llava | spatialclaw | lmms-eval | vlmevalkit, or a plugin's. Default: as the file's content says."""
    key: Path | None = None
    """What the file leaves open: COCO's annotation file, a list of class names, a list of id, image and question."""
    places: tuple[str, ...] = ()
    """What the numbers of answers in words mean, where all lines together do not say it: pixels | thousandths |
    shares | padded (of a square) | percent | pixels:LONGER_SIDE | pixels:WIDTHxHEIGHT (of a resized picture) |
    pixels:qwen, and after a comma xy | yx of points, xyxy | yxyx | xywh | cxcywh of boxes: thousandths,yxyx."""


@dataclass(frozen=True)
class JudgeAgainCommand(Output):
    """Judge the results of an earlier version again: a run, labels or a case, into a new folder.

    A run is answered again by its own models, or by the predictions that it keeps; relations alone are not measured.
    Labels are made again of their dataset with the same settings; corrections stay with the old ones.
    """

    folder: Positional[Path]
    """Of `eval`, `import-run`, `label` or `save-case`; it stays as it is."""
    out: NewFolder
    workers: Workers = CPUS


@dataclass(frozen=True)
class ExportRunCommand(Output):
    """Write a run of `eval` as predictions, with every step of each answer; `import-run` makes an equal run again."""

    run_folder: RunArg
    out: Path
    """JSON lines to write (docs/predictions.md)."""


@dataclass(frozen=True)
class FailuresCommand(Output):
    """List failures of a run by a search, with the reasons; without a search, verdicts, cost of each module, slices,
    and all failures. With --json also facets under the search, marks and kept searches."""

    run_folder: RunArg
    search: Positional[str] = ""
    """Words, such as "verdict:SRM relation:behind class:chair margin<0.1 -lucky sort:margin". One that begins with "-"
    goes after all options and a "--"."""
    limit: int = 20
    """Expressions shown at most."""
    slices: str | None = None
    """By what the run is cut, with commas: relation, kind, class, reference, distance, size, occlusion,
    same_class, label_margin, scene, frame. Default: relation; beside a search, tables of the run are shown where this
    is given."""
    compare: Path | None = None
    """A second run on the same labels: what it fixed and broke is counted, and can be searched for by change:broken,
    change:fixed, change:other_reason, change:verdict, second_verdict:LIFT."""
    sheet: Path | None = None
    """Picture to write, .png or .jpg: up to twelve of those found, the clearest of each verdict in turn."""
    answers: Flag = False
    """With --compare: only answers that differ, side by side, without labels or verdicts; each of the two may be a file
    of `ask --json` too, such as of another detector."""


@dataclass(frozen=True)
class QueryCommand(Output):
    """Ask a run in SQL: the view records, and labels_frames, labels_objects, labels_relations, labels_expressions."""

    run_folder: RunArg
    sql: Positional[str]
    """One SELECT, such as "SELECT verdict, count(*) FROM records GROUP BY ALL". It can read nothing else."""


@dataclass(frozen=True)
class TablesCommand(Output):
    """Print the paper's tables of a run, with published rows for the vocabulary of the run's labels."""

    run_folder: RunArg
    format: Literal["text", "markdown", "latex"] = "text"
    """text | markdown | latex."""


@dataclass(frozen=True, kw_only=True)
class WhatifCommand(OfAnswer):
    """Answer an expression with and without edits: moved boxes, other masks, confidences, thresholds.

    Exit status: 0 where a pair stands in the relation after the edits, 1 where none does, 2 for bad usage or input.
    """

    edits: Path | None = None
    """JSON file of edits. Without any the objects are listed with the keys that edits name them by."""
    do: tuple[str, ...] = ()
    """Edits in words, one after the other, as *What if* of the page has them: "size:1:0.2" (height), "center:0:0.5"
    (right), "yaw:30", "hide", "mask:grow:-2", "relation:0.1", "set:k:5", "set:scorer:rule"."""
    on: str | None = None
    """Key of the object that they are of. Default: the target of the answer."""
    labels: Truth = None


@dataclass(frozen=True, kw_only=True)
class SaveCaseCommand(OfAnswer):
    """Save an answer as a small folder for `replay`: a failure becomes a regression test."""

    dataset: Positional[str]
    """Dataset folder or "demo"; or a run, of this pipeline or imported: its answer, judged by its labels."""
    out: NewFolder
    labels: Truth = None
    map: Path | None = None
    """Folder of object maps that `map` wrote, for the verdict NOT-SEEN. Default: the run's."""
    edits: Path | None = None
    """Edits as a JSON file."""
    name: str | None = None
    """Title of the case."""


@dataclass(frozen=True)
class ReplayCommand(Output):
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
    predictions: Path | None = None
    """What your own pipeline gives now, as `import-run` takes it: for cases of imported runs."""
    tolerance: float = 1e-4
    """A probability that moves by more is shown as a warning."""
    update: Flag = False
    """Take the answers of now as the expected ones."""


@dataclass(frozen=True)
class ReportCommand(Output):
    """Write a self-contained page of an answer: the reason of failure, the picture, the scene in 3D, all tables;
    --tables: a run's tables as in the paper."""

    dataset: Positional[str]
    """Case folder; or a dataset folder or "demo", with FRAME and EXPRESSION."""
    frame: Positional[str | None] = None
    """Frame id, or its index."""
    expression: Positional[str | None] = None
    """TARGET RELATION REFERENCE, in quotes."""
    out: Path = Path("report.html")
    """File to write."""
    source: SourceArg = SourceOptions()
    labels: Truth = None
    scene: bool = True
    """Show the scene in 3D, about 1.5 MB."""
    overwrite: Overwrite = False


@dataclass(frozen=True)
class McpCommand:
    """Serve agents ask, why, whatif, failures, query and replay over MCP, on standard input and output (extra: mcp)."""

    paths: Positional[tuple[str, ...]]
    """Datasets, runs, and cases or folders of cases; nothing else is opened. "demo" is the built-in dataset with its
    run."""
    labels: Truth = None
    allow_corrections: Flag = False
    """Let agents correct --labels too: show, correct, confirm, undo, redo, journal. Without it nothing is written."""
    author: str | None = None
    """By whom it is said: the name of their corrections in the journal."""
    journal: JournalArg = JournalOptions()
    source: SourceArg = SourceOptions()
