"""Training of relation networks, and its figures."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from pipeline.corrections.review.label_jobs import RetrainingJob, RetrainingRun, run_retraining
from pipeline.corrections.review.retraining import RetrainConfig
from pipeline.language.counted import counted
from pipeline.language.relation_names import PHRASE
from pipeline.metrics.tables import shown
from pipeline.paper.ablation import AblationConfig, compare_features
from pipeline.relations.features import CLI_FEATURES
from pipeline.relations.model import install_network
from pipeline.system.errors import require
from pipeline.training.box_training import BoxTraining, train_box_network
from pipeline.training.card import RoomConfig, train_on_rooms
from pipeline.training.label_training import LabelTraining, train_on_labels
from pipeline.training.train import TrainConfig
from spatialviz.cli_models import AblationCommand, InstallCommand, RetrainCommand, TrainCommand
from spatialviz.options import warn
from spatialviz.printing import figure, print_rows, print_table, progress_bars, say, say_lines, table_record

ROOMS, BOXES = "rooms", "boxes"
OF_ROOMS, OF_LABELS = ("rooms", "views", "width", "height", "members"), ("vectors", "split", "pairs", "normalised")
"""Options of training on the one alone."""
MEMBERS = 3
"""Networks that the one of rooms is the mean of, where nothing is said."""
FIGURES = {"precision": "precision", "recall": "recall", "F1": "f1"}
SHOWN_CELLS = 5


def run_train(command: TrainCommand) -> None:
    if command.labels == BOXES:
        return run_train_boxes(command)
    on_rooms = command.labels == ROOMS
    # Options that say nothing about what is trained on are a mistake, not to be passed over.
    for name in OF_LABELS if on_rooms else OF_ROOMS:
        require(
            getattr(command, name) in (None, False),
            f"--{name} belongs to training on {'a labels folder' if on_rooms else 'the word rooms'}",
            got=f"training on {command.labels!r}",
        )
    features = CLI_FEATURES[command.features or ("rel32" if on_rooms else "rel14")]
    config = TrainConfig(features, command.vocabulary, batch=command.batch, epochs=command.epochs, seed=command.seed)
    if on_rooms:
        given = {name: getattr(command, name) for name in OF_ROOMS if getattr(command, name) is not None}
        config = replace(config, members=given.pop("members", MEMBERS))
        rooms = RoomConfig(**given, seed=command.seed)
        with progress_bars() as advance:
            card = train_on_rooms(command.out, rooms, config, workers=command.workers, progress=advance)
    else:
        job = LabelTraining(
            Path(command.labels), config, command.split, command.vectors, command.normalised, command.pairs
        )
        with progress_bars() as advance:
            card = train_on_labels(
                job,
                command.out,
                lambda e: advance(
                    "epochs", e.number, command.epochs, f"loss {e.loss:.4f}, held out {figure(e.metric)}"
                ),
            )
    command.write(card, print_training if on_rooms else print_label_training, card, command.out)


def run_train_boxes(command: TrainCommand) -> None:
    """Train the network that completes boxes."""
    for name in (*OF_LABELS, "members", "features", "batch"):
        require(getattr(command, name) in (None, False), f"--{name} does not belong to training on the word boxes")
    given = {name: getattr(command, name) for name in OF_ROOMS if getattr(command, name) is not None}
    with progress_bars() as advance:
        config = BoxTraining(**given, epochs=command.epochs, seed=command.seed)
        card = train_box_network(command.out, config, workers=command.workers, progress=advance)
    command.write(card, print_boxes, card, command.out)


def print_boxes(card: dict[str, Any], out: Path) -> None:
    """Print figures of completed boxes on held-out rooms, beside those of the seen ones."""
    say(f"{card['name']}: {card['training']['things']} things, {card['training']['epochs']} epochs")
    names = ("things", "seen", "by_name", "completed", "oracle", "gap_closed", "coverage")
    rows = (
        (rooms, str(found["things"]), *(figure(found[name]) for name in names[1:]))
        for rooms, found in card["held_out"].items()
    )
    print_rows(("mean IoU in 3D", *(f">{name.replace('_', ' ')}" for name in names)), rows)
    say(f"-> {out}, card {out.with_suffix('.json')}")


def run_retrain(command: RetrainCommand) -> None:
    train = TrainConfig(CLI_FEATURES[command.features], epochs=command.epochs, batch=command.batch, seed=command.seed)
    config = RetrainConfig(train, command.split)
    job = RetrainingJob(
        command.labels,
        command.journal.journal,
        command.journal.project,
        command.source.dataset,
        command.source.camera(),
        out=command.out,
        run=command.run_folder,
        config=config,
        workers=command.workers,
    )
    with progress_bars() as advance:
        done = run_retraining(job, advance)
    command.write(done.record(), print_retraining, done)


def run_install(command: InstallCommand) -> None:
    done = install_network(command.network, command.name, overwrite=command.overwrite)
    command.write({"name": done.stem, "path": str(done)}, say, f"--srm {done.stem} is now {done}")


def print_label_training(card: dict[str, Any], out: Path) -> None:
    """Print figures on held-out frames."""
    training, split, report = card["training"], card["split"], card["held_out"]
    frames = split["frames"]
    say(
        f"{card['name']}, {' '.join(training['relations'])}: {training['pairs']} pairs of {frames['train']} frames, "
        f"{training['epochs']} epochs; split by {split['kind']}, held out: {report['pairs']} pairs of "
        f"{frames['test']} frames"
    )
    print_rows(
        ("relation", *(f">{name}" for name in FIGURES), ">positives"),
        (
            (name, *(figure(r[key]) for key in FIGURES.values()), str(r["positives"]))
            for name, r in report["relations"].items()
        ),
    )
    if training["output"] == "softmax":
        say(
            f"top-1 {figure(report['top1'])}, top-2 {figure(report['top2'])}, top-1 with the prior divided out "
            f"{figure(report['top1_prior_divided'])}, mean recall {figure(report['mean_recall'])}; "
            f"always the most frequent: {figure(report['most_frequent'])}"
        )
    else:
        say(
            f"micro-F1 {figure(report['micro_f1'])}, macro-F1 {figure(report['macro_f1'])}, element accuracy "
            f"{figure(report['element_accuracy'])} (always no: {figure(report['all_negative_accuracy'])}), "
            f"Brier {figure(report['brier'])}, ECE {figure(report['ece'])}"
        )
    say(f"weights {card['weights_xxh3_128']}")
    warn(*card["warnings"])
    say(f"-> {out}, card {out.with_suffix('.json')}")


def print_training(card: dict[str, Any], out: Path) -> None:
    """Print figures on held-out rooms, beside the rule's and always-no's."""
    network, rule = card["held_out"]["network"], card["held_out"]["rule"]
    rooms, training = card["rooms"], card["training"]
    say(
        f"{card['name']}: {training['pairs']} pairs of {rooms['rooms']} rooms, {training['epochs']} epochs; "
        f"held out: {network['pairs']} pairs in {card['held_out']['views']} views of other rooms"
    )
    print_rows(
        ("relation", *(f">{name}" for name in FIGURES), ">rule's F1", ">positives"),
        (
            (name, *(figure(r[key]) for key in FIGURES.values()), figure(of_rule["f1"]), str(r["positives"]))
            for (name, r), of_rule in zip(network["relations"].items(), rule["relations"].values(), strict=True)
        ),
    )
    measured = [
        (
            name,
            *(figure(r[k]) for k in ("micro_f1", "macro_f1", "element_accuracy", "brier", "ece")),
            *(figure(r["clear_cut"][k], ".2%") for k in ("holds", "opposite")),
        )
        for name, r in (("network", network), ("rule", rule))
    ]
    bare = network["uncalibrated"]
    measured += [
        ("uncalibrated", figure(bare["micro_f1"]), "", "", figure(bare["brier"]), figure(bare["ece"])),
        ("always no", "0", "0", figure(network["all_negative_accuracy"])),
    ]
    columns = ("micro-F1", "macro-F1", "element accuracy", "Brier", "ECE", "clear-cut", "opposite")
    print_rows(("", *(f">{name}" for name in columns)), measured)
    say(f"-> {out}, card {out.with_suffix('.json')}")


def print_retraining(done: RetrainingRun) -> None:
    """Print the effect of corrections on labels, network and answers."""
    say(f"{counted(done.corrections['events'], 'event')} of the journal")
    found = done.retraining
    print_table(found.table())
    for title, count, cells in zip(
        ("became correct", "became wrong"), found.flips["all"], (found.better, found.worse), strict=True
    ):
        say(f"{title}: {count} held-out cells", style="bold")
        say_lines(
            f"  frame {cell['frame']}: {cell['a']} {PHRASE[cell['relation']]} {cell['b']} is {cell['label']}: "
            f"{cell['before']:.2f} -> {cell['after']:.2f}"
            for cell in cells[:SHOWN_CELLS]
        )
    if done.in_use is not None:
        before, after = (shown(f.micro_f1) for f in (done.in_use.before, done.in_use.after))
        say(f"the network in use: micro-F1 {before} on the same pairs; the new one {after}")
    for title, run in (("the labels alone", done.mended), ("the new network", done.replay)):
        if run is not None:
            gain = run.differences[run.measure]
            say(
                f"{title}: {len(run.fixed)} answers became correct, {len(run.broken)} wrong, of {run.shared} "
                f"({gain.value * 100:+.1f} points [{gain.low * 100:.1f}, {gain.high * 100:.1f}])"
            )
    say(f"-> {done.folder}; spatialviz models --install {done.network} --name NAME takes it into use", style="dim")


def run_ablation(command: AblationCommand) -> None:
    config = AblationConfig(
        rooms=command.rooms,
        views=command.views,
        pairs=command.pairs,
        features=tuple(CLI_FEATURES[name] for name in command.features),
        networks=command.networks,
        train=TrainConfig(batch=command.batch, epochs=command.epochs, seed=command.seed),
    )
    with progress_bars() as advance:
        table = compare_features(config, workers=command.workers, progress=advance)
    command.write(table_record(table), print_table, table)
