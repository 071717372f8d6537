"""Process settings of a command."""

import os
import subprocess
import sys

import jax

from mjx_fit.engines.mjx.compiler import compiler_options

PROGRAM = """
import jax
from mjx_fit.utils import process_setup as runtime
runtime.configure()
print(jax.config.jax_compilation_cache_dir)
"""


def cache_dir(**changed):
    environment = {key: value for key, value in os.environ.items() if key != "JAX_COMPILATION_CACHE_DIR"}
    command = [sys.executable, "-c", PROGRAM]
    done = subprocess.run(
        command, env=environment | changed, capture_output=True, text=True, timeout=60, check=True
    )
    return done.stdout.strip()


def test_compiled_computations_are_kept_where_the_user_says(tmp_path):
    assert cache_dir(JAX_COMPILATION_CACHE_DIR=str(tmp_path / "mine")) == str(tmp_path / "mine")


def test_or_else_in_the_users_cache_folder(tmp_path):
    home = {"HOME": str(tmp_path), "XDG_CACHE_HOME": str(tmp_path / "cache")}
    assert cache_dir(**home).startswith(str(tmp_path))


def test_fusion_emitters_are_off_where_jax_lets_them_be():
    """Until JAX 0.11 a CPU's MJX takes 200 times as long with them, and nothing else would tell."""
    expected = jax.default_backend() == "cpu" and jax.__version_info__ < (0, 11)
    assert bool(compiler_options()) == expected
