"""The strip and the grid of frames: what they list, scrubbing, keys, marks, cameras from above."""

from browser import OpenTab
from recordings import LONG
from servers import Server

SHOTS = "#shot-list .shot"


def test_a_drag_passes_frames_by(demo: Server, open_tab: OpenTab) -> None:
    """Marks stand; frames that are passed are not opened, the one where the drag ends is."""
    tab = open_tab(demo.address, "absent")
    tab.poll(f"[...document.querySelectorAll('{SHOTS} img[src]')].some(i => i.complete && i.naturalWidth > 0)")
    tab.poll(f"document.querySelectorAll('{SHOTS} .tally').length > 3")
    before = tab.frame
    box = tab.page.locator("#shot-3").bounding_box()
    assert box is not None
    tab.page.mouse.move(box["x"] + 20, box["y"] + 20)
    tab.page.mouse.down()
    tab.page.mouse.move(box["x"] + 20 + box["width"], box["y"] + 20, steps=6)
    tab.see(".passing figcaption", "5 of 12")
    assert tab.frame == before, "a frame that is passed by is not opened"
    tab.page.mouse.up()
    tab.other_frame(before)
    tab.poll("document.getElementById('shot-4').getAttribute('aria-selected') === 'true'")
    assert not tab.page.locator(".passing:visible").count()


def test_what_is_open_is_not_red(demo: Server, open_tab: OpenTab) -> None:
    """Wrong answers are; items that nobody has looked at are amber."""
    tab = open_tab(demo.address, "absent")
    color = "(e => e && getComputedStyle(e).backgroundColor)(document.querySelector('#strip .tally i'))"
    fill = "name => { const e = document.body.appendChild(document.createElement('i')); "
    fill += "e.style.background = `var(--${name}-fill)`; return getComputedStyle(e).backgroundColor; }"
    tab.see("#strip .tally i")
    assert tab.page.evaluate(color) == tab.page.evaluate(fill, "bad")
    tab.click("task:label")
    tab.see("#review-list .queue .q")
    tab.poll(f"wanted => {color} === wanted", tab.page.evaluate(fill, "doubt"))


def test_the_grid_by_keys_alone(demo: Server, open_tab: OpenTab) -> None:
    """Open the grid, go to another picture, open it; Escape leaves it as it was."""
    tab = open_tab(demo.address, "absent")
    tab.press("n")
    before = tab.still("document.querySelector('#where .frame-id').value")
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


def test_a_camera_of_the_plan_opens_its_frame(demo: Server, open_tab: OpenTab) -> None:
    tab = open_tab(demo.address, "absent")
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


def test_a_choice_of_frames(demo: Server, open_tab: OpenTab) -> None:
    """Frames with failures alone; none that is all right says so; in Label the marks are of the review."""
    tab = open_tab(demo.address, "absent")
    tab.click("frames-of:right")
    tab.poll("document.querySelector('#shot-list').dataset.empty.includes('all right')")
    tab.click("frames-of:failed")
    tab.poll("document.querySelectorAll('#shot-list .shot').length > 0")
    tab.click("task:label")
    tab.see('#strip [data-do="frames-of:open"]')
    tab.poll("[...document.querySelectorAll('#shot-list .shot')].some(s => s.title.includes('open'))")


def test_many_frames(long: Server, open_tab: OpenTab) -> None:
    """Few elements stand for 5,000 frames, wherever one scrolls."""
    tab = open_tab(scene="absent")
    tab.page.goto(long.address)
    tab.see(SHOTS)
    assert "5,000 frames" in (tab.page.locator(".strip-head").text_content() or "")
    tab.page.evaluate("document.getElementById('shot-list').scrollLeft = 1e9")
    tab.poll(f"document.getElementById('shot-{LONG - 1}')?.querySelector('img').naturalWidth > 0")
    assert tab.page.locator(SHOTS).count() < 40
    tab.page.locator("#shot-list").focus()
    tab.page.keyboard.press("End")
    tab.page.keyboard.press("Enter")
    tab.poll("document.querySelector('#where .frame-id').value.endsWith('4999')")
    tab.press("Shift+W")
    tab.poll("document.querySelectorAll('#frame-grid .shot').length > 5")
    assert tab.page.locator("#frame-grid .shot").count() < 60
    tab.page.keyboard.press("Escape")


def test_one_frame_needs_no_strip(single: Server, open_tab: OpenTab) -> None:
    tab = open_tab()
    tab.page.goto(single.address)
    tab.see("#where")
    tab.drawn()
    assert tab.page.locator("#strip").is_hidden()
