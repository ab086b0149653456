"""The schema of labels: one pydantic model a table, and the manifest of a run.

A labels folder holds four tables. Rows are keyed by (frame, object) and
(frame, a, b); `frame_index` is the frame's index in the dataset, and the rows'
canonical order is that of these keys. Lengths are metres, angles do not occur.
Vectors named `center`, `R`, `size` are in the camera frame (OpenCV); `lo`, `hi`
and `centroid` along the viewer's (right, up, forward).

The JSON Schemas of a version stand in `schemas/`; `python -m pipeline.labels.schema` writes those of this one.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, create_model

from pipeline.geometry.boxes import Side
from pipeline.geometry.camera import UpSource
from pipeline.geometry.cleaning import BoxMode
from pipeline.labels.profiles import canonical_hash
from pipeline.language.relation_names import PAIRWISE, RELATIONS, version_numbers

SCHEMA_VERSION = max("1.3.0", *(r.since for r in RELATIONS.values()), key=version_numbers)
"""Semantic version of the tables below: a new major number means that old readers must refuse, and a relation that is
declared anew raises the minor one."""
ADDED_COLUMNS = {"open_sides": "1.3.0"} | {
    column: RELATIONS[name].since
    for name in PAIRWISE
    if RELATIONS[name].since != "1.0.0"
    for column in (name, f"{name}_margin")
}
"""Columns that came later, with the version that brought them: a file of an older one has none, and
reads as null."""

_STATE = (
    "1 the relation holds (T), 0 too close to call (U), -1 it does not (F); null where the profile does not judge it"
)
_MARGIN = "How far, in metres, the measures stand from where the state would change: positive for T, negative for F"
State = Annotated[Literal[-1, 0, 1] | None, Field(description=_STATE, json_schema_extra={"arrow": "int8"})]
Margin = Annotated[float | None, Field(description=_MARGIN, json_schema_extra={"arrow": "float32"})]
Count = Annotated[int, Field(ge=0, json_schema_extra={"arrow": "int32"})]
Share = Annotated[float, Field(ge=0, le=1, json_schema_extra={"arrow": "float32"})]
Vector = Annotated[list[float], Field(min_length=3, max_length=3)]
Matrix = Annotated[list[float], Field(min_length=9, max_length=9)]
Pose = Annotated[list[float], Field(min_length=16, max_length=16)]
Pixels = Annotated[list[float], Field(min_length=4, max_length=4)]
Objects = Annotated[list[int], Field(json_schema_extra={"arrow": "int32"})]


class LabelRow(BaseModel):
    """What every table has."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    frame: str  # Id of the dataset's frame
    frame_index: Count  # Its index in the dataset


class FrameRow(LabelRow):
    """One frame; of a broken one only its id and the problem are known.

    `up` is the unit vector against gravity in the camera frame; with it
    `pipeline.geometry.viewer.viewer_axes` gives the axes in which everything is judged.
    """

    scene: str  # Place whose frames share a world
    ok: bool  # False where the frame could not be read or labelled
    problem: str | None  # Why not
    width: Count  # Of the picture, pixels
    height: Count  # Of the picture, pixels
    K: Matrix | None  # Intrinsics, pixels; row by row
    T_world_camera: Pose | None  # Pose: camera to world, metres; row by row
    up: Vector | None  # Unit vector against gravity, camera frame
    up_source: UpSource | None  # What says where up is
    rgb_hash: str | None  # Of the colour pixels
    depth_hash: str | None  # Of the depth
    objects: Count  # How many the frame has
    notes: list[str]  # Oddities that were left out or mended


class ObjectRow(LabelRow):
    """One object of a frame: its pixels, its points, its box, and how far they can be trusted.

    `mask` is COCO's compressed run-length code of the (height, width) mask.
    `exact_center`, `exact_R` and `exact_size` are the dataset's own box where it
    has one. `pca_center`, `pca_R` and `pca_size` are the paper's PCA box, its axes
    as PCA gives them: what the feature contracts paper30 and canon30 are made
    from. `occluded` is the share of the mask's border beside which something is at
    least 5 cm nearer. `estimator` is the fit that made the box, before 1.3.0 never `upright`. `open_sides` are
    the sides, by the viewer's axes, beyond which the object may go on: cut by the picture, hidden by something nearer,
    or never seen; null of boxes that `upright` did not fit, as those that people set. Only `usable` objects are asked
    for in expressions.
    """

    object: Annotated[int, Field(json_schema_extra={"arrow": "int32"})]  # Its number in the frame
    label: str  # Class name
    score: Share  # The detector's
    # The same object's number in all frames of the scene, where it is known
    instance: Annotated[int | None, Field(json_schema_extra={"arrow": "int32"})]
    bbox: Pixels  # x0, y0, x1, y1, pixels; x1 and y1 are exclusive edges
    mask: str | None  # Visible pixels, as COCO's compressed run-length code; null where there are none
    mask_source: str  # What made the mask
    mask_pixels: Count  # How many pixels it has
    points: Count  # Pixels of it that were kept
    kept: Share  # Share of the mask that was kept
    depth_missing: Share  # Share of the mask without depth
    touches_border: bool  # The mask reaches the picture's border
    fallback: bool  # Cleaning left too few pixels: the raw mask was used
    distance: float | None  # Median depth of its points, metres
    center: Vector | None  # Of the 3D box, camera frame, metres
    R: Matrix | None  # Rotation of the box to the camera frame; row by row, its columns are the box's axes
    size: Vector | None  # Full edge lengths along those axes, metres
    yaw_confidence: Share  # How sure the box's turn is
    estimator: BoxMode  # What fitted the box
    open_sides: list[Side] | None = None  # Sides, by the viewer's axes, beyond which the object may go on
    pca_center: Vector | None  # The paper's PCA box, as `center`
    pca_R: Matrix | None  # The same, as `R`
    pca_size: Vector | None  # The same, as `size`
    lo: Vector | None  # Least right, up and forward of the points, viewer's axes, metres
    hi: Vector | None  # Greatest right, up and forward of the points, metres
    centroid: Vector | None  # Middle of the points, viewer's axes, metres
    exact_center: Vector | None  # The dataset's own box, as `center`
    exact_R: Matrix | None  # The same, as `R`
    exact_size: Vector | None  # The same, as `size`
    # Share that is not occluded, by the dataset
    visible: Annotated[float | None, Field(json_schema_extra={"arrow": "float32"})]
    occluded: Share  # Share of the mask's border beside which something is at least 5 cm nearer
    usable: bool  # It is asked for in expressions
    reason: str | None  # Why it is not usable


class PairRow(LabelRow):
    """All relations of one ordered pair: "object a RELATION object b".

    A margin is how far, in metres, the measures stand from where the state
    would change: positive for T, negative for F, 0 for U.
    """

    a: Annotated[int, Field(json_schema_extra={"arrow": "int32"})]  # Number of the object that the relation is said of
    b: Annotated[int, Field(json_schema_extra={"arrow": "int32"})]  # Number of the object that it stands in relation to
    distance: Annotated[float | None, Field(json_schema_extra={"arrow": "float32"})]  # Between the two, metres
    doubted: Count  # Bit k set: a second opinion made relation k of the columns undecided


_OF_RELATIONS: dict[str, Any] = dict.fromkeys(PAIRWISE, (State, None))
_OF_RELATIONS |= {f"{name}_margin": (Margin, None) for name in PAIRWISE}
RelationRow = create_model("RelationRow", __base__=PairRow, __doc__=PairRow.__doc__, **_OF_RELATIONS)
"""PairRow with two columns for each declared relation."""


class ExpressionRow(LabelRow):
    """A sentence that is true of a pair of objects, with everything else it is true of.

    `targets` are the objects of the target's class that satisfy it beyond doubt
    (T with some object of the reference's class); `acceptable` are those and the
    doubtful ones (U). `ambiguous` says that more than one is acceptable.
    """

    id: str  # The same words of the same objects have the same id
    text: str  # The sentence
    target: str  # Class name of what is asked for
    relation: str  # Relation that is asked
    reference: str  # Class name of what it stands in relation to
    target_object: Annotated[int, Field(json_schema_extra={"arrow": "int32"})]  # Number of the object that was meant
    reference_object: Annotated[int, Field(json_schema_extra={"arrow": "int32"})]  # Number of its reference
    targets: Objects  # Objects that answer it beyond doubt
    acceptable: Objects  # Those and the doubtful ones
    ambiguous: bool  # More than one is acceptable
    margin: Margin
    judged_in: Literal["viewer"]  # Axes that left, right, front and behind are of
    up_source: UpSource  # What says where up is
    profile: str  # Rules that decided


class TableFile(BaseModel):
    """One table as written: its rows, the hash of their content, and that of the file."""

    model_config = ConfigDict(extra="forbid")

    file: str  # Below the folder
    rows: int  # How many it has
    content_hash: str  # Of the rows in canonical order
    sha256: str  # Of the file


SENTENCES_OF = "sentences_"
"""Before the kind, in the counts of the manifest, of the sentences beside the tables."""


class Manifest(BaseModel):
    """What made the labels, from what, and what came out.

    `content_hash` of a table depends on the rows in canonical order alone, not
    on engine, workers, shards or the libraries that wrote the file. Where
    people's corrections are in the tables, `corrections` says from which journal
    and how many, and `config` and `profile` speak of all other values. `makers`
    says for other programs what made masks, boxes and relations; the same follows
    from the rest by `pipeline.labels.provenance.makers_of`, also where it is missing.
    """

    model_config = ConfigDict(extra="forbid")

    schema_version: str  # Of the tables
    tool: str  # Program that wrote it
    version: str  # Of the program
    config: dict[str, Any]  # How frames were labelled
    config_hash: str  # Of `config`
    profile: dict[str, Any]  # Thresholds of the rules, metres and degrees
    profile_hash: str  # Of `profile`
    selection: dict[str, Any]  # Which expressions were kept
    dataset: dict[str, Any]  # What was labelled: its path, format and name
    models: dict[str, str]  # Networks that took part, each with its hash
    seed: int  # Of all that is drawn at random
    counts: dict[str, int]  # Frames, objects, pairs and expressions, and what was left out
    warnings: list[str]  # What a reader should know
    tables: dict[str, TableFile]  # By name
    environment: dict[str, str]  # Versions of Python and libraries
    created: str  # Time, UTC
    corrections: dict[str, Any] | None = None  # From which journal, and how many
    makers: dict[str, Any] | None = None  # What made masks, boxes and relations

    @property
    def sentences(self) -> dict[str, int]:
        """Number of sentences beside the tables, by kind."""
        return {k.removeprefix(SENTENCES_OF): n for k, n in self.counts.items() if k.startswith(SENTENCES_OF)}


TABLES: dict[str, type[LabelRow]] = {
    "frames": FrameRow,
    "objects": ObjectRow,
    "relations": RelationRow,
    "expressions": ExpressionRow,
}
"""The tables of a labels folder, by file name without suffix."""

KEYS: dict[str, tuple[str, ...]] = {
    "frames": ("frame_index",),
    "objects": ("frame_index", "object"),
    "relations": ("frame_index", "a", "b"),
    "expressions": ("frame_index", "relation", "target_object", "reference_object"),
}
"""What orders the rows of a table canonically; relations run in the order of `relations.PAIRWISE`."""


def json_schemas() -> dict[str, dict[str, Any]]:
    """JSON Schema of each table's row and of the manifest, by name."""
    models: dict[str, type[BaseModel]] = {**TABLES, "manifest": Manifest}
    return {
        name: {
            "$schema": "https://json-schema.org/draft/2020-12/schema",
            "$id": f"spatialviz/labels/{SCHEMA_VERSION}/{name}.json",
            **model.model_json_schema(by_alias=True),
        }
        for name, model in models.items()
    }


def labels_version(manifest: Manifest) -> str:
    """16 hexadecimal digits of the making and the content of automatic labels."""
    tables = {name: entry.content_hash for name, entry in manifest.tables.items()}
    return canonical_hash({"config": manifest.config_hash, "tables": tables})[:16]


SCHEMA_FOLDER = Path(__file__).with_name("schemas") / SCHEMA_VERSION


def schema_text(schema: dict[str, object]) -> str:
    """Text of a schema file."""
    return json.dumps(schema, indent=1, ensure_ascii=False) + "\n"


def write_schemas(folder: Path = SCHEMA_FOLDER) -> tuple[Path, ...]:
    """Write a file a table, and the manifest's."""
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for name, schema in json_schemas().items():
        written.append(folder / f"{name}.json")
        written[-1].write_text(schema_text(schema), encoding="utf-8", newline="\n")
    return tuple(written)


if __name__ == "__main__":
    for path in write_schemas():
        print(path)
