"""Head of the story of a row of a run: what `pipeline.diagnosis.story` says first, from the recorded columns alone."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pipeline.diagnosis.story import NUMBERS, TOUCHES
from pipeline.diagnosis.story_words import STORIES, Tone, capital

READ = (
    "verdict",
    "detail",
    "lucky",
    "said",
    "repair",
    "target",
    "reference",
    "box",
    "reference_box",
    "right_p_target",
    "set_iou",
    "degenerate",
    "answers",
    "answers_strict",
    "strict_correct",
    "problem",
    "missed_name",
    "missed_overlap",
)
"""Columns that a head is made of; what earlier releases did not record is not known."""


def row_head(row: Mapping[str, Any]) -> tuple[Tone, str]:
    """Tone and head of a row."""
    kind, values = _kind({name: row.get(name) for name in READ})
    tone, head, _ = STORIES[kind]
    return tone, capital(head.format(**values))


def _kind(row: Mapping[str, Any]) -> tuple[str, dict[str, Any]]:
    """Kind of the story, with the values of its head."""
    detail, answered = row["detail"] or "", row["box"] is not None
    names = {"target": row["target"], "reference": row["reference"]}
    alone = answered and row["reference_box"] is None
    if row["verdict"] is None:
        return "unjudged", {}
    if row["verdict"] == "CORRECT":
        lucky = "lucky.alone" if row["degenerate"] and alone else "lucky.another"
        return lucky if row["lucky"] else "right", names
    if row["verdict"] == "LABEL":
        sure = row["strict_correct"] is not False or row["answers"] == row["answers_strict"]
        kinds = {"BAD_BOX": "label.box", "BAD_LABEL": "label.text", "SUSPECT": "label.unlisted"}
        return kinds.get(detail, "label.another" if sure else "label.perhaps"), names
    if row["verdict"] == "PARSE":
        return "misread.refused" if row["problem"] else "misread", names
    if row["verdict"] == "NOT-SEEN":
        return f"unseen.{detail.lower() if detail == 'HIDDEN' else 'out'}.right", {
            "name": row["missed_name"] or row["target"]
        }
    if row["verdict"] in ("OPM-TARGET", "OPM-REF"):
        role = "target" if row["verdict"] == "OPM-TARGET" else "reference"
        on_it = max(TOUCHES, (row["missed_overlap"] or 0) - 1e-6) <= (row["set_iou"] or 0)
        loose = on_it and role == "target" and row["reference_box"] is not None
        kinds = {
            "THRESHOLD": f"{role}.threshold",
            "RANK": "missed.suppressed" if "over it" in (row["said"] or "") else "missed.rank",
            "LOCALISATION": "missed.loose" if loose else "missed.localisation",
        }
        kind, name = kinds.get(detail, f"{role}.absent"), row["missed_name"] or names[role]
        return kind, {"name": name, "target": name, "reference": name}
    if row["verdict"] == "UNEXPLAINED":
        return "level.3", {"Wrong": "Wrong" if answered else "Not answered"}
    if row["verdict"] == "LIFT" and (row["said"] or "").startswith("The given 3D boxes"):
        return "box.given", names
    if row["reference_box"] is None and row["reference"]:
        return "one", names
    return _lost(row, detail), names | {
        "name": next((n for n in names.values() if n and f" {n} is " in (row["said"] or "")), row["target"]),
        "Number": NUMBERS.get(len(row["repair"] or ()), "several"),
    }


def _lost(row: Mapping[str, Any], detail: str) -> str:
    """Kind of the story of a right pair that stood among the candidates and lost."""
    if row["verdict"] == "COMPOUND":
        return "several.unseen" if row["repair"] == ["RECALL"] else "several"
    if detail == "DEGENERATE":
        return "one" if row["right_p_target"] is None else "ranked.tie"
    kinds = {
        "LIFT": "box",
        "ATTRIBUTE": "looks",
        "OPM-CONF": "false",
        "SRM": {"CHOICE": "relation.choice", "CONSTANT": "relation.constant"}.get(detail, "relation"),
    }
    return kinds.get(row["verdict"], "ranked")
