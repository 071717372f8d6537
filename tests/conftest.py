import hypothesis
import jax
import pytest
from collecting import Collector

from mjx_fit.config import Config
from mjx_fit.scene import Scene, simulation_scene
from mjx_fit.simulate.native import NativeEngine

hypothesis.settings.register_profile("mjx_fit", deadline=None, derandomize=True, max_examples=50)
hypothesis.settings.load_profile("mjx_fit")


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
