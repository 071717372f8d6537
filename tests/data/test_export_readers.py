"""Exports are opened by their readers' own code, in an environment that has nothing of ours.

Read on 2026-11 with robomimic 0.3.0, torch 2.13.0, numpy 2.4.6 and h5py 3.16.0, and on 2026-12-01 with
LeRobot 0.4.4, datasets 4.8.5 and torch 2.10.0.
"""

import json
import subprocess
import sys
import venv
from pathlib import Path

import numpy as np
import pytest
from collecting import Collector
from places import EXPERIMENTS, TESTS

from mjx_fit.data import reader
from mjx_fit.data.exports import export

READER = TESTS / "robomimic_reader.py"
NEEDS = ("robomimic==0.3.0", "torch==2.13.0", "h5py>=3.12,<4", "numpy>=2.0,<3")
ALONE = ("psutil", "termcolor", "tqdm", "six", "matplotlib")
"""What robomimic imports of what it asks for; the rest, such as torchvision, is for pictures and logs."""


LEROBOT = ("lerobot==0.4.4", "datasets>=4,<5", "torch==2.10.0", "huggingface-hub>=0.34.2,<0.36")
LEROBOT_ALONE = (
    "torchvision", "packaging", "av>=15,<16", "jsonlines", "einops", "draccus==0.10.0", "gymnasium<2",
    "deepdiff<9", "imageio", "opencv-python-headless<4.13", "accelerate", "diffusers<0.36", "termcolor",
)  # fmt: skip
"""What its loader imports; the rest is for robots, cameras and policies."""


def environment(folder, alone, *others):
    """Return the interpreter of an environment with the first package as it is, and others."""
    venv.create(folder, with_pip=True)
    found = folder / ("Scripts/python.exe" if sys.platform == "win32" else "bin/python")
    for what in (others, ["--no-deps", alone]):
        done = subprocess.run(
            [found, "-m", "pip", "install", "-q", *what], capture_output=True, text=True, check=False
        )
        if done.returncode:
            pytest.skip(f"pip install {' '.join(what)}: {done.stderr.strip().splitlines()[-1]}")
    return found


def told_by(python, reader, *files):
    """Return what a reader prints about files, and show it."""
    done = subprocess.run(
        [python, reader, *files],
        capture_output=True,
        text=True,
        check=False,
        cwd=Path(files[0]).parent,
        env={"PATH": "", "HOME": str(Path(files[0]).parent)},
    )
    assert done.returncode == 0, done.stderr[-2000:]
    read = done.stdout.strip().splitlines()[-1]
    print(read)
    return read


@pytest.fixture(scope="module")
def python(tmp_path_factory):
    """The interpreter of an environment with robomimic."""
    alone, *others = NEEDS
    return environment(tmp_path_factory.mktemp("readers") / "venv", alone, *others, *ALONE)


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_robomimic_trains_on_the_demonstrations_and_numpy_opens_the_arrays(native, python, tmp_path):
    folder = Collector(native)(tmp_path / "set", sequence=2, episodes=10)
    for name in ("set.hdf5", "set.npz"):
        export(folder, tmp_path / name)
    read = json.loads(told_by(python, READER, tmp_path / "set.hdf5", tmp_path / "set.npz"))
    data = reader.load(folder)
    assert (read["env_name"], read["seed"], read["action_width"]) == ("mjx_fit", 5, 3)
    assert read["shapes"]["wrench_sensor"] == [50, 6]
    assert read["transitions"] == data.rollout.felt.length.sum()
    kept = [f"demo_{i}" for i in np.flatnonzero(data.rollout.felt.length > 0)]
    assert sorted(read["sides"]["train"] + read["sides"]["valid"]) == sorted(kept)
    assert read["npz"]["length"][1] == [len(kept)]
    assert "request" in read["about"]


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_lerobot_opens_the_folder(native, tmp_path, tmp_path_factory):
    alone, *others = LEROBOT
    python = environment(tmp_path_factory.mktemp("lerobot") / "venv", alone, *others, *LEROBOT_ALONE)
    folder = Collector(native)(tmp_path / "set", sequence=2, episodes=10)
    export(folder, tmp_path / "out")
    read = json.loads(told_by(python, TESTS / "lerobot_reader.py", tmp_path / "out"))
    data = reader.load(folder)
    length = data.rollout.felt.length[data.rollout.felt.length > 0]
    assert read["lengths"] == (length + 1).tolist()
    assert (read["episodes"], read["frames"], read["fps"]) == (len(length), (length + 1).sum(), 10)
    shapes = read["shapes"]
    assert shapes["observation.wrench"] == [8, 50, 6]
    assert (shapes["observation.state"], shapes["action"]) == ([8, 13], [8, 3])
    np.testing.assert_allclose(read["first_wrench"], data.rollout.felt.tare_sensor[0], rtol=1e-6)
    assert read["task"] == f"insert the peg {read['peg']}"
    assert np.isfinite(read["mean"]).all()


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_torch_learns_from_the_arrays(native, python, tmp_path):
    """``experiments/data/train_torch.py`` runs with PyTorch and NumPy alone."""
    folder = Collector(native)(tmp_path / "set", actions=30, policy="spiral", episodes=60)
    export(folder, tmp_path / "set.npz")
    told = told_by(python, EXPERIMENTS / "data/train_torch.py", tmp_path / "set.npz", "20")
    assert told.startswith("median error ")
