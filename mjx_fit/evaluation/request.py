"""What an experiment is asked for."""

from dataclasses import dataclass
from pathlib import Path

from mjx_fit.config import Config
from mjx_fit.simulate.interface import Engine
from mjx_fit.training.trained_sensor import TrainedSensor


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
