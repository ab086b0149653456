"""Pictures of the documents, taken from the page in Chromium: `python .ci/site/shots.py [--only NAME ...]`.

`shots.toml` says which: the data that is shown, the steps to what a picture shows, and the numbers drawn on it.
Needs playwright and Chromium (`.ci/check` says how), and in DETECTOR a YOLO export with masks, of COCO's names, for the
pictures of a detector. Data is made once, under `--work`.
"""

from __future__ import annotations

import argparse
import io
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable
from itertools import groupby
from pathlib import Path
from typing import Any

from PIL import Image, ImageChops, ImageDraw, ImageFont

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / ".ci" / "page"), str(ROOT)]
from browser import Tab, chromium, new_tab  # noqa: E402
from servers import Server  # noqa: E402

from pipeline.system.reading import parse_toml  # noqa: E402

PICTURES = ROOT / "docs" / "pictures"
MOST_BYTES = 150_000
MARK = "#d6336c"
LASTS = (
    "const soon = setTimeout; window.setTimeout = (f, t, ...a) => soon(f, t > 3900 && t < 20000 ? 60 * t : t, ...a);"
)
"""A note of what was saved, which goes after some seconds, stays until its picture is taken."""
Box = tuple[float, float, float, float]
"""Left, top, right, bottom in pixels of the picture."""


def _click(tab: Tab, text: str) -> None:
    tab.page.get_by_text(text, exact=True).locator("visible=true").first.click()


def _ask(tab: Tab, question: str) -> None:
    tab.ask(question)
    tab.page.wait_for_timeout(1500)


def _fill(tab: Tab, what: list[str]) -> None:
    """A field's selector, its text, and keys to press in it."""
    field = tab.see(what[0])
    field.fill(what[1])
    for key in what[2:]:
        field.press(key)


def _drag(tab: Tab, what: list[Any]) -> None:
    """A selector and two or more points in it, in parts of its width and height."""
    box = tab.see(what[0]).bounding_box()
    assert box is not None
    points = [(box["x"] + u * box["width"], box["y"] + v * box["height"]) for u, v in what[1:]]
    tab.page.mouse.move(*points[0])
    tab.page.mouse.down()
    for x, y in points[1:]:
        tab.page.mouse.move(x, y, steps=6)
    tab.page.mouse.up()


def _point(tab: Tab, what: list[Any]) -> None:
    """A selector and a point in it, in parts of its width and height: a click there."""
    box = tab.see(what[0]).bounding_box()
    assert box is not None
    tab.page.mouse.click(box["x"] + what[1] * box["width"], box["y"] + what[2] * box["height"])


STEPS: dict[str, Callable[[Tab, Any], Any]] = {
    "ask": _ask,  # type a question and press Enter
    "click": _click,  # the first visible element with exactly this text
    "css": lambda tab, what: tab.see(what).click(),  # the first visible element of a selector
    "do": lambda tab, what: tab.click(what),  # the element that sends this command
    "send": lambda tab, what: tab.send(what),  # the command itself, where no element has it now
    "drawer": lambda tab, what: tab.drawer(what),  # Objects, Edit (What if) or Log
    "press": lambda tab, what: tab.press(what),  # a key of the page
    "key": lambda tab, what: tab.page.keyboard.press(what),  # a key of the field that has the focus
    "fill": _fill,
    "drag": _drag,
    "point": _point,
    "hover": lambda tab, what: tab.see(what).hover(),
    "see": lambda tab, what: tab.see(*([what] if isinstance(what, str) else what)),  # a selector, or one with words
    "gone": lambda tab, what: tab.poll("what => !document.querySelector(what)", what),
    "scroll": lambda tab, what: tab.page.locator(what).first.scroll_into_view_if_needed(),
    "wait": lambda tab, what: tab.page.wait_for_timeout(1000 * what),
}
"""Verbs of `steps` in `shots.toml`."""


def box_of(tab: Tab, selectors: Iterable[str], margin: float = 0) -> Box:
    """The box around the first visible element of each selector."""
    found = [b for s in selectors if (b := tab.see(s).bounding_box())]
    return (
        min(b["x"] for b in found) - margin,
        min(b["y"] for b in found) - margin,
        max(b["x"] + b["width"] for b in found) + margin,
        max(b["y"] + b["height"] for b in found) + margin,
    )


def still(tab: Tab, most: float = 60.0) -> Image.Image:
    """A picture of the page once two in a row, half of a second apart, are the same."""
    before: Image.Image | None = None
    for _ in range(int(most / 0.5)):
        now = Image.open(io.BytesIO(tab.page.screenshot(animations="disabled", caret="hide"))).convert("RGB")
        if before is not None and not ImageChops.difference(before, now).getbbox():
            return now
        before = now
        tab.page.wait_for_timeout(500)
    raise AssertionError("the page does not come to rest")


def draw_marks(picture: Image.Image, marks: list[tuple[Box, dict[str, Any]]]) -> None:
    """Frames around parts of the page, with their numbers.

    `side` says at which corner a number stands: two of the letters t, b (top, bottom), l, r; or c, the middle.
    """
    draw = ImageDraw.Draw(picture)
    font = ImageFont.load_default(17)
    for n, (box, mark) in enumerate(marks, 1):
        left, top, right, bottom = box
        left, top = max(left, 2), max(top, 2)
        right, bottom = min(right, picture.width - 3), min(bottom, picture.height - 3)
        if mark.get("frame", True):
            draw.rounded_rectangle((left, top, right, bottom), 6, outline=MARK, width=2)
        side = mark.get("side", "tl")
        x = right if "r" in side else left if "l" in side else (left + right) / 2
        y = bottom if "b" in side else top if "t" in side else (top + bottom) / 2
        x, y = min(max(x, 15), picture.width - 16), min(max(y, 15), picture.height - 16)
        draw.ellipse((x - 13, y - 13, x + 13, y + 13), fill=MARK, outline="white", width=2)
        draw.text((x, y), str(mark.get("text", n)), fill="white", font=font, anchor="mm")


def save(picture: Image.Image, path: Path) -> int:
    """Write a JPEG of the best quality that keeps it small; its bytes."""
    for quality in range(90, 40, -4):
        out = io.BytesIO()
        picture.save(
            out, "JPEG", quality=quality, optimize=True, progressive=True, subsampling=0 if quality > 70 else 2
        )
        if out.tell() <= MOST_BYTES:
            break
    path.write_bytes(out.getvalue())
    return out.tell()


def take(tab: Tab, shot: dict[str, Any], steps: list[dict[str, Any]], address: str) -> Image.Image:
    """The picture of one shot."""
    tab.open(address + shot.get("address", ""))
    if shot.get("scene", True):
        tab.drawn()
        tab.poll("document.getElementById('loading').hidden")
    for step in steps:
        for verb, what in step.items():
            STEPS[verb](tab, what)
    # The pointer leaves what it has clicked, unless it is to stand somewhere.
    if not any("hover" in step for step in steps):
        tab.page.mouse.move(2, 2)
    picture = still(tab)
    marks = [(box_of(tab, [m["at"], *m.get("and", ())], m.get("margin", 2)), m) for m in shot.get("marks", ())]
    draw_marks(picture, marks)
    if "clip" in shot:
        clip = [shot["clip"]] if isinstance(shot["clip"], str) else shot["clip"]
        left, top, right, bottom = box_of(tab, clip, shot.get("clip_margin", 8))
        picture = picture.crop((max(0, left), max(0, top), min(picture.width, right), min(picture.height, bottom)))
    return picture


def shell(line: str) -> str:
    """A command of `shots.toml` for bash: `spatialviz` is this clone's, DETECTOR a model file from the environment."""
    line = line.replace("{root}", str(ROOT)).replace("FILE.onnx", os.environ.get("DETECTOR", "FILE.onnx"))
    return line.replace("spatialviz ", f"{sys.executable} -m spatialviz ")


def prepare(name: str, commands: list[str], work: Path) -> Path:
    """Run the commands that make a folder of data, once; a copy of it, which a server may write to."""
    made, copy = work / name, work / "now"
    done = work / f"{name}.made"
    if not done.exists() or done.read_text() != str(commands):
        shutil.rmtree(made, ignore_errors=True)
        made.mkdir(parents=True)
        for command in commands:
            subprocess.run(["bash", "-ec", shell(command)], cwd=made, check=True, stdout=subprocess.DEVNULL)
        done.write_text(str(commands))
    shutil.rmtree(copy, ignore_errors=True)
    shutil.copytree(made, copy)
    return copy


def server_of(shot: dict[str, Any]) -> tuple[str, str]:
    """The server of a shot, and its name where the server is to be its own."""
    return shot.get("server", "demo"), shot["name"] if shot.get("fresh") else ""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", nargs="*", default=[], help="names of shots, or how these begin")
    parser.add_argument("--out", type=Path, default=PICTURES)
    parser.add_argument("--work", type=Path, default=Path(tempfile.gettempdir()) / "pictures")
    told = parser.parse_args()
    plan = parse_toml((ROOT / ".ci" / "site" / "shots.toml").read_text("utf-8"))
    shots = [s for s in plan["shot"] if not told.only or s["name"].startswith(tuple(told.only))]
    os.environ["PYTHONPATH"] = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    told.out.mkdir(parents=True, exist_ok=True)
    wrong: list[str] = []
    with chromium() as browser:
        for (name, _), of_server in groupby(shots, server_of):
            kind = plan["server"][name]
            data = kind.get("data", "none")
            folder = prepare(data, plan["data"].get(data, []), told.work)
            with Server(*shell(kind.get("view", "")).split(), folder=folder) as server:
                for shot in of_server:
                    size = dict(zip(("width", "height"), shot.get("size", (1440, 900)), strict=True))
                    tab = new_tab(browser, "painted", viewport=size, color_scheme=shot.get("theme", "light"))
                    tab.page.add_init_script(LASTS)
                    steps = [*plan["steps"].get(shot.get("first"), ()), *shot.get("steps", ())]
                    try:
                        picture = take(tab, shot, steps, server.address)
                        print(
                            f"{shot['name']}: {save(picture, told.out / (shot['name'] + '.jpg')):,} bytes", flush=True
                        )
                    except Exception as error:
                        failed = told.work / f"{shot['name']}-failed.png"
                        tab.page.screenshot(path=failed)
                        wrong.append(f"{shot['name']}: {error}\n  what the page showed: {failed}")
                        print(wrong[-1], flush=True)
                    finally:
                        tab.close()
    sys.exit(1 if wrong else 0)


if __name__ == "__main__":
    main()
