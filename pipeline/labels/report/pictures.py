"""Pictures of counts and of geometry.

Counts: states, ambiguity, distance, classes, and expressions by relation and class. Geometry: where targets lie from
their references, how far decisions stand from thresholds, box sizes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.labels.report.distributions import (
    CELL_M,
    DISTANCE_STEP_M,
    FARTHEST_M,
    Displacements,
    Distributions,
    in_plan,
)
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
    new_plot,
    percent,
    relation_color,
    short,
    thousands,
    whole_percent,
    without_data,
)
from pipeline.labels.statistics import DISTANCE_BINS
from pipeline.language.relation_names import DIRECTIONAL

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

CLASSES_SHOWN = 25
FEWEST_ROWS = 5
"""Room for so many classes, so that a few do not stretch to slabs."""
SHARE_AT = (1.13, 1.29)
"""Where the shares stand in writing, in widths of the bars."""
LARGEST_SET = 8
"""Sets of acceptable objects from this size on share a bar."""


def draw_states(statistics: dict[str, Any]) -> Figure:
    """Draw the shares of T, U and F by relation."""
    relations, cells = statistics["relations"], statistics["cells"]
    figure, axes = new_plot(
        HALF,
        60 + 34 * len(relations),
        "There are no pairs of objects"
        if cells["u_share"] is None
        else f"{percent(cells['u_share'])} of all relation labels are too close to call",
        "Ordered pairs for which a relation holds (full), is in doubt (hatched), or does not hold (pale).",
    )
    if not cells["T"] + cells["U"] + cells["F"]:
        return without_data(figure, axes, "no pairs")
    for row, (name, entry) in enumerate(relations.items()):
        total = max(entry["T"] + entry["U"] + entry["F"], 1)
        t, u, color = entry["T"] / total, entry["U"] / total, relation_color(name)
        axes.barh(row, 1 - t - u, left=t + u, height=0.68, color=PALE)
        axes.barh(row, u, left=t, height=0.68, color="white", edgecolor=color, hatch="//////", linewidth=0)
        axes.barh(row, t, height=0.68, color=color)
        for x, value in zip(SHARE_AT, (t, u), strict=True):
            axes.text(x, row, percent(value), ha="right", va="center", fontsize=9)
    for x, text in zip(SHARE_AT, ("holds", "in doubt"), strict=True):
        axes.text(x, -0.78, text, ha="right", va="center", fontsize=9, color=QUIET)
    rows = {"yticks": range(len(relations)), "yticklabels": list(relations), "ylim": (len(relations) - 0.5, -1)}
    axes.set(**rows, xlim=(0, 1), xlabel="share of ordered pairs")
    axes.xaxis.set_major_formatter(whole_percent)
    bare(axes)
    return figure


def draw_ambiguity(statistics: dict[str, Any]) -> Figure:
    """Draw the number of acceptable objects of expressions."""
    ambiguity = statistics["ambiguity"]
    figure, axes = new_plot(
        HALF,
        60 + 34 * len(statistics["relations"]),
        "There are no expressions"
        if ambiguity["share"] is None
        else f"{percent(ambiguity['share'])} of the expressions have more than one right answer",
        "Expressions by the number of objects that satisfy them, undecided ones included.",
    )
    if not ambiguity["expressions"]:
        return without_data(figure, axes, "no expressions")
    counts = np.zeros(LARGEST_SET, np.int64)
    for size, count in ambiguity["set_sizes"].items():
        counts[min(max(int(size), 1), LARGEST_SET) - 1] += count
    last = max(int(np.flatnonzero(counts)[-1]) + 1, 3)
    bars = axes.bar(range(1, last + 1), counts[:last], width=0.68, color=[DARK] + [LIGHT] * (last - 1))
    axes.bar_label(bars, [thousands(c) for c in counts[:last]], padding=3, fontsize=9)
    sizes = [f"{k}+" if k == LARGEST_SET else str(k) for k in range(1, last + 1)]
    axes.set(xticks=range(1, last + 1), xticklabels=sizes, xlabel="acceptable objects", ylabel="expressions")
    axes.yaxis.set_major_formatter(thousands)
    axes.tick_params(length=0)
    axes.margins(y=0.1)
    return figure


def draw_distance(statistics: dict[str, Any], found: Distributions) -> Figure:
    """Draw distances of objects, and doubt by distance."""
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
        without_data(figure, left, "no objects with a distance")
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
        return without_data(figure, right, "no pairs")
    bars = right.bar(range(len(names)), [bins[name]["u_share"] or 0.0 for name in names], width=0.68, color=LIGHT)
    right.bar_label(bars, [percent(bins[name]["u_share"]) for name in names], padding=3, fontsize=9)
    right.set_xticks(range(len(names)), [name.replace("-", "–") for name in names])
    right.set(xlabel="distance of the first object (m)", ylabel="labels in doubt")
    right.yaxis.set_major_formatter(whole_percent)
    right.tick_params(length=0)
    right.margins(y=0.12)
    return figure


def draw_classes(statistics: dict[str, Any]) -> Figure:
    """Draw the most frequent classes with their usable objects."""
    classes = statistics["classes"]
    shown, others = list(classes)[:CLASSES_SHOWN], list(classes.values())[CLASSES_SHOWN:]
    usable, objects = statistics["counts"]["objects_usable"], statistics["counts"]["objects"]
    figure, axes = new_plot(
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

    if not shown:
        return without_data(figure, axes, "no objects")
    rows, total = np.arange(len(shown)), [classes[name]["objects"] for name in shown]
    axes.barh(rows, total, height=0.68, color=LIGHT)
    axes.barh(rows, [classes[name]["usable"] for name in shown], height=0.68, color=DARK)
    for row, count in enumerate(total):
        axes.annotate(
            thousands(count), (count, row), (4, 0), textcoords="offset points", va="center", fontsize=8.5, color=QUIET
        )
    names, bottom = [short(name) for name in shown], max(len(shown), FEWEST_ROWS) - 0.5
    axes.set(yticks=rows, yticklabels=names, ylim=(bottom, -0.5), xlabel="objects")
    axes.xaxis.set_major_formatter(thousands)
    axes.xaxis.set_major_locator(MaxNLocator(6, integer=True))
    axes.margins(x=0.1)
    bare(axes)
    return figure


def draw_heat_map(statistics: dict[str, Any], found: Distributions) -> Figure:
    """Draw expressions by relation and class of the target."""
    relations = list(statistics["relations"])
    asked = sorted(
        ((name, entry["as_target"]) for name, entry in statistics["classes"].items() if entry["as_target"]),
        key=lambda item: (-item[1], item[0]),
    )
    names = [name for name, _ in asked[:CLASSES_SHOWN]]
    figure, axes = new_plot(
        FULL,
        110 + 30 * len(relations),
        _heat_title(asked),
        "Expressions by relation and class of their target"
        + (f"; the {len(names)} most frequent of {len(asked)} classes." if len(asked) > len(names) else "."),
    )
    if not names:
        return without_data(figure, axes, "no expressions")
    from matplotlib.colors import LinearSegmentedColormap

    counts = np.array([[found.by_class.get((r, name), 0) for name in names] for r in relations], np.int64)
    most = max(int(counts.max()), 1)
    axes.pcolormesh(
        counts,
        cmap=LinearSegmentedColormap.from_list("slate", ["white", LIGHT, DARK, "#1d2636"]),
        vmin=0,
        vmax=most,
        edgecolors="white",
        linewidth=2,
    )
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
    """Pixels of a picture with a row a class."""
    return 60 + 21 * max(min(len(statistics["classes"]), CLASSES_SHOWN), FEWEST_ROWS)


NEAR_THRESHOLD_MM = 20
MARGIN_EDGES_MM = (
    0, 5, 7.5, 10, 15, 20, 30, 50, 75, 100, 150, 200, 300, 500, 750, 1000, 1500, 2000, 3000, 5000, 10_001,
)  # fmt: skip
"""Bins of about equal width on a log scale; the first holds all that is nearer."""
LEAST_SHOWN_MM = 3.5
ONE_ROW = 6
"""So many plots stand side by side."""
LIMITS_M = (0.25, 0.5, 0.75, 1, 1.5, 2, 2.5, 3, 3.5, 4, 4.5, 5, 6, 7, 8, 10)


def draw_targets(found: Distributions) -> Figure:
    """Draw the places of targets by relation, from above or from the viewer's place."""
    plan = [r for r in found.displacements if in_plan(r)]
    upright = [r for r in found.displacements if not in_plan(r)]
    rows = [row for row in (plan, upright) if row]
    firsts = {row[0]: _limit([found.displacements[name] for name in row]) for row in rows}
    if len(plan) + len(upright) <= ONE_ROW:
        rows = [plan + upright]
    columns = max(map(len, rows))
    side = min((FULL - 90) / columns - 14, 270)
    figure = new_figure(
        FULL,
        round((side + 68) * len(rows)),
        "Each relation is a place around its reference"
        if any(len(d.count) for d in found.displacements.values())
        else "No relation holds of objects whose place is known",
        "Middles of the targets of pairs for which the relation holds; the reference is at the cross, dashes are 45°. "
        "Darker: more pairs, each plot on its own scale."
        + (" A sample of the frames, spread evenly." if found.frames_sampled else ""),
    )
    grid = figure.subplots(len(rows), columns, squeeze=False)
    limit = 1.0
    for row, names in zip(grid, rows, strict=True):
        for axes, name in zip(row, names, strict=False):
            limit = firsts.get(name, limit)
            _draw_region(axes, name, found.displacements[name], limit)
            if name in firsts:
                axes.set_ylabel(f"{'farther from the viewer' if in_plan(name) else 'higher'} (m)")
                axes.set_xlabel("to the right (m)")
            else:
                axes.set_yticklabels([])
        for axes in row[len(names) :]:
            axes.set_axis_off()
    return figure


def _limit(all_of_them: list[Displacements]) -> float:
    """Metres within which 98 % of the pairs lie, rounded up."""
    reach = np.concatenate([np.maximum(np.abs(d.across), np.abs(d.along)) for d in all_of_them])
    count = np.concatenate([d.count for d in all_of_them])
    if not count.sum():
        return 1.0
    needed = _quantile(reach, count, 0.98)
    return next((limit for limit in LIMITS_M if limit >= needed), LIMITS_M[-1])


def _quantile(values: np.ndarray, counts: np.ndarray, share: float) -> float:
    order = np.argsort(values, kind="stable")
    upto = np.cumsum(counts[order])
    return float(values[order][np.searchsorted(upto, share * upto[-1])])


def _draw_region(axes: Axes, name: str, pairs: Displacements, limit: float) -> None:
    from matplotlib.colors import LinearSegmentedColormap, PowerNorm, to_rgb

    color = np.array(to_rgb(relation_color(name)))
    axes.set_title(f"{name}   ", pad=5)
    axes.text(1, 1.03, thousands(pairs.count.sum()), transform=axes.transAxes, ha="right", fontsize=8.5, color=QUIET)
    # As many whole cells a bin as make about 44 bins.
    bin_m = max(round(2 * limit / 44 / CELL_M), 1) * CELL_M
    half = int(np.ceil(limit / bin_m))
    edges = np.arange(-half, half + 1) * bin_m
    counts, _, _ = np.histogram2d(pairs.along, pairs.across, bins=(edges, edges), weights=pairs.count)
    if counts.any():
        shade = LinearSegmentedColormap.from_list(name, [color * 0.3 + 0.7, color, color * 0.45])
        # A single pair is not the darkest there is.
        scale = PowerNorm(0.5, 0, max(counts.max(), 4))
        axes.pcolormesh(edges, edges, np.ma.masked_equal(counts, 0), cmap=shade, norm=scale, linewidth=0)
    if name in DIRECTIONAL and in_plan(name):
        for slope in (1, -1):
            axes.plot([-limit, limit], [-slope * limit, slope * limit], color=LINE, lw=0.8, ls=(0, (3, 3)), zorder=0.5)
    axes.plot(0, 0, marker="+", color="black", markersize=9, markeredgewidth=1.3)
    axes.set(xlim=(-limit, limit), ylim=(-limit, limit), aspect="equal")
    ticks, texts = [-limit, 0, limit], [f"−{limit:g}", "0", f"{limit:g}"]
    axes.set_xticks(ticks, texts)
    for label, side in zip(axes.get_xticklabels(), ("left", "center", "right"), strict=True):
        label.set_horizontalalignment(side)
    axes.set_yticks(ticks, texts, color=QUIET)
    axes.tick_params(length=2.5)
    axes.spines[["top", "right"]].set_visible(True)


def draw_margins(found: Distributions) -> Figure:
    """Draw margins of each relation's decisions."""
    names = list(found.margins)
    held = [(m["mm"][m["state"] == 1], m["n"][m["state"] == 1]) for m in found.margins.values()]
    total = sum(int(n.sum()) for _, n in held)
    close = sum(int(n[mm < NEAR_THRESHOLD_MM].sum()) for mm, n in held)
    figure = new_figure(
        FULL,
        70 + 40 * len(names),
        f"{percent(close / total)} of the relations that hold do so by less than {NEAR_THRESHOLD_MM / 10:g} cm"
        if total
        else "No relation holds",
        "Margin: how far a pair's measures are from where its label would change. Heights are shares of the pairs of "
        "each side; points mark medians; what is nearer than 5 mm is in the innermost bin.",
    )
    no, yes = figure.subplots(1, 2, sharey=True, gridspec_kw={"wspace": 0.0})
    edges = np.maximum(np.array(MARGIN_EDGES_MM, np.float64), LEAST_SHOWN_MM) / 1000
    for row, name in enumerate(names):
        counted = found.margins[name]
        for axes, state, color in ((no, -1, LIGHT), (yes, 1, relation_color(name))):
            mine = counted["state"] == state
            mm, n = np.abs(counted["mm"][mine]), counted["n"][mine]
            base = len(names) - 1 - row
            axes.axhline(base, color=LINE, lw=0.8)
            if not n.sum():
                axes.text(0.5, base + 0.2, "none", transform=axes.get_yaxis_transform(), color=QUIET, fontsize=9)
                continue
            shares = np.histogram(mm, bins=np.array(MARGIN_EDGES_MM), weights=n)[0] / n.sum()
            axes.stairs(base + 0.82 * shares / max(shares.max(), 0.2), edges, baseline=base, fill=True, color=color)
            median = _quantile(mm, n, 0.5) / 1000
            axes.plot(max(median, edges[0]), base, "o", color="#1f2630", markersize=4, zorder=3, clip_on=False)
    for axes, title in ((no, "does not hold"), (yes, "holds")):
        _log_scale(axes, edges[0], 6)
        axes.set(ylim=(-0.1, len(names)), xlabel="margin (m)")
        axes.set_title(title, loc="right" if axes is no else "left", pad=6)
        bare(axes, "left", "bottom")
    no.invert_xaxis()
    no.set_yticks([len(names) - 1 - k + 0.3 for k in range(len(names))], names)
    yes.axvline(edges[0], color="#1f2630", lw=1)
    return figure


def draw_sizes(found: Distributions, statistics: dict[str, Any]) -> Figure:
    """Draw box sizes by class."""
    sizes = sorted(found.sizes, key=lambda s: (-s.longest[1], s.label))
    figure, axes = new_plot(
        HALF,
        class_rows_height(statistics),
        _size_title(sizes),
        "Longest edge of the 3D boxes of objects that can be asked for (median; the line holds 8 of 10), and "
        "their shortest (ring: median).",
    )
    if not sizes:
        return without_data(figure, axes, "no boxes")
    y = np.arange(len(sizes))
    low, half, high = np.maximum(np.array([s.longest for s in sizes]).T, 0.001)
    axes.hlines(y, low, high, color=LIGHT, lw=4, capstyle="round")
    axes.plot(half, y, "o", color=DARK, markersize=6)
    shortest = np.maximum([s.shortest for s in sizes], 0.001)
    axes.plot(shortest, y, "o", markerfacecolor="white", color=DARK, markersize=5, markeredgewidth=1.2)
    _log_scale(axes, shortest.min() / 1.4, high.max() * 1.3)
    axes.set_yticks(y, [short(s.label) for s in sizes])
    axes.set(ylim=(max(len(sizes), FEWEST_ROWS) - 0.5, -0.5), xlabel="edge (m)")
    bare(axes)
    return figure


def _log_scale(axes: Axes, lowest: float, highest: float) -> None:
    """Metres on a log scale, with a tick at each 1, 2 and 5."""
    ticks = [t for t in (0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10) if lowest <= t <= highest]
    axes.set(xscale="log", xlim=(lowest, highest))
    axes.set_xticks(ticks, [f"{t:g}" for t in ticks])
    axes.minorticks_off()
    axes.grid(axis="x")


def _size_title(sizes: list[Any]) -> str:
    if not sizes:
        return "No object has a box"
    large, small = sizes[0], sizes[-1]
    if len(sizes) == 1:
        return f"A box of “{short(large.label)}” is {large.longest[1]:.2f} m long"
    least, most = (f"{s.longest[1]:.2f} m ({short(s.label, 16)})" for s in (small, large))
    return f"Boxes are {least} to {most} long"
