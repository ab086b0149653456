"""Pipeline of a dataset and its models; ask, relations and frames, on a single frame or on all."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import field, replace
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from pipeline.answering.ask import AskConfig, Trace, ask
from pipeline.answering.objects import PreparedFrame, SceneObject, all_objects, appearance_of, prepare_frame
from pipeline.datasets import Dataset, open_dataset, resolve_frame
from pipeline.datasets.base import Frames
from pipeline.datasets.demo import found_by_name
from pipeline.datasets.opening import open_each
from pipeline.geometry.frame import Frame
from pipeline.geometry.viewer import ViewerAxes
from pipeline.language.expression import Reader, parse
from pipeline.language.naming import Synonyms
from pipeline.language.relation_names import PAIRWISE
from pipeline.language.tree import Query
from pipeline.proposals import Detector, Segmented, Segmenter, make_segmenter
from pipeline.proposals.registry import SegmenterFiles, open_detector
from pipeline.relations import RelationScorer, RelationScores, make_scorer
from pipeline.system.detector_setup import DetectorSetup, Fusion
from pipeline.system.errors import FrameUnusable, InputError, require
from pipeline.system.frozen import dataclass

if TYPE_CHECKING:
    from pipeline.answering.predictions import Prediction, Predictions

ALL_FRAMES = "all"
Skipped = Callable[[str, str], None]
"""Called with (frame id, reason) for a frame that is left out."""


@dataclass(frozen=True)
class Pipeline:
    """Dataset with the models to use on it."""

    dataset: Dataset
    detector: Detector | None  # None where the dataset has no annotations and no detector was named
    scorer: RelationScorer
    config: AskConfig = field(default_factory=AskConfig)
    synonyms: Synonyms | None = None
    open_unfiltered: Callable[[], Detector | None] | None = None  # Opens the same detector without a minimum score
    reader: Reader = parse  # What reads expressions: the grammar, unless another was asked for
    predictions: Predictions | None = None  # Of another pipeline, which answers are read from
    line: Prediction | None = None  # Of these, the one expression that this pipeline is about
    segmenter: Segmenter | None = None  # Makes masks for boxes, or for points

    def __repr__(self) -> str:
        name = self.dataset.root.resolve().name
        detector = "no detector" if self.detector is None else f"detector {self.detector.name}"
        return f"<Pipeline {name}: {len(self.dataset.frame_ids)} frames, {detector}, relations by {self.scorer.name}>"

    @property
    def frames(self) -> Frames:
        """Frames of the dataset, decoded on access."""
        return Frames(self.dataset)

    def prepare(self, frame: int | str | Frame) -> PreparedFrame:
        """Prepare a frame for questions: by its number, its id, or at hand; InputError for a broken frame."""
        if not isinstance(frame, Frame):
            frame = self.dataset.load(resolve_frame(self.dataset, frame))
        return prepare_frame(self.dataset, frame, self.config.lift)

    def unfiltered_detector(self) -> Detector:
        """Detector without a minimum score; itself without any."""
        return self._unfiltered or self.needed_detector()

    @cached_property
    def _unfiltered(self) -> Detector | None:
        return None if self.open_unfiltered is None else self.open_unfiltered()

    def needed_detector(self) -> Detector:
        """Detector; InputError for none.

        Raises
        ------
        InputError
            Where there is none.
        """
        if self.detector is None:
            raise InputError(
                "the dataset has no annotations, and no detector was named",
                expected="--detector yolo-seg --model FILE.onnx or --detector recorded --model FILE.json",
                path=self.dataset.root,
            )
        return self.detector

    def score(
        self,
        context: PreparedFrame,
        objects: Sequence[SceneObject],
        relations: Collection[str] = PAIRWISE,
        wanted: np.ndarray | None = None,
    ) -> RelationScores:
        """Relations of every ordered pair of the frame's objects; InputError for a class unknown to the scorer.

        `wanted`, (N, N) bool: the only pairs that a network is asked about.
        """
        appearance, only = appearance_of(objects, context.frame), {} if wanted is None else {"wanted": wanted}
        return self.scorer.score([o.lifted for o in objects], context.viewer, appearance, relations, **only)

    @property
    def names(self) -> tuple[str, ...]:
        """Names kept whole in an expression: the dataset's, else the detector's."""
        return tuple(self.dataset.class_names) or tuple(self.needed_detector().vocabulary or ())

    def read(self, text: str) -> Query:
        """Read an expression; InputError if unreadable."""
        return self.reader(text, class_names=self.names, relations=self.config.relations, synonyms=self.synonyms)

    def asked(self, frame_id: str, text: str) -> Pipeline:
        """Pipeline of a single expression: itself, or of imported predictions that of its line."""
        return self

    def ask(self, frame: Frame | PreparedFrame, text: str) -> Trace:
        """Answer an expression on a frame with these models."""
        own = self.asked(frame.id if isinstance(frame, Frame) else frame.frame.id, text)
        return ask(
            frame,
            text,
            own.needed_detector(),
            scorer=own.scorer,
            config=own.config,
            class_names=own.names,
            synonyms=own.synonyms,
            reader=own.reader,
        )


def open_pipeline(
    path: str | Path | Dataset,
    *,
    intrinsics: tuple[float, float, float, float] | None = None,
    depth_scale: float | None = None,
    up: str | None = None,
    level_at: str | None = None,
    depth_model: str | None = None,
    poses: str | None = None,
    registration: tuple[float, ...] | None = None,
    detector: str | Detector | None = None,
    model: Path | None = None,
    model_config: Path | None = None,
    min_score: float | None = None,
    segmenter: str | Segmenter | None = None,
    segmenter_model: SegmenterFiles = None,
    srm: str | Path | RelationScorer = "trained",
    vectors: Path | None = None,
    synonyms: Path | None = None,
    config: AskConfig | None = None,
    fuse: Sequence[str] = (),
    fusion: Fusion = "wbf",
    reader: Literal["grammar", "llm"] | Reader = "grammar",
    reader_url: str | None = None,
    reader_model: str | None = None,
    browse: bool = False,
) -> Pipeline:
    """Open a dataset and the models for it; the path "demo" is the built-in one, and a dataset may be open already.

    The camera's options, from `intrinsics` to `registration`, and `browse` are those of `open_dataset`. `detector`,
    `segmenter` and `srm` are names, as on the command line, or objects of one's own; a detector of one's own takes no
    `model`, `model_config`, `min_score` and `fuse`.
    `segmenter` makes masks for boxes that have none ("depth", "recorded", "yolo-seg", "sam", "sam2", "efficientsam");
    by default there is none. `segmenter_model` is its file, or its encoder and decoder. A network's file may also be
    named by its id on the model hub. `model_config` says what the detector's file does not.
    `srm` is "trained" (the shipped network), "rule", or the path of a network that `spatialviz train` wrote;
    `vectors` the file of text vectors it was trained with, for classes it was not trained on.
    `fuse` names further detectors ("NAME" or "NAME=MODEL") whose detections are fused with the detector's, by weighted
    boxes ("wbf") or non-maximum suppression ("nms") as `fusion` says. The minimum score and the segmenter are for all
    of them.
    `reader` is what reads expressions: "grammar", "llm" (the model `reader_model` of the OpenAI-compatible server
    `reader_url`, its key in SPATIALVIZ_VLM_KEY), or a function of one's own.

    Raises
    ------
    InputError
        For a folder that cannot be read, an unknown model name, a model file of another contract, a score calibration
        of another detector.

    >>> pipeline = open_pipeline("demo", srm="rule")
    >>> pipeline
    <Pipeline demo: 12 frames, detector annotations, relations by rule>
    >>> trace = pipeline.ask(pipeline.prepare(0), "mug left of the laptop")
    >>> trace.name(trace.ranking.pairs[0].target)
    'mug·3'
    """
    camera: dict[str, Any] = {
        "intrinsics": intrinsics,
        "depth_scale": depth_scale,
        "up": up,
        "level_at": level_at,
        "depth_model": depth_model,
        "poses": poses,
        "registration": registration,
    }
    if isinstance(path, str | Path):
        dataset = open_dataset(found_by_name(path), **camera, browse=browse)
    else:
        _refuse(camera, "a dataset that is open already")
        dataset = path
    table = Synonyms.load(synonyms)
    named = detector is not None
    detector = detector if named else "annotations" if dataset.class_names else None
    for option, given, needed, what, cause in (
        ("--model", model, named, "--detector", "which kind of model is it?"),
        ("--fuse", fuse or None, named, "--detector", "what is fused with what?"),
        ("--model-config", model_config, detector is not None, "--detector", "what is it for?"),
        ("--segmenter-model", segmenter_model, segmenter is not None, "--segmenter", "what is it for?"),
        ("--reader-url", reader_url, reader == "llm", "--reader llm", "what is it for?"),
        ("--reader-model", reader_model, reader == "llm", "--reader llm", "what is it for?"),
    ):
        if given is not None and not needed:
            path_of = given if isinstance(given, Path) and what == "--detector" else None
            raise InputError(f"{option} needs {what}", cause=cause, path=path_of)
    setup = None
    if isinstance(detector, str):
        setup = DetectorSetup(detector, model, model_config, tuple(fuse), fusion, min_score, synonyms)
    elif detector is not None:
        own = {"model": model, "model_config": model_config, "min_score": min_score, "fuse": fuse or None}
        _refuse(own, f"the detector {detector.name}, which is made already")

    def make(min_score: float | None) -> Detector | None:
        if setup is None:
            return None
        return open_detector(replace(setup, min_score=min_score), dataset.class_names, table, dataset.frame_ids)

    found = make(min_score) if detector is None or isinstance(detector, str) else detector
    masks = segmenter
    if isinstance(masks, str):
        masks = make_segmenter(masks, model=segmenter_model, synonyms=table)
    if masks is not None:
        found = None if found is None else Segmented(found, masks)
    config = config or AskConfig()
    if config.score_calibration is not None and found is not None:
        config.score_calibration.check(found)
    scorer = make_scorer(srm, vectors) if isinstance(srm, str | Path) else srm
    read = make_reader(reader, reader_url, reader_model)
    return Pipeline(dataset, found, scorer, config, table, lambda: make(0.0), read, segmenter=masks)


def make_reader(reader: str | Reader, url: str | None, model: str | None) -> Reader:
    """Reader by name or as given; InputError for a missing server or model."""
    if not isinstance(reader, str):
        return reader
    if reader == "grammar":
        return parse
    require(reader == "llm", "no such reader of expressions", got=repr(reader), expected="grammar or llm")
    if url is None or model is None:
        example = "--reader-url http://localhost:8000/v1 --reader-model NAME"
        raise InputError("--reader llm needs a server and a model", expected=example)
    from pipeline.language.llm_reader import LlmReader

    return LlmReader(url, model)


def file_of(pipeline: Pipeline) -> Predictions:
    """Predictions read by a pipeline."""
    assert pipeline.predictions is not None
    return pipeline.predictions


def line_of(pipeline: Pipeline) -> Prediction:
    """Prediction behind a pipeline of a single expression."""
    assert pipeline.line is not None
    return pipeline.line


def _refuse(options: Mapping[str, object], what: str) -> None:
    """Raise InputError for any of these options."""
    given = [name for name, value in options.items() if value is not None]
    if given:
        raise InputError(f"{given[0]} is not for {what}", got=options[given[0]], expected="leave it out")


def open_sources(path: str | Path, **options: Any) -> tuple[dict[str, Pipeline], dict[str, str]]:
    """Open a dataset, or all datasets in the folders of a folder.

    Parameters
    ----------
    path : str or Path
        A dataset, "demo", or a folder whose folders are datasets.
    options
        As for `open_pipeline`.

    Returns
    -------
    pipelines : dict of str to Pipeline
        By folder name, at least one.
    left_out : dict of str to str
        Folders that could not be opened, and why.

    Raises
    ------
    InputError
        Where nothing can be opened; the reason is that of the folder itself.
    """
    return open_each(path, partial(open_pipeline, **options))


def frame_range(dataset: Dataset, key: str | int | None) -> tuple[str, ...]:
    """Frames of a FRAME or --frames argument: "all" (or None), FROM:TO by index (TO is out), an id, an index.

    Raises
    ------
    InputError
        No such frame, or an empty range.
    """
    if key is None or key == ALL_FRAMES:
        return dataset.frame_ids
    bounds = re.fullmatch(r"([0-9]{0,9}):([0-9]{0,9})", str(key).strip())
    if bounds is None or key in dataset.frame_ids:
        return (resolve_frame(dataset, key),)
    found = dataset.frame_ids[int(bounds[1] or 0) : int(bounds[2]) if bounds[2] else None]
    require(found, "the range holds no frame", got=key, expected=f"within 0:{len(dataset.frame_ids)}")
    return found


def contexts(pipeline: Pipeline, key: str | int | None, skipped: Skipped | None = None) -> Iterator[PreparedFrame]:
    """Prepared frames, lazily.

    A broken frame that was asked for by name is an error; among all frames it is skipped with its reason.
    """
    for frame_id in frame_range(pipeline.dataset, key):
        try:
            context = prepare_frame(pipeline.dataset, pipeline.dataset.load(frame_id), pipeline.config.lift)
        except InputError as error:
            skip_or_raise(error, key, frame_id, skipped)
            continue
        yield context


def skip_or_raise(error: InputError, key: str | int | None, frame_id: str, skipped: Skipped | None) -> None:
    """Raise the error of a frame asked by name; among all frames, report and go on."""
    if key is not None and key != ALL_FRAMES:
        raise error
    if skipped is not None:
        skipped(frame_id, str(error))


@dataclass(frozen=True)
class FrameRelations:
    """Objects of a frame with every relation between them; `exact` for the dataset's own objects, `viewer` the judged
    axes, `depth_source` of the frame."""

    frame_id: str
    objects: tuple[SceneObject, ...]
    scores: RelationScores
    exact: bool
    viewer: ViewerAxes | None = None
    depth_source: str = ""


def relate_frames(
    pipeline: Pipeline, key: str | int | None, skipped: Skipped | None = None
) -> Iterator[FrameRelations]:
    """Score every pair of objects of every frame of `key`."""
    detector = pipeline.needed_detector()
    for context in contexts(pipeline, key, skipped):
        try:
            objects = all_objects(context, detector)
        except FrameUnusable as error:
            skip_or_raise(error, key, context.frame.id, skipped)
            continue
        scores = pipeline.score(context, objects)
        frame = context.frame
        yield FrameRelations(frame.id, objects, scores, detector.exact, context.viewer, frame.depth_source)
