"""Request of an experiment."""

from dataclasses import dataclass, field, replace
from pathlib import Path

from mjx_fit.config.schema import Config
from mjx_fit.engines.interface import Engine, stored_policy_name
from mjx_fit.jobs.pool import Here, Pool
from mjx_fit.task.seek import GEOMETRIC
from mjx_fit.task.seek import NAME as SEEK
from mjx_fit.training.checkpoint import FRAME_BY_FRAME
from mjx_fit.training.sensor_loader import TrainedSensor, load_baseline, load_trained_sensor
from mjx_fit.utils.errors import RequestError

SEEKING = ("full", "oracle")
"""Methods that learn all that the policy ``seek`` learns by itself, or know it."""


@dataclass(frozen=True)
class Request:
    """Request of an experiment.

    Attributes:
        config: Configuration.
        out: Result file.
        engine: Engine that simulates the attempts.
        trials: Number of trials; each experiment defines its trial.
        seed: Root seed.
        methods: Names of the methods, comma-separated; the attempt experiment has none.
        seeds: Number of seeds of exploration noise and sensor noise per trial of the insertion experiment.
        sensor: Trained sensor, for the methods that use traces.
        baseline: Frame-by-frame sensor of the same run, for the method of that name.
        pool: Performs the parts of the experiment.
    """

    config: Config
    out: Path
    engine: Engine
    trials: int
    seed: int = 0
    methods: str = ""
    seeds: int = 1
    sensor: TrainedSensor | None = None
    baseline: TrainedSensor | None = None
    pool: Pool = field(default_factory=Here)

    def asked_policy(self) -> dict[str, str]:
        """Return the custom policy for the result file; empty where attempts follow the spiral.

        Raises:
            RequestError: The policy has no name, or it updates the belief itself, and a method must not.
        """
        name = stored_policy_name(self.engine)
        if name is not None and (name == GEOMETRIC or name.partition("@")[0] == SEEK):
            for method in filter(None, self.methods.split(",")):
                if method not in SEEKING:
                    raise RequestError(
                        f"--methods: {method} cannot be used with --policy {SEEK}, which updates the belief "
                        f"itself: choose from {', '.join(SEEKING)}"
                    )
        return {} if name is None else {"policy": name}

    def with_sensors_of(self, run: Path) -> "Request":
        """Return the request with the sensor of a training run, and its baseline if a method needs it.

        Raises:
            RequestError: The run cannot be read.
        """
        needs_baseline = FRAME_BY_FRAME in self.methods.split(",")
        baseline = load_baseline(run) if needs_baseline else None
        return replace(self, sensor=load_trained_sensor(run), baseline=baseline)
