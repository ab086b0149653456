"""All published formats of predictions by name, and detections of any file that `--detector recorded` plays back.

Of detections it is told what was found for the names of each expression, and no answer; of a map of ConceptGraphs the
objects' 3D boxes come too, in the world.
"""

from __future__ import annotations

from collections.abc import Iterator

from pipeline.answering.predictions import Header, PredictedBox, Prediction, Proposal
from pipeline.datasets.base import load_picture
from pipeline.evaluation.adapters.answers import ANSWER_FORMATS
from pipeline.evaluation.adapters.published import PredictionFormat, Published
from pipeline.geometry.masks import RunLength
from pipeline.language.counted import counted
from pipeline.proposals.base import Proposals
from pipeline.proposals.detection_files import DETECTION_FORMATS
from pipeline.proposals.recorded import RecordedDetector
from pipeline.system.errors import FrameUnusable, UnknownClass

ONLY_DETECTIONS = "the file holds detections and no answers"


def read_recording(published: Published) -> tuple[Header, Iterator[Prediction]]:
    """Join every expression of the labels with the detections of the names in the text."""
    detector = RecordedDetector(published.path, key=published.key, frame_ids=published.dataset.frame_ids)
    published.notes.append(
        f"{ONLY_DETECTIONS}: with --detector recorded they can be ranked as ours are (spatialviz eval)"
    )
    if detector.elsewhere:
        published.notes.append(
            f"left out: {counted(len(detector.elsewhere), 'picture')} of the file that the dataset does not hold "
            f"(first: {detector.elsewhere[0]})"
        )
    system = detector.made_by or published.path.name
    header = Header(system=system, coordinates="world" if detector.corners else "camera_opencv", notes=ONLY_DETECTIONS)
    return header, _detections(published, detector)


def _detections(published: Published, detector: RecordedDetector) -> Iterator[Prediction]:
    for frame_id, sentences in published.sentences.items():
        frame = load_picture(published.dataset, frame_id)
        told: set[int] = set()
        for text, names in sentences.items():
            proposals: dict[str, tuple[Proposal, ...]] = {}
            unknown: dict[str, str] = {}
            try:
                for name in names:
                    try:
                        proposals[name] = tuple(_proposals(detector.detect(frame, [name]), told))
                    except UnknownClass:
                        unknown[name] = "the file has no such name"
            except FrameUnusable as error:
                yield Prediction(frame_id, text, problem=error.what)
                continue
            ids = dict.fromkeys(p.id for found in proposals.values() for p in found)
            known = detector.corners
            boxes: dict[int, PredictedBox | None] = {i: PredictedBox(corners=known[i]) for i in ids if known}
            yield Prediction(
                frame_id,
                text,
                problem=ONLY_DETECTIONS,
                proposals=proposals,
                unknown=unknown or None,
                boxes_3d=boxes or None,
            )
    published.notes.extend(detector.assumed())


def _proposals(found: Proposals, told: set[int]) -> Iterator[Proposal]:
    """Proposals, best first; an object's mask stands at the first mention in the frame."""
    rows = zip(found.ids.tolist(), found.scores.tolist(), found.boxes.tolist(), strict=True)
    for k, (i, score, box) in enumerate(rows):
        masked = found.masks is not None and (found.has_mask is None or found.has_mask[k]) and i not in told
        mask = RunLength.of(found.masks[k]) if found.masks is not None and masked else None
        told.add(i)
        yield Proposal(i, score, tuple(box), found.label(k), mask)


FORMATS: dict[str, PredictionFormat] = {
    **ANSWER_FORMATS,
    **{
        name: PredictionFormat(
            read_recording, form.recognises, form.description, 2 if name == "concept-graphs" else 1, form.needs
        )
        for name, form in DETECTION_FORMATS.items()
    },
    "recording": PredictionFormat(
        read_recording,
        lambda content: "frames" in content.first,
        "a recording of detections, JSON or a folder of NPZ",
        1,
    ),
}
"""All formats by name, but for our own and those of plugins."""
