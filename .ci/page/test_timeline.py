"""The timeline and the grid of frames: hover, scrubbing, keys, failures, the id of the frame, cameras from above."""

from browser import OpenTab, Tab
from recordings import LONG
from servers import Server

BAR = "#frame-bar"
HERE = "+document.getElementById('frame-bar').getAttribute('aria-valuenow')"


def across(tab: Tab, share: float) -> tuple[float, float]:
    """A point of the bar."""
    box = tab.see(BAR).bounding_box()
    assert box is not None
    return box["x"] + share * box["width"], box["y"] + box["height"] / 2


def color(tab: Tab, share: float) -> list[int]:
    """Colour at the foot of the bar: of what is wrong, open or missing."""
    return tab.page.evaluate(
        """share => { const c = document.querySelector('#frame-bar canvas');
        return [...c.getContext('2d').getImageData(Math.floor(share * c.width), c.height - 2, 1, 1).data]; }""",
        share,
    )


def test_a_drag_passes_frames_by(demo: Server, open_tab: OpenTab) -> None:
    """Hover shows a frame with its counts; frames passed by are not opened, the one where the drag ends is."""
    tab = open_tab(demo.address, "absent")
    before = tab.frame
    tab.page.mouse.move(*across(tab, 3.5 / 12))
    tab.see(".passing figcaption", "of 150 wrong")
    tab.see(".passing figcaption", "frame 4 of 12")
    tab.poll("document.querySelector('.passing img').naturalWidth > 0")
    tab.page.mouse.down()
    tab.page.mouse.move(*across(tab, 4.5 / 12), steps=6)
    tab.see(".passing figcaption", "frame 5 of 12")
    assert tab.frame == before, "a frame that is passed by is not opened"
    tab.page.mouse.up()
    tab.other_frame(before)
    tab.poll(f"{HERE} === 5")
    tab.page.mouse.move(300, 300)
    tab.poll("document.querySelector('.passing').hidden")


def test_what_is_open_is_not_red(demo: Server, open_tab: OpenTab) -> None:
    """Wrong answers are; items that nobody has looked at are amber, and are stepped through."""
    tab = open_tab(demo.address, "absent")
    tab.see("#timeline[data-kind=wrong] .legend", "wrong")
    red, green, _, _ = color(tab, 1 / 24)
    assert red > 2 * green
    tab.click("task:label")
    tab.see("#timeline[data-kind=open] .legend", "open")
    red, green, _, _ = color(tab, 1 / 24)
    assert red < 2 * green
    tab.see("#timeline", "1 of 12 with open items")
    tab.click("next-open:1")
    tab.see("#timeline", "2 of 12 with open items")
    tab.poll(f"{HERE} === 2")


def test_failures_are_stepped_through_from_where_one_is(demo: Server, open_tab: OpenTab) -> None:
    """Of the list of Evaluate; another search says so."""
    tab = open_tab(demo.address, "absent")
    tab.see("#timeline", "Failure 1 of 505")
    tab.click("next-failure:1")
    tab.see("#timeline", "Failure 2 of 505")
    tab.see(BAR).focus()
    tab.page.keyboard.press("End")
    tab.poll(f"{HERE} === 12")
    tab.poll("document.querySelector('#timeline .frame-id')?.value === '000004/000002'")
    tab.press(".")
    tab.poll("/^Failure (4[89]|50)/.test(document.querySelector('#frame-steps b').textContent)")
    assert tab.frame == "000004/000002"
    tab.click("task:evaluate")
    tab.page.locator("#search input").fill("relation:behind")
    tab.page.locator("#search input").press("Enter")
    tab.press("k")
    tab.click("task:explain")
    tab.poll("/ found$/.test(document.querySelector('#frame-steps b').textContent)")


def test_the_bar_by_keys_alone(demo: Server, open_tab: OpenTab) -> None:
    """Keys go on at once; what they rest on is opened. Escape stays."""
    tab = open_tab(demo.address, "absent")
    before = tab.frame
    tab.see(BAR).focus()
    for key, now in (("End", 12), ("Home", 1), ("PageUp", 11), ("ArrowLeft", 10), ("ArrowDown", 9), ("ArrowUp", 10)):
        tab.page.keyboard.press(key)
        assert tab.page.evaluate(HERE) == now
    tab.page.keyboard.press("Escape")
    tab.poll(f"{HERE} === 1")
    assert tab.frame == before
    tab.page.keyboard.press("ArrowRight")
    tab.poll("/^frame 2 of 12, 00.*wrong$/.test(document.getElementById('frame-bar').getAttribute('aria-valuetext'))")
    tab.other_frame(before)


def test_an_id_is_typed(demo: Server, open_tab: OpenTab) -> None:
    """Ids that contain what is typed are offered."""
    tab = open_tab(demo.address, "absent")
    field = tab.page.locator("#timeline .frame-id")
    field.click()
    tab.poll("document.querySelectorAll('#frame-ids option').length === 12")
    tab.page.keyboard.type("3/000002")
    tab.poll("document.querySelectorAll('#frame-ids option').length === 1")
    field.fill("000003/000002")
    tab.page.keyboard.press("Enter")
    tab.poll(f"{HERE} === 9")


def test_the_grid_by_keys_alone(demo: Server, open_tab: OpenTab) -> None:
    """Open the grid, go to another picture, open it; Escape leaves it as it was."""
    tab = open_tab(demo.address, "absent")
    first = tab.frame
    tab.press("n")
    before = tab.other_frame(first)
    tab.press("Shift+W")
    tab.see("#frame-grid .shot")
    tab.page.keyboard.press("Escape")
    tab.poll("document.getElementById('frame-grid').hidden")
    assert tab.frame == before
    tab.press("Shift+W")
    tab.poll("document.activeElement.id === 'grid-list'")
    tab.page.keyboard.press("End")
    tab.page.keyboard.press("ArrowLeft")
    tab.poll("document.getElementById('grid-10')?.querySelector('img').src")
    tab.page.keyboard.press("Enter")
    tab.poll("document.getElementById('frame-grid').hidden")
    tab.poll(f"{HERE} === 11")


def test_a_picture_that_is_gone_to_stays_in_sight_as_the_plan_comes(demo: Server, open_tab: OpenTab) -> None:
    """The plan takes some of the width: the pictures stand in more rows then."""
    tab = open_tab(demo.address, "absent")
    later = "m => { const plan = m.calls.plan; m.calls.plan = data => setTimeout(() => plan(data), 700); }"
    tab.page.evaluate(f"import('/app/core.mjs').then({later})")
    tab.press("Shift+W")
    tab.poll("document.activeElement.id === 'grid-list'")
    tab.page.keyboard.press("End")
    tab.see("#frame-grid .plan svg")
    tab.poll("document.getElementById('grid-11')?.querySelector('img').src")


def test_a_camera_of_the_plan_opens_its_frame(demo: Server, open_tab: OpenTab) -> None:
    tab = open_tab(demo.address, "absent")
    tab.press("Shift+W")
    other = tab.see("#frame-grid .plan .camera:not(.here)")
    name = other.locator("title").text_content()
    other.locator("circle").click(force=True)
    tab.poll("name => document.querySelector('#timeline .frame-id')?.value === name", name)


def test_a_choice_of_frames(demo: Server, open_tab: OpenTab) -> None:
    """Frames with failures alone; none that is all correct says so; in Label the counts are of the review."""
    tab = open_tab(demo.address, "absent")
    tab.press("Shift+W")
    tab.see("[data-local='framesOf:all correct']").click()
    tab.poll("document.querySelector('#grid-list').dataset.empty.includes('all correct')")
    tab.see("[data-local='framesOf:with failures']").click()
    tab.see("#frame-grid .shot .foot", "of 150 wrong")
    tab.page.keyboard.press("Escape")
    tab.click("task:label")
    tab.see("#timeline[data-kind=open]")
    tab.page.locator("[data-local=frames]").evaluate("e => e.click()")
    tab.see("#frame-grid .shot .foot", "open")
    tab.page.keyboard.press("Escape")


def test_many_frames(long: Server, open_tab: OpenTab) -> None:
    """Few elements stand for 5,000 frames, of which a column holds several; without a run they are of the depth."""
    tab = open_tab(scene="absent")
    tab.page.goto(long.address)
    tab.see("#timeline[data-kind=depth]", f"Frame 1 of {LONG:,}")
    tab.see("#timeline .legend", "of the depth missing")
    tab.page.mouse.move(*across(tab, 0.5))
    tab.see(".passing figcaption", "the highest of")
    tab.page.mouse.move(300, 300)
    tab.see(BAR).focus()
    tab.page.keyboard.press("End")
    tab.page.keyboard.press("Enter")
    tab.poll("document.querySelector('#timeline .frame-id')?.value.endsWith('4999')")
    tab.press("Shift+W")
    tab.poll("document.querySelectorAll('#frame-grid .shot').length > 5")
    assert tab.page.locator("#frame-grid .shot").count() < 60
    tab.page.keyboard.press("Escape")


def test_one_frame_needs_no_timeline(single: Server, open_tab: OpenTab) -> None:
    tab = open_tab()
    tab.page.goto(single.address)
    tab.see("#where")
    tab.drawn()
    assert tab.page.locator("#timeline").is_hidden()
