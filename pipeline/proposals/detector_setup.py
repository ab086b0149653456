"""What a detector is made from, so that another process makes the same one."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from pipeline.language.naming import Synonyms
from pipeline.proposals.base import Detector
from pipeline.proposals.ensemble import fused_detector
from pipeline.proposals.registry import make_detector, named_model
from pipeline.proposals.segmenter import Segmented


@dataclass(frozen=True)
class DetectorSetup:
    """A detector by name with its files and thresholds; picklable, which a detector need not be.

    Attributes
    ----------
    name : str
        As of `make_detector`.
    model, config : Path or None
        As of `make_detector`.
    min_score : float or None
        Of every detector in it; None for their own defaults.
    synonyms : Path or None
        A JSON file with more synonyms.
    fuse : tuple of str
        Further detectors, "NAME" or "NAME=MODEL", that are fused with it.
    fusion : str
        "wbf" or "nms".
    """

    name: str
    model: Path | None = None
    config: Path | None = None
    min_score: float | None = None
    synonyms: Path | None = None
    fuse: tuple[str, ...] = ()
    fusion: str = "wbf"

    @classmethod
    def named(cls, text: str, min_score: float | None = None, synonyms: Path | None = None) -> DetectorSetup:
        """Of "NAME" or "NAME=MODEL"; raises as `named_model`."""
        name, model = named_model(text)
        return cls(name, model, min_score=min_score, synonyms=synonyms)

    def with_min_score(self, min_score: float | None) -> DetectorSetup:
        """The same with another minimum score."""
        return replace(self, min_score=min_score)

    def open(self, class_names: tuple[str, ...], table: Synonyms | None = None) -> Detector:
        """Make the detector.

        Parameters
        ----------
        class_names : tuple of str
            Of the dataset.
        table : Synonyms, optional
            Where the file is read already.

        Raises
        ------
        InputError
            As `make_detector` and `EnsembleDetector`, and where the synonyms cannot be read.
        """
        table = table or Synonyms.load(self.synonyms)

        def make(name: str, model: Path | None, config: Path | None = None) -> Detector:
            return make_detector(
                name, model=model, class_names=class_names, synonyms=table, min_score=self.min_score, config=config
            )

        others = [make(*named_model(text)) for text in self.fuse]
        first = make(self.name, self.model, self.config)
        found = fused_detector(first, others, self.fusion, table)
        assert found is not None
        return found


def made_by(said: str | None, detector: Detector) -> bool:
    """Whether a detector is the one that labels or a run name as theirs; the segmenter of either does not count.

    Parameters
    ----------
    said : str or None
        "name: fingerprint", with the segmenter's behind "+" and "|": `models["detector"]` of a manifest.
    detector : Detector
    """
    own = detector.detector if isinstance(detector, Segmented) else detector
    name, fingerprint = own.name, own.fingerprint()
    said = said or ""
    return said == f"{name}: {fingerprint}" or (said.startswith(f"{name}+") and f": {fingerprint}|" in said)
