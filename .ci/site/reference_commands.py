"""Page of the command line, from the program's own parsers."""

from __future__ import annotations

import inspect
import re
import typing
import warnings
from argparse import Action
from dataclasses import is_dataclass
from functools import cache
from pathlib import Path
from types import NoneType
from typing import Any, Literal

import tyro
from markdown.extensions.toc import slugify
from markdown_tables import cell, code, table

from pipeline.system.frozen import dataclass
from spatialviz.cli import ABOUT, FORMS, GROUPS, OPTIONS, options_of
from spatialviz.options import BAD, FINE, INTERRUPTED, NO, UNREAD

DOCS = Path(__file__).resolve().parents[2] / "docs"
KINDS = {str: "text", Path: "path", int: "whole number", float: "number", bool: "flag"}
MOST_EXAMPLES = 3
STATUSES = (
    (FINE, "Fine."),
    (NO, "The answer is no: nothing was found, or a check failed. Commands that end so say when."),
    (BAD, "Bad usage, or bad input: one line says what was wrong, what was expected, and in which file."),
    (INTERRUPTED, "Stopped by `Ctrl+C`."),
    (UNREAD, "Nobody reads the output any more, as with `| head`."),
)
INTRO = f"""# Command line

Every command of `spatialviz`, with its arguments and options. {ABOUT} `spatialviz` alone opens the page on the built-in
demo, `spatialviz COMMAND --help` prints what stands here, and `spatialviz --version` the version. Every command takes
`--limits NAME=VALUE,...` for files that are [large on purpose](../limits.md).

## Exit status

"""


@dataclass(frozen=True)
class Option:
    """Argument or option of a command, as a row of a table."""

    names: tuple[str, ...]
    kind: str
    default: str
    meaning: str
    owner: type | None  # Class of options that several commands share; None for the command's own

    @property
    def row(self) -> tuple[str, ...]:
        """Cells: names, type, default, meaning."""
        default = self.default if self.default == "required" else code(self.default)
        return ", ".join(map(code, self.names)), self.kind, default, cell(self.meaning)


@dataclass(frozen=True)
class Command:
    """Command with its options; `said` is it as people type it."""

    said: str
    about: str
    arguments: tuple[Option, ...]
    options: tuple[Option, ...]

    @property
    def usage(self) -> str:
        """The line that `--help` begins with, without what is shared by all."""
        needed = (f"{o.names[-1]} {o.names[-1].strip('-').upper()}" for o in self.options if o.default == "required")
        return " ".join(("spatialviz", self.said, "[OPTIONS]", *needed, *(a.names[0] for a in self.arguments)))

    @property
    def shared(self) -> tuple[str, ...]:
        """Titles of the groups of options that other commands have too."""
        return tuple(dict.fromkeys(shared_title(o.owner) for o in self.options if o.owner is not None))


def shared_title(owner: type) -> str:
    """Return the title of a group of shared options: "Camera options" of CameraOptions."""
    words = re.sub(r"(Options|Setup)$", "", owner.__name__)
    return f"{words} options"


def _owner(command: type, place: str) -> type | None:
    """Return the class that declares the option at "source.up"; None for one of the command itself."""
    group, _, name = place.replace("-", "_").rpartition(".")
    if not group:
        return None
    found: Any = typing.get_type_hints(command)[group]
    assert is_dataclass(found), place
    return next(c for c in found.__mro__ if name in vars(c).get("__annotations__", {}))  # pyright: ignore


def _kind(hint: Any) -> str:
    """Word the type of an option."""
    parts = typing.get_args(hint)
    if typing.get_origin(hint) is Literal:
        return " or ".join(code(f"{value}") for value in parts)
    if typing.get_origin(hint) is tuple:
        return f"several: {_kind(parts[0])}" if parts[-1] is Ellipsis else f"{len(parts)} of {_kind(parts[0])}"
    return " or ".join(_kind(part) for part in parts if part is not NoneType) if parts else KINDS[hint]


def _option(command: type, action: Action) -> Option:
    told, _, default = (action.help or "").rpartition("(")
    default = default.removesuffix(")").removeprefix("default: ").strip()
    group, _, name = action.dest.replace("-", "_").rpartition(".")
    kind = _kind(typing.get_type_hints(typing.get_type_hints(command)[group] if group else command)[name])
    if default == "repeatable":
        kind, default = f"{kind.removeprefix('several: ')}, can be given again", ""
    # What is unset says in words what it means; a flag is off.
    shown = "" if default in ("None", "False") and not (kind == "flag" and default == "True") else default
    names = tuple(action.option_strings) or (f"{action.metavar}",)
    return Option(names, kind, shown, told.strip(), _owner(command, action.dest))


@cache
def command(name: str) -> Command:
    """Return a command as its parser has it."""
    options = options_of(name)
    about = inspect.getdoc(options) or ""
    with warnings.catch_warnings():
        # tyro says that it would rather be asked for its own help; it has no other way to the arguments.
        warnings.simplefilter("ignore", DeprecationWarning)
        parser = tyro.extras.get_parser(
            options, description=about, config=(tyro.conf.PositionalMetavarFromFieldName, tyro.conf.DisallowNone)
        )
    actions = [_option(options, a) for a in parser._actions if "--help" not in a.option_strings]
    said = next((" ".join(words) for words, own in OPTIONS.items() if own == name), name)
    arguments = tuple(a for a in actions if not a.names[0].startswith("-"))
    return Command(said, about, arguments, tuple(a for a in actions if a not in arguments))


def commands() -> dict[str, list[Command]]:
    """Return all commands by group, as `spatialviz --help` groups them, each before those that are its options."""
    found: dict[str, list[Command]] = {}
    for group, names in GROUPS.items():
        found[group] = []
        for name in names:
            forms = [form for (of, _), form in OPTIONS.items() if of == name and form in FORMS]
            found[group] += [command(name), *map(command, forms)]
    return found


@cache
def _blocks() -> tuple[tuple[str, str, str, str], ...]:
    """Return each line of shell in the documents: its page, the page's title, the heading above, the line."""
    found = []
    for file in sorted(DOCS.glob("*.md")):
        text = file.read_text(encoding="utf-8")
        title = next(iter(re.findall(r"^# (.*)$", text, re.M)), file.stem)
        heading, inside = "", False
        for line in text.replace("\\\n", " ").splitlines():
            if line.startswith("```"):
                inside = not inside and line[3:].strip() in ("sh", "bash", "shell")
            elif line.startswith("#") and not inside:
                heading = "" if line.startswith("# ") else line.lstrip("# ")
            elif inside and line.startswith("spatialviz "):
                found.append((file.name, title, heading, " ".join(line.split("  #")[0].split())))
    return tuple(found)


def examples(said: str) -> list[tuple[str, str]]:
    """Return lines of the documents that use a command, of each page one, with a link to where they stand."""
    found: dict[str, tuple[str, str]] = {}
    verb, *options = said.split()
    forms = [option for of, option in OPTIONS if of == verb]
    for page, title, heading, line in _blocks():
        words = line.split()
        if words[1] != verb or page in found or [w for w in words if w in forms] != options:
            continue
        anchor = slugify(heading, "-") if heading else ""
        found[page] = line, f"[{title}](../{page}{'#' + anchor if anchor else ''})"
    return list(found.values())[:MOST_EXAMPLES]


def _section(one: Command, shared: dict[str, str]) -> str:
    about = re.sub(r"\n(?!\n)", " ", one.about.replace("\n\n", "\n\n\n")).replace("\n ", "\n\n")
    parts = [f"### {one.said}\n", "\n\n".join(cell(p) for p in about.split("\n\n") if p.strip()) + "\n"]
    parts += [f"```text\n{one.usage}\n```\n"]
    own = [o for o in one.options if o.owner is None]
    if one.arguments or own:
        rows = [o.row for o in (*one.arguments, *own)]
        parts += [table(("name", "type", "default", "meaning"), rows)]
    if one.shared:
        parts += [f"Also: {', '.join(f'[{t}](#{shared[t]})' for t in one.shared)}.\n"]
    if used := examples(one.said):
        parts += ["For example:\n\n```sh\n" + "\n".join(line for line, _ in used) + "\n```\n"]
        parts += [f"Shown in {', '.join(link for _, link in used)}.\n"]
    return "\n".join(parts)


def page() -> str:
    """Return the page's Markdown."""
    groups = commands()
    every = [one for found in groups.values() for one in found]
    shared: dict[str, list[Option]] = {}
    for option in (o for one in every for o in one.options if o.owner is not None):
        known = shared.setdefault(shared_title(option.owner), [])
        if option not in known:
            known.append(option)
    anchors = {title: slugify(title, "-") for title in shared}
    parts = [INTRO + table(("status", "when"), ((code(f"{n}"), words) for n, words in STATUSES))]
    for group, found in groups.items():
        parts += [f"## {group.capitalize()}\n", *(_section(one, anchors) for one in found)]
    parts += ["## Options that commands share\n"]
    for title, options in shared.items():
        about = inspect.getdoc(options[-1].owner) or ""
        parts += [f"### {title}\n", f"{cell(about)}\n"]
        parts += [table(("name", "type", "default", "meaning"), (o.row for o in options))]
    return "\n".join(parts)
