"""Statistics of labels and of datasets on the terminal."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from rich.table import Table

from pipeline.labels.makers import makers_of
from pipeline.labels.reading import Labels
from pipeline.language.counted import counted
from spatialviz.printing import console, figure, say, table

CLASSES = 15
SUMMARY_CLASSES = 20
LONGEST_NAME = 28


def print_statistics(statistics: dict[str, Any], labels: Labels) -> None:
    """What labels contain: counts, relations, classes, distance and ambiguity. 100 columns are enough."""
    counts, cells, text = statistics["counts"], statistics["cells"], statistics["text"]
    ambiguity, occlusion = statistics["ambiguity"], statistics["occlusion"]
    candidates = counts["candidates"]
    of = "" if candidates is None else f" of {counted(candidates, 'candidate')}"
    per_pair = cells["positives_per_pair"]
    say((str(labels.root), "bold"), (f"  rules {labels.manifest.profile.get('name')}", "dim"))
    say(
        f"{counts['frames_usable']:,} of {counted(counts['frames'], 'frame')} usable, "
        f"{counted(counts['scenes'], 'scene')}, up {_listed(statistics['up_source']) or 'unknown'}"
    )
    reasons = _listed(counts["unusable"])
    others = f"; the others: {reasons}" if reasons else ""
    say(f"{counts['objects_usable']:,} of {counted(counts['objects'], 'object')} can be asked for{others}")
    say(
        f"{_share(occlusion['occluded_share'])} of them all are partly hidden, "
        f"{_share(occlusion['touching_border_share'])} are cut by the border"
    )
    if per_pair is not None:
        say(
            f"{counted(counts['pairs'], 'pair')}, {per_pair:.2f} relations hold of each on average, "
            f"{_share(cells['pairs_without_T_share'])} have none; {_share(cells['u_share'])} of labels undecided"
        )
    say(
        f"{counted(counts['expressions'], 'expression')}{of}, {counted(text['sentences'], 'sentence')} "
        f"for {counted(text['questions'], 'question')}; {_share(ambiguity['share'])} have several right answers"
    )
    for what, who in makers_of(labels.manifest).lines().items():
        say((f"{what}: ", "dim"), who)
    say()
    console().print(_relations(statistics))
    say()
    if statistics["classes"]:
        side_by_side = Table.grid(padding=(0, 4, 0, 0))
        right = Table.grid()
        right.add_row(_distances(statistics))
        right.add_row("")
        right.add_row(_set_sizes(ambiguity))
        side_by_side.add_row(_classes(statistics["classes"]), right)
        console().print(side_by_side)
        say()


def _relations(statistics: dict[str, Any]) -> Table:
    titles = ("T", "U", "F", "U %", "T a pair", "expressions", "ambiguous", "5 % margin", "median")
    rows = []
    for name, entry in statistics["relations"].items():
        margin = statistics["margins"][name]["T"]
        rows.append(
            (
                name,
                *(f"{entry[state]:,}" for state in "TUF"),
                _share(entry["u_share"]),
                figure(entry["T_per_pair"], ".3f", "–"),
                f"{entry['expressions']:,}",
                _share(entry["ambiguous_share"]),
                *("–" if margin is None else f"{100 * margin[k]:.1f} cm" for k in ("p05", "p50")),
            )
        )
    return _table("relation", titles, rows)


def _classes(classes: Mapping[str, Mapping[str, int]]) -> Table:
    keys = ("objects", "usable", "as_target", "as_reference")
    rows = [(_short(name), *(f"{entry[k]:,}" for k in keys)) for name, entry in list(classes.items())[:CLASSES]]
    others = list(classes.values())[CLASSES:]
    if others:
        rows.append((f"{len(others)} others", *(f"{sum(entry[k] for entry in others):,}" for k in keys)))
    return _table("class", ("objects", "usable", "target", "reference"), rows)


def _distances(statistics: dict[str, Any]) -> Table:
    rows = [
        (name if name == "unknown" else f"{name} m", f"{e['objects']:,}", f"{e['expressions']:,}", _share(e["u_share"]))
        for name, e in statistics["distance"].items()
        if e["objects"] or name != "unknown"
    ]
    return _table("distance", ("objects", "targets", "U %"), rows)


def _set_sizes(ambiguity: dict[str, Any]) -> Table:
    total = ambiguity["expressions"]
    rows = [(size, f"{n:,}", _share(n / total)) for size, n in list(ambiguity["set_sizes"].items())[:6]]
    rest = sum(list(ambiguity["set_sizes"].values())[6:])
    if rest:
        rows.append(("more", f"{rest:,}", _share(rest / total)))
    return _table("right answers", ("expressions", "share"), rows)


def print_summary(summary: dict[str, Any]) -> None:
    """Counts over the frames of a dataset."""
    frames, usable = summary["frames"], summary["frames_usable"]
    say(f"{usable:,} of {counted(frames, 'frame')} can be used")
    for note in summary["notes"]:
        say(f"  note: {note}", style="yellow")
    for reason, count in list(summary["problems"].items())[:5]:
        say(f"  {count:,} broken: {reason}", style="red")
    if len(summary["problems"]) > 5:
        rest = sum(list(summary["problems"].values())[5:])
        say(f"  {rest:,} broken for other reasons", style="red")
    if not usable:
        return
    say(f"  {_listed(summary['sizes'])}; up {_listed(summary['up_source'])}", style="dim")
    lacking = {
        "with little depth": summary["frames_with_little_depth"],
        "without pose": summary["frames_without_pose"],
        "without objects": summary["frames_without_objects"],
        "with notes": summary["frames_with_notes"],
    }
    frames_lacking = ", ".join(f"{count:,} {what}" for what, count in lacking.items() if count)
    depth = f"{_share(summary['depth_valid'])} of the pixels have depth"
    say(f"  {depth}" + (f"; frames: {frames_lacking}" if frames_lacking else ""), style="dim")
    classes = summary["classes"]
    if not classes:
        return
    per_frame = summary["objects_per_frame"]
    say(
        f"{counted(summary['objects'], 'object')} of {counted(len(classes), 'class')}, {per_frame:.1f} a frame: ",
        (_listed(classes, SUMMARY_CLASSES), "dim"),
    )


def _table(first: str, titles: Iterable[str], rows: Iterable[Sequence[str]]) -> Table:
    return table((first, *(f">{title}" for title in titles)), rows, no_wrap=True)


def _listed(counts: Mapping[str, int], most: int | None = None) -> str:
    """Names with their counts, the rest as one."""
    names = list(counts)
    listed = [f"{_short(name)} {counts[name]:,}" for name in names[:most]]
    if rest := names[len(listed) :]:
        listed.append(f"{len(rest):,} others {sum(counts[name] for name in rest):,}")
    return ", ".join(listed)


def _short(name: str) -> str:
    name = " ".join(name.split()) or "(blank)"
    return name if len(name) <= LONGEST_NAME else name[: LONGEST_NAME - 1] + "…"


def _share(value: float | None) -> str:
    if value is None:
        return "–"
    return f"{value:.1%}" if 0 < value < 0.0995 else f"{value:.0%}"
