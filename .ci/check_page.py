"""Smoke check of the page: served in time, closed to foreign pages, and answering in a real browser."""

import asyncio
import json
import subprocess
import sys
import time
import urllib.request
from pathlib import Path

import websockets
from playwright.sync_api import sync_playwright

from pipeline.answering.json_records import probability

PORT = 8231
ADDRESS = f"http://127.0.0.1:{PORT}"
SERVED_WITHIN = 10.0
CHROMIUM = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]


def wait_until_served(start: float) -> float:
    while time.monotonic() - start < SERVED_WITHIN:
        try:
            with urllib.request.urlopen(ADDRESS, timeout=1) as answer:
                assert answer.status == 200
                return time.monotonic() - start
        except OSError:
            time.sleep(0.05)
    raise SystemExit("the page was not served")


async def status_for(origin: str) -> int:
    try:
        async with websockets.connect(
            f"ws://127.0.0.1:{PORT}", origin=origin, subprotocols=["viser-v1.1.1"], max_size=None
        ):
            return 101
    except websockets.exceptions.InvalidStatus as refused:
        return refused.response.status_code


def memory_mb(pid: int) -> float:
    for line in Path(f"/proc/{pid}/status").read_text().splitlines():
        if line.startswith("VmRSS"):
            return int(line.split()[1]) / 1024
    return 0.0


FRAME_OF = """() => [...document.querySelectorAll('input')]
    .map(i => i.value).find(v => /^[0-9]+\\/[0-9]+$/.test(v)) || ''"""


def frame_of(page) -> str:
    return page.evaluate(FRAME_OF)


def same_as_the_command_line(page, text: str) -> None:
    """The first page shows a failure of the demo's run; what it says is what the command line says."""
    page.locator(".sv .vline").wait_for(timeout=30_000)
    run = Path(__file__).parents[1] / "assets" / "demo_run"
    asked = subprocess.run(
        [sys.executable, "-m", "spatialviz", "ask", "demo", frame_of(page), text, "--detector", "simulated", "--model",
         run / "simulated.toml", "--min-score", "0.015", "--k", "5", "--labels", run / "labels", "--json"],
        capture_output=True, check=False, text=True,
    )  # fmt: skip
    said = json.loads(asked.stdout)
    assert asked.returncode == (0 if said["answer"]["holds"] else 1), asked
    assert said["verdict"]["verdict"] != "CORRECT", said["verdict"]
    shown = page.locator(".sv .vline .vd").first.inner_text()
    assert shown.startswith(said["verdict"]["verdict"]), (shown, said["verdict"])
    assert page.locator(".sv .vline").get_attribute("title") == said["verdict"]["said"]
    heads = page.locator(".sv .heads b").all_inner_texts()
    wanted = [probability(said["answer"][k]) for k in ("relation_probability", "product")]
    assert heads == wanted, (heads, said["answer"])


def up_is_what_is_clicked(page) -> None:
    """A click names a level surface; what was declared comes back."""
    chip = page.locator(".sv .upchip")
    assert chip.inner_text() == "up declared", chip.inner_text()
    chip.click()
    page.locator(".sv .note", has_text="level surface").wait_for(timeout=30_000)
    page.evaluate("sv('image:0.10000,0.95000')")
    page.locator(".sv .upchip", has_text="given").wait_for(timeout=60_000)
    page.locator(".sv .uptold").get_by_text("take back").click()
    page.locator(".sv .upchip", has_text="declared").wait_for(timeout=60_000)


def ends_quietly(server: subprocess.Popen) -> None:
    """Stopped while a client still searches, the server says nothing but its own lines."""
    with sync_playwright() as play:
        browser = play.chromium.launch(executable_path="/usr/bin/chromium", args=CHROMIUM)
        page = browser.new_page(viewport={"width": 1440, "height": 900})
        page.goto(ADDRESS)
        search = page.locator("input.find").first
        search.wait_for(timeout=60_000)
        search.fill("said:left margin<1 sort:margin")
        search.press("Enter")
        server.terminate()
        said = server.communicate(timeout=20)[0].decode()
        browser.close()
    assert all(line.startswith("spatialviz:") for line in said.splitlines()), said


def drive() -> dict:
    with sync_playwright() as play:
        browser = play.chromium.launch(executable_path="/usr/bin/chromium", args=CHROMIUM)
        page = browser.new_page(viewport={"width": 1440, "height": 900})
        problems: list[str] = []
        page.on("pageerror", lambda error: problems.append(str(error)))
        page.goto(ADDRESS)
        page.get_by_text("Ranked pairs").wait_for(timeout=60_000)
        field = page.locator("form input").first
        same_as_the_command_line(page, field.input_value())
        field.fill("laptop right of the mug")
        field.press("Enter")
        page.locator(".sv .big", has_text="right of").wait_for(timeout=30_000)
        rows = page.locator(".sv tr.r").count()
        page.locator(".sv .bar", has_text="left of").first.click()
        page.locator(".sv .big", has_text="left of").wait_for(timeout=30_000)
        up_is_what_is_clicked(page)
        field.fill("<img src=x onerror=alert(1)> left of the mug")
        field.press("Enter")
        page.locator(".sv .note").first.wait_for(timeout=30_000)
        other = browser.new_page(viewport={"width": 1440, "height": 900})
        other.add_init_script(f"window.frameOf = {FRAME_OF}")
        other.goto(ADDRESS)
        other.get_by_text("Ranked pairs").wait_for(timeout=60_000)
        before = frame_of(page)
        other.keyboard.press("n")
        other.wait_for_function("before => window.frameOf() !== before", arg=before, timeout=30_000)
        assert frame_of(page) == before, "one client's frame moved another's"
        moved = frame_of(other)
        kept = "moved => (sessionStorage.getItem('sv') || '').includes(moved)"
        other.wait_for_function(kept, arg=moved, timeout=30_000)
        other.reload()
        other.wait_for_function("moved => window.frameOf() === moved", arg=moved, timeout=30_000)
        browser.close()
        assert not problems, problems
        return {"rows": rows}


def main() -> None:
    start = time.monotonic()
    server = subprocess.Popen(
        [sys.executable, "-m", "spatialviz", "view", "--port", str(PORT), "--no-open-browser"],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
    )
    try:
        served = wait_until_served(start)
        evil = asyncio.run(status_for("http://evil.example"))
        own = asyncio.run(status_for(ADDRESS))
        assert evil == 403, f"a foreign page may connect: {evil}"
        assert own == 101, f"the own page may not connect: {own}"
        report = drive() | {"served_s": round(served, 2), "memory_mb": round(memory_mb(server.pid))}
        ends_quietly(server)
        print(json.dumps(report))
    finally:
        server.terminate()
        server.wait(timeout=20)


if __name__ == "__main__":
    main()
