"""Check of depth, camera, poses and up of a recording, with outlines before and after each repair."""

from __future__ import annotations

from threading import Lock, Thread

from pipeline.datasets.base import Dataset
from pipeline.datasets.doctor.examine import Examination, chosen_frames, examine_frames, overlay
from pipeline.datasets.settings import read_settings
from pipeline.language.counted import counted
from pipeline.system.errors import InputError, require
from spatialviz.app.context import Context, Part, command
from spatialviz.app.frames import jpeg_url
from spatialviz.app.markup import Child, h, note

TITLE = "Depth, camera and poses"
WORDS = {"fine": "fine", "wrong": "wrong", "unknown": "cannot tell"}
ONE_AT_A_TIME = Lock()
"""Shared by all pages: an examination takes a core for seconds."""


class DepthCheck(Part):
    """Examines the current recording as `spatialviz doctor` does, and shows the findings."""

    def __init__(self, ctx: Context) -> None:
        super().__init__(ctx)
        self._told: dict[str, list[Child]] = {}

    @command("doctor")
    def examine(self) -> None:
        """Examine some frames of the recording; writes nothing."""
        name, dataset = self.state.source, self.ctx.source.dataset
        if name in self._told:
            self.ctx.dialog.show(TITLE, self._told[name])
            return
        self.ctx.dialog.show(TITLE, h.p("Some frames are looked at. It takes seconds.", role="status"))
        Thread(target=self._look, args=(name, dataset), daemon=True).start()

    def _look(self, name: str, dataset: Dataset) -> None:
        try:
            with ONE_AT_A_TIME:
                frames = chosen_frames(dataset)
                require(frames, "none of the frames that were looked at can be read", path=dataset.root)
                found = examine_frames(dataset, frames, None, read_settings(dataset.root))
        except InputError as error:
            problem = str(error)
            self.ctx.post(lambda: self.ctx.dialog.refuse(problem))
            return
        told = self._told[name] = opinions_html(found)
        self.ctx.post(lambda: self._show(told))

    def _show(self, told: list[Child]) -> None:
        # A closed dialog stays closed.
        if self.ctx.dialog.title == TITLE:
            self.ctx.dialog.show(TITLE, told)


def opinions_html(found: Examination) -> list[Child]:
    """Finding on each subject, with pictures: as read on the left, as repaired on the right."""
    rows = (
        h.tr(h.th(o.about, scope="row"), h.td(h.b(WORDS[o.state])), h.td(o.text, h.div(o.option) if o.option else None))
        for o in found.opinions
    )
    looked_at = f"{counted(len(found.frames), 'frame')} looked at; {counted(found.pairs, 'pair')} of them overlap."
    mended = "Nothing is mended: both are the same."
    if found.mends:
        mended = f"spatialviz doctor {found.root} --apply keeps what mends it beside the data."
    return [
        h.p(looked_at, cls="dim"),
        h.table(h.tbody(rows), cls="doctor"),
        h.img(src=jpeg_url(overlay(found, most=2)), alt="outlines of depth, as read and as mended", cls="edges"),
        h.p(
            "Outlines of depth on colour: green where they lie on an edge of colour, else red. On the left as the ",
            "recording is read, on the right with what mends it.",
            cls="dim small",
        ),
        note(mended) if found.mends else h.p(mended, cls="dim small"),
    ]
