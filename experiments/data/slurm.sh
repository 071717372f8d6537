#!/bin/bash
# A data set made by an array of jobs, each on a machine of its own, and joined by a last one:
#
#   jobs=$(sbatch --parsable experiments/data/slurm.sh /scratch/me/data)
#   sbatch --dependency=afterok:$jobs --wrap 'mjx-fit data merge /scratch/me/data/part-* --out /scratch/me/data/all'
#
# A job that is stopped may be started again, alone too (sbatch --array=3 ...): it goes on where it was. The number
# of parts below is that of the array.
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
