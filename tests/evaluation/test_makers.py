"""Who made labels, what a measured system shares with that, and where it is said."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from journal_world import FRAME, an_expression, saved

from pipeline.answering import open_pipeline, record_detections
from pipeline.corrections import Corrector, FieldRef, Journal, effective_tables
from pipeline.corrections.journal import edits
from pipeline.evaluation import (
    AGREEMENT,
    PERFECT,
    EvalSpec,
    RelationSpec,
    RunReport,
    evaluate_dataset,
    open_run,
    scorer_share,
    shares_of_run,
    title_of,
)
from pipeline.evaluation.leakage import CHECKED, HAD_A_PART, REPEATED, SIMULATED, Measured, leakage, rank
from pipeline.evaluation.relation_cases import open_systems
from pipeline.labels import (
    MANIFEST_FILE,
    NONE,
    Labels,
    Makers,
    Model,
    SourceSpec,
    label_dataset,
    makers_of,
    mask_makers,
    open_labels,
)
from pipeline.labels.provenance import Decided
from pipeline.metrics import BootstrapConfig, Row, Table, as_csv, in_blocks, latex, markdown
from pipeline.relations import PROFILE, T

QUICK = BootstrapConfig(resamples=50)
A, B = "0123456789abcdef0123456789abcdef", "fedcba9876543210fedcba9876543210"
YOLO, OTHER = f"yolo-seg: yolo-seg:{A}:0.15:names", f"yolo-seg: yolo-seg:{B}:0.15:names"
TITLES = {
    # (what made the labels, what is measured): what its figures are
    (YOLO, YOLO): REPEATED,
    (YOLO, f"yolo-seg: yolo-seg:{A}:0.6:other"): REPEATED,
    (YOLO, f"recorded: recorded:/x/y.json:17:0.0<{YOLO}"): REPEATED,
    (f"recorded+depth: recorded:/x/y.json:17:0.0<{YOLO}|depth:1", YOLO): REPEATED,
    (f"yolo-seg+depth: yolo-seg:{A}:0.15:names|depth:1", YOLO): REPEATED,
    (YOLO, f"yolo-seg&detic: ensemble:wbf:yolo-seg:{A}:0.15:n&detic:2:{B}:0.1:n:n"): HAD_A_PART,
    (YOLO, OTHER): "",
    (YOLO, f"owlv2: owlv2:{A}:{B}:0.1:x:y:z:3"): "",
    (f"sam: sam:1:{A}:{B}", YOLO): "",
    (YOLO, "recorded: recorded:/x/y.json:17:0.0"): "",
    ("annotations: annotations", "annotations: annotations"): PERFECT,
    ("annotations+depth: annotations|depth:1", "annotations: annotations"): PERFECT,
    ("annotations: annotations", "simulated: simulated:77"): SIMULATED,
    ("simulated: simulated:78", "simulated: simulated:77"): SIMULATED,
    ("simulated: simulated:77", "simulated: simulated:77"): REPEATED,
    ("annotations: annotations", YOLO): "",
    ("", YOLO): "",
}


def made(said: str, decided: Decided | None = None) -> Makers:
    return Makers(mask_makers(said), "0.1.0:x", PROFILE, "h", NONE, NONE, decided is not None, decided)


@pytest.mark.parametrize(("truth", "measured"), TITLES)
def test_the_same_model_is_told_whatever_its_thresholds(truth: str, measured: str) -> None:
    shares = leakage(made(truth), Measured(mask_makers(measured), "net", A))
    assert title_of(shares) == TITLES[truth, measured]
    assert shares, "something is always to be said"
    unknown = truth == "" or (measured.startswith("recorded") and "<" not in measured)
    assert (shares[0].kind == "unknown maker") == unknown


@given(st.text(max_size=60) | st.sampled_from(sorted({said for pair in TITLES for said in pair})).map(lambda s: s[:-3]))
def test_no_name_of_a_detector_is_too_odd(said: str) -> None:
    found = mask_makers(said)
    assert found is None or found.detectors
    assert title_of(leakage(made(said), Measured(found, None))) in ("", REPEATED, PERFECT, SIMULATED)


def test_what_people_decided_is_theirs() -> None:
    measured = Measured(mask_makers(YOLO), "net", A)
    some = leakage(made(YOLO, Decided((3, 9), (0, 40), (0, 5))), measured)
    assert title_of(some) == REPEATED
    assert "but for 3 of 9 objects that people decided" in some[0].text
    every = leakage(made(YOLO, Decided((9, 9), (0, 40), (0, 5))), measured)
    assert title_of(every) == CHECKED
    assert rank(CHECKED) < rank(REPEATED), "it says more, and stands above"


def test_the_network_that_had_a_vote_is_known_by_its_file() -> None:
    voted = replace(made(OTHER), second_opinion=A, second_opinion_name="trained")
    kinds = {net: {s.kind for s in leakage(voted, Measured(mask_makers(YOLO), "trained", net))} for net in (A, B, None)}
    assert "second opinion" in kinds[A]
    assert "second opinion" not in kinds[B], "another network under the same name"
    assert "second opinion" in kinds[None], "an old run says only the name"
    rule = leakage(voted, Measured(mask_makers(YOLO), "rule"))
    assert rule[0].kind == "same rule"
    published = replace(voted, rule="semantic-abstraction-published")
    assert "same rule" not in {s.kind for s in leakage(published, Measured(mask_makers(YOLO), "rule"))}


def test_rows_that_share_stand_below() -> None:
    rows = in_blocks([Row("x", (1,), shares="b"), Row("y", (2,)), Row("z", (3,), shares="a")], ["a", "b"])
    assert [row.name for row in rows] == ["y", "z", "x"]
    table = Table("t", "T", ("n",), rows, "note", ("masks: why | 5 %",))
    lines = markdown([table]).splitlines()
    assert lines[4:9] == ["| y | 2 |", "| *a* |  |", "| z | 3 |", "| *b* |  |", "| x | 1 |"]
    assert "- masks: why | 5 %" in lines
    assert [line.split(",")[-1] for line in as_csv(table).splitlines()] == ["shares", "", "a", "b"]
    assert r"\multicolumn{2}{l}{\emph{a}}" in latex([table])
    assert r"masks: why | 5 \%" in latex([table])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording that says who made it, a copy by another detector, and labels made of each and of annotations."""
    out = tmp_path_factory.mktemp("makers")
    source = open_pipeline("demo", detector="annotations")
    record_detections(source, out / "own.json", None, frame_ids=source.dataset.frame_ids[:2])
    text = (out / "own.json").read_text()
    (out / "own.json").write_text(text.replace("annotations: annotations", YOLO))
    (out / "other.json").write_text(text.replace("annotations: annotations", OTHER))
    record_detections(source, out / "folder", None, frame_ids=source.dataset.frame_ids[:2])
    label_dataset(SourceSpec("demo", {"detector": "recorded", "model": str(out / "own.json")}), out / "labels", limit=2)
    return out


def evaluated(folder: Path, out: Path, model: str, plots: bool = False) -> RunReport:
    options = {"detector": "recorded", "model": folder / model}
    how = RelationSpec(others=("rule",), frames=1)
    spec = EvalSpec("demo", str(folder / "labels"), options, relations=how, limit=20)
    return evaluate_dataset(spec, out, plots=plots, bootstrap=QUICK)


@pytest.mark.slow
def test_a_run_says_that_it_graded_itself(folder: Path, tmp_path: Path) -> None:
    report = evaluated(folder, tmp_path / "run", "own.json")
    manifest = json.loads((tmp_path / "run" / "run.json").read_text())
    assert manifest["shares"][0]["kind"] == "same detector"
    assert manifest["shares"][0]["title"] == REPEATED
    assert manifest["makers"]["masks"]["detectors"] == [{"name": "yolo-seg", "content": A}]
    assert manifest["measured"]["masks"] == manifest["makers"]["masks"]
    text = (tmp_path / "run" / "tables.md").read_text()
    titles = [line for line in text.splitlines() if line.startswith("## ")]
    assert all(REPEATED in t or AGREEMENT in t for t in titles), titles
    assert all(REPEATED in line for line in (tmp_path / "run" / "slices.md").read_text().splitlines() if "## " in line)
    grounding, relations = (next(t for t in report.tables if t.key == key) for key in ("grounding", "srm"))
    assert {row.shares for row in grounding.rows if row.source == "measured"} == {REPEATED}
    network, rule = (row.name for row in relations.rows if row.shares)
    assert network.startswith("trained, ")
    assert rule == "rule"
    assert not relations.rows[0].shares
    assert set(manifest["relations"]["shares"]) == {network, rule}
    # Another maker's truth: nothing of that, and the rows of the rule are agreement all the same.
    report = evaluated(folder, tmp_path / "other", "other.json")
    assert not title_of(report.shares)
    assert {row.shares for row in report.tables[0].rows} == {""}
    assert report.tables[0].title == "Grounding"
    assert AGREEMENT in next(t.title for t in report.tables if t.key == "srm")


@pytest.mark.slow
def test_every_picture_of_a_run_that_graded_itself_says_so(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    figures = pytest.importorskip("matplotlib.figure", reason="the extra report is not installed")
    said: dict[str, str] = {}

    def keep(figure: Any, path: Path, **_: Any) -> None:
        texts = [*figure.texts, *(t for a in figure.axes for t in (a.title, a._left_title))]
        if isinstance(path, Path):
            said[path.name] = " ".join(" ".join(t.get_text().split()) for t in texts)

    monkeypatch.setattr(figures.Figure, "savefig", keep)
    evaluated(folder, tmp_path / "own", "own.json", plots=True)
    assert set(said) == {"relations.png", "verdicts.png", "oracles.png", "srm_relations.png"}
    wanted = {name: AGREEMENT if name.startswith("srm_") else REPEATED for name in said}
    assert not {name: text for name, text in said.items() if wanted[name][1:] not in text}
    said.clear()
    evaluated(folder, tmp_path / "other", "other.json", plots=True)
    assert said
    assert not [name for name, text in said.items() if REPEATED[1:] in text]


def test_old_runs_and_labels_say_what_can_be_known(folder: Path, tmp_path: Path) -> None:
    evaluated(folder, tmp_path / "run", "own.json")
    fresh = open_run(tmp_path / "run").shares
    path = tmp_path / "run" / "run.json"
    manifest = json.loads(path.read_text())
    for damage in ({"shares": [{"about": 3}]}, {"shares": None}, {}):
        old = {k: v for k, v in manifest.items() if k not in ("shares", "makers", "measured")} | damage
        path.write_text(json.dumps(old))
        assert [s.title for s in open_run(tmp_path / "run").shares] == [s.title for s in fresh]
    (gone,) = shares_of_run(old, tmp_path / "nowhere")
    assert gone.kind == "unknown maker"
    labels = tmp_path / "labels"
    shutil.copytree(folder / "labels", labels)
    content = json.loads((labels / MANIFEST_FILE).read_text())
    assert content.pop("makers") == makers_of(open_labels(labels).manifest).record()
    content |= {"schema_version": "1.0.0", "models": {}, "config": {"relations": content["config"]["relations"]}}
    (labels / MANIFEST_FILE).write_text(json.dumps(content))
    found = makers_of(open_labels(labels).manifest)
    assert (found.masks, found.second_opinion) == (None, None)
    assert found.lines()["masks"] == "unknown"


def test_makers_of_the_demo(demo_labels: Labels) -> None:
    makers = makers_of(demo_labels.manifest)
    assert makers.annotated
    assert makers.masks is not None
    assert makers.masks.detectors == (Model("annotations"),)
    spec = RelationSpec(others=("rule",))
    assert all(scorer_share(makers, s.name, s.scorer) is not None for s in open_systems({}, spec, demo_labels))
    silent = demo_labels.manifest.model_copy(update={"models": {**demo_labels.manifest.models, "second_opinion": NONE}})
    own, rule = open_systems({}, spec, demo_labels)
    assert scorer_share(makers_of(silent), own.name, own.scorer) is None
    assert scorer_share(makers_of(silent), rule.name, rule.scorer) is not None


def test_what_people_decided_is_counted(demo_labels: Labels, bare_corrector: Corrector, journal: Journal) -> None:
    frame = bare_corrector.frame(FRAME, journal)
    row = an_expression(frame)
    a, b, relation = row["target_object"], row["reference_object"], row["relation"]
    assert set(effective_tables(demo_labels, journal).decided) == {"objects", "relations", "expressions"}
    assert [n for n, _ in effective_tables(demo_labels, journal).decided.values()] == [0, 0, 0]
    saved(journal, edits.set_class(frame, a, "thing"))
    saved(journal, edits.set_status(frame, FieldRef("object", FRAME, str(a), "status"), "accepted"))
    saved(journal, edits.set_status(frame, FieldRef("object", FRAME, str(b), "status"), "unsure"))
    saved(journal, edits.judge_relation(bare_corrector.frame(FRAME, journal), a, b, relation, T, "ann"))
    found = effective_tables(demo_labels, journal)
    counted = found.decided
    # The class and the status are of one object; who is unsure has not decided.
    assert counted["objects"] == (1, found.objects.num_rows)
    assert counted["relations"][1] == found.relations.num_rows * len(found.relation_names)
    assert counted["relations"][0] == 2, "of both ways"
