"""Elements escape whatever they are given, and a change sends no more than what changed."""

from html.parser import HTMLParser

import pytest
from hypothesis import given
from hypothesis import strategies as st

from spatialviz.app.markup import Element, changed, h

TEXT = st.text(st.characters(blacklist_categories=("Cs",), blacklist_characters="\r\0"), max_size=30)
NAMES = st.sampled_from(["div", "span", "td", "button"])


class Read(HTMLParser):
    """What a browser would make of it."""

    def __init__(self) -> None:
        super().__init__(convert_charrefs=True)
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.text = ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_data(self, data: str) -> None:
        self.text += data


@given(NAMES, TEXT, TEXT)
def test_strings_stay_strings(name: str, text: str, title: str) -> None:
    read = Read()
    read.feed(getattr(h, name)(text, title=title, do=f"ask:{text}").html)
    read.close()
    assert [tag for tag, _ in read.tags] == [name]
    assert read.text == text
    assert read.tags[0][1]["title"] == title
    assert read.tags[0][1]["data-do"] == f"ask:{text}"


@pytest.mark.parametrize("attribute", ["onclick", "onerror", "style"])
def test_neither_scripts_nor_styles_are_attributes(attribute: str) -> None:
    with pytest.raises(ValueError, match="no element has the attribute"):
        h.div("x", **{attribute: "alert(1)"})


def tree(values: list[str], ids: list[bool]) -> Element:
    rows = [h.tr(h.td(v), id=f"row-{k}" if own else None) for k, (v, own) in enumerate(zip(values, ids, strict=True))]
    return h.div(h.table(rows), id="list")


def replaced(element: Element, parts: dict[str, str]) -> str:
    """What a browser that replaces elements by their ids shows."""
    if element.id in parts:
        return parts[element.id]
    inner = "".join(c if isinstance(c, str) else replaced(c, parts) for c in element.children)
    attributes = "".join(f' {k}="{v}"' for k, v in element.attributes)
    return f"<{element.name}{attributes}>{inner}</{element.name}>"


@given(st.lists(st.tuples(st.sampled_from("abc"), st.sampled_from("abc"), st.booleans()), min_size=1, max_size=6))
def test_a_patched_page_is_the_page(rows: list[tuple[str, str, bool]]) -> None:
    ids = [own for _, _, own in rows]
    before, after = tree([a for a, _, _ in rows], ids), tree([b for _, b, _ in rows], ids)
    parts = dict(changed(before, after))
    assert replaced(before, parts) == after.html
    if all(ids):
        assert set(parts) == {f"row-{k}" for k, (a, b, _) in enumerate(rows) if a != b}
