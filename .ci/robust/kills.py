"""SIGKILL at random moments of every job: what was there stays, nothing half is believed, and it can be done again."""

from __future__ import annotations

import random
import shutil
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from benchmarks.journal_kills import survive
from promises import Kind, promise
from world import DEMO, EVAL, FRAME, QUESTION, Stopwatch, World, content, leftovers

Words = Sequence[object]


@dataclass(frozen=True)
class Job:
    """A command that writes something.

    `words`: of the command, for the place of its result. `opens`: words of a command that opens the result and must
    refuse half of it. `again`: further words for the second time.
    """

    words: Callable[[World, Path], Words]
    opens: Callable[[World, Path], Words] | None = None
    again: tuple[str, ...] = ()
    name: str = "out"
    volatile: frozenset[str] = field(default_factory=frozenset)


JOBS: dict[str, Job] = {
    "label": Job(
        lambda w, out: ("label", w.dataset, "--limit", 4, "--out", out),
        lambda w, out: ("check", out),
        again=("--resume",),
    ),
    "check": Job(lambda w, out: ("check", w.labels, "--report", out), name="report"),
    "eval": Job(
        lambda w, out: ("eval", w.dataset, "--labels", w.labels, *EVAL, "--out", out),
        lambda w, out: ("failures", out, "--json"),
    ),
    "train": Job(
        lambda w, out: ("train", w.labels, "--epochs", 1, "--out", out),
        lambda w, out: ("models", out),
        name="out.onnx",
    ),
    "retrain": Job(
        lambda w, out: ("retrain", w.corrected, "--epochs", 1, "--out", out),
        lambda w, out: ("models", out / "network.onnx"),
        volatile=frozenset({"comparison.json", "network.json", "network.comparison.json"}),
    ),
    "export": Job(lambda w, out: ("export", w.labels, "--format", "coco", "--out", out)),
    "export-run": Job(lambda w, out: ("export-run", w.run, "--out", out), name="out.jsonl"),
    "render": Job(
        lambda w, out: ("render", out, "--rooms", 1, "--views", 2, "--workers", 2),
        lambda w, out: ("frames", out),
    ),
    "detect": Job(lambda w, out: ("detect", DEMO, "--detector", "simulated", "--out", out), name="out.json"),
    "detect-folder": Job(lambda w, out: ("detect", DEMO, "--detector", "simulated", "--out", out)),
    "map": Job(lambda w, out: ("map", w.dataset, FRAME, "--out", out)),
    "save-case": Job(
        lambda w, out: ("save-case", w.dataset, 0, QUESTION, "--detector", "simulated", "--out", out),
        lambda w, out: ("replay", out),
    ),
}


class Whole:
    """What a job gives when nothing disturbs it, and how long it takes; measured once."""

    def __init__(self) -> None:
        self._known: dict[str, tuple[dict[str, str], float]] = {}
        self._folders: dict[str, Path] = {}

    def folder(self, name: str) -> Path:
        """Where the result of a job stands alone."""
        return self._folders[name]

    def of(self, world: World, name: str) -> tuple[dict[str, str], float]:
        if name not in self._known:
            job, out = JOBS[name], world.folder("whole") / JOBS[name].name
            watch = Stopwatch()
            world.commands.run(*job.words(world, out)).well(0, 1)
            self._known[name] = content_of(job, out), watch.seconds
            self._folders[name] = out.parent
        return self._known[name]


WHOLE = Whole()


def content_of(job: Job, out: Path) -> dict[str, str]:
    """Of a result, and what stands beside it."""
    found = content(out.parent)
    return {name: digest for name, digest in found.items() if Path(name).name not in job.volatile}


def kill_job(name: str, world: World, rng: random.Random, kind: Kind) -> None:
    """Kill a job once, look at what is left, and do it again."""
    job, out = JOBS[name], world.folder(f"kill-{name}") / JOBS[name].name
    whole, lasts = WHOLE.of(world, name)
    words = job.words(world, out)
    hit = world.commands.killed(rng, lasts, *words, appears=lambda: any(out.parent.iterdir()))
    kind.times += hit
    kind.counts["too late"] += not hit
    if job.opens is not None:
        opened = world.commands.run(*job.opens(world, out))
        opened.well(0, 1 if opened.words[0] == "models" else 0, 2)
        kind.counts[f"left: {'refused' if opened.status else 'opens'}"] += 1
        promise(
            opened.status or content_of(job, out) == whole,
            "what opens is whole",
            (opened, differing(content_of(job, out), whole)),
        )
    if out.exists() and not job.again:
        found = content_of(job, out)
        found = {name: digest for name, digest in found.items() if not Path(name).parts[0].endswith(".tmp")}
        promise(found == whole, "what has its name is whole", differing(found, whole))
        shutil.rmtree(out.parent)
        out.parent.mkdir()
    world.commands.run(*words, *(job.again if out.exists() else ())).well(0, 1)
    promise(content_of(job, out) == whole, "done again it is the same", differing(content_of(job, out), whole))
    left = leftovers(out.parent, world.commands.tmp)
    promise(not left, "nothing is left behind by the killed one", left)
    shutil.rmtree(out.parent)


def differing(found: dict[str, str], wanted: dict[str, str]) -> list[str]:
    return sorted(name for name in found.keys() | wanted.keys() if found.get(name) != wanted.get(name))


def kill_over(world: World, rng: random.Random, kind: Kind) -> None:
    """Kill `eval --overwrite` over an earlier run: the old one or the new one is there, whole."""
    whole, lasts = WHOLE.of(world, "eval")
    out = world.folder("kill-over") / "out"
    words = (*JOBS["eval"].words(world, out), "--overwrite")
    world.commands.run(*words).well(0)
    hit = world.commands.killed(rng, lasts, *words, appears=lambda: len(list(out.parent.iterdir())) > 1)
    kind.times += hit
    kind.counts["too late"] += not hit
    # The next writer brings back what a kill between two renamings took away.
    world.commands.run(*words).well(0)
    promise(content_of(JOBS["eval"], out) == whole, "an earlier run that was being replaced is whole")
    promise(not leftovers(out.parent, world.commands.tmp), "nothing is left behind by the killed one")
    shutil.rmtree(out.parent)


def kill_writer(
    words: Callable[[World, Path], Words], whole: int, world: World, rng: random.Random, kind: Kind
) -> None:
    """Kill what writes into a journal: all of its changes are there, or none, and those of before."""
    labels = world.labels_of_its_own()
    world.commands.run("correct", labels, "--edits", first_edit(world), "--author", "ann").well(0)
    journal = labels / "journal.sqlite"
    before = world.events(labels)
    size = journal.stat().st_size
    lasts = 1.2
    hit = world.commands.killed(
        rng,
        lasts,
        *words(world, labels),
        appears=lambda: (labels / "journal.sqlite-wal").exists() or journal.stat().st_size != size,
    )
    kind.times += hit
    kind.counts["too late"] += not hit
    after = world.events(labels)
    promise(after[: len(before)] == before, "what was saved before is there")
    new = len(after) - len(before)
    kind.counts[f"left: {'all' if new else 'none'}"] += 1
    promise(new in (0, whole), "all changes of an action or none", f"{new} of {whole}")
    again = world.commands.run(*words(world, labels)).well()
    promise(again.status == 0 or new, "it can be done again", again)
    promise(len(world.events(labels)) >= len(before) + whole, "they are there in the end")
    shutil.rmtree(labels.parent)


def first_edit(world: World) -> Path:
    """A file of one edit, of an object that `World.edits` leaves."""
    file = world.home / "first.json"
    file.write_text(f'[{{"edit": "class", "frame": "{FRAME}", "object": 7, "to": "first"}}]')
    return file


def _correct(world: World, labels: Path) -> Words:
    return "correct", labels, "--edits", world.edits, "--author", "ben"


def _import(world: World, labels: Path) -> Words:
    return "import", labels, world.corrected_coco, "--author", "eve"


def _propagate(world: World, labels: Path) -> Words:
    return "propagate", labels, FRAME, "--object", 7, "--accept", "--author", "ann", "--doubtful"


def kill_journal(world: World, rng: random.Random, kind: Kind) -> None:
    """Kill four writers of one journal at once: what each was told is saved is there, whole, once."""
    with tempfile.TemporaryDirectory(dir=world.home) as folder:
        found = survive(str(Path(folder) / "journal.sqlite"), Path(folder), rounds=1, seed=rng.randrange(10**6))
    kind.times += found.kills
    kind.counts["acknowledged"] += found.acknowledged
    promise(found.holds, "every acknowledged action is there, whole, once", found)


def scenarios() -> dict[str, Any]:
    """By the names that `--only` takes."""

    def of(name: str) -> Any:
        return lambda world, rng, kind: kill_job(name, world, rng, kind)

    def writing(words: Callable[[World, Path], Words], whole: int) -> Any:
        return lambda world, rng, kind: kill_writer(words, whole, world, rng, kind)

    return {
        **{f"kill-{name}": of(name) for name in JOBS},
        "kill-eval-overwrite": kill_over,
        "kill-correct": writing(_correct, 5),
        "kill-import": writing(_import, 4),
        "kill-propagate": writing(_propagate, 1),
        "kill-journal": kill_journal,
    }
