"""A batch on a cluster: the same labels by Ray (extra `cluster`), or by an array of jobs that share a folder.

Ray starts on this machine where RAY_ADDRESS names no cluster. `--shard k/N` needs no engine at all: it is what a SLURM
or a Kubernetes array calls, and the last task, or anyone after, merges.
"""

import os
import subprocess

import spatialviz as sp

TASKS = 3


def tables(labels: sp.Labels) -> dict[str, str]:
    return {name: entry.content_hash for name, entry in labels.manifest.tables.items()}


def array_of_jobs(out: str) -> sp.Labels:
    """What `sbatch --array=1-3 --wrap 'spatialviz label demo --out OUT --shard $SLURM_ARRAY_TASK_ID/3'` does."""
    for task in range(1, TASKS + 1):
        command = ["spatialviz", "label", "demo", "--out", out, "--shard", f"{task}/{TASKS}", "--workers", "1"]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    subprocess.run(["spatialviz", "merge", out], check=True, stdout=subprocess.DEVNULL)
    return sp.open_labels(out)


def main() -> None:
    one = sp.label("demo", "one_process")
    print(one)
    print("array of jobs gives the same rows:", tables(array_of_jobs("by_array")) == tables(one))
    if os.environ.get("WITHOUT_RAY"):
        return
    by_ray = sp.label("demo", "by_ray", engine="ray", workers=2)
    print("ray gives the same rows:", tables(by_ray) == tables(one))


if __name__ == "__main__":
    main()
