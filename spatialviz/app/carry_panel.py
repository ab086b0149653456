"""Selected labelled object carried to the scene's other frames: proposed masks as pictures, accepted singly or all."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from threading import Thread

from pipeline.corrections.journal.effective import Corrector
from pipeline.corrections.journal.events import Saved
from pipeline.corrections.propagate import CarriedObject, FrameProposals, proposals, with_scene
from pipeline.datasets.base import frames_of_scene
from pipeline.language.counted import counted
from pipeline.scenes.views import posed_frames
from pipeline.system.errors import InputError
from pipeline.system.frozen import dataclass
from spatialviz.app.context import Context, command, there
from spatialviz.app.label_part import LabelPart
from spatialviz.app.markup import Element, button, h, heading, note, panel, progress
from spatialviz.app.object_strip import picture_part


@dataclass(frozen=True, eq=False)
class Carrying:
    """Proposals of one object as they come in; nothing of them is saved."""

    source: str
    frame: str
    number: int
    refined: bool
    frames: int  # To look at
    found: tuple[FrameProposals, ...] = ()
    accepted: frozenset[tuple[str, int]] = frozenset()  # Frames and numbers
    ended: bool = False
    problem: str = ""

    @property
    def waiting(self) -> tuple[tuple[CarriedObject, FrameProposals], ...]:
        """Proposals that change something, and are not accepted yet."""
        made = ((p, one) for one in self.found for p in one.proposals if p.edits)
        return tuple((p, one) for p, one in made if (p.frame, p.number) not in self.accepted)

    @property
    def trusted(self) -> tuple[CarriedObject, ...]:
        """Proposals that are accepted together: without the doubtful ones."""
        return tuple(p for p, _ in self.waiting if not p.mask.doubtful)


class CarryPanel(LabelPart):
    """Proposes the selected object in other frames, and saves what is accepted as one step."""

    def __init__(self, ctx: Context, picture: Callable[[str], str]) -> None:
        super().__init__(ctx)
        self._picture = picture
        self._now: Carrying | None = None

    @command("carry", "carry-refined")
    def start(self, by: str) -> None:
        """Look for the object in the scene's other frames, in the background."""
        number, frame, dataset = there(self.number), self.state.frame_id, self.ctx.source.dataset
        frames = len(posed_frames(dataset, frame)) - 1
        begun = self._now = Carrying(self.state.source, frame, number, by == "carry-refined", frames)
        Thread(target=self._look, args=(begun,), daemon=True, name="carry").start()
        self.follow()

    def _look(self, begun: Carrying) -> None:
        location, dataset = self.ctx.shared.journals[begun.source], self.ctx.shared.store.sources[begun.source].dataset
        try:
            corrector = Corrector(with_scene(location.labels, dataset, begun.frame), dataset)
            journal = location.to_read()
            for one in proposals(corrector, journal or (), begun.frame, {begun.number}, refined=begun.refined):
                if self.ctx.closed.is_set() or not self._is_of(begun):
                    return
                self.ctx.post(lambda one=one: self._add(begun, one))
            self.ctx.post(lambda: self._end(begun))
        except InputError as error:
            self.ctx.post(lambda said=str(error): self._end(begun, said))

    def _is_of(self, begun: Carrying) -> bool:
        now, key = self._now, (begun.source, begun.frame, begun.number, begun.refined)
        return now is not None and (now.source, now.frame, now.number, now.refined) == key

    def _add(self, begun: Carrying, one: FrameProposals) -> None:
        if self._now is not None and self._is_of(begun):
            self._now = replace(self._now, found=(*self._now.found, one))
            self.follow()

    def _end(self, begun: Carrying, problem: str = "") -> None:
        if self._now is not None and self._is_of(begun):
            self._now = replace(self._now, ended=True, problem=problem)
            self.follow()

    @command("carry-all")
    def accept_all(self) -> None:
        """Save all proposals but the doubtful ones, as one step."""
        self._accept(there(self._now).trusted)

    @command("carry-one")
    def accept(self, number: int, frame: str) -> None:
        """Save one proposal."""
        self._accept([p for p, _ in there(self._now).waiting if (p.frame, p.number) == (frame, number)])

    def _accept(self, chosen: Sequence[CarriedObject]) -> None:
        now, edits = there(self._now), tuple(e for p in chosen for e in p.edits)
        there(edits or None)
        for p in chosen:
            self.editor.take_in(p.frame)
        if isinstance(self.save(lambda _: edits), Saved):
            accepted = now.accepted | {(p.frame, p.number) for p in chosen}
            self._now = replace(now, accepted=accepted)
        self.follow()

    @command("carry-end")
    def drop(self) -> None:
        """Drop the proposals."""
        self._now = None
        self.follow()

    def follow(self) -> None:
        """Draw the proposals of the object that is selected, or the button that asks for them."""
        state, now = self.state, self._now
        if state.labels is None or self.number is None:
            shown = None
        elif now is not None and (now.source, now.frame, now.number) == (state.source, state.frame_id, self.number):
            shown = carrying_html(now, self._picture)
        else:
            shown = self._offer()
        self.ctx.page.show("carry", shown)

    def _offer(self) -> Element | None:
        dataset = self.ctx.source.dataset
        if len(frames_of_scene(dataset, self.state.frame_id)) < 2:
            return None
        hint = "carry its pixels and class to the scene's other frames by their poses and depth; nothing is saved yet"
        return panel(heading("Other frames", button("propose", "carry", hint)))


def carrying_html(now: Carrying, picture: Callable[[str], str]) -> Element:
    """Proposed masks, drawn in parts of their frames' pictures, and what they rest on."""
    waiting, ended, trusted = now.waiting, now.ended, len(now.trusted)
    accept = h.button(f"accept {trusted}", cls="go", do="carry-all", title="all that are not doubtful, as one step")
    refine = button("refine poses", "carry-refined", "first fit each frame's pose to this frame's surfaces")
    return panel(
        heading(
            "Other frames",
            accept if trusted and ended else None,
            refine if ended and not now.refined else None,
            button("propose again", "carry") if ended and not waiting else None,
            button("close", "carry-end", "drop these proposals"),
        ).with_(id="carry-head"),
        progress("Frames looked at", len(now.found), now.frames) if not ended else None,
        note(f"Not carried: {now.problem}", "bad") if now.problem else None,
        h.div(_said(now, len(waiting)), cls="dim"),
        h.div((_proposal(p, one, picture(p.frame)) for p, one in waiting), cls="strip"),
    )


def _said(now: Carrying, waiting: int) -> str:
    seen = sum(bool(one.proposals) for one in now.found)
    doubtful = waiting - len(now.trusted)
    parts = [f"seen in {seen} of {counted(len(now.found), 'frame')}{', each with its confidence' * bool(waiting)}"]
    parts += [f"{len(now.accepted)} accepted"] if now.accepted else []
    parts += ["nothing would change"] if now.found and not waiting and not now.accepted and seen else []
    parts += [f"{doubtful} doubtful: look first"] if doubtful else []
    moved = [one.refinement.moved_m for one in now.found if one.refinement is not None]
    parts += [f"poses moved by up to {100 * max(moved):.1f} cm"] if moved else []
    agree = [one.agree for one in now.found if one.agree is not None]
    span = dict.fromkeys(f"{share:.0%}" for share in (min(agree), max(agree))) if agree else ()
    parts += [f"surfaces agree by {' to '.join(span)}"] if agree else []
    return " · ".join(parts)


def _proposal(p: CarriedObject, one: FrameProposals, address: str) -> Element:
    trust = f"{p.mask.confidence:.0%}"
    what = "new object" if p.new else ", ".join(e.ref.field for e in p.edits)
    said = f"{p.label} in {p.frame}: {what}; confidence {trust}, {p.mask.seen:.0%} of the mask seen in this frame"
    shown = h.button(
        picture_part(p.mask.mask.box, one.size, address, p.mask.mask),
        do=f"open:{p.frame}" if p.new else f"object-at:{p.number}:{p.frame}",
        cls="sighting doubtful" if p.mask.doubtful else "sighting",
        title=said,
        aria_label=said,
    )
    name = f"accept {p.label} in {p.frame}"
    accept = button("✓", f"carry-one:{p.number}:{p.frame}", name, aria_label=name)
    return h.figure(shown, h.figcaption(h.span(trust), accept), cls="carried", id=f"carried-{p.frame}-{p.number}")
