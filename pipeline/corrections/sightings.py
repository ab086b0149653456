"""Other frames of a labelled object: where its instance is labelled, too."""

from __future__ import annotations

from collections import defaultdict

from pipeline.labels.reading import Labels
from pipeline.system.frozen import dataclass


@dataclass(frozen=True)
class LabelledSighting:
    """A labelled object in a frame."""

    frame: str
    number: int
    label: str
    bbox: tuple[float, float, float, float]  # x0, y0, x1, y1, pixels
    size: tuple[int, int]  # Height and width of the picture


class Sightings:
    """Labelled objects by their instance in a scene, as the labels have them.

    >>> from pipeline.corrections.sightings import Sightings
    >>> from pipeline.datasets.demo import demo_run
    >>> from pipeline.evaluation.run_folder import open_run
    >>> Sightings(open_run(demo_run()).labels).of("000001/000000", 3)
    ()
    """

    def __init__(self, labels: Labels) -> None:
        frames = labels.frames.select(["frame", "scene", "width", "height"]).to_pylist()
        known = {row["frame"]: row for row in frames}
        self._instance: dict[tuple[str, int], tuple[str, int]] = {}
        self._found: defaultdict[tuple[str, int], list[LabelledSighting]] = defaultdict(list)
        columns = ["frame", "object", "label", "instance", "bbox"]
        for row in labels.objects.select(columns).to_pylist():
            frame = known.get(row["frame"])
            if row["instance"] is None or frame is None:
                continue
            key = frame["scene"], row["instance"]
            self._instance[row["frame"], row["object"]] = key
            size = frame["height"], frame["width"]
            self._found[key].append(
                LabelledSighting(row["frame"], row["object"], row["label"], tuple(row["bbox"]), size)
            )

    def of(self, frame: str, number: int) -> tuple[LabelledSighting, ...]:
        """Frames of an object in the labels' order, this one among them; empty without an instance."""
        key = self._instance.get((frame, number))
        return () if key is None else tuple(self._found[key])

    def beside(self, frame: str, number: int, step: int) -> LabelledSighting | None:
        """The next frame of an object, or the previous; None at the end."""
        found = self.of(frame, number)
        at = next((k for k, s in enumerate(found) if s.frame == frame), None)
        return None if at is None or not 0 <= at + step < len(found) else found[at + step]
