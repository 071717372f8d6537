"""What an experiment is asked for."""

from dataclasses import dataclass, replace
from pathlib import Path

from mjx_fit.config.schema import Config
from mjx_fit.engines.interface import Engine, stored_policy_name
from mjx_fit.training.checkpoint import FRAME_BY_FRAME
from mjx_fit.training.sensor_loader import TrainedSensor, load_baseline, load_trained_sensor


@dataclass(frozen=True)
class Request:
    """What an experiment is asked for.

    Attributes:
        config: The configuration.
        out: The result file.
        engine: Simulates the attempts.
        trials: How many; each experiment says of what.
        seed: Root seed.
        methods: Names, comma-separated. The attempt experiment has none.
        seeds: Of the exploration noise and the sensor's noise, for each trial of the insertion experiment.
        sensor: For the methods that read traces.
        baseline: The frame-by-frame sensor of the same run, for the method of that name.
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

    def asked_policy(self) -> dict[str, str]:
        """The engine's own policy, for the result file; empty where attempts follow the spiral.

        Raises:
            RequestError: It has no name.
        """
        name = stored_policy_name(self.engine)
        return {} if name is None else {"policy": name}

    def with_sensors_of(self, run: Path) -> "Request":
        """The request with the sensor of a training run, and its baseline where one of the methods needs it.

        Raises:
            RequestError: They cannot be read.
        """
        needs_baseline = FRAME_BY_FRAME in self.methods.split(",")
        baseline = load_baseline(run) if needs_baseline else None
        return replace(self, sensor=load_trained_sensor(run), baseline=baseline)
