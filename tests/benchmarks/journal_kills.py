"""Writers that are killed while they save (SIGKILL): all that was acknowledged is there, and no action in part.

cd tests && python -m benchmarks.journal_kills JOURNAL [ROUNDS] [WRITERS] [SEED]
"""

from __future__ import annotations

import json
import random
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from contextlib import redirect_stdout
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from pipeline.corrections.journal.events import Conflict, Edit, Event, NotSaved, Saved
from pipeline.corrections.journal.field_refs import object_ref, relation_ref
from pipeline.corrections.journal.journal import Journal, open_journal

from .journal_writers import FRAME, read_report, ready_processes

GROUP = 3
"""Edits of one action."""
SHARED = 5
"""Cells that all writers edit."""
PATIENCE_S = 180.0


@dataclass(frozen=True)
class Survival:
    """What was left.

    Attributes
    ----------
    kills : int
    acknowledged, groups : int
        Actions that a writer was told are saved, and actions in the journal.
    refused : int
        Times that a writer was told that its action was not saved, and tried again.
    conflicts : int
    lost : int
        Acknowledged actions that are not in the journal.
    torn : int
        Actions that are there in part.
    doubled : int
        Values that were saved more than once.
    unasked : int
        Actions that no writer was told of, less the one that each may have had on its way when it was killed.
    """

    kills: int
    acknowledged: int
    groups: int
    refused: int
    conflicts: int
    lost: int
    torn: int
    doubled: int
    unasked: int

    @property
    def holds(self) -> bool:
        """Whether every promise was kept."""
        return not (self.lost or self.torn or self.doubled or self.unasked > 0)


def write_groups(where: str, name: str) -> None:
    """Save actions without end, and print a line of JSON when each is acknowledged; what was refused is tried again."""
    rng = random.Random(name)
    own = [object_ref(FRAME, 1_000 + 10 * int(name) + k, "label") for k in range(GROUP - 1)]
    seen: dict[Any, tuple[int, Any]] = {}
    with open_journal(where) as journal:
        for number in range(1_000_000):
            shared = relation_ref(FRAME, 1, 2 + rng.randrange(SHARED), "left")
            done: Saved | Conflict | None = None
            while not isinstance(done, Saved):
                wanted = {shared: rng.choice([-1, 0, 1]), **dict.fromkeys(own, f"{name} {number}")}
                edits = [Edit(c, seen.get(c, (0, None))[1], v, seen.get(c, (0, None))[0]) for c, v in wanted.items()]
                done = _append(journal, edits, f"writer {name}")
                if isinstance(done, Conflict):
                    events = [r.event for r in done.rivals if r.event is not None]
                    print(json.dumps({"conflict": len(events)}), flush=True)
                else:
                    events = list(done.events)
                    print(json.dumps({"group": done.group}), flush=True)
                seen |= {e.ref: (e.version, e.after) for e in events}


def write_into(report: Path, where: str, name: str) -> None:
    """The same, printing into a file."""
    with open(report, "w", encoding="utf-8") as out, redirect_stdout(out):
        write_groups(where, name)


def _append(journal: Journal, edits: Sequence[Edit], author: str) -> Saved | Conflict:
    group = None
    while True:
        try:
            return journal.append(edits, author, group=group)
        except NotSaved as error:
            print(json.dumps({"refused": error.group, "reason": str(error)}), flush=True)
            edits, group = error.edits, error.group
            time.sleep(0.1)


def survive(
    where: str,
    folder: Path,
    rounds: int = 3,
    writers: int = 4,
    seed: int = 0,
    disturb: Callable[[], None] | None = None,
) -> Survival:
    """Start writers, kill them at random times, look at the journal, and again.

    Parameters
    ----------
    where : str
        Path or URL of an empty journal.
    folder : Path
        For what the writers print.
    rounds, writers, seed : int
    disturb : callable, optional
        Done once a round while all are writing; each of them saves again before it is killed.

    Raises
    ------
    TimeoutError
        A writer does not get on.
    """
    rng = random.Random(seed)
    reports: list[Path] = []
    for turn in range(rounds):
        new = [folder / f"writer-{turn * writers + k}.jsonl" for k in range(writers)]
        _round(where, new, len(reports), rng, disturb)
        reports += new
        with open_journal(where) as journal:
            cell = object_ref(FRAME, 1, "label")
            head = journal.heads([cell]).get(cell)
            before, base = (None, 0) if head is None else (head.after, head.version)
            journal.append([Edit(cell, before, f"round {turn}", base)], "the one who looks")
    with open_journal(where) as journal:
        events = [e for e in journal.events() if e.author != "the one who looks"]
    return judge(events, [read_report(r) for r in reports])


def _round(where: str, reports: list[Path], first: int, rng: random.Random, disturb: Callable[[], None] | None) -> None:
    context = ready_processes()
    processes = []
    try:
        for number, report in enumerate(reports, start=first):
            processes.append(context.Process(target=write_into, args=(report, where, str(number)), daemon=True))
            processes[-1].start()
        _wait_for(reports, [0] * len(reports))
        if disturb is not None:
            time.sleep(rng.uniform(0.0, 0.3))
            disturb()
            _wait_for(reports, [_saved(r) for r in reports])
        for process in rng.sample(processes, len(processes)):
            time.sleep(rng.uniform(0.0, 0.3))
            process.kill()
    finally:
        for process in processes:
            process.kill()
            process.join()


def _saved(report: Path) -> int:
    return sum("group" in entry for entry in read_report(report))


def _wait_for(reports: Iterable[Path], more_than: Iterable[int]) -> None:
    until = time.monotonic() + PATIENCE_S
    for report, count in zip(reports, more_than, strict=True):
        while _saved(report) <= count:
            if time.monotonic() > until:
                raise TimeoutError(f"nothing new in {report}")
            time.sleep(0.02)


def judge(events: Iterable[Event], told: Sequence[Sequence[dict[str, Any]]]) -> Survival:
    """Compare a journal with what its writers were told, a list each."""
    events = list(events)
    sizes = Counter(e.group for e in events)
    values = Counter((e.ref, e.after) for e in events if e.ref.kind == "object")
    entries = [entry for writer in told for entry in writer]
    acknowledged = {entry["group"] for entry in entries if "group" in entry}
    return Survival(
        kills=len(told),
        acknowledged=len(acknowledged),
        groups=len(sizes),
        refused=sum("refused" in entry for entry in entries),
        conflicts=sum("conflict" in entry for entry in entries),
        lost=len(acknowledged - set(sizes)),
        torn=sum(size != GROUP for size in sizes.values()),
        doubled=sum(count - 1 for count in values.values()),
        unasked=max(0, len(set(sizes) - acknowledged) - len(told)),
    )


def main(arguments: Sequence[str]) -> int:
    """The command above."""
    if not arguments:
        print("usage: python -m benchmarks.journal_kills JOURNAL [ROUNDS] [WRITERS] [SEED]", file=sys.stderr)
        return 2
    with tempfile.TemporaryDirectory(prefix="spatialviz-") as notes:
        names = ("rounds", "writers", "seed")
        numbers: dict[str, Any] = {name: int(n) for name, n in zip(names, arguments[1:4], strict=False)}
        found = survive(arguments[0], Path(notes), **numbers)
    print(json.dumps({**asdict(found), "holds": found.holds}))
    return 0 if found.holds else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
