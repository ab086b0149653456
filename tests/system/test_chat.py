"""The vision-language baseline against a local server that speaks the real protocol, well and badly."""

from __future__ import annotations

import _thread
import gc
import json
import signal
import socket
import sys
import threading
import traceback
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from chat_server import MODELS, ChatServer, Clock, CutOff, Make, Raw, Script, Slow, Trickle, completion, error, flat
from waiting import LONG_S

from pipeline.system import ChatClient, ChatPicture, ChatQuestion, InputError, MissingExtra, ServerError
from pipeline.system.chat import KEY_VARIABLE


def test_a_question_is_sent_as_the_protocol_has_it(server: ChatServer, client_of: Make) -> None:
    rgb = np.zeros((48, 64, 3), np.uint8)
    rgb[:, :32, 0], rgb[:, 32:, 2] = 250, 250
    question = ChatQuestion("Is it “blau”? 猫 🐱", ChatPicture(rgb), max_tokens=9)
    (answer,) = client_of(api_key="secret", extra={"seed": 3}).ask_many([question])
    (request,) = server.requests
    assert (answer.text, answer.finish, answer.cached) == ("Yes", "stop", False)
    assert request.prompt == "Is it “blau”? 猫 🐱"
    body = {k: v for k, v in request.body.items() if k != "messages"}
    assert body == {
        "model": MODELS[0],
        "max_tokens": 9,
        "temperature": 0.0,
        "seed": 3,
        "stream": False,
    }
    assert request.headers["authorization"] == "Bearer secret"
    assert request.picture.shape == rgb.shape
    # Red stays left and blue right: neither the channels nor the sides are swapped.
    assert np.abs(request.picture.astype(int) - rgb)[:, [4, 60]].max() < 12


def test_extra_keys_replace_and_take_away(server: ChatServer, client_of: Make) -> None:
    client_of(extra={"seed": None, "temperature": 0.5}).ask("q", flat())
    assert "seed" not in server.requests[0].body
    assert server.requests[0].body["temperature"] == 0.5


@pytest.mark.parametrize(
    ("reply", "text"),
    [
        (completion("Да — 是 ✓"), "Да — 是 ✓"),
        (completion(None), ""),
        ({"choices": [{"message": {"content": [{"type": "text", "text": "Yes"}]}}]}, "Yes"),
        (Raw(200, b"\xef\xbb\xbf" + json.dumps(completion("No")).encode()), "No"),
        (completion("No") | {"error": None}, "No"),
    ],
)
def test_replies_of_many_servers_are_read(server: ChatServer, client_of: Make, reply: Script, text: str) -> None:
    server.script = [reply]
    assert client_of().ask("q", flat()).text == text


RATE_LIMITED = error(429, "Rate limit reached", headers={"Retry-After": "7"})


@pytest.mark.parametrize(
    ("troubles", "waits"),
    [
        ([RATE_LIMITED], [7.0]),
        ([error(429, "slow down")], [0.5]),
        ([error(500, "oops"), error(503, "loading model"), error(502, "gateway")], [0.5, 1.0, 2.0]),
        ([error(503, "busy", headers={"Retry-After": "3"}), error(500, "oops")], [3.0, 1.0]),
        ([CutOff()], [0.5]),
        ([CutOff(b'{"choices": [')], [0.5]),
        ([CutOff(json.dumps(completion("Yes")).encode())], [0.5]),
        ([Raw(200, b'{"choices": [{"mess')], [0.5]),
        ([completion("x") | {"choices": []}], [0.5]),
        ([{"choices": [{"text": "no message"}]}], [0.5]),
        ([{"error": {"message": "Provider returned error", "code": 502}}], [0.5]),
    ],
)
def test_passing_troubles_are_waited_out(
    server: ChatServer, client_of: Make, clock: Clock, troubles: list[Script], waits: list[float]
) -> None:
    server.script = [*troubles, "No"]
    client = client_of()
    assert client.ask("q", flat()).text == "No"
    assert len(clock.slept) == len(waits)
    # The library shortens its own waits by chance, by a quarter at most.
    assert all(0.75 * most <= slept <= most for slept, most in zip(clock.slept, waits, strict=True))
    assert client.requests == len(troubles) + 1
    assert len({json.dumps(r.body) for r in server.requests}) == 1


def test_a_slow_answer_is_given_up_and_asked_for_again(server: ChatServer, client_of: Make) -> None:
    server.script = [Slow(), Trickle(), "Yes"]
    # Long enough for a loaded machine to give the answer that comes.
    assert client_of(timeout_s=1.0).ask("q", flat()).text == "Yes"
    server.script = [Slow()]
    with pytest.raises(ServerError, match=r"no whole reply within 0\.2 s .*longer timeout") as caught:
        client_of(timeout_s=0.2, retries=0).ask("another", flat())
    assert caught.value.status is None
    assert not caught.value.everywhere


def test_tries_end_and_the_error_says_where_and_what(server: ChatServer, client_of: Make, clock: Clock) -> None:
    server.answer = lambda _: Raw(500, b"\n  CUDA out of memory\nTraceback ...\n")
    with pytest.raises(ServerError) as caught:
        client_of(retries=2).ask("q", flat())
    assert f"{server.url}/chat/completions" in str(caught.value)
    assert "500 Internal Server Error, 3 times; got 'CUDA out of memory'" in str(caught.value)
    assert "\n" not in str(caught.value)
    assert (caught.value.status, len(server.requests), len(clock.slept)) == (500, 3, 2)


@pytest.mark.parametrize(
    ("trouble", "said"),
    [
        (error(400, "This model does not support images"), "400 Bad Request; got 'This model does not support images'"),
        (Raw(400, b'{"error": "Only stream=true is supported"}'), "got 'Only stream=true is supported'"),
        (error(429, "You exceeded your quota", type="insufficient_quota"), "exceeded your quota"),
        (error(429, "later", headers={"Retry-After": "3600"}), "it asks to wait 3600 s"),
        (Raw(200, b"<html><title>Open WebUI</title></html>", {"Content-Type": "text/html"}), "end in /v1?"),
        (Raw(200, b'data: {"choices": []}\n\n', {"Content-Type": "text/event-stream"}), "does not honour stream=false"),
        (Raw(200, b"[]"), "no JSON object"),
        (Raw(307, b"", {"Location": "https://elsewhere.example/v1"}), "redirects to https://elsewhere.example/v1"),
        (Raw(302, b"", {"Location": "https://elsewhere.example/v1"}), "redirects to https://elsewhere.example/v1"),
        (Raw(499, b""), "499 unknown status"),
    ],
)
def test_lasting_troubles_are_told_at_once(
    server: ChatServer, client_of: Make, clock: Clock, trouble: Raw, said: str
) -> None:
    server.script = [trouble]
    with pytest.raises(ServerError) as caught:
        client_of().ask("q", flat())
    assert said in str(caught.value)
    assert len(server.requests) == 1
    assert clock.slept == []


def test_a_wrong_key_a_wrong_model_and_a_wrong_address(
    server: ChatServer, client_of: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    server.key = "right"
    with pytest.raises(ServerError, match=f"401 Unauthorized.*no API key was given: set {KEY_VARIABLE}"):
        client_of().ask("q", flat())
    with pytest.raises(ServerError, match="is the API key the right one"):
        client_of(api_key="wrong").ask("q", flat())
    monkeypatch.setenv(KEY_VARIABLE, "right")
    assert client_of().ask("q", flat()).text == "Yes"
    assert len(server.requests) == 3
    with pytest.raises(ServerError, match=r"404 Not Found; got '.*lava.*'$"):
        client_of(model="lava").ask("q", flat())
    with pytest.raises(ServerError, match=r"404 Not Found.*does the base address end in /v1"):
        client_of(base_url=server.url.removesuffix("/v1")).ask("another", flat())


def test_a_key_is_never_said(server: ChatServer, client_of: Make, tmp_path: Path) -> None:
    client = client_of(api_key="sk-verysecret")
    server.script = [error(401, "bad key sk-verysecret"), "Yes"]
    with pytest.raises(ServerError, match=r"bad key \*\*\*") as caught:
        client.ask("q", flat())
    assert "verysecret" not in "".join(traceback.format_exception(caught.value))
    client.ask("q", flat())
    kept = "".join(path.read_text() for path in tmp_path.rglob("*.json"))
    assert kept
    assert "verysecret" not in str(caught.value) + repr(client) + kept


def test_nobody_listens(client_of: Make, clock: Clock) -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    with pytest.raises(ServerError, match=r"no server listens there, 2 times \(is it running") as caught:
        client_of(base_url=f"http://127.0.0.1:{port}/v1", retries=1).ask("q", flat())
    assert caught.value.everywhere
    assert len(clock.slept) == 1


def test_a_proxy_does_not_stand_before_this_machine(
    server: ChatServer, client_of: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("http_proxy", "http://127.0.0.1:9")
    monkeypatch.delenv("no_proxy", raising=False)
    assert client_of().ask("q", flat()).text == "Yes"
    assert len(server.requests) == 1


def test_the_cache_answers_the_second_time(server: ChatServer, client_of: Make, tmp_path: Path) -> None:
    server.answer = lambda _: completion("Yes", finish="length")
    first, again = client_of(), client_of()
    asked = first.ask("größer?", flat())
    known = again.ask("größer?", flat())
    assert len(server.requests) == 1
    assert asked.text == "Yes"
    assert (known.text, known.finish, known.cached, again.requests) == ("Yes", "length", True, 0)
    changes: list[dict[str, Any]] = [
        {"model": MODELS[1]},
        {"extra": {"temperature": 0.1}},
        {"extra": {"seed": 1}},
        {"max_tokens": 5},
        {"extra": {"stream": None}},
    ]
    for change in changes:
        assert not client_of(**change).ask("größer?", flat()).cached
    for rgb in (flat(91), flat(90, 32, 24)):
        assert not again.ask("größer?", rgb).cached
    assert not again.ask("größer", flat()).cached
    assert len(server.requests) == 1 + len(changes) + 3
    for path in tmp_path.rglob("*.json"):
        path.write_bytes(path.read_bytes()[:-20])
    assert not again.ask("größer?", flat()).cached
    assert again.ask("größer?", flat()).cached
    assert not list(tmp_path.rglob("*.tmp"))


def test_no_cache_and_a_cache_that_cannot_be_written(server: ChatServer, client_of: Make, tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.write_text("in the way")
    for cache in (False, file):
        client = client_of(cache=cache)
        assert [client.ask("q", flat()).cached for _ in range(2)] == [False, False]
    assert len(server.requests) == 4


def test_the_usual_cache_is_the_users(
    server: ChatServer, client_of: Make, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SPATIALVIZ_CACHE", str(tmp_path / "mine"))
    client_of(cache=True).ask("q", flat())
    assert len(list((tmp_path / "mine" / "vlm").rglob("*.json"))) == 1


def test_no_minute_sees_more_requests_than_allowed(server: ChatServer, client_of: Make, clock: Clock) -> None:
    server.script = ["Yes", error(500, "oops")]
    client = client_of(requests_per_minute=30)
    client.ask_many([ChatQuestion(str(n), ChatPicture(flat())) for n in range(40)], workers=1)
    times = np.array([r.at for r in server.requests])
    assert len(times) == 41
    assert max(int(((times >= t - 1e-6) & (times < t + 60 - 1e-6)).sum()) for t in times) == 30
    assert clock.now - 1000 == pytest.approx(80)
    # What is known needs no turn.
    before = clock.now
    client.ask("3", flat())
    assert clock.now == before


def test_the_wait_that_a_server_asks_for_holds_for_all_workers(
    server: ChatServer, client_of: Make, clock: Clock
) -> None:
    server.script = [RATE_LIMITED]
    client_of().ask_many([ChatQuestion(str(n), ChatPicture(flat())) for n in range(6)], workers=1)
    assert [r.at for r in server.requests] == [1000.0] + [1007.0] * 6


def test_many_answers_come_in_order(server: ChatServer, client_of: Make) -> None:
    server.answer = lambda request: request.prompt[::-1]
    asked = [f"question {n}" for n in range(30)]
    client = client_of()
    answers = client.ask_many((ChatQuestion(q, ChatPicture(flat())) for q in asked), workers=5)
    assert [a.text for a in answers] == [q[::-1] for q in asked]
    assert client.requests == 30
    assert client.ask_many([]) == []


def test_workers_are_bounded_and_do_work_at_once(server: ChatServer, client_of: Make) -> None:
    server.gate = threading.Event()
    together = threading.Event()

    def answer(_: Any) -> Script:
        if len(server.requests) == 3:
            together.set()
        return "Yes"

    server.answer = answer
    done: list[Any] = []
    client = client_of()
    questions = [ChatQuestion(str(n), ChatPicture(flat())) for n in range(9)]
    thread = threading.Thread(target=lambda: done.extend(client.ask_many(questions, workers=3)))
    thread.start()
    assert together.wait(LONG_S)
    assert len(server.requests) == 3
    server.gate.set()
    thread.join(LONG_S)
    assert len(done) == 9


def test_a_question_that_fails_leaves_its_own_answer_empty(server: ChatServer, client_of: Make) -> None:
    questions = [ChatQuestion(str(n), ChatPicture(flat())) for n in range(6)]
    server.answer = lambda request: error(400, "refused") if request.prompt == "3" else "Yes"
    client = client_of()
    kept = client.ask_many(questions, workers=1)
    assert [a.failure is None for a in kept] == [True] * 3 + [False] + [True] * 2
    assert "refused" in str(kept[3].failure)
    server.answer = lambda _: "No"
    again = client.ask_many(questions)
    assert [a.text for a in again] == ["Yes"] * 3 + ["No"] + ["Yes"] * 2
    assert [a.cached for a in again] == [True] * 3 + [False] + [True] * 2


def test_an_error_of_every_question_ends_a_run_and_the_next_goes_on_from_there(
    server: ChatServer, client_of: Make
) -> None:
    questions = [ChatQuestion(str(n), ChatPicture(flat())) for n in range(6)]
    server.answer = lambda request: error(401, "no more") if request.prompt == "3" else "Yes"
    client = client_of()
    with pytest.raises(ServerError, match="401"):
        client.ask_many(questions, workers=1)
    assert len(server.requests) == 4
    server.answer = lambda _: "No"
    assert [a.text for a in client.ask_many(questions)] == ["Yes"] * 3 + ["No"] * 3


def test_an_error_in_making_a_question_ends_the_run(client_of: Make) -> None:
    def questions() -> Iterator[ChatQuestion]:
        yield ChatQuestion("first", ChatPicture(flat()))
        raise InputError("no picture")

    with pytest.raises(InputError, match="no picture"):
        client_of().ask_many(questions(), workers=3)


@pytest.fixture
def interruptible() -> Iterator[None]:
    """An interrupt comes through: a shell lets its jobs in the background ignore them, and Python drops one that comes
    in a callback of the garbage collector, as others have."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    gc.collect()
    gc.disable()
    yield
    gc.enable()
    signal.signal(signal.SIGINT, before)


def test_an_interrupt_is_heeded_while_answers_are_awaited(
    server: ChatServer, client_of: Make, interruptible: None
) -> None:
    server.gate = threading.Event()

    def answer(_: Any) -> Script:
        _thread.interrupt_main()
        return "Yes"

    server.answer = answer
    client = client_of()
    with pytest.raises(KeyboardInterrupt):
        client.ask_many((ChatQuestion(str(n), ChatPicture(flat())) for n in range(50)), workers=1)
    server.answer = lambda _: "Yes"
    server.gate.set()
    # What was under way is still kept; nothing new is begun.
    assert client.ask("fresh", flat()).text == "Yes"
    assert {r.prompt for r in server.requests} == {"0", "fresh"}


@pytest.mark.parametrize(
    "options",
    [
        {"base_url": "localhost:8000"},
        {"base_url": "ftp://host/v1"},
        {"base_url": "http://"},
        {"base_url": ""},
        {"base_url": "http://me:pw@host/v1"},
        {"base_url": "http://host/v1?x=1"},
        {"base_url": "http://h st/v1"},
        {"base_url": "http://host:99999/v1"},
        {"model": " "},
        {"api_key": "two words"},
        {"api_key": "schlüssel"},
        {"requests_per_minute": 0},
    ],
)
def test_unusable_settings_are_refused(client_of: Make, options: dict[str, Any]) -> None:
    with pytest.raises(InputError):
        client_of(**options)


def test_addresses_may_end_in_many_ways(server: ChatServer, client_of: Make) -> None:
    for ending in ("", "/", "/chat/completions", "/chat/completions/", "  "):
        assert client_of(base_url=server.url + ending).base_url == server.url


def test_without_the_library_its_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "openai", None)
    monkeypatch.delitem(sys.modules, "pipeline.system.chat_http", raising=False)
    with pytest.raises(MissingExtra, match=r"asking a-model needs .*spatialviz\[llm\]"):
        ChatClient("http://localhost:8000/v1", "a-model")
