"""URL state: a page's view as its address, for links, reload and Back."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Literal, get_args
from urllib.parse import parse_qs, urlencode

import numpy as np

from pipeline.diagnosis.whatif.state import CameraView

CameraMode = Literal["pair", "sensor", "orbit", "top"]
"""Viewpoints of the scene."""
Task = Literal["explain", "evaluate", "label"]
"""Tasks of the page: explain an answer, evaluate a run, or label."""
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

    @classmethod
    def read(cls, query: str, sources: Collection[str]) -> Place:
        """Parse a query; an unknown dataset gives an empty place, unreadable fields are dropped."""
        try:
            fields = {
                key: values[0] for key, values in parse_qs(query, keep_blank_values=True, max_num_fields=16).items()
            }
        except ValueError:
            return cls()
        source = fields.get("data")
        if source is not None and source not in sources:
            return cls()
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
        )

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
        }
        return urlencode({key: value for key, value in said.items() if value is not None}, safe="/,:")

    def same_view(self, other: Place) -> bool:
        """True for equal frame, question and task: no step of Back."""
        return all(getattr(self, name) == getattr(other, name) for name in ("source", "frame", "text", "task"))


def _camera(text: str) -> tuple[CameraView, float | None] | None:
    try:
        n = [float(x) for x in text.split(",")]
    except ValueError:
        return None
    if len(n) not in (9, 10) or not np.isfinite(n).all() or max(map(abs, n)) > 1e4:
        return None
    return CameraView((n[0], n[1], n[2]), (n[3], n[4], n[5]), (n[6], n[7], n[8])), n[9] if len(n) == 10 else None
