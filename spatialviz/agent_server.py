"""Model Context Protocol server of the verbs (extra: mcp), over standard input and output."""

from __future__ import annotations

import inspect
import json
from typing import Any

import anyio
import numpy as np
from anyio.to_thread import run_sync
from mcp.server import Server
from mcp.server.stdio import stdio_server
from mcp.types import CallToolResult, ContentBlock, ImageContent, ListToolsResult, TextContent, Tool, ToolAnnotations

from pipeline import __version__
from pipeline.diagnosis.whatif.edits import adapter, validated
from pipeline.system.errors import needed, require
from spatialviz.agent_corrections import READING, WRITING
from spatialviz.agent_verbs import VERBS, Session, Verb
from spatialviz.options import error_line
from spatialviz.report.picture import jpeg_url

LONGEST = 100_000
"""Characters of an answer."""
WIDEST, QUALITY = 640, 80
"""Of a picture: pixels, and JPEG's quality."""
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
        description=inspect.getdoc(kind),
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
    """Picture, reduced in size."""
    return ImageContent(data=jpeg_url(rgb, WIDEST, QUALITY).partition(",")[2], mime_type="image/jpeg")
