"""State of a client's view, also as the page's address. Frozen: every change makes a new state, and the page is drawn
from the state."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import field, replace
from functools import cached_property
from typing import Literal, get_args
from urllib.parse import parse_qs, urlencode

import numpy as np

from pipeline.corrections.object_card import LabelView
from pipeline.diagnosis.suggestions import SuggestedQuestions
from pipeline.diagnosis.whatif.answer_view import AnswerView
from pipeline.diagnosis.whatif.edits import Edits
from pipeline.diagnosis.whatif.state import CameraView
from pipeline.evaluation.mend_counts import MendCount, SettingChange
from pipeline.evaluation.run_figures import Listing, Recorded
from pipeline.geometry.palette import RGB, Role, palette
from pipeline.geometry.viewer import Measurement, measure
from pipeline.system.frozen import dataclass

CameraMode = Literal["pair", "sensor", "orbit", "top"]
"""Viewpoints of the scene."""
Task = Literal["explain", "evaluate", "label"]
"""Tasks of the page: explain an answer, evaluate a run, or label."""
Side = Literal["a", "b", "both"]
"""Of two runs whose answer is shown: the first's, the second's, or the first's with a table of both."""
STAGES = ("PARSE", "OPM", "LIFT", "SRM", "ATTRIBUTE", "PRM", "LABEL", "-")


@dataclass(frozen=True)
class Place:
    """View of a page; None for unset fields."""

    source: str | None = None
    frame: str | None = None
    text: str | None = None  # Question; "" for none
    task: Task | None = None
    stage: str | None = None  # Module with open evidence
    find: str | None = None  # Search of the run
    item: tuple[int, int] | None = None  # Numbers of the shown labelled pair
    # Turned view in the frame's camera frame (metres), and field of view (radians)
    camera: tuple[CameraView, float | None] | None = None
    pair: int | None = None  # Rank of the shown pair, from 1; None for the best
    look: CameraMode | None = None  # Viewpoint; None for the pair
    side: Side | None = None
    missing: str = ""  # Dataset of an address that is not open here

    @classmethod
    def read(cls, query: str, sources: Collection[str]) -> Place:
        """Parse a query; an unknown dataset gives a place without a view, unreadable fields are dropped."""
        try:
            fields = {
                key: values[0] for key, values in parse_qs(query, keep_blank_values=True, max_num_fields=16).items()
            }
        except ValueError:
            return cls()
        source = fields.get("data")
        if source is not None and source not in sources:
            return cls(missing=source)
        task = next((t for t in get_args(Task) if t == fields.get("mode")), None)
        stage, pair = fields.get("stage"), fields.get("pair", "")
        look = next((m for m in get_args(CameraMode) if m == fields.get("look")), None)
        item = [int(n) for n in fields.get("item", "").split(",") if n.isdecimal()]
        return cls(
            source,
            fields.get("frame"),
            fields.get("ask"),
            task,
            stage if stage in STAGES else None,
            fields.get("find"),
            (item[0], item[1]) if len(item) == 2 else None,
            _camera(fields.get("camera", "")),
            int(pair) if pair.isdecimal() and len(pair) < 6 else None,
            look,
            next((s for s in get_args(Side) if s == fields.get("run")), None),
        )

    def dead(self, frames: Collection[str]) -> str:
        """Reason of a place that cannot be shown, by the frames of its dataset; "" for none."""
        if self.missing:
            return f"No dataset {self.missing} is open here"
        return "" if self.frame is None or self.frame in frames else f"There is no frame {self.frame}"

    def query(self) -> str:
        """Query of this place."""
        item = None if self.item is None else ",".join(map(str, self.item))
        camera = None
        if self.camera is not None:
            view, fov = self.camera
            numbers = [*view.position, *view.look_at, *view.up, *([] if fov is None else [fov])]
            camera = ",".join(f"{n:.3f}".rstrip("0").rstrip(".") for n in numbers)
        said = {
            "data": self.source,
            "frame": self.frame,
            "ask": self.text,
            "mode": self.task,
            "stage": self.stage or None,
            "find": self.find or None,
            "item": item,
            "camera": camera,
            "pair": self.pair,
            "look": self.look,
            "run": self.side,
        }
        return urlencode({key: value for key, value in said.items() if value is not None}, safe="/,:")

    def same_view(self, other: Place) -> bool:
        """True for equal frame, question, task and side: no step of Back."""
        return all(getattr(self, name) == getattr(other, name) for name in ("source", "frame", "text", "task", "side"))


def _camera(text: str) -> tuple[CameraView, float | None] | None:
    try:
        n = [float(x) for x in text.split(",")]
    except ValueError:
        return None
    if len(n) not in (9, 10) or not np.isfinite(n).all() or max(map(abs, n)) > 1e4:
        return None
    return CameraView((n[0], n[1], n[2]), (n[3], n[4], n[5]), (n[6], n[7], n[8])), n[9] if len(n) == 10 else None


ColorMode = Literal["rgb", "objects", "depth", "evidence"]
EditMode = Literal["off", "move", "turn", "resize"]
Tool = Literal["", "level", "measure"]


@dataclass(frozen=True)
class SceneFlags:
    """Visible parts of the scene."""

    cloud: bool = True
    boxes: bool = False
    labels: bool = False
    pairs: bool = False
    truth: bool = False
    axes: bool = False
    context: bool = False
    camera: bool = False
    ghosts: bool = True
    region: bool = False
    grid: bool = False
    dim: bool = True  # Points beside the answer


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
    kept: tuple[str, str] | None = None  # Text and id of the expression of the open saved case
    mode: EditMode = "off"  # Handles of the selected object's box
    labels: LabelView | None = None  # Shown labels, in place of an answer
    correctable: bool = False  # True with open, correctable labels
    picking: Tool = ""  # Tool of the next click, "level" or "measure"; "" selects
    marks: tuple[tuple[int, int], ...] = ()  # Ends of the measurement, up to two pixels
    point_size: float = 1.0  # Factor of the cloud's points
    evaluating: bool = False  # True while the run is shown, not an answer
    stage: str = ""  # Module with open evidence; "" by the answer, "-" for none
    side: Side = "a"
    # Edits of the tried mend, and the number in place of the story's; what a setting of its kind does to the run, or
    # the setting while that is counted
    tried: Edits | None = None
    tried_value: float | None = None
    mended: MendCount | SettingChange | None = None
    drawer: str = ""  # Open tab of the drawer

    @property
    def task(self) -> Task:
        """Current task."""
        return "label" if self.labels is not None else "evaluate" if self.evaluating else "explain"

    def expression_id(self, text: str) -> str | None:
        """Id of the run's expression with this text: the open expression, else the frame's first; or a saved case's."""
        if self.listing is None:
            return self.kept[1] if self.kept is not None and self.kept[0] == text else None
        at, rows = self.listing.at, self.listing.figures.rows
        if at is not None and (at[0], at[2]) == (self.frame_id, text):
            return at[1]
        number = rows.asked(self.frame_id, text)
        return None if number is None else rows.keys(np.array([number]))[0][1]

    @cached_property
    def listed(self) -> int | None:
        """Position of the current expression in the list of the run; None if not listed."""
        listing = self.listing
        if listing is None:
            return None
        if listing.at is not None and (listing.at[0], listing.at[2]) == (self.frame_id, self.text):
            return listing.place
        return listing.place_of(listing.figures.rows.asked(self.frame_id, self.text))

    @cached_property
    def recorded(self) -> Recorded | None:
        """Verdict of the run on the current, unedited expression."""
        expression = self.expression_id(self.text)
        if self.listing is None or expression is None or self.edited is not None or self.side == "b":
            return None
        number = self.listing.figures.rows.number(self.frame_id, expression)
        return None if number is None else self.listing.figures.recorded(number)

    @property
    def unasked(self) -> State:
        """State without an answer."""
        return replace(
            self,
            trace=None,
            pair=None,
            selected=None,
            error="",
            stopped="",
            judged=None,
            other=None,
            edited=None,
            tried=None,
            tried_value=None,
            mended=None,
            labels=None,
            stage="",
        )

    @cached_property
    def roles(self) -> dict[int, Role]:
        """Roles of an answer's pair; of labels, what is asked about is in one colour."""
        return super().roles if self.labels is None else dict.fromkeys(self.labels.asked, "truth")

    def color(self, place: int) -> RGB:
        """Colour of an object's role, by the theme."""
        return palette(self.dark)[self.roles.get(place, "other")]

    @property
    def pair_lines(self) -> list[tuple[int, int]]:
        """Lines of an answer's pairs; labels have none."""
        return super().pair_lines if self.labels is None else []

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
        # The picture and depth look the same on any ground.
        dark = self.dark and self.colors not in ("rgb", "depth")
        return (self.source, self.frame_id, self.colors, dark, roles)

    @property
    def spotlit(self) -> list[np.ndarray] | None:
        """(H, W) bool each: masks that the cloud is dimmed around, of an answer in the picture's own colours."""
        dims = self.flags.dim and self.colors == "rgb" and self.labels is None
        return self.lit if dims and (self.roles or self.ghosts) else None

    @property
    def at_place(self) -> Place:
        """Place restored by a reload; without a question while labels are shown."""
        look = None if self.camera == "pair" else self.camera
        pair = next((n for n, p in enumerate(self.ranked, 1) if self.at(p) == self.pair), 1)
        place = Place(
            self.source,
            self.frame_id,
            self.text,
            self.task,
            self.stage,
            pair=None if pair == 1 else pair,
            look=look,
            side=None if self.side == "a" else self.side,
        )
        if self.labels is None:
            return place
        card = self.labels.card
        return replace(place, text=None, item=None if card is None else (card.a, card.b))
