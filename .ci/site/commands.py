"""Run every command and snippet of the documents, page by page, each page in a folder of its own.

    python .ci/site/commands.py                      all pages; exit status 1 where something fails
    python .ci/site/commands.py --page docs/labels.md -v

What the placeholders stand for is made by `command_world.py`. A block that no check can run has the line
`<!-- not run: REASON -->` above it; of its commands the words are parsed all the same.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import pickle
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from multiprocessing.connection import wait
from pathlib import Path
from typing import Any

import command_runs
import command_world
from command_blocks import LANGUAGES, SHELL, Block, Command, blocks_of, commands_of
from command_data import wrong_with
from command_runs import ROOT, Ran

NO_IS_AN_ANSWER = ("ask", "bench", "check", "doctor", "failures")
"""Commands whose exit status 1 says something of the data, which are not the reader's here."""
SHORTER = {
    ("bench",): "--quick --only start.help",
    ("retrain",): "--epochs 1",
    ("train",): "--epochs 1",
    ("train", "rooms"): "--rooms 10 --views 1 --width 160 --height 120 --members 1",
    ("train", "boxes"): "--rooms 10 --views 1 --width 160 --height 120",
}
"""What keeps a command short that takes minutes."""
WRITTEN = ("--out", "--save", "--sheet", "--report", "--backup")


@dataclass(frozen=True)
class Outcome:
    """What became of a command or a snippet."""

    page: str
    line: int
    text: str
    seconds: float = 0.0
    not_run: str | None = None
    wrong: str = ""
    ran: Ran | None = None


@dataclass
class Page:
    """A page that is being followed, in its folder."""

    path: Path
    world: Path
    folder: Path
    python: command_runs.Interpreter | None = None
    words: dict[str, list[str]] = field(default_factory=dict)  # of the last command of each verb
    printed: list[Any] | None = None  # JSON of the last command of the block before
    outcomes: list[Outcome] = field(default_factory=list)

    def follow(self) -> list[Outcome]:
        """Run its blocks in order."""
        command_runs.enter(self.folder)
        for block in blocks_of(self.path):
            if block.language in SHELL:
                self.printed = None
                for command in commands_of(block):
                    self._told(command.line, command.text, lambda c=command, b=block: self._command(c, b))
            elif block.language in LANGUAGES:
                self._told(block.line, block.language, lambda b=block: self._snippet(b))
            elif re.search(r"^(\$ )?(spatialviz|pip|python) ", block.text, re.M):
                self._told(block.line, block.text, lambda: (None, "the block has a command and does not say ```sh"))
        return self.outcomes

    def _told(self, line: int, text: str, work: Any) -> None:
        begun = time.monotonic()
        try:
            ran, wrong, *reason = work()
        except Exception as error:
            ran, wrong, reason = None, repr(error), []
        where = str(self.path.relative_to(ROOT))
        self.outcomes.append(
            Outcome(where, line, text, time.monotonic() - begun, reason[0] if reason else None, wrong, ran)
        )

    def _snippet(self, block: Block) -> tuple[Any, ...]:
        if block.language != "python":
            return None, wrong_with(block, self.printed)
        if block.not_run:
            compile(block.text, str(self.path), "exec")
            return None, "", block.not_run
        written = re.findall(r'import_\w+\([^)]*"(\w+)"\)', block.text)
        self._provide(re.findall(r"[\"']([\w./-]+)[\"']", block.text), written)
        self.python = self.python or command_runs.Interpreter(lambda: command_world.python_names(self.world))
        ran = self.python.run(block.text, f"{self.path.name}:{block.line}")
        return ran, ran.wrong or (ran.err.splitlines()[-1] if ran.status else "")

    def _command(self, command: Command, block: Block) -> tuple[Any, ...]:
        files = self.folder / "log"
        known = command_world.words(self.world)
        text = re.sub(rf"\b({'|'.join(known)})\b", lambda found: known[found[1]], command.text)
        words = Command(command.line, text, command.comment).words
        own = words is not None and words[:1] == ["spatialviz"]
        if block.not_run:
            if own:
                ran = command_runs.parsed(words[1:], files)
                return ran, _wrong(ran, command, ()), block.not_run
            gone = [w for w in words or [] if re.match(r"(\.ci|docs|tests)/", w) and not (ROOT / w).exists()]
            return None, f"there is no {gone[0]}" if gone else "", block.not_run
        if not own:
            self._provide(shlex.split(text.partition("\n")[0], posix=True))
            ran = command_runs.shell(text, files)
            return ran, _wrong(ran, command, ())
        words = self._whole(words[1:])
        verb = words[0] if words else "view"
        written = [w for before, w in pairwise(words) if before in WRITTEN]
        written += words[1:2] if verb == "render" else words[-1:] if "--mesh" in words else []
        self._provide(words, written)
        for head in dict.fromkeys(((verb,), tuple(words[:2]))):
            for option in re.findall(r"--\S+(?: [^-]\S*)*", SHORTER.get(head, "")):
                words += shlex.split(option) if option.split()[0] not in words else []
        if verb in ("view", "mcp") and "--help" not in words:
            ran = (command_runs.page_server if verb == "view" else command_runs.agents_server)(words, files)
        else:
            ran = command_runs.command(words, files)
        if "--json" in words:
            self.printed = [json.loads(line) for line in ran.out.splitlines() if line.startswith("{")]
        return ran, _wrong(ran, command, NO_IS_AN_ANSWER if command.status == 0 else (), verb)

    def _whole(self, words: list[str]) -> list[str]:
        """The words with what `…` stands for: the options of the command of that verb before."""
        if {"…", "..."} & set(words):
            before, options = self.words.get(words[0], []), []
            for k, word in enumerate(before):
                if word.startswith("--") and word not in words:
                    options += before[k : k + 2] if k + 1 < len(before) and before[k + 1][:2] != "--" else [word]
            words = [w for w in words if w not in ("…", "...")] + options
        self.words[words[0] if words else "view"] = words
        return list(words)

    def _provide(self, words: list[str], written: list[str] | tuple[str, ...] = ()) -> None:
        """Bring what is named from the world, where the page has not made it; nothing is where a command writes."""
        heads = {part.partition("/")[0] for word in words for part in re.split(r"[=,:]", word)}
        made = {word.partition("/")[0] for word in written}
        for head in made:
            if head.isupper() and (self.folder / head).exists():
                shutil.rmtree(head, ignore_errors=True)
        for head in sorted(heads - made - {"", ".", ".."}):
            # Beside a network stands the TOML file that describes it.
            for source in (self.world / head, *([(self.world / head).with_suffix(".toml")] * head.endswith(".onnx"))):
                copy = self.folder / source.name
                if source.exists() and not copy.exists():
                    (shutil.copytree if source.is_dir() else shutil.copy)(source, copy)


def _wrong(ran: Ran, command: Command, may_say_no: tuple[str, ...], verb: str = "") -> str:
    if ran.wrong or ran.status == command.status or (ran.status == 1 and verb in may_say_no):
        return ran.wrong
    said = [line for line in (ran.err.strip() or ran.out).splitlines() if re.search(r"\w", line)]
    return f"exit status {ran.status}: {' '.join(said[-1:])}"


def _follow(page: Path, world: Path, folder: Path) -> None:
    """Follow a page in a process of its own; its outcomes go to a file in its home."""
    folder.mkdir(parents=True)
    outcomes = Page(page, world, folder).follow()
    command_runs.home_of(folder).joinpath("outcomes").write_bytes(pickle.dumps(outcomes))


def _forked(tasks: list[tuple[Any, ...]]) -> Iterator[int]:
    """Call each of (function, arguments...) in a process of its own, as many at once as there are cores.

    Gives the places of those that have ended.
    """
    fork, left, running = multiprocessing.get_context("fork"), list(enumerate(tasks)), {}
    while left or running:
        while left and len(running) < len(os.sched_getaffinity(0)):
            place, (task, *arguments) = left.pop(0)
            process = fork.Process(target=task, args=arguments)
            process.start()
            running[process.sentinel] = process, place
        for sentinel in wait(list(running)):
            process, place = running.pop(sentinel)  # pyright: ignore[reportArgumentType]
            process.join()
            if process.exitcode:
                raise SystemExit(f"it ends with status {process.exitcode}")
            yield place


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--page", action="append", help="only this page, as docs/labels.md; may be given again")
    parser.add_argument("-v", action="store_true", help="every command, with its seconds; what failed ones printed")
    options = parser.parse_args()
    pages = [ROOT / "README.md", *sorted((ROOT / "docs").glob("**/*.md")), *sorted((ROOT / ".github").glob("*.md"))]
    if options.page:
        pages = [page for page in pages if str(page.relative_to(ROOT)) in options.page]
    begun, before = time.monotonic(), _checkout()
    command_runs.load_program()
    with tempfile.TemporaryDirectory(prefix="documents-") as work:
        world = Path(work, "world")
        list(_forked([(command_world.make_world, world)]))
        folders = [Path(work, "pages", *page.relative_to(ROOT).with_suffix("").parts) for page in pages]
        outcomes: list[Outcome] = []
        for place in _forked([(_follow, page, world, folder) for page, folder in zip(pages, folders, strict=True)]):
            own = pickle.loads(command_runs.home_of(folders[place]).joinpath("outcomes").read_bytes())
            _print_each(own, options.v)
            outcomes += own
    _print_table(outcomes)
    changed = "" if _checkout() == before else "the checkout was changed: see git status"
    failed = sum(bool(outcome.wrong) for outcome in outcomes)
    seconds = time.monotonic() - begun
    print(f"{len(pages)} pages, {len(outcomes)} commands and snippets, {failed} failed, {seconds:.0f} s")
    print(*[changed] if changed else [], sep="\n", end="")
    return int(bool(failed or changed))


def _checkout() -> str:
    return subprocess.run(["git", "-C", str(ROOT), "status", "--porcelain"], capture_output=True, text=True).stdout


def _print_each(outcomes: list[Outcome], every: bool) -> None:
    """What is wrong; with `every` a line for each command, and what those printed that failed."""
    for o in outcomes:
        if every or o.wrong:
            mark = f"FAILED {o.wrong}" if o.wrong else f"not run: {o.not_run}" if o.not_run else f"{o.seconds:.1f} s"
            print(f"{o.page}:{o.line}: {o.text.splitlines()[0]}  [{mark}]", flush=True)
        if every and o.wrong and o.ran:
            print(*(f"    {line}" for line in (o.ran.out + o.ran.err).splitlines()[-12:]), sep="\n", flush=True)


def _print_table(outcomes: list[Outcome]) -> None:
    """A row for each page."""
    print(f"{'page':34} {'run':>4} {'not':>4} {'failed':>6}   not run, by reason")
    for page in sorted({o.page for o in outcomes}):
        own = [o for o in outcomes if o.page == page]
        reasons = Counter(o.not_run for o in own if o.not_run)
        told = ", ".join(f"{reason} {count}" for reason, count in sorted(reasons.items()))
        left, failed = reasons.total(), sum(bool(o.wrong) for o in own)
        print(f"{page:34} {len(own) - left:4} {left:4} {failed:6}   {told}".rstrip())


if __name__ == "__main__":
    sys.exit(main())
