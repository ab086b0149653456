"""Smoke check of the page: served in time, closed to foreign pages, and answering in a real browser."""

import asyncio
import json
import subprocess
import sys
from pathlib import Path

import websockets
from browser import Server, Tab, chromium, new_tab

from pipeline.answering.json_records import probability

SERVED_WITHIN = 10.0
ROW = '#stages tr[data-do^="pair:"]'


async def status_for(port: int, origin: str) -> int:
    try:
        async with websockets.connect(f"ws://127.0.0.1:{port}/app/socket?id={'0' * 32}", origin=origin):
            return 101
    except websockets.exceptions.InvalidStatus as refused:
        return refused.response.status_code


def memory_mb(pid: int) -> float:
    for line in Path(f"/proc/{pid}/status").read_text().splitlines():
        if line.startswith("VmRSS"):
            return int(line.split()[1]) / 1024
    return 0.0


def same_as_the_command_line(tab: Tab) -> None:
    """The first page shows a failure of the demo's run; what it says is what the command line says."""
    chip = tab.see("#verdict")
    run = Path(__file__).parents[1] / "assets" / "demo_run"
    asked = subprocess.run(
        [sys.executable, "-m", "spatialviz", "ask", "demo", tab.frame, tab.question, "--detector", "simulated",
         "--model", run / "simulated.toml", "--min-score", "0.015", "--k", "5", "--labels", run / "labels", "--json"],
        capture_output=True, check=False, text=True,
    )  # fmt: skip
    said = json.loads(asked.stdout)
    assert asked.returncode == (0 if said["answer"]["holds"] else 1), asked
    assert said["verdict"]["verdict"] != "CORRECT", said["verdict"]
    assert chip.inner_text().startswith(said["verdict"]["verdict"]), (chip.inner_text(), said["verdict"])
    sentence = tab.see("#side .sentence").inner_text()
    assert sentence.endswith(said["verdict"]["said"]), (sentence, said["verdict"])
    heads = tab.page.locator("#answer .heads b").all_inner_texts()
    wanted = [probability(said["answer"][k]) for k in ("relation_probability", "product")]
    assert heads == wanted, (heads, said["answer"])


def up_is_what_is_clicked(tab: Tab) -> None:
    """A click names a level surface; what was declared comes back."""
    chip = tab.see("#answer .upchip")
    assert chip.inner_text() == "up declared", chip.inner_text()
    chip.click()
    tab.see("#answer .note", "level surface")
    picture = tab.see("#image [data-point]")
    box = picture.bounding_box()
    assert box is not None
    picture.click(position={"x": 0.1 * box["width"], "y": 0.95 * box["height"]})
    tab.see("#answer .upchip", "given")
    tab.see("#answer .uptold [data-do=level-back]").click()
    tab.see("#answer .upchip", "declared")


def drive(address: str) -> dict:
    with chromium() as browser:
        tab = new_tab(browser).open(address)
        same_as_the_command_line(tab)
        tab.drawn()
        tab.ask("laptop right of the mug")
        tab.see("#answer .names", "right of")
        tab.click("stage:PRM")
        tab.see(ROW)
        rows = tab.page.locator(ROW).count()
        tab.click("stage:SRM")
        tab.see('#stages [data-do^="relation:"]', "left of").click()
        tab.see("#answer .names", "left of")
        up_is_what_is_clicked(tab)
        hostile = "<img src=x onerror=alert(1)> left of the mug"
        tab.ask(hostile)
        tab.see("#side", "cannot be read; got '<'")
        assert tab.question == hostile, tab.question
        tab.poll("hostile => document.getElementById('log').textContent.includes(hostile)", hostile)
        assert not tab.page.locator("[onerror]").count()
        other = new_tab(browser).open(address)
        before = tab.frame
        assert other.frame == before
        other.press("n")
        other.poll("before => document.querySelector('#where .frame-id').value !== before", before)
        moved = other.frame
        assert tab.frame == before, "one client's frame moved another's"
        other.poll("moved => location.search.includes(moved)", moved)
        other.page.reload()
        other.words()
        assert other.frame == moved, (other.frame, moved)
        assert not tab.problems + other.problems, tab.problems + other.problems
        return {"rows": rows}


def ends_quietly(server: Server) -> None:
    """Stopped while a client still searches, the server says nothing but its own lines."""
    with chromium() as browser:
        tab = new_tab(browser).open(server.address)
        tab.click("task:evaluate")
        search = tab.see("#search input")
        search.fill("said:left margin<1 sort:margin")
        search.press("Enter")
        said = server.end()
    assert all(line.startswith("spatialviz:") for line in said), said


def main() -> None:
    with Server() as server:
        served = server.served(SERVED_WITHIN)
        evil = asyncio.run(status_for(server.port, "http://evil.example"))
        own = asyncio.run(status_for(server.port, server.address))
        assert evil == 403, f"a foreign page may connect: {evil}"
        assert own == 101, f"the own page may not connect: {own}"
        report = drive(server.address) | {"memory_mb": round(memory_mb(server.process.pid))}
        ends_quietly(server)
    print(json.dumps(report | {"served_s": round(served, 2)}))


if __name__ == "__main__":
    main()
