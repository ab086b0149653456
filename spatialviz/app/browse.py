"""Frame browser of a dataset: a strip and a grid of marked pictures, and the cameras of a scene.

Only frames in sight are loaded: names and marks by range, pictures by address.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

from pydantic import NonNegativeInt

from pipeline.datasets.base import moves
from pipeline.datasets.frame_reports import CameraPlan
from spatialviz.app.context import Context, Part, command

Which = Literal["all", "failed", "right", "open", "settled"]
"""Filters: frames with or without a wrong answer of the run, with or without an open item of the review."""
MOST_ROWS = 400
"""Frames per request of the page, at most."""
Counts = Mapping[str, tuple[int, int]]
"""By frame: (right answers or settled items, the others)."""


class Browse(Part):
    """Opens frames for a client, and fills the strip and the grid."""

    def __init__(self, ctx: Context) -> None:
        super().__init__(ctx)
        self._which: Which = "all"
        self._listed: tuple[int, ...] = ()
        self._counted: tuple[str, str, Counts] | None = None
        self._version = 0

    @property
    def _ids(self) -> tuple[str, ...]:
        return tuple(self.ctx.source.dataset.frame_ids)

    @command("frame")
    def open_number(self, number: int) -> None:
        """Show the frame of a number."""
        if 0 <= number < len(self._ids):
            self.ctx.open_frame(self._ids[number])

    @command("next-frame")
    def step(self, step: int) -> None:
        """Show the next frame, or the previous."""
        self.open_number(self._ids.index(self.state.frame_id) + step)

    @command("move")
    def move(self, move: str) -> None:
        """Follow a move of the dataset's robot; an impossible move does nothing."""
        to = moves(self.ctx.source.dataset, self.state.frame_id).get(move)
        if to is not None:
            self.ctx.open_frame(to)

    @command("frames-of")
    def choose(self, which: Which) -> None:
        """Filter the frames."""
        self._which = which
        self.follow()

    @command("frame-grid")
    def show_all(self) -> None:
        """Show the frames as a grid of pictures."""
        self.ctx.page.call("frameGrid")

    @command("frame-rows")
    def rows(self, first: NonNegativeInt, after: NonNegativeInt) -> None:
        """Send names and marks of a range of listed frames."""
        ids, counts, places = self._ids, self._counts, self._places[first : min(after, first + MOST_ROWS)]
        rows = [[n, ids[n], *counts.get(ids[n], (0, 0))] for n in places]
        self.ctx.page.call("frameRows", {"from": first, "rows": rows})

    # ---- drawing ----------------------------------------------------------------------

    @property
    def _counts(self) -> Counts:
        """Counts by frame: of the review while labels are shown, else of the run."""
        if self.state.labels is not None:
            return self.ctx.reviewed
        run = self.ctx.run
        return {} if run is None else run.frame_counts

    @property
    def _places(self) -> range | tuple[int, ...]:
        """Numbers of the listed frames."""
        counts, which, source = self._counts, self._which, self.state.source
        before = self._counted
        if before is None or before[:2] != (source, which) or before[2] is not counts:
            well = which in ("right", "settled")
            listed = (n for n, one in enumerate(self._ids) if one in counts and well == (not counts[one][1]))
            self._counted, self._version = (source, which, counts), self._version + 1
            self._listed = () if which == "all" else tuple(listed)
        return range(len(self._ids)) if which == "all" or not counts else self._listed

    @command("strip")
    def follow(self) -> None:
        """Send the strip's list and the position of the current frame."""
        state, counts, places = self.state, self._counts, self._places
        labels = state.labels is not None
        kinds = (
            {}
            if not counts
            else {"open": "open", "settled": "settled"}
            if labels
            else {"failed": "with failures", "right": "all right"}
        )
        at = self._ids.index(state.frame_id)
        data = {
            "source": list(self.ctx.shared.store.sources).index(state.source),
            "name": state.source,
            "count": len(places),
            "all": len(self._ids),
            "at": places.index(at) if at in places else -1,
            "kinds": {"all": "all"} | kinds if kinds else {},
            "which": self._which if self._which in kinds else "all",
            "words": ["settled", "open"] if labels else ["right", "wrong"],
            "version": self._version,
        }
        self.ctx.page.call("strip", data)

    def browse(self) -> None:
        """In the background, load the neighbours and find the scene's cameras."""
        state, ids, store = self.state, self._ids, self.ctx.shared.store
        at = ids.index(state.frame_id)
        store.prepare(state.source, (*ids[at + 1 : at + 2], *ids[max(0, at - 1) : at]))

        def found(plan: CameraPlan | None) -> None:
            def show() -> None:
                if (self.state.source, self.state.frame_id) == (state.source, state.frame_id):
                    self.ctx.page.call("plan", None if plan is None else _plan_data(plan, state.frame_id))

            self.ctx.post(show)

        self.ctx.shared.pictures.plan(state.source, state.frame_id, found)


def _plan_data(plan: CameraPlan, at: str) -> dict[str, object]:
    """Cameras from above for the page, with the current frame; metres to the millimetre."""
    positions, headings = plan.positions.round(3).tolist(), plan.headings.round(3).tolist()
    return {"at": at, "scene": plan.scene, "frames": plan.frame_ids, "positions": positions, "headings": headings}
