"""What others made is opened by `pipeline/system/safe_files.py` alone; its limits are the documented ones."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path

from pipeline.system.limits import Limits, shown

ROOT = Path(__file__).resolve().parent.parent
DOOR = "system/safe_files.py"
OPENERS = {
    "open",
    "os.open",
    "io.open",
    "gzip.open",
    "bz2.open",
    "lzma.open",
    "tarfile.open",
    "mmap.mmap",
    "np.load",
    "np.fromfile",
    "np.memmap",
    "np.loadtxt",
    "np.genfromtxt",
    "pickle.load",
    "json.load",
    "json.loads",
    "cv2.imread",
    "cv2.VideoCapture",
    "cv2.FileStorage",
    "Image.open",
    "OpenEXR.File",
    "h5py.File",
    "trimesh.load",
    "pq.read_table",
    "pq.read_schema",
    "pq.read_metadata",
    "pq.ParquetFile",
    "ParquetFile",
    "ZipFile",
    "zipfile.ZipFile",
    "tomllib.load",
    "tomllib.loads",
    "ort.InferenceSession",
    "onnx.load",
}
LAST = {name.rpartition(".")[2] for name in OPENERS} | {"read_bytes", "read_text"}
MAYBE = re.compile(rf"\b({'|'.join(LAST)})\(")
METHODS = {"read_bytes", "read_text"}
"""Of paths; a file of an archive or a table has them too, and functions of the same names are fine."""
HANDED = {
    "datasets/semantic_abstraction.py h5py.File": "a checked path",
    "datasets/images.py Image.open": "an opened file",
    "datasets/images.py OpenEXR.File": "checked bytes stand there",
    "datasets/video.py cv2.VideoCapture": "a checked path",
    "language/vectors.py gzip.open": "an opened file, unpacked line by line",
    "system/onnx_contents.py mmap.mmap": "an opened file",
    "system/onnx_session.py ort.InferenceSession": "a checked path",
    "system/reading.py tomllib.loads": "text that was read",
}
"""What gets its content from the door, and why it has a name of `OPENERS`."""
OWN = {
    "answering/predictions.py open": "written to",
    "bench/": "what was made for it, /proc, documents of a checkout",
    "corrections/journal/": "the journal, which has checks of its own",
    "datasets/depth/estimator.py np.load": "the cache",
    "diagnosis/story_words.py": "comes with the program",
    "diagnosis/whatif/changes.py": "keys that were made here",
    "evaluation/importing.py .open": "written to",
    "evaluation/exporting.py json.loads": "settings that were made here",
    "evaluation/job.py json.loads": "options that were made here",
    "labels/merge.py open": "a table that was just written",
    "labels/reading.py open": "a table that was just written",
    "language/class_sizes.py": "comes with the program",
    "language/glossary.py": "comes with the program",
    "proposals/cache.py": "the cache",
    "system/contents.py": "bytes that are hashed and never decoded, and the cache",
    "system/lazy_exports.py": "comes with the program",
    "system/model_files.py": "the cache, and a table that comes with the program",
    "system/remote.py": "the cache",
    "system/sql.py": "what its parent says, /dev/null and /proc",
    "system/whole_files.py": "writes",
}
"""What opens what was written here."""


def called(node: ast.Call) -> str:
    """ "np.load" of np.load(...), "open" of open(...), ".read_bytes" of anything.read_bytes()."""
    last = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
    if last not in LAST:
        return ""
    name = ast.unparse(node.func)
    if name in OPENERS:
        return name
    if isinstance(node.func, ast.Attribute) and node.func.attr in METHODS:
        return "" if name.split(".")[0] in ("safe_files", "self", "store") else f".{node.func.attr}"
    if isinstance(node.func, ast.Attribute) and node.func.attr == "open" and name.split(".")[0] in ("path", "file"):
        return ".open"
    return ""


def opening(folder: Path) -> Iterator[tuple[str, str]]:
    """Calls that open something: "datasets/x.py np.load", and the line."""
    for path in sorted(folder.rglob("*.py")):
        where, text = path.relative_to(folder).as_posix(), path.read_text(encoding="utf-8")
        if not MAYBE.search(text):
            continue
        tree = ast.parse(text)
        own = {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}
        for node in ast.walk(tree):
            if isinstance(node, ast.Call) and (name := called(node)) and name not in own and where != DOOR:
                yield f"{where} {name}", f"{where}:{node.lineno} {name}"


def test_no_other_module_opens_what_others_made() -> None:
    excused = (*HANDED, *OWN)
    found = list(opening(ROOT / "pipeline"))
    assert not [line for where, line in found if not where.startswith(excused)]
    assert not [e for e in excused if not any(where.startswith(e) for where, _ in found)], "excused for nothing"


def test_the_walk_sees_openings(tmp_path: Path) -> None:
    (tmp_path / "x.py").write_text("a = path.read_bytes()\nnp.load(a)\nwith open(a) as f: pass\nread_bytes(a)\n")
    assert [line for _, line in opening(tmp_path)] == ["x.py:1 .read_bytes", "x.py:2 np.load", "x.py:3 open"]


def test_the_documented_limits_are_those_in_force() -> None:
    text = (ROOT / "docs" / "limits.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `(\w+)` \| (\S+) \| (.*?) \| (yes|) ?\|$", text, re.MULTILINE)
    assert rows == [
        (f.name, shown(getattr(Limits(), f.name)), f.metadata["meaning"], "yes" if f.metadata["own"] else "")
        for f in fields(Limits)
    ]
