"""Model Context Protocol server (extra: mcp) over standard input and output, with the verbs of corrections."""

from __future__ import annotations

import json
from collections.abc import Callable
from contextlib import redirect_stdout
from dataclasses import fields
from inspect import getdoc, signature
from io import StringIO
from pathlib import Path
from typing import Annotated, Any

import anyio
import numpy as np
from anyio.to_thread import run_sync
from mcp.server import Server
from mcp.server.stdio import stdio_server
from mcp.types import CallToolResult, ContentBlock, ImageContent, ListToolsResult, TextContent, Tool, ToolAnnotations
from pydantic import Field

from pipeline import __version__
from pipeline.corrections.journal.batch import actions_of
from pipeline.diagnosis.whatif.edits import adapter, validated
from pipeline.system.encoded_pictures import jpeg_url
from pipeline.system.errors import needed, require
from pipeline.system.frozen import dataclass
from spatialviz import cli_labels
from spatialviz.agent_verbs import VERBS, FrameOf, Limit, Reply, Session, Verb, Words, cut
from spatialviz.error_lines import error_line
from spatialviz.options import CameraOptions, DatasetOptions
from spatialviz.run_corrections import apply_edits, run_confirm, run_journal, run_redo, run_show, run_undo

Group = Annotated[str | None, Field(description="The group of that action, and not the newest.")]


def command_of(kind: Callable[..., Any], session: Session, **given: Any) -> Any:
    """Command of corrections by the session's author on its labels; of `given` what the command has."""
    found = needed(session.correcting, "nothing may be written here", expected="spatialviz mcp --allow-corrections")
    camera = {f.name: getattr(found.source, f.name) for f in fields(CameraOptions)}
    pictures = DatasetOptions(dataset=found.dataset, **camera)
    source = found.source if kind is cli_labels.ConfirmCommand else pictures
    known = {**vars(found), "source": source, "json": True, **given}
    return kind(**{name: known[name] for name in signature(kind).parameters if name in known})


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
        given = {**vars(self), "frame": str(self.frame)}
        return printed(run_show, command_of(cli_labels.ShowCommand, session, **given), self.limit)


@dataclass(frozen=True)
class JournalVerb(Verb):
    """List corrections, with author, time and reason."""

    last: Annotated[int, Field(ge=1, le=1000, description="So many of the newest.")] = 20

    def reply(self, session: Session) -> Reply:
        command = command_of(cli_labels.JournalCommand, session, author=None, last=self.last)
        return printed(run_journal, command, self.last)


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
        # Opens no file: the edits are here.
        command = command_of(cli_labels.CorrectCommand, session, edits=Path())
        actions = actions_of(self.edits)
        return printed(lambda command: apply_edits(command, actions), command)


@dataclass(frozen=True)
class ConfirmVerb(Verb):
    """Ask, and confirm a pair of the answer as right: from then on answers are judged by the pair."""

    frame: FrameOf
    expression: Words
    pair: Annotated[int, Field(ge=1, description="Which of the ranked pairs.")] = 1

    def reply(self, session: Session) -> Reply:
        given = {**vars(self), "frame": str(self.frame)}
        return printed(run_confirm, command_of(cli_labels.ConfirmCommand, session, **given))


@dataclass(frozen=True)
class UndoVerb(Verb):
    """Take back this author's newest action, or the one of a group."""

    group: Group = None

    def reply(self, session: Session) -> Reply:
        return printed(run_undo, command_of(cli_labels.UndoCommand, session, group=self.group))


@dataclass(frozen=True)
class RedoVerb(Verb):
    """Bring back the action last taken back by this author."""

    group: Group = None

    def reply(self, session: Session) -> Reply:
        return printed(run_redo, command_of(cli_labels.RedoCommand, session, group=self.group))


READING: dict[str, type[Verb]] = {"show": ShowVerb, "journal": JournalVerb}
WRITING: dict[str, type[Verb]] = {"correct": CorrectVerb, "confirm": ConfirmVerb, "undo": UndoVerb, "redo": RedoVerb}


LONGEST = 100_000
"""Characters of an answer."""
QUALITY = 80
"""Of a picture as JPEG."""
ABOUT = """spatialviz says why an RGB-D spatial-reasoning pipeline answered what it answered: PARSE, OPM (detection), \
LIFT (3D boxes), SRM (relations), PRM (ranking). Begin with `contents`; `failures` finds what a run got wrong, `why` \
says which module failed, `whatif` answers under edits."""


def serve(session: Session) -> None:
    """Answer until the client closes."""
    verbs = {**VERBS, **({} if session.correcting is None else {**READING, **WRITING})}
    tools = [tool for name, kind in verbs.items() if (tool := tool_of(name, kind, session)) is not None]
    one_at_a_time = anyio.CapacityLimiter(1)

    async def list_tools(context: Any, parameters: Any) -> ListToolsResult:
        return ListToolsResult(tools=tools)

    async def call_tool(context: Any, parameters: Any) -> CallToolResult:
        arguments = parameters.arguments or {}
        return await run_sync(call, session, verbs, parameters.name, arguments, limiter=one_at_a_time)

    async def run() -> None:
        server = Server(
            "spatialviz", version=__version__, instructions=ABOUT, on_list_tools=list_tools, on_call_tool=call_tool
        )
        async with stdio_server() as (read, write):
            await server.run(read, write, server.create_initialization_options())

    anyio.run(run)


def tool_of(name: str, kind: type[Verb], session: Session) -> Tool | None:
    """Tool of a verb; None where nothing named suits the verb."""
    names = {
        "source": [*session.datasets, *session.runs],
        "run": list(session.runs),
        "compare": list(session.runs),
        "cases": list(session.cases),
    }
    schema = adapter(kind).json_schema()
    for of in names.keys() & schema["properties"].keys():
        if not names[of] and name != "contents":
            return None
        argument = schema["properties"].pop(of)
        if names[of]:
            about = argument["description"]
            schema["properties"][of] = {"type": "string", "enum": names[of], "description": about}
    return Tool(
        name=name,
        description=getdoc(kind),
        input_schema={key: value for key, value in schema.items() if key not in ("title", "description")},
        annotations=ToolAnnotations(
            read_only_hint=name not in WRITING, destructive_hint=False, idempotent_hint=False, open_world_hint=False
        ),
    )


def call(session: Session, verbs: dict[str, type[Verb]], name: str, arguments: dict[str, Any]) -> CallToolResult:
    """Reply of a verb, as JSON text and pictures; or the single line of its error."""
    try:
        kind = needed(verbs.get(name), "there is no such tool", got=name, expected=", ".join(verbs))
        reply = validated(kind, arguments, name).reply(session)
        text = json.dumps(reply.record, ensure_ascii=False, allow_nan=False)
        require(
            len(text) <= LONGEST,
            "the answer is too long",
            got=f"{len(text):,} characters",
            expected=f"at most {LONGEST:,}: a smaller limit, fewer parts or columns",
        )
        content: list[ContentBlock] = [TextContent(text=text), *map(image, reply.pictures)]
        return CallToolResult(content=content)
    except Exception as error:
        return CallToolResult(content=[TextContent(text=error_line(error))], is_error=True)


def image(rgb: np.ndarray) -> ImageContent:
    """Picture as JPEG."""
    return ImageContent(data=jpeg_url(rgb, quality=QUALITY).partition(",")[2], mime_type="image/jpeg")
