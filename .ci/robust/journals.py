"""Damaged journals, several writers of one, and files of earlier versions."""

from __future__ import annotations

import contextlib
import io
import json
import random
import shutil
import sqlite3
from collections.abc import Callable
from contextlib import closing
from functools import cache
from pathlib import Path

from journal_damage import HARM, PAGE, Parts, parts_of, placed
from journal_world import work_of
from promises import Kind, promise
from world import FRAME, ROOT, World

from pipeline.corrections import JOURNAL_FILE, open_journal
from spatialviz.cli import main

FIXTURES = ROOT / "tests" / "fixtures"
AT_ONCE = 25
"""Damaged copies a round."""


def _inserted(data: bytearray, rng: random.Random) -> None:
    at = rng.randrange(len(data))
    data[at:at] = rng.randbytes(rng.choice((1, 7, 512, PAGE)))


def _swapped(data: bytearray, rng: random.Random) -> None:
    a, b = (PAGE * rng.randrange(len(data) // PAGE) for _ in range(2))
    data[a : a + PAGE], data[b : b + PAGE] = data[b : b + PAGE], data[a : a + PAGE]


def _noise(data: bytearray, rng: random.Random) -> None:
    at, length = rng.randrange(len(data)), rng.choice((1, 8, 100, PAGE))
    data[at : at + length] = rng.randbytes(min(length, len(data) - at))


def _other_text(data: bytearray, rng: random.Random) -> None:
    for old, new in ((b"mug", b"cup"), (b"ann", b"bob"), (b"lamp", b"desk")):
        if (at := data.find(old)) >= 0:
            data[at : at + len(old)] = new


OTHERS: dict[str, tuple[str, Callable[[Parts, random.Random], None]]] = {
    "bytes inserted": ("closed", lambda parts, rng: _inserted(parts[""], rng)),
    "bytes inserted in the log": ("open", lambda parts, rng: _inserted(parts["-wal"], rng)),
    "pages exchanged": ("closed", lambda parts, rng: _swapped(parts[""], rng)),
    "noise": ("closed", lambda parts, rng: _noise(parts[""], rng)),
    "noise in the log": ("open", lambda parts, rng: _noise(parts["-wal"], rng)),
    "words replaced": ("closed", lambda parts, rng: _other_text(parts[""], rng)),
    "words replaced in the log": ("open", lambda parts, rng: _other_text(parts["-wal"], rng)),
    "the log is gone": ("open", lambda parts, rng: parts.pop("-wal")),
    "nothing is left": ("closed", lambda parts, rng: parts[""].clear()),
    "another file": ("closed", lambda parts, rng: parts.update({"": bytearray(rng.randbytes(9_000))})),
}
STATEMENTS = (
    "UPDATE events SET after = '\"other\"' WHERE id = ?",
    "UPDATE events SET author = 'eve' WHERE id = ?",
    "UPDATE events SET time = time + 1 WHERE id = ?",
    "DELETE FROM events WHERE id = ?",
    "UPDATE events SET id = id + 100000 WHERE id = ?",
)
"""What somebody with SQLite may do to a row."""


@cache
def _good(home: Path) -> tuple[dict[str, Parts], list[str], Path]:
    """A journal's files, open and closed, its events as the command prints them, and its labels."""
    labels = home / "journal_labels"
    shutil.copytree(home / "labels", labels)
    path = labels / JOURNAL_FILE
    with open_journal(path) as journal:
        work_of(journal, 90)
        copies = {"open": parts_of(path)}
    copies["closed"] = parts_of(path)
    return copies, _printed(labels)[1].splitlines(), labels


def _printed(labels: Path) -> tuple[int, str, str]:
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        status = main(["journal", str(labels), "--json"])
    return status, out.getvalue(), err.getvalue()


def damaged(world: World, rng: random.Random, kind: Kind) -> None:
    """Harm a journal: it is refused in a line, or every event is as it was saved."""
    assert world.labels
    copies, events, labels = _good(world.home)
    for _ in range(AT_ONCE):
        name = rng.choice((*HARM, *OTHERS, "a row"))
        for end in ("", "-wal", "-shm"):
            Path(f"{labels / JOURNAL_FILE}{end}").unlink(missing_ok=True)
        state, harm = {**HARM, **OTHERS}.get(name, ("closed", lambda parts, rng: None))
        parts = {end: bytearray(data) for end, data in copies[state].items()}
        harm(parts, rng)
        path = placed(parts, labels)
        if name == "a row":
            with closing(sqlite3.connect(path)) as raw:
                triggers = raw.execute("SELECT name FROM sqlite_master WHERE type = 'trigger'").fetchall()
                for (trigger,) in triggers:
                    raw.execute(f"DROP TRIGGER {trigger}")
                raw.execute(rng.choice(STATEMENTS), (rng.randint(1, len(events)),))
                raw.commit()
        kind.times += 1
        status, out, err = _printed(labels)
        promise("Traceback" not in out + err and "internal error" not in err, f"{name}: no error of the program", err)
        kind.counts["refused" if status == 2 else "unharmed"] += 1
        if status == 2:
            promise(err.count("spatialviz: error:") == 1, f"{name}: one clear line", err)
        else:
            found = out.splitlines()
            # Without its log the file is that of an earlier moment, as a backup is.
            whole = events[: len(found)] if name == "the log is gone" else events
            promise(found == whole, f"{name}: what is believed is what was saved", err)


def together(world: World, rng: random.Random, kind: Kind) -> None:
    """Commands that correct the same labels at once: what was acknowledged is there, a rival's value is told."""
    labels = world.labels_of_its_own()
    started = []
    for k in range(4):
        edits = labels.parent / f"edits-{k}.json"
        made = [{"edit": "class", "frame": FRAME, "object": o, "to": f"{k} {o}"} for o in (k, 8)]
        edits.write_text(json.dumps(made))
        words = ("correct", labels, "--edits", edits, "--author", f"writer{k}", "--json")
        started.append((world.commands.start(*words), words))
    ended = [world.commands.ended(process, words).well(0, 1) for process, words in started]
    kind.times += len(ended)
    saved = sum(done.status == 0 for done in ended)
    kind.counts["saved"] += saved
    kind.counts["told of a rival"] += len(ended) - saved
    events = world.events(labels)
    promise(len(events) == 2 * saved, "what was acknowledged is there, whole, and no more", (len(events), saved))
    promise(saved >= 1, "somebody's is saved")
    shutil.rmtree(labels.parent)


def old_files(world: World, rng: random.Random, kind: Kind) -> None:
    """Every kind of file of every earlier state opens by the commands, without being changed where it is only read."""
    for state in sorted(path for path in FIXTURES.iterdir() if path.is_dir()):
        copy = world.folder("old") / state.name
        shutil.copytree(state, copy)
        tried = {
            "labels": [("check", copy / "labels"), ("journal", copy / "labels"), ("show", copy / "labels", FRAME)],
            "run": [("query", copy / "run", "select count(*) from records"), ("failures", copy / "run")],
            "case": [("replay", copy / "case")],
            "imported": [("failures", copy / "imported")],
            "case_imported": [("replay", copy / "case_imported")],
            "recording": [("frames", copy / "recording")],
        }
        commands = [words for name, every in tried.items() if (copy / name).exists() for words in every]
        commands += [("models", file) for file in sorted(copy.glob("*.onnx"))]
        for words in rng.sample(commands, min(4, len(commands))):
            world.commands.run(*words).well(0, 1)
            kind.times += 1
        shutil.rmtree(copy.parent)


SCENARIOS = {"journal-damaged": damaged, "journal-together": together, "old-files": old_files}
