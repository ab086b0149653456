"""What is fuzzed: for each reader a valid seed, made by the tests' own writers, and the command that reads it."""

from __future__ import annotations

import json
import random
import shutil
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from app_writers import truths, write_polycam, write_replica, write_scannetpp, write_stray
from dataset_writers import write_folder, write_nerfstudio
from every_format import WRITERS
from mutate import GRAMMARS, as_json, mutated
from world import FRAME, QUESTION, World

from pipeline.diagnosis import decode
from pipeline.diagnosis.whatif.edits import read_edits
from pipeline.language.vectors import open_vectors

FLAT = ("--intrinsics", "60,60,32,24", "--depth-scale", "1000")
FIXTURES = Path(__file__).resolve().parents[2] / "tests" / "fixtures" / "2026-11-26"


@dataclass(frozen=True)
class FileKind:
    """A folder with valid files, of which one to three are harmed, and the words that read it.

    `commands`: words, in which "{}" is the folder, of which one line is taken. `call`: in place of a command.
    """

    folder: Path
    commands: tuple[tuple[str, ...], ...] = ()
    harmed: str = "*"
    call: Callable[[Path], object] | None = None


@dataclass(frozen=True)
class TextKind:
    """Valid texts, how another is made of one, and what reads it: words of a command, with "{}" for it, or a call."""

    texts: Sequence[str]
    change: Callable[[str, random.Random], str]
    command: tuple[str, ...] = ()
    call: Callable[[str], object] | None = None


def _pictures(folder: Path) -> dict[str, Path]:
    """The same recording with its pictures in each format that is read."""
    import cv2

    made = {}
    for ending in (".png", ".jpg", ".tiff", ".bmp", ".webp"):
        root = folder / ending[1:]
        write_folder(root, [1, 2])
        for file in sorted((root / "rgb").iterdir()):
            image: Any = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
            file.unlink()
            cv2.imwrite(str(file.with_suffix(ending)), image)
        made[ending[1:]] = root
    with suppress(ImportError):
        import OpenEXR  # type: ignore[import-not-found]

        root = made["exr"] = folder / "exr"
        write_folder(root, [1, 2])
        for file in sorted((root / "depth").iterdir()):
            depth = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
            assert depth is not None
            file.unlink()
            header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
            with OpenEXR.File(header, {"Z": depth.astype(np.float32) / 1000}) as image:
                image.write(str(file.with_suffix(".exr")))
    return made


def _captures(folder: Path) -> Iterator[tuple[str, Path]]:
    """ROS captures, where the library that writes them is there."""
    with suppress(ImportError):
        from test_ros_streams import COLOR, DEPTH, Recorder

        for ending in (".bag", ".mcap", ".db3"):
            root = folder / f"ros{ending}"
            root.mkdir()
            recorder = Recorder(root, ending)
            for number, truth in enumerate(truths(2)):
                recorder.camera("/camera/color/camera_info", float(number))
                recorder.image(COLOR, float(number), truth.rgb[..., ::-1], "bgr8")
                recorder.image(DEPTH, number + 0.003, truth.millimetres, "16UC1")
            recorder.writer.close()
            yield f"ros{ending}", root


def _datasets(folder: Path) -> Iterator[tuple[str, Path]]:
    for name, write in WRITERS.items():
        root = folder / name
        root.mkdir()
        with suppress(ImportError):
            write(root)
            yield name, root
    made: dict[str, Callable[[Path], object]] = {
        "nerfstudio": write_nerfstudio,
        "stray": lambda root: write_stray(root, truths(2), packed=False),
        "polycam": lambda root: write_polycam(root, truths(2), corrected=True),
        "scannetpp": lambda root: write_scannetpp(root, truths(2), "colmap"),
        "replica": lambda root: write_replica(root, truths(2), 6553.5),
    }
    for name, write in made.items():
        root = folder / name
        root.mkdir()
        with suppress(Exception):  # A writer's own wishes are not what is tested here.
            write(root)
            yield name, root


READ = (("frames", "{}"), ("frames", "{}", "--json"), ("ask", "{}", "0", QUESTION), ("doctor", "{}"))
FLAT_READ = tuple((*words, *FLAT) for words in READ)


def kinds(world: World, home: Path) -> dict[str, FileKind | TextKind]:
    """All of them, with their seeds made."""
    seeds = home / "seeds"
    seeds.mkdir()
    found: dict[str, FileKind | TextKind] = {}
    for name, root in (*_datasets(seeds), *_captures(seeds)):
        found[f"dataset-{name}"] = FileKind(root, READ)
    for name, root in _pictures(seeds / "pictures").items():
        found[f"picture-{name}"] = FileKind(root, FLAT_READ, f"*.{name}")
    settled = seeds / "settings"
    write_folder(settled, [1])
    shutil.copy(FIXTURES / "settings" / "spatialviz.toml", settled)
    found["toml"] = FileKind(settled, READ, "*.toml")
    # What the commands themselves write, and read again.
    labels, run = seeds / "labels", seeds / "run"
    shutil.copytree(world.labels, labels, ignore=shutil.ignore_patterns("parts"))
    shutil.copytree(world.run, run)
    found["labels"] = FileKind(
        labels, (("check", "{}"), ("show", "{}", FRAME), ("export", "{}", "--format", "coco", "--out", "{}/out"))
    )
    found["run"] = FileKind(
        run, (("failures", "{}"), ("failures", "{}", "--json"), ("query", "{}", "select count(*) from records"))
    )
    found["case"] = FileKind(FIXTURES / "case", (("replay", "{}"),))
    found["case-imported"] = FileKind(FIXTURES / "case_imported", (("replay", "{}"),))
    found["journal"] = FileKind(FIXTURES / "labels", (("journal", "{}"), ("journal", "{}", "--json")), "journal*")
    found["coco"] = FileKind(
        world.coco,
        (("import", str(world.labels), "{}/instances.json", "--author", "x", "--dry-run"),),
        "instances.json",
    )
    found |= _made_of_one_file(world, seeds)
    found |= _texts(world)
    return found


def _made_of_one_file(world: World, seeds: Path) -> dict[str, FileKind | TextKind]:
    one = seeds / "one"
    one.mkdir()
    world.commands.run("detect", world.dataset, "--detector", "simulated", "--out", one / "found.json").well(0)
    world.commands.run("detect", world.dataset, "--detector", "simulated", "--out", seeds / "npz").well(0)
    shutil.copy(FIXTURES / "imported" / "predictions.jsonl", one)
    shutil.copy(FIXTURES / "case" / "relations.onnx", one)
    shutil.copy(world.edits, one / "edits.json")
    shutil.copy(FIXTURES / "simulated.toml", one)
    vectors = {"mug": [0.5, 1.0, 0.0], "desk lamp": [1.0, 0.25, 0.125]}
    (one / "words.vec").write_text(
        "2 3\n" + "\n".join(f"{w.replace(' ', '_')} {' '.join(map(str, v))}" for w, v in vectors.items())
    )
    np.savez(
        one / "words.npz",
        words=np.array(list(vectors)),
        vectors=np.array(list(vectors.values()), np.float32),
        kind="word",
    )
    mesh = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
    mesh += "element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"
    scene = seeds / "ply"
    write_folder(scene, [1, 2])
    (scene / "mesh.ply").write_text(mesh)
    demo = str(world.dataset)
    ask = ("ask", demo, "0", QUESTION)
    return {
        "detections": FileKind(one, ((*ask, "--detector", "recorded", "--model", "{}/found.json"),), "found.json"),
        "detections-npz": FileKind(seeds / "npz", ((*ask, "--detector", "recorded", "--model", "{}"),)),
        "simulated": FileKind(
            one, ((*ask, "--detector", "simulated", "--model", "{}/simulated.toml"),), "simulated.toml"
        ),
        "predictions": FileKind(
            one,
            (
                (
                    "import-run",
                    "{}/predictions.jsonl",
                    "--dataset",
                    demo,
                    "--labels",
                    str(world.labels),
                    "--out",
                    "{}/out",
                    "--no-plots",
                ),
            ),
            "predictions.jsonl",
        ),
        "onnx": FileKind(
            one, (("models", "{}/relations.onnx"), (*ask, "--srm", "{}/relations.onnx")), "relations.onnx"
        ),
        "edits": FileKind(
            one,
            (("correct", str(world.labels), "--edits", "{}/edits.json", "--author", "x", "--journal", "{}/j.sqlite"),),
            "edits.json",
        ),
        "ply": FileKind(scene, (("frames", "{}", *FLAT), ("ask", "{}", "0", QUESTION, *FLAT)), "*.ply"),
        "vec": FileKind(one, call=lambda folder: open_vectors(folder / "words.vec"), harmed="words.vec"),
        "vectors-npz": FileKind(one, call=lambda folder: open_vectors(folder / "words.npz"), harmed="words.npz"),
    }


def _texts(world: World) -> dict[str, FileKind | TextKind]:
    whatif = json.loads((FIXTURES / "whatif.json").read_text())
    views = [json.dumps({"source": "demo", "frame": FRAME, "expression": QUESTION, "edits": {"scores": {"1": 0.5}}})]
    calls = [
        json.dumps(call)
        for call in (
            {"tool": "ask", "arguments": {"source": "data", "frame": 0, "expression": QUESTION}},
            {"tool": "why", "arguments": {"run": "run", "id": "x"}},
            {"tool": "query", "arguments": {"run": "run", "sql": "select * from records limit 3"}},
            {"tool": "failures", "arguments": {"run": "run", "search": "verdict:LIFT"}},
            {"tool": "contents", "arguments": {"source": "data", "limit": 3, "offset": 0}},
            {"tool": "whatif", "arguments": {"frame": 0, "expression": QUESTION, "edits": {}}},
        )
    ]
    return {
        "expression": TextKind([QUESTION], GRAMMARS["sentence"], ("ask", str(world.dataset), "0", "{}")),
        "query": TextKind(
            ["select verdict, count(*) from records group by verdict"],
            GRAMMARS["query"],
            ("query", str(world.run), "{}", "--limits", "query=200M,query_seconds=5"),
        ),
        "search": TextKind(
            ["verdict:OPM-CONF relation:left"], GRAMMARS["sentence"], ("failures", str(world.run), "{}")
        ),
        "view": TextKind(views, GRAMMARS["view"], call=decode),
        "whatif-edits": TextKind([json.dumps(whatif)], as_json, call=read_edits),
        "mcp": TextKind(calls, as_json, call=_Agent(world)),
    }


class _Agent:
    """Calls of tools, without their transport; the session is opened when it is first used."""

    def __init__(self, world: World) -> None:
        self._world = world
        self._session: Any = None

    def __call__(self, text: str) -> None:
        from spatialviz.agent_server import call
        from spatialviz.agent_verbs import VERBS
        from spatialviz.cli_runs import McpCommand
        from spatialviz.run_mcp import open_session

        if self._session is None:
            paths = (str(self._world.dataset), str(self._world.run))
            self._session = open_session(McpCommand(paths=paths), ExitStack())
        asked = json.loads(text, parse_constant=lambda _: 0)
        if isinstance(asked, dict) and isinstance(asked.get("arguments", {}), dict):
            answer = call(self._session, dict(VERBS), str(asked.get("tool")), asked.get("arguments", {}))
            said = str(answer.content[0])
            assert "internal error" not in said, said


def harmed_copy(kind: FileKind, folder: Path, rng: random.Random) -> list[str]:
    """A copy of the seed with one to three files harmed; their names."""
    shutil.copytree(kind.folder, folder)
    files = sorted(f for f in folder.rglob(kind.harmed) if f.is_file())
    names, other = [], rng.choice(files).read_bytes()
    for file in rng.sample(files, min(len(files), rng.choice((1, 1, 1, 2, 3)))):
        names.append(str(file.relative_to(folder)))
        if rng.random() < 0.03:
            file.unlink()
            if to := rng.choice(("/etc/passwd", file.name, "")):
                file.symlink_to(to)
            else:
                file.mkdir()
            continue
        file.write_bytes(mutated(file.name, file.read_bytes(), rng, other))
    return names


def scratch(home: Path) -> Path:
    """A folder for one input."""
    return Path(tempfile.mkdtemp(prefix="input-", dir=home)) / "data"
