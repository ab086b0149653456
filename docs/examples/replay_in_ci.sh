#!/usr/bin/env bash
# A replay in CI: failures that were mended are kept as cases, and a change that brings one back fails the build.
#
# In GitHub Actions, with the cases in the repository:
#   - run: pip install spatialviz
#   - run: spatialviz replay cases
# or the action of this repository, which also says which module regressed (docs/agents.md).
set -euo pipefail

# Kept once, by a person (`Save case` in the page does the same).
spatialviz save-case demo 0 "mug left of the laptop" --out cases/mug
spatialviz save-case demo 0 "mug left of the laptop" --detector simulated --out cases/mug-simulated

# On each change: status 0, nothing has changed.
spatialviz replay cases
echo "unchanged: status $?"

# A change that alters a verdict fails it; here the case expects another one, which comes to the same.
python - << 'PYTHON'
from pathlib import Path

file = Path("cases/mug/spatialviz-case.json")
file.write_text(file.read_text(encoding="utf-8").replace('"verdict": "CORRECT"', '"verdict": "SRM"'), encoding="utf-8")
PYTHON
status=0
spatialviz replay cases || status=$?
echo "changed: status $status"
