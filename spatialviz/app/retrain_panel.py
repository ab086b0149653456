"""Retraining on corrected labels, in a process shared by all clients, and the measured gain."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Any

from platformdirs import user_data_path

from pipeline.corrections.review.label_jobs import CANCELLED, RetrainingJob, TrainingProgress
from pipeline.language.relation_names import PHRASE
from pipeline.relations.model import install_network
from pipeline.system.errors import InputError
from spatialviz.app.channel import Command
from spatialviz.app.context import Context, command, there
from spatialviz.app.label_part import LabelPart
from spatialviz.app.markup import Child, Element, h, heading, note, panel, progress


class RetrainPanel(LabelPart):
    """Trains, compares, remakes the run, and installs on request."""

    def __init__(self, ctx: Context) -> None:
        super().__init__(ctx)
        journals = ctx.shared.journals
        self._last = {name: place.jobs.training.seen for name, place in journals.items()}
        ctx.leave += [
            place.jobs.training.listen(lambda name=name: ctx.post(lambda: self._tell(name)))
            for name, place in journals.items()
        ]

    def _tell(self, name: str) -> None:
        """Announce the start or end of a training, and draw."""
        was, now = self._last[name], self.ctx.shared.journals[name].jobs.training.seen
        self._last[name] = now
        if now.running and not was.running:
            self.ctx.note(f"retraining on the labels of {name}")
        elif was.running and not now.running:
            done = (
                f"not retrained: {now.problem}"
                if now.record is None
                else (f"retrained in {now.seconds:.0f} s: {now.record['folder']}")
            )
            self.ctx.note("retraining was stopped" if now.problem == CANCELLED else done)
        self.follow()

    @command("retrain")
    def start(self) -> None:
        """Train on the present labels of the current pipeline."""
        name, place, run = self.state.source, self.location, self.ctx.run
        folder = user_data_path("spatialviz") / "retrained"
        if not place.jobs.training.seen.running:
            place.jobs.train(
                RetrainingJob(
                    place.labels.root,
                    None if place.where is None else str(place.where),
                    place.project,
                    str(self.ctx.source.dataset.root),
                    out=folder / f"{name}-{datetime.now():%Y%m%d-%H%M%S}",
                    run=None if run is None else run.folder,
                )
            )

    @command("stop-training")
    def stop(self) -> None:
        """Cancel a training, begun by any client, and discard the results."""
        self.location.jobs.training.stop()

    @command("install")
    def install(self, name: str) -> None:
        """Install the trained network under a name, and ask the current question again."""
        training = self.location.jobs.training
        network = there(training.seen.record)["network"]
        try:
            done = install_network(Path(network), name.strip())
        except InputError as error:
            self.ctx.toast("Not installed", str(error), bad=True)
            return
        self.ctx.note(f"installed: --srm {done.stem} is {done}")
        training.change(lambda now: replace(now, installed=done.stem))
        if self.state.labels is None:
            # While labels are shown there is no question for the network.
            self.ctx.handle(Command("edit", (f"set:scorer:{done.stem}",)))

    def follow(self) -> None:
        """Draw the section."""
        place = self.ctx.shared.journals.get(self.state.source)
        if place is None:
            return
        corrections = None
        with suppress(InputError):
            journal = place.to_read()
            corrections = 0 if journal is None else journal.count()
        training = place.jobs.training.seen
        state = _state(training, corrections, self.ctx.run is not None)
        shown = panel(heading("Retrain", _action(training, corrections)), state)
        nothing = corrections == 0 and not training.running and training.record is None
        self.ctx.page.show("review-train", None if nothing else shown)


STEPS = {
    "labels": "applying the corrections",
    "before": "learning the labels before",
    "after": "learning the labels after",
    "replay": "making the run again",
}


def _state(training: TrainingProgress, corrections: int | None, with_run: bool) -> Child:
    """Progress or result; `corrections` is None for an unreadable journal."""
    if training.running:
        what, done, of = training.step
        return progress("Training", done, of), h.div(f"{STEPS.get(what, what)} · {training.seconds:.0f} s", cls="dim")
    if training.problem and training.problem != CANCELLED:
        return note(f"Not trained: {training.problem}", "bad")
    if training.record is None:
        said = f"Learns the relations from the labels as they are now{', and makes the run again with it' * with_run}."
        if corrections is None:
            said = "The journal cannot be read now: what was corrected is not known."
        return h.div(said, cls="dim")
    record = training.record
    return _figures(record, training.seconds), _replayed(record), _install(record, training.installed)


def _action(training: TrainingProgress, corrections: int | None) -> Element:
    if training.running:
        return h.button("stop", cls="try", do="stop-training")
    if not corrections:
        return h.button("retrain", cls="try", disabled=True)
    return h.button("retrain", cls="try", do="retrain", title=f"{corrections} events in the journal (Shift+G)")


def _figures(record: Mapping[str, Any], seconds: float) -> Child:
    """F1 by relation on held-out pairs: trained on the labels before and after, and of the installed network."""
    trained, in_use = record["retraining"], record["in_use"]
    held, events = trained["held_out"], record["corrections"]["events"]
    rows = []
    for name in [*trained["after"]["f1"], "all"]:
        before, after = (_f1(trained[k], name) for k in ("before", "after"))
        now = None if in_use is None else _f1(in_use["before"], name)
        gain = None if before is None or after is None else (after - before) * 100
        kind = "" if gain is None or abs(gain) < 0.05 else " good" if gain > 0 else " bad"
        rows.append(
            h.tr(
                h.td("all" if name == "all" else PHRASE[name]),
                (h.td("–" if v is None else f"{v * 100:.1f}", cls="n") for v in (now, before, after)),
                h.td("–" if gain is None else f"{gain:+.1f}", cls=f"n{kind}"),
                cls="sum" if name == "all" else "",
            )
        )
    right, wrong = trained["became_right"]["cells"], trained["became_wrong"]["cells"]
    ends = [trained["gain"]["micro_f1"][end] for end in ("low", "high")]
    interval = "–" if None in ends else f"[{ends[0] * 100:+.1f}, {ends[1] * 100:+.1f}]"
    counts = f"{events} events · F1 on {held['pairs']} held-out pairs of {held['frames']} frames"
    head = h.tr(
        h.td(),
        h.th("in use", cls="n", title="the network in use"),
        h.th("before", cls="n", title="learnt from the labels before"),
        h.th("after", cls="n", title="learnt from the labels with the corrections"),
        h.th("gain", cls="n"),
    )
    return (
        h.div(f"{counts} · {seconds:.0f} s", cls="dim"),
        h.table(head, rows, cls="slices"),
        h.div(f"{right} held-out cells became correct, {wrong} wrong; gain {interval}", cls="dim"),
    )


def _f1(figures: Mapping[str, Any], name: str) -> float | None:
    found = figures["micro_f1"] if name == "all" else figures["f1"].get(name)
    return None if found is None else found["value"]


def _replayed(record: Mapping[str, Any]) -> Child:
    parts = []
    for title, key in (("mended labels alone", "mended"), ("new network on them", "replay")):
        found = record[key]
        if found is None:
            continue
        gain = found["differences"][found["measure"]]
        fixed, broken = found["fixed"], found["broken"]
        interval = f"{gain['value'] * 100:+.1f} [{gain['low'] * 100:+.1f}, {gain['high'] * 100:+.1f}]"
        parts.append(
            h.div(
                h.b(title),
                h.span(f"{len(fixed)} became correct", cls="good"),
                h.span(f"{len(broken)} became wrong", cls="bad"),
                h.span(interval, cls="dim"),
                cls="vrow2",
            )
        )
    return (heading("The run again"), parts) if parts else None


def _install(record: Mapping[str, Any], installed: str) -> Child:
    # Truncated at the left by right-to-left text; `bdi` keeps the ends in place.
    where = h.div(h.bdi(record["folder"]), cls="dim path", title=record["folder"])
    if installed:
        return note(f"Installed: --srm {installed}; under What if it answers any question.", "good"), where
    in_use, warning = record["in_use"], None
    if in_use is not None:
        now, new = (in_use[k]["micro_f1"]["value"] for k in ("before", "after"))
        if None not in (now, new) and new < now:
            said = f"The network in use has {now * 100:.1f} on these pairs, more than the new one ({new * 100:.1f})."
            said += "".join(f" {caveat.removeprefix('before: ')}." for caveat in in_use.get("caveats", ()))
            warning = note(said, "doubt")
    field = h.input(
        cls="find name", placeholder="name", maxlength=64, enter="install", aria_label="Name of the network"
    )
    button = h.button("install", cls="try go", local="send:install:")
    return warning, h.div(field, button, cls="inst"), where
