"""Contact-rich assembly under uncertainty, on JAX and MuJoCo.

The names listed here are the public API and stay stable within a major version; everything else is
private by convention. Modules are imported when a name is first used: ``import mjx_fit`` loads neither JAX
nor MuJoCo.

- Settings: `configure`, `Config`, `Shape`, `load_config`, `RequestError`.
- Simulation: `make_engine`, `draw_attempts`, `Attempt`, `Rollout`, `Felt`.
- Policies: `Policy`, `PolicyInput`, `stateless_policy`.
- Sensors and filters: `load_sensor`, `TrainedSensor`, `readings`, `Belief`, `filter_update`,
  `kalman_update`.
- Your own robot: `BeliefTracker`, `OnlineTracker`, `SensorLog`, `felt_from_log`, `log_from_felt`.
- Data sets: `CollectionPlan`, `collect_dataset`, `load_dataset`.
- Experiments: `draw_holes`, `try_holes`, `mean_interval`.
"""

from importlib import import_module
from typing import Any

_PUBLIC = {
    # Settings
    "configure": ("mjx_fit.utils.process_setup", "configure"),
    "Config": ("mjx_fit.config.schema", "Config"),
    "Shape": ("mjx_fit.config.sections.shape", "Shape"),
    "load_config": ("mjx_fit.api", "load_config"),
    "RequestError": ("mjx_fit.utils.errors", "RequestError"),
    # Simulation
    "make_engine": ("mjx_fit.engines.select", "make_engine"),
    "draw_attempts": ("mjx_fit.api", "draw_attempts"),
    "Attempt": ("mjx_fit.types", "Attempt"),
    "Rollout": ("mjx_fit.types", "Rollout"),
    "Felt": ("mjx_fit.types", "Felt"),
    # Policies
    "Policy": ("mjx_fit.control.policies", "Policy"),
    "PolicyInput": ("mjx_fit.control.policies", "PolicyInput"),
    "stateless_policy": ("mjx_fit.control.policies", "stateless"),
    # Sensors and filters
    "load_sensor": ("mjx_fit.api", "load_sensor"),
    "TrainedSensor": ("mjx_fit.sensors.trained_sensor", "TrainedSensor"),
    "readings": ("mjx_fit.task.estimator", "readings"),
    "Belief": ("mjx_fit.types", "Belief"),
    "filter_update": ("mjx_fit.task.estimator", "filter_update"),
    "kalman_update": ("mjx_fit.filters.kalman", "update"),
    # Your own robot
    "BeliefTracker": ("mjx_fit.task.tracker", "BeliefTracker"),
    "OnlineTracker": ("mjx_fit.task.online", "OnlineTracker"),
    "SensorLog": ("mjx_fit.sensors.sensor_log", "SensorLog"),
    "felt_from_log": ("mjx_fit.sensors.resampling", "felt_from_log"),
    "log_from_felt": ("mjx_fit.sensors.resampling", "log_from_felt"),
    # Data sets
    "CollectionPlan": ("mjx_fit.data.plan", "Plan"),
    "collect_dataset": ("mjx_fit.api", "collect_dataset"),
    "load_dataset": ("mjx_fit.api", "load_dataset"),
    # Experiments
    "draw_holes": ("mjx_fit.api", "draw_holes"),
    "try_holes": ("mjx_fit.api", "try_holes"),
    "mean_interval": ("mjx_fit.api", "mean_interval"),
}
"""Public name -> (module, attribute) that defines it."""

__all__ = list(_PUBLIC)  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    """Resolve a public name, or ``__version__``, on first access.

    Imports are deferred because the command line chooses the OpenGL back end before MuJoCo loads, and handles
    Ctrl-C before it imports anything.
    """
    if name == "__version__":
        from importlib.metadata import version

        return version("mjx-fit")
    if name not in _PUBLIC:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module, attribute = _PUBLIC[name]
    value = getattr(import_module(module), attribute)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """List the public names."""
    return [*__all__, "__version__"]
