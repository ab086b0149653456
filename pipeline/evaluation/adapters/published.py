"""Files that other pipelines publish, read as predictions: detections, and answers in words.

Detections are any file that `--detector recorded` plays back: what was found for the names of each expression, and no
answer; of a map of ConceptGraphs the objects' 3D boxes come too, in the world. Answers are JSON lines that evaluations
of vision-language models and agents leave behind:

RoboRefer: Zhoues/RoboRefer, Evaluation/test_benchmark.py: question_id, prompt, object_name, text (the answer),
model_id, rgb_path, mask_path, category, step. What numbers mean goes by model_id as in its summarize_acc.py.
SpatialRGPT: AnjieCheng/SpatialRGPT, llava/eval/eval_spatial.py: question_id, image, question, pred, gt, qa_info.
LLaVA: llava/eval/model_vqa.py: question_id, prompt, text, answer_id, model_id, metadata; the question file names the
pictures.
SpatialClaw: NVlabs/SpatialClaw, entrypoints/run.py: predictions.jsonl with sample_id, content, ground_truth, result;
where `session-<sample_id>/trace.jsonl` (logging_utils/logger.py) lies beside it, its event `init` has the question. No
file names the pictures.
lmms-eval: EvolvingLMMs-Lab/lmms-eval, loggers/evaluation_tracker.py: *_samples_<task>.jsonl with doc_id, target, input,
filtered_resps, and input_media where the task's documents name their pictures.

What a file lacks comes from the file given with --key, a list of items with an id, a picture, and a question.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path
from typing import Any

from pipeline.answering.predictions import Header, PredictedAnswer, PredictedBox, Prediction, Proposal
from pipeline.datasets import Dataset
from pipeline.datasets.base import load_picture
from pipeline.datasets.frame_names import FrameNames, Picture
from pipeline.evaluation.model_answers import parse_box, parse_yes_no, spoken_part
from pipeline.geometry.masks import RunLength
from pipeline.language.counted import counted
from pipeline.proposals.base import Proposals
from pipeline.proposals.detection_files import DETECTION_FORMATS
from pipeline.proposals.recorded import RecordedDetector
from pipeline.system.errors import FrameUnusable, InputError, UnknownClass, needed, require
from pipeline.system.limits import current_limits
from pipeline.system.reading import Content, read_content
from pipeline.system.safe_files import opened, parse_json

_WORD = re.compile(r"[^\W_]+")


@dataclass(frozen=True)
class Published:
    """A published file, and what it is about."""

    path: Path  # a file or folder
    key: Path | None  # the file that says what the first leaves open: pictures and classes by number, questions by id
    dataset: Dataset
    # sentences: the labels' expressions by frame, each with the names that it asks for
    sentences: Mapping[str, Mapping[str, tuple[str, ...]]]
    notes: list[str] = field(default_factory=list)  # for an adapter to add what the user should know
    # elsewhere: the pictures that the dataset does not hold, each with where the file names it
    elsewhere: list[str] = field(default_factory=list)

    @cached_property
    def content(self) -> Content:
        """Read the file as JSON, JSON lines or CSV; InputError for anything else."""
        return read_content(self.path)

    @cached_property
    def _frames(self) -> FrameNames:
        return FrameNames(self.dataset.frame_ids)

    @cached_property
    def _sizes(self) -> dict[str, tuple[int, int]]:
        return {}

    @cached_property
    def _texts(self) -> dict[str, dict[str, str]]:
        return {frame: {words(text): text for text in found} for frame, found in self.sentences.items()}

    def frame(self, picture: Picture, where: str) -> str | None:
        """Frame of a picture named at `where`; None, and noted, for an unknown picture.

        The adapter leaves out what is about such a picture. FrameUnusable where it may be of several frames.
        """
        found = self._frames.find(picture, where)
        if found is None:
            self.elsewhere.append(f"{where}, {picture}")
        return found

    def size(self, frame: str) -> tuple[int, int]:
        """Width and height of a frame, pixels; InputError for an unreadable frame."""
        if frame not in self._sizes:
            loaded = load_picture(self.dataset, frame)
            self._sizes[frame] = loaded.width, loaded.height
        return self._sizes[frame]

    def text(self, frame: str, candidates: Sequence[str]) -> str:
        """Expression of the labels in a question of any wording; else the first wording.

        "Point to the mug left of the laptop." has "mug left of the laptop"; of several the longest, if it is one.
        """
        known = self._texts.get(frame, {})
        asked = [words(text) for text in candidates]
        for text in asked:
            if text in known:
                return known[text]
        within = [short for short in known if any(short in text for text in asked)]
        longest = [short for short in within if len(short) == max(map(len, within))]
        return known[longest[0]] if len(longest) == 1 else candidates[0]


def words(text: str) -> str:
    """The words of a text, in small letters, with a space around each."""
    return f" {' '.join(_WORD.findall(text.casefold()))} "


@dataclass(frozen=True)
class PredictionFormat:
    """A published format of predictions."""

    # read: the header and the lines of a file, also as the dicts that `docs/predictions.md` describes
    read: Callable[[Published], tuple[Header | dict[str, Any], Iterable[Prediction | dict[str, Any]]]]
    recognises: Callable[[Content], bool]  # whether a file's content is of the format. Must be fast and must not raise.
    description: str  # one line
    level: int  # what its lines reach
    needs: str = ""  # what must be given besides, with --key; empty for nothing


ONLY_DETECTIONS = "the file holds detections and no answers"


def read_recording(published: Published) -> tuple[Header, Iterator[Prediction]]:
    """Join every expression of the labels with the detections of the names in the text."""
    detector = RecordedDetector(published.path, key=published.key, frame_ids=published.dataset.frame_ids)
    published.notes.append(
        f"{ONLY_DETECTIONS}: with --detector recorded they can be ranked as ours are (spatialviz eval)"
    )
    if detector.elsewhere:
        published.notes.append(
            f"left out: {counted(len(detector.elsewhere), 'picture')} of the file that the dataset does not hold "
            f"(first: {detector.elsewhere[0]})"
        )
    system = detector.made_by or published.path.name
    header = Header(system=system, coordinates="world" if detector.corners else "camera_opencv", notes=ONLY_DETECTIONS)
    return header, _detections(published, detector)


def _detections(published: Published, detector: RecordedDetector) -> Iterator[Prediction]:
    for frame_id, sentences in published.sentences.items():
        frame = load_picture(published.dataset, frame_id)
        told: set[int] = set()
        for text, names in sentences.items():
            proposals: dict[str, tuple[Proposal, ...]] = {}
            unknown: dict[str, str] = {}
            try:
                for name in names:
                    try:
                        proposals[name] = tuple(_proposals(detector.detect(frame, [name]), told))
                    except UnknownClass:
                        unknown[name] = "the file has no such name"
            except FrameUnusable as error:
                yield Prediction(frame_id, text, problem=error.what)
                continue
            ids = dict.fromkeys(p.id for found in proposals.values() for p in found)
            known = detector.corners
            boxes: dict[int, PredictedBox | None] = {i: PredictedBox(corners=known[i]) for i in ids if known}
            yield Prediction(
                frame_id,
                text,
                problem=ONLY_DETECTIONS,
                proposals=proposals,
                unknown=unknown or None,
                boxes_3d=boxes or None,
            )


def _proposals(found: Proposals, told: set[int]) -> Iterator[Proposal]:
    """Proposals, best first; an object's mask stands at the first mention in the frame."""
    rows = zip(found.ids.tolist(), found.scores.tolist(), found.boxes.tolist(), strict=True)
    for k, (i, score, box) in enumerate(rows):
        masked = found.masks is not None and (found.has_mask is None or found.has_mask[k]) and i not in told
        mask = RunLength.of(found.masks[k]) if found.masks is not None and masked else None
        told.add(i)
        yield Proposal(i, score, tuple(box), found.label(k), mask)


PICTURES = ("frame", "rgb_path", "image_path", "image_file", "image", "img", "images", "input_media", "file_name")
QUESTIONS = ("text_q", "question", "prompt", "text", "instruction", "query")
"""Where the items of a key have what is asked for; the first that is there is taken."""


@dataclass(frozen=True)
class Fields:
    """Where a format's lines have what is asked for."""

    id: str
    answer: str
    questions: tuple[str, ...]  # the wordings of the question; the one that is an expression of the labels is taken
    pictures: tuple[str, ...] = ()
    system: str = "model_id"


def read_answers(fields: Fields, published: Published) -> tuple[Header, Iterator[Prediction]]:
    """The lines of a file; places are shares of the picture."""
    content = published.content
    system = content.first.get(fields.system)
    name = system if isinstance(system, str) and system else published.path.stem
    return Header(system=name, box_unit="shares"), _lines(fields, published, content)


def _lines(fields: Fields, published: Published, content: Content) -> Iterator[Prediction]:
    items = {} if published.key is None else _items(read_content(published.key), fields.id)
    several = numbers = 0
    for k, row in enumerate(content.value if isinstance(content.value, list) else [content.value]):
        where = content.where(k)
        require(isinstance(row, dict), f"{where}: an object is asked for", path=content.path)
        number = row.get(fields.id)
        item = items.get(str(number))
        unknown = f"{where}, {fields.id}: --key has no item of the id {number!r}"
        require(item is not None or not items, unknown, path=published.key)
        item = item or {}
        found = _first(row, fields.pictures) or _first(item, PICTURES)
        expected = "--key ITEMS, a list of id, image and question"
        nameless = f"{where}: nothing names the picture"
        picture = needed(_picture(found), nameless, expected=expected, path=content.path)
        frame = published.frame(picture, where)
        if frame is None:
            continue
        told = [row.get(name) for name in fields.questions] + [_first(item, QUESTIONS), _traced(published.path, number)]
        candidates = [text for text in told if isinstance(text, str) and text.strip()]
        require(candidates, f"{where}: no question", expected=expected, path=content.path)
        text = published.text(frame, candidates)
        said = _said(row.get(fields.answer), item.get("choices"))
        in_pixels = any(name in str(row.get(fields.system)) for name in _IN_PIXELS)
        scale = 1000.0 if any(_THOUSANDTHS.search(text) for text in candidates) else None
        answer, problem, more = answer_of(said, lambda f=frame: published.size(f), scale, in_pixels)
        several += more
        numbers += answer is None and any(c.isdigit() for c in said)
        yield Prediction(frame, text, answer, problem)
    if several:
        published.notes.append(f"{several} answers have more than one place; the first of each is taken")
    if numbers:
        published.notes.append(
            f"{numbers} answers are numbers (a count, a distance): no place, and counted as unanswered"
        )


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


_TUPLE = re.compile(r"[(\[]\s*(-?\d+(?:\.\d+)?)\s*,\s*(-?\d+(?:\.\d+)?)\s*[)\]]")
_MOLMO = re.compile(r'x\d*="\s*(-?\d+(?:\.\d+)?)"\s+y\d*="\s*(-?\d+(?:\.\d+)?)"')
_GEMINI = re.compile(r'"point"\s*:\s*\[\s*(-?\d+(?:\.\d+)?)\s*,\s*(-?\d+(?:\.\d+)?)\s*\]')
_QWEN = re.compile(r'"point_2d"\s*:\s*\[\s*(-?\d+(?:\.\d+)?)\s*,\s*(-?\d+(?:\.\d+)?)\s*\]')
_IN_PIXELS = ("RoboBrain", "Qwen")
"""Models whose whole numbers are pixels, by RoboRefer's summarize_acc.py."""


_BOX = re.compile(r"<box>|<\|box_start\|>|bbox")
_THOUSANDTHS = re.compile(r"1000\s*[×x]\s*1000|between 0 and (?:999|1000)")


def answer_of(
    text: str, size: Callable[[], tuple[int, int]], scale: float | None = None, in_pixels: bool = False
) -> tuple[PredictedAnswer | None, str | None, bool]:
    """Place, yes or no of an answer in shares of the picture, else a reason; and a flag for several places.

    Points are read as the published evaluations read them: `x="61.5" y="40.4"` is per cent (Molmo), `"point": [y, x]`
    (Gemini) and `"point_2d": [x, y]` (Qwen) thousandths, and (x, y) shares where it has a decimal point, else pixels.

    `size`: gives width and height of the picture, pixels, where they are needed. `scale`: what the far edge is in (x,
    y), where the question told the model. `in_pixels`: (x, y) is in pixels, whatever it looks like.
    """
    spoken, reason = spoken_part(text)
    if reason:
        return None, reason, False
    for pattern, told in ((_MOLMO, 100.0), (_GEMINI, 1000.0), (_QWEN, 1000.0), (_TUPLE, scale)):
        places = [] if _BOX.search(spoken) else pattern.findall(spoken)
        if places:
            a, b = (float(v) for v in places[0])
            x, y = (b, a) if pattern is _GEMINI else (a, b)
            shares = "." in "".join(places[0]) and not in_pixels
            width, height = (told, told) if told else (1.0, 1.0) if shares else size()
            return PredictedAnswer(point=(x / width, y / height)), None, len(places) > 1
    if len(re.findall(r"\d+", spoken)) >= 4 and (box := parse_box(spoken, size(), scale)).box is not None:
        return PredictedAnswer(box=box.box), None, any("boxes" in note for note in box.notes)
    verdict = parse_yes_no(spoken)
    if verdict.value is not None:
        return PredictedAnswer(yes=verdict.value), None, False
    return None, f"no place, and {verdict.reason}: {' '.join(spoken.split())[:80]!r}", False


def _format(fields: Fields, keys: set[str], description: str, needs: str = "") -> PredictionFormat:
    return PredictionFormat(
        partial(read_answers, fields), lambda content: keys <= content.first.keys(), description, 0, needs
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
    "lmms-eval": _format(
        Fields("doc_id", "filtered_resps", ("input",), ("input_media",)),
        {"doc_id", "filtered_resps"},
        "the samples that lmms-eval logs",
        "the documents in their order, with image and question, where the log has no input_media",
    ),
}
FORMATS: dict[str, PredictionFormat] = {
    **ANSWER_FORMATS,
    **{
        name: PredictionFormat(
            read_recording, form.recognises, form.description, 2 if name == "concept-graphs" else 1, form.needs
        )
        for name, form in DETECTION_FORMATS.items()
    },
    "recording": PredictionFormat(
        read_recording,
        lambda content: "frames" in content.first,
        "a recording of detections, JSON or a folder of NPZ",
        1,
    ),
}
"""All formats by name, but for our own and those of plugins."""
