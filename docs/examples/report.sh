#!/usr/bin/env bash
# A report: one answer kept as a case, and as one HTML file with the picture, the scene in 3D and every table.
set -euo pipefail

spatialviz save-case demo 0 "mug left of the laptop" --detector simulated --out case
spatialviz report case --out report.html
spatialviz ask demo 0 "mug left of the laptop" --save answer.png

# The page loads nothing from anywhere: it can be mailed, or kept as an artefact of a build.
if grep -oE '(src|href)="https?://[^"]*"' report.html; then
  echo "the report loads something"
  exit 1
fi
echo "report.html: $(wc -c < report.html) bytes, answer.png: $(wc -c < answer.png) bytes"
