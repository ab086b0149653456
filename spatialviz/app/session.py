"""Session of a client: commands come in, the core makes a new state, the page is drawn from the state."""

from __future__ import annotations

import asyncio
from contextlib import suppress
from dataclasses import asdict, replace

from pipeline.answering.answer_words import holds
from pipeline.answering.ask import Trace
from pipeline.answering.detector_prompts import unused_words
from pipeline.answering.frame_store import LoadedFrame
from pipeline.answering.ranking import RankConfig
from pipeline.corrections.judging import Judge
from pipeline.corrections.label_editor import ANYTHING, Target
from pipeline.datasets.base import dataset_notes, named_frame
from pipeline.datasets.demo import DEMO_EXPRESSION
from pipeline.diagnosis.answer import Judged
from pipeline.diagnosis.asking import why_refused
from pipeline.diagnosis.suggestions import SuggestedQuestions, completions, first_answered, suggest_questions
from pipeline.diagnosis.whatif.answer_view import NOTHING, shown_objects
from pipeline.language.counted import counted
from pipeline.system.errors import InputError, UnknownClass, require
from spatialviz.app import (
    depth_check,
    evaluate,
    filling,
    frame_cloud,
    keys,
    view_strings,
    what_if,
)
from spatialviz.app.answer import answer_in_words, story_of
from spatialviz.app.browse import Browse
from spatialviz.app.channel import Command, Hello, Incoming, Scene
from spatialviz.app.context import Context, Idle, Part, Shared, command, commands_of, there
from spatialviz.app.labelling import Labelling
from spatialviz.app.picture import overlay_marks
from spatialviz.app.questions import Questions
from spatialviz.app.selection import Selection
from spatialviz.app.stages import opened
from spatialviz.app.state import Place, Side

RECENT = 12
"""Recent questions offered by Ask."""
REST_SECONDS = 0.4
"""Time without movement until a camera is at rest."""


class PageSession(Part):
    """State and parts of a page."""

    # Commands are handled in order on the page's own thread, so that the state needs no lock.

    def __init__(self, page_id: str, shared: Shared) -> None:
        super().__init__(
            Context(
                page_id,
                shared,
                receive=self.receive,
                clicked=self.clicked,
                draw=self.draw,
                handle=self.handle,
                open_frame=self.open_frame,
            )
        )
        ctx = self.ctx
        self._scene = Scene(f"scene/{page_id}/")
        self._asked = tuple[str, ...]()
        self._begun = self._correcting = False
        self._pushed: Place | None = None
        self._turning: asyncio.TimerHandle | None = None
        self._filling = filling.Filling(ctx)
        self._judge = Judge(shared.runs, shared.labels, shared.others, ctx.editors.corrected, shared.cases)
        ctx.client.camera.on_update(self._turned)
        self._selection = Selection(ctx, self.reopen)
        self._aids, self._cloud = frame_cloud.SceneAids(ctx), frame_cloud.FrameCloud(ctx)
        self._runs = evaluate.Evaluate(ctx, self.go, self.say_address)
        self._what_if, self._browse = what_if.WhatIf(ctx, self._judged), Browse(ctx)
        self._labels = Labelling(ctx, self.ask, self.reopen)
        self._exports = view_strings.Exports(
            ctx, self._judge, self._runs.reveal, self._runs.selected, self.go, self.ask
        )
        parts = (
            self,
            self._selection,
            Questions(ctx, self.ask),
            self._runs,
            self._what_if,
            self._exports,
            self._browse,
            keys.Keys(ctx),
            depth_check.DepthCheck(ctx),
            *self._labels.parts,
        )
        self._commands = {name: run for part in parts for name, run in commands_of(part).items()}

    def close(self) -> None:
        self.ctx.closed.set()
        for leave in self.ctx.leave:
            leave()
        self.ctx.post(self._forget)
        self.ctx.channel.close()

    def _forget(self) -> None:
        """Release frames and clouds at once; sessions are cyclic, and collected late."""
        self.state = replace(self.state.unasked, loaded=None, found=NOTHING)
        self._cloud.follow()

    # ---- the browser ------------------------------------------------------------------

    def receive(self, message: Incoming) -> None:
        if isinstance(message, Command):
            self.handle(message)
            return
        place = Place.read(message.address, self.ctx.shared.store.sources)
        if isinstance(message, Hello):
            self.ctx.channel.send(self._scene)
            self.ctx.page.again()
            if self._begun:
                return
            if message.theme:
                self.state = replace(self.state, dark=message.theme == "dark")
            self.ctx.client.set_dark(self.state.dark)
            try:
                self.ctx.editors.greet(message.author)
            except InputError as error:
                self.ctx.note(str(error))
            self._begin(place)
        else:
            self.go(place, restoring=True)
        if dead := place.dead(self.ctx.source.dataset.frame_ids):
            self.ctx.toast("Dead link: something else is shown", dead, bad=True)

    async def _turned(self, _: object) -> None:
        """Update the address after a camera move."""
        if self._turning is not None:
            self._turning.cancel()
        loop = asyncio.get_running_loop()
        self._turning = loop.call_later(REST_SECONDS, self.ctx.post, self.say_address)

    # ---- commands -------------------------------------------------------------------

    def handle(self, message: Command) -> None:
        """Execute a command; unknown commands are ignored."""
        message = keys.meant(message, self.state.labels is not None)
        try:
            with suppress(Idle):
                if message.name in self._commands:
                    self._commands[message.name](*message.arguments)
        except InputError as error:
            self.ctx.fail(error)

    def clicked(self, pixel: tuple[int, int] | None, boxes: list[int]) -> None:
        """Select by a click in the scene."""
        self._selection.click(pixel if self.state.flags.cloud else None, boxes)

    @command("data")
    def _turn_to_source(self, name: str) -> None:
        require(name in self.ctx.shared.store.sources, "this dataset is not open here", got=name)
        self.go(Place(name))

    @property
    def _exact(self) -> bool:
        return self.ctx.source.detector is not None and self.ctx.source.detector.exact

    # ---- places ---------------------------------------------------------------------

    def _begin(self, place: Place) -> None:
        """Show the place of the address, else of the server's start, else the first failure or frame."""
        task = place.task == "evaluate" or (place.task == "label" and self.state.correctable)
        if place.frame is not None or place.text is not None or task:
            if place.text is None and place.task is None and self.state.correctable:
                self.ctx.editors.wanted = ANYTHING
            self.go(place, restoring=True)
        elif self.ctx.shared.first_view is not None:
            try:
                self._exports.open(self.ctx.shared.first_view)
            except InputError as error:
                self.ctx.fail(error)
        elif self.state.source in self.ctx.shared.labels:
            # Labels were opened to be viewed; start making the queue.
            self.ctx.editors.wanted = ANYTHING
        if not self._begun:
            # With a run, the first failure; else a frame below.
            self._runs.follow()
            with suppress(Idle):
                self._runs.open(0)
        if not self._begun:
            self.open_frame(self.state.frame_id, first=True)

    def go(self, place: Place, restoring: bool = False) -> None:
        """Go to a place; unset fields stay. A restored place adds no entry to the history."""
        if restoring:
            self._pushed = place
        here = self.state
        source = place.source or here.source
        ids = self.ctx.shared.store.sources[source].dataset.frame_ids
        frame, text = place.frame, place.text
        if frame not in ids:
            # A question belongs to a frame.
            text = text if frame is None else None
            frame = here.frame_id if source == here.source else ids[0]
        if place.task is not None:
            self.state = replace(self.state, evaluating=place.task == "evaluate")
        side = place.side or ("a" if restoring else here.side)
        self.state = replace(self.state, side=side if source in self.ctx.shared.others else "a")
        turned = self.state.side != here.side
        if restoring:
            self._runs.follow()
            self._runs.search(place.find)
            self.state = replace(self.state, camera=place.look or "pair")
        here = self.state
        labelling = restoring and place.task == "label" and here.correctable
        if labelling:
            self.ctx.editors.wanted = Target(frame, place.item or ())
        elif restoring:
            here = self.state = replace(here, labels=None)
        same = (source, frame) == (here.source, here.frame_id) and text in (None, here.text) and not turned
        if not (self._begun and same) or labelling:
            if source != here.source:
                here = replace(here, source=source, text=here.text or DEMO_EXPRESSION)
            self.state = here
            self.open_frame(frame, first=True, asking=text)
        if restoring:
            self.state = replace(self.state, stage=place.stage or "")
            self.handle(Command("pair", ((place.pair or 1) - 1,)))
            self.draw()
            if same and self.state.loaded is not None:
                self.ctx.scene.viewpoint.place(self.state.camera)
        if place.camera is not None:
            self.ctx.scene.viewpoint.turn_to(*place.camera)

    def say_address(self) -> None:
        """Update the address from the state."""
        if not self._begun:
            return
        state = self.state
        place = replace(state.at_place, find=self._runs.found, camera=self.ctx.scene.viewpoint.turned_to())
        before, self._pushed = self._pushed, place
        title = f"{state.text or 'frame'} · {state.source} {state.frame_id} · spatialviz"
        self.ctx.page.say_address(place.query(), title, before is not None and not place.same_view(before))

    @command("stage")
    def _open_stage(self, name: str) -> None:
        """Toggle the evidence of a module."""
        self.ctx.show(stage="-" if opened(self.state) == name else name)

    @command("drawer")
    def _open_drawer(self, name: str) -> None:
        """Fill a tab of the drawer, or none."""
        self.ctx.show(drawer=name)

    @command("task")
    def _turn_to(self, task: str) -> None:
        """Switch the task: explain, evaluate, or label."""
        self.state = replace(self.state, evaluating=task == "evaluate")
        if (self.state.labels is not None) != (task == "label"):
            self.handle(Command("labels"))
        self.draw()

    @command("ask-typed")
    def _complete(self, typed: str) -> None:
        """Suggest questions on this frame: names, relations, and recent questions."""
        offered = self.state.offers
        found = completions(typed, offered.names, offered.questions, self._asked)
        self.ctx.page.call("asking", {"typed": typed, "offers": found})

    # ---- frames ---------------------------------------------------------------------

    def reopen(self) -> None:
        """Reload the frame, with its question."""
        self.open_frame(self.state.frame_id, first=True, asking=self.state.text)

    @command("open")
    def open_frame(self, frame_id: str, first: bool = False, asking: str | None = None) -> None:
        """Show a frame and ask `asking`, by default the last question, or on a `first` frame a suitable question."""
        frame_id = named_frame(self.ctx.source.dataset.frame_ids, frame_id, self.ctx.source.dataset.root)
        if frame_id == self.state.frame_id and not first:
            return
        self._begun = True
        self.ctx.page.call("working", "finding the objects")
        stays = asking is None and (self.state.labels is not None or self.ctx.editors.wanted is not None)
        # A frame missing in the labels is shown with the answer, and a message.
        correcting = stays and (editor := self.ctx.editors.of(self.state.source)) is not None and frame_id in editor
        self.state = replace(self.state.unasked, frame_id=frame_id, problem="", marks=(), offers=SuggestedQuestions())
        try:
            loaded = self._load(first, scored=not correcting)
        except InputError as error:
            self.state = replace(self.state, loaded=None, problem=str(error), found=NOTHING)
            self.ctx.note(str(error))
        else:
            if stays:
                try:
                    self._labels.show()
                except InputError as error:
                    self.ctx.fail(error)
            if not correcting:
                self._ask_first(loaded, first, asking)
        self.draw()
        self._browse.browse()

    def _load(self, first: bool, scored: bool) -> LoadedFrame:
        """Take the frame into the state, with suggested questions if `scored`."""
        frame_id = self.state.frame_id
        loaded = self.ctx.shared.store.load(self.state.source, frame_id)
        viewer = loaded.context.viewer
        if scored:
            truth = self._judge.labelled(self.state.source, self.ctx.source, loaded.context)
            offers = suggest_questions(self.ctx.source, loaded.context, loaded.objects, truth)
            self.state = replace(self.state, offers=offers)
        self.state = replace(self.state, loaded=loaded, found=shown_objects(loaded, None, self._exact))
        self._cloud.place_anew = first
        remarks = [f"frame {frame_id}: {counted(len(loaded.objects), 'object')}, up {viewer.up_source}"]
        remarks += dataset_notes(self.ctx.source.dataset) if first else ()
        remarks += filter(None, [loaded.problem])
        for remark in (*remarks, *(f"frame {frame_id}: {remark}" for remark in loaded.context.frame.notes)):
            self.ctx.note(remark)
        return loaded

    def _ask_first(self, loaded: LoadedFrame, first: bool, asking: str | None) -> None:
        """Ask the opened frame the last question; a `first` frame perhaps a suggestion."""
        text = self.state.text if asking is None else asking
        if self.ctx.source.detector is None:
            text = ""
        elif first and asking is None and not self._can_ask(loaded, text):
            text = first_answered(self.ctx.source, loaded.context, self.state.offers.questions)
        self.state = replace(self.state, text=text)
        if text:
            self.ask(text, draw=False)
        else:
            self.ctx.page.call("question", "")

    def _can_ask(self, loaded: LoadedFrame, text: str) -> bool:
        try:
            trace = self.ctx.source.ask(loaded.context, text)
        except InputError:
            return False
        # A question naming nothing of this dataset is no first question.
        return holds(trace) is True and not unused_words(trace.query)

    # ---- questions ------------------------------------------------------------------

    @command("ask")
    def ask(self, text: str, draw: bool = True) -> None:
        if view_strings.BEGINS.match(text):
            self.ctx.page.call("question", self.state.text)
            self._exports.restore(text)
            return
        loaded = self.state.loaded
        if loaded is None:
            return
        self.ctx.page.call("working", "answering")
        self.state = replace(self.state.unasked, text=text, selected=self.state.selected)
        self.ctx.page.call("question", text)
        self._asked = tuple(dict.fromkeys((text, *self._asked)))[:RECENT]
        try:
            source = self.ctx.answering
            trace = source.ask(loaded.context.under(source.config.lift), text)
        except InputError as error:
            shown = shown_objects(loaded, None, self._exact)
            # Names of the frame stand below; the detector knows many more.
            said = why_refused(self.ctx.answering, text, error)
            name, expression = self.state.source, self.state.expression_id(text)
            judged = self._judge.judge_refused(name, self.ctx.answering, loaded.context, expression)
            stopped = "OPM" if isinstance(error, UnknownClass) else "PARSE"
            self.state = replace(self.state, error=said, stopped=stopped, judged=judged, found=shown, selected=None)
            self.ctx.note(f"“{text}”: {error}")
            said = ""
        else:
            self._answered(loaded, trace)
            said = answer_in_words(self.state, trace)
            self.ctx.note(said)
        told = story_of(self.state)
        self.ctx.page.call("announce", f"{said} {told.head}. {told.sentence}")
        if draw:
            self.draw()

    def _judged(self, trace: Trace, rank: RankConfig | None = None) -> Judged:
        """Verdict on an answer of the current frame; `rank` holds the weights of an edited answer."""
        state, expression = self.state, self.state.expression_id(trace.query.text)
        source = self.ctx.answering
        context = there(state.loaded).context.under(source.config.lift)
        return self._judge.judge(state.source, source, context, trace, expression, rank, state.judged)

    def _answered(self, loaded: LoadedFrame, trace: Trace) -> None:
        """Take an answer into the state, with verdict and the other run's answer."""
        name, text = self.state.source, trace.query.text
        other = self._judge.other(
            name, loaded.context, text, self.state.expression_id(text), second=self.state.side != "b"
        )
        self.state = replace(
            self.state,
            trace=trace,
            found=shown_objects(loaded, trace, trace.exact),
            judged=self._judged(trace),
            other=other,
        )
        pair = next(map(self.state.at, self.state.ranked), None)
        self.state = replace(self.state, pair=pair, selected=None if pair is None else pair[0])
        self._what_if.answered()

    @command("side")
    def _turn_side(self, side: Side) -> None:
        """Show the answer of the first or of the second run, or both in a table."""
        if side != self.state.side and self.state.source in self._judge.names:
            self.state = replace(self.state, side=side)
            self.ask(self.state.text, draw=False)
            self.ctx.show(stage="LABEL" if side == "both" else "")

    @command("clear")
    def _clear(self) -> None:
        shown = shown_objects(there(self.state.loaded), None, self._exact)
        self.state = replace(self.state.unasked, text="", found=shown)
        self.ctx.page.call("question", "")
        self.draw()

    # ---- drawing --------------------------------------------------------------------

    def draw(self, live: bool = False) -> None:
        """Draw the page for the state; `live`, only the parts following a drag."""
        if live:
            with self.ctx.page.together():
                self._filling.follow()
                self._draw_scene(live=True)
                self.ctx.page.call("overlay", "".join(mark.html for mark in overlay_marks(self.state)))
            return
        self._what_if.check()
        self._labels.detail()
        correcting = self.state.labels is not None
        if correcting != self._correcting:
            # A what-if drag must not become a saved edit.
            self._correcting, self.state = correcting, replace(self.state, mode="off")
            # Questions belong to answers, not to labels.
            self.ctx.page.call("question", "" if correcting else self.state.text)
        # What is largest is on its way while the rest is made.
        self._cloud.follow()
        self._filling.fill()
        self._runs.follow()
        self._labels.follow()
        self._browse.follow()
        self._draw_scene()
        self.say_address()

    def _draw_scene(self, live: bool = False) -> None:
        """Draw boxes, pair lines, names and edits; `live` follows a drag."""
        self._cloud.dress()
        tags = [*self.ctx.scene.draw(self.state), *self._aids.follow()]
        self.ctx.page.call("tags", [asdict(tag) for tag in tags])
        self._what_if.follow(live)
