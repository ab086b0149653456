"""Commands to make, check, carry, show, correct and review labels."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import OmitArgPrefixes, Positional, arg

from pipeline.system.frozen import dataclass
from spatialviz.options import (
    ALL_FRAMES,
    CPUS,
    Box,
    Boxes,
    DatasetArg,
    DatasetOptions,
    Flag,
    FrameArg,
    JournalArg,
    JournalOptions,
    LabelledArg,
    LabelledOptions,
    LabelsArg,
    NewFolder,
    OfAnswer,
    OneFrameArg,
    OnJournal,
    OnLabels,
    OnPictures,
    OpenDatasetArg,
    Output,
    Overwrite,
    ProposalOptions,
    SourceArg,
    SourceOptions,
    Workers,
)


@dataclass(frozen=True)
class Selection:
    """Selection among all candidate expressions."""

    expressions: int | None = None
    """At most so many, level over relations and classes. Default: as many as the other rules allow."""
    per_frame: int = 40
    """At most so many of one frame."""
    balance: float = 3.0
    """No relation has more than so many times the expressions of the rarest one; 0 for no such limit."""
    selection_seed: int = 0
    """Another seed chooses others."""
    keep_vague: Flag = False
    """Keep sentences that every object of the target's class answers."""


SelectionArg = OmitArgPrefixes[Annotated[Selection, arg(help=Selection.__doc__)]]


@dataclass(frozen=True)
class LabelCommand(Output):
    """Label a dataset: objects, every relation between them, and true sentences about them; --merge: join shards."""

    dataset: DatasetArg
    out: str
    """Folder for the labels, or a URL that fsspec knows (extra: remote)."""
    source: LabelledArg = LabelledOptions()
    selection: SelectionArg = Selection()
    vocabulary: Literal["avd", "semantic-abstraction", "all"] = "avd"
    """Which relations."""
    profile: Literal["viewer-cone-v1", "semantic-abstraction-published", "given"] = "viewer-cone-v1"
    """The rules that decide them; given: no rule of ours, what the dataset's own expressions say."""
    second_opinion: str = "trained"
    """trained | none | an ONNX file: a network that makes labels undecided where it does not agree."""
    style: Literal["varied", "plain", "semantic-abstraction"] = "varied"
    """How sentences are worded."""
    sentences: tuple[Literal["attribute", "ordinal", "extreme", "side", "two-relations", "negation"], ...] | None = None
    """Also make sentences of these kinds (none named: of all) with all their right answers, for eval --sentences."""
    sentences_a_kind: int = 4
    """At most so many of each kind in a frame."""
    map: str = ""
    """Folder of object maps that `map` wrote: objects get their ids in them (`instance`), `check` compares views."""
    box: Box = "upright"
    boxes: Boxes = "seen"
    seed: int = 0
    """The same seed gives the same labels."""
    engine: Literal["local", "ray"] = "local"
    """Processes of this machine, or a Ray cluster (extra: cluster)."""
    workers: Workers = CPUS
    gpus_a_detector: float = 0.0
    """Share of a GPU for each detector of the engine ray."""
    shard: str | None = None
    """k/N: only this task of N that share the folder or URL, for arrays of jobs; then run `merge`."""
    resume: Flag = False
    """Go on in a folder where a run was stopped."""
    limit: int | None = None
    """Only the first so many frames."""
    frames_of: tuple[str, ...] = ()
    """Only the frames of these splits of the dataset's own, such as vool/train."""
    empty: Flag = False
    """Find nothing: begin labels by hand. `correct`, `confirm` and the page add what people outline, and frames with
    it; --limit takes in the first frames at once. Relations are all that there are."""


ProposalArg = OmitArgPrefixes[Annotated[ProposalOptions, arg(help=ProposalOptions.__doc__)]]


@dataclass(frozen=True, kw_only=True)
class MapCommand(Output):
    """Join the objects of a scene's posed frames: which is which, and where each is seen, hidden or missing.

    FRAME is any frame of the scene; without it, all scenes. A map that is there already is gone on from. Exit status: 0
    where frames were joined and none was left out, else 1.
    """

    dataset: DatasetArg
    frame: FrameArg = ALL_FRAMES
    out: Path
    """Folder for the maps, a file a scene."""
    refine: Flag = False
    """Use refined poses where surfaces agree better with them. It is always told how far they move."""
    source: ProposalArg = ProposalOptions()


@dataclass(frozen=True)
class MergeCommand(Output):
    """Merge the shards of `label --shard`, or select expressions anew."""

    labels: Positional[str]
    """Labels folder, or URL."""
    to: str | None = None
    """Folder or URL for the merged tables. Default: where the shards are."""
    selection: SelectionArg = Selection()


@dataclass(frozen=True)
class CheckCommand(OnLabels):
    """List faults of labels; exit status 1 for errors."""

    report: Path | None = None
    """Folder for statistics as pictures and a page."""
    rules: tuple[str, ...] = ()
    """Only these rules, or groups of them such as "expression"."""
    masks: Flag = False
    """Compare each mask with what other views show of the object: needs the dataset's pictures, and `label --map`."""
    source: OpenDatasetArg = DatasetOptions()
    show: int = 20
    """Findings shown of each rule."""


OF_AUDIT = (
    "Sentences as `eval --sentences` takes them (SUN-Refer, SUN-Spot too), the folder of RoboSpatial-Home, or a file "
    "of VSR, BLINK (Spatial_Relation), CV-Bench, What'sUp, ScanRefer or Nr3D."
)


@dataclass(frozen=True)
class AuditCommand(Output):
    """Rank the items of a benchmark by the probability of a wrong truth, with the evidence: contrary geometry, several
    right answers, another frame of reference, systems agreeing on another answer.
    """

    target: Annotated[Positional[Path], arg(help=OF_AUDIT)]
    dataset: str | None = None
    """Dataset folder that sentences are about, or "demo"."""
    runs: tuple[Path, ...] = ()
    """Runs of systems on the same items, of RoboSpatial-Home files of answers in its form: where they agree with each
    other against the truth counts."""
    out: Path | None = None
    """Write every item with its evidence, as JSON lines."""
    limit: int = 20
    """Items shown; --out holds all."""
    source: SourceArg = SourceOptions()


@dataclass(frozen=True)
class ExportCommand:
    """Write labels in another format, with where each value comes from; --effective: with the corrections applied."""

    labels: LabelsArg
    out: NewFolder
    format: str
    """jsonl | coco | kitti (boxes only) | vqa (conversations for tuning a vision-language model) | scene-graph (JSON
    and GraphML) | parquet (Hugging Face's layout), or the name that a plugin gives its own."""
    images: Literal["none", "copy"] = "none"
    """copy: write the colour images beside the labels too."""
    dataset: str | None = None
    """Where the dataset is now, for its images, for corrected masks and boxes, and for the depth that vqa measures.
    Default: where it was labelled."""
    corrected: Flag = False
    """Apply the journal first, as `effective` does."""
    journal: JournalArg = JournalOptions()
    overwrite: Overwrite = False
    licence: str | None = None
    """The labels' licence, for the card of parquet. Default: said to be unknown."""


@dataclass(frozen=True)
class ImportCommand(OnPictures):
    """Import corrections made elsewhere, in a COCO or JSONL export of these labels: all or none.

    What differs between the file and what was exported becomes edits in the journal. A value that was corrected in
    the journal since is never overwritten: it is told, and nothing is saved (exit status 1). Nor is anything saved
    where the file has problems (exit status 2).
    """

    file: Positional[Path]
    """instances.json; objects.jsonl, relations.jsonl, expressions.jsonl, frames.jsonl; or the folder of them."""
    author: str
    """Who made the corrections."""
    format: Literal["coco", "jsonl"] | None = None
    """Default: by the file's name."""
    base: str | None = None
    """What the file was exported from, where it does not say so itself any more: the folder of that export, or "now"
    where nobody has corrected anything since."""
    deleted: Literal["keep", "reject"] = "keep"
    """reject: an object that the file lacks, in a picture or frame that it has, is rejected."""
    skip_conflicts: Flag = False
    """Save what does not contradict later corrections, instead of nothing."""
    reason: str = ""
    """Kept with each correction. Default: the file's name."""
    dry_run: Flag = False
    """Save nothing; say what would be done."""
    show: int = 20
    """Lines shown of each kind."""


@dataclass(frozen=True)
class ShowCommand(OnPictures):
    """Show the labels of a frame's objects, of one object or of a pair, field by field, each with its maker."""

    frame: OneFrameArg
    object: int | None = None
    """Only this object, rejected ones included."""
    pair: str | None = None
    """A,B: every relation of "A RELATION B"."""


@dataclass(frozen=True)
class JournalCommand(OnJournal):
    """List corrections of labels; exit status 1 for none, 2 without a journal.

    A journal is checked in full whenever it is opened, and refused where it is damaged. To go on with one that is:
    `--check` tells what is intact, `--recover NEW.sqlite` writes that into a new journal, which takes the place of the
    old one or is named by `--journal`.
    """

    author: str | None = None
    """Only this person's."""
    frame: str | None = None
    """Only of this frame: its id, or its index."""
    last: int | None = None
    """Only the newest so many."""
    check: Flag = False
    """Check the journal, and say which of its events are as they were saved; exit status 1 where not all are."""
    backup: Path | None = None
    """Write a copy with all that is saved, also while others save, and check it."""
    recover: Path | None = None
    """Write what is intact of a damaged journal into a new one; the damaged one is not changed."""


@dataclass(frozen=True)
class CorrectCommand(OnPictures):
    """Apply a file of edits to labels, all or none; exit status 1 after somebody else's change of the same value."""

    edits: Path
    """JSON: a list such as [{"edit": "relation", "frame": "000001/000000", "a": 2, "b": 5, "relation": "left",
    "to": "T", "reason": "..."}]; edits are class, status, judge, settle, mask, bbox, box, drag (faces of a box: "moves"
    such as [["face", AXIS 0-2, SIDE 1 or -1, METRES]]), new, merge, split, relation, true (a sentence with its pair:
    text, target, relation, reference, a, b), text, answers, ambiguous, mark, note, and value: any one field as the
    journal keeps it (kind, key, field, to).
    Pixels of mask and new are a run-length code, or "polygon": [[x, y], ...], "rectangle": [x0, y0, x1, y1]; with
    "mode": add, remove, replace."""
    author: str
    """Who says so."""
    again: str | None = None
    """The group that a try named which could not be saved: what was saved after all is not saved twice."""


@dataclass(frozen=True)
class PropagateCommand(OnPictures):
    """Propose what people set in a frame for the scene's other frames, by their poses and depth; --accept saves it.

    Pixels, class, 3D box and status of an object go to the object at the same place, else to a new one; what a person
    set there stays. Exit status 1 for nothing to propose, or after somebody else's change.
    """

    frame: OneFrameArg
    object: tuple[int, ...] = ()
    """Only these objects, with pixels and class as they are, whoever set them. Default: all of which a person set
    something."""
    to: tuple[str, ...] = ()
    """Only to these frames: ids, or indices. Default: all labelled frames of the scene with a pose."""
    also: tuple[str, ...] = ()
    """Further frames whose masks are right: what they see of the objects is carried, too."""
    refine: Flag = False
    """Refine the pose of each frame against this frame's surfaces, where they then agree better; no file is changed."""
    accept: Flag = False
    """Save the proposals in the journal, as one step that `undo` takes back."""
    doubtful: Flag = False
    """Save the doubtful ones too: seen from behind, without an edge, or without depth."""
    author: str | None = None
    """Who accepts them."""


@dataclass(frozen=True, kw_only=True)
class ConfirmCommand(OfAnswer):
    """Ask, and confirm a pair of the answer as right: from then on answers are judged by the pair.

    What the labels lack of its two objects is added with the pixels of the answer's. Exit status 1 where somebody else
    has been there.
    """

    labels: str
    """Labels folder; one that is new is begun by hand, as by `label --empty`."""
    author: str
    """Who says so."""
    pair: int = 1
    """Which of the ranked pairs, from 1."""
    journal: JournalArg = JournalOptions()


@dataclass(frozen=True)
class OfPerson(OnJournal):
    """Author and journal of undo and redo."""

    author: str
    """Whose."""
    group: str | None = None
    """This action, and not the newest; of redo, the undo that took it back."""
    again: str | None = None
    """The group that a try named which could not be saved: what was done after all is not followed by the next."""


@dataclass(frozen=True)
class UndoCommand(OfPerson):
    """Take back a person's newest action, --redo: bring it back; exit status 1 for none, or after somebody built upon
    it."""


@dataclass(frozen=True)
class RedoCommand(OfPerson):
    """Bring back the action last taken back; exit status as of undo."""


@dataclass(frozen=True)
class EffectiveCommand(OnPictures):
    """Write labels with all corrections applied, as an ordinary labels folder with provenance."""

    out: NewFolder
    show: Annotated[int, arg(metavar="N")] = 20
    """Events that do not apply, shown of all."""


@dataclass(frozen=True)
class ReviewCommand(OnPictures):
    """Rank labels by the probability of a fault, each with the reasons; how far its reviewers agree."""

    limit: int = 50
    """Show so many; --out holds all."""
    out: Path | None = None
    """Write the whole queue as Parquet: with what is settled."""
    queue: Path | None = None
    """Read a queue that --out wrote, and do not build it anew."""
    all: Flag = False
    """Show what is settled too."""
    author: str | None = None
    """What is left for this reviewer, without what others said."""
    agreement: Flag = False
    """Print how far each two reviewers agree (Cohen's kappa), and on what they differ; exit status 1 where no two have
    judged the same item."""
    kind: Literal["relation", "object", "expression"] | None = None
    """Only items of this kind."""
    find: str = ""
    """Only items whose label, reasons or frame hold each of these words."""
    networks: bool = True
    """Ask networks that have not learnt from a label (confident learning); that takes the most time."""
    masks: Flag = False
    """Compare each mask with what other views of the object show, as `check --masks` does."""
