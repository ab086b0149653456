"""The Retrain section: what was corrected, how far the training is, and what it was worth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from pipeline.corrections.review.label_jobs import CANCELLED, TrainingProgress
from pipeline.language.relation_names import PHRASE
from spatialviz.app.text import BAD, DOUBT, GOOD, heading, note, safe, tail

STEPS = {
    "labels": "applying the corrections",
    "before": "learning the labels before",
    "after": "learning the labels after",
    "replay": "making the run again",
}
LISTED = 6


def retrain_html(training: TrainingProgress, corrections: int | None, with_run: bool) -> str:
    """The section of the Review tab; `corrections` is None where the journal cannot be read."""
    head = heading("Retrain", _action(training, corrections))
    if training.running:
        what, done, of = training.step
        share = done / of if of else 0.0
        said = f"{STEPS.get(what, what)} · {training.seconds:.0f} s"
        return head + f'<div class="prog"><i style="width:{share:.1%}"></i></div><div class="dim">{said}</div>'
    if training.problem and training.problem != CANCELLED:
        return head + note(f"Not trained: {training.problem}", BAD)
    if training.record is None:
        run = ", and makes the run again with it" if with_run else ""
        said = "Nothing corrected yet."
        if corrections is None:
            said = "The journal cannot be read now: what was corrected is not known."
        elif corrections:
            said = f"Learns the relations from the labels as they are now{run}."
        return head + f'<div class="dim">{said}</div>'
    return head + _figures(training) + _replayed(training.record) + _install(training)


def _action(training: TrainingProgress, corrections: int | None) -> str:
    if training.running:
        return '<span class="try" role="button" onclick="sv(\'stop-training\')">stop</span>'
    if not corrections:
        return '<span class="try" aria-disabled="true">retrain</span>'
    hint = f"{corrections} events in the journal (Shift+G)"
    return f'<span class="try" role="button" onclick="sv(\'retrain\')" title="{hint}">retrain</span>'


def _figures(training: TrainingProgress) -> str:
    """F1 by relation: learnt from the labels before, after, and of the network in use, on pairs that none has seen."""
    record = training.record
    assert record is not None
    trained, in_use = record["retraining"], record["in_use"]
    held, events = trained["held_out"], record["corrections"]["events"]
    rows = []
    names = list(trained["after"]["f1"])
    for name in [*names, "all"]:
        before, after = (_f1(trained[k], name) for k in ("before", "after"))
        now = None if in_use is None else _f1(in_use["before"], name)
        gain = None if before is None or after is None else (after - before) * 100
        color = "" if gain is None or abs(gain) < 0.05 else f"color:{GOOD if gain > 0 else BAD}"
        title = "all" if name == "all" else PHRASE[name]
        cells = "".join(f'<td class="n">{"–" if v is None else f"{v * 100:.1f}"}</td>' for v in (now, before, after))
        said = "–" if gain is None else f"{gain:+.1f}"
        cells += f'<td class="n" style="{color}">{said}</td>'
        rows.append(f'<tr class="{"sum" if name == "all" else ""}"><td>{title}</td>{cells}</tr>')
    right, wrong = trained["became_right"]["cells"], trained["became_wrong"]["cells"]
    gain = trained["gain"]["micro_f1"]
    ends = (gain["low"], gain["high"])
    interval = "–" if None in ends else f"[{ends[0] * 100:+.1f}, {ends[1] * 100:+.1f}]"
    return (
        f'<div class="dim">{events} events · F1 on {held["pairs"]} held-out pairs of {held["frames"]} frames · '
        f"{training.seconds:.0f} s</div>"
        '<table class="slices"><tr><th></th><th class="n" title="the network in use">in use</th>'
        '<th class="n" title="learnt from the labels before">before</th>'
        '<th class="n" title="learnt from the labels with the corrections">after</th><th class="n">gain</th></tr>'
        f"{''.join(rows)}</table>"
        f'<div class="dim">{right} held-out cells became right, {wrong} wrong; gain {interval}</div>'
        + _cells("became right", trained["became_right"]["listed"])
        + _cells("became wrong", trained["became_wrong"]["listed"])
    )


def _f1(figures: Mapping[str, Any], name: str) -> float | None:
    found = figures["micro_f1"] if name == "all" else figures["f1"].get(name)
    return None if found is None else found["value"]


def _cells(title: str, cells: Sequence[Mapping[str, Any]]) -> str:
    """The cells that changed most; a click shows the pair."""
    if not cells:
        return ""
    rows = "".join(
        f'<div class="cellrow" onclick="{_sends("labels-at:" + _pair_at(c))}" title="{safe(c["frame"])}">'
        f"<span>{c['a']} {PHRASE[c['relation']]} {c['b']} is {c['label']}</span>"
        f'<span class="dim">{safe(c["frame"])}</span><span class="n">{c["before"]:.2f} → {c["after"]:.2f}</span></div>'
        for c in cells[:LISTED]
    )
    return f"<details><summary>{title}, the largest changes</summary>{rows}</details>"


def _pair_at(cell: Mapping[str, Any]) -> str:
    return f"{cell['a']},{cell['b']},{cell['relation']},{cell['frame']}"


def _replayed(record: Mapping[str, Any]) -> str:
    parts = []
    for title, key in (("mended labels alone", "mended"), ("new network on them", "replay")):
        found = record[key]
        if found is None:
            continue
        gain = found["differences"][found["measure"]]
        fixed, broken = found["fixed"], found["broken"]
        parts.append(
            f'<div class="vrow2"><b>{title}</b><span style="color:{GOOD}">{len(fixed)} became right</span>'
            f'<span style="color:{BAD}">{len(broken)} became wrong</span>'
            f'<span class="dim">{gain["value"] * 100:+.1f} [{gain["low"] * 100:+.1f}, {gain["high"] * 100:+.1f}]</span>'
            "</div>" + _expressions("became right", fixed) + _expressions("became wrong", broken)
        )
    return heading("The run again") + "".join(parts) if parts else ""


def _expressions(title: str, rows: Sequence[Mapping[str, Any]]) -> str:
    if not rows:
        return ""
    listed = "".join(
        f'<div class="cellrow" onclick="{_sends("replayed:" + r["frame"] + "|" + r["text"])}">'
        f'<span>{safe(r["text"])}</span><span class="dim">{safe(r["frame"])}</span></div>'
        for r in rows[:LISTED]
    )
    more = f'<div class="dim">and {len(rows) - LISTED} more</div>' if len(rows) > LISTED else ""
    return f"<details><summary>{title}</summary>{listed}{more}</details>"


def _sends(message: str) -> str:
    return f'sv(this.dataset.m)" data-m="{safe(message)}'


def _install(training: TrainingProgress) -> str:
    record = training.record
    assert record is not None
    where = f'<div class="dim path" title="{safe(record["folder"])}">{tail(record["folder"])}</div>'
    if training.installed:
        said = f"Installed: --srm {training.installed}; in the Edit tab it answers any question."
        return note(said, GOOD) + where
    warning = ""
    in_use = record["in_use"]
    if in_use is not None:
        now, new = (in_use[k]["micro_f1"]["value"] for k in ("before", "after"))
        if None not in (now, new) and new < now:
            said = f"The network in use has {now * 100:.1f} on these pairs, more than the new one ({new * 100:.1f})."
            said += "".join(f" {caveat.removeprefix('before: ')}." for caveat in in_use.get("caveats", ()))
            warning = note(said, DOUBT)
    field = (
        '<input class="find name" placeholder="name" maxlength="64" '
        "onkeydown=\"if(event.key==='Enter')sv('install:'+this.value)\">"
    )
    take = "sv('install:'+this.parentElement.querySelector('input').value)"
    button = f'<span class="try go" role="button" onclick="{take}">install</span>'
    return warning + f'<div class="inst">{field}{button}</div>' + where
