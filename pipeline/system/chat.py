"""Client of OpenAI's chat protocol: questions about words or pictures, many at once, answers kept on disk."""

from __future__ import annotations

import base64
import hashlib
import json
import math
import os
import re
import threading
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict
from functools import cached_property
from multiprocessing.pool import ThreadPool
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import cv2
import numpy as np
from pydantic import TypeAdapter

from pipeline.system.errors import InputError, ServerError, extra_module, require
from pipeline.system.frozen import dataclass
from pipeline.system.paths import cache_folder
from pipeline.system.safe_files import read_json
from pipeline.system.whole_files import keep_whole

KEY_VARIABLE = "SPATIALVIZ_VLM_KEY"
JPEG_QUALITY = 92
_VERSION = "1"
"""Part of every key: a change of what is made of a reply must change it."""


@dataclass(frozen=True, eq=False)
class ChatPicture:
    """Picture to send ((H, W, 3) uint8), encoded and hashed once."""

    rgb: np.ndarray

    @cached_property
    def digest(self) -> str:
        """SHA-256 of pixels and encoding."""
        found = hashlib.sha256(f"jpeg {JPEG_QUALITY} {self.rgb.shape}".encode())
        found.update(np.ascontiguousarray(self.rgb).data)
        return found.hexdigest()

    @cached_property
    def data_url(self) -> str:
        """JPEG in base64."""
        options = [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY]
        _, data = cv2.imencode(".jpg", cv2.cvtColor(self.rgb, cv2.COLOR_RGB2BGR), options)
        return "data:image/jpeg;base64," + base64.b64encode(data.tobytes()).decode("ascii")


@dataclass(frozen=True)
class ChatQuestion:
    """One question; None stands for the client's own setting. `check` raises for a useless text, never kept."""

    prompt: str
    picture: ChatPicture | None
    max_tokens: int | None = None
    check: Callable[[str], object] = str


@dataclass(frozen=True)
class ChatAnswer:
    """Text of a model."""

    text: str
    finish: str | None = None
    """Why it ends: "stop", or "length" where it was cut off."""
    cached: bool = False
    failure: str | None = None
    """Why there is no answer to one of many questions."""


_ANSWER = TypeAdapter(ChatAnswer)


class ChatClient:
    """Client of one model of one server; InputError for unusable parameters, MissingExtra without `openai`.

    Parameters
    ----------
    base_url : str
        `http://localhost:8000/v1` (vLLM), `http://localhost:11434/v1` (Ollama), `http://localhost:8080/v1` (llama.cpp).
    model : str
        As the server names it; also a part of the cache's keys.
    api_key : str, optional
        SPATIALVIZ_VLM_KEY of the environment by default; servers on one's own machine need none.
    timeout_s : float
        Of one try.
    retries : int
        Further tries after 408, 409, 429, 5xx, a timeout, a broken connection or a broken reply.
    extra : mapping, optional
        Further keys of the request, such as `chat_template_kwargs`; a value of None takes a key away.
    cache : bool or Path
        Folder of kept answers; True for the one in the user's cache folder.
    clock, sleep : callable
        For `requests_per_minute`, evenly spaced.
    """

    def __init__(
        self,
        base_url: str,
        model: str,
        *,
        api_key: str | None = None,
        timeout_s: float = 120.0,
        retries: int = 4,
        requests_per_minute: float | None = None,
        max_tokens: int = 128,
        extra: Mapping[str, Any] | None = None,
        cache: bool | Path = True,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self.base_url, self.requests = checked_base(base_url), 0
        require(model.strip(), "the model needs a name", cause="the server's own list is at GET /models")
        require(
            requests_per_minute is None or 0 < requests_per_minute < math.inf,
            "a limit of requests a minute must be above 0",
            got=requests_per_minute,
        )
        key = (api_key if api_key is not None else os.environ.get(KEY_VARIABLE, "")).strip()
        require(
            key.isascii() and key.isprintable() and " " not in key,
            "the API key holds characters that no key has",
            cause="was more than the key copied?",
        )
        http = extra_module("pipeline.system.chat_http", f"asking {model}", "llm")
        self._server = http.Endpoint(self.base_url, key, KEY_VARIABLE, timeout_s, retries, self._begin)
        self._model, self._max_tokens, self._extra = model, max_tokens, dict(extra or {})
        self._folder = cache_folder() / "vlm" if cache is True else cache or None
        self._interval, self._clock, self._sleep = 60 / (requests_per_minute or math.inf), clock, sleep
        self._lock, self._free = threading.Lock(), clock()

    def ask(self, prompt: str, rgb: np.ndarray | None, *, check: Callable[[str], object] = str) -> ChatAnswer:
        """Ask one question about a picture ((H, W, 3) uint8, sent as JPEG) or none; as `ChatQuestion`.

        Raises ServerError after the last try, with address, status and the server's words.
        """
        return self._answer(ChatQuestion(prompt, None if rgb is None else ChatPicture(rgb), check=check))

    def ask_many(self, questions: Iterable[ChatQuestion], *, workers: int = 4) -> list[ChatAnswer]:
        """Ask many questions, `workers` at a time; answers in order, known ones from the cache.

        A question that fails for itself (a timeout, a refusal of its content) leaves only its own answer empty, with
        `failure` set; a ServerError of all questions is raised. Ctrl-C ends it at once.
        """
        stop = threading.Event()

        def answer(question: ChatQuestion) -> ChatAnswer:
            if stop.is_set():
                return ChatAnswer("")
            try:
                return self._answer(question)
            except Exception as error:
                if isinstance(error, ServerError) and not error.everywhere:
                    return ChatAnswer("", failure=str(error))
                stop.set()
                raise

        # Its threads keep nobody waiting who wants to leave.
        pool = ThreadPool(workers)
        try:
            answers = pool.map_async(answer, questions, chunksize=1)
            while not answers.ready():
                # A wait without an end cannot be interrupted everywhere.
                answers.wait(0.5)
            return answers.get()
        finally:
            stop.set()
            pool.terminate()

    def _answer(self, question: ChatQuestion) -> ChatAnswer:
        tokens = self._max_tokens if question.max_tokens is None else question.max_tokens
        request = {"model": self._model, "max_tokens": tokens, "temperature": 0.0, "seed": 0, "stream": False}
        request = {name: value for name, value in {**request, **self._extra}.items() if value is not None}
        picture = question.picture
        # The server is no part of the key: the same model at another address gives the same answer.
        asked = {"request": request, "prompt": question.prompt}
        known = {"version": _VERSION, **asked, "picture": picture.digest if picture else ""}
        key = hashlib.sha256(json.dumps(known, sort_keys=True).encode("ascii")).hexdigest()
        path = self._folder / key[:2] / f"{key}.json" if self._folder else None
        if path is not None and (kept := _kept(path, key)) is not None:
            return kept
        # The picture comes first, as in LLaVA's training; questions about one picture then begin alike.
        content: list[dict[str, Any]] = [{"type": "text", "text": question.prompt}]
        if picture is not None:
            content.insert(0, {"type": "image_url", "image_url": {"url": picture.data_url}})
        body = {**request, "messages": [{"role": "user", "content": content}]}
        found = _read(self._server.post(body, self._model)["choices"][0])
        question.check(found.text)
        if path is not None:
            table = json.dumps({"key": key, **asked, "answer": asdict(found)}).encode("ascii")
            keep_whole(path, lambda file: file.write(table))
        return found

    def _begin(self) -> None:
        """Count a try, and wait for a turn."""
        with self._lock:
            self.requests += 1
            now = self._clock()
            start = max(now, self._free)
            self._free = start + self._interval
        if start > now:
            self._sleep(start - now)


def _kept(path: Path, key: str) -> ChatAnswer | None:
    """Answer in the cache; None for a damaged file too."""
    try:
        table = read_json(path)
        return _ANSWER.validate_python({**table["answer"], "cached": True}) if table["key"] == key else None
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _read(choice: dict[str, Any]) -> ChatAnswer:
    content, finish = choice["message"].get("content"), choice.get("finish_reason")
    parts = [content] if isinstance(content, str) else [p.get("text") for p in content or () if isinstance(p, dict)]
    text = "".join(part for part in parts if isinstance(part, str))
    return ChatAnswer(text, finish if isinstance(finish, str) else None)


def checked_base(url: str) -> str:
    """Base address of a server, without a final slash or `/chat/completions`; InputError if malformed or with a key."""
    expected, url = "an address such as http://localhost:8000/v1", url.strip()
    try:
        parts = urlsplit(url)
        host, _ = parts.hostname, parts.port
    except ValueError as error:
        raise InputError("the address of the server cannot be read", got=error, expected=expected) from None
    sound = parts.scheme in ("http", "https") and host and not re.search(r"[\s\x00-\x1f\x7f?#]", url)
    require("@" not in parts.netloc, "a key does not belong into the address of the server", expected=expected)
    require(sound, "the address of the server cannot be used", got=repr(url)[:120], expected=expected)
    return f"{parts.scheme}://{parts.netloc}" + parts.path.rstrip("/").removesuffix("/chat/completions").rstrip("/")
