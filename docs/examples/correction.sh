#!/usr/bin/env bash
# A correction: a person finds a relation wrong; the journal keeps who, when and why, and the labels stay as they were.
set -euo pipefail

spatialviz label demo --out labels --limit 3 > /dev/null

# A relation whose state was too close to call, as the labels have it.
python - > fixes.json << 'PYTHON'
import json
import spatialviz as sp

row = next(r for r in sp.open_labels("labels").relations.to_pylist() if r["above"] == 0)
edit = {"edit": "relation", "frame": row["frame"], "a": row["a"], "b": row["b"], "relation": "above"}
print(json.dumps([{**edit, "to": "T", "reason": "looked at it"}]))
PYTHON

spatialviz correct labels --edits fixes.json --author ann
spatialviz journal labels
spatialviz undo labels --author ann
spatialviz redo labels --author ann

# Labels with the corrections, for eval, train, check and export; the automatic ones are not touched.
spatialviz effective labels --out mended > /dev/null
python - << 'PYTHON'
import json
import spatialviz as sp

edit = json.load(open("fixes.json"))[0]
for name in ("labels", "mended"):
    rows = sp.open_labels(name).relations.to_pylist()
    state = next(r["above"] for r in rows if (r["frame"], r["a"], r["b"]) == (edit["frame"], edit["a"], edit["b"]))
    print(f"{name}: above = {state}")
PYTHON
