"""Detections as other programs publish them, for `--detector recorded` and `import-run`.

COCO results: see `pipeline.proposals.coco_files`.

supervision: the rows of `sv.JSONSink` and `sv.CSVSink` (roboflow/supervision 0.27, detection/tools/json_sink.py and
csv_sink.py): x_min, y_min, x_max, y_max, class_id, confidence, tracker_id ("" where there is none), `class_name` of the
detections' data, and what the user adds as custom_data, of which one column names the picture (`PICTURE_COLUMNS`).
Without a class_name a list of names says what class_id means. The sinks write no masks.

Grounded SAM: `grounded_sam2_*_results.json` of IDEA-Research/Grounded-SAM-2 (image_path; annotations of class_name,
bbox, segmentation, score; box_format), and `mask.json` or `label.json` of IDEA-Research/Grounded-Segment-Anything
(value, label, logit, box), which name no picture: the file's name, or its folder's, is taken for it. A folder of such
files is read whole.

ConceptGraphs: see `pipeline.proposals.concept_graphs`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, BeforeValidator, Field, FiniteFloat

from pipeline.datasets.frame_names import Picture
from pipeline.geometry.masks import RunLength
from pipeline.proposals.class_names import read_class_names
from pipeline.proposals.coco_files import Detections, RecordedDetection, coco_detections, is_coco
from pipeline.proposals.concept_graphs import ENDINGS, SceneMap, map_detections, read_map
from pipeline.system.errors import needed, require
from pipeline.system.reading import Content, checked, read_content

PICTURE_COLUMNS = (
    "image_path", "image_name", "image_id", "image", "file_name", "filename", "file", "frame_id", "frame_name", "frame",
    "frame_index", "frame_idx", "frame_number",
)  # fmt: skip
Corners = tuple[FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat]
Number = Annotated[
    int | None, Field(ge=0, lt=2**63), BeforeValidator(lambda value: None if value in ("", -1, "-1") else value)
]
"""A number from 0; "" and -1 for none."""
Name = Annotated[str, Field(min_length=1)]
Score = Annotated[float, Field(ge=0, le=1)]


class SinkRow(BaseModel):
    """A row of supervision's sinks."""

    x_min: FiniteFloat
    y_min: FiniteFloat
    x_max: FiniteFloat
    y_max: FiniteFloat
    confidence: Score
    class_id: Number = None
    tracker_id: Number = None
    class_name: str | None = None


def _supervision(content: Content, key: Path | None) -> Detections:
    names = () if key is None else read_class_names(key)
    column = next((name for name in PICTURE_COLUMNS if name in content.first), None)
    missing, columns = "no column names the picture", ", ".join(content.first)
    column = needed(column, missing, got=columns, expected="such as image_path in custom_data", path=content.path)
    found: Detections = {}
    for k, row in enumerate(content.rows(SinkRow.model_validate, "not a row of supervision's sinks")):
        where, known = content.where(k), row.class_id is not None and row.class_id < len(names)
        label = row.class_name or (names[row.class_id] if known and row.class_id is not None else None)
        expected = None if names else "class_name in the detections' data, or a list of names (--model-config, --with)"
        label = needed(label, f"{where}: no name for the class {row.class_id}", expected=expected, path=content.path)
        picture = content.value[k].get(column)
        told = isinstance(picture, str | int) and not isinstance(picture, bool) and picture != ""
        require(told, f"{where}, {column}: names no picture", got=repr(picture), path=content.path)
        box = (row.x_min, row.y_min, row.x_max, row.y_max)
        detection = RecordedDetection(label=label, score=row.confidence, bbox=box, id=row.tracker_id)
        found.setdefault(_number(picture), []).append(detection)
    return found


def _number(picture: Picture) -> Picture:
    """A number that was written as text, as CSV has it; one that is written as file names are ("000017") stays text."""
    return (
        int(picture) if isinstance(picture, str) and picture.isdecimal() and picture == f"{int(picture)}" else picture
    )


class SegmentedThing(BaseModel):
    """An annotation of Grounded-SAM-2; its score is the mask's, a number or, as the scripts write it, a list of one."""

    class_name: Name
    bbox: Corners
    segmentation: RunLength | None = None
    score: Annotated[FiniteFloat, BeforeValidator(lambda v: v[0] if isinstance(v, list) and len(v) == 1 else v)]


class SegmentedPicture(BaseModel):
    """A result file of Grounded-SAM-2."""

    image_path: str
    annotations: list[SegmentedThing]
    box_format: Literal["xyxy"] = "xyxy"


class LabelledValue(BaseModel):
    """An entry of Grounded-Segment-Anything's mask.json; the background has neither score nor box."""

    value: int
    label: Name
    logit: Score | None = None
    box: Corners | None = None


def _grounded_sam2(content: Content, key: Path | None) -> Detections:
    wrong = "not a result of Grounded-SAM-2 at {}"
    found = checked(SegmentedPicture.model_validate, content.value, wrong, content.path)
    rows = []
    for k, thing in enumerate(found.annotations):
        where = f"annotations.{k}.score"
        # SAM's own estimate of a mask's overlap may be a little above 1.
        require(0 <= thing.score < 1.1, f"{where}: no score", got=thing.score, expected="0..1", path=content.path)
        score = min(thing.score, 1.0)
        rows.append(RecordedDetection(label=thing.class_name, score=score, bbox=thing.bbox, mask=thing.segmentation))
    return {found.image_path: rows}


def _grounded_sam(content: Content, key: Path | None) -> Detections:
    whole = content.value
    listed = Content(whole["mask"] if isinstance(whole, dict) else whole, content.path)
    rows = listed.rows(LabelledValue.model_validate, "not a value of Grounded-Segment-Anything")
    path = content.path
    picture = path.resolve().parent.name if path.stem in ("mask", "label") else path.stem
    return {
        picture: [
            RecordedDetection(label=row.label, score=row.logit, bbox=row.box)
            for row in rows
            if row.logit is not None and row.box is not None
        ]
    }


@dataclass(frozen=True)
class DetectionFormat:
    """A published format of detections.

    Attributes
    ----------
    recognises : callable
        Whether a file's content is of it.
    read : callable
        Its detections; the second argument is the file that says what its numbers mean, or None.
    description : str
    needs : str
        What that second file is; empty where there is none.
    """

    recognises: Callable[[Content], bool]
    read: Callable[[Content, Path | None], Detections]
    description: str
    needs: str = ""


def _is_sam(content: Content) -> bool:
    first = content.first["mask"] if isinstance(content.first.get("mask"), list) else [content.first]
    return bool(first) and isinstance(first[0], dict) and first[0].get("label") == "background" and "value" in first[0]


DETECTION_FORMATS = {
    "coco": DetectionFormat(
        is_coco, coco_detections, "results of the COCO API", "the annotation file, which names pictures and classes"
    ),
    "supervision": DetectionFormat(
        lambda c: {"x_min", "y_max", "confidence"} <= c.first.keys(),
        _supervision,
        "rows of supervision's JSONSink and CSVSink",
        "a list of class names, where the rows have no class_name",
    ),
    "grounded-sam2": DetectionFormat(
        lambda c: {"image_path", "annotations"} <= c.first.keys(), _grounded_sam2, "results of Grounded-SAM-2's demos"
    ),
    "grounded-sam": DetectionFormat(_is_sam, _grounded_sam, "mask.json of Grounded-Segment-Anything"),
    "concept-graphs": DetectionFormat(
        lambda c: isinstance(c.value, SceneMap), map_detections, "a map of ConceptGraphs (.pkl.gz)"
    ),
}


def format_of(content: Content) -> str | None:
    """The published format of a file; None where it is of none."""
    return next((name for name, form in DETECTION_FORMATS.items() if form.recognises(content)), None)


def detection_files(path: Path, what: str) -> list[Content]:
    """A file, or the files of published formats in a folder and in those within it; `what` names it in messages."""

    def read(file: Path) -> Content:
        return read_map(file) if file.name.endswith(ENDINGS) else read_content(file, what)

    if not path.is_dir():
        return [read(path)]
    endings = (".json", ".csv", *ENDINGS)
    found = [read(file) for file in sorted(path.rglob("*")) if file.name.endswith(endings)]
    return [content for content in found if format_of(content)]


def read_detections(files: Sequence[Content], key: Path | None) -> Detections:
    """The detections of several files of published formats.

    Raises
    ------
    InputError
        A file of no such format, one that does not follow it, and a picture that stands in two files.
    """
    found: Detections = {}
    for content in files:
        known = "a published format of detections"
        name = needed(format_of(content), f"not {known}", expected=" | ".join(DETECTION_FORMATS), path=content.path)
        for picture, rows in DETECTION_FORMATS[name].read(content, key).items():
            require(picture not in found, f"the picture {picture!r} stands in two files", path=content.path)
            found[picture] = rows
    return found
