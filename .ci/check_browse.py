"""The strip and the grid of frames in a real browser: what they list, scrubbing, keys, marks, cameras from above."""

import json
import math
import os
import tempfile
import time
from pathlib import Path

import cv2
import numpy as np
from browser import Server, Tab, chromium, new_tab

MANY = 5000
"""Frames of the long recording."""
SHOTS = "#shot-list .shot"


def strip_works(tab: Tab) -> None:
    """Marks stand, a drag passes frames by without opening them, the one where it ends is opened."""
    tab.poll(f"[...document.querySelectorAll('{SHOTS} img[src]')].some(i => i.complete && i.naturalWidth > 0)")
    assert tab.page.locator(f"{SHOTS} .tally").count() > 3
    before = tab.frame
    box = tab.page.locator("#shot-3").bounding_box()
    assert box is not None
    tab.page.mouse.move(box["x"] + 20, box["y"] + 20)
    tab.page.mouse.down()
    tab.page.mouse.move(box["x"] + 20 + box["width"], box["y"] + 20, steps=6)
    tab.see(".passing figcaption", "5 of 12")
    assert tab.frame == before, "a frame that is passed by is not opened"
    tab.page.mouse.up()
    tab.poll("before => document.querySelector('#where .frame-id').value !== before", before)
    tab.poll("document.getElementById('shot-4').getAttribute('aria-selected') === 'true'")
    assert not tab.page.locator(".passing:visible").count()


def grid_works(tab: Tab) -> None:
    """By keys alone: open the grid, go to another picture, open it; Escape leaves it as it was."""
    before = tab.frame
    tab.press("Shift+W")
    tab.see("#frame-grid .shot")
    tab.page.keyboard.press("Escape")
    tab.poll("document.getElementById('frame-grid').hidden")
    assert tab.frame == before
    tab.press("Shift+W")
    tab.see("#frame-grid .shot")
    tab.page.keyboard.press("Home")
    tab.page.keyboard.press("ArrowRight")
    tab.poll("document.getElementById('grid-1')?.querySelector('img').src")
    tab.page.keyboard.press("Enter")
    tab.poll("document.getElementById('frame-grid').hidden")
    tab.poll("document.getElementById('shot-1').getAttribute('aria-selected') === 'true'")


def cameras_work(tab: Tab) -> None:
    """A click on a camera of the plan opens its frame."""
    tab.see("#strip .plan .camera")
    # The plan follows the frame a little later, and is then drawn anew.
    tab.poll(
        "document.querySelector('#strip .camera.here title')?.textContent"
        " === document.querySelector('#where .frame-id').value"
    )
    other = tab.page.locator("#strip .camera:not(.here)").first
    name = other.locator("title").text_content()
    box = other.bounding_box()
    assert box is not None
    other.locator("circle").click(force=True)
    tab.poll("name => document.querySelector('#where .frame-id').value === name", name)


def choices_work(tab: Tab) -> None:
    """Frames with failures alone; none that is all right says so; in Label the marks are of the review."""
    tab.click("frames-of:right")
    tab.poll("document.querySelector('#shot-list').dataset.empty.includes('all right')")
    tab.click("frames-of:failed")
    tab.poll("document.querySelectorAll('#shot-list .shot').length > 0")
    tab.click("task:label")
    tab.see('#strip [data-do="frames-of:open"]')
    tab.poll("[...document.querySelectorAll('#shot-list .shot')].some(s => s.title.includes('open'))")


def long_recording(folder: Path) -> Path:
    """Many frames of a camera that goes round in a circle; all share the pixels of two files."""
    color, depth = folder / "color", folder / "depth"
    for made in (color, depth):
        made.mkdir(parents=True)
    rng = np.random.default_rng(0)
    cv2.imwrite(str(folder / "c.png"), rng.integers(0, 255, (48, 64, 3), np.uint8))
    cv2.imwrite(str(folder / "d.png"), np.full((48, 64), 1500, np.uint16))
    poses = []
    for k in range(MANY):
        os.link(folder / "c.png", color / f"{k:06d}.png")
        os.link(folder / "d.png", depth / f"{k:06d}.png")
        a = 2 * math.pi * k / MANY
        poses.append(f"{math.cos(a):.5f} {math.sin(a):.5f} 1 0 0 0 1")
    (folder / "pose.txt").write_text("\n".join(poses) + "\n")
    return folder


def long_works(tab: Tab, address: str) -> float:
    """Few elements stand for many frames, wherever one scrolls; seconds from a far jump to its pictures."""
    tab.page.goto(address)
    tab.see(SHOTS)
    assert "5,000 frames" in (tab.page.locator(".strip-head").text_content() or "")
    start = time.monotonic()
    tab.page.evaluate("document.getElementById('shot-list').scrollLeft = 1e9")
    tab.poll(f"document.getElementById('shot-{MANY - 1}')?.querySelector('img').naturalWidth > 0")
    took = time.monotonic() - start
    assert tab.page.locator(SHOTS).count() < 40
    tab.page.locator("#shot-list").focus()
    tab.page.keyboard.press("End")
    tab.page.keyboard.press("Enter")
    tab.poll("document.querySelector('#where .frame-id').value.endsWith('4999')")
    tab.press("Shift+W")
    tab.poll("document.querySelectorAll('#frame-grid .shot').length > 5")
    assert tab.page.locator("#frame-grid .shot").count() < 60
    tab.page.keyboard.press("Escape")
    return took


def main() -> None:
    with Server() as server, chromium() as browser:
        tab = new_tab(browser).open(server.address)
        strip_works(tab)
        grid_works(tab)
        cameras_work(tab)
        choices_work(tab)
        assert not tab.problems, tab.problems
    with tempfile.TemporaryDirectory() as folder:
        words = (long_recording(Path(folder)), "--intrinsics", "60,60,32,24", "--depth-scale", "1000")
        with Server(*words) as server, chromium() as browser:
            tab = new_tab(browser)
            took = long_works(tab, server.address)
            assert not tab.problems, tab.problems
    with tempfile.TemporaryDirectory() as folder:
        alone = Path(folder)
        for kind, picture in (
            ("color", np.zeros((48, 64, 3), np.uint8)),
            ("depth", np.full((48, 64), 1500, np.uint16)),
        ):
            (alone / kind).mkdir()
            cv2.imwrite(str(alone / kind / "0.png"), picture)
        with Server(alone, "--intrinsics", "60,60,32,24", "--depth-scale", "1000") as server, chromium() as browser:
            tab = new_tab(browser)
            tab.page.goto(server.address)
            tab.see("#where")
            tab.drawn()
            assert tab.page.locator("#strip").is_hidden(), "one frame needs no strip"
            assert not tab.problems, tab.problems
    print(json.dumps({"far_jump_s": round(took, 2)}))


if __name__ == "__main__":
    main()
