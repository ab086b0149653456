"""Evidence of the stages OPM and LIFT: the candidates of each name, and what became of the pixels of an object."""

from __future__ import annotations

import numpy as np

from pipeline.answering.ask import Trace
from pipeline.answering.objects import SceneObject
from pipeline.answering.ranking import Candidates
from pipeline.diagnosis.verdict import Diagnosis, Missed
from pipeline.geometry.lifting import Pixel
from pipeline.geometry.palette import DROPPED, RGB, hex_color, palette, second_color
from spatialviz.app.beside_html import hollow, second_name
from spatialviz.app.markup import Child, Element, h
from spatialviz.app.objects import score, thumb
from spatialviz.app.state import State
from spatialviz.app.text import chosen, dot, named, note, panel, words

KEPT: RGB = (53, 169, 107)


def candidates_evidence(state: State, trace: Trace) -> list[Child]:
    """For each name of the question a table of what may be meant by it, best first."""
    return [_candidates(state, n, name, found) for n, (name, found) in enumerate(trace.candidates.items())]


def _candidates(state: State, number: int, name: str, found: Candidates) -> Element:
    judged = state.judged if isinstance(state.judged, Diagnosis) else None
    raw = None if found.raw_scores is None or np.allclose(found.raw_scores, found.scores) else found.raw_scores
    rows = []
    for k in np.argsort(-found.scores, kind="stable").tolist():
        i = int(found.index[k])
        place = state.shown.place[i]
        called = found.labels[k] if found.labels and found.labels[k] != name else ""
        mark, cls = ("", "") if judged is None or not judged.gold else _mark(judged, i)
        rows.append(
            h.tr(
                h.td(thumb(state, place)),
                h.td(
                    named(palette(state.dark)[state.roles.get(place, "other")], state.shown.names[place]),
                    h.div(f"as {called}", cls="dim") if called else None,
                    h.div(mark, cls=f"mark {cls}".strip()) if mark else None,
                    cls="w",
                ),
                h.td(score(float(found.scores[k])), cls="n"),
                None if raw is None else h.td(f"{raw[k]:.2f}", cls="n dim"),
                id=f"candidate-{number}-{i}",
                do=f"object:{place}",
                hover=f"hover:{place}",
                **chosen(place == state.selected, "r"),
            )
        )
    if judged is not None and judged.missed is not None and judged.missed_name == name:
        rows.append(h.tr(h.td(_missed(judged.missed, name), colspan=4), cls="missed"))
    if not rows:
        rows = [h.tr(h.td("nothing of this name was found", cls="dim", colspan=4))]
    head = h.tr(
        h.td(),
        h.th("candidate"),
        h.th("score", cls="n", title=f"P(object | {name})"),
        None if raw is None else h.th("raw", cls="n", title="the detector's own score, before calibration"),
    )
    return h.table(h.caption(f"“{name}”"), h.thead(head), h.tbody(rows), cls="candidates")


def _mark(judged: Diagnosis, i: int) -> tuple[str, str]:
    """What a candidate is by the labels, and the class of that."""
    match, case = judged.evidence.match, judged.case
    labelled = int(match[i]) if i < len(match) else -1
    if labelled < 0:
        return "no labelled object", "low"
    roles = (("target", case.target_object), ("reference", case.reference_object))
    role = next((role for role, k in roles if k == labelled), None)
    if role is not None:
        return f"labelled {role}", "ok"
    truth = judged.truth
    return ("right, too", "ok") if labelled in case.acceptable else (f"labelled {truth.labels[labelled]}", "")


def _missed(missed: Missed, name: str) -> str:
    facts = [f"best overlap {missed.overlap:.2f}"]
    facts += [] if missed.score is None else [f"score {missed.score:.2f}"]
    facts += [] if missed.rank is None else [f"place {missed.rank} by score"]
    facts += ["suppressed by a better-scored box"] if missed.suppressed else []
    return f"missed: the right {name} ({', '.join(facts)})"


def lift_evidence(state: State, trace: Trace) -> list[Child]:
    """The objects of the chosen pair, and the one that is selected; what rests on an assumed up."""
    assumed = note("The up vector is assumed to be image-up.") if trace.viewer.up_source == "assumed" else None
    places = dict.fromkeys((*(state.pair or ()), *(() if state.selected is None else (state.selected,))))
    return [assumed, *(_own(state, i) for i in places)] if places else [assumed, h.p("No object is chosen.", cls="dim")]


def object_html(state: State) -> Element | None:
    """What is selected, of the detector that answers and of one beside it, as far as they are shown."""
    i, j = state.selected, state.second_selected
    second, title = None, None
    if j is not None and state.beside is not None and state.second_layer:
        second = state.second_layer[j]
        title = h.b(hollow(hex_color(second_color(state.dark))), f"B {second_name(state.beside, j)}")
    if i is None or i >= len(state.shown.objects) or not state.own_layer:
        return None if second is None else panel(_facts(second, title))
    # In front of it: below the facts it would not be seen.
    return panel(None if second is None else _brief(second, title), _own(state, i))


def _own(state: State, i: int) -> Element:
    return _facts(state.shown.objects[i], named(palette(state.dark)[state.roles.get(i, "other")], state.shown.names[i]))


def _score(entry: SceneObject) -> str:
    return f"score {score(entry.score)}" if score(entry.score) else ""


def _brief(entry: SceneObject, title: Child) -> Element:
    """An object in one line, beside one that is told in full."""
    facts = [_score(entry)] if _score(entry) else []
    if entry.lifted.box is not None:
        sides = " × ".join(f"{side:.2f}" for side in entry.lifted.box.size)
        facts = [f"{sides} m", f"{entry.lifted.quality.distance:.2f} m away", *facts]
    return h.h3(title, h.span(" · ".join(facts)))


def _facts(entry: SceneObject, title: Child) -> Element:
    """An object's size, its place, and what became of every pixel of its mask."""
    lifted, quality = entry.lifted, entry.lifted.quality
    facts = []
    if lifted.box is not None:
        width, height, depth = lifted.box.size
        facts += [
            ("size", f"{width:.2f} wide × {height:.2f} high × {depth:.2f} deep m"),
            ("distance", f"{quality.distance:.2f} m · yaw confidence {lifted.yaw_confidence:.2f}"),
        ]
    made = " by a segmenter" if quality.mask_source == "segmenter" else ""
    facts.append(("points", f"{quality.points:,} of {quality.mask_pixels:,} mask pixels{made} ({quality.kept:.0%})"))
    cleaned: list[Child] = []
    if lifted.evidence is not None and quality.mask_pixels:
        counts = lifted.evidence.counts()
        shares = [
            (words(reason), color, counts[reason.name.lower()] / quality.mask_pixels)
            for reason, color in {Pixel.KEPT: KEPT, **DROPPED}.items()
        ]
        shares = [share for share in shares if share[2]]
        bar = (h.i(css={"--c": hex_color(c), "width": f"{p:.1%}"}, title=f"{name} {p:.0%}") for name, c, p in shares)
        legend = (h.span(dot(color), f"{name} {p:.0%}") for name, color, p in shares)
        cleaned = [h.div(bar, cls="stack"), h.div(legend, cls="legend")]
    return h.article(
        h.h3(title, h.span(_score(entry))),
        cleaned,
        h.dl(((h.dt(name), h.dd(value)) for name, value in facts), cls="facts"),
        note("; ".join(quality.concerns)) if quality.concerns else None,
        cls="object",
    )
