"""OpenAI's chat protocol: the body of a question, the reading of what servers answer, its cost, and its cache."""

from __future__ import annotations

import base64
import hashlib
import http
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any

import cv2
import numpy as np
from pydantic import Field, TypeAdapter

from pipeline.system.chat.transport import Failure, Reply, wait_asked
from pipeline.system.errors import InputError, require
from pipeline.system.safe_files import parse_json, read_json
from pipeline.system.whole_files import keep_whole

JPEG_QUALITY = 92

_VERSION = "1"
"""Part of every key: a change of what is made of a reply must change it."""

CHARACTERS_A_TOKEN = 4
PICTURE_TOKENS = 576
"""For a server that does not count: English text has about four characters a token, and LLaVA-1.5 turns a picture into
24 x 24 tokens. Models that tile large pictures take more."""

Alternatives = tuple[tuple[str, float], ...]
"""Tokens that could stand at one place of an answer, the one that does first, with their log-probabilities."""

Tokens = Annotated[int, Field(strict=True, ge=0)]


@dataclass(frozen=True)
class Parameters:
    """What an answer depends on besides the prompt and the picture.

    Attributes
    ----------
    model : str
    max_tokens : int
    temperature : float
    seed : int or None
        None sends none.
    top_logprobs : int
        How many alternatives of each token to ask for; 0 asks for none.
    extra : mapping
        Further keys of the request, such as `chat_template_kwargs`; a value of None takes a key away.
    """

    model: str
    max_tokens: int = 128
    temperature: float = 0.0
    seed: int | None = 0
    top_logprobs: int = 0
    extra: Mapping[str, Any] = field(default_factory=dict)

    def fields(self) -> dict[str, Any]:
        """The keys of the request besides its messages."""
        table: dict[str, Any] = {
            "model": self.model,
            "max_tokens": self.max_tokens,
            "temperature": self.temperature,
            "seed": self.seed,
            "stream": False,
        }
        if self.top_logprobs:
            table |= {"logprobs": True, "top_logprobs": self.top_logprobs}
        return {name: value for name, value in {**table, **self.extra}.items() if value is not None}


@dataclass(frozen=True, eq=False)
class Picture:
    """A picture to be sent, encoded and hashed once.

    Attributes
    ----------
    rgb : (H, W, 3) uint8
    """

    rgb: np.ndarray

    def __post_init__(self) -> None:
        rgb = self.rgb
        good = isinstance(rgb, np.ndarray) and rgb.dtype == np.uint8 and rgb.ndim == 3 and rgb.shape[2] == 3
        if not good or not rgb.size:
            got = f"{rgb.dtype} {rgb.shape}" if isinstance(rgb, np.ndarray) else type(rgb).__name__
            raise InputError("a picture must be uint8 (H, W, 3)", got=got)

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the pixels and of how they are encoded."""
        found = hashlib.sha256(f"jpeg {JPEG_QUALITY} {self.rgb.shape}".encode())
        found.update(np.ascontiguousarray(self.rgb).data)
        return found.hexdigest()

    @cached_property
    def data_url(self) -> str:
        """The picture as a JPEG in base64."""
        options = [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY]
        done, data = cv2.imencode(".jpg", cv2.cvtColor(self.rgb, cv2.COLOR_RGB2BGR), options)
        require(done, "the picture cannot be encoded as JPEG", got=str(self.rgb.shape))
        return "data:image/jpeg;base64," + base64.b64encode(data.tobytes()).decode("ascii")


@dataclass(frozen=True)
class Completion:
    """A server's answer.

    Attributes
    ----------
    text : str
    finish : str or None
        Why it ends: "stop", or "length" where it was cut off.
    prompt_tokens, completion_tokens : int or None
        None where the server does not count.
    logprobs : tuple of Alternatives
        One a token; empty where the server gives none.
    """

    text: str
    finish: str | None
    prompt_tokens: Tokens | None
    completion_tokens: Tokens | None
    logprobs: tuple[Alternatives, ...] = ()


_COMPLETION = TypeAdapter(Completion)


def request_body(parameters: Parameters, prompt: str, picture: Picture | None) -> bytes:
    """The body of a request, ASCII JSON.

    The picture stands before the text, as in LLaVA's training; and what questions about one picture have in common
    comes first, which a server may keep between them.
    """
    content: list[dict[str, Any]] = [{"type": "text", "text": prompt}]
    if picture is not None:
        content.insert(0, {"type": "image_url", "image_url": {"url": picture.data_url}})
    return json.dumps({**parameters.fields(), "messages": [{"role": "user", "content": content}]}).encode("ascii")


def read_completion(reply: Reply) -> Completion:
    """The answer in a reply.

    Raises
    ------
    Failure
        The server refuses, or what it sends is no answer.
    """
    if reply.status != 200:
        raise _refusal(reply.status, reply)
    kind = reply.headers.get("content-type", "").lower()
    if "text/event-stream" in kind or reply.body.lstrip().startswith(b"data:"):
        raise Failure(
            "the server streams its answer", status=200, detail=first_line(reply.body),
            cause="it does not honour stream=false", everywhere=True,
        )  # fmt: skip
    table = _json_of(reply)
    error = table.get("error")
    if error and not table.get("choices"):
        # Some gateways report the failure of the server behind them under status 200.
        code = error.get("code") if isinstance(error, dict) else None
        raise _refusal(code if isinstance(code, int) and 400 <= code < 600 else 502, reply)
    choices = table.get("choices")
    if not isinstance(choices, list) or not choices:
        raise Failure("the reply holds no answer", status=200, detail=first_line(reply.body), again=True)
    choice = choices[0] if isinstance(choices[0], dict) else {}
    message = choice.get("message")
    if not isinstance(message, dict):
        raise Failure("the reply holds no message", status=200, detail=first_line(reply.body), again=True)
    usage = table.get("usage")
    usage = usage if isinstance(usage, dict) else {}
    finish = choice.get("finish_reason")
    return Completion(
        _text_of(message.get("content")),
        finish if isinstance(finish, str) else None,
        _count(usage.get("prompt_tokens")),
        _count(usage.get("completion_tokens")),
        _logprobs_of(choice.get("logprobs")),
    )


def read_models(reply: Reply) -> tuple[str, ...]:
    """The names of the models in a reply to GET /models.

    Raises
    ------
    Failure
    """
    if reply.status != 200:
        raise _refusal(reply.status, reply)
    data = _json_of(reply).get("data")
    rows = data if isinstance(data, list) else []
    return tuple(row["id"] for row in rows if isinstance(row, dict) and isinstance(row.get("id"), str))


def first_line(body: bytes, limit: int = 200) -> str:
    """What a body says: the message of its error, else its first line that is not blank; at most `limit` characters."""
    text = body[: 1 << 16].decode("utf-8", "replace")
    try:
        table = parse_json(text)
    except ValueError:
        table = None
    for holder in (table.get("error"), table) if isinstance(table, dict) else ():
        message = holder.get("message") if isinstance(holder, dict) else holder
        if isinstance(message, str) and message.strip():
            text = message
            break
    line = next((found for found in text.splitlines() if found.strip()), "")
    line = "".join(c if c.isprintable() else " " for c in line).strip()
    return line if len(line) <= limit else line[:limit] + "..."


def _refusal(status: int, reply: Reply) -> Failure:
    name = http.HTTPStatus(status).phrase if status in set(http.HTTPStatus) else "unknown status"
    detail = first_line(reply.body) or None
    # A used-up quota is told by the same status as haste, and no waiting mends it.
    spent = b"insufficient_quota" in reply.body
    target = reply.headers.get("location", "")[:200]
    return Failure(
        f"the server answered {status} {name}",
        status=status,
        detail=detail,
        cause=f"it redirects to {target}; give that address" if 300 <= status < 400 and target else None,
        again=(status in (408, 429) or status >= 500) and not spent,
        wait_s=wait_asked(reply.headers),
        everywhere=status in (401, 403, 404, 405, 429) or 300 <= status < 400,
    )


def _json_of(reply: Reply) -> dict[str, Any]:
    try:
        table = parse_json(reply.body)
    except ValueError:
        # A broken object may be whole the next time; a page of HTML will be the same.
        broken = reply.body.lstrip()[:1] == b"{"
        raise Failure(
            "the reply is no JSON", status=reply.status, detail=first_line(reply.body) or "nothing",
            cause=None if broken else "does the base address end in /v1?", again=broken, everywhere=not broken,
        ) from None  # fmt: skip
    if not isinstance(table, dict):
        raise Failure(
            "the reply is no JSON object", status=reply.status, detail=first_line(reply.body), everywhere=True
        )
    return table


def _text_of(content: object) -> str:
    if isinstance(content, str):
        return content
    parts: Sequence[Any] = content if isinstance(content, list) else ()
    return "".join(p["text"] for p in parts if isinstance(p, dict) and isinstance(p.get("text"), str))


def _count(value: object) -> int | None:
    return value if isinstance(value, int) and not isinstance(value, bool) and value >= 0 else None


def _logprobs_of(value: object) -> tuple[Alternatives, ...]:
    rows = value.get("content") if isinstance(value, dict) else None
    if not isinstance(rows, list):
        return ()
    found: list[Alternatives] = []
    for row in rows:
        others = row.get("top_logprobs") if isinstance(row, dict) else None
        pairs = [_pair(row), *(_pair(other) for other in (others if isinstance(others, list) else ()))]
        if pairs[0] is None:
            return ()
        found.append(tuple(dict(pair for pair in pairs if pair is not None).items()))
    return tuple(found)


def _pair(row: object) -> tuple[str, float] | None:
    if not isinstance(row, dict):
        return None
    token, value = row.get("token"), row.get("logprob")
    good = isinstance(token, str) and isinstance(value, int | float) and not math.isnan(value)
    return (token, min(float(value), 0.0)) if good else None  # type: ignore[arg-type, return-value]


@dataclass(frozen=True)
class Usage:
    """Counts of one client since it was made.

    Attributes
    ----------
    requests : int
        Questions sent, every try counted.
    answers : int
        Answers that came over the wire.
    cached : int
        Answers that the cache had.
    prompt_tokens, completion_tokens : int
        Of `answers`.
    cached_prompt_tokens, cached_completion_tokens : int
        Of `cached`: what they took when they were asked.
    estimated : int
        How many of all these answers have estimated tokens, for want of the server's count.
    """

    requests: int = 0
    answers: int = 0
    cached: int = 0
    prompt_tokens: int = 0
    completion_tokens: int = 0
    cached_prompt_tokens: int = 0
    cached_completion_tokens: int = 0
    estimated: int = 0


def estimated_tokens(text: str) -> int:
    """Tokens of a text, about."""
    return math.ceil(len(text) / CHARACTERS_A_TOKEN)


def answer_key(parameters: Parameters, prompt: str, picture: str) -> str:
    """SHA-256 of everything that the answer depends on, hexadecimal.

    The server is no part of it: the same model at another address gives the same answer. So a server that takes any
    name for its one model, as llama.cpp's does, must be given a name that tells its models apart.

    Parameters
    ----------
    picture : str
        Hash of the picture as it is sent; empty without one.
    """
    content = {"version": _VERSION, "request": parameters.fields(), "prompt": prompt, "picture": picture}
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode("ascii")).hexdigest()


class AnswerCache:
    """One JSON file an answer, below a folder.

    A damaged or unreadable file is a miss, never an error; a folder that cannot be written only means that nothing is
    kept.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def _path(self, key: str) -> Path:
        return self.folder / key[:2] / f"{key}.json"

    def load(self, key: str) -> tuple[Completion, float] | None:
        """The answer, and the seconds that it took; None where it is not known."""
        try:
            table = read_json(self._path(key))
            answer = _COMPLETION.validate_python(table["answer"])
            return (answer, float(table["seconds"])) if table["key"] == key else None
        except (OSError, ValueError, KeyError, TypeError):
            return None

    def store(self, key: str, prompt: str, parameters: Parameters, answer: Completion, seconds: float) -> None:
        """Keep an answer; the question stands beside it for people who look into the file."""
        table = {
            "key": key,
            "request": parameters.fields(),
            "prompt": prompt,
            "answer": asdict(answer),
            "seconds": seconds,
        }
        keep_whole(self._path(key), lambda file: file.write(json.dumps(table).encode("ascii")))
