"""Questions and answers from labels: sure, balanced, and checked against the tables."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import replace
from pathlib import Path

import pytest
from vqa_check import read_questions, verify_vqa

from pipeline.labels import Labels, VqaConfig, export_labels
from pipeline.labels.exports.vqa_geometry import KINDS
from pipeline.labels.exports.vqa_questions import CONVERSATIONS_FILE
from pipeline.system import InputError


def test_every_answer_follows_from_the_tables(label_sets: dict[str, Labels], tmp_path: Path) -> None:
    for kind in ("demo", "hostile", "empty"):
        export_labels(label_sets[kind], "vqa", tmp_path / kind)
        assert verify_vqa(tmp_path / kind, label_sets[kind]) == []
    asked = list(read_questions(tmp_path / "demo"))
    assert set(Counter(q.kind for q in asked)) == set(KINDS)
    assert len({q.id for q in asked}) == len(asked) > 200
    answers = Counter((q.about, q.answer) for q in asked if q.kind == "relation")
    relations = {about for about, _ in answers}
    assert len(relations) >= 6
    assert all(answers[r, "Yes"] == answers[r, "No"] for r in relations)
    assert (
        len({q.question.split(" the ")[0] for q in asked if q.kind in ("distance", "size", "grounding", "which")}) > 8
    )
    written = json.loads((tmp_path / "demo" / CONVERSATIONS_FILE).read_bytes())
    assert all(record.pop("provenance") == [] and record.pop("base") and record.pop("made_by") for record in written)
    assert [q.record() for q in asked] == written
    odd = list(read_questions(tmp_path / "hostile"))
    assert len(odd) > 10
    for question in odd:
        assert "<image>" not in question.question + question.answer


@pytest.mark.slow
def test_the_check_of_answers_finds_false_ones(label_sets: dict[str, Labels], tmp_path: Path) -> None:
    export_labels(label_sets["demo"], "vqa", tmp_path / "out")
    path = tmp_path / "out" / CONVERSATIONS_FILE
    records = json.loads(path.read_bytes())
    changed = {"Yes": "No", "No": "Yes"}
    for record in records:
        answer = record["conversations"][1]
        said, kind = answer["value"], record["metadata"]["kind"]
        if kind in ("distance", "size"):
            answer["value"] = f"{float(said[:-2]) + 0.02:.2f} m"
        elif kind == "grounding":
            answer["value"] = json.dumps([0.0, 0.0, *json.loads(said)[2:]])
        else:
            answer["value"] = changed.get(said, "unicorn")
    path.write_text(json.dumps(records))
    assert len(verify_vqa(tmp_path / "out", label_sets["demo"])) >= len(records) - 2


@pytest.mark.slow
def test_questions_follow_their_options(label_sets: dict[str, Labels], tmp_path: Path) -> None:
    config = VqaConfig(per_frame=5, kinds=("relation", "grounding"), min_margin=0.2, box_decimals=2, seed=4)
    export_labels(label_sets["demo"], "vqa", tmp_path / "a", options=config)
    export_labels(label_sets["demo"], "vqa", tmp_path / "b", options=replace(config, seed=5))
    asked = list(read_questions(tmp_path / "a"))
    assert max(Counter(q.frame for q in asked).values()) <= 5
    assert {q.kind for q in asked} == {"relation", "grounding"}
    assert verify_vqa(tmp_path / "a", label_sets["demo"], config) == []
    assert verify_vqa(tmp_path / "a", label_sets["demo"], replace(config, min_margin=0.5))
    assert asked != list(read_questions(tmp_path / "b"))
    for wrong in ({"per_frame": 0}, {"kinds": ("jokes",)}, {"box_decimals": 1}):
        with pytest.raises(InputError):
            VqaConfig(**wrong)  # type: ignore[arg-type]
