"""Pictures of counts: states, ambiguity, distance, classes, and expressions by relation and class."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.labels.report.distributions import DISTANCE_STEP_M, FARTHEST_M, Distributions
from pipeline.labels.report.style import (
    DARK,
    FULL,
    HALF,
    LIGHT,
    LINE,
    PALE,
    QUIET,
    bare,
    new_figure,
    percent,
    relation_color,
    say_nothing_there,
    short,
    thousands,
    whole_percent,
)
from pipeline.labels.statistics import DISTANCE_BINS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CLASSES_SHOWN = 25
FEWEST_ROWS = 5
"""Room for so many classes, so that a few do not stretch to slabs."""
SHARE_AT = (1.13, 1.29)
"""Where the shares stand in writing, in widths of the bars."""
LARGEST_SET = 8
"""Sets of acceptable objects from this size on share a bar."""


def draw_states(statistics: dict[str, Any]) -> Figure:
    """Per relation: the shares of T, U and F among all pairs, and how many are T."""
    relations, cells = statistics["relations"], statistics["cells"]
    figure = new_figure(
        HALF,
        60 + 34 * len(relations),
        "There are no pairs of objects"
        if cells["u_share"] is None
        else f"{percent(cells['u_share'])} of all relation labels are too close to call",
        "Ordered pairs for which a relation holds (full), is in doubt (hatched), or does not hold (pale).",
    )
    axes = figure.subplots()
    if not cells["T"] + cells["U"] + cells["F"]:
        say_nothing_there(axes, "no pairs")
        return figure
    for row, (name, entry) in enumerate(relations.items()):
        total = max(entry["T"] + entry["U"] + entry["F"], 1)
        t, u = entry["T"] / total, entry["U"] / total
        color = relation_color(name)
        axes.barh(row, 1 - t - u, left=t + u, height=0.68, color=PALE)
        axes.barh(row, u, left=t, height=0.68, color="white", edgecolor=color, hatch="//////", linewidth=0)
        axes.barh(row, t, height=0.68, color=color)
        for x, value in zip(SHARE_AT, (t, u), strict=True):
            axes.text(x, row, percent(value), ha="right", va="center", fontsize=9)
    for x, text in zip(SHARE_AT, ("holds", "in doubt"), strict=True):
        axes.text(x, -0.78, text, ha="right", va="center", fontsize=9, color=QUIET)
    axes.set_yticks(range(len(relations)), list(relations))
    axes.set(ylim=(len(relations) - 0.5, -1), xlim=(0, 1), xlabel="share of ordered pairs")
    axes.xaxis.set_major_formatter(whole_percent)
    bare(axes)
    return figure


def draw_ambiguity(statistics: dict[str, Any]) -> Figure:
    """How many objects are an acceptable answer to an expression."""
    ambiguity = statistics["ambiguity"]
    figure = new_figure(
        HALF,
        60 + 34 * len(statistics["relations"]),
        "There are no expressions"
        if ambiguity["share"] is None
        else f"{percent(ambiguity['share'])} of the expressions have more than one right answer",
        "Expressions by the number of objects that satisfy them, undecided ones included.",
    )
    axes = figure.subplots()
    if not ambiguity["expressions"]:
        say_nothing_there(axes, "no expressions")
        return figure
    counts = np.zeros(LARGEST_SET, np.int64)
    for size, count in ambiguity["set_sizes"].items():
        counts[min(max(int(size), 1), LARGEST_SET) - 1] += count
    last = max(int(np.flatnonzero(counts)[-1]) + 1, 3)
    bars = axes.bar(range(1, last + 1), counts[:last], width=0.68, color=[DARK] + [LIGHT] * (last - 1))
    axes.bar_label(bars, [thousands(c) for c in counts[:last]], padding=3, fontsize=9)
    axes.set_xticks(range(1, last + 1), [f"{k}+" if k == LARGEST_SET else str(k) for k in range(1, last + 1)])
    axes.set(xlabel="acceptable objects", ylabel="expressions")
    axes.yaxis.set_major_formatter(thousands)
    axes.tick_params(length=0)
    axes.margins(y=0.1)
    return figure


def draw_distance(statistics: dict[str, Any], found: Distributions) -> Figure:
    """How far objects are, and how doubt grows with it."""
    bins = statistics["distance"]
    counts = found.distances
    upto = np.cumsum(counts)
    # Rounded up to a step.
    median = float(np.searchsorted(upto, upto[-1] / 2) + 1) * DISTANCE_STEP_M if upto[-1] else None
    figure = new_figure(
        FULL,
        250,
        "No object has a distance" if median is None else f"Half of the objects are nearer than {median:g} m",
        "Left: objects by distance from the camera. Right: share of relation labels in doubt, "
        "by the distance of the first object of the pair.",
    )
    left, right = figure.subplots(1, 2, gridspec_kw={"width_ratios": [3, 2], "wspace": 0.06})
    if median is None:
        say_nothing_there(left, "no objects with a distance")
    else:
        last = min(int(np.flatnonzero(counts)[-1]) + 1, len(counts))
        starts = np.arange(last) * DISTANCE_STEP_M
        left.bar(starts, counts[:last], width=DISTANCE_STEP_M, align="edge", color=DARK, edgecolor="white", linewidth=1)
        left.set(
            xlim=(0, max(starts[-1] + DISTANCE_STEP_M, 1)),
            xlabel="distance (m)" + (f"; beyond {FARTHEST_M:g} m in the last bar" if counts[-1] else ""),
            ylabel="objects",
        )
        left.yaxis.set_major_formatter(thousands)
    names = [name for name in DISTANCE_BINS if bins[name]["cells"] or name != "unknown"]
    if not any(bins[name]["cells"] for name in names):
        say_nothing_there(right, "no pairs")
        return figure
    bars = right.bar(range(len(names)), [bins[name]["u_share"] or 0.0 for name in names], width=0.68, color=LIGHT)
    right.bar_label(bars, [percent(bins[name]["u_share"]) for name in names], padding=3, fontsize=9)
    right.set_xticks(range(len(names)), [name.replace("-", "–") for name in names])
    right.set(xlabel="distance of the first object (m)", ylabel="labels in doubt")
    right.yaxis.set_major_formatter(whole_percent)
    right.tick_params(length=0)
    right.margins(y=0.12)
    return figure


def draw_classes(statistics: dict[str, Any]) -> Figure:
    """The most frequent classes, and how many of their objects can be asked for."""
    classes = statistics["classes"]
    shown, others = list(classes)[:CLASSES_SHOWN], list(classes.values())[CLASSES_SHOWN:]
    usable, objects = statistics["counts"]["objects_usable"], statistics["counts"]["objects"]
    figure = new_figure(
        HALF,
        class_rows_height(statistics),
        f"{percent(usable / objects)} of {thousands(objects)} objects can be asked for"
        if objects
        else "There are no objects",
        "Objects by class: those that can be asked for (dark), and those that are too small, too sparse or of "
        "the background (light)."
        + (f" {len(others)} rarer classes have {thousands(sum(e['objects'] for e in others))} more." if others else ""),
    )
    from matplotlib.ticker import MaxNLocator

    axes = figure.subplots()
    if not shown:
        say_nothing_there(axes, "no objects")
        return figure
    rows, total = np.arange(len(shown)), [classes[name]["objects"] for name in shown]
    axes.barh(rows, total, height=0.68, color=LIGHT)
    axes.barh(rows, [classes[name]["usable"] for name in shown], height=0.68, color=DARK)
    for row, count in enumerate(total):
        axes.annotate(thousands(count), (count, row), (4, 0), textcoords="offset points", va="center", fontsize=8.5,
                      color=QUIET)  # fmt: skip
    axes.set_yticks(rows, [short(name) for name in shown])
    axes.set(ylim=(max(len(shown), FEWEST_ROWS) - 0.5, -0.5), xlabel="objects")
    axes.xaxis.set_major_formatter(thousands)
    axes.xaxis.set_major_locator(MaxNLocator(6, integer=True))
    axes.margins(x=0.1)
    bare(axes)
    return figure


def draw_heat_map(statistics: dict[str, Any], found: Distributions) -> Figure:
    """Expressions by relation and class of their target."""
    relations = list(statistics["relations"])
    asked = sorted(
        ((name, entry["as_target"]) for name, entry in statistics["classes"].items() if entry["as_target"]),
        key=lambda item: (-item[1], item[0]),
    )
    names = [name for name, _ in asked[:CLASSES_SHOWN]]
    figure = new_figure(
        FULL,
        110 + 30 * len(relations),
        _heat_title(asked),
        "Expressions by relation and class of their target"
        + (f"; the {len(names)} most frequent of {len(asked)} classes." if len(asked) > len(names) else "."),
    )
    axes = figure.subplots()
    if not names:
        say_nothing_there(axes, "no expressions")
        return figure
    from matplotlib.colors import LinearSegmentedColormap

    counts = np.array([[found.by_class.get((r, name), 0) for name in names] for r in relations], np.int64)
    most = max(int(counts.max()), 1)
    axes.pcolormesh(
        counts, cmap=LinearSegmentedColormap.from_list("slate", ["white", LIGHT, DARK, "#1d2636"]), vmin=0, vmax=most,
        edgecolors="white", linewidth=2,
    )  # fmt: skip
    for (row, column), count in np.ndenumerate(counts):
        color = LINE if not count else "white" if count > 0.45 * most else "#1f2630"
        text = thousands(count) if count < 10_000 else f"{count / 1000:,.0f}k"
        axes.text(column + 0.5, row + 0.5, text, ha="center", va="center", fontsize=8.5, color=color)
    axes.set_yticks(np.arange(len(relations)) + 0.5, relations)
    slanted = len(names) > 8
    axes.set_xticks(
        np.arange(len(names)) + 0.5,
        [short(name, 18) for name in names],
        rotation=40 if slanted else 0,
        ha="right" if slanted else "center",
        rotation_mode="anchor" if slanted else "default",
        color="#1f2630",
    )
    axes.invert_yaxis()
    axes.set_xlim(0, max(len(names), 2 * FEWEST_ROWS))
    bare(axes, "left", "bottom")
    return figure


def _heat_title(asked: list[tuple[str, int]]) -> str:
    if not asked:
        return "There are no expressions"
    total = sum(count for _, count in asked)
    name, count = asked[0]
    if len(asked) == 1:
        return f"All expressions ask for “{short(name)}”"
    return f"Of {len(asked)} classes, “{short(name)}” is asked for most: {percent(count / total)} of expressions"


def class_rows_height(statistics: dict[str, Any]) -> int:
    """Pixels of a picture whose rows are the classes."""
    return 60 + 21 * max(min(len(statistics["classes"]), CLASSES_SHOWN), FEWEST_ROWS)
