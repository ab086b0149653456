"""What a person reads of training: the curve while it runs, and the figures on what was not learnt from."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from spatialviz.printing import make_console

if TYPE_CHECKING:
    from pipeline.training.train import Epoch

BARS = "▁▂▃▄▅▆▇█"


@contextmanager
def epoch_bar(total: int) -> Iterator[Callable[[Epoch], None]]:
    """A bar of epochs with the loss and the metric so far, on a terminal; yields a function of an epoch."""
    if not sys.stderr.isatty():
        yield lambda epoch: None
        return
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[curve]}"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task("epochs", total=total, curve="")
        seen: list[Epoch] = []

        def tell(epoch: Epoch) -> None:
            seen.append(epoch)
            curve = f"loss {sparkline([e.loss for e in seen])} {epoch.loss:.4f}"
            metrics = [e.metric for e in seen if e.metric is not None]
            if metrics:
                curve += f"  held out {sparkline(metrics)} {metrics[-1]:.4f}"
            progress.update(task, completed=epoch.number, curve=curve)

        yield tell


def sparkline(values: list[float]) -> str:
    """A curve in one line of text."""
    low, high = min(values), max(values)
    span = high - low or 1.0
    return "".join(BARS[round((v - low) / span * (len(BARS) - 1))] for v in values)


def print_label_training(card: dict[str, Any], out: Path) -> None:
    """The curve of a training on labels, and its figures on frames it has not seen."""
    console = make_console()
    training, split, report = card["training"], card["split"], card["held_out"]
    frames = split["frames"]
    console.print(
        f"{card['name']}, {' '.join(training['relations'])}: {training['pairs']} pairs of {frames['train']} frames, "
        f"{training['epochs']} epochs; split by {split['kind']}, held out: {report['pairs']} pairs of "
        f"{frames['test']} frames"
    )
    metric = next(key for key in training["curve"][0] if key.startswith("validation_"))
    table = Table(box=None, pad_edge=False)
    for column in ("epoch", "loss", metric.replace("validation_", "validation ").replace("_", "-")):
        table.add_column(column, justify="right")
    for epoch in training["curve"]:
        held = epoch[metric]
        table.add_row(str(epoch["epoch"]), f"{epoch['loss']:.4f}", _figure(held))
    console.print(table)
    table = Table(box=None, pad_edge=False)
    for column in ("relation", "precision", "recall", "F1", "positives"):
        table.add_column(column, justify="left" if column == "relation" else "right")
    for name, r in report["relations"].items():
        table.add_row(name, *(_figure(r[k]) for k in ("precision", "recall", "f1")), str(r["positives"]))
    console.print(table)
    if training["output"] == "softmax":
        console.print(
            f"top-1 {_figure(report['top1'])}, top-2 {_figure(report['top2'])}, top-1 with the prior divided out "
            f"{_figure(report['top1_prior_divided'])}, mean recall {_figure(report['mean_recall'])}; "
            f"always the most frequent: {_figure(report['most_frequent'])}"
        )
    else:
        console.print(
            f"micro-F1 {_figure(report['micro_f1'])}, macro-F1 {_figure(report['macro_f1'])}, element accuracy "
            f"{_figure(report['element_accuracy'])} (always no: {_figure(report['all_negative_accuracy'])}), "
            f"Brier {_figure(report['brier'])}, ECE {_figure(report['ece'])}"
        )
    console.print(f"weights {card['weights_xxh3_128']}")
    for warning in card["warnings"]:
        print(f"spatialviz: {warning}", file=sys.stderr)
    console.print(f"-> {out}, card {out.with_suffix('.json')}")


def print_training(card: dict[str, Any], out: Path) -> None:
    """The figures of a trained network on rooms it has not seen, beside those of the rule and of always saying no."""
    console = make_console()
    network, rule = card["held_out"]["network"], card["held_out"]["rule"]
    rooms, training = card["rooms"], card["training"]
    console.print(
        f"{card['name']}: {training['pairs']} pairs of {rooms['rooms']} rooms, {training['epochs']} epochs; "
        f"held out: {network['pairs']} pairs in {card['held_out']['views']} views of other rooms"
    )
    table = Table(box=None, pad_edge=False)
    for column in ("relation", "precision", "recall", "F1", "rule's F1", "positives"):
        table.add_column(column, justify="left" if column == "relation" else "right")
    for name, r in network["relations"].items():
        other = rule["relations"][name]["f1"]
        figures = (_figure(r[k]) for k in ("precision", "recall", "f1"))
        table.add_row(name, *figures, _figure(other), str(r["positives"]))
    console.print(table)
    table = Table(box=None, pad_edge=False)
    for column in ("", "micro-F1", "macro-F1", "element accuracy", "Brier", "ECE", "clear-cut", "opposite"):
        table.add_column(column, justify="right" if column else "left")
    for name, r in (("network", network), ("rule", rule)):
        clear = r["clear_cut"]
        table.add_row(
            name,
            *(_figure(r[k]) for k in ("micro_f1", "macro_f1", "element_accuracy", "brier", "ece")),
            _figure(clear["holds"], ".2%"),
            _figure(clear["opposite"], ".2%"),
        )
    bare = network["uncalibrated"]
    table.add_row("uncalibrated", _figure(bare["micro_f1"]), "", "", _figure(bare["brier"]), _figure(bare["ece"]))
    table.add_row("always no", "0", "0", _figure(network["all_negative_accuracy"]))
    console.print(table)
    d = network["differing"]
    console.print(
        f"where the rule on the noisy view and exact geometry differ ({d['cells']} cells): "
        f"network wrong {d['errors']}, rule wrong {d['rule_errors']}"
    )
    console.print(f"-> {out}, card {out.with_suffix('.json')}")


def _figure(value: float | None, form: str = ".4f") -> str:
    return "-" if value is None else format(value, form)
