#!/bin/bash
# Collect a data set with a job array, each job on its own machine, and merge it in a final job:
#
#   jobs=$(sbatch --parsable experiments/data/slurm.sh /scratch/me/data)
#   sbatch --dependency=afterok:$jobs --wrap 'mjx-fit data merge /scratch/me/data/part-* --out /scratch/me/data/all'
#
# Restart a stopped job, on its own if you like (sbatch --array=3 ...): it resumes where it stopped. --num-shards
# below must equal the size of the array.
#SBATCH --job-name=mjx-fit-collect
#SBATCH --array=0-11
#SBATCH --cpus-per-task=8
#SBATCH --mem=4G
#SBATCH --time=01:00:00
#SBATCH --requeue
set -euo pipefail
mjx-fit collect --out "$1/part-$(printf %02d "$SLURM_ARRAY_TASK_ID")" \
    --episodes 30000 --seed 0 --policy spiral --actions 100 \
    --shard-index "$SLURM_ARRAY_TASK_ID" --num-shards 12
