"""State of a client's view. Frozen: every change makes a new state, and the page is drawn from the state."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal

import numpy as np
from pipeline.diagnosis.suggested_questions import SuggestedQuestions

from pipeline.corrections.label_view import LabelView
from pipeline.diagnosis.whatif.answer_view import AnswerView
from pipeline.evaluation.run_figures import Listing, Recorded, recorded_verdict
from pipeline.geometry.viewer import Measurement, measure
from spatialviz.app.url_state import CameraMode, Place, Task

ColorMode = Literal["rgb", "objects", "depth", "evidence"]
EditMode = Literal["off", "move", "turn", "resize"]
Tool = Literal["", "level", "measure"]


@dataclass(frozen=True)
class SceneFlags:
    """Visible parts of the scene."""

    cloud: bool = True
    boxes: bool = False
    labels: bool = False
    pairs: bool = True
    truth: bool = False
    axes: bool = False
    ghosts: bool = True
    region: bool = False
    grid: bool = False


@dataclass(frozen=True)
class State(AnswerView):
    """View of a client."""

    source: str
    frame_id: str
    problem: str = ""  # Reason of a frame that cannot be shown
    text: str = ""  # Expression as typed
    error: str = ""  # Reason of a refused expression
    stopped: str = ""  # Stage of the refusal
    colors: ColorMode = "rgb"
    camera: CameraMode = "pair"
    flags: SceneFlags = field(default_factory=SceneFlags)
    dark: bool = True
    offers: SuggestedQuestions = field(default_factory=SuggestedQuestions)  # Suggested questions
    listing: Listing | None = None  # Search of the pipeline's run
    mode: EditMode = "off"  # Handles of the selected object's box
    labels: LabelView | None = None  # Shown labels, in place of an answer
    correctable: bool = False  # True with open, correctable labels
    picking: Tool = ""  # Tool of the next click, "level" or "measure"; "" selects
    marks: tuple[tuple[int, int], ...] = ()  # Ends of the measurement, up to two pixels
    evaluating: bool = False  # True while the run is shown, not an answer
    hovered: int | None = None  # Index in `shown.objects` of the row under the mouse
    stage: str = ""  # Module with open evidence; "" by the answer, "-" for none

    @property
    def task(self) -> Task:
        """Current task."""
        return "label" if self.labels is not None else "evaluate" if self.evaluating else "explain"

    def expression_id(self, text: str) -> str | None:
        """Id of the run's expression with this text: the open expression, else the frame's first."""
        if self.listing is None:
            return None
        at, rows = self.listing.at, self.listing.figures.rows
        if at is not None and (at[0], at[2]) == (self.frame_id, text):
            return at[1]
        number = rows.asked(self.frame_id, text)
        return None if number is None else rows.keys[number][1]

    @cached_property
    def recorded(self) -> Recorded | None:
        """Verdict of the run on the current, unedited expression."""
        expression = self.expression_id(self.text)
        if self.listing is None or expression is None or self.edited is not None:
            return None
        rows = self.listing.figures.rows
        number = rows.number(self.frame_id, expression)
        return None if number is None else recorded_verdict(rows.read(np.array([number]))[0])

    @property
    def unasked(self) -> State:
        """State without an answer."""
        return replace(
            self,
            trace=None,
            pair=None,
            selected=None,
            hovered=None,
            error="",
            stopped="",
            judged=None,
            other=None,
            edited=None,
            labels=None,
            stage="",
        )

    @property
    def boxes_shown(self) -> bool:
        """True if all boxes are shown: on request, or without any pair, even labelled."""
        return self.flags.boxes or not (self.roles or self.ghosts)

    @property
    def about(self) -> np.ndarray | None:
        """(N, 3) box corners, shown frame: chosen pair with extra boxes, or the object of the open label item."""
        if self.loaded is None:
            return None
        seen = list(self.roles)
        if not seen and self.selected is not None and self.labels is not None and self.labels.item is not None:
            seen = [self.selected]
        boxes = [self.shown.objects[i].lifted.box for i in seen] + [ghost.box for ghost in self.ghosts]
        viewer = self.loaded.context.viewer
        to_show = np.stack([viewer.right, viewer.forward, viewer.up])
        corners = [box.corners @ to_show.T for box in boxes if box is not None]
        return np.concatenate(corners) if corners else None

    @property
    def measured(self) -> Measurement | None:
        """Measurement between the two marked pixels."""
        if self.loaded is None or len(self.marks) < 2:
            return None
        context = self.loaded.context
        return measure(context.frame.depth, context.frame.camera, context.viewer, *self.marks[:2])

    @property
    def paint_key(self) -> tuple[object, ...]:
        """Cache key of the cloud's colours."""
        roles = tuple(sorted(self.roles.items())) if self.colors == "objects" else ()
        return (self.source, self.frame_id, self.colors, self.dark, roles)

    @property
    def at_place(self) -> Place:
        """Place restored by a reload; without a question while labels are shown."""
        look = None if self.camera == "pair" else self.camera
        pair = next((n for n, p in enumerate(self.ranked, 1) if self.at(p) == self.pair), 1)
        place = Place(
            self.source, self.frame_id, self.text, self.task, self.stage, pair=None if pair == 1 else pair, look=look
        )
        if self.labels is None:
            return place
        card = self.labels.card
        return replace(place, text=None, item=None if card is None else (card.a, card.b))
