import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

import hypothesis
import jax
import pytest
from collecting import Collector

from mjx_fit.config.schema import Config
from mjx_fit.engines.native.engine import NativeEngine
from mjx_fit.scene.build import Scene, simulation_scene

hypothesis.settings.register_profile("mjx_fit", deadline=None, derandomize=True, max_examples=50)
hypothesis.settings.load_profile("mjx_fit")


COMPILED = "JAX_COMPILATION_CACHE_DIR"

# Small computations are kept, too: JAX keeps what took a second or more to compile, and a command that a test
# starts compiles a dozen that took less: 2 s of its 5.7 s.
KEPT_FROM_S = "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"

# Most of the time of the slowest tests is compiling, much of it LLVM polishing code that runs once. At
# level 0 rounding differs enough for trainings to part. `XLA_FLAGS= make test` tests what commands run.
os.environ.setdefault("XLA_FLAGS", "--xla_backend_optimization_level=1")


LONG = {
    "assembly", "attempt", "attention", "batches", "bench", "calibration", "checkpoint", "cli",
    "collect", "collision", "compilation_cache", "contact_memory", "contact_sensor", "crash",
    "damaged_checkpoint", "demo", "engines", "every_action", "examples", "export", "export_readers",
    "files", "framed", "going_on", "hostile_configs", "hostile_data", "hostile_results",
    "hostile_runs", "insertion_envs", "interrupts", "levelling", "loopback", "loss", "machine_paths",
    "memory", "mirror", "newton_solver", "numerics", "online", "package", "paper", "parity", "parts",
    "parts_parity", "placement", "plausible", "policy_hooks", "posed_pictures", "pools", "poses", "press",
    "public", "reader", "requests", "revisits", "round_trip", "seek_poses", "sensed_success",
    "single_hole", "sliding", "slip", "torch_twin", "tracker", "training", "turning", "types", "video",
    "viewer", "viser_access", "watchdog", "windows",
}  # fmt: skip
"""Modules that compile an engine or a training, start processes, or sweep over thousands of wrong inputs:
``make quick`` leaves them out."""


SLOWEST_FIRST = (
    "training", "engines", "parts_parity", "cli", "demo", "placement", "poses", "framed", "seek_poses",
    "every_action", "turning", "hostile_configs", "parity", "examples", "crash", "going_on",
)  # fmt: skip
"""Modules that take half a minute and more, longest first: two processes then end at about the same time."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    def place(item: pytest.Item) -> int:
        name = item.path.stem.removeprefix("test_")
        return SLOWEST_FIRST.index(name) if name in SLOWEST_FIRST else len(SLOWEST_FIRST)

    items.sort(key=place)
    for item in items:
        if item.path.stem.removeprefix("test_") in LONG:
            item.add_marker("long")


def pytest_configure(config: pytest.Config) -> None:
    """What one test compiled the others load, as commands do (``runtime``).

    The folder is the session's own: no test depends on what an earlier session left.
    """
    if not hasattr(config, "workerinput"):
        folder = tempfile.TemporaryDirectory(prefix="mjx_fit-compiled-")
        config.add_cleanup(folder.cleanup)
        os.environ[COMPILED] = folder.name
    jax.config.update("jax_compilation_cache_dir", os.environ[COMPILED])
    os.environ[KEPT_FROM_S] = "0"
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0)


MOST_MAPS = 20_000
"""Memory maps at which a process forgets what it compiled. Linux grants 65,530 (``vm.max_map_count``), each
compiled computation takes three, and a process that has none left dies where JAX loads the next one."""


@pytest.fixture(scope="module", autouse=True)
def forget_compiled() -> Iterator[None]:
    yield
    maps = Path("/proc/self/maps")
    if maps.exists() and len(maps.read_text().splitlines()) > MOST_MAPS:
        jax.clear_caches()


@pytest.fixture(scope="session")
def scene() -> Scene:
    return simulation_scene(Config().scene)


@pytest.fixture(scope="session")
def native() -> NativeEngine:
    return NativeEngine(Config(), threads=2)


@pytest.fixture(scope="session")
def collect(native) -> Collector:
    return Collector(native)


@pytest.fixture
def key() -> jax.Array:
    return jax.random.key(0)
