"""Files of diverged simulations, which users send with a report."""

import pickle
from typing import Any

import jax
import numpy as np
import pytest

from mjx_fit.config.schema import Config, config_to_yaml
from mjx_fit.engines import failure_file, failures
from mjx_fit.utils.errors import RequestError

RIGHT: dict[str, Any] = {
    "qpos": np.zeros(7, np.float32),
    "qvel": np.zeros(7, np.float32),
    "step": np.int32(3),
    "horizon": 100,
    "config": config_to_yaml(Config()),
    "key": np.asarray(jax.random.key_data(jax.random.key(0))),
    "peg_type": np.int32(0),
    "hole_type": np.int32(2),
    "hole_pos_world": np.zeros(2, np.float32),
    "estimate_world": np.zeros(2, np.float32),
    "policy": np.int32(1),
}


class Harm:
    def __reduce__(self):
        return (pytest.fail, ("a pickle was loaded",))


CHANGES = {
    "a pickle": {"config": np.array(Harm(), object)},
    "pickles": {"qpos": np.array([Harm()] * 7, object)},
    "short": {"qpos": np.zeros(6)},
    "long": {"qvel": np.zeros((7, 7))},
    "not finite": {"qpos": np.full(7, np.nan)},
    "text": {"step": np.array("3")},
    "number": {"config": np.array(3)},
    "large": {"config": np.array("x" * 300_000)},
    "compound": {"step": np.zeros((), [("a", "i4")])},
    "date": {"step": np.datetime64("2026-01-01")},
    "behind the end": {"step": 100},
    "before the start": {"step": -1},
    "endless": {"horizon": 10**9},
    "no shape": {"peg_type": 3},
    "no policy": {"policy": -1},
    "another key": {"key": np.zeros(4, np.uint32)},
    "one more": {"more": 1},
    "no such physics": {"physics_colour": np.float32(1)},
    "absurd physics": {"physics_friction": np.float32(9)},
    "physics of many": {"physics_friction": np.ones(3, np.float32)},
}


def test_what_is_right_is_read(tmp_path):
    np.savez(tmp_path / "b.npz", **RIGHT)
    kept = failure_file.read(tmp_path / "b.npz")
    assert all(np.array_equal(kept[name], value) for name, value in RIGHT.items())


def test_physics_are_read(tmp_path):
    np.savez(tmp_path / "b.npz", **RIGHT, physics_friction=np.float32(0.5))
    assert failure_file.read(tmp_path / "b.npz")["physics_friction"] == 0.5


@pytest.mark.parametrize("name", CHANGES)
def test_what_is_not_is_one_line(name, tmp_path):
    np.savez(tmp_path / "b.npz", **RIGHT | CHANGES[name])
    with pytest.raises(RequestError, match=r"b\.npz is not the file of a diverged simulation") as error:
        failures.replay(tmp_path / "b.npz")
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04", pickle.dumps(3), b"\x93NUMPY\x01\x00", None])
def test_files_that_are_none(content, tmp_path):
    if content is not None:
        (tmp_path / "b.npz").write_bytes(content)
    with pytest.raises(RequestError, match=r"b\.npz"):
        failures.replay(tmp_path / "b.npz")


def test_every_cut_and_many_flips_are_one_line(tmp_path):
    path, rng = tmp_path / "b.npz", np.random.default_rng(0)
    np.savez(path, **RIGHT)
    content = path.read_bytes()
    for length in range(0, len(content), 53):
        path.write_bytes(content[:length])
        with pytest.raises(RequestError):
            failure_file.read(path)
    for _ in range(200):
        damaged = bytearray(content)
        damaged[rng.integers(len(damaged))] ^= 1 << int(rng.integers(8))
        path.write_bytes(damaged)
        try:
            failure_file.read(path)  # a time stamp of the archive
        except RequestError:
            continue
