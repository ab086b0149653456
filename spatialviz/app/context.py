"""State, browser and scene of a page, shared by its mutually independent parts."""

from __future__ import annotations

import inspect
import re
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import field, replace
from datetime import datetime
from functools import cache, cached_property, partial
from typing import Any, TypeVar, get_type_hints

from pydantic import TypeAdapter, ValidationError

from pipeline.answering.frame_store import FrameStore
from pipeline.answering.pipeline import Pipeline
from pipeline.corrections.label_editor import LabelEditors
from pipeline.corrections.unsaved import JournalLocation
from pipeline.datasets.base import has_moves
from pipeline.datasets.demo import DEMO_EXPRESSION
from pipeline.diagnosis.cases.saving import OpenedCase
from pipeline.diagnosis.whatif.state import ViewState
from pipeline.evaluation.run_folder import Run
from pipeline.labels.reading import Labels
from pipeline.system.errors import InputError
from pipeline.system.frozen import dataclass
from spatialviz.app.channel import Channel, Command, Incoming
from spatialviz.app.frames import FramePictures
from spatialviz.app.layout import BrowserPage, Dialog
from spatialviz.app.scene import SceneView
from spatialviz.app.scene_client import SceneClient
from spatialviz.app.state import State

LOG_LENGTH = 200
Method = TypeVar("Method", bound=Callable[..., Any])
Thing = TypeVar("Thing")


@dataclass(frozen=True)
class Shared:
    """Data and options common to all pages of a server."""

    store: FrameStore  # Pipelines by name; the first is shown first
    # Runs to debug, and runs to compare with, by pipeline name
    runs: Mapping[str, Run]
    others: Mapping[str, Run]
    labels: Mapping[str, Labels]  # Truth without a run
    journals: Mapping[str, JournalLocation]  # Journals of correctable labels
    author: str | None = None  # Default author of corrections, replaced by the page's
    opened_by: tuple[str, ...] = ()  # Command line, for commands reopening the page
    first_view: ViewState | None = None  # Initial view
    cases: Mapping[str, OpenedCase] = field(default_factory=dict)  # Saved cases, by pipeline name
    dark: bool | None = None  # None for the browser's own
    alone: bool = True  # Server reachable from this machine only: pages may load files

    @cached_property
    def pictures(self) -> FramePictures:
        """Pictures of all frames."""
        return FramePictures(self.store.sources, self.store.give_way)

    @property
    def moving(self) -> bool:
        """True with a dataset of robot moves."""
        return any(has_moves(opened.dataset) for opened in self.store.sources.values())


class Context:
    """State, browser and scene of a page."""

    def __init__(
        self,
        page_id: str,
        shared: Shared,
        *,
        receive: Callable[[Incoming], None],
        # (hit pixel, boxes on the ray, smallest first)
        clicked: Callable[[tuple[int, int] | None, list[int]], None],
        # draw(live=True) only updates the parts following a drag.
        draw: Callable[..., None],
        handle: Callable[[Command], None],
        open_frame: Callable[[str], None],
    ) -> None:
        self.draw, self.handle, self.open_frame = draw, handle, open_frame
        self.reviewed: Mapping[str, tuple[int, int]] = {}  # By frame: (settled items, open items)
        self.leave: list[Callable[[], None]] = []  # Called on closing the page
        # Log of (time, line); `closed` is set with the page gone.
        self.shared, self.log, self.closed = shared, list[tuple[str, str]](), threading.Event()
        source, opened = next(iter(shared.store.sources.items()))
        first = opened.dataset.frame_ids[0]
        # Set by the page's own thread only.
        kept = shared.cases.get(source)
        self.state = State(
            source,
            first,
            dark=shared.dark is not False,
            text=DEMO_EXPRESSION if kept is None else kept.manifest.text,
            kept=None if kept is None or kept.case is None else (kept.case.text, kept.case.id),
            correctable=bool(shared.journals),
        )
        self.shown: str | None = None  # `Command.shown` of what is handled now

        def heard(message: Incoming) -> None:
            self.shown = message.shown if isinstance(message, Command) else None
            try:
                receive(message)
            finally:
                self.shown = None

        self.channel = Channel(page_id[:6], heard)
        self.post = self.channel.post  # Runs a job on the page's own thread, after earlier jobs
        self.page = BrowserPage(self.channel.send)
        self.dialog = Dialog(self.page)
        self.editors = LabelEditors(shared.journals, shared.store.sources, shared.author)
        self.client = SceneClient()
        self.scene = SceneView(self.client, lambda pixel, boxes: self.post(lambda: clicked(pixel, boxes)))

    @property
    def source(self) -> Pipeline:
        return self.shared.store.sources[self.state.source]

    @property
    def answering(self) -> Pipeline:
        """Pipeline of the shown answer: of two runs that of the shown side."""
        other = self.shared.others.get(self.state.source)
        return self.source if other is None or self.state.side != "b" else other.source

    @property
    def run(self) -> Run | None:
        """Run of the current pipeline."""
        return self.shared.runs.get(self.state.source)

    @property
    def answering_run(self) -> Run | None:
        """Run of the shown answer."""
        other = self.shared.others.get(self.state.source)
        return self.run if other is None or self.state.side != "b" else other

    @property
    def can_ask(self) -> bool:
        """True if the pipeline has a detector."""
        return self.source.detector is not None

    def note(self, text: str) -> None:
        """Write a line of the log."""
        self.log = [*self.log, (datetime.now().strftime("%H:%M:%S"), text)][-LOG_LENGTH:]

    def toast(self, title: str, text: str, bad: bool = False, undo: str = "") -> None:
        """Show a message in the corner of the page, and log it; errors stay until closed. `undo` is a command."""
        self.note(f"{title}: {text}" if text else title)
        self.page.toast(title, text, bad, undo)

    def fail(self, error: InputError) -> None:
        """Show the reason of a failure."""
        self.note(str(error))
        self.dialog.refuse(str(error))

    def show(self, **changes: Any) -> None:
        """Change the state, and draw it."""
        self.state = replace(self.state, **changes)
        self.draw()


class Part:
    """Part of a page, with commands of its own."""

    def __init__(self, ctx: Context) -> None:
        self.ctx = ctx

    @property
    def state(self) -> State:
        return self.ctx.state

    @state.setter
    def state(self, state: State) -> None:
        self.ctx.state = state


class Idle(Exception):
    """Command without a present subject; nothing happens."""


def there(value: Thing | None) -> Thing:
    """Subject of a command; `Idle` without a subject."""
    if value is None:
        raise Idle
    return value


def choice(options: Sequence[str], now: str, wanted: str) -> str | None:
    """Option by name, or the "next" after the current option; None for an unknown name."""
    if wanted == "next":
        return options[(options.index(now) + 1) % len(options)]
    return wanted if wanted in options else None


def command(*names: str) -> Callable[[Method], Method]:
    """Register a method for commands of the page; "name=argument" passes this argument.

    Arguments are converted to the annotated types of the method's parameters without defaults; invalid arguments do
    nothing. A text with ":" or "," fills several parameters. `by` gets the command's own name.
    """

    def mark(method: Method) -> Method:
        method.__dict__["commands"] = names
        return method

    return mark


def commands_of(part: object) -> dict[str, Callable[..., None]]:
    """Functions of a part by command name."""
    found: dict[str, Callable[..., None]] = {}
    for attribute, method in inspect.getmembers(type(part), lambda member: hasattr(member, "commands")):
        for said in method.commands:
            name, fixed, argument = said.partition("=")
            given = {"by": name} if "by" in inspect.signature(method).parameters else {}
            call = partial(_call, getattr(part, attribute), method, given)
            found[name] = partial(call, argument) if fixed else call
    return found


def _call(bound: Callable[..., None], method: Callable[..., None], given: dict[str, str], *arguments: Any) -> None:
    readers = _readers(method)
    if len(arguments) == 1 and len(readers) > 1:
        arguments = tuple(re.split("[:,]", arguments[0], maxsplit=len(readers) - 1))
    try:
        values = [read(value) for read, value in zip(readers, (*arguments, *[""] * len(readers)), strict=False)]
    except ValidationError:
        raise Idle from None
    bound(*values, **given)


@cache
def _readers(method: Callable[..., None]) -> tuple[Callable[[Any], Any], ...]:
    """Converters of the arguments of a command's method."""
    hints = get_type_hints(method, include_extras=True)
    _, *parameters = inspect.signature(method).parameters.values()
    kinds = (hints[p.name] for p in parameters if p.name != "by" and p.default is p.empty)
    return tuple(TypeAdapter(kind).validate_python for kind in kinds)
