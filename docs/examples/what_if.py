"""A what-if: what the answer would be if a thing stood elsewhere, were not found, or were judged otherwise.

Edits are those of `spatialviz whatif --edits`. Objects are named by the detector's own number, "#7"; where it has none,
"mug/2" is the second best mug.
"""

from typing import Any

import numpy as np

import spatialviz as sp

FORMAT = {"format": "spatialviz-edits-1"}


def main() -> None:
    answer = sp.open("demo").ask(0, "mug left of the laptop")
    target, reference = answer.target, answer.reference
    assert target is not None
    assert reference is not None
    assert target.box is not None
    box, mug, laptop = target.box, f"#{target.id}", f"#{reference.id}"
    moved = {"center": (box.center + np.array([1.0, 0, 0])).tolist(), "R": box.R.tolist(), "size": box.size.tolist()}
    changes: dict[str, dict[str, Any]] = {
        "a metre to the right": {"boxes": {mug: moved}},
        "not found": {"hidden": [mug]},
        "by the bare rule": {"scorer": "rule"},
        "by a doubting network": {"relations": [{"relation": "left", "a": mug, "b": laptop, "p": 0.4}]},
    }
    print(f"as it is: {answer.sentence} ({answer.verdict})")
    for name, edits in changes.items():
        after = answer.what_if(FORMAT | edits)
        print(f"{name}: {after.sentence} ({after.verdict})")


if __name__ == "__main__":
    main()
