"""The script for Slurm, with commands that write down how they were called."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

SCRIPT = Path("experiments/cluster/slurm.sh")
FAKES = {
    "scontrol": 'printf "node1\\nnode2\\nnode3\\n"',
    "srun": 'echo "srun $*" >> "$CALLS"; while [[ "$1" == --* ]]; do shift; done; "$@"',
    "ray": 'echo "ray $*" >> "$CALLS"',
    "mjx-fit": 'echo "mjx-fit $*" >> "$CALLS"; exit "${FAILS:-0}"',
}


@pytest.fixture
def submitted(tmp_path):
    for name, text in FAKES.items():
        (tmp_path / name).write_text(f"#!/bin/bash\n{text}\n")
        (tmp_path / name).chmod(0o755)

    def run(*words, nodes=3, fails=0):
        calls = tmp_path / "calls"
        calls.unlink(missing_ok=True)
        environment = {
            "PATH": f"{tmp_path}:{os.environ['PATH']}",
            "CALLS": str(calls),
            "SLURM_JOB_NODELIST": "node[1-3]",
            "SLURM_JOB_NUM_NODES": str(nodes),
            "SLURM_CPUS_PER_TASK": "16",
            "RAY_STARTS_S": "0.2",
            "FAILS": str(fails),
        }
        bash = shutil.which("bash")
        assert bash
        done = subprocess.run([bash, str(SCRIPT), *words], env=environment, check=False)
        return done.returncode, calls.read_text().splitlines()

    return run


def test_the_nodes_are_one_cluster_and_the_first_one_drives(submitted):
    code, calls = submitted("collect", "--out", "/scratch/my data")
    assert code == 0
    of_ray = [line for line in calls if line.startswith("ray ")]
    assert of_ray[0].startswith("ray start --head --port=6379 --num-cpus=16")
    assert of_ray[1].startswith("ray start --address=node1:6379 --num-cpus=16")
    assert any("--exclude=node1" in line and "--nodes=2 --ntasks=2" in line for line in calls)
    assert calls[-1] == "mjx-fit collect --out /scratch/my data --cluster node1:6379"


def test_one_node_is_a_cluster_too(submitted):
    _, calls = submitted("collect", nodes=1)
    assert [line.split()[1:3] for line in calls if line.startswith("ray ")] == [["start", "--head"]]


def test_the_job_fails_with_its_command(submitted):
    assert submitted("collect", fails=2)[0] == 2


def test_its_options_are_slurms():
    options = [line.split()[1] for line in SCRIPT.read_text().splitlines() if line.startswith("#SBATCH")]
    names = {option.partition("=")[0] for option in options}
    known = {"--job-name", "--nodes", "--ntasks-per-node", "--cpus-per-task", "--mem", "--time", "--requeue"}
    assert names == known
