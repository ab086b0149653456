"""The command that carries corrections of a frame to the scene's other frames."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack

from pipeline.corrections.journal.effective import Corrector
from pipeline.corrections.journal.events import outcome_record
from pipeline.corrections.journal.journal import JOURNAL_FILE, Journal
from pipeline.corrections.propagate import FrameProposals, proposals, with_scene
from pipeline.labels.by_hand import grows, with_frames
from pipeline.labels.reading import open_labels
from pipeline.language.counted import counted
from pipeline.system.errors import needed, require
from spatialviz.cli_labels import PropagateCommand
from spatialviz.options import FINE, NO, one_frame
from spatialviz.printing import figure, print_rows, say
from spatialviz.run_corrections import frames_of, print_outcome, told_how_to_try_again


def run_propagate(command: PropagateCommand) -> int:
    require(not command.accept or command.author is not None, "--accept needs --author: who says so")
    labels = open_labels(command.labels)
    dataset = needed(command.source.open(labels), "masks are carried by the pictures' depth: the dataset is needed")
    ids = dataset.frame_ids if grows(labels) else labels.frames.column("frame").to_pylist()
    frame = one_frame(ids, command.frame, labels.root)
    to = [one_frame(ids, other, labels.root) for other in command.to] or None
    also = [one_frame(ids, other, labels.root) for other in command.also]
    own = {frame, *also} & set(to or ())
    require(not own, "a frame is not carried to itself", got=min(own, default=""))
    labels = with_scene(labels, dataset, frame, None if to is None else [*also, *to])
    with ExitStack() as stack:
        corrected = command.accept or command.journal.journal is not None or (labels.root / JOURNAL_FILE).exists()
        journal = stack.enter_context(command.journal.open(labels)) if corrected else ()
        corrector = Corrector(labels, dataset)
        found = list(proposals(corrector, journal, frame, set(command.object) or None, to, command.refine, also))
        if not command.accept or command.author is None or not isinstance(journal, Journal):
            command.write((one.record() for one in found), print_proposals, found)
            return FINE if any(one.proposals for one in found) else NO
        stack.enter_context(told_how_to_try_again())
        chosen = [p for one in found for p in one.proposals if command.doubtful or not p.mask.doubtful]
        edits = [edit for proposal in chosen for edit in proposal.edits]
        if grows(labels) and edits:
            with_frames(labels, dataset, dict.fromkeys(edit.ref.frame for edit in edits))
        done = journal.append(edits, command.author) if edits else None
        record = outcome_record(done)
        command.write(record, lambda _: print_outcome(done, "saved", frames_of(corrector, journal)))
        return FINE if record["saved"] else NO


def print_proposals(found: Sequence[FrameProposals]) -> None:
    """Print a proposal on each line, and what each frame does not see."""
    rows = [
        (
            p.frame,
            p.label if p.new else f"{p.label}·{p.number}",
            "new" if p.new else ", ".join(e.ref.field for e in p.edits) or "nothing",
            f"{p.source_number}",
            "-" if p.new else figure(p.iou, ".2f"),
            figure(p.mask.seen, ".2f"),
            f"{p.mask.confidence:.2f}{' doubtful' if p.mask.doubtful else ''}",
            ", ".join(p.kept),
        )
        for one in found
        for p in one.proposals
    ]
    if rows:
        print_rows(("frame", "object", "proposed", "from", "IoU", "seen", "confidence", "a person's, kept"), rows)
    for one in found:
        moved = one.refinement
        say(
            f"{one.frame}: {counted(len(one.proposals), 'proposal')}, {len(one.unseen)} not seen; surfaces agree by "
            f"{figure(one.agree, '.2f')}"
            + (
                "" if moved is None else f", pose moved by {100 * moved.moved_m:.1f} cm, {moved.turned_deg:.2f} degrees"
            ),
            style="dim",
        )
    say("--accept --author NAME saves what is not doubtful" if rows else "nothing to propose")
