"""Make the gallery of failures from `gallery.toml`: saved cases, pictures, and the page docs/gallery.md.

    python .ci/site/gallery.py                             # the rendered ones, and the page
    python .ci/site/gallery.py --real FOLDER --out OUT     # cases of your own copies of the recordings, into OUT
    python .ci/site/gallery.py --check                     # each case gives its verdict, each picture is there, ...

FOLDER holds the recordings under the names that the page tells, and yolov8n-seg.onnx and picodet.onnx. Pictures of
recordings are drawn from masks, boxes and edges of depth: no pixel of them is kept here. `--pictures` draws these anew,
and keeps what the tool said of them in `gallery.json`.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from pipeline.diagnosis.cards import cards_of
from pipeline.diagnosis.cases.replay import replay_case
from pipeline.diagnosis.cases.saving import OpenedCase, open_case, save_case
from pipeline.diagnosis.verdict import VERDICTS, shown_verdict
from pipeline.diagnosis.whatif.state import ViewState, decode, encode
from pipeline.geometry.frame import Frame
from pipeline.geometry.masks import decode_run_length
from pipeline.labels.reading import open_labels
from pipeline.pictures.answer_card import STAGE, answer_picture
from pipeline.system.errors import InputError
from pipeline.system.reading import parse_toml

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
DOCS = ROOT / "docs"
CASES, PICTURES, PAGE, TOLD = DOCS / "gallery", DOCS / "pictures", DOCS / "gallery.md", HERE / "gallery.json"
PLAN = parse_toml((HERE / "gallery.toml").read_text())
SETS, DETECTORS, FAILURES = PLAN["sets"], PLAN["detectors"], PLAN["case"]
MODELS = {"YOLO": "yolov8n-seg.onnx", "PICODET": "picodet.onnx"}
MOST_CASES, MOST_PICTURE = 3 * 2**20, 150 * 2**10
"""Bytes of all cases, and of a picture, at most."""
TILE = 480
"""Width of a tile, pixels."""
GROUND, EDGE, OUTLINE = 24, 120, (126, 140, 160)
"""Greys of a drawn recording: ground and edges of depth; colour of outlines of what is labelled."""
SPECK = 150
"""Parts of a mask that are smaller are not outlined, square pixels."""
SMOOTH, BENT = 1.5, 0.3
"""Depth is smoothed over so many pixels; where its inverse bends by so much of itself an edge is clearest."""


def real(case: Mapping[str, Any]) -> bool:
    """True for a case of a recording that is not part of the project."""
    return "folder" in SETS[case["set"]]


def run(*words: object) -> None:
    """Run a command of spatialviz."""
    done = subprocess.run(
        [sys.executable, "-m", "spatialviz", *map(str, words)], cwd=ROOT, capture_output=True, text=True
    )
    if done.returncode:
        raise SystemExit(f"spatialviz {' '.join(map(str, words))}\n{done.stdout}{done.stderr}")


class Maker:
    """Makes cases; rooms, labels and maps of a set are made once."""

    def __init__(self, work: Path, recordings: Path | None = None) -> None:
        self.work, self.recordings = work, recordings

    def options(self, words: list[str]) -> list[str]:
        """Options with the files of models in place of their names."""
        return [str((self.recordings or Path()) / MODELS[word]) if word in MODELS else word for word in words]

    def dataset(self, name: str) -> tuple[Path, list[str]]:
        """Folder of a set with its options; its labels and map lie beside it in `work`."""
        one, own = SETS[name], self.work / name
        camera = ["--intrinsics", one["camera"]] if "camera" in one else []
        folder = own / "rooms" if "seed" in one else (self.recordings or Path()) / one["folder"]
        if "seed" in one and not folder.is_dir():
            size = ["--width", 360, "--height", 270]
            run("render", folder, "--rooms", 6, "--views", 2, "--seed", one["seed"], *size)
        if not (own / "labels").is_dir():
            run("label", folder, *camera, *self.options(one.get("label", [])), "--out", own / "labels")
        return folder, camera

    def make(self, case: Mapping[str, Any], out: Path) -> None:
        """Write the folder of a case."""
        folder, camera = self.dataset(case["set"])
        own, options = self.work / case["set"], self.options(DETECTORS[case["detector"]]["options"])
        asked = [case["frame"], case["question"], "--out", out]
        if case["detector"] == "alone":
            run("detect", folder, *camera, *options, "--out", own / "found.json")
            answers(own / "found.json", own / "labels", own / "answers.jsonl")
            judged = ["--dataset", folder, *camera, "--labels", own / "labels", "--out", own / "run", "--overwrite"]
            run("import-run", own / "answers.jsonl", *judged)
            run("save-case", own / "run", *asked)
            return
        mapped = ["--map", own / "map"] if case.get("map") else []
        if mapped and not (own / "map").is_dir():
            run("map", folder, "--out", own / "map")
        run("save-case", folder, *asked, "--labels", own / "labels", *mapped, *camera, *options)
        if "words" in case:
            plain = open_case(out)
            assert plain.case is not None
            context, words = plain.context, case["words"]
            shutil.rmtree(out)
            save_case(out, plain.source, context, words, truth=plain.truth, case=replace(plain.case, text=words))


def answers(found: Path, labels: Path, out: Path) -> None:
    """Write predictions of a detector alone: for each question its surest box of the asked class."""
    frames = json.loads(found.read_text())["frames"]
    lines: list[dict[str, Any]] = [{"spatialviz_predictions": 1, "system": "PicoDet alone"}]
    for row in open_labels(labels).expressions.to_pylist():
        own = [thing for thing in frames[row["frame"]] if thing["label"] == row["target"]]
        best = max(own, key=lambda thing: thing["score"], default=None)
        told = {"answer": None, "problem": "nothing found"} if best is None else {"answer": {"box": best["bbox"]}}
        lines.append({"frame": row["frame"], "text": row["text"], **told})
    out.write_text("".join(f"{json.dumps(line)}\n" for line in lines))


def drawn(opened: OpenedCase) -> Frame:
    """Frame with a drawing in place of its picture, and without depth: edges of depth, and outlines of masks."""
    frame, truth = opened.context.frame, opened.truth
    seen = frame.depth > 0
    inverse = cv2.GaussianBlur(1 / np.where(seen, cv2.medianBlur(frame.depth, 5), np.inf).clip(0.2), (0, 0), SMOOTH)
    # Over a plane the inverse of the depth changes evenly: it bends at edges and creases.
    bend = np.abs(cv2.Laplacian(inverse, cv2.CV_32F, ksize=5)) / inverse.clip(0.05)
    strength = np.clip(bend / BENT - 0.4, 0, 1) * cv2.erode(seen.view(np.uint8), np.ones((7, 7)))
    image = np.clip(GROUND + (EDGE - GROUND) * strength, 0, 255).astype(np.uint8)[..., None].repeat(3, axis=2)
    masks = [] if truth is None else [decode_run_length(frame.depth.shape, code) for code in truth.masks if code]
    for mask in masks:
        whole = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, np.ones((7, 7)))
        lines, _ = cv2.findContours(whole, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
        cv2.drawContours(image, [line for line in lines if cv2.contourArea(line) > SPECK], -1, OUTLINE, 2, cv2.LINE_AA)
    nothing = np.zeros_like(frame.depth)
    nothing[0, 0] = 1  # A frame has some depth; a pixel alone is not drawn in 3D.
    return replace(frame, rgb=image, depth=nothing)


def pictured(case: Mapping[str, Any], opened: OpenedCase) -> np.ndarray:
    """Card of a case: (630, 1200, 3) uint8 RGB."""
    found, frame = opened.answer(), opened.context.frame
    if real(case):
        frame = drawn(opened)
        if found.trace is not None:
            found = replace(found, trace=replace(found.trace, frame=frame))
    return answer_picture(found, frame, SETS[case["set"]]["shown"])


def write_pictures(case: Mapping[str, Any], opened: OpenedCase) -> None:
    """Write card and tile."""
    card = pictured(case, opened)
    x, y, width, height = STAGE
    tile = cv2.resize(
        card[y : y + height, x : x + width], (TILE, round(TILE * height / width)), interpolation=cv2.INTER_AREA
    )
    for path, image in ((picture(case), card), (picture(case, "-tile"), tile)):
        image = np.ascontiguousarray(image[..., ::-1])
        path.write_bytes(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 88])[1].tobytes())


def picture(case: Mapping[str, Any], part: str = "") -> Path:
    return PICTURES / f"gallery-{case['name']}{part}.jpg"


def told(opened: OpenedCase) -> dict[str, Any]:
    """What the tool says of a case: verdict, head, sentence, what mends it, the answer and what it should be."""
    found = opened.answer()
    d, story = found.diagnosis, found.story
    detail = d.detail if d is not None else None if found.unseen is None else found.unseen.detail
    trace = found.trace

    def name(k: int) -> str:
        # Without its number, which is another in the page, where all objects of the frame are counted.
        return "" if trace is None else trace.objects[k].label

    cards = {c.kind: c for c in cards_of(trace, d or found.unjudged, next(iter(found.pairs), None), name)}
    sides = {
        kind: ", ".join(f"{o.name} ({o.note})" if o.note else o.name for o in card.objects)
        for kind, card in cards.items()
    }
    return {
        "question": found.text,
        "verdict": found.verdict,
        "code": shown_verdict(found.verdict or "", detail),
        "head": story.head,
        "sentence": story.sentence,
        "mend": story.mend,
        "answer": sides.get("answer", "nothing" if opened.manifest.shown is None else "one box"),
        "right": sides.get("right") or sides.get("label") or "",
        "by": "By the label" if "label" in cards else "Should be",
    }


def page(record: Mapping[str, Mapping[str, Any]]) -> str:
    """Page of the gallery."""
    tiles = [
        f"[![{record[c['name']]['head']}](pictures/{picture(c, '-tile').name})](#{anchor(record[c['name']]['head'])})"
        f"<br>**{record[c['name']]['head']}**<br>{record[c['name']]['verdict']} · {'real' if real(c) else 'rendered'}"
        for c in FAILURES
    ]
    rows = [f"| {' | '.join(tiles[k : k + 3])} |" for k in range(0, len(tiles), 3)]
    recordings = dict.fromkeys(c["set"] for c in FAILURES if real(c))
    had = "\n".join(f"| `{SETS[s]['folder']}` | {SETS[s]['had']} | {SETS[s]['truth']} |" for s in recordings)
    demo = "\n".join(
        f"- {row['verdict']}, “{row['question']}”:\n\n  ```sh\n  spatialviz view --state {state(row)}\n  ```\n"
        for row in PLAN["demo"]
    )
    return TEXT.format(
        rows="\n".join(rows),
        cases="\n".join(section(case, record[case["name"]]) for case in FAILURES),
        had=had,
        demo=demo,
    )


def state(row: Mapping[str, str]) -> str:
    return encode(ViewState("demo", row["frame"], row["question"]))


def anchor(head: str) -> str:
    return "".join(c for c in head.lower() if c.isalnum() or c in " -").replace(" ", "-")


def section(case: Mapping[str, Any], said: Mapping[str, Any]) -> str:
    """Text of a case."""
    command = f"spatialviz view docs/gallery/{case['name']}"
    block = f"```sh\n{command}\n```"
    if real(case):
        made = f"python .ci/site/gallery.py --real RECORDINGS --out OUT --only {case['name']}"
        reason = "<!-- not run: data -->"
        block = f"{reason}\n```sh\n{made}\nspatialviz view OUT/{case['name']}\n```"
    mend = f"\n**What would mend it.** {said['mend']}\n" if said["mend"] else ""
    told = {
        "Question": f"“{said['question']}”, in {SETS[case['set']]['shown']}",
        "Detector": DETECTORS[case["detector"]]["said"],
        "Answer": said["answer"],
        said["by"]: said["right"],
        "Verdict": f"[{said['code']}](verdicts.md)",
    }
    facts = "\n".join(f"- **{name}:** {value}" for name, value in told.items() if value)
    return f"""## {said["head"]}

![“{said["question"]}”: {said["sentence"]}](pictures/{picture(case).name})

{facts}

> {said["sentence"]}

{" ".join(case["text"].split())}
{mend}
{block}
"""


TEXT = """# Gallery

Twelve wrong answers, one for each verdict, so that you know what a failure looks like and where to look first.
Each is a saved *case*: a folder with the picture, the depth, what the detector found, the question, the answer and what
is true.

| | | |
|---|---|---|
{rows}

Seven are of rendered rooms and stand in the repository. One command opens one in the page, as it was answered:

```sh
spatialviz view docs/gallery/table-box-off
```

*Try it* makes the smallest change that would mend the answer. `spatialviz replay docs/gallery` runs them all again,
and `spatialviz report docs/gallery/table-box-off --out OUT/report.html` writes one as a file to send.

Five are of real recordings. These are not ours to pass on: their pictures here are drawn from masks, boxes and edges
of depth, without a pixel of the photograph. [With your own copy](#recordings) two commands make and open the case.

{cases}
## Recordings

Put the recordings into one folder, here `RECORDINGS`, under these names, with `yolov8n-seg.onnx` (your own export:
`yolo export model=yolov8n-seg.pt format=onnx imgsz=480,640`) and `picodet.onnx` (PicoDet-S 416 of COCO;
`spatialviz models` tells where it is).

| folder | where it is had | what is true, by |
|---|---|---|
{had}

Labels that a detector made are only as good as that detector. They serve here to show what is said of an answer, and
measure nothing.

## Without the repository

The built-in demo has a run with nearly every verdict. These open a failure of it on any installation:

{demo}"""


def remake(real_from: Path | None, out: Path, only: str | None, pictures: bool, work: Path | None) -> None:
    """Make the cases, and with `pictures` their pictures and the page."""
    record = json.loads(TOLD.read_text()) if TOLD.is_file() else {}
    with tempfile.TemporaryDirectory() as own:
        maker = Maker(work or Path(own), real_from)
        for case in FAILURES:
            if real(case) != (real_from is not None) or only not in (None, case["name"]):
                continue
            made, kept = Path(own) / "cases" / case["name"], out / case["name"]
            maker.make(case, made)
            if not (kept.is_dir() and same(made, kept)):
                shutil.rmtree(kept, ignore_errors=True)
                shutil.copytree(made, kept)
            opened = open_case(kept)
            record[case["name"]] = told(opened)
            print(f"{record[case['name']]['code']:24} {kept}", flush=True)
            if pictures:
                write_pictures(case, opened)
    if pictures:
        names = [case["name"] for case in FAILURES]
        TOLD.write_text(json.dumps({n: record[n] for n in names if n in record}, ensure_ascii=False, indent=1) + "\n")
        if set(names) <= record.keys():
            PAGE.write_text(page(record))


def same(made: Path, kept: Path) -> bool:
    """True for cases that differ in the day of their making at most."""
    names = [sorted(file.name for file in folder.iterdir()) for folder in (made, kept)]
    return names[0] == names[1] and all(content(made / name) == content(kept / name) for name in names[0])


def content(path: Path) -> Any:
    if path.suffix != ".json":
        return path.read_bytes()
    read = json.loads(path.read_text())
    if path.name == "spatialviz-case.json":
        del read["created"]
        read["expected"].pop("timings_ms", None)
    return read


def check() -> list[str]:
    """What is wrong with the gallery as it stands."""
    wrong: list[str] = []
    record = json.loads(TOLD.read_text())
    if missing := set(VERDICTS) - {"CORRECT"} - {said["verdict"] for said in record.values()}:
        wrong.append(f"no case shows {', '.join(sorted(missing))}")
    if (kept := {path.name for path in CASES.iterdir()}) != {case["name"] for case in FAILURES if not real(case)}:
        wrong.append(f"docs/gallery holds other cases than gallery.toml: {', '.join(sorted(kept))}")
    if sum(file.stat().st_size for file in CASES.rglob("*") if file.is_file()) > MOST_CASES:
        wrong.append("docs/gallery is too large")
    for case in FAILURES:
        for path in (picture(case), picture(case, "-tile")):
            if not path.is_file() or path.stat().st_size > MOST_PICTURE:
                wrong.append(f"{path.name} is missing or too large")
        if real(case):
            continue
        try:
            opened = open_case(CASES / case["name"])
            wrong += [f"{case['name']}: {change}" for change in (*opened.notes, *replay_case(opened).changes)]
            if told(opened) != record[case["name"]]:
                wrong.append(f"{case['name']}: the page says something else than the tool")
        except InputError as error:
            wrong.append(f"{case['name']}: {error}")
    if PAGE.read_text() != page(record):
        wrong.append("docs/gallery.md is not what the script makes of gallery.toml and gallery.json")
    wrong += [f"demo: {problem}" for row in PLAN["demo"] if (problem := wrong_in_demo(row))]
    return wrong


def wrong_in_demo(row: Mapping[str, str]) -> str:
    """Why a failure of the demo's run does not have the verdict that the page tells; "" where it does."""
    from pipeline.datasets.demo import demo_run
    from pipeline.evaluation.run_folder import open_run

    view = decode(state(row))
    found = [
        f.verdict
        for f in open_run(demo_run()).failures()
        if (f.row["frame"], f.row["text"]) == (view.frame, view.expression)
    ]
    return "" if found == [row["verdict"]] else f"{view.expression} is {found}, not {row['verdict']}"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--real", type=Path, metavar="FOLDER", help="recordings and models: make the real cases")
    parser.add_argument("--out", type=Path, default=CASES, help="folder for the real cases")
    parser.add_argument("--only", help="name of one case")
    parser.add_argument("--pictures", action="store_true", help="with --real: draw their pictures for the page, too")
    parser.add_argument("--work", type=Path, help="folder in which rooms and labels are kept for the next time")
    parser.add_argument("--check", action="store_true", help="check what is there")
    given = parser.parse_args()
    if given.check:
        for line in (wrong := check()):
            print(line)
        return 1 if wrong else 0
    if given.real is not None and given.out == CASES:
        parser.error("--real needs --out: recordings are not kept in the project")
    given.out.mkdir(parents=True, exist_ok=True)
    PICTURES.mkdir(parents=True, exist_ok=True)
    remake(given.real, given.out, given.only, given.real is None or given.pictures, given.work)
    return 0


if __name__ == "__main__":
    sys.exit(main())
