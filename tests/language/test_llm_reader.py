"""A language model as the reader of sentences: the same tree, or one clear line."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from chat_server import MODELS, ChatServer, Clock, Raw, Script, Slow, error

from pipeline.answering import open_pipeline
from pipeline.diagnosis import open_case, save_case
from pipeline.diagnosis.whatif.rerun import Baseline
from pipeline.evaluation import evaluate_sentences
from pipeline.language import RELATIONS, LlmReader, parse
from pipeline.language.llm_reader import MOST_CHARACTERS, tree_schema
from pipeline.system import InputError, ServerError, Unsupported
from pipeline.system.chat import KEY_VARIABLE

NAMES = ("front_door", "mug", "laptop")
Make = Callable[..., LlmReader]


@pytest.fixture
def reader_of(server: ChatServer, clock: Clock, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Make:
    """Makes readers by that server, with a cache of their own."""
    monkeypatch.delenv(KEY_VARIABLE, raising=False)
    mine = {"cache": tmp_path / "answers", "clock": clock, "sleep": clock.sleep}
    return lambda **options: LlmReader(server.url, MODELS[0], **{**mine, **options})


def tree(text: str) -> dict[str, Any]:
    """What a model should say of a text: the grammar's tree without what follows from it."""

    def said(value: Any) -> Any:
        if isinstance(value, dict):
            return {k: said(v) for k, v in value.items() if k not in ("mention", "mapped_from", "note")}
        return [said(v) for v in value] if isinstance(value, list | tuple) else value

    return {"target": said(asdict(parse(text, class_names=NAMES).default.root))}


def told(text: str, **changes: Any) -> str:
    reply = tree(text)
    reply["target"] |= changes
    return json.dumps(reply)


def test_the_schema_is_what_strict_servers_take() -> None:
    schema = tree_schema()
    tables = [schema, *schema["$defs"].values()]
    assert schema["type"] == "object"
    assert {"Node", "Attachment", "Choice", "Attribute"} == set(schema["$defs"])
    for table in tables:
        assert table["additionalProperties"] is False
        assert table["required"] == list(table["properties"])
    assert '"default"' not in json.dumps(schema)
    assert schema["$defs"]["Attachment"]["properties"]["relation"]["enum"] == list(RELATIONS)


@pytest.mark.parametrize(
    "text",
    [
        "the red mug left of the laptop",
        "mug left of the mug",
        "the mug that is reddish",
        "could you pass me the can behind the mustard please",
        "table holding a lamp",
        "second chair from the left on the sofa",
        "the light blue cup between the front door and the lamp, not the red one",
        "big wooden box not on the table",
        "the cup nearest to me",
        "the mug with the broken handle under the table",
        "the two lamps in the bottom left corner",
    ],
)
def test_a_good_tree_is_the_grammars_own(server: ChatServer, reader_of: Make, text: str) -> None:
    server.answer = lambda _: json.dumps(tree(text))
    found, grammar = reader_of()(text, class_names=NAMES), parse(text, class_names=NAMES)
    assert found.default == grammar.default
    assert (found.reader, grammar.reader) == (f"llm {MODELS[0]}", "grammar")
    assert [text[s.start : s.end] for s in found.unused] == [text[s.start : s.end] for s in grammar.unused]
    nouns = [(s.index, text[s.start : s.end].split()[0]) for s in found.spans if s.role in ("target", "reference")]
    assert nouns == [
        (s.index, text[s.start : s.end].split()[0]) for s in grammar.spans if s.role in ("target", "reference")
    ]
    (request,) = server.requests
    assert text in request.prompt
    assert request.body["response_format"]["json_schema"]["strict"] is True


def test_what_a_tree_leaves_over_is_marked(server: ChatServer, reader_of: Make) -> None:
    server.answer = lambda _: told("the mug on the table")
    read = reader_of()
    query = read("the frobbed mug on the table by yonder window")
    assert [query.text[s.start : s.end] for s in query.unused] == ["frobbed", "yonder", "window"]
    spans = [(s.start, s.end) for s in query.spans]
    assert spans == sorted(spans)
    assert all(a[1] <= b[0] for a, b in pairwise(spans))
    with pytest.raises(Unsupported, match="another view"):
        read("the mug on the table facing the window")
    assert len(server.requests) == 1


def test_relations_are_those_on_offer(server: ChatServer, reader_of: Make) -> None:
    server.answer = lambda _: told("mug on the table")
    read = reader_of()
    assert (
        read("mug on the table", relations=("above", "left")).default
        == parse("mug on the table", relations=("above", "left")).default
    )
    with pytest.raises(Unsupported, match="not in this vocabulary"):
        read("mug on the table", relations=("left",))


WRONG = {
    "no JSON": "the mug",
    "no tree": '{"target": {"head": "mug"}}',
    "no such relation": told("mug on the table").replace('"on"', '"touching"'),
    "no name": told("mug on the table", label=" the "),
    "two references": told("mug on the table").replace('"relation": "on"', '"relation": "between"'),
    "the viewer": told("mug on the table", viewer=True),
    "rank": told("the leftmost mug").replace('"rank": 1', '"rank": 1000000000'),
    "control": told("mug on the table", label="mug\x1b[2J"),
    "deep": '{"target":' + '{"label":"mug","excluded":[' * 5000 + "]}" * 5000 + "}",
    "long": told("mug on the table", label="mug " * MOST_CHARACTERS),
}


@pytest.mark.parametrize("reply", WRONG.values(), ids=WRONG)
def test_a_reply_of_no_use_is_asked_for_once_more(server: ChatServer, reader_of: Make, reply: str) -> None:
    text, good = "the leftmost mug on the table", told("the leftmost mug on the table")
    server.script = [reply, good]
    read = reader_of()
    assert read(text).default == parse(text).default
    first, second = (r.prompt for r in server.requests)
    assert second.startswith(first)
    assert "could not be used: " in second
    # What was of no use is not kept: a server that has learnt is heard.
    server.script = [good]
    assert read(text).default == parse(text).default
    assert len(server.requests) == 3
    server.script = [reply, reply]
    with pytest.raises(InputError) as problem:
        read("the leftmost mug on the  table")
    assert "\n" not in str(problem.value)
    assert len(str(problem.value)) < 700
    assert str(problem.value).isprintable()
    assert len(server.requests) == 5


@pytest.mark.parametrize(
    ("trouble", "why"),
    [
        (error(401, "Incorrect API key provided: sk-secret"), "answered 401 Unauthorized.*right one"),
        (Slow(), "no whole reply within 0.3 s"),
        (Raw(200, b" " * (17 << 20)), "does not end"),
        (Raw(200, b"<html>"), "no JSON"),
    ],
    ids=["401", "slow", "huge", "html"],
)
def test_a_server_in_trouble_is_told_in_a_line(server: ChatServer, reader_of: Make, trouble: Script, why: str) -> None:
    server.script = [trouble] * 2
    with pytest.raises(ServerError, match=why) as problem:
        reader_of(timeout_s=0.3 if isinstance(trouble, Slow) else 20, api_key="sk-secret")("mug on the table")
    assert "sk-secret" not in str(problem.value)
    assert "\n" not in str(problem.value)


def test_a_sentence_is_asked_for_once(server: ChatServer, reader_of: Make) -> None:
    server.answer = lambda _: told("mug on the table")
    first = reader_of()("mug on the table")
    assert len(server.requests) == 1
    assert first == reader_of()("mug on the table")
    reader_of()("mug on  the table")
    LlmReader(server.url, MODELS[1], cache=False)("mug on the table")
    assert len(server.requests) == 3


def test_the_same_answer_case_and_sentences(
    server: ChatServer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SPATIALVIZ_CACHE", str(tmp_path / "cache"))
    source = open_pipeline("demo", srm="rule", reader="llm", reader_url=server.url, reader_model=MODELS[0])
    grammar = open_pipeline("demo", srm="rule")
    context = grammar.prepare(0)
    # Words that the grammar does not know, and the tree that they mean.
    text, plain = "mug thou seest leftwards of the laptop", "mug left of the laptop"
    server.answer = lambda _: told(plain)
    trace, expected = source.ask(context, text), grammar.ask(context, plain)
    assert trace.ranking is not None
    assert expected.ranking is not None
    assert trace.ranking.pairs == expected.ranking.pairs
    assert Baseline(source, context, text).outcome.trace.ranking is not None
    save_case(tmp_path / "case", source, context, text)
    lines = tmp_path / "asked.jsonl"
    lines.write_text(json.dumps({"frame": context.frame.id, "sentence": text, "targets": []}) + "\n")
    evaluate_sentences(lines, source, out=tmp_path / "out")
    assert len(server.requests) == 1
    record = json.loads((tmp_path / "out" / "sentences.jsonl").read_text())
    assert record["expression"]["reader"] == f"llm {MODELS[0]}"
    # The tree is kept in the case, and no server is needed.
    case = open_case(tmp_path / "case")
    assert case.manifest.reading is not None
    assert case.manifest.reading.reader == f"llm {MODELS[0]}"
    again = case.answer().needed_trace()
    assert again.ranking is not None
    assert again.query == trace.query
    assert case.source.read(plain) == grammar.read(plain)
    assert len(server.requests) == 1
    # A server that refuses ends it: it says nothing about the sentences.
    server.key = "another"
    lines.write_text(json.dumps({"frame": context.frame.id, "sentence": "a new one", "targets": []}) + "\n")
    with pytest.raises(ServerError, match="no API key was given: set SPATIALVIZ_VLM_KEY"):
        evaluate_sentences(lines, source)


def test_a_reader_needs_its_server() -> None:
    with pytest.raises(InputError, match="--reader-url http"):
        open_pipeline("demo", srm="rule", reader="llm")
    with pytest.raises(InputError, match="--reader-url needs --reader llm"):
        open_pipeline("demo", srm="rule", reader_url="http://localhost:1/v1")
    with pytest.raises(InputError, match="no such reader"):
        open_pipeline("demo", srm="rule", reader="oracle")  # type: ignore[arg-type]
