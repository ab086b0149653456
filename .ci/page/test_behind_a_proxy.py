"""Behind nginx as the document sets it up, at a name and a path that are not this machine's, the page is what it is."""

import os
import re
import shutil
import subprocess
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from browser import OpenTab
from servers import Server, free_port

DOCUMENT = Path(__file__).resolve().parents[2] / "docs" / "page.md"
NGINX = shutil.which("nginx", path=f"{os.environ['PATH']}:/usr/sbin") or "nginx"
SET_UP = """daemon off; master_process off; pid {folder}/pid; events {{}}
http {{ access_log off; {folders} server {{ listen 127.0.0.1:{port}; {location} }} }}
"""
OWN_FOLDERS = ("client_body", "proxy", "fastcgi", "uwsgi", "scgi")


@contextmanager
def nginx(folder: Path, port: int, location: str) -> Iterator[None]:
    """nginx at a port of this machine, with one location."""
    folders = " ".join(f"{kind}_temp_path {folder}/{kind};" for kind in OWN_FOLDERS)
    file, errors = folder / "nginx.conf", folder / "errors"
    file.write_text(SET_UP.format(folder=folder, folders=folders, port=port, location=location))
    with subprocess.Popen([NGINX, "-p", str(folder), "-e", str(errors), "-c", str(file)]) as process:
        try:
            while process.poll() is None:
                try:
                    urllib.request.urlopen(f"http://127.0.0.1:{port}", timeout=5)
                except urllib.error.HTTPError:
                    break
                except OSError:
                    time.sleep(0.02)
            assert process.poll() is None, errors.read_text()
            yield
        finally:
            process.terminate()


@pytest.mark.parametrize("kept", [False, True], ids=["takes its path away", "keeps its path"])
def test_the_page_behind_nginx(kept: bool, open_tab: OpenTab, tmp_path: Path) -> None:
    """All that it asks for is below the path; who has no token, or comes by another name, is refused."""
    (location,) = re.findall(r"```nginx\n(.*?)```", DOCUMENT.read_text(), re.S)
    outside = free_port()
    address = f"http://lab.localhost:{outside}/spatialviz/"
    with Server("demo", "--outer-address", address) as server:
        location = location.replace("127.0.0.1:8080/", f"127.0.0.1:{server.port}" + "/" * (not kept))
        with nginx(tmp_path, outside, location):
            assert server.process.stdout is not None
            said = b"".join(server.process.stdout.readline() for _ in range(3)).decode()
            (link,) = re.findall(rf"from outside: ({address}\?token=\S+)", said)
            tab, asked = open_tab(), list[str]()
            tab.page.on("request", lambda request: asked.append(request.url))
            tab.page.on("websocket", lambda socket: asked.append(socket.url.replace("ws", "http", 1)))
            tab.open(link).drawn()
            assert re.fullmatch(rf"{address}\?data=demo&frame=.*", tab.page.url), tab.page.url
            tab.ask("mug left of the laptop")
            tab.answers("mug", "laptop")
            first = tab.frame
            tab.press("n")
            tab.other_frame(first)
            tab.poll("document.querySelector('#photo').naturalWidth > 0")
            kinds = ("app/socket?", "app/image/", "scene/")
            assert [kind for kind in kinds if any(url.startswith(address + kind) for url in asked)] == [*kinds]
            assert not [url for url in asked if not url.startswith((address, "data:", "blob:"))]
            assert [cookie["path"] for cookie in tab.page.context.cookies()] == ["/spatialviz"]
            other = open_tab()
            for wrong, status in ((address, 401), (address.replace("lab", "other"), 421)):
                answer = other.page.goto(wrong)
                assert answer is not None
                assert answer.status == status
            named = other.page.locator("p").inner_text()
            assert f"--outer-address https://other.localhost:{outside}/" in named, named
            other.problems.clear()
