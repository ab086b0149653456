"""Everybody can use the page: axe-core in both themes, words that explain themselves, what is announced, refusals in
plain words, a window that is magnified to 200 %, other people's colours, no motion."""

import pytest
from accessibility import SMALL, axe
from browser import SIZE, OpenTab
from servers import Server
from states import explained, others

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
LISTEN = """() => {
  window.heard = [];
  const told = document.getElementById('announced');
  const listen = () => { if (told.textContent) window.heard.push(told.textContent); };
  new MutationObserver(listen).observe(told, {childList: true, characterData: true, subtree: true});
}"""
LIVE_PARTS = (
    "document.querySelectorAll(':is(#answer, #stages, #objects) :is([role=status], [role=alert], [aria-live])').length"
)


IN_BRIEF = ("answer with verdict", "stage PRM", "menu Show", "keys", "evaluate", "label, an item")
"""States of the page in which axe-core looks at it each time; it looks at the others at night."""
LOOKS = [
    pytest.param(IN_BRIEF, SIZE, id="brief"),
    pytest.param((), SIZE, id="all", marks=pytest.mark.slow),
    pytest.param((), MAGNIFIED, id="all, at 200 %", marks=pytest.mark.slow),
]


@pytest.mark.parametrize(("names", "size"), LOOKS)
def test_axe_finds_nothing(demo: Server, open_tab: OpenTab, names: tuple[str, ...], size: dict[str, int]) -> None:
    """In both themes, in the states of `names` with what depends on the theme in the second, or in all with all."""
    found, looked = [], []
    # axe-core styles what it measures by inline styles, which the page's own policy forbids; the other checks keep it.
    tab = open_tab(demo.address, viewport=size, bypass_csp=True).drawn()
    for states in (explained, others):
        for state in states(tab):
            if names and state not in names:
                continue
            tab.page.wait_for_timeout(150)  # until what appears has appeared
            seen = [*axe(tab), *tab.page.evaluate(SMALL)]
            tab.page.evaluate("document.documentElement.dataset.theme = 'light'")
            tab.page.wait_for_timeout(150)
            seen += [f"light: {one}" for one in axe(tab, *(("color-contrast", "link-in-text-block") if names else ()))]
            tab.page.evaluate("document.documentElement.dataset.theme = 'dark'")
            found += [f"{state}: {one}" for one in seen]
            looked.append(state)
    assert len(looked) == len(names) if names else len(looked) >= 20, looked
    assert not found, "\n".join(found)


def test_words_say_their_meaning(demo: Server, open_tab: OpenTab) -> None:
    """Every word of ours to who comes by Tab; Escape takes that away, and the mouse has its title."""
    tab = open_tab(demo.address, "absent")
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
        if focused[0] == "IFRAME":
            break
        assert tab.page.evaluate(HINT) == focused[1], focused
        said += focused[1:] if focused[0] == "ABBR" else []
    assert any(text.startswith("posterior:") or "posterior" in text for text in said), said
    tab.page.locator("#answer-numbers abbr").first.focus()
    tab.page.keyboard.press("Escape")
    assert not tab.page.evaluate(HINT)
    for control in tab.page.locator("#scene-tools button, #tools button").all():
        assert control.get_attribute("title") or control.locator("small").count(), control.text_content()


def test_an_answer_is_announced_once(demo: Server, open_tab: OpenTab) -> None:
    """However many parts of the page it changes, with the head of its story; a refusal, too."""
    tab = open_tab(demo.address, "absent")
    tab.poll("document.getElementById('announced').textContent.length > 0")
    tab.page.evaluate(LISTEN)
    tab.ask("laptop right of the mug")
    tab.poll("window.heard.length > 0")
    tab.answers("laptop", "mug")
    tab.page.wait_for_timeout(600)  # long enough for a second announcement of the same answer
    heard = tab.page.evaluate("window.heard")
    assert len(heard) == 1, heard
    assert "right of" in heard[0], heard
    assert tab.page.evaluate(LIVE_PARTS) == 0
    assert tab.see("#verdict").inner_text() in heard[0], heard
    tab.ask("unicorn left of the mug")
    tab.poll("window.heard.some(text => text.includes('unicorn'))")


def test_refusals_are_plain_words(demo: Server, open_tab: OpenTab) -> None:
    """What cannot be taken is said, and the page goes on as it was."""
    tab = open_tab(demo.address, "absent")
    before, field = tab.frame, tab.page.locator("#timeline .frame-id")
    field.fill("kitchen")
    field.press("Enter")
    tab.see(".toast.bad", "no frame 'kitchen'")
    tab.poll("before => document.querySelector('#timeline .frame-id')?.value === before", before)
    tab.ask("sv1:noview")
    tab.see(".toast.bad", "state string is damaged")
    tab.ask("laptop right of the mug")
    tab.answers("laptop", "mug")
    raw = tab.page.locator(".toast, #log").all_inner_texts()
    assert not any(word in text for text in raw for word in ("Error:", "Traceback", "must be a valid")), raw


@pytest.mark.parametrize("size", [MAGNIFIED, {"width": 1024, "height": 768}], ids=["magnified", "small"])
def test_magnified_nothing_is_lost(demo: Server, open_tab: OpenTab, size: dict[str, int]) -> None:
    """Whatever can be read or pressed comes into view by scrolling down."""
    tab = open_tab(demo.address, viewport=size)
    for task in ("explain", "evaluate", "label"):
        tab.click(f"task:{task}")
        tab.poll("task => document.body.dataset.mode === task", task)
        tab.still("document.body.innerHTML.length")
        lost = tab.page.evaluate(OUT_OF_REACH)
        assert not lost, (size, task, lost)
        if task == "evaluate" and size == MAGNIFIED:
            parts = [tab.page.locator(f"#{name}").bounding_box() for name in ("facets", "found", "figures")]
            assert {part and (part["x"], part["width"]) for part in parts} == {(0, size["width"])}, parts
        view = tab.page.locator("#view").bounding_box()
        # Evaluate has the width for itself, in Label the scene is a tab.
        assert task != "explain" or (view is not None and min(view["width"], view["height"]) >= 200), (size, view)


def test_what_a_reader_prefers(demo: Server, open_tab: OpenTab) -> None:
    """Nothing moves by itself for who asks for that; with the reader's own colours what is chosen is still seen."""
    tab = open_tab(demo.address, "absent", reduced_motion="reduce", forced_colors="active")
    tab.ask("laptop right of the mug")
    tab.answers("laptop", "mug")
    moving = tab.page.evaluate("document.getAnimations().filter(a => a.playState === 'running').length")
    assert not moving, moving
    edges = "e => { const s = getComputedStyle(e); return [s.outlineStyle, s.outlineWidth, s.outlineColor].join(' '); }"
    for group in ("#tasks", "#scene-tools .toggles"):
        on, off = (
            tab.page.locator(f"{group} button:is([aria-checked={v}], [aria-pressed={v}])").first
            for v in ("true", "false")
        )
        assert on.evaluate(edges) != off.evaluate(edges), group
