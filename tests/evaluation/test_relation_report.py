"""Relations alone: the tables follow from the recorded rows, and say what was learnt from them."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from label_worlds import label_worlds
from needs import needs

from pipeline.evaluation import AGREEMENT, EvalSpec, RelationSpec, RunReport, evaluate_dataset
from pipeline.evaluation.relation_records import read_relation_records
from pipeline.evaluation.relation_report import BY_RELATION, MEASURES, all_systems, counted_pairs
from pipeline.labels import MANIFEST_FILE, Labels
from pipeline.language import DIRECTIONAL, PHRASE, VOCABULARIES
from pipeline.metrics import DROPPED, VALIDATION, BootstrapConfig, Estimate, Row, markdown
from pipeline.paper import Vlm
from pipeline.relations import OnnxScorer
from pipeline.system import InputError
from pipeline.training import LabelTraining, TrainConfig, train_on_labels

pytestmark = needs("torch", "onnx")


QUICK = BootstrapConfig(resamples=100)
FAST = TrainConfig(hidden=16, epochs=2, batch=256)


@pytest.fixture(scope="module")
def networks(label_sets: dict[str, Labels], tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Hardly trained networks of the demo's labels: of 2D boxes, with language, and one that chooses a relation."""
    folder = tmp_path_factory.mktemp("networks")
    demo = label_sets["demo"]
    names = demo.objects.column("label").unique().to_pylist()
    words = sorted({w for n in names for w in n.lower().replace("_", " ").split()})
    vectors = np.random.default_rng(0).normal(size=(len(words), 4)).astype(np.float32)
    np.savez(folder / "words.npz", words=np.array(words), vectors=vectors, kind=np.str_("word"))
    variants = {
        "flat": replace(FAST, features="geom2d8"),
        "worded": replace(FAST, features="paper30+lang"),
        "choosing": replace(FAST, vocabulary="semantic-abstraction"),
    }
    for name, config in variants.items():
        lang = config.features.endswith("+lang")
        job = LabelTraining(demo.root, config, vectors=folder / "words.npz" if lang else None, pairs=2000)
        train_on_labels(job, folder / f"{name}.onnx")
    return {name: folder / f"{name}.onnx" for name in variants}


def measured(
    labels: Path, out: Path, srm: str | Path = "rule", others: tuple[Path | str, ...] = (), **more: Any
) -> RunReport:
    options = {k: more.pop(k) for k in ("workers", "plots") if k in more}
    options = {"plots": False, **options}
    pairs = more.pop("vlm", None)
    how = RelationSpec(others=tuple(map(str, others)), **more)
    spec = EvalSpec("demo", str(labels), {"srm": srm}, pairs=pairs, grounding=False, relations=how)
    return evaluate_dataset(spec, out, bootstrap=QUICK, **options)


@pytest.fixture(scope="module")
def run(label_sets: dict[str, Labels], networks: dict[str, Path], tmp_path_factory: Any) -> tuple[RunReport, Path]:
    out = tmp_path_factory.mktemp("relations") / "run"
    return measured(label_sets["demo"].root, out, others=tuple(networks.values())), out


def rows_of(report: RunReport, key: str) -> dict[str, Row]:
    return {row.name: row for row in next(t for t in report.tables if t.key == key).rows}


def numbers(row: Row, names: tuple[str, ...]) -> dict[str, Any]:
    return {n: c.value if isinstance(c, Estimate) else c for n, c in zip(names, row.cells, strict=True)}


def as_columns(path: Path, system: str, relations: tuple[str, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Probabilities and states straight from the file, by another way than the program's."""
    import duckdb

    fields = [f'p."{system}"."{r}"' for r in relations] + [f'state."{r}"' for r in relations]
    query = f"select {', '.join(f'{f} as c{k}' for k, f in enumerate(fields))} from '{path}'"
    found = duckdb.connect().execute(query).fetchnumpy()
    stacked = [np.asarray(found[f"c{k}"], np.float64) for k in range(len(fields))]
    k = len(relations)
    return np.stack(stacked[:k], axis=1), np.stack(stacked[k:], axis=1)


@pytest.mark.slow
@pytest.mark.parametrize("system", ["rule", "flat", "worded", "choosing"])
def test_figures_are_those_of_scikit_learn_on_the_recorded_rows(system: str, run: tuple[RunReport, Path]) -> None:
    sk = pytest.importorskip("sklearn.metrics")
    report, out = run
    records = read_relation_records(out / "relation_records.parquet")
    mine = next(s for s in records.systems if s.name == system)
    p, states = as_columns(out / "relation_records.parquet", system, mine.relations)
    found = numbers(rows_of(report, "srm")[mine.title], MEASURES)
    known, holds, said = states != 0, states > 0, p > 0.5
    assert found["pairs"] == len(p) == report.pairs
    assert found["masked U cells"] == (~known).sum() > 0
    assert found["micro-F1"] == pytest.approx(sk.f1_score(holds[known], said[known]), abs=1e-9)
    assert found["element accuracy"] == pytest.approx(sk.accuracy_score(holds[known], said[known]), abs=1e-9)
    assert found["Brier"] == pytest.approx(sk.brier_score_loss(holds[known], p[known]), abs=1e-9)
    f1, ap = [], []
    lines = rows_of(report, "srm_relations")
    for k, relation in enumerate(mine.relations):
        rows = known[:, k]
        truth, score = holds[rows, k], p[rows, k]
        line = numbers(lines[f"{mine.title}: {PHRASE[relation]}"], BY_RELATION)
        f1.append(sk.f1_score(truth, score > 0.5))
        ap.append(sk.average_precision_score(truth, score))
        assert line["F1"] == pytest.approx(f1[-1], abs=1e-9)
        assert line["AP"] == pytest.approx(ap[-1], abs=1e-9)
        assert line["recall"] == pytest.approx(sk.recall_score(truth, score > 0.5), abs=1e-9)
        if (score > 0.5).any():
            assert line["precision"] == pytest.approx(sk.precision_score(truth, score > 0.5), abs=1e-9)
        assert (line["positives"], line["U cells"]) == (truth.sum(), (~rows).sum())
    assert found["macro-F1"] == pytest.approx(np.mean(f1), abs=1e-9)
    assert found["mean AP"] == pytest.approx(np.mean(ap), abs=1e-9)


@pytest.mark.slow
def test_top_one_is_that_of_the_network_before_the_prior_is_divided_out(
    run: tuple[RunReport, Path], networks: dict[str, Path]
) -> None:
    sk = pytest.importorskip("sklearn.metrics")
    report, out = run
    contract = OnnxScorer(networks["choosing"]).contract
    p, states = as_columns(out / "relation_records.parquet", "choosing", contract.vocabulary)
    one = (states > 0).sum(axis=1) == 1
    likely = p[one] * np.array(contract.prior)
    truth = (states[one] > 0).argmax(axis=1)
    rows = rows_of(report, "srm")
    found = numbers(next(row for name, row in rows.items() if name.startswith("choosing")), MEASURES)
    assert found["Top-1"] == pytest.approx(np.mean(likely.argmax(axis=1) == truth), abs=1e-9)
    labels = np.arange(len(contract.vocabulary))
    expected = sk.top_k_accuracy_score(truth, likely / likely.sum(axis=1, keepdims=True), k=2, labels=labels)
    assert found["Top-2"] == pytest.approx(expected, abs=1e-9)
    assert numbers(rows["rule"], MEASURES)["Top-1"] is None


@pytest.mark.slow
def test_the_row_that_always_says_no(run: tuple[RunReport, Path]) -> None:
    report, out = run
    records = read_relation_records(out / "relation_records.parquet")
    rows = {name: row for name, row in rows_of(report, "srm").items() if name.startswith("always no")}
    sets = {s.relations for s in records.systems}
    assert len(rows) == len(sets) == 3
    for relations in sets:
        name = f"always no ({', '.join(PHRASE[r] for r in relations)})"
        truth = records.truth(relations)
        share = (truth > 0).sum() / (truth != 0).sum()
        found = numbers(rows[name], MEASURES)
        assert found["micro-F1"] == 0.0
        assert found["element accuracy"] == pytest.approx(1 - share, abs=1e-12)
        assert found["Brier"] == pytest.approx(share, abs=1e-12)
        assert found["ECE"] == pytest.approx(share, abs=1e-12)


@pytest.mark.slow
def test_probabilities_are_those_of_relations_and_the_rule_agrees_with_its_own_labels(
    run: tuple[RunReport, Path], networks: dict[str, Path]
) -> None:
    from pipeline.answering import open_pipeline, relate_frames

    _, out = run
    import pyarrow.parquet as pq

    rows = pq.read_table(out / "relation_records.parquet").to_pylist()
    source = open_pipeline("demo", srm=networks["worded"])
    frame = next(relate_frames(source, "0"))
    place = {o.id: k for k, o in enumerate(frame.objects)}
    mine = [r for r in rows if r["frame"] == frame.frame_id]
    assert len(mine) > 50
    for row in mine[:80]:
        a, b = place[row["a"]], place[row["b"]]
        assert (row["label_a"], row["label_b"]) == (frame.objects[a].label, frame.objects[b].label)
        for relation in DIRECTIONAL:
            assert row["p"]["worded"][relation] == pytest.approx(frame.scores.of(relation)[a, b], abs=1e-6)
    said = {(r["state"][x], round(r["p"]["rule"][x], 2)) for r in rows for x in DIRECTIONAL}
    # Labels may doubt what the rule is sure of, and never say the opposite.
    assert {(state, p) for state, p in said if state} == {(1, 0.95), (-1, 0.05)}


@pytest.mark.slow
def test_one_is_warned_of_pairs_that_were_learnt_by_heart(
    run: tuple[RunReport, Path], label_sets: dict[str, Labels], networks: dict[str, Path], tmp_path: Path
) -> None:
    report, out = run
    card = json.loads(networks["flat"].with_suffix(".json").read_text())
    train = set(card["split"]["train_scenes"])
    (warning,) = [w for w in report.warnings if "trained on" in w]
    assert warning.startswith("flat, worded, choosing: ")
    assert all(scene in warning for scene in train)
    assert warning in report.tables[0].note
    manifest = json.loads((out / "run.json").read_text())
    assert warning in manifest["relations"]["warnings"]
    records = read_relation_records(out / "relation_records.parquet")
    flat = records.systems[1]
    scenes = np.array(records.scenes)[records.scene]
    np.testing.assert_array_equal(flat.part != DROPPED, np.isin(scenes, [*train, *card["split"]["validation_scenes"]]))

    fresh = measured(label_sets["demo"].root, tmp_path / "fresh", others=tuple(networks.values()), pairs="held-out")
    assert not fresh.warnings
    assert 0 < fresh.pairs == counted_pairs(records, held_out=True).sum() < report.pairs
    # Away from what it learnt, the tuned threshold is measured on the very same pairs as the plain one.
    (figures,) = [f for f in all_systems(records, held_out=True, config=QUICK) if f.title == flat.title]
    truth = records.truth(flat.relations)
    test, validation = flat.part == DROPPED, flat.part == VALIDATION
    assert figures.metrics.pairs == test.sum()
    k = int(np.flatnonzero(np.isfinite(figures.tuned))[0])
    p, t = flat.p[validation, k][truth[validation, k] != 0], truth[validation, k][truth[validation, k] != 0]
    cuts = np.unique(p)
    best = max(2 * ((p > c) & (t > 0)).sum() / ((p > c).sum() + (t > 0).sum()) for c in [*cuts, -1.0])
    assert best >= 2 * ((p > 0.5) & (t > 0)).sum() / max((p > 0.5).sum() + (t > 0).sum(), 1)


@pytest.mark.slow
def test_networks_of_other_data_are_not_suspected(networks: dict[str, Path], tmp_path: Path) -> None:
    worlds = label_worlds(tmp_path / "worlds", 3, 1)
    report = measured(worlds.root, tmp_path / "run", networks["flat"])
    assert not report.warnings
    network, no = (numbers(row, MEASURES) for row in report.tables[0].rows[:2])
    assert network["pairs"] == no["pairs"] == report.pairs > 0
    assert network["mean AP"] > no["mean AP"]
    nameless = tmp_path / "nameless.onnx"
    import onnx

    model = onnx.load(str(networks["flat"]))
    kept = [p for p in model.metadata_props if p.key != "srm.trained_on"]
    del model.metadata_props[:]
    model.metadata_props.extend(kept)
    onnx.save(model, str(nameless))
    (warning,) = measured(worlds.root, tmp_path / "other", nameless).warnings
    assert "does not say what it was trained on" in warning


@pytest.mark.slow
def test_a_damaged_record_of_training_is_refused(networks: dict[str, Path], tmp_path: Path) -> None:
    import onnx

    for value in ("{", "[]", '{"dataset": "demo"}'):
        model = onnx.load(str(networks["flat"]))
        next(p for p in model.metadata_props if p.key == "srm.trained_on").value = value
        onnx.save(model, str(tmp_path / "odd.onnx"))
        with pytest.raises(InputError, match="metadata cannot be read"):
            OnnxScorer(tmp_path / "odd.onnx")


def test_pairs_without_a_probability_are_refused(label_sets: dict[str, Labels], tmp_path: Path) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    measured(label_sets["demo"].root, tmp_path / "run", "rule", frames=1)
    file = tmp_path / "run" / "relation_records.parquet"
    rows = pq.read_table(file)
    told = rows.column("p").to_pylist()
    for value in (None, 1.5, float("nan")):
        odd = pa.array([{"rule": {**told[0]["rule"], "left": value}}, *told[1:]], rows.schema.field("p").type)
        pq.write_table(rows.set_column(rows.schema.get_field_index("p"), rows.schema.field("p"), odd), file)
        with pytest.raises(InputError, match="a probability outside"):
            read_relation_records(file)


@pytest.mark.slow
def test_workers_and_shared_frames_change_nothing(
    label_sets: dict[str, Labels], networks: dict[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import pyarrow.parquet as pq

    monkeypatch.setattr("pipeline.evaluation.run.FRAMES_A_BLOCK", 2)
    labels = label_sets["demo"].root
    one = measured(labels, tmp_path / "one", networks["flat"], frames=3)
    two = measured(labels, tmp_path / "two", networks["flat"], frames=3, workers=2)
    how = RelationSpec(frames=3)
    spec = EvalSpec("demo", str(labels), {"srm": networks["flat"]}, relations=how, limit=10)
    both = evaluate_dataset(spec, tmp_path / "both", bootstrap=QUICK, plots=False)
    tables = [pq.read_table(tmp_path / name / "relation_records.parquet") for name in ("one", "two", "both")]
    assert tables[0].equals(tables[1])
    assert tables[0].equals(tables[2])
    assert len(tables[0].column("frame").unique()) == 3
    of_both = [table for table in both.tables if table.key in {t.key for t in one.tables}]
    assert markdown(one.tables) == markdown(two.tables) == markdown(of_both)
    assert (one.expressions, both.expressions) == (0, 10)
    assert not (tmp_path / "one" / "records.parquet").exists()


@pytest.mark.slow
def test_a_network_that_chooses_among_relations_that_were_not_labelled(
    label_sets: dict[str, Labels], networks: dict[str, Path], tmp_path: Path
) -> None:
    labels = tmp_path / "avd"
    shutil.copytree(label_sets["demo"].root, labels)
    manifest = json.loads((labels / MANIFEST_FILE).read_text())
    manifest["config"]["relations"] = list(DIRECTIONAL)
    (labels / MANIFEST_FILE).write_text(json.dumps(manifest))
    report = measured(labels, tmp_path / "run", networks["choosing"], geometry="stored")
    found = numbers(report.tables[0].rows[0], MEASURES)
    assert found["relations"] == len(set(DIRECTIONAL) & set(VOCABULARIES["semantic-abstraction"])) == 4
    assert found["Top-1"] is None
    assert any("without on, in, which were not labelled" in w for w in report.warnings)
    manifest["config"]["relations"] = ["near"]
    (labels / MANIFEST_FILE).write_text(json.dumps(manifest))
    with pytest.raises(InputError, match="judges none of the relations that were labelled"):
        measured(labels, tmp_path / "none", networks["flat"])
    assert not (tmp_path / "none").exists()


@pytest.mark.slow
def test_what_cannot_be_measured_is_refused(
    label_sets: dict[str, Labels], networks: dict[str, Path], tmp_path: Path
) -> None:
    demo = label_sets["demo"].root
    worlds = label_worlds(tmp_path / "worlds", 1, 1)
    refused: tuple[tuple[Path, dict[str, Any], str], ...] = (
        (worlds.root, {"geometry": "lifted"}, "cannot be lifted again"),
        (label_sets["empty"].root, {}, "no pairs of objects"),
        (demo, {"vectors": str(networks["flat"])}, "none of the relation scorers uses class names"),
        (demo, {"others": (tmp_path / "absent.onnx",)}, "there is no relation network"),
    )
    for labels, more, message in refused:
        with pytest.raises(InputError, match=message):
            measured(labels, tmp_path / "run", **more)
        assert not (tmp_path / "run").exists()
    wrongs: tuple[dict[str, Any], ...] = ({"frames": 0}, {"vlm_pairs": 0}, {"seed": -1})
    for wrong in wrongs:
        with pytest.raises(InputError, match="at least"):
            RelationSpec(**wrong)


def test_labels_of_other_objects_are_refused(label_sets: dict[str, Labels], tmp_path: Path) -> None:
    from pipeline.labels import read_table, write_table

    labels = tmp_path / "labels"
    shutil.copytree(label_sets["demo"].root, labels)
    for table, columns in (("objects", ("object",)), ("relations", ("a", "b"))):
        rows = read_table(labels / f"{table}.parquet", table)
        for name in columns:
            place = rows.schema.get_field_index(name)
            moved = np.asarray(rows.column(name).to_numpy()) + 1000
            rows = rows.set_column(place, rows.schema.field(name), [moved.astype(np.int32)])
        write_table(rows, labels / f"{table}.parquet")
    with pytest.raises(InputError, match=r"no annotation 1\d\d\d, which the labels name"):
        measured(labels, tmp_path / "run")
    assert measured(labels, tmp_path / "stored", geometry="stored").pairs > 0


@pytest.mark.slow
def test_a_vision_language_model_is_asked_about_a_sample(
    label_sets: dict[str, Labels], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import pyarrow.parquet as pq
    from chat_server import MODELS, Clock, running

    monkeypatch.setenv("SPATIALVIZ_CACHE", str(tmp_path / "cache"))
    with running(Clock()) as server:
        server.answer = lambda request: "Yes" if " left of " in request.prompt else "No"
        model = Vlm(server.url, MODELS[0])
        labels = label_sets["demo"].root
        report = measured(labels, tmp_path / "vlm", "trained", vlm=model, vlm_pairs=15, seed=4)
        again = measured(labels, tmp_path / "again", "trained", vlm=model, vlm_pairs=15, seed=4)
    rows = pq.read_table(tmp_path / "vlm" / "relation_records_vlm.parquet").to_pylist()
    assert len(rows) == 15
    assert all(r["p"] == {x: float(x == "left") for x in DIRECTIONAL} for r in rows)
    own = {
        (r["frame"], r["a"], r["b"]): r
        for r in pq.read_table(tmp_path / "vlm" / "relation_records.parquet").to_pylist()
    }
    for row in rows:
        twin = own[row["frame"], row["a"], row["b"]]
        assert row["state"] == {r: twin["state"][r] for r in DIRECTIONAL}
    (line,) = [row for name, row in rows_of(report, "srm").items() if name.startswith("VLM")]
    left = [r["state"]["left"] for r in rows if r["state"]["left"]]
    positives = sum(s > 0 for r in rows for s in r["state"].values())
    expected = 2 * sum(s > 0 for s in left) / (len(left) + positives)
    assert numbers(line, MEASURES)["micro-F1"] == pytest.approx(expected)
    assert any(name.endswith("on the VLM's pairs") for name in rows_of(report, "srm"))
    assert report.tables[0].rows == again.tables[0].rows
    # It had a vote in the labels: its rows, also on the sample, stand below the model that had none.
    assert "the scorer was the labels' second opinion" in " ".join(report.tables[0].caveats)
    measured_rows = [row for row in report.tables[0].rows if row.source == "measured"]
    assert [row.shares for row in measured_rows] == ["", "", AGREEMENT, AGREEMENT]
    assert measured_rows[0].name.startswith("VLM")
