"""The command that compares two detectors."""

from __future__ import annotations

from dataclasses import dataclass

from tyro.conf import OmitArgPrefixes, Positional

from pipeline.system.errors import InputError
from spatialviz.cli_detect import DetectorOptions
from spatialviz.exits import FINE, NO
from spatialviz.options import print_json, warn_skipped


@dataclass(frozen=True)
class Agree:
    """How far two detectors agree: on frames, class by class, and on their scores.

    A is the detector, with what --fuse adds to it; B the one of --also. Exit status 1 where neither finds anything that
    the other knows."""

    dataset: Positional[str]
    """Dataset folder, or "demo"."""
    frame: Positional[str] = "all"
    """Frame id, its index, or "all"."""
    also: str | None = None
    """The other detector: NAME or NAME=MODEL."""
    source: OmitArgPrefixes[DetectorOptions] = DetectorOptions()
    classes: tuple[str, ...] = ()
    """Names that both are asked for. Default: everything that each knows; what the other does not know counts apart."""
    iou: float = 0.5
    """Detections that overlap less, by masks where both have them, else by boxes, are not of one thing."""
    json: bool = False
    """Print one JSON object for each frame, then one of all."""

    def run(self) -> int:
        from pipeline.answering.agreement.agreement_figures import figures
        from pipeline.answering.agreement.frames import agree_frames, agreement_record
        from pipeline.answering.opening import ALL_FRAMES
        from spatialviz.printing import rate_bar
        from spatialviz.printing_agreement import print_agreement, print_frame_agreement

        if self.frame != ALL_FRAMES and self.source.frames != ALL_FRAMES:
            raise InputError("frames are named twice", got=f"{self.frame} and --frames {self.source.frames}")
        source, _ = self.source.open(self.dataset, self.also)
        frames = self.source.frames if self.frame == ALL_FRAMES else self.frame
        names = source.sides
        found = []
        with rate_bar("comparing", "frames") as advance:
            for frame_id, one in agree_frames(
                source,
                frames,
                names=self.classes or None,
                min_iou=self.iou,
                skipped=warn_skipped,
                progress=advance,
            ):
                found.append(one)
                if self.json:
                    print_json(agreement_record(frame_id, one, source.synonyms))
                elif self.frame != ALL_FRAMES:
                    print_frame_agreement(frame_id, one)
        sums = figures(found, source.synonyms)
        if self.json:
            print_json({"detectors": names, **sums.record()})
        else:
            print_agreement(sums, names)
        return FINE if sums.a + sums.b else NO
