"""Load the sensors of a training run."""

from pathlib import Path

from mjx_fit.sensors.trained_sensor import TrainedSensor
from mjx_fit.training import checkpoint
from mjx_fit.training.checkpoint import FRAME_BY_FRAME


def load_trained_sensor(run: Path) -> TrainedSensor:
    """Load the best sensor of a training run.

    Raises:
        RequestError: The folder is missing, holds no run or no checkpoint, or the network differs.
    """
    network, config = checkpoint.load_sensor(run)
    return TrainedSensor(network, config, checkpoint.fingerprint_of(network))


def load_baseline(run: Path) -> TrainedSensor | None:
    """Load the frame-by-frame baseline of a training run, or None if the run has no baseline.

    Raises:
        RequestError: The baseline exists but cannot be read.
    """
    return load_trained_sensor(run / FRAME_BY_FRAME) if (run / FRAME_BY_FRAME).is_dir() else None
