"""Small pieces shared by the panels."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from pipeline.geometry.lifting import Pixel
from pipeline.geometry.palette import RGB, hex_color
from spatialviz.app.markup import Child, Element, h

GOOD, DOUBT, BAD, IDLE = "#35a96b", "#e0982e", "#e5484d", "#8a919c"
CHANGED = 0.005
"""Numbers are shown with two digits; one that differs by less is the same."""


def dot(color: RGB) -> Element:
    """A filled square in a role's colour."""
    return h.span(cls="dot", css={"--c": hex_color(color)})


def named(color: RGB, name: str) -> Element:
    """The name of an object, in the colour of its role."""
    return h.span(dot(color), h.b(name), cls="name", title=name)


def words(reason: Pixel) -> str:
    """What became of a pixel, in words."""
    return reason.name.lower().replace("_", " ")


def panel(*children: Child, cls: str = "") -> Element:
    """Parts inside one block."""
    return h.section(*children, cls=f"panel {cls}".strip())


def heading(text: Child, *aside: Child) -> Element:
    """A small heading with an optional remark at the right."""
    return h.h2(text, h.span(*aside))


def note(text: Child, color: str = DOUBT) -> Element:
    """A remark with a coloured edge."""
    return h.div(text, cls="note", css={"--c": color})


def button(label: Child, do: str, title: str = "", cls: str = "", **more: object) -> Element:
    """A small button: what it says, the command that it sends, and what that is for."""
    return h.button(label, cls=f"try {cls}".strip(), do=do, title=title or None, **more)


def joined(parts: Iterable[Child], between: str = " · ") -> Child:
    """Parts with the same between each two."""
    return [(between if k else None, part) for k, part in enumerate(parts)]


def chosen(is_so: bool, cls: str = "") -> dict[str, object]:
    """Attributes of a row or a picture of several: the chosen one is marked, and the page scrolls to it."""
    return {"cls": f"{cls} sel".strip(), "aria_current": "true", "data_shown": True} if is_so else {"cls": cls}


def segments(kind: str, options: Mapping[str, str], chosen: str, name: str = "") -> Element:
    """One of several: a press sends "kind:key"; `name` is for those who do not see it."""
    return h.div(
        (
            h.button(label, role="radio", aria_checked=str(key == chosen).lower(), do=f"{kind}:{key}")
            for key, label in options.items()
        ),
        cls="seg",
        role="radiogroup",
        aria_label=name or kind,
    )


def was(now: float, before: float | None) -> str | None:
    """What is said of a number that the edits changed; None where it is the same."""
    return None if before is None or abs(now - before) < CHANGED else f"was {before:.2f}"


def cell(content: Child, hint: str | None = None, cls: str = "n") -> Element:
    """A cell of a table, marked where its number was another one."""
    return h.td(content, cls=f"{cls} chg".strip() if hint else cls, title=hint)
