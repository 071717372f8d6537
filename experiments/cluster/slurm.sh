#!/bin/bash
# Run a command of mjx-fit on all nodes of a Slurm job, as workers of one Ray cluster:
#
#   sbatch experiments/cluster/slurm.sh collect --episodes 100000 --out /scratch/me/data --shared-storage
#   sbatch experiments/cluster/slurm.sh sweep --config sweep.yaml --out /scratch/me/sweep
#
# A job that was stopped resumes when it is submitted again. Each node needs mjx-fit with the extra ray.
#SBATCH --job-name=mjx-fit
#SBATCH --nodes=4
#SBATCH --ntasks-per-node=1
#SBATCH --cpus-per-task=16
#SBATCH --mem=32G
#SBATCH --time=04:00:00
#SBATCH --requeue
set -euo pipefail
port=6379
nodes=$(scontrol show hostnames "$SLURM_JOB_NODELIST")
head=${nodes%%$'\n'*}
cpus=$SLURM_CPUS_PER_TASK

srun --nodes=1 --ntasks=1 --nodelist="$head" \
    ray start --head --port="$port" --num-cpus="$cpus" --disable-usage-stats --block &
sleep "${RAY_STARTS_S:-20}"
if [ "$SLURM_JOB_NUM_NODES" -gt 1 ]; then
    srun --nodes=$((SLURM_JOB_NUM_NODES - 1)) --ntasks=$((SLURM_JOB_NUM_NODES - 1)) --exclude="$head" \
        ray start --address="$head:$port" --num-cpus="$cpus" --disable-usage-stats --block &
    sleep "${RAY_STARTS_S:-20}"
fi
srun --overlap --nodes=1 --ntasks=1 --nodelist="$head" mjx-fit "$@" --cluster "$head:$port"
