"""Frames of a dataset for the page: the timeline of all, steps through them, rows by request, pictures by address.

The timeline is sent once, a byte a frame; a step from frame to frame sends only where it leads.
"""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Callable, Mapping
from typing import Any, Literal

import numpy as np
from pydantic import NonNegativeInt

from pipeline.datasets.base import moves
from pipeline.datasets.frame_reports import CameraPlan
from pipeline.datasets.odd_frames import OddFrame
from pipeline.datasets.timeline import UNKNOWN, Timeline, next_with_share, oddest
from pipeline.evaluation.run_figures import Listing
from pipeline.evaluation.search import FAILURES
from pipeline.language.counted import counted
from spatialviz.app.channel import Command
from spatialviz.app.context import Context, Part, command
from spatialviz.app.markup import Element, h
from spatialviz.app.state import State

MOST_ROWS, MOST_IDS, MOST_MARKED = 400, 20, 60
"""Frames per request of the page, ids offered for a typed one, and odd frames of a plan, at most."""
CHANGED = 0.1
"""Above this share of changed frames the timeline is sent anew."""
Kind = Literal["wrong", "open", "depth"]
"""Meaning of the timeline's shares: wrong answers, open items of the review, or pixels without depth."""
Counts = Mapping[str, tuple[int, int]]
"""By frame: (right answers or settled items, the others)."""


class Browse(Part):
    """Opens frames for a client, and fills the timeline and the grid of all frames."""

    def __init__(self, ctx: Context) -> None:
        super().__init__(ctx)
        self._sent: tuple[str, Kind, object] = "", "depth", None
        self._data: dict[str, Any] = {}
        self._shares = np.zeros(0, np.uint8)
        self._odd: dict[str, tuple[OddFrame, ...]] = {}

    @property
    def _timeline(self) -> Timeline:
        return self.ctx.shared.pictures.timeline(self.state.source)

    @property
    def _at(self) -> int:
        return self._timeline.indices[self.state.frame_id]

    # ---- commands -------------------------------------------------------------------

    @command("frame")
    def open(self, number: int) -> None:
        """Show the frame of a number, with the first of its failures that are listed."""
        ids, listing = self._timeline.frame_ids, None if self.state.labels else self.state.listing
        place = listing.first_of(ids[number]) if listing is not None and 0 <= number < len(ids) else None
        if place is None:
            self._open_number(number)
        else:
            self.ctx.handle(Command("failure", (place,)))

    def _open_number(self, number: int) -> None:
        ids = self._timeline.frame_ids
        if 0 <= number < len(ids):
            self.ctx.open_frame(ids[number])

    @command("next-frame")
    def step(self, step: int) -> None:
        """Show the next frame, or the previous."""
        self._open_number(self._at + step)

    @command("next-open")
    def step_open(self, step: int) -> None:
        """Show the next frame with open items, or the previous."""
        self._open_number(-1 if (at := next_with_share(self._shares, self._at, step)) is None else at)

    @command("move")
    def move(self, move: str) -> None:
        """Follow a move of the dataset's robot; an impossible move does nothing."""
        to = moves(self.ctx.source.dataset, self.state.frame_id).get(move)
        if to is not None:
            self.ctx.open_frame(to)

    @command("frame-grid")
    def show_all(self) -> None:
        """Show the frames as a grid of pictures."""
        self.ctx.page.call("frameGrid")

    @command("frame-rows")
    def rows(self, numbers: list[NonNegativeInt]) -> None:
        """Send ids and counts of frames."""
        ids, counts = self._timeline.frame_ids, self._counts[1]
        rows = [[n, ids[n], *counts.get(ids[n], (0, 0))] for n in numbers[:MOST_ROWS] if n < len(ids)]
        self.ctx.page.call("frameRows", rows)

    @command("frame-typed")
    def complete(self, typed: str) -> None:
        """Offer frame ids: those that contain the text, else those around the current frame."""
        ids, first = self._timeline.frame_ids, max(0, self._at - MOST_IDS // 2)
        found = (i for i in ids if typed in i) if typed else iter(ids[first:])
        self.ctx.page.call("frameIds", [i for i, _ in zip(found, range(MOST_IDS), strict=False)])

    @command("frame-plan")
    def plan(self) -> None:
        """Send the cameras of the scene from above: at once, and with the odd ones once they are found."""
        self._plan()
        if self.state.source not in self._odd:
            self._find_odd(self._plan)

    def _plan(self) -> None:
        source, line = self.state.source, self._timeline

        def found(plan: CameraPlan | None) -> None:
            data = None if plan is None else _plan_data(plan, line.indices)
            self.ctx.post(lambda: self.ctx.page.call("plan", data))

        odd = [line.frame_ids[k] for k, _ in oddest(self._odd.get(source, ()), MOST_MARKED)]
        self.ctx.shared.pictures.plan(source, self.state.frame_id, found, odd)

    # ---- timeline -------------------------------------------------------------------

    @property
    def _counts(self) -> tuple[Kind, Counts]:
        """Counts by frame: of the review while labels are shown, else of the run."""
        if self.state.labels is not None:
            return "open", self.ctx.reviewed
        run = self.ctx.run
        return "wrong", {} if run is None else run.frame_counts

    @command("timeline")
    def follow(self) -> None:
        """Send what has changed of the timeline, and the current frame."""
        state, page = self.state, self.ctx.page
        kind, about = self._counts
        if not about:
            kind, about = "depth", self._odd.get(state.source)
            if about is None and state.labels is None:
                self._find_odd()
        if self._sent[:2] != (state.source, kind) or about is not self._sent[2]:
            self._send(kind, about)
        page.show("frame-steps", steps_html(state, kind, self._at, self._shares))
        page.call("frameAt", self._at)

    def _send(self, kind: Kind, about: Counts | tuple[OddFrame, ...] | None) -> None:
        """Send the timeline, or of one that is there already the changed frames."""
        source, line, before = self.state.source, self._timeline, self._shares
        if isinstance(about, Mapping):
            self._shares = line.shares(about)
        else:
            self._shares = line.missing_depth(about) if about else np.full(len(line.frame_ids), UNKNOWN, np.uint8)
        known = self._sent[:2] == (source, kind)
        self._sent = source, kind, about
        shares = b64encode(self._shares.tobytes()).decode()
        if known and kind != "depth" and np.mean(changed := self._shares != before) <= CHANGED:
            # A browser that connects again is sent what the page has kept, by this very mapping.
            self._data["shares"] = shares
            self.ctx.page.call("frameShares", [[int(k), int(self._shares[k])] for k in np.flatnonzero(changed)])
            return
        number = list(self.ctx.shared.store.sources).index(source)
        self._data = {"source": number, "name": source, "kind": kind, "read": about is not None}
        self._data |= {"shares": shares, "scenes": line.scenes}
        self.ctx.page.call("timeline", self._data)

    def _find_odd(self, then: Callable[[], None] | None = None) -> None:
        """Find odd frames in the background, and show them; by default on the timeline alone."""
        source = self.state.source

        def show(odd: tuple[OddFrame, ...]) -> None:
            self._odd[source] = odd
            self.ctx.page.call("oddFrames", {"name": source, "frames": oddest(odd)})
            if source == self.state.source:
                (then or self.follow)()

        self.ctx.shared.pictures.odd(source, lambda odd: self.ctx.post(lambda: show(odd)))

    def browse(self) -> None:
        """In the background, load the neighbours."""
        ids, at = self._timeline.frame_ids, self._at
        self.ctx.shared.store.prepare(self.state.source, (*ids[at + 1 : at + 2], *ids[max(0, at - 1) : at]))


def _plan_data(plan: CameraPlan, indices: Mapping[str, int]) -> dict[str, object]:
    """Cameras from above for the page; metres to the millimetre."""
    positions, headings = plan.positions.round(3).tolist(), plan.headings.round(3).tolist()
    frames = [indices[frame_id] for frame_id in plan.frame_ids]
    return {"scene": plan.scene, "frames": frames, "ids": plan.frame_ids, "positions": positions, "headings": headings}


def steps_html(state: State, kind: Kind, at: int, shares: np.ndarray) -> Element:
    """Steps through the failures of the list, the frames with open items, or all frames; and the frame's id."""
    frame = f"frame {at + 1:,} of {len(shares):,}"
    words, to, noun, keys = frame.capitalize(), "next-frame", "frame", ("P", "N")
    if kind == "wrong" and state.listing is not None:
        words, to, noun, keys = listed_words(state.listing, state.listed), "next-failure", "failure", (",", ".")
        noun = noun if state.listing.query == FAILURES else f"of {state.listing.query or 'all'}"
    elif kind == "open":
        words, to, noun, keys = _open_words(shares, at), "next-open", "frame with open items", ("", "")
    ends = to == "next-frame"
    back = _step(to, -1, f"previous {noun}", keys[0], "‹", disabled=ends and at == 0)
    on = _step(to, 1, f"next {noun}", keys[1], "›", disabled=ends and at + 1 == len(shares))
    field = h.input(
        type="text",
        value=state.frame_id,
        list="frame-ids",
        aria_label="Frame",
        change="open:",
        field="frame",
        cls="frame-id",
        title=state.frame_id,
        autocomplete="off",
        spellcheck="false",
    )
    return h.div(
        h.div(back, h.b(words), on, cls="frame-row"),
        h.div(None if ends else h.span(frame, cls="dim"), field, cls="frame-row"),
    )


def _step(to: str, by: int, title: str, key: str, sign: str, disabled: bool) -> Element:
    parts = (sign, h.kbd(key) if key else None)[::-by]
    hint = f"{title} ({key})" if key else title
    return h.button(parts, cls="try", do=f"{to}:{by}", id=f"step{by}", title=hint, aria_label=title, disabled=disabled)


def listed_words(listing: Listing, place: int | None) -> str:
    """Position of an answer in a list of the run: "Failure 3 of 505", or "3 of 43 found" by another search."""
    if listing.query != FAILURES:
        return f"{listing.count:,} found" if place is None else f"{place + 1:,} of {listing.count:,} found"
    return counted(listing.count, "failure") if place is None else f"Failure {place + 1:,} of {listing.count:,}"


def _open_words(shares: np.ndarray, at: int) -> str:
    found = np.flatnonzero((shares > 0) & (shares < UNKNOWN))
    place = int(np.searchsorted(found, at)) + 1
    count = f"{place:,} of {len(found):,}" if at in found else counted(len(found), "frame")
    return f"{count} with open items"
