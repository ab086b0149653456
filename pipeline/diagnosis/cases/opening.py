"""A case read back: a source that answers from what is in the folder, and nothing else."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from pipeline.answering.objects import PreparedFrame
from pipeline.answering.opening import Pipeline
from pipeline.datasets.saved_case import MANIFEST, SavedCaseDataset, checked_file, read_manifest
from pipeline.datasets.settings import Settings
from pipeline.diagnosis.answer import Answer
from pipeline.diagnosis.asking import answer
from pipeline.diagnosis.cases.kept_proposals import KeptDetector, read_proposals
from pipeline.diagnosis.cases.manifest import NETWORK, PROPOSALS, Expected, Manifest, checked_manifest, read_truth
from pipeline.labels.cases import Case, FrameCases
from pipeline.language.naming import Synonyms
from pipeline.proposals import make_detector
from pipeline.relations import RelationScorer, make_scorer, shipped_network
from pipeline.system.errors import InputError


@dataclass(frozen=True)
class OpenedCase:
    """A case that is ready to be answered.

    Attributes
    ----------
    root : Path
    manifest : Manifest
    table : dict
        The manifest as it stands in the file.
    expected : Expected
    source : Pipeline
    truth : FrameCases or None
    case : Case or None
    mark : str or None
    confidence : float or None
    notes : tuple of str
        What is not as it was when the case was written, such as another shipped network.
    """

    root: Path
    manifest: Manifest
    table: dict[str, Any]
    expected: Expected
    source: Pipeline
    truth: FrameCases | None
    case: Case | None
    mark: str | None
    confidence: float | None
    notes: tuple[str, ...]

    @cached_property
    def context(self) -> PreparedFrame:
        """The frame, ready for questions."""
        return PreparedFrame(self.source.dataset.load(self.manifest.frame.id), self.source.config.lift)

    def answer(self) -> Answer:
        """Answer and judge now."""
        return answer(
            self.source, self.context, self.manifest.text, truth=self.truth, case=self.case, mark=self.mark,
            confidence=self.confidence, edits=self.manifest.edits,
        )  # fmt: skip

    def with_detector(self, name: str, model: Path | None, min_score: float | None = None) -> OpenedCase:
        """The same case with a detector that looks at the picture now; "live" is the one it was made with.

        Raises
        ------
        InputError
            No such detector, or it needs a model.
        """
        name = self.manifest.detector.name if name == "live" else name
        if "+" in name or "&" in name:
            what = "a detector with a segmenter" if "+" in name else "fused detectors"
            raise InputError(f"{what} cannot be run again live", got=name, path=self.root)
        made = {
            least: make_detector(
                name, model=model, class_names=self.manifest.class_names, synonyms=self.source.synonyms, min_score=least
            )
            for least in (min_score, 0.0)
        }
        same = hashlib.sha256(made[min_score].fingerprint().encode()).hexdigest()
        note = () if same == self.manifest.detector.fingerprint_sha256 else (f"{name} is not set as it was",)
        source = replace(self.source, detector=made[min_score], open_unfiltered=lambda: made[0.0])
        return replace(self, source=source, notes=(*self.notes, *note))


def open_case(
    root: str | Path,
    *,
    srm: str | Path | None = None,
    vectors: Path | None = None,
    scorer: RelationScorer | None = None,
) -> OpenedCase:
    """Read a case. Only files of its own folder are read, and the network that comes with the program.

    Parameters
    ----------
    root : str or Path
    srm : str or Path, optional
        Another relation scorer than the case's, as `pipeline.relations.make_scorer` takes it.
    vectors : Path, optional
        Text vectors of a language network.
    scorer : RelationScorer, optional
        The scorer itself, where it is at hand.

    Raises
    ------
    InputError
        A damaged case, or one whose relation network is neither in it nor given.
    """
    root = Path(root)
    if not (root / MANIFEST).is_file():
        raise InputError("this is no saved case", expected=f"a folder with {MANIFEST}", path=root)
    table = read_manifest(root)
    manifest, expected = checked_manifest(root, table)
    proposals = checked_file(root, table, PROPOSALS)
    for file in manifest.files:
        checked_file(root, table, file)
    kept, mark_of_file = read_proposals(proposals)
    d = manifest.detector
    detector = KeptDetector(d.name, d.exact, d.vocabulary, kept, proposals, mark_of_file)
    notes: tuple[str, ...] = ()
    if scorer is None:
        scorer, notes = _scorer(root, manifest, srm, vectors)
    truth = case = mark = confidence = None
    if manifest.truth is not None:
        truth, case, mark, confidence = read_truth(manifest.truth, manifest.frame.id, root / MANIFEST)
    synonyms = None
    if manifest.synonyms is not None:
        synonyms = Synonyms(
            tuple(frozenset(g) for g in manifest.synonyms.groups), frozenset(manifest.synonyms.exceptions)
        )
    source = Pipeline(
        SavedCaseDataset(root, Settings()), detector, scorer, manifest.config, synonyms,
        lambda: replace(detector, everything=True, _answers={}),
    )  # fmt: skip
    return OpenedCase(root, manifest, table, expected, source, truth, case, mark, confidence, notes)


def _scorer(
    root: Path, manifest: Manifest, srm: str | Path | None, vectors: Path | None
) -> tuple[RelationScorer, tuple[str, ...]]:
    record = manifest.scorer
    if srm is not None:
        made = make_scorer(srm, vectors)
        path = getattr(made, "path", None)
        same = record.kind == "rule" if path is None else _sha256(path) == record.sha256
        return made, () if same else (f"relations are scored by {Path(srm).name}, not by the case's {record.name}",)
    if record.kind == "rule":
        return make_scorer("rule"), ()
    if record.in_case:
        return make_scorer(checked_file(root, {"files": manifest.files}, NETWORK), vectors), ()
    if record.kind == "trained":
        same = _sha256(shipped_network()) == record.sha256
        note = "the network that comes with the program is another than when the case was saved"
        return make_scorer("trained", vectors), () if same else (note,)
    raise InputError(
        f"the relation network {record.file!r} is not in the case", expected="--srm FILE",
        cause=f"its sha256 begins with {(record.sha256 or '')[:12]}", path=root,
    )  # fmt: skip


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
