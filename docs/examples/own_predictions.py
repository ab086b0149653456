"""A format of predictions of your own: what your pipeline writes already, as `docs/predictions.md` has it. Here lines
such as "000001/000000; mug left of the laptop; 312 208".

Name it in your package's pyproject.toml, and `spatialviz import-run FILE --format points` is there:

    [project.entry-points."spatialviz.predictions"]
    points = "own_predictions:FORMAT"
"""

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import spatialviz as sp


def read(published: Any) -> tuple[dict[str, Any], Iterator[dict[str, Any]]]:
    """`published` has the path, the dataset, and functions that find the frame of a picture and the labels' words."""

    def lines() -> Iterator[dict[str, Any]]:
        for number, line in enumerate(published.path.read_text(encoding="utf-8").splitlines(), 1):
            picture, question, place = line.split("; ")
            frame = published.frame(picture, f"line {number}")
            if frame is None:  # The dataset does not hold the picture; import-run counts such lines.
                continue
            point = [float(value) for value in place.split()]
            yield {"frame": frame, "text": published.text(frame, [question]), "answer": {"point": point}}

    return {"system": "middle of the picture", "box_unit": "pixels"}, lines()


# The file does not say what it is, so that it is never taken for this format unless --format names it.
FORMAT = sp.PredictionFormat(read, lambda content: False, "frame; question; u v", level=0)

if __name__ == "__main__":
    labels = sp.label("demo", "point_labels", limit=1)
    rows = labels.expressions.to_pylist()
    Path("points.txt").write_text("".join(f"{row['frame']}; {row['text']}; 320 240\n" for row in rows))
    command = ["spatialviz", "import-run", "points.txt", "--format", "points", "--dataset", "demo", "--labels"]
    sys.exit(subprocess.run([*command, "point_labels", "--out", "point_run", "--no-plots"], check=False).returncode)
