"""A correction session in a real browser: what is done to the labels is what their journal tells, a reload included."""

import json
import shutil
import subprocess
import sys
import tempfile
import time
import urllib.request
from pathlib import Path

from playwright.sync_api import Page, sync_playwright

PORT = 8232
ADDRESS = f"http://127.0.0.1:{PORT}"
CHROMIUM = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
FRAME, MUG, LAPTOP = "000001/000000", 3, 2
SLOW = 60_000


def wait_until_served() -> None:
    for _ in range(600):
        try:
            with urllib.request.urlopen(ADDRESS, timeout=1):
                return
        except OSError:
            time.sleep(0.05)
    raise SystemExit("the page was not served")


def line(page: Page, relation: str):
    """The row of a relation of the chosen pair."""
    return page.locator(".sv .lab", has=page.get_by_text(relation, exact=True))


def state(page: Page, relation: str) -> str:
    return line(page, relation).locator(".tuf .on").inner_text()


def show_pair(page: Page) -> None:
    page.evaluate("svTab('Review')")
    page.evaluate(f"sv('labels-at:{MUG},{LAPTOP},left,{FRAME}')")
    line(page, "left of").wait_for(timeout=SLOW)


def saved(page: Page, words: str) -> None:
    page.locator(".sv .note:visible", has_text=words).first.wait_for(timeout=SLOW)


def drive() -> tuple[str, str]:
    with sync_playwright() as play:
        browser = play.chromium.launch(executable_path="/usr/bin/chromium", args=CHROMIUM)
        page = browser.new_page(viewport={"width": 1440, "height": 900})
        problems: list[str] = []
        page.on("pageerror", lambda error: problems.append(str(error)))
        page.goto(ADDRESS)
        page.get_by_text("Ranked pairs").wait_for(timeout=SLOW)
        show_pair(page)
        page.evaluate("svTab('Edit')")
        name = page.locator(".sv input[aria-label=Class]")
        name.wait_for(timeout=SLOW)
        name.fill("bottle")
        name.press("Enter")
        saved(page, "mug → bottle")
        width = page.locator(".sv label.field[title^='width'] input")
        width.fill("0.20")
        width.press("Enter")
        saved(page, "3D box of bottle")
        before = state(page, "left of")
        flipped = {"T": "F", "F": "T", "U": "T"}[before]
        # A key goes to the page only where no field is being typed into.
        page.evaluate("document.activeElement.blur()")
        page.keyboard.press(flipped.lower())
        page.wait_for_function("s => document.querySelector('.sv .lab .tuf .on').textContent === s", arg=flipped)
        page.keyboard.press("Control+z")
        page.wait_for_function("s => document.querySelector('.sv .lab .tuf .on').textContent === s", arg=before)
        page.keyboard.press("Control+y")
        page.wait_for_function("s => document.querySelector('.sv .lab .tuf .on').textContent === s", arg=flipped)
        page.reload()
        page.get_by_text("Ranked pairs").wait_for(timeout=SLOW)
        show_pair(page)
        assert state(page, "left of") == flipped
        assert line(page, "left of").get_by_text("by hand").count() == 1
        assert page.locator(".sv .h b", has_text=f"bottle·{MUG}").count()
        browser.close()
        assert not problems, problems
        return before, flipped


def told(labels: Path, journal: Path) -> list[dict]:
    command = [sys.executable, "-m", "spatialviz", "journal", str(labels), "--journal", str(journal), "--json"]
    out = subprocess.run(command, capture_output=True, check=True, text=True).stdout
    return [json.loads(entry) for entry in out.splitlines()]


def main() -> None:
    demo = Path(__file__).parents[1] / "assets" / "demo_run" / "labels"
    folder = Path(tempfile.mkdtemp())
    journal = folder / "journal.sqlite"
    server = subprocess.Popen(
        [sys.executable, "-m", "spatialviz", "view", "demo", "--labels", str(demo), "--journal", str(journal),
         "--author", "ann", "--port", str(PORT), "--no-open-browser"],
        stdout=subprocess.DEVNULL,
    )  # fmt: skip
    try:
        wait_until_served()
        before, flipped = drive()
        number = {"T": 1, "U": 0, "F": -1}
        story = [(e["action"], e["key"], e["field"], e["after"]) for e in told(demo, journal) if e["field"] != "box"]
        pair, mirror = f"{MUG},{LAPTOP}", f"{LAPTOP},{MUG}"
        wanted = [("edit", str(MUG), "label", "bottle")]
        for action, after in (("edit", flipped), ("undo", before), ("redo", flipped)):
            wanted += [(action, pair, "left", number[after]), (action, mirror, "right", number[after])]
        assert story == wanted, (story, wanted)
        (box,) = (e for e in told(demo, journal) if e["field"] == "box")
        assert (box["action"], box["key"], box["id"]) == ("edit", str(MUG), 2), box
        assert abs(box["after"]["size"][0] - 0.20) < 1e-6, box["after"]
        assert {e["author"] for e in told(demo, journal)} == {"ann"}
        print(json.dumps({"events": len(wanted) + 1, "flipped": f"{before} -> {flipped}"}))
    finally:
        server.terminate()
        server.wait(timeout=20)
        shutil.rmtree(folder)


if __name__ == "__main__":
    main()
