"""Published detections of other programs, for `--detector recorded` and `import-run`.

COCO results: see `pipeline.proposals.coco_files`.

supervision: the rows of `sv.JSONSink` and `sv.CSVSink` (roboflow/supervision 0.27, detection/tools/json_sink.py and
csv_sink.py): x_min, y_min, x_max, y_max, class_id, confidence, tracker_id ("" where there is none), `class_name` of the
detections' data, and what the user adds as custom_data, of which one column names the picture (`PICTURE_COLUMNS`).
Without a class_name a list of names says what class_id means. The sinks write no masks. Tables of other programs with
such columns (frame, name, score, x1, y1, x2, y2) are read as they are.

Boxes: for each picture an object of boxes, scores and labels, with a field that names the picture: what Grounding DINO
gives in transformers (`post_process_grounded_object_detection`), written as a list, as JSON lines or a file each. An
object with a picture's name as each key holds the same, or a list of objects with a box and a label each. Scores that
are left out are 1. Pieces of words (`pot ##ted`), which Grounding DINO's tokens leave in phrases, are joined.

Grounded SAM: `grounded_sam2_*_results.json` of IDEA-Research/Grounded-SAM-2 (image_path; annotations of class_name,
bbox, segmentation, score; box_format), and `mask.json` or `label.json` of IDEA-Research/Grounded-Segment-Anything
(value, label, logit, box), which name no picture: the file's name, or its folder's, is taken for it. A folder of such
files is read whole.

ConceptGraphs: see `pipeline.proposals.coco_files`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AliasChoices, AliasGenerator, BaseModel, BeforeValidator, ConfigDict, Field, FiniteFloat

from pipeline.datasets.frame_names import Picture
from pipeline.geometry.masks import RunLength
from pipeline.proposals.class_names import read_class_names
from pipeline.proposals.coco_files import (
    ENDINGS,
    Detections,
    RecordedDetection,
    SceneMap,
    coco_detections,
    detected,
    is_coco,
    map_detections,
    read_map,
)
from pipeline.system.errors import needed, require
from pipeline.system.frozen import dataclass
from pipeline.system.reading import Content, checked, read_content

PICTURE_COLUMNS = (
    "image_path",
    "image_name",
    "image_id",
    "image",
    "file_name",
    "filename",
    "file",
    "frame_id",
    "frame_name",
    "frame",
    "frame_index",
    "frame_idx",
    "frame_number",
)
Corners = tuple[FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat]
Number = Annotated[
    int | None, Field(ge=0, lt=2**63), BeforeValidator(lambda value: None if value in ("", -1, "-1") else value)
]
"""A number from 0; "" and -1 for none."""
Name = Annotated[str, Field(min_length=1), BeforeValidator(lambda v: v.replace(" ##", "") if isinstance(v, str) else v)]
Score = Annotated[float, Field(ge=0, le=1)]


_COLUMNS = {
    "x_min": ("x_min", "xmin", "x0", "x1"),
    "y_min": ("y_min", "ymin", "y0", "y1"),
    "x_max": ("x_max", "xmax", "x2", "x1"),
    "y_max": ("y_max", "ymax", "y2", "y1"),
    "confidence": ("confidence", "score", "conf"),
    "class_name": ("class_name", "name", "label", "phrase"),
}
"""What tables call the columns of supervision's sinks: of x0, x1 the second is the right edge, of x1, x2 the first is
the left one."""


class SinkRow(BaseModel):
    """A row of supervision's sinks, or of a table with aliased columns."""

    model_config = ConfigDict(
        alias_generator=AliasGenerator(validation_alias=lambda name: AliasChoices(*_COLUMNS.get(name, (name,))))
    )

    x_min: FiniteFloat
    y_min: FiniteFloat
    x_max: FiniteFloat
    y_max: FiniteFloat
    confidence: Score
    class_id: Number = None
    tracker_id: Number = None
    class_name: str | None = None


def _picture_column(content: Content) -> str:
    column = next((name for name in PICTURE_COLUMNS if name in content.first), None)
    missing, columns = "no column names the picture", ", ".join(content.first)
    return needed(column, missing, got=columns, expected="such as image_path in custom_data", path=content.path)


def _picture(content: Content, k: int, column: str) -> Picture:
    """Picture of row `k`."""
    picture = content.value[k].get(column)
    told = isinstance(picture, str | int) and not isinstance(picture, bool) and picture != ""
    where = f"{content.where(k)}, {column}: names no picture"
    require(told, where, got=repr(picture), path=content.path)
    return _number(picture)


def _supervision(content: Content, key: Path | None) -> Detections:
    names = () if key is None else read_class_names(key)
    column = _picture_column(content)
    found = Detections()
    for k, row in enumerate(content.rows(SinkRow.model_validate, "not a row of supervision's sinks")):
        where, known = content.where(k), row.class_id is not None and row.class_id < len(names)
        label = row.class_name or (names[row.class_id] if known and row.class_id is not None else None)
        expected = None if names else "class_name in the detections' data, or a list of names (--model-config, --with)"
        label = needed(label, f"{where}: no name for the class {row.class_id}", expected=expected, path=content.path)
        box = (row.x_min, row.y_min, row.x_max, row.y_max)
        detection = RecordedDetection(label=label, score=row.confidence, bbox=box, id=row.tracker_id)
        found.setdefault(_picture(content, k, column), []).append(detection)
    return found


class ListedBoxes(BaseModel):
    """Detections of a picture as parallel lists: results of Grounding DINO and similar as JSON."""

    boxes: list[Corners]
    scores: list[Score] | None = Field(default=None, validation_alias=AliasChoices("scores", "logits", "confidences"))
    labels: list[Name] = Field(validation_alias=AliasChoices("text_labels", "labels", "phrases"))


_BOX = AliasChoices("box", "bbox", "box_2d", "bbox_2d", "xyxy", "bounding_box")


class ListedThing(BaseModel):
    """A box of a picture, by itself."""

    box: Corners = Field(validation_alias=_BOX)
    label: Name = Field(validation_alias=AliasChoices("label", "name", "class_name", "class", "phrase", "category"))
    score: Score | None = Field(default=None, validation_alias=AliasChoices("score", "confidence", "conf", "logit"))


def _by_picture(content: Content) -> Content:
    """An object with a picture's name as each key, as a list of objects that name their picture."""
    rows = []
    for picture, found in content.value.items():
        if isinstance(found, list):
            wrong = f"{picture}, {{}}: not a box and a label"
            things = [
                checked(ListedThing.model_validate, thing, wrong, content.path, inside=(f"entry {k}",))
                for k, thing in enumerate(found)
            ]
            found = {"boxes": [t.box for t in things], "labels": [t.label for t in things]}
            if any(t.score is not None for t in things):
                found["scores"] = [1.0 if t.score is None else t.score for t in things]
        rows.append({**found, "image": picture} if isinstance(found, dict) else found)
    return replace(content, value=rows)


def _is_by_picture(content: Content) -> bool:
    """Test for an object of pictures, the first of which has lists of boxes or objects with a box."""
    values = list(content.value.values()) if isinstance(content.value, dict) else []
    some = next((v for v in values if v), None)
    first = some[0] if isinstance(some, list) else some
    boxed = isinstance(first, dict) and ("boxes" in first if isinstance(some, dict) else _boxed(first))
    return boxed and all(isinstance(v, type(some)) for v in values)


def _boxed(thing: dict[str, Any]) -> bool:
    return any(name in thing for name in _BOX.choices if isinstance(name, str))


def _lists(content: Content, key: Path | None) -> Detections:
    if _is_by_picture(content):
        content = _by_picture(content)
    content = replace(content, value=content.value if isinstance(content.value, list) else [content.value])
    column = _picture_column(content)
    found = Detections()
    read = content.rows(ListedBoxes.model_validate, "not boxes, scores and labels of a picture")
    shares = all(number <= 1 for row in read for box in row.boxes for number in box) and any(row.boxes for row in read)
    words, cause = "boxes are asked for in pixels", "shares of the picture? times its width and height"
    require(not shares, words, got="none above 1", expected="[x0, y0, x1, y1]", cause=cause, path=content.path)
    for k, row in enumerate(read):
        scores = [None] * len(row.boxes) if row.scores is None else row.scores
        lengths = f"{len(row.boxes)} boxes, {len(scores)} scores, {len(row.labels)} labels"
        alike = len(row.boxes) == len(scores) == len(row.labels)
        require(alike, f"{content.where(k)}: lists of one length are asked for", got=lengths, path=content.path)
        told = found.setdefault(_picture(content, k, column), [])
        for n, (label, score, box) in enumerate(zip(row.labels, scores, row.boxes, strict=True)):
            require(
                box[2] >= box[0] and box[3] >= box[1],
                f"{content.where(k)}, boxes.{n}: right or bottom lies before left or top",
                got=list(box),
                expected="[x0, y0, x1, y1]",
                cause="are they x, y, width, height?",
                path=content.path,
            )
            told.append(detected(label, score, box))
    return found


def _number(picture: Picture) -> Picture:
    """Number written as text, as in CSV; file names such as "000017" stay text."""
    return (
        int(picture) if isinstance(picture, str) and picture.isdecimal() and picture == f"{int(picture)}" else picture
    )


class SegmentedThing(BaseModel):
    """An annotation of Grounded-SAM-2; the score is the mask's, a number or a list of length 1."""

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
    return Detections({found.image_path: rows})


def _grounded_sam(content: Content, key: Path | None) -> Detections:
    whole = content.value
    listed = Content(whole["mask"] if isinstance(whole, dict) else whole, content.path)
    rows = listed.rows(LabelledValue.model_validate, "not a value of Grounded-Segment-Anything")
    path = content.path
    picture = path.resolve().parent.name if path.stem in ("mask", "label") else path.stem
    scored = [(row.label, row.logit, row.box) for row in rows if row.logit is not None and row.box is not None]
    return Detections({picture: [RecordedDetection(label=label, score=p, bbox=box) for label, p, box in scored]})


@dataclass(frozen=True)
class DetectionFormat:
    """A published format of detections."""

    recognises: Callable[[Content], bool]  # Whether a file's content is of it
    read: Callable[[Content, Path | None], Detections]
    """Its detections; the second argument is the file that says what its numbers mean, or None."""
    description: str
    needs: str = ""  # What that second file is; empty where there is none


def _is_sam(content: Content) -> bool:
    first = content.first["mask"] if isinstance(content.first.get("mask"), list) else [content.first]
    return bool(first) and isinstance(first[0], dict) and first[0].get("label") == "background" and "value" in first[0]


_BESIDE_BOXES = {"scores", "logits", "confidences", "text_labels", "labels", "phrases"}
DETECTION_FORMATS = {
    "coco": DetectionFormat(
        is_coco, coco_detections, "results of the COCO API", "the annotation file, which names pictures and classes"
    ),
    "supervision": DetectionFormat(
        lambda c: all(c.first.keys() & _COLUMNS[name] for name in ("x_min", "y_max", "confidence")),
        _supervision,
        "rows of supervision's JSONSink and CSVSink, or of a table of boxes",
        "a list of class names, where the rows have no class_name",
    ),
    "boxes": DetectionFormat(
        lambda c: _is_by_picture(c) or ("boxes" in c.first and bool(c.first.keys() & _BESIDE_BOXES)),
        _lists,
        "boxes, labels and, where there are any, scores of each picture, as Grounding DINO gives them",
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
    """Published format of a file, or None."""
    return next((name for name, form in DETECTION_FORMATS.items() if form.recognises(content)), None)


def detection_files(path: Path, what: str) -> list[Content]:
    """File contents: of the file, or of published formats below a folder; `what` is for messages."""

    def read(file: Path) -> Content:
        return read_map(file) if file.name.endswith(ENDINGS) else read_content(file, what)

    if not path.is_dir():
        return [read(path)]
    endings = (".json", ".csv", *ENDINGS)
    found = [read(file) for file in sorted(path.rglob("*")) if file.name.endswith(endings)]
    return [content for content in found if format_of(content)]


def read_detections(files: Sequence[Content], key: Path | None) -> Detections:
    """The detections of several files of published formats."""
    found = Detections()
    for content in files:
        known = "a published format of detections"
        name = needed(format_of(content), f"not {known}", expected=" | ".join(DETECTION_FORMATS), path=content.path)
        read = DETECTION_FORMATS[name].read(content, key)
        found.assumed += read.assumed
        for picture, rows in read.items():
            require(picture not in found, f"the picture {picture!r} stands in two files", path=content.path)
            found[picture] = rows
    return found
