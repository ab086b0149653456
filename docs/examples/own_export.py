"""An export of your own: the labels as lines "subject, relation, object", for a knowledge graph.

Name it in your package's pyproject.toml, and `spatialviz export LABELS --format triples --out FOLDER` is there:

    [project.entry-points."spatialviz.exports"]
    triples = "own_export:FORMAT"
"""

import csv
import subprocess
import sys
from typing import Any

import spatialviz as sp


def write(job: Any) -> sp.Written:
    """`job` holds the labels, the folder to write into, and a function to tell progress."""
    labels: sp.Labels = job.labels
    names = {(row["frame"], row["object"]): row["label"] for row in labels.objects.to_pylist()}
    count = 0
    with (job.folder / "triples.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["frame", "subject", "relation", "object"])
        for row in labels.relations.to_pylist():
            ends = [f"{names[row['frame'], row[end]]}-{row[end]}" for end in ("a", "b")]
            for relation in labels.relation_names:
                if row[relation] == 1:  # T; 0 is too close to call, -1 does not hold, None is not judged.
                    writer.writerow([row["frame"], ends[0], relation, ends[1]])
                    count += 1
    return sp.Written(("triples.csv",), {"triples": count})


FORMAT = sp.ExportFormat(write, None, "relations that hold, one a line", lossless=False)

if __name__ == "__main__":
    labels = sp.label("demo", "export_labels", limit=2)
    print(labels)
    command = ["spatialviz", "export", "export_labels", "--format", "triples", "--out", "triples"]
    sys.exit(subprocess.run(command, check=False).returncode)
