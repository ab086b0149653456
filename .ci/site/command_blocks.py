"""Fenced blocks of documents, and the commands in them."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

SHELL = ("sh", "bash", "console")
LANGUAGES = (*SHELL, "python", "toml", "json", "yaml")
REASONS = {
    "network": "a server or a store elsewhere",
    "docker": "a container",
    "gpu": "a graphics card",
    "cluster": "Ray or SLURM",
    "database": "PostgreSQL",
    "installation": "changes the environment",
    "extra": "an extra that is not installed for checks, such as open3d",
    "model": "weights that others publish",
    "data": "files that others publish",
    "checkout": "is done in a checkout of the source",
    "long": "takes minutes",
    "yours": "a part of the reader's own program",
}
"""Why a block may stand without being run."""
NOT_RUN = re.compile(r"<!-- not run: (.*?) -->")
IN_PAGE = re.compile(r"<!-- in the page: (spatialviz .*?) -->")
"""What readers do in the browser at this place, as a command that does the same."""


@dataclass(frozen=True)
class Block:
    """A fenced block: the number of its first line, its language, its text, and the reason not to run it."""

    line: int
    language: str
    text: str
    not_run: str | None


@dataclass(frozen=True)
class Command:
    """A command of a shell: its text without the comment, and the comment."""

    line: int
    text: str
    comment: str

    @property
    def words(self) -> list[str] | None:
        """The words, where no shell is needed to understand them; else None."""
        if "\n" in self.text or re.search(r"[|&;<>$`]|^\w+=", re.sub(r"'[^']*'|\"[^\"$`]*\"", "", self.text)):
            return None
        return shlex.split(self.text)

    @property
    def status(self) -> int:
        """The exit status that the comment promises, by default 0."""
        said = re.search(r"exit status (\d+)$", self.comment)
        return int(said[1]) if said else 0


def blocks_of(page: Path) -> Iterator[Block]:
    """Blocks of a page in order; ValueError for a fence that is not closed, or an unknown reason."""
    lines = page.read_text("utf-8").splitlines()
    at = 0
    while at < len(lines):
        opened = re.match(r"( *)```(\w*)", lines[at])
        if opened is None:
            if done := IN_PAGE.fullmatch(lines[at].strip()):
                yield Block(at + 1, "sh", done[1], None)
            at += 1
            continue
        indent, language = opened.groups()
        end = next((k for k in range(at + 1, len(lines)) if lines[k].strip() == "```"), None)
        if end is None:
            raise ValueError(f"{page}:{at + 1}: the block has no end")
        said = NOT_RUN.fullmatch(lines[at - 1].strip()) if at else None
        if said and said[1] not in REASONS:
            raise ValueError(f"{page}:{at}: {said[1]!r} is no reason; reasons: {', '.join(REASONS)}")
        text = "\n".join(line.removeprefix(indent) for line in lines[at + 1 : end])
        yield Block(at + 2, language, text, said and said[1])
        at = end + 1


def commands_of(block: Block) -> Iterator[Command]:
    """Commands of a block for a shell; what a `console` prints is left out."""
    lines = block.text.splitlines()
    at = 0
    while at < len(lines):
        first, line = at, lines[at]
        at += 1
        if block.language == "console":
            if not line.startswith("$ "):
                continue
            line = line.removeprefix("$ ")
        code, comment = _without_comment(line)
        while code.endswith("\\"):
            more, comment = _without_comment(lines[at].removeprefix("> "))
            code, at = code[:-1] + " " + more.strip(), at + 1
        if heredoc := re.search(r"<<-?\s*'?\"?(\w+)", code):
            end = next(k for k in range(at, len(lines)) if lines[k].strip() == heredoc[1])
            code, at = "\n".join([code, *lines[at : end + 1]]), end + 1
        if code.strip():
            yield Command(block.line + first, code.strip(), comment)


def _without_comment(line: str) -> tuple[str, str]:
    """A line's code and its comment, which begins with a # that is in no quotes and after a space."""
    found = re.match(r"((?:'[^']*'|\"[^\"]*\"|(?<=\S)#|[^'\"#])*)(?:#\s*(.*))?$", line)
    return (found[1].rstrip(), found[2] or "") if found else (line, "")
