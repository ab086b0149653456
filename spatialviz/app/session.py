"""One client's session: commands come in, a new state is made with the core, the page is drawn from it."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from dataclasses import asdict, replace
from datetime import datetime

import numpy as np
import viser

from pipeline.answering.ask import Trace
from pipeline.answering.asked_names import unused_words
from pipeline.answering.json_records import holds
from pipeline.answering.opening import Pipeline
from pipeline.answering.ranking import RankConfig
from pipeline.answering.suggestions import suggest_expressions
from pipeline.datasets.base import dataset_notes
from pipeline.datasets.demo import DEMO_EXPRESSION
from pipeline.diagnosis.verdict import Diagnosis
from pipeline.language.counted import counted
from pipeline.language.relation_names import PHRASE
from pipeline.system.errors import InputError, UnknownClass
from spatialviz.app.answer import answer_in_words
from spatialviz.app.asking import offers
from spatialviz.app.beside import BesideLayer
from spatialviz.app.channel import Channel
from spatialviz.app.dialog import Dialog
from spatialviz.app.filling import fill_answer, fill_page
from spatialviz.app.frame_cloud import FrameCloud
from spatialviz.app.frame_steps import FrameSteps
from spatialviz.app.frames import LoadedFrame
from spatialviz.app.judging import Judge
from spatialviz.app.keeping import Keeping
from spatialviz.app.keys import Keys, meant
from spatialviz.app.label_view import Target
from spatialviz.app.labelling import Labelling
from spatialviz.app.layout import Page
from spatialviz.app.level_surface import LevelSurface
from spatialviz.app.messages import Go, Hello, Incoming, Scene
from spatialviz.app.picture import overlay_marks
from spatialviz.app.place import Place
from spatialviz.app.pointing import Pointing
from spatialviz.app.run_browser import Listing
from spatialviz.app.run_panel import RunPanel
from spatialviz.app.scene import SceneView
from spatialviz.app.scene_aids import SceneAids
from spatialviz.app.scene_client import SceneClient
from spatialviz.app.selection import Selection
from spatialviz.app.shared import Shared
from spatialviz.app.stages import opened
from spatialviz.app.state import NOTHING, State, shown_objects
from spatialviz.app.view_settings import ViewSettings
from spatialviz.app.view_string import BEGINS
from spatialviz.app.view_strings import ViewStrings
from spatialviz.app.what_if import WhatIf

LOG_LENGTH = 200
RECENT = 12
"""Questions that Ask offers again."""
REST_SECONDS = 0.4
"""A camera that has not moved for so long is at rest."""


class Session:
    """Everything of one page.

    Commands are handled one at a time on the page's own thread, so that no lock is needed for the state.

    Parameters
    ----------
    page_id : str
        As the browser has chosen it.
    shared : Shared
        What all pages are made from.
    """

    def __init__(self, page_id: str, shared: Shared) -> None:
        self._path, self._shared = f"/scene/{page_id}/", shared
        store, runs, journals = shared.store, shared.runs, shared.journals
        self._store, self._runs_of = store, runs
        self._log: list[tuple[str, str]] = []
        self._suggestions: tuple[str, ...] = ()
        self._asked: tuple[str, ...] = ()
        self._closed = threading.Event()
        self._begun = False
        self._correcting = False
        self._pushed: Place | None = None
        self._turning: asyncio.TimerHandle | None = None
        self._judge = Judge(runs, shared.others, shared.labels, lambda *at: self._labels.correct.corrected(*at))
        source = next(iter(store.sources))
        ids = store.sources[source].dataset.frame_ids
        self.state = State(source, ids[0], dark=shared.dark, text=DEMO_EXPRESSION, correctable=bool(journals))
        self.channel = Channel(page_id[:6], self._receive)
        self.page = page = Page(self.channel.send)
        self.client = client = SceneClient()
        self.scene = SceneView(
            client,
            on_ray=lambda pixel, boxes: self.channel.post(
                lambda: None if self._labels.pixels.on_ray(pixel) else self._selection.select_on_ray(pixel, boxes)
            ),
        )
        client.camera.on_update(self._turned)
        self._level = LevelSurface(
            page, store, state=self._now, take=self._take, note=self._note,
            reopen=lambda: self._open_frame(self.state.frame_id, first=True, asking=self.state.text),
        )  # fmt: skip
        pointing = Pointing(page, self._now, self._take, self._draw, {"level": self._level.on_pixel})
        self._aids = SceneAids(client, page, self.scene)
        self._selection = Selection(self._now, self._take, self._draw, self.scene.viewpoint.focus, pointing.on_pixel)
        reach = (self._source, self._now, self._take)
        self._beside = BesideLayer(client, self.scene, self._now, self._take, self._draw)
        self._view = ViewSettings(page, self.scene, *reach, self._draw, self._note, client.set_dark)
        self._cloud = FrameCloud(self.scene, self._view.show_context, self.channel.post)
        self._runs = RunPanel(runs, store, page, self._now, self._set_listing, self._go, self.channel.post)
        self._what_if = WhatIf(
            client, page, self.scene, *reach, self._draw_edited, self._judged, self._note, self.channel.post
        )
        self._steps = FrameSteps(
            page, store, self._closed, state=self._now, open_frame=self._open_frame, post=self.channel.post
        )
        self._dialog = dialog = Dialog(page)
        self._labels = Labelling(
            client, page, self.scene, dialog, self._selection, store, runs, journals, shared.author, self._closed,
            state=self._now, take=self._take, draw=self._draw_edited, open_frame=self._open_frame, go=self._go,
            handle=self.handle, note=self._note, post=self.channel.post,
            ask=lambda: self._open_frame(self.state.frame_id, first=True, asking=self.state.text),
        )  # fmt: skip
        self._strings = ViewStrings(
            dialog, store.sources, runs, self._runs, self.scene.viewpoint, state=self._now, take=self._take,
            go=self._go, ask=self._ask, show_context=self._view.show_context, draw=self._draw, note=self._note,
        )  # fmt: skip
        keeping = Keeping(
            page, dialog, store.sources, runs, self._judge, shared.opened_by, state=self._now,
            view=self._strings.now, note=self._note,
        )  # fmt: skip
        keys = Keys(
            page, dialog, self.handle, lambda: self.state.labels is not None, moving=shared.moving,
            correcting=bool(journals), beside=shared.second,
        )  # fmt: skip
        parts = (
            self._selection, self._view, self._runs, self._what_if, self._strings, keeping, self._labels, self._beside,
            dialog, self._steps, self._level, pointing, keys,
        )  # fmt: skip
        self._more = {name: run for part in parts for name, run in part.commands().items()}

    def close(self) -> None:
        self._closed.set()
        self._labels.close()
        self.channel.post(self._forget)
        self.channel.close()

    def _forget(self) -> None:
        """Let go of frames and clouds at once: sessions refer to themselves, and are collected late."""
        self._cloud.clear()
        self.state = replace(self.state.unasked, loaded=None, shown=NOTHING)

    # ---- the browser ------------------------------------------------------------------

    def _receive(self, message: Incoming) -> None:
        if isinstance(message, Hello):
            self.channel.send(Scene(self._path))
            self.page.again()
            if self._begun:
                return
            if message.theme:
                self.state = replace(self.state, dark=message.theme == "dark")
            self.client.set_dark(self.state.dark)
            self._labels.correct.greeted(message.author)
            self._begin(Place.read(message.address, self._store.sources))
        elif isinstance(message, Go):
            self._go(Place.read(message.address, self._store.sources), restoring=True)
        else:
            self.handle(message.text)

    def signed_as(self, name: str) -> None:
        """Labels are corrected under the name of the token that the browser has, and under no other."""
        self.channel.post(lambda: self._labels.correct.signed_as(name))

    def attach(self, client: viser.ClientHandle) -> None:
        """The browser's frame is there: show the scene in it."""
        self.channel.post(lambda: self.client.attach(client))

    def detach(self, client: viser.ClientHandle) -> None:
        """The browser's frame has gone."""
        self.channel.post(lambda: self.client.detach(client))

    async def _turned(self, _: object) -> None:
        """The camera moves: where it comes to rest is said by the address."""
        if self._turning is not None:
            self._turning.cancel()
        loop = asyncio.get_running_loop()
        self._turning = loop.call_later(REST_SECONDS, self.channel.post, self._say_address)

    # ---- commands -------------------------------------------------------------------

    def handle(self, message: str) -> None:
        """Carry out a command such as "pair:3"; unknown ones are ignored."""
        message = meant(message, self.state.labels is not None)
        kind, _, argument = message.partition(":")
        number = int(argument) if argument.lstrip("-").isdecimal() else -1
        handlers: dict[str, Callable[[], None]] = {
            "relation": lambda: self._ask_relation(number),
            "try": lambda: self._ask(self._suggestions[number]) if 0 <= number < len(self._suggestions) else None,
            "ask": lambda: self._ask(argument),
            "again": lambda: self._ask(self.state.text),
            "data": lambda: self._go(Place(argument)),
            "clear": self._clear,
            "hover": lambda: self._hover(number),
            "stage": lambda: self._open_stage(argument),
            "task": lambda: self._turn_to(argument),
            "ask-typed": lambda: self._complete(argument),
        }
        if kind == "find":
            self.state = replace(self.state, evaluating=True)
        if kind in handlers:
            handlers[kind]()
        elif kind in self._more:
            self._more[kind](argument)

    def _now(self) -> State:
        return self.state

    def _take(self, state: State) -> None:
        self.state = state

    def _source(self) -> Pipeline:
        return self._store.sources[self.state.source]

    def _exact(self) -> bool:
        detector = self._source().detector
        return detector is not None and detector.exact

    # ---- places ---------------------------------------------------------------------

    def _begin(self, place: Place) -> None:
        """Show what the address says, else what the server was started with, else the first failure or frame."""
        if place.frame is not None or place.text is not None:
            if place.text is None and place.task is None and self.state.correctable:
                self._labels.correct.stay()
            self._go(place, restoring=True)
        elif self._shared.first_view is not None:
            self._strings.open(self._shared.first_view)
        elif self.state.source in self._shared.labels:
            # Labels were named to be looked at; the queue begins to be built.
            self._labels.correct.stay()
        if not self._begun:
            # With a run, its first failure; the frames follow.
            self._runs.follow()
            self._runs.open(0)
        if not self._begun:
            self._open_frame(self.state.frame_id, first=True)

    def _go(self, place: Place, restoring: bool = False) -> None:
        """Look at a place; what it does not say stays as it is. A place that is restored adds none to go back to."""
        if restoring:
            self._pushed = place
        source = place.source or self.state.source
        here = self.state
        ids = self._store.sources[source].dataset.frame_ids
        frame, text = place.frame, place.text
        if frame not in ids:
            # A question belongs to its frame.
            text = text if frame is None else None
            frame = here.frame_id if source == here.source else ids[0]
        if place.task is not None:
            self.state = replace(self.state, evaluating=place.task == "evaluate")
        if restoring:
            self._runs.follow()
            self._runs.search(place.find)
        here = self.state
        labelling = restoring and place.task == "label" and here.correctable
        if labelling:
            self._labels.correct.stay(Target(frame, place.item or ()))
        elif restoring:
            here = self.state = replace(here, labels=None)
        same = (source, frame) == (here.source, here.frame_id) and text in (None, here.text)
        if not (self._begun and same) or labelling:
            if source != here.source:
                here = replace(here, source=source, text=here.text or DEMO_EXPRESSION)
            self.state = here
            self._open_frame(frame, first=True, asking=text)
        if restoring:
            self.state = replace(self.state, stage=place.stage or "")
            self._draw()
        if place.camera is not None:
            self.scene.viewpoint.turn_to(*place.camera)

    def _say_address(self) -> None:
        state = self.state
        item = None if state.labels is None else state.labels.card
        place = replace(
            state.at_place, find=self._runs.found,
            camera=self.scene.viewpoint.turned_to(), item=None if item is None else (item.a, item.b),
        )  # fmt: skip
        push = self._pushed is not None and not place.same_view(self._pushed)
        self._pushed = place
        asked = state.text or "frame"
        self.page.say_address(place.query(), f"{asked} · {state.source} {state.frame_id} · spatialviz", push)

    def _open_stage(self, name: str) -> None:
        """Open the evidence of a module, or close it."""
        self.state = replace(self.state, stage="-" if opened(self.state) == name else name)
        self._draw()

    def _hover(self, number: int) -> None:
        """Show the box and the name of the object whose row the mouse is over; -1 for none."""
        hovered = number if 0 <= number < len(self.state.shown.objects) else None
        if hovered != self.state.hovered:
            self.state = replace(self.state, hovered=hovered)
            self._draw_scene()

    def _turn_to(self, task: str) -> None:
        """Explain, evaluate, or label: what the page is for now."""
        labels = self.state.labels is not None
        self.state = replace(self.state, evaluating=task == "evaluate")
        if labels != (task == "label"):
            self._labels.correct.toggle()
        self._draw()

    def _complete(self, typed: str) -> None:
        """Offer what could be asked of this frame: its names, relations, and what was asked lately."""
        self.page.call("asking", {"typed": typed, "offers": offers(typed, self.state, self._suggestions, self._asked)})

    # ---- frames ---------------------------------------------------------------------

    def _open_frame(self, frame_id: str, first: bool = False, asking: str | None = None) -> None:
        """Show a frame and ask `asking` of it; without, what was asked before, or on a `first` frame what fits it."""
        if frame_id == self.state.frame_id and not first:
            return
        self._begun = True
        self._show_working("finding the objects")
        stays = self._labels.correct.stays and asking is None
        # A frame that the labels lack is shown with its answer, and why is said.
        correcting = stays and (desk := self._labels.correct.desk) is not None and frame_id in desk
        cleared = replace(self.state.unasked, frame_id=frame_id, problem="", marks=())
        try:
            loaded = self._store.load(self.state.source, frame_id)
            scores = None if correcting else self._source().score(loaded.context, loaded.objects)
        except InputError as error:
            self.state = replace(cleared, loaded=None, problem=str(error), shown=NOTHING)
            self._note(str(error))
            self._suggestions = ()
            self._cloud.clear()
            self._beside.clear()
            self.page.call("tags", [])
            self._draw()
            self._steps.browse()
            return
        self.state = replace(cleared, loaded=loaded, shown=shown_objects(loaded, None, self._exact()))
        self._cloud.place_anew = first
        viewer = loaded.context.viewer
        self._suggestions = () if scores is None else suggest_expressions(loaded.objects, scores, viewer)
        self._note(f"frame {frame_id}: {counted(len(loaded.objects), 'object')}, up {viewer.up_source}")
        for remark in dataset_notes(self._source().dataset) if first else ():
            self._note(remark)
        if loaded.problem:
            self._note(loaded.problem)
        for remark in loaded.context.frame.notes:
            self._note(f"frame {frame_id}: {remark}")
        if stays:
            self._labels.correct.show()
        if correcting:
            self._draw()
            self._steps.browse()
            return
        text = self.state.text if asking is None else asking
        if self._source().detector is None:
            text = ""
        elif first and asking is None and not self._can_ask(loaded, text):
            text = self._suggestions[0] if self._suggestions else ""
        self.state = replace(self.state, text=text)
        if text:
            self._ask(text, draw=False)
        else:
            self.page.call("question", "")
        self._draw()
        self._steps.browse()

    def _can_ask(self, loaded: LoadedFrame, text: str) -> bool:
        try:
            trace = self._source().ask(loaded.context, text)
        except InputError:
            return False
        # What names nothing of this dataset is no first question of it.
        return holds(trace) and not unused_words(trace.query)

    # ---- questions ------------------------------------------------------------------

    def _ask(self, text: str, draw: bool = True) -> None:
        if BEGINS.match(text):
            self.page.call("question", self.state.text)
            self._strings.restore(text)
            return
        loaded = self.state.loaded
        if loaded is None:
            return
        self._show_working("answering")
        self.state = replace(self.state.unasked, text=text, selected=self.state.selected)
        self.page.call("question", text)
        self._asked = tuple(dict.fromkeys((text, *self._asked)))[:RECENT]
        exact = self._exact()
        try:
            trace = self._source().ask(loaded.context, text)
        except InputError as error:
            shown = shown_objects(loaded, None, exact)
            # Which names a frame has is said beside the field; the detector knows many more.
            said = error.what if isinstance(error, UnknownClass) else str(error)
            self.state = replace(self.state, error=said, shown=shown, selected=None)
            self._note(f"“{text}”: {error}")
        else:
            self._answered(loaded, trace)
            self._note(answer_in_words(self.state))
        if draw:
            self._draw()

    def _answered(self, loaded: LoadedFrame, trace: Trace) -> None:
        """Take an answer into the state, with its verdict and what the other run says."""
        name, text = self.state.source, trace.query.text
        expression = self._runs.expression(self.state.frame_id, text)
        self.state = replace(
            self.state,
            trace=trace,
            shown=shown_objects(loaded, trace, trace.exact),
            judged=self._judged(trace, None),
            other=self._judge.other(name, loaded.context, text, expression),
        )
        ranked = self.state.ranked
        pair = self.state.at(ranked[0]) if ranked else None
        self.state = replace(self.state, pair=pair, selected=None if pair is None else pair[0])
        self._what_if.answered()

    def _judged(self, trace: Trace, rank: RankConfig | None) -> Diagnosis | str | None:
        """The verdict on a trace of the frame that is shown."""
        state = self.state
        assert state.loaded is not None
        expression = self._runs.expression(state.frame_id, trace.query.text)
        return self._judge.judge(state.source, self._source(), state.loaded.context, trace, expression, rank)

    def _ask_relation(self, number: int) -> None:
        """Ask the same two names with another relation."""
        trace = self.state.trace
        if trace is None or trace.asked is None or not 0 <= number < len(trace.scores.relations):
            return
        first, second = trace.query.target, trace.asked.nodes[0].label
        if trace.inverse:
            first, second = second, first
        self._ask(f"{first} {PHRASE[trace.scores.relations[number]]} the {second}")

    def _clear(self) -> None:
        loaded = self.state.loaded
        if loaded is None:
            return
        shown = shown_objects(loaded, None, self._exact())
        self.state = replace(self.state.unasked, text="", shown=shown)
        self.page.call("question", "")
        self._draw()

    # ---- drawing --------------------------------------------------------------------

    def _note(self, text: str) -> None:
        self._log = [*self._log, (datetime.now().strftime("%H:%M:%S"), text)][-LOG_LENGTH:]

    def _show_working(self, what: str) -> None:
        """Say at once what is being done; the drawing that follows takes it away."""
        self.page.call("working", what)

    def _draw(self) -> None:
        """Bring the whole page up to the state. Handles that would not change send nothing."""
        self._what_if.check()
        self._labels.correct.chosen()
        correcting = self.state.labels is not None
        if correcting != self._correcting:
            # A drag that only tries something must not become one that is saved.
            self._correcting, self.state = correcting, replace(self.state, mode="off")
        state = self.state
        dataset = self._source().dataset
        fill_page(
            self.page,
            state,
            self._shared,
            dataset=dataset,
            can_ask=self._source().detector is not None,
            suggestions=self._suggestions,
            log=self._log,
        )
        self._runs.follow()
        self._labels.follow()
        about = self._about()
        other = self.scene.viewpoint.look_about(about)
        self._cloud.follow(state)
        # Of a question that could not be asked there is nothing else to look at.
        if other and not state.error and state.camera == "pair" and self.scene.viewpoint.untouched:
            self.scene.viewpoint.place("pair")
        self._draw_scene()
        self._say_address()

    def _about(self) -> np.ndarray | None:
        """Corners of the chosen pair's boxes, and of those that the labels have in their place; None without any."""
        state = self.state
        if state.loaded is None:
            return None
        boxes = [state.shown.objects[i].lifted.box for i in state.roles] + [ghost.box for ghost in state.ghosts]
        viewer = state.loaded.context.viewer
        to_show = np.stack([viewer.right, viewer.forward, viewer.up])
        corners = [box.corners @ to_show.T for box in boxes if box is not None]
        return np.concatenate(corners) if corners else None

    def _draw_scene(self, live: bool = False) -> None:
        """Boxes, pair lines and names, and what belongs to the edits; `live` follows a drag."""
        state = self.state
        if state.loaded is not None:
            truth = [a.box for a in state.loaded.context.frame.annotations if a.box is not None]
            shown = state.shown if state.own_layer else NOTHING
            tags = self.scene.draw(
                shown.objects,
                shown.names,
                state.roles,
                state.selected if state.hovered is None else state.hovered,
                state.pair_lines,
                truth,
                state.ghosts,
                replace(state.flags, boxes=state.boxes_shown),
                state.dark,
            )
            self.page.call("tags", [asdict(t) for t in [*tags, *self._beside.follow(live), *self._aids.follow(state)]])
        else:
            self._aids.follow(state)
        self._what_if.follow(live)
        self._labels.follow_object(live)

    def _draw_edited(self, live: bool) -> None:
        """Draw an answer under edits: all of the page, or while a hand is at it only what follows the hand."""
        if not live:
            self._draw()
            return
        with self.page.together():
            fill_answer(self.page, self.state)
            self._draw_scene(live=True)
            self.page.call("overlay", "".join(mark.html for mark in overlay_marks(self.state)))

    def _set_listing(self, listing: Listing | None) -> None:
        self.state = replace(self.state, listing=listing)
        if self._begun:
            self._say_address()
