"""Evaluate: filters, the list and its selection, marks, kept searches, a second run, 50,000 rows, keys."""

import json

import pytest
from browser import OpenTab, Tab
from recordings import ROWS as MANY
from recordings import RUN, spatialviz
from servers import Server

MOST_NODES = 120
"""Rows that are elements at once."""
ROWS = "#rows .space > .expr"
FILLED = "#rows .space > .expr:not(.wait)"
ALL = 1800
"""Rows of the demo's run."""


def finds(tab: Tab, count: int) -> None:
    tab.poll("n => document.querySelector('#found-bar .count b')?.textContent.replace(/\\D/g, '') === n", str(count))
    if count:
        tab.poll(f"document.querySelectorAll('{FILLED}').length > 0")


def search(tab: Tab, query: str) -> None:
    field = tab.see("#search input")
    field.fill(query)
    field.press("Enter")


def facet(tab: Tab, name: str) -> dict[str, int]:
    """The values of a facet that are shown, with their counts."""
    shown = tab.page.locator(f"#facet-{name} .value").evaluate_all(
        "all => all.map(v => [v.querySelector('.which').textContent, v.querySelector('.n').textContent])"
    )
    return {value: int(count.replace(",", "")) for value, count in shown}


def told(name: str) -> dict[str, int]:
    """A facet of the failures as the command line has it."""
    facets = json.loads(spatialviz("failures", RUN, "--json"))["facets"]
    return {v["name"]: v["count"] for v in facets[name]["values"]}


def pictures_are_shown(tab: Tab) -> None:
    tab.poll(f"[...document.querySelectorAll('{FILLED} img')].slice(0, 4).every(i => i.naturalWidth > 100)")


@pytest.fixture
def evaluate(compared: Server, open_tab: OpenTab) -> Tab:
    """A tab that shows the demo's run beside a second one, with its rows."""
    tab = open_tab(f"{compared.address}/?mode=evaluate", "absent")
    tab.poll(f"document.querySelectorAll('{FILLED}').length > 4")
    tab.see("#figures .falls")
    return tab


def test_filters_count_what_is_found(evaluate: Tab) -> None:
    """A facet's number is what a press on it finds; the others follow, its own does not."""
    tab = evaluate
    pictures_are_shown(tab)
    everything = told("verdict")
    before = facet(tab, "verdict")
    assert everything.items() >= before.items(), (before, everything)
    tab.click("facet:verdict:OPM-REF")
    finds(tab, before["OPM-REF"])
    assert facet(tab, "verdict") == before, "a facet must not be narrowed by itself"
    relations = facet(tab, "relation")
    assert sum(relations.values()) == before["OPM-REF"], relations
    tab.click("facet:verdict:OPM-CONF")
    finds(tab, before["OPM-REF"] + before["OPM-CONF"])
    tab.click("facet:relation:left")
    left = facet(tab, "relation")["left of"]
    finds(tab, left)
    assert sum(facet(tab, "verdict").values()) > left
    assert "find=-right verdict:OPM-REF,OPM-CONF" in tab.page.url.replace("+", " "), tab.page.url
    query = tab.see("#search input").input_value()
    said = json.loads(spatialviz("failures", RUN, "--json", "--", query))
    assert said["found"] == left, (query, said["found"], left)


def test_a_failure_opens_and_back_returns(evaluate: Tab) -> None:
    tab = evaluate
    search(tab, "-verdict:CORRECT sort:margin")
    right = json.loads(spatialviz("failures", RUN, "verdict:CORRECT", "--json"))["found"]
    finds(tab, ALL - right)
    tab.page.locator("#rows").evaluate("list => { list.scrollTop = 4000; }")
    tab.poll(f"[...document.querySelectorAll('{FILLED}')].some(e => +e.id.slice(4) > 40)")
    top = tab.page.locator("#rows").evaluate("list => list.scrollTop")
    tab.still(f"[...document.querySelectorAll('{FILLED}')].map(e => e.id).join()", 0.3)
    row = tab.page.locator(FILLED).nth(6)
    asked = row.locator(".asked").inner_text()
    row.click()
    tab.poll(
        "asked => document.body.dataset.mode === 'explain' && document.getElementById('ask-text').value === asked",
        asked,
    )
    tab.see("#verdict")
    tab.poll("location.search.includes('mode=explain')")
    tab.page.go_back()
    tab.poll("document.body.dataset.mode === 'evaluate'")
    tab.poll(f"document.querySelectorAll('{FILLED}').length > 4")
    assert tab.see("#search input").input_value() == "-verdict:CORRECT sort:margin"
    back = tab.page.locator("#rows").evaluate("list => list.scrollTop")
    assert abs(back - top) < 400, (back, top)


def test_selected_rows_are_marked_and_a_search_is_kept(evaluate: Tab) -> None:
    """By keys alone: walk, select, mark, search for the mark, keep the search under a name, forget it."""
    tab = evaluate
    search(tab, "verdict:LIFT,SRM,PRM")
    count = sum(facet(tab, "verdict")[name] for name in ("LIFT", "SRM", "PRM"))
    finds(tab, count)
    keyboard = tab.page.keyboard
    keyboard.press("j")
    assert tab.page.evaluate("document.activeElement.id") == "rows"
    keyboard.press("Home")
    keyboard.press("x")
    keyboard.press("ArrowRight")
    keyboard.press("Space")
    tab.see("#found-bar", "2 selected")
    keyboard.press("Shift+ArrowRight")
    tab.see("#found-bar", "3 selected")
    tab.poll("document.querySelectorAll('#rows .expr[aria-selected=true]').length === 3")
    tab.see("#found-bar .naming").focus()
    keyboard.type("odd")
    keyboard.press("Enter")
    tab.see("#found-bar", "#odd")
    tab.poll("document.querySelectorAll('#rows .tagged').length === 3")
    keyboard.press("Escape")
    tab.poll("!document.querySelector('#found-bar .chosen')")
    keyboard.press("Control+a")
    tab.see("#found-bar", f"{count} selected")
    keyboard.press("Escape")
    keyboard.press("/")
    assert tab.page.evaluate("document.activeElement.matches('#search input')")
    search(tab, "marks:odd")
    finds(tab, 3)
    assert facet(tab, "marks") == {"odd": 3}
    tab.see("#filters .naming").focus()
    keyboard.type("the odd ones")
    keyboard.press("Enter")
    tab.see("#filters .kept", "the odd ones")
    tab.click("find:")
    finds(tab, ALL)
    tab.see("#filters .kept .try", "the odd ones").click()
    finds(tab, 3)
    tab.see("#filters .kept .drop").click()
    tab.poll("!document.querySelector('#filters .kept')")
    tab.see("#rows").focus()
    keyboard.press("Enter")
    tab.poll("document.body.dataset.mode === 'explain'")


def test_what_the_second_run_broke(evaluate: Tab, compared: Server) -> None:
    tab, second = evaluate, compared.folder / "second"
    record = json.loads(spatialviz("failures", RUN, "change:broken", "--compare", second, "--json"))
    broken = len(record["comparison"]["broken"])
    assert broken == record["found"] > 0, record["found"]
    tab.see("#filters", "what the second run broke")
    tab.see('#filters [data-do="find:change:broken"]').click()
    finds(tab, broken)
    assert facet(tab, "change") | {"broken": broken} == facet(tab, "change")
    pictures_are_shown(tab)
    tab.click("rows-view:table")
    tab.see("#rows[role=grid] [role=columnheader]", "second run")
    first = tab.page.locator(FILLED).first.inner_text()
    assert all(word in first for word in ("CORRECT", "broken", "→")), first
    rows = int(tab.page.locator("#rows").get_attribute("aria-rowcount") or 0)
    assert rows == broken + 1, rows
    tab.click("find:change:broken sort:second_verdict")
    tab.see("#rows [aria-sort=ascending]", "second run")
    tab.poll(f"document.querySelectorAll('{FILLED}').length > 3")
    verdicts = tab.page.locator(f"{FILLED} .c-second_verdict .vd").all_inner_texts()
    assert verdicts == sorted(verdicts), verdicts


def test_many_rows_scroll(large: Server, open_tab: OpenTab) -> None:
    """Rows appear wherever the list of 50,000 is scrolled to; few of them are elements."""
    tab = open_tab(f"{large.address}/?mode=evaluate", "absent")
    tab.click("find:")
    finds(tab, MANY)
    nodes = 0
    for part in (0.1, 0.5, 0.93, 0.31, 0.999):
        tab.page.locator("#rows").evaluate("(list, part) => { list.scrollTop = part * list.scrollHeight; }", part)
        tab.poll(
            "part => { const l = document.getElementById('rows').getBoundingClientRect(), y = l.top + l.height / 2;"
            " return [...document.querySelectorAll('#rows .space > .expr:not(.wait)')].some(e => {"
            "  const r = e.getBoundingClientRect();"
            "  return r.top < y + 9 && r.bottom > y - 9 && Math.abs(+e.id.slice(4) / 50000 - part) < .03; }); }",
            part,
        )
        nodes = max(nodes, tab.page.locator(ROWS).count())
    assert nodes < MOST_NODES, nodes
    search(tab, "-verdict:CORRECT distance>1 sort:margin")
    tab.poll("document.querySelector('#rows').scrollTop < 5 && document.querySelector('#row-0:not(.wait)')")
    tab.page.locator("#rows").focus()
    for _ in range(4):
        tab.page.keyboard.press("PageDown")
    tab.poll("document.querySelector('#rows .expr.at:not(.wait)')")
    tab.click("choose-all")
    tab.see("#found-bar .chosen", "selected")


def test_what_the_second_run_broke_is_explained_by_its_own_answer(evaluate: Tab, compared: Server) -> None:
    """D3: the first of the list opens on B; the switch shows A, and the address keeps the side."""
    tab, second = evaluate, compared.folder / "second"
    search(tab, "change:broken")
    tab.poll(f"document.querySelectorAll('{FILLED}').length > 0")
    tab.page.locator(FILLED).first.click()
    tab.poll("document.body.dataset.mode === 'explain' && location.search.includes('run=b')")
    said = json.loads(spatialviz("ask", "demo", tab.frame, tab.question, "--run", second, "--json", fails=True))
    tab.see("#verdict", said["verdict"]["head"])
    assert said["verdict"]["tone"] == "wrong"
    assert tab.see("#answer .why.bad").inner_text() == said["verdict"]["said"]
    names = tab.page.locator("#answer [data-do^='side:']").all_inner_texts()
    assert names == ["A · relations by rel32 · K 5 ✓", "B · relations by rule · K 12 ✕", "both"], names
    tab.click("side:a")
    said = json.loads(spatialviz("ask", "demo", tab.frame, tab.question, "--run", "demo", "--json", fails=True))
    tab.see("#verdict", said["verdict"]["head"])
    tab.poll("!location.search.includes('run=')")
    tab.click("side:both")
    tab.see("#stages .other", "relations by rule")
    tab.poll("location.search.includes('run=both')")
    tab.page.go_back()
    tab.see("#answer [data-do='side:a'][aria-checked=true]")
    tab.page.go_back()
    tab.see("#answer [data-do='side:b'][aria-checked=true]")
    tab.see("#answer .why.bad")
