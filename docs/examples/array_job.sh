#!/usr/bin/env bash
#SBATCH --job-name=label
#SBATCH --array=1-4
#SBATCH --cpus-per-task=2
#SBATCH --time=04:00:00
#SBATCH --requeue
# An array of tasks that label one dataset into one folder or bucket; the last job of it merges. `bash array_job.sh`
# hands both to SLURM where it is, else it runs the tasks one after the other. DATASET and LABELS may be URLs:
#   DATASET=s3://bucket/rooms LABELS=s3://bucket/labels bash array_job.sh
set -euo pipefail
export DATASET=${DATASET:-demo} LABELS=${LABELS:-labels}
TASKS=${SLURM_ARRAY_TASK_COUNT:-4}
PAUSE=${PAUSE:-30} # seconds before a task is tried again

label() { # label K: the shards of task K, each whole or not there
  spatialviz label "$DATASET" --out "$LABELS" --shard "$1/$TASKS" --workers "${SLURM_CPUS_PER_TASK:-1}"
}

task() { # task K: up to three tries; what an earlier one finished is kept
  local try
  for try in 1 2 3; do
    label "$1" && return
    echo "task $1 of $TASKS failed, try $try" >&2
    sleep "$PAUSE"
  done
  return 1
}

if [ -n "${SLURM_ARRAY_TASK_ID:-}" ]; then
  task "$SLURM_ARRAY_TASK_ID"
elif command -v sbatch > /dev/null; then
  array=$(sbatch --parsable "$0")
  sbatch --dependency="afterok:$array" --wrap 'spatialviz label --merge "$LABELS"'
else
  for k in $(seq "$TASKS"); do task "$k"; done
  echo "task 2 of $TASKS, again: $(label 2)"
  spatialviz label --merge "$LABELS"
fi
