"""Everybody can use the page: axe-core (WCAG 2.2 AA) in both themes, words that explain themselves, what is announced,
Tab and Escape, a window that is magnified to 200 %, other people's colours, no motion."""

from importlib import resources
from typing import Any

from browser import Server, Tab, Timed, chromium, new_tab
from looks import explained, others
from playwright.sync_api import Browser

AXE = """async rules => {
  const options = {iframes: false, resultTypes: ['violations'],
    ...(rules.length ? {runOnly: rules} : {rules: {'target-size': {enabled: true}}})};
  return (await axe.run({exclude: [['#view']]}, options)).violations;
}"""
# WCAG 2.5.8, also of what is pressed and takes no focus, which axe-core leaves out: a target that is smaller than 24x24
# keeps a circle of 24 to itself.
# Of a bar of shares the width is the figure itself, and its searches stand beside it as chips.
SMALL = """() => {
  const pressed = 'a[href], button, input, select, textarea, summary, [data-do], [data-local]';
  const all = [...document.querySelectorAll(pressed)]
    .filter(e => e.checkVisibility({visibilityProperty: true}) && !e.closest('[inert], .hidden, .stack'))
    .map(e => [e, e.getBoundingClientRect()]).filter(([, b]) => b.width && b.height);
  const small = b => Math.min(b.width, b.height) < 23.5;
  const near = (x, y, b) => small(b) ? Math.hypot(x - b.left - b.width / 2, y - b.top - b.height / 2) < 24
    : Math.hypot(Math.max(b.left - x, 0, x - b.right), Math.max(b.top - y, 0, y - b.bottom)) < 12;
  return all.filter(([, b]) => small(b)).flatMap(([e, b]) => {
    const x = b.left + b.width / 2, y = b.top + b.height / 2;
    const other = all.find(([f, c]) => !e.contains(f) && !f.contains(e) && near(x, y, c));
    const name = f => f.getAttribute('aria-label') || f.textContent.slice(0, 30) || f.id;
    const size = `${b.width | 0}x${b.height | 0} ${e.tagName}`;
    return other ? [`target-size: ${size} "${name(e)}" beside "${name(other[0])}"`] : [];
  });
}"""
SOURCE = (resources.files("axe_playwright_python") / "axe.min.js").read_text("utf-8")
MAGNIFIED = {"width": 720, "height": 450}
"""1440x900 at 200 %, in the units of css."""
HINT = (
    "(() => { const e = document.getElementById('tip'); return e?.matches(':popover-open') ? e.textContent : ''; })()"
)
OUT_OF_REACH = """() => {
  const found = [], read = 'a[href], button, input, select, textarea, summary, [tabindex="0"], h2, h3, p, td';
  for (const e of document.querySelectorAll(read)) {
    if (!e.checkVisibility({visibilityProperty: true}) || e.closest('.hidden, [aria-hidden=true], #tags')) continue;
    e.scrollIntoView({block: 'nearest', inline: 'nearest'});
    const b = e.getBoundingClientRect(), x = b.left + Math.min(b.width, 40) / 2, y = b.top + Math.min(b.height, 24) / 2;
    const name = (e.getAttribute('aria-label') || e.textContent).trim().slice(0, 40);
    if (b.width && (x < 0 || y < 0 || x > innerWidth || y > innerHeight)) found.push(`${e.tagName} ${e.id} "${name}"`);
  }
  const {scrollWidth} = document.scrollingElement;
  return [...found, ...(scrollWidth > innerWidth ? [`the page is ${scrollWidth} wide`] : [])];
}"""
READ = """area => {
  const stops = [...document.querySelectorAll(`${area} :is(button, input, select, summary, [tabindex="0"])`)]
    .filter(e => e.checkVisibility({visibilityProperty: true}) && e.tabIndex >= 0)
    .map(e => [e.getBoundingClientRect(), e.textContent.slice(0, 30) || e.id]);
  return stops.slice(1).flatMap(([b, name], k) => {
    const [a, before] = stops[k], beside = b.top < a.bottom - 4 && a.top < b.bottom - 4;
    return b.bottom <= a.top + 1 || (beside && b.right <= a.left) ? [`${before} -> ${name}`] : [];
  });
}"""
LISTEN = """() => {
  window.heard = [];
  const told = document.getElementById('announced');
  const listen = () => { if (told.textContent) window.heard.push(told.textContent); };
  new MutationObserver(listen).observe(told, {childList: true, characterData: true, subtree: true});
}"""
LIVE_PARTS = (
    "document.querySelectorAll(':is(#answer, #stages, #objects) :is([role=status], [role=alert], [aria-live])').length"
)


def axe(tab: Tab, *rules: str) -> list[str]:
    """What axe-core finds, by all or some of its rules; the document of the scene's frame is viser's."""
    if not tab.page.evaluate("typeof axe === 'object'"):
        tab.page.evaluate(f"() => {{ {SOURCE} }}")
    found: Any = tab.page.evaluate(AXE, list(rules))
    return [f"{v['id']}: {v['help']}: {node['html'][:160]}" for v in found for node in v["nodes"][:4]]


def check_axe(browser: Browser, address: str) -> None:
    """axe-core finds nothing: all rules in one theme, and what depends on the theme in the other."""
    found, looked = [], []
    # axe-core styles what it measures by inline styles, which the page's own policy forbids; the other checks keep it.
    tab = new_tab(browser, bypass_csp=True).open(address).drawn()
    for states in (explained, others):
        for state in states(tab):
            tab.page.wait_for_timeout(150)
            seen = [*axe(tab), *tab.page.evaluate(SMALL)]
            tab.page.evaluate("document.documentElement.dataset.theme = 'light'")
            tab.page.wait_for_timeout(150)
            seen += [f"light: {one}" for one in axe(tab, "color-contrast", "link-in-text-block")]
            tab.page.evaluate("document.documentElement.dataset.theme = 'dark'")
            found += [f"{state}: {one}" for one in seen]
            looked.append(state)
    assert not tab.problems, tab.problems
    tab.page.close()
    print(f"  axe: {len(looked)} states: {', '.join(looked)}")
    assert len(looked) >= 15
    assert not found, "\n".join(found)


def check_refused(browser: Browser, address: str) -> None:
    """Who has no token gets a page that says so, to everybody."""
    tab = new_tab(browser, bypass_csp=True)
    answer = tab.page.goto(address)
    assert answer is not None
    assert answer.status == 401
    assert tab.page.locator("h1").inner_text() == "No access"
    found = axe(tab)
    assert not found, found
    tab.page.close()


def check_words(browser: Browser, address: str) -> None:
    """Every word of ours says its meaning to who comes by Tab; Escape takes that away, and the mouse has its title."""
    tab = new_tab(browser).open(address)
    tab.click("stage:PRM")
    tab.see("#head-prm[aria-expanded=true]")
    dumb = tab.page.evaluate("[...document.querySelectorAll('abbr')].filter(e => e.tabIndex < 0 || !e.title).length")
    words = set(tab.page.locator("abbr").all_inner_texts())
    assert not dumb
    assert {"P(relation)", "posterior", "margin", "tgt", "ref", "rel", "P"} <= words, words
    tab.page.locator("#head-parse").focus()
    said = []
    for _ in range(40):
        tab.page.keyboard.press("Tab")
        focused = tab.page.evaluate("[document.activeElement.tagName, document.activeElement.title]")
        assert tab.page.evaluate(HINT) == focused[1], focused
        said += focused[1:] if focused[0] == "ABBR" else []
    assert any(text.startswith("posterior:") or "posterior" in text for text in said), said
    tab.page.locator("#answer-heads abbr").first.focus()
    tab.page.keyboard.press("Escape")
    assert not tab.page.evaluate(HINT)
    for control in tab.page.locator("#scene-tools button, #tools button").all():
        assert control.get_attribute("title"), control.inner_text()
    assert not tab.problems, tab.problems
    tab.page.close()


def check_announced(browser: Browser, address: str) -> None:
    """An answer is announced once, however many parts of the page it changes; a refusal is an alert."""
    tab = new_tab(browser).open(address)
    tab.poll("document.getElementById('announced').textContent.length > 0")
    tab.page.evaluate(LISTEN)
    tab.ask("laptop right of the mug")
    tab.poll("window.heard.length > 0")
    tab.see("#answer .names", "right of")
    tab.page.wait_for_timeout(600)  # long enough for a second announcement of the same answer
    heard = tab.page.evaluate("window.heard")
    assert len(heard) == 1, heard
    assert "right of" in heard[0], heard
    assert tab.page.evaluate(LIVE_PARTS) == 0
    tab.ask("unicorn left of the mug")
    tab.see("#ask-problem [role=alert]", "unicorn")
    tab.page.close()


def check_refusals(browser: Browser, address: str) -> None:
    """What cannot be taken is said in plain words, and the page goes on as it was."""
    tab = new_tab(browser).open(address)
    before, field = tab.frame, tab.page.locator("#where .frame-id")
    field.fill("kitchen")
    field.press("Enter")
    tab.see(".toast.bad", "no frame 'kitchen'")
    tab.poll("before => document.querySelector('#where .frame-id').value === before", before)
    tab.send("paste-state")
    tab.see("#dialog-window textarea").fill("no view")
    tab.see("#dialog-window .go").click()
    tab.see("#dialog-problem", "view")
    tab.page.keyboard.press("Escape")
    tab.poll("!document.getElementById('dialog-window')")
    tab.ask("laptop right of the mug")
    tab.see("#answer .names", "right of")
    raw = tab.page.locator(".toast, #log").all_inner_texts()
    assert not any(word in text for text in raw for word in ("Error:", "Traceback", "must be a valid")), raw
    tab.page.close()


def check_keys(browser: Browser, address: str) -> None:
    """Tab goes as one reads, and out of the scene; arrows choose; Escape closes whatever is open, where one was."""
    tab = new_tab(browser).open(address)
    page = tab.page
    for area in ("#bar", "#side", "#scene-tools", "#drawer-tabs"):
        assert not page.evaluate(READ, area), (area, page.evaluate(READ, area))
    page.evaluate("document.getElementById('view').focus()")
    page.keyboard.press("Tab")
    page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement.tagName") != "IFRAME", "no way out of the scene"
    page.locator("#split").focus()
    before = page.locator("#view").bounding_box()
    page.keyboard.press("ArrowRight")
    after = page.locator("#view").bounding_box()
    assert before is not None
    assert after is not None
    assert after["width"] > before["width"]
    page.locator('#drawer-tabs [data-name="Objects"]').focus()
    page.keyboard.press("ArrowRight")
    assert page.evaluate("document.activeElement.dataset.name") == "Edit"
    assert page.locator('#drawer-tabs [data-name="Edit"]').get_attribute("aria-selected") == "true"
    page.locator(".menu>summary").focus()
    page.keyboard.press("Enter")
    tab.see(".menu[open]")
    page.keyboard.press("Tab")
    page.keyboard.press("Escape")
    assert not page.locator(".menu[open]").count()
    assert page.evaluate("document.activeElement.tagName") == "SUMMARY"
    page.keyboard.press("h")
    tab.see("#dialog-window")
    page.keyboard.press("Escape")
    tab.poll("!document.getElementById('dialog-window')")
    assert page.evaluate("document.activeElement.tagName") == "SUMMARY", "the focus is not where it was"
    assert not tab.problems, tab.problems
    page.close()


def check_sizes(browser: Browser, address: str) -> None:
    """Magnified to 200 % nothing is lost: whatever can be read or pressed comes into view by scrolling down."""
    for size in (MAGNIFIED, {"width": 1024, "height": 768}):
        tab = new_tab(browser, viewport=size).open(address)
        for task in ("explain", "evaluate", "label"):
            tab.click(f"task:{task}")
            tab.poll("task => document.body.dataset.mode === task", task)
            tab.page.wait_for_timeout(500)
            lost = tab.page.evaluate(OUT_OF_REACH)
            assert not lost, (size, task, lost)
            view = tab.page.locator("#view").bounding_box()
            # Evaluate has the width for itself.
            assert task == "evaluate" or (view is not None and min(view["width"], view["height"]) >= 200), (size, view)
        tab.page.close()


def check_preferences(browser: Browser, address: str) -> None:
    """Nothing moves by itself for who asks for that; with the reader's own colours what is chosen is still seen."""
    tab = new_tab(browser, reduced_motion="reduce", forced_colors="active").open(address)
    tab.ask("laptop right of the mug")
    tab.see("#answer .names", "right of")
    moving = tab.page.evaluate("document.getAnimations().filter(a => a.playState === 'running').length")
    assert not moving, moving
    edges = "e => { const s = getComputedStyle(e); return [s.outlineStyle, s.outlineWidth, s.outlineColor].join(' '); }"
    for group in ("#tasks", "#scene-tools .toggles"):
        on, off = (
            tab.page.locator(f"{group} button:is([aria-checked={v}], [aria-pressed={v}])").first
            for v in ("true", "false")
        )
        assert on.evaluate(edges) != off.evaluate(edges), group
    tab.page.close()


def main() -> None:
    timed = Timed()
    with chromium() as browser:
        with Server() as server:
            for check in (
                check_words,
                check_announced,
                check_refusals,
                check_keys,
                check_sizes,
                check_preferences,
                check_axe,
            ):
                timed(check, browser, server.address)
        with Server("demo", "--host", "0.0.0.0") as server:
            timed(check_refused, browser, server.address)
    print(timed)


if __name__ == "__main__":
    main()
