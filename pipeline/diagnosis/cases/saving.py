"""Case written and read back: a small folder with everything behind its answer, and nothing else."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from dataclasses import asdict, replace
from datetime import datetime, timezone
from functools import cached_property
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from pipeline.answering.imported import ImportedPipeline, config_of
from pipeline.answering.objects import PreparedFrame
from pipeline.answering.pair_rules import RunRules
from pipeline.answering.pipeline import Pipeline
from pipeline.answering.predictions import Predictions, read_predictions
from pipeline.datasets.saved_case import (
    CASE_FORMAT,
    MANIFEST,
    SavedCaseDataset,
    checked_file,
    read_manifest,
    saved_frame,
)
from pipeline.datasets.settings import Settings
from pipeline.diagnosis.answer import Answer, Edited, answer_record
from pipeline.diagnosis.asking import answer
from pipeline.diagnosis.cases.kept import (
    KeptDetector,
    imported_source,
    keep_predictions,
    keep_proposals,
    read_proposals,
)
from pipeline.diagnosis.cases.manifest import (
    NETWORK,
    PREDICTIONS,
    PROPOSALS,
    CaseManifest,
    ExpectedRecord,
    ScorerRecord,
    checked_expected,
    checked_manifest,
    config_record,
    read_truth,
    truth_record,
)
from pipeline.diagnosis.not_seen import SceneMaps, answer_unseen
from pipeline.labels.cases import Case, FrameCases
from pipeline.language.expression import parse
from pipeline.language.naming import default_synonyms
from pipeline.language.tree import Query
from pipeline.proposals.registry import open_detector
from pipeline.relations import RelationScorer, RuleScorer, make_scorer, shipped_network
from pipeline.relations.scorer import SuppliedRelations
from pipeline.system.detector_setup import DetectorSetup
from pipeline.system.errors import InputError, as_input_error, needed, require
from pipeline.system.frozen import dataclass
from pipeline.system.safe_files import read_bytes
from pipeline.system.version import __version__
from pipeline.system.whole_files import sha256_of, temporary_folder, write_synced, write_whole


def save_case(
    folder: str | Path,
    pipeline: Pipeline,
    context: PreparedFrame,
    text: str,
    *,
    truth: FrameCases | None = None,
    case: Case | None = None,
    mark: str | None = None,
    confidence: float | None = None,
    maps: SceneMaps | None = None,
    edits: Edited | None = None,
    run: Mapping[str, Any] | None = None,
    name: str | None = None,
    expected: Mapping[str, Any] | None = None,
) -> Answer:
    """Write a case, and run it once from its folder to check the answer.

    Parameters
    ----------
    folder : str or Path
        Must not exist, or be empty.
    pipeline : Pipeline
        What answers; its detector is asked once more, without its minimum score too.
    text : str
        The expression.
    truth : FrameCases, optional
        What is true of the frame; without it there is no verdict.
    case, mark, confidence
        As for `pipeline.diagnosis.asking.judge_trace`.
    maps : SceneMaps, optional
        Object maps of the frame's scene, by which the verdict may be NOT-SEEN.
    edits : mapping, optional
        Edits as JSON (`pipeline.diagnosis.whatif.edits_record`).
    run : mapping, optional
        Where the case comes from, for people: plain JSON.
    name : str, optional
        Its title; the expression and the frame by default.
    expected : mapping, optional
        The answer that a replay is compared with, as `answer_record` gives it; by default the answer now.

    Returns
    -------
    Answer
        The answer now.

    Raises
    ------
    InputError
        No detector, a folder that is in use, edits that cannot be applied, or a pipeline whose answer does not come
        back from what it gave; nothing is written then.
    """
    folder = Path(folder)
    require(
        not (folder.exists() and not (folder.is_dir() and not any(folder.iterdir()))),
        "the folder for the case is not empty",
        expected="a new one",
        path=folder,
    )
    now = answer(pipeline, context, text, truth=truth, case=case, mark=mark, confidence=confidence, edits=edits)
    now = now if maps is None else maps.answered(now)
    frame, files = saved_frame(context.frame)
    shown, made_relations = None, pipeline.scorer
    if isinstance(pipeline, ImportedPipeline):
        files[PREDICTIONS], shown = keep_predictions(pipeline, context.frame.id)
        made_relations = pipeline.scorer if shown.relations is not None else pipeline.stand_in
    else:
        files[PROPOSALS] = _json(_proposals(pipeline, context, now, case)).encode()
    scorer, network = _scorer_record(made_relations)
    if network is not None:
        files[NETWORK] = network
    judged = now.diagnosis
    known = None if judged is None else truth_record(judged.truth, judged.case, mark, confidence)
    unseen = now.unseen if judged is None else judged.unseen
    record = answer_record(now)
    detector = pipeline.needed_detector()
    reading = None if pipeline.reader is parse else TypeAdapter(Query).dump_python(pipeline.read(text), mode="json")
    manifest = {
        "format": CASE_FORMAT,
        "name": name or f"{text} in {context.frame.id}",
        "tool": f"spatialviz {__version__}",
        # The day alone: the same answer that is kept again is the same file.
        "created": datetime.now(timezone.utc).date().isoformat(),
        "files": {file: hashlib.sha256(data).hexdigest() for file, data in files.items()},
        "text": text,
        **({} if reading is None else {"reading": reading}),
        "frame": frame.model_dump(mode="json", exclude=set() if frame.depth_source else {"depth_source"}),
        "dataset": {"format": pipeline.dataset.format, "name": pipeline.dataset.root.resolve().name},
        "class_names": list(pipeline.dataset.class_names),
        "synonyms": None
        if pipeline.synonyms is None or pipeline.synonyms == default_synonyms()
        else pipeline.synonyms.record(),
        "detector": {
            "name": detector.name,
            "exact": detector.exact,
            "vocabulary": None if shown is not None else detector.vocabulary,
            "fingerprint_sha256": hashlib.sha256(detector.fingerprint().encode()).hexdigest(),
        },
        "scorer": scorer.model_dump(mode="json"),
        **({} if shown is None else {"shown": shown.model_dump(mode="json")}),
        "config": config_record(pipeline.config),
        "truth": known,
        **({} if unseen is None else {"unseen": asdict(unseen)}),
        "edits": dict(edits) if edits else None,
        "run": dict(run or {}),
        "expected": record if expected is None else dict(expected),
    }
    checked_expected(manifest["expected"], folder / MANIFEST)
    with as_input_error("the case cannot be written as JSON", TypeError, ValueError, got=str):
        files[MANIFEST] = _json(manifest).encode()
    _write_whole(folder, files, pipeline, record)
    return now


def _write_whole(folder: Path, files: dict[str, bytes], pipeline: Pipeline, record: dict[str, Any]) -> None:
    """Write beside the folder, replay, and rename."""
    with (
        as_input_error("the case cannot be written", OSError, got=lambda error: error.strerror, path=folder),
        temporary_folder(folder) as partial,
    ):
        for file, data in files.items():
            write_synced(partial / file, data)
        opened = open_case(partial, scorer=None if pipeline.predictions is not None else pipeline.scorer)
        again = answer_record(opened.answer())
        if again != record:
            require(
                "proposals" in record, "an expression that cannot be asked cannot be kept", got=record.get("reason")
            )
            which = next((k for k in record if record[k] != again.get(k)), "a part")
            raise InputError(
                "the answer does not come back from what was kept",
                got=f"another {which}",
                cause="does the detector or the scorer look at more than the frame?",
                path=folder,
            )
        if folder.exists():
            folder.rmdir()
        os.replace(partial, folder)


def _proposals(pipeline: Pipeline, context: PreparedFrame, now: Answer, case: Case | None) -> dict[str, Any]:
    query = None if now.trace is None else now.trace.query
    # A detector of its own names only is asked for the noun of "blue book".
    names = [] if query is None else [label if phrase is None else phrase for label, phrase in query.asked]
    if query is not None and query.unused:
        # What the detector refused was left out of the question, and is refused again where it is replayed.
        names += pipeline.read(query.text).labels
    case = now.diagnosis.case if now.diagnosis is not None else case
    if case is not None:
        names += filter(None, (case.target, case.reference))
    return keep_proposals(context.frame, pipeline.needed_detector(), pipeline.unfiltered_detector(), names)


def _json(record: dict[str, Any]) -> str:
    return json.dumps(record, ensure_ascii=False, allow_nan=False, indent=1) + "\n"


def _scorer_record(scorer: RelationScorer) -> tuple[ScorerRecord, bytes | None]:
    """Record of the relation scorer, and the file of a network that does not come with the program."""
    if isinstance(scorer, SuppliedRelations):
        return ScorerRecord(kind="imported", name=scorer.name), None
    if isinstance(scorer, RuleScorer):
        return ScorerRecord(kind="rule", name=scorer.name), None
    path = getattr(scorer, "path", None)
    if not isinstance(path, Path):
        raise InputError("the relation scorer has no file to be known by", got=scorer.name)
    data, shipped = read_bytes(path, "model"), path.resolve() == shipped_network().resolve()
    record = ScorerRecord(
        kind="trained" if shipped else "file",
        name=scorer.name,
        file=path.name,
        sha256=hashlib.sha256(data).hexdigest(),
        in_case=not shipped,
    )
    return record, None if shipped else data


@dataclass(frozen=True)
class OpenedCase:
    """Case ready to be answered."""

    root: Path
    manifest: CaseManifest
    table: dict[str, Any]  # The manifest as it stands in the file
    expected: ExpectedRecord
    source: Pipeline
    truth: FrameCases | None
    case: Case | None
    mark: str | None
    confidence: float | None
    notes: tuple[str, ...]  # What is not as it was when the case was written, such as another shipped network

    @cached_property
    def context(self) -> PreparedFrame:
        """The frame, ready for questions."""
        return PreparedFrame(self.source.dataset.load(self.manifest.frame.id), self.source.config.lift)

    def answer(self) -> Answer:
        """Answer and judge now."""
        found = answer(
            self.source,
            self.context,
            self.manifest.text,
            truth=self.truth,
            case=self.case,
            mark=self.mark,
            confidence=self.confidence,
            edits=self.manifest.edits,
        )
        return answer_unseen(found, self.manifest.unseen)

    def expect(self, record: dict[str, Any]) -> None:
        """Put another expected answer into the manifest, whole or not at all."""
        write_whole(self.root / MANIFEST, _json({**self.table, "expected": record}).encode(), "the case")

    def with_detector(self, name: str, model: Path | None, min_score: float | None = None) -> OpenedCase:
        """Case with a live detector; "live" names the original one."""
        require(
            self.manifest.shown is None,
            "what another pipeline gave cannot be looked at again here",
            expected="--predictions FILE, what it gives now",
            path=self.root,
        )
        name = self.manifest.detector.name if name == "live" else name
        if "+" in name or "&" in name:
            what = "a detector with a segmenter" if "+" in name else "fused detectors"
            raise InputError(f"{what} cannot be run again live", got=name, path=self.root)
        made = {
            least: open_detector(
                DetectorSetup(name, model, min_score=least), self.manifest.class_names, self.source.synonyms
            )
            for least in (min_score, 0.0)
        }
        same = hashlib.sha256(made[min_score].fingerprint().encode()).hexdigest()
        note = () if same == self.manifest.detector.fingerprint_sha256 else (f"{name} is not set as it was",)
        pipeline = replace(self.source, detector=made[min_score], open_unfiltered=lambda: made[0.0])
        return replace(self, source=pipeline, notes=(*self.notes, *note))

    def with_predictions(self, predictions: Predictions, rules: RunRules | None = None) -> OpenedCase:
        """Case answered by another pipeline, possibly a later version of its own."""
        own, shown = self.source, self.manifest.shown
        scorer = RuleScorer() if shown is None else shown.scorer(predictions, own.dataset)
        pipeline = imported_source(predictions, own.dataset, scorer, config_of(predictions), own.synonyms, rules)
        return replace(self, source=pipeline, notes=())


def open_case(
    root: str | Path,
    *,
    srm: str | Path | None = None,
    vectors: Path | None = None,
    scorer: RelationScorer | None = None,
) -> OpenedCase:
    """Read a case, from its own folder and the shipped network alone.

    Parameters
    ----------
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
    require((root / MANIFEST).is_file(), "this is no saved case", expected=f"a folder with {MANIFEST}", path=root)
    table = read_manifest(root)
    manifest, expected = checked_manifest(root, table)
    for file in manifest.files:
        checked_file(root, table, file)
    notes: tuple[str, ...] = ()
    if scorer is None and manifest.scorer.kind != "imported":
        scorer, notes = _scorer(root, manifest, srm, vectors)
    truth = case = mark = confidence = None
    if manifest.truth is not None:
        truth, case, mark, confidence = read_truth(manifest.truth, manifest.frame.id, root / MANIFEST)
    make = _own_source if manifest.shown is None else _imported_source
    pipeline = make(root, table, manifest, scorer)
    return OpenedCase(root, manifest, table, expected, pipeline, truth, case, mark, confidence, notes)


def _imported_source(
    root: Path, table: dict[str, Any], manifest: CaseManifest, scorer: RelationScorer | None
) -> ImportedPipeline:
    shown, dataset = manifest.shown, SavedCaseDataset(root, Settings())
    assert shown is not None
    read = replace(read_predictions(checked_file(root, table, PREDICTIONS)), least=shown.level)
    scorer = scorer or shown.scorer(read, dataset)
    return imported_source(read, dataset, scorer, manifest.config, manifest.synonyms, shown.rules)


def _own_source(root: Path, table: dict[str, Any], manifest: CaseManifest, scorer: RelationScorer | None) -> Pipeline:
    proposals = checked_file(root, table, PROPOSALS)
    kept, mark_of_file = read_proposals(proposals)
    d = manifest.detector
    detector = KeptDetector(d.name, d.exact, d.vocabulary, kept, proposals, mark_of_file)

    def read(text: str, **options: Any) -> Query:
        """Read an expression as when the case was kept; other texts by the grammar."""
        kept = manifest.reading
        return kept if kept is not None and text == kept.text else parse(text, **options)

    scorer = needed(scorer, "the case is damaged at shown", path=root)
    return Pipeline(
        SavedCaseDataset(root, Settings()),
        detector,
        scorer,
        manifest.config,
        manifest.synonyms,
        lambda: replace(detector, everything=True, _answers={}),
        reader=read if manifest.reading else parse,
    )


def _scorer(
    root: Path, manifest: CaseManifest, srm: str | Path | None, vectors: Path | None
) -> tuple[RelationScorer, tuple[str, ...]]:
    record = manifest.scorer
    if srm is not None:
        made = make_scorer(srm, vectors)
        path = getattr(made, "path", None)
        same = record.kind == "rule" if path is None else sha256_of(path) == record.sha256
        return made, () if same else (f"relations are scored by {Path(srm).name}, not by the case's {record.name}",)
    if record.kind == "rule":
        return make_scorer("rule"), ()
    if record.in_case:
        return make_scorer(checked_file(root, {"files": manifest.files}, NETWORK), vectors), ()
    if record.kind == "trained":
        same = sha256_of(shipped_network()) == record.sha256
        note = "the network that comes with the program is another than when the case was saved"
        return make_scorer("trained", vectors), () if same else (note,)
    raise InputError(
        f"the relation network {record.file!r} is not in the case",
        expected="--srm FILE",
        cause=f"its sha256 begins with {(record.sha256 or '')[:12]}",
        path=root,
    )
