"""A client of OpenAI's chat protocol, asked about pictures or words: retries, pace, cache, counts, many at once."""

from __future__ import annotations

import json
import math
import os
import threading
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from pipeline.system.chat.protocol import (
    PICTURE_TOKENS,
    AnswerCache,
    Completion,
    Parameters,
    Picture,
    Usage,
    answer_key,
    estimated_tokens,
    read_completion,
    read_models,
    request_body,
)
from pipeline.system.chat.transport import Failure, checked_base, map_ordered, send
from pipeline.system.errors import InputError, ServerError, listed, require
from pipeline.system.paths import cache_folder

KEY_VARIABLE = "SPATIALVIZ_VLM_KEY"
FIRST_WAIT_S = 0.5
LONGEST_WAIT_S = 60.0
"""Waits between tries double from the first to the longest. They have no jitter: `Pace` already spreads the requests of
one client, and a run can be repeated. A server that asks for more than the longest is not waited for."""

_MODELS_TIMEOUT_S = 10.0
_REFUSALS_OF_A_MODEL = (400, 404, 422)


class _Stopped(Exception):
    """Nobody waits for the answer any more."""


@dataclass(frozen=True)
class Question:
    """One question, about a picture where there is one; None stands for the client's own setting. `check` raises for an
    answer that is of no use, which is then not kept."""

    prompt: str
    picture: Picture | None
    max_tokens: int | None = None
    top_logprobs: int | None = None
    check: Callable[[str], object] = str


@dataclass(frozen=True)
class Answer(Completion):
    """What a model said, and what it cost.

    Attributes
    ----------
    estimated : bool
        The server does not count tokens, and those of this answer are guesses from the length.
    seconds : float
        From the request to its whole reply, when it was asked.
    cached : bool
    failure : str or None
        Why there is no answer: only where a run was told to go on without it.
    """

    estimated: bool = False
    seconds: float = 0.0
    cached: bool = False
    failure: str | None = None


class ChatClient:
    """Asks one model of one server.

    Parameters
    ----------
    base_url : str
        `http://localhost:8000/v1` (vLLM), `http://localhost:11434/v1` (Ollama), `http://localhost:8080/v1` (llama.cpp).
    model : str
        As the server names it; also a part of the cache's keys.
    api_key : str, optional
        SPATIALVIZ_VLM_KEY of the environment where none is given; servers on one's own machine need none.
    timeout_s : float
        Seconds for one try.
    retries : int
        Further tries after 408, 429, 5xx, a timeout, a broken connection or a broken reply.
    requests_per_minute : float, optional
    max_tokens, temperature, seed, top_logprobs, extra
        See `pipeline.system.chat.protocol.Parameters`.
    cache : bool or Path
        Whether answers are kept, in the user's cache folder (or SPATIALVIZ_CACHE) or in one's own.
    clock, sleep : callable
        Seconds, and waiting for some.

    Attributes
    ----------
    usage : Usage
        What was asked so far.

    Raises
    ------
    InputError
        For a parameter that cannot be used.
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
        temperature: float = 0.0,
        seed: int | None = 0,
        top_logprobs: int = 0,
        extra: Mapping[str, Any] | None = None,
        cache: bool | Path = True,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self.base_url = checked_base(base_url)
        self.parameters = Parameters(model, max_tokens, temperature, seed, top_logprobs, dict(extra or {}))
        _check(self.parameters, timeout_s, retries)
        self.timeout_s, self.retries = timeout_s, retries
        self._key = (api_key if api_key is not None else os.environ.get(KEY_VARIABLE, "")).strip()
        require(
            (self._key.isascii() and self._key.isprintable()) and " " not in self._key,
            "the API key holds characters that no key has",
            cause="was more than the key copied?",
        )
        folder = cache_folder() / "vlm" if cache is True else cache
        self._cache = AnswerCache(folder) if folder else None
        self._clock, self._sleep = clock, sleep
        self._pace = Pace(requests_per_minute, clock, sleep)
        self.usage, self._lock = Usage(), threading.Lock()

    def ask(
        self,
        prompt: str,
        image: np.ndarray | Picture | None,
        *,
        max_tokens: int | None = None,
        top_logprobs: int | None = None,
        check: Callable[[str], object] = str,
    ) -> Answer:
        """Ask one question.

        Parameters
        ----------
        image : (H, W, 3) uint8 or Picture, optional
            Sent as it is, as JPEG.
        max_tokens, top_logprobs : int, optional
            Instead of the client's.
        check : callable
            Raises for an answer that is of no use; it is not kept in the cache.

        Raises
        ------
        ServerError
            There is no answer after all tries: an `InputError` that names address, status and the server's words.
        """
        picture = image if image is None or isinstance(image, Picture) else Picture(image)
        return self._answer(Question(prompt, picture, max_tokens, top_logprobs, check), threading.Event())

    def ask_many(
        self,
        questions: Iterable[Question],
        *,
        workers: int = 4,
        progress: Callable[[int], None] = lambda _: None,
        keep_going: bool = False,
    ) -> list[Answer]:
        """Ask many questions, a few at a time.

        An error or Ctrl-C ends it at once; answers that came before are in the cache, so that the same call goes on
        from there.

        Parameters
        ----------
        questions : iterable of Question
            May make its pictures as it goes.
        workers : int
            Questions on their way at a time.
        progress : callable
            Called in this thread with the number of answers so far.
        keep_going : bool
            Whether a question that fails for itself (a timeout, a refusal of its content) leaves only its own answer
            empty, with `failure` set. What would fail every question still raises.

        Returns
        -------
        list of Answer
            In the order of the questions.

        Raises
        ------
        ServerError
        """
        require(workers >= 1, "at least one worker is needed", got=workers)

        def answer(question: Question, stop: threading.Event) -> Answer:
            try:
                return self._answer(question, stop)
            except ServerError as error:
                if not keep_going or error.everywhere:
                    raise
                return Answer("", None, 0, 0, failure=str(error))

        return map_ordered(answer, questions, workers, progress)

    def models(self) -> tuple[str, ...]:
        """The models that the server has, by GET /models.

        Raises
        ------
        ServerError
        """
        url = f"{self.base_url}/models"
        try:
            return read_models(send(url, None, self._headers(), min(self.timeout_s, _MODELS_TIMEOUT_S)))
        except Failure as failure:
            self._give_up(failure, url, 1, failure.cause)

    def _answer(self, question: Question, stop: threading.Event) -> Answer:
        own = {"max_tokens": question.max_tokens, "top_logprobs": question.top_logprobs}
        parameters = replace(self.parameters, **{k: v for k, v in own.items() if v is not None})
        _check(parameters, self.timeout_s, self.retries)
        require(question.prompt.strip(), "a question without words")
        key = answer_key(parameters, question.prompt, question.picture.digest if question.picture else "")
        known = self._cache.load(key) if self._cache else None
        if known is not None:
            return self._counted(question, *known, cached=True)
        completion, seconds = self._post(request_body(parameters, question.prompt, question.picture), stop)
        question.check(completion.text)
        if self._cache:
            self._cache.store(key, question.prompt, parameters, completion, seconds)
        return self._counted(question, completion, seconds, cached=False)

    def _post(self, body: bytes, stop: threading.Event) -> tuple[Completion, float]:
        url = f"{self.base_url}/chat/completions"
        for tries in range(1, self.retries + 2):
            self._pace.wait()
            if stop.is_set():
                raise _Stopped
            self._count(requests=1)
            start = self._clock()
            try:
                completion = read_completion(send(url, body, self._headers(), self.timeout_s))
                return completion, self._clock() - start
            except Failure as failure:
                wait = failure.wait_s
                if wait is None:
                    wait = min(FIRST_WAIT_S * 2 ** (tries - 1), LONGEST_WAIT_S)
                if not failure.again or tries > self.retries:
                    self._give_up(failure, url, tries, self._likely_cause(failure))
                if wait > LONGEST_WAIT_S:
                    self._give_up(failure, url, tries, f"it asks to wait {wait:g} s")
                if failure.status == 429 or failure.wait_s is not None:
                    self._pace.hold(wait)
                else:
                    self._sleep(wait)
        raise AssertionError("unreachable")

    def _headers(self) -> dict[str, str]:
        headers = {"Content-Type": "application/json", "Accept": "application/json", "User-Agent": "spatialviz"}
        return headers | ({"Authorization": f"Bearer {self._key}"} if self._key else {})

    def _give_up(self, failure: Failure, url: str, tries: int, cause: str | None) -> NoReturn:
        # A server may repeat what it was sent.
        detail = failure.detail.replace(self._key, "***") if failure.detail and self._key else failure.detail
        raise ServerError(
            f"{url}: {failure.what}" + (f", {tries} times" if tries > 1 else ""),
            status=failure.status,
            everywhere=failure.everywhere,
            got=repr(detail) if detail else None,
            cause=cause,
        ) from failure

    def _likely_cause(self, failure: Failure) -> str | None:
        if failure.status in (401, 403):
            return "is the API key the right one?" if self._key else f"no API key was given: set {KEY_VARIABLE}"
        if failure.status in _REFUSALS_OF_A_MODEL:
            try:
                names = self.models()
            except ServerError as error:
                return "does the base address end in /v1?" if error.status == 404 else failure.cause
            if names and self.parameters.model not in names:
                return f"the server has no model {self.parameters.model!r}, only: {listed(names)}"
        return failure.cause

    def _counted(self, question: Question, found: Completion, seconds: float, *, cached: bool) -> Answer:
        tokens_in, tokens_out = found.prompt_tokens, found.completion_tokens
        estimated = tokens_in is None or tokens_out is None
        if tokens_in is None:
            tokens_in = estimated_tokens(question.prompt) + (PICTURE_TOKENS if question.picture else 0)
        tokens_out = estimated_tokens(found.text) if tokens_out is None else tokens_out
        if cached:
            self._count(
                cached=1, cached_prompt_tokens=tokens_in, cached_completion_tokens=tokens_out, estimated=estimated
            )
        else:
            self._count(answers=1, prompt_tokens=tokens_in, completion_tokens=tokens_out, estimated=estimated)
        return Answer(found.text, found.finish, tokens_in, tokens_out, found.logprobs, estimated, seconds, cached)

    def _count(self, **more: int) -> None:
        with self._lock:
            self.usage = replace(self.usage, **{name: getattr(self.usage, name) + n for name, n in more.items()})


def _check(parameters: Parameters, timeout_s: float, retries: int) -> None:
    p = parameters
    try:
        json.dumps(dict(p.extra), allow_nan=False)
    except (TypeError, ValueError) as error:
        raise InputError("the extra keys of a request are no JSON", got=error) from None
    require(
        not (p.extra.keys() & {"messages", "model"} or p.extra.get("stream")),
        "the extra keys of a request cannot replace model, messages or stream",
        got=sorted(p.extra),
    )
    require(p.model.strip(), "the model needs a name", cause="the server's own list is at GET /models")
    require(0 < timeout_s < math.inf, "a timeout must be above 0 seconds", got=timeout_s)
    require(
        retries >= 0 and p.max_tokens >= 1,
        "retries must be 0 or more, max_tokens 1 or more",
        got=f"{retries}, {p.max_tokens}",
    )
    require(0 <= p.temperature < math.inf, "the temperature must be 0 or more", got=p.temperature)
    require(
        0 <= p.top_logprobs <= 20,
        "top_logprobs",
        got=p.top_logprobs,
        expected="0 to 20, the most that the protocol allows",
    )


class Pace:
    """A token bucket that holds one token, so that requests are evenly spaced.

    A bucket of a whole minute's tokens would let twice the limit through in its first minute.

    Parameters
    ----------
    per_minute : float or None
        None sets no limit.
    clock, sleep : callable
        Seconds, and waiting for some.
    """

    def __init__(
        self,
        per_minute: float | None,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        require(
            per_minute is None or 0 < per_minute < float("inf"),
            "a limit of requests a minute must be above 0",
            got=per_minute,
        )
        self.interval = 60.0 / per_minute if per_minute else 0.0
        self._clock, self._sleep = clock, sleep
        self._lock = threading.Lock()
        self._free = clock()

    def wait(self) -> None:
        """Return when the next request may be made."""
        while True:
            with self._lock:
                now = self._clock()
                if now >= self._free:
                    self._free = now + self.interval
                    return
                left = self._free - now
            self._sleep(left)

    def hold(self, seconds: float) -> None:
        """No request of any worker for so long."""
        with self._lock:
            self._free = max(self._free, self._clock() + seconds)
