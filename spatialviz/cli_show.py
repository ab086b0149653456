"""The command that shows what is known of a labelled object or pair, and where from."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from tyro.conf import OmitArgPrefixes, Positional

from pipeline.system.errors import InputError
from spatialviz.cli_journal import DatasetOptions, JournalOptions
from spatialviz.exits import FINE, NO
from spatialviz.options import print_json


@dataclass(frozen=True)
class Show:
    """Show the labels of a frame's objects, of one object or of a pair, field by field, with who or what made each."""

    labels: Positional[Path]
    """Labels folder."""
    frame: Positional[str]
    """Frame id, or its index."""
    object: int | None = None
    """Only this object, rejected ones included."""
    pair: str | None = None
    """A,B: every relation of "A RELATION B"."""
    journal: OmitArgPrefixes[JournalOptions] = field(default_factory=JournalOptions)
    source: OmitArgPrefixes[DatasetOptions] = field(default_factory=DatasetOptions)
    support: bool = False
    """With --object: what it stands on, found in the depth around it."""
    json: bool = False
    """Print one JSON object for each object, or one for the pair."""

    def run(self) -> int:
        from pipeline.corrections.cards import pair_card
        from pipeline.corrections.journal.effective import Corrector
        from pipeline.corrections.journal_location import JournalLocation
        from pipeline.corrections.object_card import object_card
        from pipeline.corrections.support import support_of
        from pipeline.datasets.base import named_frame
        from pipeline.labels.reading import open_labels
        from spatialviz.printing_show import print_objects, print_pair, print_support

        if self.object is not None and self.pair is not None:
            raise InputError("--object and --pair exclude each other")
        if self.support and self.object is None:
            raise InputError("--support needs --object")
        labels = open_labels(self.labels)
        if self.journal.journal is not None:
            journal = self.journal.open(labels, must_exist=True)
        else:
            journal = JournalLocation(labels, project=self.journal.project).to_read()
        corrector = Corrector(labels, self.source.open(labels))
        name = named_frame(tuple(corrector.index.of_frame), self.frame, labels.root)
        frame = corrector.frame(name, () if journal is None else journal)
        if self.pair is not None:
            card = pair_card(frame, *_two_numbers(self.pair))
            print_json(card.record()) if self.json else print_pair(card)
            return FINE if card.lines else NO
        numbers = sorted({*frame.objects, *frame.left_out}) if self.object is None else [self.object]
        cards = [object_card(frame, n) for n in numbers]
        stands = support_of(frame, numbers[0], corrector) if self.support else None
        if self.json:
            for one in cards:
                more = {} if stands is None else {"support": {**stands[0].record(), "gap": stands[1]}}
                print_json({**one.record(), **more})
            return FINE if cards else NO
        print_objects(cards, whole=self.object is not None)
        if stands is not None:
            print_support(frame, *stands)
        return FINE if cards else NO


def _two_numbers(said: str) -> tuple[int, int]:
    try:
        a, b = (int(part) for part in said.split(","))
    except ValueError:
        raise InputError("a pair is two numbers of objects", got=repr(said), expected="--pair 3,5") from None
    return a, b
