"""Answers of vision-language models and agents, JSON lines that their evaluations leave behind.

RoboRefer: Zhoues/RoboRefer, Evaluation/test_benchmark.py: question_id, prompt, object_name, text (the answer),
model_id, rgb_path, mask_path, category, step. What numbers mean goes by model_id as in its summarize_acc.py.
SpatialRGPT: AnjieCheng/SpatialRGPT, llava/eval/eval_spatial.py: question_id, image, question, pred, gt, qa_info.
LLaVA: llava/eval/model_vqa.py: question_id, prompt, text, answer_id, model_id, metadata; the question file names the
pictures.
SpatialClaw: NVlabs/SpatialClaw, entrypoints/run.py: predictions.jsonl with sample_id, content, ground_truth, result;
where `session-<sample_id>/trace.jsonl` (logging_utils/logger.py) lies beside it, its event `init` has the question. No
file names the pictures.
lmms-eval: EvolvingLMMs-Lab/lmms-eval, loggers/evaluation_tracker.py: *_samples_<task>.jsonl with doc_id, target, input,
resps, filtered_resps, and input_media where the task's documents name their pictures.

What a file lacks comes from the file given with --key, a list of items with an id, a picture, and a question.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from pipeline.answering.predictions import Header, PredictedAnswer, Prediction
from pipeline.datasets.frame_names import Picture
from pipeline.evaluation.adapters.published import PredictionFormat, Published
from pipeline.evaluation.model_answers import parse_yes_no, spoken_part
from pipeline.evaluation.place_reading import PlacedLine, ReadPlace, read_places
from pipeline.evaluation.written_places import written_place
from pipeline.language.counted import counted
from pipeline.system.errors import InputError, needed, require
from pipeline.system.frozen import dataclass
from pipeline.system.limits import current_limits
from pipeline.system.reading import Content, read_content
from pipeline.system.safe_files import opened, parse_json

PICTURES = ("frame", "rgb_path", "image_path", "image_file", "image", "img", "images", "input_media", "file_name")
QUESTIONS = ("text_q", "question", "prompt", "text", "instruction", "query")
"""Where the items of a key have what is asked for; the first that is there is taken."""


@dataclass(frozen=True)
class Fields:
    """Keys under which a format's lines have what is asked for."""

    id: str
    answer: str
    questions: tuple[str, ...]  # the wordings of the question; the one that is an expression of the labels is taken
    pictures: tuple[str, ...] = ()
    system: str = "model_id"
    raw: str = ""  # where the answer stands that was not filtered, for when the filtered one is missing or empty


def read_answers(fields: Fields, published: Published) -> tuple[Header, Iterator[Prediction]]:
    """The lines of a file; places are shares of the picture."""
    content = published.content
    system = content.first.get(fields.system)
    name = system if isinstance(system, str) and system else published.path.stem
    return Header(system=name, box_unit="shares"), _lines(fields, published, content)


def _lines(fields: Fields, published: Published, content: Content) -> Iterator[Prediction]:
    items = {} if published.key is None else _items(read_content(published.key), fields.id)
    read: list[Prediction] = []
    placed: dict[int, PlacedLine] = {}
    numbers = 0
    for k, row in enumerate(content.value if isinstance(content.value, list) else [content.value]):
        where = content.where(k)
        require(isinstance(row, dict), f"{where}: an object is asked for", path=content.path)
        number = row.get(fields.id)
        item = items.get(str(number))
        unknown = f"{where}, {fields.id}: --key has no item of the id {number!r}"
        require(item is not None or not items, unknown, path=published.key)
        inner = row.get("doc")
        item = {**(inner if isinstance(inner, dict) else {}), **(item or {})}
        found = _first(row, fields.pictures) or _first(item, PICTURES)
        expected = "--key ITEMS, a list of id, image and question"
        nameless = f"{where}: nothing names the picture"
        picture = needed(_picture(found), nameless, expected=expected, path=content.path)
        frame = published.frame(picture, where)
        if frame is None:
            continue
        told = [row.get(name) for name in fields.questions] + [_first(item, QUESTIONS), _traced(published.path, number)]
        told.append(item.get("answer") if inner else None)  # Where RefCOCO's documents have the expression.
        candidates = [text for text in told if isinstance(text, str) and text.strip()]
        require(candidates, f"{where}: no question", expected=expected, path=content.path)
        text = published.text(frame, candidates)
        given = row.get(fields.answer) or row.get(fields.raw, row.get(fields.answer))
        missing = f"{where}, {fields.answer}: no answer"
        require(given is not None, missing, got=", ".join(row), expected="text, empty for none", path=content.path)
        said = _said(given, item.get("choices"))
        spoken, problem = spoken_part(said)
        place = None if problem else written_place(spoken)
        if place is None:
            verdict = None if problem else parse_yes_no(spoken)
            yes = None if verdict is None else verdict.value
            if verdict is not None and yes is None:
                problem = f"no place, and {verdict.reason}: {' '.join(spoken.split())[:80]!r}"
            numbers += yes is None and any(c.isdigit() for c in said)
            read.append(Prediction(frame, text, None if yes is None else PredictedAnswer(yes=yes), problem))
            continue
        model = row.get(fields.system)
        model = model if isinstance(model, str) and model else f"{content.path.parent.name}/{content.path.stem}"
        unit = "thousandths" if any(_THOUSANDTHS.search(text) for text in candidates) else ""
        asked = published.sentences.get(frame, {}).get(text, ())[:1] or ((place.label,) if place.label else ())
        things = published.things(frame, *asked)
        placed[len(read)] = PlacedLine(where, place, published.size(frame), things, model, unit)
        read.append(Prediction(frame, text))
    places, notes = read_places(list(placed.values()), published.places, content.path)
    published.notes.extend(notes)
    several = sum(
        line.place.several and (place.point or not line.place.pair)
        for line, place in zip(placed.values(), places, strict=True)
    )
    if several:
        published.notes.append(f"more than one place in {counted(several, 'answer')}; the first of each is taken")
    if numbers:
        published.notes.append(
            f"a number (a count, a distance) in {counted(numbers, 'answer')}: no place, and counted as unanswered"
        )
    for k, place in zip(placed, places, strict=True):
        read[k] = _answered(read[k], place)
    yield from read


def _answered(line: Prediction, place: ReadPlace) -> Prediction:
    """A line with its place; beyond the picture it is none, cut at the edge where it goes on slightly."""
    x0, y0, x1, y1 = place.box
    if max(x0, y0) > 1 + OVERSHOOT or min(x1, y1) < -OVERSHOOT:
        return replace(line, problem=f"a place outside the picture: {place.written}")
    if place.point:
        return replace(line, answer=PredictedAnswer(point=(x0, y0)))
    x0, x1, y0, y1 = min(x0, x1), max(x0, x1), min(y0, y1), max(y0, y1)
    box = (max(x0, 0.0), max(y0, 0.0), min(x1, 1.0), min(y1, 1.0))
    if box[0] >= box[2] or box[1] >= box[3]:
        return replace(line, problem=f"an empty box: {place.written}")
    return replace(line, answer=PredictedAnswer(box=box))


def _items(content: Content, name: str) -> dict[str, Mapping[str, Any]]:
    """Items of a key by their ids; by their number in the list without ids, and for lmms-eval's doc_id."""
    listed = content.value
    require(isinstance(listed, list), "--key is a list of items", got=type(listed).__name__, path=content.path)
    found: dict[str, Mapping[str, Any]] = {}
    for k, item in enumerate(listed):
        require(isinstance(item, dict), f"{content.where(k)}: an object is asked for", path=content.path)
        number = _first(item, (name,) if name == "doc_id" else (name, "id", "idx", "index"))
        number = str(k if number is None else number)
        require(number not in found, f"{content.where(k)}: the id {number} stands twice", path=content.path)
        found[number] = item
    return found


def _first(row: Mapping[str, Any], names: Iterable[str]) -> Any:
    return next((row[name] for name in names if row.get(name) not in (None, "", [])), None)


def _picture(found: Any) -> Picture | None:
    """A name or number; the only entry of a list, the path of an object."""
    if isinstance(found, list) and len(found) == 1:
        found = found[0]
    if isinstance(found, dict):
        found = _first(found, ("path", "file_path", "file_name", "url"))
    if isinstance(found, bool) or not isinstance(found, str | int) or str(found).startswith("data:"):
        return None
    return found


def _traced(path: Path, number: Any) -> str | None:
    """Question in a session's trace beside the file, without the benchmark's additions."""
    name = f"session-{number}"
    if "/" in name or "\\" in name:
        return None
    with suppress(OSError, ValueError, InputError), opened(path.parent / name / "trace.jsonl", "unpacked") as file:
        event = parse_json(file.readline(current_limits().text), path)
        return str(event["instruction"]).split("\n\n")[0] if event.get("event_type") == "init" else None
    return None


def _said(answer: Any, choices: Any) -> str:
    """Words of an answer; a letter of several choices is resolved."""
    while isinstance(answer, list) and len(answer) == 1:
        answer = answer[0]
    text = answer if isinstance(answer, str) else json.dumps(answer)
    spoken, _ = spoken_part(text)
    letter = re.fullmatch(r"(?:.*\\boxed\{)?\W*([A-Z])\W*", spoken, re.DOTALL)
    if letter is None or not isinstance(choices, dict | list):
        return text
    known = choices if isinstance(choices, dict) else dict(zip("ABCDEFGHIJKLMNOPQRSTUVWXYZ", choices, strict=False))
    return str(known.get(letter[1], text))


_THOUSANDTHS = re.compile(r"1000\s*[×x]\s*1000|between 0 and (?:999|1000)")
OVERSHOOT = 0.1
"""Shares of the picture beyond its edge at which a place is none of it."""


def _format(fields: Fields, keys: set[str], description: str, needs: str = "") -> PredictionFormat:
    """Format of answers; `keys`: those of its lines, of "a|b" one."""
    return PredictionFormat(
        partial(read_answers, fields),
        lambda content: all(content.first.keys() & set(key.split("|")) for key in keys),
        description,
        0,
        needs,
    )


ANSWER_FORMATS = {
    "roborefer": _format(
        Fields("question_id", "text", ("prompt", "object_name", "instruction"), ("rgb_path",)),
        {"question_id", "text", "rgb_path"},
        "answers of RoboRefer's test_benchmark.py",
    ),
    "spatialrgpt": _format(
        Fields("question_id", "pred", ("question",), ("image",)),
        {"question_id", "pred", "image"},
        "answers of SpatialRGPT's eval_spatial.py",
    ),
    "llava": _format(
        Fields("question_id", "text", ("prompt",)),
        {"question_id", "text", "answer_id"},
        "answers of LLaVA's model_vqa.py",
        "the question file: question_id, image, text",
    ),
    "spatialclaw": _format(
        Fields("sample_id", "content", ()),
        {"sample_id", "content"},
        "predictions.jsonl of SpatialClaw",
        "the samples: id, image, question, choices",
    ),
    "vlmevalkit": _format(
        Fields("index", "prediction", ("question",), ("image_path", "image")),
        {"index", "question", "prediction"},
        "predictions of VLMEvalKit, .tsv (PRED_FORMAT=tsv)",
        "the benchmark's table, with index and image_path, where the predictions have none",
    ),
    "lmms-eval": _format(
        Fields("doc_id", "filtered_resps", ("input",), ("input_media",), raw="resps"),
        {"doc_id", "resps|filtered_resps"},
        "the samples that lmms-eval logs",
        "the documents in their order, with image and question, where the log has no input_media",
    ),
}
