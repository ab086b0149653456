"""A second detector beside the own one: whose boxes are shown, its boxes in the picture, and what the two agree on."""

from __future__ import annotations

from pipeline.answering.agreement.agreement import MIN_IOU
from pipeline.answering.agreement.frames import SecondDetections
from pipeline.geometry.palette import hex_color, palette, second_color
from spatialviz.app.state import State
from spatialviz.app.text import DOUBT, GOOD, dot, heading, note, panel, safe, segments

SHOW_CHOSEN = (
    "const s=this.parentElement.querySelector('.scroll'),r=s&&s.querySelector('tr.sel');"
    "if(r&&(r.offsetTop<s.scrollTop||r.offsetTop+r.offsetHeight>s.scrollTop+s.clientHeight))"
    "s.scrollTop=r.offsetTop-s.clientHeight/2"
)


def second_name(beside: SecondDetections, j: int) -> str:
    """The name of one of the second detector's objects."""
    return f"{beside.objects[j].label}·{j}"


def layers_html(state: State) -> str:
    """Whose boxes are shown; nothing without a second detector."""
    if state.beside is None:
        return ""
    a, b = state.beside.names
    cells = segments("layer", {"both": "Both", "a": "A", "b": "B"}, state.layers)
    hint = safe(f"A: {a}, solid; B: {b}, dashed (Shift+B)")
    return f'<div class="row" title="{hint}"><label>Boxes</label>{cells}</div>'


def second_overlay(state: State, unit: float) -> list[str]:
    """The second detector's 2D boxes as parts of an SVG: dashed, faint where the own one found the same."""
    beside = state.beside
    if beside is None or not state.second_layer or not (state.flags.boxes or state.second_selected is not None):
        return []
    color, tag = hex_color(second_color(True)), hex_color(second_color(False))
    alike = set(beside.found.pairs[beside.found.same, 1].tolist())
    parts = []
    for j, entry in enumerate(beside.objects):
        chosen = j == state.second_selected
        if not chosen and not state.flags.boxes:
            continue
        x0, y0, x1, y1 = (float(v) for v in entry.bbox)
        faint = j in alike and state.layers == "both"
        width = 1.8 if chosen else 0.8 if faint else 1.2
        opacity = 1.0 if chosen else 0.5 if faint else 0.95
        parts.append(
            f'<rect x="{x0:.1f}" y="{y0:.1f}" width="{x1 - x0:.1f}" height="{y1 - y0:.1f}" fill="none" '
            f'stroke="{color}" stroke-width="{width * unit:.2f}" opacity="{opacity}" '
            f'stroke-dasharray="{3.2 * unit:.1f} {2.2 * unit:.1f}"/>'
        )
        if chosen:
            parts.append(name_tag(f"B {second_name(beside, j)}", x0, y1, entry.mask.shape, unit, tag))
    return parts


def name_tag(text: str, x: float, y: float, shape: tuple[int, ...], unit: float, color: str) -> str:
    """A name on its colour in the picture, its upper left corner at (x, y) or as near as the picture's `shape` lets."""
    width, height = (len(text) * 6.2 + 8) * unit, 14 * unit
    x, y = min(x, max(shape[1] - width, 0)), min(max(y, 0), shape[0] - height)
    return (
        f'<rect x="{max(x, 0):.1f}" y="{y:.1f}" width="{width:.1f}" height="{height:.1f}" '
        f'rx="{2 * unit:.1f}" fill="{color}"/>'
        f'<text x="{max(x, 0) + 4 * unit:.1f}" y="{y + 10.4 * unit:.1f}" font-size="{10.5 * unit:.1f}" '
        f'font-weight="600" fill="#fff" font-family="system-ui,sans-serif">{safe(text)}</text>'
    )


def agreement_html(state: State) -> str:
    """Counts, figures, and a row for each disagreement; a click selects what it is about."""
    beside = state.beside
    if beside is None:
        reason = "The detectors are compared beside an answer, not beside labels."
        return panel(note(reason if state.labels is not None else "There is nothing to compare in this frame."))
    sums, a, b = beside.sums, *beside.names
    second = hex_color(second_color(state.dark))
    other = hex_color(palette(state.dark)["other"])
    whose = f"{dot(palette(state.dark)['other'])}A {safe(a)} &emsp;{hollow(second)}B {safe(b)}"
    whose = f'<span title="{safe(f"A: {a}, B: {b}")}">{whose}</span>'
    title = heading("Agreement", whose)
    if not sums.a + sums.b:
        return panel(title, '<div class="dim">Neither finds anything that the other knows.</div>', _beyond(beside))
    shares = (
        (sums.both, GOOD, "alike", ""),
        (sums.otherwise, DOUBT, "named otherwise", ""),
        (sums.only_a, other, "only A", ""),
        (sums.only_b, second, "only B", "second"),
    )
    bar = "".join(
        f'<i class="{kind}" style="--c:{color};flex:{count}" title="{count} {name}"></i>'
        for count, color, name, kind in shares
        if count
    )
    legend = "".join(
        f'<span><span class="{"hollow" if kind else "dot"}" style="--c:{color}"></span>{count} {name}</span>'
        for count, color, name, kind in shares
    )
    figures = (
        ("agreement", sums.share, "2 alike / (A + B): what kappa tends to where empty places are beyond counting"),
        ("of places", sums.share_placed, "the same, however the two name what they both found"),
        ("mean IoU", sums.mean_iou, "of what both found"),
        ("scores ρ", sums.score_correlation, "rank correlation of the scores of what both found"),
    )
    cells = "".join(
        f'<span class="dim" title="{safe(hint)}"><b>{_figure(value)}</b>{name}</span>' for name, value, hint in figures
    )
    return panel(
        title,
        f'<div class="agree">{bar}</div><div class="legend">{legend}</div><div class="kappas">{cells}</div>',
        _rows(state, beside),
        _beyond(beside),
    )


def _figure(value: float | None) -> str:
    return "–" if value is None else f"{value:.2f}".replace("-", "−")


def _rows(state: State, beside: SecondDetections) -> str:
    color = second_color(state.dark)
    grey = palette(state.dark)
    iou = {(int(i), int(j)): float(v) for (i, j), v in zip(beside.found.pairs, beside.found.iou, strict=True)}
    rows = []
    for i, j in beside.disagreements:
        own = other = '<td class="none">–</td><td></td>'
        if i is not None:
            mark = dot(grey[state.roles.get(i, "other")])
            # The question may name it otherwise than the detector does where it is asked for everything.
            number = state.shown.names[i].rpartition("·")[2]
            own = _cell(mark, f"{beside.found.labels_a[i]}·{number}", float(beside.found.scores_a[i]))
        if j is not None:
            other = _cell(hollow(hex_color(color)), second_name(beside, j), float(beside.found.scores_b[j]))
        chosen = (i, j) == chosen_row(state)
        if i is not None and j is not None:
            overlap, hint = iou[i, j], "overlap of the two"
        else:
            near = beside.found.nearest_a if i is not None else beside.found.nearest_b
            overlap = float(near[i if i is not None else j])
            why = "which stands for another already" if overlap >= MIN_IOU else "too little"
            hint = f"overlap with the nearest of the other detector, {why}"
        message = f"sv('beside:{-1 if i is None else i},{-1 if j is None else j}')"
        rows.append(
            f'<tr class="r{" sel" if chosen else ""}" onclick="{message}">{own}{other}'
            f'<td class="n dim" title="{hint}">{overlap:.2f}</td></tr>'
        )
    if not rows:
        return '<div class="dim">They disagree on nothing.</div>'
    score = '<th class="n" title="the detector\'s own">score</th>'
    head = f'<tr><th>A</th>{score}<th>B</th>{score}<th class="n">IoU</th></tr>'
    widths = '<colgroup><col><col class="s"><col><col class="s"><col class="s"></colgroup>'
    height = 192 if not beside.sums.beyond_a + beside.sums.beyond_b else 218
    return (
        heading(f"Disagreements ({len(rows)})", "<kbd>Shift</kbd> <kbd>J</kbd> next")
        + f'<div class="scroll" style="--mh:max(150px, calc(50vh - {height}px))"><table class="apart">{widths}{head}'
        f'{"".join(rows)}</table></div><img src="" style="display:none" onerror="{safe(SHOW_CHOSEN)}">'
    )


def chosen_row(state: State) -> tuple[int | None, int | None]:
    """What is selected of the two detectors, as a row of the disagreements has it."""
    beside = state.beside
    if beside is None:
        return None, None
    second = state.second_selected
    if state.selected is None:
        return beside.partner_of_b(second), second
    return state.selected, second


def _cell(mark: str, name: str, score: float) -> str:
    said = "" if score >= 0.9995 else f"{score:.2f}"
    hint = safe(name)
    return f'<td title="{hint}"><span class="name">{mark}<b>{hint}</b></span></td><td class="n dim">{said}</td>'


def hollow(color: str) -> str:
    """The dashed square that marks the second detector's objects."""
    return f'<span class="hollow" style="--c:{color}"></span>'


def _beyond(beside: SecondDetections) -> str:
    sums = beside.sums
    if not sums.beyond_a + sums.beyond_b:
        return ""
    parts = [f"{n} of {name}" for n, name in ((sums.beyond_a, "A"), (sums.beyond_b, "B")) if n]
    return f'<div class="dim small">Not counted, of classes that the other does not know: {", ".join(parts)}.</div>'
