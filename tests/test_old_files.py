"""Old files always open: labels, runs, cases, journals, view strings and networks of earlier states say what they said.

`fixtures/2026-11-21` was written before labels said who made them and before journals were chained, `2026-11-22` before
the relations of labels were declared in one place; `2026-11-24` has the network that took all names at their word. A
release that changes a format adds a folder and changes none.
"""

from __future__ import annotations

import json
import shutil
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from pipeline.corrections import effective_tables, open_journal
from pipeline.diagnosis import decode, open_case
from pipeline.diagnosis.cases.replay import replay_case
from pipeline.diagnosis.whatif.state import state_record
from pipeline.evaluation import open_database, open_run
from pipeline.labels import open_labels
from pipeline.relations import T, U, make_scorer

FIXTURES = Path(__file__).parent / "fixtures"
STATES = ("2026-11-21", "2026-11-22")
FRAME = "000001/000000"
VERDICTS = {
    "2026-11-21": {"CORRECT": 7, "OPM-CONF": 3, "LABEL": 1, "OPM-TARGET": 1},
    "2026-11-22": {"CORRECT": 7, "OPM-CONF": 1, "OPM-REF": 1, "LABEL": 1, "OPM-TARGET": 2},
}


@pytest.fixture(params=STATES)
def state(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """A copy, since opening a journal may bring it up to date."""
    return Path(shutil.copytree(FIXTURES / request.param, tmp_path / request.param))


def test_labels(state: Path) -> None:
    labels = open_labels(state / "labels")
    assert labels.expressions.num_rows == 12
    assert labels.expressions.column("text")[0].as_py() == "from the camera, the laptop left of the picture"
    names = labels.objects.column("label").to_pylist()
    assert names[:4] == ["desk", "potted plant", "laptop", "mug"]
    assert {"left", "right", "above", "below", "front", "behind"} <= set(labels.relation_names)
    left = np.asarray(labels.relations.column("left"))
    assert np.count_nonzero(left == T) > 100


def test_a_journal_and_the_labels_with_its_corrections(state: Path) -> None:
    labels = open_labels(state / "labels")
    before = labels.objects.column("label").to_pylist()
    journal = open_journal(state / "labels" / "journal.sqlite", must_exist=True)
    try:
        events = journal.events()
        assert [(e.ref.kind, e.ref.field, e.after) for e in events[:4]] == [
            ("object", "label", "cup"),
            ("relation", "above", U),
            ("relation", "below", U),
            ("frame", "note", "looked at"),
        ]
        assert {e.author for e in events} == {"ann"}
        assert Counter(e.action for e in events) == {"edit": 4, "undo": 4, "redo": 4}
        found = effective_tables(labels, journal)
    finally:
        journal.close()
    after = found.tables["objects"].column("label").to_pylist()
    assert after == [*before[:3], "cup", *before[4:]]
    assert found.provenance.num_rows == 4


def test_a_run(state: Path) -> None:
    run = open_run(state / "run", labels=str(state / "labels"))
    assert run.spec.dataset == "demo"
    with open_database(state / "run") as database:
        found = dict(database.select("select verdict, count(*) from records group by verdict").rows)
    assert found == VERDICTS[state.name]


def test_a_case_answers_as_it_did() -> None:
    replay = replay_case(open_case(FIXTURES / "2026-11-21" / "case"))
    assert replay.changes == ()


def test_corrected_labels() -> None:
    labels = open_labels(FIXTURES / "2026-11-21" / "corrected")
    assert labels.objects.column("label")[3].as_py() == "cup"


def test_a_view_string(state: Path) -> None:
    view = decode((state / "view.txt").read_text().strip())
    assert state_record(view) == json.loads((state / "view.json").read_text())
    assert view.edits.k == 3


@pytest.mark.parametrize(
    "network", [FIXTURES / f for f in ("rel14.onnx", "2026-11-22/rel26.onnx", "2026-11-24/rel32.onnx")]
)
def test_a_relation_network(network: Path) -> None:
    assert make_scorer(network).name == network.stem
