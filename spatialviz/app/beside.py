"""A second detector beside the own one: whose boxes are shown, where, and what the two agree on."""

from __future__ import annotations

from collections.abc import Iterator
from typing import get_args

import numpy as np

from pipeline.answering.agreement.agreement import MIN_IOU
from pipeline.answering.agreement.frames import SecondDetections
from pipeline.geometry.boxes import Box3D, edge_lines
from pipeline.geometry.palette import hex_color, ink, palette
from spatialviz.app.context import Context, Part, choice, command
from spatialviz.app.markup import (
    DOUBT,
    GOOD,
    Child,
    Element,
    detector_score,
    dot,
    h,
    heading,
    note,
    panel,
    segments,
    term,
)  # fmt: skip
from spatialviz.app.scene import GHOST_GROWTH, Tag, extent
from spatialviz.app.state import Layers, State
from spatialviz.report.picture import dashed

DASH = 0.055
"""Length of a dash with its gap, metres."""
ANCHOR = "/tags/beside"


class BesideLayer(Part):
    """Draws the second detector's boxes, and takes what is asked of it."""

    def __init__(self, ctx: Context) -> None:
        super().__init__(ctx)
        self._drawn: tuple[object, ...] = ()
        self._tags: list[Tag] = []

    @command("layer")
    def show(self, which: str) -> None:
        """Show the boxes of "both", "a" or "b"; or the "next" of them."""
        layers = choice(get_args(Layers), self.state.layers, which)
        if layers is not None and self.state.beside is not None:
            self.ctx.show(layers=layers)

    @command("beside")
    def _select(self, places: str) -> None:
        """Select "3,5": object 3 of the own detector and 5 of the second; -1 for none."""
        beside = self.state.beside
        own, _, other = places.partition(",")
        if beside is None or not all(n.lstrip("-").isdecimal() for n in (own, other)):
            return
        i, j = int(own), int(other)
        if i < len(self.state.shown.objects) and j < len(beside.objects):
            self._choose(None if i < 0 else i, None if j < 0 else j)

    @command("next-disagreement")
    def _step(self, step: int) -> None:
        """Go to the next disagreement, or to one before."""
        rows = () if self.state.beside is None else self.state.beside.disagreements
        if rows:
            at = chosen_row(self.state)
            place = rows.index(at) + step if at in rows else 0 if step > 0 else -1
            self._choose(*rows[place % len(rows)])

    def _choose(self, own: int | None, second: int | None) -> None:
        layers = self.state.layers
        # What is chosen must be seen.
        hidden = layers != "both" and (own if layers == "a" else second) is None
        self.ctx.show(selected=own, second=second, layers="both" if hidden else layers)

    def follow(self, live: bool = False) -> list[Tag]:
        """Bring the scene up to the state, and return the names to show; while a hand is at a box nothing changes."""
        state = self.state
        objects, chosen = state.second_layer, state.second_selected
        marks = (state.source, state.frame_id, bool(objects), chosen, state.layers, state.boxes_shown, state.dark)
        if live or marks == self._drawn:
            return self._tags
        self._drawn = marks
        color, alike = np.array(palette(state.dark)["second"]), _alike(state)
        faint = (color + (20 if state.dark else 250)) // 2
        boxes = {j: self.ctx.scene.shown_box(o.lifted.box) for j, o in enumerate(objects) if o.lifted.box is not None}
        shown = boxes if state.boxes_shown else {}
        drawn = (
            ("alike", [j for j in shown if j in alike], faint, 1.2),
            ("apart", [j for j in shown if j not in alike], color, 2.2),
            ("chosen", [j for j in boxes if j == chosen], color, 4.0),
        )
        with self.ctx.client.atomic():
            for name, which, look, width in drawn:
                # A little larger, so that they do not lie in the very lines of the own boxes.
                lines = dashed(edge_lines([boxes[j] for j in which], GHOST_GROWTH), DASH)
                self.ctx.client.lines(f"/beside/{name}", lines, look, width)
            self._tags = [self._tag(state.beside, j, boxes[j]) for j in boxes if state.beside and j == chosen]
        return self._tags

    def _tag(self, beside: SecondDetections, j: int, box: Box3D) -> Tag:
        anchor, color = self.ctx.client.anchor(ANCHOR, box.center), hex_color(palette(self.state.dark)["second"])
        name, detail = f"B {second_name(beside, j)}", detector_score(beside.objects[j].score)
        return Tag(anchor, name, detail, color, True, extent=extent(box))


def _alike(state: State) -> set[int]:
    """The second detector's objects that need not stand out: the own one, which is shown too, found the same."""
    if state.beside is None or state.layers != "both":
        return set()
    return set(state.beside.found.pairs[state.beside.found.same, 1].tolist())


def second_name(beside: SecondDetections, j: int) -> str:
    """The name of one of the second detector's objects."""
    return f"{beside.objects[j].label}·{j}"


def layers_html(state: State) -> Element | None:
    """Whose boxes are shown; nothing without a second detector."""
    if state.beside is None:
        return None
    a, b = state.beside.names
    cells = segments("layer", {"both": "Both", "a": "A", "b": "B"}, state.layers, "Boxes")
    return h.div(h.span("Boxes", cls="label"), cells, cls="row", title=f"A: {a}, solid; B: {b}, dashed (Shift+B)")


def second_overlay(state: State, beside: SecondDetections, unit: float) -> Iterator[Element]:
    """The second detector's 2D boxes as parts of an SVG: dashed, faint where the own one found the same."""
    color, tag = hex_color(palette(True)["second"]), hex_color(palette(False)["second"])
    alike = _alike(state)
    for j, entry in enumerate(state.second_layer):
        chosen = j == state.second_selected
        if not chosen and not state.boxes_shown:
            continue
        x0, y0, x1, y1 = (float(v) for v in entry.bbox)
        width, opacity = (1.8, 1.0) if chosen else (0.8, 0.5) if j in alike else (1.2, 0.95)
        yield h.rect(
            x=f"{x0:.1f}", y=f"{y0:.1f}", width=f"{x1 - x0:.1f}", height=f"{y1 - y0:.1f}", fill="none",
            stroke=color, stroke_width=f"{width * unit:.2f}", opacity=opacity,
            stroke_dasharray=f"{3.2 * unit:.1f} {2.2 * unit:.1f}",
        )  # fmt: skip
        if chosen:
            yield from name_tag(f"B {second_name(beside, j)}", x0, y1, entry.mask.shape, unit, tag)


def name_tag(text: str, x: float, y: float, shape: tuple[int, ...], unit: float, color: str) -> tuple[Element, Element]:
    """A name on its colour in the picture, its upper left corner at (x, y) or as near as the picture's `shape` lets."""
    width, height = (len(text) * 6.2 + 8) * unit, 14 * unit
    x, y = max(min(x, shape[1] - width), 0), min(max(y, 0), shape[0] - height)
    return (
        h.rect(
            x=f"{x:.1f}", y=f"{y:.1f}", width=f"{width:.1f}", height=f"{height:.1f}", rx=f"{2 * unit:.1f}", fill=color
        ),
        h.text(
            text, x=f"{x + 4 * unit:.1f}", y=f"{y + 10.4 * unit:.1f}", font_size=f"{10.5 * unit:.1f}",
            font_weight=600, fill=ink(color), font_family="system-ui,sans-serif",
        ),
    )  # fmt: skip


def agreement_html(state: State) -> Element:
    """Counts, figures, and a row for each disagreement; a click selects what it is about."""
    beside = state.beside
    if beside is None:
        reason = "The detectors are compared beside an answer, not beside labels."
        return panel(note(reason if state.labels is not None else "There is nothing to compare in this frame."))
    sums, a, b = beside.sums, *beside.names
    second, other = hex_color(palette(state.dark)["second"]), hex_color(palette(state.dark)["other"])
    whose = (dot(palette(state.dark)["other"]), f"A {a} \u2003", hollow(second), f"B {b}")
    title = heading("Agreement", h.span(whose, title=f"A: {a}, B: {b}"))
    if not sums.a + sums.b:
        return panel(title, h.div("Neither finds anything that the other knows.", cls="dim"), _beyond(beside))
    shares = (
        (sums.both, GOOD, "alike", ""),
        (sums.otherwise, DOUBT, "named otherwise", ""),
        (sums.only_a, other, "only A", ""),
        (sums.only_b, second, "only B", "second"),
    )
    shown = {"agreement": sums.share, "of places": sums.share_placed, "mean IoU": sums.mean_iou,
             "scores ρ": sums.score_correlation}  # fmt: skip
    figures = ((name, "–" if p is None else f"{p:.2f}".replace("-", "−")) for name, p in shown.items())
    return panel(
        title,
        h.div(
            (
                h.i(cls=kind, css={"--c": color, "flex": str(count)}, title=f"{count} {name}")
                for count, color, name, kind in shares
                if count
            ),
            cls="agree",
        ),
        h.div(
            (
                h.span(h.span(cls="hollow" if kind else "dot", css={"--c": color}), f"{count} {name}")
                for count, color, name, kind in shares
            ),
            cls="legend",
        ),
        h.div((h.span(h.b(value), term(name), cls="dim") for name, value in figures), cls="kappas"),
        _rows(state, beside),
        _beyond(beside),
    )


def _rows(state: State, beside: SecondDetections) -> Child:
    found, colors = beside.found, palette(state.dark)
    iou = {(int(i), int(j)): float(v) for (i, j), v in zip(found.pairs, found.iou, strict=True)}
    rows = []
    for i, j in beside.disagreements:
        own = other = (h.td("–", cls="none"), h.td())
        if i is not None:
            # The question may name it otherwise than the detector does where it is asked for everything.
            name = f"{found.labels_a[i]}·{state.shown.names[i].rpartition('·')[2]}"
            own = _cells(dot(colors[state.roles.get(i, "other")]), name, float(found.scores_a[i]))
        if j is not None:
            mark = hollow(hex_color(palette(state.dark)["second"]))
            other = _cells(mark, second_name(beside, j), float(found.scores_b[j]))
        if i is not None and j is not None:
            overlap, hint = iou[i, j], "overlap of the two"
        else:
            overlap = float(found.nearest_b[j] if i is None else found.nearest_a[i])
            why = "which stands for another already" if overlap >= MIN_IOU else "too little"
            hint = f"overlap with the nearest of the other detector, {why}"
        ends = ",".join(str(-1 if k is None else k) for k in (i, j))
        rows.append(
            h.tr(
                own, other, h.td(f"{overlap:.2f}", cls="n dim", title=hint), id=f"apart-{ends.replace(',', '-')}",
                cls="r", do=f"beside:{ends}", aria_current="true" if (i, j) == chosen_row(state) else None,
            )
        )  # fmt: skip
    if not rows:
        return h.div("They disagree on nothing.", cls="dim")
    score = h.th(term("score"), cls="n s")
    head = h.tr(h.th("A"), score, h.th("B"), score, h.th(term("IoU"), cls="n s"))
    return (
        heading(f"Disagreements ({len(rows)})", h.kbd("Shift"), " ", h.kbd("J"), " next"),
        h.div(h.table(head, rows, cls="apart"), cls="scroll disagreements"),
    )


def chosen_row(state: State) -> tuple[int | None, int | None]:
    """What is selected of the two detectors, as a row of the disagreements has it."""
    own, second = state.selected, state.second_selected
    if state.beside is None:
        return None, None
    return state.beside.partner_of_b(second) if own is None else own, second


def _cells(mark: Element, name: str, score: float) -> tuple[Element, Element]:
    return h.td(h.span(mark, h.b(name), cls="name"), title=name), h.td(detector_score(score), cls="n dim")


def hollow(color: str) -> Element:
    """The dashed square that marks the second detector's objects."""
    return h.span(cls="hollow", css={"--c": color})


def _beyond(beside: SecondDetections) -> Element | None:
    sums = beside.sums
    if not sums.beyond_a + sums.beyond_b:
        return None
    parts = [f"{n} of {name}" for n, name in ((sums.beyond_a, "A"), (sums.beyond_b, "B")) if n]
    return h.div(f"Not counted, of classes that the other does not know: {', '.join(parts)}.", cls="dim small")
