"""HTTP of the chat client by OpenAI's library (extra: llm): retries, limits of time and size, errors of one line."""

from __future__ import annotations

import ipaddress
import ssl
import urllib.request
from collections.abc import Callable
from contextlib import closing
from http import HTTPStatus
from time import monotonic
from typing import Any
from urllib.parse import urlsplit

import httpx2
import openai

from pipeline.system.errors import ServerError
from pipeline.system.safe_files import parse_json

MAX_BYTES = 16 << 20
"""No answer to a question is longer."""
_ENDING = "does the base address end in /v1?"


class _Useless(openai.OpenAIError):
    """Reply beyond mending by another try; the library hands such errors on at once."""

    def __init__(self, what: str, detail: str, cause: str | None = None) -> None:
        super().__init__(what)
        self.what, self.detail, self.cause = what, detail, cause


class _Transport(httpx2.HTTPTransport):
    """One try: `begin` first, then a whole reply within seconds and bytes; a broken reply counts as a broken line."""

    def __init__(self, timeout_s: float, begin: Callable[[], None], proxy: str | None) -> None:
        # The certificates of this machine, as other programs here take them.
        super().__init__(verify=ssl.create_default_context(), proxy=proxy)
        self._timeout_s, self._begin = timeout_s, begin

    def handle_request(self, request: httpx2.Request) -> httpx2.Response:
        self._begin()
        deadline = monotonic() + self._timeout_s
        body = bytearray()
        with closing(super().handle_request(request)) as reply:
            for part in reply.stream:  # pyright: ignore[reportGeneralTypeIssues]
                body += part
                if len(body) > MAX_BYTES:
                    raise _Useless("the reply does not end", f"more than {MAX_BYTES >> 20} MB")
                if monotonic() > deadline:
                    raise httpx2.ReadTimeout("a reply that trickles in")
        whole = httpx2.Response(reply.status_code, headers=reply.headers, content=bytes(body), request=request)
        if b"insufficient_quota" in body:
            # A used-up quota has the status of haste, and no waiting mends it.
            whole.headers["x-should-retry"] = "false"
        if whole.status_code == 200:
            _check_answer(whole)
        return whole


def _check_answer(reply: httpx2.Response) -> None:
    """Raise for a reply without an answer; an error under status 200 gets the status named inside, else 502."""
    text = reply.text.lstrip("\ufeff \r\n")
    if "text/event-stream" in reply.headers.get("content-type", "") or text.startswith("data:"):
        raise _Useless("the server streams its answer", text, "it does not honour stream=false")
    try:
        table = parse_json(reply.content)
    except ValueError:
        # A broken object may be whole the next time; a page of HTML will be the same.
        if text.startswith("{"):
            raise httpx2.RemoteProtocolError("the reply is no JSON") from None
        raise _Useless("the reply is no JSON", text or "nothing", _ENDING) from None
    if not isinstance(table, dict):
        raise _Useless("the reply is no JSON object", text)
    if (error := table.get("error")) and not table.get("choices"):
        code = error.get("code") if isinstance(error, dict) else None
        reply.status_code = code if isinstance(code, int) and 400 <= code < 600 else 502
        return
    try:
        message = table["choices"][0]["message"]
    except (LookupError, TypeError):
        message = None
    if not isinstance(message, dict):
        raise httpx2.RemoteProtocolError("the reply holds no answer")


class Endpoint:
    """Chat server."""

    def __init__(
        self, base_url: str, key: str, key_variable: str, timeout_s: float, retries: int, begin: Callable[[], None]
    ) -> None:
        self._base, self._key, self._key_variable, self._timeout_s = base_url, key, key_variable, timeout_s
        transport = _Transport(timeout_s, begin, _proxy(base_url))
        # What the environment holds for OpenAI's own server is for no other.
        left_out = ["OpenAI-Organization", "OpenAI-Project", *([] if key else ["Authorization"])]
        self._options: Any = {"headers": dict.fromkeys(left_out, openai.Omit())}
        self._client = openai.OpenAI(
            api_key=key or "none",
            base_url=base_url,
            timeout=timeout_s,
            max_retries=retries,
            default_headers={"Accept-Encoding": "identity", "User-Agent": "spatialviz"},
            # A redirect would turn the question into a GET, and carry the key to another host.
            http_client=httpx2.Client(transport=transport, follow_redirects=False, timeout=timeout_s),
        )

    def post(self, body: dict[str, Any], model: str) -> dict[str, Any]:
        """Reply to a question; ServerError after the last try."""
        try:
            reply = self._client.post("/chat/completions", cast_to=httpx2.Response, body=body, options=self._options)
            return reply.json()
        except openai.OpenAIError as error:
            raise self._server_error(error, self._cause(error, model)) from None

    def _cause(self, error: openai.OpenAIError, model: str) -> str | None:
        """Likely cause of a status."""
        if not isinstance(error, openai.APIStatusError):
            return None
        status, headers = error.status_code, error.response.headers
        if status in (401, 403):
            return "is the API key the right one?" if self._key else f"no API key was given: set {self._key_variable}"
        if 300 <= status < 400:
            return f"it redirects to {headers.get('location', '')[:200]}; give that address"
        if "retry-after" in headers:
            return f"it asks to wait {headers['retry-after'][:40]} s"
        return _ENDING if status == 404 and model not in error.response.text else None

    def _server_error(self, error: openai.OpenAIError, cause: str | None) -> ServerError:
        status, everywhere, detail = None, False, ""
        if isinstance(error, _Useless):
            what, detail, cause, everywhere = error.what, error.detail, error.cause, True
        elif isinstance(error, openai.APIStatusError):
            status, body = error.status_code, error.body
            name = HTTPStatus(status).phrase if status in set(HTTPStatus) else "unknown status"
            what = f"the server answered {status} {name}"
            body = body.get("message") if isinstance(body, dict) else body
            detail = body if isinstance(body, str) else error.response.text
            everywhere = status in (401, 403, 404, 405, 429) or 300 <= status < 400
        elif isinstance(error, openai.APITimeoutError):
            what, cause = f"no whole reply within {self._timeout_s:g} s", "a longer timeout may help"
        else:
            everywhere = isinstance(error.__cause__, httpx2.ConnectError)
            root: BaseException = error
            while (below := root.__cause__ or root.__context__) is not None:
                root = below
            what, detail = "the connection failed", str(root)
            if isinstance(root, ConnectionRefusedError):
                what, detail, cause = "no server listens there", "", "is it running, on this port?"
        tries = 1 + int(error.request.headers["x-stainless-retry-count"]) if isinstance(error, openai.APIError) else 1
        # A server may repeat what it was sent.
        detail = detail.replace(self._key, "***") if self._key else detail
        line = next((found for found in detail.splitlines() if found.strip()), "").strip()
        line = "".join(c if c.isprintable() else " " for c in line)
        return ServerError(
            f"{self._base}/chat/completions: {what}" + (f", {tries} times" if tries > 1 else ""),
            status=status,
            everywhere=everywhere,
            got=repr(line[:200] + "..." * (len(line) > 200)) if line else None,
            cause=cause,
        )


def _proxy(url: str) -> str | None:
    """Proxy of the environment; none before this machine itself."""
    parts = urlsplit(url)
    host = parts.hostname or ""
    try:
        here = ipaddress.ip_address(host).is_loopback
    except ValueError:
        here = host == "localhost" or host.endswith(".localhost")
    return None if here or urllib.request.proxy_bypass(host) else urllib.request.getproxies().get(parts.scheme)
