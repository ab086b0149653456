"""Correction verbs for agents: the commands of the same names, by the named author."""

from __future__ import annotations

import json
from collections.abc import Callable
from contextlib import redirect_stdout
from dataclasses import dataclass, fields
from io import StringIO
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from pipeline.corrections.journal.batch import actions_of
from pipeline.system.errors import needed
from spatialviz import cli_labels
from spatialviz.agent_verbs import Correcting, FrameOf, Limit, Reply, Session, Verb, Words, cut
from spatialviz.options import CameraOptions, DatasetOptions
from spatialviz.run_corrections import apply_edits, run_confirm, run_journal, run_redo, run_show, run_undo

Group = Annotated[str | None, Field(description="The group of that action, and not the newest.")]


def allowed(session: Session) -> tuple[Correcting, dict[str, Any]]:
    """Author and labels of corrections, with the options of every command on a journal."""
    found = needed(session.correcting, "nothing may be written here", expected="spatialviz mcp --allow-corrections")
    return found, {"labels": found.labels, "journal": found.journal, "json": True}


def pictures(found: Correcting) -> DatasetOptions:
    """Dataset of the pictures."""
    return DatasetOptions(
        dataset=found.dataset, **{f.name: getattr(found.source, f.name) for f in fields(CameraOptions)}
    )


def printed(run: Callable[[Any], object], command: object, limit: int | None = None) -> Reply:
    """Reply from a command's --json output: its object, or with a limit its objects as "entries"."""
    # Calls are answered one at a time, and the transport writes to a stream of its own.
    with redirect_stdout(StringIO()) as out:
        run(command)
    records = [json.loads(line) for line in out.getvalue().splitlines()]
    return Reply(records[0]) if limit is None else Reply(cut({"entries": records}, limit, "entries"))


@dataclass(frozen=True)
class ShowVerb(Verb):
    """Show the labels of a frame's objects, of one object or of a pair, field by field, each with its maker."""

    frame: FrameOf
    object: Annotated[int | None, Field(description="Only this object, by its number.")] = None
    pair: Annotated[str | None, Field(description='"A,B": every relation of "A RELATION B".')] = None
    limit: Limit = 30

    def reply(self, session: Session) -> Reply:
        found, options = allowed(session)
        frame = str(self.frame)
        command = cli_labels.ShowCommand(
            **options, frame=frame, object=self.object, pair=self.pair, source=pictures(found)
        )
        return printed(run_show, command, self.limit)


@dataclass(frozen=True)
class JournalVerb(Verb):
    """List corrections, with author, time and reason."""

    last: Annotated[int, Field(ge=1, le=1000, description="So many of the newest.")] = 20

    def reply(self, session: Session) -> Reply:
        return printed(run_journal, cli_labels.JournalCommand(**allowed(session)[1], last=self.last), self.last)


@dataclass(frozen=True)
class CorrectVerb(Verb):
    """Apply edits to the labels, all or none. After somebody else's change of the same value nothing is saved, and
    "conflicts" names the author."""

    edits: Annotated[
        list[dict[str, Any]],
        Field(
            min_length=1,
            description='Such as {"edit": "relation", "frame": "000001/000000", "a": 2, "b": 5, "relation": "left", '
            '"to": "T", "reason": "..."} or {"edit": "class", "frame": ..., "object": 2, "to": "notebook"}; edits are '
            "those of `spatialviz correct --help`.",
        ),
    ]

    def reply(self, session: Session) -> Reply:
        found, options = allowed(session)
        # Opens no file: the edits are here.
        command = cli_labels.CorrectCommand(**options, edits=Path(), author=found.author, source=pictures(found))
        actions = actions_of(self.edits)
        return printed(lambda command: apply_edits(command, actions), command)


@dataclass(frozen=True)
class ConfirmVerb(Verb):
    """Ask, and confirm a pair of the answer as right: from then on answers are judged by the pair."""

    frame: FrameOf
    expression: Words
    pair: Annotated[int, Field(ge=1, description="Which of the ranked pairs.")] = 1

    def reply(self, session: Session) -> Reply:
        found, options = allowed(session)
        of = {"dataset": found.dataset, "frame": str(self.frame), "expression": self.expression, "pair": self.pair}
        return printed(
            run_confirm, cli_labels.ConfirmCommand(**options, **of, author=found.author, source=found.source)
        )


@dataclass(frozen=True)
class UndoVerb(Verb):
    """Take back this author's newest action, or the one of a group."""

    group: Group = None

    def reply(self, session: Session) -> Reply:
        found, options = allowed(session)
        return printed(run_undo, cli_labels.UndoCommand(**options, author=found.author, group=self.group))


@dataclass(frozen=True)
class RedoVerb(Verb):
    """Bring back the action last taken back by this author."""

    group: Group = None

    def reply(self, session: Session) -> Reply:
        found, options = allowed(session)
        return printed(run_redo, cli_labels.RedoCommand(**options, author=found.author, group=self.group))


READING: dict[str, type[Verb]] = {"show": ShowVerb, "journal": JournalVerb}
WRITING: dict[str, type[Verb]] = {"correct": CorrectVerb, "confirm": ConfirmVerb, "undo": UndoVerb, "redo": RedoVerb}
