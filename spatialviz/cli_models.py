"""The commands about networks: which can be used, what a file is, how fast a detector runs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from tyro.conf import OmitArgPrefixes, Positional

from pipeline.system.errors import InputError
from spatialviz.cli_detect import DetectorOptions
from spatialviz.exits import FINE, NO
from spatialviz.options import print_json


@dataclass(frozen=True)
class Models:
    """Which model files can be used and what is here; for a file, which option reads it, or why none does."""

    files: Positional[tuple[Path, ...]] = ()
    """ONNX files. Default: list all that is known."""
    json: bool = False
    """Print one JSON object."""

    def run(self) -> int:
        from pipeline.answering.model_catalogue import adapters, describe_file, look_around
        from spatialviz.printing_models import catalogue_record, file_record, print_catalogue, print_file

        if not self.files:
            known, here = adapters(), look_around()
            if self.json:
                print_json(catalogue_record(known, here))
            else:
                print_catalogue(known, here)
            return FINE
        reports = [describe_file(path) for path in self.files]
        if self.json:
            print_json({"files": [file_record(r) for r in reports]})
        else:
            for report in reports:
                print_file(report)
        return FINE if all(r.kind is not None and r.kind.options for r in reports) else NO


@dataclass(frozen=True)
class BenchDetect:
    """Run a detector over a dataset's frames again and again: frames a second, and how much memory it holds."""

    dataset: Positional[str]
    """Dataset folder, or "demo"."""
    source: OmitArgPrefixes[DetectorOptions] = DetectorOptions()
    count: int = 1000
    """Pictures, each different to the detector and its cache."""
    json: bool = False
    """Print one JSON object."""

    def run(self) -> int:
        from pipeline.answering.endurance import run_endurance
        from spatialviz.printing import rate_bar
        from spatialviz.printing_models import print_endurance

        if self.count < 1:
            raise InputError("--count must be at least 1", got=self.count)
        source, frame_ids = self.source.open(self.dataset)
        with rate_bar("detecting", "frames") as advance:
            report = run_endurance(source, frame_ids, self.count, advance)
        if self.json:
            print_json(report.record())
        else:
            print_endurance(report)
        return FINE
