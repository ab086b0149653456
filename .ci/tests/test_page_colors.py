"""The colours of the page: the core's roles, and every text is read on every ground that it may stand on."""

import re
from importlib import resources

import pytest

from pipeline.geometry.palette import dimming, hex_color, palette

CSS = (resources.files("spatialviz.app") / "static" / "theme.css").read_text("utf-8")
GROUNDS = ("bg", "panel", "raised", "hover", "field")
ACCENTS = ("accent-explain", "accent-evaluate", "accent-label")
TEXTS = ("text", "dim", "good", "doubt", "bad", "idle", "target", "reference", "truth", "edited", "other")


def colors(dark: bool) -> dict[str, str]:
    """Name to "#rrggbb" of a theme, as theme.css declares them."""
    theme = "dark" if dark else "light"
    block = re.search(rf"\n(?::root,)?\[data-theme={theme}\]\{{(.*?)\n\}}", CSS, re.S)
    assert block is not None
    found = dict(re.findall(r"--([\w-]+):([^;]+);", block[1]))
    prefix = "" if dark else r"\[data-theme=light\] "
    modes = re.findall(rf"(?:^|,){prefix}\[data-mode=(\w+)\]\{{[^}}]*--accent:([^;}}]+)", CSS, re.M)
    found |= {f"accent-{mode}": color for mode, color in modes}
    for name, value in found.items():
        if value.startswith("var(--"):
            found[name] = found[value[6:-1]]
        elif re.fullmatch("#[0-9a-f]{3}", value):
            found[name] = "#" + "".join(2 * c for c in value[1:])
    return found


def luminance(color: str) -> float:
    channels = (int(color[k : k + 2], 16) / 255 for k in (1, 3, 5))
    red, green, blue = (c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in channels)
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue


def contrast(one: str, other: str) -> float:
    low, high = sorted((luminance(one), luminance(other)))
    return (high + 0.05) / (low + 0.05)


@pytest.mark.parametrize("dark", [True, False])
def test_roles_have_the_colours_of_the_core(dark):
    page = colors(dark)
    assert {role: page[role] for role in palette(dark)} == {role: hex_color(c) for role, c in palette(dark).items()}


@pytest.mark.parametrize("dark", [True, False])
def test_every_text_is_read_on_every_ground(dark):
    page = colors(dark)
    low = {
        (text, ground): round(contrast(color, page[ground]), 2)
        for text, color in ((name, page[name]) for name in (*TEXTS, *ACCENTS))
        for ground in GROUNDS
        if contrast(color, page[ground]) < 4.5
    }
    assert not low
    assert contrast("#ffffff", "#767676") == pytest.approx(4.54, abs=0.01)


def test_what_is_dimmed_is_seen_on_a_light_ground() -> None:
    """White, too, whose form shows by its own shades."""
    page = colors(False)
    white, black = (
        hex_color(tuple((255 * dimming(False) @ [*color, 1]).round().astype(int))) for color in ([1] * 3, [0] * 3)
    )
    assert contrast(white, page["ground"]) > 1.3
    assert contrast(black, page["ground"]) > 7
    assert luminance(page["ground"]) < luminance(page["bg"])


@pytest.mark.parametrize("dark", [True, False])
def test_edges_of_controls_are_seen(dark):
    page = colors(dark)
    assert all(contrast(page["edge"], page[ground]) >= 3 for ground in GROUNDS)
