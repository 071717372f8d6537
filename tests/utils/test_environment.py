"""The environment's wrong values are one line each, and what is not needed is not loaded."""

import os
import subprocess
import sys
import warnings

import jax
import jax.numpy as jnp
import pytest

from mjx_fit.cli import main
from mjx_fit.utils import environment
from mjx_fit.utils.errors import RequestError


@pytest.mark.parametrize(
    ("variable", "value", "error"),
    [
        ("JAX_ENABLE_X64", "maybe", "invalid truth value 'maybe' for environment 'JAX_ENABLE_X64'"),
        ("JAX_RANDOM_SEED_OFFSET", "x", 'Invalid value "x" for JAX flag jax_random_seed_offset'),
        ("JAX_PLATFORMS", "cuda", ""),
        (
            "JAX_PLATFORMS",
            "nonsense",
            "Unable to initialize backend 'nonsense' (set JAX_PLATFORMS='' to ...)",
        ),
        ("JAX_DEFAULT_DEVICE", "toaster", "jax.default_device must be passed a Device, got: 'toaster'"),
        (
            "NPY_DISABLE_CPU_FEATURES",
            "SSE",
            "During parsing environment variable: 'NPY_DISABLE_CPU_FEATURES'",
        ),
    ],
)
def test_the_variable_at_fault_is_named(variable, value, error, monkeypatch):
    for name in list(os.environ):
        if name.startswith(("JAX_", "XLA_", "NPY_")):
            monkeypatch.delenv(name)
    assert environment.blame(RuntimeError(error)) is None
    monkeypatch.setenv("JAX_LOG_COMPILES", "0")
    monkeypatch.setenv(variable, value)
    told = str(environment.blame(AssertionError(error)))
    assert told.startswith(f"{variable}: {value!r} cannot be used here: ")


def test_flags_that_xla_would_end_the_process_at(monkeypatch, tmp_path):
    monkeypatch.setattr(environment, "CACHE", tmp_path / "cache")
    monkeypatch.setenv("XLA_FLAGS", "--nonsense=1")
    with pytest.raises(RequestError, match=r"XLA_FLAGS: '--nonsense=1' cannot be used: Unknown flag"):
        environment._require_flags()
    monkeypatch.setenv("XLA_FLAGS", "--xla_backend_optimization_level=1")
    environment._require_flags()
    monkeypatch.setattr(environment, "subprocess", None)  # the verdict is kept
    environment._require_flags()
    monkeypatch.setenv("XLA_FLAGS", " ")
    environment._require_flags()


def test_what_does_not_draw_loads_no_gl_and_children_get_the_users_choice(monkeypatch):
    monkeypatch.setattr(environment, "_hidden", {})
    monkeypatch.delitem(sys.modules, "mujoco")
    for asked in ("osmesa", None):
        if asked is None:
            monkeypatch.delenv("MUJOCO_GL", raising=False)
        else:
            monkeypatch.setenv("MUJOCO_GL", asked)
        environment.draw_nothing()
        assert os.environ["MUJOCO_GL"] == "disable"
        assert environment.for_children().get("MUJOCO_GL") == asked


def test_warnings_are_no_errors(monkeypatch):
    monkeypatch.setattr(sys, "warnoptions", ["error"])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        environment.relax_warnings()
        with pytest.warns(DeprecationWarning, match="old"):
            warnings.warn("old", DeprecationWarning, stacklevel=1)


def test_memory_that_xla_does_not_get_is_one_line(monkeypatch, capsys):
    monkeypatch.setattr("mjx_fit.report.build.build", lambda *_: jax.block_until_ready(jnp.zeros(1 << 45)))
    assert main.main(["report", "d", "--out", "page"]) == 1
    err = capsys.readouterr().err
    assert "this needs more memory than there is (Out of memory allocating 140737488355328 bytes" in err
    assert err.count("\n") == 1


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize(
    ("setting", "words", "code", "says"),
    [
        ("JAX_PLATFORMS=cuda", ["info"], 2, "JAX_PLATFORMS: 'cuda' cannot be used here"),
        ("JAX_PLATFORMS=nonsense", ["info"], 2, "JAX_PLATFORMS: 'nonsense' cannot be used here"),
        ("JAX_ENABLE_X64=maybe", ["info"], 2, "JAX_ENABLE_X64: 'maybe' cannot be used here"),
        ("XLA_FLAGS=--nonsense", ["info"], 2, "XLA_FLAGS: '--nonsense' cannot be used"),
        ("MUJOCO_GL=nonsense", ["info"], 0, ""),
        ("MUJOCO_GL=osmesa", ["info"], 0, ""),
        ("PYTHONWARNINGS=error", ["info", "--json"], 0, ""),
        ("HOME=/dev/null", ["info"], 0, ""),
        ("TMPDIR=/nonexistent", ["info"], 0, ""),
        ("MUJOCO_GL=nonsense", ["render", "--out", "x.mp4"], 2, "MUJOCO_GL: 'nonsense' cannot be used"),
    ],
)
def test_commands_under_a_setting(setting, words, code, says, tmp_path):
    name, _, value = setting.partition("=")
    command = [sys.executable, "-m", "mjx_fit", *words]
    env = os.environ | {name: value, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    done = subprocess.run(
        command, env=env, cwd=tmp_path, capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == code, done.stderr
    assert "Traceback" not in done.stderr
    assert says in done.stderr
