"""Exports are opened by their readers' own code, in an environment that has nothing of ours.

Read on 2026-11 with robomimic 0.3.0, torch 2.13.0, numpy 2.4.6 and h5py 3.16.0.
"""

import json
import subprocess
import sys
import venv

import numpy as np
import pytest
from collecting import Collector
from places import TESTS

from mjx_fit.data import reader
from mjx_fit.data.exports import export

READER = TESTS / "robomimic_reader.py"
NEEDS = ("robomimic==0.3.0", "torch==2.13.0", "h5py>=3.12,<4", "numpy>=2.0,<3")
ALONE = ("psutil", "termcolor", "tqdm", "six", "matplotlib")
"""What robomimic imports of what it asks for; the rest, such as torchvision, is for pictures and logs."""


@pytest.fixture(scope="module")
def python(tmp_path_factory):
    """The interpreter of an environment with robomimic."""
    folder = tmp_path_factory.mktemp("readers") / "venv"
    venv.create(folder, with_pip=True)
    found = folder / ("Scripts/python.exe" if sys.platform == "win32" else "bin/python")
    robomimic, *others = NEEDS
    for what in ([*others, *ALONE], ["--no-deps", robomimic]):
        done = subprocess.run(
            [found, "-m", "pip", "install", "-q", *what], capture_output=True, text=True, check=False
        )
        if done.returncode:
            pytest.skip(f"pip install {' '.join(what)}: {done.stderr.strip().splitlines()[-1]}")
    return found


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_robomimic_trains_on_the_demonstrations_and_numpy_opens_the_arrays(native, python, tmp_path):
    folder = Collector(native)(tmp_path / "set", sequence=2, episodes=10)
    for name in ("set.hdf5", "set.npz"):
        export(folder, tmp_path / name)
    done = subprocess.run(
        [python, READER, tmp_path / "set.hdf5", tmp_path / "set.npz"],
        capture_output=True,
        text=True,
        check=False,
        cwd=tmp_path,
        env={"PATH": "", "HOME": str(tmp_path)},
    )
    assert done.returncode == 0, done.stderr[-2000:]
    read = json.loads(done.stdout.strip().splitlines()[-1])
    print(json.dumps(read))
    data = reader.load(folder)
    assert (read["env_name"], read["seed"], read["action_width"]) == ("mjx_fit", 5, 3)
    assert read["shapes"]["wrench_sensor"] == [50, 6]
    assert read["transitions"] == data.rollout.felt.length.sum()
    kept = [f"demo_{i}" for i in np.flatnonzero(data.rollout.felt.length > 0)]
    assert sorted(read["sides"]["train"] + read["sides"]["valid"]) == sorted(kept)
    assert read["npz"]["length"][1] == [len(kept)]
    assert "request" in read["about"]
