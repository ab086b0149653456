"""The page by keys alone: Tab reaches every control as one reads, arrows choose, Escape leaves."""

from browser import OpenTab
from servers import Server

READ = """area => {
  const stops = [...document.querySelectorAll(`${area} :is(button, input, select, summary, [tabindex="0"])`)]
    .filter(e => e.checkVisibility({visibilityProperty: true}) && e.tabIndex >= 0)
    .map(e => [e.getBoundingClientRect(), e.textContent.slice(0, 30) || e.id, e.closest('.pair-card')]);
  return stops.slice(1).flatMap(([b, name, card], k) => {
    // A card is read to its end before the one beside it.
    if (card && stops[k][2] && card !== stops[k][2]) return [];
    const [a, before] = stops[k], beside = b.top < a.bottom - 4 && a.top < b.bottom - 4;
    return b.bottom <= a.top + 1 || (beside && b.right <= a.left) ? [`${before} -> ${name}`] : [];
  });
}"""
FOCUSED = """() => {
  const e = document.activeElement, s = getComputedStyle(e), b = e.getBoundingClientRect();
  return {tag: e.tagName, name: e.id || e.dataset.do || e.dataset.local || e.textContent.slice(0, 30),
    ring: parseFloat(s.outlineWidth) > 0 && s.outlineStyle !== 'none',
    area: e.closest('header, aside, #stage')?.id || '',
    seen: b.width > 0 && b.bottom > 0 && b.top < innerHeight};
}"""
REACHED = """() => [...document.querySelectorAll(
    'a[href], button, input, select, textarea, summary, [data-do], [data-local]')]
  .filter(e => e.checkVisibility({visibilityProperty: true}) && !e.disabled && e.tabIndex >= 0
    && e.getAttribute('role') !== 'option')
  .map(e => e.id || e.dataset.do || e.dataset.local || e.textContent.slice(0, 30))"""


def test_tab_reaches_every_control(demo: Server, open_tab: OpenTab) -> None:
    """Bar, side, stage, with a ring that is seen."""
    tab = open_tab(demo.address)
    tab.page.evaluate("document.activeElement.blur()")
    wanted, seen, areas = set(tab.page.evaluate(REACHED)), [], []
    for _ in range(len(wanted) + 200):
        tab.page.keyboard.press("Tab")
        now = tab.page.evaluate(FOCUSED)
        if now["tag"] == "BODY":
            break
        seen.append(now["name"])
        if now["tag"] == "IFRAME":
            continue
        assert now["ring"], f"no ring around {now}"
        assert now["seen"], f"not in view: {now}"
        areas += [now["area"]] if not areas or areas[-1] != now["area"] else []
        if wanted <= set(seen):
            break
    assert wanted <= set(seen), sorted(wanted - set(seen))
    assert areas[:3] == ["bar", "side", "stage"], areas


def test_a_question_is_completed_as_it_is_typed(demo: Server, open_tab: OpenTab) -> None:
    tab = open_tab(demo.address, "absent")
    tab.press("/")
    field = tab.page.locator("#ask-text")
    field.fill("")
    for text, offered in (("lap", "laptop"), ("rig", "right of"), ("the m", "mug")):
        tab.page.keyboard.type(text)
        tab.see("#suggested .offer", offered)
        # What was offered for fewer letters goes.
        tab.still("document.getElementById('suggested').textContent")
        for _ in range(10):
            tab.page.keyboard.press("ArrowDown")
            if tab.page.locator("#suggested [aria-selected=true] b").inner_text() == offered:
                break
        tab.page.keyboard.press("Enter")
        assert field.input_value().endswith(f"{offered} "), field.input_value()
    tab.page.keyboard.press("Enter")
    tab.answers("laptop", "mug")
    tab.press("/")
    tab.page.keyboard.press("Escape")
    tab.poll("document.activeElement.tagName === 'BODY'")


def test_a_field_is_left_by_enter(reviewed: Server, open_tab: OpenTab) -> None:
    """Whatever is typed in: the keys after it are the page's."""
    tab = open_tab(reviewed.address, "absent")
    left = "document.activeElement.tagName === 'BODY'"
    tab.click("task:label")
    author = tab.see("#review-head input")
    author.fill("bob")
    author.press("Enter")
    tab.poll(left)
    tab.page.keyboard.type("jk")
    assert author.input_value() == "bob"
    frame = tab.frame
    for task, field, said in (("evaluate", "#search input", "said:left"), ("explain", "#timeline .frame-id", frame)):
        tab.click(f"task:{task}")
        tab.see(field).fill(said)
        tab.see(field).press("Enter")
        tab.poll(left)
    tab.ask("laptop right of the mug")
    tab.answers("laptop", "mug")
    tab.poll(left)
    tab.drawer("Edit")
    number = tab.see("#edit input[type=number]")
    number.fill("0.5")
    number.press("Enter")
    tab.poll(left)


def test_a_new_class_is_asked_about_where_it_is_typed(reviewed: Server, open_tab: OpenTab) -> None:
    """The first Enter leaves nothing undone: the field comes back, with the question."""
    tab = open_tab(f"{reviewed.address}/?mode=label", "absent")
    tab.click("queue-kind:object")
    tab.press("j")
    tab.press("Shift+O")
    tab.poll("document.activeElement.dataset.field === 'class'")
    tab.page.keyboard.type("gizmo")
    tab.page.keyboard.press("Enter")
    tab.see("#suggested", "Enter again makes it one")
    assert tab.page.evaluate("[document.activeElement.dataset.field, document.activeElement.value]") == [
        "class",
        "gizmo",
    ]
    tab.page.keyboard.press("Escape")
    tab.page.keyboard.press("Escape")


def test_keys_are_searched_at_once(demo: Server, open_tab: OpenTab) -> None:
    """What is typed after ? finds a command, and Enter does it."""
    tab = open_tab(demo.address, "absent")
    tab.press("?")
    tab.see("#dialog-window")
    tab.page.keyboard.type("all frames")
    tab.page.keyboard.press("Enter")
    tab.see("#frame-grid .shot")
    tab.page.keyboard.press("Escape")


def test_handles_go_with_their_tab(demo: Server, open_tab: OpenTab) -> None:
    """And the key that shows them opens it."""
    tab = open_tab(demo.address).drawn()
    tab.press("Shift+E")
    tab.see("#drawer-tabs [data-name=Edit][aria-selected=true]")
    shown = (
        "(() => { const node = document.getElementById('view').contentWindow.__viserMutable"
        ".nodeRefFromName['/edit/gizmo']; return !!node && node.visible; })()"
    )
    tab.poll(shown)
    tab.drawer("Objects")
    tab.poll(f"!{shown}")


def test_keys_go_as_one_reads(demo: Server, open_tab: OpenTab) -> None:
    """And out of the scene; arrows choose; Escape closes whatever is open, where one was."""
    tab = open_tab(demo.address)
    page = tab.page
    for area in ("#bar", "#side", "#scene-tools", "#scene-buttons", "#timeline"):
        assert not page.evaluate(READ, area), (area, page.evaluate(READ, area))
    page.evaluate("document.getElementById('view').focus()")
    page.keyboard.press("Tab")
    page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement.tagName") != "IFRAME", "no way out of the scene"
    tab.drawer("Objects")
    page.locator('#drawer-tabs [data-name="Objects"]').focus()
    page.keyboard.press("ArrowRight")
    assert page.evaluate("document.activeElement.dataset.name") == "Edit"
    assert page.locator('#drawer-tabs [data-name="Edit"]').get_attribute("aria-selected") == "true"
    page.keyboard.press("Escape")
    tab.poll("document.getElementById('drawer').classList.contains('closed')")
    page.locator('.menu>summary[aria-label="More"]').focus()
    page.keyboard.press("Enter")
    tab.see(".menu[open]")
    page.keyboard.press("Tab")
    page.keyboard.press("Escape")
    assert not page.locator(".menu[open]").count()
    assert page.evaluate("document.activeElement.tagName") == "SUMMARY"
    page.keyboard.press("h")
    tab.see("#dialog-window")
    page.keyboard.press("Escape")
    tab.closed()
    assert page.evaluate("document.activeElement.tagName") == "SUMMARY", "the focus is not where it was"
