"""What the address keeps, and what a view string opens."""

from dataclasses import replace
from urllib.parse import parse_qs, urlsplit

from browser import OpenTab, Tab
from servers import Server

from pipeline.diagnosis.whatif.state import ViewState, encode


def looked_at(tab: Tab) -> dict[str, list[str]]:
    return parse_qs(urlsplit(tab.page.url).query)


def shows_the_same(tab: Tab, wanted: dict[str, list[str]]) -> None:
    tab.words().drawn()
    tab.see("#head-srm[aria-expanded=true]")
    tab.answers("laptop", "mug")
    tab.page.wait_for_timeout(1200)  # long enough for the scene to turn the camera again, which it must not
    found = looked_at(tab)
    cameras = [[float(n) for n in place.pop("camera")[0].split(",")] for place in (found, dict(wanted))]
    assert found == {k: v for k, v in wanted.items() if k != "camera"}, (found, wanted)
    assert max(abs(a - b) for a, b in zip(*cameras, strict=True)) < 0.02, cameras


def turn_the_camera(tab: Tab) -> None:
    box = tab.see("#view").bounding_box()
    assert box is not None
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] * 0.8
    tab.page.mouse.move(x, y)
    tab.page.mouse.down()
    tab.page.mouse.move(x + 60, y - 20, steps=6)
    tab.page.mouse.up()
    tab.poll("location.search.includes('stage=SRM') && location.search.includes('camera=')")
    tab.still("location.search", 0.8)


def test_what_is_looked_at_comes_back(demo: Server, open_tab: OpenTab) -> None:
    """Frame, question, mode, stage, filter and camera: by reload, in a second tab, by Back and Forward."""
    tab = open_tab(demo.address).drawn()
    first = tab.frame
    tab.ask("laptop right of the mug")
    tab.answers("laptop", "mug")
    tab.click("stage:SRM")
    tab.see("#head-srm[aria-expanded=true]")
    turn_the_camera(tab)
    wanted = looked_at(tab)
    assert wanted["ask"] == ["laptop right of the mug"], wanted
    tab.page.reload()
    shows_the_same(tab, wanted)
    second = open_tab(tab.page.url)
    shows_the_same(second, wanted)
    second.close()
    tab.press("n")
    moved = tab.other_frame(first)
    tab.poll("first => !location.search.includes(first)", first)
    tab.click("task:evaluate")
    search = tab.see("#search input")
    search.fill("said:left")
    search.press("Enter")
    tab.poll("location.search.includes('find=said:left') && location.search.includes('mode=evaluate')")
    tab.page.reload()
    tab.words()
    assert tab.see("#search input").input_value() == "said:left"
    assert (looked_at(tab)["mode"], tab.frame) == (["evaluate"], moved)
    for _ in range(6):
        if tab.frame == first:
            break
        tab.page.go_back()
        # The address is the one before at once, the page as soon as the server has heard of it.
        tab.poll(
            "new URLSearchParams(location.search).get('frame') === document.querySelector('#timeline .frame-id').value"
        )
        tab.still("location.search + document.getElementById('ask-text').value")
    assert (tab.frame, tab.question) == (first, "laptop right of the mug"), (tab.frame, tab.question)
    tab.page.go_forward()
    tab.poll("moved => document.querySelector('#timeline .frame-id')?.value === moved", moved)


def test_a_dead_link_says_so(demo: Server, open_tab: OpenTab) -> None:
    """In one line, and what is shown instead; a live one says nothing."""
    tab = open_tab(f"{demo.address}/?data=nosuch&frame=zzz&ask=foo", "absent")
    tab.see(".toast.bad", "No dataset nosuch is open here")
    tab.open(f"{demo.address}/?data=demo&frame=zzz")
    tab.see(".toast.bad", "There is no frame zzz")
    tab.open(f"{demo.address}/?data=demo&frame={tab.frame}")
    tab.page.wait_for_timeout(500)  # long enough for a message
    assert not tab.page.locator(".toast").count()


def test_the_labelled_pair_comes_back(demo: Server, open_tab: OpenTab) -> None:
    """The pair that is looked at is in the address, and comes back in a second tab."""
    tab = open_tab(demo.address, "absent")
    tab.click("task:label")
    tab.see("#review-list .queue .q")
    tab.press("j")
    tab.see("#review-item .task-item")
    tab.poll("location.search.includes('item=') && location.search.includes('mode=label')")
    wanted = looked_at(tab)
    second = open_tab(tab.page.url, "absent")
    second.poll("location.search.includes('item=') && location.search.includes('mode=label')")
    found = looked_at(second)
    assert {k: found[k] for k in ("frame", "item", "mode")} == {k: wanted[k] for k in ("frame", "item", "mode")}, found


def test_what_a_view_string_names_is_opened_after_a_yes_alone(demo: Server, open_tab: OpenTab) -> None:
    """No other dataset, no run, no network file."""
    tab = open_tab(demo.address, "absent")
    tab.poll("location.search.includes('ask=')")
    view, before = ViewState("demo", tab.frame, tab.question), tab.page.url
    tab.ask(encode(replace(view, dataset="/etc")))
    tab.see(".toast.bad", "a dataset that is not open here")
    assert tab.page.url == before
    tab.ask(encode(replace(view, run="/nowhere/other")))
    tab.drawer("Log")
    tab.poll("document.getElementById('log').textContent.includes('/nowhere/other, which is not open here')")
    network = "/nowhere/network.onnx"
    told = "name => ['log', 'toasts'].some(id => document.getElementById(id).textContent.includes(name))"
    for answer in ("Without it", "Load it"):
        tab.ask(encode(replace(view, edits=view.edits.with_scorer(network))))
        tab.see("#dialog-window pre", network)
        # Nobody has looked for the file yet: that there is none is not known.
        assert not tab.page.evaluate(told, network)
        tab.see("#dialog-window button", answer).click()
        tab.poll("answer => !document.getElementById('dialog-window') || answer === 'Load it'", answer)
    tab.poll(told, network)
    tab.page.keyboard.press("Escape")
