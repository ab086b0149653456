"""Server of the page: a viser server, with a session for each open page."""

from __future__ import annotations

import io
import shlex
import signal
import sys
import threading
import time
import warnings
import webbrowser
from collections.abc import Mapping, Sequence
from contextlib import redirect_stdout
from functools import partial
from importlib import import_module

import viser

from pipeline.answering.frame_store import FrameStore
from pipeline.answering.pipeline import Pipeline
from pipeline.corrections.unsaved import JournalLocation, dump_unsaved
from pipeline.datasets.demo import demo_path
from pipeline.diagnosis.cases.saving import OpenedCase
from pipeline.diagnosis.whatif.state import ViewState
from pipeline.evaluation.run_folder import Run
from pipeline.labels.reading import Labels
from pipeline.language.counted import counted
from pipeline.system.errors import require
from pipeline.system.freed_memory import uncollected
from pipeline.system.worker_pool import one_thread
from spatialviz.app.access import Access
from spatialviz.app.channel import answering, end_all
from spatialviz.app.context import Shared
from spatialviz.app.listening import Listening, listen
from spatialviz.app.site import MAX_CLIENTS
from spatialviz.plain_text import one_line

ENDS_WITHIN = 10.0
"""Seconds for clients' threads to finish."""
SIGNAL_SECONDS = 0.5
"""Longest wait before a signal is seen."""


def start(
    sources: dict[str, Pipeline],
    *,
    runs: Mapping[str, Run] | None = None,
    others: Mapping[str, Run] | None = None,
    labels: Mapping[str, Labels] | None = None,
    journals: Mapping[str, JournalLocation] | None = None,
    author: str | None = None,
    opened_by: Sequence[str] = (),
    first_view: ViewState | None = None,
    cases: Mapping[str, OpenedCase] | None = None,
    host: str = "127.0.0.1",
    port: int = 8080,
    dark: bool | None = None,
    access: Access | None = None,
    max_clients: int = MAX_CLIENTS,
    listening: Listening | None = None,
) -> viser.ViserServer:
    """Start the server on its own threads, and return the server.

    Mappings are by the names in `sources`; the first source is shown first. The other arguments are the fields of
    `Shared`, and those of `listen`; without an `author`, names come from the browser, else the login. By default,
    `access` admits everybody on this machine, nobody else. `listening` is a server that was made by `listen` with these
    arguments, by default a new one.

    InputError for a dataset without frames, or an unusable address.
    """
    for name, source in sources.items():
        require(source.dataset.frame_ids, f"the dataset {name} has no frames", path=source.dataset.root)
    access = access or Access.of(host)
    listening = listening or listen(access, host, port, dark, max_clients)
    listening.shared.set_result(
        Shared(
            FrameStore(sources, answering),
            runs or {},
            others or {},
            labels or {},
            journals or {},
            author,
            tuple(opened_by),
            first_view,
            cases or {},
            dark,
            access.open,
        )
    )
    return listening.server


def serve(
    sources: dict[str, Pipeline],
    *,
    runs: Mapping[str, Run] | None = None,
    others: Mapping[str, Run] | None = None,
    labels: Mapping[str, Labels] | None = None,
    journals: Mapping[str, JournalLocation] | None = None,
    author: str | None = None,
    opened_by: Sequence[str] = (),
    first_view: ViewState | None = None,
    cases: Mapping[str, OpenedCase] | None = None,
    host: str = "127.0.0.1",
    port: int = 8080,
    dark: bool | None = None,
    open_browser: bool = True,
    access: Access | None = None,
    max_clients: int = MAX_CLIENTS,
    block: bool = True,
    listening: Listening | None = None,
) -> viser.ViserServer | None:
    """Start the server, print the address, and wait for the end; without `block`, return the server instead."""
    access = access or Access.of(host)
    server = start(
        sources,
        runs=runs,
        others=others,
        labels=labels,
        journals=journals,
        author=author,
        opened_by=opened_by,
        first_view=first_view,
        cases=cases,
        host=host,
        port=port,
        dark=dark,
        access=access,
        max_clients=max_clients,
        listening=listening,
    )
    announced = partial(announce, server, access, sources, host, port, open_browser)
    if not block:
        announced("stop()")
        return server
    _end_in_order()
    try:
        announced("Ctrl-C")
        # Results for a page closed meanwhile are dropped; no news to a user.
        warnings.filterwarnings("ignore", r"Queued a \w+ on a closed connection", UserWarning)
        # Nor are messages foreign to viser's client.
        warnings.filterwarnings("ignore", r"\[viser\] .* does not match annotation", UserWarning)
        # Products of a few numbers: a second thread costs more than it gains, at the expense of other clients.
        with one_thread():
            # What pages are made of is loaded while the browser starts.
            with uncollected():
                import_module("spatialviz.app.session")
            # Short sleeps: a signal delivered to another thread wakes no sleeper; it is seen at the next turn.
            while True:
                time.sleep(SIGNAL_SECONDS)
    finally:
        for place in (journals or {}).values():
            place.end_jobs()
        end_all(ENDS_WITHIN)
        with redirect_stdout(io.StringIO()):
            server.stop()
        for place in (journals or {}).values():
            _say_unsaved(place)


def announce(
    server: viser.ViserServer,
    access: Access,
    sources: Mapping[str, Pipeline],
    host: str,
    port: int,
    open_browser: bool,
    stop: str,
) -> None:
    """Print a server's address, asked for at `host` and `port`, and the way to stop; open a browser if wanted."""
    shown = "127.0.0.1" if host in ("", "0.0.0.0", "::") else f"[{host}]" if ":" in host else host
    address = f"http://{shown}:{server.get_port()}"
    if port and server.get_port() != port:
        print(f"spatialviz: port {port} is taken, using {server.get_port()}", file=sys.stderr)
    built_in = demo_path().resolve()
    named = (
        "the built-in demo" if source.dataset.root.resolve() == built_in else name for name, source in sources.items()
    )
    print(f"spatialviz: {', '.join(named)} at {address} ({stop} stops)", flush=True)
    link, *outside = access.links(address)
    if not access.open:
        why = "others may reach it, so a token is needed:" if access.unnamed else "everybody opens"
        print(
            f"spatialviz: {why} {link}", *(f"\nspatialviz: from outside: {one}" for one in outside), sep="", flush=True
        )
    if open_browser and (access.open or access.unnamed):
        webbrowser.open(link)


def _end_in_order() -> None:
    """Treat SIGTERM and a closed terminal as Ctrl-C, so that unsaved edits are kept."""

    def end(number: int, frame: object) -> None:
        # A second signal would interrupt the shutdown.
        signal.signal(number, signal.SIG_IGN)
        raise SystemExit(128 + number)

    if threading.current_thread() is threading.main_thread():
        for name in ("SIGTERM", "SIGHUP"):
            number = getattr(signal, name, None)
            if number is not None and signal.getsignal(number) is signal.SIG_DFL:
                signal.signal(number, end)


def _say_unsaved(place: JournalLocation) -> None:
    """Print the unsaved corrections, with instructions for saving later."""
    for found in dump_unsaved(place):
        count = len(found.edits)
        print(
            f"spatialviz: {counted(count, 'edit')} of {found.author} could not be saved: {found.problem}",
            file=sys.stderr,
        )
        for edit in found.edits:
            print(f"  {one_line(str(edit))}", file=sys.stderr)
        if not found.files:
            print("spatialviz: no folder can be written: they are lost", file=sys.stderr)
        for path in found.files:
            words = ["spatialviz", "correct", str(place.labels.root), "--edits", str(path), "--author", found.author]
            words += place.words
            print(f"spatialviz: kept in {path}; save them with: {shlex.join(words)}", file=sys.stderr)
