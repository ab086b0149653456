"""The smallest change that a story names is tried by a press, taken back by another, and counted over the run."""

import json
from urllib.parse import quote

from browser import OpenTab
from recordings import spatialviz
from servers import Server

FRAME, QUESTION = "000002/000001", "where is a bowl on the left side of a basket?"


def test_try_it_makes_the_answer_right_and_counts_the_run(demo: Server, open_tab: OpenTab) -> None:
    tab = open_tab(f"{demo.address}/?frame={FRAME}&ask={quote(QUESTION)}")
    said = json.loads(spatialviz("ask", "demo", FRAME, QUESTION, "--run", "demo", "--try", "--json", fails=True))
    assert said["tried"]["said"] == "✓ Now correct"
    head = tab.see("#verdict", said["verdict"]["head"]).inner_text()
    tab.click("try-mend")
    tab.see("#verdict", said["tried"]["head"])
    tab.see("#answer .before", "✓ Now correct")
    assert tab.see("#try-mend").inner_text() == "Take it back"
    # A busy machine looks at fewer in its time.
    setting = said["over_run"]["said"].partition(":")[0]
    counts = tab.see("#over-run", "mended").inner_text()
    assert counts.startswith(f"Over the run {setting}: "), counts
    assert "looked at" in counts or counts.endswith(said["over_run"]["said"]), counts
    slider = tab.page.locator("#slide-mend input")
    slider.fill("0.05")
    tab.see("#answer .before", "Answer unchanged")
    tab.see("#verdict", "Wrong bowl")
    assert tab.see("#try-mend").inner_text() == "Take it back"
    tab.click("try-mend")
    tab.poll("!document.querySelector('#answer .before')")
    tab.see("#verdict", head)
    assert tab.see("#try-mend").inner_text() == "Try it"
