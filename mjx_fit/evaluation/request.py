"""Request of an experiment."""

from dataclasses import dataclass, field, replace
from pathlib import Path

from mjx_fit.config.schema import Config
from mjx_fit.engines.interface import Engine, stored_policy_name
from mjx_fit.evaluation.result_schema import MOST_PART_ROWS
from mjx_fit.jobs.pool import Here, Pool
from mjx_fit.task.seek import GEOMETRIC
from mjx_fit.task.seek import NAME as SEEK
from mjx_fit.training.checkpoint import FRAME_BY_FRAME
from mjx_fit.training.sensor_loader import TrainedSensor, load_baseline, load_trained_sensor
from mjx_fit.utils.errors import RequestError, require

PART_ROWS_OF_WORKERS = 128
"""Enough to fill an engine's blocks on two threads, and few enough for several workers to have parts."""
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
        part_rows: Most rows of a part (``parts.pieces``); None: as many as suit the pool. Beliefs depend on
            it in their last bits.
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
    part_rows: int | None = None

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

    @property
    def rows_of_parts(self) -> int | None:
        """Most rows of a part; None: as many as suit one process."""
        return PART_ROWS_OF_WORKERS if self.part_rows is None and not self.pool.alone else self.part_rows

    def asked_parts(self) -> dict[str, int]:
        """Return the size of the parts for the result file; empty where nobody asked for one.

        Raises:
            RequestError: The number is out of range.
        """
        rows = self.rows_of_parts
        if rows is None:
            return {}
        require("--part-rows", rows, 1, MOST_PART_ROWS)
        return {"part_rows": rows}

    def with_sensors_of(self, run: Path) -> "Request":
        """Return the request with the sensor of a training run, and its baseline if a method needs it.

        Raises:
            RequestError: The run cannot be read.
        """
        needs_baseline = FRAME_BY_FRAME in self.methods.split(",")
        baseline = load_baseline(run) if needs_baseline else None
        return replace(self, sensor=load_trained_sensor(run), baseline=baseline)
