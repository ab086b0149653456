"""The page of the demo answers as the command line does, shows the evidence, and takes what is typed as text."""

import json
from urllib.parse import quote, urlsplit

from browser import OpenTab, Tab
from recordings import MARKUP, spatialviz
from servers import Server

from pipeline.answering.answer_words import probability

ROW = '#stages tr[data-do^="pair:"]'
COLORS = """() => {
  const all = [...document.getElementById('view').contentDocument.querySelectorAll('canvas')];
  const canvas = all.find(c => c.dataset.engine || c.width > 100), made = document.createElement('canvas');
  [made.width, made.height] = [60, 60];
  const at = made.getContext('2d');
  at.drawImage(canvas, 0, 0, 60, 60);
  const d = at.getImageData(0, 0, 60, 60).data;
  return new Set(Array.from({length: 3600}, (_, k) => `${d[4 * k]},${d[4 * k + 1]},${d[4 * k + 2]}`)).size;
}"""


def test_the_page_says_what_the_command_line_says(demo: Server, open_tab: OpenTab) -> None:
    """The first page shows a failure of the demo's run."""
    tab = open_tab(demo.address)
    head = tab.see("#verdict").inner_text()
    said = json.loads(spatialviz("ask", "demo", tab.frame, tab.question, "--run", "demo", "--json", fails=True))
    verdict = said["verdict"]
    assert verdict["verdict"] != "CORRECT", verdict
    assert head == verdict["head"], (head, verdict)
    assert verdict["verdict"] in tab.see("#answer .verd .sub").inner_text(), verdict
    assert tab.see("#answer .why.bad").inner_text() == verdict["said"], verdict
    assert tab.see("#answer .fix p").inner_text() == verdict["mend"]["said"], verdict
    tab.click("stage:PRM")
    tab.see("#answer-numbers")
    numbers = tab.page.locator("#answer-numbers b").all_inner_texts()
    wanted = [probability(said["answer"][k]) for k in ("relation_probability", "product")]
    assert numbers == wanted, (numbers, said["answer"])


def test_things_go_by_the_name_of_their_role(demo: Server, open_tab: OpenTab) -> None:
    """The README's question, whose mug and laptop the detector takes for each other, too."""
    tab = open_tab(demo.address, "absent")
    question = "mug left of the laptop"
    tab.ask(question)
    names = tab.answers("mug", "laptop").replace(" ", "·").split("···")
    told = spatialviz("ask", "demo", tab.frame, question, "--run", "demo").splitlines()
    assert any(line.startswith(f"{names[0]} left of {names[1]}   relation") for line in told), (names, told)
    answer = json.loads(spatialviz("ask", "demo", tab.frame, question, "--run", "demo", "--json"))["answer"]
    tab.drawer("Objects")
    for role in ("target", "reference"):
        name = next(n for n in names if n.startswith(answer[role]["label"]))
        row = tab.see("#objects", name).inner_text()
        assert f"{answer[role]['score']:.2f}" in row.partition(name)[2].partition("·")[0], (name, row)


def test_nothing_is_asked_by_itself_that_has_no_answer(demo: Server, open_tab: OpenTab) -> None:
    tab = open_tab(f"{demo.address}/?mode=evaluate", "evaluated")
    tab.see("#figures .falls")
    tab.click("task:explain")
    tab.see("#answer .why")
    assert "Could not be asked" not in tab.see("#verdict").inner_text()
    tab.ask("zebra left of the mug")
    offered = tab.see("#answer", "zebra").inner_text()
    assert "by the labels" in offered, offered
    assert "teddy bear" not in offered, offered


def test_the_scene_is_painted(demo: Server, open_tab: OpenTab) -> None:
    """The points of the frame are seen, and go where they are hidden: the other checks leave them out."""
    tab = open_tab(demo.address, "painted").drawn()
    points = tab.poll(f"({COLORS})() > 400 && ({COLORS})()")
    tab.press("v")
    tab.poll(f"points => ({COLORS})() < points / 2", points)


def test_a_new_answer_is_read_from_its_head(demo: Server, open_tab: OpenTab) -> None:
    """However far down the column was; another stage of the same answer leaves it where it is."""
    tab = open_tab(demo.address, "absent", viewport={"width": 1440, "height": 500})
    down = "(() => { const side = document.getElementById('side'); side.scrollTop = 9999; return side.scrollTop; })()"
    tab.click("stage:PRM")
    tab.see("#head-prm[aria-expanded=true]")
    assert tab.page.evaluate(down) > 100
    tab.press("j")
    tab.page.wait_for_timeout(500)  # long enough for the other pair
    assert tab.page.evaluate("document.getElementById('side').scrollTop") > 0
    tab.page.evaluate(down)
    tab.ask("laptop right of the mug")
    tab.answers("laptop", "mug")
    tab.poll("document.getElementById('side').scrollTop === 0")


def test_what_if_says_whether_the_answer_has_changed(demo: Server, open_tab: OpenTab) -> None:
    tab = open_tab(demo.address, "absent")
    tab.ask("mug on the left of another mug")
    tab.see("#verdict", "Correct by luck")
    tab.drawer("Edit")
    tab.send("edit:set:k:9")
    tab.see("#answer .before", "Answer unchanged")
    tab.see("#answer .before .vd", "CORRECT lucky")
    tab.press("0")
    tab.poll("!document.querySelector('#answer .before')")
    tab.send("edit:hide")
    tab.see("#answer .before", "Now there is no answer")
    tab.press("0")
    tab.ask("which potted plant is on the left side of a shelf?")
    tab.see("#verdict", "Wrong potted plant")
    tab.send("edit:hide")
    tab.see("#answer .before", "Another answer")
    tab.press("0")


def test_the_colours_are_the_systems_until_others_are_chosen(demo: Server, open_tab: OpenTab) -> None:
    """From the first byte; those that are chosen stay, and `view --theme` decides before the system does."""
    theme = "document.documentElement.dataset.theme"
    tab = open_tab(demo.address, "absent", color_scheme="light")
    assert tab.page.evaluate(theme) == "light"
    tab.page.emulate_media(color_scheme="dark")
    tab.poll(f"{theme} === 'dark'")
    tab.page.emulate_media(color_scheme="light")
    tab.poll(f"{theme} === 'light'")
    tab.press("m")
    tab.poll(f"{theme} === 'dark'")
    tab.page.reload()
    tab.words()
    assert tab.page.evaluate(theme) == "dark"
    with Server("demo", "--theme", "dark") as dark:
        assert open_tab(dark.address, "absent", color_scheme="light").page.evaluate(theme) == "dark"


def test_a_question_and_its_evidence(demo: Server, open_tab: OpenTab) -> None:
    tab = open_tab(demo.address, "absent")
    tab.ask("laptop right of the mug")
    tab.answers("laptop", "mug")
    tab.click("stage:PRM")
    tab.see(ROW)
    tab.click("stage:SRM")
    tab.see('#stages [data-do^="relation:"]', "left of").click()
    tab.poll("document.getElementById('ask-text').value.includes('left of')")


def test_up_is_what_is_clicked(demo: Server, open_tab: OpenTab) -> None:
    """A click names a level surface; what was declared comes back."""
    tab = open_tab(demo.address, "absent")
    tab.ask("laptop right of the mug")
    tab.answers("laptop", "mug")
    assert not tab.page.locator("#answer .upchip").count()  # up is declared: nothing to doubt
    tab.press("Shift+U")
    tab.see("#answer .note", "level surface")
    picture = tab.see("#image [data-point]")
    box = picture.bounding_box()
    assert box is not None
    picture.click(position={"x": 0.1 * box["width"], "y": 0.95 * box["height"]})
    tab.see("#answer .upchip", "given")
    tab.see("#answer .uptold [data-do=level-back]").click()
    tab.poll("!document.querySelector('#answer .upchip')")


def _is_text(tab: Tab, question: str) -> None:
    tab.ask(question)
    tab.see("#answer", "a character that cannot be read: '<'")
    assert tab.question == question, tab.question
    tab.drawer("Log")
    tab.poll("text => document.getElementById('log').textContent.includes(text)", question)
    assert not tab.page.locator("[onerror]").count()


def test_markup_in_a_question_is_text(demo: Server, open_tab: OpenTab) -> None:
    """And an address opens nothing that is not open already."""
    tab = open_tab(demo.address, "absent")
    _is_text(tab, "<img src=x onerror=alert(1)> left of the mug")
    _is_text(tab, MARKUP)
    before = tab.frame
    root = urlsplit(tab.page.url)._replace(query="").geturl()
    for query in (
        f"data={quote('/etc')}&frame=0",
        f"data={quote(MARKUP)}",
        "run=/etc&scorer=/etc/passwd",
        "mode=exec&stage=rm&item=1,x&camera=nan",
    ):
        tab.open(f"{root}?{query}")
        # The page says in the address what it shows instead.
        tab.poll("location.search.includes('frame=') && !/etc|img|exec|nan/.test(location.search)")
        assert tab.frame == before, (query, tab.frame)
        assert not tab.page.locator("[onerror], #dialog-window").count()
    assert tab.page.title() != "hit"


def test_markup_in_names_is_text(hostile: Server, open_tab: OpenTab) -> None:
    """In the names of a dataset, of its folder and of a class, wherever they stand."""
    tab = open_tab(hostile.address).drawn()
    tab.see("#bar .dataset, #bar select", MARKUP)
    tab.drawer("Objects")
    tab.see("#objects", MARKUP)
    tab.ask(f'"{MARKUP}" left of the laptop')
    tab.press("/")
    tab.page.keyboard.type("img")
    tab.page.wait_for_timeout(800)  # long enough for an image to fail to load
    tab.page.keyboard.press("Escape")
    for name in ("Edit", "Log"):
        tab.drawer(name)
    assert not tab.page.locator("[onerror]").count()
    assert "hit" not in (tab.page.title(), *(frame.evaluate("document.title") for frame in tab.page.frames))


def test_one_page_does_not_move_another(demo: Server, open_tab: OpenTab) -> None:
    tab, other = (open_tab(demo.address, "absent") for _ in range(2))
    before = tab.frame
    assert other.frame == before
    other.press("n")
    moved = other.other_frame(before)
    assert tab.frame == before, "one client's frame moved another's"
    other.poll("moved => location.search.includes(moved)", moved)
    other.page.reload()
    other.words()
    assert other.frame == moved, (other.frame, moved)


def test_depth_and_camera_are_examined_with_outlines(demo: Server, open_tab: OpenTab) -> None:
    tab = open_tab(demo.address, "absent")
    tab.see('.menu>summary[aria-label="More"]').click()
    tab.click("doctor")
    tab.see("#dialog-window .doctor", "registration")
    tab.poll("document.querySelector('#dialog-window img.edges').naturalWidth > 600")


def test_the_heat_map_outlines_the_right_pair_and_shows_it_at_a_click(demo: Server, open_tab: OpenTab) -> None:
    tab = open_tab(demo.address)
    tab.click("stage:PRM")
    tab.see(".mx td.ok:not(.top)").first.click()
    tab.see(".mx td.ok.sel")
    tab.poll("document.querySelector('.pairs tr.sel').id !== 'pair-0'")
