#!/bin/bash
# A Ray cluster of the nodes of a Slurm job, and one command of fungrasp on it:
#   sbatch examples/slurm_cluster.sh evaluate --grasps allegro.npz --policy student --json result.json
#SBATCH --job-name=fungrasp
#SBATCH --nodes=4
#SBATCH --ntasks-per-node=1
#SBATCH --cpus-per-task=32
#SBATCH --time=04:00:00
set -euo pipefail

port=6379
head=$(scontrol show hostnames "$SLURM_JOB_NODELIST" | head -n 1)
address="$head:$port"
export OMP_NUM_THREADS=1

srun --nodes=1 --ntasks=1 --nodelist="$head" \
    ray start --head --port="$port" --num-cpus="$SLURM_CPUS_PER_TASK" --block &
sleep 20
if [ "$SLURM_JOB_NUM_NODES" -gt 1 ]; then
    srun --nodes=$((SLURM_JOB_NUM_NODES - 1)) --ntasks=$((SLURM_JOB_NUM_NODES - 1)) --exclude="$head" \
        ray start --address="$address" --num-cpus="$SLURM_CPUS_PER_TASK" --block &
    sleep 20
fi

srun --nodes=1 --ntasks=1 --overlap --nodelist="$head" fungrasp "$@" --ray "$address"
