"""Failure page as HTML, self-contained: the page's own stages of an answer, without actions."""

from __future__ import annotations

import base64
import shlex
from collections.abc import Mapping, Sequence
from contextlib import redirect_stdout
from dataclasses import replace
from importlib import resources
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import viser

from pipeline import __version__
from pipeline.answering.frame_store import LoadedFrame
from pipeline.answering.objects import PreparedFrame
from pipeline.answering.pipeline import Pipeline
from pipeline.diagnosis.answer import Answer
from pipeline.diagnosis.cases.saving import OpenedCase
from pipeline.diagnosis.whatif.answer_view import NOTHING, ShownObjects
from pipeline.diagnosis.whatif.edits import Edits, read_edits
from pipeline.diagnosis.whatif.state import ViewState, encode
from pipeline.evaluation.leakage import Share, shares_of_answer, title_of
from pipeline.geometry.cloud import cloud_of, drawn_pixels, viewpoint
from pipeline.labels.reading import Labels
from pipeline.language.lexicon import wording
from pipeline.pictures.answer_card import SIZE, answer_picture
from pipeline.pictures.looks import frame_picture
from pipeline.system.encoded_pictures import jpeg_url
from pipeline.system.errors import InputError
from pipeline.system.frozen import dataclass
from pipeline.system.whole_files import write_whole
from spatialviz.app.answer import verdict_chip_of
from spatialviz.app.kept_pictures import IMAGES
from spatialviz.app.markup import Element, h, note
from spatialviz.app.scene import SceneView
from spatialviz.app.scene_client import SceneClient, triple
from spatialviz.app.stages import all_stages_html
from spatialviz.app.state import State
from spatialviz.app.viser_socket import served_by

POLICY = (
    "default-src 'none'; style-src 'unsafe-inline'; img-src data: blob:; frame-src 'self' data: blob:; "
    "script-src 'unsafe-inline' 'unsafe-eval' 'wasm-unsafe-eval' blob: data:; worker-src blob: data:; "
    "connect-src data: blob:; font-src data:"
)
"""The page and the scene in it may run what they hold, and fetch nothing from anywhere."""


LIVE = ("data-do", "data-hover", "data-shown", "tabindex", "type", "disabled", "aria-expanded", "aria-controls")
"""Attributes of actions."""


def failure_page(
    answered: Answer, source: Pipeline, context: PreparedFrame, subject: Subject, scene: str | None = None
) -> str:
    """HTML page of an answer.

    `scene`: a self-contained page of the scene in 3D, put into a frame of its own.
    """
    card = jpeg_url(answer_picture(answered, context.frame, subject.dataset), quality=QUALITY)
    image = jpeg_url(frame_picture(answered, context.frame, WIDEST), quality=QUALITY)
    views = [h.img(src=image, alt=answered.sentence)]
    if scene is not None:
        views.append(h.iframe(title="The scene in 3D", sandbox="allow-scripts", srcdoc=scene))
    body = h.main(
        h.img(src=card, alt=f"{answered.story.head}. {answered.story}", width=SIZE[0], height=SIZE[1], cls="head"),
        _header(answered, subject),
        h.div(views, cls="views"),
        all_stages_html(shown_state(answered, context)),
        h.h2("See it again"),
        (h.pre(command) for command in subject.commands),
        None if subject.state is None else (h.h3("The view as a string"), h.pre(subject.state)),
        h.h2("Made with"),
        h.dl(((h.dt(name), h.dd(value)) for name, value in _facts(answered, source, context, subject)), cls="facts"),
        h.footer(f"spatialviz {__version__}"),
    )
    static = resources.files("spatialviz.app") / "static"
    style = "".join((static / name).read_text("utf-8") for name in ("theme.css", "panels.css", "report.css"))
    return (
        '<!doctype html>\n<html lang="en" data-theme="light"><head><meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"{h.title(f'{answered.text} · {subject.frame}').html}\n"
        f"{h.meta(property='og:title', content=f'{answered.story.head}: “{answered.text}”').html}\n"
        f"{h.meta(property='og:description', content=str(answered.story)).html}\n<style>{style}</style></head>\n"
        f"<body>{still(body).html}</body></html>\n"
    )


def shown_state(answered: Answer, context: PreparedFrame) -> State:
    """View of an answer, as the page shows it."""
    trace, found = answered.trace, NOTHING
    if trace is not None:
        places = range(len(trace.objects))
        found = ShownObjects(trace.objects, tuple(map(trace.name, places)), {i: i for i in places})
    state = State(
        "",
        context.frame.id,
        loaded=LoadedFrame(context, ()),
        text=answered.text,
        trace=trace,
        found=found,
        error=answered.problem or "",
        stopped="" if trace is not None else "PARSE",
        judged=answered.diagnosis or answered.unjudged,
        dark=False,
    )
    return replace(state, pair=next(map(state.at, state.ranked), None))


def still(element: Element) -> Element:
    """Element without actions, with styles in place and pictures inside, for a page without a server."""
    attributes = {name: value for name, value in element.attributes if name not in LIVE}
    if "data-css" in attributes:
        attributes["style"] = attributes.pop("data-css")
    if (data := IMAGES.get(attributes.get("src", "").rpartition("/")[2])) is not None:
        attributes["src"] = f"data:image/jpeg;base64,{base64.b64encode(data).decode('ascii')}"
    children = tuple(child if isinstance(child, str) else still(child) for child in element.children)
    return Element("div" if element.name == "button" else element.name, tuple(attributes.items()), children)


def write_page(page: str, path: Path) -> None:
    """Write a page, whole or not at all."""
    write_whole(path, page.encode("utf-8", "replace"), "the report")


def _header(answered: Answer, subject: Subject) -> Element:
    """Verdict, question, reason and answer; a note where answer and truth share a maker."""
    judged, told = answered.diagnosis, answered.story
    title = "" if judged is None else title_of(subject.shares)
    return h.header(
        h.div(
            h.span("NO VERDICT", cls="dim") if judged is None else verdict_chip_of(judged),
            h.b(f"“{answered.text}”"),
            h.span(f"{subject.dataset} · frame {subject.frame}", cls="dim"),
            cls="eyebrow",
        ),
        h.h1(told.head),
        h.p(str(told), cls="lead"),
        h.p(f"Answer: {answered.sentence}.", cls="lead dim") if answered.pairs else None,
        note(f"{title[:1].upper()}{title[1:]}.") if title else None,
    )


def _facts(answered: Answer, source: Pipeline, context: PreparedFrame, subject: Subject) -> list[tuple[str, str]]:
    config, judged, frame = source.config, answered.diagnosis, context.frame
    rank = config.rank
    weights = f"target {rank.target_weight:g}, reference {rank.reference_weight:g}, relation {rank.relation_weight:g}"
    facts = [
        ("detector", f"{source.needed_detector().name}, the best {config.k} of each name"),
        ("relations by", source.scorer.name),
        ("weights", f"{weights}, {rank.aggregate}"),
        ("picture", f"{frame.width}×{frame.height}, up {context.viewer.up_source}"),
    ]
    if frame.depth_source:
        facts.append(("depth", frame.depth_source))
    if answered.trace is not None and answered.trace.score_calibration is not None:
        c = answered.trace.score_calibration
        facts.append(("scores", f"calibrated, a {c.a:.3f}, b {c.b:.3f}"))
    if judged is not None:
        case = judged.case
        meant = f"{case.target} {wording(case.relation)} {case.reference}" if case.meant is None else case.text
        right = f"{len(case.strict)} beyond doubt, {len(case.acceptable)} with the undecided"
        facts += [("meant", meant), ("correct answers", right)]
        facts += [("judged by", share.sentence) for share in subject.shares]
    return [*facts, *subject.facts]


@dataclass(frozen=True)
class Subject:
    """Description of the page's subject, besides the answer."""

    dataset: str  # Its name
    frame: str
    commands: tuple[str, ...]  # To see the same again
    state: str | None = None  # The view as one string
    facts: tuple[tuple[str, str], ...] = ()  # More about where it is from
    shares: tuple[Share, ...] = ()  # What the answer has in common with what made the truth that its verdict is by

    @staticmethod
    def of_case(opened: OpenedCase) -> Subject:
        """Description of a saved case."""
        m = opened.manifest
        root = str(opened.root)
        facts = [("case", m.name), ("kept", f"{m.created} by {m.tool}")]
        facts += [(str(key), str(value)) for key, value in m.run.items()]
        facts += [("note", note) for note in opened.notes]
        dataset = m.dataset.get("name", "")
        commands = tuple(shlex.join(["spatialviz", name, root]) for name in ("replay", "view"))
        return Subject(
            dataset,
            m.frame.id,
            commands,
            view_state(dataset, m.frame.id, m.text, m.edits),
            tuple(facts),
        )

    @staticmethod
    def of_dataset(
        path: str,
        source: Pipeline,
        context: PreparedFrame,
        text: str,
        options: Sequence[str] = (),
        labels: Labels | None = None,
    ) -> Subject:
        """Description of an expression on a frame, judged by labels or annotations; `options` of the command line."""
        frame = context.frame.id
        name = source.dataset.root.resolve().name
        commands = (
            shlex.join(["spatialviz", "ask", path, frame, text, *options]),
            shlex.join(["spatialviz", "save-case", path, frame, text, "--out", "CASE", *options]),
        )
        shares = shares_of_answer(source, labels)
        return Subject(name, frame, commands, view_state(name, frame, text, None), shares=shares)


def view_state(dataset: str, frame: str, text: str, edits: Mapping[str, Any] | None) -> str | None:
    """View string for `spatialviz view --state`; None where too large."""
    try:
        return encode(ViewState(dataset, frame, text, edits=read_edits(dict(edits)) if edits else Edits()))
    except InputError:
        return None


WIDEST, QUALITY = 1280, 86
"""Width of the frame's picture at most, pixels, and how well pictures are kept."""
MOST_POINTS = 40_000
ASPECT = 1.6
"""Width over height of the part of the page that shows the scene."""


def scene_html(answered: Answer, context: PreparedFrame) -> str:
    """HTML page of the scene, about 1.5 MB, drawn in the viewer's level frame, dark."""
    state = shown_state(answered, context)
    # The server says where it listens; nobody is to go there.
    with served_by(None), redirect_stdout(StringIO()):
        server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
        try:
            return _drawn(server, replace(state, dark=True, flags=replace(state.flags, boxes=True)), context)
        finally:
            server.stop()


def _drawn(server: viser.ViserServer, state: State, context: PreparedFrame) -> str:
    client, scene, frame = SceneClient(), server.scene, context.frame
    view = SceneView(client, lambda pixel, boxes: None)
    view.to_show = np.stack([context.viewer.right, context.viewer.forward, context.viewer.up])
    tags = view.draw(state)
    scene.set_up_direction("+z")
    scene.world_axes.visible = False
    scene.configure_environment_map(hdri=None)
    scene.configure_default_lights(cast_shadow=False)
    usable = drawn_pixels(frame)
    stride = max(1, int(np.ceil(np.sqrt(usable.sum() / MOST_POINTS))))
    while usable[::stride, ::stride].sum() > MOST_POINTS:
        stride += 1
    cloud = cloud_of(frame, context.viewer, stride)
    colors = cloud.painted(frame.rgb)
    for part in cloud.parts:
        look = {"point_size": part.size, "point_shading": "flat", "point_shape": "square"}
        client.put("point_cloud", f"/cloud/{part.name}", points=cloud.points[part.at], colors=colors[part.at], **look)
    for tag in tags:
        # Labelled ones have their name below, so that neither hides the other's.
        above, anchor = (1, "bottom-center") if tag.strong else (-1, "top-center")
        at = np.array(client.nodes[tag.node].position) + np.array([0.0, 0.0, above * (tag.extent[2] + 0.05)])
        look = {"font_size_mode": "screen", "font_screen_scale": 0.9, "anchor": anchor, "depth_test": False}
        client.put("label", f"/names{tag.node}", text=tag.text[:60], position=triple(at), **look)
    client.copy_to(scene)
    eye, look, fov = viewpoint("orbit", cloud.points, view.to_show, frame.camera, ASPECT)
    camera = server.initial_camera
    camera.up, camera.position, camera.look_at, camera.fov = (0.0, 0.0, 1.0), triple(eye), triple(look), float(fov)
    return scene.as_html(dark_mode=True)
