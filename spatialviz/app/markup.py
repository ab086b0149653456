"""HTML elements with escaping by construction, their differences, and common pieces of panels.

Nothing else turns strings into HTML: text and attributes are escaped here, and no attribute can hold a
script or a style, as the page's content policy forbids both. Actions of an element are data for `static/page.mjs`:

===============  =======================================================================================
`do`             command sent by a click, and by Enter or the space bar while it has the focus
`local`          action of the browser alone on a click: a name of `static/page.mjs`, and its argument
`live`           command sent with the value of a field during a change, at most every 50 ms
`change`         command sent with the value of a field after a change
`enter`          command sent with the value of a text field by Enter, leaving the field; Escape reverts
`point`          command sent with the clicked point of a picture, as fractions of width and height
`band`           command sent with the rectangle drawn with Shift held, as the same fractions
`hover`          "hover:3", or of a pair "hover:3,7": the objects that hover or focus marks everywhere
`field`          a text field with a list of its own: a name of `static/fields.mjs`
`css`            custom properties and styles of this element alone
`color`          its colour, RGB, hex text or a name of `TONES`: the custom property `--c`
===============  =======================================================================================
"""

from __future__ import annotations

import html
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from typing import TypeAlias, cast

from pipeline.geometry.cleaning import Pixel
from pipeline.geometry.palette import RGB, hex_color
from pipeline.language.glossary import explained, find_term
from pipeline.system.frozen import dataclass

Child: TypeAlias = "Element | str | int | float | Iterable[Child] | None"
DATA = ("do", "local", "live", "change", "enter", "point", "band", "hover", "field")
ACTIVE = ("a", "button", "input", "select", "textarea", "option", "summary")
"""Elements with native keyboard access."""
VOID = ("br", "img", "input", "hr", "meta", "link")


@dataclass(frozen=True, slots=True)
class Element:
    """Element of the page."""

    name: str
    attributes: tuple[tuple[str, str], ...] = ()
    children: tuple[Element | str, ...] = ()  # Unescaped text

    @property
    def id(self) -> str:
        """Id on the page; "" for an element without an id."""
        return dict(self.attributes).get("id", "")

    @property
    def html(self) -> str:
        attributes = "".join(f' {name}="{html.escape(value, quote=True)}"' for name, value in self.attributes)
        if self.name in VOID:
            return f"<{self.name}{attributes}>"
        inner = "".join(html.escape(c, quote=False) if isinstance(c, str) else c.html for c in self.children)
        return f"<{self.name}{attributes}>{inner}</{self.name}>"

    @property
    def text(self) -> str:
        """Text without elements."""
        return "".join(c if isinstance(c, str) else c.text for c in self.children)

    def with_(self, **attributes: object) -> Element:
        """Copy with further attributes."""
        return replace(self, attributes=_attributes(self.name, dict(self.attributes) | attributes))


def _attributes(name: str, given: Mapping[str, object]) -> tuple[tuple[str, str], ...]:
    made: dict[str, str] = {}
    given = dict(given)
    color = given.pop("color", None)
    if color is not None:
        own = {"--c": TONES.get(color, color) if isinstance(color, str) else hex_color(cast(RGB, color))}
        given["css"] = own | cast(dict[str, str], given.get("css") or {})
    for key, value in given.items():
        if key.startswith("aria_") and isinstance(value, bool):
            value = str(value).lower()
        if value is None or value is False or (key == "cls" and not value):
            continue
        key = f"data-{key}" if key in DATA else "class" if key == "cls" else key.replace("_", "-")
        if key == "css":
            assert isinstance(value, Mapping)
            key, value = "data-css", ";".join(f"{k}:{v}" for k, v in value.items())
        if key.startswith("on") or key == "style":
            raise ValueError(f"no element has the attribute {key}: say what it does by `do`, how it looks by `css`")
        made[key] = "" if value is True else str(value)
    if "data-do" in made or "data-local" in made:
        if name not in ACTIVE:
            made.setdefault("tabindex", "0")
            if name not in ("tr", "td", "th"):
                made.setdefault("role", "button")
        elif name == "button":
            made.setdefault("type", "button")
    return tuple(made.items())


def _flat(children: Iterable[Child]) -> Iterator[Element | str]:
    for child in children:
        if isinstance(child, Element):
            yield child
        elif isinstance(child, (str, int, float)):
            yield from filter(None, [str(child)])
        elif child is not None:
            yield from _flat(child)


def _element(name: str, /, *children: Child, **attributes: object) -> Element:
    return Element(name, _attributes(name, attributes), tuple(_flat(children)))


class Tags:
    """Makes elements by name: `h.div("text", h.span("more"), cls="row", do="pair:3")`.

    Attributes of None or False are left out, True stands by its name, but ARIA's are "true" or "false"; `cls` is the
    class; `_` stands for `-`.
    """

    def __getattr__(self, name: str) -> Callable[..., Element]:
        return partial(_element, name)


h = Tags()


def changed(before: Element, after: Element) -> Iterator[tuple[str, str]]:
    """Replacements (id, HTML) turning an element of the page into another of the same id.

    Differing descendants with ids are replaced alone: a row, not the table. Added, removed or moved elements replace
    the whole parent.
    """
    if before == after:
        return
    if not _alike(before, after):
        yield after.id, after.html
        return
    for one, other in zip(before.children, after.children, strict=True):
        if isinstance(one, Element) and isinstance(other, Element):
            yield from changed(one, other)


def _alike(before: Element, after: Element) -> bool:
    """True if two elements differ only within descendants with ids."""
    if (before.name, before.attributes, len(before.children)) != (after.name, after.attributes, len(after.children)):
        return False
    for one, other in zip(before.children, after.children, strict=True):
        if isinstance(one, str) or isinstance(other, str):
            if one != other:
                return False
        elif one.id != other.id or not (one.id or _alike(one, other)):
            return False
    return True


TONES = {"good": "#35a96b", "doubt": "#e0982e", "bad": "#e5484d", "idle": "#8a919c"}
"""Colours by name."""
CHANGED = 0.005
"""Numbers are shown with two digits; smaller differences are equal."""


def term(name: str, shown: Child = None) -> Element:
    """Glossary word with its meaning as a tooltip, also on focus."""
    return h.abbr(name if shown is None else shown, title=f"{name}: {find_term(name).hint}", tabindex=0)


def with_terms(text: str, *names: str) -> Child:
    """Text with glossary tooltips on the given words."""
    parts = re.split(rf"\b({'|'.join(map(re.escape, names))})\b", text)
    return [term(part) if part in names else part for part in parts]


def hint_of(label: str, key_hint: str = "") -> str | None:
    """Tooltip of a control: glossary entry of its label, and key; None without either."""
    found = explained(label)
    return " ".join(filter(None, (f"{found.name}: {found.hint}" if found else "", key_hint))) or None


def dot(color: RGB) -> Element:
    """Filled square in a role's colour."""
    return h.span(cls="dot", color=color)


def named(color: RGB, name: str) -> Element:
    """Object's name, in the colour of its role."""
    return h.span(dot(color), h.b(name), cls="name", title=name)


def words(reason: Pixel) -> str:
    """Outcome of a pixel, in words."""
    return reason.name.lower().replace("_", " ")


def panel(*children: Child, cls: str = "") -> Element:
    """Parts inside a block."""
    return h.section(*children, cls=f"panel {cls}".strip())


def heading(text: Child, *aside: Child) -> Element:
    """Small heading with an optional remark at the right."""
    return h.h2(text, h.span(*aside))


def more(what: str) -> Element:
    """Switch between the first few rows of what follows it and all of it."""
    return h.details(h.summary(what), cls="more")


def note(text: Child, color: str = "doubt") -> Element:
    """Remark with a coloured edge."""
    return h.div(text, cls="note", color=color)


def button(label: Child, do: str, title: str = "", cls: str = "", **more: object) -> Element:
    """Small button: label, command, and tooltip."""
    return h.button(label, cls=f"try {cls}".strip(), do=do, title=title or None, **more)


def toggle(label: Child, do: str, on: bool, title: str | None, **look: object) -> Element:
    """Button that stays pressed while something is `on`."""
    return h.button(label, do=do, aria_pressed=on, title=title, **look)


def sign(mark: str, do: str, name: str, cls: str = "drop", **more: object) -> Element:
    """Button of a single sign; its name is the tooltip, too."""
    return h.button(mark, cls=cls, do=do, aria_label=name, **{"title": name, **more})


def textbox(name: str, hint: str = "", cls: str = "find", **more: object) -> Element:
    """Text field without the browser's own completions and spelling."""
    plain = {"spellcheck": "false", "autocomplete": "off", "title": hint or None}
    return h.input(cls=cls, aria_label=name, **(plain | more))


def slider(value: float, low: float = 0, high: float = 1, step: str = "0.01", **more: object) -> Element:
    """Slider of a number; `--v` is how far along it stands."""
    along, value = (value - low) / (high - low), round(value, 4)
    return h.input(type="range", min=low, max=high, step=step, value=value, css={"--v": f"{along:.4f}"}, **more)


def progress(name: str, done: float, of: float) -> Element:
    share = done / of if of else 0.0
    return h.div(
        h.i(css={"width": f"{share:.1%}"}),
        cls="prog",
        role="progressbar",
        aria_valuenow=round(100 * share),
        aria_label=name,
    )


def joined(parts: Iterable[Child], between: str = " · ") -> Child:
    """Parts with a separator."""
    return [(between if k else None, part) for k, part in enumerate(parts)]


def chosen(is_so: bool, cls: str = "") -> dict[str, object]:
    """Attributes of a row or picture: the chosen is marked, and scrolled into view."""
    return {"cls": f"{cls} sel".strip(), "aria_current": "true", "data_shown": True} if is_so else {"cls": cls}


def segments(
    kind: str, options: Mapping[str, str], chosen: str, name: str = "", hints: Mapping[str, str] | None = None
) -> Element:
    """Choice of an option: a press sends "kind:key"; `name` is the accessible name, `hints` default to the glossary.

    Tab stops at one of them; arrows go on from there.
    """
    stop = chosen if chosen in options else next(iter(options), "")
    return h.div(
        (
            h.button(
                label,
                role="radio",
                aria_checked=key == chosen,
                tabindex=0 if key == stop else -1,
                do=f"{kind}:{key}",
                title=hint_of(label) if hints is None else hints[key],
            )
            for key, label in options.items()
        ),
        cls="seg",
        role="radiogroup",
        aria_label=name or kind,
    )


def was(now: float, before: float | None) -> str | None:
    """Tooltip of a number changed by the edits; None if unchanged."""
    return None if before is None or abs(now - before) < CHANGED else f"was {before:.2f}"


def cell(content: Child, hint: str | None = None, cls: str = "n") -> Element:
    """Table cell, marked after a change of its number."""
    return h.td(content, cls=f"{cls} chg".strip() if hint else cls, title=hint)


def score_text(value: float) -> str:
    """Detector's score; "" for the dataset's own objects."""
    return "" if value >= 0.9995 else f"{value:.2f}"
