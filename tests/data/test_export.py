"""A data set in others' formats, against what was stored."""

import json
import shutil
from dataclasses import replace
from typing import Any

import h5py
import numpy as np
import pytest
from collecting import Collector

from mjx_fit.config.schema import Config
from mjx_fit.data import hdf5, hdf5_fields, reader
from mjx_fit.data.exports import export
from mjx_fit.data.manifest import read_manifest, write_manifest
from mjx_fit.data.split import split_sequences
from mjx_fit.utils.errors import RequestError


@pytest.fixture(scope="module")
def folder(native, tmp_path_factory):
    return Collector(native)(tmp_path_factory.mktemp("data") / "set", sequence=2, episodes=10)


def test_npz_holds_every_field(folder, tmp_path):
    export(folder, tmp_path / "set.npz")
    data = reader.load(folder)
    with np.load(tmp_path / "set.npz") as file:
        about = json.loads(str(file["about"]))
        for name, value in hdf5.flat(data, Config(), hdf5_fields.Kind()).items():
            key = name.replace("/", "_")
            assert np.array_equal(file[key], value[data.rollout.felt.length > 0])
            assert about[key]["unit"] == hdf5_fields.FIELDS[name].unit
    assert about["request"]["seed"] == 5


def test_demonstrations_are_laid_out_as_robomimic_reads_them(folder, native, tmp_path):
    export(folder, tmp_path / "set.hdf5")
    data = reader.load(folder)
    with h5py.File(tmp_path / "set.hdf5") as file:
        root: Any = file["data"]
        demos = list(root)
        assert demos == [f"demo_{i}" for i in range(10)]
        assert root.attrs["total"] == data.rollout.felt.length.sum()
        about = json.loads(root.attrs["env_args"])
        assert about["env_kwargs"]["seed"] == 5
        assert (about["env_name"], about["type"]) == ("mjx_fit", 2)
        fields = hdf5.flat(data, Config(), hdf5_fields.Kind())
        for i, name in enumerate(demos):
            demo = root[name]
            n = demo.attrs["num_samples"]
            assert n == data.rollout.felt.length[i] == len(demo["actions"])
            assert demo["dones"][-1] == 1
            assert demo["dones"][:-1].sum() == demo["rewards"][()].sum() == 0
            for key in demo["obs"]:
                stored = np.asarray(fields[f"trace/{key}"][i, :n])
                if key == "contact":
                    stored = stored[:, None].astype(np.float32)
                assert demo["obs"][key].dtype == np.float32
                assert np.array_equal(demo["next_obs"][key], stored)
                assert np.array_equal(demo["obs"][key][1:], stored[:-1])
            start = demo["obs/tip_pos_world"][0]
            assert start[:2] == pytest.approx(data.rollout.felt.estimate_world[i])
            assert start[2] == pytest.approx(native.scene.plate_top_m + 0.002)
            assert demo.attrs["peg_type"] in ("cross", "rectangle", "square")


def test_the_masks_are_the_sides_that_training_would_take(native, tmp_path):
    folder = Collector(native)(tmp_path / "set", sequence=2, episodes=30)
    export(folder, tmp_path / "set.hdf5")
    data = reader.load(folder)
    sides = split_sequences(np.asarray(data.sequence), Config().train.validation_fraction, seed=0)
    with h5py.File(tmp_path / "set.hdf5") as file:
        root: Any = file
        masks = [[name.decode() for name in root[f"mask/{side}"]] for side in ("train", "valid")]
        assert set(masks[0]) | set(masks[1]) == set(root["data"])
    for names, ids in zip(masks, sides, strict=True):
        assert names == [f"demo_{i}" for i in ids if data.rollout.felt.length[i] > 0]
        assert names
    of = dict(zip((f"demo_{i}" for i in range(30)), np.asarray(data.sequence).tolist(), strict=True))
    assert not {of[name] for name in masks[0]} & {of[name] for name in masks[1]}


def test_a_single_sequence_is_for_training(native, tmp_path):
    folder = Collector(native)(tmp_path / "set", sequence=2, episodes=2)
    export(folder, tmp_path / "set.hdf5")
    with h5py.File(tmp_path / "set.hdf5") as file:
        root: Any = file
        assert len(root["mask/train"]) == len(root["data"])
        assert len(root["mask/valid"]) == 0


@pytest.mark.parametrize("name", ["set.npz", "set.hdf5"])
def test_unfinished_and_damaged_sets_are_refused_and_leave_nothing(name, folder, tmp_path):
    part = shutil.copytree(folder, tmp_path / "part")
    write_manifest(part, replace(read_manifest(part), complete=False))
    with pytest.raises(RequestError, match="it is not complete"):
        export(part, tmp_path / name)
    damaged = shutil.copytree(folder, tmp_path / "damaged")
    next(damaged.glob("*.h5")).write_bytes(b"?")
    with pytest.raises(RequestError, match="damaged or missing"):
        export(damaged, tmp_path / name)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["damaged", "part"]


def test_other_endings_and_folders_are_refused(folder, tmp_path):
    with pytest.raises(RequestError, match=r"must end in one of \.npz, \.hdf5"):
        export(folder, tmp_path / "set.csv")
    (tmp_path / "set.npz").mkdir()
    with pytest.raises(RequestError, match="it is a folder"):
        export(folder, tmp_path / "set.npz")
    assert list(tmp_path.iterdir()) == [tmp_path / "set.npz"]
