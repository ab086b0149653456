"""Pictures of the verdicts, each of an expression on the demo's frames, and of the order in which they are decided.

Of an answer only the expression is chosen here: objects, words and the stage at fault are the program's.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping
from functools import cache, partial
from itertools import groupby
from pathlib import Path

import numpy as np
from svg import BAD, DOUBT, EDGE, INK, QUIET, REFERENCE, SURFACE, TARGET, TRUTH, Card, measured

from pipeline.answering import Header, PredictedAnswer, Prediction, open_pipeline, write_predictions
from pipeline.datasets.demo import demo_labels, demo_run
from pipeline.diagnosis.answer import Answer, stages_of, unasked_stages
from pipeline.diagnosis.not_seen import SceneMaps
from pipeline.diagnosis.opened import Opened
from pipeline.diagnosis.verdict import shown_verdict
from pipeline.evaluation import import_run, open_run
from pipeline.evaluation.run_folder import Run
from pipeline.geometry.boxes import Box3D
from pipeline.geometry.camera import Camera
from pipeline.geometry.frame import Frame
from pipeline.geometry.palette import VERDICTS, hex_color, ink
from pipeline.pictures.looks import Look, Named
from pipeline.pictures.marks import box_edges_2d, roles_of, tinted, window
from pipeline.pictures.shapes import CHECK, CROSS, LEVEL, POINT
from pipeline.scenes.object_map import map_scene

OF_THE_RUN = {
    "CORRECT": ("000001/000000", "aa1dbb4cde209aa5"),
    "PARSE": ("000003/000001", "c1e7da6aaddb2b10"),
    "LABEL": ("000001/000000", "60c0e50d408d929e"),
    "OPM-TARGET": ("000002/000001", "6f1ee17f544f7ae5"),
    "OPM-REF": ("000001/000000", "4b9bd8cda1bbec17"),
    "LIFT": ("000001/000000", "69ebaf4875587143"),
    "SRM": ("000002/000002", "e977939fec2ab45e"),
    "OPM-CONF": ("000003/000001", "df0cbb6075ca4195"),
    "PRM": ("000002/000002", "2696481ec97296ac"),
    "COMPOUND": ("000002/000002", "da6d4c13ab169e39"),
}
"""An expression of the demo's run for each verdict: its frame and its id."""
STAGE = (24, 72, 520, 390)
"""Where the picture is."""
STRIP = 520
MARK = {"good": (TRUTH, CHECK), "doubt": (DOUBT, POINT), "bad": (BAD, CROSS), "idle": (QUIET, LEVEL)}


@cache
def run() -> Run:
    """The demo's run."""
    return open_run(demo_run())


@cache
def opened() -> Opened:
    """The pipeline of the demo's run."""
    return Opened(run().source, run().labels)


def unseen() -> Answer:
    """An answer about what the frame does not show, by an object map of its scene."""
    plain = open_pipeline("demo")
    frames = tuple(i for i in plain.dataset.frame_ids if i.startswith("000001/"))
    maps = SceneMaps({"000001": map_scene(plain, "000001", frames)})
    return maps.answered(Opened(plain).ask(frames[0], "pillow on the armchair"))


def unexplained() -> Answer:
    """An answer of a file that gives a box and nothing else: that of the picture for OPM-CONF."""
    told = run().answer(*OF_THE_RUN["OPM-CONF"])
    assert told.trace is not None
    assert told.target is not None
    x0, y0, x1, y1 = (float(v) for v in told.target.bbox)
    line = Prediction(told.trace.frame.id, told.text, answer=PredictedAnswer(box=(x0, y0, x1, y1)))
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "p.jsonl"
        write_predictions(file, Header(system="a system that tells its answer only"), [line])
        import_run(file, "demo", demo_labels(), Path(folder) / "run", plots=False)
        return open_run(Path(folder) / "run").failures()[0].answer


def answer_of(verdict: str) -> Answer:
    """The example of a verdict."""
    if verdict == "NOT-SEEN":
        return unseen()
    if verdict == "UNEXPLAINED":
        return unexplained()
    if verdict == "ATTRIBUTE":
        return opened().ask("000004/000001", "the large lamp")
    return run().answer(*OF_THE_RUN[verdict])


def verdict_card(verdict: str) -> Card:
    """Picture of a verdict: the question, the frame with the answer and the right pair, the stage at fault, and why."""
    answer = answer_of(verdict)
    told, judged = answer.story, answer.diagnosis
    assert answer.verdict == verdict, (answer.verdict, verdict)
    card = Card(960, 584, f"{verdict}: “{answer.text}”. {told.sentence}")
    question(card, answer)
    frame = answer.trace.frame if answer.trace is not None else judged.evidence.answers.context.frame  # type: ignore[union-attr]
    photo(card, answer, frame, solid=verdict == "LIFT")
    x, width = STAGE[0] + STAGE[2] + 24, 960 - STAGE[2] - 72
    detail = "" if judged is None else shown_verdict(judged.verdict, judged.detail, judged.lucky)
    color = hex_color(VERDICTS[verdict])
    card.chip(x, STAGE[1] + 18, detail or verdict, color, ink(color), 18)
    y = card.paragraph(x, STAGE[1] + 78, told.head, width, 27, bold=True, most=2) + 4
    y = card.paragraph(x, y, told.sentence, width, 21) + 12
    card.paragraph(x, y, told.mend, width, 19, QUIET)
    strip(card, answer)
    return card


def question(card: Card, answer: Answer) -> None:
    """Write the question, its target and reference in their colours."""
    colors = [INK] * len(answer.text)
    for span in () if answer.trace is None else answer.trace.query.spans:
        if span.role in ("target", "reference"):
            color = TARGET if span.role == "target" else REFERENCE
            colors[span.start : span.end] = [color] * (span.end - span.start)
    letters = zip(f"“{answer.text}”", [INK, *colors, INK], strict=True)
    parts = [("".join(letter for letter, _ in same), color) for color, same in groupby(letters, lambda at: at[1])]
    card.spans(24, 46, parts, min(27.0, 27 * 900 / measured(answer.text, 27, True)))


def photo(card: Card, answer: Answer, frame: Frame, *, solid: bool) -> None:
    """Show the frame with the objects of the answer and of the right pair; with their 3D boxes where `solid`."""
    look = Look(answer, frame)
    x, y, width, height = STAGE
    rgb = frame.rgb if look.trace is None else tinted(frame.rgb, look.trace.objects, roles_of(answer.pairs[0]))
    ends = np.array([named.bbox for named in look.all]).reshape(-1, 4)
    image, zoom, corner = window(rgb, ends, (width, height), least=0.5)
    card.picture(image, x, y, width, height)
    card.add(f'<clipPath id="stage"><rect x="{x}" y="{y}" width="{width}" height="{height}" rx="8"/></clipPath>')
    card.add('<g clip-path="url(#stage)">')
    boxes = [(named, (named.bbox.reshape(2, 2) - corner) * zoom + [x, y]) for named in look.all]
    for named, box in boxes:
        shape = named.box if solid else None
        outline(card, named, box, None if shape is None else edges(shape, frame.camera, corner, zoom))
    if solid and answer.diagnosis is not None:
        for box in answer.diagnosis.labelled_boxes().values():
            card.path(edges(box, frame.camera, corner, zoom), stroke=TRUTH, line=3, dash="9 7")
    filled: list[tuple[float, float, float, float]] = []
    for named, box in reversed(boxes):
        tag(card, named, box, filled)
    card.add("</g>")
    if answer.unseen is not None:
        inset(card, answer.unseen.frames[0], answer.text)
    legend(card, look)


def edges(box: Box3D, camera: Camera, corner: np.ndarray, zoom: float) -> str:
    """SVG path of the edges of a 3D box in the picture."""
    lines = (box_edges_2d(box, camera) - corner) * zoom + [STAGE[0], STAGE[1]]
    return "".join(f"M{a[0]:.1f} {a[1]:.1f}L{b[0]:.1f} {b[1]:.1f}" for a, b in np.clip(lines, -2000, 3000))


def outline(card: Card, named: Named, box: np.ndarray, solid: str | None) -> None:
    """Draw an object's box, dashed where it is the right one and not the answer's."""
    (x0, y0), (x1, y1) = box
    path = solid or f"M{x0:.1f} {y0:.1f}H{x1:.1f}V{y1:.1f}H{x0:.1f}Z"
    card.path(path, stroke="#000000", line=6)
    card.path(path, stroke="#{:02x}{:02x}{:02x}".format(*named.color), line=3, dash="" if named.given else "9 7")


def tag(card: Card, named: Named, box: np.ndarray, filled: list[tuple[float, float, float, float]]) -> None:
    """Write an object's name at its box, where no other name is."""
    (x0, y0), (x1, y1) = box
    left, top, wide, high = STAGE
    width, height = measured(named.name, 17, True) + 19, 27.0
    places = [
        (x0, y0 - height - 3),
        (x0, y1 + 3),
        (x1 + 3, y0),
        (x0 - width - 3, y0),
        (x1 - width, y0 - height - 3),
        (x0 + 4, y0 + 4),
        (x0 + 4, y1 - height - 4),
        (x0, y0 - 2 * height - 6),
        (x0, y1 + height + 6),
    ]

    def fits(at: tuple[float, float]) -> bool:
        a, b = at
        inside = left + 4 <= a and a + width <= left + wide - 4 and top + 4 <= b and b + height <= top + high - 4
        return inside and not any(
            a < u + w + 2 and u < a + width + 2 and b < v + h + 2 and v < b + height + 2 for u, v, w, h in filled
        )

    clipped = [
        (float(np.clip(a, left + 4, left + wide - width - 4)), float(np.clip(b, top + 4, top + high - height - 4)))
        for a, b in places
    ]
    a, b = next((at for at in (*places, *clipped) if fits(at)), clipped[0])
    filled.append((a, b, width, height))
    card.chip(a, b + height / 2, named.name, "#{:02x}{:02x}{:02x}".format(*named.color), "#0e1014", 17)


def inset(card: Card, frame_id: str, text: str) -> None:
    """Show the frame that sees what this one does not, over a corner."""
    other = Opened(open_pipeline("demo")).ask(frame_id, text)
    assert other.trace is not None
    assert other.target is not None
    width, height = 216, 162
    x, y = STAGE[0] + STAGE[2] - width - 10, STAGE[1] + STAGE[3] - height - 10
    rgb, box = other.trace.frame.rgb, np.asarray(other.target.bbox, float).reshape(2, 2)
    zoom = width / rgb.shape[1]
    card.box(x - 4, y - 32, width + 8, height + 36, fill=SURFACE, stroke=EDGE, radius=8)
    card.text(x + 2, y - 11, f"frame {frame_id}", 16, INK, bold=True)
    card.picture(rgb[::2, ::2], x, y, width, height)
    (x0, y0), (x1, y1) = box * zoom + [x, y]
    card.box(x0, y0, x1 - x0, y1 - y0, stroke="#000000", line=6)
    card.box(x0, y0, x1 - x0, y1 - y0, stroke=TRUTH, line=3)


def legend(card: Card, look: Look) -> None:
    """Write below the picture which colour is what."""
    x, y = float(STAGE[0]), STAGE[1] + STAGE[3] + 27
    given = {named.role for named in look.given}
    for color, words, dash, shown in (
        (TARGET, "answer", "", "target" in given),
        (REFERENCE, "its reference", "", "reference" in given),
        (TRUTH, "right by the labels", "9 7", bool(look.missed)),
    ):
        if shown:
            card.lines([(x, y - 6), (x + 30, y - 6)], stroke=color, line=4, dash=dash)
            x += 40 + card.text(x + 40, y, words, 17, QUIET) + 20


def strip(card: Card, answer: Answer) -> None:
    """Draw the stages in order, each with its mark; the failed one is filled."""
    judged = answer.diagnosis or answer.unseen
    made = unasked_stages(judged, 0, "PARSE") if answer.trace is None else stages_of(answer.trace, judged)
    stages = [s for s in made if s.name != "LABEL" or answer.verdict == "LABEL"]
    gap, height, size = (26, 42, 19) if len(stages) < 6 else (18, 42, 16)
    width = (912 - gap * (len(stages) - 1)) / len(stages)
    for number, stage in enumerate(stages):
        x, (color, lines) = 24 + number * (width + gap), MARK[stage.mark]
        failed = stage.mark == "bad"
        card.box(x, STRIP, width, height, fill=color if failed else SURFACE, stroke=color, line=2, radius=9)
        paint = "#0e1014" if failed else color
        wide = measured(stage.name, size, True) + 26
        left = x + (width - wide) / 2
        for line in lines:
            points = [(left + 22 * a - 4, STRIP + height / 2 + 22 * (b - 0.5)) for a, b in line]
            card.lines(points, stroke=paint, line=3)
        card.text(left + 23, STRIP + 28, stage.name, size, "#0e1014" if failed else INK, bold=True)
        if number < len(stages) - 1:
            card.arrow((x + width + 4, STRIP + height / 2), (x + width + gap - 4, STRIP + height / 2), head=9)


QUESTIONS = (
    ("Read as meant, and on the right target?", "CORRECT", "lucky: with a wrong reference"),
    ("Read as something else?", "PARSE", "a word, the grammar, what is not judged"),
    ("Is the label too narrow, or wrong?", "LABEL", "another right answer, or marked"),
    ("With a map: is it out of view?", "NOT-SEEN", "outside the picture, or hidden"),
    ("Is no candidate a right target?", "OPM-TARGET", "absent, badly boxed, low score"),
    ("Is no candidate pair a right one?", "OPM-REF", "the same, of the reference"),
)
MENDS = (
    ("true 3D boxes", ("LIFT",), "a 3D box is off"),
    ("true looks", ("ATTRIBUTE",), "a colour, size or shape is misjudged"),
    ("true relations", ("SRM",), "a relation is misjudged"),
    ("true scores", ("OPM-CONF", "PRM"), "no such thing won · a real one won"),
    ("only several of them", ("COMPOUND",), "several modules together"),
    ("the file does not say", ("UNEXPLAINED",), "only of imported predictions"),
)


def decision_card() -> Card:
    """Picture of the order in which verdicts are decided."""
    card = Card(960, 874, "The order in which verdicts are decided; the first that fits is given")
    card.text(24, 46, "Which verdict? The first question with a yes decides.", 26, bold=True)
    y = 74.0
    for text, verdict, words in QUESTIONS:
        card.box(24, y, 410, 46, fill=SURFACE, stroke=EDGE, radius=8)
        card.text(40, y + 30, text, 20)
        card.arrow((440, y + 23), (492, y + 23))
        card.text(464, y + 14, "yes", 16, QUIET, anchor="middle")
        chips(card, 502, y + 23, (verdict,), words)
        card.arrow((60, y + 48), (60, y + 64), head=8)
        card.text(76, y + 62, "no", 16, QUIET)
        y += 66
    card.box(24, y, 912, 46, fill=SURFACE, stroke=TARGET, line=2, radius=8)
    card.text(40, y + 30, "A right pair was among the candidates and lost. Whose truth alone makes it win?", 20)
    y += 64
    card.lines([(60, y - 16), (60, y + 5 * 56 + 22)], stroke=QUIET)
    for text, verdicts, words in MENDS:
        card.arrow((60, y + 22), (96, y + 22))
        card.box(102, y, 250, 44, fill=SURFACE, stroke=EDGE, radius=8)
        card.text(118, y + 29, text, 20)
        card.arrow((358, y + 22), (386, y + 22))
        chips(card, 396, y + 22, verdicts, words)
        y += 56
    return card


def chips(card: Card, x: float, y: float, verdicts: tuple[str, ...], words: str) -> None:
    """Write verdicts in their colours, and what they mean."""
    for verdict in verdicts:
        color = hex_color(VERDICTS[verdict])
        x += card.chip(x, y, verdict, color, ink(color), 17) + 8
    card.text(x + 4, y + 6, words, 18, QUIET)


PICTURES: Mapping[str, Callable[[], Card]] = {
    "verdict-order": decision_card,
    **{f"verdict-{verdict.lower()}": partial(verdict_card, verdict) for verdict in VERDICTS},
}
