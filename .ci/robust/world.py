"""What faults are done to: labels, a run, a journal, a dataset, each made once by the commands themselves."""

from __future__ import annotations

import hashlib
import json
import shutil
import time
from collections.abc import Iterable
from functools import cached_property
from pathlib import Path

from commands import Commands

ROOT = Path(__file__).resolve().parents[2]
DEMO = ROOT / "assets" / "demo"
FRAME = "000001/000000"
QUESTION = "mug left of the laptop"
EVAL = ("--detector", "simulated", "--no-plots")
VOLATILE = frozenset({"run.json", "manifest.json", "README.md", "plan.json", "report.html", "export.json", "tables.md"})
"""Files that name a time, a duration or a path."""


class World:
    """A folder of its own, in which a runner works."""

    def __init__(self, home: Path) -> None:
        self.home = home
        self.commands = Commands(home / "machine")
        self._number = 0

    def folder(self, name: str) -> Path:
        """A new folder."""
        self._number += 1
        made = self.home / f"{name}-{self._number}"
        made.mkdir()
        return made

    def _made(self, name: str, *words: object) -> Path:
        out = self.home / name
        self.commands.run(*words, "--out", out).well(0)
        return out

    @cached_property
    def dataset(self) -> Path:
        """The first scene of the demo, by its own files: they may be harmed."""
        return self.copy_of_dataset(self.home / "dataset")

    @staticmethod
    def copy_of_dataset(folder: Path) -> Path:
        shutil.copytree(DEMO, folder, ignore=shutil.ignore_patterns("00000[234]"))
        return folder

    @cached_property
    def labels(self) -> Path:
        return self._made("labels", "label", self.dataset, "--limit", 4, "--workers", 1)

    @cached_property
    def run(self) -> Path:
        return self._made("run", "eval", self.dataset, "--labels", self.labels, *EVAL, "--workers", 1)

    @cached_property
    def coco(self) -> Path:
        return self._made("coco", "export", self.labels, "--format", "coco")

    @cached_property
    def edits(self) -> Path:
        """A file of edits that changes several values at once."""
        file = self.home / "edits.json"
        names = ("mug", "vase", "book", "lamp", "plant")
        file.write_text(
            json.dumps([{"edit": "class", "frame": FRAME, "object": k, "to": f"{n} x"} for k, n in enumerate(names)])
        )
        return file

    @cached_property
    def corrected_coco(self) -> Path:
        """An export in which somebody else has renamed things."""
        folder = self.home / "corrected_coco"
        shutil.copytree(self.coco, folder)
        file = folder / "instances.json"
        content = json.loads(file.read_text())
        content["categories"].append({"id": 9_999, "name": "renamed thing", "supercategory": "object"})
        for annotation in content["annotations"][:4]:
            annotation["category_id"] = 9_999
        file.write_text(json.dumps(content))
        return folder

    def labels_of_its_own(self) -> Path:
        """A copy of the labels, for a journal of its own."""
        folder = self.folder("corrected") / "labels"
        shutil.copytree(self.labels, folder)
        return folder

    @cached_property
    def corrected(self) -> Path:
        """Labels with corrections in their journal."""
        labels = self.labels_of_its_own()
        self.commands.run("correct", labels, "--edits", self.edits, "--author", "ann").well(0)
        return labels

    def events(self, labels: Path) -> list[dict[str, object]]:
        """What the journal beside labels holds, by the command."""
        done = self.commands.run("journal", labels, "--json").well()
        return [json.loads(line) for line in done.out.splitlines()]


def content(path: Path, volatile: Iterable[str] = VOLATILE) -> dict[str, str]:
    """Hashes of a file's, or a folder's, files that are the same in each run."""
    files = [path] if path.is_file() else sorted(path.rglob("*"))
    return {
        str(file.relative_to(path)): hashlib.sha256(file.read_bytes()).hexdigest()
        for file in files
        if file.is_file() and file.name not in set(volatile) and "parts" not in file.parts
    }


def leftovers(*folders: Path) -> list[Path]:
    """What no finished command leaves: hidden names of files on their way, and temporary folders."""
    return [
        left
        for folder in folders
        for pattern in (".*.tmp", ".*.old", "tmp*", "spatialviz*")
        for left in folder.glob(pattern)
    ]


class Stopwatch:
    """Seconds since it was made."""

    def __init__(self) -> None:
        self._start = time.monotonic()

    @property
    def seconds(self) -> float:
        return time.monotonic() - self._start
