"""Pipeline opened for questions from Python: `open` and `ask` of the public face."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipeline.answering.objects import PreparedFrame
from pipeline.answering.pipeline import Pipeline, open_pipeline
from pipeline.datasets import Dataset, resolve_frame
from pipeline.datasets.base import Frames, InMemoryDataset
from pipeline.diagnosis.answer import Answer
from pipeline.diagnosis.asking import edited_trace, judged, truth_or_reason
from pipeline.geometry.frame import Frame
from pipeline.labels.cases import FrameCases
from pipeline.proposals import Detector
from pipeline.relations import TRAINED, make_scorer
from pipeline.relations.scorer import supplied_relations
from pipeline.system.errors import InputError
from pipeline.system.frozen import dataclass

if TYPE_CHECKING:
    from pipeline.labels.reading import Labels

KEPT_FRAMES = 4
"""So many frames stay ready for the next question."""
Source = str | Path | Dataset | Frame | Sequence[Frame]
"""What can be opened: a folder, "demo", a dataset of one's own, frames that are at hand."""


@dataclass(frozen=True)
class Opened:
    """Pipeline opened for questions from Python, with the truth of its frames.

    >>> opened = open("demo")
    >>> opened
    <Pipeline demo: 12 frames, detector annotations, relations by rel32>
    >>> opened.frames[0].rgb.shape, opened.ask(0, "mug left of the laptop").verdict
    ((480, 640, 3), 'CORRECT')
    """

    pipeline: Pipeline  # Dataset with its models
    labels: Labels | None = None  # What is true; without them the frames' annotations say it, where there are any
    # Shows this, or an answer of it. The core has no screen: `spatialviz.open` sets it.
    viewer: Callable[..., Any] | None = None

    def __repr__(self) -> str:
        truth = "" if self.labels is None else f", true by {self.labels.root.name}"
        return f"{repr(self.pipeline).removesuffix('>')}{truth}>"

    @property
    def frames(self) -> Frames:
        """Frames of the dataset, decoded on access: `for frame in opened.frames`, `opened.frames[0]`."""
        return self.pipeline.frames

    @cached_property
    def _prepared(self) -> Callable[[str], tuple[PreparedFrame, FrameCases | str | None]]:
        return lru_cache(maxsize=KEPT_FRAMES)(lambda frame_id: self._with_truth(self.pipeline.prepare(frame_id)))

    def _with_truth(self, context: PreparedFrame) -> tuple[PreparedFrame, FrameCases | str | None]:
        return context, truth_or_reason(self.pipeline, context, self.labels)

    def ask(self, frame: int | str | Frame, text: str) -> Answer:
        """Answer an expression such as "mug left of the laptop".

        Parameters
        ----------
        frame : int, str or Frame
            Its number in the dataset, its id, or one that is at hand.

        Raises
        ------
        InputError
            No such frame, a broken one, an expression that cannot be read, a name that the detector cannot know.
        """
        self.pipeline.needed_detector()
        if isinstance(frame, Frame):
            context, truth = self._with_truth(self.pipeline.prepare(frame))
        else:
            context, truth = self._prepared(resolve_frame(self.pipeline.dataset, frame))
        return replace(judged(self.pipeline.ask(context, text), self.pipeline, context, truth), origin=self)

    def what_if(self, answer: Answer, edits: Mapping[str, Any]) -> Answer:
        """Answer of this pipeline under edits; see `Answer.what_if`."""
        context, truth = self._with_truth(self.pipeline.prepare(answer.needed_trace().frame))
        trace, rank = edited_trace(self.pipeline, context, answer.text, edits)
        return replace(judged(trace, self.pipeline, context, truth, rank), origin=self, edits=edits)

    def show(self, **options: Any) -> Any:
        """Open the page; `options` as for `spatialviz.show`."""
        return self.view(self, **options)

    def view(self, what: Opened | Answer, **options: Any) -> Any:
        """Show this pipeline, or an answer of it.

        Raises
        ------
        InputError
            Nothing here has a screen.
        """
        if self.viewer is None:
            raise InputError("the core has no screen", expected="import spatialviz, and spatialviz.open")
        return self.viewer(what, **options)


def open(
    dataset: Source,
    *,
    labels: str | Path | Labels | None = None,
    detector: str | Detector | None = None,
    model: str | Path | None = None,
    **options: Any,
) -> Opened:
    """Open a dataset and the models for questions.

    Parameters
    ----------
    dataset : str, Path, Dataset, Frame or sequence of Frame
        A folder, "demo" for the built-in one, a dataset of one's own, or frames that are at hand.
    labels : str, Path or Labels, optional
        A labels folder that says what is true; answers are then judged in its axes. Default: the frames' annotations.
    detector : str or Detector, optional
        A name as on the command line, or an object of one's own. Default: the dataset's annotations, where it has any.
    model : str or Path, optional
        Its file, or its id on the model hub.
    options
        All others of `pipeline.answering.pipeline.open_pipeline`: min_score, segmenter, srm, up, intrinsics, ...

    >>> opened = open("demo")
    >>> answer = opened.ask(0, "mug left of the laptop")
    >>> answer.target.label, answer.reference.label, answer.holds, answer.verdict
    ('mug', 'laptop', True, 'CORRECT')
    """
    found = None
    options |= {"detector": detector, "model": None if model is None else Path(model)}
    if labels is not None:
        from pipeline.labels.reading import labelled_up, open_labels

        found = open_labels(labels) if isinstance(labels, str | Path) else labels
        options = labelled_up(found.manifest, options)
    if isinstance(dataset, Frame):
        dataset = [dataset]
    if isinstance(dataset, Sequence) and not isinstance(dataset, str):
        dataset = InMemoryDataset(dataset)
    return Opened(open_pipeline(dataset, **options), found)


def open_arrays(
    rgb: Any,
    depth: Any,
    K: Any,
    *,
    boxes: Sequence[Any] | None = None,
    relations: Mapping[str, Any] | None = None,
    **arrays: Any,
) -> Opened:
    """Open arrays for questions: given boxes and relations are kept, the rest is computed.

    `rgb`, `depth`, `K`: as for `Frame.of_arrays`, from numpy or another library; `boxes`: A 3D box or None for each
    mask, camera frame, metres: a Box3D, its (8, 3) corners, or a mapping of `center`, `size` and `rotation`;
    `relations`: P("a RELATION b") by relation, (N, N) float or {(a, b): p}, objects by their place in `masks`;
    `arrays`: masks, names, up, T_world_camera, id: as for `Frame.of_arrays`.
    """
    found = None
    if boxes is not None:
        from pipeline.answering.coordinate_conventions import box_at_hand

        found = [box_at_hand(box, f"boxes[{k}]") for k, box in enumerate(boxes)]
    frame = Frame.of_arrays(rgb, depth, K, boxes=found, **arrays)
    scorer = make_scorer(TRAINED)
    if relations is not None:
        scorer = supplied_relations(relations, len(frame.annotations), scorer)
    return open(frame, srm=scorer)


def ask(dataset: Opened | Source, frame: int | str | Frame, text: str, **options: Any) -> Answer:
    """Answer an expression; for several open the dataset once. `options` as for `open`.

    >>> ask("demo", 0, "mug left of the laptop").sentence
    'mug·3 left of laptop·2: relation 1.00, product 1.00'
    """
    return (dataset if isinstance(dataset, Opened) else open(dataset, **options)).ask(frame, text)
