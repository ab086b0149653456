"""What colours in the scene mean: the depths of the bar, the areas of the decision map."""

from __future__ import annotations

import numpy as np

from pipeline.diagnosis.whatif.decision_map import DecisionMap
from pipeline.geometry.palette import depth_colors, depth_ends
from spatialviz.app.edit_scene import winner_colors
from spatialviz.app.images import png_url
from spatialviz.app.markup import Element, h
from spatialviz.app.state import State
from spatialviz.app.text import dot

STEPS = 128
"""Colours of the bar."""


def depth_bar(state: State) -> Element | None:
    """The colours of depths with their ends and their middle, metres, while these are shown."""
    if state.loaded is None or state.colors != "depth":
        return None
    depth = state.loaded.context.frame.depth
    low, high = depth_ends(depth)
    measured = depth[depth > 0]
    colors = depth_colors(np.linspace(low, high, STEPS, dtype=np.float32)[None], (low, high))
    bar = np.concatenate([colors[..., ::-1], np.full((1, STEPS, 1), 255, np.uint8)], axis=2)
    nearest, farthest = float(measured.min()), float(measured.max())
    return h.figure(
        h.figcaption("Depth"),
        h.img(src=png_url(bar), alt=f"colours from {low:.2f} m, red, to {high:.2f} m, blue", draggable="false"),
        h.div((h.span(f"{at:.2f} m") for at in (low, (low + high) / 2, high)), cls="ticks"),
        cls="depthbar",
        title=f"Nearer and farther ones have the colours of the ends: {nearest:.2f} to {farthest:.2f} m were measured.",
    )


def map_legend(state: State, found: DecisionMap | None) -> Element | None:
    """Who wins where, with the share of the floor."""
    if found is None:
        return None
    colors = winner_colors(found, state)
    winners, counts = np.unique(found.winner, return_counts=True)
    rows = (
        h.li(
            dot(colors[w]) if w >= 0 else h.span(cls="dot none"),
            h.b(state.named(found.keys[w]) if w >= 0 else "no pair"),
            h.span(f"{n / found.winner.size:.0%}"),
        )
        for n, w in sorted(zip(counts.tolist(), winners.tolist(), strict=True), reverse=True)
    )
    return h.figure(
        h.figcaption("Who wins if ", h.b(state.named(found.key)), " stands there"),
        h.ul(rows),
        h.p("paler where the next is close", cls="dim"),
        cls="maplegend",
    )
