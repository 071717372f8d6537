"""A trained sensor with what it was trained for."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace

from mjx_fit.config.schema import Config, config_differences
from mjx_fit.config.sections.learning import SensorConfig, TrainConfig
from mjx_fit.sensors.contact_sensor import ContactSensor
from mjx_fit.utils.errors import RequestError


@dataclass(frozen=True)
class TrainedSensor:
    """A sensor as a training run left it.

    Example:
        >>> import mjx_fit as mf
        >>> sensor = mf.load_sensor()
        >>> sensor.differences(mf.load_config(None, "scene.friction=0.6"))
        ['scene.friction is 0.3 there and 0.6 here']

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
                f"--run: not usable with this scene.shapes ({here}): it was trained on others ({there})"
            )
        for section in ("sensor", "train"):
            asked, there = getattr(config, section), getattr(trained, section)
            if asked not in (there, getattr(Config(), section)):
                word = next(
                    word for word in config_differences(trained, config) if word.startswith(f"{section}.")
                )
                raise RequestError(f"config: {word}: it belongs to the trained sensor and cannot be changed")
        return replace(config, sensor=trained.sensor, train=trained.train)

    def differences(self, config: Config) -> list[str]:
        """In what a configuration differs from the training's, but for the network and its training."""
        return config_differences(*(_without_network(one) for one in (self.config, config)))

    def say_if_away(self, config: Config, doing: str) -> None:
        """Notes on stderr, where a configuration differs from the training's, what is done with it."""
        if note := away_from_training(self.differences(config)):
            print(f"{doing}: {note}", file=sys.stderr)


def away_from_training(differences: Sequence[str]) -> str:
    """In what the settings in use differ from those that a sensor was trained with, in a line; or nothing.

    Args:
        differences: Of the training's configuration and the one in use, from ``config.differences``; those of
            the network and of training are not looked at.
    """
    words = [" ".join(str(one).split()) for one in differences]
    words = [one for one in words if not one.startswith(("sensor.", "train."))]
    if not words:
        return ""
    more = f" (and {len(words) - 1} more)" if len(words) > 1 else ""
    return f"settings differ from the sensor's training: {words[0]}{more}"


def _without_network(config: Config) -> Config:
    return replace(config, sensor=SensorConfig(), train=TrainConfig())
