"""A trained sensor with what it was trained for."""

import sys
from dataclasses import dataclass, replace
from pathlib import Path

from mjx_fit import config as config_
from mjx_fit.config import Config
from mjx_fit.errors import RequestError
from mjx_fit.sensors.model import ContactSensor
from mjx_fit.settings import SensorConfig, TrainConfig
from mjx_fit.training import checkpoint
from mjx_fit.training.checkpoint import FRAME_BY_FRAME
from mjx_fit.training.kinship import away_from_training


@dataclass(frozen=True)
class TrainedSensor:
    """A sensor as a training run left it.

    Attributes:
        network: The sensor itself.
        config: The configuration that it was trained with.
        fingerprint: Tells it from all others.
    """

    network: ContactSensor
    config: Config
    fingerprint: str

    def adapt(self, config: Config) -> Config:
        """The configuration with the sensor and training of this one, which cannot be changed.

        Raises:
            RequestError: The configuration asks for others, or for shapes that the sensor does not know.
        """
        trained = self.config
        if trained.scene.shapes != config.scene.shapes:
            there, here = (", ".join(one.scene.names) for one in (trained, config))
            raise RequestError(
                f"--run: not allowed with this scene.shapes ({here}): it was trained on others ({there})"
            )
        for section in ("sensor", "train"):
            asked, there = getattr(config, section), getattr(trained, section)
            if asked not in (there, getattr(Config(), section)):
                word = next(
                    word for word in config_.differences(trained, config) if word.startswith(f"{section}.")
                )
                raise RequestError(f"config: {word}: it belongs to the trained sensor and cannot be changed")
        return replace(config, sensor=trained.sensor, train=trained.train)

    def differences(self, config: Config) -> list[str]:
        """In what a configuration differs from the training's, but for the network and its training."""
        return config_.differences(*(_without_network(one) for one in (self.config, config)))

    def say_if_away(self, config: Config, doing: str) -> None:
        """Notes on stderr, where a configuration differs from the training's, what is done with it."""
        if note := away_from_training(self.differences(config)):
            print(f"{doing}: {note}", file=sys.stderr)


def load_trained_sensor(run: Path) -> TrainedSensor:
    """Loads the best sensor of a training run.

    Raises:
        RequestError: The folder is missing, holds no run or no checkpoint, or one of another network.
    """
    network, config = checkpoint.load_sensor(run)
    return TrainedSensor(network, config, checkpoint.fingerprint_of(network))


def load_baseline(run: Path) -> TrainedSensor | None:
    """Loads the frame-by-frame baseline of a training run; None where it has none.

    Raises:
        RequestError: It is there and cannot be read.
    """
    return load_trained_sensor(run / FRAME_BY_FRAME) if (run / FRAME_BY_FRAME).is_dir() else None


def _without_network(config: Config) -> Config:
    return replace(config, sensor=SensorConfig(), train=TrainConfig())
