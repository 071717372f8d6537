"""What a process decides about numbers: commands pin it, the library refuses it, records carry it."""

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
import pytest
from collecting import files_of

from mjx_fit.cli import main
from mjx_fit.config.schema import Config
from mjx_fit.data.manifest import read_manifest, write_manifest
from mjx_fit.engines.select import make_engine
from mjx_fit.evaluation import parts
from mjx_fit.task.estimator import filter_update
from mjx_fit.training import checkpoint, run_folder
from mjx_fit.utils import numerics, process_setup, provenance, randomness
from mjx_fit.utils.errors import RequestError

OTHERS = {
    "jax_enable_x64": True,
    "jax_default_prng_impl": "rbg",
    "jax_threefry_partitionable": False,
    "jax_random_seed_offset": 5,
    "jax_high_dynamic_range_gumbel": True,
    "jax_default_matmul_precision": "bfloat16",
    "jax_numpy_dtype_promotion": "strict",
    "jax_disable_jit": True,
    "jax_disable_most_optimizations": True,
    "jax_optimization_level": "O1",
    "jax_use_direct_linearize": False,
    "jax_numpy_rank_promotion": "raise",
    "jax_explicit_x64_dtypes": "error",
    "jax_legacy_prng_key": "error",
    "jax_transfer_guard_host_to_device": "disallow",
    "jax_transfer_guard_device_to_host": "disallow_explicit",
    "jax_debug_nans": True,
    "jax_debug_infs": True,
    "jax_debug_key_reuse": True,
    "jax_check_tracer_leaks": True,
    "jax_enable_checks": True,
    "jax_error_checking_behavior_nan": "raise",
}
"""For each kind of option a value that is invalid."""


@pytest.fixture
def option(request):
    """One option of the process set to another value, and back afterwards."""
    name, before = request.param, numerics._value(request.param)
    jax.config.update(name, OTHERS[name])
    yield name
    jax.config.update(name, before)


every_option = pytest.mark.parametrize("option", OTHERS, indirect=True)


@every_option
def test_the_library_refuses_an_option_that_changes_numbers(option):
    with pytest.raises(RequestError, match=rf"{option}: .* cannot be used .* expected "):
        randomness.root_key(0, "test")


@every_option
def test_commands_set_it(option):
    assert option in numerics.pin()
    assert numerics._value(option) == numerics.PINNED[option][0]
    numerics.require()


def test_every_way_into_the_library_looks():
    settings = Config()
    ways = (
        lambda: make_engine("native", settings),
        lambda: make_engine("mjx", settings),
        lambda: checkpoint.load_sensor(Path("nowhere")),
        lambda: filter_update(settings, None),
        lambda: randomness.root_key(0, "test"),
    )
    with jax.enable_x64(True):  # of this thread alone
        for way in ways:
            with pytest.raises(RequestError, match="jax_enable_x64"):
                way()
    numerics.require()


def test_an_engine_looks_again_when_it_runs(native):
    with jax.enable_x64(True), pytest.raises(RequestError, match="jax_enable_x64"):
        native.run(None, 1)


def test_numpy_that_raises_is_refused():
    with np.errstate(over="raise"), pytest.raises(RequestError, match=r"numpy.seterr: over='raise'"):
        numerics.require()


def test_keys_do_not_depend_on_the_default(monkeypatch):
    plain = jax.random.key_data(randomness.root_key(3, "test"))
    monkeypatch.setattr(numerics, "require", lambda: None)
    before = jax.config.jax_default_prng_impl
    jax.config.update("jax_default_prng_impl", "rbg")
    try:
        assert np.array_equal(jax.random.key_data(randomness.root_key(3, "test")), plain)
    finally:
        jax.config.update("jax_default_prng_impl", before)


def test_a_command_says_what_it_does_not_use(monkeypatch, capsys):
    monkeypatch.setenv("JAX_ENABLE_X64", "1")
    monkeypatch.setattr(numerics, "pin", lambda: {"jax_enable_x64": False, "jax_debug_nans": False})
    process_setup.pin()
    assert capsys.readouterr().err == "mjx-fit: JAX_ENABLE_X64=1 is not used: commands compute with False\n"


def test_an_ordinary_shell_adds_nothing_to_the_versions(monkeypatch):
    for name in list(os.environ):
        if name.startswith(("JAX_", "XLA_", "NPY_", "OPENBLAS_")):
            monkeypatch.delenv(name)
    monkeypatch.setenv("JAX_PLATFORMS", "cpu")
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", "somewhere")
    monkeypatch.setenv("JAX_ENABLE_X64", "1")  # pinned
    monkeypatch.setenv("XLA_FLAGS", " ")
    assert provenance.settings_of(provenance.versions()) == {}


def test_flags_are_carried_in_one_order_and_from_files(monkeypatch, tmp_path):
    def carried(value):
        monkeypatch.setenv("XLA_FLAGS", value)
        return provenance.versions().get("XLA_FLAGS")

    monkeypatch.setenv("NPY_DISABLE_CPU_FEATURES", "AVX2  FMA3")
    monkeypatch.setenv("JAX_SOMETHING_NEW", "1")
    assert carried(" --b=2   --a=1 --a=1 --xla_dump_to=/somewhere") == "--a=1 --b=2"
    (tmp_path / "flags").write_text("--b=2\n--a=1\n")
    assert carried(str(tmp_path / "flags")) == "--a=1 --b=2"
    assert provenance.versions()["NPY_DISABLE_CPU_FEATURES"] == "AVX2 FMA3"
    assert provenance.versions()["JAX_SOMETHING_NEW"] == "1"


FLAG = {"XLA_FLAGS": "--a=1"}


@pytest.fixture(params=["there", "here"])
def other(request, monkeypatch):
    """Changes a record of versions so that one side has an entry that the other lacks."""

    def change(versions):
        plain = {name: value for name, value in versions.items() if name != "XLA_FLAGS"}
        return plain | FLAG if request.param == "there" else plain

    monkeypatch.setenv("XLA_FLAGS", "" if request.param == "there" else "--a=1")
    return change


def test_a_set_of_two_arithmetics_is_not_completed(collect, tmp_path, other):
    out = collect(tmp_path / "set")
    there = read_manifest(out)
    write_manifest(out, replace(there, versions=other(there.versions)))
    collect(out)  # complete: nothing is made
    min(out.glob("*.h5")).unlink()
    with pytest.raises(RequestError, match="cannot be completed here: it was begun with XLA_FLAGS"):
        collect(out)


def test_nor_are_its_parts_merged(collect, tmp_path, capsys):
    folders = [collect(tmp_path / f"part{i}", shard_index=i, num_shards=2) for i in range(2)]
    there = read_manifest(folders[1])
    write_manifest(folders[1], replace(there, versions=there.versions | {"NPY_DISABLE_CPU_FEATURES": "X"}))
    capsys.readouterr()
    for order in (folders, folders[::-1]):
        assert main.main(["data", "merge", *map(str, order), "--out", str(tmp_path / "whole")]) == 2
        assert "its NPY_DISABLE_CPU_FEATURES is" in capsys.readouterr().err


def test_nor_is_begun_work_continued(tmp_path, other):
    own = {"request": 1, "versions": other(provenance.versions())}
    (tmp_path / parts.ASKED).write_text(json.dumps(own))
    with pytest.raises(RequestError, match="its XLA_FLAGS differs"):
        parts._require_own(tmp_path, own | {"versions": provenance.versions()})


def test_nor_a_run(tmp_path, other, capsys):
    def begin(versions):
        (tmp_path / run_folder.RUN).write_text(json.dumps({"versions": versions}))

    begin(other(provenance.versions()))
    with pytest.raises(RequestError, match=r"XLA_FLAGS: .* cannot be used here: .* was begun with"):
        run_folder.require_same_arithmetic(tmp_path)
    begin(provenance.versions())
    run_folder.require_same_arithmetic(tmp_path)
    assert capsys.readouterr().err == ""
    begin(provenance.versions() | {"jax": "0.1"})
    run_folder.require_same_arithmetic(tmp_path)
    assert "was begun with jax 0.1 and resumes with" in capsys.readouterr().err


SETTINGS = (
    "JAX_ENABLE_X64=1", "JAX_DEFAULT_PRNG_IMPL=rbg", "JAX_THREEFRY_PARTITIONABLE=0", "JAX_DISABLE_JIT=1",
    "JAX_NUMPY_RANK_PROMOTION=raise", "JAX_TRANSFER_GUARD=disallow", "JAX_NUMPY_DTYPE_PROMOTION=strict",
    "JAX_DEBUG_NANS=1", "JAX_DEFAULT_MATMUL_PRECISION=bfloat16", "JAX_RANDOM_SEED_OFFSET=5",
    "JAX_DISABLE_MOST_OPTIMIZATIONS=1", "JAX_ENABLE_CUSTOM_PRNG=1",
)  # fmt: skip


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_a_command_makes_the_same_bytes_under_every_setting(tmp_path):
    def made(number, setting):
        out = tmp_path / str(number)
        name, _, value = setting.partition("=")
        words = ["collect", "--episodes", "6", "--policy", "spiral", "--steps", "20", "--out", str(out)]
        env = os.environ | {name: value}
        subprocess.run([sys.executable, "-m", "mjx_fit", *words], check=True, timeout=300, env=env)
        return files_of(out)

    plain = made("plain", "NOTHING=1")
    assert len(plain) == 2
    for number, setting in enumerate(SETTINGS):
        assert made(number, setting) == plain, setting
