"""A relation of one's own: what `docs/adding-a-relation.md` shows is all it takes, from the sentence to the labels."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from pipeline.labels import LabelConfig, SourceSpec, label_dataset, open_labels
from pipeline.language import PAIRWISE, RELATIONS
from pipeline.language.relation import DECLARED, Relation
from pipeline.language.relation_names import checked
from pipeline.relations import predicates_of
from pipeline.system import InputError

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "adding-a-relation.md"

PROGRAM = """
import json, sys
from pathlib import Path

import numpy as np

from pipeline.language import relation

added, out, old = json.loads(sys.argv[1]), Path(sys.argv[2]), Path(sys.argv[3])
relation.DECLARED += eval("(" + added["pipeline/language/relation.py"] + ")", vars(relation))

from pipeline.relations import relations

exec(added["pipeline/relations/relations.py"], vars(relations))

from pipeline.answering.pipeline import open_pipeline
from pipeline.diagnosis.asking import annotated_truth, contexts
from pipeline.diagnosis.whatif.region import place_in_region, region_of
from pipeline.labels.check.linter import check_labels
from pipeline.labels.plan import LabelConfig
from pipeline.labels.exports.exporting import export_labels
from pipeline.labels.job import label_dataset
from pipeline.labels.plan import SourceSpec
from pipeline.labels.reading import open_labels
from pipeline.labels.schema import SCHEMA_VERSION, TABLES, json_schemas
from pipeline.labels.reading import content_hash
from pipeline.language.expression import parse
from pipeline.language.relation_names import PAIRWISE, PHRASE
from pipeline.training.label_data import read_label_data

name = PAIRWISE[-1]
demo = open_pipeline("demo", srm="rule")
context = next(contexts(demo, 0))
truth = annotated_truth(context, demo)
a, b = next(
    (int(a), int(b)) for a, b in np.argwhere(truth.states[name] == 1)
    if truth.labels.count(truth.labels[a]) == truth.labels.count(truth.labels[b]) == 1
)
trace = demo.ask(context, f"the {truth.labels[a]} {PHRASE[name]} the {truth.labels[b]}")
best = trace.ranking.pairs[0]
at = {int(o.id): o.lifted for o in trace.objects}
target, reference = at[int(truth.numbers[a])], at[int(truth.numbers[b])]
placement = place_in_region(target, reference, name, context.viewer)
region = region_of(reference, name, target.hi - target.lo, context.viewer)

label_dataset(SourceSpec("demo"), out, LabelConfig(vocabulary="all"), limit=1)
labels, earlier = open_labels(out), open_labels(old)
for row in labels.relations.to_pylist():
    TABLES["relations"].model_validate(row)
for format in ("jsonl", "parquet"):
    export_labels(earlier, format, out.parent / format)
sentences = [row for row in labels.expressions.to_pylist() if row["relation"] == name]
print(json.dumps({
    "read": parse(f"mug {PHRASE[name]} the laptop").expression.relation,
    "answer": [int(trace.objects[best.target].id), int(trace.objects[best.reference].id)],
    "meant": [int(truth.numbers[a]), int(truth.numbers[b])],
    "probability": float(trace.scores.of(name)[best.target, best.reference]),
    "placement": [placement.state, placement.why],
    "region": [p.label for p in region],
    "version": SCHEMA_VERSION,
    "written": [labels.manifest.schema_version, list(labels.relation_names)],
    "schema": sorted(c for c in json_schemas()["relations"]["properties"] if c.startswith(name)),
    "states": sorted(set(labels.relations.column(name).to_pylist())),
    "margins": labels.relations.column(name + "_margin").null_count,
    "sentences": len(sentences),
    "reread": all(parse(s["text"]).expression.relation == name for s in sentences),
    "findings": [[f.rule, f.message] for f in check_labels(labels) if f.severity == "error" or name in f.message],
    "learnt": read_label_data(labels, "rel14", ("left", name)).frames[0].states.shape[-1],
    "old": [earlier.relations.num_rows, earlier.relations.column(name).null_count],
    "old_hash": content_hash(earlier.relations, "relations") == earlier.manifest.tables["relations"].content_hash,
    "old_findings": [[f.rule, f.message] for f in check_labels(earlier) if f.rule.split("/")[0] in
                     ("file", "profile", "relation")],
}))
"""


def added_lines(page: str) -> dict[str, str]:
    """What a diff in the page adds, by file."""
    found: dict[str, str] = {}
    file = ""
    for line in page.split("```diff\n")[1].split("```")[0].splitlines():
        if line.startswith("+++ b/"):
            file = line.removeprefix("+++ b/")
            found[file] = ""
        elif line.startswith("+"):
            found[file] += line[1:] + "\n"
    return found


@pytest.fixture(scope="module")
def asked(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """What a program finds that has the page's relation, given labels made without it."""
    folder = tmp_path_factory.mktemp("added")
    label_dataset(SourceSpec("demo"), folder / "old", LabelConfig(vocabulary="all"), limit=1)
    (folder / "program.py").write_text(PROGRAM, encoding="utf-8")
    arguments = [json.dumps(added_lines(PAGE.read_text(encoding="utf-8"))), str(folder / "new"), str(folder / "old")]
    done = subprocess.run(
        [sys.executable, str(folder / "program.py"), *arguments],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    assert done.returncode == 0, done.stderr[-2000:]
    found = json.loads(done.stdout.splitlines()[-1])
    with pytest.raises(InputError, match="not declared here"):
        open_labels(folder / "new")
    return found


@pytest.mark.slow
def test_its_sentence_is_read_judged_and_answered(asked: dict[str, Any]) -> None:
    assert asked["read"] == "diagonal"
    assert asked["answer"] == asked["meant"]
    assert asked["probability"] == 0.95
    state, why = asked["placement"]
    assert state == 1
    assert why.startswith("It holds by 0.")
    assert set(asked["region"]) == {"T", "U"}


@pytest.mark.slow
def test_its_labels_have_columns_and_sentences(asked: dict[str, Any]) -> None:
    assert asked["version"] == "1.4.0"
    assert asked["written"] == ["1.4.0", [*PAIRWISE, "diagonal"]]
    assert asked["schema"] == ["diagonal", "diagonal_margin"]
    assert asked["states"] == [-1, 0, 1]
    assert asked["margins"] == 0
    assert asked["sentences"] > 3
    assert asked["reread"]
    assert asked["findings"] == []
    assert asked["learnt"] == 2


@pytest.mark.slow
def test_labels_without_its_column_open(asked: dict[str, Any]) -> None:
    rows, nulls = asked["old"]
    assert rows == nulls > 100
    assert asked["old_hash"]
    assert asked["old_findings"] == []


@pytest.mark.parametrize(
    ("new", "match"),
    [
        (Relation("left", "leftish", ("leftish",)), "declared twice"),
        (Relation("over", "over", ("over",)), "two relations are read from 'over'"),
        (Relation("touching", "touching", ("in touch with",)), "does not read its own phrase"),
        (Relation("touching", "touching", ("touching",), inverse="left"), "not each other's inverse"),
        (Relation("touching", "touching", ("touching",), inverse="touched"), "not each other's inverse"),
    ],
)
def test_a_faulty_declaration_is_told_in_one_line(new: Relation, match: str) -> None:
    with pytest.raises(InputError, match=match):
        checked((*DECLARED, new))


def test_a_new_relation_stands_behind_the_old_ones() -> None:
    new = Relation("touching", "touching", ("touching",), since="1.4.0")
    assert list(checked((*DECLARED, new))) == [*RELATIONS, "touching"]
    with pytest.raises(InputError, match="order of columns"):
        checked((new, *DECLARED))
    with pytest.raises(InputError, match="order of columns"):
        checked((*DECLARED, new, replace(new, name="other", phrase="o", reads=("o",), since="1.2.9")))


def test_a_relation_without_a_predicate_is_told() -> None:
    with pytest.raises(InputError, match="'touching' has no predicate"):
        predicates_of(("left", "touching"))
