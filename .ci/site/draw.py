"""Draw the pictures of the documents into `docs/pictures`; `--check` says whether they are those that the code draws.

python .ci/site/draw.py [--check] [NAME ...]
"""

from __future__ import annotations

import base64
import re
import sys
from importlib import import_module
from pathlib import Path

import cv2
import numpy as np

FOLDER = Path(__file__).resolve().parents[2] / "docs" / "pictures"
MODULES = ("concept_pictures", "relation_pictures", "verdict_pictures")
# Not a part of a colour or of an id.
NUMBER = re.compile(r"(?<![#0-9a-fA-F.])-?\d+(?:\.\d+)?")
JPEG = re.compile(r"data:image/jpeg;base64,([\w+/=]+)")


def same(ours: str, theirs: str) -> bool:
    """Compare two pictures: words, colours and shapes to the letter, lengths to two pixels, photographs to the eye.

    Another machine rounds differently, measures a letter a little wider, and compresses with another library.
    """
    photos = [JPEG.findall(text) for text in (ours, theirs)]
    texts = [JPEG.sub("", text) for text in (ours, theirs)]
    if NUMBER.sub("#", texts[0]) != NUMBER.sub("#", texts[1]) or len(photos[0]) != len(photos[1]):
        return False
    lengths = [np.array(NUMBER.findall(text), float) for text in texts]
    return np.abs(lengths[0] - lengths[1]).max(initial=0) <= 2 and all(map(alike, *photos))


def alike(ours: str, theirs: str) -> bool:
    """Compare two photographs, JPEG in base64."""
    a, b = (cv2.imdecode(np.frombuffer(base64.b64decode(p), np.uint8), cv2.IMREAD_COLOR) for p in (ours, theirs))
    return a.shape == b.shape and float(np.abs(a.astype(float) - b).mean()) < 2


def main(arguments: list[str]) -> int:
    check, names = "--check" in arguments, [a for a in arguments if not a.startswith("-")]
    wrong = []
    for module in MODULES:
        for name, draw in import_module(module).PICTURES.items():
            if names and not any(name.startswith(asked) for asked in names):
                continue
            file, text = FOLDER / f"{name}.svg", draw().svg()
            if not check:
                file.write_text(text, "utf-8")
                print(f"{file.name}: {len(text) / 1024:.0f} KB")
            elif not file.is_file() or not same(text, file.read_text("utf-8")):
                wrong.append(file.name)
    if wrong:
        print(f"not as drawn now: {', '.join(wrong)}; python .ci/site/draw.py draws them", file=sys.stderr)
    return 1 if wrong else 0


if __name__ == "__main__":
    FOLDER.mkdir(exist_ok=True)
    sys.exit(main(sys.argv[1:]))
