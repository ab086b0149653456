"""A model hub on this machine, as far as fetching files needs one: what is in a repository, and its files."""

from __future__ import annotations

import hashlib
import json
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from urllib.parse import unquote, urlsplit


@dataclass
class Hub:
    """Repositories by name: files by path, and the commit of the branch `main`.

    `told` overrides the hash that is told of a file; `cut` files are sent by half.
    """

    url: str = ""
    files: dict[str, dict[str, bytes]] = field(default_factory=dict)
    commits: dict[str, str] = field(default_factory=dict)
    told: dict[str, str] = field(default_factory=dict)
    cut: set[str] = field(default_factory=set)
    gated: set[str] = field(default_factory=set)
    requests: list[str] = field(default_factory=list)

    def put(self, repo: str, commit: str, **files: bytes) -> None:
        """Files of a commit; "__" stands for "/" and "_dot_" for "." in their names."""
        self.files[repo] = {n.replace("__", "/").replace("_dot_", "."): content for n, content in files.items()}
        self.commits[repo] = commit


@contextmanager
def running_hub() -> Iterator[Hub]:
    """A hub that runs while the context is open."""
    hub = Hub()

    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def log_message(self, format: str, *args: object) -> None:
            pass

        def do_HEAD(self) -> None:
            self.answer(body=False)

        def do_GET(self) -> None:
            self.answer(body=True)

        def answer(self, body: bool) -> None:
            path = unquote(urlsplit(self.path).path)
            hub.requests.append(f"{self.command} {path}")
            parts = path.strip("/").split("/")
            if parts[:2] == ["api", "models"]:
                self.info("/".join(parts[2:4]), parts[5] if len(parts) > 5 else "main")
            elif len(parts) > 4 and parts[2] == "resolve":
                self.file("/".join(parts[:2]), parts[3], "/".join(parts[4:]), body)
            else:
                self.refuse("EntryNotFound")

        def info(self, repo: str, revision: str) -> None:
            if repo in hub.gated:
                self.refuse("GatedRepo", 403)
            elif repo not in hub.files:
                self.refuse("RepoNotFound")
            elif revision not in ("main", hub.commits[repo]):
                self.refuse("RevisionNotFound")
            else:
                siblings = [
                    {
                        "rfilename": name,
                        "size": len(content),
                        "lfs": {"sha256": self.hash(name, content), "size": len(content), "pointerSize": 130},
                    }
                    for name, content in hub.files[repo].items()
                ]
                found = {"id": repo, "sha": hub.commits[repo], "siblings": siblings, "tags": []}
                self.send(json.dumps(found).encode(), {"Content-Type": "application/json"})

        def file(self, repo: str, revision: str, name: str, body: bool) -> None:
            content = hub.files.get(repo, {}).get(name)
            if content is None or revision not in ("main", hub.commits[repo]):
                self.refuse("EntryNotFound")
                return
            headers = {"ETag": f'"{self.hash(name, content)}"', "X-Repo-Commit": hub.commits[repo]}
            self.send(content, headers, body=body, cut=name in hub.cut)

        def hash(self, name: str, content: bytes) -> str:
            return hub.told.get(name) or hashlib.sha256(content).hexdigest()

        def refuse(self, code: str, status: int = 404) -> None:
            self.send(b"{}", {"X-Error-Code": code, "X-Error-Message": code}, status=status)

        def send(
            self, content: bytes, headers: dict[str, str], *, status: int = 200, body: bool = True, cut: bool = False
        ) -> None:
            self.send_response(status)
            for name, value in {**headers, "Content-Length": str(len(content))}.items():
                self.send_header(name, value)
            self.end_headers()
            if body and self.command == "GET":
                self.wfile.write(content[: len(content) // 2] if cut else content)
            self.close_connection = cut

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    hub.url = f"http://127.0.0.1:{server.server_address[1]}"
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        yield hub
    finally:
        server.shutdown()
        server.server_close()
        thread.join()
