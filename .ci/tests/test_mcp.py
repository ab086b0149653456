"""Agents, by a real client of the Model Context Protocol over standard input and output."""

from __future__ import annotations

import base64
import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from anyio.from_thread import start_blocking_portal
from mcp import Client, StdioServerParameters, stdio_client
from mcp.types import CallToolResult, ImageContent, TextContent, Tool

from pipeline.datasets.demo import demo_path, demo_run
from pipeline.labels.reading import Labels
from spatialviz.cli import main

DOCUMENT = Path(__file__).resolve().parents[2] / "docs" / "agents.md"
TEXT = "mug left of the laptop"
READING = {"contents", "ask", "why", "whatif", "failures", "query", "replay"}
WRITING = {"correct", "confirm", "undo", "redo"}


class Agent:
    """What a client makes of a server, without its event loop."""

    def __init__(self, portal: Any, client: Client) -> None:
        self._portal, self._client = portal, client

    def tools(self) -> dict[str, Tool]:
        return {tool.name: tool for tool in self._portal.call(self._client.list_tools).tools}

    def call(self, tool: str, **arguments: Any) -> CallToolResult:
        return self._portal.call(self._client.call_tool, tool, arguments)

    def ask(self, tool: str, **arguments: Any) -> dict[str, Any]:
        """The JSON of an answer that is no error."""
        answer = self.call(tool, **arguments)
        text = text_of(answer)
        assert not answer.is_error, text
        return json.loads(text)

    def at_once(self, *calls: tuple[str, dict[str, Any]]) -> list[CallToolResult]:
        """Answers of calls that do not wait for each other."""
        running = [self._portal.start_task_soon(self._client.call_tool, *call) for call in calls]
        return [one.result() for one in running]

    def refused(self, tool: str, **arguments: Any) -> str:
        """The one line of an error."""
        answer = self.call(tool, **arguments)
        assert answer.is_error
        assert len(answer.content) == 1
        text = text_of(answer)
        assert text.startswith("error: ")
        assert "\n" not in text
        assert "Traceback" not in text
        return text


def text_of(answer: CallToolResult) -> str:
    assert isinstance(answer.content[0], TextContent)
    return answer.content[0].text


def picture_of(answer: CallToolResult) -> np.ndarray:
    (found,) = (part for part in answer.content if isinstance(part, ImageContent))
    assert found.mime_type == "image/jpeg"
    return cv2.imdecode(np.frombuffer(base64.b64decode(found.data), np.uint8), cv2.IMREAD_COLOR)


@contextmanager
def served(*words: str | Path) -> Iterator[Agent]:
    server = StdioServerParameters(
        command=sys.executable, args=["-m", "spatialviz", "mcp", *map(str, words)], env=dict(os.environ)
    )
    with (
        start_blocking_portal() as portal,
        portal.wrap_async_context_manager(Client(stdio_client(server))) as client,
    ):
        yield Agent(portal, client)


@pytest.fixture(scope="module")
def cases(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("kept")
    for name, text in (("left", TEXT), ("right", "mug right of the laptop")):
        assert main(["save-case", "demo", "0", text, "--out", str(folder / name)]) == 0
    file = folder / "right" / "spatialviz-case.json"
    file.write_text(file.read_text().replace('"verdict": "CORRECT"', '"verdict": "SRM"'))
    return folder


@pytest.fixture(scope="module")
def agent(cases: Path) -> Iterator[Agent]:
    (block,) = re.findall(r"```json\n(.*?)```", DOCUMENT.read_text(), re.DOTALL)
    told = json.loads(block)["mcpServers"]["spatialviz"]
    assert (told["command"], told["args"][0]) == ("spatialviz", "mcp")
    with served(*told["args"][1:], cases) as found:
        yield found


@pytest.fixture
def printed(capsys: pytest.CaptureFixture[str]) -> Callable[..., list[dict[str, Any]]]:
    """What a command prints with --json."""

    def run(*words: str | Path) -> list[dict[str, Any]]:
        capsys.readouterr()
        assert main([*map(str, words), "--json"]) in (0, 1)
        return [json.loads(line) for line in capsys.readouterr().out.splitlines()]

    return run


def without_times(record: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in record.items() if key != "timings_ms"}


def test_the_document_names_the_tools_and_their_arguments(agent: Agent) -> None:
    rows = dict(re.findall(r"^\| `(\w+)` \| ([^|]+) \|", DOCUMENT.read_text(), re.MULTILINE))
    tools = agent.tools()
    assert rows.keys() == tools.keys()
    for name, takes in rows.items():
        named = set(re.findall(r"`(\w+)`", takes))
        assert named <= tools[name].input_schema["properties"].keys()
        assert set(tools[name].input_schema.get("required", ())) <= named


def test_tools_are_those_of_what_was_named_and_say_what_there_is(agent: Agent) -> None:
    tools = agent.tools()
    assert tools.keys() == READING
    assert all(tool.annotations is not None and tool.annotations.read_only_hint for tool in tools.values())
    assert tools["ask"].input_schema["properties"]["source"]["enum"] == ["demo", "demo-run"]
    assert tools["query"].input_schema["properties"]["run"]["enum"] == ["demo-run"]
    assert all(tool.description and tool.input_schema["type"] == "object" for tool in tools.values())
    there = agent.ask("contents")
    assert [one["name"] for one in there["datasets"]] == ["demo"]
    assert there["datasets"][0]["frames"] == 12
    assert there["runs"][0]["expressions"] == 1800
    assert there["cases"][0]["cases"] == 2
    assert there["writes"] is False
    assert agent.ask("contents", source="demo", limit=2, offset=3)["frames"] == ["000002/000000", "000002/000001"]


def test_an_answer_is_that_of_the_command_line_with_a_picture(agent: Agent, printed: Callable[..., Any]) -> None:
    (expected,) = printed("ask", "demo", "0", TEXT)
    answer = agent.call("ask", frame=0, expression=TEXT)
    assert without_times(json.loads(text_of(answer))) == without_times(expected)
    picture = picture_of(answer)
    assert picture.shape[1] == 640
    assert picture.std() > 20
    assert len(agent.call("ask", frame=0, expression=TEXT, picture=False).content) == 1
    (simulated,) = printed(
        "ask",
        "demo",
        "0",
        TEXT,
        "--labels",
        demo_run().parent / "labels",
        "--detector",
        "simulated",
        "--model",
        demo_run().parent / "simulated.toml",
    )
    of_run = agent.ask("ask", frame=0, expression=TEXT, source="demo-run", limit=1000)
    assert without_times(of_run) == without_times(simulated)


def test_calls_at_once_have_each_its_own_answer(agent: Agent) -> None:
    asked = [(frame, source) for frame in range(5) for source in ("demo", "demo-run")]
    answers = agent.at_once(
        *(("ask", {"frame": k, "expression": TEXT, "source": s, "picture": False}) for k, s in asked)
    )
    alone = [agent.ask("ask", frame=k, expression=TEXT, source=s, picture=False) for k, s in asked]
    assert [without_times(json.loads(text_of(one))) for one in answers] == [without_times(one) for one in alone]


def test_why_is_the_verdict_of_the_answer_and_of_a_runs_expression(agent: Agent) -> None:
    asked, told = agent.ask("ask", frame=0, expression=TEXT), agent.ask("why", frame=0, expression=TEXT)
    assert told["verdict"] == asked["verdict"]
    assert told["why"] == asked["verdict"]["said"]
    assert told["holds"]
    rows = agent.ask("query", sql="SELECT id, verdict, said FROM records WHERE verdict <> 'CORRECT' ORDER BY margin")
    assert len(rows["rows"]) > 20
    for row in rows["rows"][::12]:
        again = agent.ask("why", id=row["id"], picture=False)
        assert (again["verdict"]["verdict"], again["why"]) == (row["verdict"], row["said"])


def test_whatif_is_that_of_the_command_line(agent: Agent, printed: Callable[..., Any], tmp_path: Path) -> None:
    (tmp_path / "edits.json").write_text('{"hidden": ["#3"]}')
    (expected,) = printed("whatif", "demo", "0", TEXT, "--edits", tmp_path / "edits.json")
    told = agent.call("whatif", frame="0", expression=TEXT, edits={"hidden": ["#3"]})
    assert without_times(json.loads(text_of(told))) == without_times(expected)
    assert picture_of(told).shape[1] == 640


def test_failures_queries_and_replays_are_those_of_the_command_line(
    agent: Agent, printed: Callable[..., Any], cases: Path
) -> None:
    search = "verdict:OPM-CONF sort:margin"
    (expected,) = printed("failures", demo_run(), search, "--limit", "6", "--slices", "relation")
    parts = ["summary", "slices", "facets"]
    found = agent.ask("failures", search=search, limit=6, slices="relation", parts=parts)
    assert found.pop("left_out") == f"{expected['found'] - 6} more: a larger limit gives them, or query"
    assert found == expected
    classes = agent.ask("failures", slices="class", limit=2, parts=["slices"])["slices"]["class"]
    assert len(classes["slices"]) == 2
    assert classes["left_out"]["slices"].endswith(" more")
    # The figures of what was found come with the summary.
    assert set(expected) - set(agent.ask("failures", search=search)) == {*parts, "of_found"}
    sql = "SELECT verdict, count(*) AS n, avg(margin) FROM records GROUP BY 1 ORDER BY 2, 1"
    assert agent.ask("query", sql=sql)["rows"] == printed("query", demo_run(), sql)
    *results, totals = printed("replay", cases)
    replayed = agent.ask("replay")
    assert sorted(replayed["results"], key=lambda one: one["case"]) == results
    assert [one["status"] for one in replayed["results"]] == ["changed", "same"]
    assert {key: replayed[key] for key in ("cases", "same", "changed")} == {"cases": 2, "same": 1, "changed": 1}
    assert totals["changed"] == 1


def test_long_answers_are_cut_and_say_how_to_get_the_rest(agent: Agent) -> None:
    sql, rows, offset = "SELECT id FROM records ORDER BY id", [], 0
    while True:
        page = agent.ask("query", sql=sql, limit=700, offset=offset)
        rows += [row["id"] for row in page["rows"]]
        if "left_out" not in page:
            break
        assert f"offset={offset + 700}" in page["left_out"]
        offset += 700
    assert len(rows) == 1800
    assert rows == sorted(rows)
    short = agent.ask("ask", frame=0, expression="book near the mug", limit=1, picture=False)
    assert len(short["pairs"]) == 1 == len(short["relations"])
    assert short["left_out"]["pairs"].endswith(" more")
    most = int(short["left_out"]["how"].removeprefix("limit=").split()[0])
    whole = agent.ask("ask", frame=0, expression="book near the mug", limit=most, picture=False)
    assert len(whole["pairs"]) == most
    assert "left_out" not in whole
    assert "the answer is too long" in agent.refused("query", sql="SELECT repeat('x', 200000) FROM range(3)")
    assert "expected at most 1000" in agent.refused("query", sql=sql, limit=1001)


@pytest.mark.parametrize(
    ("tool", "arguments", "words"),
    [
        ("ask", {"frame": 99, "expression": TEXT}, "no frame '99' among 12"),
        ("ask", {"frame": 0, "expression": "zebra left of the laptop"}, "zebra"),
        ("ask", {"frame": 0, "expression": "???"}, "???"),
        ("ask", {"frame": 0}, "expression cannot be this; got nothing; expected a value"),
        ("ask", {"frame": 0, "expression": TEXT, "model": "x.onnx"}, "model cannot be this; got a field of an"),
        ("ask", {"frame": 0, "expression": TEXT, "source": "/etc"}, "expected demo or demo-run"),
        ("why", {"id": "nothing"}, "the run has no such expression"),
        ("why", {"frame": 0}, "frame and expression go together"),
        (
            "whatif",
            {"frame": 0, "expression": TEXT, "edits": {"hidden": ["#99"]}},
            "edits of objects that are not there",
        ),
        ("whatif", {"frame": 0, "expression": TEXT, "edits": {"scorer": "/etc/passwd"}}, "by its path"),
        ("failures", {"search": "verdikt:SRM"}, "verdikt"),
        ("failures", {"compare": str(demo_run())}, "there is no run of this name"),
        ("query", {"sql": "DROP TABLE records"}, "a run is only read"),
        ("query", {"sql": "SELECT * FROM read_csv('/etc/passwd')"}, "disabled by configuration"),
        ("query", {"sql": "COPY (SELECT 1) TO 'x.csv'"}, "a run is only read"),
        ("replay", {"srm": "/etc/passwd"}, "'trained' or 'rule'"),
        ("replay", {"cases": "/tmp"}, "there is no case of this name"),
        ("correct", {"edits": []}, "there is no such tool"),
        ("nothing", {}, "there is no such tool"),
    ],
)
def test_what_cannot_be_done_is_one_line(agent: Agent, tool: str, arguments: dict[str, Any], words: str) -> None:
    assert words in agent.refused(tool, **arguments)


def test_what_was_opened_stays_open(tmp_path: Path) -> None:
    """The files may go away: a run's rows, a frame that was asked."""
    shutil.copytree(demo_run().parent, tmp_path / "kept")
    shutil.copytree(demo_path(), tmp_path / "rooms")
    with served(tmp_path / "rooms", tmp_path / "kept" / "run") as agent:
        counted = agent.ask("query", sql="SELECT count(*) AS n FROM records")
        assert agent.ask("failures")["found"] > 0
        first = agent.ask("ask", frame=0, expression=TEXT)
        shutil.rmtree(tmp_path / "kept")
        shutil.rmtree(tmp_path / "rooms")
        assert (
            agent.ask("query", sql="SELECT count(*) AS n FROM records")
            == counted
            == {"columns": ["n"], "rows": [{"n": 1800}]}
        )
        assert agent.ask("failures", limit=1)["found"] > 0
        assert without_times(agent.ask("ask", frame=0, expression=TEXT)) == without_times(first)
        assert "error: " in agent.refused("ask", frame=1, expression=TEXT)


def test_corrections_are_by_the_author_that_was_named(
    demo_labels: Labels, tmp_path: Path, printed: Callable[..., Any]
) -> None:
    labels = tmp_path / "labels"
    shutil.copytree(demo_labels.root, labels)
    frame = demo_labels.frames.column("frame")[0].as_py()
    with served("demo", "--labels", labels, "--allow-corrections", "--author", "agent-7") as agent:
        tools = agent.tools()
        assert tools.keys() == READING - {"failures", "query", "replay"} | WRITING | {"show", "journal"}
        writing = {name for name, tool in tools.items() if tool.annotations and not tool.annotations.read_only_hint}
        assert writing == WRITING
        (shown,) = agent.ask("show", frame=frame, object=2)["entries"]
        assert shown["label"] == "laptop"
        edit = {"edit": "class", "frame": frame, "object": 2, "to": "notebook", "reason": "it folds"}
        assert "expected one of 'class'" in agent.refused("correct", edits=[{"edit": "clas"}])
        assert "author cannot be this; got a field of" in agent.refused("correct", edits=[edit], author="ann")
        (saved,) = agent.ask("correct", edits=[edit])["saved"]
        assert (saved["author"], saved["after"], saved["reason"]) == ("agent-7", "notebook", "it folds")
        assert agent.ask("show", frame=frame, object=2)["entries"][0]["label"] == "notebook"
        assert agent.ask("undo")["saved"][0]["after"] == "laptop"
        assert agent.ask("redo")["saved"][0]["after"] == "notebook"
        (tmp_path / "ann.json").write_text(json.dumps([{**edit, "to": "computer"}]))
        conflicts = printed("correct", labels, "--edits", tmp_path / "ann.json", "--author", "ann")[0]["conflicts"]
        assert "agent-7" in conflicts[0]["message"]
        assert agent.ask("journal")["entries"] == printed("journal", labels)
        confirmed = agent.ask("confirm", frame=frame, expression="mug left of the laptop")
        assert {event["author"] for event in confirmed["saved"]} == {"agent-7"}
        assert confirmed["verdict"] == "CORRECT"


def test_nothing_is_written_where_corrections_are_not_allowed(cases: Path, agent: Agent) -> None:
    def state() -> dict[Path, tuple[int, int]]:
        files = (p for root in (cases, demo_path(), demo_run()) for p in root.rglob("*") if p.is_file())
        return {p: (p.stat().st_size, p.stat().st_mtime_ns) for p in files}

    before = state()
    agent.ask("ask", frame=2, expression=TEXT)
    agent.ask("whatif", frame=2, expression=TEXT, edits={"k": 1})
    agent.ask("replay", srm="rule")
    agent.ask("failures", parts=["summary", "slices", "facets"])
    assert state() == before


def test_an_earlier_client_is_answered_in_plain_lines_and_the_end_of_input_ends_it() -> None:
    """JSON-RPC by hand, of the protocol of 2025: each line of the output is a message."""
    said = {
        "protocolVersion": "2025-06-18",
        "capabilities": {},
        "clientInfo": {"name": "hand", "version": "1"},
    }
    messages = [
        {"id": 1, "method": "initialize", "params": said},
        {"method": "notifications/initialized"},
        {"id": 2, "method": "tools/call", "params": {"name": "ask", "arguments": {"frame": 0, "expression": TEXT}}},
        {"id": 3, "method": "tools/call", "params": {"name": "ask", "arguments": {"frame": -1, "expression": TEXT}}},
    ]
    command = [sys.executable, "-m", "spatialviz", "mcp", "demo"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as server:
        assert server.stdin
        assert server.stdout
        assert server.stderr
        answers: dict[int, Any] = {}
        for message in messages:
            server.stdin.write(json.dumps({"jsonrpc": "2.0", **message}).encode() + b"\n")
            server.stdin.flush()
            if "id" in message:
                answers[message["id"]] = json.loads(server.stdout.readline())["result"]
        server.stdin.close()
        assert server.stdout.read() == b""
        assert b"Traceback" not in server.stderr.read()
        assert server.wait(20) == 0
    assert answers[1]["protocolVersion"] == "2025-06-18"
    assert "spatialviz" in answers[1]["instructions"]
    assert json.loads(answers[2]["content"][0]["text"])["answer"]["target"]["label"] == "mug"
    assert answers[3]["isError"]
    assert answers[3]["content"][0]["text"].startswith("error: no frame '-1'")


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ([], "nothing was named to be served"),
        (["nowhere"], "there is no such dataset"),
        (["demo", "--allow-corrections"], "--allow-corrections and --author go together"),
        (["demo", "--allow-corrections", "--author", "ann"], "needs labels to correct"),
    ],
)
def test_a_server_that_cannot_start_says_so_in_one_line(
    words: list[str], told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["mcp", *words]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("spatialviz: error: ")
    assert told in line
