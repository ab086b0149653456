"""Many writers at once: each saves edits, some of cells that others edit too, and afterwards every promise is checked.

cd tests && python -m benchmarks.journal_writers JOURNAL [WRITERS] [EDITS]
"""

from __future__ import annotations

import json
import multiprocessing
import random
from collections import Counter
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path
from time import perf_counter
from typing import Any

from pipeline.corrections.journal.events import Edit, Event, Saved, grouped
from pipeline.corrections.journal.field_refs import FieldRef, relation_ref
from pipeline.corrections.journal.journal import open_journal

SHARED_CELLS = 20
"""Cells that all writers edit: conflicts are certain."""
SHARED_SHARE = 0.3
FRAME = "scene/000000"


@dataclass(frozen=True)
class Proof:
    """What came of it.

    Attributes
    ----------
    writers, edits : int
        Processes, and edits that each of them had saved in the end.
    seconds : float
    saved : int
        Events that were acknowledged.
    conflicts : int
        Times that a writer was told that somebody else had been there.
    lost : int
        Acknowledged events that are not in the journal, or are there with another value.
    unasked : int
        Events in the journal that nobody was told of.
    overwritten : int
        Events that were not made on the version just before them, and on its value.
    """

    writers: int
    edits: int
    seconds: float
    saved: int
    conflicts: int
    lost: int
    unasked: int
    overwritten: int

    @property
    def holds(self) -> bool:
        """Whether nothing was lost, and nothing overwritten."""
        return not (self.lost or self.unasked or self.overwritten)


def write_many(where: str, name: str, edits: int, report: Path, seed: int = 0, start: Any = None) -> None:
    """One writer: save edits, look again where there is a conflict, and note each acknowledged event in a file.

    Of the cells that others edit too it knows what it saw last, as a person before a page does.

    Parameters
    ----------
    report : Path
        One line of JSON an acknowledged event, or a conflict; written after the journal returned.
    start : multiprocessing.Barrier, optional
        Where all wait for each other before they begin.
    """
    rng = random.Random(f"{seed} {name}")
    own = 3_000 + int(name) * 100_000
    seen: dict[FieldRef, tuple[int, int | None]] = {}
    with open_journal(where) as journal, open(report, "w", encoding="utf-8") as told:
        if start is not None:
            start.wait()
        for k in range(edits):
            shared = rng.random() < SHARED_SHARE
            cell = relation_ref(FRAME, 1, 2 + rng.randrange(SHARED_CELLS) if shared else own + k, "left")
            saved = False
            while not saved:
                version, before = seen.get(cell, (0, None))
                done = journal.append([Edit(cell, before, rng.choice([-1, 0, 1]), version)], f"writer {name}")
                saved = isinstance(done, Saved)
                # A conflict tells what is there now.
                event = done.events[0] if isinstance(done, Saved) else done.rivals[0].event
                assert event is not None
                seen[cell] = event.version, event.after
                entry = {"saved": event.ulid, "after": event.after} if saved else {"conflict": event.ulid}
                print(json.dumps(entry), file=told, flush=True)


def ready_processes() -> Any:
    """Where the system has it, processes that are forked from one that has everything imported, and else spawned."""
    if "forkserver" not in multiprocessing.get_all_start_methods():
        return multiprocessing.get_context("spawn")
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["pipeline.corrections.journal.journal"])
    return context


def prove(where: str, folder: Path, writers: int = 8, edits: int = 2_000, seed: int = 0) -> Proof:
    """Let processes write into one journal at the same time, and check it against what each of them was told.

    Parameters
    ----------
    where : str
        Path or URL of a journal; best an empty one.
    folder : Path
        Where the writers note what they were told.
    """
    with open_journal(where) as journal:
        known = {event.ulid for event in journal.events()}
    context = ready_processes()
    reports = [folder / f"writer-{k}.jsonl" for k in range(writers)]
    together = context.Barrier(writers + 1)
    processes = [
        context.Process(target=write_many, args=(where, str(k), edits, report, seed, together))
        for k, report in enumerate(reports)
    ]
    for process in processes:
        process.start()
    together.wait()
    start = perf_counter()
    for process in processes:
        process.join()
    seconds = perf_counter() - start
    with open_journal(where) as journal:
        events = [event for event in journal.events() if event.ulid not in known]
    return judge(events, [read_report(r) for r in reports], writers, edits, seconds)


def read_report(path: Path) -> list[dict[str, Any]]:
    """What a writer noted; a last line that was cut off is not counted."""
    lines = path.read_text(encoding="utf-8").split("\n")[:-1] if path.exists() else []
    return [json.loads(line) for line in lines]


def judge(events: Iterable[Event], told: list[list[dict[str, Any]]], writers: int, edits: int, seconds: float) -> Proof:
    """Compare a journal with what its writers were told."""
    events = list(events)
    after = {event.ulid: event.after for event in events}
    saved = [entry for entries in told for entry in entries if "saved" in entry]
    lost = sum(after.get(e["saved"], "nothing") != e["after"] for e in saved)
    acknowledged = {e["saved"] for e in saved}
    overwritten = sum(
        second.base != first.version or second.version != first.version + 1 or second.before != first.after
        for chain in grouped(events, lambda e: e.ref).values()
        for first, second in pairwise(chain)
    )
    repeated = sum(n - 1 for n in Counter(e["saved"] for e in saved).values())
    return Proof(
        writers,
        edits,
        round(seconds, 2),
        len(saved),
        sum("conflict" in entry for entries in told for entry in entries),
        lost + repeated,
        sum(ulid not in acknowledged for ulid in after),
        overwritten,
    )


if __name__ == "__main__":
    import sys
    import tempfile

    if len(sys.argv) < 2:
        sys.exit("usage: python -m benchmarks.journal_writers JOURNAL [WRITERS] [EDITS]")
    with tempfile.TemporaryDirectory(prefix="spatialviz-") as notes:
        proof = prove(sys.argv[1], Path(notes), *(int(n) for n in sys.argv[2:4]))
    print(json.dumps({**asdict(proof), "holds": proof.holds}))
    sys.exit(0 if proof.holds else 1)
